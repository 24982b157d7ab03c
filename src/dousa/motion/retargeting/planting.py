"""Holding feet and hands in place: bending two bones so that the end of a limb reaches a place."""

from __future__ import annotations

import numpy as np

from dousa.arrays import BoolArray, FloatArray
from dousa.motion.retargeting.stances import smooth
from dousa.motion.rotations import between, rotate

_REACH = 0.9999  # of the length of a limb: beyond, the knee would leap
_BENT = 0.999  # of the length of a leg: the pelvis goes down so far that knees keep a little bend
_BIAS = 0.02  # of the upper bone
_EASED, _SWINGING = 0.1, 0.1  # s; how much of a foot in the air counts
_SMOOTH = 0.08  # s, over which the pelvis gives way


def share_moves(moves: FloatArray, stands: BoolArray, frame_rate: float) -> FloatArray:
    """Compute the move (T, 3) m of the whole body from those of its feet, so that the legs bend little.

    A standing foot counts most.

    Parameters
    ----------
    moves : (T, 2, 3) m, of the feet.
    stands : (T, 2) which of them are held.
    frame_rate : Hz.
    """
    around = max(1, round(_EASED * frame_rate))
    weights = np.where(stands, 1.0, _SWINGING)
    shared = (weights[..., None] * moves).sum(axis=1) / weights.sum(axis=1)[:, None]
    return np.stack([smooth(shared[:, axis], around) for axis in range(3)], axis=1)


def bend(
    root: FloatArray, middle: FloatArray, end: FloatArray, wanted: FloatArray, outward: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Compute turns (T, 4) in the world of the upper and lower bone that bring the end of a limb to a place.

    The plane of the limb turns as little as it can; lengths are kept, so that a place out of reach is approached.

    Parameters
    ----------
    root, middle, end : (T, 3) m, joints of the limb, such as hip, knee and ankle.
    wanted : (T, 3) m, place for the end.
    outward : (T, 3) of any length, direction of the middle joint if the limb is straight: knees to the front.
    """
    upper, lower = np.linalg.norm(middle - root, axis=1), np.linalg.norm(end - middle, axis=1)
    line, goal = end - root, wanted - root
    furthest, nearest = _REACH * (upper + lower), 1.001 * np.abs(upper - lower) + 1e-6
    distance = np.clip(np.linalg.norm(goal, axis=1), nearest, np.maximum(furthest, nearest))
    ahead = goal / np.maximum(np.linalg.norm(goal, axis=1, keepdims=True), 1e-9)
    turned = rotate(between(line, goal), middle - root)
    # A straight limb has no plane of its own, and one that is nearly straight an unsteady one.
    side = outward / np.maximum(np.linalg.norm(outward, axis=1, keepdims=True), 1e-9)
    own = turned - (turned * ahead).sum(axis=1, keepdims=True) * ahead
    lacking = np.maximum(_BIAS * upper - np.linalg.norm(own, axis=1), 0.0)
    turned = turned + lacking[:, None] * side
    across = turned - (turned * ahead).sum(axis=1, keepdims=True) * ahead
    length = np.linalg.norm(across, axis=1, keepdims=True)
    across = across / np.maximum(length, 1e-9)
    along = (upper**2 - lower**2 + distance**2) / (2 * distance)
    off = np.sqrt(np.maximum(upper**2 - along**2, 0.0))
    knee = along[:, None] * ahead + off[:, None] * across
    reached = distance[:, None] * ahead
    return between(middle - root, knee), between(end - middle, reached - knee)


def lower_pelvis(hips: FloatArray, wanted: FloatArray, lengths: FloatArray, frame_rate: float) -> FloatArray:
    """Compute how far down (T,) m the pelvis must go so that all feet are within reach, smooth over time.

    Parameters
    ----------
    hips, wanted : (T, 2, 3) m, hip joints, and places for the ankles.
    lengths : (2,) m of the legs.
    """
    gap = hips - wanted
    beside = np.square(gap[..., 0]) + np.square(gap[..., 2])
    highest = np.sqrt(np.maximum(np.square(_BENT * lengths) - beside, 0.0))
    needed = np.maximum(gap[..., 1] - highest, 0.0).max(axis=1)
    return _widen(needed, max(1, round(_SMOOTH * frame_rate)))


def _widen(values: FloatArray, around: int) -> FloatArray:
    """A smooth curve (T,) nowhere below the values: the maximum around each, averaged over as far."""
    around = min(around, len(values))
    padded = np.pad(values, 2 * around, mode="edge")
    highest = np.lib.stride_tricks.sliding_window_view(padded, 2 * around + 1).max(axis=1)
    weights = np.hanning(2 * around + 3)[1:-1]
    return np.convolve(highest, weights / weights.sum(), mode="valid")
