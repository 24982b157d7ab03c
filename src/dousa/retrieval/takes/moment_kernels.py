"""Compiled loops over the moments of a recording: what lies around each, the trees that judge it, the best sequence."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def integrate(rows, padding, first_speed, n_speeds, at_rest, sums, times):  # pragma: no cover - compiled
    """Running sums of the channels and their squares, into ``sums`` (n + 2 padding + 1, 2 C), and motion time, into
    ``times`` (n + 2 padding + 1,).

    ``rows`` (n, C); before and after them the body stands as at the ends, all channels from ``first_speed`` on that
    speak of movement being 0; ``n_speeds`` of these are the speeds that make motion time.
    """
    n, count = rows.shape
    for t in range(n + 2 * padding):
        inside = padding <= t < padding + n
        row = rows[min(max(t - padding, 0), n - 1)]
        effort = at_rest
        for k in range(count):
            value = row[k] if inside or k < first_speed else 0.0
            sums[t + 1, k] = sums[t, k] + value
            sums[t + 1, count + k] = sums[t, count + k] + value * value
        if inside:
            for k in range(n_speeds):
                effort += row[first_speed + 4 + k]
        times[t + 1] = times[t] + effort


@njit(cache=True, nogil=True)
def _place(times, wanted, low, high):  # pragma: no cover - compiled
    """Where an ascending function of whole frames reaches a value, as a fraction, within ``low`` to ``high``."""
    if wanted <= times[low]:
        return float(low)
    if wanted >= times[high]:
        return float(high)
    below, above = low, high
    while above - below > 1:
        middle = (below + above) // 2
        if times[middle] <= wanted:
            below = middle
        else:
            above = middle
    return below + (wanted - times[below]) / (times[above] - times[below])


@njit(cache=True, nogil=True)
def describe(sums, times, moments, seconds, efforts, reach, out):  # pragma: no cover - compiled
    """Mean and spread of all channels in the cells around moments, into ``out`` (M, cells * 2 C) float32.

    ``moments`` (M,) frames of the padded recording; ``seconds`` (E,) edges of cells in frames from the moment,
    ``efforts`` (E,) in motion time, none farther than ``reach`` frames away.
    """
    count = sums.shape[1] // 2
    last = sums.shape[0] - 1
    before, now = np.empty(2 * count), np.empty(2 * count)
    for m in range(len(moments)):
        moment, column = moments[m], 0
        low, high = max(int(moment - reach), 0), min(int(moment + reach) + 1, last)
        whole = int(moment)
        middle = times[whole] + (moment - whole) * (times[min(whole + 1, last)] - times[whole])
        for kind in range(2):
            edges = seconds if kind == 0 else efforts
            place = 0.0
            for e in range(len(edges)):
                if kind == 0:
                    edge = min(max(moment + edges[e], 0.0), float(last))
                else:
                    edge = _place(times, middle + edges[e], low, high)
                below = min(int(edge), last - 1)
                share = edge - below
                for k in range(2 * count):
                    now[k] = sums[below, k] + share * (sums[below + 1, k] - sums[below, k])
                if e > 0:
                    per_frame = 1.0 / max(edge - place, 1e-3)
                    for k in range(count):
                        mean = (now[k] - before[k]) * per_frame
                        square = (now[count + k] - before[count + k]) * per_frame
                        out[m, column + k] = mean
                        out[m, column + count + k] = np.sqrt(max(square - mean * mean, 0.0))
                    column += 2 * count
                before, now = now, before
                place = edge


@njit(cache=True, nogil=True)
def encode(values, lows, scales, out):  # pragma: no cover - compiled
    """Values (M, F) as steps of a scale from 0 to 255, into ``out`` (M, F) uint8."""
    for m in range(values.shape[0]):
        for f in range(values.shape[1]):
            out[m, f] = np.uint8(min(max((values[m, f] - lows[f]) * scales[f], 0.0), 255.0))


@njit(cache=True, nogil=True)
def _draw(state):  # pragma: no cover - compiled
    """A random number of 63 bits; ``state`` (1,) uint64 goes on (xorshift)."""
    x = state[0]
    x ^= x << np.uint64(13)
    x ^= x >> np.uint64(7)
    x ^= x << np.uint64(17)
    state[0] = x
    return np.int64(x >> np.uint64(1))


@njit(cache=True, nogil=True)
def _try_split(seen, threshold, of, weight, left, right):  # pragma: no cover - compiled
    """How pure a split leaves both sides: the sum of squares of the weights of categories over the sides' weights.

    ``seen`` (K,) values, ``of`` (K,) categories and ``weight`` (K,) of the samples; ``left`` and ``right`` (S,) are
    zeros, and are again when this returns.
    """
    pure_left = pure_right = all_left = all_right = 0.0
    for i in range(len(seen)):
        label, heavy = of[i], weight[i]
        if seen[i] <= threshold:
            pure_left += heavy * (2.0 * left[label] + heavy)
            left[label] += heavy
            all_left += heavy
        else:
            pure_right += heavy * (2.0 * right[label] + heavy)
            right[label] += heavy
            all_right += heavy
    for i in range(len(seen)):
        left[of[i]] = 0.0
        right[of[i]] = 0.0
    return pure_left / all_left + pure_right / all_right


@njit(cache=True, nogil=True)
def _find_split(by_value, by_moment, rows, of, weight, n_tries, state, left, right):  # pragma: no cover - compiled
    """The best of some random tests of random values: which value (-1 for none) and its threshold."""
    best, feature, threshold = -1.0, -1, 0
    looked = len(rows)
    seen = np.empty(looked, np.uint8)
    for _ in range(n_tries):
        f = _draw(state) % by_value.shape[0]
        # Few moments lie in the cache whole; of many only the one value does.
        if looked <= 64:
            for i in range(looked):
                seen[i] = by_moment[rows[i], f]
        else:
            column = by_value[f]
            for i in range(looked):
                seen[i] = column[rows[i]]
        low = high = seen[0]
        for i in range(1, looked):
            low, high = min(low, seen[i]), max(high, seen[i])
        if low == high:
            continue
        t = low + _draw(state) % (np.int64(high) - low)
        gain = _try_split(seen, t, of, weight, left, right)
        if gain > best:
            best, feature, threshold = gain, f, t
    return feature, threshold


@njit(cache=True, nogil=True)
def grow(
    by_value, by_moment, labels, weights, n_categories, n_tries, least, most_looked, seed, chosen, nodes, leaf_of
):  # pragma: no cover - compiled
    """One extremely randomised tree over all moments.

    ``by_value`` (F, N) uint8 and ``by_moment`` (N, F), the same transposed; ``labels`` (N,), ``weights`` (N,). Into
    ``nodes`` (2 N, 3) int32 go value, threshold and the left child (the right one follows it); a leaf has -1 - its
    number in the place of the child. ``chosen`` (N,) becomes the moments in the order of the leaves, ``leaf_of`` (N,)
    the leaf of each of them. A node of more than ``most_looked`` moments looks at as many, drawn at random, when it
    chooses its test. Returns the numbers of nodes and leaves.
    """
    state = np.array([np.uint64(seed) * np.uint64(2654435761) + np.uint64(88172645463325252)], np.uint64)
    left, right = np.zeros(n_categories), np.zeros(n_categories)
    of, weight = np.empty(most_looked, np.int64), np.empty(most_looked)
    for i in range(len(chosen)):
        chosen[i] = i
    stack = [(0, 0, len(chosen))]
    n_nodes, n_leaves = 1, 0
    while stack:
        node, start, stop = stack.pop()
        rows = chosen[start:stop]
        count = stop - start
        pure = True
        for i in range(1, count):
            if labels[rows[i]] != labels[rows[0]]:
                pure = False
                break
        feature, threshold, middle = -1, 0, start
        if not pure and count >= 2 * least:
            looked = min(count, most_looked)
            for i in range(looked):
                if looked < count:
                    other = i + _draw(state) % (count - i)
                    rows[i], rows[other] = rows[other], rows[i]
                of[i], weight[i] = labels[rows[i]], weights[rows[i]]
            feature, threshold = _find_split(
                by_value, by_moment, rows[:looked], of[:looked], weight[:looked], n_tries, state, left, right
            )
        if feature >= 0:
            column = by_value[feature]
            for i in range(start, stop):
                if column[chosen[i]] <= threshold:
                    chosen[i], chosen[middle] = chosen[middle], chosen[i]
                    middle += 1
        if feature < 0 or middle - start < least or stop - middle < least:
            nodes[node, 0], nodes[node, 1], nodes[node, 2] = -1, 0, -1 - n_leaves
            leaf_of[start:stop] = n_leaves
            n_leaves += 1
            continue
        nodes[node, 0], nodes[node, 1], nodes[node, 2] = feature, threshold, n_nodes
        stack.append((n_nodes, start, middle))
        stack.append((n_nodes + 1, middle, stop))
        n_nodes += 2
    return n_nodes, n_leaves


@njit(cache=True, nogil=True)
def reach_leaves(codes, nodes, roots, out):  # pragma: no cover - compiled
    """The leaf of every moment in every tree, into ``out`` (M, n_trees) int32; ``codes`` (M, F)."""
    for tree in range(len(roots)):  # a tree at a time: its nodes stay near
        for m in range(codes.shape[0]):
            row = codes[m]
            node = roots[tree]
            while nodes[node, 2] >= 0:
                node = nodes[node, 2] + (1 if row[nodes[node, 0]] > nodes[node, 1] else 0)
            out[m, tree] = -1 - nodes[node, 2]


@njit(cache=True, nogil=True)
def add_leaves(leaves, starts, categories, shares, out):  # pragma: no cover - compiled
    """Adds the shares of the categories of all leaves that a moment reached to its row of ``out`` (M, S)."""
    for m in range(leaves.shape[0]):
        row = out[m]
        for tree in range(leaves.shape[1]):
            leaf = leaves[m, tree]
            for k in range(starts[leaf], starts[leaf + 1]):
                row[categories[k]] += shares[k]


@njit(cache=True, nogil=True)
def find_best_sequence(evidence, opening, closing, lengths, tails, again, begins, before):  # noqa: PLR0912  # pragma: no cover - compiled
    """The segments whose evidence and lengths are the likeliest together (an explicit-duration Viterbi search).

    ``evidence`` (T, S) log likelihood of every state at every step; ``opening`` and ``closing`` (T, S) what is added
    for the first and for the last step of a segment; ``lengths`` (M, S) log probability of a segment of 1 ... M steps;
    ``tails`` (S,) what every step beyond M costs; ``again`` (S,) what it costs that a state follows itself. ``begins``
    (T + 1, S) and ``before`` (T + 1, S) are filled: where the best segment that ends at a step begins, and the state
    before it (-1 for none). Returns the best last state.
    """
    n, count = evidence.shape
    most = lengths.shape[0]
    sums = np.zeros((n + 1, count))
    entry = np.zeros((n + 1, count))  # best value of a segment that begins at a step, less the evidence until then
    entry[0] = opening[0]
    came = np.full((n + 1, count), -1, np.int32)
    tail, tail_begin = np.full(count, -np.inf), np.zeros(count, np.int32)
    value, begin = np.empty(count), np.empty(count, np.int32)
    for t in range(1, n + 1):
        value[:] = -np.inf
        for c in range(count):
            sums[t, c] = sums[t - 1, c] + evidence[t - 1, c]
        for length in range(1, min(most, t) + 1):
            row, log = entry[t - length], lengths[length - 1]
            for c in range(count):
                total = row[c] + log[c]
                if total > value[c]:
                    value[c], begin[c] = total, t - length
        if t > most:
            for c in range(count):
                start = entry[t - most - 1, c] + lengths[most - 1, c]
                if start > tail[c]:
                    tail[c], tail_begin[c] = start, t - most - 1
                tail[c] += tails[c]
                if tail[c] > value[c]:
                    value[c], begin[c] = tail[c], tail_begin[c]
        first, second = -1, -1
        for c in range(count):
            value[c] += sums[t, c] + closing[t - 1, c]
            begins[t, c] = begin[c]
            before[t, c] = came[begin[c], c]
            if first < 0 or value[c] > value[first]:
                first, second = c, first
            elif second < 0 or value[c] > value[second]:
                second = c
        for c in range(count):
            best = first if first != c else second
            total = value[best] if best >= 0 else -np.inf
            if value[c] - again[c] > total:
                best, total = c, value[c] - again[c]
            entry[t, c] = total - sums[t, c] + (opening[t, c] if t < n else 0.0)
            came[t, c] = best
    return first if n > 0 else -1
