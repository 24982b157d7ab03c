"""Compiled loops over the moments of a recording and over windows.

Parts of rows are slices from 0, as an index that is a sum may be negative to the compiler, which then does
not vectorise.
"""

from __future__ import annotations

import numpy as np

from dousa.kernels import kernel, part


@kernel
def integrate(rows, padding, first_speed, n_speeds, at_rest, sums, times):  # pragma: no cover - compiled
    """Sum the channels and their squares into ``sums`` (n + 2 padding + 1, 2 C), and motion time into ``times``.

    ``times`` has as many rows, ``rows`` (n, C) are the channels. Padding repeats the first and last row, with the
    channels of movement, from ``first_speed`` on, at 0; from the fifth of them ``n_speeds`` speeds make motion time.
    """
    n, count = rows.shape
    for t in range(n + 2 * padding):
        inside = padding <= t < padding + n
        row = rows[min(max(t - padding, 0), n - 1)]
        last, squares, now, now_squares = sums[t], sums[t, count:], sums[t + 1], sums[t + 1, count:]
        moving, effort = count if inside else first_speed, at_rest
        for k in range(moving):
            now[k] = last[k] + row[k]
        for k in range(moving):
            now_squares[k] = squares[k] + row[k] * row[k]
        for k in range(moving, count):  # row to row would have the compiler write the message of an error, for seconds
            now[k], now_squares[k] = last[k], squares[k]
        if inside:
            for k in range(n_speeds):
                effort += row[first_speed + 4 + k]
        times[t + 1] = times[t] + effort


@part
def _place(times, wanted, low, high):  # pragma: no cover - compiled
    """Return where an ascending function of whole frames reaches a value, as a fraction, within ``low`` to ``high``."""
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


@kernel
def describe(sums, times, moments, seconds, efforts, reach, rows, out):  # pragma: no cover - compiled
    """Fill ``out`` (M, 8 * 3 C) float32: mean and spread in cells of seconds around moments, spread in movement.

    ``moments`` (M,) are frames of the padded recording; ``seconds`` (E,) edges of cells in frames from the moment,
    ``efforts`` (E,) in motion time, at most ``reach`` frames away. ``rows`` (2, 2 C) are working memory.
    """
    count = sums.shape[1] // 2
    last = sums.shape[0] - 1
    before, now = rows[0], rows[1]
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
                lower, upper = sums[below], sums[below + 1]
                for k in range(2 * count):
                    now[k] = lower[k] + share * (upper[k] - lower[k])
                if e > 0:
                    per_frame = 1.0 / max(edge - place, 1e-3)
                    if kind == 0:
                        means = out[m, column:]
                        for k in range(count):
                            means[k] = (now[k] - before[k]) * per_frame
                        column += count
                    spreads, squares, earlier = out[m, column:], now[count:], before[count:]
                    for k in range(count):
                        mean = (now[k] - before[k]) * per_frame
                        square = (squares[k] - earlier[k]) * per_frame
                        spreads[k] = np.sqrt(max(square - mean * mean, 0.0))
                    column += count
                before, now = now, before
                place = edge


@kernel
def place(values, lows, scales, highest, out):  # pragma: no cover - compiled
    """Scale values of moments (M, F) to 0 to ``highest``, not rounded, into ``out``; all float32."""
    nothing = np.float32(0.0)
    for m in range(values.shape[0]):
        for f in range(values.shape[1]):
            out[m, f] = min(max((values[m, f] - lows[f]) * scales[f], nothing), highest)


@kernel
def place_mirrored(values, order, signs, lows, scales, highest, out):  # pragma: no cover - compiled
    """Scale values of the mirror image: value ``order`` (F,) times ``signs`` (F,) gives that of the image."""
    nothing = np.float32(0.0)
    for m in range(values.shape[0]):
        row, own = values[m], out[m]
        for f in range(values.shape[1]):
            own[f] = row[order[f]]
        for f in range(values.shape[1]):
            own[f] = min(max((own[f] * signs[f] - lows[f]) * scales[f], nothing), highest)


