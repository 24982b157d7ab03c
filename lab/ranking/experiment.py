"""The ranking experiment: are the clips that come first of the same category as the query?

A query is a clip that the gallery does not hold; with performers left out, its performer is nowhere in the gallery. The
clips of the gallery are put in order for every query; a clip is relevant if it is of the query's category. Forests and
templates learn from the gallery and its labels; Euclidean distance and DTW need no labels. Nothing is published for
retrieving whole clips by a clip on the sets used here, so the protocol is written down in docs/ranking.md.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dousa.errors import TrainingError
from dousa.experiments.runner import (
    Split,
    Steps,
    check_at_least,
    check_categories,
    check_some,
    choose_split,
    make_folds,
)
from dousa.experiments.table import Cell, Result, ResultTable, show
from dousa.messages import Message, Progress
from dousa.retrieval.features.feature_sets import DEFAULT_FEATURE_SET, get_feature_set
from dousa.retrieval.features.posed_motion import LabelledClip
from lab.ranking.metrics import RANKING_SCORES, Interval, bootstrap_interval, score_ranking
from lab.ranking.systems import (
    RANKING_SYSTEMS,
    Ranker,
    RankingMaterial,
    RankingSettings,
    describe_clips,
    make_rankers,
)

_MAP = RANKING_SCORES.index("map")
_P_AT_10 = 10

_SYSTEM_WORDS = {
    "fused": Message("trial_words.fused"),
    "histogram": Message("trial_words.histogram"),
    "leaves": Message("trial_words.leaves"),
    "pose": Message("trial_words.pose"),
    "euclidean": Message("trial_words.euclidean"),
    "dtw": Message("trial_words.dtw"),
    "motion_templates": Message("trial_words.motion_templates"),
}

_DESCRIBED = {
    "forest": Message("trial_ranking.describe_forest"),
    "poses": Message("trial_ranking.describe_poses"),
    "motion_templates": Message("trial_ranking.describe_templates"),
}

_SHOWN = {"p_at_1": "P@1", "p_at_10": "P@10", "map": "MAP", "ndcg_at_10": "nDCG@10"}


@dataclass(frozen=True, slots=True)
class RankingFold:
    """One system's mean average precision on the queries of one performer."""

    name: str
    n_gallery: int
    n_queries: int
    mean_average_precision: float


@dataclass(frozen=True, slots=True)
class RankingSystemResult(Result):
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
        rest = Result.to_json(self)
        return answer | {key: rest[key] for key in ("query_milliseconds", "times_faster_than_dtw", "folds")}


@dataclass(frozen=True, slots=True)
class RankingResult(Result):
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
        """The fields by name, the feature set as ``features``."""
        answer = Result.to_json(self)
        return {"features": answer.pop("feature_set"), **answer}

    def to_tables(self) -> tuple[ResultTable, ...]:
        """A row a ranking; below it how to read the table, and what is compared besides."""
        heads: tuple[Cell, ...] = (
            *_SHOWN.values(),
            Message("trial_words.query_ms"),
            Message("trial_ranking.times_faster"),
        )
        return (
            ResultTable(
                (Message("trial_ranking.ranking"), *heads),
                tuple(_make_row(name, system) for name, system in self.systems.items()),
                title=Message(
                    "trial_ranking.title",
                    categories=len(self.categories),
                    queries=self.n_queries,
                    gallery=self.n_gallery,
                    split=self.split,
                    features=self.feature_set,
                    trees=self.n_trees,
                ),
                notes=tuple(self._explain()),
                bold=frozenset(row for row, name in enumerate(self.systems) if name == "fused"),
            ),
        )

    def _explain(self) -> Iterable[Message]:
        """Lines below the table."""
        yield Message("trial_ranking.how", resamples=self.n_resamples)
        times = tuple(
            Message("trial_ranking.milliseconds", what=_DESCRIBED[kind], time=time)
            for kind, time in self.describe_milliseconds.items()
        )
        yield Message("trial_ranking.describing", times=times)
        beyond = {k: one.beyond_dtw for k, one in self.systems.items() if one.beyond_dtw is not None}
        if beyond:
            yield Message("trial_ranking.beyond_dtw", found=_list_intervals(beyond, sign="+"))
        precisions = {k: one.scores["r_precision"] for k, one in self.systems.items()}
        yield Message("trial_ranking.r_precision", found=_list_intervals(precisions))
        grouped = {k: one.scores_by_performer["map"] for k, one in self.systems.items() if one.scores_by_performer}
        if grouped:
            ends = tuple(f"{k} [{show(one.low)}, {show(one.high)}]" for k, one in grouped.items())
            yield Message("trial_ranking.by_performer", found=ends)
        if self.n_short:
            yield Message("trial_ranking.short", queries=self.n_short, best=self.best_p_at_10)
        for category, count in self.without_relevant.items():
            yield Message("trial_ranking.without_relevant", name=category, n=count)


