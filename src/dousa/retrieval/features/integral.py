"""Integral features: the mean of a pose feature over any interval for one subtraction (eq. 3-5).

Interval ``[t0, t1]`` stands for the frames ``t0 + 1 ... t1`` counted from 1, that is ``t0 ... t1 - 1``
counted from 0: with T frames there are ``T (T + 1) / 2`` of them.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from dousa.arrays import FloatArray, IndexArray, IntArray
from dousa.errors import InvalidMotionError, OptionError

MEAN, SPREAD, TREND = 0, 1, 2
"""Kinds of tests: the mean of a column over an interval, its standard deviation, its change along the fitted line."""


def integrate(features: ArrayLike) -> FloatArray:
    """Running sums of pose features, from which every mean over an interval is one subtraction.

    Parameters
    ----------
    features : (N, T, F) pose features of N clips, thinned to T frames.

    Returns
    -------
    (N, F, T + 1) with ``g[..., 0] = 0`` and ``g[..., t] = g[..., t - 1] + p[..., t]``.

    Raises
    ------
    InvalidMotionError : not three axes, or an axis of length 0 other than the first.

    Source: Hamada et al., eq. 4.
    """
    pose = np.asarray(features, dtype=np.float64)
    if pose.ndim != 3 or 0 in pose.shape[1:]:
        raise InvalidMotionError("features.shape", shape=pose.shape)
    clips, frames, count = pose.shape
    integrals = np.zeros((clips, count, frames + 1))
    np.cumsum(pose.transpose(0, 2, 1), axis=2, out=integrals[:, :, 1:])
    return integrals


def compute_interval_means(integrals: ArrayLike, start: int, stop: int) -> FloatArray:
    """Mean pose features over the frames ``start ... stop - 1``, counted from 0.

    Parameters
    ----------
    integrals : (..., T + 1) of ``integrate``.
    start, stop : t0 and t1 of the paper, 0 <= start < stop <= T.

    Returns
    -------
    (...,) in the unit of the features.

    Raises
    ------
    OptionError : an interval outside the clip.

    Source: Hamada et al., eq. 3 and 5.
    """
    g = np.asarray(integrals, dtype=np.float64)
    if not 0 <= start < stop < g.shape[-1]:
        raise OptionError("features.interval", last=g.shape[-1] - 1, start=start, stop=stop)
    return (g[..., stop] - g[..., start]) / (stop - start)


def list_tests(n_features: int, n_frames: int) -> IntArray:
    """Every mean that a tree may ask for: the set R of the paper.

    Parameters
    ----------
    n_features, n_frames : F and T, at least 1.

    Returns
    -------
    (F T (T + 1) / 2, 5) rows (kind, i, i, t0, t1) with the kind 0, a mean; 3,080 for 56 features and 10 frames. Longer
    intervals come first, then earlier ones: of tests that part the clips equally well a tree without randomness takes
    the first, and the mean over a longer time says more about the motion and less about the moment.
    """
    columns = np.arange(n_features)
    return list_interval_tests([(0, columns, columns)], n_frames)


def list_interval_tests(kinds: Sequence[tuple[int, IndexArray, IndexArray]], n_frames: int) -> IntArray:
    """Tests of several kinds over every interval, in the order of ``list_tests``.

    Parameters
    ----------
    kinds : for each kind its number, the columns that it may ask for, and the partner of each column.
    n_frames : T.

    Returns
    -------
    (R, 5) rows (kind, column, partner, t0, t1).
    """
    starts, stops = np.triu_indices(n_frames + 1, k=1)
    order = np.lexsort((starts, starts - stops))
    asked = np.concatenate(
        [np.stack([np.full(len(columns), kind), columns, partners], axis=1) for kind, columns, partners in kinds]
    )
    tests = np.empty((len(starts), len(asked), 5), np.int64)
    tests[:, :, :3] = asked
    tests[:, :, 3] = starts[order, None]
    tests[:, :, 4] = stops[order, None]
    return tests.reshape(-1, 5)
