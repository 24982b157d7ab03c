"""Label a motion while it happens: frames go in, answers come out within one window.

Frames are brought to 30 Hz and the last ones kept, some ten seconds at most. A few times a second the windows that have
become complete are described and scored as those of a recorded take are, and laid one after another anew. So memory and
work a frame stay the same for hours. What lies a longest window back is settled and will not change.
"""

from __future__ import annotations

import json
import reprlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from math import isnan
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dousa.arrays import FloatArray, IntArray
from dousa.errors import InvalidMotionError, OptionError
from dousa.motion.canonical.joints import CANONICAL_JOINTS, JOINT_INDEX
from dousa.retrieval.takes.label import SHORT_GAP, Segment, TakeLabeller, choose_segments
from dousa.retrieval.takes.windows import TAKE_RATE, Sampled, hop_of

if TYPE_CHECKING:
    from dousa.retrieval.features.feature_sets import FeatureSet
    from dousa.retrieval.forest.forest import MotionForest

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
            raise OptionError("live.height_option", found=height)
        if threshold is not None and not 0 <= threshold <= 1:
            raise OptionError("labeller.threshold", found=threshold)
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
            raise InvalidMotionError("live.frame_shape", shape=points.shape)
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
            from dousa.motion.canonical.geometry import chain_height

            height = float(chain_height(self._sampler.last(_MEASURED)))
            if not height > 0:
                raise InvalidMotionError("live.no_height")
            self.height = height
        return self.height is not None

    def _describe(self) -> None:
        """Score the windows that have become complete."""
        from dousa.retrieval.features.feature_sets import compute_track

        now = self._sampler.count
        starts, stops = _complete_windows(self._labeller.grid.lengths, self._described, now)
        self._described = now
        if not len(starts):
            return
        first = max(int(starts.min()) - _MARGIN, self._sampler.oldest)
        track = compute_track(Sampled(self._sampler.last(now - first), float(self.height or 1.0)), self._feature_set)
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
        chosen = choose_segments(some.starts - base, some.stops - base, some.scores, self._sampler.count - base)
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


def _complete_windows(lengths: tuple[int, ...], before: int, now: int) -> tuple[IntArray, IntArray]:
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

    starts: IntArray
    stops: IntArray
    scores: NDArray[np.float32]

    @classmethod
    def none(cls, n_categories: int) -> _Windows:
        empty = np.zeros(0, np.int64)
        return cls(empty, empty, np.zeros((0, n_categories), np.float32))

    def add(self, starts: IntArray, stops: IntArray, scores: NDArray[np.float32]) -> _Windows:
        edges = np.concatenate([self.starts, starts]), np.concatenate([self.stops, stops])
        return _Windows(*edges, np.concatenate([self.scores, scores]))

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

    def last(self, count: int) -> FloatArray:
        """The last samples, as many as there are."""
        return self._room[max(self._filled - count, 0) : self._filled]

    def push(self, points: FloatArray, time: float) -> None:
        if self._begin is None:
            self._begin = self._time = time
        elif not 0 < time - self._time <= _LONGEST_GAP:
            raise InvalidMotionError("live.order", gap=_LONGEST_GAP, time=time, before=self._time)
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

    def _close(self, number: int, following: FloatArray) -> None:
        mean, gap = self._sum / self._many, number - self._bin
        self.flush()
        for k in range(1, gap):
            self._store(mean + (following - mean) * (k / gap))

    def _store(self, sample: FloatArray) -> None:
        if self._filled == len(self._room):
            self._room[: self._capacity] = self._room[-self._capacity :]
            self._filled = self._capacity
        self._room[self._filled] = sample
        self._filled += 1
        self.count += 1


_N_JOINTS = len(CANONICAL_JOINTS)


@dataclass(frozen=True, slots=True, eq=False)
class LiveFrame:
    """One frame.

    Parameters
    ----------
    time : s.
    positions : (20, 3) m.
    held : joints that were missing and stay where they were.
    """

    time: float
    positions: FloatArray
    held: tuple[str, ...] = ()


