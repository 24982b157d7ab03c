"""Joint angles of bvh-toolbox: three tables of one motion, NAME_rot.csv, NAME_hierarchy.csv and NAME_pos.csv.

The angles are degrees in the order of the columns (``Hips.z, Hips.x, Hips.y``), the hierarchy has a row for every joint
(``joint, parent, offset.x, offset.y, offset.z``), ends without angles included, and the positions move the root.
"""

from __future__ import annotations

import os
import re
from pathlib import Path

import numpy as np

from dousa.arrays import FloatArray
from dousa.errors import MotionFileError
from dousa.files.disk import read_bytes
from dousa.formats.assembly import settle_motion
from dousa.formats.guard import Clock
from dousa.formats.tables.cells import count_cells, decode, find_rows, list_lines, split_rows
from dousa.messages import Message
from dousa.motion import Motion, Skeleton
from dousa.motion.rotations import from_euler, identity

_ANGLES = re.compile(r"(.*)_(?:rot|rotations?)\.csv", re.IGNORECASE)


def is_of_angles(path: str | os.PathLike[str]) -> bool:
    """Return whether a table is one of angles by its name."""
    return _ANGLES.fullmatch(os.path.basename(os.fspath(path))) is not None


def read_angles(path: str | os.PathLike[str], *, unit: float | str | None, up: str | None) -> Motion:
    """Read the motion of a table of angles with the hierarchy, and the places of the root, of the tables beside it.

    Raises
    ------
    MotionFileError : no hierarchy beside it, joints without angles, numbers that are none.
    """
    name = _ANGLES.fullmatch(os.path.basename(os.fspath(path)))
    stem = Path(path).parent / (name[1] if name else "")
    tree, moved = Path(f"{stem}_hierarchy.csv"), Path(f"{stem}_pos.csv")
    if not tree.exists():
        raise MotionFileError(path, "tables.no_hierarchy", file=tree.name)
    text = decode(read_bytes(tree))
    rows, _ = find_rows(tree, text, 1, ",", (5, text.partition("\n")[0].count(",") + 1))
    joints = split_rows(rows.text.split("\n"), ",")
    names = tuple(row[0].strip() for row in joints)
    above = {row[0].strip(): row[1].strip() for row in joints}
    parents = [names.index(above[joint]) if above[joint] in names else -1 for joint in names]
    if not names or any(parent >= n for n, parent in enumerate(parents)):
        raise MotionFileError(tree, "tables.no_tree")
    (offsets,) = rows.read((2, 3, 4))
    values, turns, notes = _read_columns(path)
    lacking = tuple(joint for joint in names if joint in above.values() and sorted(turns.get(joint, {})) != list("xyz"))
    if lacking:
        raise MotionFileError(path, "tables.no_angles", joints=lacking)
    rotations = identity((len(values), len(names)))
    for number, joint in enumerate(names):
        if joint in turns:
            own = turns[joint]
            rotations[:, number] = from_euler(np.radians(values[:, list(own.values())]), "".join(own).upper())
    translations = np.tile(offsets, (len(values), 1, 1))
    if moved.exists():
        places, columns, more = _read_columns(moved)
        notes += more
        own = columns.get(names[0], {})
        if len(places) != len(values) or sorted(own) != list("xyz"):
            raise MotionFileError(moved, "tables.other_frames", expected=len(values), found=len(places), joint=names[0])
        translations[:, 0] = places[:, [own[axis] for axis in "xyz"]]
    ends = np.array([joint not in turns for joint in names])
    return settle_motion(
        path, "csv", Skeleton(names, np.array(parents), offsets, ends), rotations, translations,
        Clock(None, values[:, 0], assumed=30.0), unit=unit, up=up, notes=notes,
    )  # fmt: skip


def _read_columns(
    path: str | os.PathLike[str],
) -> tuple[FloatArray, dict[str, dict[str, int]], tuple[Message, ...]]:
    """The numbers, the times first, of each joint the columns by axis in the order of the table, and notes."""
    text = decode(read_bytes(path))
    (titles,) = split_rows(list_lines(text, 1), ",")
    columns: dict[str, dict[str, int]] = {}
    for number, title in enumerate(titles):
        joint, dot, axis = title.strip().rpartition(".")
        if dot and axis.lower() in ("x", "y", "z"):
            columns.setdefault(joint, {})[axis.lower()] = number
    rows, notes = find_rows(path, text, 1, ",", count_cells(titles))
    return rows.read(range(len(titles)))[0], columns, notes
