"""Compiled loops of the channels, from the joints of every frame to the integrals of all channels and cells of windows.

``channels`` describes the numbers, in the order of the columns. Loops write to slices counted from 0, as a sum as index
may be negative to the compiler and prevents vectorisation.
"""

from __future__ import annotations

import numpy as np

from dousa.kernels import kernel, part


@part
def _smooth_narrow(values, count, weights, out):
    """Do ``smooth`` for narrow rows, flat (n * count,), many rows at a time."""
    size = len(values)
    for k in range(size):
        out[k] = weights[0] * values[k]
    for step in range(1, len(weights)):
        weight, apart = weights[step], step * count
        inner, later = out[apart:], values[2 * apart :]
        for k in range(size - 2 * apart):
            inner[k] += weight * (values[k] + later[k])
        for k in range(min(apart, size)):
            later = values[k + apart] if k < size - apart else values[size - count + k % count]
            out[k] += weight * (values[k % count] + later)
        for k in range(max(size - apart, apart), size):
            out[k] += weight * (values[k - apart] + values[size - count + k % count])


@part
def smooth(values, weights, out):
    """Compute weighted means over time of ``values`` (n, K), into ``out``; the ends are held.

    ``weights`` (r + 1,) of the middle and of the frames 1 ... r away from it on either side.
    """
    n, count = values.shape
    last = n - 1
    if count <= 4:
        _smooth_narrow(values.reshape(n * count), count, weights, out.reshape(n * count))
        return
    for t in range(n):
        row, own = out[t], values[t]
        for k in range(count):
            row[k] = weights[0] * own[k]
        for step in range(1, len(weights)):
            weight = weights[step]
            sooner, later = values[max(t - step, 0)], values[min(t + step, last)]
            for k in range(count):
                row[k] += weight * (sooner[k] + later[k])


@part
def _find_horizontal(points, t, tip, base, left):
    """Write unit x and z of base -> tip in frame t into ``left`` (n, 2); return whether it is horizontal enough."""
    x = (points[t, tip, 0] - points[t, 0, 0]) - (points[t, base, 0] - points[t, 0, 0])
    y = (points[t, tip, 1] - points[t, 0, 1]) - (points[t, base, 1] - points[t, 0, 1])
    z = (points[t, tip, 2] - points[t, 0, 2]) - (points[t, base, 2] - points[t, 0, 2])
    length = np.hypot(x, z)
    whole = np.hypot(length, y)
    certain = whole > 1e-6 and length >= 0.1 * whole
    share = length if certain else 1.0
    left[t, 0], left[t, 1] = x / share, z / share
    return certain


@part
def find_lateral(points, hips, shoulders, left):
    """Find unit x and z of the direction to the left, into ``left`` (n, 2): of the hips, else the shoulders, else as
    before.

    ``points`` (n, J, 3) with Y up; ``hips`` and ``shoulders`` (2,) are the left and the right one.
    """
    first = last = -1
    for t in range(len(points)):
        certain = _find_horizontal(points, t, hips[0], hips[1], left)
        if not certain:
            certain = _find_horizontal(points, t, shoulders[0], shoulders[1], left)
        if certain:
            first, last = t if first < 0 else first, t
        elif last >= 0:
            left[t, 0], left[t, 1] = left[last, 0], left[last, 1]
    # Before the first known direction, as when the performer lies on one side: that direction.
    for t in range(first if first >= 0 else len(points)):
        left[t, 0], left[t, 1] = (left[first, 0], left[first, 1]) if first >= 0 else (1.0, 0.0)


@kernel(linear=True)
def find_lateral_directions(points, hips, shoulders, left):
    """Do ``find_lateral``."""
    find_lateral(points, hips, shoulders, left)


@part
def turn_to_body(points, left, body):
    """Turn ``points`` (n, J, 3) with Y up, relative to the first joint, into body axes: left, up, forward."""
    for t in range(points.shape[0]):
        length = max(np.hypot(left[t, 0], left[t, 1]), 1e-9)
        across, along = left[t, 0] / length, left[t, 1] / length
        for j in range(points.shape[1]):
            x, z = points[t, j, 0] - points[t, 0, 0], points[t, j, 2] - points[t, 0, 2]
            body[t, j, 0] = x * across + z * along
            body[t, j, 1] = points[t, j, 1] - points[t, 0, 1]
            body[t, j, 2] = z * across - x * along


