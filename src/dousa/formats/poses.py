"""Common code of the formats of joint rotations: file units and axes to metres with Y up, world to local poses."""

from __future__ import annotations

import dataclasses
import os
from typing import Any

import numpy as np

from dousa.arrays import BoolArray, FloatArray
from dousa.errors import InvalidMotionError, MotionFileError
from dousa.messages import Message
from dousa.motion import Motion, Provenance, Skeleton, Trajectories, compute_rest_positions, forward_kinematics
from dousa.motion.canonical.reference_frame import infer_reference_frame, parse_unit, parse_up, to_reference_frame
from dousa.motion.rotations import conjugate, multiply, rotate

_SAMPLE_FRAMES = 16


def settle_motion(
    path: str | os.PathLike[str],
    format_name: str,
    skeleton: Skeleton,
    rotations: FloatArray,
    translations: FloatArray,
    frame_rate: float,
    *,
    unit: float | str | None,
    up: str | None,
    unit_in_file: float | None = None,
    up_in_file: str | None = None,
    declared_unit: float | None = None,
    default_up: str | None = "y",
    rest_in_world: bool = True,
    layout: Any = None,
    notes: tuple[Message, ...] = (),
) -> Motion:
    """Build a motion in metres with Y up from the content of a file.

    Parameters
    ----------
    path, format_name : for the provenance and the messages.
    skeleton : offsets in the file's unit and axes.
    rotations : (T, J, 4) local unit quaternions.
    translations : (T, J, 3) local positions in the file's unit and axes.
    frame_rate : Hz.
    unit, up : given by the caller, or None.
    unit_in_file, up_in_file : of the file or its format, or None.
    declared_unit : of the file or its format, rejected if the body would have an impossible height.
    default_up : usual in the format, if neither is there; None where it has none.
    rest_in_world : whether the rest pose stands in the axes of the file; else only the frames show the up axis.
    layout : of this format only.
    notes : for the user, on the reading of the file.

    Raises
    ------
    MotionFileError : arrays that make no motion, such as infinite positions.
    """
    known_unit = unit_in_file if unit is None else parse_unit(unit)
    known_up = up_in_file if up is None else parse_up(up)
    try:
        with np.errstate(over="ignore", invalid="ignore"):  # a damaged file may hold 1e300
            raw = Motion(skeleton, rotations, translations, frame_rate)
            count = min(raw.n_frames, _SAMPLE_FRAMES)
            frames = np.arange(count) * (raw.n_frames - 1) // max(count - 1, 1)
            positions, _ = forward_kinematics(skeleton.parents, raw.rotations[frames], raw.translations[frames])
            rest = compute_rest_positions(skeleton) if rest_in_world else None
            sample = Trajectories(skeleton.names, positions, 1.0, skeleton.parents, rest)
            frame = infer_reference_frame(
                sample, unit=known_unit, up=known_up, declared_unit=declared_unit, default_up=default_up
            )
            settled = to_reference_frame(raw, frame)
    except InvalidMotionError as error:
        raise MotionFileError(path, "markers.damaged", reason=error) from error
    provenance = Provenance(
        os.fspath(path),
        format_name,
        frame.unit,
        "declared" if unit is None and unit_in_file is not None else frame.unit_source,
        frame.up,
        "declared" if up is None and up_in_file is not None else frame.up_source,
        layout=layout,
        notes=(*notes, *frame.notes),
    )
    return dataclasses.replace(settled, provenance=provenance)


def localise(parents: Any, world: FloatArray, positions: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Compute local rotations (T, J, 4) and translations (T, J, 3) of joints from poses in the world.

    Parameters
    ----------
    parents : (J,) parent before child, -1 for a root.
    world : (T, J, 4) unit quaternions; NaN where missing.
    positions : (T, J, 3); NaN where missing.
    """
    rotations, translations = np.array(world), np.array(positions)
    for joint, parent in enumerate(parents):
        if parent >= 0:
            back = conjugate(world[:, parent])
            rotations[:, joint] = multiply(back, world[:, joint])
            translations[:, joint] = rotate(back, positions[:, joint] - positions[:, parent])
    return rotations, translations


def median_offsets(translations: FloatArray) -> FloatArray:
    """Compute the offsets (J, 3) of a skeleton as medians of the local positions (T, J, 3), root at 0."""
    counted: BoolArray = np.isfinite(translations.sum(axis=2))
    offsets = np.zeros(translations.shape[1:])
    for joint in range(1, translations.shape[1]):
        seen = translations[counted[:, joint], joint]
        if len(seen):
            offsets[joint] = np.median(seen, axis=0)
    return offsets


def order_tree(names: tuple[str, ...], parent_names: dict[str, str]) -> tuple[list[int], list[int]]:
    """Order the names with parents before children; return their indices and the parent of each in that order.

    Parameters
    ----------
    names : of the joints.
    parent_names : name of the parent by name; a joint without one, or whose parent is not among the names or is its
        own descendant, is a root.
    """
    known = {name: index for index, name in enumerate(names)}
    order: list[int] = []
    place: dict[int, int] = {}
    parents: list[int] = []
    for start in range(len(names)):
        chain = []
        joint: int | None = start
        while joint is not None and joint not in place and joint not in chain:
            chain.append(joint)
            joint = known.get(parent_names.get(names[joint], ""))
        for index in reversed(chain):
            above = known.get(parent_names.get(names[index], ""))
            parents.append(place.get(above, -1) if above is not None else -1)
            place[index] = len(order)
            order.append(index)
    return order, parents
