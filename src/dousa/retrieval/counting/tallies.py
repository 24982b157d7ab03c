"""Tallies: numbers that grow with every repetition of an action, however long each takes.

Some count something at once: how often the strongest movement goes out and comes back, how often the body speeds up,
how often the period fits in at which the velocities resemble themselves. Some do so again where less was smoothed away
(what is as quick as clapping goes with the noise), and of what both sides have in common: kicks with the left and the
right foot in turn are single kicks there, not halves of pairs. Others only add up: the duration, the way moved. Each is
wrong now and then, on its own occasions; `counter` learns whom to believe.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dousa.arrays import FloatArray
from dousa.motion.canonical.joints import CANONICAL_JOINTS, JOINT_INDEX, MIRRORED_JOINTS
from dousa.retrieval.counting import tally_kernels as kernels
from dousa.retrieval.features.channel_kernels import smooth
from dousa.retrieval.features.pose_features import HIPS, SHOULDERS

RATE = 30.0
"""Frames a second of what is counted."""

COUNTED = (
    *("out", "back", "out_small", "back_small", "second_out", "crossings"),
    *("turns", "small_turns", "quick_out", "quick_crossings"),
    *("bursts", "bouts", "away", "away_crossings", "periods"),
    *("light_crossings", "light_turns", "light_quick_crossings", "light_bursts", "light_periods"),
    *("even_out", "even_crossings", "even_turns", "even_quick_crossings", "even_periods"),
)
"""Tallies that are counts themselves."""

AMOUNTS = ("duration", "way", "moving")
"""Tallies that only add up: s, body heights, s."""

TALLIES = (*COUNTED, *AMOUNTS)

_JOINTS = "head left_elbow left_hand right_elbow right_hand left_knee left_ankle right_knee right_ankle".split()
_INDEX = np.array([JOINT_INDEX[joint] for joint in _JOINTS])
_OTHERS = np.array([_JOINTS.index(CANONICAL_JOINTS[MIRRORED_JOINTS[joint]]) for joint in _INDEX])
_SMOOTHING = 3.0  # frames, standard deviation: a sensor's noise is quicker than people
_LIGHT = 1.5  # frames: hands that clap or wave are as quick as noise
_LEAST_EVEN = 1e-3  # share of the greatest speed: what both sides do alike


def _list_weights(deviation: float) -> FloatArray:
    weights: FloatArray = np.exp(-0.5 * (np.arange(int(4.0 * deviation + 0.5) + 1) / deviation) ** 2)
    weights /= 2.0 * weights.sum() - weights[0]
    return weights


_WEIGHTS, _LIGHT_WEIGHTS = _list_weights(_SMOOTHING), _list_weights(_LIGHT)
_LARGE, _SMALL = 0.5, 0.3  # shares of the range (5 to 95 %) that a movement out and back has at least
_TURN, _SMALL_TURN, _BURST = 0.6, 0.3, 0.35  # likewise of the speed along one direction, of the body's speed (95 %)
_MOVING = 0.15  # share of the speed (90 %) below which the body rests
_BOUT_GAP = 9  # frames of rest between two bouts of movement
_STILL = 1e-9  # body heights a frame: nothing moves
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
    (28,) in the order of ``TALLIES``; 0 where nothing moves.
    """
    from dousa.retrieval.features.partial_bodies import FRAME_JOINTS, complete_positions

    points = complete_positions(sampled, height, (), {*_JOINTS, *FRAME_JOINTS})
    if len(points) < 2:
        return np.zeros(len(TALLIES))
    points = np.ascontiguousarray(points)
    course = _describe(points, height, _WEIGHTS)
    if course.ordered[-1] <= _STILL:
        return np.zeros(len(TALLIES))
    light, even = _describe(points, height, _LIGHT_WEIGHTS), _fold(course)
    axes = _find_axes(course, even)
    curves = _draw_curves(course, axes[0], _WEIGHTS)
    counts = (
        *_count_along_axes(curves),
        *_count_quick(curves),
        _count_bursts(course, curves),
        kernels.count_bouts(course.speeds, course.moving, _BOUT_GAP),
        *_count_away(course),
        _count_periods(course),
        *_count_light(light, axes[0]),
        *_count_even(even, axes[1], course.ordered[-1]),
    )
    amounts = len(points) / RATE, course.speeds.sum(), (course.speeds > course.moving).sum() / RATE
    return np.array([*counts, *amounts], np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class _Course:
    """What moves: body heights, and body heights a frame.

    Parameters
    ----------
    poses, velocities : (n, K).
    speeds : (n,).
    ordered : (n,) speeds in their order.
    moving : speed below which the body rests.
    """

    poses: FloatArray
    velocities: FloatArray
    speeds: FloatArray
    ordered: FloatArray
    moving: float


def _describe(points: FloatArray, height: float, weights: FloatArray) -> _Course:
    n = len(points)
    (poses, velocities), speeds = np.empty((2, n, 3 * len(_JOINTS))), np.empty(n)
    kernels.describe(
        points, float(height), weights, HIPS, SHOULDERS, _INDEX, np.empty(points.shape), np.empty((n, 2)),
        poses, velocities, speeds,
    )  # fmt: skip
    return _follow(poses, velocities, speeds)


def _follow(poses: FloatArray, velocities: FloatArray, speeds: FloatArray) -> _Course:
    ordered = np.sort(speeds)
    return _Course(poses, velocities, speeds, ordered, _MOVING * kernels.read_quantile(ordered, 0.9))


@dataclass(frozen=True, slots=True, eq=False)
class _Curves:
    """What swings while an action is repeated, each (n,).

    Parameters
    ----------
    first, second : along the two directions of most movement.
    along : speed along the direction of quickest movement.
    level : along this direction, without what drifts slowly, or fades.
    smooth : speed of the body.
    """

    first: FloatArray
    second: FloatArray
    along: FloatArray
    level: FloatArray
    smooth: FloatArray


def _find_axes(*courses: _Course) -> FloatArray:
    """(C, 2, K, K) the directions of movement, and of quick movement, of some courses: columns, the last is the first.

    All at once: most of the time goes into asking.
    """
    spreads = [course.poses - course.poses.mean(axis=0) for course in courses]
    squares = [
        [spread.T @ spread, one.velocities.T @ one.velocities] for spread, one in zip(spreads, courses, strict=True)
    ]
    axes: FloatArray = np.linalg.eigh(np.array(squares))[1]
    return axes


def _draw_curves(course: _Course, axes: FloatArray, weights: FloatArray) -> _Curves:
    quickest = axes[1][:, -1]
    first, second = np.ascontiguousarray(((course.poses - course.poses.mean(axis=0)) @ axes[0][:, :-3:-1]).T)
    level, even = course.poses @ quickest, np.empty(len(course.poses))
    kernels.level(level)
    smooth(course.speeds[:, None], weights, even[:, None])
    return _Curves(first, second, course.velocities @ quickest, level, even)


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
        _count_middles(curves),
    )


