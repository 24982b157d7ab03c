"""Compiled loops over the tree answers of very many clips.

The code of a leaf is its number among the occupied leaves of its tree. Votes are sparse: ``starts`` (N + 1,), and
``categories`` (``found``) and ``votes`` (E,).
"""

from __future__ import annotations

import numpy as np

from dousa.arrays import FloatArray
from dousa.kernels import kernel, part


@kernel(linear=True)
def find_owners(leaves, owners):
    """Write the tree of each leaf of leaves (N, n_trees) into ``owners`` (L,); False if one is in two trees."""
    for clip in range(leaves.shape[0]):
        for tree in range(leaves.shape[1]):
            leaf = leaves[clip, tree]
            if owners[leaf] < 0:
                owners[leaf] = tree
            elif owners[leaf] != tree:
                return False
    return True


@kernel(linear=True)
def encode_leaves(leaves, ranks, codes):
    """Write ``ranks[leaves]`` into ``codes`` (N, n_trees), without a copy in another type."""
    for clip in range(leaves.shape[0]):
        for tree in range(leaves.shape[1]):
            codes[clip, tree] = ranks[leaves[clip, tree]]


@kernel(linear=True)
def recode(codes, rows, offsets, ranks, places, out):
    """Write the ``ranks`` of the leaves of some rows of ``codes`` into places of ``out``."""
    for number in range(len(rows)):
        for tree in range(codes.shape[1]):
            out[places[number], tree] = ranks[offsets[tree] + codes[rows[number], tree]]


@kernel(linear=True)
def copy_runs(values, starts, rows, ends, out):
    """Copy the values of some rows, from ``starts`` (N + 1,), into ``out``, where they end at ``ends`` (M,)."""
    for number in range(len(rows)):
        first, last = starts[rows[number]], starts[rows[number] + 1]
        for step in range(last - first):
            out[ends[number] - (last - first) + step] = values[first + step]


@kernel(linear=True)
def find_most(starts, found, votes, out):
    """Write the category with most votes of each clip, the first of equals, into ``out`` (N,)."""
    for clip in range(len(out)):
        best, most = 0, 0
        for entry in range(starts[clip], starts[clip + 1]):
            if votes[entry] > most:
                best, most = found[entry], votes[entry]
        out[clip] = best


@kernel(linear=True)
def count_sparsely(
    codes, offsets, begins, stops, classes, weights, parts, meanings, merged, first, shares, ends, found, votes,
    squares, lengths,
):  # fmt: skip
    """Count the votes of ``len(ends)`` clips from ``first`` on; return the number of written entries.

    Sums run in the order of ``tree_kernels.count_leaves``, so they are equal to the last bit; trees are the outer loop
    over blocks of clips (``shares`` (B, C)), as the leaves of one tree fit the cache. ``begins`` and ``stops`` (K,)
    bound the entries of each leaf of the table; ``merged`` are zeros, one for each meaning; ``squares`` are the sums of
    the squared votes, ``lengths`` the Euclidean lengths of the votes for meanings.
    """
    n_classes, n_trees = len(meanings), codes.shape[1]
    written = 0
    for block in range(0, len(ends), len(shares)):
        count = min(len(shares), len(ends) - block)
        shares[:count] = 0.0
        for tree in range(n_trees):
            for place in range(count):
                leaf = offsets[tree] + codes[first + block + place, tree]
                for entry in range(begins[leaf], stops[leaf]):
                    shares[place, classes[entry]] += weights[entry]
        for place in range(count):
            clip, began, square = first + block + place, written, np.int64(0)
            for category in range(n_classes):
                if shares[place, category] != 0.0:
                    own = np.int64(np.rint(shares[place, category] / n_trees * (parts * n_trees)))
                    if own != 0:
                        found[written], votes[written] = category, own
                        written += 1
                        square += own * own
                        merged[meanings[category]] += own
            squares[clip] = square
            total = 0.0
            for entry in range(began, written):
                meaning = meanings[found[entry]]
                total += float(merged[meaning]) * float(merged[meaning])
                merged[meaning] = 0
            lengths[clip] = np.sqrt(total)
            ends[block + place] = written
    return written


@kernel(linear=True)
def bound_clips(
    starts, found, votes, squares, lengths, query, meant, numbers, weights, n_trees, bounds, cosines
):  # fmt: skip
    """Bound the distance of each clip from below, and compute the cosine of its votes with those of a query.

    Clips that share a leaf share the vote of its tree, so the votes in common limit how many leaves they share.

    Parameters
    ----------
    query, meant : (C,) votes of the query for each category, and for its meaning.
    numbers : sum of the query's votes, of their squares, length of its votes for meanings, and parts of a vote.
    weights : of the distance of the histograms, and of the share of other leaves.
    bounds, cosines : (N,), filled.
    """
    total, square, length, parts = numbers
    by_histogram, by_leaves = weights
    for clip in range(len(bounds)):
        dot, common, same = 0.0, np.int64(0), 0.0
        first, last = starts[clip], starts[clip + 1]
        for entry in range(first, last):
            own, other = votes[entry], query[found[entry]]
            dot += float(own) * float(other)
            common += min(own, other)
            same += float(own) * float(meant[found[entry]])
        histogram = np.sqrt(max(float(squares[clip]) + square - 2.0 * dot, 0.0)) / total
        shared = min((common + (last - first)) / parts, float(n_trees))  # votes are rounded
        bounds[clip] = by_histogram * histogram + by_leaves * (1.0 - shared / n_trees)
        cosines[clip] = same / max(lengths[clip] * length, 1e-9)


@part(fastmath={"reassoc", "contract"})
def _multiply(one, other):
    """Return the dot product of two float32 vectors, summed in float64."""
    total = 0.0
    for place in range(len(one)):
        total += np.float64(one[place]) * np.float64(other[place])
    return total


@kernel(linear=True)
def compare_clips(
    rows, starts, found, votes, squares, codes, directions, query, query_codes, direction, total, square, histograms,
    leaves, cosines,
):  # fmt: skip
    """Compare the clips of some rows (M,) with a query.

    Parameters
    ----------
    query, query_codes, direction : (C,) votes, (n_trees,) and (K,) of the query; no directions if K is 0.
    total, square : sum of the query's votes, and of their squares.
    histograms, leaves, cosines : (M,), filled: distances, trees with other leaves, cosines of the directions.
    """
    for place in range(len(rows)):
        clip = rows[place]
        dot = 0.0
        for entry in range(starts[clip], starts[clip + 1]):
            dot += float(votes[entry]) * float(query[found[entry]])
        histograms[place] = np.sqrt(max(float(squares[clip]) + square - 2.0 * dot, 0.0)) / total
        count = np.int32(0)
        for tree in range(len(query_codes)):
            count += np.int32(codes[clip, tree] != query_codes[tree])
        leaves[place] = count
        if len(direction):
            cosines[place] = _multiply(directions[clip], direction)


def find_limit(bounds: FloatArray, least: int, n_buckets: int = 1 << 14, farthest: float = 4.0) -> float:
    """Return a limit that at least ``least`` of the bounds (N,) do not exceed; infinity if there are fewer.

    Bounds of ``farthest`` and more are left out; the limit is that much too high at most, divided by ``n_buckets``.
    """
    near = bounds[bounds < farthest]
    places = np.maximum((near * (n_buckets / farthest)).astype(np.intp), 0)
    below = np.cumsum(np.bincount(places, minlength=n_buckets))
    return float(np.searchsorted(below, least) + 1) * (farthest / n_buckets) if below[-1] >= least else np.inf
