"""Two views of the same points: how they stand to each other, and where the points are.

From the essential matrix (Nister's five points and MAGSAC++, as OpenCV has them) over the points of all moments.
Coordinates are normalised: x / z and y / z along the camera's axes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dousa.arrays import BoolArray, FloatArray
from dousa.estimation.calibration.bundle import Rig, Sightings

_MOST_PAIRS = 1500  # points that RANSAC looks at: more of the same person tell it nothing new
_LEAST_PAIRS = 30
_SURE = 0.999
_MOST_TRIALS = 1000
_SAME = 0.02  # rad: poses that differ by less are one
_SEED = 7


@dataclass(frozen=True, slots=True, eq=False)
class RelativePose:
    """A second camera as the first one sees it.

    Parameters
    ----------
    rotation : (3, 3) from the first camera's axes to the second's.
    translation : (3,) of length 1.
    share : of the points that agree, 0 to 1.
    parallax : rad, middle angle between the two lines of sight of a point that agrees.
    """

    rotation: FloatArray
    translation: FloatArray
    share: float
    parallax: float


def find_relative_poses(first: FloatArray, second: FloatArray, spread: float) -> list[RelativePose]:
    """How two cameras may stand to each other, by estimators that fail in different cases.

    Parameters
    ----------
    first, second : (N, 2) normalised coordinates of the same points.
    spread : by how far a point is off, normalised; twice as far still agrees.

    Returns
    -------
    Different poses; none where there are too few points, or no pose puts them before both cameras.
    """
    from dousa.extras import cv2

    if len(first) < _LEAST_PAIRS:
        return []
    if len(first) > _MOST_PAIRS:
        some = np.random.default_rng(_SEED).choice(len(first), _MOST_PAIRS, replace=False)
        first, second = first[some], second[some]
    found: list[RelativePose] = []
    for method, threshold in ((cv2.USAC_MAGSAC, 2.0), (cv2.USAC_MAGSAC, 1.0), (cv2.LMEDS, 1.0)):
        pose = _find_relative_pose(first, second, method, threshold * spread)
        if pose is not None and all(_turn_between(pose.rotation, other.rotation) > _SAME for other in found):
            found.append(pose)
    return found


def _turn_between(first: FloatArray, second: FloatArray) -> float:
    """Angle between two rotations, rad."""
    return float(np.arccos(np.clip((np.trace(first @ second.T) - 1.0) / 2.0, -1.0, 1.0)))


def _find_relative_pose(first: FloatArray, second: FloatArray, method: int, threshold: float) -> RelativePose | None:
    from dousa.extras import cv2

    cv2.setRNGSeed(_SEED)
    try:
        essential, inliers = cv2.findEssentialMat(
            first, second, np.eye(3), method=method, prob=_SURE, threshold=threshold, maxIters=_MOST_TRIALS
        )
        if essential is None or essential.shape != (3, 3):
            return None
        before, rotation, translation, _ = cv2.recoverPose(essential, first, second, np.eye(3), mask=inliers.copy())
    except cv2.error:
        return None
    if before < _LEAST_PAIRS // 2:
        return None
    good = inliers.ravel() > 0
    rays = [np.concatenate((points[good], np.ones((good.sum(), 1))), axis=1) for points in (first, second)]
    rays = [ray / np.linalg.norm(ray, axis=1, keepdims=True) for ray in rays]
    cosines = np.clip((rays[0] @ rotation.T * rays[1]).sum(axis=1), -1.0, 1.0)
    parallax = float(np.median(np.arccos(cosines)))
    return RelativePose(
        np.asarray(rotation, np.float64), np.asarray(translation, np.float64).ravel(), before / len(first), parallax
    )


def triangulate(sightings: Sightings, rig: Rig, views: Sequence[int] | None = None) -> FloatArray:
    """Places of points: nearest to the lines of sight of all views that saw them, in the sense of least squares.

    Parameters
    ----------
    sightings : V views, T moments, K points.
    rig : the cameras.
    views : those to use; all by default.

    Returns
    -------
    (T, K, 3); nan where fewer than two views saw a point, or where it would be behind one that did.
    """
    used = list(range(rig.n_views)) if views is None else list(views)
    weights = np.where(sightings.weights[used] > 0, sightings.weights[used], 0.0)
    points = np.where(weights[..., None] > 0, sightings.points[used], 0.0)
    flat = points / rig.focals[used][:, None, None, None]
    rays = np.concatenate((flat, np.ones_like(flat[..., :1])), axis=-1)
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    rays = np.einsum("vji,vtkj->vtki", rig.rotations[used], rays)
    across = np.eye(3) - rays[..., :, None] * rays[..., None, :]
    across *= weights[..., None, None]
    normal = across.sum(axis=0)
    right = np.einsum("vtkij,vj->tki", across, rig.positions[used])
    seen = _is_well_placed(weights, normal)
    normal[~seen] = np.eye(3)
    found = np.linalg.solve(normal, right[..., None])[..., 0]
    depths = np.einsum("vj,tkj->vtk", rig.rotations[used][:, 2], found) + rig.translations[used][:, 2, None, None]
    seen &= ~((depths <= 0) & (weights > 0)).any(axis=0)
    return np.where(seen[..., None], found, np.nan)


def _is_well_placed(weights: FloatArray, normal: FloatArray) -> BoolArray:
    """(T, K) True where at least two lines of sight meet that are not parallel."""
    least = np.linalg.eigvalsh(normal)[..., 0]
    return np.asarray(((weights > 0).sum(axis=0) >= 2) & (least > 1e-5 * weights.sum(axis=0)))
