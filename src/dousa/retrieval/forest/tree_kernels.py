"""Compiled loops of the motion forest: running clips down all trees, and counting leaves.

Shared arrays
-------------
``tests`` (R, 5): kind, column i, its partner j, t0, t1. The value of a test over the frames t0 ... t1 is:

- ``MEAN``: the difference of two integrals of column i (eq. 5, times the length of the interval);
- ``SPREAD``: the standard deviation, from the means of column i and of its partner, which holds its squares;
- ``TREND``: the change along the fitted line, from column i and its partner, the values times the time in frames.

``nodes`` (M, 6) int32 and ``cuts`` (M, 3) float64 are two views of the same memory, 24 bytes a node:

- columns 0 and 1: the two integrals subtracted (``i * (T + 1) + t1`` and ``i * (T + 1) + t0``);
- column 2: the left child (the right child is next to it), or ``-1 - leaf``;
- column 3: offset of the partner's integrals, 0 for a mean, positive for a spread, negative for a trend;
- ``cuts[:, 2]``: the threshold of the value; for a mean, times the length of the interval.
"""

from __future__ import annotations

import numpy as np

from dousa.kernels import kernel, part
from dousa.retrieval.features.channel_kernels import read_edge


@part
def _is_above(integral, later, sooner, partner, cut, width):
    """Return whether a clip is above the threshold of a node of any kind, without division or root."""
    difference = integral[later] - integral[sooner]
    if partner == 0:
        return difference > cut
    length = float(later - sooner)
    bar = cut * length * length
    if partner > 0:  # the standard deviation > cut, which is not below 0
        other = integral[later + partner] - integral[sooner + partner]
        return other * length - difference * difference > cut * bar
    # the change along the fitted line > cut; times are counted from the column's first place
    first = int((later + 0.5) / width) * width
    other = integral[later - partner] - integral[sooner - partner]
    return 12.0 * other - 6.0 * (later + sooner - 2 * first) * difference > bar


@part
def _run_down_means(integral, nodes, cuts, roots, places, trees, leaves):
    """Find the leaf of one clip in each tree, from its integrals (F * (T + 1),), where all nodes test means."""
    # One step down all trees at a time: the steps do not wait for each other's memory.
    n_active = len(roots)
    for tree in range(n_active):
        places[tree], trees[tree] = roots[tree], tree
    while n_active > 0:
        n_kept = 0
        for k in range(n_active):
            node, tree = places[k], trees[k]
            child = np.int64(nodes[node, 2])
            # eq. 5 without the division: the threshold is stored times the length of the interval.
            above = integral[nodes[node, 0]] - integral[nodes[node, 1]] > cuts[node, 2]
            leaves[tree] = -1 - child  # the last one written is the leaf
            places[n_kept], trees[n_kept] = child + above, tree
            n_kept += child >= 0
        n_active = n_kept


@part
def _run_down(integral, width, nodes, cuts, roots, places, trees, leaves):
    """Do ``_run_down_means`` for nodes of all kinds, a tenth slower."""
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


@kernel(linear=True)
def find_leaves(features, nodes, cuts, roots, only_means, integral, work, leaves):
    """Find the leaf that each clip (N, T, F) reaches in each tree (section 3.4), into ``leaves`` (N, n_trees).

    ``only_means`` if no node tests anything else. ``integral`` (F * (T + 1),), which begins with zeros, and ``work``
    (2, n_trees) are working memory. Returns the first clip with a value that is not finite, or -1.
    """
    n_clips, n_frames, n_features = features.shape
    places, trees = work[0], work[1]
    for clip in range(n_clips):
        finite = 0.0
        for i in range(n_features):
            running = 0.0
            row = i * (n_frames + 1) + 1
            for t in range(n_frames):
                running += np.float64(features[clip, t, i])  # eq. 4
                integral[row + t] = running
            finite += running - running  # NaN as soon as one value is NaN or infinite
        if finite != 0.0:
            return clip
        if only_means:
            _run_down_means(integral, nodes, cuts, roots, places, trees, leaves[clip])
        else:
            _run_down(integral, n_frames + 1, nodes, cuts, roots, places, trees, leaves[clip])
    return -1


@kernel(linear=True)
def count_leaves(leaves, starts, classes, weights, out):
    """Add, for each clip, the entries (class, weight) of every leaf that it reached to ``out`` (N, C)."""
    for clip in range(leaves.shape[0]):
        for tree in range(leaves.shape[1]):
            leaf = leaves[clip, tree]
            for entry in range(starts[leaf], starts[leaf + 1]):
                out[clip, classes[entry]] += weights[entry]


