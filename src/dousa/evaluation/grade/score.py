"""The grade: 100 is the mean of the reference takes, and 10 go for every standard deviation between them.

The measure behind it is one angle: how far, on average, the segments are from where the reference has them at that
moment.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from dousa.errors import InvalidMotionError
from dousa.evaluation.posture.posture import SEGMENTS, check_weights
from dousa.messages import Message

UNCALIBRATED_SPREAD = 4.0
"""deg, standard deviation where the takes are too few to tell. Measured at the same time, tempo kept: how far the
clean takes of one person are from the first of them has a pooled standard deviation of 4.0 deg (and a median of
10.5 deg) in 450 pairs of 87 classes and styles of Bandai-Namco and HDM05, none of them held out."""

_POINTS = 10.0  # for a standard deviation
_FEWEST = 2  # takes beside the first that have a spread


def compute_deviation(residual: ArrayLike, weights: ArrayLike | None = None) -> float:
    """Mean angle between a performance and its reference.

    Parameters
    ----------
    residual : (T, 9) rad, angle of each segment to the reference's at the same time; nan is left out.
    weights : (9,) of the segments, 0 or above; None for equal ones.

    Returns
    -------
    deg, the mean over time of the weighted root mean square over the segments; nan where nothing is compared.

    Raises
    ------
    InvalidMotionError : another shape.
    OptionError : wrong weights.
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


def compute_score(deviation: float, reference_deviations: Sequence[float]) -> tuple[float, Message, bool]:
    """The grade of a performance, or of its part of a furi.

    Parameters
    ----------
    deviation : deg, of the performance from the first reference take; nan if nothing could be compared.
    reference_deviations : deg, of every other reference take from the first; nan are left out.

    Returns
    -------
    score : 0 to 100.
    formula : how it came about, with its numbers.
        The standard deviation of a handful of takes is uncertain: `UNCALIBRATED_SPREAD` counts as one take more.
    calibrated : False where there are fewer than two other takes: then 100 is no deviation at all, and the
        standard deviation is `UNCALIBRATED_SPREAD`.
    """
    takes = np.array([value for value in reference_deviations if np.isfinite(value)])
    calibrated = len(takes) >= _FEWEST
    mean, spread = 0.0, UNCALIBRATED_SPREAD
    if calibrated:
        mean = float(takes.mean())
        # A handful of takes shows its spread badly: the usual one counts as one take more.
        squares = float(((takes - mean) ** 2).sum()) + UNCALIBRATED_SPREAD**2
        spread = float(np.sqrt(squares / len(takes)))
    if not np.isfinite(deviation):
        return 0.0, Message("grade.nothing"), calibrated
    # Rounded, so that rounding errors in angles do not keep the same motion from 100.
    score = round(float(np.clip(100.0 - _POINTS * (deviation - mean) / spread, 0.0, 100.0)), 4)
    values = {"points": _POINTS, "own": float(deviation), "spread": spread}
    raw = 100.0 - _POINTS * (deviation - mean) / spread
    if calibrated:
        total = Message("grade.from_mean", **values, mean=mean, raw=raw)
    else:
        total = Message("grade.from_none", **values, raw=raw)
    # The grade lies between 0 and 100, whatever the sum.
    if not 0.0 <= raw <= 100.0:
        total = Message("grade.bounded", sum=total, score=score)
    if calibrated:
        formula = Message("grade.calibrated", **values, sum=total, mean=mean, takes=len(takes))
    else:
        formula = Message("grade.uncalibrated", **values, sum=total)
    return score, formula, calibrated
