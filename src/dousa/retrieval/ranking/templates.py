"""Motion templates: the baseline for the random forest.

A template gives, frame by frame, the relational features that are always true, always false or vary in the motions of a
category. Source: Müller, Röder, "Motion templates for automatic classification and retrieval of motion capture data",
SCA 2006. Every training motion in turn is the reference to which the others are warped; frames weigh less where a
motion is stretched and are averaged where it is squeezed; the weighted mean is stretched back to frames of equal
weight. This repeats until nothing changes. Entries near 0 or 1 are then rounded; the others are grey and ignored.

Deviations: whole clips are compared instead of stretches of a recording, so diagonal steps weigh double and the sum is
divided by both lengths. In a large category only some motions serve as references (all are averaged).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Self

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from dousa.arrays import BoolArray, FloatArray, IndexArray
from dousa.errors import NotTrainedError, OptionError, TrainingError
from dousa.retrieval.features.posed_motion import PosedMotion
from dousa.retrieval.ranking.relational import RELATIONAL_FEATURES, compute_relational_features

_CHANGE_THAT_ENDS_LEARNING = 1e-3  # mean change of an entry in one round


def compute_relational_sequence(clip: PosedMotion, sampling_rate: float = 30.0) -> BoolArray:
    """Compute the (T', 39) features of a clip of canonical positions, resampled to a rate in Hz."""
    positions, rate = clip.positions, clip.frame_rate
    if not np.isclose(rate, sampling_rate):
        from dousa.motion import Trajectories, resample
        from dousa.motion.canonical.joints import CANONICAL_JOINTS

        positions = resample(Trajectories(CANONICAL_JOINTS, positions, rate), sampling_rate).positions
    return compute_relational_features(positions, sampling_rate, clip.height)


class MotionTemplates:
    """One template per category; a motion has the category of the nearest.

    Parameters
    ----------
    sampling_rate : Hz, of the compared motions.
    threshold : share of the training motions that may disagree about an entry that is not grey; 0 to below 0.5.
    n_iterations : greatest number of rounds of warping and averaging.
    max_references : motions of a category that serve as references.
    n_jobs : threads (joblib); None for one.

    Attributes
    ----------
    classes_ : (C,) the categories, sorted.
    templates_ : C arrays (K, 39) of int8: 0 never, 1 always, -1 grey.
    averages_ : C arrays (K, 39) before rounding: shares of the training motions.
    """

    def __init__(
        self,
        sampling_rate: float = 30.0,
        threshold: float = 0.1,
        n_iterations: int = 12,
        max_references: int = 10,
        n_jobs: int | None = None,
    ) -> None:
        self.sampling_rate = sampling_rate
        self.threshold = threshold
        self.n_iterations = n_iterations
        self.max_references = max_references
        self.n_jobs = n_jobs

    def fit(self, clips: Sequence[PosedMotion], categories: ArrayLike) -> Self:
        """Learn a template for every category from training motions and their labels (N,).

        TrainingError : no clips, or another number of labels. OptionError : a parameter outside its range.
        """
        self._check_parameters()
        return self.fit_sequences(self._sequences(clips), categories)

    def fit_sequences(self, sequences: Sequence[BoolArray], categories: ArrayLike) -> Self:
        """As ``fit``, for relational features (T, 39)."""
        self._check_parameters()
        labels = np.asarray(categories)
        if len(sequences) == 0 or labels.shape != (len(sequences),):
            raise TrainingError("templates.labels", clips=len(sequences), shape=labels.shape)
        self.classes_, numbers = np.unique(labels, return_inverse=True)
        groups = [
            [np.asarray(sequences[int(k)], dtype=np.float64) for k in np.flatnonzero(numbers == c)]
            for c in range(len(self.classes_))
        ]
        self.averages_ = _in_threads(
            _learn_average, [(group, self.n_iterations, self.max_references) for group in groups], self.n_jobs
        )
        self.templates_ = [_round_off(average, self.threshold) for average in self.averages_]
        self._weights, self._offsets, self._bounds = _cost_matrices(self.templates_)
        return self

    def distances(self, clips: Sequence[PosedMotion]) -> FloatArray:
        """Compute the (N, C) distances of clips to templates, from 0 (equal wherever not grey) to 1.

        NotTrainedError : before ``fit``.
        """
        return self.sequence_distances(self._sequences(clips))

    def sequence_distances(self, sequences: Sequence[BoolArray]) -> FloatArray:
        """As ``distances``, for relational features (T, 39)."""
        self._check_trained()
        rows = _in_threads(self._distances_of_one, [(sequence,) for sequence in sequences], self.n_jobs)
        return np.array(rows, dtype=np.float64).reshape(len(sequences), len(self.classes_))

    def predict(self, clips: Sequence[PosedMotion]) -> NDArray[Any]:
        """Return the category of the nearest template for every clip, (N,)."""
        return self.classes_of(self.distances(clips))

    def predict_sequences(self, sequences: Sequence[BoolArray]) -> NDArray[Any]:
        """As ``predict``, for relational features (T, 39)."""
        return self.classes_of(self.sequence_distances(sequences))

    def classes_of(self, distances: FloatArray) -> NDArray[Any]:
        """Return the category of the smallest distance in every row of (N, C)."""
        self._check_trained()
        found: NDArray[Any] = self.classes_[np.argmin(distances, axis=1)]
        return found

    def _distances_of_one(self, sequence: BoolArray) -> FloatArray:
        costs = self._weights @ np.asarray(sequence, dtype=np.float64).T
        costs += self._offsets[:, None]
        return warped_costs(costs, self._bounds)

    def _sequences(self, clips: Sequence[PosedMotion]) -> list[BoolArray]:
        return [compute_relational_sequence(clip, self.sampling_rate) for clip in clips]

    def _check_trained(self) -> None:
        if not hasattr(self, "classes_"):
            raise NotTrainedError("templates.not_trained")

    def _check_parameters(self) -> None:
        if not (np.isfinite(self.sampling_rate) and self.sampling_rate > 0):
            raise OptionError("templates.rate", found=self.sampling_rate)
        if not 0 <= self.threshold < 0.5:
            raise OptionError("templates.threshold", found=self.threshold)
        if self.n_iterations < 1 or self.max_references < 1:
            raise OptionError("templates.counts", iterations=self.n_iterations, references=self.max_references)


def _in_threads(function: Any, arguments: Sequence[tuple[Any, ...]], n_jobs: int | None) -> list[Any]:
    """Return ``function(*a)`` for every a, in threads, as the kernels release the interpreter's lock."""
    if n_jobs in (None, 1) or len(arguments) < 2:
        return [function(*a) for a in arguments]
    from joblib import Parallel, delayed

    found: list[Any] = Parallel(n_jobs=n_jobs, prefer="threads")(delayed(function)(*a) for a in arguments)
    return found


def _learn_average(motions: list[FloatArray], n_iterations: int, max_references: int) -> FloatArray:
    """Return the average (K, F) of motions (T_i, F) after warping them in time, before rounding."""
    if len(motions) == 1:
        return motions[0]
    by_length = np.argsort([len(motion) for motion in motions], kind="stable")
    chosen = np.linspace(0, len(motions) - 1, min(max_references, len(motions))).round().astype(int)
    references = [motions[by_length[k]] for k in chosen]
    current = motions
    for _ in range(n_iterations):
        merged = [_merge(reference, current)[0] for reference in references]
        stable = all(_agree(old, new) for old, new in zip(references, merged, strict=True))
        references = current = merged
        if stable:
            break
    # The rounds make the references similar; the motions choose among them.
    costs = [_merge(reference, motions)[1] / len(reference) for reference in references]
    found: FloatArray = references[int(np.argmin(costs))]
    return found


def _merge(reference: FloatArray, motions: Sequence[FloatArray]) -> tuple[FloatArray, float]:
    """Average the motions warped to the reference, at frames of equal weight; also return the cost of warping."""
    values = np.zeros_like(reference)
    weights = np.zeros(len(reference))
    cost = 0.0
    for motion in motions:
        cost += merge_along_path(reference, np.ascontiguousarray(motion.T), values, weights)
    return _equalise(values / weights[:, None], weights / len(motions)), cost


def _equalise(values: FloatArray, weights: FloatArray) -> FloatArray:
    """Stretch frames of weight above 1 and average those below: (K', F), K' the total weight.

    A frame of weight w fills a length w; a new frame is the mean over an equal part of the whole.
    """
    ends = np.concatenate([[0.0], np.cumsum(weights)])
    integral = np.vstack([np.zeros(values.shape[1]), np.cumsum(values * weights[:, None], axis=0)])
    count = max(round(float(ends[-1])), 1)
    cuts = np.linspace(0.0, ends[-1], count + 1)
    piece = np.clip(np.searchsorted(ends, cuts, side="right") - 1, 0, len(weights) - 1)
    at_cuts = integral[piece] + (cuts - ends[piece])[:, None] * values[piece]
    found: FloatArray = np.clip(np.diff(at_cuts, axis=0) * (count / ends[-1]), 0.0, 1.0)
    return found


def _agree(old: FloatArray, new: FloatArray) -> bool:
    return old.shape == new.shape and float(np.abs(old - new).mean()) <= _CHANGE_THAT_ENDS_LEARNING


def _round_off(average: FloatArray, threshold: float) -> NDArray[np.int8]:
    """Return 0 and 1 where the motions agree up to ``threshold``, -1 (grey) elsewhere."""
    # Room for rounding of weighted means.
    room = threshold + 1e-9
    return np.where(average <= room, 0, np.where(average >= 1.0 - room, 1, -1)).astype(np.int8)


def _cost_matrices(templates: Sequence[NDArray[np.int8]]) -> tuple[FloatArray, FloatArray, IndexArray]:
    """Return weights and offsets of the local costs ``weights @ X.T + offsets`` of a motion X (T, F); template bounds.

    The cost of a template frame is the share of its 0 and 1 entries that the motion contradicts, 0 if all are grey.
    """
    stacked = np.concatenate(templates)
    fixed = np.maximum((stacked >= 0).sum(axis=1), 1)
    weights = ((stacked == 0).astype(np.float64) - (stacked == 1)) / fixed[:, None]
    offsets = (stacked == 1).sum(axis=1) / fixed
    bounds = np.concatenate([[0], np.cumsum([len(template) for template in templates])]).astype(np.intp)
    assert weights.shape[1] == len(RELATIONAL_FEATURES)
    return weights, offsets, bounds


@njit(cache=True, nogil=True)
def _accumulate(reference: FloatArray, motion_by_feature: FloatArray) -> FloatArray:
    """Return the (K, L) cost of the best path to each pair of frames; local costs are Manhattan distances."""
    n_reference, n_features = reference.shape
    n_motion = motion_by_feature.shape[1]
    total = np.zeros((n_reference, n_motion))
    for i in range(n_reference):
        row = total[i]
        for f in range(n_features):
            here = reference[i, f]
            there = motion_by_feature[f]
            for j in range(n_motion):
                row[j] += abs(here - there[j])
        if i == 0:
            for j in range(1, n_motion):
                row[j] += row[j - 1]
        else:
            above = total[i - 1]
            row[0] += above[0]
            for j in range(1, n_motion):
                row[j] += min(above[j - 1], above[j], row[j - 1])
    return total


@njit(cache=True, nogil=True)
def merge_along_path(
    reference: FloatArray, motion_by_feature: FloatArray, values: FloatArray, weights: FloatArray
) -> float:
    """Warp a motion to a reference, add it to the sums of the reference, and return the cost of the best path.

    Parameters
    ----------
    reference : (K, F).
    motion_by_feature : (F, L), transposed for access in memory order.
    values : (K, F), increased by weight x motion frame for every pair on the best path.
    weights : (K,), increased by 1/n for each of the n reference frames of a motion frame, so by L in all.
    """
    total = _accumulate(reference, motion_by_feature)
    i = len(total) - 1
    for j in range(total.shape[1] - 1, -1, -1):
        last = i  # motion frame j has the reference frames i..last
        while i > 0 and (j == 0 or total[i - 1, j] < min(total[i, j - 1], total[i - 1, j - 1])):
            i -= 1
        share = 1.0 / (last - i + 1)
        for k in range(i, last + 1):
            weights[k] += share
            for f in range(reference.shape[1]):
                values[k, f] += share * motion_by_feature[f, j]
        if i > 0 and total[i - 1, j - 1] <= total[i, j - 1]:
            i -= 1
    found: float = total[-1, -1]
    return found


@njit(cache=True, nogil=True)
def warped_costs(costs: FloatArray, bounds: IndexArray) -> FloatArray:
    """Compute the (C,) costs of the best warping of a motion to each of several templates.

    ``costs`` (sum of template lengths, L) are local costs of template and motion frames, ``bounds`` (C + 1,) the starts
    of the templates there. Diagonal steps count twice, and the sum is divided by K + L.
    """
    n_motion = costs.shape[1]
    answer = np.empty(len(bounds) - 1)
    row = np.empty(n_motion)
    for c in range(len(bounds) - 1):
        start, stop = bounds[c], bounds[c + 1]
        row[0] = 2.0 * costs[start, 0]
        for j in range(1, n_motion):
            row[j] = row[j - 1] + costs[start, j]
        for i in range(start + 1, stop):
            diagonal = row[0]
            row[0] += costs[i, 0]
            for j in range(1, n_motion):
                cost = costs[i, j]
                best = min(diagonal + cost, row[j], row[j - 1]) + cost
                diagonal = row[j]
                row[j] = best
        answer[c] = row[n_motion - 1] / (stop - start + n_motion)
    return answer
