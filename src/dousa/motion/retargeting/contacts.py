"""Foot contacts: a foot stands when it is low and slow."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dousa.arrays import BoolArray, FloatArray
from dousa.motion.canonical.canonicalise import CanonicalMotion
from dousa.motion.canonical.joints import JOINT_INDEX as J
from dousa.motion.runs import find_runs

_SLOW = 0.25  # m/s, for a body of _HEIGHT
_LOW = 0.05  # m above the lowest of the second around
_HEIGHT = 1.6  # m over the joints
_AROUND, _SHORTEST, _GAP = 1.0, 0.1, 0.06  # s
SLOWEST_RATE = 8.0  # Hz


def find_contacts(motion: CanonicalMotion, joint: str = "toe") -> BoolArray:
    """Find when the left and the right foot stand on the floor, (T, 2), from one joint of each.

    A foot stands where that joint is at most 5 cm above its lowest point of a second before and after, and slower than
    0.25 m/s (both for a body of 1.6 m over the joints, in proportion for others), for at least 0.1 s. None stands below
    8 Hz, where two frames give no speed.

    Parameters
    ----------
    motion : canonical motion in m.
    joint : ``"toe"`` or ``"ankle"``.
    """
    size = body_size(motion)
    rate = motion.frame_rate
    contacts = np.zeros((motion.n_frames, 2), bool)
    if rate < SLOWEST_RATE:
        return contacts
    for column, side in enumerate(("left", "right")):
        points = motion.positions[:, J[f"{side}_{joint}"]]
        height = points[:, 1] - measure_lowest(points[:, 1], max(1, round(_AROUND * rate)))
        standing = (height < _LOW * size) & (measure_speed(points, rate) < _SLOW * size)
        standing = drop_short(standing, False, max(1, round(_GAP * rate)))
        contacts[:, column] = drop_short(standing, True, max(2, round(_SHORTEST * rate)))
    return contacts


def body_size(motion: CanonicalMotion) -> float:
    """Return the height over the joints, in bodies of 1.6 m."""
    return float(np.clip(motion.height / _HEIGHT, 0.2, 5.0))


def measure_lowest(values: FloatArray, around: int) -> FloatArray:
    """Compute the minimum (T,) of the values so many frames before and after."""
    around = min(around, len(values))
    padded = np.concatenate((np.full(around, np.inf), values, np.full(around, np.inf)))
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * around + 1)
    lowest: FloatArray = windows.min(axis=1)
    return lowest


def measure_speed(points: FloatArray, rate: float) -> FloatArray:
    """Compute the speed (T,) m/s over two frames."""
    if len(points) < 2:
        return np.zeros(len(points))
    speed: FloatArray = np.linalg.norm(np.gradient(points, axis=0), axis=1) * rate
    return speed


def drop_short(states: BoolArray, which: bool, shortest: int) -> BoolArray:
    """Flip stretches of one kind that are shorter than so many frames."""
    result = states.copy()
    for start, end in find_runs(states == which):
        if end - start < shortest and (which or (start > 0 and end < len(states))):
            result[start:end] = not which
    return result


_LOW, _SLOW = 0.14, 1.2  # m above the lowest of the second around, m/s
_AROUND, _SHORTEST = 1.0, 0.04  # s
_HELD, _FREE = 0.2, 0.5  # m/s: slower it is held, faster it is free
_NEAR, _FAR = 0.035, 0.08  # m from where it stands: however slow, it has moved on
_WEIGHT = 0.08  # m/s: slower frames determine where it stands
_EASE = 0.03  # s


@dataclass(frozen=True, slots=True, eq=False)
class Stances:
    """How one point of a foot stands.

    Parameters
    ----------
    near : (T,) where it is low and slow.
    steps : (T - 1, 3) m from frame to frame; 0 where it stands.
    speed : (T,) m/s of the point.
    held : (T,) 1 where it stands, 0 where it moves freely.
    """

    near: BoolArray
    steps: FloatArray
    speed: FloatArray
    held: FloatArray


def find_stances(points: FloatArray, frame_rate: float, size: float) -> Stances:
    """Find stretches in which a point stands, and its path without negligible moves.

    Parameters
    ----------
    points : (T, 3) m.
    frame_rate : Hz; below 8 Hz nothing stands, since two frames give no speed.
    size : of the body, in bodies of 1.6 m over the joints.
    """
    speed = measure_speed(points, frame_rate)
    steps = np.diff(points, axis=0)
    near = np.zeros(len(points), bool)
    if frame_rate < SLOWEST_RATE:
        return Stances(near, steps, speed, np.zeros(len(points)))
    height = points[:, 1] - measure_lowest(points[:, 1], max(1, round(_AROUND * frame_rate)))
    near = (height < _LOW * size) & (speed < _SLOW * size)
    near = drop_short(near, True, max(2, round(_SHORTEST * frame_rate)))
    free = ramp(speed / size, _HELD, _FREE)
    for start, end in find_runs(near).tolist():
        weights = 1.0 / (1.0 + np.square(speed[start:end] / (size * _WEIGHT))) ** 2
        away = points[start:end] - np.average(points[start:end], axis=0, weights=weights)
        free[start:end] = np.maximum(free[start:end], ramp(np.linalg.norm(away, axis=1) / size, _NEAR, _FAR))
    free = smooth(free, max(1, round(_EASE * frame_rate)))
    return Stances(near, 0.5 * (free[1:] + free[:-1])[:, None] * steps, speed, (1 - free) * near)


def ramp(values: FloatArray, low: float, high: float) -> FloatArray:
    """Return a smooth step from 0 at ``low`` to 1 at ``high``."""
    share = np.clip((values - low) / (high - low), 0.0, 1.0)
    way: FloatArray = share * share * (3 - 2 * share)
    return way


def smooth(values: FloatArray, around: int) -> FloatArray:
    """Compute the mean (T,) of so many frames before and after, the nearest most."""
    window = np.hanning(2 * around + 3)[1:-1]
    return np.convolve(np.pad(values, around, mode="edge"), window / window.sum(), mode="valid")
