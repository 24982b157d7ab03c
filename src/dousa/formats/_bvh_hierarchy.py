"""The HIERARCHY section of a BVH file: the tree of joints, their offsets and channels."""

from __future__ import annotations

import functools
import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from decimal import Decimal

import numpy as np

from dousa.formats._channels import ChannelProgram
from dousa.formats._numbers import parse_number
from dousa.motion._types import Skeleton

__all__ = ["CHANNEL_NAMES", "BvhLayout", "BvhSyntaxError", "Hierarchy", "parse_hierarchy"]

CHANNEL_NAMES = ("Xposition", "Yposition", "Zposition", "Xrotation", "Yrotation", "Zrotation")
MAX_JOINTS = 10_000
_USUAL_RATES = (
    24,
    25,
    30,
    48,
    50,
    60,
    72,
    75,
    90,
    100,
    120,
    125,
    144,
    150,
    180,
    200,
    240,
    250,
    300,
    360,
    480,
    500,
)
_KINDS = {name.lower(): kind for kind, name in enumerate(CHANNEL_NAMES)}
_STATEMENT = re.compile(rb"[{}]|[^\r\n{}]+")
_KEYWORD = re.compile(rb"(?:ROOT|JOINT|END|ENDSITE|OFFSET|CHANNELS)(?!\S)", re.IGNORECASE)
_NUMBERED = re.compile(rb"(?:OFFSET|CHANNELS)(?!\S)", re.IGNORECASE)
_JOINED = re.compile(rb"\s+(?=(?:JOINT|END|ENDSITE|OFFSET|CHANNELS)(?!\S))", re.IGNORECASE)


class BvhSyntaxError(ValueError):
    """Something at a byte position of the file is not as it should be; turned into a MotionFileError by the reader."""

    def __init__(self, problem: str, position: int) -> None:
        super().__init__(problem)
        self.problem = problem
        self.position = position


