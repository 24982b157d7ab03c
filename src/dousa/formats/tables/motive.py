"""OptiTrack Motive CSV: markers, rigid bodies and skeletons, a column each.

A first row of keys and values (``Format Version``, frame rates, ``Rotation Type``, ``Length Units``), then rows
``Type``, ``Name``, ``ID``, from version 1.24 ``Parent``, then ``Rotation``/``Position``, then ``Frame, Time, X, Y, Z, W
...``, then a row per frame. Y up, right-handed. Reference: OptiTrack documentation, "Data Export: CSV".

A skeleton is read as a motion if its tree is known (by the row ``Parent`` or by the usual names) and its rotations are
quaternions or Euler angles; else the positions of its bones; without bones the labelled markers.
"""

from __future__ import annotations

import csv
import math
import os
import re
from dataclasses import dataclass

import numpy as np

from dousa.arrays import FloatArray
from dousa.errors import MotionFileError, MotionWriteError
from dousa.files.disk import atomic_write
from dousa.formats.assembly import declared_unit, settle_trajectories, settle_world
from dousa.formats.guard import Clock, check_points
from dousa.formats.tables.cells import count_cells, find_rows, list_lines, read_number
from dousa.formats.tables.usual_trees import guess_parents
from dousa.messages import Message
from dousa.motion import Motion, Trajectories, forward_kinematics
from dousa.motion.rotations import from_euler, normalise

