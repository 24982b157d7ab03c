"""Compiled loops of the motion forest: running clips down all trees and counting what their leaves say.

The layout of the nodes is told in ``_forest_kernels``.
"""

from __future__ import annotations

import numpy as np
from numba import njit

__all__ = ["count_leaves", "find_leaves", "measure_spread", "measure_trend", "run_down", "run_down_means"]


@njit(cache=True, nogil=True)
def measure_spread(difference, square_difference, length):
    """Standard deviation over an interval, from the integrals of values and of squares."""
    mean = difference / length
    return np.sqrt(max(square_difference / length - mean * mean, 0.0))


@njit(cache=True, nogil=True)
def measure_trend(difference, moment_difference, length, middle):
    """Change along the line of least squares over an interval, from the integrals of values and value times time."""
    return 12.0 * (moment_difference - middle * difference) / (length * length)


@njit(cache=True, nogil=True)
def _is_above(integral, later, sooner, partner, cut, width):
    """Whether a clip lies above the threshold of a node, whatever its kind; nothing is divided, nor a root taken."""
    difference = integral[later] - integral[sooner]
    if partner == 0:
        return difference > cut
    length = float(later - sooner)
    bar = cut * length * length
    if partner > 0:  # measure_spread > cut, which is not below 0
        other = integral[later + partner] - integral[sooner + partner]
        return other * length - difference * difference > cut * bar
    # measure_trend > cut; times are counted from the column's first place
    first = int((later + 0.5) / width) * width
    other = integral[later - partner] - integral[sooner - partner]
    return 12.0 * other - 6.0 * (later + sooner - 2 * first) * difference > bar


@njit(cache=True, nogil=True)
def run_down_means(integral, nodes, cuts, roots, places, trees, leaves):
    """The leaf of one clip in each tree, from its integrals (F * (T + 1),), where every node asks for a mean."""
    # One step down all trees at a time: the steps do not wait for each other's memory.
    n_active = len(roots)
    for tree in range(n_active):
        places[tree], trees[tree] = roots[tree], tree
    while n_active > 0:
        n_kept = 0
        for k in range(n_active):
            node, tree = places[k], trees[k]
            child = np.int64(nodes[node, 2])
            # eq. 5, without the division: the threshold is kept times the length of the interval.
            above = integral[nodes[node, 0]] - integral[nodes[node, 1]] > cuts[node, 2]
            leaves[tree] = -1 - child  # the last one written is the leaf
            places[n_kept], trees[n_kept] = child + above, tree
            n_kept += child >= 0
        n_active = n_kept


@njit(cache=True, nogil=True)
def run_down(integral, width, nodes, cuts, roots, places, trees, leaves):
    """``run_down_means`` for nodes of all kinds: it takes a tenth longer."""
    # One step down all trees at a time: the steps do not wait for each other's memory.
    n_active = len(roots)
    for tree in range(n_active):
        places[tree], trees[tree] = roots[tree], tree
    while n_active > 0:
        n_kept = 0
        for k in range(n_active):
            node, tree = places[k], trees[k]
            child = np.int64(nodes[node, 2])
            above = _is_above(integral, nodes[node, 0], nodes[node, 1], nodes[node, 3], cuts[node, 2], width)
            leaves[tree] = -1 - child  # the last one written is the leaf
            places[n_kept], trees[n_kept] = child + above, tree
            n_kept += child >= 0
        n_active = n_kept


@njit(cache=True, nogil=True)
def find_leaves(features, nodes, cuts, roots, only_means, leaves):
    """Section 3.4: the leaf that each clip reaches in each tree, into ``leaves`` (N, n_trees).

    ``features`` is (N, T, F); ``only_means`` says that no node asks for anything else. Returns the first clip with a
    value that is not finite, or -1.
    """
    n_clips, n_frames, n_features = features.shape
    integral = np.zeros(n_features * (n_frames + 1))
    places, trees = np.empty(len(roots), np.int64), np.empty(len(roots), np.int64)
    for clip in range(n_clips):
        finite = 0.0
        for i in range(n_features):
            running = 0.0
            row = i * (n_frames + 1) + 1
            for t in range(n_frames):
                running += features[clip, t, i]  # eq. 4
                integral[row + t] = running
            finite += running - running  # NaN as soon as one value is NaN or infinite
        if finite != 0.0:
            return clip
        if only_means:
            run_down_means(integral, nodes, cuts, roots, places, trees, leaves[clip])
        else:
            run_down(integral, n_frames + 1, nodes, cuts, roots, places, trees, leaves[clip])
    return -1


@njit(cache=True, nogil=True)
def count_leaves(leaves, starts, classes, weights, out):
    """Adds, for each clip, the entries (class, weight) of every leaf that it reached to ``out`` (N, C)."""
    for clip in range(leaves.shape[0]):
        for tree in range(leaves.shape[1]):
            leaf = leaves[clip, tree]
            for entry in range(starts[leaf], starts[leaf + 1]):
                out[clip, classes[entry]] += weights[entry]
