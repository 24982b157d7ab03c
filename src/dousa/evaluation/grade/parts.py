"""Measures that make a grade: distances of a performance from its reference, and the importance of each segment.

The same measures of each further take against the others are the yardstick. A segment that moves much, and in the same
way in all takes, is important for the grade; finding errors does not use the importance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dousa.arrays import FloatArray, IndexArray
from dousa.errors import InvalidMotionError
from dousa.evaluation.alignment.dynamic_programming import follow_lag
from dousa.evaluation.errors.evidence import Deviations
from dousa.evaluation.posture.posture import LIMBS, SEGMENTS, Working, check_weights
from dousa.evaluation.posture.yaw import rotate_yaw

PARTS: tuple[str, ...] = ("deviation", "shape", "worst", "lag", "missing", "more", "pace")
"""Mean angle at the same time, and at the best time nearby (deg); what the worst segment exceeds for a tenth of the
time, at the best time nearby (deg); lag of the limbs (s); range of motion that is missing, and that is too much (deg);
length of the way that the segments go (logarithm of the ratio)."""

_RATE = 10.0  # Hz, of the moments that are measured
_CHANGE, _LATE = 0.4, 0.02  # prices of 0.1 s more or less of lag, and of being late, against log(1 + chord^2 / near)
_FLOOR_DEG, _FLOOR_SPEED = 20.0, 5.0  # deg, deg/s: what hardly moves is measured against this


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """A performance against its reference, segment by segment; (N,) moments at about 10 Hz."""

    rows: IndexArray  # (N,) frames at the working rate
    same: FloatArray  # (N, 9) deg, angle at the same time; nan where not judged
    shape: FloatArray  # (N, 9) deg, angle at the best time nearby; nan where not judged
    lag: FloatArray  # (N, 9) s, of each segment's limb, without a sign
    moving: FloatArray  # (N, 9) deg/s, of the reference
    missing: FloatArray  # (9,) deg, range less than any take's
    more: FloatArray  # (9,) deg, range more than any take's
    way: FloatArray  # (9,) deg that each segment goes
    ways: FloatArray  # (n, 9) deg, the same of the takes over the part of them that was danced
    covered: NDArray[np.bool_]  # (U,) moments of the reference that were danced
    weights_of: FloatArray  # (U, 9) deg/s, how much the reference moves then

    def find_coverage(self, weights: FloatArray, *, floor_still: float = 1.0) -> float:
        """Find the share of the reference's motion that was danced, 0 to 1; weights (9,) of the segments."""
        # floor_still: deg/s, of a reference that stands still
        motion = (self.weights_of + floor_still) @ weights
        return float((motion * self.covered).sum() / max(float(motion.sum()), 1e-9))

    def find_parts(
        self, weights: FloatArray, frames: NDArray[np.bool_] | None = None, *, worst: float = 90.0
    ) -> FloatArray:
        """(7,) values of `PARTS`; nan if nothing is compared.

        Parameters
        ----------
        weights : (9,) of the segments.
        frames : (T,) of the working frames, those to look at: range and way are not measured then.
        worst : percentile over time of the largest angles.
        """
        here = slice(None) if frames is None else np.flatnonzero(frames[np.minimum(self.rows, len(frames) - 1)])
        shares = np.where(np.isnan(self.same[here]), 0.0, weights)
        if not shares.any():
            return np.full(len(PARTS), np.nan)
        moving = shares * (self.moving[here] + _FLOOR_SPEED)
        values = np.zeros(len(PARTS))
        values[0], values[1] = (_average(angles[here], shares) for angles in (self.same, self.shape))
        largest = (np.nan_to_num(self.shape[here]) * np.sqrt(shares)).max(axis=1)
        values[2] = float(np.percentile(largest[shares.any(axis=1)], worst))
        values[3] = float((self.lag[here] * moving).sum() / moving.sum())
        if frames is None:
            judged = np.isfinite(self.same).any(axis=0) * weights
            values[4], values[5] = (
                float(np.sqrt((judged * x**2).sum() / judged.sum())) for x in (self.missing, self.more)
            )
            values[6] = _compare_ways(float(self.way @ judged), self.ways @ judged, _FLOOR_DEG * judged.sum())
        return values


def _average(angles: FloatArray, shares: FloatArray) -> float:
    """Mean over time of the root mean square over the segments."""
    total = shares.sum(axis=1)
    some = total > 0.0
    return float(np.sqrt((np.nan_to_num(angles) ** 2 * shares).sum(axis=1)[some] / total[some]).mean())


def _compare_ways(own: float, those: FloatArray, floor: float) -> float:
    """How much further or less far than any take, as a logarithm."""
    ratios = np.log((own + floor) / (those + floor))
    return float(max(ratios.min(), -ratios.max(), 0.0))


