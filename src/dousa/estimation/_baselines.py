"""What an estimate has to beat: poses that were made without looking at any image."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dousa.errors import OptionError
from dousa.motion import rotations as rot

__all__ = ["constant_velocity", "frozen_first_pose"]

FloatArray = NDArray[np.float64]


def frozen_first_pose(first: ArrayLike, n_frames: int) -> FloatArray:
    """The first pose held.

    Parameters
    ----------
    first : (7 + A,) pose, see `BodyModel`.
    n_frames : T, 1 or more.

    Returns
    -------
    (T, 7 + A).
    """
    pose = np.asarray(first, np.float64)
    if pose.ndim != 1 or n_frames < 1:
        raise OptionError(
            f"expected one pose and a frame or more, got shape {pose.shape} and {n_frames} frames"
        )
    return np.tile(pose, (n_frames, 1))


def constant_velocity(
    first: ArrayLike, second: ArrayLike, n_frames: int, limits: ArrayLike | None = None
) -> FloatArray:
    """What two poses foretell: every joint goes on turning, and the root moving, as it did between them.

    Parameters
    ----------
    first, second : (7 + A,) poses of two frames in succession; the tracker is told the first alone.
    n_frames : T, 1 or more, counted from the first.
    limits : (A, 2) rad that angles stop at; none by default.

    Returns
    -------
    (T, 7 + A).
    """
    one, other = np.asarray(first, np.float64), np.asarray(second, np.float64)
    if one.ndim != 1 or one.shape != other.shape or n_frames < 1:
        raise OptionError(
            f"expected two poses of one body and a frame or more, got shapes {one.shape} and {other.shape} and "
            f"{n_frames} frames"
        )
    steps = np.arange(n_frames)[:, None]
    poses = one + steps * (other - one)
    turn = rot.to_axis_angle(rot.multiply(rot.conjugate(one[3:7]), other[3:7]))
    poses[:, 3:7] = rot.multiply(one[3:7], rot.from_axis_angle(steps * turn))
    if limits is not None:
        low, high = np.asarray(limits, np.float64).T
        poses[:, 7:] = np.clip(poses[:, 7:], low, high)
    return poses
