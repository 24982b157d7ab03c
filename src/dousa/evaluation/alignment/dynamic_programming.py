"""Dynamic programming over two motions: every way to find which moment belongs to which.

Four recurrences, compiled; the slow ones to compare with are in tests/oracles. What prepares them and what traces their
courses back is NumPy and plain Python:

- `follow_states`: the cheapest course through the states of each frame, where a step to the next state or a leap to any
  other costs. `follow_lag`, `follow_classes` and `switch_on` are this one, with one of the prices infinite.
- `extend_lines` and `trace_lines`: reference frames on straight lines, with jumps, pauses and an outside.
- `warp` and `trace_back`: dynamic time warping in a band of two motions; `compare_stretches` between parts of one.
- `accumulate_likeness`, `find_ends`, `trace_repeats`: local alignment of a motion with itself.

Their steps differ, and so does the order of comparison, which decides between equal prices.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import FloatArray, IndexArray
from dousa.kernels import kernel, part

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
@part(fastmath={"contract"})
def _correlate(pose: Matrix, b: Matrix, low: int, high: int, out: Matrix) -> None:  # pragma: no cover - compiled
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
        likeness = np.float32(math.sqrt(along * along + across * across) + up)
        out[u] = likeness if likeness < np.float32(1.0) else np.float32(1.0)


@kernel
def correlate_rows(a: Matrix, b: Matrix, out: Matrix, start: int, stop: int) -> None:  # pragma: no cover - compiled
    """Rows start to stop of the matrix of a (T, 27) and b (27, U), packed, into out (T, U)."""
    for i in range(start, stop):
        _correlate(a[i], b, 0, b.shape[1], out[i])


@kernel
def _follow(
    cost: FloatArray,
    slope: float,
    leap: float,
    best: FloatArray,
    origin: NDArray[np.int16],
    course: NDArray[np.int32],
) -> None:  # pragma: no cover - compiled
    """Do `follow_states`; room: (K,) least sums that end in each state, and (T, K) where each comes from."""
    n_frames, n_states = cost.shape
    for k in range(n_states):
        best[k] = cost[0, k]
    for t in range(1, n_frames):
        source = origin[t]
        top = 0
        for k in range(n_states):
            source[k] = k
            if best[k] < best[top]:
                top = k
        leapt = best[top] + leap
        for k in range(1, n_states):
            if best[k - 1] + slope < best[k]:
                best[k] = best[k - 1] + slope
                source[k] = source[k - 1]
        for k in range(n_states - 2, -1, -1):
            if best[k + 1] + slope < best[k]:
                best[k] = best[k + 1] + slope
                source[k] = source[k + 1]
        for k in range(n_states):
            if leapt < best[k]:
                best[k] = leapt
                source[k] = top
            best[k] += cost[t, k]
    course[n_frames - 1] = best.argmin()
    for t in range(n_frames - 1, 0, -1):
        course[t - 1] = origin[t, course[t]]


def follow_states(cost: FloatArray, slope: float, leap: float) -> NDArray[np.int32]:
    """Find the cheapest course (T,) through the states of (T, K) costs, T at least 1.

    A step to the next state costs ``slope``, as many as one likes from frame to frame; a leap to any state ``leap``.
    """
    course = np.empty(len(cost), np.int32)
    room = np.empty(cost.shape[1]), np.empty(cost.shape, np.int16)
    _follow(np.ascontiguousarray(cost), slope, leap, *room, course)
    return course


def follow_lag(cost: FloatArray, slope: float) -> NDArray[np.int32]:
    """Find the cheapest course (T,) of lag through (T, K) costs; a change by one column costs ``slope``."""
    return follow_states(cost, float(slope), math.inf)


def follow_classes(scores: FloatArray, change: float) -> NDArray[np.int32]:
    """Find the classes (N,) with the largest sum of (N, C) scores; every change of class costs."""
    return follow_states(-scores, math.inf, float(change)) if len(scores) else np.empty(0, np.int32)


def switch_on(score: FloatArray, price: float) -> NDArray[np.bool_]:
    """Find the on/off sequence (T,) with the largest sum of scores while on, less ``price`` for every change.

    Before the first frame and after the last it is off.
    """
    scores = np.zeros((len(score) + 2, 2))
    scores[[0, -1], 1] = -math.inf
    scores[1:-1, 1] = score
    on: NDArray[np.bool_] = follow_classes(scores, price)[1:-1] == 1
    return on


_LINE, _PAUSE, _SKIP, _ELSEWHERE = 0, 1, 2, 3  # by definition


@kernel
def _extend_lines(
    cost: FloatArray,
    best: FloatArray,
    outside_costs: FloatArray,
    prices: FloatArray,
    now: FloatArray,
    steps: NDArray[np.uint8],
    others: NDArray[np.int32],
    ended: NDArray[np.int32],
) -> None:  # pragma: no cover - compiled
    """Do `extend_lines`: prices are jump, pause and outside, ``now`` (U,) is room, ``steps`` (n, U) is not packed."""
    n_reference = len(best)
    jump, pause, outside = prices[0], prices[1], prices[2]
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
        jumped, before = best[cheapest] + jump, outside_costs[0]
        others[t] = -1 if before < jumped else cheapest
        row, step = cost[t], steps[t]
        for r in range(n_reference):
            value, way = jumped, _ELSEWHERE
            if r >= 1 and best[r - 1] <= value:
                value, way = best[r - 1], _LINE
            if best[r] + pause < value:
                value, way = best[r] + pause, _PAUSE
            if r >= 2 and best[r - 2] + pause < value:
                value, way = best[r - 2] + pause, _SKIP
            if before < value:
                value, way = before, _ELSEWHERE
            now[r] = value + row[r]
            step[r] = way
        for r in range(n_reference):
            best[r] = now[r]
        outside_costs[0] += outside


Steps = tuple[NDArray[np.uint8], NDArray[np.int32], NDArray[np.int32]]
"""How frames were reached on lines: (n, U / 4) the ways, four to a byte; (n,) where jumps came from, -1 from before the
lines; (n,) the reference frame after which the lines ended at this frame, -2 if they did before."""


def extend_lines(
    cost: FloatArray, best: FloatArray, outside_costs: FloatArray, jump: float, pause: float, outside: float
) -> Steps:
    """Carry the cheapest sequences of lines on by frames that are new; before the first all of ``best`` is infinite.

    Parameters
    ----------
    cost : (n, U) of the new performance frames against the reference frames.
    best : (U,) price of the cheapest sequence of lines that ends at each reference frame; in place.
    outside_costs : (2,) price of being before the lines so far, and of being after them; in place.
    jump : price of leaving a line for any other.
    pause : price of staying at a reference frame, or of leaving one out, for one frame.
    outside : price a frame of being before the first or after the last line.
    """
    n_frames, n_reference = cost.shape
    ways = np.zeros((n_frames, -(-n_reference // 4) * 4), np.uint8)
    others, ended = np.empty(n_frames, np.int32), np.empty(n_frames, np.int32)
    prices = np.array([jump, pause, outside], np.float64)
    _extend_lines(cost, best, outside_costs, prices, np.empty(n_reference), ways, others, ended)
    packed = ways[:, 0::4] | ways[:, 1::4] << 2 | ways[:, 2::4] << 4 | ways[:, 3::4] << 6
    return packed, others, ended


def join_steps(steps: Sequence[Steps], kept: int = 0) -> Steps:
    """Join the steps of frames one after the other; 0 keeps all frames, else so many of the last."""
    ways, others, ended = (np.concatenate(one)[-kept:] for one in zip(*steps, strict=True))
    return ways, others, ended


def trace_lines(best: FloatArray, outside_costs: FloatArray, steps: Steps) -> NDArray[np.int32]:
    """Trace the reference frames (n,) of the last n frames on the cheapest sequence of lines; -1 without a line.

    Parameters
    ----------
    best, outside_costs, steps : what `extend_lines` has made of these frames.
    """
    ways, others, ended = steps
    path = np.full(len(others), -1, np.int32)
    place, t = int(best.argmin()), len(others) - 1
    if outside_costs[1] < best[place]:
        left = np.flatnonzero(ended != -2)
        if not len(left):
            return path
        place, t = int(ended[left[-1]]), int(left[-1]) - 1
    while t >= 0 and place >= 0:
        path[t] = place
        way = int(ways[t, place >> 2]) >> 2 * (place & 3) & 3
        place = int(others[t]) if way == _ELSEWHERE else place - (1, 0, 2)[way]
        t -= 1
    return path


@kernel
def _warp(
    a: Matrix,
    b: Matrix,
    low: IndexArray,
    high: IndexArray,
    first: IndexArray,
    skip: float,
    origin: NDArray[np.uint8],
    similar: Matrix,
    rows: FloatArray,
    last: IndexArray,
) -> None:  # pragma: no cover - compiled
    """Do `warp`: ``similar`` (U,) and ``rows`` (2, U + 1), all far, are room; the last cell goes into ``last`` (2,)."""
    n_rows, n_columns = len(a), b.shape[1]
    price = _FAR
    for t in range(n_rows):
        # One to the right: index u + 1, so that u - 1 exists for u = 0.
        before, now = rows[t % 2], rows[1 - t % 2]
        start, stop = low[t], high[t]
        _correlate(a[t], b, start, stop, similar)
        now[start] = _FAR
        left = _FAR
        cells = origin[first[t] :]
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
            cells[u - start] = source
        if t == n_rows - 1:
            for u in range(start, stop):
                if now[u + 1] + (n_columns - 1 - u) * skip <= price:
                    price = now[u + 1] + (n_columns - 1 - u) * skip
                    last[0], last[1] = t, u
        elif stop == n_columns and left + (n_rows - 1 - t) * skip < price:
            price = left + (n_rows - 1 - t) * skip
            last[0], last[1] = t, stop - 1
        if t + 1 < n_rows:  # cells of the next row's band that this row did not reach
            for u in range(stop, high[t + 1]):
                now[u + 1] = _FAR


def warp(
    a: Matrix, b: Matrix, low: IndexArray, high: IndexArray, first: IndexArray, skip: float, origin: NDArray[np.uint8]
) -> tuple[int, int]:
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
    last = np.zeros(2, np.intp)
    rows = np.full((2, b.shape[1] + 1), _FAR)
    _warp(a, b, low, high, first, float(skip), origin, np.empty(b.shape[1], np.float32), rows, last)
    return int(last[0]), int(last[1])


def trace_back(origin: NDArray[np.uint8], low: IndexArray, first: IndexArray, row: int, column: int) -> IndexArray:
    """Trace the path (K, 2), ascending, that ends in a cell, through what `warp` has filled."""
    cells, starts = memoryview(origin.data), (first - low).tolist()
    path = [(row, column)]
    while (source := cells[starts[row] + column]) != _HERE:
        if source != _COLUMN_BEFORE:
            row -= 1
        if source != _ROW_BEFORE:
            column -= 1
        path.append((row, column))
    return np.array(path[::-1], np.intp)


def compute_gains(
    similarity: Matrix, radius: int, noise: float, hopeless: float, *, at_once: int = 64
) -> Iterator[Matrix]:
    """Compute the contrast of every pair of frames to the pairs before and after it, in either motion.

    The similarity is (n, n) of a motion with itself, 1 = equal; radius is the number of pairs on either side, noise is
    1 - similarity between takes of the same thing, and beyond hopeless a pair gains nothing. Yields some rows at a time
    of (n, n), 0 on and below the diagonal: logarithm of the contrast to the more similar side. A ridge stands out from
    both sides; the edge of a block, which two rests make, only from one.
    """
    # at_once: rows; so many stay in the cache
    n = len(similarity)
    for first in range(0, n, at_once):
        i, j = np.arange(first, min(first + at_once, n))[:, None], np.arange(first, n)
        shape = len(i) + 2 * radius, len(j) + 2 * radius
        near, skipped = max(first - radius, 0), max(radius - first, 0)  # 0 beyond the edges
        around, known = np.zeros(shape), similarity[near : first + len(i) + radius, near:]
        around[skipped : skipped + len(known), skipped : skipped + known.shape[1]] = known
        rows, columns = slice(radius, radius + len(i)), slice(radius, radius + len(j))
        away = 1.0 - around[rows, columns]
        sides = _sum_windows(around[rows].T, radius).T
        left, right = sides[:, : len(j)], sides[:, -len(j) :]
        sides = _sum_windows(around[:, columns], radius)
        above, below = sides[: len(i)], sides[-len(i) :]
        # Too few pairs at the edge of the matrix say nothing.
        with np.errstate(divide="ignore", invalid="ignore"):
            beside = 1.0 - left / np.minimum(j, radius)
            ahead = 1.0 - below / np.minimum(n - 1 - i, radius)
            beside = np.where(
                2 * (n - 1 - j) > radius, np.minimum(beside, 1.0 - right / np.minimum(n - 1 - j, radius)), beside
            )
            ahead = np.where(2 * i > radius, np.minimum(ahead, 1.0 - above / np.minimum(i, radius)), ahead)
        contrast = 0.5 * (np.maximum(beside, 0.0) + np.maximum(ahead, 0.0)) + noise
        some = (j > i) & (away <= hopeless)
        gains = np.zeros((len(i), n), np.float32)
        gains[:, first:][some] = np.log(contrast[some] / (np.maximum(away[some], 0.0) + noise))
        yield gains


def _sum_windows(values: FloatArray, width: int) -> FloatArray:
    """Sums of so many rows from each one on."""
    if width == 1:
        return values
    half = _sum_windows(values, width // 2)
    both: FloatArray = half[: -(width // 2)] + half[width // 2 :]
    return both if width % 2 == 0 else both[:-1] + values[width - 1 :]


@kernel
def _accumulate(
    similarity: Matrix,
    gains: Matrix,
    first: int,
    moving: FloatArray,
    min_lag: int,
    prices: FloatArray,
    score: Matrix,
    step: NDArray[np.uint8],
    summit: Matrix,
) -> None:  # pragma: no cover - compiled
    """Do `accumulate_likeness` for rows from first on: prices are toll, tolerated and drop.

    ``summit`` (3, n) holds the best score along the path so far, of the last three rows.
    """
    n = len(similarity)
    toll, tolerated, drop = prices[0], prices[1], prices[2]
    for i in range(first, first + len(gains)):
        top = summit[i % 3]
        for j in range(n):
            top[j] = 0.0
        for j in range(i + min_lag, n):
            gain = moving[i] * moving[j] * gains[i - first, j] - toll
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


def accumulate_likeness(
    similarity: Matrix,
    gains: Iterable[Matrix],
    moving: FloatArray,
    min_lag: int,
    toll: float,
    tolerated: float,
    drop: float,
) -> tuple[Matrix, NDArray[np.uint8]]:
    """Compute the score of the best repetition that ends in each pair of frames.

    Parameters
    ----------
    similarity : (n, n) of a motion with itself, 1 = equal.
    gains : (n, n) of `compute_gains`, some rows at a time.
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
    n, first = len(similarity), 0
    score, step, summit = np.zeros((n, n), np.float32), np.zeros((n, n), np.uint8), np.zeros((3, n), np.float32)
    prices = np.array([toll, tolerated, drop])
    for rows in gains:
        _accumulate(similarity, rows, first, moving, min_lag, prices, score, step, summit)
        first += len(rows)
    return score, step


