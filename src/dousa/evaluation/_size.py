"""Range of motion and what is missing of it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dousa.motion._types import FloatArray

__all__ = ["measure_missing_range", "measure_ranges"]

_MOST_FRAMES = 90
_MODEL_SHARE = 0.25


def measure_ranges(segments: FloatArray) -> FloatArray:
    """(S,) rad, the largest angle between any two directions of each segment of (T, S, 3)."""
    thinned = segments[:: max(1, -(-len(segments) // _MOST_FRAMES))].transpose(1, 0, 2)
    cosines = (thinned @ thinned.transpose(0, 2, 1)).reshape(len(thinned), -1).min(axis=1)
    ranges: FloatArray = np.arccos(np.clip(cosines, -1.0, 1.0))
    return ranges


def measure_missing_range(
    reference: FloatArray, performance: FloatArray, model: FloatArray, segments: NDArray[np.intp]
) -> tuple[float, float]:
    """How much range the most affected segment lacks.

    Parameters
    ----------
    reference, performance, model : (T, 9, 3) unit vectors of the same moments; the model is the performance as its
        explanation has it, without the performer's unsteadiness.
    segments : indices of those that may be affected.

    Returns
    -------
    missing : rad.
    share : of the reference's range.
    """
    whole = measure_ranges(reference[:, segments])
    # Seen and explained err to different sides: unsteadiness widens the one, a blunt model narrows the other.
    seen, explained = measure_ranges(performance[:, segments]), measure_ranges(model[:, segments])
    missing = whole - (1.0 - _MODEL_SHARE) * seen - _MODEL_SHARE * explained
    worst = int(np.argmax(missing))
    amount = float(max(missing[worst], 0.0))
    return amount, amount / max(float(whole[worst]), 1e-6)
