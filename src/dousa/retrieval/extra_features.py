"""Optional features beyond the paper: how far the body has turned and moved, how fast its parts move, how long.

The 56 features of ``features`` see poses only; put beside them (``np.concatenate([...], axis=1)``) these tell a
walk from a turn and a slow gesture from a fast one. Place and heading count from the first frame of the clip, so
where it was recorded still does not matter.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dousa.errors import InvalidMotionError
from dousa.motion.joints import JOINT_INDEX
from dousa.motion.resampling import thin
from dousa.retrieval.features import find_lateral_axis, turn_to_body

if TYPE_CHECKING:
    from dousa.motion import CanonicalMotion

__all__ = ["EXTRA_FEATURE_NAMES", "compute_extra_features"]

_MOVING = ("head", "left_elbow", "left_hand", "left_ankle", "right_elbow", "right_hand", "right_ankle")
_WAYS = ("to the left", "upwards", "forwards")

EXTRA_FEATURE_NAMES: tuple[str, ...] = (
    "body turned to the left since the start",
    *(f"body moved {way} since the start" for way in _WAYS),
    *(
        f"{joint.replace('_', ' ').replace('ankle', 'foot')} moving {way}"
        for joint in _MOVING
        for way in _WAYS
    ),
    "duration of the clip",
)
"""26 names: a turn (rad), 3 ways (body heights), 21 velocities (body heights per step of the thinned clip), s."""


def compute_extra_features(canonical: CanonicalMotion, n_frames: int = 10) -> NDArray[np.float64]:
    """The optional features of a clip.

    Parameters
    ----------
    canonical : the clip.
    n_frames : equally spaced frames to thin it to, as for ``compute_clip_features``.

    Returns
    -------
    (n_frames, 26) in the order of ``EXTRA_FEATURE_NAMES``. Velocities are in the body-fixed system, seen from
    the pelvis, and central differences; those of a clip of one frame are 0.

    Raises
    ------
    OptionError : ``n_frames`` below 1.
    InvalidMotionError : positions that are not finite, or no body height.
    """
    if not (np.isfinite(canonical.height) and canonical.height > 0):
        raise InvalidMotionError(f"expected a body height above 0 m, got {canonical.height}")
    points = thin(canonical.positions, n_frames) / canonical.height
    if not np.isfinite(points).all():
        raise InvalidMotionError("expected finite positions, got NaN or infinity; canonicalise fills gaps")
    posed = points - points[:, :1]
    left = find_lateral_axis(posed)
    heading = np.unwrap(np.arctan2(-left[:, 1], left[:, 0]))
    travel = points[:, 0] - points[0, 0]
    across, along = left[0]
    moved = np.stack(
        [
            travel[:, 0] * across + travel[:, 2] * along,
            travel[:, 1],
            travel[:, 2] * across - travel[:, 0] * along,
        ],
        axis=1,
    )
    moving = turn_to_body(posed)[:, [JOINT_INDEX[joint] for joint in _MOVING]]
    velocity = np.gradient(moving, axis=0) if n_frames > 1 else np.zeros_like(moving)
    seconds = len(canonical.positions) / canonical.frame_rate
    return np.concatenate(
        [
            (heading - heading[0])[:, None],
            moved,
            velocity.reshape(n_frames, -1),
            np.full((n_frames, 1), seconds),
        ],
        axis=1,
    )
