"""Tallies of repetitions with NumPy's own quantiles and fits, each curve by itself.

It says what ``dousa.retrieval.counting.counter`` computes with less ado; swings are counted there.
"""

import numpy as np

from dousa.arrays import BoolArray, FloatArray
from dousa.motion.canonical.joints import JOINT_INDEX
from dousa.motion.resampling import smooth_gaussian
from dousa.retrieval.counting.counter import TALLIES, count_swings
from dousa.retrieval.features.pose_features import turn_to_body
from dousa.retrieval.features.posed_motion import FRAME_JOINTS, complete_positions

RATE = 30.0
_JOINTS = "head left_elbow left_hand right_elbow right_hand left_knee left_ankle right_knee right_ankle".split()
_INDEX = [JOINT_INDEX[joint] for joint in _JOINTS]
_SMOOTHING = 3.0  # frames, standard deviation: a sensor's noise is quicker than people
_LIGHT = 1.5  # frames: of what is as quick as noise
_LARGE, _SMALL = 0.5, 0.3  # shares of the range (5 to 95 %) that a movement out and back has at least
_TURN, _SMALL_TURN, _BURST = 0.6, 0.3, 0.35  # likewise of the speed along one direction, of the body's speed (95 %)
_MOVING = 0.15  # share of the speed (90 %) below which the body rests
_BOUT_GAP = 9  # frames of rest between two bouts of movement
_SHORTEST = 9  # frames of a period
_LONGEST = 0.62  # share of the moving part that a period may last
_NEAR, _REACHED, _END, _ROUNDS, _CORE_ALIKE = (
    0.8,
    0.1,
    3,
    2.5,
    0.2,
)  # of what is repeated between a way there and a way back
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
    points = complete_positions(sampled, height, (), {*_JOINTS, *FRAME_JOINTS})
    if len(points) < 2:
        return np.zeros(len(TALLIES))
    poses = _describe(points, height, _SMOOTHING)
    speeds, velocities = _measure_speeds(poses)
    if speeds.max() <= 1e-9:
        return np.zeros(len(TALLIES))
    core = find_core(poses, speeds)
    if core.stop > core.start and _fit_periods(velocities[core], _CORE_ALIKE) >= _ROUNDS:
        points, poses = points[core], _describe(points[core], height, _SMOOTHING)
        speeds, velocities = _measure_speeds(poses)
    moving, axes = _find_moving(speeds), _find_axes(poses, velocities)
    counts = (
        *_count_along_axes(poses, axes),
        *_count_quick(poses, velocities, axes),
        _count_bursts(speeds, _SMOOTHING),
        _count_bouts(moving),
        *_count_away(poses, speeds),
        _count_periods(velocities, moving),
        *_count_light(_describe(points, height, _LIGHT), axes),
        *_count_even(poses, float(speeds.max())),
    )
    return np.array([*counts, len(points) / RATE, speeds.sum(), moving.sum() / RATE], np.float64)


def find_core(poses: FloatArray, speeds: FloatArray) -> slice:
    """The frames of poses (n, K) between a way there and a way back, or one of them; none where there is no such."""
    moving = np.flatnonzero(_find_moving(speeds))
    if not len(moving) or moving[-1] + 1 - moving[0] < 2 * _SHORTEST:
        return slice(0, 0)
    starts, stops = [], []
    for pose in (poses[:_END].mean(axis=0), poses[-_END:].mean(axis=0)):
        away = np.linalg.norm(poses - pose, axis=1)
        far = away >= _NEAR * np.median(away[moving[0] : moving[-1] + 1])
        block = np.flatnonzero(far)
        if len(block) == block[-1] + 1 - block[0] >= 2 * _SHORTEST:
            reached = block[away[block] >= np.quantile(away[block], _REACHED)]
            starts.append(int(reached[0]))
            stops.append(int(reached[-1]) + 1)
    if not starts or min(stops) - max(starts) < 2 * _SHORTEST:
        return slice(0, 0)
    return slice(max(starts), min(stops))


def _describe(points: FloatArray, height: float, deviation: float) -> FloatArray:
    smoothed = smooth_gaussian(points, deviation)
    poses: FloatArray = turn_to_body((smoothed - smoothed[:, :1]) / height)[:, _INDEX].reshape(len(points), -1)
    return poses


def _measure_speeds(poses: FloatArray) -> tuple[FloatArray, FloatArray]:
    velocities: FloatArray = np.asarray(np.gradient(poses, axis=0))
    return np.sqrt((velocities**2).sum(axis=1)), velocities


def _find_moving(speeds: FloatArray) -> BoolArray:
    moving: BoolArray = speeds > _MOVING * np.percentile(speeds, 90)
    return moving


