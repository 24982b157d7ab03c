"""From channel values (Euler angles, positions) to poses (quaternions, translations), for BVH and AMC."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass, field

import numpy as np
from numba import njit

from dousa.arrays import FloatArray, IntArray
from dousa.errors import InvalidMotionError, MotionFileError
from dousa.motion.canonical.reference_frame import ReferenceFrame, infer_reference_frame, to_reference_frame
from dousa.motion.kinematics import compute_rest_positions, forward_kinematics
from dousa.motion.types import Motion, Provenance, Skeleton, Trajectories, freeze

_SAMPLED_FRAMES = 16
_MOST_FRAMES = 20_000  # that are looked at where the sample leaves a doubt
_LARGE_MOTION = 50_000_000  # joints x frames, about 3 GB


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
    rest_positions : (J, 3) the joints with no turn at all.
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
    rest_positions: FloatArray = field(init=False)

    def __post_init__(self) -> None:
        moved = (joint for joint in range(len(self.axes)) if (self._kinds_of(joint) < 3).any())
        object.__setattr__(self, "added", tuple(moved))
        with np.errstate(over="ignore", invalid="ignore"):
            rest = freeze(compute_rest_positions(self.skeleton))
        object.__setattr__(self, "rest_positions", rest)

    def _kinds_of(self, joint: int) -> IntArray:
        return self.kinds[self.starts[joint] : self.starts[joint + 1]]


@dataclass(frozen=True, slots=True)
class FileUnits:
    """Unit and up axis of a file, as far as known before its poses are read.

    ``unit`` and ``up`` come from the caller; ``declared_unit`` from the file, found plausible.
    """

    unit: float | None = None
    up: str | None = None
    declared_unit: float | None = None


@njit(cache=True, nogil=True)
def _pose_kernel(
    values: FloatArray,
    offsets: FloatArray,
    starts: IntArray,
    kinds: IntArray,
    columns: IntArray,
    half_angle: float,
    axes: FloatArray,
    rotations: FloatArray,
    translations: FloatArray,
) -> None:
    for t in range(values.shape[0]):
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
                    cosine, sine = math.cos(value * half_angle), math.sin(value * half_angle)
                    if kind == 3:
                        a, b, c, d = (
                            a * cosine - b * sine,
                            b * cosine + a * sine,
                            c * cosine + d * sine,
                            d * cosine - c * sine,
                        )
                    elif kind == 4:
                        a, b, c, d = (
                            a * cosine - c * sine,
                            b * cosine - d * sine,
                            c * cosine + a * sine,
                            d * cosine + b * sine,
                        )
                    else:
                        a, b, c, d = (
                            a * cosine - d * sine,
                            b * cosine + c * sine,
                            c * cosine - b * sine,
                            d * cosine + a * sine,
                        )
            if j < axes.shape[0]:
                # C (a, v) C^-1 = (a, C v)
                b, c, d = (
                    axes[j, 0, 0] * b + axes[j, 0, 1] * c + axes[j, 0, 2] * d,
                    axes[j, 1, 0] * b + axes[j, 1, 1] * c + axes[j, 1, 2] * d,
                    axes[j, 2, 0] * b + axes[j, 2, 1] * c + axes[j, 2, 2] * d,
                )
            rotations[t, j, 0], rotations[t, j, 1], rotations[t, j, 2], rotations[t, j, 3] = a, b, c, d
            translations[t, j, 0], translations[t, j, 1], translations[t, j, 2] = x, y, z


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
    _pose_kernel(
        values, start, program.starts, program.kinds, program.columns, program.half_angle, program.axes,
        rotations, translations,
    )  # fmt: skip
    for joint in program.added:
        if joint > 0:  # the root moves in the world's axes
            translations[:, joint] = translations[:, joint] @ program.axes[joint].T
        translations[:, joint] += offsets[joint]
    for joint, column, direction in program.stretches:
        translations[:, joint] += values[:, column, None] * np.array(direction)
    return rotations, translations


def build_motion(
    path: str,
    program: ChannelProgram,
    values: FloatArray,
    frame_rate: float,
    provenance: Provenance,
    units: FileUnits,
) -> Motion:
    """Build a motion, in metres with Y up, from channel values; the sources of unit and axis are in its provenance.

    MotionFileError for values that make no motion, such as positions beyond the largest float.
    """
    skeleton = program.skeleton
    poses = len(values) * skeleton.n_joints
    if poses > max(_LARGE_MOTION, 16 * values.size):
        raise MotionFileError(
            path, "channels.too_few", frames=len(values), joints=skeleton.n_joints, channels=values.shape[1]
        )
    try:
        with np.errstate(over="ignore", invalid="ignore"):
            rotations, translations = compute_poses(program, values)
            frame = _infer_frame(program, rotations, translations, frame_rate, units)
            offsets = skeleton.offsets * frame.unit
            translations *= frame.unit
            scaled = Skeleton(skeleton.names, skeleton.parents, offsets, skeleton.end_sites)
            rotations, translations = freeze(rotations), freeze(translations)
            located = dataclasses.replace(
                provenance,
                unit=frame.unit,
                unit_source=frame.unit_source,
                up=frame.up,
                up_source=frame.up_source,
                notes=(*provenance.notes, *frame.notes),
            )
            motion = Motion(scaled, rotations, translations, frame_rate, located)
            return motion if frame.up == "y" else to_reference_frame(motion, ReferenceFrame(up=frame.up))
    except InvalidMotionError as error:
        raise MotionFileError(path, "channels.no_motion", reason=error) from error


def _infer_frame(
    program: ChannelProgram, rotations: FloatArray, translations: FloatArray, frame_rate: float, units: FileUnits
) -> ReferenceFrame:
    skeleton = program.skeleton

    def place(frames: IntArray | slice, rate: float) -> Trajectories:
        positions, _ = forward_kinematics(skeleton.parents, rotations[frames], translations[frames])
        return Trajectories(skeleton.names, freeze(positions), rate, skeleton.parents, program.rest_positions)

    count = min(len(rotations), _SAMPLED_FRAMES)
    frames = np.arange(count) * (len(rotations) - 1) // max(count - 1, 1)
    return infer_reference_frame(
        place(frames, frame_rate),
        unit=units.unit,
        up=units.up,
        declared_unit=units.declared_unit,
        whole=lambda: place(slice(0, _MOST_FRAMES), frame_rate),
    )
