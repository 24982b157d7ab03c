"""Compiled loops of the alignment: the cheapest sequence of straight lines, and the cheapest course of the lag."""

from __future__ import annotations

import numpy as np
from numba import njit

from dousa.motion._types import FloatArray

__all__ = ["extend_lines", "follow_lag", "follow_lines", "switch_on"]


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
    """Reference frame of every performance frame on the cheapest sequence of lines.

    Parameters
    ----------
    cost : (T, U) of performance frame against reference frame, 0 to 1.
    jump, pause, outside : prices, as in `extend_lines`.

    Returns
    -------
    (T,) reference frames; -1 before the first and after the last line.
    """
    n_frames, n_reference = cost.shape
    best = np.full(n_reference, np.inf)
    outside_costs = np.zeros(2)
    origin = np.empty((n_frames, n_reference), np.int32)
    ended = np.empty(n_frames, np.int32)
    extend_lines(cost, best, outside_costs, jump, pause, outside, origin, ended)
    path = np.full(n_frames, -1, np.int32)
    r, t = np.argmin(best), n_frames - 1
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
    """Cheapest course through (T, K) costs if a change by one column costs ``slope``; (T,) columns."""
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
