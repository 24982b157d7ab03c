"""Biovision BVH: a tree of joints with Euler angles, one line of channel values a frame.

Read as the files in use are: any order and number (0 to 6) of channels on any joint, position channels
that replace the OFFSET, several end sites, any line ends, ``nan`` for a missing value. The file's own numbers
stay with the motion (``motion.provenance``), so that writing an unchanged motion keeps every value. A BVH file says
neither its unit nor its up axis: both are inferred, or given by the caller.
"""

from __future__ import annotations

import os
import re

import numpy as np

from dousa._files import read_bytes
from dousa.errors import MotionFileError
from dousa.formats._bvh_hierarchy import BvhLayout, BvhSyntaxError, parse_hierarchy
from dousa.formats._bvh_writer import write_bvh
from dousa.formats._channels import FileUnits, build_motion
from dousa.formats._numbers import DONE, FULL, line_number, parse_number, scan_rows, scannable, settle
from dousa.motion._types import FloatArray, Motion, Provenance

__all__ = ["BvhLayout", "read_bvh", "write_bvh"]

_LONGEST_HIERARCHY = 10_000_000  # bytes searched for an unusual spelling; a skeleton takes some thousand
_HIERARCHY = re.compile(rb"(?:\xef\xbb\xbf)?\s*HIERARCHY\b", re.IGNORECASE)
_MOTION = re.compile(rb"(?:^|(?<=[\r\n}]))[ \t]*MOTION\b", re.IGNORECASE)
_FRAMES = re.compile(rb"\s*Frames[ \t]*:?[ \t]*(\S*)", re.IGNORECASE)
_FRAME_TIME = re.compile(rb"\s*Frame[ \t]*Time[ \t]*:?[ \t]*(\S*)", re.IGNORECASE)


def read_bvh(path: str | os.PathLike[str], *, unit: float | None = None, up: str | None = None) -> Motion:
    """Read a BVH file.

    Parameters
    ----------
    path : the file.
    unit : metres per unit of the file; by default inferred from the height of the body.
    up : axis of the file that points up, such as ``"y"`` or ``"z"``; by default inferred.

    Returns
    -------
    Motion in metres, Y up. ``provenance.layout`` is a `BvhLayout`, ``provenance.values`` (T, C) the channel values
    as they stand in the file. A frame time that is a usual rate rounded (0.0333333) gives that rate (30).

    Raises
    ------
    MotionFileError : the file is missing or damaged; with the line.
    """
    data = scannable(read_bytes(path))
    try:
        return _parse(os.fspath(path), data, FileUnits(unit, up))
    except BvhSyntaxError as error:
        raise MotionFileError(path, error.problem, line_number(data, error.position)) from None


def _parse(path: str, data: bytes, units: FileUnits) -> Motion:
    start = _HIERARCHY.match(data)
    if start is None:
        raise BvhSyntaxError("expected HIERARCHY; is this a BVH file?", 0)
    motion = _find_motion(data, start.end())
    section = data[start.end() : motion.start()]
    try:
        hierarchy = parse_hierarchy(section)
    except BvhSyntaxError as error:
        raise BvhSyntaxError(error.problem, error.position + start.end()) from None
    if hierarchy.n_channels == 0:
        raise BvhSyntaxError("no joint has CHANNELS, so there is no motion to read", start.end())
    n_frames, frames_at, frame_time, values_at = _parse_motion_header(data, motion.end())
    values = _read_values(data, values_at, hierarchy.n_channels, n_frames, frames_at)
    layout = BvhLayout(hierarchy.channels, hierarchy.offsets, frame_time, hierarchy.encoding)
    provenance = Provenance(path, "bvh", layout=layout, values=values)
    return build_motion(path, hierarchy.program, values, layout.frame_rate, provenance, units)


def _find_motion(data: bytes, start: int) -> re.Match[bytes]:
    quick = data.find(b"\nMOTION", start)
    found = _MOTION.match(data, quick + 1) if quick >= 0 else None
    # The usual spelling may stand behind an unusual one only in a damaged file, which fails later anyway.
    found = found or _MOTION.search(data, start, start + _LONGEST_HIERARCHY)
    if found is None:
        raise BvhSyntaxError(
            "expected MOTION after the HIERARCHY, found none; is the file truncated?", len(data)
        )
    return found


def _parse_motion_header(data: bytes, position: int) -> tuple[int, int, str, int]:
    """Number of frames, where that stands, frame time as spelt, where the values begin."""
    frames = _FRAMES.match(data, position)
    if frames is None or not re.fullmatch(rb"\d{1,18}", frames[1]):
        at = _next_text(data, position)
        raise BvhSyntaxError(f"expected 'Frames: N' after MOTION, got '{_show_line(data, at)}'", at)
    n_frames = int(frames[1])
    if n_frames == 0:
        raise BvhSyntaxError("the file says 'Frames: 0': there is no motion in it", frames.start(1))
    time = _FRAME_TIME.match(data, frames.end())
    if time is None:
        raise BvhSyntaxError("expected 'Frame Time: SECONDS' after 'Frames:'", _next_text(data, frames.end()))
    seconds = parse_number(time[1])
    if seconds is None or not 1e-6 <= seconds <= 1e6:
        shown = time[1][:40].decode("ascii", "backslashreplace")
        raise BvhSyntaxError(
            f"expected a frame time above 0 in seconds, from 1e-6 to 1e6, got '{shown}'", time.start(1)
        )
    return n_frames, frames.start(1), time[1].decode("ascii"), time.end()


def _show_line(data: bytes, start: int) -> str:
    """The beginning of a line, to be shown in a message."""
    return re.split(rb"[\r\n]", data[start : start + 60])[0].decode("ascii", "backslashreplace").rstrip()


def _next_text(data: bytes, position: int) -> int:
    found = re.compile(rb"\S").search(data, position)
    return found.start() if found else len(data)


def _read_values(data: bytes, start: int, columns: int, n_frames: int, frames_at: int) -> FloatArray:
    """Channel values (T, C); no more memory than the bytes at hand can fill."""
    # A value takes two bytes, itself and the space after it.
    rows = min(n_frames, (len(data) - start) // (2 * columns) + 1)
    values = np.empty((rows, columns))
    notes = np.empty((rows * columns, 2), np.int64)
    flat = values.reshape(-1)
    status, position, filled, noted = scan_rows(
        np.frombuffer(data, np.uint8), start, len(data), columns, flat, notes
    )
    bad = settle(data, notes[:noted], flat)
    if bad is not None:
        raise BvhSyntaxError(bad[1], bad[0])
    if status == FULL:
        found = rows + sum(1 for line in data[position:].splitlines() if line.strip())
        raise BvhSyntaxError(_wrong_count(n_frames, found), frames_at)
    if status != DONE:
        line = data[position:].lstrip().splitlines()[0]
        problem = f"expected {columns} channel values, got {len(line.split())}; is the file truncated?"
        raise BvhSyntaxError(problem, position)
    if filled != n_frames * columns:
        raise BvhSyntaxError(_wrong_count(n_frames, filled // columns), frames_at)
    values.flags.writeable = False
    return values


def _wrong_count(declared: int, found: int) -> str:
    problem = f"the file says {declared} frames, but {found or 'none'} follow; is it truncated or edited?"
    return f"{problem} If the frames are all there, write 'Frames: {found}'" if found else problem
