"""Body files in TOML: any tree of parts, or a person in a few lines.

A person:

    stature = 1.65          # metres
    sex = "female"          # optional, "average" by default
    [measures]              # metres, any of dousa.estimation.body.human.MEASURES
    thigh = 0.41

Any tree, root first (metres, radians, axes of the part; see `BodyModel`):

    stature = 1.2
    [[part]]
    name = "base"
    spheres = [[0, 0, 0, 0.1], [0, 0.5, 0, 0.1]]       # x, y, z and radius; three numbers are a corner
    [[part]]
    name = "arm"
    parent = "base"
    joint = "shoulder"                                  # by default the part's name
    offset = [0, 0.5, 0]
    axes = [[1, 0, 0], [0, 0, 1]]                       # without axes the part is fixed
    limits = [[-1.5, 1.5], [-0.5, 0.5]]                 # or limits_degrees
    rest = [1, 0, 0, 0]                                 # quaternion w, x, y, z; no turn by default
    agility = 1.5                                       # 1 by default
    neutral = [0.2, 0]                                  # angles at ease, one for each axis; 0 by default
    stiffness = 1                                       # cost of leaving them; 0 by default
    spheres = [[0, 0, 0, 0.05], [0, 0.4, 0, 0.03]]
    [[tip]]
    name = "gripper"
    part = "arm"
    offset = [0, 0.4, 0]
"""

from __future__ import annotations

import os
import re
import tomllib
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from dousa.arrays import FloatArray
from dousa.errors import BodyModelError
from dousa.estimation.body.body import BodyModel, pad_axes
from dousa.estimation.body.human import make_human
from dousa.files.disk import atomic_write, read_bytes
from dousa.files.markup import parse_toml, quote_toml
from dousa.messages import Message

_PERSON_KEYS = ("stature", "sex", "measures")
_TREE_KEYS = ("stature", "part", "tip")
_PART_KEYS = (
    *("name", "joint", "parent", "offset", "rest", "axes", "limits", "limits_degrees", "spheres"),
    *("agility", "neutral", "stiffness"),
)
_TIP_KEYS = ("name", "part", "offset")
_AT_LINE = re.compile(r"\s*\(at line (\d+), column \d+\)")


def read_body(path: str | os.PathLike[str], *, most_bytes: int = 1_000_000) -> BodyModel:
    """Read a body from a TOML file of this module, of at most ``most_bytes``.

    Raises
    ------
    MotionFileError : the file is missing, unreadable or empty.
    BodyModelError : no TOML, unknown or missing entries, or an invalid body; with the line where known.
    """
    data = read_bytes(path)
    if len(data) > most_bytes:
        raise BodyModelError("body_file.too_large").at(path)
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise BodyModelError("body_file.encoding", reason=error).at(path) from error
    try:
        content = parse_toml(text)
    except tomllib.TOMLDecodeError as error:
        place = _AT_LINE.search(str(error))
        problem = _AT_LINE.sub("", str(error))
        raise BodyModelError("body_file.toml", reason=problem).at(path, int(place[1]) if place else None) from error
    except RecursionError:
        raise BodyModelError("body_file.nested").at(path) from None
    source, is_tree = _Source(text), "part" in content
    try:
        _refuse_unknown(
            source,
            content,
            _TREE_KEYS if is_tree else _PERSON_KEYS,
            Message("body_file.tree" if is_tree else "body_file.person"),
        )
        if "stature" not in content:
            raise BodyModelError("body_file.no_stature")
        return _read_tree(source, content) if is_tree else _read_person(source, content)
    except BodyModelError as error:
        error.at(path)
        raise


class _Source:
    """The text of a file, for line numbers in errors."""

    def __init__(self, text: str) -> None:
        self._lines = text.splitlines()

    def stature(self, content: Mapping[str, Any]) -> float:
        value = content["stature"]
        if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < 1e6:
            raise BodyModelError("person.number", measure="stature", found=repr(value)).at(line=self.key("stature"))
        return float(value)

    def find(self, pattern: str, number: int = 0, after: int = 0) -> int | None:
        """Return the 1-based line of the match of that number, from a line on."""
        found = [i for i, line in enumerate(self._lines, 1) if i >= after and re.match(pattern, line)]
        return found[number] if number < len(found) else None

    def key(self, key: str, after: int | None = 0) -> int | None:
        """Return the 1-based line of a key, at or after a line."""
        return self.find(rf"\s*[\"']?{re.escape(key)}[\"']?\s*=", 0, after or 0)


def _read_person(source: _Source, content: Mapping[str, Any]) -> BodyModel:
    measures = content.get("measures", {})
    if not isinstance(measures, Mapping):
        raise BodyModelError("body_file.measures").at(line=source.key("measures"))
    try:
        return make_human(content["stature"], content.get("sex", "average"), measures)
    except BodyModelError as error:
        named = error.message.values.get("measure")
        error.at(line=source.key(named) if named else None)
        raise


