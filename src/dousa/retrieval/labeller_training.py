"""Learn to label takes: weights of the leaves, how sure an answer is, and from when on it is said.

The leaf weights are fitted on takes joined from the clips that trained the forest. How sure an answer is cannot be seen
on those: they are known by heart. So the clips are divided by performers (by chance where those are not known), some
categories are set aside too, a smaller forest is learned from the rest, and the takes joined from what was left
out say how often an answer with this score is right, and what is gained by not answering.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dousa.errors import TrainingError
from dousa.retrieval._experiment_result import LabelledClip
from dousa.retrieval._joined_takes import JoinedTake, Piece, join_clips, shuffle_into_takes
from dousa.retrieval._leaf_weights import LeafWeights, covered_pieces, fit_leaf_weights
from dousa.retrieval.labelling import TakeLabeller, choose_segments, describe_scores
from dousa.retrieval.takes import TakeWindows, WindowGrid, choose_grid, describe_take, place_windows

if TYPE_CHECKING:
    from dousa.retrieval.feature_sets import FeatureSet
    from dousa.retrieval.forest import MotionForest

__all__ = ["train_labeller"]

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
    features: NDArray[np.float64] | None = None,
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
        raise TrainingError(
            f"expected the clips that trained the forest, got {len(clips)} with unknown categories {strange[:3]}"
        )
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

    def fit(
        self, forest: MotionForest, clips: Sequence[LabelledClip], generator: np.random.Generator
    ) -> LeafWeights:
        """Leaf weights from takes joined of the clips: once as recorded, once with other tempos."""
        from dousa.retrieval.tracks import compute_track

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
        if not leaves:
            return LeafWeights(
                np.zeros((forest.trees_.n_leaves, len(numbers)), np.float32),
                np.zeros(len(numbers), np.float32),
            )
        return fit_leaf_weights(
            np.concatenate(leaves),
            np.concatenate(categories),
            np.concatenate(overlaps),
            forest.trees_.n_leaves,
            len(numbers),
        )


def _join_all(clips: Sequence[LabelledClip], generator: np.random.Generator) -> Iterator[JoinedTake]:
    """Takes of all clips: once as recorded, once with other tempos."""
    for spread in (0.0, _TEMPO):
        for group in shuffle_into_takes(clips, generator):
            tempos = np.exp(generator.uniform(-spread, spread, len(group))).tolist()
            yield join_clips([clips[k] for k in group], generator, tempos=tempos)


def _divide(clips: Sequence[LabelledClip], generator: np.random.Generator) -> list[NDArray[np.intp]]:
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

    evidence: NDArray[np.float64]  # (K, 2)
    lengths: NDArray[np.float64]  # (K,) frames
    right: NDArray[np.float64]  # (K,) share of those frames that have this category
    known: NDArray[np.float64]  # (K,) share that has any known category


def _try_fold(
    tools: _Tools,
    forest: MotionForest,
    clips: Sequence[LabelledClip],
    features: NDArray[np.float64],
    fold: NDArray[np.intp],
    generator: np.random.Generator,
) -> list[_Answers]:
    """Learn without some performers and some categories, and label takes of those performers."""
    from dousa.retrieval.forest import MotionForest as Forest

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
    evidence: NDArray[np.float64],
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
    evidence = np.concatenate([one.evidence for one in answers])
    right = np.concatenate([one.right for one in answers])
    known = np.concatenate([one.known for one in answers])
    lengths = np.concatenate([one.lengths for one in answers])
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


def fit_logistic(columns: NDArray[np.float64], truth: NDArray[np.float64]) -> tuple[float, ...]:
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
