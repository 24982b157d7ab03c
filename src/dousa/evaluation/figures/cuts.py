"""Where to cut a dance: what a cut is worth at every moment, and the cuts that are worth most together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import FloatArray
from dousa.evaluation.alignment.correspondence import compute_correlation_matrix
from dousa.evaluation.alignment.dynamic_programming import accumulate_likeness, compute_gains, find_ends, trace_repeats


@dataclass(frozen=True, slots=True)
class Coarse:
    """A motion at the coarse rate."""

    segments: FloatArray  # (n, 9, 3) each the mean of `block` frames
    block: int  # frames of the motion to a coarse one
    rate: float  # Hz
    similarity: NDArray[np.float32]  # (n, n) float32 self-correlation
    speed: FloatArray  # (n,) rad/s, change of posture, root mean square over the segments


@dataclass(frozen=True, slots=True)
class Repeat:
    """A stretch of a motion that is done again."""

    earlier: NDArray[np.intp]  # (K,) coarse frames in order of time
    later: NDArray[np.intp]  # (K,) coarse frames that resemble them
    score: float  # height that the alignment climbed to


def coarsen(segments: FloatArray, frame_rate: float, *, most_rate: float = 10.0, most_poses: int = 3000) -> Coarse:
    """Reduce a motion to a coarse rate and compute its self-correlation matrix.

    Parameters
    ----------
    segments : (T, 9, 3), at least one frame.
    frame_rate : Hz.
    most_rate : Hz, the coarse rate at most.
    most_poses : coarse poses of a very long take: 36 MB a matrix.
    """
    block = max(1, int(np.ceil(frame_rate / most_rate - 1e-9)), -(-len(segments) // most_poses))
    starts = np.arange(0, len(segments), block)
    means = np.add.reduceat(segments, starts, axis=0)
    lengths = np.linalg.norm(means, axis=2, keepdims=True)
    means = means / np.where(lengths > 1e-9, lengths, 1.0)
    rate = frame_rate / block
    similarity = compute_correlation_matrix(means, means)
    # Away from two poses earlier; turning on the spot is no change of posture.
    away = np.maximum(1.0 - np.diagonal(similarity, 2).astype(np.float64), 0.0)
    speed = 0.5 * rate * np.sqrt(2.0 * away)
    speed = np.pad(speed, 1, mode="edge") if len(speed) else np.zeros(len(means))
    return Coarse(means, block, rate, similarity, speed)


def find_repeats(
    coarse: Coarse,
    min_s: float,
    *,
    background_s: float = 1.0,
    noise: float = 0.005,
    toll: float = 0.45,
    tolerated: float = 0.05,
    drop_s: float = 1.5,
    moving_speed: float = 0.2,
    least_gain: float = 0.45,
    near_s: float = 0.4,
) -> tuple[Repeat, ...]:
    """Find all stretches that are repeated, the clearest first.

    Parameters
    ----------
    coarse : the motion.
    min_s : s, the shortest stretch and the shortest lag.
    background_s : s around a pair of frames that a repetition has to stand out from. This and the following
        thresholds were tuned on synthetic dances and on the recordings that are not held out.
    noise : 1 - S between two takes of the same pose by one person: 6 degrees a segment.
    toll : taken off the gain of every pair of frames.
    tolerated : 1 - S beyond which a pair costs extra: 18 degrees a segment.
    drop_s : s of tolls by which the score may fall before a repetition ends.
    moving_speed : rad/s over all segments from which on a person is not at rest.
    least_gain : of a repetition, mean over its pairs.
    near_s : s; repetitions whose lags differ by less are one.
    """
    rate, n = coarse.rate, len(coarse.segments)
    shortest = max(2, round(0.8 * min_s * rate))
    if n < 2 * shortest:
        return ()
    radius, width = max(1, round(background_s * rate)), max(1, round(near_s * rate))
    moving = np.clip(coarse.speed / moving_speed, 0.0, 1.0)
    gains = compute_gains(coarse.similarity, radius, noise, 4.0 * tolerated)
    score, step = accumulate_likeness(coarse.similarity, gains, moving, shortest, toll, tolerated, drop_s * rate * toll)
    least = least_gain * min_s * rate
    ends = find_ends(score, least)
    ends = ends[np.argsort(-score[ends[:, 0], ends[:, 1]], kind="stable")]
    lines = trace_repeats(score, step, ends, width, shortest, least)
    return tuple(Repeat(line[::-1, 0], line[::-1, 1], float(score[line[0, 0], line[0, 1]])) for line in lines)


_NOVELTY_WORTH, _REST_WORTH = 0.2, 0.25


def rate_cuts(coarse: Coarse, repeats: Sequence[Repeat], speed: FloatArray) -> FloatArray:
    """Rate a cut before each coarse frame of a dance, given its repeats and the speed (T,) rad/s of all its frames.

    Returns (n,): about 1 where a cut is sure, below 0 where repetitions or long rests speak against it.
    """
    slow = np.minimum.reduceat(speed, np.arange(0, len(speed), coarse.block))
    typical = float(np.quantile(slow, 0.75))
    rest = np.exp(-slow / (0.3 * typical)) if typical > 1e-6 else np.zeros(len(slow))
    own = _NOVELTY_WORTH * _compute_novelty(coarse) + _REST_WORTH * rest
    worth = _share_between(own, repeats) + _rate_ends(coarse, repeats)
    for start, end in _find_long_rests(coarse):
        worth[start:end] = -1.0
        worth[[k for k in (start, end) if k < len(worth)]] = 1.0
    return np.minimum(worth, 1.0)


def _compute_novelty(coarse: Coarse, *, novelty_s: float = 1.5) -> FloatArray:
    """(n,) 0 to 1, how much the motion after each coarse frame differs from the one before (Foote 2000)."""
    # novelty_s: half a side of the checkerboard
    half = max(1, round(novelty_s * coarse.rate))
    n = len(coarse.similarity)
    side = np.arange(-half, half) + 0.5
    bell = np.exp(-0.5 * (side / (0.5 * half)) ** 2) * np.sign(side)
    kernel = np.outer(bell, bell)
    padded = np.pad(coarse.similarity, half, mode="edge")
    row, column = padded.strides
    views = np.lib.stride_tricks.as_strided(
        padded, (n, 2 * half, 2 * half), (row + column, row, column), writeable=False
    )
    novelty = np.maximum(np.einsum("nab,ab->n", views, kernel), 0.0)
    top = float(novelty.max())
    return np.asarray(novelty / top if top > 1e-9 else novelty)


def _share_between(worth: FloatArray, repeats: Sequence[Repeat]) -> FloatArray:
    """Frames that are danced again take over half of each other's worth, so that equal figures are cut equally."""
    if not repeats:
        return worth
    earlier = np.concatenate([repeat.earlier for repeat in repeats])
    later = np.concatenate([repeat.later for repeat in repeats])
    n = len(worth)
    total = np.bincount(earlier, worth[later], n) + np.bincount(later, worth[earlier], n)
    count = np.bincount(earlier, minlength=n) + np.bincount(later, minlength=n)
    return np.where(count > 0, 0.5 * worth + 0.5 * total / np.maximum(count, 1.0), worth)


