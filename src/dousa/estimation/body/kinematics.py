"""Forward kinematics of a body, and poses as a motion with the body's joint names."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from dousa.arrays import FloatArray, IndexArray
from dousa.errors import BodyModelError
from dousa.estimation.body.body import BodyModel
from dousa.kernels import kernel, part
from dousa.motion import Motion, Skeleton
from dousa.motion import rotations as rot

Tree = tuple[IndexArray, FloatArray, FloatArray, IndexArray, FloatArray, IndexArray]


def tree_arrays(body: BodyModel) -> Tree:
    """Return the body as arrays of the kernels: parents, offsets, rest, n_axes, axes, angle_starts."""
    starts = body.angle_starts
    starts.flags.writeable = False
    return body.parents, body.offsets, body.rest, body.n_axes, body.axes, starts


def _checked_poses(body: BodyModel, poses: ArrayLike) -> FloatArray:
    array = np.ascontiguousarray(poses, np.float64)
    if array.ndim == 0 or array.shape[-1] != 7 + body.n_angles:
        raise BodyModelError("pose.rows", expected=7 + body.n_angles, found=str(array.shape))
    return array


def place_parts(body: BodyModel, poses: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Compute world rotations and places of all parts (forward kinematics).

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
    local, parts = np.empty((body.n_parts, 3, 3)), np.arange(body.n_parts)
    place_all(flat, parts, tree_arrays(body), local, rotations, positions)
    batch = array.shape[:-1]
    return rotations.reshape(*batch, body.n_parts, 3, 3), positions.reshape(*batch, body.n_parts, 3)


def point_names(body: BodyModel) -> tuple[str, ...]:
    """Return the names (P + K,) of the points of `compute_points`: the joints, then the tips."""
    return (*body.joints, *body.tips)


def compute_points(body: BodyModel, poses: ArrayLike) -> FloatArray:
    """Compute places (..., P + K, 3) m of the joints and tips of a body in poses (..., 7 + A)."""
    rotations, positions = place_parts(body, poses)
    tips = positions[..., body.tip_parts, :] + np.einsum(
        "...kij,kj->...ki", rotations[..., body.tip_parts, :, :], body.tip_offsets
    )
    return np.concatenate((positions, tips), axis=-2)


def step_poses(poses: FloatArray, steps: FloatArray) -> FloatArray:
    """Move poses (..., 7 + A) by steps (..., 6 + A): place, turn in the root's own axes, angles."""
    places, angles = poses[..., :3] + steps[..., :3], poses[..., 7:] + steps[..., 6:]
    turned = rot.normalise(rot.multiply(poses[..., 3:7], rot.from_axis_angle(steps[..., 3:6])))
    return np.concatenate((places, turned, angles), axis=-1)


def pose_difference(before: FloatArray, after: FloatArray) -> FloatArray:
    """Compute the steps (..., 6 + A) by which `step_poses` takes poses (..., 7 + A) to others."""
    turn = rot.to_axis_angle(rot.multiply(rot.conjugate(before[..., 3:7]), after[..., 3:7]))
    return np.concatenate((after[..., :3] - before[..., :3], turn, after[..., 7:] - before[..., 7:]), axis=-1)


def to_motion(body: BodyModel, poses: ArrayLike, frame_rate: float) -> Motion:
    """Convert poses (T, 7 + A) to a motion in metres with a joint for every part and every tip.

    The rest pose is the body at angle zero without rest rotations, which are part of the local rotations; tips do not
    turn. ``frame_rate`` is in Hz.
    """
    array = _checked_poses(body, poses).reshape(-1, 7 + body.n_angles)
    rotations, positions = place_parts(body, array)
    n_frames, n_parts, n_tips = len(array), body.n_parts, len(body.tips)
    local = np.empty((n_frames, n_parts, 3, 3))
    local[:, 0] = rotations[:, 0]
    above = rotations[:, body.parents[1:]]
    local[:, 1:] = np.swapaxes(above, -1, -2) @ rotations[:, 1:]
    quaternions = np.concatenate((rot.from_matrix(local), rot.identity((n_frames, n_tips))), axis=1)
    offsets = np.concatenate((body.offsets, body.tip_offsets))
    parents = np.concatenate((body.parents, body.tip_parts))
    translations = np.tile(offsets, (n_frames, 1, 1))
    translations[:, 0] = positions[:, 0]
    skeleton = Skeleton(point_names(body), parents, offsets)
    return Motion(skeleton, quaternions, translations, frame_rate)


