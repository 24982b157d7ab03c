"""From channel values (Euler angles, positions) to poses (quaternions, translations), for BVH and AMC."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from dousa.arrays import FloatArray, IntArray
from dousa.formats.assembly import LONGEST, settle_motion
from dousa.formats.guard import Clock, check_memory
from dousa.kernels import is_worth_compiling, kernel, part
from dousa.motion.types import Motion, Skeleton, freeze


@dataclass(frozen=True, slots=True, eq=False)
class ChannelProgram:
    """Meaning of the columns of a file for each joint, all lengths in file units.

    Parameters
    ----------
    skeleton : joints with offsets in file units.
    starts : (J + 1,) steps of joint j are ``starts[j]:starts[j + 1]``, in the order they are applied.
    kinds : per step 0, 1, 2: the x, y, z position, which replaces the offset; 3, 4, 5: a turn about x, y, z.
    columns : per step the column of its value.
    half_angle : radians of half a turn of one unit: pi / 360 for degrees, 1/2 for radians.
    axes : (J, 3, 3) in Acclaim files the orientation C of a bone's axes: a turn M becomes C M C^-1, and positions t are
        added to the offset as C t; (0, 3, 3) where the axes are the joints' own and positions replace the offset.
    added : joints whose positions are added, not replaced.
    stretches : (joint, column, direction): the joint moves by the column's value along the direction.
    """

    skeleton: Skeleton
    starts: IntArray
    kinds: IntArray
    columns: IntArray
    half_angle: float
    axes: FloatArray = field(default_factory=lambda: np.empty((0, 3, 3)))
    stretches: tuple[tuple[int, int, tuple[float, float, float]], ...] = ()
    added: tuple[int, ...] = field(init=False)

    def __post_init__(self) -> None:
        moved = (joint for joint in range(len(self.axes)) if (self._kinds_of(joint) < 3).any())
        object.__setattr__(self, "added", tuple(moved))

    def _kinds_of(self, joint: int) -> IntArray:
        return self.kinds[self.starts[joint] : self.starts[joint + 1]]


def _pose(
    t: Any, values: Any, offsets: Any, starts: Any, kinds: Any, columns: Any, half_angle: Any, axes: Any,
    rotations: Any, translations: Any,
) -> None:  # fmt: skip
    """Fill the poses of frame t, which may be a slice: NumPy then does the same with all its frames at once."""
    for j in range(offsets.shape[0]):
        x, y, z = offsets[j, 0], offsets[j, 1], offsets[j, 2]
        a, b, c, d = 1.0, 0.0, 0.0, 0.0
        for step in range(starts[j], starts[j + 1]):
            kind, value = kinds[step], values[t, columns[step]]
            if kind == 0:
                x = value
            elif kind == 1:
                y = value
            elif kind == 2:
                z = value
            else:
                cosine, sine = np.cos(value * half_angle), np.sin(value * half_angle)
                # About x; about y and z it is the same with the axes in turn.
                if kind == 4:
                    b, c, d = c, d, b
                elif kind == 5:
                    b, c, d = d, b, c
                a, b, c, d = (
                    a * cosine - b * sine,
                    b * cosine + a * sine,
                    c * cosine + d * sine,
                    d * cosine - c * sine,
                )
                if kind == 4:
                    b, c, d = d, b, c
                elif kind == 5:
                    b, c, d = c, d, b
        if j < axes.shape[0]:
            # C (a, v) C^-1 = (a, C v)
            b, c, d = (
                axes[j, 0, 0] * b + axes[j, 0, 1] * c + axes[j, 0, 2] * d,
                axes[j, 1, 0] * b + axes[j, 1, 1] * c + axes[j, 1, 2] * d,
                axes[j, 2, 0] * b + axes[j, 2, 1] * c + axes[j, 2, 2] * d,
            )
        rotations[t, j, 0], rotations[t, j, 1], rotations[t, j, 2], rotations[t, j, 3] = a, b, c, d
        translations[t, j, 0], translations[t, j, 1], translations[t, j, 2] = x, y, z


_pose_part = part(_pose)


@kernel
def _pose_all(values, offsets, starts, kinds, columns, half_angle, axes, rotations, translations):  # type: ignore[no-untyped-def]
    for t in range(values.shape[0]):
        _pose_part(t, values, offsets, starts, kinds, columns, half_angle, axes, rotations, translations)


def compute_poses(program: ChannelProgram, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Compute local rotations (T, J, 4) and translations (T, J, 3) in file units from channel values (T, C)."""
    offsets = program.skeleton.offsets
    start = offsets
    if program.added:
        start = offsets.copy()
        start[list(program.added)] = 0.0
    for array in (values, start, program.starts, program.kinds, program.columns, program.axes):
        freeze(array)
    rotations, translations = (np.empty((len(values), len(offsets), width)) for width in (4, 3))
    arrays = (
        values, start, program.starts, program.kinds, program.columns, program.half_angle, program.axes,
        rotations, translations,
    )  # fmt: skip
    if is_worth_compiling(translations.size):
        _pose_all(*arrays)
    else:
        _pose(slice(None), *arrays)
    for joint in program.added:
        if joint > 0:  # the root moves in the world's axes
            translations[:, joint] = translations[:, joint] @ program.axes[joint].T
        translations[:, joint] += offsets[joint]
    for joint, column, direction in program.stretches:
        translations[:, joint] += values[:, column, None] * np.array(direction)
    return rotations, translations


def build_motion(
    path: str,
    format_name: str,
    program: ChannelProgram,
    rows: FloatArray,
    clock: Clock | float,
    **settings: Any,
) -> Motion:
    """Build a motion, in metres with Y up, from channel values; the sources of unit and axis are in its provenance.

    Parameters
    ----------
    rows : (T, C) channel values.
    clock : all that the file says of time.
    settings : of `settle_motion`.

    Raises
    ------
    MotionFileError : values that make no motion, such as positions beyond the largest float; poses that take far more
        memory than the file.
    """
    check_memory(path, 56 * len(rows) * program.skeleton.n_joints, os.path.getsize(path))  # a quaternion and a place
    with np.errstate(over="ignore", invalid="ignore"):
        rotations, translations = compute_poses(program, rows)
    return settle_motion(
        path, format_name, program.skeleton, rotations, translations, clock,
        most_frames=LONGEST, damaged="channels.no_motion", **settings,
    )  # fmt: skip
