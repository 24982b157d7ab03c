"""Time-series correlation matrix: how alike every pose of one motion is to every pose of another.

Source: Yamane and Shakunaga, section 2.2.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dousa.errors import InvalidMotionError, OptionError
from dousa.evaluation.posture import SEGMENTS, check_segments, check_weights
from dousa.motion._types import FloatArray

__all__ = ["check_segment_weights", "check_sequence", "compute_correlation_matrix", "compute_similarity"]

_TILE = 64  # rows that a thread takes at a time
_WORTH_THREADS = 1_000_000  # pairs of poses; below, starting threads takes longer than the work
_MOST_PAIRS = 2**34  # 64 GiB


def compute_correlation_matrix(
    a: ArrayLike, b: ArrayLike, weights: ArrayLike | None = None, similarity: str = "cosine"
) -> NDArray[np.float32]:
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
        raise OptionError(
            f"correlation matrix: {len(first)} x {len(second)} is too large; lower the frame rate"
        )
    if similarity == "cosine":
        shares_of_a: FloatArray = shares / shares.sum()
        shares_of_b: FloatArray = np.ones_like(shares)
    elif similarity == "planar":
        shares_of_a, shares_of_b = shares * _planar_share(first, shares), _planar_share(second, shares)
        first, second = _flatten(first), _flatten(second)
    else:
        raise OptionError(f"similarity: expected 'cosine' or 'planar', got {similarity!r}")
    from dousa.evaluation._correlation_kernels import pack

    return _correlate(pack(first, shares_of_a), np.ascontiguousarray(pack(second, shares_of_b).T))


def check_sequence(values: ArrayLike, what: str) -> FloatArray:
    """Postures over time, checked.

    Parameters
    ----------
    values : (T, 9, 3) finite.
    what : name of the argument, for the message.

    Returns
    -------
    (T, 9, 3).

    Raises
    ------
    InvalidMotionError : another shape, no numbers, or values that are missing.
    """
    segments = check_segments(values, what)
    if segments.ndim != 3:
        raise InvalidMotionError(f"{what}: expected shape (frames, {len(SEGMENTS)}, 3), got {segments.shape}")
    return segments


def check_segment_weights(weights: ArrayLike | None) -> FloatArray:
    """Weights (9,) of the segments, checked, the same for all frames; equal ones if None.

    Raises
    ------
    OptionError : another shape, or values that are negative, missing or all 0.
    """
    shares = check_weights(weights)
    if shares.shape != (len(SEGMENTS),):
        raise OptionError(f"weights: expected one a segment, shape ({len(SEGMENTS)},), got {shares.shape}")
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
    return np.minimum(np.hypot(along, across) + up, 1.0)


def _planar_share(segments: FloatArray, shares: FloatArray) -> FloatArray:
    """(T, 1) one over the norm of the horizontal part of each pose; 0 for a pose that has none."""
    squared = (segments[..., 0] ** 2 + segments[..., 2] ** 2) @ shares
    norm = np.sqrt(squared)[:, None]
    return np.divide(1.0, norm, out=np.zeros_like(norm), where=norm > 0)


def _flatten(segments: FloatArray) -> FloatArray:
    return segments * np.array([1.0, 0.0, 1.0])


def _correlate(a: NDArray[np.float32], b: NDArray[np.float32]) -> NDArray[np.float32]:
    from joblib import cpu_count

    from dousa.evaluation._correlation_kernels import correlate_rows

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
