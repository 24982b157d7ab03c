"""Label a motion while it is recorded, frame by frame.

The last ten seconds of frames are kept at 30 Hz. Five times a second the newest moments are judged as those of a
recorded take, as if the body then stood still, and the likeliest sequence is searched from the last settled moment, so
memory and work per frame stay constant. A segment is settled once some moments after it have all their surroundings.
"""

from __future__ import annotations

import json
import reprlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from math import isnan
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dousa.arrays import FloatArray
from dousa.errors import InvalidMotionError, OptionError
from dousa.motion.canonical.geometry import chain_height
from dousa.motion.canonical.joints import CANONICAL_JOINTS, JOINT_INDEX
from dousa.retrieval.features.posed_motion import PlainMotion
from dousa.retrieval.forest.stretches import StretchJudge
from dousa.retrieval.takes.label import (
    SHORT_GAP,
    Segment,
    TakeLabeller,
    average_shares,
    check_threshold,
    describe_run,
    make_segment,
    weigh_chosen,
)
from dousa.retrieval.takes.moment_model import HOP, REACH, describe_chunk, sharpen
from dousa.retrieval.takes.repetitions import Chosen
from dousa.retrieval.takes.sequence import N_PHASES, Run
from dousa.retrieval.takes.windows import TAKE_RATE

# Frames needed before a moment, as channels are smoothed over time; after which its judgement hardly changes; and from
# which the body height is estimated, the first second (docs/takes.md).
_BEFORE, _AHEAD, _MEASURED = REACH + 40, 60, 30


@dataclass(frozen=True, slots=True)
class LiveAnswer:
    """The state of the labels at a moment.

    Parameters
    ----------
    time : s, of the last frame used.
    category : of the action that ends about now; None where it is unknown or not over yet.
    confidence : 0 to 1, as of a `Segment`.
    start : s, the beginning of that action; ``time`` where there is none.
    settled : segments settled since the last answer; together they are the timeline.
    guess : a category too doubtful for ``category``; else None.
    """

    time: float
    category: str | None
    confidence: float
    start: float
    settled: tuple[Segment, ...] = ()
    guess: str | None = None

    def to_json(self) -> dict[str, Any]:
        """Return plain words and numbers; times in seconds."""
        return {
            "time_s": round(self.time, 3),
            "category": self.category,
            "unknown": self.category is None,
            "perhaps": self.guess is not None,
            "guess": self.guess,
            "confidence": round(self.confidence, 4),
            "start_s": round(self.start, 3),
            "settled": [segment.to_json() for segment in self.settled],
        }


