"""Compiled loops of the alignment: the cheapest sequence of straight lines, and the cheapest course of the lag."""

from __future__ import annotations

import numpy as np
from numba import njit

from dousa.motion._types import FloatArray

__all__ = ["follow_lag", "follow_lines", "switch_on"]


@njit(cache=True, nogil=True)
def follow_lines(  # noqa: PLR0912, PLR0915 - one compiled loop
    cost: FloatArray, jump: float, pause: float, outside: float
) -> np.ndarray:  # pragma: no cover - compiled
    """Reference frame of every performance frame on the cheapest sequence of lines.

    Parameters
    ----------
    cost : (T, U) of performance frame against reference frame, 0 to 1.
    jump : price of leaving a line for any other.
    pause : price of staying at a reference frame, or of leaving one out, for one frame.
    outside : price a frame of being before the first or after the last line.

    Returns
    -------
    (T,) reference frames; -1 before the first and after the last line.
    """
    n_frames, n_reference = cost.shape
    origin = np.empty((n_frames, n_reference), np.int32)
    best = np.empty(n_reference)
    now = np.empty(n_reference)
    left = np.empty(n_frames)  # price of being outside after the lines, and where they ended
    last = np.empty(n_frames, np.int32)
    for r in range(n_reference):
        best[r] = cost[0, r]
        origin[0, r] = -1
    left[0] = outside
    last[0] = -1
    before = outside
    for t in range(1, n_frames):
        cheapest = 0
        for r in range(1, n_reference):
            if best[r] < best[cheapest]:
                cheapest = r
        left[t] = left[t - 1] + outside
        last[t] = -2
        if best[cheapest] + outside < left[t]:
            left[t] = best[cheapest] + outside
            last[t] = cheapest
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
            if before < value:
                value = before
                source = -1
            now[r] = value + cost[t, r]
            origin[t, r] = source
        best, now = now, best
        before += outside
    path = np.full(n_frames, -1, np.int32)
    r = 0
    for other in range(1, n_reference):
        if best[other] < best[r]:
            r = other
    t = n_frames - 1
    if left[t] < best[r]:
        while t >= 0 and last[t] == -2:
            t -= 1
        if t < 0 or last[t] == -1:
            return path
        r = last[t]
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
