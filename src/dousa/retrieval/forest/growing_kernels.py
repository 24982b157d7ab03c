"""Compiled loops that grow a tree of the motion forest (steps 1-8 of the paper).

``tree_kernels`` describes tests and nodes. The features are (N, F, T) here, float32 or float64: a test adds a few
neighbours, and a block of clips gets several tests at a time, so that its rows are read from memory once.

Entropies are compared as integers, with ``n log2 n`` tabulated in fixed point: equal gains are equal to the last bit,
for any order of clips and numbering of categories.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import FloatArray, IntArray
from dousa.kernels import kernel, part
from dousa.retrieval.features.feature_sets import MEAN, SPREAD

FIXED_POINT = 2**32
"""One bit of entropy of one clip, in the units of the ``n log2 n`` table."""

_NO_SCORE = -(2**62)  # by definition below every score
_SAME_SCORE = 256  # units of the table: 6 log2 6 = 2 * 3 log2 3 + 6, but for the rounding of the entries
# Splitmix64: Steele, Lea, Flood, "Fast splittable pseudorandom number generators", OOPSLA 2014.
GOLDEN, MIX_1, MIX_2 = np.uint64(0x9E3779B97F4A7C15), np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
_SHIFT_27, _SHIFT_30, _SHIFT_31, _SHIFT_32 = np.uint64(27), np.uint64(30), np.uint64(31), np.uint64(32)


class Workspace(NamedTuple):
    """Working memory of a growing tree; made by NumPy, as compiling an allocation is slow."""

    values: FloatArray
    asked: FloatArray
    rows: FloatArray
    others: FloatArray
    places: IntArray
    chosen: IntArray
    thresholds: FloatArray
    states: NDArray[np.uint64]
    kept: IntArray
    kept_thresholds: FloatArray
    kept_scores: IntArray
    looked: IntArray
    looked_labels: NDArray[np.int32]
    looked_counts: IntArray
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
    n_looked: int

    @classmethod
    def create(
        cls,
        features: FloatArray,
        n_clips: int,
        n_classes: int,
        n_tests: int,
        *,
        block: int = 64,
        at_once: int = 16,
        most_asked: tuple[int, int] = (128, 256),
        n_looked: int = 256,
        n_weighed: int = 2048,
        n_kept: int = 8,
    ) -> Workspace:
        """Allocate for trees of features (N, F, T).

        Parameters
        ----------
        features : (N, F, T) of all clips.
        n_clips, n_classes, n_tests : of the largest tree.
        block : clips whose rows fit into the cache.
        at_once : tests evaluated at once on a block.
        most_asked : tests evaluated at once in a node of many tests, and its clips at most.
        n_looked : clips by which a larger node preselects tests.
        n_weighed : clips by which it chooses among those; the best splits all clips.
        n_kept : preselected tests.
        """
        keys, spare = np.empty((2, n_clips), np.int64)
        counts, looked_counts, left, present, number = np.empty((5, n_classes), np.int64)
        return cls(
            values=np.empty((at_once, n_clips)),
            asked=np.empty(most_asked),
            rows=np.empty(block * features.shape[1] * features.shape[2], features.dtype),
            others=np.empty(block),
            places=np.arange(block),
            chosen=np.empty(most_asked[0], np.int64),
            thresholds=np.empty(most_asked[0]),
            states=np.empty(most_asked[0], np.uint64),
            kept=np.empty(n_kept + 1, np.int64),
            kept_thresholds=np.empty(n_kept + 1),
            kept_scores=np.empty(n_kept + 1, np.int64),
            looked=np.empty(n_weighed, np.int64),
            looked_labels=np.empty(n_weighed, np.int32),
            looked_counts=looked_counts,
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
            n_looked=n_looked,
        )


@part
def _draw_below(state, bound):
    """Return the next number of splitmix64, scaled to 0 <= number < bound (bound < 2**31)."""
    state[0] += GOLDEN
    z = state[0]
    z = (z ^ (z >> _SHIFT_30)) * MIX_1
    z = (z ^ (z >> _SHIFT_27)) * MIX_2
    z ^= z >> _SHIFT_31
    return np.int64(((z >> _SHIFT_32) * np.uint64(bound)) >> _SHIFT_32)


@part
def _sort_digits(keys, spare, counts, n):
    """Sort ascending in place by four 8-bit digits of the value; an even number, so the result is in ``keys``."""
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


@part
def _measure_spread(difference, square_difference, length):
    """Compute the standard deviation over an interval from the sums of values and of squares."""
    mean = difference / length
    return np.sqrt(max(square_difference / length - mean * mean, 0.0))


@part
def _measure_trend(difference, moment_difference, length, middle):
    """Compute the change along the line of least squares from the sums of values and of value times time."""
    return 12.0 * (moment_difference - middle * difference) / (length * length)


@part
def _add_cells(cells, size, start, length, samples, sums):
    """Sum ``length`` cells of some clips, from the place ``start`` of each clip on (eq. 5); memory reads overlap."""
    for k in range(len(samples)):
        sums[k] = 0.0
    for place in range(start, start + length):
        for k in range(len(samples)):
            sums[k] += cells[np.uint64(samples[k]) * size + place]


@part
def _evaluate(cells, size, width, test, samples, others, values):
    """Compute the value of one test for a block of clips, into ``values``.

    ``cells`` holds the features clip by clip, ``size`` values each, in columns of ``width`` cells; ``others`` is
    working memory of one block.
    """
    # Unsigned, to avoid the check for negative indices.
    first, count = np.uint64(test[3]), np.uint64(test[4] - test[3])
    kind, column, partner = test[0], np.uint64(test[1]), np.uint64(test[2])
    length, middle = float(test[4] - test[3]), 0.5 * (test[3] + test[4])
    _add_cells(cells, size, column * width + first, count, samples, values)
    if kind == MEAN:
        return
    _add_cells(cells, size, partner * width + first, count, samples, others)
    if kind == SPREAD:
        for k in range(len(samples)):
            values[k] = _measure_spread(values[k], others[k], length)
    else:
        for k in range(len(samples)):
            values[k] = _measure_trend(values[k], others[k], length, middle)


@part
def _evaluate_all(cells, size, width, tests, chosen, samples, is_many, work, values):
    """Compute the values of some tests for the clips of a node, into ``values`` (tests, clips), block by block.

    For many tests the rows of a block are first copied, which is faster than single cells.
    """
    rows, block = work.rows, len(work.others)
    for start in range(0, len(samples), block):
        count = min(block, len(samples) - start)
        source, places = cells, samples[start : start + count]
        if is_many:
            source, places = rows, work.places[:count]
            for k in range(count):
                own, copy = np.uint64(samples[start + k]) * size, np.uint64(k) * size
                for cell in range(size):
                    rows[copy + cell] = cells[own + cell]
        for q in range(len(chosen)):
            _evaluate(source, size, width, tests[chosen[q]], places, work.others, values[q, start:])


@part(fastmath={"nnan", "nsz"})
def _find_range(values, n):
    """Return the lowest and the highest of the first n values."""
    low, high = np.inf, -np.inf
    for k in range(n):
        low = min(low, values[k])
        high = max(high, values[k])
    return low, high


@part
def _order_clips(values, low, high, n, keys, spare, digits):
    """Sort the node's clips by their values: keys whose low half is the clip's place in the node."""
    scale = (2.0**31 - 1.0) / (high - low)  # a key is 31 bits of value above 32 bits of place: positive as int64
    if n >= 64:  # counting digits is faster than insertion sort
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


@part
def _split_best(values, keys, n, labels, counts, left, total, log_table, tolerance, best):
    """Find the threshold of largest gain (eq. 7) of one test, whose clips are in order: step 3.

    Returns its score and the threshold; the score is ``best``, and the threshold 0, where none is better.
    """
    threshold = 0.0
    for c in range(len(counts)):
        left[c] = 0
    running = total
    place = keys[0] & 0xFFFFFFFF
    for k in range(n - 1):
        c = labels[place]
        inside = left[c]
        outside = counts[c] - inside
        left[c] = inside + 1
        running += log_table[inside + 1] - log_table[inside] + log_table[outside - 1] - log_table[outside]
        following = keys[k + 1] & 0xFFFFFFFF
        score = running - log_table[k + 1] - log_table[n - k - 1]
        if score > best + _SAME_SCORE and values[following] - values[place] > tolerance:
            best = score
            threshold = 0.5 * (values[place] + values[following])
        place = following
    return best, threshold


@part
def _split_at(values, threshold, n, labels, counts, left, log_table):
    """Return the score of one test at a given threshold."""
    for c in range(len(counts)):
        left[c] = 0
    for k in range(n):
        left[np.uint64(labels[k])] += values[k] <= threshold
    score, n_left = np.int64(0), np.int64(0)
    for c in range(len(counts)):
        score += log_table[left[c]] + log_table[counts[c] - left[c]]
        n_left += left[c]
    return score - log_table[n_left] - log_table[n - n_left]


@part
def _draw_tests(drawn, count, is_all, random_thresholds, work):
    """Draw the next tests of a node into ``chosen``, and their thresholds as shares of the range of values.

    ``states`` keeps the state of the random numbers before each threshold, for tests that separate no clips.
    """
    order, swaps = work.order, work.swaps
    for q in range(count):
        place = drawn + q
        if not is_all:
            swaps[place] = place + _draw_below(work.state, len(order) - place)
            order[place], order[swaps[place]] = order[swaps[place]], order[place]
        work.chosen[q] = order[place]
        work.states[q] = work.state[0]
        if random_thresholds:
            # Never at the ends, where it would split nothing.
            work.thresholds[q] = (_draw_below(work.state, np.int64(2**24)) + 0.5) / 2**24


@part
def _put_back(order, swaps, first, last):
    """Undo the draws of the tests first ... last - 1."""
    for k in range(last - 1, first - 1, -1):
        order[k], order[swaps[k]] = order[swaps[k]], order[k]


@part
def _score_test(values, n, part, labels, counts, total, log_table, tolerance, best, random_thresholds, work):
    """Return score and threshold of one test; the score is not above ``best`` where the test separates no clips.

    ``part`` is the place of a random threshold between the lowest and the highest value, 0 to 1.
    """
    low, high = _find_range(values, n)
    if high - low <= tolerance:
        return _NO_SCORE, 0.0
    if random_thresholds:
        threshold = low + (high - low) * part
        return _split_at(values, threshold, n, labels, counts, work.left, log_table), threshold
    _order_clips(values, low, high, n, work.keys, work.spare, work.digits)
    return _split_best(values, work.keys, n, labels, counts, work.left, total, log_table, tolerance, best)


@part
def _keep(work, n_kept, test, threshold, score):
    """Insert a test among the best, equal ones in order; return how many these are."""
    place = n_kept
    while place > 0 and work.kept_scores[place - 1] + _SAME_SCORE < score:
        work.kept[place] = work.kept[place - 1]
        work.kept_thresholds[place] = work.kept_thresholds[place - 1]
        work.kept_scores[place] = work.kept_scores[place - 1]
        place -= 1
    work.kept[place], work.kept_thresholds[place], work.kept_scores[place] = test, threshold, score
    return min(n_kept + 1, len(work.kept) - 1)


@part
def _find_splits(
    cells, size, width, tolerances, tests, samples, labels, counts, total, log_table, n_trials, random_thresholds,
    most, work,
):  # fmt: skip
    """Steps 1-4 for one node: find the tests and thresholds of largest gain (eq. 7) among ``n_trials`` drawn tests.

    The score of a gain leaves out the part that all splits of the node share; ``total`` is the sum of the table over
    ``counts``. Writes the best ``most`` tests into ``kept`` (places in ``tests``), with thresholds; returns how many, 0
    if none separates the clips. Restores ``order``, so that no node depends on the draws of another.
    """
    n, n_tests = len(samples), len(tests)
    is_all = n_trials >= n_tests
    best, n_kept, drawn, begun = np.int64(_NO_SCORE), np.int64(0), np.int64(0), np.int64(0)
    # No split gains more than the node's entropy, nor more than the one bit a clip of an even split.
    # Once that is reached, more draws cannot change the answer: the first of equals is kept.
    perfect = min(np.int64(0), total - log_table[n // 2] - log_table[n - n // 2])
    # If no drawn test separates two clips, drawing goes on, as in scikit-learn.
    while drawn < n_tests and (drawn < n_trials or n_kept == 0) and best < perfect - _SAME_SCORE:
        # Few at first: small nodes are often split by the first.
        count, left = min(2 + drawn - begun, len(work.values)), (n_trials if drawn < n_trials else n_tests) - drawn
        # A node of 64 clips or more that has drawn eight tests, and draws as many again, is one of many tests.
        is_many = 64 <= n <= work.asked.shape[1] and min(drawn - begun, left) >= 8
        count = min(len(work.asked) if is_many else count, left)
        _draw_tests(drawn, count, is_all, random_thresholds, work)
        values = work.asked if is_many else work.values
        _evaluate_all(cells, size, width, tests, work.chosen[:count], samples, is_many, work, values)
        end = drawn + count
        for q in range(count):
            test = work.chosen[q]
            score, threshold = _score_test(
                values[q], n, work.thresholds[q], labels, counts, total, log_table, tolerances[tests[test, 1]],
                best if most == 1 else np.int64(_NO_SCORE), random_thresholds, work,
            )  # fmt: skip
            drawn += 1
            if score == _NO_SCORE and random_thresholds:
                work.state[0], begun = work.states[q], drawn
                break
            if score > _NO_SCORE and (most > 1 or score > best + _SAME_SCORE):
                n_kept = min(_keep(work, n_kept, test, threshold, score), most)
                best = max(best, work.kept_scores[0])
                # Beyond the trials, the first that separates clips is taken.
                if best >= perfect - _SAME_SCORE or drawn > n_trials:
                    break
        if not is_all:
            _put_back(work.order, work.swaps, drawn, end)
    if not is_all:
        _put_back(work.order, work.swaps, np.int64(0), drawn)
    return n_kept


@part
def _look_at_some(samples, labels, n_present, count, log_table, work):
    """Sample clips of a large node, one from each of equally long stretches; return the sum of the table over them."""
    counts = work.looked_counts[:n_present]
    counts[:] = 0
    step = len(samples) / count
    for k in range(count):
        place = min(np.int64((k + _draw_below(work.state, np.int64(2**24)) / 2**24) * step), len(samples) - 1)
        work.looked[k], work.looked_labels[k] = samples[place], labels[place]
        counts[labels[place]] += 1
    total = np.int64(0)
    for c in range(n_present):
        total += log_table[counts[c]]
    return total


@part
def _weigh_again(
    cells, size, width, tolerances, tests, samples, labels, counts, total, log_table, n_kept, random_thresholds, work
):  # fmt: skip
    """Return the best of the tests in ``kept`` by more clips, and its threshold."""
    best, best_test, best_threshold = np.int64(_NO_SCORE), work.kept[0], work.kept_thresholds[0]
    _evaluate_all(cells, size, width, tests, work.kept[:n_kept], samples, False, work, work.values)
    for q in range(n_kept):
        values, test, threshold = work.values[q], work.kept[q], work.kept_thresholds[q]
        if random_thresholds:
            score = _split_at(values, threshold, len(samples), labels, counts, work.left, log_table)
        else:
            score, threshold = _score_test(
                values, len(samples), 0.0, labels, counts, total, log_table, tolerances[tests[test, 1]], best,
                random_thresholds, work,
            )  # fmt: skip
        if score > best + _SAME_SCORE:
            best, best_test, best_threshold = score, test, threshold
    return best_test, best_threshold


@part
def _partition(values, threshold, samples, spare):
    """Move clips at or below the threshold to the front, order kept (step 5); return how many."""
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


@part
def _count_labels(categories, samples, labels, counts, present, number, log_table):
    """Renumber the categories of a node from 0, so that a small node is cheap for any number of categories.

    Fills each clip's new number, and each category's count and old number; returns their number and the table's sum.
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


