"""Gradient-boosted trees that were trained elsewhere: arrays in a file, and what they say of features."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from dousa.arrays import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class BoostedTrees:
    """Trees whose leaves add up to the logits of classes.

    Parameters
    ----------
    feature : (N,) uint16, of each node; of a leaf unused.
    threshold : (N,) float32; a value at most this goes left. Of a leaf its value.
    left, right : (N,) int32, children; -1 of a leaf.
    roots : (R, C) int32, first node of each round's tree for each class.
    start : (C,) logits before the first tree.
    """

    feature: NDArray[np.uint16]
    threshold: NDArray[np.float32]
    left: NDArray[np.int32]
    right: NDArray[np.int32]
    roots: NDArray[np.int32]
    start: FloatArray

    def predict_log_proba(self, features: ArrayLike) -> FloatArray:
        """(N, C) logarithms of the probabilities of the classes, of features (N, F)."""
        rows = np.ascontiguousarray(features, np.float32)
        logits = _add_up(rows, self.feature, self.threshold, self.left, self.right, self.roots, self.start)
        most = logits.max(axis=1, keepdims=True)
        found: FloatArray = logits - most - np.log(np.exp(logits - most).sum(axis=1, keepdims=True))
        return found

    def to_arrays(self, prefix: str) -> dict[str, np.ndarray]:
        """The arrays by name, for a file."""
        return {f"{prefix}_{name}": getattr(self, name) for name in _ARRAYS}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, np.ndarray], prefix: str) -> BoostedTrees:
        """The trees whose ``to_arrays(prefix)`` these are."""
        return cls(**{name: np.ascontiguousarray(arrays[f"{prefix}_{name}"]) for name in _ARRAYS})


_BLOCK = 128
_ARRAYS = ("feature", "threshold", "left", "right", "roots", "start")


@njit(cache=True, nogil=True)
def _add_up(
    rows: np.ndarray,
    feature: np.ndarray,
    threshold: np.ndarray,
    left: np.ndarray,
    right: np.ndarray,
    roots: np.ndarray,
    start: np.ndarray,
) -> FloatArray:  # pragma: no cover - compiled
    logits = np.empty((len(rows), len(start)))
    for i in range(len(rows)):  # all at once would have the compiler write the message of an error, for seconds
        for c in range(len(start)):
            logits[i, c] = start[c]
    # A tree for a block of rows: both stay in the nearest cache.
    for first in range(0, len(rows), _BLOCK):
        last = min(first + _BLOCK, len(rows))
        for turn in range(len(roots)):
            for c in range(len(start)):
                root = roots[turn, c]
                for i in range(first, last):
                    node = root
                    while left[node] >= 0:
                        node = left[node] if rows[i, feature[node]] <= threshold[node] else right[node]
                    logits[i, c] += threshold[node]
    return logits
