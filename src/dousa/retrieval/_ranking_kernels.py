"""Comparing one query with every clip of a library: the compiled loops, one pass over the clips each."""

from __future__ import annotations

import numpy as np
from numba import njit

__all__ = ["count_differences", "measure_distances"]


@njit(cache=True, nogil=True)
def measure_distances(query, stored, distances):  # pragma: no cover - compiled
    """Euclidean distances of query (C,) float64 from the rows of stored (N, C) float64 or int32, into (N,)."""
    for k in range(len(stored)):
        square = 0.0
        for c in range(len(query)):
            difference = stored[k, c] - query[c]
            square += difference * difference
        distances[k] = np.sqrt(square)


@njit(cache=True, nogil=True)
def count_differences(query, stored, counts):  # pragma: no cover - compiled
    """In how many places the rows of stored (N, n) int32 differ from query (n,) int32, into (N,) int32."""
    for k in range(len(stored)):
        count = np.int32(0)
        for t in range(len(query)):
            count += np.int32(stored[k, t] != query[t])
        counts[k] = count
