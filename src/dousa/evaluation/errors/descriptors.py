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
from dousa.evaluation.alignment.dynamic_programming import follow_lag
from dousa.evaluation.errors.evidence import LAG_CHANGE, Evidence
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
_LAG = _PER_WINDOW.index("lag")
_SLIGHT = 0.03  # rad
_KERNEL = np.ones(9) / 9.0
_SORTED = ("own", "best", "at_body", "path", "left_by_gain", "gain", "lag_beside_body")


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


def describe_moments(
    evidence: Evidence, time_spread: FloatArray, n_references: int, findings: Sequence[Finding]
) -> Descriptors:
    """Describe a performance.

    Parameters
    ----------
    evidence : of the performance.
    time_spread : (T,) s, how much the timing of the takes of the reference differs there; 0 of one take.
    n_references : takes.
    findings : of the closed explanations, see `dousa.evaluation.errors.explain`.
    """
    deviations, rate = evidence.deviations, evidence.rate
    frames = np.arange(0, len(deviations.judged), choose_stride(rate))
    limb_table, body_table = _measure_windows(evidence, time_spread, frames)
    n = len(frames)
    clip = _summarise(limb_table)
    clips = np.broadcast_to(clip, (n, *clip.shape))
    length_s = max(len(deviations.judged) / rate, 0.5)
    constants = np.broadcast_to(np.array([np.log(length_s), min(n_references, 6)]), (n, N_LIMBS, 2))
    kind = np.broadcast_to(np.array([0.0, 1.0, 1.0, 2.0, 2.0])[None, :, None], (n, N_LIMBS, 1))
    marks = mark_findings(findings, len(deviations.judged))[frames]
    courses = _follow_lags(evidence)[frames]
    together = _compare_lags(limb_table, body_table)
    ranked = [np.sort(limb_table[:, :, :, _PER_WINDOW.index(name)], axis=1).reshape(n, -1) for name in _SORTED]
    limb_table[..., _LAG], body_table[..., _LAG] = np.abs(limb_table[..., _LAG]), np.abs(body_table[..., _LAG])
    body_flat = np.concatenate([body_table.reshape(n, -1), together[:, N_LIMBS], courses[:, N_LIMBS]], axis=1)
    seen = np.broadcast_to(body_flat[:, None], (n, N_LIMBS, body_flat.shape[1]))
    flat, others = limb_table.reshape(n, N_LIMBS, -1), _describe_others(limb_table)
    parts = [flat, clips, others, kind, constants, seen, marks, courses, together]
    limbs = np.concatenate([part[:, :N_LIMBS] for part in parts], axis=2)
    parts = [body_flat, *ranked, np.sort(clips, axis=1), constants[:, 0], marks, np.sort(courses[:, :N_LIMBS], axis=1)]
    body = np.concatenate([part.reshape(n, -1) for part in parts], axis=1)
    return Descriptors(frames, limbs.astype(np.float32), body.astype(np.float32))


def _measure_windows(
    evidence: Evidence, time_spread: FloatArray, frames: NDArray[np.intp]
) -> tuple[FloatArray, FloatArray]:
    """(N, 5, W, 21) and (N, W, 15), see `_describe`."""
    deviations, rate = evidence.deviations, evidence.rate
    reach = min(round(_REACH_S * rate), deviations.center)
    part = slice(deviations.center - reach, deviations.center + reach + 1)
    # What has no weight, or is never seen, is as it should be.
    counts: NDArray[np.bool_] = np.any(evidence.ratio > 0.0, axis=(0, 1), keepdims=True)[0, 0]
    squared, common = _pool_limbs(deviations.squared[:, part] * counts, LIMB_OF, N_LIMBS, _CAP, _CAP_IN_COMMON)
    mirrored = deviations.reference[:, MIRRORED_SEGMENTS, :] * np.array([-1.0, 1.0, 1.0])
    performance = np.where(counts[:, None], deviations.performance, deviations.reference)
    motions = (performance, deviations.reference, mirrored, deviations.spread, time_spread)
    ours, theirs, mirrored, spread, timing = (np.ascontiguousarray(values) for values in motions)
    judged = deviations.judged.astype(np.float64)
    rows = _collect_rows(squared, common, ours, theirs, mirrored, judged, LIMB_OF, rate, spread, timing)
    halves = np.array([max(1, round(0.5 * seconds * rate)) for seconds in _WINDOWS_S])
    sharp = max(1, round(_SHARP_S * rate))
    return _describe(squared, common, ours, theirs, rows, LIMB_OF, frames, halves, sharp, _LAG_PRICE / rate, rate)


def _compare_lags(limb_table: FloatArray, body_table: FloatArray) -> FloatArray:
    """(N, 6, 2 * W) of limbs and, last, the body: lag in the sense of the body's, and the share that a lag explains.

    Of the body the first is how much the limbs' lags agree in sense, each with the say of how clear it is.
    """
    own, best, lag = (limb_table[..., _PER_WINDOW.index(name)] for name in ("own", "best", "lag"))
    sense = np.sign(body_table[:, None, :, _LAG])
    clear = np.maximum(own - best, 0.0)
    agreed = (clear * np.sign(lag) * sense).sum(axis=1) / (clear.sum(axis=1) + _SLIGHT)
    explained = clear / (own + _SLIGHT)
    body_own, body_best = body_table[..., 0], body_table[..., 1]
    body = np.concatenate([agreed, np.maximum(body_own - body_best, 0.0) / (body_own + _SLIGHT)], axis=1)
    limbs = np.concatenate([lag * sense, explained], axis=2)
    return np.concatenate([limbs, body[:, None]], axis=1)


