"""Dynamic time warping of one sequence of poses against many: the compiled loops.

Steps are (1, 1), (1, 0) and (0, 1), each paying the distance of the poses it arrives at; so a path that goes straight
pays for fewer pairs, which keeps warping in bounds. The sum is divided by the two lengths.
"""

from __future__ import annotations

import numpy as np
from numba import njit

__all__ = ["warp_distances"]

_FAR = np.float32(1e30)


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract"})
def _measure(query, i, frames, j):  # pragma: no cover - compiled
    """Euclidean distance of row i of query from row j of frames; its own function, as only here order is free."""
    square = np.float32(0.0)
    for k in range(query.shape[1]):
        difference = query[i, k] - frames[j, k]
        square += difference * difference
    return np.sqrt(square)


@njit(cache=True, nogil=True)
def _warp(query, frames, start, m, reach, before, now):  # pragma: no cover - compiled
    """Cost of the cheapest path between query (n, D) and m rows of frames; the last two are room for m + 1 numbers."""
    n = len(query)
    slope = (m - 1) / (n - 1) if n > 1 else 0.0
    width = (
        min(max(reach, slope, 1.0), float(m)) + 1e-9 if n > 1 else float(m)
    )  # an edge may round either way
    for j in range(m + 1):
        before[j] = now[j] = _FAR  # index j + 1, so that j - 1 exists for j = 0
    before[0] = np.float32(0.0)
    for i in range(n):
        first = max(0, int(np.ceil(i * slope - width)))
        last = min(m - 1, int(np.floor(i * slope + width)))
        for j in range(first, last + 1):
            now[j + 1] = _measure(query, i, frames, start + j)
        now[first] = left = _FAR
        for j in range(first, last + 1):
            left = now[j + 1] + min(left, before[j], before[j + 1])
            now[j + 1] = left
        for j in range(last + 1, min(m, last + 2 + int(slope))):  # the next row's band goes a little further
            now[j + 1] = _FAR
        before, now = now, before
    return before[m]


@njit(cache=True, nogil=True)
def warp_distances(query, frames, starts, stops, reach, distances):  # pragma: no cover - compiled
    """Distances of one sequence from many.

    Parameters
    ----------
    query : (n, D) float32.
    frames : (M, D) float32, the other sequences one after the other.
    starts, stops : (N,) rows of ``frames`` where each begins and ends.
    reach : frames by which a pair may lie off the diagonal (Sakoe and Chiba); wider where the lengths ask for it;
        infinity for no band.
    distances : (N,) float64, filled.
    """
    longest = 0
    for k in range(len(starts)):
        longest = max(longest, stops[k] - starts[k])
    before, now = np.empty(longest + 1, np.float32), np.empty(longest + 1, np.float32)
    for k in range(len(starts)):
        m = stops[k] - starts[k]
        distances[k] = _warp(query, frames, starts[k], m, reach, before, now) / (len(query) + m)
