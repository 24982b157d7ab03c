"""The ranking experiment: are the clips that come first of the same category as the query?

A query is a clip that the gallery does not hold; with performers left out, its performer is nowhere in the gallery. The
clips of the gallery are put in order for every query; a clip is relevant if it is of the query's category. Forests and
templates learn from the gallery and its labels; Euclidean distance and DTW need no labels. Nothing is published for
retrieving whole clips by a clip on the sets used here, so the protocol is written down in docs/ranking.md.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dousa.errors import OptionError, TrainingError
from dousa.retrieval._experiment_result import LabelledClip
from dousa.retrieval._ranking_material import RankingMaterial, describe_clips
from dousa.retrieval._ranking_result import RankingFold, RankingResult, RankingSystemResult
from dousa.retrieval._ranking_systems import RANKING_SYSTEMS, Ranker, RankingSettings, make_rankers
from dousa.retrieval.experiment import SPLITS, Progress
from dousa.retrieval.feature_sets import DEFAULT_FEATURE_SET, get_feature_set
from dousa.retrieval.ranking_metrics import RANKING_SCORES, Interval, bootstrap_interval, score_ranking
from dousa.retrieval.splits import Split, leave_performer_out, split_half

__all__ = ["RANKING_SYSTEMS", "RankingResult", "RankingSystemResult", "run_ranking_experiment"]

_MAP = RANKING_SCORES.index("map")
_P_AT_10 = 10


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
    _check_options(split, test_clips is not None, systems, random_state, n_resamples)
    everything = [*clips, *(test_clips or ())]
    _check_clips(everything)
    name = "given" if test_clips is not None else split or "half"
    folds = _make_folds(everything, len(clips), name, random_state)
    settings = RankingSettings(get_feature_set(feature_set), n_trees, n_jobs)
    material = describe_clips(everything, systems, settings.feature_set, progress)
    queries, without = _choose_queries(material, folds)
    runs = _run_folds(systems, material, folds, queries, settings, random_state, progress)
    performers = [clip.performer for clip in everything]
    return RankingResult(
        systems=_summarise(systems, runs, performers, n_resamples, random_state, name),
        n_queries=sum(len(run.queries) for run in runs),
        n_gallery=round(
            float(np.average([r.n_gallery for r in runs], weights=[len(r.queries) for r in runs]))
        ),
        categories=tuple(sorted(set(material.categories))),
        split=name,
        feature_set=feature_set,
        n_trees=n_trees,
        random_state=random_state,
        n_resamples=n_resamples,
        without_relevant=without,
        n_short=sum(int((run.n_relevant < _P_AT_10).sum()) for run in runs),
        best_p_at_10=float(
            np.concatenate([np.minimum(r.n_relevant, _P_AT_10) for r in runs]).mean() / _P_AT_10
        ),
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


def _check_options(
    split: str | None, test_given: bool, systems: Sequence[str], random_state: int, n_resamples: int
) -> None:
    if split is not None and split not in SPLITS:
        raise OptionError(f"split: expected {' or '.join(SPLITS)}, got '{split}'")
    if split is not None and test_given:
        raise OptionError("test clips were given, so there is nothing to split; give one or the other")
    unknown = [system for system in systems if system not in RANKING_SYSTEMS]
    if unknown or not systems:
        raise OptionError(
            f"rankings: expected some of {', '.join(RANKING_SYSTEMS)}, got {', '.join(unknown) or 'none'}"
        )
    if random_state < 0 or n_resamples < 1:
        raise OptionError(
            f"expected a seed of 0 or more and 1 resample or more, got {random_state} and {n_resamples}"
        )


def _check_clips(clips: Sequence[LabelledClip]) -> None:
    for clip in clips:
        if not clip.category:
            raise TrainingError(f"{clip.name}: expected a category, the clip has none")


def _make_folds(
    clips: Sequence[LabelledClip], n_first: int, split: str, random_state: int
) -> tuple[Split, ...]:
    """Gallery and queries of each fold; a gallery of one category puts nothing in order."""
    if split == "given":
        folds: tuple[Split, ...] = (Split(np.arange(n_first), np.arange(n_first, len(clips))),)
    elif split == "leave-performer-out":
        folds = leave_performer_out([clip.performer for clip in clips])
    else:
        generator = np.random.default_rng([random_state, 0])
        folds = (split_half([clip.category for clip in clips], generator),)
    for fold in folds:
        found = sorted({clips[k].category for k in fold.train})
        if len(found) < 2 or not len(fold.test):
            what = f"all clips are '{found[0]}'" if len(found) == 1 else "there are none"
            raise TrainingError(
                f"ranking needs queries and a gallery of at least two categories; in the fold '{fold.name}' "
                f"{what if len(found) < 2 else 'there is no query'}"
            )
    return folds


def _choose_queries(
    material: RankingMaterial, folds: Sequence[Split]
) -> tuple[list[NDArray[np.intp]], dict[str, int]]:
    """The queries of each fold that have something to find, and how many have not, by category."""
    chosen, without = [], Counter[str]()
    for fold in folds:
        wanted = np.isin(material.categories[fold.test], material.categories[fold.train])
        chosen.append(fold.test[wanted])
        without.update(material.categories[fold.test[~wanted]])
    if not sum(map(len, chosen)):
        raise TrainingError(
            "no query has a clip of its category in the gallery, so there is nothing to rank; is the category taken "
            "from the right place (--category-from), and does more than one performer show it?"
        )
    return chosen, dict(sorted(without.items()))


class _Stopwatch:
    """Ranks and times queries, and counts them for the progress callback."""

    def __init__(self, progress: Progress | None, total: int) -> None:
        self.progress, self.total, self.done = progress, total, 0

    def say(self, doing: str) -> None:
        if self.progress is not None:
            self.progress(self.done, self.total, doing)

    def measure(
        self, rank: Ranker, queries: NDArray[np.intp], relevant: NDArray[np.bool_], doing: str
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Scores (Q, 5) and seconds (Q,) of queries whose relevant clips of the gallery are known, (Q, N)."""
        rank(int(queries[0]))  # compiles, and touches the memory
        scores, seconds = np.empty((len(queries), len(RANKING_SCORES))), np.empty(len(queries))
        for row, query in enumerate(queries):
            self.say(doing)
            started = time.perf_counter()
            order = rank(int(query))
            seconds[row] = time.perf_counter() - started
            scores[row] = score_ranking(relevant[row, order]).as_row()
            self.done += 1
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
    watch = _Stopwatch(progress, len(systems) * sum(map(len, queries)))
    runs = []
    for number, (fold, asked) in enumerate(zip(folds, queries, strict=True)):
        if not len(asked):
            continue
        watch.say(f"training, {fold.name}")
        generator = np.random.default_rng([random_state, 1, number])
        gallery = generator.permutation(fold.train)  # so that equals come in an order drawn at random
        seed = int(generator.integers(2**31 - 1))
        rankers, fit_seconds = make_rankers(systems, material, gallery, settings, seed)
        relevant = material.categories[asked][:, None] == material.categories[gallery][None]
        measured = {
            system: watch.measure(rank, asked, relevant, f"{system}, {fold.name}")
            for system, rank in rankers.items()
        }
        scores = {system: one for system, (one, _) in measured.items()}
        seconds = {system: two for system, (_, two) in measured.items()}
        runs.append(_Run(fold.name, len(gallery), asked, relevant.sum(axis=1), scores, seconds, fit_seconds))
    watch.say("done")
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
    medians = {
        system: float(np.median(np.concatenate([run.seconds[system] for run in runs]))) for system in systems
    }
    who = [performers[k] for run in runs for k in run.queries]
    groups = np.array(who, dtype=str) if all(who) and len(set(who)) > 1 else None

    def interval(values: NDArray[np.float64], grouped: bool = False) -> Interval:
        return bootstrap_interval(
            values, groups=groups if grouped else None, n_resamples=n_resamples, random_state=random_state
        )

    results = {}
    for system in systems:
        columns = dict(zip(RANKING_SCORES, scores[system].T, strict=True))
        against = scores[system][:, _MAP] - scores["dtw"][:, _MAP] if "dtw" in systems else None
        results[system] = RankingSystemResult(
            scores={name: interval(values) for name, values in columns.items()},
            scores_by_performer={}
            if groups is None
            else {name: interval(values, grouped=True) for name, values in columns.items()},
            beyond_dtw=None if against is None or system == "dtw" else interval(against),
            query_milliseconds=1e3 * medians[system],
            times_faster_than_dtw=medians["dtw"] / medians[system] if "dtw" in systems else None,
            folds=tuple(_score_fold(run, system) for run in runs) if split == "leave-performer-out" else (),
        )
    return results


def _score_fold(run: _Run, system: str) -> RankingFold:
    mean = float(run.scores[system][:, _MAP].mean())
    return RankingFold(run.name, run.n_gallery, len(run.queries), mean)
