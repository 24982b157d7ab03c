"""Foot contacts: a foot stands when it is low and slow."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dousa.arrays import BoolArray, FloatArray
from dousa.motion.canonical.canonicalise import CanonicalMotion
from dousa.motion.canonical.joints import JOINT_INDEX as J
from dousa.motion.runs import find_runs


def find_contacts(
    motion: CanonicalMotion,
    joint: str = "toe",
    *,
    low: float = 0.05,
    slow: float = 0.25,
    around: float = 1.0,
    shortest: float = 0.1,
    gap: float = 0.06,
    slowest_rate: float = 8.0,
) -> BoolArray:
    """Find when the left and the right foot stand on the floor, (T, 2), from one joint of each.

    A foot stands where that joint is near its lowest point of the time around, and slow.

    Parameters
    ----------
    motion : canonical motion in m.
    joint : ``"toe"`` or ``"ankle"``.
    low, slow : m and m/s, for a body of 1.6 m over the joints, in proportion for others.
    around : s before and after.
    shortest, gap : s of a contact, and between two that are one.
    slowest_rate : Hz, below which two frames give no speed and no foot stands.
    """
    size = body_size(motion)
    rate = motion.frame_rate
    contacts = np.zeros((motion.n_frames, 2), bool)
    if rate < slowest_rate:
        return contacts
    for column, side in enumerate(("left", "right")):
        points = motion.positions[:, J[f"{side}_{joint}"]]
        height = points[:, 1] - measure_lowest(points[:, 1], max(1, round(around * rate)))
        standing = (height < low * size) & (measure_speed(points, rate) < slow * size)
        standing = drop_short(standing, False, max(1, round(gap * rate)))
        contacts[:, column] = drop_short(standing, True, max(2, round(shortest * rate)))
    return contacts


def body_size(motion: CanonicalMotion) -> float:
    """Return the height over the joints, in bodies of 1.6 m."""
    return float(np.clip(motion.height / 1.6, 0.2, 5.0))


def measure_lowest(values: FloatArray, around: int) -> FloatArray:
    """Compute the minimum (T,) of the values so many frames before and after."""
    around = min(around, len(values))
    padded = np.pad(values, around, constant_values=np.inf)
    lowest: FloatArray = np.lib.stride_tricks.sliding_window_view(padded, 2 * around + 1).min(axis=1)
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


def find_stances(
    points: FloatArray,
    frame_rate: float,
    size: float,
    *,
    low: float = 0.14,
    slow: float = 1.2,
    around: float = 1.0,
    shortest: float = 0.04,
    held: tuple[float, float] = (0.2, 0.5),
    near: tuple[float, float] = (0.035, 0.08),
    places: float = 0.08,
    ease: float = 0.03,
    slowest_rate: float = 8.0,
) -> Stances:
    """Find stretches in which a point stands, and its path without negligible moves.

    The rule is generous on purpose: rolling over heel or toe at the ends of a stance is kept.

    Parameters
    ----------
    points : (T, 3) m.
    frame_rate : Hz; below ``slowest_rate`` nothing stands, since two frames give no speed.
    size : of the body, in bodies of 1.6 m over the joints; distances and speeds are for such a body.
    low, slow : m above the lowest of the time around, and m/s.
    around, shortest : s before and after, and of a stance.
    held : m/s; slower it is held, faster it is free.
    near : m from where it stands; farther it has moved on, however slow.
    places : m/s; slower frames determine where it stands.
    ease : s, over which it becomes free.
    """
    speed = measure_speed(points, frame_rate)
    steps = np.diff(points, axis=0)
    stands = np.zeros(len(points), bool)
    if frame_rate < slowest_rate:
        return Stances(stands, steps, speed, np.zeros(len(points)))
    height = points[:, 1] - measure_lowest(points[:, 1], max(1, round(around * frame_rate)))
    stands = (height < low * size) & (speed < slow * size)
    stands = drop_short(stands, True, max(2, round(shortest * frame_rate)))
    free = ramp(speed / size, *held)
    for start, end in find_runs(stands).tolist():
        weights = 1.0 / (1.0 + np.square(speed[start:end] / (size * places))) ** 2
        away = points[start:end] - np.average(points[start:end], axis=0, weights=weights)
        free[start:end] = np.maximum(free[start:end], ramp(np.linalg.norm(away, axis=1) / size, *near))
    free = smooth(free, max(1, round(ease * frame_rate)))
    return Stances(stands, 0.5 * (free[1:] + free[:-1])[:, None] * steps, speed, (1 - free) * stands)


def ramp(values: FloatArray, low: float, high: float) -> FloatArray:
    """Return a smooth step from 0 at ``low`` to 1 at ``high``."""
    share = np.clip((values - low) / (high - low), 0.0, 1.0)
    way: FloatArray = share * share * (3 - 2 * share)
    return way


def smooth(values: FloatArray, around: int) -> FloatArray:
    """Compute the mean (T,) of so many frames before and after, the nearest most."""
    window = np.hanning(2 * around + 3)[1:-1]
    return np.convolve(np.pad(values, around, mode="edge"), window / window.sum(), mode="valid")
