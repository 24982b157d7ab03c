"""Names of the array types."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
IndexArray = NDArray[np.intp]
BoolArray = NDArray[np.bool_]
Mask = NDArray[np.bool_]
"""(..., H, W), True where the person is."""
Image = NDArray[np.uint8]
"""(H, W) or (H, W, 3), bytes."""


def read_only(array: FloatArray) -> FloatArray:
    """Return a read-only view, so that kernels compile once for arrays of both kinds."""
    view = array.view()
    view.flags.writeable = False
    return view


def iterate_blocks(count: int, size: int = 4096) -> Iterator[slice]:
    """Iterate over blocks of so many frames: work on all at once would hold several times their memory."""
    return (slice(first, min(first + size, count)) for first in range(0, count, size))


def spread_evenly(n: int, most: int) -> IndexArray:
    """Return at most ``most`` of n indices, evenly spread from the first to the last."""
    return np.unique(np.linspace(0, n - 1, min(n, most)).round()).astype(np.intp)


def nearest_frames(times: FloatArray, moments: FloatArray) -> IndexArray:
    """(S,) the frame that is nearest to each moment."""
    after = np.clip(np.searchsorted(times, moments), 1, max(len(times) - 1, 1))
    before = after - 1
    if len(times) == 1:
        return np.zeros(len(moments), np.intp)
    return np.where(moments - times[before] <= times[after] - moments, before, after)
