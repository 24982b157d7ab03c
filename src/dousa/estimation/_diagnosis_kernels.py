"""Compiled look at a pose that has been found: what it covers, what hides, what could as well lie elsewhere."""

from __future__ import annotations

import numpy as np
from numba import njit

from dousa.estimation._borrowing import borrow
from dousa.estimation._raster_kernels import interval_mask, outline_part, popcount
from dousa.estimation._search_kernels import (
    count_parts_apart,
    draw_parts_into,
    fill_evidence,
    move_axis,
    place_parts,
    select_fixed,
)

__all__ = ["cover_views", "measure_widths"]

_TIE = 1.0  # log score: what drops by less is as good


@njit(cache=True, nogil=True)
def cover_views(pose, model, views, scratch, overlap, visible):  # type: ignore[no-untyped-def]
    """Overlap of body and silhouette in each view, and how much of each part no other part covers.

    Fills ``overlap`` (V,), intersection over union, NaN where nothing is seen, and ``visible`` (P,), the greatest share
    over the views of a part's pixels that are its own alone.
    """
    pose, model, views, scratch = borrow((pose, model, views, scratch))
    overlap, visible = borrow((overlap, visible))
    cameras, sizes, seen, silhouettes = views
    work, once, twice = scratch[0], scratch[2], scratch[3]
    n_parts = len(visible)
    once[:] = np.uint64(0)
    twice[:] = np.uint64(0)
    visible[:] = 0.0
    place_parts(model[2][:n_parts], n_parts, pose, model[0], scratch)
    for view in range(len(cameras)):
        overlap[view] = np.nan
        if not seen[view]:
            continue
        width, height = sizes[view, 0], sizes[view, 1]
        for part in range(n_parts):
            first, last = outline_part(
                part, cameras[view], width, height, model[1], scratch[5], scratch[6], work
            )
            for row in range(first, last):
                start, stop = work[2][row], work[3][row]
                for word in range(start >> 6, (stop >> 6) + 1 if stop >= start else 0):
                    mask = interval_mask(word, start, stop)
                    twice[view, row, word] |= once[view, row, word] & mask
                    once[view, row, word] |= mask
        both, either = 0, 0
        for row in range(silhouettes.shape[1]):
            for word in range(silhouettes.shape[2]):
                s, b = silhouettes[view, row, word], once[view, row, word]
                both += np.int64(popcount(s & b))
                either += np.int64(popcount(s | b))
        overlap[view] = both / either if either > 0 else np.nan
        for part in range(n_parts):
            first, last = outline_part(
                part, cameras[view], width, height, model[1], scratch[5], scratch[6], work
            )
            own, whole = 0, 0
            for row in range(first, last):
                start, stop = work[2][row], work[3][row]
                for word in range(start >> 6, (stop >> 6) + 1 if stop >= start else 0):
                    mask = interval_mask(word, start, stop)
                    whole += np.int64(popcount(mask))
                    own += np.int64(popcount(mask & ~twice[view, row, word]))
            if whole > 0:
                visible[part] = max(visible[part], own / whole)


@njit(cache=True, nogil=True)
def measure_widths(pose, weights, bounds, model, views, scratch, low, high):  # type: ignore[no-untyped-def]
    """How far each degree of freedom can be moved either way before the image's score drops by one.

    Fills ``low`` and ``high`` (D,), amounts of 0 or more, dR / 32, / 8 or / 2.
    """
    pose, weights, bounds, model, views, scratch = borrow((pose, weights, bounds, model, views, scratch))
    low, high = borrow((low, high))
    tree, subtrees, starts = model[0], model[2], model[3]
    plus, minus = scratch[2], scratch[3]
    n_parts = len(tree[0])
    for part in range(n_parts):
        below = subtrees[starts[part] : starts[part + 1]]
        place_parts(subtrees[:n_parts], n_parts, pose, tree, scratch)
        scratch[4][:] = np.uint64(0)
        draw_parts_into(scratch[4], select_fixed(part, n_parts, below, scratch[9]), model, views, scratch)
        fill_evidence(0, views[3], scratch[4], plus, minus)
        allowed = count_parts_apart(below, model, views, plus, minus, scratch) + _TIE / weights[2]
        first = 0 if part == 0 else 6 + tree[5][part]
        for axis in range(first, first + (6 if part == 0 else tree[3][part])):
            low[axis] = _measure_width(
                axis, -1.0, allowed, below, pose, bounds[0][axis], model, views, scratch
            )
            high[axis] = _measure_width(
                axis, 1.0, allowed, below, pose, bounds[0][axis], model, views, scratch
            )


@njit(cache=True, nogil=True)
def _measure_width(axis, side, allowed, below, pose, spread, model, views, scratch):  # type: ignore[no-untyped-def]
    """The last of the growing amounts up to which the mismatch stays within what is allowed."""
    trial = scratch[8]
    reached, amount = 0.0, spread / 32.0
    while amount <= spread:
        trial[:] = pose
        move_axis(trial, axis, side * amount)
        place_parts(below, 1, trial, model[0], scratch)
        if count_parts_apart(below, model, views, scratch[2], scratch[3], scratch) > allowed:
            break
        reached = amount
        amount *= 4.0
    return reached
