"""Reading of Biovision BVH: a tree of joints with Euler angles, one line of channel values a frame.

Accepts any order and number (0 to 6) of channels on any joint, position channels that replace the OFFSET, several end
sites, any line ends, ``nan`` for a missing value. The file's own numbers stay with the motion
(``motion.provenance``), so that writing an unchanged motion keeps every value. A BVH file declares neither unit nor up
axis: both are inferred, or given by the caller.
"""

from __future__ import annotations

import functools
import math
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from decimal import Decimal
from typing import Any

import numpy as np

from dousa.arrays import FloatArray
from dousa.errors import MotionFileError
from dousa.files.disk import read_bytes
from dousa.formats.channels import ChannelProgram, build_motion
from dousa.formats.guard import MOST_POINTS, Clock
from dousa.formats.numbers import (
    DONE,
    FULL,
    LONG,
    line_number,
    parse_number,
    read_plain_rows,
    scan_numbers,
    scannable,
)
from dousa.messages import Message
from dousa.motion.types import Motion, Skeleton

CHANNEL_NAMES = ("Xposition", "Yposition", "Zposition", "Xrotation", "Yrotation", "Zrotation")
_KINDS = {name.lower(): kind for kind, name in enumerate(CHANNEL_NAMES)}
_STATEMENT = re.compile(rb"[{}]|[^\r\n{}]+")
_KEYWORD = re.compile(rb"(?:ROOT|JOINT|END|ENDSITE|OFFSET|CHANNELS)(?!\S)", re.IGNORECASE)
_NUMBERED = re.compile(rb"(?:OFFSET|CHANNELS)(?!\S)", re.IGNORECASE)
_CONTROL = re.compile(rb"[\0-\x08\x0e-\x1f]")  # bytes that no text has
_JOINED = re.compile(rb"\s+(?=(?:JOINT|END|ENDSITE|OFFSET|CHANNELS)(?!\S))", re.IGNORECASE)


class BvhSyntaxError(ValueError):
    """A fault at a byte position of the file; turned into a MotionFileError by the reader."""

    def __init__(self, position: int, code: str | Message, /, **values: Any) -> None:
        self.message = code if isinstance(code, Message) else Message(code, **values)
        self.position = position
        super().__init__(self.message)


@dataclass(frozen=True, slots=True)
class BvhLayout:
    """Layout of a BVH file, kept so that writing gives the same file content.

    Parameters
    ----------
    channels : per joint (end sites included, without channels) its channel names in the order of the file.
    offsets : per joint its OFFSET in the file's unit and axes.
    frame_time : seconds per frame as the file spells them.
    encoding : encoding of the joint names, ``"utf-8"`` or ``"latin-1"``.
    """

    channels: tuple[tuple[str, ...], ...]
    offsets: tuple[tuple[float, float, float], ...]
    frame_time: str
    encoding: str = "utf-8"

    @property
    def n_channels(self) -> int:
        """Values per frame."""
        return sum(map(len, self.channels))

    def take(self, joints: list[int]) -> BvhLayout:
        """Return the layout of a file of these joints alone."""
        channels = tuple(self.channels[joint] for joint in joints)
        return BvhLayout(channels, tuple(self.offsets[joint] for joint in joints), self.frame_time, self.encoding)

    @property
    def frame_rate(self) -> float:
        """Hz: the only usual rate that rounds to the frame time, else one over the time."""
        usual = (
            24, 25, 30, 48, 50, 60, 72, 75, 90, 100, 120, 125, 144, 150, 180, 200, 240, 250, 300, 360, 480, 500
        )  # fmt: skip
        seconds, (_, digits, exponent) = float(self.frame_time), Decimal(self.frame_time).as_tuple()
        if len(digits) > 1 and isinstance(exponent, int) and exponent < 0:
            last = 10.0**exponent
            rounded = [rate for rate in usual if abs(1 / rate - seconds) <= 0.500001 * last]
            # 0.0166 is 60 Hz with the other digits cut off.
            near = rounded or [rate for rate in usual if seconds <= 1 / rate < seconds + last]
            if len(near) == 1:
                return float(near[0])
        return 1.0 / seconds


