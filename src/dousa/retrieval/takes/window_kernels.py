"""Compiled loops over the windows of long recordings: compare, score, choose."""

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
def compare_poses(sums, starts, stops, query, out):  # pragma: no cover - compiled
    """Root mean square distance between windows and a query, both cut into equal parts, into ``out``.

    Compared are the mean poses of the parts and the changes from one part to the next. ``sums`` (n + 1, P) are running
    sums of the poses, ``query`` (parts, P) the query's means. Parts start at whole frames.
    """
    n_parts, n_values = query.shape
    before, apart = np.empty(n_values), np.empty(n_values)
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
            before, apart = apart, before
            first = last
        out[w] = np.sqrt(total / ((2 * n_parts - 1) * n_values))


@njit(cache=True, nogil=True)
def score_windows(leaves, weights, out):  # pragma: no cover - compiled
    """Adds the weights (leaves, C) of all leaves that a window reached to its row of ``out`` (W, C)."""
    for w in range(leaves.shape[0]):
        for tree in range(leaves.shape[1]):
            row = weights[leaves[w, tree]]
            for c in range(len(row)):
                out[w, c] += row[c]


@njit(cache=True, nogil=True)
def spread_to_leaves(leaves, values, out):  # pragma: no cover - compiled
    """Adds the row of a window (W, C) to the rows of ``out`` (leaves, C) of all leaves that it reached."""
    for w in range(leaves.shape[0]):
        for tree in range(leaves.shape[1]):
            row = out[leaves[w, tree]]
            for c in range(len(row)):
                row[c] += values[w, c]


@njit(cache=True, nogil=True)
def choose_windows(starts, stops, gains, n_frames, first_at, best, chosen):  # pragma: no cover - compiled
    """The windows, no two overlapping, of the largest sum of gains.

    Windows stand in ascending order of their ends; ``first_at`` (n_frames + 2,) says where those that end at each frame
    begin. ``best`` (n_frames + 1,) and ``chosen`` (n_frames + 1,) are filled: the sum up to a frame, and the window
    that ends there, or -1 where the frame before it belongs to none. Of equal sums no window counts first, then the
    first window.
    """
    best[0] = 0.0
    chosen[0] = -1
    for t in range(1, n_frames + 1):
        best[t] = best[t - 1]
        chosen[t] = -1
        for w in range(first_at[t], first_at[t + 1]):
            total = best[starts[w]] + gains[w]
            if total > best[t]:
                best[t] = total
                chosen[t] = w