def _make_row(name: str, result: RankingSystemResult) -> tuple[Message | str, ...]:
    cells = [_show_interval(result.scores[score]) for score in _SHOWN]
    faster = result.times_faster_than_dtw
    return (
        _SYSTEM_WORDS[name],
        *cells,
        show(result.query_milliseconds),
        "-" if faster is None else f"{faster:.3g}",
    )


def _show_interval(one: Interval, sign: str = "") -> str:
    return f"{show(one.mean, sign=sign)} [{show(one.low, sign=sign)}, {show(one.high, sign=sign)}]"


def _list_intervals(intervals: dict[str, Interval], sign: str = "") -> tuple[str, ...]:
    return tuple(f"{name} {_show_interval(one, sign)}" for name, one in intervals.items())


def run_ranking_experiment(
    clips: Sequence[LabelledClip],
    *,
    test_clips: Sequence[LabelledClip] | None = None,
    split: str | None = None,
    random_state: int = 0,
    systems: Sequence[str] = RANKING_SYSTEMS,
    n_trees: int = 100,
    feature_set: str = DEFAULT_FEATURE_SET,
    n_resamples: int = 2000,
    n_jobs: int | None = None,
    progress: Progress | None = None,
) -> RankingResult:
    """Rank the same galleries for the same queries by all systems.

    Parameters
    ----------
    clips : all clips, or the gallery if ``test_clips`` is given.
    test_clips : the queries; nothing is split then.
    split : ``"half"`` (default: half of every category is the gallery) or ``"leave-performer-out"`` (the clips of one
        performer are the queries, those of the others the gallery; once for each).
    random_state : seed of the half, of the forests, of the order of equals and of the resampling.
    systems : which, of ``RANKING_SYSTEMS``.
    n_trees : trees of the forest.
    feature_set : what the forest looks at, ``"paper"`` or ``"extended"``.
    n_resamples : how often queries are drawn for the intervals, which hold 95 % of the means.
    n_jobs : threads that train; None for one. Queries run one after the other in one thread, as they are timed.
    progress : called with the number of queries ranked, their total, and what comes next.

    Returns
    -------
    RankingResult

    Raises
    ------
    TrainingError : no clips, a clip without category, a gallery of one category, an unknown performer where performers
        are left out, or no query with anything to find.
    OptionError : an unknown split, system or feature set, or a number outside its range.
    """
    split = choose_split(split, test_clips is not None)
    check_some("rankings", systems, RANKING_SYSTEMS)
    check_at_least(seed=(random_state, 0), resamples=(n_resamples, 1))
    everything = [*clips, *(test_clips or ())]
    check_categories(everything)
    folds = make_folds(everything, len(clips), split, [random_state, 0])
    settings = RankingSettings(get_feature_set(feature_set), n_trees, n_jobs)
    material = describe_clips(everything, systems, settings.feature_set, progress)
    queries, without = _choose_queries(material, folds)
    runs = _run_folds(systems, material, folds, queries, settings, random_state, progress)
    performers = [clip.performer for clip in everything]
    return RankingResult(
        systems=_summarise(systems, runs, performers, n_resamples, random_state, split),
        n_queries=sum(len(run.queries) for run in runs),
        n_gallery=round(float(np.average([r.n_gallery for r in runs], weights=[len(r.queries) for r in runs]))),
        categories=tuple(sorted(set(material.categories))),
        split=split,
        feature_set=feature_set,
        n_trees=n_trees,
        random_state=random_state,
        n_resamples=n_resamples,
        without_relevant=without,
        n_short=sum(int((run.n_relevant < _P_AT_10).sum()) for run in runs),
        best_p_at_10=float(np.concatenate([np.minimum(r.n_relevant, _P_AT_10) for r in runs]).mean() / _P_AT_10),
        describe_milliseconds=material.milliseconds,
        fit_seconds={k: sum(run.fit_seconds[k] for run in runs) for k in runs[0].fit_seconds},
    )


@dataclass(frozen=True, slots=True)
class _Run:
    """One fold: scores (Q, 5) and seconds (Q,) of each system."""

    name: str
    n_gallery: int
    queries: NDArray[np.intp]
    n_relevant: NDArray[np.intp]
    scores: dict[str, NDArray[np.float64]]
    seconds: dict[str, NDArray[np.float64]]
    fit_seconds: dict[str, float]