def _count_middles(curves: _Curves) -> float:
    """Half of the crossings of the middle along the direction of most movement."""
    low, high, sign = kernels.find_range(np.sort(curves.first), True)
    return float(kernels.count_crossings(curves.first, sign, 0.5 * (low + high)))


def _count_quick(curves: _Curves) -> tuple[float, float, float, float]:
    """Along the direction of quickest movement: how often it is taken, there and back, half each; and out and back."""
    speed = kernels.read_quantile(np.sort(np.abs(curves.along)), 0.95)
    low, high, sign = kernels.find_range(np.sort(curves.level), True)
    return (
        0.5 * sum(kernels.count_swings(curves.along, 1.0, _least(_TURN * speed))),
        0.5 * sum(kernels.count_swings(curves.along, 1.0, _least(_SMALL_TURN * speed))),
        kernels.count_swings(curves.level, sign, _least(_SMALL * (high - low)))[0],
        kernels.count_crossings(curves.level, sign, 0.5 * (low + high)),
    )


def _count_bursts(course: _Course, curves: _Curves) -> int:
    """How often the body speeds up."""
    least = _least(_BURST * kernels.read_quantile(course.ordered, 0.95))
    return int(kernels.count_swings(curves.smooth, 1.0, least)[0])


def _count_away(course: _Course) -> tuple[float, float]:
    """Movements away from the pose at rest and back, by their tops and by half of the crossings of the middle."""
    away, calm = np.empty(len(course.poses)), kernels.read_quantile(course.ordered, 0.2)
    kernels.find_distances(course.poses, course.speeds, calm, np.empty(_CALM, np.int64), np.empty(_CALM), away)
    low, high, _ = kernels.find_range(np.sort(away), False)
    tops = kernels.count_swings(away, 1.0, _least(_LARGE * (high - low)))[0]
    return tops, kernels.count_crossings(away, 1.0, 0.5 * (low + high))


def _count_light(course: _Course, axes: FloatArray) -> tuple[float, ...]:
    """Some of the same of what is smoothed less, along the same directions."""
    curves = _draw_curves(course, axes, _LIGHT_WEIGHTS)
    turns, _, _, crossings = _count_quick(curves)
    return _count_middles(curves), turns, crossings, _count_bursts(course, curves), _count_periods(course)


def _fold(course: _Course) -> _Course:
    """What both sides do: the mean of what moves and its mirror image."""
    (poses, velocities), speeds = np.empty((2, *course.poses.shape)), np.empty(len(course.speeds))
    kernels.fold(course.poses, course.velocities, _OTHERS, poses, velocities, speeds)
    return _follow(poses, velocities, speeds)


def _count_even(even: _Course, axes: FloatArray, fastest: float) -> tuple[float, ...]:
    """Some of the same of what both sides do; 0 where one does the opposite of the other."""
    if even.ordered[-1] <= max(_LEAST_EVEN * fastest, _STILL):
        return (0.0,) * 5
    curves = _draw_curves(even, axes, _WEIGHTS)
    turns, _, _, crossings = _count_quick(curves)
    return _count_along_axes(curves)[2], _count_middles(curves), turns, crossings, _count_periods(even)


def _count_periods(course: _Course) -> float:
    """How often the period fits into the moving part; 1 where there is none."""
    places = np.flatnonzero(course.speeds > course.moving)
    part = course.velocities[places[0] : places[-1] + 1]
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
