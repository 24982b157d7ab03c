"""Compiled loops that find the directions in which points vary most: eigenvectors of small symmetric matrices.

A solver of whole matrices finds 27 directions where one or two are asked for. Here a matrix becomes tridiagonal by
Householder's reflections, its largest eigenvalues are found by bisection (Sturm counts), and their vectors by inverse
iteration. Source: Golub and Van Loan, "Matrix computations", 2013, sections 8.3, 8.4.1 and 8.2.2. Nothing here
allocates: without reference counts it compiles in half the time.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

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
