"""Acclaim ASF skeletons: bones with a direction, a length and their own rotation axes."""

from __future__ import annotations

import functools
import math
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from dousa.errors import MotionFileError
from dousa.files.disk import read_bytes
from dousa.formats.channels import ChannelProgram
from dousa.formats.numbers import parse_number
from dousa.motion.kinematics import compute_rest_positions
from dousa.motion.rotations import from_euler, to_matrix
from dousa.motion.types import Skeleton

Vector = tuple[float, float, float]

_CHANNELS = ("tx", "ty", "tz", "rx", "ry", "rz")


@dataclass(frozen=True, slots=True)
class AsfBone:
    """One bone.

    Parameters
    ----------
    name : as in the file.
    parent : index of the bone it starts at the end of; -1 if it starts at the root.
    direction : unit vector of the bone at rest, in the world.
    length : file units.
    axis : rad, turns of the bone's own axes against the world, about x, y and z.
    axis_order : order of those turns and of the bone's rotation: ``"XYZ"`` turns about x first.
    dof : channels of the bone in the order of the AMC file: ``rx ry rz tx ty tz l``.
    """

    name: str
    parent: int
    direction: Vector
    length: float
    axis: Vector
    axis_order: str
    dof: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class AsfSkeleton:
    """The skeleton of an ASF file.

    Parameters
    ----------
    path : the file.
    bones : parents before their children.
    root_order : channels of the root in the order of the AMC file.
    root_axis_order : as ``AsfBone.axis_order``.
    root_position : file units, added to the root's translation.
    root_orientation : rad, as ``AsfBone.axis``.
    unit : metres per file unit, 0.0254 over the file's ``length``.
    degrees : whether angles are in degrees (also in AMC files without a declaration).
    """

    path: str
    bones: tuple[AsfBone, ...]
    root_order: tuple[str, ...]
    root_axis_order: str
    root_position: Vector
    root_orientation: Vector
    unit: float
    degrees: bool

    def to_skeleton(self) -> Skeleton:
        """Return joints in file units: the root, one at the start of every bone, an end site at each last tip."""
        return _build_skeleton(self)

    @property
    def declared_unit(self) -> float | None:
        """Return the unit if it makes the body between 0.4 and 3 m tall, else None."""
        height = _rest_height(self) * self.unit
        return self.unit if 0.4 <= height <= 3.0 else None


@functools.lru_cache(maxsize=64)
def _build_skeleton(asf: AsfSkeleton) -> Skeleton:
    names, parents, ends = ["root"], [-1], [False]
    offsets = [asf.root_position]
    tips = [_tip(bone) for bone in asf.bones]
    for bone in asf.bones:
        names.append(bone.name)
        parents.append(bone.parent + 1)
        offsets.append(tips[bone.parent] if bone.parent >= 0 else (0.0, 0.0, 0.0))
        ends.append(False)
    has_child = {bone.parent for bone in asf.bones}
    for index, bone in enumerate(asf.bones):
        if index not in has_child:
            name = f"{bone.name}_end"
            while name in names:
                name += "_"
            names.append(name)
            parents.append(index + 1)
            offsets.append(tips[index])
            ends.append(True)
    return Skeleton(tuple(names), np.array(parents, np.intp), np.array(offsets), np.array(ends))


def _tip(bone: AsfBone) -> Vector:
    x, y, z = bone.direction
    return bone.length * x, bone.length * y, bone.length * z


@functools.lru_cache(maxsize=64)
def _rest_height(asf: AsfSkeleton) -> float:
    return float(np.ptp(compute_rest_positions(asf.to_skeleton()), axis=0).max())


def read_asf(path: str | os.PathLike[str]) -> AsfSkeleton:
    """Read an Acclaim skeleton (``.asf``); cached until the file changes.

    Raises
    ------
    MotionFileError : the file is missing or damaged, its hierarchy is cyclic or in pieces; with the line.
    """
    try:
        state = os.stat(path)
    except (OSError, ValueError):
        state = None  # read_bytes raises the error
    if state is None:
        return _parse(os.fspath(path), read_bytes(path))
    return _read_cached(os.fspath(path), state.st_mtime_ns, state.st_size, state.st_ino)


@functools.lru_cache(maxsize=64)
def _read_cached(path: str, mtime: int, size: int, file: int) -> AsfSkeleton:
    return _parse(path, read_bytes(path))


@dataclass(slots=True)
class _Line:
    number: int
    words: list[str]


@dataclass(slots=True)
class _BoneText:
    """A bone read so far."""

    line: int
    name: str = ""
    direction: Vector = (0.0, 0.0, 0.0)
    length: float = 0.0
    axis: Vector = (0.0, 0.0, 0.0)
    axis_order: str = "XYZ"
    dof: tuple[str, ...] = ()


