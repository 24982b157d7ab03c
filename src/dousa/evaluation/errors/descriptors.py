"""What is seen around a moment of a performance, limb by limb and in common: the features of the learned judge.

Of every limb and of the whole body, in windows of half a second to two: how far it is from the reference at the same
time and at the best other time, that lag and how clear it is, the gain and what a gain leaves over, whether it is
on the reference's path and whether all of that path is reached (coverage both ways), whether it does what the other
side should do, how much the reference moves there, and how much takes of the reference differ there. The same of the
whole stretch out of tolerance in which a moment lies, however long it is.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import FloatArray, iterate_blocks
from dousa.evaluation.alignment.dynamic_programming import follow_lag, switch_on
from dousa.evaluation.errors.deviations import Deviations
from dousa.evaluation.errors.evidence import LAG_CHANGE, Evidence
from dousa.evaluation.posture.posture import LIMBS, MIRRORED_SEGMENTS, SEGMENTS
from dousa.kernels import kernel
from dousa.motion.runs import find_runs

N_LIMBS = len(LIMBS)
LIMB_OF = np.array([next(i for i, limb in enumerate(LIMBS.values()) if s in limb) for s in range(len(SEGMENTS))])
"""Limb of each segment."""

_LIMB_SEGMENTS = tuple(np.array(limb) for limb in LIMBS.values())
_MEMBERS = np.array([*(np.arange(N_LIMBS)[:, None] == LIMB_OF), np.ones(len(SEGMENTS), bool)])  # of limbs and the body


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
    "clear",
    "off",
    "missing",
    "unexplained",
)
_LAG = _PER_WINDOW.index("lag")
_WINDOWS_S, _N_OF_BODY = (0.5, 1.0, 2.0), 19  # s around a moment, and values of the whole body in each
_USUAL = [_PER_WINDOW.index(name) for name in ("own", "best", "lag", "path")]
_SLIGHT = 0.03  # rad, so that nothing is divided by 0: the judge of lab/training/train_judge.py is fitted with it
_FLIP = np.array([1.0, 1.0, -1.0])  # mirror image by definition: z, the body's own left in `Deviations`, negated
_SORTED = ("own", "best", "at_body", "path", "left_by_gain", "gain", "lag_beside_body")


@dataclass(frozen=True, slots=True, eq=False)
class Descriptors:
    """Features of moments."""

    frames: NDArray[np.intp]  # (N,) working frames
    limbs: NDArray[np.float32]  # (N, 5, F) float32, of each limb
    body: NDArray[np.float32]  # (N, G) float32, of all limbs in common
    usual: FloatArray  # (N, 5, 4) of each limb, of which the medians over all moments are usual in this performance


def choose_stride(rate: float, *, moments_a_second: float = 15.0) -> int:
    """Choose the number of working frames from one of the described moments, about 15 a second, to the next."""
    return max(1, round(rate / moments_a_second))


def describe_moments(
    evidence: Evidence,
    time_spread: FloatArray,
    n_references: int,
    *,
    wanted: slice = slice(None),
    before: FloatArray | None = None,
    at_once: int = 1024,
) -> Iterator[Descriptors]:
    """Describe a performance, some moments at a time.

    Parameters
    ----------
    evidence : of the performance.
    time_spread : (T,) s, how much the timing of the takes of the reference differs there; 0 of one take.
    n_references : takes.
    wanted : moments to describe.
    before : (n, 5, 4) ``usual`` of earlier moments, which count too in what is usual of this performance.
    at_once : moments.
    """
    deviations, rate = evidence.deviations, evidence.rate
    frames = np.arange(0, len(deviations.judged), choose_stride(rate))[wanted]
    if not len(frames):
        return
    limb_table = np.empty((len(frames), N_LIMBS, len(_WINDOWS_S), len(_PER_WINDOW)), np.float32)
    body_table = np.empty((len(frames), len(_WINDOWS_S), _N_OF_BODY), np.float32)
    for some in iterate_blocks(len(frames), at_once):
        limb_table[some], body_table[some] = _measure_windows(evidence, time_spread, frames[some])
    usual = np.abs(limb_table[:, :, 0, _USUAL])
    clip = np.median(usual if before is None else np.concatenate([before, usual]), axis=0)
    length_s = max(len(deviations.judged) / rate, 0.5)
    constants = np.array([np.log(length_s), min(n_references, 6)])
    courses = _follow_lags(evidence)
    stretches = _describe_stretches(evidence, courses[:, :, -1])[frames]
    courses = np.concatenate([courses[frames], stretches], axis=2)
    for some in iterate_blocks(len(frames), at_once):
        limbs, body = _join_features(limb_table[some], body_table[some], clip, constants, courses[some])
        yield Descriptors(frames[some], limbs, body, usual[some])


def join_descriptors(descriptors: Iterable[Descriptors]) -> Descriptors:
    """Join the features of moments one after the other."""
    blocks = [(one.frames, one.limbs, one.body, one.usual) for one in descriptors]
    return Descriptors(*(np.concatenate(arrays) for arrays in zip(*blocks, strict=True)))


def _join_features(
    limb_table: NDArray[np.float32],
    body_table: NDArray[np.float32],
    clip: FloatArray,
    constants: FloatArray,
    courses: FloatArray,
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """(N, 5, F) and (N, G) features of some moments; ``clip`` (5, 4) and ``constants`` (2,) are of the performance."""
    n = len(limb_table)
    clips = np.broadcast_to(clip, (n, *clip.shape))
    always = np.broadcast_to(constants, (n, N_LIMBS, len(constants)))
    kind = np.broadcast_to(np.array([0.0, 1.0, 1.0, 2.0, 2.0])[None, :, None], (n, N_LIMBS, 1))
    together = _compare_lags(limb_table, body_table)
    ranked = [np.sort(limb_table[:, :, :, _PER_WINDOW.index(name)], axis=1).reshape(n, -1) for name in _SORTED]
    others = _describe_others(limb_table)
    for lags in (limb_table[..., _LAG], body_table[..., _LAG]):
        np.abs(lags, out=lags)
    body_flat = np.concatenate([body_table.reshape(n, -1), together[:, N_LIMBS], courses[:, N_LIMBS]], axis=1)
    seen = np.broadcast_to(body_flat[:, None], (n, N_LIMBS, body_flat.shape[1]))
    table = limb_table.reshape(n, N_LIMBS, -1)
    parts: list[NDArray[Any]] = [table, clips, others, kind, always, seen, courses, together]
    limbs = np.concatenate([part[:, :N_LIMBS] for part in parts], axis=2, dtype=np.float32, casting="same_kind")
    parts = [body_flat, *ranked, np.sort(clips, axis=1), always[:, 0], np.sort(courses[:, :N_LIMBS], axis=1)]
    body = np.concatenate([part.reshape(n, -1) for part in parts], axis=1, dtype=np.float32, casting="same_kind")
    return limbs, body


def _measure_windows(
    evidence: Evidence,
    time_spread: FloatArray,
    frames: NDArray[np.intp],
    *,
    reach_s: float = 0.8,
    sharp_s: float = 0.1,
    lateness_price: float = 2e-3,
    farthest: float = 4.0,
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """(N, 5, W, 25) features of limbs, in the order of `_PER_WINDOW`, and (N, W, 19) of the body."""
    # reach_s: lags that are looked at; lateness_price: rad^2 a second: of lags as good as each other the nearest;
    # farthest: squared chord of opposite directions
    deviations, rate = evidence.deviations, evidence.rate
    reach = min(round(reach_s * rate), deviations.center)
    halves = [max(1, round(0.5 * seconds * rate)) for seconds in _WINDOWS_S]
    # The frames around these moments are all that matters to them.
    first = max(int(frames[0]) - max(halves) - reach - 1, 0)
    frames, here = frames - first, slice(first, int(frames[-1]) + max(halves) + reach + 2)
    deviations, time_spread, off = deviations.cut(here), time_spread[here], evidence.ordinary[here]
    squared = deviations.squared[:, deviations.center - reach : deviations.center + reach + 1]
    counts = evidence.ratio.find_weighing()
    ours, theirs = _take_weighing(evidence, deviations)
    windows = [_Window(frames, half, len(ours)) for half in halves]
    lags = _Lags(max(1, round(sharp_s * rate)), lateness_price / rate)
    limbs = np.zeros((len(frames), N_LIMBS, len(windows), len(_PER_WINDOW)), np.float32)
    body = np.zeros((len(frames), len(windows), _N_OF_BODY), np.float32)

    pooled = _pool_limbs(squared, counts)
    common = _pool_body(pooled)
    covered = [_cover(common)]
    total = _accumulate(common)
    at = np.empty((len(windows), len(frames), N_LIMBS + 1), np.intp)
    for w, window in enumerate(windows):
        body[:, w, :4], at[w, :, N_LIMBS] = lags.find(total, window)
    for number, limb in enumerate(pooled):
        covered.insert(number, _cover(limb))
        total = _accumulate(limb)
        for w, window in enumerate(windows):
            limbs[:, number, w, :4], at[w, :, number] = lags.find(total, window)
            limbs[:, number, w, 4] = np.sqrt(np.maximum(window.average(total, at[w, :, N_LIMBS]), 0.0))
    body[..., 2] /= rate
    limbs[..., 2] /= rate
    limbs[..., 5] = np.abs(limbs[..., 2] - body[:, None, :, 2])

    far = ((ours - theirs[:, MIRRORED_SEGMENTS, :] * _FLIP) ** 2).sum(axis=2)
    blocks = [
        np.array([path for path, _ in covered]).T,
        np.array([unreached for _, unreached in covered]).T,
        _by_limb(np.minimum(far, farthest) * deviations.judged),
        _by_limb(_measure_speeds(theirs, rate)),
        _by_limb(_measure_speeds(ours, rate)),
        _by_limb(deviations.spread),
        np.repeat(time_spread[:, None], N_LIMBS + 1, axis=1),
        _by_limb(np.maximum(deviations.beyond - deviations.apart, 0.0)),
        _by_limb(off),
    ]
    total = _accumulate(np.concatenate(blocks, axis=1))
    for w, window in enumerate(windows):
        means = window.average(total).reshape(len(frames), len(blocks), N_LIMBS + 1)
        means[:, :3] = np.sqrt(np.maximum(means[:, :3], 0.0))
        fit, late = (window.fit_gains(ours, theirs, shift) for shift in (np.zeros_like(at[w]), at[w] - reach))
        body[:, w, 4:6], body[:, w, 6:8] = fit[:, N_LIMBS, :2], late[:, N_LIMBS, :2]
        body[:, w, 8:17] = means[:, (0, 1, 3, 4, 2, 5, 6, 7, 8), N_LIMBS]
        shrunk = _describe_shrinking(fit)
        limbs[:, :, w, 23:], body[:, w, 17:] = shrunk[:, :N_LIMBS], shrunk[:, N_LIMBS]
        limbs[:, :, w, 6:11], limbs[:, :, w, 11:13] = fit[:, :N_LIMBS], late[:, :N_LIMBS, :2]
        limbs[:, :, w, 13:15] = means[:, :2, :N_LIMBS].transpose(0, 2, 1)
        limbs[:, :, w, 15] = np.sqrt(window.find_largest(blocks[1])[:, :N_LIMBS])
        limbs[:, :, w, 16:23] = means[:, 2:, :N_LIMBS].transpose(0, 2, 1)
    return limbs, body


def _take_weighing(evidence: Evidence, deviations: Deviations) -> tuple[FloatArray, FloatArray]:
    """(T, 9, 3) performance and reference; what has no weight, or is never seen, is as it should be."""
    counts, theirs = evidence.ratio.find_weighing(), np.ascontiguousarray(deviations.reference)
    return np.ascontiguousarray(np.where(counts[:, None], deviations.performance, theirs)), theirs


class _Window:
    """Frames around moments: (N,) of ``frames``, so many on either side, fewer at the ends."""

    def __init__(self, frames: NDArray[np.intp], half: int, n_frames: int) -> None:
        self.frames, self.half = frames, half
        self.first, self.last = np.maximum(frames - half, 0), np.minimum(frames + half + 1, n_frames)

    def average(self, total: FloatArray, columns: NDArray[np.intp] | None = None) -> FloatArray:
        """(N, K) means of values whose sums (T + 1, K) are given; (N,) where each moment has its column."""
        count = self.last - self.first
        if columns is not None:
            return np.asarray((total[self.last, columns] - total[self.first, columns]) / count)
        return np.asarray((total[self.last] - total[self.first]) / count[:, None])

    def find_largest(self, values: FloatArray) -> FloatArray:
        """(N, K) largest of values (T, K) that are 0 or above."""
        padded = np.pad(values, ((self.half, self.half), (0, 0)))
        largest = np.zeros((len(self.frames), values.shape[1]))
        for step in range(2 * self.half + 1):
            np.maximum(largest, padded[self.frames + step], out=largest)
        return largest

    def fit_gains(self, ours: FloatArray, theirs: FloatArray, lags: NDArray[np.intp]) -> FloatArray:
        """(N, 6, 5) of limbs and, last, the body, at lags (N, 6) in frames, see `_fit_gains`."""
        fits = np.empty((*lags.shape, 5))
        _fit_gains(ours, theirs, self.first, self.last, np.ascontiguousarray(lags), _MEMBERS, fits)
        return fits


@dataclass(frozen=True, slots=True)
class _Lags:
    """How the lag is found that leaves least."""

    sharp: int  # columns
    price: float  # rad^2 a column

    def find(self, total: FloatArray, window: _Window) -> tuple[FloatArray, NDArray[np.intp]]:
        """(N, 4) deviation at the same time, at the best lag, that lag in columns, and its clearness; and its column.

        Sums (T + 1, K) are of squared deviations at each lag.
        """
        means = window.average(total)
        center, rows = total.shape[1] // 2, np.arange(len(means))
        best = (means + self.price * np.abs(np.arange(total.shape[1]) - center)).argmin(axis=1)
        beside = np.maximum(best - self.sharp, 0), np.minimum(best + self.sharp, total.shape[1] - 1)
        own, here, left, right = (np.sqrt(np.maximum(means[rows, at], 0.0)) for at in (center, best, *beside))
        return np.stack([own, here, best - center, 0.5 * (left + right) - here], axis=1), best


def _compare_lags(limb_table: NDArray[np.float32], body_table: NDArray[np.float32]) -> FloatArray:
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


def _follow_lags(evidence: Evidence, *, beside_s: tuple[float, float] = (1.0, 2.0)) -> FloatArray:
    """(T, 6, 9) of limbs and, last, the body along the cheapest course of lag.

    Its size; its size beside the clip's usual lag, beside the lag a while before and after (twice), beside the clip's
    trend, and beside the body's; what it explains; for how long it has one sense; and what it leaves. People who dance
    as they please drift; an error comes and goes.
    """
    prices, change = evidence.lag_prices, LAG_CHANGE * 30.0 / evidence.rate
    count, step_s = len(evidence.ordinary), evidence.deviations.step_s
    result = np.empty((count, N_LIMBS + 1, 9))
    trend: FloatArray = np.zeros(count)
    together: FloatArray = trend
    groups, ratio = [*_LIMB_SEGMENTS, np.arange(len(SEGMENTS))], evidence.ratio
    same = ratio.at_lag(np.full(count, evidence.center))
    for limb in range(N_LIMBS, -1, -1):
        segments, share = groups[limb], len(groups[limb]) / len(SEGMENTS)
        course = evidence.course
        if limb < N_LIMBS:
            course = follow_lag(ratio.sum_up(segments) + share * prices, share * change).astype(np.intp)
        lag: FloatArray = np.asarray((evidence.center - course) * step_s, np.float64)
        if limb == N_LIMBS:
            together, trend = lag, _find_trend(lag)
        here = ratio.at_lag(course)[:, segments].mean(axis=1)
        explained = np.convolve(same[:, segments].mean(axis=1) - here, np.ones(9) / 9.0, mode="same")[:count]
        edges = np.concatenate([[True], np.sign(lag[1:]) != np.sign(lag[:-1])])
        run = np.cumsum(edges) - 1
        lasts = np.bincount(run)[run] * step_s
        around = [_look_beside(lag, round(seconds * evidence.rate)) for seconds in beside_s]
        beside = np.stack([np.full(count, np.median(lag)), *around, trend, together])
        result[:, limb] = np.stack([np.abs(lag), *np.abs(lag - beside), explained, lasts, here], axis=1)
    return result


def _describe_stretches(
    evidence: Evidence, late: FloatArray, *, change: float = 8.0, beside_s: float = 0.25
) -> FloatArray:
    """(T, 6, 6) of the stretch out of tolerance in which each frame lies, of limbs and, last, the body; else 0.

    How long it lasts, how far it is off, the share of that which lag leaves (``late`` (T, 6)), the range that a gain
    makes missing, what that leaves, and how large the range of the reference is.
    """
    # change: price of a beginning or an end, in frames of 1/30 s of a segment at its tolerance
    rate, count = evidence.rate, len(evidence.ordinary)
    result = np.zeros((count, N_LIMBS + 1, 6))
    deviations, beside = evidence.deviations, round(beside_s * rate)
    ours, theirs = _take_weighing(evidence, deviations)
    off = _by_limb(evidence.ordinary)
    far = np.stack([evidence.ordinary[:, limb].max(axis=1) for limb in _LIMB_SEGMENTS], axis=1)
    for group, members in enumerate(_MEMBERS):
        # Of the body as a whole half of the tolerance is much.
        over = far[:, group] - 1.0 if group < N_LIMBS else 3.0 * (off[:, group] - 0.5)
        runs = find_runs(switch_on(over * (30.0 / rate), change))
        if not len(runs):
            continue
        first, last = np.maximum(runs[:, 0] - beside, 0), np.minimum(runs[:, 1] + beside, count)
        fits = np.empty((len(runs), 1, 5))
        _fit_gains(ours, theirs, first, last, np.zeros((len(runs), 1), np.intp), members[None], fits)
        shrunk = _describe_shrinking(fits)[:, 0]
        for (start, end), gain, fit in zip(runs.tolist(), shrunk, fits[:, 0], strict=True):
            here = off[start:end, group].mean()
            left = late[start:end, group].mean() / (here + _SLIGHT)
            result[start:end, group] = (end - start) / rate, here, left, *gain, fit[3]
    return result


def _describe_shrinking(fits: FloatArray) -> FloatArray:
    """(..., 2) rad of spread that a gain makes missing, and the share of what is left beside it, of `_fit_gains`."""
    missing, left = (1.0 - fits[..., 0]) * fits[..., 3], fits[..., 1]
    return np.stack([missing, left / (left + np.abs(missing) + _SLIGHT)], axis=-1)


def _look_beside(values: FloatArray, reach: int) -> FloatArray:
    """Mean of the values so many frames before and after, those at the ends held."""
    frames = np.arange(len(values))
    before, after = values[np.maximum(frames - reach, 0)], values[np.minimum(frames + reach, len(values) - 1)]
    return 0.5 * (before + after)


def _find_trend(values: FloatArray, *, trend_rounds: int = 8) -> FloatArray:
    """Straight line through most of the values: least absolute differences, by weights."""
    x = np.linspace(-1.0, 1.0, len(values)) if len(values) > 1 else np.zeros(1)
    weights = np.ones(len(values))
    slope, middle = 0.0, float(np.median(values))
    for _ in range(trend_rounds):
        total = weights.sum()
        mean_x, mean_y = (weights * x).sum() / total, (weights * values).sum() / total
        slope = (weights * (x - mean_x) * (values - mean_y)).sum() / max((weights * (x - mean_x) ** 2).sum(), 1e-9)
        middle = mean_y - slope * mean_x
        weights = 1.0 / np.maximum(np.abs(values - middle - slope * x), _SLIGHT)
    return middle + slope * x


def _describe_others(limb_table: NDArray[np.float32]) -> FloatArray:
    """(N, 5, 2 * W) how far the other limbs are: the farthest and the middle one, windows of own-time deviation."""
    own = limb_table[:, :, :, _PER_WINDOW.index("own")]
    result = np.empty((len(own), N_LIMBS, 2 * own.shape[2]))
    for limb in range(N_LIMBS):
        others = np.delete(own, limb, axis=1)
        result[:, limb] = np.concatenate([others.max(axis=1), np.median(others, axis=1)], axis=1)
    return result


def _pool_limbs(squared: NDArray[np.float32], counts: NDArray[np.bool_], *, cap: float = 1.3) -> FloatArray:
    """(L, T, K) mean squared chord of the segments of each limb that count, of (T, K, 9)."""
    # cap: squared chord of 70 deg: further away says no more
    shares = _MEMBERS[:N_LIMBS] / _MEMBERS[:N_LIMBS].sum(axis=1, keepdims=True)
    pooled = np.minimum(squared * counts, cap) @ shares.T
    return np.ascontiguousarray(np.moveaxis(pooled, 2, 0))


def _pool_body(limbs: FloatArray, *, most: float = 0.19) -> FloatArray:
    """(T, K) mean of the limbs, each with a limited say."""
    # most: of 25 deg: one limb alone does not decide the body's lag
    return np.asarray(np.minimum(limbs, most).mean(axis=0))


def _accumulate(values: FloatArray) -> FloatArray:
    """Sums along the last axis but one, from none."""
    total = np.zeros((*values.shape[:-2], values.shape[-2] + 1, values.shape[-1]))
    np.cumsum(values, axis=-2, out=total[..., 1:, :])
    return total


def _measure_speeds(motion: FloatArray, rate: float) -> FloatArray:
    """(T, 9) rad/s."""
    frames = np.arange(len(motion))
    before, after = np.maximum(frames - 1, 0), np.minimum(frames + 1, len(motion) - 1)
    steps = np.linalg.norm(motion[after] - motion[before], axis=2)
    speeds: FloatArray = steps * rate / np.maximum(after - before, 1)[:, None]
    return speeds


def _by_limb(values: FloatArray) -> FloatArray:
    """(T, L + 1) means over the segments of each limb, and of the limbs, of (T, 9)."""
    limbs = np.stack([values[:, list(limb)].mean(axis=1) for limb in LIMBS.values()], axis=1)
    return np.concatenate([limbs, limbs.mean(axis=1, keepdims=True)], axis=1)


def _cover(squared: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Of (T, K) squared deviations: nearest moment of the reference to each of ours, and of ours to each of theirs."""
    n, n_lags = squared.shape
    unreached = np.full(n, np.inf)
    for k in range(n_lags):
        shift = n_lags // 2 - k  # of the frame of ours that meets a moment of theirs in this column
        theirs, ours = (slice(max(step, 0), max(n + min(step, 0), 0)) for step in (-shift, shift))
        np.minimum(unreached[theirs], squared[ours, k], out=unreached[theirs])
    return squared.min(axis=1), unreached


@kernel
def _fit_gains(
    ours: FloatArray,
    theirs: FloatArray,
    firsts: NDArray[np.intp],
    lasts: NDArray[np.intp],
    lags: NDArray[np.intp],
    members: NDArray[np.bool_],
    fits: FloatArray,
) -> None:  # pragma: no cover - compiled
    """Into ``fits`` (N, G, 5) gain, root mean square that it leaves, constant difference, spreads of theirs and ours.

    ``lags`` are (N, G) in frames, ``members`` (G, 9) the segments of each group.
    """
    n = len(theirs)
    for i in range(len(firsts)):
        first, last = firsts[i], lasts[i]
        count = last - first
        for group in range(len(members)):
            lag, out = lags[i, group], fits[i, group]
            power, product, other, shift, segments = 0.0, 0.0, 0.0, 0.0, 0.0
            for s in range(9):
                if not members[group, s]:
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
            out[1] = math.sqrt(max(left, 0.0) / size)
            out[2] = math.sqrt(shift / segments)
            out[3] = math.sqrt(max(power, 0.0) / size)
            out[4] = math.sqrt(max(other, 0.0) / size)
