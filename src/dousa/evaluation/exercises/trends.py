"""How a measure changes over the repetitions of an exercise, and whether chance alone would show as much."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

LEVEL = 0.05
"""Two-sided probability below which a trend is called distinguishable from none: the convention of R. A. Fisher,
"Statistical Methods for Research Workers", 1925."""


@dataclass(frozen=True, slots=True)
class Trend:
    """How one measure changes over the repetitions."""

    slope: float  # per repetition, in the unit of the measure; nan with fewer than two values
    p_value: float  # of Mann and Kendall's test against no trend, two-sided; nan with fewer than two values
    n: int  # number of values
    # the same probability where several measures were tested at once, see `adjust_for_many`
    adjusted_p: float = math.nan

    @property
    def distinguishable(self) -> bool:
        """Whether the trend is distinguishable from none; with four repetitions or fewer it never can."""
        return (self.p_value if math.isnan(self.adjusted_p) else self.adjusted_p) < LEVEL


def estimate_trend(values: ArrayLike) -> Trend:
    """Estimate the median of the slopes between all pairs, and the exact test of it.

    Parameters
    ----------
    values : (N,) of one measure, in order of the repetitions; nan is left out and keeps its place.

    Source: P. K. Sen, "Estimates of the regression coefficient based on Kendall's tau", J. American Statistical
    Association 63, 1379-1389, 1968; H. B. Mann, "Nonparametric tests against trend", Econometrica 13, 245-259, 1945.
    """
    array = np.asarray(values, np.float64)
    places = np.flatnonzero(np.isfinite(array))
    if len(places) < 2:
        return Trend(math.nan, math.nan, len(places))
    pairs = [(array[j] - array[i], j - i) for i, j in itertools.combinations(places.tolist(), 2)]
    slope = float(np.median([rise / run for rise, run in pairs]))
    score = int(sum(np.sign(rise) for rise, _ in pairs))
    return Trend(slope, _compute_p_value(score, array[places]), len(places))


def adjust_for_many(trends: Mapping[str, Trend]) -> dict[str, Trend]:
    """Adjust the probabilities of trends to the number of measures: one chance finding in twenty recordings.

    Source: S. Holm, "A simple sequentially rejective multiple test procedure", Scandinavian J. Statistics 6, 65-70,
    1979.
    """
    tested = sorted((name for name in trends if not math.isnan(trends[name].p_value)), key=lambda n: trends[n].p_value)
    adjusted, reached = dict(trends), 0.0
    for place, name in enumerate(tested):
        reached = max(reached, min(1.0, (len(tested) - place) * trends[name].p_value))
        adjusted[name] = dataclasses.replace(trends[name], adjusted_p=reached)
    return adjusted


def _compute_p_value(score: int, values: np.ndarray, *, exact_up_to: int = 40) -> float:
    # exact_up_to: values without ties; of more, and with ties, the normal approximation
    n = len(values)
    ties = np.unique(values, return_counts=True)[1]
    if n <= exact_up_to and ties.max() == 1:
        counts = _count_orders(n)
        total = math.factorial(n)
        most = n * (n - 1) // 2
        # A score of most - 2 d has d pairs out of order.
        tail = sum(counts[: (most - abs(score)) // 2 + 1])
        return min(1.0, 2.0 * tail / total)
    variance = (n * (n - 1) * (2 * n + 5) - float((ties * (ties - 1) * (2 * ties + 5)).sum())) / 18.0
    if variance <= 0:
        return 1.0
    return math.erfc(max(abs(score) - 1, 0) / math.sqrt(2.0 * variance))


@lru_cache
def _count_orders(n: int) -> tuple[int, ...]:
    """Number of orders of n values by how many pairs are out of order."""
    counts = [1]
    for size in range(2, n + 1):
        wider = [0] * (len(counts) + size - 1)
        for place, count in enumerate(counts):
            for more in range(size):
                wider[place + more] += count
        counts = wider
    return tuple(counts)
