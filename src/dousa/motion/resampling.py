"""Motion at other instants: resampling to a frame rate, thinning to a few frames, filling gaps."""

from __future__ import annotations

from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dousa.errors import InvalidMotionError, OptionError
from dousa.motion._types import FloatArray, Motion, Trajectories
from dousa.motion.rotations import slerp

__all__ = ["fill_gaps", "find_neighbours", "resample", "thin"]

_Moving = TypeVar("_Moving", Motion, Trajectories)

_MOST_FRAMES = 20_000_000
_FRAME_TOLERANCE = 1e-9  # a last frame missed by rounding alone still counts


def resample(moving: _Moving, frame_rate: float) -> _Moving:
    """The same motion at another frame rate.

    The first frame stays; the new frames go on as long as the old ones do. Positions are interpolated
    linearly, rotations on the shorter arc. Where either neighbour is missing (NaN) the result is missing.

    Parameters
    ----------
    moving : motion or trajectories.
    frame_rate : Hz.

    Returns
    -------
    The same type; the very object if it has this frame rate already.

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
        return cast(
            _Moving, moving.replace(rotations=_own(turned), translations=_own(moved), frame_rate=rate)
        )
    return cast(
        _Moving,
        moving.replace(positions=_own(_blend(moving.positions, before, after, fraction)), frame_rate=rate),
    )


def find_neighbours(
    n_frames: int, old_rate: float, new_rate: float
) -> tuple[NDArray[np.intp], NDArray[np.intp], FloatArray]:
    """Old frames before and after each frame at another rate, and where between them it falls.

    Parameters
    ----------
    n_frames : at the old rate.
    old_rate, new_rate : Hz.

    Raises
    ------
    OptionError : a frame rate that is not above 0, or that makes too many frames.
    """
    if not (np.isfinite(new_rate) and 0 < new_rate <= 1e6):
        raise OptionError(f"frame rate: expected Hz above 0 and up to a million, got {new_rate}")
    count = int(np.floor((n_frames - 1) / old_rate * new_rate + _FRAME_TOLERANCE)) + 1
    if count > _MOST_FRAMES:
        raise OptionError(f"frame rate: {new_rate:g} Hz would make {count} frames; choose a lower rate")
    place = np.minimum(np.arange(count) * (old_rate / new_rate), n_frames - 1.0)
    nearest = np.round(place)
    # Frames that fall together but for rounding are copied, so that NaN beside them does not spread.
    place = np.where(np.abs(place - nearest) < _FRAME_TOLERANCE * np.maximum(1.0, nearest), nearest, place)
    before = place.astype(np.intp)
    return before, np.minimum(before + 1, n_frames - 1), place - before


def _blend(
    values: FloatArray, before: NDArray[np.intp], after: NDArray[np.intp], fraction: FloatArray
) -> FloatArray:
    """Linear interpolation along the first axis of (T, n, 3)."""
    weight = fraction[:, None, None]
    mixed = values[before] * (1.0 - weight) + values[after] * weight
    exact = fraction == 0
    mixed[exact] = values[before[exact]]
    return cast(FloatArray, mixed)


def _own(array: FloatArray) -> FloatArray:
    """Mark an array nobody else holds as read-only, which spares the constructor a copy."""
    array.flags.writeable = False
    return array


def thin(array: ArrayLike, n: int) -> NDArray[Any]:
    """The frames nearest to n equally spaced instants from the first frame to the last.

    Parameters
    ----------
    array : (T, ...) anything with frames first; shorter arrays repeat frames.
    n : number of frames wanted; one frame is the first.

    Returns
    -------
    (n, ...) copy.

    Raises
    ------
    OptionError : n below 1.
    InvalidMotionError : no frame at all.
    """
    frames = np.asarray(array)
    if n < 1:
        raise OptionError(f"number of frames: expected 1 or more, got {n}")
    if frames.ndim == 0 or len(frames) == 0:
        raise InvalidMotionError("thin: expected at least one frame, got none")
    places = np.linspace(0, len(frames) - 1, n)
    chosen: NDArray[Any] = frames[np.floor(places + 0.5).astype(np.intp)]
    return chosen


def fill_gaps(positions: ArrayLike) -> FloatArray:
    """Positions with their gaps bridged in a straight line.

    A point with any coordinate missing is missing. Before its first and after its last sighting a point stays
    where it was seen; a point never seen stays NaN.

    Parameters
    ----------
    positions : (T, K, 3) m, NaN where missing.

    Returns
    -------
    (T, K, 3) copy.

    Raises
    ------
    InvalidMotionError : another shape.
    """
    filled = np.array(positions, np.float64)
    if filled.ndim != 3:
        raise InvalidMotionError(f"positions: expected shape (any, any, 3), got {filled.shape}")
    missing = cast(NDArray[np.bool_], np.isnan(filled).any(axis=2))
    frames = np.arange(len(filled))
    for point in np.flatnonzero(missing.any(axis=0)):
        seen = frames[~missing[:, point]]
        if len(seen) == 0:
            filled[:, point] = np.nan
            continue
        for axis in range(filled.shape[2]):
            filled[:, point, axis] = np.interp(frames, seen, filled[seen, point, axis])
    return filled
