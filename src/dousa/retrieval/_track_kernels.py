"""Compiled loops that read the cells of windows from the running sums of a recording, and send them down the trees."""

from __future__ import annotations

import numpy as np
from numba import njit

from dousa.retrieval._descent_kernels import run_down, run_down_means

__all__ = ["find_window_leaves", "read_cells"]


@njit(cache=True, nogil=True)
def _read_edge(integrals, times, edge, n_channels, row):
    """The integrals up to one instant, into ``row`` (banks * n_channels,); returns the instant in motion time."""
    width = integrals.shape[1]
    below = min(int(edge), integrals.shape[0] - 2)
    share = edge - below
    whole = times[below + 1] - times[below]
    time = times[below] + share * whole
    for c in range(min(width, 2 * n_channels)):
        row[c] = integrals[below, c] + share * (integrals[below + 1, c] - integrals[below, c])
    if width > n_channels:
        # Within a frame the value is constant, so its integral over time is a line, its moment a parabola.
        grown = 0.5 * (time * time - times[below] * times[below]) / whole
        for c in range(n_channels):
            value = integrals[below + 1, c] - integrals[below, c]
            row[2 * n_channels + c] = integrals[below, 2 * n_channels + c] + grown * value
    return time


@njit(cache=True, nogil=True)
def read_cells(integrals, times, edges, n_channels, work, out):
    """Cell means of windows, into ``out`` (W, T, F).

    ``integrals`` (n + 1, banks * n_channels) are the integrals of the values over ``times`` (n + 1,) and, with three
    banks, of their squares and of the values times the time; ``edges`` (W, T + 1) are the edges of the cells in frames.
    With three banks F is 3 C + 1: the means, a column that is left as it is, the means of the squares, and those of the
    values times the time, counted in cells from the start of the window. ``work`` (2, banks * n_channels) is working
    memory.
    """
    squares, moments = n_channels, 2 * n_channels
    before, now = work[0], work[1]
    for w in range(out.shape[0]):
        earlier = 0.0
        for t in range(edges.shape[1]):
            time = _read_edge(integrals, times, edges[w, t], n_channels, now)
            if t > 0:
                cell = max(time - earlier, 1e-12)
                row = out[w, t - 1]
                for c in range(n_channels):
                    row[c] = (now[c] - before[c]) / cell
                if integrals.shape[1] > n_channels:
                    for c in range(n_channels):
                        row[squares + 1 + c] = (now[squares + c] - before[squares + c]) / cell
                        moment = now[moments + c] - before[moments + c] - earlier * (now[c] - before[c])
                        row[moments + 1 + c] = (t - 1) * row[c] + moment / (cell * cell)
            before, now = now, before
            earlier = time


@njit(cache=True, nogil=True)
def find_window_leaves(integrals, times, edges, rate, n_channels, nodes, cuts, roots, only_means, leaves):
    """The leaf that each window reaches in each tree, into ``leaves`` (W, n_trees).

    What ``read_cells`` and ``find_leaves`` say one after the other, but for the last bits: the cells of a window are
    equally long in motion time, so the sums of eq. 4 are integrals of the recording, less those at the start.
    """
    width = integrals.shape[1]
    last = edges.shape[1] - 1
    shift = np.int64(width > n_channels)  # the duration stands between the values and their squares
    start, row = np.empty(width), np.empty(width)
    integral = np.zeros((width + shift) * (last + 1))
    places, trees = np.empty(len(roots), np.int64), np.empty(len(roots), np.int64)
    for w in range(edges.shape[0]):
        begin = _read_edge(integrals, times, edges[w, 0], n_channels, start)
        end = _read_edge(integrals, times, edges[w, last], n_channels, row)
        per_cell = last / max(end - begin, 1e-12)
        for t in range(1, last + 1):
            _read_edge(integrals, times, edges[w, t], n_channels, row)
            for c in range(n_channels):
                integral[c * (last + 1) + t] = (row[c] - start[c]) * per_cell
            if shift:
                for c in range(n_channels, 2 * n_channels):
                    integral[(c + 1) * (last + 1) + t] = (row[c] - start[c]) * per_cell
                for c in range(n_channels):
                    moment = row[2 * n_channels + c] - start[2 * n_channels + c] - begin * (row[c] - start[c])
                    integral[(2 * n_channels + c + 1) * (last + 1) + t] = moment * per_cell * per_cell
                integral[n_channels * (last + 1) + t] = t * (edges[w, last] - edges[w, 0]) / rate
        if only_means:
            run_down_means(integral, nodes, cuts, roots, places, trees, leaves[w])
        else:
            run_down(integral, last + 1, nodes, cuts, roots, places, trees, leaves[w])
