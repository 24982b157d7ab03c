"""Resampling to a frame rate, thinning to a few frames, filling gaps, smoothing."""

from __future__ import annotations

import sys
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dousa.arrays import BoolArray, FloatArray, IndexArray
from dousa.errors import InvalidMotionError, OptionError
from dousa.motion.rotations import slerp
from dousa.motion.types import Motion, Trajectories, freeze

_Moving = TypeVar("_Moving", Motion, Trajectories)


def resample(moving: _Moving, frame_rate: float) -> _Moving:
    """Resample a motion to another frame rate; the same object if it has this rate already.

    The frames run from the first old frame to at most the last. Positions are interpolated linearly, rotations on the
    shorter arc. Where either neighbour is missing (NaN) the result is missing.

    Parameters
    ----------
    moving : motion or trajectories.
    frame_rate : Hz.

    Raises
    ------
    OptionError : a frame rate that is not above 0, or that makes too many frames.
    """
    rate = float(frame_rate)
    if rate == moving.frame_rate:
        return moving
    before, after, fraction = find_neighbours(moving.n_frames, moving.frame_rate, frame_rate)
    if isinstance(moving, Motion):
        turned = slerp(moving.rotations[before], moving.rotations[after], fraction[:, None])
        exact = fraction == 0
        turned[exact] = moving.rotations[before[exact]]
        moved = _blend(moving.translations, before, after, fraction)
        return moving.replace(rotations=freeze(turned), translations=freeze(moved), frame_rate=rate)
    positions = freeze(_blend(moving.positions, before, after, fraction))
    return moving.replace(positions=positions, frame_rate=rate)


def find_neighbours(
    n_frames: int, old_rate: float, new_rate: float, most: int = 20_000_000, tolerance: float = 1e-9
) -> tuple[IndexArray, IndexArray, FloatArray]:
    """Find the old frames before and after each frame at another rate, and the fraction between them.

    Parameters
    ----------
    n_frames : at the old rate.
    old_rate, new_rate : Hz.
    most : frames at the new rate.
    tolerance : frames; a last one that is missed only by rounding counts.

    Raises
    ------
    OptionError : a new rate not above 0, or too many frames.
    """
    if not (np.isfinite(new_rate) and 0 < new_rate <= 1e6):
        raise OptionError("resampling.rate", rate=new_rate)
    count = int(np.floor((n_frames - 1) / old_rate * new_rate + tolerance)) + 1
    if count > most:
        raise OptionError("resampling.too_many", rate=new_rate, count=count)
    place = np.minimum(np.arange(count) * (old_rate / new_rate), n_frames - 1.0)
    nearest = np.round(place)
    # Frames that fall together but for rounding are copied, so that NaN beside them does not spread.
    place = np.where(np.abs(place - nearest) < tolerance * np.maximum(1.0, nearest), nearest, place)
    before = place.astype(np.intp)
    return before, np.minimum(before + 1, n_frames - 1), place - before


def _blend(values: FloatArray, before: IndexArray, after: IndexArray, fraction: FloatArray) -> FloatArray:
    weight = fraction[:, None, None]
    mixed = values[before] * (1.0 - weight) + values[after] * weight
    exact = fraction == 0
    mixed[exact] = values[before[exact]]
    return mixed


def thin(array: ArrayLike, n: int) -> NDArray[Any]:
    """Return the (n, ...) frames nearest to n equally spaced instants from the first frame to the last, as a copy.

    Parameters
    ----------
    array : (T, ...) anything with frames first; shorter arrays repeat frames.
    n : number of frames wanted; one frame is the first.

    Raises
    ------
    OptionError : n below 1.
    InvalidMotionError : no frame at all.
    """
    frames = np.asarray(array)
    if n < 1:
        raise OptionError("resampling.count", count=n)
    if frames.ndim == 0 or len(frames) == 0:
        raise InvalidMotionError("resampling.no_frames")
    places = np.arange(n) * ((len(frames) - 1) / max(n - 1, 1)) + 0.5
    chosen: NDArray[Any] = frames[places.astype(np.intp)]
    return chosen


def fill_gaps(positions: ArrayLike) -> FloatArray:
    """Fill gaps in positions along a straight line, in a copy.

    A point with any coordinate missing is missing. The first and last positions are held at the ends; a point that is
    never seen stays NaN.

    Parameters
    ----------
    positions : (T, K, 3) m, NaN where missing.

    Raises
    ------
    InvalidMotionError : another shape.
    """
    filled = np.array(positions, np.float64)
    if filled.ndim != 3:
        raise InvalidMotionError("resampling.shape", shape=filled.shape)
    missing = cast(BoolArray, np.isnan(filled).any(axis=2))
    frames = np.arange(len(filled))
    for point in np.flatnonzero(missing.any(axis=0)):
        seen = frames[~missing[:, point]]
        if len(seen) == 0:
            filled[:, point] = np.nan
            continue
        for axis in range(filled.shape[2]):
            filled[:, point, axis] = np.interp(frames, seen, filled[seen, point, axis])
    return filled


def smooth_gaussian(values: FloatArray, deviation: float, *, small: int = 10_000_000) -> FloatArray:
    """Smooth values (T, ...) with a Gaussian of four standard deviations (in frames) to either side; ends are repeated.

    Missing values make all within reach of them missing. Up to ``small`` products are added up without SciPy, in the
    same order: loading it takes longer.
    """
    n, reach = len(values), int(4.0 * deviation + 0.5)
    if "scipy.ndimage" in sys.modules or not 0 < values.size * (reach + 1) <= small:
        from scipy.ndimage import gaussian_filter1d

        smooth: FloatArray = gaussian_filter1d(values, deviation, axis=0, output=np.float64, mode="nearest")
        return smooth
    weights = np.exp(-0.5 / (deviation * deviation) * np.arange(-reach, reach + 1) ** 2)
    weights = (weights / weights.sum())[reach:]
    held = np.asarray(values, np.float64)[np.arange(-reach, n + reach).clip(0, n - 1)]
    smooth = weights[0] * held[reach : reach + n]
    for step in range(reach, 0, -1):
        smooth += (held[reach - step : reach - step + n] + held[reach + step : reach + step + n]) * weights[step]
    return smooth
