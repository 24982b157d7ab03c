"""Tallies: numbers that grow with every repetition of an action, however long each takes.

Some count something at once: how often the strongest movement goes out and comes back, how often the body speeds up,
how often the period fits in at which the velocities resemble themselves. Others only add up: the duration, the way
moved. Each is wrong now and then, on its own occasions; `counter` learns whom to believe.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from dousa.arrays import BoolArray, FloatArray
from dousa.motion.canonical.joints import JOINT_INDEX
from dousa.retrieval.features.channel_kernels import smooth

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
_INDEX = [JOINT_INDEX[joint] for joint in _JOINTS]
_SMOOTHING = 3.0  # frames, standard deviation: a sensor's noise is quicker than people
_WEIGHTS = np.exp(-0.5 * (np.arange(int(4.0 * _SMOOTHING + 0.5) + 1) / _SMOOTHING) ** 2)
_WEIGHTS /= 2.0 * _WEIGHTS.sum() - _WEIGHTS[0]
_LARGE, _SMALL = 0.5, 0.3  # shares of the range (5 to 95 %) that a movement out and back has at least
_TURN, _SMALL_TURN, _BURST = 0.6, 0.3, 0.35  # likewise of the speed along one direction, of the body's speed (95 %)
_MOVING = 0.15  # share of the speed (90 %) below which the body rests
_BOUT_GAP = 9  # frames of rest between two bouts of movement
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
    from dousa.retrieval.features.pose_features import turn_to_body

    points = complete_positions(sampled, height, (), {*_JOINTS, *FRAME_JOINTS})
    if len(points) < 2:
        return np.zeros(len(TALLIES))
    points = _smooth(points)
    poses = turn_to_body((points - points[:, :1]) / height)[:, _INDEX].reshape(len(points), -1)
    velocities: FloatArray = np.asarray(np.gradient(poses, axis=0))
    speeds = np.sqrt((velocities**2).sum(axis=1))
    ordered = np.sort(speeds)
    if ordered[-1] <= 1e-9:
        return np.zeros(len(TALLIES))
    moving = speeds > _MOVING * read_quantile(ordered, 0.9)
    counts = (
        *_count_along_axes(poses),
        *_count_quick(poses, velocities),
        count_swings(_smooth(speeds), _BURST * read_quantile(ordered, 0.95))[0],
        _count_bouts(moving),
        *_count_away(poses, speeds, read_quantile(ordered, 0.2)),
        _count_periods(velocities, moving),
    )
    return np.array([*counts, len(points) / RATE, speeds.sum(), moving.sum() / RATE], np.float64)


def _smooth(values: FloatArray) -> FloatArray:
    """Values (n, ...) over time under a Gaussian; the ends are held."""
    even = np.empty(values.shape)
    smooth(values.reshape(len(values), -1), _WEIGHTS, even.reshape(len(values), -1))
    return even


def read_quantile(ordered: FloatArray, share: float) -> float:
    """A quantile of values (n,) that are sorted, linear between two of them, as ``np.quantile`` has it."""
    place = (len(ordered) - 1) * share
    below = int(place)
    low, high, part = float(ordered[below]), float(ordered[min(below + 1, len(ordered) - 1)]), place - below
    return low + (high - low) * part if part < 0.5 else high - (high - low) * (1.0 - part)


@dataclass(frozen=True, slots=True, eq=False)
class _Curve:
    """A curve (n,) and where it ranges: the quantiles of 5 and of 95 %."""

    values: FloatArray
    low: float
    high: float

    @classmethod
    def of(cls, values: FloatArray) -> _Curve:
        ordered = np.sort(values)
        return cls(values, read_quantile(ordered, 0.05), read_quantile(ordered, 0.95))

    @classmethod
    def turned_out(cls, values: FloatArray) -> _Curve:
        """A curve or its negative, such that most of the time is spent low: repetitions leave a rest."""
        ordered = np.sort(values)
        if read_quantile(ordered, 0.5) > 0.5 * (ordered[0] + ordered[-1]):
            values, ordered = -values, -ordered[::-1]
        return cls(values, read_quantile(ordered, 0.05), read_quantile(ordered, 0.95))

    def count_swings(self, share: float) -> tuple[int, int]:
        """Tops and bottoms that differ by a share of the range."""
        return count_swings(self.values, share * (self.high - self.low))

    def count_crossings(self) -> float:
        """Half of how often it crosses the middle of its range."""
        above = self.values > 0.5 * (self.low + self.high)
        return 0.5 * np.count_nonzero(above[1:] != above[:-1])


def _count_along_axes(poses: FloatArray) -> tuple[float, ...]:
    """Movements out and back along the two directions of most movement, and half of the crossings of the middle."""
    spread = poses - poses.mean(axis=0)
    axes = np.linalg.eigh(spread.T @ spread)[1][:, :-3:-1]
    first, second = (_Curve.turned_out(curve) for curve in (spread @ axes).T)
    return (
        *first.count_swings(_LARGE),
        *first.count_swings(_SMALL),
        second.count_swings(_LARGE)[0],
        first.count_crossings(),
    )


def _count_quick(poses: FloatArray, velocities: FloatArray) -> tuple[float, ...]:
    """Along the direction of quickest movement: how often it is taken, there and back, half each; and out and back.

    What drifts slowly, or fades, is quick all the same.
    """
    axis = np.linalg.eigh(velocities.T @ velocities)[1][:, -1]
    along = velocities @ axis
    speed = read_quantile(np.sort(np.abs(along)), 0.95)
    curve = poses @ axis
    times = np.arange(len(curve)) - 0.5 * (len(curve) - 1)
    drift = (times @ curve) / (times @ times)  # of the line of least squares
    level = _Curve.turned_out(curve - curve.mean() - drift * times)
    return (
        0.5 * sum(count_swings(along, _TURN * speed)),
        0.5 * sum(count_swings(along, _SMALL_TURN * speed)),
        level.count_swings(_SMALL)[0],
        level.count_crossings(),
    )


def _count_bouts(moving: BoolArray) -> int:
    """Bouts of movement with rests between them."""
    places = np.flatnonzero(moving)
    return 1 + int(np.count_nonzero(np.diff(places) > _BOUT_GAP))


def _count_away(poses: FloatArray, speeds: FloatArray, calm: float) -> tuple[float, float]:
    """Movements away from the pose at rest and back, by their tops and by half of the crossings of the middle."""
    slow = poses[speeds <= calm]
    # Of the calm poses the one that most others are like.
    some = slow[:: max(len(slow) // 60, 1)]
    near = ((some[:, None] - some[None]) ** 2).sum(axis=2)
    rest = some[int(np.median(near, axis=1).argmin())]
    away = _Curve.of(np.sqrt(((poses - rest) ** 2).sum(axis=1)))
    return away.count_swings(_LARGE)[0], away.count_crossings()


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
    size = 1 << (2 * n - 1).bit_length()
    spectrum = np.fft.rfft(velocities, size, axis=0)
    products = np.fft.irfft((spectrum * spectrum.conj()).real.sum(axis=1), size)[:most]
    energy = np.concatenate([[0.0], np.cumsum((velocities**2).sum(axis=1))])
    lags = np.arange(most)
    before, after = energy[n - lags], energy[n] - energy[lags]
    likeness: FloatArray = products / np.maximum(np.sqrt(before * after), 1e-12)
    return likeness


def count_swings(curve: FloatArray, least: float) -> tuple[int, int]:
    """How many tops, and how many bottoms, a curve (n,) has that differ by so much from those before and after.

    The ends count: a curve that only rises has a bottom and a top.
    """
    tops, bottoms = _count_swings(np.ascontiguousarray(curve, np.float64), max(least, 1e-9))
    return int(tops), int(bottoms)


@njit(cache=True, nogil=True)
def _count_swings(curve, least):  # type: ignore[no-untyped-def]  # pragma: no cover - compiled
    tops = bottoms = rising = 0
    high = low = curve[0]
    for value in curve:
        high, low = max(high, value), min(low, value)
        if rising >= 0 and value <= high - least:
            tops, rising, low = tops + 1, -1, value
        elif rising <= 0 and value >= low + least:
            bottoms, rising, high = bottoms + 1, 1, value
    return tops + (rising > 0), bottoms + (rising < 0)
