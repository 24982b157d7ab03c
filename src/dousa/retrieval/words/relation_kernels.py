"""The compiled loop of the relations: the body-fixed system, and which relation holds in which frame and how long.

The rows are in the order of ``relations``. A missing joint (NaN) fulfils no relation.
"""

from __future__ import annotations

import math

import numpy as np

from dousa.kernels import kernel, part
from dousa.retrieval.features.channel_kernels import find_lateral, wrap

_LEFT, _RIGHT = 0, 1


@kernel(linear=True)
def find_stretches(
    values, points, height, rate, trunk, arms, legs, sides, body, total, ways, lines, reach, holds, found
):
    """Find the longest stretches of every relation, for both sides at once, the left alone and the right alone.

    Parameters
    ----------
    values, points : (n, 3 J) and (n, J, 3), the same numbers: m with Y up, the first joint the pelvis; written over.
    height, rate : m, Hz.
    trunk, arms, legs : joints: (2,) head and neck; of either side (2, 4) shoulder, elbow, wrist and hand, and (2, 2)
        knee and ankle.
    sides : (2, 2) hips and shoulders, left and right, between which the direction to the left is.
    body, total, ways, lines, reach, holds : room: (n, J, 3), (n + 1, 3 J), (2, n, 2), (n, 3), (n, 3), and (Q, 2, n) of
        false.
    found : (Q, 3, 3) gets the number of frames, and the first and the frame after the last of the longest stretch.
    """
    n = len(points)
    left, speed, lowest, turned, room = ways[0], ways[1], lines[:, 0], lines[:, 1], lines[:, 2]
    _average(values, 5, total)
    for t in range(n):
        for j in range(points.shape[1]):
            for axis in range(3):
                points[t, j, axis] /= height
                body[t, j, axis] = points[t, j, axis] - points[t, 0, axis]
    find_lateral(body, sides[0], sides[1], left)
    _average(left, 15, total)
    _turn(points, left, rate, body, lowest, speed, turned)
    _average(speed, 21, total)  # it varies with every step
    # Without feet the floor is unknown, and so are heights.
    floor, heights, has_feet = _find_percentile(lowest, 5.0, room), points[:, :, 1], False
    for t in range(n):
        has_feet = has_feet or np.isfinite(heights[t, legs[_LEFT, 1]]) or np.isfinite(heights[t, legs[_RIGHT, 1]])
    for t in range(n):
        for j in range(points.shape[1]):
            heights[t, j] -= floor if has_feet else np.nan
    _ask_arms(body, trunk[0], arms, holds[:5])
    _ask_hands(body, heights, trunk[0], arms, rate, reach, holds[5:14])
    _ask_legs(body, heights, legs, rate, room, holds[14:19])
    _ask_body(body, heights, trunk, rate, holds[19:24])
    _ask_travel(body, heights, speed, left, turned, arms[:, 3], rate, holds[24:32])
    _ask_jumps(heights, legs, lowest, room, holds[19, 0], holds[32, 0])
    _measure_stretches(holds, found)