def measure_parts(
    references: Sequence[Working], performance: Working, deviations: Deviations, frames: FloatArray
) -> Measured:
    """Measure a performance.

    Parameters
    ----------
    references : takes on the clock of the first.
    performance : by the body of the reference, at the working rate.
    deviations : from the nearest take.
    frames : (T,) reference frames of the line.
    """
    rate = performance.frame_rate
    step = max(1, round(rate / _RATE))
    rows = np.arange(0, performance.n_frames, step)
    squared, judged = deviations.squared[::step], deviations.judged[rows]
    columns, best = _follow_limbs(squared, deviations.center, rate)
    same, shape = (
        np.where(judged, np.degrees(2.0 * np.arcsin(np.minimum(0.5 * np.sqrt(x), 1.0))), np.nan)
        for x in (squared[:, deviations.center], best)
    )
    lag = np.abs(columns) / rate
    speed = _measure_speed(references[0])
    there = np.clip(np.rint(frames[rows]).astype(np.intp), 0, references[0].n_frames - 1)
    middle = np.median(columns, axis=1).astype(np.intp)
    covered = _find_covered(squared, rows, frames, middle, deviations.center, step, references[0].n_frames, rate)
    own = _measure_motion(performance, deviations.judged, rate)
    shown = covered[:, None] & _find_shown(performance, frames, references[0].n_frames)
    those = [_measure_motion(take, shown & take.seen, rate) for take in references]
    low, high = (bound([one[0] for one in those], axis=0) for bound in (np.min, np.max))
    return Measured(
        rows,
        same,
        shape,
        lag,
        speed[there],
        np.maximum(low - own[0], 0.0),
        np.maximum(own[0] - high, 0.0),
        own[1],
        np.array([one[1] for one in those]),
        covered,
        speed,
    )


def _follow_limbs(
    squared: FloatArray, center: int, rate: float, *, near: float = np.radians(12.0) ** 2
) -> tuple[NDArray[np.intp], FloatArray]:
    """(N, 9) columns of lag of each segment's limb, and (N, 9) squared chords there."""
    # near: squared chord from which a moment is hardly the same
    lags = np.abs(np.arange(squared.shape[1]) - center) / rate
    rows = np.arange(len(squared))
    columns, best = np.zeros((len(squared), 9), np.intp), np.zeros((len(squared), 9))
    change = _CHANGE * _RATE / rate
    for segments in LIMBS.values():
        part = squared[:, :, list(segments)]
        cost = np.log1p(part / near).mean(axis=2)
        course = follow_lag(cost + _LATE * _RATE * lags, change)
        for segment in segments:
            columns[:, segment] = course - center
            best[:, segment] = squared[rows, course, segment]
    return columns, best


def _measure_speed(take: Working) -> FloatArray:
    """(U, 9) deg/s."""
    if take.n_frames < 2:
        return np.zeros((take.n_frames, 9))
    speed = np.degrees(np.linalg.norm(np.diff(take.segments, axis=0), axis=2)) * take.frame_rate
    return np.concatenate([speed, speed[-1:]])


