"""Deviations in multiples of what is tolerated."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import FloatArray
from dousa.evaluation.alignment.dynamic_programming import follow_lag
from dousa.evaluation.errors.deviations import Deviations
from dousa.evaluation.posture.posture import SEGMENTS
from dousa.kernels import kernel


def measure_ranges(segments: FloatArray, *, most_frames: int = 90) -> FloatArray:
    """(S,) rad, the largest angle between any two directions of each segment of (T, S, 3)."""
    thinned = segments[:: max(1, -(-len(segments) // most_frames))].transpose(1, 0, 2)
    cosines = (thinned @ thinned.transpose(0, 2, 1)).reshape(len(thinned), -1).min(axis=1)
    ranges: FloatArray = np.arccos(np.clip(cosines, -1.0, 1.0))
    return ranges


def measure_missing_range(
    reference: FloatArray, performance: FloatArray, segments: NDArray[np.intp]
) -> tuple[float, float]:
    """Measure the range that the most affected segment lacks: rad, and as a share of the reference's range.

    Reference and performance are (T, 9, 3) unit vectors of the same moments; segments are the indices that may be
    affected.
    """
    whole = measure_ranges(reference[:, segments])
    missing = whole - measure_ranges(performance[:, segments])
    worst = int(np.argmax(missing))
    amount = float(max(missing[worst], 0.0))
    return amount, amount / max(float(whole[worst]), 1e-6)


CAP = 9.0
"""The square of three, by definition: three times out of tolerance a segment is wrong; further out says no more."""

SLACK_S = 0.07
"""s; no person is steadier in time than this, so a smaller lag is forgiven (docs/evaluation.md)."""

# All in units of one frame at 30 Hz with one segment at its tolerance.
LAG_CHANGE = 2.0  # price of one column of lag more or less
LAG_PRICE = 0.15  # and of being late at all, a frame and column, see docs/evaluation.md


@kernel(linear=True)
def _sum_up(
    squared: NDArray[np.float32],
    center: int,
    scale: FloatArray,
    shares: FloatArray,
    total: NDArray[np.float32],
) -> None:  # pragma: no cover - compiled
    """Add `Ratios.sum_up` to ``total`` (T, K): ``scale`` (9,) inverse squared tolerance, ``shares`` (9,) weights."""
    for t in range(len(squared)):
        for s in range(9):
            same = np.float64(squared[t, center, s])
            if shares[s] > 0.0 and same > 0.0:
                for k in range(squared.shape[1]):
                    far = np.float64(squared[t, k, s])
                    far = far if far > 0.0 else same  # what is not seen speaks for no lag
                    total[t, k] += min(far * scale[s], CAP) * shares[s]


@dataclass(frozen=True, slots=True, eq=False)
class Ratios:
    """Squared deviation over squared tolerance, at most `CAP`, times the segment's weight; made where it is needed.

    What is not seen speaks for no lag: it is as good as at the same time, or nothing if that is not judged.
    """

    deviations: Deviations
    tolerance: FloatArray  # (9,) rad
    weights: FloatArray  # (9,) of the segments, those above 0 of mean 1

    def at_lag(self, course: NDArray[np.intp], first: int = 0) -> FloatArray:
        """(n, 9) at each frame's column, of frames from ``first`` on."""
        squared = self.deviations.squared[first : first + len(course)]
        return self._weigh(squared[np.arange(len(course)), course], squared[:, self.deviations.center])

    def sum_up(self, segments: NDArray[np.intp]) -> NDArray[np.float32]:
        """(T, K) sums over some segments."""
        total = np.zeros(self.deviations.squared.shape[:2], np.float32)
        shares = np.where(np.isin(np.arange(9), segments), self.weights, 0.0)
        _sum_up(self.deviations.squared, self.deviations.center, self.tolerance**-2.0, shares, total)
        return total

    def find_weighing(self) -> NDArray[np.bool_]:
        """(9,) segments that weigh anything at any moment."""
        judged: NDArray[np.bool_] = np.any(self.deviations.squared[:, self.deviations.center] > 0.0, axis=0)
        return judged & (self.weights > 0.0)

    def _weigh(self, squared: NDArray[np.float32], same: NDArray[np.float32]) -> FloatArray:
        ratio, here = (np.minimum(values / self.tolerance**2, CAP) * self.weights for values in (squared, same))
        unseen, unjudged = squared == 0.0, same == 0.0
        if unseen.any():
            np.copyto(ratio, here, where=unseen)
        if unjudged.any():
            np.copyto(ratio, 0.0, where=unjudged)
        return ratio


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """Deviations in multiples of what is tolerated."""

    deviations: Deviations  # as measured
    tolerance: FloatArray  # (9,) rad
    ratio: Ratios  # the deviations in multiples of the tolerance
    # (T, 9) the ratio at the same time, small lags forgiven; 0 where nothing is judged
    ordinary: FloatArray
    punctual: FloatArray  # (T, 9) the same without forgiving
    course: NDArray[np.intp]  # (T,) column of the lag that explains most
    near: NDArray[np.intp]  # (T,) the same among the lags that are forgiven
    slack_s: float  # s of lag that is forgiven
    slack: int  # columns of it
    rate: float  # Hz

    @property
    def center(self) -> int:
        """Column of no lag."""
        return self.deviations.center

    @property
    def lag_prices(self) -> FloatArray:
        """(K,) price a frame of each lag."""
        columns = np.arange(self.deviations.squared.shape[1])
        prices: FloatArray = LAG_PRICE * np.abs(columns - self.center) * (30.0 / self.rate)
        return prices