@part
def _average(values, width, total):
    """Average ``values`` (n, K) in place over frames, at the ends over fewer, as the joints of a Kinect jump.

    ``total`` (n + 1, K or more) is room for sums.
    """
    n, count = values.shape
    half = min(width // 2, (n - 1) // 2)
    if half < 1:
        return
    for k in range(count):
        total[0, k] = 0.0
    for t in range(n):
        for k in range(count):
            total[t + 1, k] = total[t, k] + values[t, k]
    for t in range(n):
        first, last = max(t - half, 0), min(t + half + 1, n)
        for k in range(count):
            values[t, k] = (total[last, k] - total[first, k]) / (last - first)


@part
def _find_percentile(values, percent, room):
    """Find the percentile of the finite ``values`` (n,), interpolated linearly; NaN if there are none.

    ``room`` (n,) is partly sorted, by Hoare's quickselect (Communications of the ACM 4, 1961).
    """
    count = 0
    for t in range(len(values)):
        if np.isfinite(values[t]):
            room[count] = values[t]
            count += 1
    if count == 0:
        return np.nan
    place = (count - 1) * percent / 100.0
    below = int(place)
    low, high = 0, count - 1
    while low < high:
        pivot, i, j = room[below], low, high
        while i <= j:
            while room[i] < pivot:
                i += 1
            while room[j] > pivot:
                j -= 1
            if i <= j:
                room[i], room[j] = room[j], room[i]
                i, j = i + 1, j - 1
        low, high = (i if j < below else low), (j if below < i else high)
    above = room[min(below + 1, count - 1)]
    for t in range(below + 1, count):
        above = min(above, room[t])
    return room[below] + (above - room[below]) * (place - below)


@part
def _slope(values, t, rate):
    """Change per second of ``values`` (n,) at frame t, over a few frames on either side."""
    first, last = max(t - 2, 0), min(t + 2, len(values) - 1)
    return (values[last] - values[first]) * rate / max(last - first, 1)


@part
def _turn(points, left, rate, body, lowest, speed, turned):
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
        speed[t, 0], speed[t, 1] = _slope(points[:, 0, 0], t, rate), _slope(points[:, 0, 2], t, rate)
        # Seen from above, a turn to the left takes x towards -z.
        angle = math.atan2(-along, across)
        around += 0.0 if t == 0 else wrap(angle - before)
        turned[t], before = around, angle


@part
def _apart(a, b):
    return np.sqrt((a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2 + (a[2] - b[2]) ** 2)


@part
def _ask_arms(body, head, limbs, holds):
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


@part
def _ask_hands(body, heights, head, limbs, rate, reach, holds):
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
            holds[5, side, t] = _slope(reach[:, 2], t, rate) > 1.0 and end[1] > body[t, shoulder, 1] - 0.2
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


@part
def _ask_legs(body, heights, legs, rate, room, holds):
    """Foot raised, knee raised, kicking forward, stepping aside, legs apart: into ``holds`` (5, 2, n).

    ``legs`` (2, 2) are knee and ankle of either side, ``room`` (n,) for numbers.
    """
    n = len(body)
    for side in (_LEFT, _RIGHT):
        knee, ankle = legs[side]
        outward, other = 1.0 - 2.0 * side, legs[1 - side, 1]
        start, swung = _find_percentile(body[: max(n // 10, 1), ankle, 0], 50.0, room), False
        for t in range(n):
            high = heights[t, ankle] - heights[t, other]
            holds[0, side, t] = high > 0.15
            holds[1, side, t] = body[t, knee, 1] > -0.12 and high > 0.08
            swung = swung or (high > 0.08 and _slope(body[:, ankle, 2], t, rate) > 0.9)
            away = outward * body[t, ankle, 0]
            holds[3, side, t] = outward * (body[t, ankle, 0] - start) > 0.08 and away > 0.12
        for t in range(n):
            holds[2, side, t] = swung and holds[0, side, t] and body[t, ankle, 2] > 0.18
    for t in range(n):
        holds[4, 0, t] = abs(body[t, legs[_LEFT, 1], 0] - body[t, legs[_RIGHT, 1], 0]) > 0.3


@part
def _ask_body(body, heights, trunk, rate, holds):
    """Lying, low, bent forward, getting up, getting down: into ``holds`` (5, 2, n)."""
    pelvis, head, neck = heights[:, 0], trunk[0], trunk[1]
    n, tenth = len(body), max(len(body) // 10, 1)
    highest, rise = 0.0, 0.0
    for t in range(n):
        highest = pelvis[t] if pelvis[t] > highest else highest
    for t in range(tenth):
        rise += (pelvis[n - 1 - t] - pelvis[t]) / tenth
    for t in range(n):
        upward = body[t, neck]
        lying = heights[t, head] < 0.35
        moving = abs(_slope(pelvis, t, rate)) > 0.1
        holds[0, 0, t] = lying
        holds[1, 0, t] = pelvis[t] < max(0.4, 0.8 * highest) and not lying
        holds[2, 0, t] = (
            upward[1] / np.sqrt(upward[0] ** 2 + upward[1] ** 2 + upward[2] ** 2) < 0.8 and upward[2] > 0 and not lying
        )
        holds[3, 0, t] = moving and rise > 0.1
        holds[4, 0, t] = moving and rise < -0.1


@part
def _ask_travel(body, heights, speed, left, turned, hands, rate, holds):
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
        fast, turning = np.hypot(to_left, forward), _slope(turned, t, rate)
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
                square += _slope(body[:, joint, axis], t, rate) ** 2
            still = still and np.sqrt(square) < 0.1
        holds[7, 0, t] = still


@part
def _ask_jumps(heights, legs, feet, room, lying, holds):
    """In the air: into ``holds`` (n,); ``feet`` and ``room`` (n,) are for numbers, ``lying`` (n,) is of the body."""
    pelvis = heights[:, 0]
    for t in range(len(heights)):
        one, other = heights[t, legs[_LEFT, 1]], heights[t, legs[_RIGHT, 1]]
        feet[t] = one if one < other or np.isnan(one) else other
    stand, middle = _find_percentile(feet, 20.0, room), _find_percentile(pelvis, 50.0, room)
    for t in range(len(heights)):
        holds[t] = feet[t] > stand + 0.05 and pelvis[t] > middle + 0.02 and not lying[t]


@part
def _measure_stretches(holds, found):
    """Fill ``found`` of `find_stretches`."""
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