_UNLABELLED = re.compile(r"(?:.*:)?(?:Unlabeled\b.*|\d+)", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class _Table:
    """The header: its fields, and the columns of every asset by (type, name)."""

    fields: dict[str, str]
    columns: dict[tuple[str, str], dict[str, list[int]]]
    parents: dict[str, str]
    notes: tuple[Message, ...]
    """Of assets whose columns are not X, Y, Z (and W) of a quantity, and of rows of other widths in the header."""
    cells: tuple[int, int]
    """Titles of the columns, as `count_cells` has it."""
    body: int


def read_motive(
    path: str | os.PathLike[str], text: str, *, unit: float | str | None = None, up: str | None = None
) -> Motion | Trajectories:
    """Read a CSV file that Motive exported: bones or markers.

    Parameters
    ----------
    path : the file.
    text : of the file.
    unit : metres per unit; by default that of the header.
    up : axis that points up; by default Y unless the body stands along another.

    Raises
    ------
    MotionFileError : missing, damaged, neither bones nor labelled markers.
    """
    lines = list_lines(text, 12)
    check_points(path, max(line.count(",") for line in lines) // 7)  # numbers of a bone
    table = _read_header(path, list(csv.reader(lines)))
    kinds = {kind for kind, _ in table.columns}
    kind = next(
        (kind for kind in ("bone", "marker", "bonemarker", "rigidbodymarker", "rigidbody") if kind in kinds), None
    )
    assets = [(name, columns) for (other, name), columns in table.columns.items() if other == kind]
    assets = [(name, c) for name, c in assets if len(c.get("position", [])) == 3 and not _UNLABELLED.fullmatch(name)]
    if kind is None or not assets:
        raise MotionFileError(path, "motive.nothing")
    frames = read_number(table.fields.get("total exported frames"))
    rows, notes = find_rows(path, text, table.body, ",", table.cells, declared=frames)
    names = [name for name, _ in assets]
    given = {
        child: parent if parent in names else f"{child.rpartition(':')[0]}:{parent}"
        for child, parent in table.parents.items()
    }
    parents = given or guess_parents(names)
    turning = _find_turns(table.fields, assets) if kind == "bone" and any(p in names for p in parents.values()) else []
    places = [column for _, columns in assets for column in columns["position"]]
    counted, positions, turns = rows.read((0, 1), places, turning)
    positions = positions.reshape(len(positions), len(names), 3)
    rates = (read_number(table.fields.get(key)) for key in ("export frame rate", "capture frame rate"))
    clock = Clock(next((rate for rate in rates if rate is not None), None), counted[:, 1], counted[:, 0], frames)
    notes += table.notes
    unit_in_file = declared_unit(table.fields.get("length units", ""))
    del text, rows
    # Rigid bodies and bones that are not solved are blank; markers of older versions lie at the origin.
    if not turning:
        return settle_trajectories(
            path, "motive", tuple(names), positions, clock,
            unit=unit, up=up, declared_unit=unit_in_file, notes=notes,
        )  # fmt: skip
    return settle_world(
        path, "motive", names, parents, _read_turns(table.fields, turns, len(names)), positions, clock,
        are_local=table.fields.get("coordinate space", "global").lower() == "local",
        unit=unit, up=up, unit_in_file=unit_in_file, notes=notes,
    )  # fmt: skip


def _read_header(path: str | os.PathLike[str], rows: list[list[str]]) -> _Table:
    first = [cell.strip() for cell in rows[0]] if rows else []
    fields = {key.lower(): value for key, value in zip(first[::2], first[1::2], strict=False)}
    labelled: dict[str, list[str]] = {}
    for number, row in enumerate(rows[1:12], 1):
        cells = [cell.strip() for cell in row]
        key = (cells[1] if len(cells) > 1 else "").lower().replace(" ", "")
        if key in ("type", "name", "parent"):
            labelled[key] = cells
        elif cells and cells[0].lower() == "frame":
            if "name" not in labelled:
                break
            what = [cell.strip() for cell in rows[number - 1]]
            columns, parents, notes = _read_columns(labelled, what, cells)
            uneven = [(n, len(row)) for n, row in enumerate(rows[1:number], 2) if len(row) not in (0, len(cells))]
            if uneven:
                line, found = uneven[0]
                notes += (Message("motive.header", line=line, found=found, expected=len(cells)),)
            return _Table(fields, columns, parents, notes, count_cells(cells), number + 1)
    raise MotionFileError(path, "motive.no_names")


def _read_columns(
    labelled: dict[str, list[str]], what: list[str], axes: list[str]
) -> tuple[dict[tuple[str, str], dict[str, list[int]]], dict[str, str], tuple[Message, ...]]:
    names, kinds = labelled["name"], labelled.get("type", [])
    columns: dict[tuple[str, str], dict[str, list[int]]] = {}
    parents: dict[str, str] = {}
    above = labelled.get("parent", [])
    for column in range(2, min(len(names), len(what), len(axes))):
        kind = kinds[column].lower().replace(" ", "") if column < len(kinds) else "marker"
        quantity = what[column].lower()
        if axes[column].upper() not in ("X", "Y", "Z", "W") or quantity not in ("rotation", "position"):
            continue
        columns.setdefault((kind, names[column]), {}).setdefault(quantity, []).append(column)
        if column < len(above) and above[column] and kind == "bone":
            parents[names[column]] = above[column]
    odd = {
        name: None
        for (_, name), quantities in columns.items()
        for found in quantities.values()
        if "".join(axes[column].upper() for column in found) not in ("XYZ", "XYZW")
    }
    notes = (Message("motive.columns", n=len(odd), name=next(iter(odd))),) if odd else ()
    return columns, parents, notes


def _turn_order(fields: dict[str, str]) -> str:
    return fields.get("rotation type", "quaternion").upper()


def _find_turns(fields: dict[str, str], assets: list[tuple[str, dict[str, list[int]]]]) -> list[int]:
    """The columns of the rotations; none if the file has other rotations than are known, or lacks some."""
    order = _turn_order(fields)
    width = 4 if order == "QUATERNION" else 3 if sorted(order) == ["X", "Y", "Z"] else 0
    if any(len(columns.get("rotation", [])) != width for _, columns in assets):
        return []
    return [column for _, columns in assets for column in columns.get("rotation", [])]


def _read_turns(fields: dict[str, str], turns: FloatArray, count: int) -> FloatArray:
    """(T, J, 4) unit quaternions in the world."""
    order = _turn_order(fields)
    numbers = turns.reshape(len(turns), count, -1)
    if order == "QUATERNION":
        return normalise(numbers[..., [3, 0, 1, 2]])
    # The columns are X, Y, Z, whatever the order of the turns.
    return from_euler(np.radians(numbers[..., ["XYZ".index(letter) for letter in order]]), order)


def write_motive(motion: Motion | Trajectories, path: str | os.PathLike[str]) -> None:
    """Write a table as Motive exports it: metres, Y up, rotations of bones as quaternions in the world.

    A motion is written with the row ``Parent`` of version 1.24; missing values are blank.

    Raises
    ------
    MotionWriteError : a name with a comma, a quote or a line break, a disk error.
    """
    bones = isinstance(motion, Motion)
    names = motion.skeleton.names if isinstance(motion, Motion) else motion.names
    for name in names:
        if not name.strip() or any(sign in name for sign in ',"\r\n'):
            raise MotionWriteError(path, "motive.name", name=name)
    if isinstance(motion, Motion):
        skeleton = motion.skeleton
        positions, world = forward_kinematics(skeleton.parents, motion.rotations, motion.translations)
        values = np.concatenate((world[..., [1, 2, 3, 0]], positions), axis=2)
        above = tuple(names[parent] if parent >= 0 else "" for parent in skeleton.parents)
    else:
        values, above = motion.positions, ()
    width = values.shape[2]
    rate = repr(float(motion.frame_rate))
    keys = (
        "Format Version", "1.24", "Take Name", "dousa", "Capture Frame Rate", rate, "Export Frame Rate", rate,
        "Total Exported Frames", str(motion.n_frames), "Rotation Type", "Quaternion", "Length Units", "Meters",
        "Coordinate Space", "Global",
    )  # fmt: skip

    def spread(title: str, cells: tuple[str, ...]) -> str:
        return ",".join(("", title, *(cell for cell in cells for _ in range(width))))

    kind = "Bone" if bones else "Marker"
    rows = [",".join(keys), "", spread("Type", (kind,) * len(names)), spread("Name", names)]
    rows.append(spread("ID", tuple(str(number) for number in range(1, len(names) + 1))))
    if bones:
        rows.append(spread("Parent", above))
    rotations = ("Rotation",) * 4 if bones else ()
    quantities, axes = (*rotations, *("Position",) * 3), "XYZWXYZ" if bones else "XYZ"
    rows.append(",".join(("", "", *quantities * len(names))))
    rows.append(",".join(("Frame", "Time (Seconds)", *axes * len(names))))
    with atomic_write(path) as file:
        file.write(("\r\n".join(rows) + "\r\n").encode())
        for frame, row in enumerate(values.reshape(motion.n_frames, -1).tolist()):
            cells = ",".join("" if math.isnan(value) else repr(value) for value in row)
            file.write(f"{frame},{frame / motion.frame_rate!r},{cells}\r\n".encode())