@part
def wrap(angle):
    """Wrap an angle to -pi ... pi."""
    if angle > np.pi:
        return angle - 2.0 * np.pi
    if angle < -np.pi:
        return angle + 2.0 * np.pi
    return angle


@part
def find_angle(y, x):
    """Compute ``np.arctan2`` to the last digit but one, in a form that vectorises.

    Source: Moshier, Cephes mathematical library, ``atan.c``, 2001: by a ratio of polynomials up to an eighth of a turn.
    """
    along, across = abs(x), abs(y)
    long, short = max(along, across), min(along, across)
    steep = short > 0.41421356237309503 * long
    top = short - long if steep else short
    bottom = short + long if steep else long
    part = top / (bottom if bottom > 0.0 else 1.0)
    square = part * part
    upper = -8.750608600031904122785e-1 * square - 1.615753718733365076637e1
    upper = (upper * square - 7.500855792314704667340e1) * square - 1.228866684490136173410e2
    upper = upper * square - 6.485021904942025371773e1
    lower = (square + 2.485846490142306297962e1) * square + 1.650270098316988542046e2
    lower = (lower * square + 4.328810604912902668951e2) * square + 4.853903996359136964868e2
    lower = lower * square + 1.945506571482613964425e2
    angle = part + part * square * upper / lower
    angle = angle + 0.25 * np.pi if steep else angle
    angle = 0.5 * np.pi - angle if across > along else angle
    angle = np.pi - angle if x < 0.0 else angle
    return -angle if y < 0.0 else angle


@part
def _turned(angles, before, after, t):
    """Return the turn of an angle from frame ``before`` over t to ``after``, each by the shorter way."""
    return wrap(angles[after] - angles[t]) + wrap(angles[t] - angles[before])


@part
def find_angles(even, left, fast, headings, angles):
    """Find the heading of the body, into ``headings`` (n,), and of each joint, into ``angles`` (2, n, 3 joints),
    radians.

    The latter are directions in the three planes of the body, and the ways there, in the unit of ``even``.
    """
    last = even.shape[0] - 1
    for t in range(even.shape[0]):
        headings[t] = find_angle(-left[t, 1], left[t, 0])
        before, after = max(t - 1, 0), min(t + 1, last)
        turned, far = angles[0, t], angles[1, t]
        for f in range(len(fast)):
            sooner, later = even[before, fast[f]], even[after, fast[f]]
            for plane in range(3):
                turned[3 * f + plane] = later[(plane + 1) % 3] - sooner[(plane + 1) % 3]
                far[3 * f + plane] = later[plane] - sooner[plane]
        for k in range(len(turned)):
            y, x = turned[k], far[k]
            turned[k], far[k] = find_angle(y, x), np.sqrt(x * x + y * y)


@part
def _measure(one, other):
    square = 0.0
    for axis in range(3):
        square += (one[axis] - other[axis]) ** 2
    return np.sqrt(square)


@part
def _fill_pose(body, placed, apart, feet, row):
    """Write positions, distances and the height of the pelvis; return the next column."""
    column = 0
    for j in placed:
        for axis in range(3):
            row[column] = body[j, axis]
            column += 1
    for pair in apart:
        row[column] = _measure(body[pair[0]], body[pair[1]])
        column += 1
    row[column] = -min(body[feet[0], 1], body[feet[1], 1])
    return column + 1


@part
def _fill_travel(sooner, later, left, per_second, row, column):
    """Write the pelvis's speed to the left, upwards, forwards; return the next column."""
    length = max(np.hypot(left[0], left[1]), 1e-9)
    across, along = left[0] / length, left[1] / length
    x, z = later[0] - sooner[0], later[2] - sooner[2]
    row[column] = (x * across + z * along) * per_second
    row[column + 1] = (later[1] - sooner[1]) * per_second
    row[column + 2] = (z * across - x * along) * per_second
    return column + 3


