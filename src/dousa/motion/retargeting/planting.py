"""Feet that stay where they stand, hands that reach what they reached: two bones that are bent to a place."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from dousa.arrays import BoolArray, FloatArray
from dousa.motion.retargeting.contacts import list_stretches
from dousa.motion.rotations import between, rotate

_REACH = 0.9999  # of the length of a limb: beyond, the knee would leap
_BIAS = 0.02  # of the upper bone
_SMOOTH = 0.08  # s, over which the pelvis gives way


def plan_corrections(points: FloatArray, contacts: BoolArray, height: float) -> FloatArray:
    """How far (T, 3) a foot must be moved so that it stands still where it stands.

    Parameters
    ----------
    points : (T, 3) m, where its toe is.
    contacts : (T,) when it stands.
    height : m, at which the toe is when the foot is on the floor.

    Returns
    -------
    During a contact what brings the toe to its mean place and to the height; between contacts a smooth way from one to
    the other; before the first and after the last it is held.
    """
    stretches = list_stretches(contacts)
    corrections = np.zeros_like(points)
    if not stretches:
        return corrections
    for start, end in stretches:
        place = points[start:end].mean(axis=0)
        place[1] = height
        corrections[start:end] = place - points[start:end]
    first, last = stretches[0][0], stretches[-1][1]
    corrections[:first] = corrections[first]
    corrections[last:] = corrections[last - 1]
    for (_, end), (start, _) in pairwise(stretches):
        share = (np.arange(end, start) - end + 1)[:, None] / (start - end + 1)
        share = share * share * (3 - 2 * share)
        corrections[end:start] = (1 - share) * corrections[end - 1] + share * corrections[start]
    return corrections


def bend(
    root: FloatArray, middle: FloatArray, end: FloatArray, wanted: FloatArray, outward: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Turns (T, 4) in the world of the upper and of the lower bone that bring the end of a limb to a place.

    The plane of the limb turns as little as it can; the lengths are kept, so that a place out of reach is approached.

    Parameters
    ----------
    root, middle, end : (T, 3) m, joints of the limb, such as hip, knee and ankle.
    wanted : (T, 3) m, where the end shall be.
    outward : (T, 3) of any length, where the middle joint points to if the limb is straight: knees to the front.
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
    """How far down (T,) m the pelvis must go so that all feet are within reach, smooth over time.

    Parameters
    ----------
    hips, wanted : (T, 2, 3) m, hip joints, and where the ankles shall be.
    lengths : (2,) m of the legs.
    """
    gap = hips - wanted
    beside = np.square(gap[..., 0]) + np.square(gap[..., 2])
    highest = np.sqrt(np.maximum(np.square(_REACH * lengths) - beside, 0.0))
    needed = np.maximum(gap[..., 1] - highest, 0.0).max(axis=1)
    return _widen(needed, max(1, round(_SMOOTH * frame_rate)))


def _widen(values: FloatArray, around: int) -> FloatArray:
    """A smooth curve (T,) nowhere below the values: the maximum around each, averaged over as far."""
    around = min(around, len(values))
    padded = np.pad(values, 2 * around, mode="edge")
    highest = np.lib.stride_tricks.sliding_window_view(padded, 2 * around + 1).max(axis=1)
    weights = np.hanning(2 * around + 3)[1:-1]
    return np.convolve(highest, weights / weights.sum(), mode="valid")
