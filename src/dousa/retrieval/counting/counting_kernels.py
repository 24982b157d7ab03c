"""Compiled: all tallies of a part of a recording at once, from the places of its joints, in the order of ``tallies``.

Nothing here allocates: without reference counts it compiles in half the time.
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
from dousa.retrieval.features.noise_kernels import find_middle

_NEAR = 0.8  # share of the usual distance from the pose at an end below which the body is back there
_REACHED = 0.1  # of what is not near, so much still belongs to the ways there and back
_END = 3  # frames whose mean is the pose at an end


@compiled
def _measure_away(poses, at_end, away):
    """How far poses (K, n) are from the mean of the first frames, or of the last, into ``away`` (n,)."""
    n = poses.shape[1]
    away[:] = 0.0
    for k in range(len(poses)):
        curve, pose = poses[k], 0.0
        for t in range(_END):
            pose += curve[n - 1 - t] / _END if at_end else curve[t] / _END
        for t in range(n):
            away[t] += (curve[t] - pose) ** 2
    for t in range(n):
        away[t] = np.sqrt(away[t])


@compiled
def _find_block(away, first, last, shortest, lines):
    """The frames that are away from an end, if they are one stretch: where they range, and from where to where; else 0.

    ``away`` (n,); the usual distance is that of the frames from ``first`` to before ``last``; ``lines`` (2, n) is
    working memory.
    """
    n, ordered = len(away), lines[0]
    for t in range(first, last):
        ordered[t - first] = away[t]
    least = _NEAR * find_middle(ordered[: last - first])
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
    reached = read_quantile(ordered[: end - begin], _REACHED)
    while away[begin] < reached:
        begin += 1
    while away[end - 1] < reached:
        end -= 1
    return begin, end


@compiled
def find_core(poses, speeds, moving, shortest, lines):
    """The frames of poses (K, n) between a way there and a way back, or one of them; 0, 0 where there is none.

    ``speeds`` (n,) of all poses, ``moving`` that from which the body moves; of less than ``shortest`` frames nothing is
    said; ``lines`` (3, n) is working memory.
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

_LARGE, _SMALL = 0.5, 0.3  # shares of the range (5 to 95 %) that a movement out and back has at least
_TURN, _SMALL_TURN, _BURST = 0.6, 0.3, 0.35  # likewise of the speed along one direction, of the body's speed (95 %)
_BOUT_GAP = 9  # frames of rest between two bouts of movement
_LEAST_EVEN = 1e-3  # share of the greatest speed: what both sides do alike
_LEAST = 1e-9

RATE = 30.0
"""Frames a second of what is counted."""

MOVING = 0.15
"""Share of the speed (90 %) below which the body rests."""

SHORTEST, ALIKE, NEARLY = 9, 0.3, 0.8
"""Frames of a period; correlation of a period at least; share of the highest that a shorter period needs."""

STILL = 1e-9
"""Body heights a frame: nothing moves."""

SHORT = 256
"""Frames of which products are summed one by one; of more, somebody else sums them from their spectrum."""

LONGEST = 0.62
"""Share of the moving part that a period may last."""

ROUNDS, CORE_ALIKE = 2.5, 0.2
"""Periods that are repetitions, as one action there and back may have a top of two parts; and their correlation."""

CALM = 120
"""Of the calm poses, so many are looked at, and at least half as many."""

N_LINES = 6
"""Working memory of `tally`, in frames."""


@compiled
def _count_along(curve, lines, counts):
    """Movements out and back along a direction, large and small ones, and half of the crossings of the middle.

    Into ``counts`` (5,).
    """
    sort_into(curve, lines[0], lines[1])
    low, high, sign = find_range(lines[0], True)
    counts[0], counts[1] = count_swings(curve, sign, max(_LARGE * (high - low), _LEAST))
    counts[2], counts[3] = count_swings(curve, sign, max(_SMALL * (high - low), _LEAST))
    counts[4] = count_crossings(curve, sign, 0.5 * (low + high))