@part
def compute_rows(points, left, body, even, fast, placed, apart, feet, pointing, rate, headings, angles, rows):
    """Compute all channels of every frame, into ``rows`` (n, C).

    ``points`` (n, J, 3) smooth and in body heights, ``left`` (n, 2), ``body`` and ``even`` (n, J, 3) in body axes, the
    second smoothed once more; ``fast``, ``placed`` (joints,), ``apart`` (pairs, 2), ``feet`` (2,) and ``pointing``
    (joints,) are joint numbers; ``headings`` and ``angles`` are of ``find_angles``.
    """
    last = points.shape[0] - 1
    slow = 0.3  # body heights a second: the direction of a slower joint is noise and counts less
    for t in range(points.shape[0]):
        row = rows[t]
        before, after = max(t - 1, 0), min(t + 1, last)
        per_second = rate / max(after - before, 1)
        column = _fill_pose(body[t], placed, apart, feet, row)
        column = _fill_travel(points[before, 0], points[after, 0], left[t], per_second, row, column)
        row[column] = _turned(headings, before, after, t) * per_second
        column += 1
        for j in fast:
            row[column] = _measure(body[after, j], body[before, j]) * per_second
            column += 1
        sooner, now, later, far = angles[0, before], angles[0, t], angles[0, after], angles[1, t]
        for k in range(len(now)):
            turn = (wrap(later[k] - now[k]) + wrap(now[k] - sooner[k])) * per_second
            row[column + k] = min(max(turn, -rate), rate) * min(far[k] * per_second / slow, 1.0)
        column += len(now)
        for j in pointing:
            speed = max(_measure(even[after, j], even[before, j]) * per_second, slow)
            for axis in range(3):
                row[column] = (even[after, j, axis] - even[before, j, axis]) * per_second / speed
                column += 1


@kernel(linear=True)
def describe_frames(
    positions, height, pose_weights, heading_weights, hips, shoulders, fast, placed, apart, feet, pointing, rate, room,
    lefts, headings, angles, rows,
):  # fmt: skip
    """Compute all channels of ``positions`` (n, J, 3), into ``rows`` (n, C), by the steps above.

    ``room`` (3, n, J, 3), ``lefts`` (2, n, 2), ``headings`` and ``angles`` are working memory; the rest as above.
    """
    n, width = len(positions), 3 * positions.shape[1]
    points, body, even = room[0, :n], room[1, :n], room[2, :n]
    first_left, left = lefts[0, :n], lefts[1, :n]
    for t in range(n):
        for j in range(positions.shape[1]):
            for axis in range(3):
                body[t, j, axis] = positions[t, j, axis] / height
    smooth(body.reshape(n, width), pose_weights, points.reshape(n, width))
    find_lateral(points, hips, shoulders, first_left)
    smooth(first_left, heading_weights, left)
    turn_to_body(points, left, body)
    smooth(body.reshape(n, width), pose_weights, even.reshape(n, width))
    find_angles(even, left, fast, headings, angles)
    compute_rows(points, left, body, even, fast, placed, apart, feet, pointing, rate, headings, angles, rows)


@kernel(linear=True)
def integrate_rows(rows, first_speed, n_speeds, at_rest, step, times, integrals):
    """Compute motion time into ``times`` (n + 1,), and integrals over it into ``integrals`` (n + 1, 3 C).

    The integrals are of the channels, their squares, and the channels times the time; both start from their first row.
    """
    n, count = rows.shape
    for t in range(n):
        effort = at_rest
        for k in range(first_speed, first_speed + n_speeds):
            effort += rows[t, k]
        weight = effort * step
        times[t + 1] = times[t] + weight
        middle = 0.5 * (times[t] + times[t + 1])
        row, last, now = rows[t], integrals[t], integrals[t + 1]
        squares, moments, now_squares, now_moments = last[count:], last[2 * count :], now[count:], now[2 * count :]
        for k in range(count):
            now[k] = last[k] + row[k] * weight
        for k in range(count):
            now_squares[k] = squares[k] + row[k] * weight * row[k]
        for k in range(count):
            now_moments[k] = moments[k] + row[k] * weight * middle


@part
def read_edge(integrals, times, edge, n_channels, row):
    """Read the integrals up to one instant into ``row`` (banks * n_channels,); return the instant in motion time."""
    width = integrals.shape[1]
    below = min(int(edge), integrals.shape[0] - 2)
    share = edge - below
    whole = times[below + 1] - times[below]
    time = times[below] + share * whole
    lower, upper = integrals[below], integrals[below + 1]
    for c in range(min(width, 2 * n_channels)):
        row[c] = lower[c] + share * (upper[c] - lower[c])
    if width > n_channels:
        # Within a frame the value is constant, so its integral over time is a line, its moment a parabola.
        grown = 0.5 * (time * time - times[below] * times[below]) / whole
        moments, lowest = row[2 * n_channels :], lower[2 * n_channels :]
        for c in range(n_channels):
            moments[c] = lowest[c] + grown * (upper[c] - lower[c])
    return time


