"""Qualisys TSV: markers (3D), or a skeleton with a quaternion for every segment.

Rows of a key and its values (``NO_OF_FRAMES``, ``FREQUENCY``, ``MARKER_NAMES`` ...), perhaps a row of column titles
(``Frame  Time  A X ...``), then a row per frame, usually millimetres, Z up. A marker that is not seen is blank,
``nan`` or 0, 0, 0. A skeleton has no ``MARKER_NAMES``; its titles name each segment before ``X Y Z QX QY QZ QW``.
Reference: Qualisys Track Manager, "TSV file formats".
"""

from __future__ import annotations

import os
import re

import numpy as np

from dousa.arrays import FloatArray
from dousa.errors import MotionFileError
from dousa.formats.assembly import settle_trajectories, settle_world
from dousa.formats.guard import Clock, check_points, compare_points
from dousa.formats.tables.cells import find_rows, list_lines, read_number
from dousa.formats.tables.usual_trees import guess_parents
from dousa.messages import Message
from dousa.motion import Motion, Trajectories
from dousa.motion.rotations import normalise

_KEY = re.compile(r"[A-Z][A-Z0-9_]{2,40}")
_SEGMENT = ["X", "Y", "Z", "QX", "QY", "QZ", "QW"]


def read_qualisys(
    path: str | os.PathLike[str], text: str, *, unit: float | str | None = None, up: str | None = None
) -> Motion | Trajectories:
    """Read markers or a skeleton from a TSV file that Qualisys Track Manager exported.

    Parameters
    ----------
    path : the file.
    text : of the file.
    unit : metres per unit; by default millimetres.
    up : axis that points up; by default Z unless the body stands along another.

    Raises
    ------
    MotionFileError : missing, damaged, rigid bodies (6D) without markers.
    """
    lines = list_lines(text, 42)
    check_points(path, max(line.count("\t") for line in lines) // 3)
    fields: dict[str, list[str]] = {}
    number = 0
    while number < min(len(lines), 40):
        key, *cells = (cell.strip() for cell in lines[number].split("\t"))
        if not _KEY.fullmatch(key) and (key or cells):
            break
        fields[key] = cells
        number += 1
    titles = [cell.strip() for cell in lines[number].split("\t")] if number < len(lines) else []
    first = number + (bool(titles) and not re.fullmatch(r"[\d.eE+-]*|nan", titles[0]))
    titles = titles[: len(titles) * (first - number)]
    if "BODY_NAMES" in fields and "MARKER_NAMES" not in fields:
        raise MotionFileError(path, "qualisys.bodies")
    if "MARKER_NAMES" not in fields:
        return _read_skeleton(path, fields, titles, text, first, unit, up)
    names = [name for name in fields["MARKER_NAMES"] if name]
    leading = next((index for index, title in enumerate(titles) if title not in ("Frame", "Time")), 0)
    width = leading + 3 * len(names)
    if not names:
        raise MotionFileError(path, "qualisys.no_names")
    values, clock, notes = _read_values(path, fields, titles[:leading], text, first, (width, width))
    points = values.reshape(len(values), len(names), 3)
    points[~points.any(axis=2)] = np.nan  # by the definition of the format
    return settle_trajectories(
        path, "qualisys", tuple(names), points, clock,
        unit=unit, up=up, declared_unit=0.001, default_up="z",
        notes=(*notes, *compare_points(read_number(fields.get("NO_OF_MARKERS")), len(names))),
    )  # fmt: skip


def _read_values(
    path: str | os.PathLike[str],
    fields: dict[str, list[str]],
    titles: list[str],
    text: str,
    first: int,
    width: tuple[int, int],
) -> tuple[FloatArray, Clock, tuple[Message, ...]]:
    """Numbers (T, columns) of the rows without what is under the titles, what the file says of time, and notes."""
    frames = read_number(fields.get("NO_OF_FRAMES"))
    rows, notes = find_rows(path, text, first, "\t", width, declared=frames)
    counted, values = rows.read(range(len(titles)), range(len(titles), width[0]))
    numbers, times = (counted[:, titles.index(t)] if t in titles else None for t in ("Frame", "Time"))
    return values, Clock(read_number(fields.get("FREQUENCY")), times, numbers, frames), notes


def _read_skeleton(
    path: str | os.PathLike[str],
    fields: dict[str, list[str]],
    titles: list[str],
    text: str,
    first: int,
    unit: float | str | None,
    up: str | None,
) -> Motion | Trajectories:
    starts = [i for i in range(len(titles)) if [t.upper() for t in titles[i + 1 : i + 8]] == _SEGMENT]
    names = [titles[index] for index in starts]
    if not names:
        raise MotionFileError(path, "qualisys.no_names")
    leading = titles[: starts[0]]
    values, clock, notes = _read_values(path, fields, leading, text, first, (starts[-1] + 8, len(titles)))
    blocks: FloatArray = np.stack([values[:, start - starts[0] + 1 :][:, :7] for start in starts], axis=1)
    positions, world = blocks[..., :3], normalise(blocks[..., [6, 3, 4, 5]])
    parents = guess_parents(names)
    if not parents:
        return settle_trajectories(
            path, "qualisys", tuple(names), positions, clock,
            unit=unit, up=up, declared_unit=0.001, default_up="z", notes=notes,
        )  # fmt: skip
    return settle_world(
        path, "qualisys", names, parents, world, positions, clock,
        unit=unit, up=up, unit_in_file=0.001, default_up="z", rest_in_world=False, notes=notes,
    )  # fmt: skip