@kernel
def find_window_leaves(
    integrals, times, edges, rate, n_channels, nodes, cuts, roots, only_means, rows, integral, work, leaves
):  # fmt: skip
    """Find the leaf that each window reaches in each tree, into ``leaves`` (W, n_trees).

    Equals ``read_cells`` then ``find_leaves`` but for the last bits: the cells of a window are equally long in motion
    time, so the sums of eq. 4 are integrals of the recording less those at the start. ``rows`` (2, banks * n_channels),
    and ``integral`` and ``work`` as for ``find_leaves``, are working memory.
    """
    width = integrals.shape[1]
    last = edges.shape[1] - 1
    shift = np.int64(width > n_channels)  # the duration stands between the values and their squares
    start, row, places, trees = rows[0], rows[1], work[0], work[1]
    for w in range(edges.shape[0]):
        begin = read_edge(integrals, times, edges[w, 0], n_channels, start)
        end = read_edge(integrals, times, edges[w, last], n_channels, row)
        per_cell = last / max(end - begin, 1e-12)
        for t in range(1, last + 1):
            read_edge(integrals, times, edges[w, t], n_channels, row)
            for c in range(n_channels):
                integral[c * (last + 1) + t] = (row[c] - start[c]) * per_cell
            if shift:
                for c in range(n_channels, 2 * n_channels):
                    integral[(c + 1) * (last + 1) + t] = (row[c] - start[c]) * per_cell
                for c in range(n_channels):
                    moment = row[2 * n_channels + c] - start[2 * n_channels + c] - begin * (row[c] - start[c])
                    integral[(2 * n_channels + c + 1) * (last + 1) + t] = moment * per_cell * per_cell
                integral[n_channels * (last + 1) + t] = t * (edges[w, last] - edges[w, 0]) / rate
        if only_means:
            _run_down_means(integral, nodes, cuts, roots, places, trees, leaves[w])
        else:
            _run_down(integral, last + 1, nodes, cuts, roots, places, trees, leaves[w])


@kernel
def find_marked(codes, offsets, places, marked, found):
    """Write whether each row of codes (n, n_trees) has a leaf ``marked`` in the table into ``found`` (n,).

    ``places`` (n,) is -1 for rows that do not count, which are not found.
    """
    for row in range(codes.shape[0]):
        hit = False
        if places[row] >= 0:
            for tree in range(codes.shape[1]):
                if marked[offsets[tree] + codes[row, tree]]:
                    hit = True
                    break
        found[row] = hit


@kernel
def count_standing(codes, offsets, places, ranks, categories, counts):
    """Count every clip in a leaf that has a rank, into ``counts`` (ranks, categories), as in ``find_marked``."""
    for row in range(codes.shape[0]):
        if places[row] >= 0:
            category = categories[places[row]]
            for tree in range(codes.shape[1]):
                rank = ranks[offsets[tree] + codes[row, tree]]
                if rank >= 0:
                    counts[rank, category] += 1


@kernel
def list_marked(codes, offsets, places, marked, out):
    """List clips and places of all marked leaves with a clip, into ``out`` (2, M) as far as fits; return the full
    number.
    """
    count = 0
    for row in range(codes.shape[0]):
        if places[row] >= 0:
            for tree in range(codes.shape[1]):
                place = offsets[tree] + codes[row, tree]
                if marked[place]:
                    if count < out.shape[1]:
                        out[0, count], out[1, count] = places[row], place
                    count += 1
    return count


@kernel
def keep_examples(numbers, categories, leaves, kept, own):
    """Put clips into the rows of their leaves in ``kept`` (L, E), and their categories into ``own``; -1 is free.

    In a full row, a clip replaces the last of the most frequent category, if that has at least two more than its own.
    """
    n_kept = kept.shape[1]
    for clip in range(leaves.shape[0]):
        category = categories[clip]
        for tree in range(leaves.shape[1]):
            leaf = leaves[clip, tree]
            place, alike = n_kept, 0
            for k in range(n_kept):
                if kept[leaf, k] < 0:
                    place = k
                    break
                alike += own[leaf, k] == category
            if place == n_kept and 2 * alike < n_kept:
                most = alike + 1
                for k in range(n_kept):
                    count, last = 0, k
                    for other in range(n_kept):
                        if own[leaf, other] == own[leaf, k]:
                            count, last = count + 1, other
                    if count > most:
                        most, place = count, last
            if place < n_kept:
                kept[leaf, place], own[leaf, place] = numbers[clip], category
