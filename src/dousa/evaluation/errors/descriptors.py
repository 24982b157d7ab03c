"""What is seen around a moment of a performance, limb by limb and in common: the features of the learned judge.

Of every limb and of the whole body, in windows of half a second to two: how far it is from the reference at the same
time and at the best other time, that lag and how clear it is, the gain and what a gain leaves over, whether it is
on the reference's path and whether all of that path is reached (coverage both ways), whether it does what the other
side should do, how much the reference moves there, and how much takes of the reference differ there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from dousa.arrays import FloatArray
from dousa.evaluation.errors.deviation import Deviations
from dousa.evaluation.errors.explain import Finding
from dousa.evaluation.posture.posture import LIMBS, MIRRORED_SEGMENTS, SEGMENTS

N_LIMBS = len(LIMBS)
LIMB_OF = np.array([next(i for i, limb in enumerate(LIMBS.values()) if s in limb) for s in range(len(SEGMENTS))])
"""Limb of each segment."""
RATE = 15.0
"""Moments a second that are described, about."""

_WINDOWS_S = (0.5, 1.0, 2.0)
_REACH_S = 0.8  # lags that are looked at
_SHARP_S = 0.1
_CAP = 1.3  # squared chord of 70 deg: further away says no more
_CAP_IN_COMMON = 0.19  # of 25 deg: one limb alone does not decide the body's lag
_LAG_PRICE = 2e-3  # rad^2 a second: of lags as good as each other the nearest
_ROBUST = 0.05  # rad

_PER_WINDOW = (
    "own",
    "best",
    "lag",
    "sharp",
    "at_body",
    "lag_beside_body",
    "gain",
    "left_by_gain",
    "offset",
    "theirs",
    "ours",
    "late_gain",
    "left_by_late_gain",
    "path",
    "unreached",
    "most_unreached",
    "mirrored",
    "their_speed",
    "our_speed",
    "spread",
    "time_spread",
)
_PER_WINDOW_BODY = (
    "own",
    "best",
    "lag",
    "sharp",
    "gain",
    "left_by_gain",
    "late_gain",
    "left_by_late_gain",
    "path",
    "unreached",
    "their_speed",
    "our_speed",
    "mirrored",
    "spread",
    "time_spread",
)
_IN_CLIP = ("usual_own", "usual_best", "usual_lag", "usual_path")
_SORTED = ("own", "best", "at_body", "path", "left_by_gain", "gain", "lag_beside_body")


@dataclass(frozen=True, slots=True, eq=False)
class Surroundings:
    """What else is known of a performance and its reference.

    Parameters
    ----------
    spread : (T, 9) rad, how much takes of the reference differ at each moment; 0 of one take.
    time_spread : (T,) s, how much their timing does.
    n_references : takes.
    """

    spread: FloatArray
    time_spread: FloatArray
    n_references: int

    @classmethod
    def of_one(cls, n_frames: int) -> Surroundings:
        """Of a single take nothing is known."""
        return cls(np.zeros((n_frames, len(SEGMENTS))), np.zeros(n_frames), 1)


@dataclass(frozen=True, slots=True, eq=False)
class Descriptors:
    """Features of moments.

    Parameters
    ----------
    frames : (N,) working frames.
    limbs : (N, 5, F) float32, of each limb.
    body : (N, G) float32, of all limbs in common.
    """

    frames: NDArray[np.intp]
    limbs: NDArray[np.float32]
    body: NDArray[np.float32]


def choose_stride(rate: float) -> int:
    """Working frames from one described moment to the next."""
    return max(1, round(rate / RATE))


_KINDS = ("shift", "incomplete", "partial", "global")
_MOST_SEVERE = 10.0


def mark_findings(findings: Sequence[Finding], n_frames: int) -> FloatArray:
    """What the closed explanations say at each frame of each limb and, last, of the body: (T, 6, 7).

    Severity by class, lag in s, share of the range that is missing, and how many frames the error lasts.
    """
    marks = np.zeros((n_frames, N_LIMBS + 1, len(_KINDS) + 3))
    for finding in findings:
        limbs = {int(LIMB_OF[segment]) for segment in finding.segments}
        row = np.zeros(len(_KINDS) + 3)
        row[_KINDS.index(finding.kind)] = min(finding.severity, _MOST_SEVERE)
        row[-3:] = finding.lag_s or 0.0, finding.shortfall_share or 0.0, finding.end - finding.start
        for limb in (*limbs, *((N_LIMBS,) if len(limbs) >= N_LIMBS - 1 else ())):
            marks[max(finding.start, 0) : finding.end, limb] = row
    return marks


def describe_moments(deviations: Deviations, around: Surroundings, findings: Sequence[Finding]) -> Descriptors:
    """Describe a performance.

    Parameters
    ----------
    deviations : of the performance.
    around : of the same frames.
    findings : of the closed explanations, see `dousa.evaluation.errors.explain`.
    """
    rate = 1.0 / deviations.step_s
    stride = choose_stride(rate)
    reach = min(round(_REACH_S * rate), deviations.center)
    part = slice(deviations.center - reach, deviations.center + reach + 1)
    squared, common = _pool_limbs(deviations.squared[:, part], LIMB_OF, N_LIMBS, _CAP, _CAP_IN_COMMON)
    ours, theirs = deviations.performance, deviations.reference
    judged = deviations.judged.astype(np.float64)
    mirrored = theirs[:, MIRRORED_SEGMENTS, :] * np.array([-1.0, 1.0, 1.0])
    frames = np.arange(0, len(ours), stride)
    halves = np.array([max(1, round(0.5 * seconds * rate)) for seconds in _WINDOWS_S])
    limb_table, body_table = _describe(
        squared,
        common,
        np.ascontiguousarray(ours),
        np.ascontiguousarray(theirs),
        np.ascontiguousarray(mirrored),
        judged,
        LIMB_OF,
        frames,
        halves,
        max(1, round(_SHARP_S * rate)),
        _LAG_PRICE / rate,
        rate,
        np.ascontiguousarray(around.spread),
        np.ascontiguousarray(around.time_spread),
    )
    clip = _summarise(limb_table)
    n = len(frames)
    flat = limb_table.reshape(n, N_LIMBS, -1)
    everywhere = np.array([np.log(max(len(ours) / rate, 0.5)), min(around.n_references, 6)])
    constants = np.broadcast_to(everywhere, (n, N_LIMBS, len(everywhere)))
    others = _describe_others(limb_table)
    marks = mark_findings(findings, len(ours))[frames]
    kind = np.broadcast_to(np.array([0.0, 1.0, 1.0, 2.0, 2.0])[None, :, None], (n, N_LIMBS, 1))
    body_flat = body_table.reshape(n, -1)
    seen = np.broadcast_to(body_flat[:, None], (n, N_LIMBS, body_flat.shape[1]))
    clips = np.broadcast_to(clip, (n, *clip.shape))
    limbs = np.concatenate([flat, clips, others, kind, constants, seen, marks[:, :N_LIMBS]], axis=2)
    ranked = [np.sort(limb_table[:, :, :, _PER_WINDOW.index(name)], axis=1).reshape(n, -1) for name in _SORTED]
    body = np.concatenate(
        [body_flat, *ranked, np.sort(clips, axis=1).reshape(n, -1), constants[:, 0], marks.reshape(n, -1)], axis=1
    )
    return Descriptors(frames, limbs.astype(np.float32), body.astype(np.float32))


def _summarise(limb_table: FloatArray) -> FloatArray:
    """(5, 4) what is usual of each limb in this performance: medians over all moments."""
    names = ("own", "best", "lag", "path")
    columns = [np.abs(limb_table[:, :, 0, _PER_WINDOW.index(name)]) for name in names]
    return np.stack([np.median(column, axis=0) for column in columns], axis=1)


def _describe_others(limb_table: FloatArray) -> FloatArray:
    """(N, 5, 2 * W) how far the other limbs are: the farthest and the middle one, windows of own-time deviation."""
    own = limb_table[:, :, :, _PER_WINDOW.index("own")]
    result = np.empty((len(own), N_LIMBS, 2 * own.shape[2]))
    for limb in range(N_LIMBS):
        others = np.delete(own, limb, axis=1)
        result[:, limb] = np.concatenate([others.max(axis=1), np.median(others, axis=1)], axis=1)
    return result


@njit(cache=True, nogil=True)
def _pool_limbs(
    squared: FloatArray, limb_of: np.ndarray, n_limbs: int, cap: float, common_cap: float
) -> tuple[FloatArray, FloatArray]:  # pragma: no cover - compiled
    """(T, L, K) mean squared chord of each limb, and (T, K) of the body with each limb's say limited."""
    n, n_lags, n_segments = squared.shape
    limbs = np.zeros((n, n_limbs, n_lags))
    common = np.zeros((n, n_lags))
    count = np.zeros(n_limbs)
    for s in range(n_segments):
        count[limb_of[s]] += 1.0
    for t in range(n):
        for k in range(n_lags):
            for s in range(n_segments):
                limbs[t, limb_of[s], k] += min(squared[t, k, s], cap) / count[limb_of[s]]
            for limb in range(n_limbs):
                common[t, k] += min(limbs[t, limb, k], common_cap) / n_limbs
    return limbs, common