@part
def _choose_split(
    cells, size, width, tolerances, tests, samples, n_present, total, log_table, n_trials, random_thresholds, work
):  # fmt: skip
    """Return the test of a node, -1 if none separates its clips, and the threshold.

    In a very large node, a sample preselects a few tests, and a larger one chooses among these.
    """
    labels, counts, n = work.labels, work.counts[:n_present], len(samples)
    if n > work.n_looked:
        some = _look_at_some(samples, labels, n_present, work.n_looked, log_table, work)
        n_kept = 0
        if log_table[work.n_looked] - some > _SAME_SCORE:  # several categories
            n_kept = _find_splits(
                cells, size, width, tolerances, tests, work.looked[: work.n_looked], work.looked_labels,
                work.looked_counts[:n_present], some, log_table, n_trials, random_thresholds,
                np.int64(len(work.kept) - 1), work,
            )  # fmt: skip
        if n_kept > 0:
            if n > len(work.looked):
                total = _look_at_some(samples, labels, n_present, np.int64(len(work.looked)), log_table, work)
                samples, labels, counts = work.looked, work.looked_labels, work.looked_counts[:n_present]
            return _weigh_again(
                cells, size, width, tolerances, tests, samples, labels, counts, total, log_table, n_kept,
                random_thresholds, work,
            )  # fmt: skip
    n_kept = _find_splits(
        cells, size, width, tolerances, tests, samples, labels, counts, total, log_table, n_trials,
        random_thresholds, np.int64(1), work,
    )  # fmt: skip
    return (work.kept[0], work.kept_thresholds[0]) if n_kept > 0 else (np.int64(-1), 0.0)


