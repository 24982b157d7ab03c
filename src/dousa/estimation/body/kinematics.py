"""Where the parts of a body lie in a pose, and poses as a motion with canonical joint names."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import ArrayLike

from dousa.arrays import FloatArray, IndexArray
from dousa.errors import BodyModelError
from dousa.estimation.body.body import BodyModel
from dousa.motion import Motion, Skeleton
from dousa.motion.rotations import from_matrix, identity

Tree = tuple[IndexArray, FloatArray, FloatArray, IndexArray, FloatArray, IndexArray]


def tree_arrays(body: BodyModel) -> Tree:
    """The body as the compiled kernels take it: parents, offsets, rest, n_axes, axes, angle_starts."""
    starts = body.angle_starts
    starts.flags.writeable = False
    return body.parents, body.offsets, body.rest, body.n_axes, body.axes, starts


def _checked_poses(body: BodyModel, poses: ArrayLike) -> FloatArray:
    array = np.ascontiguousarray(poses, np.float64)
    if array.ndim == 0 or array.shape[-1] != 7 + body.n_angles:
        raise BodyModelError("pose.rows", expected=7 + body.n_angles, found=str(array.shape))
    return array


def place_parts(body: BodyModel, poses: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """World rotations and places of all parts (forward kinematics).

    Parameters
    ----------
    body : with P parts and A joint angles.
    poses : (..., 7 + A), see `BodyModel`.

    Returns
    -------
    rotations : (..., P, 3, 3) from the part's axes to the world's.
    positions : (..., P, 3) m, the part's joint.
    """
    array = _checked_poses(body, poses)
    flat = array.reshape(-1, array.shape[-1])
    rotations = np.empty((len(flat), body.n_parts, 3, 3))
    positions = np.empty((len(flat), body.n_parts, 3))
    place_all(flat, tree_arrays(body), rotations, positions)
    batch = array.shape[:-1]
    return rotations.reshape(*batch, body.n_parts, 3, 3), positions.reshape(*batch, body.n_parts, 3)


def point_names(body: BodyModel) -> tuple[str, ...]:
    """Names (P + K,) of the points of `compute_points`: the joints, then the tips."""
    return (*body.joints, *body.tips)


def compute_points(body: BodyModel, poses: ArrayLike) -> FloatArray:
    """Places (..., P + K, 3) m of the joints and tips of a body in poses (..., 7 + A)."""
    rotations, positions = place_parts(body, poses)
    tips = positions[..., body.tip_parts, :] + np.einsum(
        "...kij,kj->...ki", rotations[..., body.tip_parts, :, :], body.tip_offsets
    )
    return np.concatenate((positions, tips), axis=-2)


def to_motion(body: BodyModel, poses: ArrayLike, frame_rate: float) -> Motion:
    """Poses as a motion: a joint for every part, named as the body names it, and a joint without turn for every tip.

    Parameters
    ----------
    body : with P parts, K tips and A joint angles.
    poses : (T, 7 + A).
    frame_rate : Hz.

    Returns
    -------
    Motion of P + K joints, metres, whose rest pose is the body at angle zero with no rest rotation taken in: the
    rest rotations are part of the local rotations.
    """
    array = _checked_poses(body, poses).reshape(-1, 7 + body.n_angles)
    rotations, positions = place_parts(body, array)
    n_frames, n_parts, n_tips = len(array), body.n_parts, len(body.tips)
    local = np.empty((n_frames, n_parts, 3, 3))
    local[:, 0] = rotations[:, 0]
    above = rotations[:, body.parents[1:]]
    local[:, 1:] = np.swapaxes(above, -1, -2) @ rotations[:, 1:]
    quaternions = np.concatenate((from_matrix(local), identity((n_frames, n_tips))), axis=1)
    offsets = np.concatenate((body.offsets, body.tip_offsets))
    parents = np.concatenate((body.parents, body.tip_parts))
    translations = np.tile(offsets, (n_frames, 1, 1))
    translations[:, 0] = positions[:, 0]
    skeleton = Skeleton(point_names(body), parents, offsets)
    return Motion(skeleton, quaternions, translations, frame_rate)


@njit(cache=True, nogil=True, forceinline=True)
def exp_rotation(x, y, z, out):  # type: ignore[no-untyped-def]
    """Quaternion of the rotation vector (x, y, z) rad."""
    angle = np.sqrt(x * x + y * y + z * z)
    scale = 0.5 if angle < 1e-9 else np.sin(0.5 * angle) / angle
    out[0], out[1], out[2], out[3] = np.cos(0.5 * angle), x * scale, y * scale, z * scale


@njit(cache=True, nogil=True, forceinline=True)
def multiply_into(a, b, out):  # type: ignore[no-untyped-def]
    """Hamilton product of quaternions; ``out`` may be one of them."""
    w = a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3]
    x = a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2]
    y = a[0] * b[2] + a[2] * b[0] + a[3] * b[1] - a[1] * b[3]
    z = a[0] * b[3] + a[3] * b[0] + a[1] * b[2] - a[2] * b[1]
    out[0], out[1], out[2], out[3] = w, x, y, z


@njit(cache=True, nogil=True)
def turn_root(pose, x, y, z):  # type: ignore[no-untyped-def]
    """Turn the root of a pose row by a rotation vector in its own axes, in place."""
    turn = np.empty(4)
    exp_rotation(x, y, z, turn)
    multiply_into(pose[3:7], turn, pose[3:7])


@njit(cache=True, nogil=True, forceinline=True)
def turn_part(part, pose, tree, work, local):  # type: ignore[no-untyped-def]
    """Rotation matrix ``local[part]`` (3, 3) of a part in its parent's axes; of the root in the world's.

    ``tree`` is (parents, offsets, rest, n_axes, axes, angle_starts); ``work`` (2, 4) is scratch.
    """
    parents, _, rest, n_axes, axes, angle_starts = tree
    quaternion, turn = work[0], work[1]
    if parents[part] < 0:
        quaternion[:] = pose[3:7]
        _to_matrix(quaternion, local[part])
        return
    quaternion[:] = rest[part]
    count = n_axes[part]
    first = 7 + angle_starts[part]
    axis = axes[part]
    if count == 3:
        a, b, c = pose[first], pose[first + 1], pose[first + 2]
        exp_rotation(
            a * axis[0, 0] + b * axis[1, 0],
            a * axis[0, 1] + b * axis[1, 1],
            a * axis[0, 2] + b * axis[1, 2],
            turn,
        )
        multiply_into(quaternion, turn, quaternion)
        exp_rotation(c * axis[2, 0], c * axis[2, 1], c * axis[2, 2], turn)
        multiply_into(quaternion, turn, quaternion)
    else:
        for k in range(count):
            a = pose[first + k]
            exp_rotation(a * axis[k, 0], a * axis[k, 1], a * axis[k, 2], turn)
            multiply_into(quaternion, turn, quaternion)
    _to_matrix(quaternion, local[part])


@njit(cache=True, nogil=True, forceinline=True)
def hang_part(part, pose, tree, local, rotations, positions):  # type: ignore[no-untyped-def]
    """World rotation matrix (3, 3) and place (3,) of a part that was turned, below a parent that was hung."""
    parent = tree[0][part]
    if parent < 0:
        for i in range(3):
            positions[part, i] = pose[i]
            for k in range(3):
                rotations[part, i, k] = local[part, i, k]
        return
    offsets = tree[1]
    for i in range(3):
        p, q, r = rotations[parent, i, 0], rotations[parent, i, 1], rotations[parent, i, 2]
        positions[part, i] = positions[parent, i] + (p * offsets[part, 0] + q * offsets[part, 1] + r * offsets[part, 2])
        for k in range(3):
            rotations[part, i, k] = p * local[part, 0, k] + q * local[part, 1, k] + r * local[part, 2, k]


@njit(cache=True, nogil=True, forceinline=True)
def _to_matrix(q, out):  # type: ignore[no-untyped-def]
    w, x, y, z = q[0], q[1], q[2], q[3]
    out[0, 0], out[0, 1], out[0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
    out[1, 0], out[1, 1], out[1, 2] = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
    out[2, 0], out[2, 1], out[2, 2] = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)


@njit(cache=True, nogil=True)
def place_all(poses, tree, rotations, positions):  # type: ignore[no-untyped-def]
    """Rotations (T, P, 3, 3) and places (T, P, 3) of all parts in all poses (T, 7 + A)."""
    work, local = np.empty((2, 4)), np.empty(rotations.shape[1:])
    for t in range(len(poses)):
        for part in range(rotations.shape[1]):
            turn_part(part, poses[t], tree, work, local)
            hang_part(part, poses[t], tree, local, rotations[t], positions[t])