@dataclass(frozen=True, slots=True, eq=False)
class Hierarchy:
    """A parsed HIERARCHY section; offsets in file units."""

    program: ChannelProgram
    channels: tuple[tuple[str, ...], ...]
    offsets: tuple[tuple[float, float, float], ...]
    encoding: str
    n_channels: int


@dataclass(slots=True)
class _Joint:
    name: str
    parent: int
    position: int
    is_end: bool
    offset: tuple[float, float, float] | None = None
    channels: tuple[str, ...] | None = None


@dataclass(slots=True)
class _Parser:
    """Parser of statements; ``open`` are the joints with open braces, ``pending`` one without braces yet."""

    encoding: str
    joints: list[_Joint] = field(default_factory=list)
    open: list[int] = field(default_factory=list)
    pending: bool = False
    n_joints: int = 0

    def take(self, text: bytes, position: int) -> None:
        if text == b"{":
            self._open(position)
        elif text == b"}":
            self._close(position)
        elif self.pending:
            raise BvhSyntaxError(position, "bvh.no_open", joint=self.joints[-1].name, found=_shown(text))
        else:
            self._statement(text, position)

    def _open(self, position: int) -> None:
        if not self.pending:
            raise BvhSyntaxError(position, "bvh.stray_open")
        self.pending = False
        self.open.append(len(self.joints) - 1)

    def _close(self, position: int) -> None:
        if self.pending or not self.open:
            raise BvhSyntaxError(position, "bvh.stray_close")
        joint = self.joints[self.open.pop()]
        if joint.offset is None:
            raise BvhSyntaxError(joint.position, "bvh.no_offset", joint=joint.name)

    def _statement(self, text: bytes, position: int) -> None:
        word, _, rest = text.replace(b"\t", b" ").partition(b" ")
        keyword, rest = word.lower(), rest.strip()
        if keyword in (b"root", b"joint"):
            self._begin_joint(keyword == b"root", rest, position)
        elif keyword in (b"end", b"endsite"):
            if not self.open:
                raise BvhSyntaxError(position, "bvh.end_outside")
            self._add(_Joint(f"{self.joints[self.open[-1]].name}_end", self.open[-1], position, True))
        elif keyword == b"offset":
            joint = self._current("OFFSET", position)
            if joint.offset is not None:
                raise BvhSyntaxError(position, "bvh.second_offset", joint=joint.name)
            joint.offset = _parse_offset(rest.split(), position)
        elif keyword == b"channels":
            joint = self._current("CHANNELS", position)
            if joint.channels is not None:
                raise BvhSyntaxError(position, "bvh.second_channels", joint=joint.name)
            joint.channels = _parse_channels(rest.split(), position)
            if joint.is_end and joint.channels:
                raise BvhSyntaxError(position, "bvh.end_channels")
        else:
            raise BvhSyntaxError(position, "bvh.keyword", found=_shown(text))

    def _begin_joint(self, is_root: bool, name: bytes, position: int) -> None:
        if not name:
            raise BvhSyntaxError(position, "bvh.no_name", kind="ROOT" if is_root else "JOINT")
        if is_root == bool(self.open):
            raise BvhSyntaxError(position, "bvh.root_inside" if is_root else "bvh.joint_outside")
        if self.open and self.joints[self.open[-1]].is_end:
            raise BvhSyntaxError(position, "bvh.joint_in_end")
        self._add(_Joint(name.decode(self.encoding), self.open[-1] if self.open else -1, position, False))

    def _add(self, joint: _Joint, most: int = MOST_POINTS, most_with_ends: int = 4 * MOST_POINTS) -> None:
        self.n_joints += not joint.is_end
        if self.n_joints > most or len(self.joints) >= most_with_ends:
            raise BvhSyntaxError(joint.position, "bvh.too_many", most=most)
        self.joints.append(joint)
        self.pending = True

    def _current(self, keyword: str, position: int) -> _Joint:
        if not self.open:
            raise BvhSyntaxError(position, "bvh.outside", keyword=keyword)
        return self.joints[self.open[-1]]


