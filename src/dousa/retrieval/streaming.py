"""Label a motion while it happens: frames go in, answers come out within one window.

Frames are brought to 30 Hz and the last ones kept, some ten seconds at most. A few times a second the windows that have
become complete are described and scored as those of a recorded take are, and laid one after another anew. So memory and
work a frame stay the same for hours. What lies a longest window back is settled and will not change.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dousa.errors import InvalidMotionError, OptionError
from dousa.motion.joints import CANONICAL_JOINTS
from dousa.retrieval.labelling import SHORT_GAP, Segment, TakeLabeller, choose_segments
from dousa.retrieval.takes import TAKE_RATE, Sampled, hop_of

if TYPE_CHECKING:
    from dousa.retrieval.feature_sets import FeatureSet
    from dousa.retrieval.forest import MotionForest

__all__ = ["LiveAnswer", "LiveLabeller"]

_HOP = 4  # frames at 30 Hz between two answers
_MARGIN = 30  # frames before a window: channels are smoothed over time
_MEASURED = 30  # frames that the body height is estimated from
_LONGEST_GAP = 2.0  # s between two frames that are bridged in a straight line


@dataclass(frozen=True, slots=True)
class LiveAnswer:
    """What is known at a moment.

    Parameters
    ----------
    time : s, of the last frame that counted.
    category : of the action that ends about now; None where it is unknown or not over yet.
    confidence : 0 to 1, the probability that the category is right; of an unknown one, that none would be.
    start : s, when that action began; ``time`` where there is none.
    settled : stretches that became certain since the last answer; together they are the timeline.
    """

    time: float
    category: str | None
    confidence: float
    start: float
    settled: tuple[Segment, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """Plain words and numbers; times in seconds."""
        return {
            "time_s": round(self.time, 3),
            "category": self.category,
            "unknown": self.category is None,
            "confidence": round(self.confidence, 4),
            "start_s": round(self.start, 3),
            "settled": [segment.to_json() for segment in self.settled],
        }


class LiveLabeller:
    """Labels frames as they come.

    Parameters
    ----------
    forest, feature_set, labeller : as for takes.
    height : m, of the performer; None to estimate it from the first second.
    threshold : confidence from which a category is said; None for the labeller's own.

    Raises
    ------
    OptionError : a height or threshold out of range.
    """

    def __init__(
        self,
        forest: MotionForest,
        feature_set: FeatureSet,
        labeller: TakeLabeller,
        *,
        height: float | None = None,
        threshold: float | None = None,
    ) -> None:
        if height is not None and not 0 < height < np.inf:
            raise OptionError(f"height: expected m above 0, got {height}")
        if threshold is not None and not 0 <= threshold <= 1:
            raise OptionError(f"threshold: expected 0 to 1, got {threshold}")
        self.height = height
        self._forest, self._feature_set, self._labeller = forest, feature_set, labeller
        self._threshold = labeller.threshold if threshold is None else threshold
        self._longest = labeller.grid.lengths[-1]
        self._sampler = _Sampler(2 * self._longest + 4 * _MARGIN)
        self._described = 0  # samples whose windows are scored
        self._settled = 0  # samples whose label is certain
        self._windows = _Windows.none(len(labeller.classes))

    def push(self, positions: ArrayLike, time: float) -> LiveAnswer | None:
        """Take a frame; answers come about eight times a second, None in between.

        Parameters
        ----------
        positions : (20, 3) m, canonical joints, Y up, finite.
        time : s, later than that of the frame before.

        Raises
        ------
        InvalidMotionError : another shape, positions that are not finite, a time that does not go on.
        """
        points = np.asarray(positions, np.float64)
        if points.shape != (len(CANONICAL_JOINTS), 3) or not np.isfinite(points).all():
            raise InvalidMotionError(
                f"expected finite positions (20, 3) of a frame, got shape {points.shape} or NaN"
            )
        self._sampler.push(points, float(time))
        if self._sampler.count - self._described < _HOP or not self._know_height():
            return None
        self._describe()
        return self._answer(self._settle(self._sampler.count - self._longest))

    def finish(self) -> LiveAnswer | None:
        """Take no more frames: the last answer, with all that was not settled; None if there was no frame."""
        self._sampler.flush()
        if not self._sampler.count:
            return None
        if self._know_height(at_once=True):
            self._describe()
        return self._answer(self._settle(self._sampler.count, rest=True))

    def _know_height(self, *, at_once: bool = False) -> bool:
        if self.height is None and (at_once or self._sampler.count >= _MEASURED):
            from dousa.motion.geometry import chain_height

            height = float(chain_height(self._sampler.last(_MEASURED)))
            if not height > 0:
                raise InvalidMotionError("expected a body of some height, got all joints in one place")
            self.height = height
        return self.height is not None

    def _describe(self) -> None:
        """Score the windows that have become complete."""
        from dousa.retrieval.tracks import compute_track

        now = self._sampler.count
        starts, stops = _complete_windows(self._labeller.grid.lengths, self._described, now)
        self._described = now
        if not len(starts):
            return
        first = max(int(starts.min()) - _MARGIN, self._sampler.oldest)
        track = compute_track(
            Sampled(self._sampler.last(now - first), float(self.height or 1.0)), self._feature_set
        )
        leaves = self._forest.apply_windows(track, starts - first, stops - first)
        self._windows = self._windows.add(starts, stops, self._labeller.score(leaves))

    def _settle(self, until: int, *, rest: bool = False) -> tuple[Segment, ...]:
        """Segments that end before a sample, in order; with the rest, what follows the last of them too."""
        settled: list[Segment] = []
        for start, stop, category, sure in self._lay():
            if stop > until:
                break
            if stop <= self._settled:
                continue
            begin = self._settled  # a short gap goes to the action behind it
            if start - begin > SHORT_GAP:
                settled.append(self._segment(begin, start, None, 1.0))
                begin = start
            at_end = rest and self._sampler.count - stop <= SHORT_GAP
            self._settled = self._sampler.count if at_end else stop
            settled.append(self._segment(begin, self._settled, category, sure))
        if rest and self._sampler.count > self._settled:
            settled.append(self._segment(self._settled, self._sampler.count, None, 1.0))
            self._settled = self._sampler.count
        self._windows = self._windows.after(self._settled)
        if until - self._settled > self._longest:
            # Nothing was found for long: what no window that is still to come can reach is unknown.
            settled.append(self._segment(self._settled, until, None, 1.0))
            self._settled = until
            self._windows = self._windows.after(until)
        return tuple(settled)

    def _lay(self) -> list[tuple[int, int, int, float]]:
        """Start, stop, category and confidence of the best sequence of windows from the settled sample on."""
        some = self._windows
        base = self._settled - self._longest // 8  # windows may reach a little into what is settled
        chosen = choose_segments(
            some.starts - base, some.stops - base, some.scores, self._sampler.count - base
        )
        if not chosen:
            return []
        sure = self._labeller.confidence(some.scores[[one.row for one in chosen]])
        return [
            (one.start + base, one.stop + base, one.category, float(known))
            for one, known in zip(chosen, sure, strict=True)
        ]

    def _segment(self, start: int, stop: int, category: int | None, sure: float) -> Segment:
        first, last = self._sampler.time_of(start), self._sampler.time_of(stop)
        if category is None:
            return Segment(first, last, None, sure)
        known = sure >= self._threshold
        name = self._labeller.classes[category] if known else None
        return Segment(first, last, name, sure if known else 1.0 - sure)

    def _answer(self, settled: tuple[Segment, ...]) -> LiveAnswer:
        now = self._sampler.count
        time = self._sampler.time_of(now)
        sequence = self._lay()
        if sequence and now - sequence[-1][1] <= SHORT_GAP:
            segment = self._segment(sequence[-1][0], now, sequence[-1][2], sequence[-1][3])
            return LiveAnswer(time, segment.category, segment.confidence, segment.start, settled)
        return LiveAnswer(time, None, 1.0, time, settled)


def _complete_windows(
    lengths: tuple[int, ...], before: int, now: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The windows of the grid that end after sample ``before`` and not after ``now``."""
    starts, stops = [], []
    for length in lengths:
        hop = hop_of(length)
        first = max(-(-(before + 1 - length) // hop), 0) * hop
        some = np.arange(first, now - length + 1, hop, dtype=np.int64)
        starts.append(some)
        stops.append(some + length)
    return np.concatenate(starts), np.concatenate(stops)


@dataclass(frozen=True, slots=True, eq=False)
class _Windows:
    """Windows that may still become part of the answer."""

    starts: NDArray[np.int64]
    stops: NDArray[np.int64]
    scores: NDArray[np.float32]

    @classmethod
    def none(cls, n_categories: int) -> _Windows:
        empty = np.zeros(0, np.int64)
        return cls(empty, empty, np.zeros((0, n_categories), np.float32))

    def add(
        self, starts: NDArray[np.int64], stops: NDArray[np.int64], scores: NDArray[np.float32]
    ) -> _Windows:
        return _Windows(
            np.concatenate([self.starts, starts]),
            np.concatenate([self.stops, stops]),
            np.concatenate([self.scores, scores]),
        )

    def after(self, sample: int) -> _Windows:
        """Those that begin at a sample or later, give or take what two windows may share."""
        keep = self.starts + (self.stops - self.starts) // 8 >= sample
        return _Windows(self.starts[keep], self.stops[keep], self.scores[keep])


class _Sampler:
    """The last frames at 30 Hz, whatever the rate they come at.

    Frames that fall into the same thirtieth of a second are averaged; thirtieths without a frame are filled in a
    straight line.
    """

    def __init__(self, capacity: int) -> None:
        # Twice the room, so that the frames move to its beginning once in a while only.
        self._room = np.empty((2 * capacity, len(CANONICAL_JOINTS), 3))
        self._capacity, self._filled = capacity, 0
        self.count = 0
        self._begin: float | None = None
        self._time = 0.0
        self._bin, self._sum, self._many = 0, np.zeros((len(CANONICAL_JOINTS), 3)), 0

    @property
    def oldest(self) -> int:
        """Number of the first sample that is still there."""
        return self.count - min(self._filled, self._capacity)

    def time_of(self, sample: int) -> float:
        """s, when a sample begins."""
        return (self._begin or 0.0) + sample / TAKE_RATE

    def last(self, count: int) -> NDArray[np.float64]:
        """The last samples, as many as there are."""
        return self._room[max(self._filled - count, 0) : self._filled]

    def push(self, points: NDArray[np.float64], time: float) -> None:
        if self._begin is None:
            self._begin = self._time = time
        elif not 0 < time - self._time <= _LONGEST_GAP:
            raise InvalidMotionError(
                f"expected frames in the order of time and at most {_LONGEST_GAP:g} s apart, got {time:g} s after "
                f"{self._time:g} s; start anew after a longer gap"
            )
        self._time = time
        # A rate of 30 Hz that is written with few digits must not fall beside its thirtieths.
        number = int((time - self._begin) * TAKE_RATE + 0.1)
        if number > self._bin and self._many:
            self._close(number, points)
        self._bin = number
        self._sum += points
        self._many += 1

    def flush(self) -> None:
        """Close the thirtieth of a second that is open."""
        if self._many:
            self._store(self._sum / self._many)
            self._sum[:] = 0.0
            self._many = 0

    def _close(self, number: int, following: NDArray[np.float64]) -> None:
        mean = self._sum / self._many
        self._store(mean)
        gap = number - self._bin
        for k in range(1, gap):
            self._store(mean + (following - mean) * (k / gap))
        self._sum[:] = 0.0
        self._many = 0

    def _store(self, sample: NDArray[np.float64]) -> None:
        if self._filled == len(self._room):
            self._room[: self._capacity] = self._room[-self._capacity :]
            self._filled = self._capacity
        self._room[self._filled] = sample
        self._filled += 1
        self.count += 1
