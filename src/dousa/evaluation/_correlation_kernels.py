"""Compiled loop of the correlation matrix.

One pass: 45 multiplications a pair of poses in registers, one write. The loop over the columns is innermost but
for the nine segments, which the compiler unrolls, so that it works on eight columns at a time.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from dousa.motion._types import FloatArray

__all__ = ["correlate_row", "correlate_rows", "pack"]


def pack(segments: FloatArray, shares: FloatArray) -> np.ndarray:
    """(T, 27) float32: z, x and y of the nine segments, times (9,) or (T, 9) shares of them."""
    parts = np.empty((len(segments), 3, segments.shape[1]), np.float32)
    for row, axis in enumerate((2, 0, 1)):
        np.multiply(segments[:, :, axis], shares, out=parts[:, row], casting="same_kind")
    return parts.reshape(len(segments), 3 * segments.shape[1])


# Contraction to fused multiply-add is the only liberty taken; nan and inf stay what they are.
@njit(cache=True, nogil=True, fastmath={"contract"})
def correlate_row(pose, b, low, high, out):  # pragma: no cover - compiled
    """|sum h conj(h')| + sum y y' of a pose (27,) and columns low to high of b (27, U), into out[low:high]."""
    # Unsigned, so that the compiler knows no index counts from the end: else it does not vectorise.
    for u in range(np.uint64(low), np.uint64(high)):
        along = across = up = np.float32(0.0)
        for p in range(9):
            along += pose[p] * b[p, u]
            along += pose[9 + p] * b[9 + p, u]
            across += pose[9 + p] * b[p, u]
            across -= pose[p] * b[9 + p, u]
            up += pose[18 + p] * b[18 + p, u]
        out[u] = min(math.sqrt(along * along + across * across) + up, np.float32(1.0))


@njit(cache=True, nogil=True)
def correlate_rows(a, b, out, start, stop):  # pragma: no cover - compiled
    """Rows start to stop of the matrix of a (T, 27) and b (27, U), packed, into out (T, U)."""
    for i in range(start, stop):
        correlate_row(a[i], b, 0, b.shape[1], out[i])