@compiled
def _count_quick(along, lying, lines, counts):
    """Along the direction of quickest movement: how often it is taken, there and back, half each; and out and back.

    ``along`` (n,) is the speed, ``lying`` (n,) the place; into ``counts`` (4,).
    """
    for t in range(len(along)):
        lines[2, t] = abs(along[t])
    sort_into(lines[2], lines[0], lines[1])
    speed = read_quantile(lines[0], 0.95)
    level(lying)
    sort_into(lying, lines[0], lines[1])
    low, high, sign = find_range(lines[0], True)
    tops, bottoms = count_swings(along, 1.0, max(_TURN * speed, _LEAST))
    counts[0] = 0.5 * (tops + bottoms)
    tops, bottoms = count_swings(along, 1.0, max(_SMALL_TURN * speed, _LEAST))
    counts[1] = 0.5 * (tops + bottoms)
    counts[2] = count_swings(lying, sign, max(_SMALL * (high - low), _LEAST))[0]
    counts[3] = count_crossings(lying, sign, 0.5 * (low + high))


@compiled
def _count_bursts(speeds, ordered, weights, even):
    """How often the body speeds up."""
    n = len(speeds)
    smooth(speeds.reshape(n, 1), weights, even.reshape(n, 1))
    return count_swings(even, 1.0, max(_BURST * read_quantile(ordered, 0.95), _LEAST))[0]


@compiled
def _count_away(poses, speeds, ordered, near, some_poses, lines, counts):
    """Movements away from the pose at rest and back, by their tops and by half of the crossings of the middle.

    ``near`` (M,) and ``some_poses`` (M, K) are as of ``find_distances``; into ``counts`` (2,).
    """
    away = lines[2]
    find_distances(poses, speeds, read_quantile(ordered, 0.2), near, some_poses, away)
    sort_into(away, lines[0], lines[1])
    low, high, _ = find_range(lines[0], False)
    counts[0] = count_swings(away, 1.0, max(_LARGE * (high - low), _LEAST))[0]
    counts[1] = count_crossings(away, 1.0, 0.5 * (low + high))


@compiled
def _count_periods(velocities, speeds, moving, sums):
    """How often the period fits into the moving part, 1 where there is none; NaN where that is too long to be told."""
    first, last = len(speeds), 0
    for t in range(len(speeds)):
        if speeds[t] > moving:
            first, last = min(first, t), t + 1
    return _fit_periods(velocities, first, last, ALIKE, sums)


@compiled
def _fit_periods(velocities, first, last, alike, sums):
    """How often the period fits into the frames from ``first`` to before ``last``, as `_count_periods` says.

    ``alike`` is the least correlation of a period.
    """
    n = last - first
    if n > SHORT:
        return np.nan
    likeness = sums[0, : max(round(LONGEST * n), 1)]
    correlate(velocities, first, last, likeness)
    normalise(velocities, first, last, sums[1], likeness)
    period = find_period(likeness, SHORTEST, alike, NEARLY)
    return n / period if period else 1.0


@compiled
def _find_repeated(course, speeds, ordered, lines, sums, core):
    """Whether what is repeated lies between a way there and a way back, and where, into ``core`` (2,).

    Where that is too long for its period to be told, the frame after its last is negative, and the answer no.
    """
    start, stop = find_core(course[0], speeds, _read_moving(ordered), 2 * SHORTEST, lines)
    if stop > start:
        periods = _fit_periods(course[1], start, stop, CORE_ALIKE, sums)
        if periods >= ROUNDS:
            core[0], core[1] = start, stop
            return True
        if np.isnan(periods):
            core[0], core[1] = start, -stop
    return False


@compiled
def _read_moving(ordered):
    return MOVING * read_quantile(ordered, 0.9)


@compiled
def _find_directions(course, squares, room, axes):
    """The two directions of most movement, and that of the quickest, into ``axes`` (3, K).

    ``course`` (3, K, n) are poses, velocities, and room; ``squares`` (K, K) and ``room`` (6, K) are working memory.
    """
    for which in range(2):  # one call for both: what is called twice is compiled twice
        if which:
            square_curves(course[1], squares)
        else:
            square(course[0], course[2], squares)
        find_axes(squares, room, axes[2 * which : 2 + which])


@compiled
def _count_course(course, axes, n_axes, lines, work):
    """What swings along the directions ``axes`` (3, K): ``_count_along`` of ``n_axes``, and ``_count_quick``.

    Into ``work`` (14,), two rows of 5 and one of 4.
    """
    poses, velocities = course[0], course[1]
    for number in range(n_axes):
        project(poses, axes[number], lines[4])
        _count_along(lines[4], lines, work[5 * number : 5 * number + 5])
    project(velocities, axes[2], lines[4])
    project(poses, axes[2], lines[5])
    _count_quick(lines[4], lines[5], lines, work[10:])