def gather_evidence(
    deviations: Deviations, tolerance: FloatArray, slack_s: float, weights: FloatArray, *, tie: float = 1e-3
) -> Evidence:
    """Weigh the deviations.

    Parameters
    ----------
    deviations : of the performance.
    tolerance : (9,) rad.
    slack_s : s, lag that is forgiven.
    weights : (9,) of the segments, those above 0 of mean 1.
    """
    rate = 1.0 / deviations.step_s
    ratio, center = Ratios(deviations, tolerance, weights), deviations.center
    cost = ratio.sum_up(np.arange(len(SEGMENTS)))
    slack = min(max(1, round(slack_s * rate)), center)
    change = LAG_CHANGE * 30.0 / rate
    prices = LAG_PRICE * np.abs(np.arange(cost.shape[1]) - center) * (30.0 / rate)
    # Where all lags are as good there is none.
    forgiven = slice(center - slack, center + slack + 1)
    forgiven_course = follow_lag(cost[:, forgiven] + tie * prices[forgiven], change)
    near = forgiven_course.astype(np.intp) + center - slack
    course = follow_lag(cost + prices, change).astype(np.intp)
    ordinary = ratio.at_lag(near) * deviations.judged
    punctual = ratio.at_lag(np.full(len(near), center)) * deviations.judged
    return Evidence(deviations, tolerance, ratio, ordinary, punctual, course, near, slack_s, slack, rate)


def refine_lag(evidence: Evidence, course: NDArray[np.intp], first: int = 0) -> FloatArray:
    """Refine the lag in s of frames from ``first`` on to a fraction of a column: the lowest point of a parabola.

    One frame's minimum is noise; nine frames at the same lag have one.
    """
    rows = np.arange(first, first + len(course))
    inner = np.clip(course, 1, evidence.deviations.squared.shape[1] - 2)
    left, here, right = (evidence.deviations.squared[rows, inner + step].sum(axis=1) for step in (-1, 0, 1))
    nine = np.ones(9) / 9.0
    left, here, right = (np.convolve(values, nine, mode="same")[: len(rows)] for values in (left, here, right))
    bend = left - 2.0 * here + right
    # Where nothing differs the lag is none, however lopsided the parabola is.
    sure = (bend > 1e-6) & (here > 1e-9)
    shift = np.where(sure, 0.5 * (left - right) / np.maximum(bend, 1e-6), 0.0)
    columns: FloatArray = course - evidence.center + np.clip(shift, -1.0, 1.0)
    return -columns * evidence.deviations.step_s


_STEADIEST, _UNSTEADIEST = np.radians(3.0), np.radians(9.0)
_WOBBLE_S, _WOBBLE_PERCENTILE, _WOBBLE_MULTIPLE, _MOST_SLACK_S = 0.5, 20.0, 3.0, 0.3


@dataclass(frozen=True, slots=True, eq=False)
class Tolerance:
    """What is tolerated."""

    angle: FloatArray  # (9,) rad, of each segment
    lag_s: float = SLACK_S  # s


def measure_unsteadiness(
    deviations: Deviations, *, multiple: float = 2.4, least_tolerance: float = np.radians(10.0), near_s: float = 0.14
) -> Tolerance:
    """Measure the tolerance of a performance: multiples of its usual distance from the reference in angle and time."""
    reach = max(1, round(near_s / deviations.step_s))
    center = deviations.center
    near = slice(max(center - reach, 0), center + reach + 1)
    nearest = deviations.squared[:, near].sum(axis=2).argmin(axis=1)
    left = np.take_along_axis(deviations.squared[:, near], nearest[:, None, None], axis=1)[:, 0]
    # The root mean square of a wavering direction is 1.2 times its median; errors hardly move the median.
    typical = 1.2 * np.sqrt(np.median(left, axis=0))
    steadiness = np.clip(typical, _STEADIEST, _UNSTEADIEST)
    return Tolerance(np.maximum(multiple * steadiness, least_tolerance), _measure_wobble(deviations))


def _measure_wobble(deviations: Deviations) -> float:
    """Measure the lag in s that is forgiven: at least `SLACK_S`, more for an unsteady performer."""
    center = deviations.center
    reach = min(round(_WOBBLE_S / deviations.step_s), center - 1)
    near = deviations.squared[:, center - reach - 1 : center + reach + 2].sum(axis=2)
    # One frame's minimum is noise; a few frames at the same lag have one.
    near = np.apply_along_axis(np.convolve, 0, near, np.ones(5) / 5.0, "same")
    nearest = near[:, 1:-1].argmin(axis=1) + 1
    rows = np.arange(len(near))
    left, here, right = (near[rows, nearest + step] for step in (-1, 0, 1))
    bend = np.maximum(left - 2.0 * here + right, 1e-6)
    lag = nearest - (reach + 1) + np.clip(0.5 * (left - right) / bend, -0.5, 0.5)
    # Of a pose that is held every moment is as good: what moves most tells the time.
    speed = ((deviations.reference[1:] - deviations.reference[:-1]) ** 2).sum(axis=(1, 2))
    moving = np.flatnonzero(speed >= np.percentile(speed, 60.0)) if len(speed) else rows
    typical = float(np.percentile(np.abs(lag[moving]), _WOBBLE_PERCENTILE)) * deviations.step_s
    return float(np.clip(_WOBBLE_MULTIPLE * typical, SLACK_S, _MOST_SLACK_S))
