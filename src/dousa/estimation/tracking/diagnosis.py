"""What is noted down about every settled pose: overlap with the silhouettes, hidden parts, how far to trust it."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from dousa.arrays import FloatArray
from dousa.estimation.body.kinematics import compute_points
from dousa.estimation.raster.rasteriser import borrow, interval_mask, outline_part, popcount
from dousa.estimation.tracking.beam import move_pose
from dousa.estimation.tracking.search_kernels import (
    count_parts_apart,
    draw_parts_into,
    fill_evidence,
    move_axis,
    place_parts,
    select_fixed,
)
from dousa.estimation.tracking.search_setup import Frame, SearchSetup

_HIDDEN = 0.1  # share of a part's own pixels below which the image does not tell where it is
_LEAST_OVERLAP = 0.35
_LOST_SHARE = 0.7  # of the usual overlap


class Diagnosis:
    """Notes on settled poses, frame by frame.

    Parameters
    ----------
    setup : body, cameras and settings.
    """

    def __init__(self, setup: SearchSetup) -> None:
        self.setup = setup
        self._scratch = setup.make_scratch()
        self._overlap: list[FloatArray] = []
        self._uncertainty: list[FloatArray] = []
        self._occluded: list[NDArray[np.bool_]] = []

    def cover(self, pose: FloatArray, frame: Frame) -> float:
        """Mean overlap of a pose over the views that see somebody; 0 if none does."""
        overlap, _ = self._cover(pose, frame)
        seen = overlap[np.isfinite(overlap)]
        return float(seen.mean()) if len(seen) else 0.0

    def _cover(self, pose: FloatArray, frame: Frame) -> tuple[FloatArray, FloatArray]:
        overlap, visible = np.empty(len(self.setup.cameras)), np.empty(self.setup.body.n_parts)
        cover_views(pose, self.setup.model, self.setup.views(frame), self._scratch, overlap, visible)
        return overlap, visible

    def look(self, pose: FloatArray, frame: Frame) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Overlap (V,) of a pose with the silhouettes, NaN where there is none, and hidden parts (P,)."""
        overlap, visible = self._cover(pose, frame)
        return overlap, visible < _HIDDEN

    @property
    def latest(self) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Overlap (V,) and hidden parts (P,) of the pose noted down last."""
        return self._overlap[-1], self._occluded[-1]

    def write(self, pose: FloatArray, frame: Frame) -> None:
        """Note down a settled pose."""
        overlap, visible = self._cover(pose, frame)
        self._overlap.append(overlap)
        self._occluded.append(visible < _HIDDEN)
        self._uncertainty.append(self._measure_spread(pose, frame))

    def _measure_spread(self, pose: FloatArray, frame: Frame) -> FloatArray:
        """How far (P + K,) m each point moves while the image stays nearly as well explained.

        Each degree of freedom is moved by itself to where the image's score has dropped by one, at most dR; what that
        moves the points by adds up in squares.
        """
        setup = self.setup
        low, high = np.zeros(setup.n_axes), np.zeros(setup.n_axes)
        measure_widths(pose, setup.weights, setup.bounds, setup.model, setup.views(frame), self._scratch, low, high)
        half = 0.5 * (low + high)
        axes = np.flatnonzero(half)
        if not len(axes):
            return np.zeros(setup.body.n_parts + len(setup.body.tips))
        moved = np.tile(pose, (len(axes), 1))
        for row, axis in zip(moved, axes, strict=True):
            if 3 <= axis < 6:
                row[:] = move_pose(pose, half[axis] * np.eye(setup.n_axes)[axis])
            else:
                row[axis + (axis >= 6)] += half[axis]
        points = compute_points(setup.body, np.concatenate((pose[None], moved)))
        away = np.linalg.norm(points[1:] - points[0], axis=-1)
        return np.asarray(np.sqrt((away * away).sum(axis=0)))

    def is_lost(self, covered: float, usual: float) -> bool:
        """Whether an overlap is that of a track gone wrong."""
        return covered < max(_LEAST_OVERLAP, _LOST_SHARE * usual)

    def find_lost(self, overlap: FloatArray, usual: float) -> NDArray[np.bool_]:
        """(T,) frames whose overlap (T, V) is poor in the mean of the views, or that nobody sees."""
        seen = np.isfinite(overlap)
        count = seen.sum(axis=1)
        mean = np.where(seen, overlap, 0.0).sum(axis=1) / np.maximum(count, 1)
        return np.array([n == 0 or self.is_lost(m, usual) for n, m in zip(count, mean, strict=True)], np.bool_)

    def arrays(self) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
        """Overlap (T, V), uncertainty (T, P + K) m and hidden parts (T, P)."""
        body, n_views = self.setup.body, len(self.setup.cameras)
        return (
            np.array(self._overlap).reshape(-1, n_views),
            np.array(self._uncertainty).reshape(-1, body.n_parts + len(body.tips)),
            np.array(self._occluded, np.bool_).reshape(-1, body.n_parts),
        )

    def load(self, overlap: FloatArray, uncertainty: FloatArray, occluded: NDArray[np.bool_]) -> None:
        """Take up the notes of an earlier run."""
        self._overlap, self._uncertainty, self._occluded = list(overlap), list(uncertainty), list(occluded)


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
            first, last = outline_part(part, cameras[view], width, height, model[1], scratch[5], scratch[6], work)
            for row in range(first, last):
                start, stop = work[2][row], work[3][row]
                for word in range(start >> 6, (stop >> 6) + 1 if stop >= start else 0):
                    mask = interval_mask(word, start, stop)
                    twice[view, row, word] |= once[view, row, word] & mask
                    once[view, row, word] |= mask
        both, either = np.int64(0), np.int64(0)
        for row in range(silhouettes.shape[1]):
            for word in range(silhouettes.shape[2]):
                s, b = silhouettes[view, row, word], once[view, row, word]
                both += np.int64(popcount(s & b))
                either += np.int64(popcount(s | b))
        overlap[view] = both / either if either > 0 else np.nan
        for part in range(n_parts):
            first, last = outline_part(part, cameras[view], width, height, model[1], scratch[5], scratch[6], work)
            own, whole = np.int64(0), np.int64(0)
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
            low[axis] = _measure_width(axis, -1.0, allowed, below, pose, bounds[0][axis], model, views, scratch)
            high[axis] = _measure_width(axis, 1.0, allowed, below, pose, bounds[0][axis], model, views, scratch)


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
