"""Compiled loops of the noise-reducing splines of ``sensor_noise``, without the cosine transform.

Courses are the places of joints over time (J, 3, n). No allocations, which halves the compile time.
"""

from __future__ import annotations

import numpy as np

from dousa.kernels import kernel, part


@kernel(linear=True)
def measure(waves, rows, lost, left):
    """Compute the squared residuals of the splines of every weight for some courses, into the rows of ``left`` (J, L).

    ``waves`` (J, 3, n) of the reflected courses; ``lost`` (n, L) share of their power.
    """
    n = len(lost)
    for r in range(len(rows)):
        sums, own = left[rows[r]], waves[rows[r]]
        sums[:] = 0.0
        for k in range(n):
            power = own[0, k] * own[0, k] + own[1, k] * own[1, k] + own[2, k] * own[2, k]
            power /= 2.0 * n if k else 4.0 * n
            for weight in range(len(sums)):
                sums[weight] += power * lost[k, weight]


@part
def find_middle(values):
    """Return the median of ``values`` (n,), which are reordered (Hoare's selection)."""
    wanted, first, last = len(values) // 2, 0, len(values) - 1
    while first < last:
        pivot, i, j = values[(first + last) // 2], first, last
        while i <= j:
            while values[i] < pivot:
                i += 1
            while pivot < values[j]:
                j -= 1
            if i <= j:
                values[i], values[j] = values[j], values[i]
                i, j = i + 1, j - 1
        if wanted <= j:
            last = j
        elif wanted >= i:
            first = i
        else:
            break
    upper = values[wanted]
    if len(values) % 2:
        return upper
    lower = values[0]
    for k in range(1, wanted):
        lower = max(lower, values[k])
    return 0.5 * (lower + upper)


@part
def choose(left, freedom, n, room, chosen):
    """Choose the spline of each course, into ``chosen`` (J,); return the variance of the errors of all.

    ``left`` (J, L) of ``measure``, ``freedom`` (L,) of the splines, ``room`` (2, J).
    """
    sizes, ordered = room
    for j in range(len(left)):
        best, least = 0, np.inf
        for weight in range(len(freedom)):
            score = left[j, weight] / (n - freedom[weight]) ** 2
            if score < least:
                best, least = weight, score
        sizes[j] = ordered[j] = left[j, best] / (3.0 * (n - freedom[best]))
    variance = find_middle(ordered)
    # Errors above the median variance count as measured; those below it are raised to the median.
    for j in range(len(left)):
        best, least = 0, np.inf
        for weight in range(len(freedom)):
            score = left[j, weight] + 6.0 * max(sizes[j], variance) * freedom[weight]
            if score < least:
                best, least = weight, score
        chosen[j] = best
    return variance


@kernel(linear=True)
def choose_all(left, freedom, n, recordings, n_joints, room, chosen, variances):
    """Do ``choose`` for ``recordings`` (R,) of those in ``left`` and ``chosen``, with variances into ``variances``
    (R,).
    """
    for r in range(len(recordings)):
        first, stop = recordings[r] * n_joints, (recordings[r] + 1) * n_joints
        variances[r] = choose(left[first:stop], freedom, n, room, chosen[first:stop])


@kernel(linear=True)
def believe(courses, smooth, limit, rows, room, changed, believed, glitches):
    """Replace glitches by the splines' values, into ``believed`` (J, 3, n), for joints with any.

    A glitch is a place whose squared error is beyond ``limit`` medians of its joint. ``rows`` (R,) are the joints to
    check; ``changed`` (J,) those with a glitch before or now; ``room`` (2, n). The number in each recording is added to
    ``glitches``, which has one entry for each, of as many joints.
    """
    n, n_joints = courses.shape[2], len(courses) // len(glitches)
    squared, ordered = room
    for j in rows:
        for t in range(n):
            square = 0.0
            for axis in range(3):
                square += (courses[j, axis, t] - smooth[j, axis, t]) ** 2
            squared[t] = ordered[t] = square
        beyond, here = limit * find_middle(ordered), 0
        for t in range(n):
            here += squared[t] > beyond
        glitches[j // n_joints] += here
        changed[j] = changed[j] or here > 0
        if changed[j]:
            for axis in range(3):
                for t in range(n):
                    believed[j, axis, t] = smooth[j, axis, t] if squared[t] > beyond else courses[j, axis, t]


@kernel(linear=True)
def measure_chain(points, bones, shares, lengths):
    """Return the median over time of the length of a chain of bones.

    ``points`` (n, J, 3) finite; ``bones`` (B, 3) are joints: one end, and two whose middle is the other end; ``shares``
    (B,) of them; ``lengths`` (n,) is working memory.
    """
    for t in range(len(points)):
        lengths[t] = 0.0
        for b in range(len(bones)):
            square = 0.0
            for axis in range(3):
                end = 0.5 * points[t, bones[b, 1], axis] + 0.5 * points[t, bones[b, 2], axis]
                square += (points[t, bones[b, 0], axis] - end) ** 2
            lengths[t] += np.sqrt(square) * shares[b]
    return find_middle(lengths)


@kernel(linear=True)
def measure_unsteadiness(points, bones, room):
    """Return the standard deviation of a bone's length as a share of its median, the median over the bones; or 0.

    ``points`` (n, J, 3); ``bones`` (B, 2) are joints, left out if missing in any frame; ``room`` (2, R) for n or B
    numbers.
    """
    lengths, shares = room
    n, found = len(points), 0
    for b in range(len(bones)):
        total, there = 0.0, True
        for t in range(n):
            square = 0.0
            for axis in range(3):
                square += (points[t, bones[b, 0], axis] - points[t, bones[b, 1], axis]) ** 2
            lengths[t] = np.sqrt(square)
            there = there and np.isfinite(lengths[t])
            total += lengths[t]
        if not there:
            continue
        mean, spread = total / n, 0.0
        for t in range(n):
            spread += (lengths[t] - mean) ** 2
        middle = find_middle(lengths[:n])
        if middle > 0.0:
            shares[found] = np.sqrt(spread / n) / middle
            found += 1
    return find_middle(shares[:found]) if found else 0.0