@kernel(linear=True)
def read_cells(integrals, times, edges, n_channels, work, out):
    """Compute cell means of windows, into ``out`` (W, T, F).

    ``integrals`` (n + 1, banks * n_channels) are the integrals of the values over ``times`` (n + 1,) and, with three
    banks, of their squares and of the values times the time; ``edges`` (W, T + 1) are the edges of the cells in frames.
    With three banks F is 3 C + 1: the means, an unwritten column, the means of the squares, and those of the values
    times the time, in cells from the start of the window. ``work`` (2, banks * n_channels) is working memory.
    """
    before, now = work[0], work[1]
    for w in range(out.shape[0]):
        earlier = 0.0
        for t in range(edges.shape[1]):
            time = read_edge(integrals, times, edges[w, t], n_channels, now)
            if t > 0:
                cell = max(time - earlier, 1e-12)
                row = out[w, t - 1]
                for c in range(n_channels):
                    row[c] = (now[c] - before[c]) / cell
                if integrals.shape[1] > n_channels:
                    squares, square, sooner = row[n_channels + 1 :], now[n_channels:], before[n_channels:]
                    for c in range(n_channels):
                        squares[c] = (square[c] - sooner[c]) / cell
                    moments, moment, sooner = row[2 * n_channels + 1 :], now[2 * n_channels :], before[2 * n_channels :]
                    for c in range(n_channels):
                        grown = moment[c] - sooner[c] - earlier * (now[c] - before[c])
                        moments[c] = (t - 1) * row[c] + grown / (cell * cell)
            before, now = now, before
            earlier = time


@part
def _read_time(times, frame):
    """Return the instant at a fractional frame, of ``times`` (n + 1,) at whole ones."""
    below = int(frame)
    if below >= len(times) - 1:
        return times[len(times) - 1]
    return (times[below + 1] - times[below]) * (frame - below) + times[below]


@part
def _find_frame(times, wanted, low, high):
    """Return the fractional frame where ascending ``times`` (n + 1,) reach a value, between two frames."""
    while high - low > 1:
        middle = (low + high) // 2
        if times[middle] <= wanted:
            low = middle
        else:
            high = middle
    if wanted >= times[high]:
        return float(high)
    return 1.0 / (times[high] - times[low]) * (wanted - times[low]) + low


@kernel(linear=True)
def find_edges(times, starts, stops, parts, edges):
    """Find the edges of the cells of windows, in frames, into ``edges`` (W, E).

    ``times`` (n + 1,) at whole frames; ``starts`` and ``stops`` (W,) of the windows, in frames; ``parts`` (E,) from 0
    to 1, of the time of a window.
    """
    last = len(times) - 1
    for w in range(len(starts)):
        begin, end = _read_time(times, starts[w]), _read_time(times, stops[w])
        low, high = int(starts[w]), min(int(stops[w]) + 1, last)
        edges[w, 0], edges[w, len(parts) - 1] = starts[w], stops[w]
        for e in range(1, len(parts) - 1):
            edges[w, e] = _find_frame(times, begin + (end - begin) * parts[e], low, high)
            low = int(edges[w, e])


@kernel(linear=True)
def read_means(integrals, times, edges, columns, scale, out):
    """Compute means of some channels over the cells of windows, into ``out`` (W, E - 1, K).

    ``integrals`` (n + 1, banks * C) over ``times`` (n + 1,); ``edges`` (W, E) as in ``find_edges``, of cells that last
    equally long in those times; ``columns`` (K,), whose means are multiplied by ``scale`` (K,).
    """
    last, n_cells = len(times) - 2, edges.shape[1] - 1
    for w in range(len(edges)):
        per_cell = n_cells / (_read_time(times, edges[w, n_cells]) - _read_time(times, edges[w, 0]))
        for k in range(len(columns)):
            column, before = columns[k], 0.0
            for e in range(n_cells + 1):
                below = min(int(edges[w, e]), last)
                share = edges[w, e] - below
                now = integrals[below, column] * (1.0 - share) + integrals[below + 1, column] * share
                if e > 0:
                    out[w, e - 1, k] = (now - before) * per_cell * scale[k]
                before = now
