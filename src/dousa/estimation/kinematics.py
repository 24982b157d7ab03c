"""Where the parts of a body lie in a pose, and poses as a motion with canonical joint names."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dousa.errors import BodyModelError

if TYPE_CHECKING:
    from dousa.estimation.body import BodyModel
    from dousa.motion import Motion

__all__ = ["compute_points", "place_parts", "point_names", "to_motion", "tree_arrays"]

FloatArray = NDArray[np.float64]
Tree = tuple[NDArray, FloatArray, FloatArray, NDArray, FloatArray, NDArray]


def tree_arrays(body: BodyModel) -> Tree:
    """The body as the compiled kernels take it: parents, offsets, rest, n_axes, axes, angle_starts."""
    starts = body.angle_starts
    starts.flags.writeable = False
    return body.parents, body.offsets, body.rest, body.n_axes, body.axes, starts


def _checked_poses(body: BodyModel, poses: ArrayLike) -> FloatArray:
    array = np.ascontiguousarray(poses, np.float64)
    if array.ndim == 0 or array.shape[-1] != 7 + body.n_angles:
        raise BodyModelError(f"poses: expected rows of {7 + body.n_angles} numbers, got shape {array.shape}")
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
    from dousa.estimation._pose_kernels import place_all

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
    from dousa.motion import Motion, Skeleton
    from dousa.motion.rotations import from_matrix, identity

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
