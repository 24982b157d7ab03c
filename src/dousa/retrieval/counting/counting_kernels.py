"""Compiled loops: all tallies of a part of a recording at once, from its joints, in the order of ``counter``.

No allocations, which halves the compile time.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from dousa.retrieval.counting.tally_kernels import (
    compiled,
    correlate,
    count_bouts,
    count_crossings,
    count_swings,
    describe,
    differentiate,
    find_axes,
    find_distances,
    find_period,
    find_range,
    fold,
    level,
    normalise,
    project,
    read_quantile,
    sort_into,
    square,
    square_curves,
)
from dousa.retrieval.features.channel_kernels import smooth
from dousa.retrieval.features.channels import CHANNEL_RATE
from dousa.retrieval.features.noise_kernels import find_middle


@compiled
def _measure_away(poses, at_end, away):
    """Compute distances of poses (K, n) from the mean of the first or last frames, into ``away`` (n,)."""
    n, n_end = poses.shape[1], 3
    away[:] = 0.0
    for k in range(len(poses)):
        curve, pose = poses[k], 0.0
        for t in range(n_end):
            pose += curve[n - 1 - t] / n_end if at_end else curve[t] / n_end
        for t in range(n):
            away[t] += (curve[t] - pose) ** 2
    for t in range(n):
        away[t] = np.sqrt(away[t])


@compiled
def _find_block(away, first, last, shortest, lines):
    """Return start and stop of the frames away from an end, if they are one stretch; else 0, 0.

    The usual distance in ``away`` (n,) is that from ``first`` to before ``last``; ``lines`` (2, n) is working memory.
    """
    n, ordered = len(away), lines[0]
    for t in range(first, last):
        ordered[t - first] = away[t]
    # Nearer than four fifths of the usual distance the body is back at the pose at the end.
    least = 0.8 * find_middle(ordered[: last - first])
    begin, end = n, 0
    for t in range(n):
        if away[t] >= least:
            begin, end = min(begin, t), t + 1
    for t in range(begin, end):
        if away[t] < least:
            return 0, 0
    if end - begin < shortest:
        return 0, 0
    sort_into(away[begin:end], ordered[: end - begin], lines[1])
    # A tenth of the distant frames still belongs to the ways there and back.
    reached = read_quantile(ordered[: end - begin], 0.1)
    while away[begin] < reached:
        begin += 1
    while away[end - 1] < reached:
        end -= 1
    return begin, end


@compiled
def find_core(poses, speeds, moving, shortest, lines):
    """Return start and stop of the poses (K, n) between a way there and a way back, or after or before one; 0, 0 for
    none.

    ``speeds`` (n,) of all poses; the body moves above ``moving``; ``shortest`` is the least number of frames; ``lines``
    (3, n) is working memory.
    """
    n, away = len(speeds), lines[2]
    first, last, start, stop, found = n, 0, 0, n, False
    for t in range(n):
        if speeds[t] > moving:
            first, last = min(first, t), t + 1
    if last - first < shortest:
        return 0, 0
    for at_end in (False, True):
        _measure_away(poses, at_end, away)
        begin, end = _find_block(away, first, last, shortest, lines)
        if end > begin:
            start, stop, found = max(start, begin), min(stop, end), True
    return (start, stop) if found and stop - start >= shortest else (0, 0)


_njit: Any = njit  # whose types leave out some of its options

_LARGE, _SMALL = 0.5, 0.3  # least shares of the range (5 to 95 %) of a movement out and back
_TURN, _SMALL_TURN, _BURST = 0.6, 0.3, 0.35  # likewise of the speed along one direction, of the body's speed (95 %)

SHORTEST, LONGEST, ALIKE, NEARLY = 9, 0.62, 0.3, 0.8
"""Frames of a period; largest share of the moving part that it lasts; its least correlation; share of the highest
correlation that a shorter period needs."""

SHORT = 256
"""Frames that the scratch of ``measure_parts`` holds, by definition; of more, ``counter`` takes the spectrum."""

ROUNDS, CORE_ALIKE = 2.5, 0.2
"""Least periods of a repetition, as one action there and back may have a top of two parts; and their correlation."""


@compiled
def _count_along(curve, lines, counts):
    """Count large and small movements out and back, and half of the crossings of the middle, into ``counts`` (5,)."""
    sort_into(curve, lines[0], lines[1])
    low, high, sign = find_range(lines[0], True)
    counts[0], counts[1] = count_swings(curve, sign, _LARGE * (high - low))
    counts[2], counts[3] = count_swings(curve, sign, _SMALL * (high - low))
    counts[4] = count_crossings(curve, sign, 0.5 * (low + high))


@compiled
def _count_quick(along, lying, lines, counts):
    """Count half of the turns, large and small, then movements out and back, and crossings, into ``counts`` (4,).

    ``along`` (n,) is the speed in the direction of quickest movement, ``lying`` (n,) the place.
    """
    for t in range(len(along)):
        lines[2, t] = abs(along[t])
    sort_into(lines[2], lines[0], lines[1])
    speed = read_quantile(lines[0], 0.95)
    level(lying)
    sort_into(lying, lines[0], lines[1])
    low, high, sign = find_range(lines[0], True)
    tops, bottoms = count_swings(along, 1.0, _TURN * speed)
    counts[0] = 0.5 * (tops + bottoms)
    tops, bottoms = count_swings(along, 1.0, _SMALL_TURN * speed)
    counts[1] = 0.5 * (tops + bottoms)
    counts[2] = count_swings(lying, sign, _SMALL * (high - low))[0]
    counts[3] = count_crossings(lying, sign, 0.5 * (low + high))


@compiled
def _count_bursts(speeds, ordered, weights, even):
    n = len(speeds)
    smooth(speeds.reshape(n, 1), weights, even.reshape(n, 1))
    return count_swings(even, 1.0, _BURST * read_quantile(ordered, 0.95))[0]


@compiled
def _count_away(poses, speeds, ordered, near, some_poses, lines, counts):
    """Count movements away from the pose at rest and back, by their tops and by half of the crossings of the middle.

    ``near`` (M,) and ``some_poses`` (M, K) are as of ``find_distances``; into ``counts`` (2,).
    """
    away = lines[2]
    find_distances(poses, speeds, read_quantile(ordered, 0.2), near, some_poses, away)
    sort_into(away, lines[0], lines[1])
    low, high, _ = find_range(lines[0], False)
    counts[0] = count_swings(away, 1.0, _LARGE * (high - low))[0]
    counts[1] = count_crossings(away, 1.0, 0.5 * (low + high))


@compiled
def _count_periods(velocities, speeds, moving, sums):
    """Count periods in the moving part, 1 where there is none; NaN where that is too long."""
    first, last = len(speeds), 0
    for t in range(len(speeds)):
        if speeds[t] > moving:
            first, last = min(first, t), t + 1
    return _fit_periods(velocities, first, last, ALIKE, sums)


@compiled
def _fit_periods(velocities, first, last, least, sums):
    """Count periods from ``first`` to before ``last`` as `_count_periods`; ``least`` is their least correlation."""
    n = last - first
    if n > SHORT:
        return np.nan
    likeness = sums[0, : max(round(LONGEST * n), 1)]
    correlate(velocities, first, last, likeness)
    normalise(velocities, first, last, sums[1], likeness)
    period = find_period(likeness, SHORTEST, least, NEARLY)
    return n / period if period else 1.0


@compiled
def _find_repeated(course, speeds, ordered, lines, sums, core):
    """Return whether repetitions lie between a way there and a way back, with their frames in ``core`` (2,).

    Where the frames are too many for their period, ``core`` has the negative of the end, and the result is False.
    """
    start, stop = find_core(course[0], speeds, read_moving(ordered), 2 * SHORTEST, lines)
    if stop > start:
        periods = _fit_periods(course[1], start, stop, CORE_ALIKE, sums)
        if periods >= ROUNDS:
            core[0], core[1] = start, stop
            return True
        if np.isnan(periods):
            core[0], core[1] = start, -stop
    return False


@compiled
def read_moving(ordered):
    """Return the speed below which the body rests, from the sorted speeds (n,)."""
    return 0.15 * read_quantile(ordered, 0.9)


@compiled
def _find_directions(course, squares, room, axes):
    """Find the two directions of most movement, and the quickest, into ``axes`` (3, K).

    ``course`` (3, K, n) are poses, velocities, and working memory, as are ``squares`` (K, K) and ``room`` (6, K).
    """
    for which in range(2):  # one call for both: each call is compiled separately
        if which:
            square_curves(course[1], squares)
        else:
            square(course[0], course[2], squares)
        find_axes(squares, room, axes[2 * which : 2 + which])


@compiled
def _count_course(course, axes, n_axes, lines, work):
    """Count swings along ``axes`` (3, K), ``_count_along`` of ``n_axes`` and ``_count_quick``, into ``work`` (14,)."""
    poses, velocities = course[0], course[1]
    for number in range(n_axes):
        project(poses, axes[number], lines[4])
        _count_along(lines[4], lines, work[5 * number : 5 * number + 5])
    project(velocities, axes[2], lines[4])
    project(poses, axes[2], lines[5])
    _count_quick(lines[4], lines[5], lines, work[10:])


@compiled
def _put_whole(course, speeds, ordered, lines, calm, work, counts):
    """Write the tallies of the strongly smoothed course, but for bursts and periods, into ``counts`` (28,)."""
    for k in range(4):
        counts[k], counts[6 + k] = work[k], work[10 + k]
    counts[4], counts[5] = work[5], work[4]
    moving = read_moving(ordered)
    counts[11] = count_bouts(speeds, moving, 9)
    _count_away(course[0], speeds, ordered, calm[0], calm[1], lines, counts[12:14])
    counts[25] = len(speeds) / CHANNEL_RATE
    for t in range(len(speeds)):
        counts[26] += speeds[t]
        counts[27] += speeds[t] > moving
    counts[27] /= CHANNEL_RATE


@_njit(inline="always")  # into `tally_all` alone: a call would be compiled twice
def tally(points, height, smoothing, joints, places, courses, speeds, lines, calm, squares, sums, whole, core, counts):
    """Compute all tallies of ``points`` (n, J, 3), at least two frames, into ``counts`` (28,).

    Returns True, without tallies, if only the part in ``core`` (2,) is to be tallied (`_find_repeated`); not with
    ``whole``.

    ``smoothing`` are strong and light weights as of ``smooth``. ``joints`` are the hips (2,), the shoulders (2,), the
    joints (K,) to use, and those on the other side. The rest is working memory: ``places`` (n, J, 3) and (n, 2);
    ``courses`` two of (3, 3 K, n) and one of (3, E, n), in which poses and velocities stay, smoothed strongly, lightly,
    and common to both sides (E curves); ``speeds`` (3, n) of these; ``lines`` (6, n); ``calm`` (P,) and (P, 3 K) for at
    most P calm poses to compare; ``squares`` (3 K, 3 K), (E, E), (6, 3 K), and the directions (3, 3 K) and (3, E);
    ``sums`` (3, ``SHORT`` + 1). Periods that need a spectrum are NaN.
    """
    n, ordered, work, axes, fastest = len(points), lines[3], sums[2, :14], squares[3], 0.0
    still = 1e-9  # body heights a frame, at or below which nothing moves
    hips, shoulders, looked_at, others = joints
    counts[:] = 0.0
    for which in range(3):  # strong, light, both sides; one call site each, as each call is compiled separately
        course = courses[which]
        if which < 2:
            describe(points, height, smoothing[which], hips, shoulders, looked_at, places[0], places[1], course[0])
        else:
            fold(courses[0][0], others, course[0])
        differentiate(course[0], course[1], speeds[which])
        sort_into(speeds[which], ordered, lines[1])
        if which == 0:
            fastest = ordered[n - 1]
            if fastest <= still:
                return False
            if not whole and _find_repeated(course, speeds[0], ordered, lines, sums, core):
                return True
        if which == 2 and ordered[n - 1] <= max(1e-3 * fastest, still):  # nothing is common to both sides
            break
        if which != 1:  # the lightly smoothed course keeps the directions
            axes = squares[3 + which // 2]
            _find_directions(course, squares[which // 2], squares[2], axes)
        _count_course(course, axes, 1 if which else 2, lines, work)
        periods = _count_periods(course[1], speeds[which], read_moving(ordered), sums)
        if which == 2:
            counts[20], counts[21], counts[22], counts[23], counts[24] = work[2], work[4], work[10], work[13], periods
            break
        bursts = _count_bursts(speeds[which], ordered, smoothing[which], lines[2])
        if which == 1:
            counts[15], counts[16], counts[17], counts[18], counts[19] = work[4], work[10], work[13], bursts, periods
        else:
            counts[10], counts[14] = bursts, periods
            _put_whole(course, speeds[0], ordered, lines, calm, work, counts)
    return False


@compiled
def tally_all(
    points, spans, height, smoothing, joints, places, left, frames, speeds, lines, calm, squares, sums, whole, core,
    counts,
):  # fmt: skip
    """Run ``tally`` for parts of one recording ``points`` (n, J, 3), into ``counts`` (N, 28).

    ``spans`` (N, 2) are the first frame of each part and the one after its last, at least two frames, at most those of
    the working memory: ``places``, ``left``, ``speeds`` and ``lines`` are flat, ``frames`` are three flat courses; the
    rest as in ``tally``. ``core`` is that of the last part, 0 for none.
    """
    number, start, trimmed = 0, 0, False
    while number < len(spans):  # a part of which only the core counts comes twice
        if trimmed:
            start, stop = start + core[0], start + core[1]
        else:
            start, stop = spans[number, 0], spans[number, 1]
            core[:] = 0
        part = points[start:stop]
        n, n_joints, width, even = len(part), points.shape[1], len(squares[0]), len(squares[1])
        room = places[: 3 * n * n_joints].reshape(n, n_joints, 3), left[: 2 * n].reshape(n, 2)
        courses = (
            frames[0][: 3 * width * n].reshape(3, width, n),
            frames[1][: 3 * width * n].reshape(3, width, n),
            frames[2][: 3 * even * n].reshape(3, even, n),
        )
        fast, rows = speeds[: 3 * n].reshape(3, n), lines[: 6 * n].reshape(6, n)
        trimmed = tally(
            part, height, smoothing, joints, room, courses, fast, rows, calm, squares, sums, whole or trimmed, core,
            counts[number],
        )  # fmt: skip
        if not trimmed:
            number += 1


@compiled
def choose(tallies, usual, known, n_counted, weights, least, farthest, most):
    """Return the count from 1 to ``most`` that best fits tallies (28,), as described in ``counter``.

    ``usual`` (28,) is used if ``known``; the first ``n_counted`` tallies are counts themselves.
    """
    highest = 0.0
    for k in range(len(tallies)):
        if k < n_counted:
            highest = max(highest, tallies[k])
        if known:
            highest = max(highest, tallies[k] / usual[k])
    best, score = 1, -np.inf
    for count in range(1, min(int(1.2 * highest) + 2, most) + 1):
        size = np.log(count)
        total = weights[1] - weights[0] * size if count == 1 else -weights[0] * size
        for k in range(len(tallies)):
            value = max(tallies[k], least)
            if k < n_counted:
                total -= weights[2 + 2 * k] * min(abs(np.log(value) - size), farthest)
                total += weights[3 + 2 * k] if abs(value - count) <= 0.5 else 0.0
            if known:
                ratio, first = np.log(value / usual[k]) - size, 2 + 2 * n_counted + 3 * k
                total -= weights[first] * min(abs(ratio), farthest)
                total += weights[first + 1] if abs(value / usual[k] - count) <= 0.5 else 0.0
                total -= weights[first + 2] * min(max(ratio, 0.0), farthest)
        if total > score:
            best, score = count, total
    return best
