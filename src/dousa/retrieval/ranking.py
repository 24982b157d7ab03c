"""Ranking of clips by their histograms (eq. 8)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dousa.errors import InvalidMotionError

__all__ = ["rank_by_histogram"]


def rank_by_histogram(
    query: ArrayLike, histograms: ArrayLike
) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """Clips from the most to the least similar, by the Euclidean distance of their histograms.

    Parameters
    ----------
    query : (C,) histogram of the query.
    histograms : (N, C) of the clips.

    Returns
    -------
    order : (N,) indices of the clips, nearest first; equals keep their order.
    distances : (N,) of the clips in the order given: ``distances[order]`` ascends. 0 to sqrt(2) for shares.

    Raises
    ------
    InvalidMotionError : shapes that disagree, or values that are not finite.

    Source: Hamada et al., eq. 8. The paper calls it a similarity and sorts descending; it is a distance.
    """
    asked = np.asarray(query, dtype=np.float64)
    stored = np.asarray(histograms, dtype=np.float64)
    if asked.ndim != 1 or stored.ndim != 2 or stored.shape[1] != len(asked):
        raise InvalidMotionError(
            f"expected a histogram (C,) and histograms (N, C), got shapes {asked.shape} and {stored.shape}"
        )
    differences = stored - asked
    distances = np.sqrt(np.einsum("nc,nc->n", differences, differences))
    if not np.isfinite(distances).all():
        raise InvalidMotionError("expected finite histograms, got NaN or infinity")
    return np.argsort(distances, kind="stable"), distances
