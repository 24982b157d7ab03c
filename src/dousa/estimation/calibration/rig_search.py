"""First guess of a rig: a pair of views by its essential matrix, the others by the points of that pair.

Essential matrices come from the points of all moments (Nister's five points and MAGSAC++, as in OpenCV) in
normalised coordinates: x / z and y / z along the camera's axes. As chance matters where cameras face each other or the
body is flat, several poses are tried, each improved by a few steps of the bundle adjustment, and the best is kept.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dousa.arrays import BoolArray, FloatArray
from dousa.estimation.calibration.bundle import Fit, Freedom, Limb, Rig, Sightings, adjust
from dousa.extras import cv2

_MOST_PAIRS = 1500  # points for RANSAC: more of the same person add nothing
_LEAST_PAIRS = 30
_SURE = 0.999
_MOST_TRIALS = 1000
_SAME = 0.02  # rad: poses that differ by less are one
_SEED = 7


@dataclass(frozen=True, slots=True, eq=False)
class RelativePose:
    """The pose of a second camera relative to a first.

    Parameters
    ----------
    rotation : (3, 3) from the first camera's axes to the second's.
    translation : (3,) of length 1.
    share : of the points that agree, 0 to 1.
    parallax : rad, median angle between the two lines of sight of an agreeing point.
    """

    rotation: FloatArray
    translation: FloatArray
    share: float
    parallax: float


def find_relative_poses(first: FloatArray, second: FloatArray, spread: float) -> list[RelativePose]:
    """Return different possible poses of two cameras; none with too few points, or none before both cameras.

    Parameters
    ----------
    first, second : (N, 2) normalised coordinates of the same points.
    spread : normalised error of a point; twice as far still agrees.
    """
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
    """Compute the angle between two rotations, rad."""
    return float(np.arccos(np.clip((np.trace(first @ second.T) - 1.0) / 2.0, -1.0, 1.0)))


def _find_relative_pose(first: FloatArray, second: FloatArray, method: int, threshold: float) -> RelativePose | None:
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
    """Triangulate points (T, K, 3) by least squares from all views that saw them.

    They are nan where fewer than two views saw a point, or where it would be behind one of them.

    Parameters
    ----------
    sightings : V views, T moments, K points.
    rig : the cameras.
    views : those to use; all by default.
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
    """Return (T, K) True where at least two lines of sight meet that are not parallel."""
    least = np.linalg.eigvalsh(normal)[..., 0]
    return np.asarray(((weights > 0).sum(axis=0) >= 2) & (least > 1e-5 * weights.sum(axis=0)))


_MOST_MOMENTS = 40  # for the first guess
_MOST_STARTS = 6
_STEPS = 10
_LEAST_POINTS = 12
_MOST_OFF = 2.5  # spreads by which a point may be off for a further view's pose


def find_rig(sightings: Sightings, focals: FloatArray, limbs: Sequence[Limb]) -> Fit | None:
    """Find a first guess of the cameras, in the axes of the first and an arbitrary unit, from at most 40 moments.

    Returns None where no two views agree, or a further view agrees with none.

    Parameters
    ----------
    sightings : V views, T moments, K points.
    focals : (V,) px.
    limbs : of constant length.
    """
    some = _pick_moments(sightings)
    starts: list[tuple[float, int, int, RelativePose]] = []
    for one, other in itertools.combinations(range(len(focals)), 2):
        both = (some.weights[one] > 0) & (some.weights[other] > 0)
        flat = [some.points[view][both] / focals[view] for view in (one, other)]
        spread = float(np.mean(some.spreads[[one, other]] / focals[[one, other]]))
        for pose in find_relative_poses(flat[0], flat[1], spread):
            starts.append((pose.share * np.sin(pose.parallax), one, other, pose))
    starts.sort(key=lambda start: -start[0])
    best: Fit | None = None
    for _, one, other, pose in starts[:_MOST_STARTS]:
        rig = _chain(some, focals, one, other, pose)
        if rig is None:
            continue
        fit = adjust(some, rig, triangulate(some, rig), limbs, Freedom(), _STEPS)
        if best is None or fit.cost < best.cost:
            best = fit
    return best


def _pick_moments(sightings: Sightings) -> Sightings:
    n_moments = sightings.points.shape[1]
    picked = np.unique(np.linspace(0, n_moments - 1, min(n_moments, _MOST_MOMENTS)).round().astype(int))
    return replace(
        sightings,
        points=sightings.points[:, picked],
        weights=sightings.weights[:, picked],
        velocities=sightings.velocities[:, picked],
    )


def _chain(sightings: Sightings, focals: FloatArray, one: int, other: int, pose: RelativePose) -> Rig | None:
    """Return a rig that begins with a pair; its first view has the world's axes."""
    n_views = len(focals)
    rotations, translations = np.tile(np.eye(3), (n_views, 1, 1)), np.zeros((n_views, 3))
    rotations[other], translations[other] = pose.rotation, pose.translation
    rig = Rig(rotations, translations, focals, sightings.offsets)
    placed = [one, other]
    while len(placed) < n_views:
        points = triangulate(sightings, rig, placed)
        found = [
            (share, view, rotation, translation)
            for view in range(n_views)
            if view not in placed
            for share, rotation, translation in [_find_pose(sightings, points, focals[view], view)]
        ]
        share, view, rotation, translation = max(found, key=lambda item: item[0])
        if share <= 0:
            return None
        rotations[view], translations[view] = rotation, translation
        placed.append(view)
    return _about_first(rig)


def _find_pose(
    sightings: Sightings, points: FloatArray, focal: float, view: int
) -> tuple[float, FloatArray, FloatArray]:
    """Return the share of points that agree with a further view's pose, and that pose; 0 where there is none."""
    both = np.isfinite(points[..., 0]) & (sightings.weights[view] > 0)
    if both.sum() < _LEAST_POINTS:
        return 0.0, np.eye(3), np.zeros(3)
    flat = sightings.points[view][both] / focal
    reach = _MOST_OFF * sightings.spreads[view] / focal
    try:
        good, turn, place, inliers = cv2.solvePnPRansac(
            points[both], flat, np.eye(3), None, reprojectionError=reach, iterationsCount=500, flags=cv2.SOLVEPNP_EPNP
        )
        if not good or inliers is None or len(inliers) < _LEAST_POINTS:
            return 0.0, np.eye(3), np.zeros(3)
        agree = inliers.ravel()
        _, turn, place = cv2.solvePnP(points[both][agree], flat[agree], np.eye(3), None, turn, place, True)
    except cv2.error:
        return 0.0, np.eye(3), np.zeros(3)
    rotation = np.asarray(cv2.Rodrigues(turn)[0], np.float64)
    return len(agree) / int(both.sum()), rotation, np.asarray(place, np.float64).ravel()


def _about_first(rig: Rig) -> Rig:
    """Return the same rig in the axes of its first camera."""
    rotation, translation = rig.rotations[0], rig.translations[0]
    turned = rig.rotations @ rotation.T
    return replace(rig, rotations=turned, translations=rig.translations - turned @ translation)
