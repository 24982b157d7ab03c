"""Robust triangulation of points from several images (Hartley and Zisserman, section 12).

Each pair of views proposes a point (linear triangulation); the proposal that the other views agree with best is kept,
views that disagree are left out, and the point is refined on its reprojection errors by Gauss-Newton steps.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np

from dousa.arrays import BoolArray, FloatArray
from dousa.estimation.cameras.camera import Camera


def reduce_known(reduce: Callable[..., Any], values: FloatArray, axis: int) -> FloatArray:
    """Apply a function such as `np.nanmedian` along an axis; without a warning nan where all is nan."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        return np.asarray(reduce(values, axis=axis))


@dataclass(frozen=True, slots=True, eq=False)
class Triangulated:
    """Points of space.

    Parameters
    ----------
    points : (..., 3) m, nan where fewer than two views agree.
    covariance : (..., 3, 3) m^2, of the image errors; nan likewise.
    used : (V, ...) the views that agree.
    errors : (V, ...) px, reprojection errors; nan where there is none.
    """

    points: FloatArray
    covariance: FloatArray
    used: BoolArray
    errors: FloatArray


def triangulate(
    cameras: Sequence[Camera],
    points: FloatArray,
    visibility: FloatArray | None = None,
    spread: float = 0.03,
    *,
    agrees: float = 3.0,
    steps: int = 4,
) -> Triangulated:
    """Triangulate points, leaving out views that do not agree.

    Parameters
    ----------
    cameras : (V,) two at least.
    points : (V, ..., 2) px, nan where not seen.
    visibility : (V, ...) 0 to 1, weights; ones by default.
    spread : m, one sigma of the points' errors at the distance of the person.
    agrees : sigmas; a view that is farther off is left out.
    steps : of Gauss and Newton that refine a point.
    """
    batch = points.shape[1:-1]
    flat = points.reshape(len(cameras), -1, 2)
    seen = np.isfinite(flat[..., 0])
    weights = np.where(seen, 1.0 if visibility is None else visibility.reshape(len(cameras), -1), 0.0)
    rays = [camera.compute_rays(np.where(seen[v][:, None], flat[v], 0.0)) for v, camera in enumerate(cameras)]
    n_points = flat.shape[1]
    best, best_score = np.full((n_points, 3), np.nan), np.full(n_points, np.inf)
    for pair in combinations(range(len(cameras)), 2):
        found = meet([rays[view] for view in pair])
        found[~(seen[pair[0]] & seen[pair[1]])] = np.nan
        errors, scale = _reproject(cameras, found, flat, spread)
        off = np.minimum((errors / scale) ** 2, agrees**2)
        score = np.where(seen, weights * np.where(np.isfinite(off), off, agrees**2), 0.0).sum(axis=0)
        score += agrees**2 * 1e-3 * (2.0 - weights[list(pair)].sum(axis=0))  # of equals, those that are seen better
        better = np.isfinite(found[:, 0]) & (score < best_score)
        best[better], best_score[better] = found[better], score[better]
    return _refine(cameras, flat, weights, best, batch, spread=spread, agrees=agrees, steps=steps)


def meet(rays: Sequence[tuple[FloatArray, FloatArray]], least_angle: float = 0.06) -> FloatArray:
    """Return the points (N, 3) nearest to two rays.

    They are nan where the rays meet behind a camera, or at less than ``least_angle`` (rad), which leaves depth open.
    """
    (start, way), (other_start, other_way) = rays
    cosine = (way * other_way).sum(axis=1)
    between = other_start - start
    a, b = (between * way).sum(axis=1), (between * other_way).sum(axis=1)
    sine = 1.0 - cosine**2
    with np.errstate(all="ignore"):
        here, there = (a - cosine * b) / sine, (cosine * a - b) / sine
        found = 0.5 * (start + here[:, None] * way + other_start + there[:, None] * other_way)
    found[(sine < np.sin(least_angle) ** 2) | ~(here > 0) | ~(there > 0)] = np.nan
    return np.asarray(found)


def pixels_per_metre(camera: Camera, points: FloatArray) -> FloatArray:
    """Compute px per metre across the view at points (..., 3) m."""
    focal = float(0.5 * (camera.matrix[0, 0] + camera.matrix[1, 1]))
    if camera.kind == "orthographic":
        return np.full(points.shape[:-1], focal)
    depth = camera.compute_depths(points)
    return np.asarray(focal / np.where(depth > 0.05, depth, np.nan))


def _reproject(
    cameras: Sequence[Camera], found: FloatArray, flat: FloatArray, spread: float
) -> tuple[FloatArray, FloatArray]:
    """Return errors (V, N) px, and px of one sigma."""
    errors = np.stack([np.linalg.norm(camera.project(found) - own, axis=1)
                       for camera, own in zip(cameras, flat, strict=True)])  # fmt: skip
    return errors, spread * np.stack([pixels_per_metre(camera, found) for camera in cameras])


def _refine(
    cameras: Sequence[Camera],
    flat: FloatArray,
    weights: FloatArray,
    best: FloatArray,
    batch: tuple[int, ...],
    *,
    spread: float,
    agrees: float,
    steps: int,
) -> Triangulated:
    """Refine points by Gauss-Newton on the agreeing views, chosen again at each step."""
    points = best.copy()
    n_points = len(points)
    used = np.zeros(flat.shape[:2], bool)
    square = np.zeros((n_points, 3, 3))
    for _ in range(steps):
        square[:] = 1e-9 * np.eye(3)
        gradient = np.zeros((n_points, 3))
        errors, scale = _reproject(cameras, points, flat, spread)
        with np.errstate(invalid="ignore"):
            used = (errors < agrees * scale) & (weights > 0)
        for view, camera in enumerate(cameras):
            share = np.where(used[view], weights[view] / scale[view] ** 2, 0.0)
            slope = project_slope(camera, points)
            off = np.where(used[view][:, None], flat[view] - camera.project(points), 0.0)
            slope = np.where(np.isfinite(slope), slope, 0.0)
            share = np.where(np.isfinite(share), share, 0.0)
            square += np.einsum("n,nij,nik->njk", share, slope, slope)
            gradient += np.einsum("n,nij,ni->nj", share, slope, off)
        points = points + np.linalg.solve(square, gradient[..., None])[..., 0]
    errors, _ = _reproject(cameras, points, flat, spread)
    determined = (used.sum(axis=0) >= 2) & np.isfinite(points).all(axis=1)
    points[~determined] = np.nan
    covariance = np.full((n_points, 3, 3), np.nan)
    covariance[determined] = np.linalg.inv(square[determined])
    return Triangulated(
        points.reshape(*batch, 3),
        covariance.reshape(*batch, 3, 3),
        (used & determined).reshape(len(cameras), *batch),
        errors.reshape(len(cameras), *batch),
    )


def project_slope(camera: Camera, points: FloatArray, step: float = 1e-5) -> FloatArray:
    """Compute the derivative (..., 2, 3) px/m of the image of points (..., 3) by differences over ``step`` m."""
    steps = points[..., None, :] + step * np.eye(3)
    here = camera.project(points)
    return np.asarray(np.swapaxes(camera.project(steps) - here[..., None, :], -1, -2) / step)
