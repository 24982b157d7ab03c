"""Local alignment of a motion with itself: where it does again what it did before.

The same dynamic programme as Smith and Waterman's for molecules: along a repetition the score climbs, elsewhere
it falls back to 0. Steps are (1, 1), (2, 1) and (1, 2), so that a repetition may run up to twice as fast.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

__all__ = ["accumulate_likeness", "compare_stretches", "compute_gains", "find_ends", "trace_repeats"]

Matrix = NDArray[np.float32]


@njit(cache=True, nogil=True)
def _slide(
    above: NDArray[np.float64], below: NDArray[np.float64], similarity: Matrix, i: int, radius: int
) -> None:
    """Move the sums of the rows above and below on to row i; right of the diagonal only."""
    n = len(similarity)
    if i == 0:
        for k in range(1, min(n, radius + 1)):
            for j in range(n):
                below[j] += similarity[k, j]
        return
    gone, come = i - 1 - radius, i + radius
    for j in range(i + 1, n):
        above[j] += similarity[i - 1, j] - (similarity[gone, j] if gone >= 0 else 0.0)
        below[j] += (similarity[come, j] if come < n else 0.0) - similarity[i, j]


@njit(cache=True, nogil=True)
def compute_gains(similarity: Matrix, radius: int, noise: float, hopeless: float) -> Matrix:
    """How far every pair of frames stands out from the pairs before and after it, in either motion.

    Parameters
    ----------
    similarity : (n, n) of a motion with itself, 1 = equal.
    radius : how many pairs on either side.
    noise : 1 - similarity between takes of the same thing.
    hopeless : 1 - similarity beyond which a pair gains nothing.

    Returns
    -------
    (n, n) above the diagonal: logarithm of the contrast to the side that is more alike. A ridge stands out from
    both sides; the edge of a block, which two rests make, only from one.
    """
    n = len(similarity)
    gains = np.zeros((n, n), np.float32)
    above, below = np.zeros(n), np.zeros(n)
    for i in range(n):
        _slide(above, below, similarity, i, radius)
        n_above, n_below = min(i, radius), min(n - 1 - i, radius)
        left, right = 0.0, 0.0
        for j in range(max(0, i - radius), i):
            left += similarity[i, j]
        for j in range(i + 1, min(n, i + 1 + radius)):
            right += similarity[i, j]
        for j in range(i + 1, n):
            left += similarity[i, j - 1]
            right -= similarity[i, j]
            if j - 1 - radius >= 0:
                left -= similarity[i, j - 1 - radius]
            if j + radius < n:
                right += similarity[i, j + radius]
            n_left, n_right = min(j, radius), min(n - 1 - j, radius)
            here = 1.0 - similarity[i, j]
            beside = 1.0 - left / n_left
            if 2 * n_right > radius:
                beside = min(beside, 1.0 - right / n_right)
            ahead = 1.0 - below[j] / n_below
            if 2 * n_above > radius:
                ahead = min(ahead, 1.0 - above[j] / n_above)
            if here > hopeless:
                continue
            around = 0.5 * (max(beside, 0.0) + max(ahead, 0.0))
            gains[i, j] = np.log((around + noise) / (max(here, 0.0) + noise))
    return gains


@njit(cache=True, nogil=True)
def accumulate_likeness(
    similarity: Matrix,
    gains: Matrix,
    moving: NDArray[np.float64],
    min_lag: int,
    toll: float,
    tolerated: float,
    drop: float,
) -> tuple[Matrix, NDArray[np.uint8]]:
    """Scores of the best repetition that ends in each pair of frames.

    Parameters
    ----------
    similarity : (n, n) of a motion with itself, 1 = equal.
    gains : (n, n) of `compute_gains`.
    moving : (n,) 0 at rest to 1 in motion: at rest nothing is gained.
    min_lag : pairs nearer in time than this do not count.
    toll : taken off the gain of every pair.
    tolerated : 1 - similarity beyond which a pair costs extra.
    drop : a repetition ends when its score has fallen this far.

    Returns
    -------
    score : (n, n), 0 where nothing ends; only above the diagonal.
    step : (n, n) 0 start, 1 from (1, 1), 2 from (2, 1), 3 from (1, 2).
    """
    n = len(similarity)
    score = np.zeros((n, n), np.float32)
    step = np.zeros((n, n), np.uint8)
    summit = np.zeros((3, n), np.float32)  # best score along the path so far, of the last three rows
    for i in range(n):
        top = summit[i % 3]
        for j in range(n):
            top[j] = 0.0
        for j in range(i + min_lag, n):
            gain = moving[i] * moving[j] * gains[i, j] - toll
            away = 1.0 - similarity[i, j]
            if away > tolerated:
                gain -= min((away - tolerated) / tolerated, 2.0)
            best, way, peak = 0.0, 0, 0.0
            if i >= 1:
                best, way, peak = score[i - 1, j - 1], 1, summit[(i - 1) % 3, j - 1]
                if i >= 2 and score[i - 2, j - 1] - toll > best:
                    best, way, peak = score[i - 2, j - 1] - toll, 2, summit[(i - 2) % 3, j - 1]
                if score[i - 1, j - 2] - toll > best:
                    best, way, peak = score[i - 1, j - 2] - toll, 3, summit[(i - 1) % 3, j - 2]
                if best <= 0.0:
                    best, way, peak = 0.0, 0, 0.0
            best += gain
            if best > 0.0 and best > peak - drop:
                score[i, j] = best
                step[i, j] = way
                top[j] = max(peak, best)
    return score, step


@njit(cache=True, nogil=True)
def find_ends(score: Matrix, least: float) -> NDArray[np.int64]:
    """Pairs of frames where a repetition may end: none beside them is higher, and no step goes up from there.

    Parameters
    ----------
    score : of `accumulate_likeness`.
    least : height.

    Returns
    -------
    (E, 2) in order of rows.
    """
    n = len(score)
    ends = np.empty((0, 2), np.int64)
    for fills in range(2):
        found = 0
        for i in range(n):
            for j in range(i + 1, n):
                here = score[i, j]
                if here < least or score[i, j - 1] > here:
                    continue
                # The later frame is the larger one: behind the last column nothing follows.
                if j + 1 < n and (score[i, j + 1] > here or score[i + 1, j + 1] > here):
                    continue
                if fills:
                    ends[found, 0], ends[found, 1] = i, j
                found += 1
        if not fills:
            ends = np.empty((found, 2), np.int64)
    return ends


@njit(cache=True, nogil=True)
def trace_repeats(
    score: Matrix, step: NDArray[np.uint8], ends: NDArray[np.int64], width: int, shortest: int, least: float
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Walk repetitions back from their ends, one after the other, unless better ones have been along there.

    Parameters
    ----------
    score, step : of `accumulate_likeness`.
    ends : (E, 2) pairs of frames, best first.
    width : pairs so near to a repetition that has been found belong to it, frames.
    shortest : frames.
    least : score that has to be left where one runs into another that has been found.

    Returns
    -------
    pairs : (K, 2) frames of all repetitions, each from its end to its start.
    counts : (R,) pairs of each.
    """
    n = len(score)
    taken = np.zeros((n, n), np.bool_)
    pairs = np.empty((4 * n, 2), np.int32)
    counts = np.empty(len(ends), np.int32)
    total, found = 0, 0
    for end in range(len(ends)):
        a, b = ends[end, 0], ends[end, 1]
        last = score[a, b]
        if taken[a, b]:
            continue
        if total + n > len(pairs):
            more = np.empty((2 * len(pairs), 2), np.int32)
            for k in range(total):
                more[k, 0], more[k, 1] = pairs[k, 0], pairs[k, 1]
            pairs = more
        count = 0
        while not taken[a, b]:
            pairs[total + count, 0], pairs[total + count, 1] = a, b
            count += 1
            way = step[a, b]
            if way == 0:
                break
            a -= 2 if way == 2 else 1
            b -= 2 if way == 3 else 1
        if taken[a, b] and last - score[a, b] < least:
            continue
        for k in range(total, total + count):
            for near in range(max(0, pairs[k, 1] - width), min(n, pairs[k, 1] + width + 1)):
                taken[pairs[k, 0], near] = True
        if ends[end, 0] - pairs[total + count - 1, 0] + 1 < shortest:
            continue
        counts[found] = count
        found += 1
        total += count
    return pairs[:total], counts[:found]


