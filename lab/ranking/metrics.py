"""Scores of clips put in order.

- A clip is relevant or not. A query without a relevant clip has no score (NaN): it says nothing of a ranking.
- Precision at k is the number of relevant clips among the first k, divided by k, even where fewer than k are relevant
  or there at all; so the best possible value may be below 1. R-precision, the precision at the number of relevant
  clips, can always reach 1.
- Average precision is the mean, over the relevant clips, of the precision at their places.
- nDCG at k has gains of 1, the discount 1 / log2(place + 1), and is divided by the best possible.

These are scikit-learn's ``average_precision_score`` and ``ndcg_score(k=10)`` where no two clips have equal scores.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from dousa.arrays import FloatArray
from dousa.errors import OptionError

RANKING_SCORES: tuple[str, ...] = ("p_at_1", "p_at_10", "map", "ndcg_at_10", "r_precision")
"""Names of the scores, in the order of ``RankingScores.as_row``."""

_DEPTH = 10
_DRAWN_AT_ONCE = 1_000_000  # numbers of queries, which bounds the memory


@dataclass(frozen=True, slots=True)
class RankingScores:
    """Scores of one query, 0 to 1; NaN where no clip is relevant."""

    p_at_1: float
    p_at_10: float
    average_precision: float
    ndcg_at_10: float
    r_precision: float

    def as_row(self) -> tuple[float, ...]:
        """The scores in the order of ``RANKING_SCORES``."""
        return (self.p_at_1, self.p_at_10, self.average_precision, self.ndcg_at_10, self.r_precision)


@dataclass(frozen=True, slots=True)
class Interval:
    """A mean and its interval; all NaN without values.

    Parameters
    ----------
    mean : of the values.
    low, high : ends of the interval.
    """

    mean: float
    low: float
    high: float


def score_ranking(relevant: ArrayLike) -> RankingScores:
    """Score the order in which one query's clips came.

    Parameters
    ----------
    relevant : (N,) whether each clip is relevant, the first clip of the ranking first.

    Raises
    ------
    OptionError : another shape.
    """
    hits = np.asarray(relevant, dtype=bool)
    if hits.ndim != 1:
        raise OptionError("trials.hits", shape=hits.shape)
    places = np.flatnonzero(hits)
    count = len(places)
    if not count:
        return RankingScores(*[float("nan")] * 5)
    precisions = np.arange(1, count + 1) / (places + 1)
    discounts = 1.0 / np.log2(np.arange(_DEPTH) + 2.0)
    return RankingScores(
        p_at_1=float(hits[0]),
        p_at_10=float(hits[:_DEPTH].sum() / _DEPTH),
        average_precision=float(precisions.mean()),
        ndcg_at_10=float(discounts[places[places < _DEPTH]].sum() / discounts[:count].sum()),
        r_precision=float(hits[:count].sum() / count),
    )


def bootstrap_interval(
    values: ArrayLike,
    *,
    groups: ArrayLike | None = None,
    n_resamples: int = 2000,
    confidence: float = 0.95,
    random_state: int = 0,
) -> Interval:
    """The mean of some values and its percentile bootstrap interval.

    Parameters
    ----------
    values : (Q,) finite, one per query.
    groups : (Q,) the performer of each query, say: whole groups are drawn instead of queries, as the queries of one
        performer resemble each other. With few groups such an interval is rough.
    n_resamples : how often values are drawn with replacement, 1 or more.
    confidence : share of the resampled means inside the interval, between 0 and 1.
    random_state : seed; the same seed draws the same queries, so that systems are compared on the same draws.

    Returns
    -------
    Interval; with one value, or one group, its ends are the mean.

    Raises
    ------
    OptionError : a number outside its range, or other shapes.

    Source: Efron and Tibshirani, "An introduction to the bootstrap", 1993, chapter 13.
    """
    data = np.asarray(values, dtype=np.float64)
    names = np.arange(len(data)) if groups is None else np.asarray(groups)
    if data.ndim != 1 or names.shape != data.shape:
        raise OptionError("trials.groups", values=data.shape, groups=names.shape)
    if n_resamples < 1 or not 0 < confidence < 1:
        raise OptionError("trials.confidence", resamples=n_resamples, confidence=confidence)
    if not len(data):
        return Interval(float("nan"), float("nan"), float("nan"))
    _, number = np.unique(names, return_inverse=True)
    sums, sizes = np.bincount(number, weights=data), np.bincount(number)
    generator = np.random.default_rng(random_state)
    means: list[FloatArray] = []
    portion = max(1, _DRAWN_AT_ONCE // len(sums))
    for first in range(0, n_resamples, portion):
        drawn = generator.integers(len(sums), size=(min(portion, n_resamples - first), len(sums)))
        means.append(sums[drawn].sum(axis=1) / sizes[drawn].sum(axis=1))
    outside = 50.0 * (1.0 - confidence)
    low, high = np.percentile(np.concatenate(means), [outside, 100.0 - outside])
    return Interval(float(data.mean()), float(low), float(high))
