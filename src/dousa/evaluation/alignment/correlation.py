"""Time-series correlation matrix: how alike every pose of one motion is to every pose of another.

Source: Yamane and Shakunaga, section 2.2.
"""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from dousa.arrays import FloatArray
from dousa.errors import InvalidMotionError, OptionError
from dousa.evaluation.posture.posture import SEGMENTS, check_segments, check_weights

Matrix = NDArray[np.float32]
_TILE = 64  # rows that a thread takes at a time
_WORTH_THREADS = 1_000_000  # pairs of poses; below, starting threads takes longer than the work
_MOST_PAIRS = 2**34  # 64 GiB


def compute_correlation_matrix(
    a: ArrayLike, b: ArrayLike, weights: ArrayLike | None = None, similarity: str = "cosine"
) -> Matrix:
    """Similarity of every pose of one motion to every pose of another, whichever way they face.

    Parameters
    ----------
    a : (T, 9, 3) unit vectors, Y up.
    b : (U, 9, 3) unit vectors, Y up.
    weights : (9,) of the segments, 0 or above; None for equal ones.
    similarity : ``"cosine"`` is S, the mean cosine between the segments at the best yaw; ``"planar"`` is |C|, the
        modulus of the complex correlation, which sees only the horizontal parts.

    Returns
    -------
    (T, U) float32. S is -1 to 1, |C| is 0 to 1; equal poses have 1 but for rounding (some 1e-7).

    Raises
    ------
    InvalidMotionError : wrong shapes or missing values.
    OptionError : an unknown similarity, wrong weights, or a matrix of more than 64 GiB.

    Source: Yamane and Shakunaga, section 2.2 and eq. 5. |C| is the paper's; it is blind to height, so that arms
    mirrored up and down score 1. The default is S = (|sum w h conj(h')| + sum w y y') / sum w, where h is the
    horizontal part as a complex number and y the vertical one: turning b by theta changes only
    Re(exp(-j theta) sum h conj(h')), whose maximum is the modulus.
    """
    first, second = check_sequence(a, "a"), check_sequence(b, "b")
    shares = check_segment_weights(weights)
    if len(first) * len(second) > _MOST_PAIRS:
        raise OptionError("correlation.too_large", rows=len(first), columns=len(second))
    if similarity == "cosine":
        shares_of_a: FloatArray = shares / shares.sum()
        shares_of_b: FloatArray = np.ones_like(shares)
    elif similarity == "planar":
        shares_of_a, shares_of_b = shares * _planar_share(first, shares), _planar_share(second, shares)
        first, second = _flatten(first), _flatten(second)
    else:
        raise OptionError("correlation.similarity", similarity=similarity)

    return _correlate(pack(first, shares_of_a), np.ascontiguousarray(pack(second, shares_of_b).T))


def check_sequence(values: ArrayLike, what: str) -> FloatArray:
    """Postures over time (T, 9, 3), finite; ``what`` names the argument in the error.

    Raises
    ------
    InvalidMotionError : another shape, no numbers, or values that are missing.
    """
    segments = check_segments(values, what)
    if segments.ndim != 3:
        raise InvalidMotionError("postures.sequence_shape", what=what, shape=segments.shape)
    return segments


def check_segment_weights(weights: ArrayLike | None) -> FloatArray:
    """Weights (9,) of the segments, checked, the same for all frames; equal ones if None.

    Raises
    ------
    OptionError : another shape, or values that are negative, missing or all 0.
    """
    shares = check_weights(weights)
    if shares.shape != (len(SEGMENTS),):
        raise OptionError("postures.segment_weights_shape", shape=shares.shape)
    return shares


def compute_similarity(a: ArrayLike, b: ArrayLike, weights: ArrayLike | None = None) -> FloatArray:
    """Similarity S of poses pair by pair: the mean cosine between the segments at the best yaw.

    Parameters
    ----------
    a, b : (..., 9, 3) unit vectors, Y up; leading axes broadcast.
    weights : (9,) of the segments, 0 or above; None for equal ones.

    Returns
    -------
    (...) -1 to 1.

    Raises
    ------
    InvalidMotionError : wrong shapes or missing values.
    OptionError : wrong weights.
    """
    first, second = check_segments(a, "a"), check_segments(b, "b")
    shares = check_segment_weights(weights)
    shares = shares / shares.sum()
    along = ((first[..., 2] * second[..., 2] + first[..., 0] * second[..., 0]) * shares).sum(axis=-1)
    across = ((first[..., 0] * second[..., 2] - first[..., 2] * second[..., 0]) * shares).sum(axis=-1)
    up = (first[..., 1] * second[..., 1] * shares).sum(axis=-1)
    return np.asarray(np.minimum(np.hypot(along, across) + up, 1.0))


def _planar_share(segments: FloatArray, shares: FloatArray) -> FloatArray:
    """(T, 1) one over the norm of the horizontal part of each pose; 0 for a pose that has none."""
    squared = (segments[..., 0] ** 2 + segments[..., 2] ** 2) @ shares
    norm = np.sqrt(squared)[:, None]
    return np.asarray(np.divide(1.0, norm, out=np.zeros_like(norm), where=norm > 0))


def _flatten(segments: FloatArray) -> FloatArray:
    return np.asarray(segments * np.array([1.0, 0.0, 1.0]))


def _correlate(a: Matrix, b: Matrix) -> Matrix:
    from joblib import cpu_count

    matrix = np.empty((len(a), b.shape[1]), np.float32)
    if matrix.size < _WORTH_THREADS:
        correlate_rows(a, b, matrix, 0, len(a))
        return matrix
    with ThreadPoolExecutor(cpu_count()) as pool:
        jobs = [
            pool.submit(correlate_rows, a, b, matrix, start, min(start + _TILE, len(a)))
            for start in range(0, len(a), _TILE)
        ]
        for job in jobs:
            job.result()
    return matrix


def pack(segments: FloatArray, shares: FloatArray) -> np.ndarray:
    """(T, 27) float32: z, x and y of the nine segments, times (9,) or (T, 9) shares of them."""
    parts = np.empty((len(segments), 3, segments.shape[1]), np.float32)
    for row, axis in enumerate((2, 0, 1)):
        np.multiply(segments[:, :, axis], shares, out=parts[:, row], casting="same_kind")
    return parts.reshape(len(segments), 3 * segments.shape[1])


# Contraction to fused multiply-add is the only liberty taken; nan and inf stay what they are.
@njit(cache=True, nogil=True, fastmath={"contract"})
def correlate_row(pose: Matrix, b: Matrix, low: int, high: int, out: Matrix) -> None:  # pragma: no cover - compiled
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
def correlate_rows(a: Matrix, b: Matrix, out: Matrix, start: int, stop: int) -> None:  # pragma: no cover - compiled
    """Rows start to stop of the matrix of a (T, 27) and b (27, U), packed, into out (T, U)."""
    for i in range(start, stop):
        correlate_row(a[i], b, 0, b.shape[1], out[i])
