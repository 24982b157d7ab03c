"""Where a performance differs by more than is tolerated: stretches of frames that want an explanation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import FloatArray
from dousa.evaluation.alignment.dynamic_programming import follow_lag, switch_on
from dousa.evaluation.errors.deviation import Deviations
from dousa.evaluation.errors.extent import find_shrunk
from dousa.evaluation.posture.posture import LIMBS

CAP = 9.0
"""A segment three times out of tolerance is wrong; how much further out says no more."""

SLACK_S = 0.07
"""s; nobody is steadier in time than this, so a smaller lag is forgiven."""

LIMB_SEGMENTS: tuple[NDArray[np.intp], ...] = tuple(np.array(indices) for indices in LIMBS.values())

# All in units of one frame at 30 Hz with one segment at its tolerance.
LAG_CHANGE = 2.0  # price of one column of lag more or less
LAG_PRICE = 0.15  # and of being late at all, a frame and column: of two explanations the nearer one
_CHANGE = 8.0  # price of starting or ending a stretch
_BODY = 0.45  # mean over all segments from which the body as a whole is off
_LAG_EVIDENCE = 40.0  # what a lag must explain
_SHORTEST_LAG_S = 0.2
_BRIDGE_S = 0.25
_TIE = 1e-3
_APART_S = 0.3


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """Deviations in multiples of what is tolerated.

    Parameters
    ----------
    deviations : as measured.
    tolerance : (9,) rad.
    ratio : (T, K, 9) squared deviation over squared tolerance, at most `CAP`, times the segment's weight.
    ordinary : (T, 9) the same at the same time, small lags forgiven; 0 where nothing is judged.
    punctual : (T, 9) the same without forgiving.
    course : (T,) column of the lag that explains most.
    near : (T,) the same among the lags that are forgiven.
    slack_s : s of lag that is forgiven.
    slack : columns of it.
    rate : Hz.
    """

    deviations: Deviations
    tolerance: FloatArray
    ratio: FloatArray
    ordinary: FloatArray
    punctual: FloatArray
    course: NDArray[np.intp]
    near: NDArray[np.intp]
    slack_s: float
    slack: int
    rate: float

    @property
    def center(self) -> int:
        """Column of no lag."""
        return self.deviations.center

    @property
    def lag_prices(self) -> FloatArray:
        """(K,) price a frame of each lag."""
        columns = np.arange(self.ratio.shape[1])
        prices: FloatArray = LAG_PRICE * np.abs(columns - self.center) * (30.0 / self.rate)
        return prices


def at_lag(ratio: FloatArray, course: NDArray[np.intp]) -> FloatArray:
    """(T, 9) of (T, K, 9) at each frame's column."""
    return np.take_along_axis(ratio, course[:, None, None], axis=1)[:, 0]


def gather_evidence(deviations: Deviations, tolerance: FloatArray, slack_s: float, weights: FloatArray) -> Evidence:
    """Weigh the deviations.

    Parameters
    ----------
    deviations : of the performance.
    tolerance : (9,) rad.
    slack_s : s, lag that is forgiven.
    weights : (9,) of the segments, those above 0 of mean 1.
    """
    rate = 1.0 / deviations.step_s
    ratio = np.minimum(deviations.squared / tolerance**2, CAP) * weights
    center = deviations.center
    _level_gaps(ratio, deviations)
    cost = ratio.sum(axis=2)
    slack = min(max(1, round(slack_s * rate)), center)
    change = LAG_CHANGE * 30.0 / rate
    prices = LAG_PRICE * np.abs(np.arange(cost.shape[1]) - center) * (30.0 / rate)
    # Where all lags are as good there is none.
    forgiven = slice(center - slack, center + slack + 1)
    near = follow_lag(cost[:, forgiven] + _TIE * prices[forgiven], change)
    near = near.astype(np.intp) + center - slack
    course = follow_lag(cost + prices, change).astype(np.intp)
    ordinary = at_lag(ratio, near) * deviations.judged
    punctual = ratio[:, center] * deviations.judged
    return Evidence(deviations, tolerance, ratio, ordinary, punctual, course, near, slack_s, slack, rate)


def _level_gaps(ratio: FloatArray, deviations: Deviations) -> None:
    """Let what is not seen speak for no lag: as good as at the same time, or nothing if that is not judged."""
    unseen = deviations.squared == 0.0
    if not unseen.any():
        return
    center = deviations.center
    np.copyto(ratio, ratio[:, center : center + 1], where=unseen)
    np.copyto(ratio, 0.0, where=unseen[:, center : center + 1])


