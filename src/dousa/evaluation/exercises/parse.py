"""Where a recording runs through a template, again and again: subsequence dynamic time warping in one pass.

A recording is read as a chain of rests, other motion, and passes through the template (one repetition), each at its
own and varying speed. The cheapest chain gives the number of passes and their bounds at once.

Source: the one-stage method of connected word recognition: H. Ney, "The use of a one-stage dynamic programming
algorithm for connected word recognition", IEEE Trans. ASSP 32(2), 263-271, 1984.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

STAY, SKIP = 0.2, 0.2
"""Price of a frame during which the template waits, and of every frame of the template that is left out."""
ENTRY = 0.03
"""Price of beginning a repetition, as a share of the template's frames."""

Matrix = NDArray[np.float64]


def parse_passes(cost: Matrix, outside: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.float64], float]:
    """The cheapest reading of a recording as passes through a template, and what lies between them.

    Parameters
    ----------
    cost : (T, n) of pairing a frame of the recording with one of the template.
    outside : (T,) cost of a frame that belongs to no pass.

    Returns
    -------
    passes : (R, 2) first frame and frame after the last of each pass, in order.
    prices : (R,) of each pass, a frame.
    price : of the whole reading.
    """
    if len(cost) == 0 or cost.shape[1] == 0:
        return np.zeros((0, 2), np.int64), np.zeros(0), float(outside.sum())
    total, origin, from_pass = _accumulate(cost, outside, STAY, SKIP, ENTRY * cost.shape[1])
    bounds = _trace(origin, from_pass, total[-1, -1] < total[-1, 0])
    before = np.array([total[start - 1, [0, -1]].min() if start else 0.0 for start, _ in bounds])
    prices = (total[bounds[:, 1] - 1, -1] - before) / np.maximum(bounds[:, 1] - bounds[:, 0], 1)
    return bounds, prices, float(min(total[-1, 0], total[-1, -1]))


@njit(cache=True, nogil=True)
def _accumulate(  # type: ignore[no-untyped-def]
    cost, outside, stay, skip, entry
):  # pragma: no cover - compiled
    """Cheapest prices (T, n + 1), and the way back: column 0 is outside, j + 1 the template."""
    n_frames, n = cost.shape
    total = np.full((n_frames, n + 1), np.inf)
    origin = np.full((n_frames, n + 1), -1, np.int8)  # 0 from outside or a pass's end, 1 stay, 2, 3, 4: so many on
    from_pass = np.zeros(n_frames, np.bool_)  # whether what is outside, or begins, follows a pass
    total[0, 0] = outside[0]
    total[0, 1] = entry + cost[0, 0]
    origin[0, 1] = 0
    for t in range(1, n_frames):
        before, here = total[t - 1], total[t]
        from_pass[t] = before[n] < before[0]
        outer = min(before[0], before[n])
        here[0] = outer + outside[t]
        for j in range(1, n + 1):
            best, way = before[j] + stay, 1
            if j == 1 and outer + entry < best:
                best, way = outer + entry, 0
            for step in range(1, 4):
                if j - step >= 1 and before[j - step] + skip * (step - 1) < best:
                    best, way = before[j - step] + skip * (step - 1), 1 + step
            here[j] = best + cost[t, j - 1]
            origin[t, j] = way
    return total, origin, from_pass


@njit(cache=True, nogil=True)
def _trace(origin, from_pass, in_pass):  # type: ignore[no-untyped-def]  # pragma: no cover - compiled
    """(R, 2) bounds of the passes on the cheapest chain."""
    n_frames, n = origin.shape[0], origin.shape[1] - 1
    bounds = np.empty((n_frames, 2), np.int64)
    count = 0
    j = n if in_pass else 0
    end = n_frames
    for t in range(n_frames - 1, -1, -1):
        if j == 0:
            if t > 0 and from_pass[t]:
                j, end = n, t
            continue
        way = origin[t, j]
        if way == 0:
            bounds[count, 0], bounds[count, 1] = t, end
            count += 1
            j = 0
            if t > 0 and from_pass[t]:
                j, end = n, t
        elif way > 1:
            j -= way - 1
    return bounds[:count][::-1].copy()
