"""Compiled loops of dynamic time warping inside a band.

The costs of a row are computed from the postures when the row's turn comes and are forgotten with it; only one
byte a cell stays: where its path came from.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from dousa.evaluation._correlation_kernels import correlate_row

__all__ = ["trace_back", "warp"]

_DIAGONAL, _ROW_BEFORE, _COLUMN_BEFORE, _HERE = 0, 1, 2, 3
_FAR = 1e300


@njit(cache=True, nogil=True)
def warp(a, b, low, high, first, skip, origin):  # pragma: no cover - compiled
    """Cheapest path through a band; fills origin and returns the last cell.

    Parameters
    ----------
    a : (T, 27) packed postures, divided by the sum of weights.
    b : (27, U) packed postures.
    low, high : (T,) columns of the band in each row, half-open, both ascending; neighbours overlap.
    first : (T,) place of the band's first cell of each row in ``origin``.
    skip : price of a frame left out at either end; very large if the path goes from corner to corner.
    origin : (cells,) uint8.
    """
    n_rows, n_columns = len(a), b.shape[1]
    alike = np.empty(n_columns, np.float32)
    before = np.full(n_columns + 1, _FAR)  # one to the right: index u + 1, so that u - 1 exists for u = 0
    now = np.full(n_columns + 1, _FAR)
    price, last_row, last_column = _FAR, 0, 0
    for t in range(n_rows):
        start, stop = low[t], high[t]
        correlate_row(a[t], b, start, stop, alike)
        now[start] = _FAR
        left = _FAR
        place = first[t]
        for u in range(start, stop):
            best, source = before[u], _DIAGONAL
            if before[u + 1] < best:
                best, source = before[u + 1], _ROW_BEFORE
            if (t == 0 or u == 0) and (t + u) * skip <= best:
                best, source = (t + u) * skip, _HERE
            if left < best:
                best, source = left, _COLUMN_BEFORE
            left = best + (1.0 - alike[u])
            now[u + 1] = left
            origin[place] = source
            place += 1
        if t == n_rows - 1:
            for u in range(start, stop):
                if now[u + 1] + (n_columns - 1 - u) * skip <= price:
                    price, last_row, last_column = now[u + 1] + (n_columns - 1 - u) * skip, t, u
        elif stop == n_columns and left + (n_rows - 1 - t) * skip < price:
            price, last_row, last_column = left + (n_rows - 1 - t) * skip, t, stop - 1
        if t + 1 < n_rows:  # cells of the next row's band that this row did not reach
            for u in range(stop, high[t + 1]):
                now[u + 1] = _FAR
        before, now = now, before
    return last_row, last_column


@njit(cache=True, nogil=True)
def trace_back(origin, low, first, row, column, path):  # pragma: no cover - compiled
    """Write the path that ends in a cell, last cell first, into path (n, 2); returns its length."""
    n = 0
    while True:
        path[n, 0], path[n, 1] = row, column
        n += 1
        source = origin[first[row] + column - low[row]]
        if source == _HERE:
            return n
        if source != _COLUMN_BEFORE:
            row -= 1
        if source != _ROW_BEFORE:
            column -= 1