def find_ends(score: Matrix, least: float) -> IndexArray:
    """Find pairs of frames where a repetition may end: no neighbour is higher, and no step goes up from there.

    Takes the score of `accumulate_likeness` and the least height, above 0; returns (E, 2) in order of rows.
    """
    ends = []
    for i, row in enumerate(score):
        j = np.flatnonzero(row[i + 1 :] >= np.float64(least)) + i + 1
        if not len(j):
            continue
        here = row[j]
        j = j[row[j - 1] <= here]
        # The later frame is the larger one: behind the last column nothing follows.
        after = np.minimum(j + 1, len(score) - 1)
        beyond = score[np.minimum(i + 1, len(score) - 1), after]
        j = j[(after == j) | ((row[after] <= row[j]) & (beyond <= row[j]))]
        ends.append(np.column_stack([np.full(len(j), i), j]))
    return np.concatenate(ends) if ends else np.empty((0, 2), np.intp)


def trace_repeats(
    score: Matrix, step: NDArray[np.uint8], ends: IndexArray, width: int, shortest: int, least: float
) -> list[IndexArray]:
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
    (K, 2) pairs of frames of each repetition, from its end to its start.
    """
    n = len(score)
    taken = np.zeros((n, n + 2 * width), np.bool_)  # columns from -width on
    found = []
    for end, its in ends.tolist():
        a, b, pairs = end, its, []
        last = score[a, b]
        while not taken[a, b + width]:
            pairs.append((a, b))
            way = step[a, b]
            if way == 0:
                break
            a -= 2 if way == 2 else 1
            b -= 2 if way == 3 else 1
        if not pairs or (way != 0 and float(last - score[a, b]) < least):
            continue
        walk = np.array(pairs, np.intp)
        taken[walk[:, :1], walk[:, 1:] + np.arange(2 * width + 1)] = True
        if end - walk[-1, 0] + 1 >= shortest:
            found.append(walk)
    return found


@kernel
def _compare_with_later(
    similarity: Matrix, cuts: IndexArray, p: int, slack: float, line: FloatArray, apart: Matrix
) -> None:  # pragma: no cover - compiled
    """Do `compare_stretches` for stretch p and those after it; ``line`` (n + 1,) is room."""
    a, rows = cuts[p], cuts[p + 1] - cuts[p]
    for q in range(p + 1, len(cuts) - 1):
        b, columns = cuts[q], cuts[q + 1] - cuts[q]
        if rows > slack * columns or columns > slack * rows:
            continue
        # A diagonal step counts twice, so that every path weighs rows + columns in all.
        line[0] = 0.0
        for j in range(1, columns + 1):
            line[j] = _FAR
        for i in range(a, a + rows):
            corner = line[0]
            line[0] = _FAR
            for j in range(1, columns + 1):
                cost = max(0.0, 1.0 - similarity[i, b + j - 1])
                value = min(corner + 2.0 * cost, min(line[j], line[j - 1]) + cost)
                corner = line[j]
                line[j] = value
        apart[p, q] = apart[q, p] = line[columns] / (rows + columns)


def compare_stretches(similarity: Matrix, cuts: IndexArray, slack: float) -> tuple[Matrix, Matrix]:
    """Compute the distance of every stretch of a motion from every other, warped to it, and within each.

    The similarity is (n, n) of a motion with itself, cuts are (F + 1,) frames from 0 to n; stretches whose lengths
    differ by a factor above slack are not compared. Returns the mean of 1 - similarity (F, F) along the best path,
    infinite where not compared, and (F, 1) between all frames of the stretch.
    """
    n_stretches = len(cuts) - 1
    apart = np.full((n_stretches, n_stretches), np.inf, np.float32)
    np.fill_diagonal(apart, 0.0)
    within = np.empty((n_stretches, 1), np.float32)
    line = np.empty(len(similarity) + 1)
    for p, (a, b) in enumerate(pairwise(cuts.tolist())):
        within[p, 0] = (1.0 - similarity[a:b, a:b].astype(np.float64)).mean()
        _compare_with_later(similarity, cuts, p, slack, line, apart)
    return apart, within
