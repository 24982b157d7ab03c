"""The frames of an AMC file: a line with the frame number, then one line per bone."""

from __future__ import annotations

import functools
import re
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from dousa.errors import MotionFileError
from dousa.formats._amc_skeleton import AsfSkeleton
from dousa.formats._numbers import line_number, scan_short, settle
from dousa.motion._types import FloatArray

__all__ = ["AmcHeader", "parse_frames", "parse_header"]

_DONE, _BAD_NUMBER, _SKIPPED, _MISSING, _UNKNOWN, _TWICE, _COUNT = range(7)
_LINE = re.compile(rb"[^\r\n]*")


@dataclass(frozen=True, slots=True)
class AmcHeader:
    """What stands before the first frame: where that begins, what the file says about angles and rate."""

    first_frame_at: int
    degrees: bool | None
    frame_rate: float | None


@dataclass(frozen=True, slots=True, eq=False)
class _Tables:
    """A skeleton as the kernel needs it: the letters of all names, their starts, the columns of every bone."""

    names: tuple[str, ...]
    letters: NDArray[np.uint8]
    name_starts: NDArray[np.int64]
    columns: NDArray[np.int64]
    follower: NDArray[np.int64]
    smallest_frame: int  # bytes


def parse_header(path: str, data: bytes) -> AmcHeader:
    """Read comments and keywords up to the first line that is a frame number."""
    position, degrees, rate = 0, None, None
    while position < len(data):
        match = _LINE.match(data, position)
        text = match[0].strip() if match else b""
        if text.isdigit():
            return AmcHeader(position, degrees, rate)
        words = text.removeprefix(b"\xef\xbb\xbf").lower().split()
        if words and not words[0].startswith((b":", b"#")):
            shown = text[:40].decode("ascii", "backslashreplace")
            problem = f"expected a comment, a keyword or the number of the first frame, got '{shown}'"
            raise MotionFileError(path, problem, line_number(data, position))
        if words and words[0] in (b":degrees", b":radians"):
            degrees = words[0] == b":degrees"
        if (
            len(words) == 2
            and words[0] == b":samples-per-second"
            and re.fullmatch(rb"\d{1,5}(\.\d*)?", words[1])
        ):
            rate = float(words[1]) or None
        position = (match.end() if match else position) + 1
    raise MotionFileError(path, "no frames; is the file truncated?", line_number(data, len(data)))


@njit(cache=True, nogil=True)
def _find_bone(buffer, start, end, names, name_starts):
    """Index of the bone named ``buffer[start:end]``; -1 if there is none."""
    for bone in range(len(name_starts) - 1):
        first = name_starts[bone]
        same = 0
        while same < end - start and buffer[start + same] == names[first + same]:
            same += 1
        if same == end - start and name_starts[bone + 1] - first == same:
            return bone
    return -1


@njit(cache=True, nogil=True)
def _scan_frames(buffer, position, end, names, name_starts, columns, last_seen, follower, out, notes):  # noqa: PLR0911, PLR0912, PLR0915
    """Fill ``out`` (T, C); bone b has the columns ``columns[b]:columns[b + 1]``.

    Tokens that are no short decimals go to ``notes`` (M, 2): position, index in out.
    ``last_seen`` holds -1 per bone, ``follower`` the bone expected next after each: the order is learnt on the way.
    Returns (status, position, frames read, bone, tokens noted).
    """
    bones = len(columns) - 1
    needed = 0
    for bone in range(bones):
        needed += columns[bone + 1] > columns[bone]
    frame, number, seen, previous, noted = -1, 0, needed, bones - 1, 0
    while True:
        while position < end and buffer[position] <= 32:
            position += 1
        if position == end:
            break
        token = position
        # Nearly every line is the bone that followed last time: compare in place, look it up only if it is not.
        bone = follower[previous]
        letter, last = name_starts[bone], name_starts[bone + 1]
        while letter < last and buffer[position] == names[letter]:
            letter += 1
            position += 1
        if letter < last or buffer[position] > 32:
            while buffer[position] > 32:
                position += 1
            value, digits = 0, token
            while 48 <= buffer[digits] <= 57 and digits - token < 18:
                value = value * 10 + np.int64(buffer[digits]) - 48
                digits += 1
            if digits == position:
                if seen < needed:
                    break
                if frame >= 0 and value != number + 1:
                    return _SKIPPED, token, frame + 1, number, noted
                frame, number, seen = frame + 1, value, 0
                continue
            bone = _find_bone(buffer, token, position, names, name_starts)
            if bone < 0:
                return (_UNKNOWN if digits == token else _BAD_NUMBER), token, frame + 1, 0, noted
        if last_seen[bone] == frame:
            return _TWICE, token, frame + 1, bone, noted
        last_seen[bone] = frame
        seen += columns[bone + 1] > columns[bone]
        follower[previous] = bone
        previous = bone
        column, last = columns[bone], columns[bone + 1]
        while True:
            while (
                buffer[position] <= 32
                and buffer[position] != 10
                and buffer[position] != 13
                and position < end - 1
            ):
                position += 1
            if buffer[position] <= 32:
                break
            if column == last:
                return _COUNT, token, frame + 1, bone, noted
            start = position
            out[frame, column], position, short = scan_short(buffer, position)
            if not short:
                notes[noted, 0], notes[noted, 1] = start, frame * out.shape[1] + column
                noted += 1
            column += 1
        if column != last:
            return _COUNT, token, frame + 1, bone, noted
    if seen < needed:
        for bone in range(bones):
            if last_seen[bone] < frame and columns[bone + 1] > columns[bone]:
                return _MISSING, position, frame + 1, bone, noted
    return _DONE, position, frame + 1, 0, noted


