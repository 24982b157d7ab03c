"""Positions of joints as a bare array (T, J, 3), as data sets and methods of machine learning save them.

Such a file has neither names nor unit nor rate. The layout follows from the number of joints; of several layouts, the
one whose bones have the most constant lengths over time and between left and right.
"""

from __future__ import annotations

import dataclasses
import os
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import FloatArray
from dousa.errors import MotionFileError
from dousa.formats.assembly import settle_trajectories
from dousa.formats.guard import Clock, check_memory, check_points
from dousa.formats.smpl import mean_body
from dousa.messages import Message
from dousa.motion import Trajectories
from dousa.motion.canonical.naming import match_names

_NAMES = ("joints", "positions", "keypoints3d_optim", "keypoints3d", "keypoints_3d", "joints3d", "poses_3d", "motion")
_LIMBS = (("shoulder", "elbow"), ("elbow", "wrist"), ("hip", "knee"), ("knee", "ankle"))
BODY_OF = {133: 17, 136: 26, 553: 33, 543: 33, 67: 25, 137: 25}
"""Points of the body among more, by the definition of COCO-WholeBody, HALPE 136, MediaPipe Holistic (FreeMoCap with
refined faces, and without) and OpenPose with hands, and with hands and face: the body comes first."""


@dataclass(frozen=True, slots=True)
class Layout:
    """Joint order of a data set: names, the rate in Hz and the up axis of its files."""

    title: str
    names: tuple[str, ...]
    rate: float
    up: str | None


@lru_cache(maxsize=1)
def list_layouts() -> tuple[Layout, ...]:
    """Return the layouts of ``layouts.toml``."""
    table: dict[str, Any] = tomllib.loads(resources.files(__package__).joinpath("layouts.toml").read_text("utf-8"))
    counts = {"SMPL-H": 52, "SMPL-X": 55}
    return tuple(
        Layout(
            title,
            mean_body(counts[title]).names if title in counts else tuple(row["names"]),
            row["rate"],
            row.get("up"),
        )
        for title, row in table.items()
    )


def is_joint_array(shape: tuple[int, ...]) -> bool:
    """Return whether an array of this shape can hold positions of joints over time."""
    trimmed = tuple(axis for axis in shape if axis != 1)
    counts = {len(layout.names) for layout in list_layouts()}
    return len(trimmed) == 3 and (trimmed[2] == 3 or (trimmed[0] in counts and trimmed[1] == 3))


def find_joints(arrays: Mapping[str, Any]) -> str | None:
    """Find the name of the array of joints: a usual name, else the only one of such a shape."""
    fitting = [name for name, array in arrays.items() if is_joint_array(array.shape)]
    return next((name for name in _NAMES if name in fitting), fitting[0] if len(fitting) == 1 else None)


def build_joints(
    path: str | os.PathLike[str],
    format_name: str,
    array: NDArray[Any],
    *,
    unit: float | str | None,
    up: str | None,
    frame_rate: float | None,
    names: tuple[str, ...] | None = None,
    notes: tuple[Message, ...] = (),
) -> Trajectories:
    """Build trajectories from an array of joints.

    Parameters
    ----------
    path, format_name : for messages and provenance.
    array : (T, J, 3) or (J, 3, T), with axes of length 1 anywhere; (T, J, 4) with a score of each, 0 for what was not
        seen.
    unit, up, frame_rate : as for `read_arrays`.
    names : (J,) of the file, if any.
    notes : for the user, on the reading of the file.
    """
    array = _without_scores(array)
    if not is_joint_array(array.shape):
        raise MotionFileError(path, "arrays.shape", found=str(array.shape))
    if os.path.isfile(path):  # an archive holds small numbers, squeezed
        check_memory(path, 8 * array.size, os.path.getsize(path))
    points = array.reshape([axis for axis in array.shape if axis != 1]).astype(np.float64)
    if points.shape[2] != 3:
        points = np.moveaxis(points, 2, 0)
    check_points(path, points.shape[1])
    if points.shape[1] in BODY_OF and names is None:
        points = points[:, : BODY_OF[points.shape[1]]]
    return name_joints(path, format_name, points, names, unit=unit, up=up, frame_rate=frame_rate, notes=notes)


