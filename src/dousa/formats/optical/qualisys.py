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
from dousa.files.disk import read_bytes
from dousa.formats.assembly import settle_trajectories, settle_world
from dousa.formats.optical.cells import guess_parents, read_rows, strip_owner
from dousa.motion import Motion, Trajectories
from dousa.motion.rotations import normalise

_KEY = re.compile(r"[A-Z][A-Z0-9_]{2,40}")
_SEGMENT = ["X", "Y", "Z", "QX", "QY", "QZ", "QW"]


def read_qualisys(
    path: str | os.PathLike[str], *, unit: float | str | None = None, up: str | None = None
) -> Motion | Trajectories:
    """Read markers or a skeleton from a TSV file that Qualisys Track Manager exported.

    Parameters
    ----------
    path : the file.
    unit : metres per unit; by default millimetres.
    up : axis that points up; by default Z unless the body stands along another.

    Raises
    ------
    MotionFileError : missing, damaged, rigid bodies (6D) without markers.
    """
    text = read_bytes(path).decode("utf-8-sig", errors="replace").replace("\r\n", "\n").replace("\r", "\n")
    rows = [line.split("\t") for line in text.split("\n")]
    fields: dict[str, list[str]] = {}
    number = 0
    while number < min(len(rows), 40) and (_KEY.fullmatch(rows[number][0].strip()) or not any(rows[number])):
        fields[rows[number][0].strip()] = [cell.strip() for cell in rows[number][1:]]
        number += 1
    rate = _read_rate(path, fields)
    titles = [cell.strip() for cell in rows[number]] if number < len(rows) else []
    has_titles = bool(titles) and not re.fullmatch(r"[\d.eE+-]*|nan", titles[0])
    first = number + has_titles
    lines = {n: row for n, row in enumerate(rows[first:], first + 1) if any(cell.strip() for cell in row)}
    if not lines:
        raise MotionFileError(path, "qualisys.no_frames", number)
    if "BODY_NAMES" in fields and "MARKER_NAMES" not in fields:
        raise MotionFileError(path, "qualisys.bodies")
    if "MARKER_NAMES" not in fields:
        return _read_skeleton(path, titles, lines, rate, unit, up)
    names = [name for name in fields["MARKER_NAMES"] if name]
    leading = 0
    if has_titles:
        leading = next((index for index, title in enumerate(titles) if title not in ("Frame", "Time")), 0)
    if not names or max(map(len, lines.values())) < leading + 3 * len(names):
        raise MotionFileError(
            path, "qualisys.width", first + 1, expected=leading + 3 * len(names), found=len(next(iter(lines.values())))
        )
    values = read_rows(path, [*lines.values()], [*lines], leading + 3 * len(names))[:, leading:]
    points = values.reshape(len(values), len(names), 3)
    points = np.where((points == 0).all(axis=2, keepdims=True), np.nan, points)
    return settle_trajectories(
        path, "qualisys", tuple(names), points, rate,
        unit=unit, up=up, unit_in_file=0.001, up_in_file=None, default_up="z",
    )  # fmt: skip


def _read_rate(path: str | os.PathLike[str], fields: dict[str, list[str]]) -> float:
    try:
        rate = float(fields["FREQUENCY"][0])
    except (LookupError, ValueError):
        rate = float("nan")
    if not 0 < rate <= 1e6:
        raise MotionFileError(path, "qualisys.rate")
    return rate


def _read_skeleton(
    path: str | os.PathLike[str],
    titles: list[str],
    lines: dict[int, list[str]],
    rate: float,
    unit: float | str | None,
    up: str | None,
) -> Motion | Trajectories:
    starts = [i for i in range(len(titles)) if [t.upper() for t in titles[i + 1 : i + 8]] == _SEGMENT]
    names = strip_owner([titles[index] for index in starts])
    if not names:
        raise MotionFileError(path, "qualisys.no_names")
    values = read_rows(path, [*lines.values()], [*lines], starts[-1] + 8)
    blocks: FloatArray = np.stack([values[:, start + 1 : start + 8] for start in starts], axis=1)
    positions, world = blocks[..., :3], normalise(blocks[..., [6, 3, 4, 5]])
    parents = guess_parents(names)
    if not parents:
        return settle_trajectories(
            path, "qualisys", tuple(names), positions, rate,
            unit=unit, up=up, unit_in_file=0.001, up_in_file=None, default_up="z",
        )  # fmt: skip
    return settle_world(
        path, "qualisys", names, parents, world, positions, rate,
        unit=unit, up=up, unit_in_file=0.001, default_up="z", rest_in_world=False,
    )  # fmt: skip
