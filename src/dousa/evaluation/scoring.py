"""The grade: 100 is the mean of the reference takes, and 10 go for every standard deviation between them.

The measure behind it is one angle: how far, on average, the segments are from where the reference has them at that
moment.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from dousa.errors import InvalidMotionError
from dousa.evaluation.posture import SEGMENTS, check_weights
from dousa.evaluation.words import check_language

__all__ = ["UNCALIBRATED_SPREAD", "compute_deviation", "compute_score"]

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
        raise InvalidMotionError(f"residual: expected shape (frames, 9), got {angles.shape}")
    shares = np.where(np.isnan(angles), 0.0, check_weights(weights))
    total = shares.sum(axis=1)
    compared = total > 0
    if not compared.any():
        return float("nan")
    squares = (np.nan_to_num(angles) ** 2 * shares).sum(axis=1)[compared] / total[compared]
    return float(np.degrees(np.sqrt(squares).mean()))


def compute_score(
    deviation: float, reference_deviations: Sequence[float], language: str = "en"
) -> tuple[float, str, bool]:
    """The grade of a performance, or of its part of a furi.

    Parameters
    ----------
    deviation : deg, of the performance from the first reference take; nan if nothing could be compared.
    reference_deviations : deg, of every other reference take from the first; nan are left out.
    language : ``"en"`` or ``"ja"``.

    Returns
    -------
    score : 0 to 100.
    formula : how it came about, in words and numbers.
        The standard deviation of a handful of takes is uncertain: `UNCALIBRATED_SPREAD` counts as one take more.
    calibrated : False where there are fewer than two other takes: then 100 is no deviation at all, and the
        standard deviation is `UNCALIBRATED_SPREAD`.

    Raises
    ------
    OptionError : a language that there is not.
    """
    check_language(language)
    takes = np.array([value for value in reference_deviations if np.isfinite(value)])
    calibrated = len(takes) >= _FEWEST
    mean, spread = 0.0, UNCALIBRATED_SPREAD
    if calibrated:
        mean = float(takes.mean())
        # A handful of takes tell their spread badly: the usual one counts as one take more.
        squares = float(((takes - mean) ** 2).sum()) + UNCALIBRATED_SPREAD**2
        spread = float(np.sqrt(squares / len(takes)))
    if not np.isfinite(deviation):
        return 0.0, _NOTHING[language], calibrated
    # Rounded, so that rounding errors in angles do not keep the same motion from 100.
    score = round(float(np.clip(100.0 - _POINTS * (deviation - mean) / spread, 0.0, 100.0)), 4)
    return score, _describe(score, deviation, mean, spread, len(takes), calibrated, language), calibrated


_NOTHING = {
    "en": "0: no moment of the performance could be compared with the reference",
    "ja": "0点:手本と比べられる場面がありません",
}

# {sum} is the calculation, {own}, {mean} and {spread} are deg, {takes} is the number of other takes.
_CALIBRATED = {
    "en": "{sum}. The performance is {own} deg from the reference on average; {takes} other takes of the reference "
    "are {mean} deg from it (standard deviation {spread} deg, {points} points each)",
    "ja": "{sum}。演技と手本の差は平均{own}度、手本のほかの{takes}テイクの差は平均{mean}度"
    "(標準偏差{spread}度、1標準偏差につき{points}点減点)",
}
_UNCALIBRATED = {
    "en": "{sum}. The performance is {own} deg from the reference on average; not calibrated: with fewer than three "
    "takes of the reference, {spread} deg stand for the standard deviation between clean takes ({points} points "
    "each)",
    "ja": "{sum}。演技と手本の差は平均{own}度。未校正：手本が3テイクに満たないため、"
    "標準偏差を{spread}度とみなしています(1標準偏差につき{points}点減点)",
}


def _describe(
    score: float, own: float, mean: float, spread: float, takes: int, calibrated: bool, language: str
) -> str:
    sign = "×" if language == "ja" else "x"
    apart = f"({own:.1f} - {mean:.1f})" if calibrated else f"{own:.1f}"
    # The grade lies between 0 and 100, whatever the sum.
    bound = {"en": ", held within 0 to 100", "ja": "(0~100点に制限)"}[language]
    raw = 100.0 - _POINTS * (own - mean) / spread
    result = f"100 - {_POINTS:.0f} {sign} {apart} / {spread:.1f} = {raw:.1f}"
    if not 0.0 <= raw <= 100.0:
        result += f"{bound}: {score:.0f}" if language == "en" else f"{bound}→{score:.0f}点"
    text = (_CALIBRATED if calibrated else _UNCALIBRATED)[language]
    return text.format(
        sum=result,
        own=f"{own:.1f}",
        mean=f"{mean:.1f}",
        spread=f"{spread:.1f}",
        takes=takes,
        points=f"{_POINTS:.0f}",
    )