def _find_axes(poses: FloatArray, velocities: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The directions of movement, and of quick movement, the least first."""
    spread = poses - poses.mean(axis=0)
    return np.linalg.eigh(spread.T @ spread)[1], np.linalg.eigh(velocities.T @ velocities)[1]


def _count_light(poses: FloatArray, axes: tuple[FloatArray, FloatArray]) -> tuple[float, ...]:
    """Some of it, of what is smoothed less."""
    speeds, velocities = _measure_speeds(poses)
    turns, _, _, crossings = _count_quick(poses, velocities, axes)
    return (
        _count_along_axes(poses, axes)[-1],
        turns,
        crossings,
        _count_bursts(speeds, _LIGHT),
        _count_periods(velocities, _find_moving(speeds)),
    )


def _count_even(poses: FloatArray, fastest: float) -> tuple[float, ...]:
    """Some of it, of the mean of the poses and their mirror images."""
    joints = poses.reshape(len(poses), -1, 3)
    others = [_JOINTS.index(_mirror(joint)) for joint in _JOINTS]
    even = 0.5 * (joints + joints[:, others] * (-1.0, 1.0, 1.0)).reshape(len(poses), -1)
    speeds, velocities = _measure_speeds(even)
    if speeds.max() <= max(1e-3 * fastest, 1e-9):
        return (0.0,) * 5
    axes = _find_axes(even, velocities)
    turns, _, _, crossings = _count_quick(even, velocities, axes)
    along = _count_along_axes(even, axes)
    return along[2], along[-1], turns, crossings, _count_periods(velocities, _find_moving(speeds))


def _mirror(joint: str) -> str:
    side, _, rest = joint.partition("_")
    return {"left": "right", "right": "left"}[side] + "_" + rest if rest else joint


def _count_bursts(speeds: FloatArray, deviation: float) -> int:
    """How often the body speeds up."""
    return count_swings(smooth_gaussian(speeds, deviation), _BURST * float(np.percentile(speeds, 95)))[0]


def _count_along_axes(poses: FloatArray, axes: tuple[FloatArray, FloatArray]) -> tuple[float, ...]:
    """Movements out and back along the two directions of most movement, and half of the crossings of the middle."""
    spread = poses - poses.mean(axis=0)
    first, second = (_turn_out(curve) for curve in (spread @ axes[0][:, :-3:-1]).T)
    reach, other = _reach(first), _reach(second)
    return (
        *count_swings(first, _LARGE * reach),
        *count_swings(first, _SMALL * reach),
        count_swings(second, _LARGE * other)[0],
        _count_crossings(first),
    )


def _reach(curve: FloatArray) -> float:
    low, high = np.quantile(curve, (0.05, 0.95))
    return float(high - low)


def _count_crossings(curve: FloatArray) -> float:
    """Half of how often a curve crosses the middle of its range."""
    above = curve > 0.5 * np.quantile(curve, (0.05, 0.95)).sum()
    return 0.5 * np.count_nonzero(above[1:] != above[:-1])


def _turn_out(curve: FloatArray) -> FloatArray:
    """The curve or its negative, such that most of the time is spent low: repetitions leave a rest."""
    return -curve if np.median(curve) > 0.5 * (curve.min() + curve.max()) else curve


def _count_quick(
    poses: FloatArray, velocities: FloatArray, axes: tuple[FloatArray, FloatArray]
) -> tuple[float, float, float, float]:
    """Along the direction of quickest movement: how often it is taken, there and back, half each; and out and back.

    What drifts slowly, or fades, is quick all the same.
    """
    axis = axes[1][:, -1]
    along = velocities @ axis
    speed = float(np.quantile(np.abs(along), 0.95))
    curve = poses @ axis
    curve = _turn_out(curve - np.polyval(np.polyfit(np.arange(len(curve)), curve, 1), np.arange(len(curve))))
    return (
        0.5 * sum(count_swings(along, _TURN * speed)),
        0.5 * sum(count_swings(along, _SMALL_TURN * speed)),
        count_swings(curve, _SMALL * _reach(curve))[0],
        _count_crossings(curve),
    )


def _count_bouts(moving: BoolArray) -> int:
    """Bouts of movement with rests between them."""
    places = np.flatnonzero(moving)
    return 1 + int(np.count_nonzero(np.diff(places) > _BOUT_GAP))


def _count_away(poses: FloatArray, speeds: FloatArray) -> tuple[float, float]:
    """Movements away from the pose at rest and back, by their tops and by half of the crossings of the middle."""
    slow = poses[speeds <= np.quantile(speeds, 0.2)]
    # Of the calm poses the one that most others are like.
    some = slow[:: max(len(slow) // 60, 1)]
    near = ((some[:, None] - some[None]) ** 2).sum(axis=2)
    rest = some[int(np.median(near, axis=1).argmin())]
    away = np.sqrt(((poses - rest) ** 2).sum(axis=1))
    return count_swings(away, _LARGE * _reach(away))[0], _count_crossings(away)


def _count_periods(velocities: FloatArray, moving: BoolArray) -> float:
    """How often the period fits into the moving part; 1 where there is none."""
    places = np.flatnonzero(moving)
    return _fit_periods(velocities[places[0] : places[-1] + 1], _ALIKE)


def _fit_periods(part: FloatArray, alike: float) -> float:
    likeness = correlate(part)
    peaks = 1 + np.flatnonzero((likeness[1:-1] >= likeness[:-2]) & (likeness[1:-1] > likeness[2:]))
    peaks = peaks[peaks >= _SHORTEST]
    if not len(peaks) or likeness[peaks].max() < alike:
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