def refine_lag(evidence: Evidence, course: NDArray[np.intp], first: int = 0) -> FloatArray:
    """Lag in s of frames ``first`` and on, to a fraction of a column: the lowest point of a parabola.

    One frame's minimum is noise; nine frames at the same lag have one.
    """
    rows = np.arange(first, first + len(course))
    inner = np.clip(course, 1, evidence.ratio.shape[1] - 2)
    left, here, right = (evidence.deviations.squared[rows, inner + step].sum(axis=1) for step in (-1, 0, 1))
    kernel = np.ones(9) / 9.0
    left, here, right = (np.convolve(values, kernel, mode="same")[: len(rows)] for values in (left, here, right))
    bend = left - 2.0 * here + right
    # Where nothing differs the lag is none, however lopsided the parabola is.
    sure = (bend > 1e-6) & (here > 1e-9)
    shift = np.where(sure, 0.5 * (left - right) / np.maximum(bend, 1e-6), 0.0)
    columns: FloatArray = course - evidence.center + np.clip(shift, -1.0, 1.0)
    return -columns * evidence.deviations.step_s


def runs_of(mask: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Half-open stretches where a mask is true."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.view(np.int8), [0]])))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


def find_stretches(evidence: Evidence) -> list[tuple[int, int]]:
    """Half-open stretches of frames in which something is wrong: a limb, the body, the time, or the size."""
    per_frame = 30.0 / evidence.rate
    wrong = np.zeros(len(evidence.ordinary), np.bool_)
    for limb in LIMB_SEGMENTS:
        wrong |= switch_on((evidence.ordinary[:, limb].max(axis=1) - 1.0) * per_frame, _CHANGE)
    body = evidence.ordinary.mean(axis=1) - _BODY
    wrong |= switch_on(3.0 * body * per_frame, _CHANGE)
    wrong |= _find_lags(evidence)
    shrunk = find_shrunk(evidence.deviations, evidence.tolerance, evidence.rate)
    apart = _widen(wrong, round(_APART_S * evidence.rate))
    for start, end in shrunk:
        # Where something else is wrong the windows that look for shrinking see that.
        if apart[start:end].mean() < 0.3:
            wrong[start:end] = True
    stretches: list[tuple[int, int]] = []
    for start, end in runs_of(wrong):
        if stretches and start - stretches[-1][1] <= _BRIDGE_S * evidence.rate:
            stretches[-1] = (stretches[-1][0], end)
        else:
            stretches.append((start, end))
    return stretches


def _find_lags(evidence: Evidence) -> NDArray[np.bool_]:
    """Where the lag is beyond what is forgiven, and is sure: being in time explains much less."""
    explained = evidence.punctual.sum(axis=1) - at_lag(evidence.ratio, evidence.course).sum(axis=1)
    explained -= evidence.lag_prices[evidence.course]
    late = np.abs(refine_lag(evidence, evidence.course)) > evidence.slack_s
    late &= evidence.deviations.judged.any(axis=1)
    found = np.zeros(len(late), np.bool_)
    for start, end in runs_of(late):
        enough = explained[start:end].sum() * (30.0 / evidence.rate) > _LAG_EVIDENCE
        found[start:end] = enough and end - start >= _SHORTEST_LAG_S * evidence.rate
    return found


def _widen(mask: NDArray[np.bool_], reach: int) -> NDArray[np.bool_]:
    """True wherever the mask is true at most ``reach`` frames away."""
    count = np.convolve(mask.astype(float), np.ones(2 * reach + 1))[reach : reach + len(mask)]
    wide: NDArray[np.bool_] = count > 0.5
    return wide


_STEADIEST, _UNSTEADIEST = np.radians(3.0), np.radians(9.0)
_MULTIPLE = 2.4
_LEAST = np.radians(10.0)
_NEAR_S = 0.14
_WOBBLE_S, _WOBBLE_PERCENTILE, _WOBBLE_MULTIPLE, _MOST_SLACK_S = 0.5, 20.0, 3.0, 0.3


@dataclass(frozen=True, slots=True, eq=False)
class Tolerance:
    """What is tolerated.

    Parameters
    ----------
    angle : (9,) rad, of each segment.
    lag_s : s.
    """

    angle: FloatArray
    lag_s: float = SLACK_S


def measure_unsteadiness(deviations: Deviations) -> Tolerance:
    """Tolerance from one performance: multiples of how far segments and time mostly are from the reference."""
    reach = max(1, round(_NEAR_S / deviations.step_s))
    center = deviations.center
    near = slice(max(center - reach, 0), center + reach + 1)
    nearest = deviations.squared[:, near].sum(axis=2).argmin(axis=1)
    left = np.take_along_axis(deviations.squared[:, near], nearest[:, None, None], axis=1)[:, 0]
    # The root mean square of a wavering direction is 1.2 times its median; errors hardly move the median.
    typical = 1.2 * np.sqrt(np.median(left, axis=0))
    steadiness = np.clip(typical, _STEADIEST, _UNSTEADIEST)
    return Tolerance(np.maximum(_MULTIPLE * steadiness, _LEAST), _measure_wobble(deviations))


def _measure_wobble(deviations: Deviations) -> float:
    """Lag in s that is forgiven: nobody is steadier than `SLACK_S`, many are less steady throughout."""
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