def _rate_ends(
    coarse: Coarse,
    repeats: Sequence[Repeat],
    *,
    spread_s: float = 0.15,
    sure_s: float = 1.0,
    inside_s: float = 0.5,
    through_cost: float = 1.0,
    outvoted: float = 0.4,
    edge_s: float = 0.3,
) -> FloatArray:
    """(n,) what a cut is worth because repetitions begin or end there; less where others run on."""
    # spread_s: uncertainty of where a repetition begins; sure_s: a repetition counts in full from so long a one on
    # that gains 1 at every pair; inside_s: further than this from its ends a repetition speaks against a cut;
    # outvoted: what one end beyond the first says against that; edge_s: a repetition that ends this near to the end of
    # the take ended because the take did
    n = len(coarse.similarity)
    ends, through = np.zeros(n + 1), np.zeros(n + 1)
    edge, inside = edge_s * coarse.rate, round(inside_s * coarse.rate)
    for repeat in repeats:
        sure = min(1.0, repeat.score / (sure_s * coarse.rate))
        cut_off = repeat.later[-1] + 1 >= n - edge
        ends[repeat.earlier[0]] += sure
        ends[repeat.later[0]] += sure
        ends[repeat.earlier[-1] + 1] += 0.5 * sure if cut_off else sure
        ends[repeat.later[-1] + 1] += sure
        # A repetition that overlaps itself is a rhythm, which is cut at every beat.
        if repeat.later[0] > repeat.earlier[-1]:
            for line in (repeat.earlier, repeat.later):
                through[line[0] + inside : max(0, line[-1] + 1 - inside)] += sure
    spread = spread_s * coarse.rate
    reach = int(np.ceil(4.0 * spread))
    bell = np.exp(-0.5 * (np.arange(-reach, reach + 1) / spread) ** 2)
    near = np.convolve(ends, bell)[reach : reach + n]
    against = through[:n] / (1.0 + through[:n] + outvoted * np.maximum(near - 1.0, 0.0))
    return np.asarray(np.minimum(near, 1.0) - through_cost * against)


