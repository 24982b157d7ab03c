"""Lost points: what programs write where a point was not seen, such as 0 0 0, -9999 or 1e9 in all three coordinates.

No number says by itself that it is no place. What was not seen has one size in all three coordinates, which no measured
point has, and jumps there from where it was seen; or it lies far beyond all other points. All distances are shares of
the size of the body, in whatever unit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dousa.arrays import BoolArray, FloatArray, IndexArray
from dousa.motion.canonical.anthropometry import find_medians


@dataclass(frozen=True, slots=True, eq=False)
class Cloud:
    """Where the points of a file are: their middle (3,), and the usual size of the body."""

    middle: FloatArray
    size: float


def measure_cloud(positions: FloatArray, most: int = 20) -> Cloud:
    """Measure the points of a file, robust against strays; of a single point how far it gets around.

    Parameters
    ----------
    positions : (T, K, 3) in any unit; NaN where missing.
    most : frames that are looked at.
    """
    sample = positions[:: -(-len(positions) // most)]
    with np.errstate(over="ignore", invalid="ignore"):
        seen = np.isfinite(sample.sum(axis=2)) & ~_equal_sides(sample)
        counts = seen.sum(axis=1)
        if not counts.all():
            sample, seen, counts = (array[counts > 0] for array in (sample, seen, counts))
            if len(sample) == 0:
                return Cloud(np.zeros(3), 0.0)
        ranked = np.sort(np.where(seen[..., None], sample, np.nan), axis=1)  # NaN last
        shares = np.rint(np.multiply.outer((0.1, 0.5, 0.9), counts - 1)).astype(np.intp)
        low, middle, high = ranked[np.arange(len(sample)), shares]
        extents = (high - low).max(axis=1, keepdims=True)
        *middles, size = find_medians(np.concatenate((middle, extents), axis=1)).tolist()
    return Cloud(np.array(middles), size or float(np.ptp(middle, axis=0).max()))


def find_lost(positions: FloatArray, *, can_rest: bool = False, body: FloatArray | None = None) -> BoolArray | None:
    """Find the points that were not seen and yet have coordinates: (T, K), None if there are none.

    Parameters
    ----------
    positions : (T, K, 3) in any unit; NaN where missing.
    can_rest : whether a zero before the first and after the last other place is one: roots stand there at rest.
    body : (T', K', 3) points of the body that these belong to, if they are not all of it.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        equal = _equal_sides(positions)
        if can_rest and equal.any():
            away: BoolArray = np.any(positions, axis=2)
            if not away.any():  # a root that stays at the origin
                return None
            within = np.maximum.accumulate(away, axis=0) & np.maximum.accumulate(away[::-1], axis=0)[::-1]
            equal &= within
        suspected = bool(equal.any())
        if not suspected and (positions.shape[1] < 3 or body is not None):
            return None
        cloud = measure_cloud(positions if body is None else body)
        if not cloud.size > 0:
            return None
        lost = _strays(positions, equal, cloud) if positions.shape[1] > 2 else np.zeros(equal.shape, bool)
        if suspected:
            frames, points = np.nonzero(equal)
            lost[frames, points] |= _jumps(positions, equal, frames, points, cloud)
    return lost if lost.any() else None


def _strays(positions: FloatArray, equal: BoolArray, cloud: Cloud, most: float = 100.0) -> BoolArray:
    """(T, K) points that are beyond all that the body reaches, by more than ``most`` of its sizes."""
    beyond = most * cloud.size
    low, high = (reduce(positions, axis=None) for reduce in (np.fmin.reduce, np.fmax.reduce))
    if low >= cloud.middle.max() - beyond and high <= cloud.middle.min() + beyond:
        return np.zeros(equal.shape, bool)
    # How far the whole body gets around: the median of the points in each frame.
    seen = np.where(equal[..., None], np.nan, positions)
    seen = seen[np.isfinite(seen).all(axis=2).any(axis=-1)]
    middles = np.nanmedian(seen, axis=1) if len(seen) else cloud.middle[None]
    strays: BoolArray = np.abs(positions - cloud.middle).max(axis=2) > beyond + np.abs(middles - cloud.middle).max()
    return strays


def _equal_sides(positions: FloatArray) -> BoolArray:
    """(T, K) whether all three coordinates have one size."""
    y = np.abs(positions[..., 1])
    equal: BoolArray = np.abs(positions[..., 0]) == y
    if equal.any():
        equal &= y == np.abs(positions[..., 2])
    return equal


def _jumps(
    positions: FloatArray,
    equal: BoolArray,
    frames: IndexArray,
    points: IndexArray,
    cloud: Cloud,
    near: float = 0.05,
    outside: float = 3.0,
) -> BoolArray:
    """Whether suspected positions are out of the way that the point takes, and moves with the others.

    Parameters
    ----------
    positions, equal : (T, K, 3) and (T, K).
    frames, points : (N,) of the suspected ones.
    cloud : of all points.
    near : size of the body within which a point stays from one frame to the next in which it is seen.
    outside : sizes of the body from whose middle a point must be that is never seen elsewhere.
    """
    n_frames = len(positions)
    seen = ~equal & np.isfinite(positions).all(axis=2)
    count = seen.sum(axis=1)
    middles = np.stack([np.where(seen, positions[..., axis], 0.0).sum(axis=1) for axis in range(3)], axis=1)
    middles /= np.maximum(count, 1)[:, None]
    middles[count == 0] = np.nan
    columns, where = np.unique(points, return_inverse=True)
    shown = seen[:, columns]
    index = np.arange(n_frames)[:, None]
    before = np.maximum.accumulate(np.where(shown, index, -1), axis=0)[frames, where]
    after = np.minimum.accumulate(np.where(shown, index, n_frames)[::-1], axis=0)[::-1][frames, where]
    here = positions[frames, points]
    nearest = np.full(len(frames), np.inf)
    for other, there in ((before, before >= 0), (after, after < n_frames)):
        step = here - positions[np.clip(other, 0, n_frames - 1), points]
        carried = step - (middles[frames] - middles[np.clip(other, 0, n_frames - 1)])
        # In a frame without any other point the body would be a single point.
        far = np.linalg.norm(carried, axis=1)
        far = np.minimum(np.linalg.norm(step, axis=1), np.where(np.isnan(far), np.inf, far))
        nearest = np.where(there, np.minimum(nearest, far), nearest)
    never = ~np.isfinite(nearest)
    lost: BoolArray = nearest > near * cloud.size
    collapsed = (count[frames] == 0) & (positions.shape[1] > 1)
    lost[never] = np.abs(here[never] - cloud.middle).max(axis=1) > outside * cloud.size
    lost[collapsed] = True
    return lost