def _refuse_unknown(
    source: _Source, table: Mapping[str, Any], known: Sequence[str], what: str | Message, after: int | None = 0
) -> None:
    for key in table:
        if key not in known:
            raise BodyModelError("body_file.unknown", what=what, key=key, known=known).at(
                line=source.key(key, after) or after or None
            )


def _read_tree(source: _Source, content: Mapping[str, Any]) -> BodyModel:
    parts = _list_tables(source, content, "part", _PART_KEYS)
    tips = _list_tables(source, content, "tip", _TIP_KEYS)
    names = [part.text("name") for part in parts]
    for number, part in enumerate(parts):
        if names[number] in names[:number]:
            raise part.error(Message("body_file.second", table=part.title), "name")
    try:
        return _build(parts, tips, names, source.stature(content))
    except BodyModelError as error:
        part_name = error.message.values.get("part")  # from BodyModel itself, which has no file
        error.at(line=parts[names.index(part_name)].line if part_name in names else None)
        raise


def _build(parts: Sequence[_Table], tips: Sequence[_Table], names: Sequence[str], stature: float) -> BodyModel:
    solids = [part.numbers("spheres", (None, 4)) for part in parts]
    joints = [_read_joint(part) for part in parts]
    return BodyModel(
        names=tuple(names),
        joints=tuple(part.text("joint", name) for part, name in zip(parts, names, strict=True)),
        parents=np.array([_parent(part, names, number) for number, part in enumerate(parts)]),
        offsets=np.array([part.numbers("offset", (3,), (0.0, 0.0, 0.0)) for part in parts]),
        rest=np.array([part.unit("rest", (4,), (1.0, 0.0, 0.0, 0.0)) for part in parts]),
        n_axes=np.array([len(axes) for axes, _ in joints]),
        axes=np.array([pad_axes(axes, 3) for axes, _ in joints]),
        limits=np.array([pad_axes(limits, 2) for _, limits in joints]),
        spheres=np.concatenate(solids),
        sphere_starts=np.cumsum([0, *(len(solid) for solid in solids)]),
        tips=tuple(tip.text("name") for tip in tips),
        tip_parts=np.array([tip.one_of("part", names) for tip in tips], np.intp),
        tip_offsets=np.array([tip.numbers("offset", (3,)) for tip in tips]).reshape(-1, 3),
        stature=stature,
        agility=np.array([part.numbers("agility", (), 1.0) for part in parts]),
        neutral=np.array(
            [
                pad_axes(part.numbers("neutral", (len(axes),), (0.0,) * len(axes)), 1).ravel()
                for part, (axes, _) in zip(parts, joints, strict=True)
            ]
        ),
        stiffness=np.array([part.numbers("stiffness", (), 0.0) for part in parts]),
    )


def _list_tables(source: _Source, content: Mapping[str, Any], kind: str, keys: Sequence[str]) -> list[_Table]:
    """Return all [[part]] or [[tip]] of a file, without unknown entries."""
    tables = content.get(kind, [])
    if not isinstance(tables, list) or not all(isinstance(table, Mapping) for table in tables):
        raise BodyModelError("body_file.tables", key=kind).at(line=source.find(rf"\s*\[?{kind}\b"))
    made = [_Table(source, kind, number, table) for number, table in enumerate(tables)]
    for table in made:
        _refuse_unknown(source, table.entries, keys, table.title, table.line)
    return made