def _shown(text: bytes) -> str:
    return f"'{text[:40].decode('ascii', 'backslashreplace')}'"


def _parse_offset(words: list[bytes], position: int) -> tuple[float, float, float]:
    if len(words) != 3:
        raise BvhSyntaxError(position, "bvh.offset_count", found=len(words))
    values = []
    for word in words:
        value = parse_number(word)
        if value is None or not math.isfinite(value):
            raise BvhSyntaxError(position, "bvh.offset_number", found=_shown(word))
        values.append(value)
    return values[0], values[1], values[2]


def _parse_channels(words: list[bytes], position: int) -> tuple[str, ...]:
    count = int(words[0]) if words and re.fullmatch(rb"\d{1,3}", words[0]) else -1
    if count < 0 or count > 6:
        raise BvhSyntaxError(position, "bvh.channel_number", found=_shown(b" ".join(words)))
    names = words[1:]
    if len(names) != count:
        raise BvhSyntaxError(position, "bvh.channel_names", declared=count, found=len(names))
    kinds: list[int] = []
    for name in names:
        kind = _KINDS.get(name.decode("ascii", "replace").lower())
        if kind is None:
            raise BvhSyntaxError(position, "bvh.unknown_channel", found=_shown(name), known=CHANNEL_NAMES)
        # Two turns about one axis, one after the other, are one turn.
        if kind in kinds if kind < 3 else kinds[-1:] == [kind]:
            raise BvhSyntaxError(position, "bvh.channel_twice", found=_shown(name))
        kinds.append(kind)
    return tuple(CHANNEL_NAMES[kind] for kind in kinds)


def _statements(section: bytes) -> Iterator[tuple[bytes, int]]:
    """Yield braces and statements with their places; mostly a line each, but lines may be split or joined."""
    held, held_at = b"", 0
    for text, position in _pieces(section):
        if held and text not in (b"{", b"}") and _lacks_words(held) and not _KEYWORD.match(text):
            held += b" " + text
            continue
        if held:
            yield held, held_at
        held, held_at = text, position
    if held:
        yield held, held_at


def _pieces(section: bytes) -> Iterator[tuple[bytes, int]]:
    """Yield braces and lines, cut before a keyword that follows numbers or channels (joint names may hold any word)."""
    for match in _STATEMENT.finditer(section):
        text = match.group().strip()
        if text and _NUMBERED.match(text):
            for piece in _JOINED.split(text):
                yield piece, match.start()
        elif text:
            yield text, match.start()


def _lacks_words(statement: bytes) -> bool:
    """Whether a statement continues in the next line."""
    words = statement.split()
    keyword = words[0].lower()
    if keyword == b"offset":
        return len(words) < 4
    if keyword == b"channels":
        return len(words) == 1 or (words[1].isdigit() and len(words) < 2 + int(words[1][:3]))
    return len(words) == 1 and keyword in (b"root", b"joint", b"end")


def _encoding(section: bytes) -> str:
    try:
        section.decode("utf-8")
    except UnicodeDecodeError:
        return "latin-1"
    return "utf-8"


@functools.lru_cache(maxsize=32)
def parse_hierarchy(section: bytes) -> Hierarchy:
    """Parse the text between HIERARCHY and MOTION, cached by content; BvhSyntaxError with the place in the section."""
    parser = _Parser(_encoding(section))
    if odd := _CONTROL.search(section):
        raise BvhSyntaxError(odd.start(), "numbers.control", found=f"\\x{odd[0][0]:02x}")
    for text, position in _statements(section):
        parser.take(text, position)
    joints = parser.joints
    if not joints:
        raise BvhSyntaxError(0, "bvh.no_root")
    if parser.open or parser.pending:
        missing = len(parser.open) + parser.pending
        raise BvhSyntaxError(len(section), "bvh.open_braces", count=missing)
    channels = tuple(joint.channels or () for joint in joints)
    offsets = tuple(joint.offset or (0.0, 0.0, 0.0) for joint in joints)
    skeleton = Skeleton(
        names=_unique_ends(joints),
        parents=np.array([joint.parent for joint in joints], np.intp),
        offsets=np.array(offsets),
        end_sites=np.array([joint.is_end for joint in joints]),
    )
    return Hierarchy(_program(skeleton, channels), channels, offsets, parser.encoding, sum(map(len, channels)))


