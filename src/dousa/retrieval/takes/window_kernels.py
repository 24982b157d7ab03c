"""Compiled loops over the windows of long recordings: comparing leaves, and poses."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def compare_leaves(leaves, query, out):  # pragma: no cover - compiled
    """The share of trees in which a window (row of ``leaves``) and the query fall into the same leaf, into ``out``."""
    n_trees = leaves.shape[1]
    for w in range(leaves.shape[0]):
        same = 0
        for tree in range(n_trees):
            same += leaves[w, tree] == query[tree]
        out[w] = same / n_trees


@njit(cache=True, nogil=True)
def compare_poses(sums, starts, stops, query, most, out):  # pragma: no cover - compiled
    """Root mean square distance between windows and a query, both cut into equal parts, into ``out``.

    Of windows that are farther than ``most`` it is not computed to the end: infinite.

    Compared are the mean poses of the parts and the changes from one part to the next. ``sums`` (n + 1, P) are running
    sums of the poses, ``query`` (parts, P) the query's means. Parts start at whole frames.
    """
    n_parts, n_values = query.shape
    before, apart = np.empty(n_values), np.empty(n_values)
    divisor = (2 * n_parts - 1) * n_values
    limit = most * most * divisor * (1.0 + 1e-9)  # rounding must not lose one that is as far
    for w in range(len(starts)):
        length = stops[w] - starts[w]
        total, first = 0.0, starts[w]
        for part in range(n_parts):
            last = starts[w] + ((part + 1) * length * 2 + n_parts) // (2 * n_parts)
            share = 1.0 / (last - first)
            placed = changed = 0.0
            for k in range(n_values):
                apart[k] = (sums[last, k] - sums[first, k]) * share - query[part, k]
                placed += apart[k] * apart[k]
            if part > 0:
                for k in range(n_values):
                    changed += (apart[k] - before[k]) ** 2
            total += placed + changed
            if total > limit:
                total = np.inf
                break
            before, apart = apart, before
            first = last
        out[w] = np.sqrt(total / divisor)
