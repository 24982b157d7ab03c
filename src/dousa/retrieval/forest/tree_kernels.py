"""Compiled loops of the motion forest: growing a tree (steps 1-8), running clips down all trees, counting leaves.

Arrays that the loops share
---------------------------
``integrals`` (F, T + 1, N): eq. 4 with the clips last, so that one test of all clips reads two rows.
``tests`` (R, 5): kind, column i, its partner j, t0, t1. A test asks for one value of the frames t0 ... t1:

- ``MEAN``: the difference of two integrals of column i (eq. 5, times the length of the interval);
- ``SPREAD``: the standard deviation, from the means of column i and of its partner, which holds its squares;
- ``TREND``: the change along the fitted line over the interval, from column i and its partner, which holds the values
  times the time in frames.

``nodes`` (M, 6) int32 and ``cuts`` (M, 3) float64 are two views of the same memory, 24 bytes a node, so that
a node costs one cache line: columns 0 and 1 say which two integrals are subtracted (``i * (T + 1) + t1`` and
``i * (T + 1) + t0``), column 2 is the left child (the right child stands next to it) or ``-1 - leaf``, column
3 tells the kind and how far the integrals of the partner stand from them (0 for a mean, positive for a spread, negative
for a trend), and ``cuts[:, 2]`` is the threshold of the value: for a mean, of the difference, which is the threshold of
the mean times the length of the interval.

Entropies are compared as integers: ``n log2 n`` is tabulated in fixed point, so sums do not depend on their
order and two splits of equal gain are equal to the last bit, however clips are ordered and categories are
numbered.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from dousa.arrays import FloatArray, IntArray
from dousa.retrieval.features.channel_kernels import read_edge
from dousa.retrieval.features.integral import MEAN, SPREAD


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


@njit(cache=True, nogil=True)
def find_window_leaves(integrals, times, edges, rate, n_channels, nodes, cuts, roots, only_means, leaves):
    """The leaf that each window reaches in each tree, into ``leaves`` (W, n_trees).

    What ``read_cells`` and ``find_leaves`` say one after the other, but for the last bits: the cells of a window are
    equally long in motion time, so the sums of eq. 4 are integrals of the recording, less those at the start.
    """
    width = integrals.shape[1]
    last = edges.shape[1] - 1
    shift = np.int64(width > n_channels)  # the duration stands between the values and their squares
    start, row = np.empty(width), np.empty(width)
    integral = np.zeros((width + shift) * (last + 1))
    places, trees = np.empty(len(roots), np.int64), np.empty(len(roots), np.int64)
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
            run_down_means(integral, nodes, cuts, roots, places, trees, leaves[w])
        else:
            run_down(integral, last + 1, nodes, cuts, roots, places, trees, leaves[w])


FIXED_POINT = 2**32
"""One bit of entropy of one clip, in the units of the ``n log2 n`` table."""

_NO_SCORE = -(2**62)
_SAME_SCORE = 256  # units of the table: 6 log2 6 = 2 * 3 log2 3 + 6, but for the rounding of the entries
_KEY_RANGE = 2.0**31 - 1.0  # a key is 31 bits of value above 32 bits of place: positive as int64
_PLACE = 0xFFFFFFFF
_HALVES = 2**24  # places for a random threshold: never at the ends, where it would part nothing
_MANY = 64  # from here on, counting digits is faster than insertion sort

_NODE_STEP = np.uint64(0xD1342543DE82EF95)
_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_MIX_1 = np.uint64(0xBF58476D1CE4E5B9)
_MIX_2 = np.uint64(0x94D049BB133111EB)
_SHIFT_27, _SHIFT_30, _SHIFT_31, _SHIFT_32 = np.uint64(27), np.uint64(30), np.uint64(31), np.uint64(32)


class Workspace(NamedTuple):
    """Memory that a tree needs while it grows; made by NumPy, as compiling an allocation takes long."""

    values: FloatArray
    labels: NDArray[np.int32]
    keys: IntArray
    spare: IntArray
    counts: IntArray
    left: IntArray
    present: IntArray
    number: IntArray
    order: IntArray
    swaps: IntArray
    stack: IntArray
    digits: IntArray
    state: NDArray[np.uint64]

    @classmethod
    def create(cls, n_clips: int, n_classes: int, n_tests: int) -> Workspace:
        """For trees of so many clips, categories and tests."""
        keys, spare = np.empty((2, n_clips), np.int64)
        counts, left, present, number = np.empty((4, n_classes), np.int64)
        return cls(
            values=np.empty(n_clips),
            labels=np.empty(n_clips, np.int32),
            keys=keys,
            spare=spare,
            counts=counts,
            left=left,
            present=present,
            number=number,
            order=np.arange(n_tests),
            swaps=np.empty(n_tests, np.int64),
            stack=np.empty((n_clips + 1, 3), np.int64),
            digits=np.empty((4, 256), np.int64),
            state=np.empty(1, np.uint64),
        )


@njit(cache=True, nogil=True)
def _draw_below(state, bound):
    """The next number of splitmix64, scaled to 0 <= number < bound (bound < 2**31)."""
    state[0] += _GOLDEN
    z = state[0]
    z = (z ^ (z >> _SHIFT_30)) * _MIX_1
    z = (z ^ (z >> _SHIFT_27)) * _MIX_2
    z ^= z >> _SHIFT_31
    return np.int64(((z >> _SHIFT_32) * np.uint64(bound)) >> _SHIFT_32)


@njit(cache=True, nogil=True)
def _sort_digits(keys, spare, counts, n):
    """Ascending in place: four counted digits of the value (an even number, so the result is in ``keys``)."""
    for digit in range(4):
        for bucket in range(256):
            counts[digit, bucket] = 0
    for k in range(n):
        value = keys[k] >> 32
        counts[0, value & 255] += 1
        counts[1, (value >> 8) & 255] += 1
        counts[2, (value >> 16) & 255] += 1
        counts[3, value >> 24] += 1
    for digit in range(4):
        place = 0
        for bucket in range(256):
            place += counts[digit, bucket]
            counts[digit, bucket] = place - counts[digit, bucket]
        shift = 32 + 8 * digit
        for k in range(n):
            bucket = (keys[k] >> shift) & 255
            spare[counts[digit, bucket]] = keys[k]
            counts[digit, bucket] += 1
        keys, spare = spare, keys


@njit(cache=True, nogil=True)
def _evaluate(integrals, test, samples, values):
    """The value of one test for the clips of a node, into ``values``; returns the lowest and the highest."""
    kind, i, j, t0, t1 = test[0], test[1], test[2], test[3], test[4]
    low, high = np.inf, -np.inf
    later, sooner = integrals[i, t1], integrals[i, t0]
    partner_later, partner_sooner = integrals[j, t1], integrals[j, t0]
    length, middle = float(t1 - t0), 0.5 * (t0 + t1)
    for k in range(len(samples)):
        value = later[samples[k]] - sooner[samples[k]]  # eq. 5, times t1 - t0
        values[k] = value
        low = min(low, value)
        high = max(high, value)
    if kind == MEAN:
        return low, high
    low, high = np.inf, -np.inf
    for k in range(len(samples)):
        other = partner_later[samples[k]] - partner_sooner[samples[k]]
        value = (
            measure_spread(values[k], other, length)
            if kind == SPREAD
            else measure_trend(values[k], other, length, middle)
        )
        values[k] = value
        low = min(low, value)
        high = max(high, value)
    return low, high


@njit(cache=True, nogil=True)
def _order_clips(values, low, high, n, keys, spare, digits):
    """The node's clips in ascending order of their values: keys whose low half is the clip's place in the node."""
    scale = _KEY_RANGE / (high - low)
    if n >= _MANY:
        for k in range(n):
            keys[k] = (np.int64((values[k] - low) * scale) << 32) | k
        _sort_digits(keys, spare, digits, n)
        return
    for k in range(n):
        key = (np.int64((values[k] - low) * scale) << 32) | k
        j = k - 1
        while j >= 0 and keys[j] > key:
            keys[j + 1] = keys[j]
            j -= 1
        keys[j + 1] = key


@njit(cache=True, nogil=True)
def _split_best(values, keys, n, labels, counts, left, total, log_table, tolerance, best):
    """Step 3: the threshold of largest gain (eq. 7) of one test, whose clips are in order.

    Returns its score and the threshold; the score is ``best``, and the threshold nothing, where none is better.
    """
    threshold = 0.0
    for c in range(len(counts)):
        left[c] = 0
    running = total
    place = keys[0] & _PLACE
    for k in range(n - 1):
        c = labels[place]
        inside = left[c]
        outside = counts[c] - inside
        left[c] = inside + 1
        running += log_table[inside + 1] - log_table[inside] + log_table[outside - 1] - log_table[outside]
        following = keys[k + 1] & _PLACE
        score = running - log_table[k + 1] - log_table[n - k - 1]
        if score > best + _SAME_SCORE and values[following] - values[place] > tolerance:
            best = score
            threshold = 0.5 * (values[place] + values[following])
        place = following
    return best, threshold


@njit(cache=True, nogil=True)
def _split_at(values, threshold, n, labels, counts, left, total, log_table):
    """The score of one test at a given threshold."""
    for c in range(len(counts)):
        left[c] = 0
    running, n_left = total, 0
    for k in range(n):
        if values[k] <= threshold:
            c = labels[k]
            inside = left[c]
            outside = counts[c] - inside
            left[c] = inside + 1
            running += log_table[inside + 1] - log_table[inside] + log_table[outside - 1] - log_table[outside]
            n_left += 1
    return running - log_table[n_left] - log_table[n - n_left]


@njit(cache=True, nogil=True)
def _find_split(
    integrals, tolerances, tests, order, swaps, state, samples, labels, counts, total, log_table, n_trials,
    random_thresholds, values, keys, spare, left, digits,
):  # fmt: skip
    """Steps 1-4 for one node: the test and threshold of largest gain (eq. 7) among ``n_trials`` drawn tests.

    Gains are compared by their score, which leaves out what all splits of the node share; ``total`` is the
    sum of the table over ``counts``. Returns the test's place in ``tests``, or -1 if none tells the clips
    apart, and the threshold of its value. Leaves ``order`` as it was, so that no node depends on
    how many tests another has drawn.
    """
    n, n_tests = len(samples), len(tests)
    best, best_test, best_threshold = _NO_SCORE, -1, 0.0
    # No split gains more than all the entropy there is, nor more than the one bit a clip of an even split.
    # Once that is reached, drawing on cannot change the answer: the first of equals is kept.
    perfect = min(np.int64(0), total - log_table[n // 2] - log_table[n - n // 2])
    drawn = 0
    # If no drawn test tells two clips apart, drawing goes on, as in scikit-learn.
    while drawn < n_tests and (drawn < n_trials or best_test < 0) and best < perfect - _SAME_SCORE:
        if n_trials < n_tests:
            swaps[drawn] = drawn + _draw_below(state, n_tests - drawn)
            order[drawn], order[swaps[drawn]] = order[swaps[drawn]], order[drawn]
        test = order[drawn]
        drawn += 1
        tolerance = tolerances[tests[test, 1]]
        low, high = _evaluate(integrals, tests[test], samples, values)
        if high - low <= tolerance:
            continue
        if random_thresholds:
            threshold = low + (high - low) * (_draw_below(state, _HALVES) + 0.5) / _HALVES
            score = _split_at(values, threshold, n, labels, counts, left, total, log_table)
        else:
            _order_clips(values, low, high, n, keys, spare, digits)
            score, threshold = _split_best(values, keys, n, labels, counts, left, total, log_table, tolerance, best)
        if score > best + _SAME_SCORE:
            best, best_test, best_threshold = score, test, threshold
    if n_trials < n_tests:
        for k in range(drawn - 1, -1, -1):
            order[k], order[swaps[k]] = order[swaps[k]], order[k]
    return best_test, best_threshold


@njit(cache=True, nogil=True)
def _partition(values, threshold, samples, spare):
    """Step 5: clips at or below the threshold to the front, order kept; returns how many."""
    n_left = 0
    n_right = 0
    for k in range(len(samples)):
        sample = samples[k]
        if values[k] <= threshold:
            samples[n_left] = sample
            n_left += 1
        else:
            spare[n_right] = sample
            n_right += 1
    for k in range(n_right):
        samples[n_left + k] = spare[k]
    return n_left


@njit(cache=True, nogil=True)
def _count_labels(categories, samples, labels, counts, present, number, log_table):
    """Numbers the categories of a node from 0, so that a small node costs little however many there are.

    Fills each clip's new number, how many clips each has, and which category it stands for. Returns how
    many categories there are and the sum of the table over their counts.
    """
    for c in range(len(number)):
        number[c] = 0
    for k in range(len(samples)):
        number[categories[samples[k]]] += 1
    n_present = 0
    total = np.int64(0)
    for c in range(len(number)):
        if number[c] > 0:
            counts[n_present], present[n_present] = number[c], c
            total += log_table[number[c]]
            number[c] = n_present
            n_present += 1
    for k in range(len(samples)):
        labels[k] = number[categories[samples[k]]]
    return n_present, total


@njit(cache=True, nogil=True)
def grow_tree(
    integrals, tolerances, categories, tests, log_table, samples, n_trials, random_thresholds, max_entropy, seed,
    work, nodes, cuts, leaf_starts, leaf_classes, leaf_counts,
):  # fmt: skip
    """Steps 1-8 for one tree: fills ``nodes``, ``cuts`` and the leaves' histograms, and counts both.

    ``samples`` are the clips, permuted in place; ``max_entropy``
    is in fixed point. Nodes are worked off depth first, left before right; each draws its tests with its own
    random numbers, from the seed and the node's number. All tests at once are taken in order.
    """
    values, labels, keys, spare, counts, left, present, number, order, swaps, stack, digits, state = work
    stack[0, 0], stack[0, 1], stack[0, 2] = 0, 0, len(samples)
    depth, n_nodes, n_leaves, n_entries = 1, 1, 0, 0
    leaf_starts[0] = 0
    while depth > 0:
        depth -= 1
        node, start, stop = stack[depth, 0], stack[depth, 1], stack[depth, 2]
        n = stop - start
        inside = samples[start:stop]
        n_present, total = _count_labels(categories, inside, labels, counts, present, number, log_table)
        impurity = log_table[n] - total  # n times eq. 6
        test, threshold = -1, 0.0
        if impurity > max_entropy * n + _SAME_SCORE:
            state[0] = seed ^ (np.uint64(node) * _NODE_STEP)
            test, threshold = _find_split(
                integrals, tolerances, tests, order, swaps, state, inside, labels, counts[:n_present], total,
                log_table, n_trials, random_thresholds, values, keys, spare, left, digits,
            )  # fmt: skip
        if test < 0:
            nodes[node, 0], nodes[node, 1], nodes[node, 2], nodes[node, 3] = 0, 0, -1 - n_leaves, 0
            cuts[node, 2] = 0.0
            for c in range(n_present):
                leaf_classes[n_entries + c] = present[c]
                leaf_counts[n_entries + c] = counts[c]
            n_entries += n_present
            n_leaves += 1
            leaf_starts[n_leaves] = n_entries
            continue
        _evaluate(integrals, tests[test], inside, values)
        n_left = _partition(values, threshold, inside, keys)
        width = integrals.shape[1]
        kind, i, j = tests[test, 0], tests[test, 1], tests[test, 2]
        nodes[node, 0], nodes[node, 1] = i * width + tests[test, 4], i * width + tests[test, 3]
        nodes[node, 2] = n_nodes
        nodes[node, 3] = 0 if kind == MEAN else (j - i) * width * (1 if kind == SPREAD else -1)
        cuts[node, 2] = threshold
        stack[depth, 0], stack[depth, 1], stack[depth, 2] = n_nodes + 1, start + n_left, stop
        stack[depth + 1, 0], stack[depth + 1, 1], stack[depth + 1, 2] = n_nodes, start, start + n_left
        depth += 2
        n_nodes += 2
    return n_nodes, n_leaves