def _unique_ends(joints: list[_Joint]) -> tuple[str, ...]:
    """Names, those of end sites with a number where the name is taken."""
    taken = {joint.name for joint in joints if not joint.is_end}
    numbers: dict[str, int] = {}
    names = []
    for joint in joints:
        name = joint.name
        while joint.is_end and name in taken:
            numbers[joint.name] = numbers.get(joint.name, 1) + 1
            name = f"{joint.name}{numbers[joint.name]}"
        taken.add(name)
        names.append(name)
    return tuple(names)


def _program(skeleton: Skeleton, channels: tuple[tuple[str, ...], ...]) -> ChannelProgram:
    starts = np.concatenate(([0], np.cumsum([len(names) for names in channels]))).astype(np.int64)
    kinds = np.array([_KINDS[name.lower()] for names in channels for name in names], np.int64)
    return ChannelProgram(skeleton, starts, kinds, np.arange(len(kinds)), math.pi / 360)


_HIERARCHY = re.compile(rb"(?:\xef\xbb\xbf)?\s*HIERARCHY\b", re.IGNORECASE)
_MOTION = re.compile(rb"(?:^|(?<=[\r\n}]))[ \t]*MOTION\b", re.IGNORECASE)
_FRAMES = re.compile(rb"\s*Frames[ \t]*:?[ \t]*(\S*)", re.IGNORECASE)
_FRAME_TIME = re.compile(rb"\s*Frame[ \t]*Time[ \t]*:?[ \t]*(\S*)", re.IGNORECASE)


def read_bvh(path: str | os.PathLike[str], *, unit: float | None = None, up: str | None = None) -> Motion:
    """Read a BVH file.

    ``provenance.layout`` is a `BvhLayout`, ``provenance.values`` (T, C) the channel values in the file. A frame time
    that is a usual rate rounded (0.0333333) gives that rate (30).

    Parameters
    ----------
    path : the file.
    unit : metres per unit of the file; by default inferred from the height of the body.
    up : axis of the file that points up, such as ``"y"`` or ``"z"``; by default inferred.

    Raises
    ------
    MotionFileError : the file is missing or damaged; with the line.
    """
    data = scannable(read_bytes(path))
    try:
        program, layout, values, n_frames, notes = _parse(data)
    except BvhSyntaxError as error:
        raise MotionFileError(path, error.message, line_number(data, error.position)) from None
    del data  # the text of a long recording is as large as its numbers
    return build_motion(
        os.fspath(path), "bvh", program, values, Clock(layout.frame_rate, frames=n_frames),
        unit=unit, up=up, layout=layout, values=values, notes=notes,
    )  # fmt: skip


def _parse(data: bytes) -> tuple[ChannelProgram, BvhLayout, FloatArray, int, tuple[Message, ...]]:
    """How channels make poses, the layout, the channel values (T, C), the declared number of frames, and notes."""
    start = _HIERARCHY.match(data)
    if start is None:
        raise BvhSyntaxError(0, "bvh.no_hierarchy")
    motion = _find_motion(data, start.end())
    section = data[start.end() : motion.start()]
    try:
        hierarchy = parse_hierarchy(section)
    except BvhSyntaxError as error:
        raise BvhSyntaxError(error.position + start.end(), error.message) from None
    if hierarchy.n_channels == 0:
        raise BvhSyntaxError(start.end(), "bvh.no_channels")
    n_frames, frames_at, frame_time, values_at = _parse_motion_header(data, motion.end())
    values, notes = _read_values(data, values_at, hierarchy.n_channels, n_frames, frames_at)
    layout = BvhLayout(hierarchy.channels, hierarchy.offsets, frame_time, hierarchy.encoding)
    return hierarchy.program, layout, values, n_frames, notes


