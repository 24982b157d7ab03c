"""Compiled loops over what the trees say of very many clips.

Leaves are kept as codes: the number of a leaf among those of its tree that clips stand in. Votes are kept sparsely: of
each clip the categories that trees name (``starts`` (N + 1,), ``categories`` and ``votes`` (E,)).
"""

from __future__ import annotations

import numpy as np
from numba import njit

_BUCKETS = 1 << 14
_FARTHEST = 4.0  # no bound is larger


@njit(cache=True, nogil=True)
def find_owners(leaves, owners):
    """The tree of each leaf (L,) that occurs in leaves (N, n_trees), -1 before; False if one occurs in two trees."""
    for clip in range(leaves.shape[0]):
        for tree in range(leaves.shape[1]):
            leaf = leaves[clip, tree]
            if owners[leaf] < 0:
                owners[leaf] = tree
            elif owners[leaf] != tree:
                return False
    return True


@njit(cache=True, nogil=True)
def encode_leaves(leaves, ranks, codes):
    """``ranks[leaves]`` (N, n_trees), without a copy in another type."""
    for clip in range(leaves.shape[0]):
        for tree in range(leaves.shape[1]):
            codes[clip, tree] = ranks[leaves[clip, tree]]


@njit(cache=True, nogil=True)
def recode(codes, rows, offsets, ranks, places, out):
    """``ranks`` of the leaves of some clips, from the rows of ``codes`` into the places of ``out``."""
    for number in range(len(rows)):
        for tree in range(codes.shape[1]):
            out[places[number], tree] = ranks[offsets[tree] + codes[rows[number], tree]]


@njit(cache=True, nogil=True)
def copy_runs(values, starts, rows, ends, out):
    """The values of some clips, which begin at ``starts`` (N + 1,), so that they end at ``ends`` (M,) in ``out``."""
    for number in range(len(rows)):
        first, last = starts[rows[number]], starts[rows[number] + 1]
        for step in range(last - first):
            out[ends[number] - (last - first) + step] = values[first + step]


@njit(cache=True, nogil=True)
def find_most(starts, found, votes, out):
    """The category with most votes of each clip, between equals the first in order, into ``out`` (N,)."""
    for clip in range(len(out)):
        best, most = 0, 0
        for entry in range(starts[clip], starts[clip + 1]):
            if votes[entry] > most:
                best, most = found[entry], votes[entry]
        out[clip] = best


@njit(cache=True, nogil=True)
def count_sparsely(
    codes, offsets, begins, stops, classes, weights, parts, meanings, n_meanings, first, shares, ends, found, votes,
    squares, lengths,
):  # fmt: skip
    """Votes of clips from ``first`` on, as many as ``ends`` has room for; returns how many entries were written.

    The sums are those of ``tree_kernels.count_leaves``, in the same order, so that they are equal to the last bit; but
    one tree after the other is looked at for as many clips as ``shares`` (B, C) has room for, since the leaves of one
    are near enough to each other to stay in the processor. ``begins`` and ``stops`` (K,) are where the entries of the
    leaves of the table are. ``squares`` are the sums of the squared votes, ``lengths`` the Euclidean lengths of the
    votes for meanings.
    """
    n_classes, n_trees = len(meanings), codes.shape[1]
    merged = np.zeros(n_meanings, np.int64)
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


@njit(cache=True, nogil=True)
def bound_clips(
    starts, found, votes, squares, lengths, query, told, numbers, weights, n_trees, bounds, cosines
):  # fmt: skip
    """For each clip the least that its distance can be, and the cosine of its votes and those of a query.

    Two clips that share a leaf of a tree share that tree's vote, so what their votes have in common says how many
    leaves they share at most.

    Parameters
    ----------
    starts, found, votes, squares, lengths : of the clips.
    query, told : (C,) votes of the query for each category, and for its meaning.
    numbers : sum of the query's votes, of their squares, length of its votes for meanings, and parts of a vote.
    weights : of the distance of the histograms, and of the share of other leaves; the rest counts nothing.
    n_trees : of the forest.
    bounds, cosines : (N,), filled.
    """
    total, square, length, parts = numbers
    by_histogram, by_leaves = weights
    for clip in range(len(bounds)):
        dot, common, alike = 0.0, np.int64(0), 0.0
        first, last = starts[clip], starts[clip + 1]
        for entry in range(first, last):
            own, other = votes[entry], query[found[entry]]
            dot += float(own) * float(other)
            common += min(own, other)
            alike += float(own) * float(told[found[entry]])
        histogram = np.sqrt(max(float(squares[clip]) + square - 2.0 * dot, 0.0)) / total
        shared = min((common + (last - first)) / parts, float(n_trees))  # votes are rounded
        bounds[clip] = by_histogram * histogram + by_leaves * (1.0 - shared / n_trees)
        cosines[clip] = alike / max(lengths[clip] * length, 1e-9)


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract"})
def _multiply(one, other):
    """The product of two float32 vectors, summed in float64."""
    total = 0.0
    for place in range(len(one)):
        total += np.float64(one[place]) * np.float64(other[place])
    return total


@njit(cache=True, nogil=True)
def compare_clips(
    rows, starts, found, votes, squares, codes, directions, query, query_codes, direction, total, square, histograms,
    leaves, cosines,
):  # fmt: skip
    """Distances of some clips from a query: of histograms, and in how many trees the leaf is another; and the cosines.

    Parameters
    ----------
    rows : (M,) of the clips.
    query, query_codes, direction : (C,) votes, (n_trees,) and (K,) of the query; no directions if K is 0.
    total, square : sum of the query's votes, and of their squares.
    histograms, leaves, cosines : (M,), filled.
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


@njit(cache=True, nogil=True)
def find_limit(bounds, least):
    """A number that at least so many bounds (N,) are not above, if there are as many; infinity if not."""
    counts = np.zeros(_BUCKETS, np.int64)
    for clip in range(len(bounds)):
        if bounds[clip] < _FARTHEST:
            counts[max(int(bounds[clip] * (_BUCKETS / _FARTHEST)), 0)] += 1
    below = 0
    for bucket in range(_BUCKETS):
        below += counts[bucket]
        if below >= least:
            return (bucket + 1) * (_FARTHEST / _BUCKETS)
    return np.inf
