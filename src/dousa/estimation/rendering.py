"""Silhouettes of a body in motion: what cameras would see, for tests, experiments and demonstrations.

The inverse of estimation. What comes out is clean; `spoil` makes it as bad as a real segmentation.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dousa.errors import BodyModelError
from dousa.estimation._spoiling import NOISY, Spoiling, spoil

if TYPE_CHECKING:
    from dousa.estimation.body import BodyModel
    from dousa.estimation.camera import Camera
    from dousa.motion import Motion, Trajectories

__all__ = ["NOISY", "Spoiling", "poses_from_motion", "render", "render_frames", "spoil"]

FloatArray = NDArray[np.float64]
Mask = NDArray[np.bool_]

_PIXELS_AT_ONCE = 8_000_000  # of one view: bounds the memory, long enough that calls cost nothing


def render(body: BodyModel, poses: ArrayLike, cameras: Sequence[Camera]) -> list[Mask]:
    """Silhouettes of a body in every view, whole.

    Parameters
    ----------
    body : with A joint angles.
    poses : (T, 7 + A), see `BodyModel`.
    cameras : (V,) the views.

    Returns
    -------
    (V,) masks (T, height, width), true on the body, as `draw_body` draws it.

    Raises
    ------
    BodyModelError : poses of another shape.
    """
    from dousa.estimation.rasteriser import draw_body

    rows = _checked_poses(body, poses)
    return [draw_body(body, rows, camera) for camera in cameras]


def render_frames(body: BodyModel, poses: ArrayLike, cameras: Sequence[Camera]) -> Iterator[tuple[Mask, ...]]:
    """Silhouettes frame by frame, so that the memory does not grow with the length.

    Parameters
    ----------
    body, poses, cameras : as for `render`.

    Yields
    ------
    (V,) masks (height, width) of one frame.
    """
    from dousa.estimation.rasteriser import draw_body

    rows = _checked_poses(body, poses)
    largest = max((camera.width * camera.height for camera in cameras), default=1)
    step = max(1, _PIXELS_AT_ONCE // largest)
    for first in range(0, len(rows), step):
        views = [draw_body(body, rows[first : first + step], camera) for camera in cameras]
        for frame in range(len(rows[first : first + step])):
            yield tuple(view[frame] for view in views)


def poses_from_motion(body: BodyModel, motion: Motion | Trajectories) -> FloatArray:
    """Poses of a body that follow the joints of a motion.

    Parameters
    ----------
    body : any tree of parts; the nearer its bones to the motion's, the nearer the joints.
    motion : whose joints bear the names of the body's joints and tips, or, for a person, can be mapped to the
        canonical ones; of T frames.

    Returns
    -------
    (T, 7 + A) within the limits of the body, by inverse kinematics, each frame starting from the one before.

    Raises
    ------
    BodyModelError : too few joints of the body are found in the motion.
    JointMappingError : the joints of a person's motion cannot be told apart.
    """
    from dousa.estimation.kinematics import point_names
    from dousa.estimation.posing import fit_poses
    from dousa.motion import CANONICAL_JOINTS, Motion, canonicalise, compute_trajectories

    moving = compute_trajectories(motion) if isinstance(motion, Motion) else motion
    wanted = point_names(body)
    if set(wanted) <= set(moving.names) or not set(wanted) >= set(CANONICAL_JOINTS):
        names, positions = moving.names, moving.positions
    else:
        canonical = canonicalise(motion)
        names, positions = CANONICAL_JOINTS, canonical.positions
    if not set(wanted) & set(names):
        raise BodyModelError(
            f"motion: expected joints of the body ({', '.join(wanted)}), got {', '.join(names)}; "
            "rename them or use a body with these joints"
        )
    return fit_poses(body, positions, names)[0]


def _checked_poses(body: BodyModel, poses: ArrayLike) -> FloatArray:
    rows = np.asarray(poses, np.float64)
    if rows.ndim != 2 or rows.shape[1] != 7 + body.n_angles:
        raise BodyModelError(f"poses: expected shape (T, {7 + body.n_angles}), got {rows.shape}")
    if not np.isfinite(rows).all():
        raise BodyModelError("poses: expected finite numbers")
    return rows
