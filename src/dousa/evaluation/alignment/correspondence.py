"""Time-series correlation matrix, and the correspondence of the moments of two motions in it.

Source: Yamane and Shakunaga, section 2.2: straight lines in the correlation matrix where the tempo agrees; section
2.3 (4): a curve where it drifts. The curve is found by dynamic time warping on 1 - S.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from dousa.arrays import FloatArray, IndexArray
from dousa.errors import InvalidMotionError, OptionError
from dousa.evaluation.alignment.dynamic_programming import Matrix, correlate_rows, pack, trace_back, warp
from dousa.evaluation.posture.posture import SEGMENTS, check_segments, check_weights


def compute_correlation_matrix(
    a: ArrayLike,
    b: ArrayLike,
    weights: ArrayLike | None = None,
    similarity: str = "cosine",
    *,
    largest_gib: float = 64.0,
    worth_threads: int = 1_000_000,
) -> Matrix:
    """Compute the similarity of every pose of one motion to every pose of another, at any heading.

    Parameters
    ----------
    a : (T, 9, 3) unit vectors, Y up.
    b : (U, 9, 3) unit vectors, Y up.
    weights : (9,) of the segments, 0 or above; None for equal ones.
    similarity : ``"cosine"`` is S, the mean cosine between the segments at the best yaw; ``"planar"`` is |C|, the
        modulus of the complex correlation, which sees only the horizontal parts.
    largest_gib : GiB that the matrix may have.
    worth_threads : pairs of poses from which threads save more time than they cost.

    Returns
    -------
    (T, U) float32. S is -1 to 1, |C| is 0 to 1; equal poses have 1 but for rounding (some 1e-7).

    Raises
    ------
    InvalidMotionError : wrong shapes or missing values.
    OptionError : an unknown similarity, wrong weights, or a matrix that is too large.

    Source: Yamane and Shakunaga, section 2.2 and eq. 5. |C| is the paper's; it is blind to height, so that arms
    mirrored up and down score 1. The default is S = (|sum w h conj(h')| + sum w y y') / sum w, where h is the
    horizontal part as a complex number and y the vertical one: turning b by theta changes only
    Re(exp(-j theta) sum h conj(h')), whose maximum is the modulus.
    """
    pairs = Correlation.of(a, b, weights, similarity)
    if 4 * len(pairs.a) * pairs.b.shape[1] > largest_gib * 2**30:
        raise OptionError("correlation.too_large", rows=len(pairs.a), columns=pairs.b.shape[1])
    return pairs.compare(0, len(pairs.a), worth_threads=worth_threads)


@dataclass(frozen=True, slots=True, eq=False)
class Correlation:
    """Two motions packed to be compared: the rows of `compute_correlation_matrix` that are asked for."""

    a: Matrix  # (T, 27)
    b: Matrix  # (27, U)

    @classmethod
    def of(
        cls, a: ArrayLike, b: ArrayLike, weights: ArrayLike | None = None, similarity: str = "cosine"
    ) -> Correlation:
        """Pack two motions; parameters and errors as of `compute_correlation_matrix`."""
        first, second = check_sequence(a, "a"), check_sequence(b, "b")
        shares = check_segment_weights(weights)
        if similarity == "cosine":
            shares_of_a: FloatArray = shares / shares.sum()
            shares_of_b: FloatArray = np.ones_like(shares)
        elif similarity == "planar":
            shares_of_a, shares_of_b = shares * _planar_share(first, shares), _planar_share(second, shares)
            first, second = _flatten(first), _flatten(second)
        else:
            raise OptionError("correlation.similarity", similarity=similarity)
        return cls(pack(first, shares_of_a), np.ascontiguousarray(pack(second, shares_of_b).T))

    def compare(self, start: int, stop: int, *, worth_threads: int = 1_000_000, tile: int = 64) -> Matrix:
        """Rows start to stop of the matrix."""
        # worth_threads: pairs of poses; tile: rows that a thread takes at a time
        a, b = self.a[start:stop], self.b
        matrix = np.empty((len(a), b.shape[1]), np.float32)
        if matrix.size < worth_threads:
            correlate_rows(a, b, matrix, 0, len(a))
            return matrix
        from joblib import cpu_count

        with ThreadPoolExecutor(cpu_count()) as pool:
            jobs = [
                pool.submit(correlate_rows, a, b, matrix, first, min(first + tile, len(a)))
                for first in range(0, len(a), tile)
            ]
            for job in jobs:
                job.result()
        return matrix


def check_sequence(values: ArrayLike, what: str) -> FloatArray:
    """Check postures over time (T, 9, 3); ``what`` names the argument in the error.

    Raises
    ------
    InvalidMotionError : another shape, no numbers, or values that are missing.
    """
    segments = check_segments(values, what)
    if segments.ndim != 3:
        raise InvalidMotionError("postures.sequence_shape", what=what, shape=segments.shape)
    return segments


def check_segment_weights(weights: ArrayLike | None) -> FloatArray:
    """Check weights (9,) of the segments, the same for all frames; equal ones if None.

    Raises
    ------
    OptionError : another shape, or values that are negative, missing or all 0.
    """
    shares = check_weights(weights)
    if shares.shape != (len(SEGMENTS),):
        raise OptionError("postures.segment_weights_shape", shape=shares.shape)
    return shares


def compute_similarity(a: ArrayLike, b: ArrayLike, weights: ArrayLike | None = None) -> FloatArray:
    """Compute the similarity S of poses pair by pair: the mean cosine between the segments at the best yaw.

    Poses are (..., 9, 3) unit vectors, Y up, and broadcast; weights (9,) are 0 or above, None for equal ones. Returns
    (...) from -1 to 1. Raises InvalidMotionError for wrong shapes or missing values, OptionError for wrong weights.
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


def find_path(
    a: ArrayLike,
    b: ArrayLike,
    weights: ArrayLike | None = None,
    radius: int = 192,
    ends: str = "fixed",
    *,
    step: int = 4,
    left_out: float = 0.1,
    coarsest: int = 3000,
    largest_gib: float = 4.0,
) -> IndexArray:
    """Find the curve of best correspondence: dynamic time warping on 1 - S, coarse to fine.

    Every path is tried on a coarse level; each finer level searches a band around the path of the coarser one.

    Parameters
    ----------
    a : (T, 9, 3) unit vectors, Y up.
    b : (U, 9, 3) unit vectors, Y up.
    weights : (9,) of the segments, 0 or above; None for equal ones.
    radius : frames, of each level, by which the path may leave the coarser level's path in either motion; at least 1.
    ends : ``"fixed"``: from the first frames to the last frames of both. ``"open"``: frames of one motion may be
        left out before the path begins and after it ends, at a price of 0.1 each, so that poses less similar than
        S = 0.8 are rather left out than paired.
    step : ratio of the frames of neighbouring levels, about.
    left_out : price of a frame left out at an open end; two of them stand against one pair of poses.
    coarsest : frames of the longer motion up to which every path is tried.
    largest_gib : GiB that a band may have.

    Returns
    -------
    (K, 2) frames of a and of b, ascending; every step goes on by one frame in one or both.

    Raises
    ------
    InvalidMotionError : wrong shapes, missing values, or no frame.
    OptionError : wrong weights, a radius below 1, unknown ends, or a band that is too large.

    Memory is one byte a cell of the band, about 4 * radius * T: it grows linearly. Without any price, open ends would
    shrink the path to one pair of poses. The band misses the path of the full search where a whole passage goes
    elsewhere at almost the same price; lab/benchmarks/correspondence.py compares.
    """
    first, second = _check_frames(a, "a"), _check_frames(b, "b")
    shares = check_segment_weights(weights)
    if radius < 1:
        raise OptionError("correlation.radius", radius=radius)
    if ends not in {"fixed", "open"}:
        raise OptionError("correlation.ends", ends=ends)
    skip = 1e30 if ends == "fixed" else left_out
    size = -(-max(len(first), len(second)) // coarsest)
    band = None
    while True:
        level_a, level_b = _shrink(first, size), _shrink(second, size)
        path = _warp(level_a, level_b, shares / shares.sum(), band, skip, largest_gib)
        if size == 1:
            return path
        finer = max(1, size // step)
        counts = -(-len(first) // finer), -(-len(second) // finer)
        band = _band(path, size / finer, counts, radius)
        size = finer


def _check_frames(values: ArrayLike, what: str) -> FloatArray:
    segments = check_sequence(values, what)
    if len(segments) == 0:
        raise InvalidMotionError("postures.no_frame", what=what)
    return segments


def _shrink(segments: FloatArray, size: int) -> FloatArray:
    """Mean directions of blocks of so many frames; the last block may be shorter."""
    if size == 1:
        return segments
    sums: FloatArray = np.add.reduceat(segments, np.arange(0, len(segments), size), axis=0)
    lengths = np.linalg.norm(sums, axis=2, keepdims=True)
    np.divide(sums, lengths, out=sums, where=lengths > 0)
    return sums


def _band(path: IndexArray, ratio: float, counts: tuple[int, int], radius: int) -> tuple[IndexArray, IndexArray]:
    """First column, and column after the last, of each row of the finer level that is near the path."""
    last = np.array(counts) - 1
    rows, columns = np.minimum((path + 0.5) * ratio - 0.5, last).T
    reach = radius + int(np.ceil(2 * ratio))
    each = np.arange(counts[0])
    begin = np.minimum(np.searchsorted(rows, each - reach, "left"), len(rows) - 1)
    end = np.maximum(np.searchsorted(rows, each + reach, "right") - 1, 0)
    low = np.maximum(np.floor(columns[begin]).astype(np.intp) - reach, 0)
    high = np.minimum(np.ceil(columns[end]).astype(np.intp) + reach, last[1]) + 1
    return low, high


def _warp(
    a: FloatArray,
    b: FloatArray,
    shares: FloatArray,
    band: tuple[IndexArray, IndexArray] | None,
    skip: float,
    largest_gib: float,
) -> IndexArray:
    """The cheapest path of one level, inside the band."""
    if band is None:
        low, high = np.zeros(len(a), np.intp), np.full(len(a), len(b), np.intp)
    else:
        low, high = band
    n_cells = int((high - low).sum())
    if n_cells > largest_gib * 2**30:  # one byte each
        raise OptionError("correlation.band_too_large", gib=n_cells / 2**30)
    origin = np.empty(n_cells, np.uint8)
    first = np.cumsum(high - low) - (high - low)
    packed = np.ascontiguousarray(pack(b, np.ones_like(shares)).T)
    row, column = warp(pack(a, shares), packed, low, high, first, skip, origin)
    return trace_back(origin, low, first, row, column)
