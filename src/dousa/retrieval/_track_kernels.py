"""Compiled loop that reads the cells of windows from the running sums of a recording."""

from __future__ import annotations

from numba import njit

__all__ = ["read_cells"]


@njit(cache=True, nogil=True)
def read_cells(integrals, times, edges, n_channels, work, out):
    """Cell means of windows, into ``out`` (W, T, F).

    ``integrals`` (n + 1, banks * n_channels) are the integrals of the values over ``times`` (n + 1,) and, with three
    banks, of their squares and of the values times the time; ``edges`` (W, T + 1) are the edges of the cells in frames.
    With three banks F is 3 C + 1: the means, a column that is left as it is, the means of the squares, and those of the
    values times the time, counted in cells from the start of the window. ``work`` (2, banks * n_channels) is working
    memory.
    """
    last = integrals.shape[0] - 2
    width = integrals.shape[1]
    squares, moments = n_channels, 2 * n_channels
    before, now = work[0], work[1]
    for w in range(out.shape[0]):
        earlier = 0.0
        for t in range(edges.shape[1]):
            below = min(int(edges[w, t]), last)
            share = edges[w, t] - below
            time = times[below] + share * (times[below + 1] - times[below])
            for c in range(min(width, moments)):
                now[c] = integrals[below, c] + share * (integrals[below + 1, c] - integrals[below, c])
            if width > n_channels:
                # Within a frame the value is constant, so its integral over time is a line, its moment a parabola.
                whole = times[below + 1] - times[below]
                grown = 0.5 * (time * time - times[below] * times[below]) / whole
                for c in range(n_channels):
                    value = integrals[below + 1, c] - integrals[below, c]
                    now[moments + c] = integrals[below, moments + c] + grown * value
            if t > 0:
                cell = max(time - earlier, 1e-12)
                row = out[w, t - 1]
                for c in range(n_channels):
                    row[c] = (now[c] - before[c]) / cell
                if width > n_channels:
                    for c in range(n_channels):
                        row[squares + 1 + c] = (now[squares + c] - before[squares + c]) / cell
                        moment = now[moments + c] - before[moments + c] - earlier * (now[c] - before[c])
                        row[moments + 1 + c] = (t - 1) * row[c] + moment / (cell * cell)
            before, now = now, before
            earlier = time