@njit(cache=True, nogil=True)
def _accumulate(values: FloatArray) -> FloatArray:  # pragma: no cover - compiled
    total = np.zeros((values.shape[0] + 1, values.shape[1]))
    for t in range(values.shape[0]):
        for k in range(values.shape[1]):
            total[t + 1, k] = total[t, k] + values[t, k]
    return total


@njit(cache=True, nogil=True)
def _cover(squared: FloatArray) -> tuple[FloatArray, FloatArray]:  # pragma: no cover - compiled
    """Of (T, K) squared deviations: nearest moment of the reference to each of ours, and of ours to each of theirs."""
    n, n_lags = squared.shape
    center = n_lags // 2
    path, unreached = np.empty(n), np.empty(n)
    for t in range(n):
        least = np.inf
        for k in range(n_lags):
            least = min(least, squared[t, k])
        path[t] = least
        least = np.inf
        for k in range(n_lags):
            other = t + center - k
            if 0 <= other < n:
                least = min(least, squared[other, k])
        unreached[t] = least
    return path, unreached


@njit(cache=True, nogil=True)
def _fit_gain(
    ours: FloatArray,
    theirs: FloatArray,
    first: int,
    last: int,
    lag: int,
    limb: int,
    limb_of: np.ndarray,
    out: FloatArray,
) -> None:  # pragma: no cover - compiled
    """Into ``out``: gain, root mean square that a gain leaves, constant difference, spreads of theirs and ours."""
    n = len(theirs)
    count = last - first
    power, product, other, shift, segments = 0.0, 0.0, 0.0, 0.0, 0.0
    for s in range(len(limb_of)):
        if limb >= 0 and limb_of[s] != limb:
            continue
        segments += 1.0
        for axis in range(3):
            x, y, xx, xy, yy = 0.0, 0.0, 0.0, 0.0, 0.0
            for t in range(first, last):
                there = min(max(t + lag, 0), n - 1)
                a, b = theirs[there, s, axis], ours[t, s, axis]
                x += a
                y += b
                xx += a * a
                xy += a * b
                yy += b * b
            power += xx - x * x / count
            product += xy - x * y / count
            other += yy - y * y / count
            shift += (x - y) * (x - y) / (count * count)
    size = count * segments
    gain = product / max(power, 1e-4 * size)
    left = other - 2.0 * gain * product + gain * gain * power
    out[0] = min(max(gain, -1.0), 2.0)
    out[1] = np.sqrt(max(left, 0.0) / size)
    out[2] = np.sqrt(shift / segments)
    out[3] = np.sqrt(max(power, 0.0) / size)
    out[4] = np.sqrt(max(other, 0.0) / size)


