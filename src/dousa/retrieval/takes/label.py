"""Label a long take over time: which category from when to when, how sure, and where nothing known happens.

Every window of a take is scored for every category by the leaves that it reaches. Of all ways to lay windows one after
another, the one with the largest sum of score times length is taken (dynamic programming over the ends of the windows,
linear in their number), which finds the places and the lengths of the actions at once; what no window covers, and what
is not likely enough to be right, is unknown.
"""

from __future__ import annotations

import csv
import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import FloatArray, IntArray
from dousa.errors import InvalidMotionError, MotionWriteError, OptionError
from dousa.messages import Message
from dousa.retrieval.forest.forest_file import check, check_version, pack_arrays, unpack_arrays
from dousa.retrieval.takes.leaf_weights import LeafWeights
from dousa.retrieval.takes.windows import TAKE_RATE, TakeWindows, WindowGrid, read_grid

SHORT_GAP = 15
"""Frames between two actions, or at an end, that are shared out among them."""

_LEAST_SCORE = 0.02  # of a window that is chosen


_VERSION = 1
_WHAT = Message("stored.labeller")
_NAMES = ("version", "classes", "weights", "offset", "lengths", "calibration", "threshold", "n_trees")


@dataclass(frozen=True, slots=True)
class Segment:
    """A stretch of a take.

    Parameters
    ----------
    start, stop : s.
    category : None where it is unknown.
    confidence : 0 to 1, the probability that the category is right; of an unknown one, that none would be.
    """

    start: float
    stop: float
    category: str | None
    confidence: float

    def to_json(self) -> dict[str, Any]:
        """Plain words and numbers; times in seconds."""
        return {
            "start_s": round(self.start, 3),
            "end_s": round(self.stop, 3),
            "category": self.category,
            "unknown": self.category is None,
            "confidence": round(self.confidence, 4),
        }


@dataclass(frozen=True, slots=True)
class Timeline:
    """A take from beginning to end.

    Parameters
    ----------
    segments : one after another without gaps, in the order of time; none for a take of no length.
    duration : s.
    threshold : confidence below which a stretch is unknown.
    """

    segments: tuple[Segment, ...]
    duration: float
    threshold: float

    def category_at(self, seconds: float) -> str | None:
        """The category at a moment; None where it is unknown or outside the take."""
        for segment in self.segments:
            if segment.start <= seconds < segment.stop:
                return segment.category
        return None

    def to_json(self) -> dict[str, Any]:
        """Plain dictionaries, lists, numbers and strings, ready for ``json.dumps``."""
        return {
            "duration_s": round(self.duration, 3),
            "threshold": round(self.threshold, 4),
            "segments": [segment.to_json() for segment in self.segments],
        }