@kernel
def find_best_sequence(  # noqa: PLR0912  # pragma: no cover - compiled
    evidence, opening, closing, lengths, tails, again, sums, entry, rows, numbers, begins, before
):  # fmt: skip
    """Find the likeliest segments by evidence and lengths (an explicit-duration Viterbi search); return the last state.

    ``evidence`` (T, S) is the log likelihood of every state at every step; ``opening`` and ``closing`` (T, S) are added
    at the first and last step of a segment; ``lengths`` (M, S) is the log probability of 1 ... M steps; ``tails`` (S,)
    is added for every step beyond M; ``again`` (S,) is the cost of a state after itself. ``begins`` and ``before``
    (T + 1, S) are filled with the start of the best segment that ends at a step, and the state before it (-1 for none).
    ``sums``, ``entry`` (T + 1, S), ``rows`` (2, S) and ``numbers`` (T + 3, S), int32, are working memory.
    """
    n, count = evidence.shape
    most = lengths.shape[0]
    tail, value, tail_begin, begin, came = rows[0], rows[1], numbers[n + 1], numbers[n + 2], numbers
    for c in range(count):  # row to row would have the compiler write the message of an error, for seconds
        # ``entry`` is the best value of a segment that begins at a step, less the evidence until then.
        sums[0, c], entry[0, c], came[0, c], tail[c] = 0.0, opening[0, c], -1, -np.inf
    for t in range(1, n + 1):
        for c in range(count):
            value[c] = -np.inf
            sums[t, c] = sums[t - 1, c] + evidence[t - 1, c]
        for length in range(1, min(most, t) + 1):
            row, log = entry[t - length], lengths[length - 1]
            for c in range(count):
                total = row[c] + log[c]
                if total > value[c]:
                    value[c], begin[c] = total, t - length
        first, second = -1, -1
        for c in range(count):
            if t > most:
                start = entry[t - most - 1, c] + lengths[most - 1, c]
                if start > tail[c]:
                    tail[c], tail_begin[c] = start, t - most - 1
                tail[c] += tails[c]
                if tail[c] > value[c]:
                    value[c], begin[c] = tail[c], tail_begin[c]
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


@kernel
def compare_leaves(leaves, query, out):  # pragma: no cover - compiled
    """Compute the shares of trees with the same leaf for windows (rows of ``leaves``) and the query, into ``out``."""
    n_trees = leaves.shape[1]
    for w in range(leaves.shape[0]):
        same = 0
        for tree in range(n_trees):
            same += leaves[w, tree] == query[tree]
        out[w] = same / n_trees


@kernel(allocates=True)
def compare_poses(sums, starts, stops, query, most, out):  # pragma: no cover - compiled
    """Compute root mean square distances of windows from a query by parts into ``out``; infinite above ``most``.

    Compared are the mean poses of the parts and the changes from one part to the next. ``sums`` (n + 1, P) are running
    sums of the poses, ``query`` (parts, P) the query's means. Parts start at whole frames.
    """
    n_parts, n_values = query.shape
    before, apart = np.empty(n_values), np.empty(n_values)
    divisor = (2 * n_parts - 1) * n_values
    limit = most * most * divisor * (1.0 + 1e-9)  # room for rounding
    for w in range(len(starts)):
        length = stops[w] - starts[w]
        total, first = 0.0, starts[w]
        for piece in range(n_parts):
            last = starts[w] + ((piece + 1) * length * 2 + n_parts) // (2 * n_parts)
            share = 1.0 / (last - first)
            placed = changed = 0.0
            for k in range(n_values):
                apart[k] = (sums[last, k] - sums[first, k]) * share - query[piece, k]
                placed += apart[k] * apart[k]
            if piece > 0:
                for k in range(n_values):
                    changed += (apart[k] - before[k]) ** 2
            total += placed + changed
            if total > limit:
                total = np.inf
                break
            before, apart = apart, before
            first = last
        out[w] = np.sqrt(total / divisor)
