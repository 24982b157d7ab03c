"""Train labellers of takes: discriminants of moments, the sequence of segments, and the confidence of answers.

The material is annotated takes, and takes made of clips, as recorded and disturbed (`made_takes`). The discriminants
follow from sums over all moments. Penalty, sharpness, sequence weights and calibration are chosen on people left out
(or random groups of clips), with some categories set aside, by leaving parts out of the sums.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import FloatArray, IntArray
from dousa.errors import TrainingError
from dousa.messages import Count
from dousa.motion.runs import find_equal_runs
from dousa.retrieval.features.channels import count_samples, sample_positions
from dousa.retrieval.features.posed_motion import AnnotatedTake, LabelledClip, PosedMotion, check_motion
from dousa.retrieval.takes.label import SHORT_GAP, TakeLabeller
from dousa.retrieval.takes.labeller_tuning import STRANGE, UNCOUNTED, Trial, calibrate, calibrate_places, choose_weights
from dousa.retrieval.takes.made_takes import JoinedTake, Piece, disturb, join_clips, join_with_rests, shuffle_into_takes
from dousa.retrieval.takes.moment_model import (
    HOP,
    N_VALUES,
    Codes,
    MomentModel,
    Scale,
    choose_scale,
    count_moments,
    describe_moments,
    sharpen,
)
from dousa.retrieval.takes.moment_sums import MomentRows, MomentSums, sum_moments
from dousa.retrieval.takes.repetitions import count_part, find_phases
from dousa.retrieval.takes.sequence import FLOOR, N_PHASES, PHASE_FRAMES, Run, SequenceWeights, fit_lengths, join_phases
from dousa.retrieval.takes.windows import TAKE_RATE
from dousa.workers.threads import limit_blas, map_pieces


@limit_blas()
def train_labeller(
    clips: Sequence[LabelledClip],
    takes: Sequence[AnnotatedTake] = (),
    *,
    random_state: int = 0,
    n_jobs: int | None = None,
    progress: Count | None = None,
) -> TakeLabeller:
    """Train a labeller of takes.

    Parameters
    ----------
    clips : whole actions with categories, and performers if known.
    takes : annotated from beginning to end.
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
    n_steps = 4
    report(0, n_steps)
    material = _make_material(clips, takes, np.random.default_rng(seeds[0]))
    report(1, n_steps)
    scale, codes, shown = _describe(material, classes, n_jobs)
    report(2, n_steps)
    generator = np.random.default_rng(seeds[1])
    sequence = fit_lengths(_measure(material, classes), SequenceWeights())
    del material  # frees some hundred kilobytes per take
    model, trials = _learn_model(scale, codes, shown, len(classes), generator, n_jobs)
    report(3, n_steps)
    sequence = replace(sequence, weights=choose_weights(sequence, trials))
    answers = [answer for trial in trials for answer in trial.answer(sequence)]
    calibration, threshold = calibrate(answers)
    placing = calibrate_places(answers)
    held, states = _gather(shown, generator)
    phases = _learn_phases(clips, takes, classes)
    return TakeLabeller(classes, model, sequence, calibration, threshold, held, states, phases, placing)