def _choose_queries(material: RankingMaterial, folds: Sequence[Split]) -> tuple[list[NDArray[np.intp]], dict[str, int]]:
    """The queries of each fold that have something to find, and how many have not, by category."""
    chosen, without = [], Counter[str]()
    for fold in folds:
        wanted = np.isin(material.categories[fold.test], material.categories[fold.train])
        chosen.append(fold.test[wanted])
        without.update(material.categories[fold.test[~wanted]])
    if not sum(map(len, chosen)):
        raise TrainingError("trials.no_gallery")
    return chosen, dict(sorted(without.items()))


def _measure(
    rank: Ranker, queries: NDArray[np.intp], relevant: NDArray[np.bool_], steps: Steps, doing: Message
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Scores (Q, 5) and seconds (Q,) of queries whose relevant clips of the gallery are known, (Q, N)."""
    rank(int(queries[0]))  # compiles, and touches the memory
    scores, seconds = np.empty((len(queries), len(RANKING_SCORES))), np.empty(len(queries))
    for row, query in enumerate(queries):
        steps.say(doing)
        started = time.perf_counter()
        order = rank(int(query))
        seconds[row] = time.perf_counter() - started
        scores[row] = score_ranking(relevant[row, order]).as_row()
        steps.done += 1
    return scores, seconds


def _run_folds(
    systems: Sequence[str],
    material: RankingMaterial,
    folds: Sequence[Split],
    queries: Sequence[NDArray[np.intp]],
    settings: RankingSettings,
    random_state: int,
    progress: Progress | None,
) -> list[_Run]:
    steps = Steps(progress, len(systems) * sum(map(len, queries)))
    runs = []
    for number, (fold, asked) in enumerate(zip(folds, queries, strict=True)):
        if not len(asked):
            continue
        steps.say(Message("trial_progress.training", fold=fold.name))
        generator = np.random.default_rng([random_state, 1, number])
        gallery = generator.permutation(fold.train)  # so that equals come in an order drawn at random
        seed = int(generator.integers(2**31 - 1))
        rankers, fit_seconds = make_rankers(systems, material, gallery, settings, seed)
        relevant = material.categories[asked][:, None] == material.categories[gallery][None]
        measured = {
            system: _measure(
                rank, asked, relevant, steps, Message("trial_progress.fold", system=system, fold=fold.name)
            )
            for system, rank in rankers.items()
        }
        scores = {system: one for system, (one, _) in measured.items()}
        seconds = {system: two for system, (_, two) in measured.items()}
        runs.append(_Run(fold.name, len(gallery), asked, relevant.sum(axis=1), scores, seconds, fit_seconds))
    steps.finish()
    return runs


def _summarise(
    systems: Sequence[str],
    runs: Sequence[_Run],
    performers: Sequence[str | None],
    n_resamples: int,
    random_state: int,
    split: str,
) -> dict[str, RankingSystemResult]:
    """Means, intervals and times of every system."""
    scores = {system: np.concatenate([run.scores[system] for run in runs]) for system in systems}
    medians = {system: float(np.median(np.concatenate([run.seconds[system] for run in runs]))) for system in systems}
    who = [performers[k] for run in runs for k in run.queries]
    groups = np.array(who, dtype=str) if all(who) and len(set(who)) > 1 else None

    interval = partial(bootstrap_interval, n_resamples=n_resamples, random_state=random_state)
    results = {}
    for system in systems:
        columns = dict(zip(RANKING_SCORES, scores[system].T, strict=True))
        against = scores[system][:, _MAP] - scores["dtw"][:, _MAP] if "dtw" in systems else None
        results[system] = RankingSystemResult(
            scores={name: interval(values) for name, values in columns.items()},
            scores_by_performer={}
            if groups is None
            else {name: interval(values, groups=groups) for name, values in columns.items()},
            beyond_dtw=None if against is None or system == "dtw" else interval(against),
            query_milliseconds=1e3 * medians[system],
            times_faster_than_dtw=medians["dtw"] / medians[system] if "dtw" in systems else None,
            folds=tuple(_score_fold(run, system) for run in runs) if split == "leave-performer-out" else (),
        )
    return results


def _score_fold(run: _Run, system: str) -> RankingFold:
    mean = float(run.scores[system][:, _MAP].mean())
    return RankingFold(run.name, run.n_gallery, len(run.queries), mean)
