"""Bones of PMX and PMD models, and a template body.

Places are in units of the file with z mirrored (right-handed, facing +Z), see `vmd`.
Reference: PMX 2.0/2.1 and PMD as described with MikuMikuDance and PMX Editor.
"""

from __future__ import annotations

import os
import tomllib
from dataclasses import dataclass, field
from importlib import resources
from typing import Any

import numpy as np

from dousa.arrays import FloatArray
from dousa.errors import MotionFileError
from dousa.files.disk import read_bytes
from dousa.formats.mmd.vmd import Cursor, decode_name

SUFFIXES = (".pmx", ".pmd")
_TAIL, _IK, _TURNS_WITH, _MOVES_WITH, _FIXED, _LOCAL, _OUTSIDE = 0x01, 0x20, 0x100, 0x200, 0x400, 0x800, 0x2000


@dataclass(frozen=True, slots=True, eq=False)
class IkChain:
    """Target bone of an IK bone, and the links that turn, the one nearest to the target first."""

    target: int
    links: tuple[int, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Bone:
    """One bone of a model.

    Parameters
    ----------
    name : Japanese, as in motions.
    parent : number of its parent bone, -1 for none.
    place : (3,) at rest.
    end : (3,) place where it ends, None if given by another bone.
    source, share : bone whose turns (``turns``) or moves (``moves``) it follows by a share; -1 for none.
    ik : its IK chain.
    """

    name: str
    parent: int
    place: FloatArray
    end: FloatArray | None = None
    source: int = -1
    share: float = 0.0
    turns: bool = False
    moves: bool = False
    ik: IkChain | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Model:
    """Bones of a model, parents before children and sources before those that follow them in ``order``."""

    name: str
    bones: tuple[Bone, ...]
    order: tuple[int, ...] = field(default=())


def find_model(path: str | os.PathLike[str]) -> str | None:
    """Find the model beside a motion: the only one of the folder, or the one of the same name."""
    folder, own = os.path.split(os.path.abspath(path))
    try:
        found = sorted(name for name in os.listdir(folder) if name.lower().endswith(SUFFIXES))
    except OSError:
        return None
    named = [name for name in found if os.path.splitext(name)[0] == os.path.splitext(own)[0]]
    chosen = found if len(found) == 1 else named
    return os.path.join(folder, chosen[0]) if len(chosen) == 1 else None


def load_model(path: str | os.PathLike[str]) -> Model:
    """Load the bones of a PMX or PMD file; MotionFileError if damaged, no model, or the bones form no tree."""
    cursor = Cursor(path, read_bytes(path))
    if cursor.data[:4] == b"PMX ":
        return _order(cursor, *_read_pmx(cursor))
    if cursor.data[:3] == b"Pmd":
        return _order(cursor, *_read_pmd(cursor))
    raise MotionFileError(path, "mmd.no_model")


def _order(cursor: Cursor, name: str, bones: list[Bone], most: int = 10_000) -> Model:
    """The model with an order in which every bone follows those that it depends on."""
    if not bones or len(bones) > most:
        raise cursor.fail("mmd.many_bones", found=len(bones), most=most)
    numbers = {number for bone in bones for number in _links(bone)}
    if not numbers <= set(range(-1, len(bones))):
        raise cursor.fail("mmd.bone_number", count=len(bones))
    if not all(np.isfinite(bone.place).all() and np.abs(bone.place).max() < 1e6 for bone in bones):
        raise cursor.fail("mmd.finite")
    state, order = [0] * len(bones), []
    for start in range(len(bones)):
        waiting = [start]
        while waiting:
            number = waiting[-1]
            before = [n for n in (bones[number].parent, bones[number].source) if n >= 0 and state[n] < 2]
            if state[number] == 2:
                waiting.pop()
            elif before and state[number] == 0:
                state[number] = 1
                if any(state[n] == 1 for n in before):
                    raise cursor.fail("mmd.tree", bone=bones[number].name)
                waiting += before
            else:
                state[number] = 2
                order.append(waiting.pop())
    return Model(name, tuple(bones), tuple(order))


def _links(bone: Bone) -> list[int]:
    return [bone.parent, bone.source, *((bone.ik.target, *bone.ik.links) if bone.ik else ())]


def _vector(values: tuple[float, ...]) -> FloatArray:
    return np.array(values, np.float64) * (1, 1, -1)


def _read_pmx(cursor: Cursor) -> tuple[str, list[Bone]]:
    cursor.take(4)
    version, n_globals = cursor.unpack("fB")
    settings = cursor.take(n_globals)
    if not 1.9 < version < 3 or n_globals < 8 or settings[0] > 1 or settings[1] > 4:
        raise cursor.fail("mmd.version", found=f"{version:g}")
    encoding = "utf-16-le" if settings[0] == 0 else "utf-8"
    vertex, texture, _, bone = settings[2:6]
    if not {vertex, texture, bone} <= {1, 2, 4}:
        raise cursor.fail("mmd.version", found=f"{version:g}")

    def text() -> str:
        return cursor.take(cursor.count("i", 1)).decode(encoding, "replace")[:1_000_000]

    name = text()
    for _ in range(3):
        text()
    _skip_vertices(cursor, settings[1], bone)
    cursor.take(cursor.count("i", vertex) * vertex)
    for _ in range(cursor.count("i", 4)):
        text()
    for _ in range(cursor.count("i", 80)):
        text(), text()
        cursor.take(4 * 11 + 1 + 4 * 5 + 2 * texture + 1)
        cursor.take(texture if cursor.take(1) == b"\0" else 1)
        text()
        cursor.take(4)
    bones = []
    for _ in range(cursor.count("i", 26)):
        names = text(), text()
        bones.append(_read_bone(cursor, names[0] or names[1], bone))
    places = [b.place for b in bones]
    return name, [_settle_end(b, places) for b in bones]


def _skip_vertices(cursor: Cursor, n_extra: int, bone: int) -> None:
    """Skip vertices, whose sizes depend on the kind of their weights."""
    weights = {0: bone, 1: 2 * bone + 4, 2: 4 * bone + 16, 3: 2 * bone + 40, 4: 4 * bone + 16}
    head = 32 + 16 * n_extra
    data, place = cursor.data, 0
    number = cursor.count("i", head + 5 + bone)
    place, end = cursor.place, len(data) - 1
    for _ in range(number):
        kind = weights.get(data[place + head]) if place + head < end else None
        if kind is None:
            raise cursor.fail("mmd.truncated", place=place)
        place += head + 1 + kind + 4
    cursor.take(place - cursor.place)


def _read_bone(cursor: Cursor, name: str, size: int) -> Bone:
    place = _vector(cursor.unpack("3f"))
    parent = cursor.index(size)
    _, flags = cursor.unpack("iH")
    end: Any = cursor.index(size) if flags & _TAIL else place + _vector(cursor.unpack("3f"))
    source, share = -1, 0.0
    if flags & (_TURNS_WITH | _MOVES_WITH):
        source, share = cursor.index(size), cursor.unpack("f")[0]
    cursor.take(12 * bool(flags & _FIXED) + 24 * bool(flags & _LOCAL) + 4 * bool(flags & _OUTSIDE))
    ik = None
    if flags & _IK:
        target = cursor.index(size)
        cursor.take(8)
        links = []
        for _ in range(cursor.count("i", size + 1)):
            links.append(cursor.index(size))
            cursor.take(24 if cursor.take(1) != b"\0" else 0)
        ik = IkChain(target, tuple(links))
    share = float(share) if np.isfinite(share) and abs(share) < 100 else 0.0
    return Bone(
        name, parent, place, np.array([end]) if isinstance(end, int) else end, source, share,
        bool(flags & _TURNS_WITH), bool(flags & _MOVES_WITH), ik,
    )  # fmt: skip


def _settle_end(bone: Bone, places: list[FloatArray]) -> Bone:
    """The end of a bone as a place, where the file names another bone."""
    from dataclasses import replace

    end = bone.end
    if end is not None and len(end) == 1:
        number = int(end[0])
        end = places[number] if 0 <= number < len(places) else None
    return replace(bone, end=end if end is not None and np.isfinite(end).all() else None)


def _read_pmd(cursor: Cursor) -> tuple[str, list[Bone]]:
    cursor.take(7)
    name = decode_name(cursor.take(20))
    cursor.take(256)
    for form, size in (("I", 38), ("I", 2), ("I", 70)):
        cursor.take(cursor.count(form, size) * size)
    rows = [cursor.unpack("20sHHBH3f") for _ in range(cursor.count("H", 39))]
    chains = {}
    for _ in range(cursor.count("H", 11)):
        bone, target, number, _, _ = cursor.unpack("HHBHf")
        chains[bone] = IkChain(target, cursor.unpack(f"{number}H"))
    bones = []
    for number, (raw, parent, _, _, _, *place) in enumerate(rows):
        above = -1 if parent == 0xFFFF else parent
        bones.append(Bone(decode_name(raw), above, _vector(tuple(place)), ik=chains.get(number)))
    return name, bones


def template() -> Model:
    """Return the body of ``template.toml``, for motions without their model."""
    table: dict[str, Any] = tomllib.loads(resources.files(__package__).joinpath("template.toml").read_text("utf-8"))
    rows = [(name, parent, np.array(place)) for name, parent, place in table["bones"]]
    for side, sign in (("左", 1.0), ("右", -1.0)):
        mirror = np.array([sign, 1.0, 1.0])
        rows += [(side + n, p.replace("左", side), np.array(place) * mirror) for n, p, place in table["left"]]
        along = np.array(table["arm"])
        elbow = np.array(next(place for n, _, place in table["left"] if n == "腕")) + table["upper_arm"] * along
        wrist = elbow + table["forearm"] * along
        rows += [(f"{side}{n}", f"{side}{p}", place * mirror) for n, p, place in (
            ("腕捩", "腕", elbow - 0.4 * table["upper_arm"] * along), ("ひじ", "腕捩", elbow),
            ("手捩", "ひじ", wrist - 0.4 * table["forearm"] * along), ("手首", "手捩", wrist),
        )]  # fmt: skip
        for finger, numbers, out, front, lengths in table["fingers"]:
            above, place = f"{side}手首", wrist + out * along + (0, 0, front)
            for number, length in zip(numbers, lengths, strict=True):
                rows.append((f"{side}{finger}{number}", above, place * mirror))
                above, place = f"{side}{finger}{number}", place + length * along
    return _build_template(rows, table["end"])


def _build_template(rows: list[tuple[str, str, FloatArray]], ends: dict[str, list[float]]) -> Model:
    number = {name: index for index, (name, _, _) in enumerate(rows)}
    bones = []
    for name, parent, place in rows:
        side = name[0]
        source = {f"{side}肩C": f"{side}肩P", f"{side}腰キャンセル": "腰"}.get(name)
        links = {f"{side}足ＩＫ": ("足首", "ひざ", "足"), f"{side}つま先ＩＫ": ("つま先", "足首")}.get(name)
        chain = [number[side + link] for link in links] if links else []
        bones.append(Bone(
            name, number.get(parent, -1), place, np.array(ends[name]) if name in ends else None,
            number[source] if source else -1, -1.0 if source else 0.0, bool(source), False,
            IkChain(chain[0], tuple(chain[1:])) if chain else None,
        ))  # fmt: skip
    return _order(Cursor("template.toml", b""), "", bones)