def _learn_phases(
    clips: Sequence[LabelledClip],
    takes: Sequence[AnnotatedTake],
    classes: Sequence[str],
    least: int = 3,
    most: int = 12,
    of_all: int = 400,
) -> tuple[int, ...]:
    """Return how many cycles one repetition of each category is, from some of its clips and segments.

    These are ``least`` to ``most`` of a category, and ``of_all`` together.
    """
    shown: dict[str, list[tuple[FloatArray, float]]] = {name: [] for name in classes}
    for clip in clips:
        shown[clip.category].append((clip.positions, clip.frame_rate))
    for take in takes:
        for one in take.stretches:
            if one.category is not None:
                start, stop = (round(seconds * take.frame_rate) for seconds in (one.start, one.stop))
                shown[one.category].append((take.positions[start:stop], take.frame_rate))
    count = int(np.clip(of_all // max(len(shown), 1), least, most))
    few = [some[:: max(-(-len(some) // count), 1)] for some in shown.values()]
    return tuple(find_phases([count_part(sample_positions(part, rate)) for part, rate in some]) for some in few)


@dataclass(frozen=True, slots=True, eq=False)
class _Material:
    """A training take, its performer and its round (0: as recorded)."""

    take: JoinedTake
    performer: str
    number: int


def _make_material(
    clips: Sequence[LabelledClip],
    takes: Sequence[AnnotatedTake],
    generator: np.random.Generator,
    *,
    most_moments: int = 9_000,
    more_moments: int = 40,
    rounds: tuple[int, int] = (3, 5),
) -> list[_Material]:
    """Make the training takes of several rounds; of many clips, each round has a part.

    Parameters
    ----------
    clips, takes, generator : what is learned from.
    most_moments, more_moments : training moments, and more for each category.
    rounds : least and most: the first is as recorded, the others are disturbed.
    """
    real = [(_to_joined(take), take.performer or take.name) for take in takes]
    most = most_moments + more_moments * len({clip.category for clip in clips})
    per_round = sum(len(take.positions) for take, _ in real) / HOP
    per_round += sum(len(clip.positions) / clip.frame_rate for clip in clips) * TAKE_RATE / HOP
    n_rounds = int(np.clip(round(most / max(per_round, 1.0)), *rounds))
    share = min(1.0, most / max(per_round * n_rounds, 1.0))
    material: list[_Material] = []
    order = _take_turns([clip.category for clip in clips], generator)
    for number in range(n_rounds):
        # With few clips every round has all, with many the next ones.
        first, count = round(number * share * len(clips)), round(share * len(clips))
        part = [clips[k] for k in np.sort(np.roll(order, -first)[:count])]
        for group in shuffle_into_takes(part, generator) if part else ():
            some = [part[k] for k in _pair(group, [clip.category for clip in part], generator)]
            take = join_with_rests(some, generator) if number else join_clips(some, generator)
            material.append(_Material(take, some[0].performer or f"group {len(material)}", number))
        material += [_Material(take, performer, number) for take, performer in real]
    return [replace(one, take=disturb(one.take, generator)) if one.number else one for one in material]


def _take_turns(categories: Sequence[str], generator: np.random.Generator) -> NDArray[np.intp]:
    """Return a random order of clips: one of each category, then the second of each, and so on."""
    mixed = generator.permutation(len(categories))
    _, which = np.unique(np.array(categories, dtype=np.str_)[mixed], return_inverse=True)
    by_category = np.argsort(which, kind="stable")
    counts = np.bincount(which)
    turns = np.empty(len(mixed), np.int64)
    turns[by_category] = np.arange(len(mixed)) - np.repeat(np.cumsum(counts) - counts, counts)
    order: NDArray[np.intp] = mixed[np.argsort(turns, kind="stable")]
    return order


def _pair(
    group: Sequence[int], categories: Sequence[str], generator: np.random.Generator, chance: float = 0.3
) -> list[int]:
    """Order the clips of a take so that some follow one of their own category, to learn where one ends.

    ``chance`` is that of a clip of which there is one more.
    """
    rest, order = list(group), list[int]()
    while rest:
        same = [k for k in rest if order and categories[k] == categories[order[-1]]]
        chosen = same[0] if same and generator.random() < chance else rest[0]
        order.append(chosen)
        rest.remove(chosen)
    return order


def _to_joined(take: AnnotatedTake) -> JoinedTake:
    pieces = tuple(
        Piece(one.start * TAKE_RATE, one.stop * TAKE_RATE, one.category, one.counted) for one in take.stretches
    )
    return JoinedTake(sample_positions(check_motion(take), take.frame_rate), take.height, pieces)


@dataclass(frozen=True, slots=True, eq=False)
class _Shown:
    """The moments of a take: bytes (M, F), states (M,) as 3 c + phase, 3 C for nothing, performer, and pieces."""

    codes: Codes
    states: IntArray
    performer: str
    pieces: list[Run]


def _describe(
    material: Sequence[_Material],
    classes: Sequence[str],
    n_jobs: int | None,
    scaled_takes: int = 12,
    scaled_moments: int = 3,
) -> tuple[Scale, Codes, list[_Shown]]:
    """Return the scale, the moments of all takes in a row, and those of each take as views.

    Every so many moments (``scaled_moments``) of some ``scaled_takes`` set the scale.
    """

    def values_of(one: _Material) -> NDArray[np.float32]:
        sampled = sample_positions(one.take.positions, one.take.frame_rate)
        return np.concatenate([values for _, values in describe_moments(sampled, one.take.height)])

    every = max(len(material) // scaled_takes, 1)
    scale = choose_scale(np.concatenate([values_of(one) for one in material[::every]])[::scaled_moments])
    numbers = {name: number for number, name in enumerate(classes)}

    sizes = [count_moments(count_samples(len(one.take.positions), one.take.frame_rate)) for one in material]
    starts = np.cumsum([0, *sizes])
    codes = np.empty((starts[-1], N_VALUES), np.uint8)

    def show(place: int) -> _Shown:
        one, own = material[place], codes[starts[place] : starts[place + 1]]
        own[:] = scale.encode(values_of(one))
        states = _states_of(one.take, len(own), numbers)
        return _Shown(own, states, one.performer, _runs_of(one.take, len(own), numbers))

    return scale, codes, map_pieces(show, range(len(material)), n_jobs, at_a_time=1)


def _states_of(take: JoinedTake, n_moments: int, numbers: dict[str, int]) -> IntArray:
    states = np.full(n_moments, UNCOUNTED)
    middles = (np.arange(n_moments) + 0.5) * HOP
    for piece in take.pieces:
        inside = (middles >= piece.start) & (middles < piece.stop)
        if not piece.counted:
            states[inside] = UNCOUNTED
        elif piece.category is None:
            states[inside] = N_PHASES * len(numbers)
        else:
            edge = min(PHASE_FRAMES, 0.5 * (piece.stop - piece.start))
            phase = 1 - (middles[inside] < piece.start + edge) + (middles[inside] >= piece.stop - edge)
            states[inside] = N_PHASES * numbers[piece.category] + phase
    return states


def _gather(
    shown: Sequence[_Shown], generator: np.random.Generator, most: int = 600
) -> tuple[Codes, NDArray[np.int32]]:
    """Return (H, F) bytes and (H,) states of ``most`` moments, spread evenly over the states (docs/takes.md)."""
    places = [(k, m) for k, one in enumerate(shown) for m in np.flatnonzero(one.states >= 0)]
    order = _take_turns([str(shown[k].states[m]) for k, m in places], generator)
    chosen = [places[k] for k in order[:most]]
    codes = np.stack([shown[k].codes[m] for k, m in chosen])
    return codes, np.array([shown[k].states[m] for k, m in chosen], np.int32)


def _measure(material: Sequence[_Material], classes: Sequence[str]) -> list[list[float]]:
    lengths: dict[str | None, list[float]] = {name: [] for name in (*classes, None)}
    for one in material:
        for piece in one.take.pieces:
            if piece.counted:
                lengths[piece.category].append(piece.stop - piece.start)
    return [lengths[name] for name in (*classes, None)]


def _divide(shown: Sequence[_Shown], generator: np.random.Generator, n_folds: int = 3) -> list[set[str]]:
    """Return the people left out of each fold (docs/takes.md)."""
    names = sorted({one.performer for one in shown})
    mixed = generator.permutation(np.array(names))
    folds = [set(mixed[k::n_folds].tolist()) for k in range(n_folds)]
    return [fold for fold in folds if fold and len(fold) < len(names)]


@dataclass(frozen=True, slots=True, eq=False)
class _Fold:
    takes: list[_Shown]
    aside: IntArray
    sums: MomentSums | MomentRows


def _learn_model(
    scale: Scale,
    codes: Codes,
    shown: Sequence[_Shown],
    n_categories: int,
    generator: np.random.Generator,
    n_jobs: int | None,
    set_aside: float = 0.25,
    least_states: int = 3,
) -> tuple[MomentModel, list[Trial]]:
    """Return the discriminants of all moments, and trials of models without some people on the takes of these.

    A share ``set_aside`` of the categories is unknown to a fold (docs/takes.md), which has ``least_states`` states.
    """
    n_states = N_PHASES * n_categories + 1
    people = _divide(shown, generator)
    mixed, count = generator.permutation(n_categories), round(set_aside * n_categories)
    asides = [mixed[k * count : (k + 1) * count] for k in range(len(people))]
    states = np.concatenate([one.states for one in shown])
    weigh = _weigh(states[states >= 0], n_states)
    # Bits of the folds that lack a moment; moments with the same bits share one sum.
    out = np.zeros(len(states), np.int64)
    for k, (some, aside) in enumerate(zip(people, asides, strict=True)):
        theirs = np.repeat([one.performer in some for one in shown], [len(one.states) for one in shown])
        out |= (theirs | np.isin(states // N_PHASES, aside)).astype(np.int64) << k
    out[states < 0] = -1
    total, *sums = _sum_folds(scale, codes, states, weigh, out, len(people), n_jobs)
    folds = [
        _Fold([one for one in shown if one.performer in people[k]], asides[k], own)
        for k, own in enumerate(sums)
        if (own.weights[::N_PHASES] > 0).sum() >= least_states
    ]
    ridge, sharpness, fold_scores = _choose_penalty(scale, folds, weigh)
    trials = [
        one
        for fold, scores in zip(folds, fold_scores, strict=True)
        for one in _try_fold(fold, scores, sharpness, n_categories)
    ]
    return MomentModel(scale, total.solve(ridge), sharpness), trials


def _sum_folds(
    scale: Scale, codes: Codes, states: IntArray, weigh: FloatArray, out: IntArray, n_folds: int, n_jobs: int | None
) -> Sequence[MomentSums | MomentRows]:
    """Return the sums over all moments, then those of each fold, which lacks the moments with its bit in ``out``.

    Moments with ``out`` below 0 are in none.
    """
    there = np.flatnonzero(out >= 0)
    if len(there) < codes.shape[1]:
        every = MomentRows.create(scale, codes[there], states[there], weigh)
        return [every, *(every.take(np.flatnonzero(out[there] >> k & 1 == 0)) for k in range(n_folds))]

    def add_up(pattern: int) -> MomentSums:
        return sum_moments(scale, codes, np.flatnonzero(out == pattern), states, weigh)

    sums = [MomentSums.zero(codes.shape[1], len(weigh)) for _ in range(n_folds + 1)]
    patterns = np.unique(out[there]).tolist()
    for pattern, part in zip(patterns, map_pieces(add_up, patterns, n_jobs, at_a_time=1), strict=True):
        for k, own in enumerate(sums):  # of all moments, then of the folds
            if k == 0 or not pattern >> (k - 1) & 1:
                own.add(part)
    return sums


def _choose_penalty(
    scale: Scale,
    folds: Sequence[_Fold],
    weigh: FloatArray,
    ridges: tuple[float, ...] = (0.1, 0.4, 1.6, 6.4),
    sharpnesses: tuple[float, ...] = (3.0, 4.5, 6.5, 9.0, 13.0, 19.0, 28.0),
    defaults: tuple[float, float] = (0.4, 6.5),
) -> tuple[float, float, list[NDArray[np.float32]]]:
    """Return the penalty and sharpness best for people left out, and the discriminants of their moments.

    The search for the penalty among ``ridges`` begins at the first of the ``defaults``, which are used without folds.
    """
    if not folds:
        return *defaults, []
    states = [np.concatenate([one.states for one in fold.takes]) for fold in folds]
    rows = [
        np.flatnonzero((some >= 0) & ~np.isin(some // N_PHASES, fold.aside))
        for fold, some in zip(folds, states, strict=True)
    ]

    def score(ridge: float, k: int) -> NDArray[np.float32]:
        discriminants = folds[k].sums.solve(ridge)
        return np.concatenate([scale.standardise(one.codes) @ discriminants for one in folds[k].takes])

    def rate(found: Sequence[NDArray[np.float32]], sharpness: float) -> float:
        return sum(
            _rate(scores[some], of[some], sharpness, weigh)
            for scores, of, some in zip(found, states, rows, strict=False)
        )

    # The first fold chooses the penalty, all choose the sharpness.
    values: dict[float, float] = {}
    first: dict[float, NDArray[np.float32]] = {}
    place = ridges.index(defaults[0])
    step = -1
    while True:
        for at in (place, place + step):
            if 0 <= at < len(ridges) and ridges[at] not in values:
                first[ridges[at]] = score(ridges[at], 0)
                values[ridges[at]] = max(rate([first[ridges[at]]], one) for one in sharpnesses)
        best = max(values, key=lambda one: values[one])
        if best == ridges[place]:
            if step > 0 or len(values) > 2:
                break
            step = 1
        else:
            place = ridges.index(best)
    found = [first[best], *(score(best, k) for k in range(1, len(folds)))]
    return best, max(sharpnesses, key=lambda one: rate(found, one)), found


def _rate(scores: NDArray[np.float32], states: IntArray, sharpness: float, weigh: FloatArray) -> float:
    """Return the weighted log likelihood of the true states of moments."""
    joined = join_phases(sharpen(scores, sharpness))
    right = joined[np.arange(len(states)), states // N_PHASES]
    return float((np.log(right + FLOOR) * weigh[states]).sum())


def _try_fold(fold: _Fold, scores: NDArray[np.float32], sharpness: float, n_categories: int) -> list[Trial]:
    trials, first = [], 0
    for one in fold.takes:
        own = scores[first : first + len(one.codes)]
        first += len(own)
        states = np.where(one.states < 0, one.states, one.states // N_PHASES)
        strange = _forgive(np.where(np.isin(states, fold.aside), STRANGE, states), n_categories)
        known = [piece for piece in one.pieces if piece.state not in fold.aside]
        others = [piece for piece in one.pieces if piece.state in fold.aside]
        trials.append(Trial(sharpen(own, sharpness), strange, known, others))
    return trials


def _runs_of(take: JoinedTake, n_moments: int, numbers: dict[str, int]) -> list[Run]:
    runs = []
    for piece in take.pieces:
        start, stop = round(piece.start / HOP), min(round(piece.stop / HOP), n_moments)
        if piece.counted and piece.category is not None and stop > start:
            runs.append(Run(start, stop, numbers[piece.category]))
    return runs


def _weigh(states: IntArray, n_states: int) -> FloatArray:
    weights: FloatArray = 1.0 / np.sqrt(np.maximum(np.bincount(states, minlength=n_states), 1.0))
    weights *= len(states) / weights[states].sum()
    return weights


def _forgive(states: IntArray, nothing: int) -> IntArray:
    """Leave short gaps between two actions uncounted, as they are divided among these."""
    forgiven = states.copy()
    for start, stop in find_equal_runs(states):
        if states[start] == nothing and (stop - start) * HOP <= SHORT_GAP + HOP:
            forgiven[start:stop] = UNCOUNTED
    return forgiven


@dataclass(frozen=True, slots=True, eq=False)
class Example:
    """A ``motion``, part of a recording, that shows one ``category``."""

    motion: PosedMotion
    category: str


def teach_labeller(
    labeller: TakeLabeller,
    examples: Sequence[Example],
    *,
    ridge: float = 0.2,
    most_moments: int = 1500,
    least_moments: int = 3,
    n_copies: int = 5,
) -> TakeLabeller:
    """Add examples of known or new categories to a labeller that was not taught before; new categories come last.

    The calibration stays.

    Parameters
    ----------
    labeller, examples : what is taught what.
    ridge : how far an example yields to other examples and held moments, relative to its likeness to itself, 1.
    most_moments : of all examples together.
    least_moments : of an example; shorter ones, under half a second, are ignored.
    n_copies : disturbed copies of an example.

    Raises
    ------
    InvalidMotionError : another shape than (n, 20, 3), positions that are not finite, no body height.
    """
    most = max(most_moments // max(len(examples) * (n_copies + 1), 1), least_moments)
    shown = [(codes, one.category) for one in examples for codes in _describe_example(labeller, one.motion, n_copies)]
    shown = [(codes, name) for codes, name in shown if len(codes) >= least_moments]
    if not shown:
        return labeller
    new = sorted({name for _, name in shown} - set(labeller.classes))
    classes = (*labeller.classes, *new)
    parts = [np.unique(np.linspace(0, len(codes) - 1, most).astype(np.int64)) for codes, _ in shown]
    states = np.concatenate(
        [_count_phases(len(codes), classes.index(name))[part] for (codes, name), part in zip(shown, parts, strict=True)]
    )
    taught = {classes.index(name) for _, name in shown}
    held = labeller.held[[state // N_PHASES not in taught for state in labeller.held_states.tolist()]]
    scale, weights = labeller.model.scale, labeller.model.weights
    wider = np.insert(weights, [weights.shape[1] - 1] * (N_PHASES * len(new)), 0.0, axis=1)
    model = replace(labeller.model, weights=wider)
    own = scale.standardise(np.concatenate([codes[part] for (codes, _), part in zip(shown, parts, strict=True)]))
    seen = np.concatenate([scale.standardise(held), own])
    missing = np.zeros((len(seen), model.weights.shape[1]), np.float32)
    missing[len(held) :] = _find_missing(own @ model.weights, states)
    likeness = seen @ seen.T / seen.shape[1]
    likeness[np.diag_indices(len(seen))] += np.float32(ridge)
    added = seen.T @ np.linalg.solve(likeness, missing) * np.float32(1.0 / seen.shape[1])
    lengths = [[float(len(codes) * HOP) for codes, name in shown if name == one] for one in new]
    sequence = labeller.sequence.with_lengths(lengths) if new else labeller.sequence
    model = replace(model, weights=model.weights + added)
    return replace(labeller, classes=classes, sequence=sequence, model=model)


def _describe_example(labeller: TakeLabeller, motion: PosedMotion, n_copies: int) -> list[Codes]:
    """Return (M, F) bytes of the moments of a part, and of disturbed copies for other performers."""
    generator = np.random.default_rng(0)
    part = JoinedTake(sample_positions(check_motion(motion), motion.frame_rate), motion.height, ())
    copies = [part, *(disturb(part, generator) for _ in range(n_copies if len(part.positions) > HOP else 0))]
    described = []
    for copy in copies:
        sampled = sample_positions(copy.positions, copy.frame_rate)
        codes = [labeller.model.scale.encode(values) for _, values in describe_moments(sampled, copy.height)]
        described.append(np.concatenate(codes))
    return described


def _count_phases(n_moments: int, category: int) -> IntArray:
    edge = min(PHASE_FRAMES / HOP, 0.5 * n_moments)
    middles = np.arange(n_moments) + 0.5
    phase: IntArray = N_PHASES * category + 1 - (middles < edge) + (middles >= n_moments - edge)
    return phase


def _find_missing(said: NDArray[np.float32], states: IntArray) -> NDArray[np.float32]:
    """Return (K, S) corrections of discriminants (K, S): own state to 1 above its value or 0, other categories to 0."""
    missing = -said
    # Another phase of the own category is no mistake.
    own = states[:, None] // N_PHASES * N_PHASES + np.arange(N_PHASES)
    np.put_along_axis(missing, own, 0.0, axis=1)
    rows = np.arange(len(states))
    missing[rows, states] = 1.0 - np.minimum(said[rows, states], 0.0)
    return missing