class _Table:
    """One [[part]] or [[tip]]; errors have its title and line."""

    def __init__(self, source: _Source, kind: str, number: int, entries: Mapping[str, Any]) -> None:
        self._source, self.entries = source, dict(entries)
        self.line = source.find(rf"\s*\[\[\s*{kind}\s*\]\]", number)
        name = entries.get("name")
        self.title = f"{kind} '{name}'" if isinstance(name, str) else f"{kind} {number + 1}"
        rows = entries.get("spheres")
        if isinstance(rows, list):  # three numbers are a corner, a sphere of no radius
            corners = [[*row, 0.0] if isinstance(row, list) and len(row) == 3 else row for row in rows]
            self.entries["spheres"] = corners

    def error(self, problem: Message, key: str = "") -> BodyModelError:
        line = self._source.key(key, self.line) if key and self.line else self.line
        return BodyModelError(problem).at(line=line)

    def text(self, key: str, default: str | None = None) -> str:
        value = self.entries.get(key, default)
        if not isinstance(value, str) or not value:
            problem = Message("body_file.text", table=self.title, key=key, found=repr(value))
            raise self.error(problem, key if value is not None else "")
        return value

    def one_of(self, key: str, names: Sequence[str]) -> int:
        value = self.text(key)
        if value not in names:
            raise self.error(Message("body_file.no_part", table=self.title, key=key, found=value), key)
        return names.index(value)

    def numbers(
        self, key: str, shape: tuple[int | None, ...], default: Sequence[float] | float | None = None
    ) -> FloatArray:
        """Return finite numbers of a shape, in which None stands for any size."""
        value = self.entries.get(key, default)
        wanted = " x ".join("n" if size is None else str(size) for size in shape)
        try:
            array = np.array(value, np.float64)
        except (TypeError, ValueError, OverflowError):
            array = np.full((), np.nan)
        fits = array.ndim == len(shape) and all(
            size is None or size == got for size, got in zip(shape, array.shape, strict=True)
        )
        if not fits or not np.isfinite(array).all():
            shown = Message("body_file.nothing") if value is None else repr(value)[:60]
            raise self.error(
                Message("body_file.numbers", table=self.title, key=key, expected=wanted, found=shown)
                if shape
                else Message("body_file.number", table=self.title, key=key, found=shown),
                key if value is not None else "",
            )
        return array

    def unit(
        self, key: str, shape: tuple[int | None, ...], default: Sequence[float] | None = None, *, slack: float = 1e-3
    ) -> FloatArray:
        """Return rows of unit length, normalised if they are so within ``slack``, as what is typed has a few digits."""
        array = self.numbers(key, shape, default)
        with np.errstate(over="ignore"):  # then they are not of unit length
            lengths = np.linalg.norm(array, axis=-1, keepdims=True)
        wrong = lengths[np.abs(lengths - 1.0) > slack]
        if len(wrong):
            raise self.error(Message("body_file.unit", table=self.title, key=key, found=wrong[0]), key)
        exact = np.abs(lengths - 1.0) < 1e-12  # written by write_body: read back bit for bit
        return np.where(exact, array, array / lengths)


def _read_joint(part: _Table) -> tuple[FloatArray, FloatArray]:
    """Return axes (n, 3) and limits (n, 2) rad."""
    axes = part.unit("axes", (None, 3)) if "axes" in part.entries else np.zeros((0, 3))
    if not len(axes):
        return axes, np.zeros((0, 2))
    if ("limits" in part.entries) == ("limits_degrees" in part.entries):
        raise part.error(Message("body_file.limits", table=part.title))
    key = "limits" if "limits" in part.entries else "limits_degrees"
    limits = part.numbers(key, (len(axes), 2))
    return axes, limits if key == "limits" else np.radians(limits)


def _parent(part: _Table, names: Sequence[str], number: int) -> int:
    if "parent" not in part.entries:
        if number:
            raise part.error(Message("body_file.parent", table=part.title))
        return -1
    return part.one_of("parent", names)


def write_body(body: BodyModel, path: str | os.PathLike[str]) -> None:
    """Write a body as TOML so that `read_body` reads the same numbers; the file appears whole or not at all.

    Raises
    ------
    MotionWriteError : the folder is missing or read-only, or the disk is full.
    """
    lines = ["# metres, radians; axes of each part, root first", f"stature = {body.stature!r}"]
    for part, name in enumerate(body.names):
        count = int(body.n_axes[part])
        solid = body.spheres[slice(*body.sphere_starts[part : part + 2])]
        lines += ["", "[[part]]", f"name = {quote_toml(name)}", f"joint = {quote_toml(body.joints[part])}"]
        if part:
            lines.append(f"parent = {quote_toml(body.names[body.parents[part]])}")
        lines += [f"offset = {_row(body.offsets[part])}", f"rest = {_row(body.rest[part])}"]
        if count:
            lines.append(f"axes = {_rows(body.axes[part, :count])}")
            lines.append(f"limits = {_rows(body.limits[part, :count])}")
        if body.agility[part] != 1.0:
            lines.append(f"agility = {float(body.agility[part])!r}")
        if body.neutral[part, :count].any():
            lines.append(f"neutral = {_row(body.neutral[part, :count])}")
        if body.stiffness[part]:
            lines.append(f"stiffness = {float(body.stiffness[part])!r}")
        lines.append(f"spheres = {_rows(solid)}")
    for tip, name in enumerate(body.tips):
        owner = body.names[body.tip_parts[tip]]
        lines += ["", "[[tip]]", f"name = {quote_toml(name)}", f"part = {quote_toml(owner)}"]
        lines.append(f"offset = {_row(body.tip_offsets[tip])}")
    with atomic_write(path) as file:
        file.write(("\n".join(lines) + "\n").encode())


def _row(values: FloatArray) -> str:
    return "[" + ", ".join(repr(float(value)) for value in values) + "]"


def _rows(values: FloatArray) -> str:
    return "[" + ", ".join(_row(row) for row in values) + "]"
