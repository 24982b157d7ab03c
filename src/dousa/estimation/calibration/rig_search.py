"""First guess of a rig: a pair of views by its essential matrix, the others by the points of that pair.

Essential matrices come from the points of all moments (Nister's five points and MAGSAC++, as in OpenCV) in
normalised coordinates: x / z and y / z along the camera's axes. As chance matters where cameras face each other or the
body is flat, several poses are tried, each improved by a few steps of the bundle adjustment, and the best is kept.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from dousa.arrays import FloatArray, spread_evenly
from dousa.estimation.calibration.bundle import Fit, Freedom, Limb, Rig, Sightings, adjust
from dousa.extras import cv2

RelativePose = tuple[float, FloatArray, FloatArray]
"""Merit of the pose of a second camera relative to a first, rotation (3, 3), and translation (3,) of length 1."""


def find_relative_poses(
    first: FloatArray,
    second: FloatArray,
    spread: float,
    *,
    most: int = 1500,
    least: int = 30,
    same: float = 0.02,
    seed: int = 7,
) -> list[RelativePose]:
    """Return different possible poses of two cameras; none with too few points, or none before both cameras.

    The better the more points agree and the wider the median angle between their lines of sight is.

    Parameters
    ----------
    first, second : (N, 2) normalised coordinates of the same points.
    spread : normalised error of a point; twice as far still agrees.
    most : points that are used: more of the same person add nothing.
    least : points that are needed, of which half must lie before both cameras.
    same : rad, between two poses that are one.
    seed : of all random choices.
    """
    if len(first) < least:
        return []
    if len(first) > most:
        some = np.random.default_rng(seed).choice(len(first), most, replace=False)
        first, second = first[some], second[some]
    found: list[RelativePose] = []
    for method, threshold in ((cv2.USAC_MAGSAC, 2.0), (cv2.USAC_MAGSAC, 1.0), (cv2.LMEDS, 1.0)):
        cv2.setRNGSeed(seed)
        pose = _find_relative_pose(first, second, method, threshold * spread, least // 2)
        if pose is not None and all(_turn_between(pose[1], other[1]) > same for other in found):
            found.append(pose)
    return found


def _turn_between(first: FloatArray, second: FloatArray) -> float:
    """Compute the angle between two rotations, rad."""
    return float(np.arccos(np.clip((np.trace(first @ second.T) - 1.0) / 2.0, -1.0, 1.0)))


def _find_relative_pose(
    first: FloatArray,
    second: FloatArray,
    method: int,
    threshold: float,
    least: int,
    sure: float = 0.999,
    most_trials: int = 1000,
) -> RelativePose | None:
    """Return the pose by a method of OpenCV, ``sure`` in its sense, if ``least`` points lie before both cameras."""
    try:
        essential, inliers = cv2.findEssentialMat(
            first, second, np.eye(3), method=method, prob=sure, threshold=threshold, maxIters=most_trials
        )
        if essential is None or essential.shape != (3, 3):
            return None
        before, rotation, translation, _ = cv2.recoverPose(essential, first, second, np.eye(3), mask=inliers.copy())
    except cv2.error:
        return None
    if before < least:
        return None
    good = inliers.ravel() > 0
    rays = [np.concatenate((points[good], np.ones((good.sum(), 1))), axis=1) for points in (first, second)]
    rays = [ray / np.linalg.norm(ray, axis=1, keepdims=True) for ray in rays]
    cosines = np.clip((rays[0] @ rotation.T * rays[1]).sum(axis=1), -1.0, 1.0)
    merit = before / len(first) * np.sin(float(np.median(np.arccos(cosines))))
    return merit, np.asarray(rotation, np.float64), np.asarray(translation, np.float64).ravel()


def triangulate(sightings: Sightings, rig: Rig, views: Sequence[int] | None = None) -> FloatArray:
    """Triangulate points (T, K, 3) by least squares from all views that saw them.

    They are nan where fewer than two views saw a point, or where it would be behind one of them.

    Parameters
    ----------
    sightings : V views, T moments, K points.
    rig : the cameras.
    views : those to use; all by default.
    """
    used = list(range(len(rig.rotations))) if views is None else list(views)
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
    # At least two lines of sight meet that are not parallel.
    seen = (weights > 0).sum(axis=0) >= 2
    seen &= np.linalg.eigvalsh(normal)[..., 0] > 1e-5 * weights.sum(axis=0)
    normal[~seen] = np.eye(3)
    found = np.linalg.solve(normal, right[..., None])[..., 0]
    depths = np.einsum("vj,tkj->vtk", rig.rotations[used][:, 2], found) + rig.translations[used][:, 2, None, None]
    seen &= ~((depths <= 0) & (weights > 0)).any(axis=0)
    return np.where(seen[..., None], found, np.nan)


def find_rig(
    sightings: Sightings,
    focals: FloatArray,
    limbs: Sequence[Limb],
    *,
    most_moments: int = 40,
    most_starts: int = 6,
    steps: int = 10,
) -> Fit | None:
    """Find a first guess of the cameras, in the axes of the first and an arbitrary unit.

    Returns None where no two views agree, or a further view agrees with none.

    Parameters
    ----------
    sightings : V views, T moments, K points.
    focals : (V,) px.
    limbs : of constant length.
    most_moments : evenly spread, that are used.
    most_starts : pairs of views that are tried, the best first.
    steps : of the adjustment of each.
    """
    some = sightings.pick(spread_evenly(sightings.points.shape[1], most_moments))
    starts: list[tuple[int, int, RelativePose]] = []
    for one, other in itertools.combinations(range(len(focals)), 2):
        both = (some.weights[one] > 0) & (some.weights[other] > 0)
        flat = [some.points[view][both] / focals[view] for view in (one, other)]
        spread = float(np.mean(some.spreads[[one, other]] / focals[[one, other]]))
        starts += [(one, other, pose) for pose in find_relative_poses(flat[0], flat[1], spread)]
    starts.sort(key=lambda start: -start[2][0])
    best: Fit | None = None
    for start in starts[:most_starts]:
        rig = _chain(some, focals, *start)
        if rig is None:
            continue
        fit = adjust(some, rig, triangulate(some, rig), limbs, Freedom(), steps)
        if best is None or fit.cost < best.cost:
            best = fit
    return best


def _chain(sightings: Sightings, focals: FloatArray, one: int, other: int, pose: RelativePose) -> Rig | None:
    """Return a rig that begins with a pair; its first view has the world's axes."""
    n_views = len(focals)
    rotations, translations = np.tile(np.eye(3), (n_views, 1, 1)), np.zeros((n_views, 3))
    rotations[other], translations[other] = pose[1:]
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
    return rig.move(rig.rotations[0], rig.translations[0])