@dataclass(slots=True)
class _AsfParser:
    path: str
    length: float = 1.0
    degrees: bool = True
    root: dict[str, list[str]] = field(default_factory=dict)
    root_axis: str = "XYZ"
    root_position: Vector = (0.0, 0.0, 0.0)
    root_orientation: Vector = (0.0, 0.0, 0.0)
    root_order: tuple[str, ...] = ()
    bones: dict[str, _BoneText] = field(default_factory=dict)
    bone: _BoneText | None = None
    parents: dict[str, tuple[str, int]] = field(default_factory=dict)

    def fail(self, code: str, line: int | None, **values: Any) -> MotionFileError:
        return MotionFileError(self.path, code, line, **values)

    def take(self, section: str, line: _Line) -> None:
        if section == "units":
            self._take_unit(line)
        elif section == "root":
            self._take_root(line)
        elif section == "bonedata":
            self._take_bone(line)
        elif section == "hierarchy" and line.words[0].lower() not in ("begin", "end"):
            for child in line.words[1:]:
                if child in self.parents:
                    raise self.fail("asf.two_parents", line.number, bone=child)
                self.parents[child] = (line.words[0], line.number)

    def _take_unit(self, line: _Line) -> None:
        key = line.words[0].lower()
        if key in ("length", "scale"):
            (value,) = self.numbers(line, line.words[1:], 1)
            if value <= 0:
                raise self.fail("asf.unit", line.number, key=key, value=value)
            self.length *= value
        elif key == "angle":
            self.degrees = "".join(line.words[1:]).lower().startswith("deg")

    def _take_root(self, line: _Line) -> None:
        key, rest = line.words[0].lower(), line.words[1:]
        if key == "order":
            self.root_order = self._dof(line, rest, allowed=_CHANNELS)
        elif key == "axis":
            self.root_axis = self._axis_order(line, "".join(rest))
        elif key == "position":
            self.root_position = self._vector(line, rest)
        elif key == "orientation":
            self.root_orientation = self._vector(line, rest)

    def _take_bone(self, line: _Line) -> None:
        key, rest = line.words[0].lower(), line.words[1:]
        if key == "begin":
            if self.bone is not None:
                raise self.fail("asf.begin_inside", line.number)
            self.bone = _BoneText(line.number)
        elif self.bone is None:
            raise self.fail("asf.no_begin", line.number, found=line.words[0][:40])
        elif key == "end":
            self._finish_bone(self.bone)
            self.bone = None
        elif key == "name":
            self.bone.name = " ".join(rest)
        elif key == "direction":
            self.bone.direction = self._vector(line, rest)
        elif key == "length":
            (self.bone.length,) = self.numbers(line, rest, 1)
        elif key == "axis":
            self.bone.axis = self._vector(line, rest[:3])
            self.bone.axis_order = self._axis_order(line, "".join(rest[3:]) or "XYZ")
        elif key == "dof":
            self.bone.dof = self._dof(line, rest, allowed=(*_CHANNELS, "l"))

    def _finish_bone(self, bone: _BoneText, most: int = 10_000) -> None:
        if not bone.name:
            raise self.fail("asf.no_name", bone.line)
        if bone.name in self.bones or bone.name == "root":
            raise self.fail("asf.twice", bone.line, bone=bone.name)
        if len(self.bones) == most:
            raise self.fail("asf.too_many", bone.line, most=most)
        self.bones[bone.name] = bone

    def numbers(self, line: _Line, words: list[str], count: int) -> list[float]:
        values = [parse_number(word.encode("latin-1")) for word in words]
        good = [value for value in values if value is not None and math.isfinite(value)]
        if len(good) != count or len(values) != count:
            raise self.fail("asf.numbers", line.number, count=count, key=line.words[0], found=" ".join(words)[:60])
        return good

    def _vector(self, line: _Line, words: list[str]) -> Vector:
        x, y, z = self.numbers(line, words, 3)
        return x, y, z

    def _axis_order(self, line: _Line, text: str) -> str:
        if sorted(text.upper()) != ["X", "Y", "Z"]:
            raise self.fail("asf.axis", line.number, found=text[:40])
        return text.upper()

    def _dof(self, line: _Line, words: list[str], allowed: tuple[str, ...]) -> tuple[str, ...]:
        names = tuple(word.lower() for word in words)
        bad = [name for name in names if name not in allowed]
        if bad or len(set(names)) != len(names):
            raise self.fail(
                "asf.unknown_channel" if bad else "asf.channel_twice",
                line.number,
                channel=bad[0][:40] if bad else None,
                allowed=allowed,
            )
        return names


