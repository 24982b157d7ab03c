"""Furi files: a person says where the figures of a dance begin and end.

One line a figure, ``start end [label]``; what follows ``#`` is a comment:

    1-70     hand 1     # frames, from 1, the last one included
    71-100   turn
    0:03.3 0:05.0 hand 2   # minutes and seconds
    5.0s, 6.5s             # seconds; commas, semicolons and tabs part as well as spaces do

Figures of one label share one eigenspace; without a label a figure is alone. Between figures there may be gaps,
which are not judged, but no overlap.
"""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from contextlib import suppress
from itertools import pairwise

from dousa.errors import MotionFileError, MotionWriteError, OptionError
from dousa.evaluation.furi import Furi, name_label

__all__ = ["can_hold", "format_furi", "read_furi", "uncovered", "write_furi"]

_MOST_BYTES = 1_000_000
_SLACK_S = 0.1  # people round: the last figure may end so much after the dance
_SHOWN = 40  # letters of a wrong line in a message
_LONGEST_LABEL = 100  # letters; a whole line of a page
_VALUE = r"[^\s,;\-–—−~〜～]+"
_LINE = re.compile(rf"({_VALUE})\s*[\s,;\-–—−~〜～]\s*({_VALUE})(?:[\s,;]+(.*))?", re.DOTALL)
_HEADING = re.compile(r"(start|begin|from|開始)\w*[\s,;]+(end|stop|to|終了)\w*([\s,;].*)?", re.IGNORECASE)
_FRAME = re.compile(r"\d{1,20}", re.ASCII)
_SECONDS = re.compile(r"(\d{1,9}(?:\.\d{0,9})?|\.\d{1,9})s(?:ec)?", re.ASCII | re.IGNORECASE)
_CLOCK = re.compile(r"(?:(\d{1,4}):)?(\d{1,6}):(\d{1,2}(?:\.\d{0,9})?)", re.ASCII)
_FORM = "expected 'start end [label]' in frames (1-70), seconds (1.5s 3s) or minutes (0:01.5 0:03)"


def read_furi(path: str | os.PathLike[str], frame_rate: float, n_frames: int) -> tuple[Furi, ...]:
    """Read where the figures of a dance begin and end.

    Parameters
    ----------
    path : text as the module's docstring says.
    frame_rate : Hz, of the reference.
    n_frames : of the reference.

    Returns
    -------
    Figures in order of time; `uncovered` tells what lies between them.

    Raises
    ------
    MotionFileError : the file cannot be read or has no figure; a line that is none; a figure that ends before it
        begins, lies outside the reference, or overlaps another.
    """
    found: list[tuple[int, int, str, int]] = []
    for number, line in enumerate(_read_text(path).splitlines(), 1):
        content = line.partition("#")[0].strip()
        if not content or (not found and _HEADING.fullmatch(content)):
            continue
        try:
            found.append((*_parse_line(content, frame_rate, n_frames), number))
        except ValueError as error:
            raise MotionFileError(path, str(error), number) from None
    if not found:
        raise MotionFileError(path, f"{_FORM}, got no line")
    found.sort()
    for (_, end, _, one), (start, _, _, other) in pairwise(found):
        if start < end:
            raise MotionFileError(
                path, f"this figure and the one of line {min(one, other)} overlap", max(one, other)
            )
    return _name(found)


def _read_text(path: str | os.PathLike[str]) -> str:
    try:
        # Not the size that the system tells: a device or a pipe has none, and may never end.
        with open(path, "rb") as file:
            data = file.read(_MOST_BYTES + 1)
        if len(data) > _MOST_BYTES:
            raise MotionFileError(path, "expected a furi file of a few lines, got a file of over 1 MB")
        text = data.decode("utf-8-sig")
    except OSError as error:
        raise MotionFileError(path, f"the furi file cannot be read: {error.strerror or error}") from error
    except UnicodeDecodeError as error:
        raise MotionFileError(path, f"expected text in UTF-8: {error}") from error
    except ValueError as error:  # a zero byte in the name
        raise MotionFileError(path, f"not the name of a file: {error}") from error
    if "\0" in text:
        raise MotionFileError(path, "expected a text file, got zero bytes")
    return text


