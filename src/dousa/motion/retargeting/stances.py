"""Stances of a point of the foot: stretches in which it is low and slow, and how it moves in them.

The rule is generous on purpose: rolling over heel or toe at the ends of a stance is kept.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dousa.arrays import BoolArray, FloatArray
from dousa.motion.retargeting.contacts import SLOWEST_RATE, drop_short, measure_lowest, measure_speed
from dousa.motion.runs import find_runs

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