@njit(cache=True, nogil=True)
def compare_stretches(similarity: Matrix, cuts: NDArray[np.int64], slack: float) -> tuple[Matrix, Matrix]:
    """Distance of every stretch of a motion from every other, each warped to the other, and within each.

    Parameters
    ----------
    similarity : (n, n) of a motion with itself, 1 = equal.
    cuts : (F + 1,) frames, from 0 to n.
    slack : stretches whose lengths differ by a larger factor are not compared.

    Returns
    -------
    apart : (F, F) mean of 1 - similarity along the best path; infinite where not compared.
    within : (F, 1) mean of 1 - similarity between all frames of the stretch.
    """
    n_stretches = len(cuts) - 1
    apart = np.full((n_stretches, n_stretches), np.inf, np.float32)
    within = np.zeros((n_stretches, 1), np.float32)
    for p in range(n_stretches):
        a, rows = cuts[p], cuts[p + 1] - cuts[p]
        apart[p, p] = 0.0
        inside = 0.0
        for i in range(rows):
            for j in range(rows):
                inside += 1.0 - similarity[a + i, a + j]
        within[p, 0] = inside / (rows * rows)
        for q in range(p + 1, n_stretches):
            b, columns = cuts[q], cuts[q + 1] - cuts[q]
            if rows > slack * columns or columns > slack * rows:
                continue
            # A diagonal step counts twice, so that every path weighs rows + columns in all.
            before, now = np.zeros(columns), np.zeros(columns)
            for i in range(rows):
                for j in range(columns):
                    cost = max(0.0, 1.0 - similarity[a + i, b + j])
                    if i == 0 and j == 0:
                        now[j] = 2.0 * cost
                    elif i == 0:
                        now[j] = now[j - 1] + cost
                    elif j == 0:
                        now[j] = before[j] + cost
                    else:
                        now[j] = min(before[j - 1] + 2.0 * cost, min(before[j], now[j - 1]) + cost)
                before, now = now, before
            apart[p, q] = apart[q, p] = before[columns - 1] / (rows + columns)
    return apart, within