@njit(cache=True, nogil=True)
def _find_lag(
    total: FloatArray, first: int, last: int, price: float, sharp: int, out: FloatArray
) -> int:  # pragma: no cover - compiled
    """Into ``out``: deviation at the same time, at the best lag, that lag in columns, and its clearness."""
    n_lags = total.shape[1]
    center = n_lags // 2
    count = last - first
    best, least = center, np.inf
    for k in range(n_lags):
        mean = (total[last, k] - total[first, k]) / count + price * abs(k - center)
        if mean < least:
            best, least = k, mean
    here = max((total[last, best] - total[first, best]) / count, 0.0)
    left = max((total[last, max(best - sharp, 0)] - total[first, max(best - sharp, 0)]) / count, 0.0)
    right_at = min(best + sharp, n_lags - 1)
    right = max((total[last, right_at] - total[first, right_at]) / count, 0.0)
    out[0] = np.sqrt(max((total[last, center] - total[first, center]) / count, 0.0))
    out[1] = np.sqrt(here)
    out[2] = best - center
    out[3] = 0.5 * (np.sqrt(left) + np.sqrt(right)) - np.sqrt(here)
    return best


@njit(cache=True, nogil=True)
def _mean(total: FloatArray, first: int, last: int, column: int) -> float:  # pragma: no cover - compiled
    return (total[last, column] - total[first, column]) / (last - first)