def _find_covered(
    squared: FloatArray,
    rows: IndexArray,
    frames: FloatArray,
    lag: NDArray[np.intp],
    center: int,
    step: int,
    count: int,
    rate: float,
    *,
    step_s: float = 0.5,
    resembled: float = np.radians(25.0) ** 2,
) -> NDArray[np.bool_]:
    """(U,) moments of the reference that the performance passes, or whose pose it shows at about that time."""
    # resembled: squared chord of all segments of a pose that was danced, at whatever time
    # step_s: a performance that goes on by no more than this in the reference leaves nothing out
    covered = np.zeros(count, np.bool_)
    there = np.rint(frames[rows]).astype(np.intp) + lag
    near = np.abs(np.diff(there)) <= step_s * rate + step
    for start, end in zip(there[:-1][near], there[1:][near], strict=True):
        covered[max(min(start, end), 0) : max(max(start, end) + 1, 0)] = True
    steps = np.arange(-(center // step), center // step + 1) * step
    part = squared[:, center + steps]
    # The limb that is off most: in an exercise of one arm all others always resemble.
    unlike = np.where((part > 0.0).any(axis=2), part.max(axis=2), np.inf)
    shown = (np.rint(frames[rows]).astype(np.intp)[:, None] + steps)[unlike < resembled]
    for shift in range(-(step // 2), step - step // 2):
        covered[(shown + shift)[(shown + shift >= 0) & (shown + shift < count)]] = True
    return covered


def _find_shown(performance: Working, frames: FloatArray, count: int) -> NDArray[np.bool_]:
    """(U, 9) moments of the reference at which the performance is not hidden."""
    shown = np.ones((count, 9), np.bool_)
    there = np.rint(frames).astype(np.intp)
    for row in np.flatnonzero(~performance.seen.all(axis=1) & (there >= 0) & (there < count)):
        shown[there[row]] &= performance.seen[row]
    return shown


def _measure_motion(
    take: Working, seen: NDArray[np.bool_], rate: float, *, most_poses: int = 90
) -> tuple[FloatArray, FloatArray]:
    """(9,) deg of range, and (9,) deg of way, of what is (T, 9) to be looked at."""
    step = max(1, round(rate / _RATE))
    body = rotate_yaw(take.segments, -np.nan_to_num(take.heading))[::step]
    here = seen[::step]
    ranges, ways = np.zeros(9), np.zeros(9)
    turns = np.degrees(np.linalg.norm(np.diff(body, axis=0), axis=2))
    for segment in np.flatnonzero(here.sum(axis=0) >= 2):
        some = body[here[:, segment], segment]
        few = some[np.linspace(0, len(some) - 1, min(len(some), most_poses)).round().astype(int)]
        ranges[segment] = np.percentile(np.degrees(np.arccos(np.clip(few @ few.T, -1.0, 1.0))), 99.0)
        both = here[1:, segment] & here[:-1, segment]
        ways[segment] = turns[both, segment].sum()
    return ranges, ways


def compute_deviation(residual: ArrayLike, weights: ArrayLike | None = None) -> float:
    """Compute the mean angle between a performance and its reference in deg.

    The residual is (T, 9) rad, nan left out; weights (9,) are 0 or above, None for equal ones. Returns the mean over
    time of the weighted root mean square over the segments; nan where nothing is compared. Raises InvalidMotionError
    for another shape, OptionError for wrong weights.
    """
    angles = np.asarray(residual, np.float64)
    if angles.ndim != 2 or angles.shape[1] != len(SEGMENTS):
        raise InvalidMotionError("evaluation.residual", shape=angles.shape)
    shares = np.where(np.isnan(angles), 0.0, check_weights(weights))
    total = shares.sum(axis=1)
    compared = total > 0
    if not compared.any():
        return float("nan")
    squares = (np.nan_to_num(angles) ** 2 * shares).sum(axis=1)[compared] / total[compared]
    return float(np.degrees(np.sqrt(squares).mean()))


_ALONE, _TOGETHER = 0.35, 0.5  # how much is made of it, with one take and with several


def learn_importance(
    takes: Sequence[Working],
    measured: Sequence[Measured],
    *,
    little_deg: float = 15.0,
    alike_deg: float = 5.0,
    most: float = 2.5,
) -> FloatArray:
    """(9,) weights of the segments, of mean 1.

    Parameters
    ----------
    takes : of the reference, at the working rate.
    measured : of the further ones against the others; of one take there are none, and its amount of motion alone
        tells, mildly.
    little_deg : deg added to the motion: what moves little is still looked at.
    alike_deg : deg that takes of one person differ by anyway.
    most : largest weight, and the inverse of the smallest.
    """
    motion = np.mean([_measure_spread(take) for take in takes], axis=0) + little_deg
    seen = takes[0].seen.any(axis=0)
    if measured:
        apart = np.mean([_average_over_time(one.shape) for one in measured], axis=0)
        shares = (motion / (apart + alike_deg)) ** _TOGETHER
    else:
        shares = motion**_ALONE
    shares /= shares[seen].mean() if seen.any() else 1.0
    shares = np.clip(shares, 1.0 / most, most)
    return np.asarray(shares / shares[seen].mean() if seen.any() else np.ones(9))


def _average_over_time(angles: FloatArray) -> FloatArray:
    """(9,) root mean square over time of (N, 9); 0 where nothing is known."""
    count = np.isfinite(angles).sum(axis=0)
    return np.asarray(np.sqrt(np.nansum(angles**2, axis=0) / np.maximum(count, 1)))


def _measure_spread(take: Working) -> FloatArray:
    """(9,) deg, root mean square of the angle from the mean direction, in the performer's own frame."""
    body = rotate_yaw(take.segments, -np.nan_to_num(take.heading))
    mean = body.mean(axis=0)
    mean /= np.maximum(np.linalg.norm(mean, axis=1, keepdims=True), 1e-9)
    cosine = np.clip(np.einsum("tsk,sk->ts", body, mean), -1.0, 1.0)
    spread: FloatArray = np.sqrt((np.degrees(np.arccos(cosine)) ** 2).mean(axis=0))
    return spread