@dataclass(frozen=True, slots=True)
class BvhLayout:
    """What only a BVH file knows, kept so that writing gives the same file content.

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

    @property
    def frame_rate(self) -> float:
        """Hz: the one usual rate whose frame time was rounded or cut off to this one, else one over the time."""
        seconds, (_, digits, exponent) = float(self.frame_time), Decimal(self.frame_time).as_tuple()
        if len(digits) > 1 and isinstance(exponent, int) and exponent < 0:
            last = 10.0**exponent
            rounded = [rate for rate in _USUAL_RATES if abs(1 / rate - seconds) <= 0.500001 * last]
            # 0.0166 is 60 Hz with the other digits cut off.
            near = rounded or [rate for rate in _USUAL_RATES if seconds <= 1 / rate < seconds + last]
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
    """Reads statement after statement; ``open`` are the joints whose braces are open, ``pending`` one without yet."""

    encoding: str
    joints: list[_Joint] = field(default_factory=list)
    open: list[int] = field(default_factory=list)
    pending: bool = False

    def take(self, text: bytes, position: int) -> None:
        if text == b"{":
            self._open(position)
        elif text == b"}":
            self._close(position)
        elif self.pending:
            raise BvhSyntaxError(
                f"expected '{{' after '{self.joints[-1].name}', got {_shown(text)}", position
            )
        else:
            self._statement(text, position)

    def _open(self, position: int) -> None:
        if not self.pending:
            raise BvhSyntaxError("'{' without a ROOT, JOINT or End Site before it", position)
        self.pending = False
        self.open.append(len(self.joints) - 1)

    def _close(self, position: int) -> None:
        if self.pending or not self.open:
            raise BvhSyntaxError("'}' without its '{': the braces do not pair up", position)
        joint = self.joints[self.open.pop()]
        if joint.offset is None:
            raise BvhSyntaxError(f"'{joint.name}' has no OFFSET", joint.position)

    def _statement(self, text: bytes, position: int) -> None:
        word, _, rest = text.replace(b"\t", b" ").partition(b" ")
        keyword, rest = word.lower(), rest.strip()
        if keyword in (b"root", b"joint"):
            self._begin_joint(keyword == b"root", rest, position)
        elif keyword in (b"end", b"endsite"):
            if not self.open:
                raise BvhSyntaxError("an End Site outside of any joint", position)
            self._add(_Joint(f"{self.joints[self.open[-1]].name}_end", self.open[-1], position, True))
        elif keyword == b"offset":
            joint = self._current("OFFSET", position)
            if joint.offset is not None:
                raise BvhSyntaxError(f"a second OFFSET of '{joint.name}'", position)
            joint.offset = _parse_offset(rest.split(), position)
        elif keyword == b"channels":
            joint = self._current("CHANNELS", position)
            if joint.channels is not None:
                raise BvhSyntaxError(f"a second CHANNELS line of '{joint.name}'", position)
            joint.channels = _parse_channels(rest.split(), position)
            if joint.is_end and joint.channels:
                raise BvhSyntaxError("an End Site cannot have channels", position)
        else:
            raise BvhSyntaxError(
                f"expected ROOT, JOINT, End Site, OFFSET, CHANNELS, '{{', '}}' or MOTION, got {_shown(text)}",
                position,
            )

    def _begin_joint(self, is_root: bool, name: bytes, position: int) -> None:
        if not name:
            raise BvhSyntaxError(f"{'ROOT' if is_root else 'JOINT'} without a name", position)
        if is_root == bool(self.open):
            problem = "ROOT inside another joint" if is_root else "JOINT outside of any ROOT"
            raise BvhSyntaxError(f"{problem}; do the braces pair up?", position)
        if self.open and self.joints[self.open[-1]].is_end:
            raise BvhSyntaxError("JOINT inside an End Site", position)
        self._add(_Joint(name.decode(self.encoding), self.open[-1] if self.open else -1, position, False))

    def _add(self, joint: _Joint) -> None:
        if len(self.joints) == MAX_JOINTS:
            raise BvhSyntaxError(f"more than {MAX_JOINTS} joints; is this a skeleton?", joint.position)
        self.joints.append(joint)
        self.pending = True

    def _current(self, keyword: str, position: int) -> _Joint:
        if not self.open:
            raise BvhSyntaxError(f"{keyword} outside of any joint", position)
        return self.joints[self.open[-1]]


def _shown(text: bytes) -> str:
    return f"'{text[:40].decode('ascii', 'backslashreplace')}'"


def _parse_offset(words: list[bytes], position: int) -> tuple[float, float, float]:
    if len(words) != 3:
        raise BvhSyntaxError(f"expected 3 numbers after OFFSET, got {len(words)}", position)
    values = []
    for word in words:
        value = parse_number(word)
        if value is None or not math.isfinite(value):
            raise BvhSyntaxError(f"expected a finite number in OFFSET, got {_shown(word)}", position)
        values.append(value)
    return values[0], values[1], values[2]


def _parse_channels(words: list[bytes], position: int) -> tuple[str, ...]:
    count = int(words[0]) if words and re.fullmatch(rb"\d{1,3}", words[0]) else -1
    if count < 0 or count > 6:
        raise BvhSyntaxError(
            f"expected a number of channels from 0 to 6, got {_shown(b' '.join(words))}", position
        )
    names = words[1:]
    if len(names) != count:
        raise BvhSyntaxError(f"CHANNELS says {count}, but {len(names)} names follow", position)
    kinds = []
    for name in names:
        kind = _KINDS.get(name.decode("ascii", "replace").lower())
        if kind is None:
            raise BvhSyntaxError(
                f"unknown channel {_shown(name)}; expected {', '.join(CHANNEL_NAMES)}", position
            )
        if kind < 3 and kind in kinds:
            raise BvhSyntaxError(f"channel {_shown(name)} is there twice", position)
        kinds.append(kind)
    return tuple(CHANNEL_NAMES[kind] for kind in kinds)


def _statements(section: bytes) -> Iterator[tuple[bytes, int]]:
    """Braces and statements with their places; mostly a line each, but lines may be split or joined."""
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
    """Braces and lines, cut before a keyword that follows numbers or channels (joint names may hold any word)."""
    for match in _STATEMENT.finditer(section):
        text = match.group().strip()
        if text and _NUMBERED.match(text):
            for piece in _JOINED.split(text):
                yield piece, match.start()
        elif text:
            yield text, match.start()


def _lacks_words(statement: bytes) -> bool:
    """Whether a statement goes on in the next line."""
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
    """Parse the text between HIERARCHY and MOTION; kept for the next file with the same skeleton.

    Raises
    ------
    BvhSyntaxError : what is wrong and where in the section.
    """
    parser = _Parser(_encoding(section))
    for text, position in _statements(section):
        parser.take(text, position)
    joints = parser.joints
    if not joints:
        raise BvhSyntaxError("expected a ROOT joint after HIERARCHY, got none", 0)
    if parser.open or parser.pending:
        missing = len(parser.open) + parser.pending
        raise BvhSyntaxError(
            f"{missing} '}}' missing at the end of the HIERARCHY; is the file truncated?", len(section)
        )
    channels = tuple(joint.channels or () for joint in joints)
    offsets = tuple(joint.offset or (0.0, 0.0, 0.0) for joint in joints)
    skeleton = Skeleton(
        names=_unique_ends(joints),
        parents=np.array([joint.parent for joint in joints], np.intp),
        offsets=np.array(offsets),
        end_sites=np.array([joint.is_end for joint in joints]),
    )
    return Hierarchy(
        _program(skeleton, channels), channels, offsets, parser.encoding, sum(map(len, channels))
    )


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
