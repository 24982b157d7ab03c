"""What the ranking experiment gives: scores with intervals, differences to DTW, times."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

from dousa.retrieval.ranking_metrics import Interval

__all__ = ["RankingFold", "RankingResult", "RankingSystemResult"]


@dataclass(frozen=True, slots=True)
class RankingFold:
    """One system's mean average precision on the queries of one performer."""

    name: str
    n_gallery: int
    n_queries: int
    mean_average_precision: float


@dataclass(frozen=True, slots=True)
class RankingSystemResult:
    """What one way of ranking reached.

    Parameters
    ----------
    scores : mean over the queries and its interval, by the names of ``RANKING_SCORES``.
    scores_by_performer : the same with whole performers drawn instead of queries; empty where performers are unknown.
    beyond_dtw : mean average precision less that of DTW on the same queries; None where DTW was not asked for.
    query_milliseconds : median time of a query, its description (features, poses) being computed already.
    times_faster_than_dtw : ratio of the median times.
    folds : per performer, if performers were left out.
    """

    scores: dict[str, Interval]
    scores_by_performer: dict[str, Interval]
    beyond_dtw: Interval | None
    query_milliseconds: float
    times_faster_than_dtw: float | None
    folds: tuple[RankingFold, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """The means by name, their intervals, then everything else."""
        answer: dict[str, Any] = {name: interval.mean for name, interval in self.scores.items()}
        for suffix, intervals in (("", self.scores), ("_by_performer", self.scores_by_performer)):
            answer |= {f"{name}_interval{suffix}": [one.low, one.high] for name, one in intervals.items()}
        if self.beyond_dtw is not None:
            answer["map_beyond_dtw"] = self.beyond_dtw.mean
            answer["map_beyond_dtw_interval"] = [self.beyond_dtw.low, self.beyond_dtw.high]
        return answer | {
            "query_milliseconds": self.query_milliseconds,
            "times_faster_than_dtw": self.times_faster_than_dtw,
            "folds": [asdict(fold) for fold in self.folds],
        }


@dataclass(frozen=True, slots=True)
class RankingResult:
    """What all rankings reached on the same queries.

    Parameters
    ----------
    systems : results by name, in the order they were asked for.
    n_queries : queries that were scored.
    n_gallery : clips that were put in order for a query, mean over the queries, rounded.
    categories : all categories, sorted.
    split : ``"half"``, ``"leave-performer-out"`` or ``"given"``.
    feature_set : what the forest looked at.
    n_trees, random_state, n_resamples : as they were asked for.
    without_relevant : queries left out, as no clip of their category was there to be found, by category.
    n_short : queries with fewer than 10 relevant clips, whose precision at 10 cannot reach 1.
    best_p_at_10 : what a perfect ranking would reach.
    describe_milliseconds : time to describe a clip, by what is described: ``"forest"``, ``"poses"`` (Euclidean, DTW),
        ``"motion_templates"``.
    fit_seconds : to train the forests and the templates, all folds together.
    """

    systems: dict[str, RankingSystemResult]
    n_queries: int
    n_gallery: int
    categories: tuple[str, ...]
    split: str
    feature_set: str
    n_trees: int
    random_state: int
    n_resamples: int
    without_relevant: dict[str, int] = field(default_factory=dict)
    n_short: int = 0
    best_p_at_10: float = 1.0
    describe_milliseconds: dict[str, float] = field(default_factory=dict)
    fit_seconds: dict[str, float] = field(default_factory=dict)

    def to_json(self) -> dict[str, Any]:
        """Plain dictionaries, lists, numbers and strings, ready for ``json.dumps``."""
        return {
            "systems": {name: system.to_json() for name, system in self.systems.items()},
            "n_queries": self.n_queries,
            "n_gallery": self.n_gallery,
            "categories": list(self.categories),
            "split": self.split,
            "features": self.feature_set,
            "n_trees": self.n_trees,
            "random_state": self.random_state,
            "n_resamples": self.n_resamples,
            "without_relevant": dict(self.without_relevant),
            "n_short": self.n_short,
            "best_p_at_10": self.best_p_at_10,
            "describe_milliseconds": dict(self.describe_milliseconds),
            "fit_seconds": dict(self.fit_seconds),
        }
