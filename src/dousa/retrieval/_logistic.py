"""Logistic curves over a few scores, fitted by the largest likelihood, and the area under the curve of a score."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["Curve", "compute_auroc", "fit_curve", "read_curve"]

FloatArray = NDArray[np.float64]

_RIDGE = 1e-3  # holds curves finite where the scores part both sides without a mistake
_STEPS = 50


@dataclass(frozen=True, slots=True)
class Curve:
    """A logistic curve that rises with every score.

    Parameters
    ----------
    intercept : the log odds where all scores are 0.
    slopes : of each score, 0 or more.
    """

    intercept: float
    slopes: tuple[float, ...]

    def evaluate(self, scores: FloatArray) -> FloatArray:
        """Probabilities (N,) of scores (N, K)."""
        return _logistic(self.intercept + scores @ np.asarray(self.slopes))


def compute_auroc(scores: FloatArray, positive: NDArray[np.bool_]) -> float:
    """How often a positive has a higher score than a negative, equal ones counting half; 0.5 without either."""
    n_positive = int(positive.sum())
    n_negative = len(positive) - n_positive
    if not n_positive or not n_negative:
        return 0.5
    ordered = np.sort(scores)
    ranks = 0.5 * (np.searchsorted(ordered, scores, "left") + np.searchsorted(ordered, scores, "right") + 1)
    return float((ranks[positive].sum() - n_positive * (n_positive + 1) / 2) / (n_positive * n_negative))


def fit_curve(scores: FloatArray, positive: NDArray[np.bool_], *, balanced: bool = True) -> Curve:
    """The most likely logistic curve without falling slopes, both sides counting the same if ``balanced``."""
    n_positive, n_negative = int(positive.sum()), int((~positive).sum())
    target = np.where(positive, (n_positive + 1) / (n_positive + 2), 1 / (n_negative + 2))
    weight = np.full(len(positive), 1.0 / max(len(positive), 1))
    if balanced and n_positive and n_negative:
        weight = np.where(positive, 0.5 / n_positive, 0.5 / n_negative)
    used = np.arange(scores.shape[1])
    while True:
        solution = _climb(scores[:, used], target, weight)
        if not len(used) or solution[1:].min() >= 0.0:
            break
        used = np.delete(used, solution[1:].argmin())
    slopes = np.zeros(scores.shape[1])
    slopes[used] = solution[1:]
    return Curve(float(solution[0]), tuple(float(slope) for slope in slopes))


def _climb(scores: FloatArray, target: FloatArray, weight: FloatArray) -> FloatArray:
    """Intercept and slopes of the largest likelihood, by Newton's method on a strictly concave function."""
    design = np.column_stack([np.ones(len(scores)), scores])
    ridge = np.diag([1e-9, *[_RIDGE] * scores.shape[1]])
    solution = np.zeros(design.shape[1])
    for _ in range(_STEPS):
        probability = _logistic(design @ solution)
        slope = design.T @ (weight * (target - probability)) - ridge @ solution
        bend = (design.T * (weight * np.maximum(probability * (1.0 - probability), 1e-6))) @ design + ridge
        step = np.linalg.solve(bend, slope)
        solution += step * min(1.0, 4.0 / max(np.abs(step).max(), 1e-12))
        if np.abs(step).max() < 1e-9:
            break
    return solution


def _logistic(odds: FloatArray) -> FloatArray:
    probability: FloatArray = 1.0 / (1.0 + np.exp(-np.clip(odds, -700.0, 700.0)))
    return probability


def read_curve(data: Mapping[str, Any], count: int) -> Curve:
    """A curve over so many scores from plain numbers; KeyError, TypeError or ValueError where it is none."""
    curve = Curve(float(data["intercept"]), tuple(float(slope) for slope in data["slopes"]))
    if (
        len(curve.slopes) != count
        or not np.isfinite([curve.intercept, *curve.slopes]).all()
        or min(curve.slopes) < 0
    ):
        raise ValueError(f"expected a rising curve over {count} scores")
    return curve