def _find_motion(data: bytes, start: int) -> re.Match[bytes]:
    quick = data.find(b"\nMOTION", start)
    found = _MOTION.match(data, quick + 1) if quick >= 0 else None
    # The usual spelling may stand behind an unusual one only in a damaged file, which fails later anyway; that is
    # looked for in 10 MB: a skeleton takes some thousand bytes.
    found = found or _MOTION.search(data, start, start + 10_000_000)
    if found is None:
        raise BvhSyntaxError(len(data), "bvh.no_motion")
    return found


def _parse_motion_header(data: bytes, position: int) -> tuple[int, int, str, int]:
    """Number of frames, its place, frame time as spelt, start of the values."""
    frames = _FRAMES.match(data, position)
    if frames is None or not re.fullmatch(rb"\d{1,18}", frames[1]):
        at = _next_text(data, position)
        raise BvhSyntaxError(at, "bvh.frames", found=_show_line(data, at))
    n_frames = int(frames[1])
    if n_frames == 0:
        raise BvhSyntaxError(frames.start(1), "bvh.zero_frames")
    time = _FRAME_TIME.match(data, frames.end())
    if time is None:
        raise BvhSyntaxError(_next_text(data, frames.end()), "bvh.no_frame_time")
    seconds = parse_number(time[1])
    if seconds is None or not 1e-6 <= seconds <= 1e6:
        shown = time[1][:40].decode("ascii", "backslashreplace")
        raise BvhSyntaxError(time.start(1), "bvh.frame_time", found=shown)
    return n_frames, frames.start(1), time[1].decode("ascii"), time.end()


def _show_line(data: bytes, start: int) -> str:
    return re.split(rb"[\r\n]", data[start : start + 60])[0].decode("ascii", "backslashreplace").rstrip()


def _next_text(data: bytes, position: int) -> int:
    found = re.compile(rb"\S").search(data, position)
    return found.start() if found else len(data)


def _read_values(
    data: bytes, start: int, columns: int, n_frames: int, frames_at: int
) -> tuple[FloatArray, tuple[Message, ...]]:
    """Channel values (T, C), bounded by the bytes of the file, and notes about the rows."""
    # A value takes two bytes, itself and the space after it.
    rows = min(n_frames, (len(data) - start) // (2 * columns) + 1)
    values, status, position, filled = _scan(data, start, columns, rows)
    if status == FULL:  # more rows than declared
        values, status, position, filled = _scan(data, start, columns, (len(data) - start) // (2 * columns) + 1)
    found = filled // columns - (status == LONG)  # the first values of a row that is too long were read as a row
    if found == 0 and status == DONE:
        raise BvhSyntaxError(frames_at, "bvh.no_values", declared=n_frames, found=found)
    notes = []
    if status not in (DONE, FULL):
        notes.append(_explain_rest(data, position, columns, found))
    if found < len(values):
        values = values[:found].copy()
    values.flags.writeable = False
    return values, tuple(notes)


def _scan(data: bytes, start: int, columns: int, rows: int) -> tuple[FloatArray, int, int, int]:
    """Scan at most so many rows: values (rows, C), status, place, and number of values read."""
    plain = read_plain_rows(data, start, columns, rows)
    if plain is not None:
        return plain, DONE, len(data), plain.size
    values, status, position, filled, bad = scan_numbers(data, start, columns, rows)
    if bad is not None:
        raise BvhSyntaxError(*bad)
    return values, status, position, filled


def _explain_rest(data: bytes, position: int, columns: int, found: int) -> Message:
    """Explain a row of another width: a row that breaks off, or another skeleton; BvhSyntaxError if damaged."""
    widths = [len(line.split()) for line in data[position:].splitlines() if line.strip()]
    if found and len(widths) == 1 and widths[0] < columns:
        return Message("guard.cut_off", line=line_number(data, position))
    if found and len(widths) > 1 and len(set(widths)) == 1:
        return Message("bvh.other_rows", found=found, columns=columns, left_out=len(widths), width=widths[0])
    raise BvhSyntaxError(position, "bvh.value_count", expected=columns, found=widths[0])
