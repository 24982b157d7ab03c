"""Compiled loops of the relations: the body-fixed system, and which relation holds in which frame.

The rows are in the order of ``relations``. A missing joint (NaN) fulfils no relation.
"""

from __future__ import annotations

import math

import numpy as np

from dousa.kernels import kernel, part
from dousa.retrieval.features.channel_kernels import wrap

_LEFT, _RIGHT = 0, 1


@kernel(linear=True)
def average(values, half, total, out):
    """Average ``values`` (n, K) over the frames within ``half`` of each into ``out``.

    ``total`` (n + 1, K) is room for sums; its first row is 0.
    """
    n, count = values.shape
    for t in range(n):
        for k in range(count):
            total[t + 1, k] = total[t, k] + values[t, k]
    for t in range(n):
        first, last = max(t - half, 0), min(t + half + 1, n)
        for k in range(count):
            out[t, k] = (total[last, k] - total[first, k]) / (last - first)


@part
def slope(values, t, rate):
    """Change per second of ``values`` (n,) at frame t, over a few frames on either side."""
    first, last = max(t - 2, 0), min(t + 2, len(values) - 1)
    return (values[last] - values[first]) * rate / max(last - first, 1)


@kernel(linear=True)
def turn(points, left, rate, body, lowest, speed, turned):
    """Compute the body-fixed system of every frame.

    ``points`` (n, J, 3) in body heights with Y up, ``left`` (n, 2), brought to length 1; fills ``body`` (n, J, 3) left,
    up and forward of the first joint, ``lowest`` (n,) height of any joint, ``speed`` (n, 2) of the first joint along X
    and Z, ``turned`` (n,) radians to the left since the beginning.
    """
    around, before = 0.0, 0.0
    for t in range(len(points)):
        length = max(np.hypot(left[t, 0], left[t, 1]), 1e-9)
        across, along = left[t, 0] / length, left[t, 1] / length
        left[t, 0], left[t, 1] = across, along
        lowest[t] = np.nan
        for j in range(points.shape[1]):
            x, y, z = points[t, j, 0] - points[t, 0, 0], points[t, j, 1], points[t, j, 2] - points[t, 0, 2]
            body[t, j, 0] = x * across + z * along
            body[t, j, 1] = y - points[t, 0, 1]
            body[t, j, 2] = -x * along + z * across
            if y < lowest[t] or np.isnan(lowest[t]):
                lowest[t] = y
        speed[t, 0], speed[t, 1] = slope(points[:, 0, 0], t, rate), slope(points[:, 0, 2], t, rate)
        # Seen from above, a turn to the left takes x towards -z.
        angle = math.atan2(-along, across)
        around += 0.0 if t == 0 else wrap(angle - before)
        turned[t], before = around, angle


@part
def _norm(a):
    return np.sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2])