@functools.lru_cache(maxsize=64)
def _tables(asf: AsfSkeleton) -> _Tables:
    names = ("root", *(bone.name for bone in asf.bones))
    widths = [len(asf.root_order), *(len(bone.dof) for bone in asf.bones)]
    encoded = [name.encode("latin-1") for name in names]
    return _Tables(
        names,
        letters=np.frombuffer(b"".join(encoded) + b"\n", np.uint8),
        name_starts=np.cumsum([0, *map(len, encoded)]),
        columns=np.cumsum([0, *widths]),
        follower=np.roll(np.arange(len(names)), -1),
        # Its number, the names, a space and a digit per value, line ends.
        smallest_frame=2 + sum(len(n) + 2 * w + 1 for n, w in zip(encoded, widths, strict=True) if w),
    )


def parse_frames(path: str, data: bytes, start: int, asf: AsfSkeleton) -> FloatArray:
    """Channel values (T, C) as they stand in the file: root first, then the bones in the skeleton's order.

    Raises
    ------
    MotionFileError : an unknown, missing or repeated bone, a wrong count, frames that skip; with the line.
    """
    tables = _tables(asf)
    rows = (len(data) - start) // tables.smallest_frame + 2
    values = np.empty((rows, int(tables.columns[-1])))
    notes = np.empty((values.size, 2), np.int64)
    status, position, n_frames, detail, noted = _scan_frames(
        np.frombuffer(data, np.uint8),
        start,
        len(data),
        tables.letters,
        tables.name_starts,
        tables.columns,
        np.full(len(tables.names), -1),
        tables.follower.copy(),
        values,
        notes,
    )
    bad = settle(data, notes[:noted], values)
    if bad is not None:
        raise MotionFileError(path, bad[1], line_number(data, bad[0]))
    if status != _DONE:
        problem = _problem(data, status, position, n_frames, detail, tables, asf)
        raise MotionFileError(path, problem, line_number(data, position))
    values = values[:n_frames].copy() if 2 * n_frames < rows else values[:n_frames]
    values.flags.writeable = False
    return values


def _problem(
    data: bytes, status: int, position: int, n_frames: int, detail: int, tables: _Tables, asf: AsfSkeleton
) -> str:
    line = _LINE.match(data, position)
    words = line[0].split() if line else []
    shown = words[0][:40].decode("ascii", "backslashreplace") if words else ""
    bone = tables.names[detail] if status in (_MISSING, _TWICE, _COUNT) else ""
    if status == _BAD_NUMBER:
        return f"expected a frame number or a bone, got '{shown}'"
    if status == _SKIPPED:
        return f"frame {detail + 1} expected after frame {detail}, got {shown}"
    if status == _MISSING:
        return f"frame {n_frames} of the file has no values for bone '{bone}'; is the file truncated?"
    if status == _UNKNOWN:
        return f"bone '{shown}' is not in {asf.path}; name the right skeleton with --skeleton"
    if status == _TWICE:
        return f"bone '{bone}' comes twice in one frame"
    wanted = tables.columns[detail + 1] - tables.columns[detail]
    return f"expected {wanted} values for '{bone}', got {len(words) - 1}; is the file truncated?"
