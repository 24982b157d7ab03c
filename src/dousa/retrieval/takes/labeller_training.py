"""Learn to label takes: weights of the leaves, how sure an answer is, and from when on it is said.

The leaf weights are fitted on takes joined from the clips that trained the forest. How sure an answer is cannot be seen
on those: they are known by heart. So the clips are divided by performers (by chance where those are not known), some
categories are set aside too, a smaller forest is learned from the rest, and the takes joined from what was left
out say how often an answer with this score is right, and what is gained by not answering.

What a person corrects in a take is learned from single examples, at once. A labeller is fitted on thousands of windows;
one more clip among them says next to nothing. So an example corrects what the labeller would have said of its windows:
the differences are spread over the leaves that the windows reach, such that windows of the examples come out right, and
other windows change as far as they share leaves with them (ridge regression of the residuals, the number of shared
leaves as kernel). Clips of other categories are held fast: what is said of them must not change.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import FloatArray, IndexArray, IntArray
from dousa.errors import TrainingError
from dousa.retrieval.features.posed_motion import LabelledClip
from dousa.retrieval.forest.trees import Trees
from dousa.retrieval.takes.label import TakeLabeller, choose_segments, describe_scores
from dousa.retrieval.takes.leaf_weights import (
    JoinedTake,
    LeafWeights,
    Piece,
    covered_pieces,
    fit_leaf_weights,
    join_clips,
    shuffle_into_takes,
)
from dousa.retrieval.takes.windows import TakeWindows, WindowGrid, choose_grid, describe_take, place_windows

if TYPE_CHECKING:
    from dousa.retrieval.features.feature_sets import FeatureSet
    from dousa.retrieval.forest.forest import MotionForest

Progress = Callable[[int, int], None]

_LEAST, _MOST = 0.6, 1.6  # lengths of windows, as shares of the shortest and longest clip
_MOST_WINDOWS = 30_000  # that the leaf weights are fitted on; half as many in a fold
_TEMPO = 0.35  # spread of the log tempo of the pieces of every second take
_FOLDS = 4
_SET_ASIDE = 0.25  # share of the categories that a fold does not know
_ENOUGH = 8  # answers, right and wrong ones each, that a calibration needs
_DEFAULT_CALIBRATION = (4.0, 2.0, 2.0)
_DEFAULT_THRESHOLD = 0.5


def train_labeller(
    forest: MotionForest,
    feature_set: FeatureSet,
    clips: Sequence[LabelledClip],
    *,
    features: FloatArray | None = None,
    random_state: int = 0,
    n_jobs: int | None = None,
    progress: Progress | None = None,
) -> TakeLabeller:
    """Learn to label takes with a trained forest.

    Parameters
    ----------
    forest : trained on ``clips``.
    feature_set : that it was trained on.
    clips : with categories; performers where they are known.
    features : (N, T, F) of the clips, if they are computed already.
    random_state : seed; the same seed gives the same labeller.
    n_jobs : threads; None for one. The result does not depend on it.
    progress : called with the steps done and their number.

    Raises
    ------
    TrainingError : no clips, or a category that the forest does not know.
    NotTrainedError : the forest knows nothing yet.
    """
    classes = tuple(str(name) for name in forest.classes_)
    strange = sorted({clip.category for clip in clips} - set(classes))
    if not clips or strange:
        raise TrainingError("labeller.other_clips", clips=len(clips), strange=strange[:3])
    grid = choose_grid([len(clip.positions) / clip.frame_rate for clip in clips], _LEAST, _MOST)
    tools = _Tools(feature_set, grid, n_jobs, _MOST_WINDOWS)
    seeds = np.random.SeedSequence(random_state).spawn(_FOLDS + 1)
    weights = tools.fit(forest, clips, np.random.default_rng(seeds[0]))
    known = features if features is not None else np.stack([feature_set.compute(clip) for clip in clips])
    folds = _divide(clips, np.random.default_rng(random_state))
    answers: list[_Answers] = []
    tools = replace(tools, most_windows=_MOST_WINDOWS // 2)
    for number, fold in enumerate(folds):
        if progress is not None:
            progress(number + 1, len(folds) + 1)
        answers += _try_fold(tools, forest, clips, known, fold, np.random.default_rng(seeds[number + 1]))
    calibration, threshold = _calibrate(answers)
    return TakeLabeller(classes, weights, grid, calibration, threshold, len(forest.trees_.roots))


@dataclass(frozen=True, slots=True)
class _Tools:
    """What the forest of each fold is used with."""

    feature_set: FeatureSet
    grid: WindowGrid
    n_jobs: int | None
    most_windows: int

    def describe(self, forest: MotionForest, take: JoinedTake) -> TakeWindows:
        return describe_take(forest, self.feature_set, take, self.grid, n_jobs=self.n_jobs)

    def fit(self, forest: MotionForest, clips: Sequence[LabelledClip], generator: np.random.Generator) -> LeafWeights:
        """Leaf weights from takes joined of the clips: once as recorded, once with other tempos."""
        from dousa.retrieval.features.feature_sets import compute_track

        numbers = {str(name): number for number, name in enumerate(forest.classes_)}
        takes = list(_join_all(clips, generator))
        placed = [place_windows(self.grid, len(take.positions)) for take in takes]
        share = self.most_windows / max(sum(len(starts) for starts, _ in placed), 1)
        leaves, categories, overlaps = [], [], []
        for take, (starts, stops) in zip(takes, placed, strict=True):
            some = np.flatnonzero(generator.random(len(starts)) < share)
            if not len(some):
                continue
            best, overlap = covered_pieces(starts[some], stops[some], take.pieces)
            track = compute_track(take, self.feature_set)
            leaves.append(forest.apply_windows(track, starts[some], stops[some]).astype(np.int32))
            categories.append(np.array([numbers[piece.category] for piece in take.pieces])[best])
            overlaps.append(overlap)
        n_leaves, count = forest.trees_.n_leaves, len(numbers)
        if not leaves:
            return LeafWeights(np.zeros((n_leaves, count), np.float32), np.zeros(count, np.float32))
        best, covered = np.concatenate(categories), np.concatenate(overlaps)
        return fit_leaf_weights(np.concatenate(leaves), best, covered, n_leaves, count)


def _join_all(clips: Sequence[LabelledClip], generator: np.random.Generator) -> Iterator[JoinedTake]:
    """Takes of all clips: once as recorded, once with other tempos."""
    for spread in (0.0, _TEMPO):
        for group in shuffle_into_takes(clips, generator):
            tempos = np.exp(generator.uniform(-spread, spread, len(group))).tolist()
            yield join_clips([clips[k] for k in group], generator, tempos=tempos)


def _divide(clips: Sequence[LabelledClip], generator: np.random.Generator) -> list[IndexArray]:
    """Clips that are left out together: whole performers where all are known, else by chance."""
    performers = [clip.performer for clip in clips]
    names = sorted({name for name in performers if name})
    if len(names) >= 2 and all(performers):
        group = {name: k % _FOLDS for k, name in enumerate(generator.permutation(names))}
        numbers = np.array([group[str(name)] for name in performers])
    else:
        numbers = generator.permutation(len(clips)) % _FOLDS
    folds = [np.flatnonzero(numbers == k) for k in range(_FOLDS)]
    return [fold for fold in folds if 0 < len(fold) < len(clips)]


@dataclass(frozen=True, slots=True)
class _Answers:
    """Chosen windows of a take that was not seen: their evidence, frames of the take and whether each is right."""

    evidence: FloatArray  # (K, 2)
    lengths: FloatArray  # (K,) frames
    right: FloatArray  # (K,) share of those frames that have this category
    known: FloatArray  # (K,) share that has any known category


def _try_fold(
    tools: _Tools,
    forest: MotionForest,
    clips: Sequence[LabelledClip],
    features: FloatArray,
    fold: IndexArray,
    generator: np.random.Generator,
) -> list[_Answers]:
    """Learn without some performers and some categories, and label takes of those performers."""
    from dousa.retrieval.forest.forest import MotionForest as Forest

    names = np.array(sorted({clip.category for clip in clips}))
    aside = set(generator.permutation(names)[: round(_SET_ASIDE * len(names))].tolist())
    left = np.setdiff1d(np.arange(len(clips)), fold)
    train = [k for k in left if clips[k].category not in aside]
    labels = [clips[k].category for k in train]
    if len(set(labels)) < 2:
        return []
    smaller = Forest().set_params(**forest.get_params()).set_params(random_state=0)
    smaller.fit(features[train], labels, feature_set=tools.feature_set)
    weights = tools.fit(smaller, [clips[k] for k in train], generator)
    unseen = [clips[k] for k in fold]
    answers = []
    for group in shuffle_into_takes(unseen, generator):
        take = join_clips([unseen[k] for k in group], generator)
        windows = tools.describe(smaller, take)
        scores = weights.score(windows.leaves)
        chosen = choose_segments(windows.starts, windows.stops, scores, windows.n_frames)
        if chosen:
            said = [str(smaller.classes_[one.category]) for one in chosen]
            spans = [(one.start, one.stop) for one in chosen]
            evidence = describe_scores(scores[[one.row for one in chosen]])
            known = {str(name) for name in smaller.classes_}
            answers.append(_judge(evidence, spans, said, take.pieces, known))
    return answers


def _judge(
    evidence: FloatArray,
    spans: Sequence[tuple[int, int]],
    said: Sequence[str],
    pieces: Sequence[Piece],
    known: set[str],
) -> _Answers:
    right, familiar = [], []
    for (start, stop), category in zip(spans, said, strict=True):
        shared = [max(min(stop, p.stop) - max(start, p.start), 0.0) / (stop - start) for p in pieces]
        right.append(sum(s for s, p in zip(shared, pieces, strict=True) if p.category == category))
        familiar.append(sum(s for s, p in zip(shared, pieces, strict=True) if p.category in known))
    lengths = np.array([stop - start for start, stop in spans], np.float64)
    return _Answers(evidence, lengths, np.array(right), np.array(familiar))


def _calibrate(answers: Sequence[_Answers]) -> tuple[tuple[float, float, float], float]:
    """Weights of the log odds that an answer is right, and the confidence from which answering pays.

    An answer pays if its frames are more often right than they are of no known category.
    """
    if not answers:
        return _DEFAULT_CALIBRATION, _DEFAULT_THRESHOLD
    evidence, lengths, right, known = (
        np.concatenate([getattr(one, name) for one in answers]) for name in ("evidence", "lengths", "right", "known")
    )
    correct = right > 0.5
    if min(correct.sum(), (~correct).sum()) < _ENOUGH:
        return _DEFAULT_CALIBRATION, _DEFAULT_THRESHOLD
    offset, by_score, by_lead = fit_logistic(evidence, correct.astype(np.float64))
    sure = 1.0 / (1.0 + np.exp(-(evidence @ (by_score, by_lead) + offset)))
    order = np.argsort(-sure, kind="stable")
    gained = np.cumsum(((right - (1.0 - known)) * lengths)[order])
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


_RIDGE = 20.0  # beside the number of trees: how far an example gives way to others and to the clips that are held

_MOST_TAUGHT = 1500  # of all examples together

_MOST_OF_ONE = 120
_NOTHING = 0.3  # share of the example up to which a window counts as not covering it, as in the learning


@dataclass(frozen=True, slots=True, eq=False)
class Example:
    """A part of a recording that shows one category.

    Parameters
    ----------
    windows : of the part alone, of the labeller's forest.
    category : what it shows.
    """

    windows: TakeWindows
    category: str


def teach_labeller(
    labeller: TakeLabeller, examples: Sequence[Example], held: NDArray[Any] | None = None
) -> TakeLabeller:
    """A labeller that knows examples too.

    Parameters
    ----------
    labeller : learned with the forest that described the examples.
    examples : of categories old or new. One that is shorter than every window of the labeller teaches nothing.
    held : (H, n_trees) leaves of clips of other categories; what is said of them changes as little as can be.

    Returns
    -------
    A new labeller with the same calibration; new categories come last.

    Raises
    ------
    InvalidMotionError : windows of another forest.
    """
    classes = [*labeller.classes, *dict.fromkeys(one.category for one in examples)]
    classes = list(dict.fromkeys(classes))
    wider = _with_classes(labeller, classes)
    most = max(_MOST_TAUGHT // max(len(examples), 1), 8)
    chosen = [_choose_windows(one.windows, wider, min(most, _MOST_OF_ONE)) for one in examples]
    if not any(len(leaves) for leaves, _ in chosen):
        return labeller
    n_held = 0 if held is None else len(held)
    residuals = [np.zeros((n_held, len(classes)), np.float32)]
    for (leaves, covered), one in zip(chosen, examples, strict=True):
        scores = wider.score(leaves)
        wanted = np.minimum(scores, 0.0)  # it is none of the others
        own = classes.index(one.category)
        # A short window of a long walk looks like a whole walk of somebody else: nothing is taken from the category.
        wanted[:, own] = np.maximum(covered, scores[:, own])
        residuals.append(wanted - scores)
    weights = wider.leaf_weights.weights.copy()
    reached = [*([] if held is None else [held.astype(np.int32)]), *(leaves for leaves, _ in chosen)]
    spread_corrections(weights, np.concatenate(reached), np.concatenate(residuals))
    return replace(wider, leaf_weights=LeafWeights(weights, wider.leaf_weights.offset))


def _with_classes(labeller: TakeLabeller, classes: Sequence[str]) -> TakeLabeller:
    """The labeller with categories at its end that no leaf speaks for."""
    known = labeller.leaf_weights
    n_new = len(classes) - len(labeller.classes)
    weights = np.concatenate([known.weights, np.zeros((len(known.weights), n_new), np.float32)], axis=1)
    offset = np.concatenate([known.offset, np.full(n_new, known.offset.min(), np.float32)])
    return replace(labeller, classes=tuple(classes), leaf_weights=LeafWeights(np.ascontiguousarray(weights), offset))


def _choose_windows(
    windows: TakeWindows, labeller: TakeLabeller, most: int
) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """Leaves (W, n_trees) of some windows of an example, and how well each covers it, 0 to 1."""
    rows = windows.rows_within(labeller.grid)
    lengths = (windows.stops[rows] - windows.starts[rows]).astype(np.float64)
    shares = lengths / lengths.max(initial=1.0)  # of an example that is longer than all windows, the longest are right
    covered = np.maximum(shares - _NOTHING, 0.0) / (1.0 - _NOTHING)
    order = np.argsort(-shares, kind="stable")
    best, rest = order[: most // 2], order[most // 2 :]
    if len(rest) > most - len(best):
        rest = rest[np.linspace(0, len(rest) - 1, most - len(best)).astype(np.int64)]
    chosen = np.concatenate([best, rest])
    return windows.leaves[rows][chosen].astype(np.int32), covered[chosen].astype(np.float32)


def spread_corrections(weights: NDArray[np.float32], leaves: NDArray[np.int32], residuals: NDArray[np.float32]) -> None:
    """Add what is missing (W, C) to the leaves (W, n_trees) of windows."""
    from dousa.retrieval.takes.window_kernels import compare_leaves, spread_to_leaves

    n_windows, n_trees = leaves.shape
    shared = np.empty((n_windows, n_windows))
    for window, row in enumerate(leaves):
        compare_leaves(leaves, row, shared[window])
    shared = np.rint(shared * n_trees)
    shared[np.diag_indices(n_windows)] += _RIDGE
    missing = np.zeros(weights.shape)
    spread_to_leaves(leaves, np.linalg.solve(shared, residuals.astype(np.float64)), missing)
    weights += missing.astype(np.float32)


def carry_labeller(labeller: TakeLabeller, before: Trees, after: Trees) -> TakeLabeller:
    """The labeller of a forest for what the forest has grown into; a new leaf says what the old one said.

    Parameters
    ----------
    labeller : of the trees before.
    before, after : the trees; those after are grown out of those before (`dousa.retrieval.forest.growth`).

    Returns
    -------
    A labeller of the same categories: those that the forest has learned since must be taught.
    """
    known = labeller.leaf_weights
    weights = known.weights[_find_origins(before, after)]
    return replace(labeller, leaf_weights=LeafWeights(np.ascontiguousarray(weights), known.offset))


def _find_origins(before: Trees, after: Trees) -> IntArray:
    """(L,) the leaf of the trees before that each leaf of the trees after has grown out of."""
    origins = np.zeros(after.n_leaves, np.int64)
    old, new = before.roots.astype(np.int64), after.roots.astype(np.int64)
    leaf = np.full(len(old), -1, np.int64)  # of the old tree, once it is reached
    while len(new):
        children = before.nodes[old, 2]
        leaf = np.where((leaf < 0) & (children < 0), -1 - children, leaf)
        below = after.nodes[new, 2]
        ended = below < 0
        origins[-1 - below[ended]] = leaf[ended]
        goes = ~ended
        step = np.where(leaf[goes] < 0, children[goes], old[goes])
        inside = (leaf[goes] < 0).astype(np.int64)
        old = np.concatenate([step, step + inside])  # within a leaf of the old tree there is nowhere to go
        new = np.concatenate([below[goes], below[goes] + 1]).astype(np.int64)
        leaf = np.concatenate([leaf[goes], leaf[goes]])
    return origins
