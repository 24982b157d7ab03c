"""Compiled loops of the tallies: the poses of a part of a recording, its curves over time, and what swings on them.

What each number is for is told in ``tallies``. Curves stand in rows, time after time. Nothing here allocates: without
reference counts it compiles in half the time.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from dousa.retrieval.counting.axis_kernels import square_curves
from dousa.retrieval.features.channel_kernels import find_lateral, smooth
from dousa.retrieval.features.noise_kernels import find_middle

_njit: Any = njit  # whose types leave out some of its options
compiled = _njit(cache=True, nogil=True, error_model="numpy", no_cfunc_wrapper=True, _nrt=False)


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