def _parse_line(content: str, frame_rate: float, n_frames: int) -> tuple[int, int, str]:
    """Start, end (not included) and label; a ValueError says what is wrong."""
    match = _LINE.fullmatch(content)
    if match is None:
        raise ValueError(f"{_FORM}, got {_quote(content)}")
    first, last, label = match[1], match[2], _clean(match[3] or "")
    if len(label) > _LONGEST_LABEL:
        raise ValueError(
            f"expected a label of at most {_LONGEST_LABEL} letters, got {len(label)}: {_quote(label)}"
        )
    if _FRAME.fullmatch(first) and _FRAME.fullmatch(last):
        start, end = int(first) - 1, int(last)
        if start < 0 or end > n_frames:
            raise ValueError(f"expected frames 1 to {n_frames}, got {first} to {last}")
    else:
        times = [text for text in (first, last) if not _FRAME.fullmatch(text)]
        seconds = [_parse_time(text) for text in times]
        if len(times) == 1:
            raise ValueError(f"expected both ends in frames or both in time, got {first} to {last}")
        if seconds[1] > n_frames / frame_rate + _SLACK_S:
            raise ValueError(
                f"expected times up to {n_frames / frame_rate:.3f} s, the end of the dance, got {last}"
            )
        start, end = (min(round(s * frame_rate), n_frames) for s in seconds)
    if start >= end:
        raise ValueError(f"expected an end after the start, got {first} to {last}")
    return start, end, label


def _parse_time(text: str) -> float:
    """Seconds."""
    if match := _SECONDS.fullmatch(text):
        return float(match[1])
    if match := _CLOCK.fullmatch(text):
        return 3600.0 * int(match[1] or 0) + 60.0 * int(match[2]) + float(match[3])
    remedy = "; seconds are written with an s (1.5s)" if re.fullmatch(r"\d*\.\d*", text) else ""
    raise ValueError(f"expected a frame (70), seconds (1.5s) or minutes (0:01.5), got {_quote(text)}{remedy}")


def _clean(label: str) -> str:
    return " ".join(label.split()).strip("\"' ")


def _quote(text: str) -> str:
    return repr(text if len(text) <= _SHOWN else text[:_SHOWN] + "...")


def _name(found: Sequence[tuple[int, int, str, int]]) -> tuple[Furi, ...]:
    """Figures without a label get one that no other has."""
    given = {label for _, _, label, _ in found}
    names = (name for number in range(2 * len(found)) if (name := name_label(number)) not in given)
    return tuple(Furi(start, end, label or next(names)) for start, end, label, _ in found)


def write_furi(path: str | os.PathLike[str], furi: Sequence[Furi], frame_rate: float) -> None:
    """Write figures so that `read_furi` reads the same; the file appears whole or not at all.

    Parameters
    ----------
    path : text file to write or replace.
    furi : figures.
    frame_rate : Hz, for the times in the comments.

    Raises
    ------
    OptionError : a label that a furi file cannot hold: empty, with ``#``, with spaces, commas or quotes around it,
        longer than 100 letters.
    MotionWriteError : the folder is missing or read-only, or the disk is full.
    """
    text = format_furi(furi, frame_rate)
    target = os.path.realpath(path)
    part = os.path.join(os.path.dirname(target), f".{os.path.basename(target)}.{os.getpid()}.part")
    try:
        with open(part, "w", encoding="utf-8", newline="\n") as file:
            file.write(text)
        os.replace(part, target)
    except OSError as error:
        with suppress(OSError):
            os.unlink(part)
        raise MotionWriteError(path, f"the furi file cannot be written: {error.strerror or error}") from error


def format_furi(furi: Sequence[Furi], frame_rate: float) -> str:
    """The text of a furi file.

    Raises
    ------
    OptionError : a label that a furi file cannot hold.
    """
    lines = [f"# start-end label, frames from 1, last one included, {frame_rate:g} frames/s"]
    for figure in furi:
        if not can_hold(figure.label):
            raise OptionError(
                f"furi: the label {figure.label[:_SHOWN]!r} cannot be written to a furi file; choose plain words"
            )
        times = f"{_clock(figure.start / frame_rate)} to {_clock(figure.end / frame_rate)}"
        lines.append(f"{figure.start + 1}-{figure.end} {figure.label}  # {times}")
    return "\n".join(lines) + "\n"


def can_hold(label: str) -> bool:
    """Whether a furi file can hold a label."""
    match = _LINE.fullmatch(f"1-2 {label}")
    plain = label.isprintable() and "#" not in label
    whole = match is not None and match[3] == label == _clean(label)
    return plain and whole and 0 < len(label) <= _LONGEST_LABEL


def _clock(seconds: float) -> str:
    minutes, rest = divmod(round(1000 * seconds), 60_000)
    return f"{minutes}:{rest / 1000:06.3f}"


def uncovered(furi: Sequence[Furi], n_frames: int) -> tuple[tuple[int, int], ...]:
    """Stretches of the reference that belong to no figure, and so are not judged.

    Parameters
    ----------
    furi : in order of time.
    n_frames : of the reference.

    Returns
    -------
    (start, end) frames, the end not included.
    """
    places = [0, *(frame for figure in furi for frame in (figure.start, figure.end)), n_frames]
    return tuple((a, b) for a, b in zip(places[::2], places[1::2], strict=True) if a < b)
