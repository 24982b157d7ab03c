"""Dynamic programming over two motions, compiled: every way to find which moment belongs to which.

Three families of recurrences; the slow ones to compare with are in tests/oracles:

- one value a frame: `extend_lines` and `follow_lines` (the reference frame: straight lines, jumps, pauses),
  `follow_lag` (a lag whose changes cost), `switch_on` (on or off). Costs (T, K), the cheapest course traced back.
- dynamic time warping: `warp` and `trace_back` in a band of two motions, `compare_stretches` between the parts of one.
- local alignment of a motion with itself: `compute_gains`, `accumulate_likeness`, `find_ends`, `trace_repeats`.

They share no inner loop: each has other steps, and their order of comparison decides between equal prices.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from dousa.arrays import FloatArray, IndexArray

Matrix = NDArray[np.float32]
_DIAGONAL, _ROW_BEFORE, _COLUMN_BEFORE, _HERE = 0, 1, 2, 3
_FAR = 1e300  # infinite, by definition: above any price


def pack(segments: FloatArray, shares: FloatArray) -> np.ndarray:
    """(T, 27) float32: z, x and y of the nine segments, times (9,) or (T, 9) shares of them."""
    parts = np.empty((len(segments), 3, segments.shape[1]), np.float32)
    for row, axis in enumerate((2, 0, 1)):
        np.multiply(segments[:, :, axis], shares, out=parts[:, row], casting="same_kind")
    return parts.reshape(len(segments), 3 * segments.shape[1])


# Contraction to fused multiply-add is the only liberty taken; nan and inf stay what they are.
@njit(cache=True, nogil=True, fastmath={"contract"})
def correlate_row(pose: Matrix, b: Matrix, low: int, high: int, out: Matrix) -> None:  # pragma: no cover - compiled
    """|sum h conj(h')| + sum y y' of a pose (27,) and columns low to high of b (27, U), into out[low:high]."""
    # Unsigned, so that the compiler knows no index counts from the end: else it does not vectorise.
    for u in range(np.uint64(low), np.uint64(high)):
        along = across = up = np.float32(0.0)
        for p in range(9):
            along += pose[p] * b[p, u]
            along += pose[9 + p] * b[9 + p, u]
            across += pose[9 + p] * b[p, u]
            across -= pose[p] * b[9 + p, u]
            up += pose[18 + p] * b[18 + p, u]
        out[u] = min(math.sqrt(along * along + across * across) + up, np.float32(1.0))


@njit(cache=True, nogil=True)
def correlate_rows(a: Matrix, b: Matrix, out: Matrix, start: int, stop: int) -> None:  # pragma: no cover - compiled
    """Rows start to stop of the matrix of a (T, 27) and b (27, U), packed, into out (T, U)."""
    for i in range(start, stop):
        correlate_row(a[i], b, 0, b.shape[1], out[i])


@njit(cache=True, nogil=True)
def extend_lines(
    cost: FloatArray,
    best: FloatArray,
    outside_costs: FloatArray,
    jump: float,
    pause: float,
    outside: float,
    origin: np.ndarray,
    ended: np.ndarray,
) -> None:  # pragma: no cover - compiled
    """Carry the cheapest sequences of lines on by frames that are new; before the first all of ``best`` is infinite.

    Parameters
    ----------
    cost : (n, U) of the new performance frames against the reference frames.
    best : (U,) price of the cheapest sequence of lines that ends at each reference frame; in place.
    outside_costs : (2,) price of being before the lines so far, and of being after them; in place.
    jump : price of leaving a line for any other.
    pause : price of staying at a reference frame, or of leaving one out, for one frame.
    outside : price a frame of being before the first or after the last line.
    origin : (n, U) out, reference frame that each is reached from; -1 from before the lines.
    ended : (n,) out, reference frame after which the lines ended at this frame; -2 if they did before.
    """
    n_reference = len(best)
    now = np.empty(n_reference)
    for t in range(len(cost)):
        cheapest = 0
        for r in range(1, n_reference):
            if best[r] < best[cheapest]:
                cheapest = r
        outside_costs[1] += outside
        ended[t] = -2
        if best[cheapest] + outside < outside_costs[1]:
            outside_costs[1] = best[cheapest] + outside
            ended[t] = cheapest
        for r in range(n_reference):
            value = best[cheapest] + jump
            source = cheapest
            if r >= 1 and best[r - 1] <= value:
                value = best[r - 1]
                source = r - 1
            if best[r] + pause < value:
                value = best[r] + pause
                source = r
            if r >= 2 and best[r - 2] + pause < value:
                value = best[r - 2] + pause
                source = r - 2
            if outside_costs[0] < value:
                value = outside_costs[0]
                source = -1
            now[r] = value + cost[t, r]
            origin[t, r] = source
        for r in range(n_reference):
            best[r] = now[r]
        outside_costs[0] += outside


@njit(cache=True, nogil=True)
def follow_lines(
    cost: FloatArray, jump: float, pause: float, outside: float
) -> np.ndarray:  # pragma: no cover - compiled
    """Find the reference frame of every performance frame on the cheapest sequence of lines.

    The cost is (T, U) of performance frame against reference frame, 0 to 1; prices are those of `extend_lines`. Returns
    (T,) reference frames; -1 before the first and after the last line.
    """
    n_frames, n_reference = cost.shape
    best = np.full(n_reference, np.inf)
    outside_costs = np.zeros(2)
    origin = np.empty((n_frames, n_reference), np.int32)
    ended = np.empty(n_frames, np.int32)
    extend_lines(cost, best, outside_costs, jump, pause, outside, origin, ended)
    return trace_lines(best, outside_costs, origin, ended)


@njit(cache=True, nogil=True)
def trace_lines(
    best: FloatArray, outside_costs: FloatArray, origin: np.ndarray, ended: np.ndarray
) -> np.ndarray:  # pragma: no cover - compiled
    """Trace the reference frames (n,) of the last n frames on the cheapest sequence of lines; -1 without a line.

    Parameters
    ----------
    best, outside_costs, origin, ended : what `extend_lines` has made of these frames.
    """
    path = np.full(len(origin), -1, np.int32)
    r, t = np.argmin(best), len(origin) - 1
    if outside_costs[1] < best[r]:
        while t >= 0 and ended[t] == -2:
            t -= 1
        if t < 0:
            return path
        r = ended[t]
        t -= 1
    while t >= 0 and r >= 0:
        path[t] = r
        r = origin[t, r]
        t -= 1
    return path


@njit(cache=True, nogil=True)
def follow_lag(cost: FloatArray, slope: float) -> np.ndarray:  # pragma: no cover - compiled
    """Find the cheapest course, (T,) columns, through (T, K) costs; a change by one column costs ``slope``."""
    n_frames, n_lags = cost.shape
    origin = np.empty((n_frames, n_lags), np.int16)
    best = cost[0].astype(np.float64)
    source = np.empty(n_lags, np.int16)
    for t in range(1, n_frames):
        for k in range(n_lags):
            source[k] = k
        for k in range(1, n_lags):
            if best[k - 1] + slope < best[k]:
                best[k] = best[k - 1] + slope
                source[k] = source[k - 1]
        for k in range(n_lags - 2, -1, -1):
            if best[k + 1] + slope < best[k]:
                best[k] = best[k + 1] + slope
                source[k] = source[k + 1]
        for k in range(n_lags):
            origin[t, k] = source[k]
            best[k] += cost[t, k]
    course = np.empty(n_frames, np.int32)
    k = 0
    for other in range(1, n_lags):
        if best[other] < best[k]:
            k = other
    for t in range(n_frames - 1, -1, -1):
        course[t] = k
        if t > 0:
            k = origin[t, k]
    return course


@njit(cache=True, nogil=True)
def switch_on(score: FloatArray, price: float) -> np.ndarray:  # pragma: no cover - compiled
    """(T,) the on/off sequence with the largest sum of scores while on, less ``price`` for every change."""
    n_frames = len(score)
    starts = np.zeros(n_frames, np.bool_)  # on at t comes from off before
    stops = np.zeros(n_frames, np.bool_)  # off at t comes from on before
    off, on = 0.0, score[0] - price
    for t in range(1, n_frames):
        starts[t] = off - price > on
        stops[t] = on - price > off
        was_off = off
        off = max(on - price, off)
        on = max(was_off - price, on) + score[t]
    state = on - price > off
    result = np.zeros(n_frames, np.bool_)
    for t in range(n_frames - 1, -1, -1):
        result[t] = state
        state = (t > 0 and not starts[t]) if state else stops[t]
    return result


@njit(cache=True, nogil=True)
def warp(
    a: Matrix,
    b: Matrix,
    low: IndexArray,
    high: IndexArray,
    first: IndexArray,
    skip: float,
    origin: NDArray[np.uint8],
) -> tuple[int, int]:  # pragma: no cover - compiled
    """Find the cheapest path through a band: fill origin and return the last cell.

    Parameters
    ----------
    a : (T, 27) packed postures, divided by the sum of weights.
    b : (27, U) packed postures.
    low, high : (T,) columns of the band in each row, half-open, both ascending; neighbours overlap.
    first : (T,) place of the band's first cell of each row in ``origin``.
    skip : price of a frame left out at either end; very large if the path goes from corner to corner.
    origin : (cells,) uint8.
    """
    n_rows, n_columns = len(a), b.shape[1]
    similar = np.empty(n_columns, np.float32)
    before = np.full(n_columns + 1, _FAR)  # one to the right: index u + 1, so that u - 1 exists for u = 0
    now = np.full(n_columns + 1, _FAR)
    price, last_row, last_column = _FAR, 0, 0
    for t in range(n_rows):
        start, stop = low[t], high[t]
        correlate_row(a[t], b, start, stop, similar)
        now[start] = _FAR
        left = _FAR
        place = first[t]
        for u in range(start, stop):
            best, source = before[u], _DIAGONAL
            if before[u + 1] < best:
                best, source = before[u + 1], _ROW_BEFORE
            if (t == 0 or u == 0) and (t + u) * skip <= best:
                best, source = (t + u) * skip, _HERE
            if left < best:
                best, source = left, _COLUMN_BEFORE
            left = best + (1.0 - similar[u])
            now[u + 1] = left
            origin[place] = source
            place += 1
        if t == n_rows - 1:
            for u in range(start, stop):
                if now[u + 1] + (n_columns - 1 - u) * skip <= price:
                    price, last_row, last_column = now[u + 1] + (n_columns - 1 - u) * skip, t, u
        elif stop == n_columns and left + (n_rows - 1 - t) * skip < price:
            price, last_row, last_column = left + (n_rows - 1 - t) * skip, t, stop - 1
        if t + 1 < n_rows:  # cells of the next row's band that this row did not reach
            for u in range(stop, high[t + 1]):
                now[u + 1] = _FAR
        before, now = now, before
    return last_row, last_column


@njit(cache=True, nogil=True)
def trace_back(
    origin: NDArray[np.uint8], low: IndexArray, first: IndexArray, row: int, column: int, path: IndexArray
) -> int:  # pragma: no cover - compiled
    """Write the path that ends in a cell, last cell first, into path (n, 2); returns its length."""
    n = 0
    while True:
        path[n, 0], path[n, 1] = row, column
        n += 1
        source = origin[first[row] + column - low[row]]
        if source == _HERE:
            return n
        if source != _COLUMN_BEFORE:
            row -= 1
        if source != _ROW_BEFORE:
            column -= 1


@njit(cache=True, nogil=True)
def _slide(above: NDArray[np.float64], below: NDArray[np.float64], similarity: Matrix, i: int, radius: int) -> None:
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
    """Compute the contrast of every pair of frames to the pairs before and after it, in either motion.

    The similarity is (n, n) of a motion with itself, 1 = equal; radius is the number of pairs on either side, noise is
    1 - similarity between takes of the same thing, and beyond hopeless a pair gains nothing. Returns (n, n) above the
    diagonal: logarithm of the contrast to the more similar side. A ridge stands out from both sides; the edge of a
    block, which two rests make, only from one.
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
    """Compute the score of the best repetition that ends in each pair of frames.

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
    """Find pairs of frames where a repetition may end: no neighbour is higher, and no step goes up from there.

    Takes the score of `accumulate_likeness` and the least height; returns (E, 2) in order of rows.
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
    """Compute the distance of every stretch of a motion from every other, warped to it, and within each.

    The similarity is (n, n) of a motion with itself, cuts are (F + 1,) frames from 0 to n; stretches whose lengths
    differ by a factor above slack are not compared. Returns the mean of 1 - similarity (F, F) along the best path,
    infinite where not compared, and (F, 1) between all frames of the stretch.
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
