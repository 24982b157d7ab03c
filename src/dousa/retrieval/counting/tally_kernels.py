"""Compiled loops of the tallies: the poses of a part of a recording, its curves over time, and their swings.

``counter`` describes the numbers. Curves stand in rows. No allocations, which halves the compile time.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from dousa.retrieval.features.channel_kernels import find_lateral, smooth
from dousa.retrieval.features.noise_kernels import find_middle

_njit: Any = njit  # whose types leave out some of its options
compiled = _njit(cache=True, nogil=True, error_model="numpy", no_cfunc_wrapper=True, _nrt=False)
# Sums in any order, many terms at a time.
_summing = _njit(
    cache=True, nogil=True, error_model="numpy", no_cfunc_wrapper=True, _nrt=False, fastmath={"reassoc", "contract"}
)

_TINY = 1e-200  # keeps pivots and lengths from 0; far above the smallest number of float64 (IEEE 754)


@_summing
def dot(one, other):
    """Return the scalar product of two vectors (n,)."""
    total = 0.0
    for k in range(len(one)):
        total += one[k] * other[k]
    return total


@_summing
def square_curves(curves, square):
    """Compute the products of all curves (K, n) with each other, into ``square`` (K, K)."""
    count, n = curves.shape
    for a in range(count):
        for b in range(a + 1):
            total = 0.0
            for t in range(n):
                total += curves[a, t] * curves[b, t]
            square[a, b] = square[b, a] = total


@compiled
def _reduce(square, diagonal, beside, moved):
    """Make a symmetric matrix (K, K) tridiagonal: ``diagonal`` (K,) and ``beside`` it (K,), the last of which is 0.

    The reflection vectors stay in the rows of ``square``, right of the diagonal; ``moved`` (K,) is working memory.
    """
    count = len(square)
    for k in range(count - 1):
        diagonal[k] = square[k, k]
        mirror = square[k, k + 1 :]
        length = np.sqrt(dot(mirror, mirror))
        beside[k] = -length if mirror[0] > 0.0 else length
        mirror[0] -= beside[k]
        size = np.sqrt(dot(mirror, mirror))
        if size <= _TINY:
            mirror[:] = 0.0
            continue
        for i in range(len(mirror)):
            mirror[i] /= size
        some = moved[: len(mirror)]
        for i in range(len(mirror)):
            some[i] = 2.0 * dot(square[k + 1 + i, k + 1 :], mirror)
        share = dot(some, mirror)
        for i in range(len(mirror)):
            some[i] -= share * mirror[i]
        for i in range(len(mirror)):
            row, one, other = square[k + 1 + i, k + 1 :], mirror[i], some[i]
            for j in range(len(mirror)):
                row[j] -= one * some[j] + other * mirror[j]
    diagonal[count - 1], beside[count - 1] = square[count - 1, count - 1], 0.0


@compiled
def _keep_away(pivot):
    return -_TINY if abs(pivot) < _TINY else pivot


@compiled
def _find_value(diagonal, beside, rank):
    """Return the eigenvalue of a tridiagonal matrix with ``rank`` larger ones, by overlapping pairs of bisections."""
    count, low, high = len(diagonal), np.inf, -np.inf
    for k in range(count):
        radius = abs(beside[k]) + (abs(beside[k - 1]) if k else 0.0)
        low, high = min(low, diagonal[k] - radius), max(high, diagonal[k] + radius)
    least = 1e-9 * max(abs(low), abs(high)) + _TINY
    while high - low > least:
        middle = 0.5 * (low + high)
        below, above = 0.5 * (low + middle), 0.5 * (middle + high)
        lower, larger, upper, one, two, three = 0, 0, 0, 1.0, 1.0, 1.0
        for k in range(count):
            square = beside[k - 1] * beside[k - 1] if k else 0.0
            one, two, three = (
                _keep_away(diagonal[k] - below - square / one),
                _keep_away(diagonal[k] - middle - square / two),
                _keep_away(diagonal[k] - above - square / three),
            )
            lower, larger, upper = lower + (one > 0.0), larger + (two > 0.0), upper + (three > 0.0)
        for half, found in ((middle, larger), (above, upper) if larger > rank else (below, lower)):
            if high - low > least:
                low, high = (half, high) if found > rank else (low, half)
    return 0.5 * (low + high)


@compiled
def _solve(diagonal, beside, value, rows, found):
    """Solve (T - value) x = ``found`` (K,) in place, T tridiagonal, by elimination with exchanged rows.

    ``rows`` (3, K) is working memory: the remaining diagonal, and the two right of it.
    """
    count = len(diagonal)
    scale = _TINY
    for k in range(count):
        scale = max(scale, abs(diagonal[k]), abs(beside[k]))
    own, next_, after = rows
    own[0], next_[0], after[0] = diagonal[0] - value, beside[0], 0.0
    for k in range(count - 1):
        below, middle, right = beside[k], diagonal[k + 1] - value, beside[k + 1]
        if abs(below) > abs(own[k]):
            share = own[k] / below
            own[k + 1], next_[k + 1] = next_[k] - share * middle, -share * right
            own[k], next_[k], after[k] = below, middle, right
            found[k], found[k + 1] = found[k + 1], found[k] - share * found[k + 1]
        else:
            if abs(own[k]) < 1e-16 * scale:
                own[k] = 1e-16 * scale
            share = below / own[k]
            own[k + 1], next_[k + 1], after[k] = middle - share * next_[k], right, 0.0
            found[k + 1] -= share * found[k]
    if abs(own[count - 1]) < 1e-16 * scale:
        own[count - 1] = 1e-16 * scale
    for k in range(count - 1, -1, -1):
        rest = found[k]
        if k + 1 < count:
            rest -= next_[k] * found[k + 1]
        if k + 2 < count:
            rest -= after[k] * found[k + 2]
        found[k] = rest / own[k]


@compiled
def find_axes(square, room, axes):
    """Find the directions of most variation, unit and in order, into ``axes`` (A, K); their signs are arbitrary.

    ``square`` (K, K), symmetric, is overwritten; ``room`` (6, K) or wider is working memory.
    """
    count = len(square)
    diagonal, beside, rows = room[0, :count], room[1, :count], room[2:5]
    _reduce(square, diagonal, beside, room[5])
    for number in range(len(axes)):
        axis, value = axes[number], _find_value(diagonal, beside, number)
        for k in range(count):
            axis[k] = 1.0 + 0.1 * ((7 * k) % 11)  # unlikely to be orthogonal to a direction
        for _ in range(4):  # rounds of inverse iteration
            _solve(diagonal, beside, value, rows, axis)
            for before in range(number):
                share = dot(axes[before], axis)
                for k in range(count):
                    axis[k] -= share * axes[before, k]
            largest = 0.0
            for k in range(count):
                largest = max(largest, abs(axis[k]))
            for k in range(count):
                axis[k] /= largest
            length = np.sqrt(dot(axis, axis))
            for k in range(count):
                axis[k] /= length
    for number in range(len(axes)):
        for k in range(count - 2, -1, -1):
            mirror, part = square[k, k + 1 :], axes[number, k + 1 :]
            share = 2.0 * dot(mirror, part)
            for i in range(len(part)):
                part[i] -= share * mirror[i]


@compiled
def describe(sampled, height, weights, hips, shoulders, joints, room, left, poses):
    """Compute smoothed places of ``joints`` (K,) in the body-fixed system, into ``poses`` (3 K, n), body heights.

    ``sampled`` (n, J, 3) m; ``weights`` as of ``smooth``; ``room`` (n, J, 3) and ``left`` (n, 2) are working memory.
    """
    n, width = len(sampled), 3 * sampled.shape[1]
    smooth(sampled.reshape(n, width), weights, room.reshape(n, width))
    find_lateral(room, hips, shoulders, left)
    for k in range(len(joints)):
        joint = joints[k]
        for t in range(n):
            across, along = left[t, 0], left[t, 1]
            x = (room[t, joint, 0] - room[t, 0, 0]) / height
            z = (room[t, joint, 2] - room[t, 0, 2]) / height
            poses[3 * k, t] = x * across + z * along
            poses[3 * k + 1, t] = (room[t, joint, 1] - room[t, 0, 1]) / height
            poses[3 * k + 2, t] = z * across - x * along


@compiled
def differentiate(poses, velocities, speeds):
    """Compute changes of poses (K, n) a frame, into ``velocities`` (K, n), and their speed, into ``speeds`` (n,)."""
    count, n = poses.shape
    speeds[:] = 0.0
    for k in range(count):
        curve, slopes = poses[k], velocities[k]
        slopes[0], slopes[n - 1] = curve[1] - curve[0], curve[n - 1] - curve[n - 2]
        inner, after = slopes[1:], curve[2:]
        for t in range(n - 2):
            inner[t] = (after[t] - curve[t]) / 2.0
        for t in range(n):
            speeds[t] += slopes[t] * slopes[t]
    for t in range(n):
        speeds[t] = np.sqrt(speeds[t])


@compiled
def fold(poses, others, even):
    """Compute the movement common to both sides, into ``even`` (E, n): half of poses (3 K, n) plus their mirror images.

    ``others`` (K,) is the joint on the other side, or the same one in the middle, whose first curve is then 0 and left
    out; two sides share one curve, larger by the root of two.
    """
    row, root = 0, np.sqrt(0.5)
    for k in range(len(others)):
        other = others[k]
        for axis in range(3):
            if other < k or (other == k and axis == 0):
                continue
            one, two, sign = poses[3 * k + axis], poses[3 * other + axis], -1.0 if axis == 0 else 1.0
            for t in range(poses.shape[1]):
                even[row, t] = one[t] if other == k else root * (one[t] + sign * two[t])
            row += 1


@compiled
def square(curves, centred, squares):
    """Compute the products of curves (K, n) less their means, into ``squares`` (K, K), those curves into ``centred``
    (K, n).
    """
    for k in range(len(curves)):
        total = 0.0
        for t in range(curves.shape[1]):
            total += curves[k, t]
        middle = total / curves.shape[1]
        for t in range(curves.shape[1]):
            centred[k, t] = curves[k, t] - middle
    square_curves(centred, squares)


@compiled
def project(curves, axis, along):
    """Project curves (K, n) on a direction (K,), into ``along`` (n,)."""
    along[:] = 0.0
    for k in range(len(curves)):
        share = axis[k]
        for t in range(len(along)):
            along[t] += share * curves[k, t]


@compiled
def level(curve):
    """Subtract the mean and the line of least squares from a curve (n,), in place."""
    n, mean, moment, squared = len(curve), 0.0, 0.0, 0.0
    for t in range(n):
        time = t - 0.5 * (n - 1)
        mean += curve[t] / n
        moment += time * curve[t]
        squared += time * time
    for t in range(n):
        curve[t] -= mean + moment / squared * (t - 0.5 * (n - 1))


@compiled
def find_distances(poses, speeds, calm, near, some_poses, distances):
    """Compute distances of poses (K, n) from the pose at rest, into ``distances`` (n,).

    That is the pose with the least median distance to the others among those at a speed of at most ``calm``; of very
    many, a sample. ``some_poses`` (M, K) and ``near`` (M,) are working memory.
    """
    count, n = poses.shape
    calm_ones, some, seen = 0, 0, 0
    for t in range(n):
        calm_ones += speeds[t] <= calm
    step = max(calm_ones // (len(near) // 2), 1)
    for t in range(n):
        if speeds[t] <= calm:
            if seen % step == 0:
                for k in range(count):
                    some_poses[some, k] = poses[k, t]
                some += 1
            seen += 1
    best, least = 0, np.inf
    for a in range(some):
        for b in range(some):
            near[b] = 0.0
            for k in range(count):
                near[b] += (some_poses[a, k] - some_poses[b, k]) ** 2
        middle = find_middle(near[:some])
        if middle < least:
            best, least = a, middle
    distances[:] = 0.0
    for k in range(count):
        at_rest = some_poses[best, k]
        for t in range(n):
            distances[t] += (poses[k, t] - at_rest) ** 2
    for t in range(n):
        distances[t] = np.sqrt(distances[t])


@compiled
def sort_into(values, ordered, room):
    """Sort values (n,) into ``ordered`` (n,) by merging runs; ``room`` (n,) is working memory."""
    n, size, swapped = len(values), 8, False
    for first in range(0, n, size):
        for k in range(first, min(first + size, n)):
            value, place = values[k], k
            while place > first and ordered[place - 1] > value:
                ordered[place] = ordered[place - 1]
                place -= 1
            ordered[place] = value
    source, target = ordered, room
    while size < n:
        for first in range(0, n, 2 * size):
            middle, last = min(first + size, n), min(first + 2 * size, n)
            one, two = first, middle
            for k in range(first, last):
                if one < middle and (two >= last or source[one] <= source[two]):
                    target[k] = source[one]
                    one += 1
                else:
                    target[k] = source[two]
                    two += 1
        source, target, size, swapped = target, source, 2 * size, not swapped
    for k in range(n if swapped else 0):
        ordered[k] = room[k]


@compiled
def read_quantile(ordered, share):
    """Return a quantile of sorted values (n,), interpolated linearly as by ``np.quantile``."""
    place = (len(ordered) - 1) * share
    below = int(place)
    low, high, part = ordered[below], ordered[min(below + 1, len(ordered) - 1)], place - below
    return low + (high - low) * part if part < 0.5 else high - (high - low) * (1.0 - part)


@compiled
def find_range(ordered, turns):
    """Return the quantiles of 5 and of 95 % of a curve with sorted values ``ordered`` (n,), and a sign.

    With ``turns``, of the curve or its negative, such that most of the time is spent low, as repetitions leave a rest.
    """
    low, high = read_quantile(ordered, 0.05), read_quantile(ordered, 0.95)
    if turns and read_quantile(ordered, 0.5) > 0.5 * (ordered[0] + ordered[-1]):
        return -high, -low, -1.0
    return low, high, 1.0


@compiled
def count_swings(curve, sign, least):
    """Count tops and bottoms of ``sign`` times a curve (n,) that differ by ``least`` from those before and after."""
    tops = bottoms = rising = 0
    high = low = sign * curve[0]
    least = max(least, 1e-9)  # a curve that does not move has no swings
    for t in range(len(curve)):
        value = sign * curve[t]
        high, low = max(high, value), min(low, value)
        if rising >= 0 and value <= high - least:
            tops, rising, low = tops + 1, -1, value
        elif rising <= 0 and value >= low + least:
            bottoms, rising, high = bottoms + 1, 1, value
    return tops + (rising > 0), bottoms + (rising < 0)


@compiled
def count_crossings(curve, sign, middle):
    """Return half of how often ``sign`` times a curve (n,) crosses ``middle``."""
    crossed = 0
    for t in range(1, len(curve)):
        crossed += (sign * curve[t] > middle) != (sign * curve[t - 1] > middle)
    return 0.5 * crossed


@compiled
def count_bouts(speeds, moving, gap):
    """Count bouts of movement: frames faster than ``moving`` with more than ``gap`` frames of rest between them."""
    bouts, last = 1, -1
    for t in range(len(speeds)):
        if speeds[t] > moving:
            bouts += last >= 0 and t - last > gap
            last = t
    return bouts


@compiled
def correlate(curves, first, last, products):
    """Sum products of curves (K, n), from ``first`` to before ``last``, at lags 0, 1, 2 ... frames, into ``products``
    (L,).

    Slices count from 0, as a sum as index may be negative to the compiler and prevents vectorisation.
    """
    most = len(products)
    products[:] = 0.0
    for k in range(len(curves)):
        for t in range(first, last):
            later = curves[k, t:]
            for lag in range(min(most, last - t)):
                products[lag] += later[0] * later[lag]


@compiled
def normalise(curves, first, last, energy, products):
    """Scale products (L,) of ``correlate`` to a correlation, -1 to 1; ``energy`` (n + 1,) is working memory."""
    n = last - first
    energy[:] = 0.0
    summed = energy[1:]
    for k in range(len(curves)):
        curve = curves[k, first:]
        for t in range(n):
            summed[t] += curve[t] * curve[t]
    for t in range(n):
        energy[t + 1] += energy[t]
    for lag in range(len(products)):
        before, after = energy[n - lag], energy[n] - energy[lag]
        products[lag] /= max(np.sqrt(before * after), 1e-12)


@compiled
def find_period(likeness, shortest, least, nearly):
    """Return the first lag whose ``likeness`` (L,) is nearly the highest; 0 for none.

    Only peaks from ``shortest`` on count; the highest must be at least ``least``.
    """
    highest = -1.0
    for lag in range(shortest, len(likeness) - 1):
        if likeness[lag - 1] <= likeness[lag] and likeness[lag] > likeness[lag + 1]:
            highest = max(highest, likeness[lag])
    if highest < least:
        return 0
    for lag in range(shortest, len(likeness) - 1):
        top = likeness[lag - 1] <= likeness[lag] and likeness[lag] > likeness[lag + 1]
        if top and likeness[lag] >= nearly * highest:
            return lag
    return 0
