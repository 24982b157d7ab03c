"""The mean angle between a performance and its reference."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from dousa.errors import InvalidMotionError
from dousa.evaluation.posture.posture import SEGMENTS, check_weights


def compute_deviation(residual: ArrayLike, weights: ArrayLike | None = None) -> float:
    """Compute the mean angle between a performance and its reference in deg.

    The residual is (T, 9) rad, nan left out; weights (9,) are 0 or above, None for equal ones. Returns the mean over
    time of the weighted root mean square over the segments; nan where nothing is compared. Raises InvalidMotionError
    for another shape, OptionError for wrong weights.
    """
    angles = np.asarray(residual, np.float64)
    if angles.ndim != 2 or angles.shape[1] != len(SEGMENTS):
        raise InvalidMotionError("evaluation.residual", shape=angles.shape)
    shares = np.where(np.isnan(angles), 0.0, check_weights(weights))
    total = shares.sum(axis=1)
    compared = total > 0
    if not compared.any():
        return float("nan")
    squares = (np.nan_to_num(angles) ** 2 * shares).sum(axis=1)[compared] / total[compared]
    return float(np.degrees(np.sqrt(squares).mean()))