def _find_long_rests(coarse: Coarse, *, long_rest_s: float = 3.0, at_rest: float = 0.1) -> list[tuple[int, int]]:
    """Start and end of stretches without motion."""
    # long_rest_s: standing still for so long is a figure of its own; at_rest: rad/s over all segments
    still = np.concatenate([[False], coarse.speed < at_rest, [False]])
    edges = np.flatnonzero(still[1:] != still[:-1]).tolist()
    least = long_rest_s * coarse.rate
    return [(a, b) for a, b in zip(edges[::2], edges[1::2], strict=True) if b - a >= least]


def choose_cuts(
    worth: FloatArray,
    rate: float,
    min_s: float,
    max_s: float,
    *,
    cut_cost: float = 0.5,
    comfort: float = 0.6,
    short_cost: float = 0.15,
) -> list[int]:
    """Choose the cuts with the largest sum of ratings, by dynamic programming.

    Parameters
    ----------
    worth : (n,) of a cut before each coarse frame.
    rate : Hz, coarse.
    min_s, max_s : s, shortest and longest piece.
    cut_cost : least rating of a cut; a rest or a change of motion alone is below it, the start of a repetition rates 1.
        This and the following costs were tuned on synthetic dances and on the recordings that are not held out.
    comfort : share of the longest furi from which on its length costs something.
    short_cost : of the shortest furi, nothing from twice its length on: steps of a walk go in pairs.

    Returns
    -------
    Coarse frames of the cuts, from 0 to n.
    """
    n = len(worth)
    shortest, longest = max(1, int(np.ceil(min_s * rate - 1e-9))), max(2, int(max_s * rate))
    lengths = np.arange(shortest, longest + 1)
    over = (lengths / rate - comfort * max_s) / ((1.0 - comfort) * max_s)
    under = 2.0 - lengths / (rate * min_s)
    costs = np.maximum(over, 0.0) ** 2 + short_cost * np.maximum(under, 0.0) ** 2
    best, before = np.full(n + 1, -np.inf), np.zeros(n + 1, np.intp)
    best[0] = 0.0
    for end in range(shortest, n + 1):
        some = lengths[: max(0, end - shortest + 1)]
        totals = best[end - some[some <= end]] - costs[: (some <= end).sum()]
        choice = int(totals.argmax())
        before[end] = end - lengths[choice]
        best[end] = totals[choice] + (worth[end] - cut_cost if end < n else 0.0)
    if not np.isfinite(best[n]):
        return [0, n]
    cuts = [n]
    while cuts[-1]:
        cuts.append(int(before[cuts[-1]]))
    return cuts[::-1]


def compute_speed(segments: FloatArray, rate: float, *, smooth_s: float = 0.25) -> FloatArray:
    """Compute the speed (T,) rad/s of segments (T, 9, 3), root mean square over them, averaged over smooth_s."""
    if len(segments) < 2:
        return np.zeros(len(segments))
    steps = np.diff(segments, axis=0)
    speed = rate * np.sqrt(np.einsum("tsk,tsk->t", steps, steps) / segments.shape[1])
    speed = np.concatenate([speed[:1], speed])
    half = round(0.5 * smooth_s * rate)
    sums = np.concatenate([[0.0], np.cumsum(speed)])
    frames = np.arange(len(speed))
    low, high = np.maximum(frames - half, 0), np.minimum(frames + half + 1, len(speed))
    return np.asarray((sums[high] - sums[low]) / (high - low))


def snap_cuts(cuts: Sequence[int], coarse: Coarse, speed: FloatArray, min_s: float) -> list[int]:
    """Move cuts to the moments of least motion nearby.

    Cuts are coarse frames, from 0 to n; the speed is (T,) rad/s of all frames of the dance; no piece becomes shorter
    than min_s. Returns frames of the cuts, from 0 to T.
    """
    shortest = int(np.ceil(min_s * coarse.rate * coarse.block))
    frames = [*(cut * coarse.block for cut in cuts[:-1]), len(speed)]
    for k in range(1, len(frames) - 1):
        low = max(frames[k] - coarse.block, frames[k - 1] + shortest)
        high = min(frames[k] + coarse.block, frames[k + 1] - shortest)
        if low <= high:
            frames[k] = low + int(speed[low : high + 1].argmin())
    return frames
