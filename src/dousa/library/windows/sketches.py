"""A few bytes of a window that say nearly what it costs as an answer to a query.

What is compared of a window, the mean poses of its parts and their changes, is a vector; its first principal
coordinates are kept, one byte each, and how far it lies from what these span. Of two vectors the rests are not known
to be alike or not: they are taken to stand at an angle. Of leaves those of some trees are told apart, by a byte each.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import FloatArray
from dousa.retrieval.takes.find import cost_windows
from dousa.retrieval.takes.windows import N_PARTS, TakeWindows

N_VALUES = 15
"""Coordinates of a sketch."""

N_MARKS = 32
"""Trees whose leaves are told apart."""

# The cosine between the rests of a query and of windows that are like it; chosen on joined takes of UTD-MHAD.
_ALIKE = 0.4
# The share of all trees is that of some, and of one tree more with a usual share.
_USUAL_SHARE = 0.25
_LEAST_STEP = 1e-9
_AT_ONCE = 16_384  # windows whose mean poses are in memory: 28 MB, and some times that on the way
_NEARLY_ALL = 0.9999  # what is farther out is taken to be as far as that


@dataclass(frozen=True, slots=True, eq=False)
class Sketcher:
    """Makes sketches of windows, fitted to some of them.

    Parameters
    ----------
    centre : (P,) mean of the mean poses of the parts of windows.
    axes : (P, R) by which coordinates are computed.
    steps : (2,) of the coordinates and of the rests.
    """

    centre: FloatArray
    axes: FloatArray
    steps: FloatArray

    @classmethod
    def fit(cls, means: FloatArray) -> Sketcher:
        """For windows like some of which the mean poses of the parts (N, 8, 27) are known."""
        flat = means.reshape(len(means), -1)
        centre = flat.mean(axis=0)
        whole = _expand((flat - centre).reshape(means.shape))
        basis = np.linalg.eigh(whole.T @ whole)[1][:, : -N_VALUES - 1 : -1]
        axes = _expand(np.eye(flat.shape[1]).reshape(-1, *means.shape[1:])) @ basis
        known = cls(centre, axes, np.ones(2))
        placed, rests = known.place(means)
        steps = np.quantile(np.abs(placed), _NEARLY_ALL) / 127, np.quantile(rests, _NEARLY_ALL) / 255
        return cls(centre, axes, np.maximum(steps, _LEAST_STEP))

    def place(self, means: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Coordinates (N, R) and rests (N,) of the mean poses of parts (N, 8, 27)."""
        apart = means.reshape(len(means), len(self.centre)) - self.centre
        placed = apart @ self.axes
        parts = apart.reshape(means.shape)
        changes = np.diff(parts, axis=1)
        squares = np.einsum("ijk,ijk->i", parts, parts) + np.einsum("ijk,ijk->i", changes, changes)
        squares *= len(parts) / max(parts.size + changes.size, 1)
        squares -= np.einsum("ij,ij->i", placed, placed)
        return placed, np.sqrt(np.maximum(squares, 0.0))

    def sketch(self, means: FloatArray) -> NDArray[np.int8]:
        """(R + 1, N) for ``kernels.scan_sketches``."""
        placed, rests = self.place(means)
        sketches = np.empty((placed.shape[1] + 1, len(means)), np.int8)
        sketches[:-1] = np.clip(np.rint(placed.T / self.steps[0]), -127, 127)
        sketches[-1] = np.clip(np.rint(rests / self.steps[1]), 0, 255) - 128
        return sketches

    def ask(self, parts: FloatArray) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Coordinates of a query (8, 27) in steps, and what the rest of a window adds to its squared distance."""
        placed, rests = self.place(parts[None])
        own, theirs = float(rests[0]), np.arange(256) * self.steps[1]
        added = (theirs - own) ** 2 + 2.0 * (1.0 - _ALIKE) * theirs * own
        step = self.steps[0]
        return (placed[0] / step).astype(np.float32), (added / step**2).astype(np.float32)


def cost_marks(n_marks: int) -> FloatArray:
    """(S + 1,) what leaves cost of which as many are the same."""
    shares = (np.arange(n_marks + 1) + _USUAL_SHARE) / (n_marks + 1)
    costs: FloatArray = cost_windows(0.0, shares)
    return costs


def cut_windows(windows: TakeWindows, rows: slice | NDArray[np.intp]) -> FloatArray:
    """(N, 8, 27) mean poses of the parts of some windows of a take, as ``compare_poses`` has them."""
    starts, lengths = windows.starts[rows, None], (windows.stops - windows.starts)[rows, None]
    edges = starts + (np.arange(N_PARTS + 1) * lengths * 2 + N_PARTS) // (2 * N_PARTS)
    means: FloatArray = np.diff(windows.sums[edges], axis=1) / np.diff(edges, axis=1)[..., None]
    return means


def sketch_windows(sketcher: Sketcher, windows: TakeWindows, rows: slice) -> NDArray[np.int8]:
    """(R + 1, N) sketches of some windows of a take, which may be long: of many windows some at a time."""
    first, last, _ = rows.indices(len(windows.starts))
    starts = range(first, last, _AT_ONCE)
    parts = [sketcher.sketch(cut_windows(windows, slice(one, min(one + _AT_ONCE, last)))) for one in starts]
    return np.concatenate([np.empty((sketcher.axes.shape[1] + 1, 0), np.int8), *parts], axis=1)


def _expand(means: FloatArray) -> FloatArray:
    """Mean poses and their changes, so that the length of a difference is what ``compare_poses`` computes."""
    count, n_parts, n_values = means.shape
    whole = np.concatenate([means, np.diff(means, axis=1)], axis=1).reshape(count, (2 * n_parts - 1) * n_values)
    scaled: FloatArray = whole / np.sqrt((2 * n_parts - 1) * n_values)
    return scaled
