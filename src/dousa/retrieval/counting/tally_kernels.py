"""Compiled loops of the tallies: the poses of a part of a recording, its curves over time, and what swings on them.

What each number is for is told in ``tallies``. Curves stand in rows, time after time. Nothing here allocates: without
reference counts it compiles in half the time.
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

_NEAR = 1e-9  # of the largest value: so near is each found; the rounds do the rest
_ROUNDS = 4  # of inverse iteration
_TINY = 1e-200


@_summing
def dot(one, other):
    """The scalar product of two vectors (n,)."""
    total = 0.0
    for k in range(len(one)):
        total += one[k] * other[k]
    return total


@_summing
def square_curves(curves, square):
    """The products of all curves (K, n) with each other, into ``square`` (K, K)."""
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

    What is reflected at stands in the rows of ``square``, right of the diagonal; ``moved`` (K,) is working memory.
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
    """A pivot that can be divided by."""
    return -_TINY if abs(pivot) < _TINY else pivot


@compiled
def _find_value(diagonal, beside, rank):
    """The eigenvalue of a tridiagonal matrix than which ``rank`` are larger.

    Two halvings at a time: a processor divides for the middle and both of the next middles while it would wait for one.
    """
    count, low, high = len(diagonal), np.inf, -np.inf
    for k in range(count):
        radius = abs(beside[k]) + (abs(beside[k - 1]) if k else 0.0)
        low, high = min(low, diagonal[k] - radius), max(high, diagonal[k] + radius)
    least = _NEAR * max(abs(low), abs(high)) + _TINY
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

    ``rows`` (3, K) is working memory: the diagonal of what is left, and what stands right of it.
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
    """The directions in which something varies most, of length 1, the first most, into ``axes`` (A, K).

    ``square`` (K, K), symmetric, is used up; ``room`` (6, K) or wider is working memory. Which way each points is open.
    """
    count = len(square)
    diagonal, beside, rows = room[0, :count], room[1, :count], room[2:5]
    _reduce(square, diagonal, beside, room[5])
    for number in range(len(axes)):
        axis, value = axes[number], _find_value(diagonal, beside, number)
        for k in range(count):
            axis[k] = 1.0 + 0.1 * ((7 * k) % 11)  # no direction is at right angles to it but by chance
        for _ in range(_ROUNDS):
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
    """Smoothed places of some joints in the body-fixed system.

    ``sampled`` (n, J, 3) m; ``weights`` as of ``smooth``; ``joints`` (K,); ``room`` (n, J, 3) and ``left`` (n, 2) are
    working memory. Into ``poses`` (3 K, n), body heights.
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
    """How poses (K, n) change a frame, into ``velocities`` (K, n), and how fast all do, into ``speeds`` (n,)."""
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
    """What both sides do, half each: of poses (3 K, n) the mean with their mirror images, into ``even`` (E, n).

    ``others`` (K,) is the joint on the other side, or the same one in the middle, of whose three curves one is always
    0 and left out; of two sides, which do the same, there is one, larger by the root of two.
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
    """The products of curves (K, n) less their means, into ``squares`` (K, K), those curves into ``centred`` (K, n)."""
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
    """Curves (K, n) along a direction (K,), into ``along`` (n,)."""
    along[:] = 0.0
    for k in range(len(curves)):
        share = axis[k]
        for t in range(len(along)):
            along[t] += share * curves[k, t]


@compiled
def level(curve):
    """Take the mean and the line of least squares off a curve (n,), in place."""
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
    """How far poses (K, n) are from the pose at rest, into ``distances`` (n,).

    That is, of the calm poses, those of at most this speed, the one that most others are like; of very many, some of
    them: as many as fit into ``some_poses`` (M, K) half filled. That and ``near`` (M,) are working memory.
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
    """Values (n,) in ascending order, into ``ordered`` (n,), by merging runs; ``room`` (n,) is working memory."""
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
    """A quantile of values (n,) that are sorted, linear between two of them, as ``np.quantile`` has it."""
    place = (len(ordered) - 1) * share
    below = int(place)
    low, high, part = ordered[below], ordered[min(below + 1, len(ordered) - 1)], place - below
    return low + (high - low) * part if part < 0.5 else high - (high - low) * (1.0 - part)


@compiled
def find_range(ordered, turns):
    """Where a curve ranges whose values are ``ordered`` (n,): the quantiles of 5 and of 95 %.

    With ``turns``, of the curve or of its negative, such that most of the time is spent low: repetitions leave a rest.
    The third is the sign.
    """
    low, high = read_quantile(ordered, 0.05), read_quantile(ordered, 0.95)
    if turns and read_quantile(ordered, 0.5) > 0.5 * (ordered[0] + ordered[-1]):
        return -high, -low, -1.0
    return low, high, 1.0


@compiled
def count_swings(curve, sign, least):
    """Tops, and bottoms, of ``sign`` times a curve (n,) that differ by so much from those before and after."""
    tops = bottoms = rising = 0
    high = low = sign * curve[0]
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
    """Half of how often ``sign`` times a curve (n,) crosses a value."""
    crossed = 0
    for t in range(1, len(curve)):
        crossed += (sign * curve[t] > middle) != (sign * curve[t - 1] > middle)
    return 0.5 * crossed


@compiled
def count_bouts(speeds, moving, gap):
    """Bouts of movement: frames faster than ``moving`` with more than ``gap`` frames of rest between them."""
    bouts, last = 1, -1
    for t in range(len(speeds)):
        if speeds[t] > moving:
            bouts += last >= 0 and t - last > gap
            last = t
    return bouts


@compiled
def correlate(curves, first, last, products):
    """The products of curves (K, n), from frame ``first`` to before ``last``, with themselves 0, 1, 2 ... frames later.

    Into ``products`` (L,). An index that is a sum may be negative to the compiler, which then handles one value at a
    time; a slice is counted from 0.
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
    """Make products (L,) of ``correlate`` a correlation, -1 to 1; ``energy`` (n + 1,) is working memory."""
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
def find_period(likeness, shortest, alike, nearly):
    """The first lag at which what moves resembles itself nearly as well as at any, of ``likeness`` (L,); 0 for none.

    A lag counts from ``shortest`` on where the likeness is higher than around it, and at least ``alike``.
    """
    highest = -1.0
    for lag in range(shortest, len(likeness) - 1):
        if likeness[lag - 1] <= likeness[lag] and likeness[lag] > likeness[lag + 1]:
            highest = max(highest, likeness[lag])
    if highest < alike:
        return 0
    for lag in range(shortest, len(likeness) - 1):
        top = likeness[lag - 1] <= likeness[lag] and likeness[lag] > likeness[lag + 1]
        if top and likeness[lag] >= nearly * highest:
            return lag
    return 0