def write_timeline_csv(timeline: Timeline, path: str | os.PathLike[str]) -> None:
    """Write a row a segment: start_s, end_s, category (empty where unknown), confidence.

    Raises
    ------
    MotionWriteError : the file cannot be written.
    """
    try:
        with open(path, "w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(("start_s", "end_s", "category", "confidence"))
            writer.writerows(
                (f"{one.start:.3f}", f"{one.stop:.3f}", one.category or "", f"{one.confidence:.4f}")
                for one in timeline.segments
            )
    except OSError as error:
        raise MotionWriteError(path, "labeller.unwritable", reason=error) from error


@dataclass(frozen=True, slots=True, eq=False)
class TakeLabeller:
    """What is learned to label takes with, beside the forest.

    Parameters
    ----------
    classes : (C,) the categories.
    leaf_weights : of the forest's leaves.
    grid : the windows that are looked at.
    calibration : (3,) the log odds that a chosen window is right: offset, weight of the log score, weight of the lead
        over the second category.
    threshold : confidence from which a category is said.
    n_trees : of the forest.
    """

    classes: tuple[str, ...]
    leaf_weights: LeafWeights
    grid: WindowGrid
    calibration: tuple[float, float, float]
    threshold: float
    n_trees: int

    def score(self, leaves: NDArray[Any]) -> NDArray[np.float32]:
        """(W, C) how well windows cover an action of each category, from their leaves (W, n_trees).

        Raises
        ------
        InvalidMotionError : leaves of another forest.
        """
        n_leaves = len(self.leaf_weights.weights)
        if leaves.shape[1] != self.n_trees or (len(leaves) and int(leaves.max()) >= n_leaves):
            raise InvalidMotionError("labeller.other_forest", trees=self.n_trees, leaves=n_leaves)
        return self.leaf_weights.score(leaves)

    def confidence(self, scores: NDArray[np.float32]) -> FloatArray:
        """(W,) probability that the best category of windows is right, from their scores (W, C)."""
        offset, by_score, by_lead = self.calibration
        evidence = describe_scores(scores) @ (by_score, by_lead) + offset
        sure: FloatArray = 1.0 / (1.0 + np.exp(-np.clip(evidence, -50, 50)))
        return sure

    def to_bytes(self) -> bytes:
        """The bytes of an .npz file (no pickle); the same labeller gives the same bytes."""
        return pack_arrays(
            {
                "version": np.array(_VERSION, np.int64),
                "classes": np.array(self.classes, dtype=np.str_),
                "weights": np.ascontiguousarray(self.leaf_weights.weights),
                "offset": np.ascontiguousarray(self.leaf_weights.offset),
                "lengths": np.array(self.grid.lengths, np.int64),
                "calibration": np.array(self.calibration, np.float64),
                "threshold": np.array(self.threshold, np.float64),
                "n_trees": np.array(self.n_trees, np.int64),
            }
        )

    @classmethod
    def from_bytes(cls, data: bytes) -> TakeLabeller:
        """The labeller that ``to_bytes`` wrote; DousaError for damaged, other or newer bytes."""
        arrays = unpack_arrays(data, _NAMES, _WHAT)
        check_version(arrays, _WHAT, (_VERSION,))
        classes, weights, offset = arrays["classes"], arrays["weights"], arrays["offset"]
        check(classes.ndim == 1 and len(classes) > 0 and classes.dtype.kind == "U", _WHAT, "bad categories")
        check(len(np.unique(classes)) == len(classes), _WHAT, "a category occurs twice")
        right = weights.dtype == np.float32 and weights.ndim == 2 and weights.shape[1] == len(classes)
        check(right and weights.flags.c_contiguous and bool(np.isfinite(weights).all()), _WHAT, "bad weights")
        right = offset.dtype == np.float32 and offset.shape == classes.shape
        check(right and bool(np.isfinite(offset).all()), _WHAT, "bad weights")
        grid, calibration = read_grid(arrays["lengths"], _WHAT), arrays["calibration"]
        right = calibration.shape == (3,) and calibration.dtype == np.float64
        check(right and bool(np.isfinite(calibration).all()), _WHAT, "bad calibration")
        threshold, n_trees = arrays["threshold"], arrays["n_trees"]
        right = threshold.shape == () and threshold.dtype == np.float64
        check(right and 0 <= float(threshold) <= 1, _WHAT, "bad threshold")
        right = n_trees.shape == () and n_trees.dtype == np.int64
        check(right and int(n_trees) > 0, _WHAT, "bad number of trees")
        offset_score, by_score, by_lead = (float(value) for value in calibration)
        by_window = offset_score, by_score, by_lead
        names, known = tuple(map(str, classes)), LeafWeights(weights, offset)
        return cls(names, known, grid, by_window, float(threshold), int(n_trees))


def describe_scores(scores: NDArray[np.float32]) -> FloatArray:
    """(W, 2) log of the best score, and its lead over the second as a share of it."""
    if scores.shape[1] == 1:
        best, second = scores[:, 0].astype(np.float64), np.zeros(len(scores))
    else:
        second, best = np.partition(scores, -2, axis=1)[:, -2:].T.astype(np.float64)
    best = np.maximum(best, 1e-3)
    return np.stack([np.log(best), 1.0 - np.maximum(second, 0.0) / best], axis=1)


@dataclass(frozen=True, slots=True)
class Chosen:
    """A window that is part of the answer: frames of the action, row of the window, number of the category."""

    start: int
    stop: int
    row: int
    category: int


def choose_segments(starts: IntArray, stops: IntArray, scores: NDArray[np.float32], n_frames: int) -> list[Chosen]:
    """Windows one after another with the largest sum of score times length.

    Two may overlap by an eighth of the shorter one's length: an action seldom begins and ends where a window does.
    Where it does, the windows about the same place tell together, see ``_place_edges``.
    """
    from dousa.retrieval.takes.window_kernels import choose_windows

    lengths = stops - starts
    spare = lengths // 16
    first, last = starts + spare, stops - spare
    order = np.lexsort((np.arange(len(last)), last))
    gains = (scores.max(axis=1) - _LEAST_SCORE).astype(np.float64) * lengths if len(scores) else np.zeros(0)
    first_at = np.searchsorted(last[order], np.arange(n_frames + 2))
    best, chosen = np.empty(n_frames + 1), np.empty(n_frames + 1, np.int64)
    choose_windows(first[order], last[order], gains[order], n_frames, first_at, best, chosen)
    rows, frame = [], n_frames
    while frame > 0:
        if chosen[frame] < 0:
            frame -= 1
            continue
        rows.append(int(order[chosen[frame]]))
        frame = int(first[rows[-1]])
    return _place_edges(rows[::-1], starts, stops, scores)


def _place_edges(rows: list[int], starts: IntArray, stops: IntArray, scores: NDArray[np.float32]) -> list[Chosen]:
    """Where the actions of chosen windows begin and end: between the frames that the grid has.

    The mean of the starts, and of the stops, of all windows that overlap the chosen one by half or more (intersection
    over union), weighted with the cube of their scores for its category; at most a quarter of its length away.
    """
    by_start = np.argsort(starts, kind="stable")
    sorted_starts = starts[by_start]
    answer = []
    for row in rows:
        start, stop = int(starts[row]), int(stops[row])
        category = int(scores[row].argmax())
        length = stop - start
        # What overlaps by half is at most twice as long, and begins no earlier than a length before.
        near = by_start[slice(*np.searchsorted(sorted_starts, (start - length, stop)))]
        shared = np.minimum(stops[near], stop) - np.maximum(starts[near], start)
        union = np.maximum(stops[near], stop) - np.minimum(starts[near], start)
        near = near[2 * shared >= union]
        weights = np.maximum(scores[near, category].astype(np.float64), 1e-6) ** 3
        weights /= weights.sum()
        begin, end = round(float(weights @ starts[near])), round(float(weights @ stops[near]))
        begin = min(max(begin, start - length // 4), start + length // 4)
        end = min(max(end, stop - length // 4), stop + length // 4)
        answer.append(Chosen(begin, end, row, category))
    return answer


def label_take(labeller: TakeLabeller, take: TakeWindows, *, threshold: float | None = None) -> Timeline:
    """Label a take from beginning to end.

    Parameters
    ----------
    labeller : learned with the forest that described the take.
    take : its windows; those of the lengths that the labeller knows are looked at.
    threshold : confidence from which a category is said, 0 to 1; None for the labeller's own.

    Raises
    ------
    OptionError : a threshold outside 0 to 1.
    InvalidMotionError : windows of another forest.
    """
    limit = labeller.threshold if threshold is None else threshold
    if not 0 <= limit <= 1:
        raise OptionError("labeller.threshold", found=limit)
    rows = take.rows_within(labeller.grid)
    starts, stops = take.starts[rows], take.stops[rows]
    scores = labeller.score(take.leaves[rows])
    chosen = choose_segments(starts, stops, scores, take.n_frames)
    sure = labeller.confidence(scores[[one.row for one in chosen]]) if chosen else np.zeros(0)
    return make_timeline(chosen, sure, labeller.classes, take.duration, limit)


def make_timeline(
    chosen: Sequence[Chosen], sure: FloatArray, classes: Sequence[str], duration: float, threshold: float
) -> Timeline:
    """Segments without gaps from chosen windows and how sure each is."""
    n_frames = duration * TAKE_RATE
    spans = _share_gaps([(float(one.start), float(one.stop)) for one in chosen], n_frames)
    parts: list[Segment] = []
    reached = 0.0
    for one, (start, stop), confidence in zip(chosen, spans, sure, strict=True):
        if start > reached:
            parts.append(Segment(reached / TAKE_RATE, start / TAKE_RATE, None, 1.0))
        known = bool(confidence >= threshold)
        category, sureness = (
            classes[one.category] if known else None,
            confidence if known else 1.0 - confidence,
        )
        parts.append(Segment(start / TAKE_RATE, stop / TAKE_RATE, category, float(sureness)))
        reached = stop
    if reached < n_frames:
        parts.append(Segment(reached / TAKE_RATE, duration, None, 1.0))
    return Timeline(_merge_unknown(parts), duration, threshold)


def _share_gaps(spans: list[tuple[float, float]], n_frames: float) -> list[tuple[float, float]]:
    """Overlaps and short gaps between neighbours end in the middle; short gaps at the ends go to the outermost."""
    if not spans:
        return []
    starts, stops = (list(edges) for edges in zip(*spans, strict=True))
    for k in range(len(spans) - 1):
        if starts[k + 1] - stops[k] <= SHORT_GAP:
            middle = 0.5 * (stops[k] + starts[k + 1])
            stops[k] = starts[k + 1] = min(max(middle, starts[k] + 1), max(stops[k + 1] - 1, starts[k] + 1))
    if starts[0] <= SHORT_GAP:
        starts[0] = 0.0
    if n_frames - stops[-1] <= SHORT_GAP:
        stops[-1] = n_frames
    return list(zip(starts, stops, strict=True))


def _merge_unknown(parts: Sequence[Segment]) -> tuple[Segment, ...]:
    """Neighbouring stretches that are unknown become one, as sure as their mean over time."""
    merged: list[Segment] = []
    for part in parts:
        before = merged[-1] if merged else None
        if before is not None and before.category is None and part.category is None:
            sure, more = (each.confidence * (each.stop - each.start) for each in (before, part))
            mean = (sure + more) / (part.stop - before.start)
            merged[-1] = Segment(before.start, part.stop, None, mean)
        else:
            merged.append(part)
    return tuple(merged)
