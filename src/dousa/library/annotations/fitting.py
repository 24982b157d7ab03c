"""Labels and the take that they are laid onto: what is cut or left out, and tables that do not fit it at all."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from math import isfinite
from pathlib import PurePath
from typing import Any, Self

from dousa.errors import DousaError, MotionFileError, OptionError
from dousa.formats.annotations.label_file import leave_out_twice
from dousa.library.labels import check_labels
from dousa.messages import Message
from dousa.motion.annotation import Annotation, Stretch

LEAST_FRAMES = 2
"""Of a segment: one pose is no motion."""

_FAR = 3.0  # durations of the take: whole numbers up to there may be no seconds
_COVERED = 0.25  # of the take, by times that are whole numbers of something else than seconds
_SLACK = 1.05


@dataclass(frozen=True, slots=True)
class TakeLength:
    """How long a take is.

    Parameters
    ----------
    path : of the take, for messages.
    duration : s.
    frame_rate : Hz.
    n_frames : of the take.
    """

    path: str
    duration: float
    frame_rate: float
    n_frames: int

    @classmethod
    def of(cls, row: Any) -> Self:
        """That of a row of ``clips``."""
        return cls(row.path, row.duration, row.frame_rate, row.n_frames)

    def find_frames(self, segment: Stretch) -> tuple[int, int]:
        """The first frame of a segment, and the one after its last."""
        first, stop = round(segment.start * self.frame_rate), round(segment.stop * self.frame_rate)
        return max(first, 0), min(stop, self.n_frames)


def fit(take: TakeLength, segments: Iterable[Stretch]) -> tuple[list[Stretch], list[Message]]:
    """Segments within a take in the order of time, each once; and what was cut or left out."""
    once, twice = leave_out_twice(sorted(segments, key=lambda one: (one.start, one.stop)))
    kept, cut, beyond, short = [], [], [], []
    for one in once:
        part = replace(one, start=max(one.start, 0.0), stop=min(one.stop, take.duration))
        first, last = take.find_frames(part)
        if last - first >= LEAST_FRAMES:
            kept.append(part)
            if one.stop - take.duration > 1.0 / take.frame_rate:
                cut.append(one)
        elif one.start >= take.duration or one.stop <= 0.0:
            beyond.append(one)
        else:
            short.append(one)
    # What was cut to the same place counts once, too: the labels say no more of it.
    kept, same = leave_out_twice(kept)
    notes = [note for _, note in twice or same]
    if cut:
        end = {"start": cut[0].start, "stop": cut[0].stop, "category": cut[0].category}
        notes.append(Message("annotations.past_end", n=len(cut), duration=take.duration, **end))
    if beyond:
        end = {"start": beyond[0].start, "stop": beyond[0].stop, "category": beyond[0].category}
        notes.append(Message("annotations.beyond", n=len(beyond), duration=take.duration, **end))
    if short:
        notes.append(Message("annotations.too_short", n=len(short), start=short[0].start, category=short[0].category))
    return kept, notes


def check_fit(take: TakeLength, labels: Annotation) -> None:
    """Find a table that is not about a take, before it empties the take.

    Raises
    ------
    MotionFileError : none of the labels of the table lies in the take, or all are too short for it, or they count
        milliseconds or frames; with the table and the line.
    OptionError : the same of labels that came from no table.
    """
    if not labels.segments:
        return
    kept, _ = fit(take, labels.segments)
    unit = _guess_unit(take, labels.segments, 0.0 if not kept else _COVERED)
    if kept and unit is None:
        return
    outside = [one for one in labels.segments if one.stop > take.duration or one.stop <= 0.0]
    first = min(outside or labels.segments, key=lambda one: (one.start, one.stop))
    values = {"start": first.start, "stop": first.stop, "category": first.category, "take": PurePath(take.path).name}
    if unit is None and not outside:
        raise _about(labels, first, Message("annotations.all_short", **values))
    remedy = unit or Message("annotations.other_take", n=len(labels.segments))
    raise _about(labels, first, Message("annotations.outside", duration=take.duration, remedy=remedy, **values))


def _about(labels: Annotation, segment: Stretch, problem: Message) -> DousaError:
    return MotionFileError(labels.source, problem, segment.line) if labels.source else OptionError(problem)


def _guess_unit(take: TakeLength, segments: Sequence[Stretch], covered: float) -> Message | None:
    """What the times look like that are no seconds; None where they may be.

    Parameters
    ----------
    covered : share of the take that they cover at least, counted in that unit.
    """
    times = [time for one in segments for time in (one.start, one.stop)]
    last = max(times)
    if last < _FAR * take.duration or any(time != int(time) for time in times):
        return None
    for scale, unit in (
        (take.frame_rate, Message("annotations.in_frames", rate=take.frame_rate)),
        (1000.0, Message("annotations.in_ms")),
    ):
        if covered * take.duration <= last / scale <= _SLACK * take.duration:
            return unit
    return None


def check_times(start: float, stop: float, category: str | None) -> None:
    """OptionError for times that are no part of a recording: no numbers, or an end that is not after the beginning."""
    if not (_is_time(start) and _is_time(stop)):
        raise OptionError("label_files.no_time", found=f"{start}, {stop}")
    if stop <= start:
        raise OptionError("label_files.backwards", start=start, stop=stop, category=category or "")


def _is_time(value: object) -> bool:
    try:
        return isfinite(value)  # type: ignore[arg-type]
    except (TypeError, OverflowError):
        return False


def check_annotation(labels: Annotation) -> None:
    """OptionError for labels that cannot be: times as in `check_times`, a category that is empty or too long."""
    for one in labels.segments:
        check_labels(one.category)
        check_times(one.start, one.stop, one.category)
    for start, stop in labels.unclear:
        check_times(start, stop, None)
