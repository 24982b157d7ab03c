"""The first guess of a rig: a pair of views by its essential matrix, the others by the points that the pair places.

What comes out of an essential matrix depends on chance where cameras face each other or the body is flat, so several
poses are tried, each improved by a few steps of the bundle adjustment, and the one with the least cost is kept.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dousa.arrays import FloatArray
from dousa.estimation.calibration.bundle import Fit, Freedom, Limb, Rig, Sightings, adjust
from dousa.estimation.calibration.two_views import RelativePose, find_relative_poses, triangulate

_MOST_MOMENTS = 40  # for the first guess
_MOST_STARTS = 6
_STEPS = 10
_LEAST_POINTS = 12
_MOST_OFF = 2.5  # spreads by which a point may be off for a further view's pose


def find_rig(sightings: Sightings, focals: FloatArray, limbs: Sequence[Limb]) -> Fit | None:
    """Where the cameras stand, in the axes of the first and an arbitrary unit.

    Parameters
    ----------
    sightings : V views, T moments, K points.
    focals : (V,) px.
    limbs : what keeps its length.

    Returns
    -------
    The best guess, over at most 40 of the moments; None where no two views agree on any, or a view agrees with none.
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
    """A rig that begins with a pair; its first view has the world's axes."""
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
    """Share of the points that agree with a further view's pose, and that pose; 0 where there is none."""
    from dousa.extras import cv2

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
    """The same rig in the axes of its first camera."""
    rotation, translation = rig.rotations[0], rig.translations[0]
    turned = rig.rotations @ rotation.T
    return replace(rig, rotations=turned, translations=rig.translations - turned @ translation)
