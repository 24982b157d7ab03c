"""Scores of predicted categories and of labelled takes.

**Categories.** Where a category leaves a score undefined:

- Averages are macro averages over the categories of the truth: each counts the same, however many clips it
  has. A category that was only ever predicted lowers the recall of those it was mistaken for, nothing else.
- A category that was never predicted has precision 0; its F-measure is 0.
- F-measure is computed per category, then averaged.
- Nothing to score gives 0 everywhere.

These are scikit-learn's ``precision_recall_fscore_support(truth, predicted, labels=unique(truth),
average="macro", zero_division=0)``.

**Timelines.** Frame accuracy: the share of frames (at 30 Hz) whose category, or being unknown, is right. Events: a
labelled segment is right if a true piece of its category overlaps it by at least half (intersection over union), each
piece counting once, the best overlaps first; precision, recall and F are over known categories. Boundary error: of the
starts and stops of the right ones, the median of the absolute differences.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dousa.errors import OptionError
from dousa.experiments.table import Result
from dousa.motion.annotation import Stretch
from dousa.retrieval.takes.find import overlap
from dousa.retrieval.takes.label import Segment
from dousa.retrieval.takes.windows import TAKE_RATE


@dataclass(frozen=True, slots=True)
class Scores:
    """Macro averages over the categories of the truth, and the share of clips that were right; 0 to 1."""

    recall: float
    precision: float
    f_measure: float
    accuracy: float


@dataclass(frozen=True, slots=True)
class Confusion:
    """How often clips of one category were taken for another.

    Parameters
    ----------
    truth, predicted : the categories.
    count : clips.
    share : of the clips of the true category, 0 to 1.
    """

    truth: str
    predicted: str
    count: int
    share: float


def compute_confusion_matrix(truth: ArrayLike, predicted: ArrayLike) -> tuple[NDArray[np.intp], NDArray[Any]]:
    """Count which category was taken for which.

    Parameters
    ----------
    truth, predicted : (N,) categories.

    Returns
    -------
    matrix : (C, C), row the true category, column the predicted one.
    categories : (C,) all that occur in either, sorted.

    Raises
    ------
    OptionError : arrays that are not one-dimensional and of equal length.
    """
    true, named = _check(truth, predicted)
    if not len(true):
        return np.zeros((0, 0), np.intp), true
    categories, numbers = np.unique(np.concatenate([true, named]), return_inverse=True)
    count = len(categories)
    rows, columns = numbers[: len(true)], numbers[len(true) :]
    matrix = np.bincount(rows * count + columns, minlength=count * count).reshape(count, count)
    return matrix.astype(np.intp), categories


def compute_scores(truth: ArrayLike, predicted: ArrayLike) -> Scores:
    """Score predictions; see the module for the conventions.

    Parameters
    ----------
    truth, predicted : (N,) categories.

    Returns
    -------
    Scores, each 0 to 1; 0 if there is nothing to score.

    Raises
    ------
    OptionError : arrays that are not one-dimensional and of equal length.
    """
    matrix, _ = compute_confusion_matrix(truth, predicted)
    if not len(matrix):
        return Scores(0.0, 0.0, 0.0, 0.0)
    right = np.diag(matrix).astype(np.float64)
    clips, named = matrix.sum(axis=1), matrix.sum(axis=0)
    in_truth = clips > 0
    recall = right[in_truth] / clips[in_truth]
    precision = right[in_truth] / np.maximum(named[in_truth], 1)
    f_measure = 2.0 * right[in_truth] / (clips[in_truth] + named[in_truth])
    return Scores(
        recall=float(recall.mean()),
        precision=float(precision.mean()),
        f_measure=float(f_measure.mean()),
        accuracy=float(right.sum() / matrix.sum()),
    )


def list_confusions(truth: ArrayLike, predicted: ArrayLike, limit: int | None = 10) -> tuple[Confusion, ...]:
    """The mistakes, most frequent first; ties by share, then by name.

    Parameters
    ----------
    truth, predicted : (N,) categories.
    limit : how many to list; None for all.
    """
    matrix, categories = compute_confusion_matrix(truth, predicted)
    clips = matrix.sum(axis=1)
    found = [
        Confusion(str(categories[i]), str(categories[j]), int(matrix[i, j]), float(matrix[i, j] / clips[i]))
        for i, j in np.argwhere(matrix)
        if i != j
    ]
    found.sort(key=lambda one: (-one.count, -one.share, one.truth, one.predicted))
    return tuple(found[:limit])


def _check(truth: ArrayLike, predicted: ArrayLike) -> tuple[NDArray[Any], NDArray[Any]]:
    true, named = np.asarray(truth), np.asarray(predicted)
    if true.ndim != 1 or true.shape != named.shape:
        raise OptionError("trials.predictions", true=true.shape, predicted=named.shape)
    return true, named


# Timelines

TrueSegment = Stretch
"""What a take shows; category None where it is none that is known."""


@dataclass(frozen=True, slots=True)
class TimelineScores(Result):
    """Shares from 0 to 1, and seconds; nan where there is nothing to count."""

    frame_accuracy: float
    precision: float
    recall: float
    f_measure: float
    boundary_error_s: float
    n_frames: int
    n_events: int


@dataclass(frozen=True, slots=True)
class TimelineCounts:
    """What scores are made of; counts of several takes can be added.

    Parameters
    ----------
    right_frames, n_frames : frames whose label is right, frames that count.
    matched, said, true : segments that are right, labelled segments, true pieces of known categories.
    boundary_errors : s, two of each right segment.
    """

    right_frames: int = 0
    n_frames: int = 0
    matched: int = 0
    said: int = 0
    true: int = 0
    boundary_errors: tuple[float, ...] = ()

    def scores(self) -> TimelineScores:
        """The scores of these counts."""
        nan = float("nan")
        precision = self.matched / self.said if self.said else nan
        recall = self.matched / self.true if self.true else nan
        both = self.said + self.true
        return TimelineScores(
            frame_accuracy=self.right_frames / self.n_frames if self.n_frames else nan,
            precision=precision,
            recall=recall,
            f_measure=2 * self.matched / both if both else nan,
            boundary_error_s=float(np.median(self.boundary_errors)) if self.boundary_errors else nan,
            n_frames=self.n_frames,
            n_events=self.true,
        )


def add_counts(counts: Iterable[TimelineCounts]) -> TimelineCounts:
    """The counts of several takes together."""
    some = list(counts)
    return TimelineCounts(
        sum(one.right_frames for one in some),
        sum(one.n_frames for one in some),
        sum(one.matched for one in some),
        sum(one.said for one in some),
        sum(one.true for one in some),
        tuple(error for one in some for error in one.boundary_errors),
    )


def compare_timeline(segments: Sequence[Segment], truth: Sequence[TrueSegment], duration: float) -> TimelineCounts:
    """Count what is right in the labels of a take.

    Parameters
    ----------
    segments : of a timeline.
    truth : what the take shows; nothing known where no true segment is.
    duration : s.
    """
    times = np.asarray((np.arange(round(duration * TAKE_RATE)) + 0.5) / TAKE_RATE, np.float64)
    said = name_at(times, [(one.start, one.stop, one.category) for one in segments])
    shown = name_at(times, [(one.start, one.stop, one.category) for one in truth])
    counted = np.ones(len(times), bool)
    for one in truth:
        if not one.counted:
            counted &= ~((times >= one.start) & (times < one.stop))
    labelled = [one for one in segments if one.category is not None]
    events = [one for one in truth if one.category is not None and one.counted]
    pairs = sorted(
        (
            (-overlap((a.start, a.stop), (b.start, b.stop)), i, k)
            for i, a in enumerate(labelled)
            for k, b in enumerate(events)
            if a.category == b.category and overlap((a.start, a.stop), (b.start, b.stop)) >= 0.5
        )
    )
    used: tuple[set[int], set[int]] = (set(), set())
    errors: list[float] = []
    for _, i, k in pairs:
        if i not in used[0] and k not in used[1]:
            used[0].add(i)
            used[1].add(k)
            errors += [abs(labelled[i].start - events[k].start), abs(labelled[i].stop - events[k].stop)]
    n_said = sum(_is_counted(one, truth) for one in labelled)
    right = int(((said == shown) & counted).sum())
    return TimelineCounts(right, int(counted.sum()), len(used[0]), n_said, len(events), tuple(errors))


def name_at(times: NDArray[np.float64], spans: Iterable[tuple[float, float, str | None]]) -> NDArray[np.object_]:
    """Return the category at each of some times (N,), of (start, stop, category); empty where there is none."""
    names = np.full(len(times), "", dtype=object)
    for start, stop, category in spans:
        names[(times >= start) & (times < stop)] = category or ""
    return names


def _is_counted(segment: Segment, truth: Sequence[TrueSegment]) -> bool:
    """Whether most of a segment lies where the truth is known."""
    unclear = sum(
        max(min(segment.stop, one.stop) - max(segment.start, one.start), 0.0) for one in truth if not one.counted
    )
    return unclear <= 0.5 * (segment.stop - segment.start)