class LiveFrameParser:
    """Reads lines one at a time and remembers what a later line needs.

    Attributes
    ----------
    height, frame_rate : of the header; None where it did not say.
    """

    def __init__(self) -> None:
        self.height: float | None = None
        self.frame_rate: float | None = None
        self._last: FloatArray | None = None
        self._line = 0
        self._frames = 0

    def parse(self, line: str) -> LiveFrame | None:
        """The frame of a line; None for an empty line and for the header.

        Raises
        ------
        InvalidMotionError : with the number of the line, and what was expected.
        """
        self._line += 1
        if not line.strip():
            return None
        try:
            said = json.loads(line)
        except (ValueError, RecursionError) as error:
            raise self._wrong("live.not_json", reason=error) from error
        if not isinstance(said, dict):
            raise self._wrong("live.no_object", found=type(said).__name__)
        if "joints" not in said and "positions" not in said:
            self._take_header(said)
            return None
        positions, held = self._read_positions(said)
        frame = LiveFrame(self._read_time(said), positions, held)
        self._last = positions
        self._frames += 1
        return frame

    @property
    def line(self) -> int:
        """Number of the last line that was read, from 1."""
        return self._line

    def _wrong(self, code: str, **values: Any) -> InvalidMotionError:
        return InvalidMotionError(code, line=self._line, **values)

    def _take_header(self, said: dict[str, Any]) -> None:
        strange = sorted(set(said) - {"height", "frame_rate"})
        if strange or not said or self._frames:
            names = reprlib.repr(", ".join(sorted(said))) if said else "nothing"
            raise self._wrong("live.no_frame", found=names)
        if "height" in said:
            self.height = self._read_number(said["height"], "height in m", 0.1, 10.0)
        if "frame_rate" in said:
            self.frame_rate = self._read_number(said["frame_rate"], "frame_rate in Hz", 0.1, 1e5)

    def _read_number(self, value: object, what: str, least: float, most: float) -> float:
        right = isinstance(value, int | float) and not isinstance(value, bool)
        if not right or not least <= float(value) <= most:  # type: ignore[arg-type]
            raise self._wrong("live.number", what=what, least=least, most=most, found=reprlib.repr(value))
        return float(value)  # type: ignore[arg-type]

    def _read_time(self, said: dict[str, Any]) -> float:
        if "time" in said:
            return self._read_number(said["time"], "time in s", -1e12, 1e12)
        if self.frame_rate is None:
            raise self._wrong("live.no_time")
        return self._frames / self.frame_rate

    def _read_positions(self, said: dict[str, Any]) -> tuple[FloatArray, tuple[str, ...]]:
        named = said.get("joints")
        if "positions" in said:
            listed = said["positions"]
            if not isinstance(listed, list) or len(listed) != _N_JOINTS:
                count = len(listed) if isinstance(listed, list) else type(listed).__name__
                raise self._wrong("live.positions", count=_N_JOINTS, found=count)
            named = dict(zip(CANONICAL_JOINTS, listed, strict=True))
        if not isinstance(named, dict):
            raise self._wrong("live.joints", found=type(named).__name__)
        strange = sorted(set(named) - set(JOINT_INDEX))
        if strange:
            raise self._wrong("live.unknown_joint", name=reprlib.repr(strange[0]), known=CANONICAL_JOINTS)
        positions = np.full((_N_JOINTS, 3), np.nan)
        for name, place in named.items():
            if place is not None:
                positions[JOINT_INDEX[name]] = self._read_place(name, place)
        return self._hold(positions)

    def _read_place(self, name: str, place: object) -> list[float]:
        if not isinstance(place, list) or len(place) != 3:
            raise self._wrong("live.place", name=name, found=reprlib.repr(place))
        # NaN, which JSON does not have but Python writes, is a joint not seen, as null is.
        if any(value is None or (isinstance(value, float) and isnan(value)) for value in place):
            return [np.nan] * 3
        if not all(type(value) in (int, float) and abs(value) < 1e9 for value in place):
            raise self._wrong("live.place_in_m", name=name, found=reprlib.repr(place))
        return [float(value) for value in place]

    def _hold(self, positions: FloatArray) -> tuple[FloatArray, tuple[str, ...]]:
        missing = np.isnan(positions).any(axis=1)
        if not missing.any():
            return positions, ()
        names = tuple(CANONICAL_JOINTS[k] for k in np.flatnonzero(missing))
        if self._last is None:
            raise self._wrong("live.first_frame", count=_N_JOINTS, missing=names)
        positions[missing] = self._last[missing]
        return positions, names


def read_live_frames(lines: Iterable[str], parser: LiveFrameParser | None = None) -> Iterator[LiveFrame]:
    """The frames of lines as they come.

    Parameters
    ----------
    lines : of a file or of standard input.
    parser : to know the header; None for one of its own.

    Raises
    ------
    InvalidMotionError : a line that is no frame, with its number.
    """
    reader = parser or LiveFrameParser()
    for line in lines:
        frame = reader.parse(line)
        if frame is not None:
            yield frame