def _follow_lags(evidence: Evidence) -> FloatArray:
    """(T, 6, 4) of limbs and, last, the body along the cheapest course of lag: its size, its size beside the clip's
    usual lag, what it explains, and for how long it has one sense."""
    prices, change = evidence.lag_prices, LAG_CHANGE * 30.0 / evidence.rate
    result = np.empty((len(evidence.ordinary), N_LIMBS + 1, 4))
    for limb in range(N_LIMBS + 1):
        segments = np.flatnonzero(limb == LIMB_OF) if limb < N_LIMBS else np.arange(len(SEGMENTS))
        cost = evidence.ratio[:, :, segments].sum(axis=2)
        share = len(segments) / len(SEGMENTS)
        course = follow_lag(cost + share * prices, share * change).astype(np.intp)
        lag = (evidence.center - course) * evidence.deviations.step_s
        here = np.take_along_axis(cost, course[:, None], axis=1)[:, 0]
        explained = np.convolve(cost[:, evidence.center] - here, _KERNEL, mode="same")[: len(lag)] / len(segments)
        edges = np.concatenate([[True], np.sign(lag[1:]) != np.sign(lag[:-1])])
        run = np.cumsum(edges) - 1
        lasts = np.bincount(run)[run] * evidence.deviations.step_s
        result[:, limb] = np.stack([np.abs(lag), np.abs(lag - np.median(lag)), explained, lasts], axis=1)
    return result


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
    return int(best)


@njit(cache=True, nogil=True)
def _mean(total: FloatArray, first: int, last: int, column: int) -> float:  # pragma: no cover - compiled
    return float((total[last, column] - total[first, column]) / (last - first))


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
def _collect_rows(
    squared: FloatArray,
    common: FloatArray,
    ours: FloatArray,
    theirs: FloatArray,
    mirrored: FloatArray,
    judged: FloatArray,
    limb_of: np.ndarray,
    rate: float,
    spread: FloatArray,
    time_spread: FloatArray,
) -> FloatArray:  # pragma: no cover - compiled
    """(T, 7 * (L + 1)): path, unreached, mirrored, their and our speed, spreads of the limbs and, last, the body."""
    n, n_limbs = squared.shape[:2]
    width = n_limbs + 1
    rows = np.zeros((n, 7 * width))
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
        rows[t, 6 * width :] = time_spread[t]
    for limb in range(n_limbs):
        rows[:, limb], rows[:, width + limb] = _cover(squared[:, limb])
    rows[:, n_limbs], rows[:, width + n_limbs] = _cover(common)
    return rows


@njit(cache=True, nogil=True)
def _describe(
    squared: FloatArray,
    common: FloatArray,
    ours: FloatArray,
    theirs: FloatArray,
    rows: FloatArray,
    limb_of: np.ndarray,
    frames: np.ndarray,
    halves: np.ndarray,
    sharp: int,
    price: float,
    rate: float,
) -> tuple[FloatArray, FloatArray]:  # pragma: no cover - compiled
    """(N, L, W, 21) features of limbs and (N, W, 15) of the body, in the order of `_PER_WINDOW`."""
    n, n_limbs, n_lags = squared.shape
    width, center = n_limbs + 1, n_lags // 2
    limb_out = np.zeros((len(frames), n_limbs, len(halves), 21))
    body_out = np.zeros((len(frames), len(halves), 15))
    totals = np.zeros((n_limbs, n + 1, n_lags))
    for limb in range(n_limbs):
        totals[limb] = _accumulate(squared[:, limb])
    together, sums = _accumulate(common), _accumulate(rows)
    lagged, fit = np.zeros(4), np.zeros(5)
    for i in range(len(frames)):
        for w in range(len(halves)):
            first, last = max(frames[i] - halves[w], 0), min(frames[i] + halves[w] + 1, n)
            body_at = _find_lag(together, first, last, price, sharp, lagged)
            out = body_out[i, w]
            body_lag = lagged[2] / rate
            out[0], out[1], out[2], out[3] = lagged[0], lagged[1], body_lag, lagged[3]
            _fit_gain(ours, theirs, first, last, 0, -1, limb_of, fit)
            out[4:6] = fit[:2]
            _fit_gain(ours, theirs, first, last, body_at - center, -1, limb_of, fit)
            out[6:8] = fit[:2]
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
                out[0], out[1], out[2], out[3] = lagged[0], lagged[1], lagged[2] / rate, lagged[3]
                out[4] = np.sqrt(max(_mean(totals[limb], first, last, body_at), 0.0))
                out[5] = abs(lagged[2] / rate - body_lag)
                _fit_gain(ours, theirs, first, last, 0, limb, limb_of, fit)
                out[6:11] = fit
                _fit_gain(ours, theirs, first, last, at - center, limb, limb_of, fit)
                out[11:13] = fit[:2]
                out[13] = np.sqrt(max(_mean(sums, first, last, limb), 0.0))
                out[14] = np.sqrt(max(_mean(sums, first, last, width + limb), 0.0))
                out[15] = np.sqrt(rows[first:last, width + limb].max())
                out[16] = np.sqrt(max(_mean(sums, first, last, 2 * width + limb), 0.0))
                for block in range(3, 7):
                    out[14 + block] = _mean(sums, first, last, block * width + limb)
    return limb_out, body_out
