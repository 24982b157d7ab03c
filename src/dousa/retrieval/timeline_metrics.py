"""How good a timeline is: frames, events and boundaries against the truth.

Frame accuracy: the share of frames (at 30 Hz) whose category, or being unknown, is right. Events: a labelled segment is
right if a true piece of its category overlaps it by at least half (intersection over union), each piece counting once,
the best overlaps first; precision, recall and F are over known categories. Boundary error: of the starts and stops of
the right ones, the median of the absolute differences.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dousa.retrieval.finding import overlap
from dousa.retrieval.labelling import Segment
from dousa.retrieval.takes import TAKE_RATE

__all__ = ["TimelineCounts", "TimelineScores", "TrueSegment", "add_counts", "compare_timeline"]

_ENOUGH_OVERLAP = 0.5


@dataclass(frozen=True, slots=True)
class TrueSegment:
    """What a take shows from ``start`` to ``stop`` (s); category None where it is none that is known.

    Parameters
    ----------
    counted : false where nobody can say what it is; such frames do not count.
    """

    start: float
    stop: float
    category: str | None
    counted: bool = True


@dataclass(frozen=True, slots=True)
class TimelineScores:
    """Shares from 0 to 1, and seconds; nan where there is nothing to count."""

    frame_accuracy: float
    precision: float
    recall: float
    f_measure: float
    boundary_error_s: float
    n_frames: int
    n_events: int

    def to_json(self) -> dict[str, Any]:
        """Plain numbers; None for nan."""
        values = {name: getattr(self, name) for name in self.__slots__}
        return {name: None if value != value else value for name, value in values.items()}  # noqa: PLR0124


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


def compare_timeline(
    segments: Sequence[Segment], truth: Sequence[TrueSegment], duration: float
) -> TimelineCounts:
    """Count what is right in the labels of a take.

    Parameters
    ----------
    segments : of a timeline.
    truth : what the take shows; nothing known where no true segment is.
    duration : s.
    """
    times = np.asarray((np.arange(round(duration * TAKE_RATE)) + 0.5) / TAKE_RATE, np.float64)
    said = _names_at(times, [(one.start, one.stop, one.category) for one in segments])
    shown = _names_at(times, [(one.start, one.stop, one.category) for one in truth])
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
            if a.category == b.category and overlap((a.start, a.stop), (b.start, b.stop)) >= _ENOUGH_OVERLAP
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


def _names_at(
    times: NDArray[np.float64], spans: Iterable[tuple[float, float, str | None]]
) -> NDArray[np.object_]:
    names = np.full(len(times), "", dtype=object)
    for start, stop, category in spans:
        names[(times >= start) & (times < stop)] = category or ""
    return names


def _is_counted(segment: Segment, truth: Sequence[TrueSegment]) -> bool:
    """Whether most of a segment lies where the truth is known."""
    unclear = sum(
        max(min(segment.stop, one.stop) - max(segment.start, one.start), 0.0)
        for one in truth
        if not one.counted
    )
    return unclear <= 0.5 * (segment.stop - segment.start)
