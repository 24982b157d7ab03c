"""What keypoints say of how far off a fitted body is: the evidence that `dousa.estimation.body.doubt` weighs.

With one view nothing in the picture tells the distance: its spread is stated by itself, and ``lost`` is said of the
posture.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dousa.arrays import BoolArray, FloatArray
from dousa.estimation.body.body import BodyModel
from dousa.estimation.body.doubt import Evidence
from dousa.estimation.body.kinematics import compute_points
from dousa.estimation.body.posing import standing_state
from dousa.estimation.cameras.camera import Camera
from dousa.estimation.multiview.landmarks import Landmarks, SeenLandmarks
from dousa.estimation.multiview.pose_residuals import place_points
from dousa.estimation.multiview.triangulation import pixels_per_metre

VISIBLE = 0.3
"""Visibility from which a point counts as seen: below, networks guess (docs/keypoints.md)."""

DISTANCE_SPREAD = 0.07
"""Share of the distance, one sigma of a single view's: 277 mm at 4 m (python -m lab.trials.made_people)."""


def measure_errors(
    body: BodyModel, poses: FloatArray, landmarks: Landmarks, seen: SeenLandmarks, cameras: Sequence[Camera]
) -> tuple[FloatArray, FloatArray]:
    """Return reprojection errors (V, T, L) in px and in m; nan where a point is not seen."""
    places = place_points(body, poses, landmarks)
    errors = np.stack([np.linalg.norm(camera.project(places) - points, axis=-1)
                       for camera, points in zip(cameras, seen.points, strict=True)])  # fmt: skip
    return errors, errors / np.stack([pixels_per_metre(camera, places) for camera in cameras])


def find_evidence(
    body: BodyModel,
    covariance: FloatArray,
    landmarks: Landmarks,
    seen: SeenLandmarks,
    off: FloatArray,
    exchanged: BoolArray,
) -> Evidence:
    """Return the evidence of T poses; a joint takes that of the landmark nearest to it in a standing body.

    Parameters
    ----------
    body : of the poses.
    covariance : (T, N, 3, 3) m^2 of joints and tips.
    landmarks, seen : on the body, and in the views.
    off : (V, T, L) m, of `measure_errors`.
    exchanged : (V, T, G) where left and right were exchanged.
    """
    pose = standing_state(body)
    apart = compute_points(body, pose)[:, None] - place_points(body, pose, landmarks)[None]
    near = np.linalg.norm(apart, axis=2).argmin(axis=1)
    shown = (seen.visibility > VISIBLE) & np.isfinite(off)
    # Of the two coordinates in each view a place in space takes up three in all: counted per degree of freedom left,
    # errors mean the same with any number of views.
    free = np.where(shown.sum(axis=0) > 1, shown.sum(axis=0) - 1.5, 1.0)
    squares = np.where(shown, np.nan_to_num(off) ** 2, 0.0).sum(axis=0) / free
    needed = min(2, max(1, seen.n_views))
    hidden = 1.0 - np.sort(seen.visibility, axis=0)[-needed]
    swap = np.repeat(exchanged.mean(axis=(0, 2))[:, None], len(near), axis=1)
    width = np.sqrt(np.trace(covariance, axis1=-2, axis2=-1))
    present = np.asarray((shown.sum(axis=0) >= needed).any(axis=1))
    return Evidence(present, width, squares[:, near], hidden[:, near], swap)