def _find_pose(
    sightings: Sightings, points: FloatArray, focal: float, view: int, least: int = 12, most_off: float = 2.5
) -> tuple[float, FloatArray, FloatArray]:
    """Return the share of points that agree with a further view's pose, and that pose; 0 where there is none.

    At least ``least`` points must agree, that is, be off by at most ``most_off`` spreads.
    """
    nothing = 0.0, np.eye(3), np.zeros(3)
    both = np.isfinite(points[..., 0]) & (sightings.weights[view] > 0)
    if both.sum() < least:
        return nothing
    flat = sightings.points[view][both] / focal
    reach = most_off * sightings.spreads[view] / focal
    try:
        good, turn, place, inliers = cv2.solvePnPRansac(
            points[both], flat, np.eye(3), None, reprojectionError=reach, iterationsCount=500, flags=cv2.SOLVEPNP_EPNP
        )
        if not good or inliers is None or len(inliers) < least:
            return nothing
        agree = inliers.ravel()
        _, turn, place = cv2.solvePnP(points[both][agree], flat[agree], np.eye(3), None, turn, place, True)
    except cv2.error:
        return nothing
    rotation = np.asarray(cv2.Rodrigues(turn)[0], np.float64)
    return len(agree) / int(both.sum()), rotation, np.asarray(place, np.float64).ravel()
