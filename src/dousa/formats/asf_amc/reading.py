"""Reading of Acclaim ASF and AMC: a skeleton of bones in one file, its motion in another.

A joint is at the start of a bone (``lfemur`` at the hip) and turns by C M C^-1: M are the bone's channels, C the
orientation of its axes. The last bone of a chain gets an end site at its tip. ASF lengths are inches times the file's
``length``; an AMC file has no frame rate, 120 Hz is usual for CMU and HDM05.
"""

from __future__ import annotations

import functools
import os
import re
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import FloatArray, IntArray
from dousa.errors import MotionFileError
from dousa.files.disk import read_bytes
from dousa.formats.asf_amc.skeleton import AsfSkeleton, channel_program, read_asf
from dousa.formats.channels import build_motion
from dousa.formats.guard import Clock
from dousa.formats.numbers import Bytes, line_number, scan_short, scannable, settle
from dousa.kernels import kernel, part
from dousa.messages import Message
from dousa.motion.types import Motion

_DONE, _BAD_NUMBER, _MISSING, _UNKNOWN, _TWICE, _COUNT = range(6)
_LINE = re.compile(rb"[^\r\n]*")


@dataclass(frozen=True, slots=True)
class AmcHeader:
    """Header of an AMC file: start of the first frame, angles and rate."""

    first_frame_at: int
    degrees: bool | None
    frame_rate: float | None


@dataclass(frozen=True, slots=True, eq=False)
class _Tables:
    """A skeleton for the kernel: the letters of all names, their starts, the columns of every bone."""

    names: tuple[str, ...]
    letters: NDArray[np.uint8]
    name_starts: IntArray
    columns: IntArray
    follower: IntArray
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
            raise MotionFileError(path, "amc.header", line_number(data, position), found=shown)
        if words and words[0] in (b":degrees", b":radians"):
            degrees = words[0] == b":degrees"
        if len(words) == 2 and words[0] == b":samples-per-second" and re.fullmatch(rb"\d{1,5}(\.\d*)?", words[1]):
            rate = float(words[1]) or None
        position = (match.end() if match else position) + 1
    raise MotionFileError(path, "amc.no_frames", line_number(data, len(data)))


@part
def _find_bone(buffer: Bytes, start: int, end: int, names: Bytes, name_starts: IntArray) -> int:
    """Index of the bone named ``buffer[start:end]``; -1 if there is none."""
    for bone in range(len(name_starts) - 1):
        first = name_starts[bone]
        same = 0
        while same < end - start and buffer[start + same] == names[first + same]:
            same += 1
        if same == end - start and name_starts[bone + 1] - first == same:
            return bone
    return -1


@kernel
def _scan_frames(  # noqa: PLR0912, PLR0915
    buffer: Bytes,
    position: int,
    end: int,
    names: Bytes,
    name_starts: IntArray,
    columns: IntArray,
    last_seen: IntArray,
    follower: IntArray,
    out: FloatArray,
    numbers: FloatArray,
    notes: IntArray,
) -> tuple[int, int, int, int, int]:
    """Fill ``out`` (T, C) and ``numbers`` (T,) of the frames; bone b has the columns ``columns[b]:columns[b + 1]``.

    Tokens that are no short decimals go to ``notes`` (M, 2): position, index in out.
    ``last_seen`` holds -1 per bone, ``follower`` the bone expected next after each, learnt on the way.
    Returns (status, position, frames read, bone, tokens noted).
    """
    bones = len(columns) - 1
    needed = 0
    for bone in range(bones):
        needed += columns[bone + 1] > columns[bone]
    frame, seen, previous, noted = -1, needed, bones - 1, 0
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
            value: Any = 0
            digits = token
            while 48 <= buffer[digits] <= 57 and digits - token < 18:
                value = value * 10 + np.int64(buffer[digits]) - 48
                digits += 1
            if digits == position:
                if seen < needed:
                    break
                frame, seen = frame + 1, 0
                numbers[frame] = value
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
            while (buffer[position] == 32 or buffer[position] == 9) and position < end - 1:
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


def parse_frames(path: str, data: bytes, start: int, asf: AsfSkeleton) -> tuple[FloatArray, FloatArray]:
    """Parse channel values (T, C), root first, then the bones in the skeleton's order, and the frames' numbers (T,).

    Raises
    ------
    MotionFileError : an unknown, missing or repeated bone, a wrong count; with the line.
    """
    tables = _tables(asf)
    rows = (len(data) - start) // tables.smallest_frame + 2
    values = np.empty((rows, int(tables.columns[-1])))
    numbers = np.empty(rows)
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
        numbers,
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
    return values, numbers[:n_frames]


