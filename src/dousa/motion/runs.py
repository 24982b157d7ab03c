"""Runs of frames: where a mask is true, and where a value stays the same."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import BoolArray, IndexArray


def find_runs(mask: BoolArray) -> IndexArray:
    """Find the first index and one past the last of each run of true in a mask (T,), as (N, 2)."""
    edges: IndexArray = np.flatnonzero(np.diff(np.concatenate(([False], mask, [False]))))
    return edges.reshape(-1, 2)


def find_equal_runs(values: NDArray[Any]) -> IndexArray:
    """Find the first index and one past the last of each run of one value in an array (T,), as (N, 2)."""
    if len(values) == 0:
        return np.zeros((0, 2), np.intp)
    cuts = np.flatnonzero(values[1:] != values[:-1]) + 1
    return np.stack([np.concatenate(([0], cuts)), np.concatenate((cuts, [len(values)]))], axis=1)
