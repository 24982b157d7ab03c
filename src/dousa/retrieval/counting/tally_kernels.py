"""Compiled loops of the tallies: the poses of a part of a recording, its curves over time, and what swings on them.

What each number is for is told in ``tallies``. Nothing here allocates: without reference counts it compiles in half the
time.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from dousa.retrieval.features.channel_kernels import find_lateral, smooth
from dousa.retrieval.features.noise_kernels import find_middle

_njit: Any = njit  # whose types leave out some of its options
compiled = _njit(cache=True, nogil=True, error_model="numpy", no_cfunc_wrapper=True, _nrt=False)


@compiled
def describe(sampled, height, weights, hips, shoulders, joints, room, left, poses, velocities, speeds):
    """Smoothed places of some joints in the body-fixed system, how they change a frame, and how fast all of it does.

    ``sampled`` (n, J, 3) m; ``weights`` as of ``smooth``; ``joints`` (K,); ``room`` (n, J, 3) and ``left`` (n, 2) are
    working memory. Into ``poses`` and ``velocities`` (n, 3 K), body heights, and ``speeds`` (n,).
    """
    n, width = len(sampled), 3 * sampled.shape[1]
    smooth(sampled.reshape(n, width), weights, room.reshape(n, width))
    for t in range(n):
        for axis in range(3):
            pelvis = room[t, 0, axis]
            for j in range(sampled.shape[1]):
                room[t, j, axis] = (room[t, j, axis] - pelvis) / height
    find_lateral(room, hips, shoulders, left)
    for t in range(n):
        across, along = left[t, 0], left[t, 1]
        for k in range(len(joints)):
            x, y, z = room[t, joints[k], 0], room[t, joints[k], 1], room[t, joints[k], 2]
            poses[t, 3 * k] = x * across + z * along
            poses[t, 3 * k + 1] = y
            poses[t, 3 * k + 2] = z * across - x * along
    for t in range(n):
        before, after = max(t - 1, 0), min(t + 1, n - 1)
        square = 0.0
        for k in range(poses.shape[1]):
            velocities[t, k] = (poses[after, k] - poses[before, k]) / (after - before)
            square += velocities[t, k] ** 2
        speeds[t] = np.sqrt(square)


@compiled
def fold(poses, velocities, others, even_poses, even_velocities, speeds):
    """What both sides do, half each: of poses and velocities (n, 3 K) the mean with their mirror images, and how fast.

    ``others`` (K,) is the joint on the other side. Into arrays of the same shapes, and ``speeds`` (n,).
    """
    for t in range(len(poses)):
        square = 0.0
        for k in range(len(others)):
            for axis in range(3):
                own, other, sign = 3 * k + axis, 3 * others[k] + axis, -1.0 if axis == 0 else 1.0
                even_poses[t, own] = 0.5 * (poses[t, own] + sign * poses[t, other])
                even_velocities[t, own] = 0.5 * (velocities[t, own] + sign * velocities[t, other])
                square += even_velocities[t, own] ** 2
        speeds[t] = np.sqrt(square)


@compiled
def level(curve):
    """Take the mean and the line of least squares off a curve (n,), in place."""
    n, mean, moment, square = len(curve), 0.0, 0.0, 0.0
    for t in range(n):
        time = t - 0.5 * (n - 1)
        mean += curve[t] / n
        moment += time * curve[t]
        square += time * time
    for t in range(n):
        curve[t] -= mean + moment / square * (t - 0.5 * (n - 1))


@compiled
def find_distances(poses, speeds, calm, room, near, distances):
    """How far poses (n, K) are from the pose at rest, into ``distances`` (n,).

    That is, of the calm poses, those of at most this speed, the one that most others are like; of very many, some of
    them: as many as fit into ``room`` (M,) half filled. ``near`` (M,) is working memory.
    """
    n, count, step = len(poses), 0, 1
    for t in range(n):
        count += speeds[t] <= calm
    step, some, seen = max(count // (len(room) // 2), 1), 0, 0
    for t in range(n):
        if speeds[t] <= calm:
            if seen % step == 0:
                room[some] = t
                some += 1
            seen += 1
    best, least = 0, np.inf
    for a in range(some):
        for b in range(some):
            near[b] = _measure_square(poses[room[a]], poses[room[b]])
        middle = find_middle(near[:some])
        if middle < least:
            best, least = a, middle
    for t in range(n):
        distances[t] = np.sqrt(_measure_square(poses[t], poses[room[best]]))


@compiled
def _measure_square(one, other):
    """The squared distance of two poses (K,)."""
    square = 0.0
    for k in range(len(one)):
        square += (one[k] - other[k]) ** 2
    return square


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
def correlate(curves, products):
    """Add up the products of curves (K, n) with themselves 0, 1, 2 ... frames later, into ``products`` (L,)."""
    n, most = curves.shape[1], len(products)
    for k in range(len(curves)):
        for t in range(n):
            value = curves[k, t]
            for lag in range(min(most, n - t)):
                products[lag] += value * curves[k, t + lag]
