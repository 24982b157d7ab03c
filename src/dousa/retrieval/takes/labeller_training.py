"""Learn to label takes: trees over moments, how segments follow one another, and how sure an answer is.

What trains are takes: annotated ones, and takes made of clips, once as they are and some more times disturbed
(`made_takes`). The trees learn from all of them. How much a moment's evidence weighs, how willing the sequence is to
say "nothing", how much it minds where actions begin and end, and how sure an answer is cannot be seen there: those
takes are known by heart. So the people are divided (clips by chance where they are not known), some categories are set
aside too, fewer trees are grown on the rest, and the takes of the people left out say which weights label them best,
how often an answer with this score is right, and what is gained by not answering.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import FloatArray, IntArray
from dousa.errors import TrainingError
from dousa.retrieval.counting.counter import find_usual
from dousa.retrieval.counting.tallies import measure_tallies
from dousa.retrieval.features.posed_motion import AnnotatedTake, LabelledClip, check_motion
from dousa.retrieval.takes.label import SHORT_GAP, TakeLabeller, describe_scores, mean_scores
from dousa.retrieval.takes.made_takes import (
    JoinedTake,
    Piece,
    disturb,
    join_clips,
    join_with_rests,
    shuffle_into_takes,
)
from dousa.retrieval.takes.moment_forest import Codes, MomentForest, Scale, choose_scale, grow_moment_forest
from dousa.retrieval.takes.moments import HOP, describe_moments
from dousa.retrieval.takes.sequence import N_PHASES, PHASE_FRAMES, Run, SequenceModel, SequenceWeights, fit_lengths
from dousa.retrieval.takes.windows import TAKE_RATE

Progress = Callable[[int, int], None]

_N_TREES, _N_FOLD_TREES = 60, 20
_MOST_MOMENTS = 20_000  # that the trees are grown on; fewer in a fold
_MOST_IN_FOLD = 8_000
_LEAST_ROUNDS, _MOST_ROUNDS = 2, 5  # times that the material is shown: once as it is, then disturbed
_PAIRED = 0.3  # chance that a clip is followed by one of its category, if there is one
_FOLDS = 3
_SET_ASIDE = 0.25  # share of the categories that a fold does not know
_STRANGERS = 0.4  # times as many of those are met elsewhere: one action in ten
_LEAST_STATES = 3  # categories, or nothing, that a fold must know
_ENOUGH = 8  # answers, right and wrong ones each, that a calibration needs
_MOST_HELD = 400  # moments
_MOST_COUNTED = 12  # clips of a category whose repetitions are counted
_DEFAULT_CALIBRATION = (4.0, 2.0, 2.0)
_DEFAULT_THRESHOLD = 0.5
_UNCOUNTED, _STRANGE = -1, -2  # moments of which nobody can say what they are; of categories that a fold does not know


def train_labeller(
    clips: Sequence[LabelledClip],
    takes: Sequence[AnnotatedTake] = (),
    *,
    random_state: int = 0,
    n_jobs: int | None = None,
    progress: Progress | None = None,
) -> TakeLabeller:
    """Learn to label takes.

    Parameters
    ----------
    clips : whole actions with categories; performers where they are known.
    takes : with what happens in them from beginning to end.
    random_state : seed; the same seed gives the same labeller.
    n_jobs : threads; None for one. The result does not depend on it.
    progress : called with the steps done and their number.

    Raises
    ------
    TrainingError : neither clips nor a segment with a category.
    """
    names = {clip.category for clip in clips}
    names |= {stretch.category for take in takes for stretch in take.stretches if stretch.category is not None}
    if not names:
        raise TrainingError("labeller.nothing_to_learn")
    classes = tuple(sorted(names))
    seeds = np.random.SeedSequence(random_state).spawn(2)
    report = progress or (lambda done, total: None)
    report(0, _FOLDS + 2)
    material = _make_material(clips, takes, np.random.default_rng(seeds[0]))
    shown = _describe(material, classes, n_jobs)
    report(1, _FOLDS + 2)
    generator = np.random.default_rng(seeds[1])
    n_states = N_PHASES * len(classes) + 1
    chosen = _thin([one.states for one in shown], n_states, _MOST_MOMENTS, generator)
    codes, states = _gather(shown, chosen)
    forest = _grow(codes, states, shown[0].scale, n_states, _N_TREES, random_state, n_jobs)
    sequence = fit_lengths(_measure(material, classes), SequenceWeights())
    held = np.sort(generator.permutation(len(states))[:_MOST_HELD])
    trials: list[_Trial] = []
    for number, people in enumerate(_divide(material, generator)):
        report(number + 2, _FOLDS + 2)
        trials += _try_fold(shown, chosen, material, people, sequence, generator, n_jobs)
    sequence = replace(sequence, weights=_choose_weights(sequence, trials))
    calibration, threshold = _calibrate([answer for trial in trials for answer in trial.answer(sequence)])
    leaves = forest.apply(codes[held])
    usual = _find_usual(clips, takes, classes)
    return TakeLabeller(classes, forest, sequence, calibration, threshold, leaves, states[held].astype(np.int32), usual)


def _find_usual(clips: Sequence[LabelledClip], takes: Sequence[AnnotatedTake], classes: Sequence[str]) -> FloatArray:
    """(C, 18) what one repetition of each category comes to in each tally, by some of its clips and segments."""
    from dousa.retrieval.features.channels import sample_positions

    shown: dict[str, list[tuple[FloatArray, float, float]]] = {name: [] for name in classes}
    for clip in clips:
        shown[clip.category].append((clip.positions, clip.frame_rate, clip.height))
    for take in takes:
        for one in take.stretches:
            if one.category is not None:
                start, stop = (round(seconds * take.frame_rate) for seconds in (one.start, one.stop))
                shown[one.category].append((take.positions[start:stop], take.frame_rate, take.height))
    usual = []
    for some in shown.values():
        few = some[:: max(-(-len(some) // _MOST_COUNTED), 1)]
        usual.append(find_usual([measure_tallies(sample_positions(part, rate), height) for part, rate, height in few]))
    return np.stack(usual)


@dataclass(frozen=True, slots=True, eq=False)
class _Material:
    """A take that trains: who performs, and in which round it is shown (0: as it is)."""

    take: JoinedTake
    performer: str
    number: int


def _make_material(
    clips: Sequence[LabelledClip], takes: Sequence[AnnotatedTake], generator: np.random.Generator
) -> list[_Material]:
    """Annotated takes and takes made of the clips, in several rounds; of many clips each is shown in one round."""
    real = [(_to_joined(take), take.performer or take.name) for take in takes]
    per_round = sum(len(take.positions) for take, _ in real) / HOP
    per_round += sum(len(clip.positions) / clip.frame_rate for clip in clips) * TAKE_RATE / HOP
    n_rounds = int(np.clip(round(_MOST_MOMENTS / max(per_round, 1.0)), _LEAST_ROUNDS, _MOST_ROUNDS))
    share = min(1.0, _MOST_MOMENTS / max(per_round * n_rounds, 1.0))
    material: list[_Material] = []
    order = generator.permutation(len(clips))
    for number in range(n_rounds):
        # Of few clips all are shown in every round, of many the next ones of them.
        first, count = round(number * share * len(clips)), round(share * len(clips))
        part = [clips[k] for k in np.sort(np.roll(order, -first)[:count])]
        for group in shuffle_into_takes(part, generator) if part else ():
            some = [part[k] for k in _pair(group, [clip.category for clip in part], generator)]
            take = join_with_rests(some, generator) if number else join_clips(some, generator)
            material.append(_Material(take, some[0].performer or f"group {len(material)}", number))
        material += [_Material(take, performer, number) for take, performer in real]
    return [replace(one, take=disturb(one.take, generator)) if one.number else one for one in material]


def _pair(group: Sequence[int], categories: Sequence[str], generator: np.random.Generator) -> list[int]:
    """The clips of a take in an order in which some follow one of their own category: where does one end there?"""
    rest, order = list(group), list[int]()
    while rest:
        same = [k for k in rest if order and categories[k] == categories[order[-1]]]
        chosen = same[0] if same and generator.random() < _PAIRED else rest[0]
        order.append(chosen)
        rest.remove(chosen)
    return order


def _to_joined(take: AnnotatedTake) -> JoinedTake:
    from dousa.retrieval.features.channels import sample_positions

    pieces = tuple(
        Piece(one.start * TAKE_RATE, one.stop * TAKE_RATE, one.category, one.counted) for one in take.stretches
    )
    return JoinedTake(sample_positions(check_motion(take), take.frame_rate), take.height, pieces)


@dataclass(frozen=True, slots=True, eq=False)
class _Shown:
    """The moments of a take: bytes (M, F), states (M,): 3 c + phase of category c, 3 C for nothing."""

    scale: Scale
    codes: Codes
    states: IntArray


def _describe(material: Sequence[_Material], classes: Sequence[str], n_jobs: int | None) -> list[_Shown]:
    import joblib

    from dousa.retrieval.features.channels import sample_positions

    def values_of(one: _Material) -> NDArray[np.float32]:
        sampled = sample_positions(one.take.positions, one.take.frame_rate)
        return np.concatenate([values for _, values in describe_moments(sampled, one.take.height)])

    every = max(len(material) // _SCALED_TAKES, 1)
    scale = choose_scale(np.concatenate([values_of(one) for one in material[::every]])[::_SCALED_MOMENTS])
    numbers = {name: number for number, name in enumerate(classes)}

    def show(one: _Material) -> _Shown:
        codes = scale.encode(values_of(one))
        return _Shown(scale, codes, _states_of(one.take, len(codes), numbers))

    shown: list[_Shown] = joblib.Parallel(n_jobs=n_jobs, prefer="threads")(
        joblib.delayed(show)(one) for one in material
    )
    return shown


_SCALED_TAKES, _SCALED_MOMENTS = 12, 3  # takes that the scale is measured on, and every which moment of them


def _states_of(take: JoinedTake, n_moments: int, numbers: dict[str, int]) -> IntArray:
    states = np.full(n_moments, _UNCOUNTED)
    middles = (np.arange(n_moments) + 0.5) * HOP
    for piece in take.pieces:
        inside = (middles >= piece.start) & (middles < piece.stop)
        if not piece.counted:
            states[inside] = _UNCOUNTED
        elif piece.category is None:
            states[inside] = N_PHASES * len(numbers)
        else:
            edge = min(PHASE_FRAMES, 0.5 * (piece.stop - piece.start))
            phase = 1 - (middles[inside] < piece.start + edge) + (middles[inside] >= piece.stop - edge)
            states[inside] = N_PHASES * numbers[piece.category] + phase
    return states


def _thin(
    states: Sequence[IntArray], n_states: int, most: int, generator: np.random.Generator
) -> list[NDArray[np.bool_]]:
    """Which moments train: as many as there may be, fewer of the states that have most."""
    everything = np.concatenate(states)
    counts = np.sort(np.bincount(everything[everything >= 0], minlength=n_states))
    rest, left = most, n_states
    limit = float(counts[-1])
    for count in counts:
        if count * left > rest:
            limit = rest / left
            break
        rest, left = rest - int(count), left - 1
    keep = np.zeros(len(everything), bool)
    for state in range(n_states):
        own = np.flatnonzero(everything == state)
        keep[generator.permutation(own)[: max(round(limit), 1)]] = True
    return np.split(keep, np.cumsum([len(some) for some in states])[:-1])


def _gather(shown: Sequence[_Shown], chosen: Sequence[NDArray[np.bool_]]) -> tuple[Codes, IntArray]:
    """(N, F) bytes, and (N,) states, of the chosen moments."""
    codes = np.concatenate([one.codes[keep] for one, keep in zip(shown, chosen, strict=True)])
    states = np.concatenate([one.states[keep] for one, keep in zip(shown, chosen, strict=True)])
    return codes, states


def _grow(
    codes: Codes, states: IntArray, scale: Scale, n_states: int, n_trees: int, seed: int, n_jobs: int | None
) -> MomentForest:
    weights = _weigh(states, n_states)
    return grow_moment_forest(codes, states, weights, scale, n_states, n_trees, random_state=seed, n_jobs=n_jobs)


def _weigh(states: IntArray, n_states: int) -> FloatArray:
    """The moments of a state weigh together as the square root of their number."""
    weights: FloatArray = 1.0 / np.sqrt(np.maximum(np.bincount(states, minlength=n_states), 1.0))
    return weights[states]


def _measure(material: Sequence[_Material], classes: Sequence[str]) -> list[list[float]]:
    """The lengths (frames) of all segments of each category and of nothing."""
    lengths: dict[str | None, list[float]] = {name: [] for name in (*classes, None)}
    for one in material:
        for piece in one.take.pieces:
            if piece.counted:
                lengths[piece.category].append(piece.stop - piece.start)
    return [lengths[name] for name in (*classes, None)]


def _divide(material: Sequence[_Material], generator: np.random.Generator) -> list[set[str]]:
    """Performers that are left out together."""
    names = sorted({one.performer for one in material})
    mixed = generator.permutation(np.array(names))
    folds = [set(mixed[k::_FOLDS].tolist()) for k in range(_FOLDS)]
    return [fold for fold in folds if fold and len(fold) < len(names)]


@dataclass(frozen=True, slots=True, eq=False)
class _Trial:
    """A take of somebody left out: probabilities of the phases (M, 3 C + 1), and the truth (M,), C being nothing."""

    shares: NDArray[np.float32]
    states: IntArray
    pieces: list[Run]

    def answer(self, sequence: SequenceModel) -> list[_Answer]:
        """What the model says, and what of it is right."""
        answers, n_categories = [], len(sequence.log_lengths) - 1
        for run in sequence.find_runs(self.shares):
            if run.state < n_categories:
                true = self.states[run.start : run.stop]
                true = true[true != _UNCOUNTED]
                if len(true):
                    evidence = describe_scores(mean_scores(self.shares, run)[None])[0]
                    right = float((true == run.state).mean())
                    strange = float((true == _STRANGE).mean())
                    answers.append(_Answer(evidence, len(true), right, strange))
        return answers


@dataclass(frozen=True, slots=True, eq=False)
class _Answer:
    """A segment that was said: evidence (2,), moments, shares of them that are right, and of categories not known."""

    evidence: FloatArray
    length: int
    right: float
    strange: float


def _try_fold(
    shown: Sequence[_Shown],
    chosen: Sequence[NDArray[np.bool_]],
    material: Sequence[_Material],
    people: set[str],
    sequence: SequenceModel,
    generator: np.random.Generator,
    n_jobs: int | None,
) -> list[_Trial]:
    """Learn without some people and some categories, and judge takes of those people."""
    n_categories = len(sequence.log_lengths) - 1
    n_states = N_PHASES * n_categories + 1
    aside = generator.permutation(n_categories)[: round(_SET_ASIDE * n_categories)]
    # Of the moments that train all, so that nothing has the same share here and there.
    train = [
        keep & ~np.isin(one.states // N_PHASES, aside) & (take.performer not in people)
        for one, keep, take in zip(shown, chosen, material, strict=True)
    ]
    share = _MOST_IN_FOLD / max(sum(int(keep.sum()) for keep in train), 1)
    codes, states = _gather(shown, [keep & (generator.random(len(keep)) < share) for keep in train])
    if len(np.unique(states // N_PHASES)) < _LEAST_STATES:
        return []
    forest = _grow(codes, states, shown[0].scale, n_states, _N_FOLD_TREES, int(generator.integers(2**31)), n_jobs)
    trials = []
    for one, take in zip(shown, material, strict=True):
        if take.performer in people:
            shares = forest.judge(forest.apply(one.codes))
            states = np.where(one.states < 0, one.states, one.states // N_PHASES)
            pieces = _runs_of(take.take, len(one.codes), states)
            strange = _forgive(np.where(np.isin(states, aside), _STRANGE, states), n_categories)
            trials.append(_Trial(shares, strange, [piece for piece in pieces if piece.state not in aside]))
    return trials


def _runs_of(take: JoinedTake, n_moments: int, states: IntArray) -> list[Run]:
    runs = []
    for piece in take.pieces:
        start, stop = round(piece.start / HOP), min(round(piece.stop / HOP), n_moments)
        if piece.counted and piece.category is not None and stop > start:
            runs.append(Run(start, stop, int(states[(start + stop) // 2])))
    return runs


def _forgive(states: IntArray, nothing: int) -> IntArray:
    """Short gaps between two actions are shared out, so nothing there counts neither way."""
    edges = np.flatnonzero(np.diff(states)) + 1
    forgiven = states.copy()
    for start, stop in zip(np.concatenate([[0], edges]), np.concatenate([edges, [len(states)]]), strict=True):
        if states[start] == nothing and (stop - start) * HOP <= SHORT_GAP + HOP:
            forgiven[start:stop] = _UNCOUNTED
    return forgiven


_EVIDENCE = (0.2, 0.4, 0.8, 1.6)
_NOTHING = (1.0, 0.0, -1.0, -2.0, -3.0, -4.0, -6.0, -8.0)
_EDGES = (0.0, 0.25, 0.5, 1.0, 1.5, 2.0)
_OF_NOTHING = 0.5  # of a category: what nobody named may be an action all the same
_SEARCHED = (
    ("edges", _EDGES, 1.0),
    ("nothing", _NOTHING, 0.1),  # where an action begins matters less than that it is seen
    ("evidence", _EVIDENCE, 1.0),
    ("edges", _EDGES, 1.0),
    ("nothing", _NOTHING, 0.1),
)
_MOST_WORK = 1_000_000  # moments times states that weights are tried on


def _choose_weights(sequence: SequenceModel, trials: Sequence[_Trial]) -> SequenceWeights:
    """The weights that label the takes of people left out best, one changed at a time."""
    best = sequence.weights
    if not trials:
        return best
    most = _MOST_WORK / trials[0].shares.shape[1]
    sizes = np.cumsum([len(one.shares) for one in trials])
    step = max(round(float(sizes[-1]) / most), 1)
    some = list(trials)[::step]
    for name, values, events in _SEARCHED:
        best = max(
            (replace(best, **{name: one}) for one in dict.fromkeys((getattr(best, name), *values))),
            key=lambda weights: _rate(replace(sequence, weights=weights), some, events),
        )
    return best


def _rate(sequence: SequenceModel, trials: Sequence[_Trial], events: float) -> float:
    """Mean share of right moments over the categories and nothing, and the F of the segments times ``events``."""
    n_states = len(sequence.log_lengths)
    right, total = np.zeros(n_states), np.zeros(n_states)
    matched = said = true = 0
    for trial in trials:
        runs = sequence.find_runs(trial.shares)
        answer = np.concatenate([np.full(run.stop - run.start, run.state) for run in runs])
        counted = trial.states >= 0
        total += np.bincount(trial.states[counted], minlength=n_states)
        right += np.bincount(trial.states[counted & (answer == trial.states)], minlength=n_states)
        # Segments where nothing happens are seen in the share of its moments; here they are not held against the model.
        acts = np.concatenate([[0], np.cumsum((trial.states >= 0) & (trial.states < n_states - 1))])
        actions = [
            run
            for run in runs
            if run.state < n_states - 1 and 2 * (acts[run.stop] - acts[run.start]) >= run.stop - run.start
        ]
        said, true = said + len(actions), true + len(trial.pieces)
        matched += sum(any(_is_same(run, piece) for run in actions) for piece in trial.pieces)
    counts = np.where(total > 0, np.append(np.ones(n_states - 1), _OF_NOTHING), 0.0)
    return float(counts @ (right / np.maximum(total, 1.0)) / max(counts.sum(), 1e-9)) + events * 2.0 * matched / max(
        said + true, 1
    )


def _is_same(one: Run, other: Run) -> bool:
    shared = min(one.stop, other.stop) - max(one.start, other.start)
    return one.state == other.state and 2 * shared >= max(one.stop, other.stop) - min(one.start, other.start)


def _calibrate(answers: Sequence[_Answer]) -> tuple[tuple[float, float, float], float]:
    """Weights of the log odds that an answer is right, and the confidence from which answering pays.

    An answer pays if its frames are more often right than they are of a category that is not known; of those a fold
    shows more than takes do.
    """
    if not answers:
        return _DEFAULT_CALIBRATION, _DEFAULT_THRESHOLD
    evidence = np.stack([one.evidence for one in answers])
    lengths, right, strange = (
        np.array([getattr(one, name) for one in answers]) for name in ("length", "right", "strange")
    )
    correct = right > 0.5
    if min(correct.sum(), (~correct).sum()) < _ENOUGH:
        return _DEFAULT_CALIBRATION, _DEFAULT_THRESHOLD
    offset, by_score, by_lead = fit_logistic(evidence, correct.astype(np.float64))
    sure = 1.0 / (1.0 + np.exp(-(evidence @ (by_score, by_lead) + offset)))
    order = np.argsort(-sure, kind="stable")
    gained = np.cumsum(((right - _STRANGERS * strange) * lengths)[order])
    best = int(gained.argmax())
    if gained[best] <= 0:
        return (offset, by_score, by_lead), 1.0
    # Half way to the next answer, which does not pay any more.
    following = sure[order[best + 1]] if best + 1 < len(order) else 0.0
    return (offset, by_score, by_lead), float(0.5 * (sure[order[best]] + following))


def fit_logistic(columns: FloatArray, truth: FloatArray) -> tuple[float, ...]:
    """Offset and weights of the log odds by Newton's method, with a small penalty on the weights.

    Parameters
    ----------
    columns : (N, K) evidence.
    truth : (N,) 0 to 1.
    """
    design = np.column_stack([np.ones(len(columns)), columns])
    penalty = np.diag([1e-6] + [1e-2] * columns.shape[1])
    weights = np.zeros(design.shape[1])
    for _ in range(50):
        guess = 1.0 / (1.0 + np.exp(-np.clip(design @ weights, -30, 30)))
        slope = design.T @ (truth - guess) - penalty @ weights
        curvature = (design * (guess * (1.0 - guess))[:, None]).T @ design + penalty
        step = np.linalg.solve(curvature, slope)
        # Where the evidence parts right from wrong, full steps run away.
        step *= min(1.0, 5.0 / max(float(np.abs(step).max()), 1e-12))
        weights += step
        if np.abs(step).max() < 1e-8:
            break
    return tuple(float(value) for value in weights)
