"""Compiled loops over the sketches of windows."""

from __future__ import annotations

import numpy as np
from numba import njit

TILE = 2048  # windows whose distances are in hand at a time


@njit(cache=True, nogil=True)
def scan_sketches(
    sketches, marks, first, last, query, rests, leaves, added, weight, most, rows, costs
):  # pragma: no cover - compiled
    """Windows that cost at most ``most`` by their sketches, into ``rows`` and ``costs``; returns how many.

    ``sketches`` (R + 1, N) int8 are the coordinates of N windows in steps and, last, how far each lies from what the
    axes span; ``marks`` (N, S) uint8 tell leaves; ``first`` to ``last`` are looked at. ``query`` (R,) float32 are the
    coordinates of the query; ``rests`` (256,) float32 says what each value of the last row, which begins at -128, adds
    to the squared distance in steps; ``leaves`` (S,) are the marks of the query, and ``added`` (S + 1,) is what as many
    equal ones cost. ``weight`` is the cost of a step.
    """
    n_values, n_marks = sketches.shape[0] - 1, marks.shape[1]
    tile = np.empty(TILE, np.float32)
    nearest = most - added.min()
    limit = np.float32((nearest / weight) ** 2 if nearest > 0.0 else -1.0)
    count = 0
    for start in range(first, last, TILE):
        size = min(TILE, last - start)
        for w in range(size):
            tile[w] = rests[np.int64(sketches[n_values, start + w]) + 128]
        for k in range(n_values):
            wanted = query[k]
            own = sketches[k, start : start + size]
            for w in range(size):
                apart = np.float32(own[w]) - wanted
                tile[w] += apart * apart
        for w in range(size):
            if tile[w] <= limit:
                same = 0
                for k in range(n_marks):
                    same += marks[start + w, k] == leaves[k]
                cost = weight * np.sqrt(np.float64(tile[w])) + added[same]
                if cost <= most:
                    rows[count], costs[count] = start + w, cost
                    count += 1
    return count