def _problem(
    data: bytes, status: int, position: int, n_frames: int, detail: int, tables: _Tables, asf: AsfSkeleton
) -> Message:
    line = _LINE.match(data, position)
    words = line[0].split() if line else []
    shown = words[0][:40].decode("ascii", "backslashreplace") if words else ""
    bone = tables.names[detail] if status in (_MISSING, _TWICE, _COUNT) else ""
    if status == _BAD_NUMBER:
        return Message("amc.bad_number", found=shown)
    if status == _MISSING:
        return Message("amc.missing", frame=n_frames, bone=bone)
    if status == _UNKNOWN:
        return Message("amc.unknown_bone", bone=shown, skeleton=asf.path)
    if status == _TWICE:
        return Message("amc.twice", bone=bone)
    wanted = tables.columns[detail + 1] - tables.columns[detail]
    return Message("amc.count", expected=wanted, bone=bone, found=len(words) - 1)


TOP = ".dousa-top"
"""A file of this name in a folder: what lies above does not belong to the motions here, and is not looked at."""


def read_amc(
    path: str | os.PathLike[str],
    *,
    skeleton: str | os.PathLike[str] | None = None,
    unit: float | None = None,
    up: str | None = None,
) -> Motion:
    """Read an Acclaim motion with its skeleton.

    The rate is ``:SAMPLES-PER-SECOND``, else that of a name ending in ``_120`` as in HDM05, else 120 Hz.

    Parameters
    ----------
    path : the ``.amc`` file.
    skeleton : its ``.asf``; by default the one of the same name or of the actor part of the name (``HDM_bd.asf`` for
        ``HDM_bd_squat.amc``, ``86.asf`` for ``86_01.amc``), else the only one, in the same folder or up to three above,
        no further than a folder that holds a file `TOP`.
    unit : metres per unit of the file; by default that of the ASF if the body is then 0.4 to 3 m tall, else inferred.
    up : axis of the file that points up; by default y unless the body stands along another.

    Raises
    ------
    MotionFileError : a file is missing or damaged, no or several skeletons fit; with the line.
    """
    name = os.fspath(path)
    data = scannable(read_bytes(path))
    asf = read_asf(skeleton if skeleton is not None else find_skeleton(name))
    header = parse_header(name, data)
    values, numbers = parse_frames(name, data, header.first_frame_at, asf)
    degrees = asf.degrees if header.degrees is None else header.degrees
    clock = Clock(header.frame_rate or _rate_of_name(name), numbers=numbers)
    program = channel_program(asf, degrees)
    return build_motion(name, "amc", program, values, clock, unit=unit, up=up, declared_unit=asf.declared_unit)


def _rate_of_name(path: str) -> float:
    found = re.search(r"HDM_.*_(\d{2,3})\.amc$", os.path.basename(path), re.IGNORECASE)
    return float(found[1]) if found and int(found[1]) > 0 else 120.0


def find_skeleton(path: str, levels: int = 4) -> str:
    """Find the ``.asf`` of a motion in so many folders, from its own upwards; names without regard to case."""
    folder, name = os.path.split(os.path.abspath(path))
    folders: list[str] = []
    while len(folders) < levels and folder not in folders:
        folders.append(folder)
        if os.path.exists(os.path.join(folder, TOP)):
            break
        folder = os.path.dirname(folder)
    stems = _shorter_names(os.path.splitext(name)[0].lower())
    for folder in folders:
        by_stem = _skeletons_in(folder, _modified(folder))
        for stem in stems:
            if stem in by_stem:
                return os.path.join(folder, by_stem[stem])
    for folder in folders:
        skeletons = list(_skeletons_in(folder, _modified(folder)).values())
        if len(skeletons) == 1:
            return os.path.join(folder, skeletons[0])
        if skeletons:
            raise MotionFileError(path, "amc.several_skeletons", skeletons=skeletons[:8], folder=folder)
    raise MotionFileError(path, "amc.no_skeleton", levels=levels - 1)


def _shorter_names(stem: str) -> list[str]:
    """The whole name, then without its last parts: ``hdm_bd_walk``, ``hdm_bd``, ``hdm``."""
    parts = re.split(r"([_\-. ])", stem)
    return ["".join(parts[:count]) for count in range(len(parts), 0, -2)]


def _modified(folder: str) -> int:
    try:
        return os.stat(folder).st_mtime_ns
    except OSError:
        return -1


@functools.lru_cache(maxsize=256)
def _skeletons_in(folder: str, modified: int) -> dict[str, str]:
    """The ``.asf`` files of a folder by stem in lower case; cached for all motions of the folder."""
    try:
        with os.scandir(folder) as entries:
            names = sorted(entry.name for entry in entries if entry.name.lower().endswith(".asf"))
    except OSError:
        return {}
    return {os.path.splitext(name)[0].lower(): name for name in names}