@njit(cache=True, nogil=True)
def _measure_speeds(motion: FloatArray, rate: float, limb_of: np.ndarray, n_limbs: int) -> FloatArray:
    """(T, L) rad/s."""  # pragma: no cover - compiled
    n = len(motion)
    speeds = np.zeros((n, n_limbs))
    count = np.zeros(n_limbs)
    for s in range(len(limb_of)):
        count[limb_of[s]] += 1.0
    for t in range(n):
        low, high = max(t - 1, 0), min(t + 1, n - 1)
        if high == low:
            continue
        for s in range(len(limb_of)):
            far = 0.0
            for axis in range(3):
                step = motion[high, s, axis] - motion[low, s, axis]
                far += step * step
            speeds[t, limb_of[s]] += np.sqrt(far) * rate / (high - low) / count[limb_of[s]]
    return speeds


@njit(cache=True, nogil=True)
def _describe(
    squared: FloatArray,
    common: FloatArray,
    ours: FloatArray,
    theirs: FloatArray,
    mirrored: FloatArray,
    judged: FloatArray,
    limb_of: np.ndarray,
    frames: np.ndarray,
    halves: np.ndarray,
    sharp: int,
    price: float,
    rate: float,
    spread: FloatArray,
    time_spread: FloatArray,
) -> tuple[FloatArray, FloatArray]:  # pragma: no cover - compiled
    """(N, L, W, 21) features of limbs and (N, W, 15) of the body, in the order of `_PER_WINDOW`."""
    n, n_limbs, n_lags = squared.shape
    n_windows = len(halves)
    limb_out = np.zeros((len(frames), n_limbs, n_windows, 21))
    body_out = np.zeros((len(frames), n_windows, 15))
    # Per frame: path, unreached, mirrored, speeds, spreads of limbs (0 to L - 1) and the body (L).
    rows = np.zeros((n, 7 * (n_limbs + 1)))
    width = n_limbs + 1
    theirs_speed = _measure_speeds(theirs, rate, limb_of, n_limbs)
    ours_speed = _measure_speeds(ours, rate, limb_of, n_limbs)
    count = np.zeros(n_limbs)
    for s in range(len(limb_of)):
        count[limb_of[s]] += 1.0
    for t in range(n):
        for s in range(len(limb_of)):
            limb = limb_of[s]
            far = 0.0
            for axis in range(3):
                step = ours[t, s, axis] - mirrored[t, s, axis]
                far += step * step
            rows[t, 2 * width + limb] += min(far, 4.0) / count[limb] * judged[t, s]
            rows[t, 5 * width + limb] += spread[t, s] / count[limb]
        for limb in range(n_limbs):
            rows[t, 3 * width + limb] = theirs_speed[t, limb]
            rows[t, 4 * width + limb] = ours_speed[t, limb]
            for block in range(2, 6):
                rows[t, block * width + n_limbs] += rows[t, block * width + limb] / n_limbs
        for limb in range(width):
            rows[t, 6 * width + limb] = time_spread[t]
    totals = np.zeros((n_limbs, n + 1, n_lags))
    for limb in range(n_limbs):
        path, unreached = _cover(squared[:, limb])
        rows[:, limb] = path
        rows[:, width + limb] = unreached
        totals[limb] = _accumulate(squared[:, limb])
    path, unreached = _cover(common)
    rows[:, n_limbs] = path
    rows[:, width + n_limbs] = unreached
    together = _accumulate(common)
    sums = _accumulate(rows)
    lagged, fit = np.zeros(4), np.zeros(5)
    for i in range(len(frames)):
        for w in range(n_windows):
            first, last = max(frames[i] - halves[w], 0), min(frames[i] + halves[w] + 1, n)
            body_at = _find_lag(together, first, last, price, sharp, lagged)
            out = body_out[i, w]
            body_lag = lagged[2] / rate
            out[0], out[1], out[2], out[3] = lagged[0], lagged[1], abs(body_lag), lagged[3]
            _fit_gain(ours, theirs, first, last, 0, -1, limb_of, fit)
            out[4], out[5] = fit[0], fit[1]
            _fit_gain(ours, theirs, first, last, body_at - n_lags // 2, -1, limb_of, fit)
            out[6], out[7] = fit[0], fit[1]
            out[8] = np.sqrt(max(_mean(sums, first, last, n_limbs), 0.0))
            out[9] = np.sqrt(max(_mean(sums, first, last, width + n_limbs), 0.0))
            out[10] = _mean(sums, first, last, 3 * width + n_limbs)
            out[11] = _mean(sums, first, last, 4 * width + n_limbs)
            out[12] = np.sqrt(max(_mean(sums, first, last, 2 * width + n_limbs), 0.0))
            out[13] = _mean(sums, first, last, 5 * width + n_limbs)
            out[14] = _mean(sums, first, last, 6 * width + n_limbs)
            for limb in range(n_limbs):
                out = limb_out[i, limb, w]
                at = _find_lag(totals[limb], first, last, price, sharp, lagged)
                out[0], out[1], out[2], out[3] = lagged[0], lagged[1], abs(lagged[2]) / rate, lagged[3]
                out[4] = np.sqrt(max(_mean(totals[limb], first, last, body_at), 0.0))
                out[5] = abs(lagged[2] / rate - body_lag)
                _fit_gain(ours, theirs, first, last, 0, limb, limb_of, fit)
                out[6], out[7], out[8], out[9], out[10] = fit[0], fit[1], fit[2], fit[3], fit[4]
                _fit_gain(ours, theirs, first, last, at - n_lags // 2, limb, limb_of, fit)
                out[11], out[12] = fit[0], fit[1]
                out[13] = np.sqrt(max(_mean(sums, first, last, limb), 0.0))
                out[14] = np.sqrt(max(_mean(sums, first, last, width + limb), 0.0))
                most = 0.0
                for t in range(first, last):
                    most = max(most, rows[t, width + limb])
                out[15] = np.sqrt(most)
                for block in range(2, 7):
                    mean = _mean(sums, first, last, block * width + limb)
                    out[14 + block] = np.sqrt(max(mean, 0.0)) if block == 2 else mean
    return limb_out, body_out
