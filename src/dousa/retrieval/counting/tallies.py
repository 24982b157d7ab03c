"""Tallies: numbers that grow with every repetition of an action, however long each takes.

Some count something at once: how often the strongest movement goes out and comes back, how often the body speeds up,
how often the period fits in at which the velocities resemble themselves. Others only add up: the duration, the way
moved. Each is wrong now and then, on its own occasions; `counter` learns whom to believe.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dousa.arrays import BoolArray, FloatArray
from dousa.motion.canonical.joints import JOINT_INDEX
from dousa.retrieval.counting import tally_kernels as kernels
from dousa.retrieval.features.channel_kernels import smooth
from dousa.retrieval.features.pose_features import HIPS, SHOULDERS

RATE = 30.0
"""Frames a second of what is counted."""

COUNTED = (
    *("out", "back", "out_small", "back_small", "second_out", "crossings"),
    *("turns", "small_turns", "quick_out", "quick_crossings"),
    *("bursts", "bouts", "away", "away_crossings", "periods"),
)
"""Tallies that are counts themselves."""

AMOUNTS = ("duration", "way", "moving")
"""Tallies that only add up: s, body heights, s."""

TALLIES = (*COUNTED, *AMOUNTS)

_JOINTS = "head left_elbow left_hand right_elbow right_hand left_knee left_ankle right_knee right_ankle".split()
_INDEX = np.array([JOINT_INDEX[joint] for joint in _JOINTS])
_SMOOTHING = 3.0  # frames, standard deviation: a sensor's noise is quicker than people
_WEIGHTS = np.exp(-0.5 * (np.arange(int(4.0 * _SMOOTHING + 0.5) + 1) / _SMOOTHING) ** 2)
_WEIGHTS /= 2.0 * _WEIGHTS.sum() - _WEIGHTS[0]
_LARGE, _SMALL = 0.5, 0.3  # shares of the range (5 to 95 %) that a movement out and back has at least
_TURN, _SMALL_TURN, _BURST = 0.6, 0.3, 0.35  # likewise of the speed along one direction, of the body's speed (95 %)
_MOVING = 0.15  # share of the speed (90 %) below which the body rests
_BOUT_GAP = 9  # frames of rest between two bouts of movement
_SHORT = 256  # frames of which products are summed one by one; of more they come from their spectrum
_CALM = 120  # of the calm poses, so many are looked at, and at least half as many
_SHORTEST = 9  # frames of a period
_LONGEST = 0.62  # share of the moving part that a period may last
_ALIKE, _NEARLY = 0.3, 0.8  # correlation of a period at least; share of the highest that a shorter period needs


def measure_tallies(sampled: FloatArray, height: float) -> FloatArray:
    """What each tally of a part of a recording comes to.

    Parameters
    ----------
    sampled : (n, 20, 3) m, canonical joints at ``RATE``.
    height : m.

    Returns
    -------
    (18,) in the order of ``TALLIES``; 0 where nothing moves.
    """
    from dousa.retrieval.features.partial_bodies import FRAME_JOINTS, complete_positions

    points = complete_positions(sampled, height, (), {*_JOINTS, *FRAME_JOINTS})
    n = len(points)
    if n < 2:
        return np.zeros(len(TALLIES))
    (poses, velocities), speeds = np.empty((2, n, 3 * len(_JOINTS))), np.empty(n)
    kernels.describe(
        np.ascontiguousarray(points), float(height), _WEIGHTS, HIPS, SHOULDERS, _INDEX, np.empty(points.shape),
        np.empty((n, 2)), poses, velocities, speeds,
    )  # fmt: skip
    ordered = np.sort(speeds)
    if ordered[-1] <= 1e-9:
        return np.zeros(len(TALLIES))
    curves = _draw_curves(poses, velocities, speeds, kernels.read_quantile(ordered, 0.2))
    moving = _MOVING * kernels.read_quantile(ordered, 0.9)
    fast = speeds > moving
    counts = (
        *_count_along_axes(curves),
        *_count_quick(curves),
        kernels.count_swings(curves.smooth, 1.0, _least(_BURST * kernels.read_quantile(ordered, 0.95)))[0],
        kernels.count_bouts(speeds, moving, _BOUT_GAP),
        *_count_away(curves),
        _count_periods(velocities, fast),
    )
    return np.array([*counts, n / RATE, speeds.sum(), fast.sum() / RATE], np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class _Curves:
    """What swings while an action is repeated, each (n,).

    Parameters
    ----------
    first, second : along the two directions of most movement.
    along : speed along the direction of quickest movement.
    level : along this direction, without what drifts slowly, or fades.
    away : from the pose at rest.
    smooth : speed of the body.
    """

    first: FloatArray
    second: FloatArray
    along: FloatArray
    level: FloatArray
    away: FloatArray
    smooth: FloatArray


def _draw_curves(poses: FloatArray, velocities: FloatArray, speeds: FloatArray, calm: float) -> _Curves:
    spread = poses - poses.mean(axis=0)
    axes = np.linalg.eigh(np.stack([spread.T @ spread, velocities.T @ velocities]))[1]
    first, second = np.ascontiguousarray((spread @ axes[0][:, :-3:-1]).T)
    quickest = axes[1][:, -1]
    level, away, even = poses @ quickest, np.empty(len(poses)), np.empty(len(poses))
    kernels.level(level)
    kernels.find_distances(poses, speeds, calm, np.empty(_CALM, np.int64), np.empty(_CALM), away)
    smooth(speeds[:, None], _WEIGHTS, even[:, None])
    return _Curves(first, second, velocities @ quickest, level, away, even)


def _least(size: float) -> float:
    return max(size, 1e-9)


def _count_along_axes(curves: _Curves) -> tuple[float, ...]:
    """Movements out and back along the two directions of most movement, and half of the crossings of the middle."""
    low, high, sign = kernels.find_range(np.sort(curves.first), True)
    other_low, other_high, other_sign = kernels.find_range(np.sort(curves.second), True)
    return (
        *kernels.count_swings(curves.first, sign, _least(_LARGE * (high - low))),
        *kernels.count_swings(curves.first, sign, _least(_SMALL * (high - low))),
        kernels.count_swings(curves.second, other_sign, _least(_LARGE * (other_high - other_low)))[0],
        kernels.count_crossings(curves.first, sign, 0.5 * (low + high)),
    )


def _count_quick(curves: _Curves) -> tuple[float, ...]:
    """Along the direction of quickest movement: how often it is taken, there and back, half each; and out and back."""
    speed = kernels.read_quantile(np.sort(np.abs(curves.along)), 0.95)
    low, high, sign = kernels.find_range(np.sort(curves.level), True)
    return (
        0.5 * sum(kernels.count_swings(curves.along, 1.0, _least(_TURN * speed))),
        0.5 * sum(kernels.count_swings(curves.along, 1.0, _least(_SMALL_TURN * speed))),
        kernels.count_swings(curves.level, sign, _least(_SMALL * (high - low)))[0],
        kernels.count_crossings(curves.level, sign, 0.5 * (low + high)),
    )


def _count_away(curves: _Curves) -> tuple[float, float]:
    """Movements away from the pose at rest and back, by their tops and by half of the crossings of the middle."""
    low, high, _ = kernels.find_range(np.sort(curves.away), False)
    tops = kernels.count_swings(curves.away, 1.0, _least(_LARGE * (high - low)))[0]
    return tops, kernels.count_crossings(curves.away, 1.0, 0.5 * (low + high))


def _count_periods(velocities: FloatArray, moving: BoolArray) -> float:
    """How often the period fits into the moving part; 1 where there is none."""
    places = np.flatnonzero(moving)
    part = velocities[places[0] : places[-1] + 1]
    likeness = correlate(part)
    peaks = 1 + np.flatnonzero((likeness[1:-1] >= likeness[:-2]) & (likeness[1:-1] > likeness[2:]))
    peaks = peaks[peaks >= _SHORTEST]
    if not len(peaks) or likeness[peaks].max() < _ALIKE:
        return 1.0
    period = peaks[likeness[peaks] >= _NEARLY * likeness[peaks].max()][0]
    return len(part) / float(period)


def correlate(velocities: FloatArray) -> FloatArray:
    """(L,) how much velocities (n, K) resemble themselves 0, 1, 2 ... frames later, -1 to 1; L a share of n."""
    n = len(velocities)
    most = max(round(_LONGEST * n), 1)
    if n <= _SHORT:
        products = np.zeros(most)
        kernels.correlate(np.ascontiguousarray(velocities.T), products)
    else:
        size = 1 << (n + most - 1).bit_length()
        spectrum = np.fft.rfft(velocities.T, size)
        products = np.fft.irfft((spectrum * spectrum.conj()).real.sum(axis=0), size)[:most]
    energy = np.concatenate([[0.0], np.cumsum((velocities**2).sum(axis=1))])
    lags = np.arange(most)
    before, after = energy[n - lags], energy[n] - energy[lags]
    likeness: FloatArray = products / np.maximum(np.sqrt(before * after), 1e-12)
    return likeness


def count_swings(curve: FloatArray, least: float) -> tuple[int, int]:
    """How many tops, and how many bottoms, a curve (n,) has that differ by so much from those before and after.

    The ends count: a curve that only rises has a bottom and a top.
    """
    tops, bottoms = kernels.count_swings(np.ascontiguousarray(curve, np.float64), 1.0, _least(least))
    return int(tops), int(bottoms)