@part
def _write_node(nodes, cuts, node, test, threshold, n_frames, child):
    kind, i, j, width = test[0], test[1], test[2], n_frames + 1
    nodes[node, 0], nodes[node, 1] = i * width + test[4], i * width + test[3]
    nodes[node, 2] = child
    nodes[node, 3] = 0 if kind == MEAN else (j - i) * width * (1 if kind == SPREAD else -1)
    cuts[node, 2] = threshold


@kernel
def grow_tree(
    features, tolerances, categories, tests, log_table, samples, n_trials, random_thresholds, max_entropy, seed,
    work, nodes, cuts, leaf_starts, leaf_classes, leaf_counts,
):  # fmt: skip
    """Grow one tree by steps 1-8: fill ``nodes``, ``cuts`` and the leaves' histograms; return the numbers of nodes and
    leaves.

    ``samples`` are the clips, permuted in place; ``max_entropy`` is in fixed point. Nodes are processed depth first,
    left before right; each draws its tests from the seed and the node's number. All tests at once are taken in order.
    """
    n_frames = features.shape[2]
    cells, width = features.reshape(-1), np.uint64(n_frames)
    size, values, stack = np.uint64(features.shape[1]) * width, work.values[0], work.stack
    stack[0, 0], stack[0, 1], stack[0, 2] = 0, 0, len(samples)
    depth, n_nodes, n_leaves, n_entries = 1, np.int64(1), 0, 0
    leaf_starts[0] = 0
    while depth > 0:
        depth -= 1
        node, start, stop = stack[depth, 0], stack[depth, 1], stack[depth, 2]
        n, inside = stop - start, samples[start:stop]
        n_present, total = _count_labels(
            categories, inside, work.labels, work.counts, work.present, work.number, log_table
        )  # fmt: skip
        test, threshold = np.int64(-1), 0.0
        # n times eq. 6
        if log_table[n] - total > max_entropy * n + _SAME_SCORE:
            # Multiplier of Steele, Vigna, "Computationally easy, spectrally good multipliers ...", 2021.
            work.state[0] = seed ^ (np.uint64(node) * np.uint64(0xD1342543DE82EF95))
            test, threshold = _choose_split(
                cells, size, width, tolerances, tests, inside, n_present, total, log_table, n_trials,
                random_thresholds, work,
            )  # fmt: skip
        if test < 0:
            nodes[node, 0], nodes[node, 1], nodes[node, 2], nodes[node, 3] = 0, 0, -1 - n_leaves, 0
            cuts[node, 2] = 0.0
            for c in range(n_present):
                leaf_classes[n_entries + c] = work.present[c]
                leaf_counts[n_entries + c] = work.counts[c]
            n_entries += n_present
            n_leaves += 1
            leaf_starts[n_leaves] = n_entries
            continue
        work.chosen[0] = test
        _evaluate_all(cells, size, width, tests, work.chosen[:1], inside, False, work, work.values)
        n_left = _partition(values, threshold, inside, work.keys)
        _write_node(nodes, cuts, node, tests[test], threshold, n_frames, n_nodes)
        stack[depth, 0], stack[depth, 1], stack[depth, 2] = n_nodes + 1, start + n_left, stop
        stack[depth + 1, 0], stack[depth + 1, 1], stack[depth + 1, 2] = n_nodes, start, start + n_left
        depth += 2
        n_nodes += 2
    return n_nodes, n_leaves
