"""Where a track begins: whether cameras and start fit, and the first frame with somebody in it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dousa.errors import BodyModelError, CalibrationError, SilhouetteError
from dousa.estimation.cleaning import NEARLY_FULL

if TYPE_CHECKING:
    from dousa.estimation.body import BodyModel
    from dousa.estimation.camera import Camera
    from dousa.estimation.silhouettes import Silhouettes

__all__ = ["check_cameras", "checked_start", "find_first"]

FloatArray = NDArray[np.float64]

_FIRST_FRAMES = 150  # looked through for the first one with somebody in it


def check_cameras(silhouettes: Silhouettes, cameras: Sequence[Camera]) -> None:
    """CalibrationError unless there is one camera for each view, of the size of its masks."""
    if len(cameras) != silhouettes.n_views:
        raise CalibrationError(
            f"expected one camera for each of the {silhouettes.n_views} views, got {len(cameras)}"
        )
    for camera, size, name in zip(cameras, silhouettes.sizes, silhouettes.names, strict=True):
        if (camera.width, camera.height) != tuple(size):
            raise CalibrationError(
                f"view '{name}': expected a camera for {size[0]} x {size[1]} pixels, got one for "
                f"{camera.width} x {camera.height}; see fit_cameras"
            )


def checked_start(body: BodyModel, start: ArrayLike) -> FloatArray:
    """The pose (7 + A,) within the body's limits; BodyModelError if it is none of this body."""
    pose = np.array(start, np.float64)
    if pose.shape != (7 + body.n_angles,) or not np.isfinite(pose).all():
        raise BodyModelError(
            f"start: expected a pose of {7 + body.n_angles} finite numbers, got shape {pose.shape}"
        )
    length = float(np.linalg.norm(pose[3:7]))
    if not 0.99 < length < 1.01:
        raise BodyModelError(
            f"start: expected a unit quaternion as the root's orientation, got length {length:g}"
        )
    pose[3:7] /= length
    limits = body.angle_limits
    pose[7:] = np.clip(pose[7:], limits[:, 0], limits[:, 1])
    return pose


def find_first(silhouettes: Silhouettes) -> tuple[int, tuple[NDArray[np.bool_] | None, ...]]:
    """The first frame with somebody in it: in as many views as any of the first frames has."""
    best, best_count, best_masks, full = -1, 0, None, 0
    for frame in range(min(silhouettes.n_frames, _FIRST_FRAMES)):
        masks = silhouettes.read(frame)
        good = [mask is not None and 0 < mask.mean() < NEARLY_FULL for mask in masks]
        full += any(mask is not None and mask.mean() >= NEARLY_FULL for mask in masks)
        if sum(good) > best_count:
            kept = tuple(mask if fine else None for mask, fine in zip(masks, good, strict=True))
            best, best_count, best_masks = frame, sum(good), kept
        if best_count and (best_count == len(masks) or frame >= best + 5):
            break
    if best_masks is None:
        what = "every mask is full: is black foreground, white background?" if full else "every mask is empty"
        raise SilhouetteError(
            f"expected a person in the first {min(silhouettes.n_frames, _FIRST_FRAMES)} frames, but {what}"
        )
    return best, best_masks