@part
def _apart(a, b):
    return np.sqrt((a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2 + (a[2] - b[2]) ** 2)


@kernel(linear=True)
def ask_arms(body, head, limbs, holds):
    """Arms above the head, level, aside, ahead, elbow bent: into ``holds`` (5, 2, n).

    ``head`` is a joint, ``limbs`` (2, 4) are shoulder, elbow, wrist and hand of either side.
    """
    for side in (_LEFT, _RIGHT):
        shoulder, elbow, wrist, hand = limbs[side]
        outward = 1.0 - 2.0 * side
        for t in range(len(body)):
            at, middle, end = body[t, shoulder], body[t, elbow], body[t, hand]
            x, y, z = end[0] - at[0], end[1] - at[1], end[2] - at[2]
            far = _apart(end, at) > 0.24  # a straight arm has 0.3 to 0.4
            holds[0, side, t] = end[1] > body[t, head, 1]
            holds[1, side, t] = far and abs(y) < 0.1
            holds[2, side, t] = far and outward * x > 0.17 and y > -0.2 and y < 0.25
            holds[3, side, t] = far and z > 0.2 and abs(x) < z and y > -0.15
            # A right angle or less has a cosine above 0.
            cosine = 0.0
            for axis in range(3):
                cosine += (at[axis] - middle[axis]) * (body[t, wrist, axis] - middle[axis])
            holds[4, side, t] = cosine > 0.0


@kernel(linear=True)
def ask_hands(body, heights, head, limbs, rate, reach, holds):
    """Hands together, meeting, crossed, waving, circling, thrust, behind, low, at the head: into ``holds`` (9, 2, n).

    ``reach`` (n, 3) is room for the vector from a shoulder to its hand.
    """
    n = len(body)
    left, right = body[:, limbs[_LEFT, 3]], body[:, limbs[_RIGHT, 3]]
    meetings = 0
    for t in range(n):
        holds[0, 0, t] = _apart(left[t], right[t]) < 0.1
        meetings += t > 0 and holds[0, 0, t] and not holds[0, 0, t - 1]
        in_front = left[t, 2] > 0.03 and right[t, 2] > 0.03
        holds[2, 0, t] = in_front and left[t, 0] < right[t, 0] - 0.05
    for t in range(n):
        under = left[t, 1] < body[t, head, 1] and right[t, 1] < body[t, head, 1]
        holds[1, 0, t] = meetings >= 2 and holds[0, 0, t] and under
    for side in (_LEFT, _RIGHT):
        shoulder, hand = limbs[side, 0], limbs[side, 3]
        for t in range(n):
            for axis in range(3):
                reach[t, axis] = body[t, hand, axis] - body[t, shoulder, axis]
        _find_waves(reach, holds[3, side])
        for axis in (1, 0):
            _find_circles(reach, axis, holds[4, side])
        for t in range(n):
            end = body[t, hand]
            holds[5, side, t] = slope(reach[:, 2], t, rate) > 1.0 and end[1] > body[t, shoulder, 1] - 0.2
            holds[6, side, t] = end[2] < -0.1
            holds[7, side, t] = heights[t, hand] < 0.2
            holds[8, side, t] = _apart(end, body[t, head]) < 0.13


@part
def _find_waves(reach, holds):
    """Mark three or more swings from side to side, hand not hanging; ``reach`` (n, 3) from the shoulder."""
    turns, first, last = 0, 0, 0
    mark, best, way = np.nan, 0.0, 0
    for t in range(len(reach)):
        value = reach[t, 0]
        if not reach[t, 1] > -0.12 or np.isnan(value):
            if turns < 3:
                turns, mark, way = 0, np.nan, 0
            continue
        if np.isnan(mark):
            mark = best = value
        if (way > 0 and value > best) or (way < 0 and value < best):
            best = value
        step = value - (best if way != 0 else mark)
        if abs(step) > 0.05 and np.sign(step) != way:
            way, best = (1 if step > 0 else -1), value
            first = t if turns == 0 else first
            last = t
            turns += 1
    for t in range(first, last + 1 if turns >= 4 else first):
        holds[t] = reach[t, 1] > -0.12


@part
def _find_circles(reach, axis, holds):
    """Mark a whole turn of the arm about the shoulder in the plane of an axis and the next; ``reach`` (n, 3)."""
    n, wide = len(reach), 0
    around, lowest, highest, before = 0.0, 0.0, 0.0, 0.0
    for t in range(n):
        a, b = reach[t, axis], reach[t, axis + 1]
        wide += np.hypot(a, b) > 0.15
        angle = math.atan2(a, b)
        around += 0.0 if t == 0 else wrap(angle - before)
        lowest, highest, before = min(lowest, around), max(highest, around), angle
    if wide >= 0.8 * n and highest - lowest > np.radians(330.0):
        for t in range(n):
            if np.hypot(reach[t, axis], reach[t, axis + 1]) > 0.15:
                holds[t] = True


@kernel(linear=True)
def ask_legs(body, heights, legs, rate, starts, holds):
    """Foot raised, knee raised, kicking forward, stepping aside, legs apart: into ``holds`` (5, 2, n).

    ``legs`` (2, 2) are knee and ankle of either side, ``starts`` (2,) the first places of the feet to the left.
    """
    n = len(body)
    for side in (_LEFT, _RIGHT):
        knee, ankle = legs[side]
        outward, other = 1.0 - 2.0 * side, legs[1 - side, 1]
        swung = False
        for t in range(n):
            high = heights[t, ankle] - heights[t, other]
            holds[0, side, t] = high > 0.15
            holds[1, side, t] = body[t, knee, 1] > -0.12 and high > 0.08
            swung = swung or (high > 0.08 and slope(body[:, ankle, 2], t, rate) > 0.9)
            away = outward * body[t, ankle, 0]
            holds[3, side, t] = outward * (body[t, ankle, 0] - starts[side]) > 0.08 and away > 0.12
        for t in range(n):
            holds[2, side, t] = swung and holds[0, side, t] and body[t, ankle, 2] > 0.18
    for t in range(n):
        holds[4, 0, t] = abs(body[t, legs[_LEFT, 1], 0] - body[t, legs[_RIGHT, 1], 0]) > 0.3


@kernel(linear=True)
def ask_body(body, heights, head, neck, rise, rate, holds):
    """Lying, low, bent forward, getting up, getting down: into ``holds`` (5, 2, n); ``rise`` is that of the pelvis."""
    pelvis = heights[:, 0]
    highest = 0.0
    for t in range(len(body)):
        highest = pelvis[t] if pelvis[t] > highest else highest
    for t in range(len(body)):
        trunk = body[t, neck]
        lying = heights[t, head] < 0.35
        moving = abs(slope(pelvis, t, rate)) > 0.1
        holds[0, 0, t] = lying
        holds[1, 0, t] = pelvis[t] < max(0.4, 0.8 * highest) and not lying
        holds[2, 0, t] = trunk[1] / _norm(trunk) < 0.8 and trunk[2] > 0 and not lying
        holds[3, 0, t] = moving and rise > 0.1
        holds[4, 0, t] = moving and rise < -0.1


@kernel(linear=True)
def ask_travel(body, heights, speed, left, turned, hands, rate, holds):
    """Walking, running, walking back, going left and right, turning left and right, standing: into ``holds`` (8, 2, n).

    ``speed`` (n, 2) of the pelvis along X and Z, ``left`` (n, 2), ``turned`` (n,) and the joints ``hands`` (2,).
    """
    most, least = 0.0, 0.0
    for t in range(len(body)):
        most, least = max(most, turned[t]), min(least, turned[t])
    half = np.radians(50.0)
    for t in range(len(body)):
        to_left = speed[t, 0] * left[t, 0] + speed[t, 1] * left[t, 1]
        forward = -speed[t, 0] * left[t, 1] + speed[t, 1] * left[t, 0]
        fast, turning = np.hypot(to_left, forward), slope(turned, t, rate)
        holds[0, 0, t] = forward > 0.3 and fast < 1.2
        holds[1, 0, t] = fast > 1.2
        holds[2, 0, t] = forward < -0.2
        holds[3, 0, t] = to_left > 0.2 and to_left > abs(forward)
        holds[4, 0, t] = to_left < -0.2 and -to_left > abs(forward)
        holds[5, 0, t] = turning > 0.4 and most > half
        holds[6, 0, t] = turning < -0.4 and least < -half
        still = fast < 0.05 and heights[t, 0] > 0.42
        for joint in hands:
            square = 0.0
            for axis in range(3):
                square += slope(body[:, joint, axis], t, rate) ** 2
            still = still and np.sqrt(square) < 0.1
        holds[7, 0, t] = still


@kernel(linear=True)
def find_stretches(holds, found):
    """Find the longest stretches of ``holds`` (Q, 2, n), for both sides at once, the left alone and the right alone.

    ``found`` (Q, 3, 3) gets the number of frames, and the first and the frame after the last of the longest stretch.
    """
    n = holds.shape[2]
    for question in range(len(holds)):
        one, other = holds[question]
        for side in range(3):
            count, start, best, end = 0, 0, 0, 0
            for t in range(n + 1):
                true = False
                if t < n:
                    both = one[t] and other[t]
                    true = both if side == 0 else (one[t] if side == 1 else other[t]) and not both
                count += true
                if not true:
                    if t - start > end - best:
                        best, end = start, t
                    start = t + 1
            found[question, side, 0], found[question, side, 1], found[question, side, 2] = count, best, end