def _sections(text: str) -> Iterator[tuple[str, _Line]]:
    """Every line that is not blank or a comment, with the ``:section`` it stands in."""
    section = ""
    for number, raw in enumerate(re.split(r"\r\n|\r|\n", text), start=1):
        words = raw.split("#", 1)[0].split()
        if not words:
            continue
        if words[0].startswith(":"):
            section = words[0][1:].lower()
            if section == "scale" and len(words) > 1:
                yield "units", _Line(number, ["scale", *words[1:]])
            continue
        yield section, _Line(number, words)


def _parse(path: str, data: bytes) -> AsfSkeleton:
    parser = _AsfParser(path)
    for section, line in _sections(data.decode("latin-1").removeprefix("ï»¿")):
        parser.take(section, line)
    if parser.bone is not None:
        raise parser.fail("asf.no_end", parser.bone.line)
    if not parser.bones:
        raise parser.fail("asf.no_bones", None)
    if not parser.root_order:
        raise parser.fail("asf.no_order", None)
    order = _sort_bones(parser)
    index = {name: number for number, name in enumerate(order)}
    turn = math.pi / 180 if parser.degrees else 1.0
    bones = tuple(_to_bone(parser.bones[name], index.get(parser.parents[name][0], -1), turn) for name in order)
    orientation = parser.root_orientation
    return AsfSkeleton(
        path=path,
        bones=bones,
        root_order=parser.root_order,
        root_axis_order=parser.root_axis,
        root_position=parser.root_position,
        root_orientation=(orientation[0] * turn, orientation[1] * turn, orientation[2] * turn),
        unit=0.0254 / parser.length,
        degrees=parser.degrees,
    )


def _to_bone(text: _BoneText, parent: int, turn: float) -> AsfBone:
    size = math.hypot(*text.direction)
    # Printed directions are short of unit length by a digit or two.
    x, y, z = (part / size for part in text.direction) if size > 0 else text.direction
    a, b, c = (angle * turn for angle in text.axis)
    return AsfBone(text.name, parent, (x, y, z), text.length, (a, b, c), text.axis_order, text.dof)


def _sort_bones(parser: _AsfParser) -> list[str]:
    """Names of the bones, each after its parent, depth first as the hierarchy lists them."""
    children: dict[str, list[str]] = {}
    for child, (parent, line) in parser.parents.items():
        for name in (parent, child):
            if name not in parser.bones and (name != "root" or name == child):
                raise parser.fail("asf.unknown_bone", line, bone=name)
        children.setdefault(parent, []).append(child)
    order, waiting = [], children.get("root", [])[::-1]
    while waiting:
        order.append(waiting.pop())
        waiting += children.get(order[-1], [])[::-1]
    lost = [name for name in parser.bones if name not in set(order)]
    if lost:
        line = parser.parents[lost[0]][1] if lost[0] in parser.parents else parser.bones[lost[0]].line
        raise parser.fail("asf.not_connected", line, bones=lost[:5])
    return order


def _steps(dof: tuple[str, ...], axis_order: str, first_column: int) -> list[tuple[int, int]]:
    """(kind, column) of a joint's channels for `ChannelProgram`; ``l`` has none.

    An axis order XYZ turns about x first, in fixed axes: the matrix product is Rz Ry Rx, z first.
    """
    column = {name: first_column + place for place, name in enumerate(dof)}
    turns = [f"r{letter.lower()}" for letter in reversed(axis_order)]
    return [(_CHANNELS.index(name), column[name]) for name in (*_CHANNELS[:3], *turns) if name in column]


@functools.lru_cache(maxsize=64)
def channel_program(asf: AsfSkeleton, degrees: bool) -> ChannelProgram:
    """Build the program for the columns of an AMC file: root first, bones in the skeleton's order."""
    skeleton = asf.to_skeleton()
    joints = [(asf.root_order, asf.root_axis_order, asf.root_orientation)]
    joints += [(bone.dof, bone.axis_order, bone.axis) for bone in asf.bones]
    axes = np.empty((len(joints), 3, 3))
    starts, steps, stretches, column = [0], [], [], 0
    for joint, (dof, order, angles) in enumerate(joints):
        steps += _steps(dof, order, column)
        starts.append(len(steps))
        if "l" in dof:
            bone = asf.bones[joint - 1]
            after = np.flatnonzero(skeleton.parents == joint).tolist()
            stretches += [(child, column + dof.index("l"), bone.direction) for child in after]
        column += len(dof)
        by_axis = dict(zip("XYZ", angles, strict=True))
        axes[joint] = to_matrix(from_euler([by_axis[letter] for letter in reversed(order)], order[::-1]))
    starts += [len(steps)] * (skeleton.n_joints - len(joints))
    kinds, columns = np.array(steps, np.int64).reshape(-1, 2).T.copy()
    half = math.pi / 360 if degrees else 0.5
    return ChannelProgram(skeleton, np.array(starts), kinds, columns, half, axes, tuple(stretches))