def _without_scores(array: NDArray[Any]) -> NDArray[Any]:
    """Take the scores, from 0 to 1, off the places; the rows of quaternions have length 1 and stay."""
    if array.ndim < 3 or array.shape[-1] != 4 or not is_joint_array((*array.shape[:-1], 3)):
        return array
    places, scores = array[..., :3].astype(np.float64), array[..., 3]
    with np.errstate(over="ignore", invalid="ignore"):
        turns = np.abs(np.square(places).sum(axis=-1) + np.square(scores) - 1) < 1e-3
    if turns.all() or not ((scores >= 0) & (scores <= 1)).all():
        return array
    return np.where((scores > 0)[..., None], places, np.nan)


def name_joints(
    path: str | os.PathLike[str],
    format_name: str,
    points: FloatArray,
    names: tuple[str, ...] | None,
    *,
    unit: float | str | None,
    up: str | None,
    frame_rate: float | None,
    clock: Clock | None = None,
    unit_in_file: float | None = None,
    notes: tuple[Message, ...] = (),
) -> Trajectories:
    """Build trajectories of points that may lack names, unit, axes and rate.

    Parameters
    ----------
    path, format_name : for messages and provenance.
    points : (T, J, 3) in the file's unit and axes, NaN where missing.
    names : (J,) of the file; else those of the layout of this number of joints.
    unit, up, frame_rate : as for `read_arrays`.
    clock : what the file says about time, if anything.
    unit_in_file : metres per unit, declared in the file.
    notes : for the user, on the reading of the file.

    Raises
    ------
    MotionFileError : an unknown number of joints, an impossible rate.
    """
    if names is not None and len(names) == points.shape[1]:
        layout = next((known for known in list_layouts() if set(known.names) == set(names)), None)
    else:
        layout = _choose_layout(points)
        if layout is None:
            known = tuple(sorted({len(layout.names) for layout in list_layouts()}))
            raise MotionFileError(path, "arrays.joints", found=points.shape[1], known=known)
        names = layout.names
        notes += (Message("arrays.layout", joints=len(names), layout=layout.title),)
    clock = dataclasses.replace(clock or Clock(), assumed=layout.rate if layout else 30.0)
    if frame_rate is not None:
        clock = dataclasses.replace(clock, rate=frame_rate, times=None)
    return settle_trajectories(
        path, format_name, names, points, clock,
        unit=unit, up=up, declared_unit=unit_in_file, default_up=layout.up if layout else None, notes=notes,
    )  # fmt: skip


def _choose_layout(points: FloatArray) -> Layout | None:
    """Layout of this number of joints with the most constant limb lengths over time and between the sides."""
    fitting = [layout for layout in list_layouts() if len(layout.names) == points.shape[1]]
    return min(fitting, key=lambda layout: measure_unevenness(points, layout.names)) if fitting else None


def measure_unevenness(points: FloatArray, names: tuple[str, ...]) -> float:
    """Measure how the lengths of four limbs spread over frames (T, J, 3) and sides: the sum of shares of the length."""
    match = match_names(names)
    if match is None or match.missing:
        return float("inf")
    sample = points[:: max(1, len(points) // 50)]
    total = 0.0
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        for start, end in _LIMBS:
            sides = []
            for side in ("left_", "right_"):
                first, last = (sample[:, list(match.sources[side + joint])].mean(axis=1) for joint in (start, end))
                sides.append(np.linalg.norm(first - last, axis=1))
            lengths = np.concatenate(sides)
            lengths = lengths[np.isfinite(lengths)]
            total += float(lengths.std() / lengths.mean()) if len(lengths) else 1.0
    return total if np.isfinite(total) else 1e9