@part
def _turn(a, b, c, d, x, y, z):  # type: ignore[no-untyped-def]
    """Return a quaternion followed by a rotation vector in its own axes."""
    angle = np.sqrt(x * x + y * y + z * z)
    scale = 0.5 if angle < 1e-9 else np.sin(0.5 * angle) / angle
    w, x, y, z = np.cos(0.5 * angle), x * scale, y * scale, z * scale
    return (
        a * w - b * x - c * y - d * z,
        a * x + b * w + c * z - d * y,
        a * y + c * w + d * x - b * z,
        a * z + d * w + b * y - c * x,
    )


@part
def turn_root(pose, x, y, z):  # type: ignore[no-untyped-def]
    """Turn the root of a pose row by a rotation vector in its own axes, in place."""
    pose[3], pose[4], pose[5], pose[6] = _turn(pose[3], pose[4], pose[5], pose[6], x, y, z)


@part
def turn_part(part, pose, tree, local):  # type: ignore[no-untyped-def]
    """Compute the rotation matrix ``local[part]`` (3, 3) of a part in its parent's axes; of the root in the world's.

    ``tree`` is (parents, offsets, rest, n_axes, axes, angle_starts). Of three axes the first two are one rotation
    vector, the third follows.
    """
    parents, _, rest, n_axes, axes, angle_starts = tree
    if parents[part] < 0:
        a, b, c, d = pose[3], pose[4], pose[5], pose[6]
    else:
        a, b, c, d = rest[part, 0], rest[part, 1], rest[part, 2], rest[part, 3]
        count, first, k = n_axes[part], 7 + angle_starts[part], 0
        while k < count:
            turn = pose[first + k]
            x, y, z = turn * axes[part, k, 0], turn * axes[part, k, 1], turn * axes[part, k, 2]
            k += 1
            if count == 3 and k == 1:
                turn = pose[first + 1]
                x, y, z = x + turn * axes[part, 1, 0], y + turn * axes[part, 1, 1], z + turn * axes[part, 1, 2]
                k = 2
            a, b, c, d = _turn(a, b, c, d, x, y, z)
    local[part, 0, 0] = 1.0 - 2.0 * (c * c + d * d)
    local[part, 0, 1] = 2.0 * (b * c - a * d)
    local[part, 0, 2] = 2.0 * (b * d + a * c)
    local[part, 1, 0] = 2.0 * (b * c + a * d)
    local[part, 1, 1] = 1.0 - 2.0 * (b * b + d * d)
    local[part, 1, 2] = 2.0 * (c * d - a * b)
    local[part, 2, 0] = 2.0 * (b * d - a * c)
    local[part, 2, 1] = 2.0 * (c * d + a * b)
    local[part, 2, 2] = 1.0 - 2.0 * (b * b + c * c)


@part
def hang_part(part, pose, tree, local, rotations, positions):  # type: ignore[no-untyped-def]
    """Compute world rotation matrix (3, 3) and place (3,) of a turned part below a placed parent."""
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


@part
def hang_parts(parts, n_turned, pose, tree, local, rotations, positions):  # type: ignore[no-untyped-def]
    """Place parts, parents first; only the first ``n_turned`` have new angles."""
    for i in range(len(parts)):
        if i < n_turned:
            turn_part(parts[i], pose, tree, local)
        hang_part(parts[i], pose, tree, local, rotations, positions)


@kernel
def place_all(poses, parts, tree, local, rotations, positions):  # type: ignore[no-untyped-def]
    """Compute rotations (T, P, 3, 3) and places (T, P, 3) of all parts in poses (T, 7 + A); ``local`` is scratch."""
    for t in range(len(poses)):
        hang_parts(parts, len(parts), poses[t], tree, local, rotations[t], positions[t])
