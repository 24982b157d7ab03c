"""Forward kinematics: from joint rotations to positions in the world."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dousa.arrays import FloatArray, iterate_blocks
from dousa.kernels import is_worth_compiling, kernel, part
from dousa.motion.types import Motion, Skeleton, Trajectories


def _follow(t: Any, parents: Any, rotations: Any, translations: Any, world: Any, positions: Any) -> None:
    """Fill the world rotations and positions of frame t, or of a slice of frames; parents stand before children."""
    for j in range(translations.shape[1]):
        p = parents[j]
        w, x, y, z = rotations[t, j, 0], rotations[t, j, 1], rotations[t, j, 2], rotations[t, j, 3]
        vx, vy, vz = translations[t, j, 0], translations[t, j, 1], translations[t, j, 2]
        if p < 0:
            world[t, j, 0], world[t, j, 1], world[t, j, 2], world[t, j, 3] = w, x, y, z
            positions[t, j, 0], positions[t, j, 1], positions[t, j, 2] = vx, vy, vz
            continue
        a, b, c, d = world[t, p, 0], world[t, p, 1], world[t, p, 2], world[t, p, 3]
        world[t, j, 0] = a * w - b * x - c * y - d * z
        world[t, j, 1] = a * x + b * w + c * z - d * y
        world[t, j, 2] = a * y - b * z + c * w + d * x
        world[t, j, 3] = a * z + b * y - c * x + d * w
        # v + 2 a (u x v) + 2 u x (u x v) with u the vector part of the parent's quaternion
        tx = 2.0 * (c * vz - d * vy)
        ty = 2.0 * (d * vx - b * vz)
        tz = 2.0 * (b * vy - c * vx)
        positions[t, j, 0] = positions[t, p, 0] + vx + a * tx + c * tz - d * ty
        positions[t, j, 1] = positions[t, p, 1] + vy + a * ty + d * tx - b * tz
        positions[t, j, 2] = positions[t, p, 2] + vz + a * tz + b * ty - c * tx


_follow_part = part(_follow)


@kernel
def _follow_all(parents, rotations, translations, world, positions):  # type: ignore[no-untyped-def]
    for t in range(translations.shape[0]):
        _follow_part(t, parents, rotations, translations, world, positions)


def forward_kinematics(
    parents: ArrayLike, rotations: ArrayLike, translations: ArrayLike
) -> tuple[FloatArray, FloatArray]:
    """Compute positions and rotations in the world of a tree of joints.

    Parameters
    ----------
    parents : (J,) parent before child, -1 for a root.
    rotations : (..., J, 4) local unit quaternions, w x y z.
    translations : (..., J, 3) local positions, any unit.

    Returns
    -------
    positions : (..., J, 3) in the unit of the translations.
    world_from_joint : (..., J, 4) unit quaternions.
    """
    q = np.asarray(rotations, np.float64)
    v = np.asarray(translations, np.float64)
    joints = q.shape[-2]
    batch = np.broadcast_shapes(q.shape[:-2], v.shape[:-2])
    q = np.ascontiguousarray(np.broadcast_to(q, (*batch, joints, 4))).reshape(-1, joints, 4)
    v = np.ascontiguousarray(np.broadcast_to(v, (*batch, joints, 3))).reshape(-1, joints, 3)
    world, positions = np.empty(q.shape), np.empty(v.shape)
    arrays = _read_only(np.asarray(parents, np.intp)), _read_only(q), _read_only(v), world, positions
    if is_worth_compiling(v.size):
        _follow_all(*arrays)
    else:
        with np.errstate(over="ignore", invalid="ignore"):
            _follow(slice(None), *arrays)
    return positions.reshape(*batch, joints, 3), world.reshape(*batch, joints, 4)


def _read_only(array: np.ndarray) -> np.ndarray:
    """Read-only view: numba compiles one version for read-only arrays, not two."""
    view = np.ascontiguousarray(array).view()
    view.flags.writeable = False
    return view


def compute_rest_positions(skeleton: Skeleton) -> FloatArray:
    """Compute positions (J, 3) m of the rest pose (no rotation), in the skeleton's own axes."""
    rest = np.array(skeleton.offsets)
    for joint, parent in enumerate(skeleton.parents):
        if parent >= 0:
            rest[joint] += rest[parent]
    return rest


def compute_trajectories(motion: Motion | Trajectories) -> Trajectories:
    """Compute positions in the world of all joints and end sites of a motion, by forward kinematics.

    Names, parents and rest pose are kept; positions are NaN below a joint whose rotation is missing. Trajectories are
    returned as they are.

    >>> trajectories = dousa.compute_trajectories(dousa.read_motion("wave.bvh"))
    >>> trajectories.positions.shape[1:] == (len(trajectories.names), 3)
    True
    """
    if isinstance(motion, Trajectories):
        return motion
    skeleton = motion.skeleton
    positions = np.empty(motion.translations.shape)
    for some in iterate_blocks(motion.n_frames):
        positions[some] = forward_kinematics(skeleton.parents, motion.rotations[some], motion.translations[some])[0]
    positions.flags.writeable = False
    return Trajectories(
        names=skeleton.names,
        positions=positions,
        frame_rate=motion.frame_rate,
        parents=skeleton.parents,
        rest_positions=compute_rest_positions(skeleton),
        provenance=motion.provenance and motion.provenance.derive(),
    )
