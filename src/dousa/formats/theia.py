"""Segments of markerless systems (Theia3D): poses as 4 x 4 matrices in C3D files, beside or instead of points.

A matrix has the axes of a segment in its first three columns and its origin, the joint nearer to the trunk, in the
fourth. It is stored column by column, then a residual, negative where the segment was not found
(c3d.org, "Rotation data").
"""

from __future__ import annotations

import os
import re
from collections.abc import Sequence

import numpy as np

from dousa.arrays import FloatArray
from dousa.errors import MotionFileError
from dousa.formats.assembly import declared_unit, settle_world
from dousa.motion import Motion
from dousa.motion.rotations import from_matrix

ITEMS = 17
"""Numbers of a segment in a frame: a matrix and a residual (c3d.org, "Rotation data": the format's definition)."""

_SUFFIX = re.compile(r"_4x4$", re.IGNORECASE)
_WORLD = ("worldbody", "world", "lab")
_PARENTS = {
    "abdomen": ("pelvis",), "torso": ("abdomen", "pelvis"), "thorax": ("abdomen", "pelvis"),
    "neck": ("torso", "thorax", "pelvis"), "head": ("neck", "torso", "thorax"),
    "clavicle": ("torso", "thorax"), "uarm": ("clavicle", "torso", "thorax"), "larm": ("uarm",), "hand": ("larm",),
    "thigh": ("pelvis",), "shank": ("thigh",), "foot": ("shank",), "toes": ("foot",),
}  # fmt: skip


def build_segments(
    path: str | os.PathLike[str],
    labels: Sequence[str],
    values: FloatArray,
    frame_rate: float,
    *,
    unit: float | str | None,
    up: str | None,
    unit_in_file: str,
) -> Motion:
    """Build the motion of segments.

    Parameters
    ----------
    path : for the messages.
    labels : (K,) names of the segments.
    values : (T, K, 17) as in the file.
    frame_rate : Hz.
    unit, up : given by the caller, or None.
    unit_in_file : named in the file.

    Raises
    ------
    MotionFileError : no segment was ever found.
    """
    bare = [_SUFFIX.sub("", label) for label in labels]
    kept = [index for index, name in enumerate(bare) if name.lower() not in _WORLD]
    names = [bare[index] for index in kept]
    numbers = values[:, kept].astype(np.float64)
    lost = (numbers[..., 16] < 0) | ~np.isfinite(numbers[..., :16]).all(axis=2)
    if not names or lost.all():
        raise MotionFileError(path, "c3d.no_points")
    # Columns of 4 x 4 numbers: three axes, then the origin.
    columns = np.where(lost[..., None], 0.0, numbers[..., :16]).reshape(*lost.shape, 4, 4)
    axes = np.where(lost[..., None, None], np.eye(3), np.swapaxes(columns[..., :3, :3], -1, -2))
    turns = from_matrix(axes)
    turns[lost] = np.nan
    places = np.where(lost[..., None], np.nan, columns[..., 3, :3])
    return settle_world(
        path, "c3d", names, _find_parents(names), turns, places, frame_rate,
        unit=unit, up=up, declared_unit=declared_unit(unit_in_file), default_up="z", rest_in_world=False,
    )  # fmt: skip


def _find_parents(names: list[str]) -> dict[str, str]:
    """Name of the parent by name; segments of the sides hang on those of their side, else on the trunk."""
    lower = {name.lower(): name for name in names}
    parents = {}
    for name in names:
        side, _, part = name.lower().rpartition("_")
        for parent in _PARENTS.get(part, ()):
            above = lower.get(f"{side}_{parent}") or lower.get(parent)
            if above is not None:
                parents[name] = above
                break
    return parents