@compiled
def _put_whole(course, speeds, ordered, lines, calm, work, counts):
    """The tallies of what is smoothed much, but for bursts and periods, into ``counts`` (28,)."""
    for k in range(4):
        counts[k], counts[6 + k] = work[k], work[10 + k]
    counts[4], counts[5] = work[5], work[4]
    moving = _read_moving(ordered)
    counts[11] = count_bouts(speeds, moving, _BOUT_GAP)
    _count_away(course[0], speeds, ordered, calm[0], calm[1], lines, counts[12:14])
    counts[25] = len(speeds) / RATE
    for t in range(len(speeds)):
        counts[26] += speeds[t]
        counts[27] += speeds[t] > moving
    counts[27] /= RATE


@_njit(inline="always")  # into `tally_all` alone: what is called is compiled twice
def tally(points, height, smoothing, joints, places, courses, speeds, lines, calm, squares, sums, whole, core, counts):
    """All tallies of ``points`` (n, J, 3), two frames at least, into ``counts`` (28,).

    Returns True, and nothing else, if it is not to be the ``whole`` and a part of it alone is to be tallied, which is
    then in ``core`` (2,) as `_find_repeated` tells it.

    ``smoothing`` are weights as of ``smooth``, of much and of little of it. ``joints`` are the hips (2,), the shoulders
    (2,), the joints (K,) that are looked at, and those on the other side of them. All else is working memory:
    ``places`` (n, J, 3) and (n, 2); ``courses`` two of (3, 3 K, n) and one of (3, E, n), in which poses and velocities
    stay, smoothed much, and little, and of what both sides do (E curves); ``speeds`` (3, n) of these; ``lines``
    (``N_LINES``, n); ``calm`` (``CALM``,) and (``CALM``, 3 K); ``squares`` (3 K, 3 K), (E, E), (6, 3 K), and the
    directions (3, 3 K) and (3, E); ``sums`` (3, ``SHORT`` + 1). A number of periods that takes a spectrum is NaN.
    """
    n, ordered, work, axes, fastest = len(points), lines[3], sums[2, :14], squares[3], 0.0
    hips, shoulders, looked_at, others = joints
    counts[:] = 0.0
    for which in range(3):  # smoothed much, smoothed little, what both sides do; each thing is called at one place
        course = courses[which]
        if which < 2:
            describe(points, height, smoothing[which], hips, shoulders, looked_at, places[0], places[1], course[0])
        else:
            fold(courses[0][0], others, course[0])
        differentiate(course[0], course[1], speeds[which])
        sort_into(speeds[which], ordered, lines[1])
        if which == 0:
            fastest = ordered[n - 1]
            if fastest <= STILL:
                return False
            if not whole and _find_repeated(course, speeds[0], ordered, lines, sums, core):
                return True
        if which == 2 and ordered[n - 1] <= max(_LEAST_EVEN * fastest, STILL):
            break
        if which != 1:  # what is smoothed less is looked at along the same directions
            axes = squares[3 + which // 2]
            _find_directions(course, squares[which // 2], squares[2], axes)
        _count_course(course, axes, 1 if which else 2, lines, work)
        periods = _count_periods(course[1], speeds[which], _read_moving(ordered), sums)
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
    """``tally`` for parts of one recording ``points`` (n, J, 3), into ``counts`` (N, 28).

    ``spans`` (N, 2) are the first frame of each part and the one after its last, two at least, and so many at most as
    there is working memory for: ``places``, ``left``, ``speeds`` and ``lines`` are flat, ``frames`` are three flat
    courses; the rest is as there. ``core`` is that of the last part, 0 where none is found.
    """
    number, start, trimmed = 0, 0, False
    while number < len(spans):  # a part whose core alone counts comes twice
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
        fast, rows = speeds[: 3 * n].reshape(3, n), lines[: N_LINES * n].reshape(N_LINES, n)
        trimmed = tally(
            part, height, smoothing, joints, room, courses, fast, rows, calm, squares, sums, whole or trimmed, core,
            counts[number],
        )  # fmt: skip
        if not trimmed:
            number += 1


@compiled
def choose(tallies, usual, known, n_counted, weights, least, farthest, most):
    """The count from 1 to ``most`` that tallies (28,) speak for: see ``counter``, which describes each count so.

    ``usual`` (28,) is looked at if ``known``; the first ``n_counted`` tallies are counts themselves.
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