class LiveLabeller:
    """A labeller of frames as they arrive.

    Parameters
    ----------
    labeller : as for takes.
    height : m, of the performer; None to estimate it from the first second.
    threshold, judge : as for takes; the judge sees only the kept end of a long segment.

    Raises
    ------
    OptionError : a height or threshold out of range.
    """

    def __init__(
        self,
        labeller: TakeLabeller,
        *,
        height: float | None = None,
        threshold: float | None = None,
        judge: StretchJudge | None = None,
    ) -> None:
        if height is not None and not 0 < height < np.inf:
            raise OptionError("live.height_option", found=height)
        check_threshold(threshold)
        self.height = height
        self._labeller, self._judge = labeller, judge
        self._threshold = threshold
        self._sampler = _Sampler(2 * (_BEFORE + _AHEAD) + _MEASURED)
        self._settled = 0  # moments with a settled label
        self._scores = np.zeros((0, N_PHASES * len(labeller.classes) + 1), np.float32)  # of the moments after those

    def push(self, positions: ArrayLike, time: float) -> LiveAnswer | None:
        """Add canonical joints (20, 3) m, Y up, at a time in s; return an answer five times a second, else None.

        InvalidMotionError : another shape, positions that are not finite, a time not after the last, or over 2 s later.
        """
        points = np.asarray(positions, np.float64)
        if points.shape != (len(CANONICAL_JOINTS), 3) or not np.isfinite(points).all():
            raise InvalidMotionError("live.frame_shape", shape=points.shape)
        self._sampler.push(points, float(time))
        if self._sampler.count < (self._settled + len(self._scores) + 1) * HOP or not self._know_height():
            return None
        self._describe(self._sampler.count // HOP)
        return self._answer(self._settle())

    def finish(self) -> LiveAnswer | None:
        """Return the last answer, with all that was not settled; None if there was no frame."""
        self._sampler.flush()
        if not self._sampler.count:
            return None
        if self._know_height(at_once=True):
            self._describe(-(-self._sampler.count // HOP))
        return self._answer(self._settle(rest=True))

    def _know_height(self, *, at_once: bool = False) -> bool:
        if self.height is None and (at_once or self._sampler.count >= _MEASURED):
            height = float(chain_height(self._sampler.last(_MEASURED)))
            if not height > 0:
                raise InvalidMotionError("live.no_height")
            self.height = height
        return self.height is not None

    def _describe(self, n_moments: int) -> None:
        """Judge the new moments, and earlier ones whose surroundings have changed."""
        n_new = max(n_moments - self._settled - len(self._scores), 0)
        first = max(n_moments - _AHEAD // HOP - n_new, self._settled)
        begin = max(first * HOP - _BEFORE, self._sampler.oldest)
        begin = -(-begin // HOP) * HOP
        sampled = self._sampler.last(self._sampler.count - begin)
        _, values = describe_chunk(sampled, float(self.height or 1.0), 0)
        judged = self._labeller.model.judge(values[first - begin // HOP : n_moments - begin // HOP])
        self._scores = np.concatenate([self._scores[: first - self._settled], judged])

    def _settle(self, *, rest: bool = False, longest: int = 300) -> tuple[Segment, ...]:
        """Return the segments that are settled now, in order; with ``rest``, all.

        More than ``longest`` open moments, a minute, settle the first segment.
        """
        runs = self._runs()
        done = runs if rest else [run for run in runs[:-1] if run.stop <= len(self._scores) - 2 * _AHEAD // HOP]
        if not done and len(self._scores) > longest:
            done = runs[:1]
        settled = tuple(self._segment(run, last=rest and run is done[-1]) for run in done)
        if done:
            self._scores = self._scores[done[-1].stop :]
            self._settled += done[-1].stop
        return settled

    def _runs(self) -> list[Run]:
        """Return the likeliest sequence after the settled part; short gaps join the action after them."""
        runs = self._labeller.sequence.find_runs(self._share(), never_nothing=self._threshold == 0)
        nothing, joined = len(self._labeller.classes), list[Run]()
        for run in runs:
            before = joined[-1] if joined else None
            short = before is not None and before.state == nothing and (before.stop - before.start) * HOP <= SHORT_GAP
            joined[len(joined) - short :] = [Run(before.start if before and short else run.start, run.stop, run.state)]
        return joined

    def _share(self) -> NDArray[np.float32]:
        return sharpen(self._scores, self._labeller.model.sharpness) if len(self._scores) else self._scores

    def _segment(self, run: Run, *, last: bool = False) -> Segment:
        start, stop = (self._sampler.time_of((self._settled + edge) * HOP) for edge in (run.start, run.stop))
        stop = self._sampler.time_of(self._sampler.count) if last else stop
        if run.state == len(self._labeller.classes):
            return Segment(start, stop, None, 1.0)
        weighed = self._weigh(run)
        known = weighed.likely if self._threshold is None else weighed.confidence >= self._threshold
        return make_segment(weighed, (start, stop), self._labeller.classes[weighed.category], said=known)

    def _weigh(self, run: Run) -> Chosen:
        """Weigh a run of a category by the part of it that is kept."""
        evidence = describe_run(self._share(), run, self._labeller.sequence)
        begin = self._sampler.oldest
        start, stop = ((self._settled + edge) * HOP for edge in (run.start, run.stop))
        first, last = max(start - begin, 0), min(stop, self._sampler.count) - begin
        kept = Chosen(first, last, run.state, evidence, shares=average_shares(self._share(), run)[:-1])
        motion = PlainMotion(self._sampler.last(self._sampler.count - begin), TAKE_RATE, float(self.height or 1.0))
        # Without kept frames the labeller alone decides.
        return weigh_chosen(self._labeller, [kept], motion, self._judge if kept.stop > HOP else None)[0]

    def _answer(self, settled: tuple[Segment, ...]) -> LiveAnswer:
        time = self._sampler.time_of(self._sampler.count)
        runs = self._runs()
        if runs and runs[-1].state < len(self._labeller.classes):
            segment = self._segment(runs[-1])
            return LiveAnswer(time, segment.category, segment.confidence, segment.start, settled, segment.guess)
        return LiveAnswer(time, None, 1.0, time, settled)


class _Sampler:
    """The last frames, resampled to 30 Hz.

    Frames in the same thirtieth of a second are averaged; empty thirtieths are filled linearly.
    """

    def __init__(self, capacity: int) -> None:
        # Twice the room, so that frames are moved rarely.
        self._room = np.empty((2 * capacity, len(CANONICAL_JOINTS), 3))
        self._capacity, self._filled = capacity, 0
        self.count = 0
        self._begin: float | None = None
        self._time = 0.0
        self._bin, self._sum, self._many = 0, np.zeros((len(CANONICAL_JOINTS), 3)), 0

    @property
    def oldest(self) -> int:
        """Number of the first kept sample."""
        return self.count - min(self._filled, self._capacity)

    def time_of(self, sample: int) -> float:
        """Return the time at which a sample begins, s."""
        return (self._begin or 0.0) + sample / TAKE_RATE

    def last(self, count: int) -> FloatArray:
        """Return the last ``count`` samples, or as many as are kept."""
        return self._room[max(self._filled - count, 0) : self._filled]

    def push(self, points: FloatArray, time: float, longest_gap: float = 2.0) -> None:
        """Add a frame; gaps of up to ``longest_gap`` s are bridged linearly."""
        if self._begin is None:
            self._begin = self._time = time
        elif not 0 < time - self._time <= longest_gap:
            raise InvalidMotionError("live.order", gap=longest_gap, time=time, before=self._time)
        self._time = time
        # Times at 30 Hz with few digits must not fall into the thirtieth before.
        number = int((time - self._begin) * TAKE_RATE + 0.1)
        if number > self._bin and self._many:
            self._close(number, points)
        self._bin = number
        self._sum += points
        self._many += 1

    def flush(self) -> None:
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
    """A frame at ``time`` s with ``positions`` (20, 3) m; ``held`` joints were missing and keep their last place."""

    time: float
    positions: FloatArray
    held: tuple[str, ...] = ()


class LiveFrameParser:
    """A parser of lines of frames; ``height`` and ``frame_rate`` are those of the header, None if not given."""

    def __init__(self) -> None:
        self.height: float | None = None
        self.frame_rate: float | None = None
        self._last: FloatArray | None = None
        self._line = 0
        self._frames = 0

    def parse(self, line: str) -> LiveFrame | None:
        """Parse a line; None for an empty line and for the header; InvalidMotionError with its number for all else."""
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
        """Number of the last line read, from 1."""
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
        # NaN, which Python writes although JSON lacks it, is a missing joint like null.
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
    """Yield the frames of lines as they arrive; pass a ``parser`` to read its header afterwards.

    InvalidMotionError : a line that is no frame, with its number.
    """
    reader = parser or LiveFrameParser()
    for line in lines:
        frame = reader.parse(line)
        if frame is not None:
            yield frame
