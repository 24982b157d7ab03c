"""How well takes of people never seen are labelled and searched.

One performer at a time is left out. A forest and a labeller learn from the clips of the others; the clips of the one
left out are joined into takes, with blends between them (`join_clips`), so that the truth is known. Four kinds:
as recorded; each piece 0.5 to 2 times as fast; and both with a share of the categories set aside before the training,
so that their pieces are unknown. For the search, clips of the others are looked for in the takes: of categories that
the forest knows, and of those set aside.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dousa.errors import OptionError
from dousa.experiments.metrics import TimelineCounts, TimelineScores, TrueSegment, add_counts, compare_timeline
from dousa.experiments.runner import (
    Steps,
    check_at_least,
    describe_copies,
    fit_forest,
    learn_judge,
    leave_performer_out,
    make_forest,
)
from dousa.experiments.table import Cell, Result, ResultTable, show
from dousa.messages import Message, Progress
from dousa.motion.runs import find_equal_runs
from dousa.retrieval.features.feature_sets import DEFAULT_FEATURE_SET, FeatureSet, get_feature_set
from dousa.retrieval.features.posed_motion import LabelledClip
from dousa.retrieval.forest.forest import MotionForest
from dousa.retrieval.forest.stretches import StretchJudge
from dousa.retrieval.takes.find import Found, describe_query, find_in_takes, overlap
from dousa.retrieval.takes.label import Segment, TakeLabeller, label_take
from dousa.retrieval.takes.labeller_training import train_labeller
from dousa.retrieval.takes.made_takes import JoinedTake, join_clips, join_series, shuffle_into_takes
from dousa.retrieval.takes.windows import TAKE_RATE, TakeWindows, WindowGrid, choose_grid, describe_take

OURS, NEVER_UNKNOWN = "discriminants of moments, best sequence", "the same, all said"
FRAMEWISE = "votes, frame by frame"
AS_RECORDED, OTHER_TEMPO = "as recorded", "tempo 0.5 to 2"
WITH_UNKNOWN, BOTH = "unknown pieces", "unknown pieces, tempo 0.5 to 2"
KNOWN_QUERIES, NEW_QUERIES = "known categories", "categories never trained"


@dataclass(frozen=True, slots=True)
class FindScores(Result):
    """Search in takes, means over queries; an answer is right if it overlaps a piece of the category by half.

    Parameters
    ----------
    mean_average_precision : over all pieces of the query's category.
    precision_at_1 : share of queries whose first answer is right.
    n_queries : how many.
    """

    mean_average_precision: float
    precision_at_1: float
    n_queries: int


@dataclass(frozen=True, slots=True)
class TakesResult(Result):
    """What was reached.

    Parameters
    ----------
    labelled : scores by kind of take, then by method.
    found : scores by kind of query.
    performers : left out in turn.
    set_aside : categories set aside by performer left out.
    random_state : seed.
    label_frames_per_second : features included.
    seconds : for everything.
    """

    labelled: dict[str, dict[str, TimelineScores]]
    found: dict[str, FindScores]
    performers: tuple[str, ...]
    set_aside: dict[str, tuple[str, ...]]
    random_state: int
    label_frames_per_second: float
    seconds: float

    def to_tables(self) -> tuple[ResultTable, ...]:
        """Labels by kind of take and method, then searches."""
        rows = [(kind, method, scores) for kind, some in self.labelled.items() for method, scores in some.items()]
        first = frozenset(row for row, one in enumerate(rows) if row == 0 or one[0] != rows[row - 1][0])
        labels = ResultTable(
            (Message("trial_takes.takes"), Message("trial_takes.method"), *_SCORE_HEADS.values()),
            tuple(
                (
                    _WORDS[kind] if row in first else "",
                    _WORDS[method],
                    *(show(getattr(scores, name)) for name in _SCORE_HEADS),
                )
                for row, (kind, method, scores) in enumerate(rows)
            ),
            title=Message("trial_takes.labelled", people=len(self.performers)),
            n_words=2,
            bold=first,
            sections=frozenset(row - 1 for row in first if row),
        )
        searches = ResultTable(
            (Message("trial_takes.queries"), "MAP", "P@1", Message("trial_takes.number")),
            tuple(
                (_WORDS[kind], show(one.mean_average_precision), show(one.precision_at_1), str(one.n_queries))
                for kind, one in self.found.items()
            ),
            title=Message("trial_takes.found"),
        )
        how = Message("trial_takes.how", seed=self.random_state, rate=self.label_frames_per_second)
        return (labels, *([searches] if self.found else []), ResultTable(notes=(how,)))


_WORDS = {
    OURS: Message("trial_takes.ours"),
    NEVER_UNKNOWN: Message("trial_takes.never_unknown"),
    FRAMEWISE: Message("trial_takes.framewise"),
    AS_RECORDED: Message("trial_takes.as_recorded"),
    OTHER_TEMPO: Message("trial_takes.other_tempo"),
    WITH_UNKNOWN: Message("trial_takes.with_unknown"),
    BOTH: Message("trial_takes.both"),
    KNOWN_QUERIES: Message("trial_takes.known_queries"),
    NEW_QUERIES: Message("trial_takes.new_queries"),
}

_SCORE_HEADS: dict[str, Cell] = {
    "frame_accuracy": Message("trial_takes.frame_accuracy"),
    "precision": Message("trial_words.precision"),
    "recall": Message("trial_words.recall"),
    "f_measure": "F",
    "boundary_error_s": Message("trial_takes.boundary_error"),
}


def run_takes_experiment(
    clips: Sequence[LabelledClip],
    *,
    feature_set: str = DEFAULT_FEATURE_SET,
    n_trees: int = 100,
    random_state: int = 0,
    set_aside: float = 0.25,
    n_queries: int = 40,
    n_jobs: int | None = None,
    progress: Progress | None = None,
) -> TakesResult:
    """Label and search takes of performers left out in turn.

    Parameters
    ----------
    clips : whole actions, with category and performer.
    feature_set, n_trees : of the forests.
    random_state : seed of forests, takes and choices.
    set_aside : share of the categories that are unknown where unknown pieces are wanted, 0 to below 1.
    n_queries : clips looked for in the takes of each performer.
    n_jobs : threads; None for one.
    progress : called with the steps done, their number, and what comes next.

    Raises
    ------
    TrainingError : no clips, fewer than two performers, a clip without performer or category.
    OptionError : a number outside its range.
    """
    if not 0 <= set_aside < 1:
        raise OptionError("trials.set_aside", found=set_aside)
    check_at_least(n_queries=(n_queries, 0), seed=(random_state, 0))
    started = time.perf_counter()
    trial = _Trial(clips, get_feature_set(feature_set), n_trees, random_state, n_queries, n_jobs)
    names = sorted({clip.category for clip in clips})
    splits = leave_performer_out([clip.performer for clip in clips])
    aside: dict[str, tuple[str, ...]] = {}
    steps = Steps(progress, 2 * len(splits))
    for number, split in enumerate(splits):
        draw = np.random.default_rng([random_state, number])
        aside[split.name] = tuple(sorted(draw.permutation(names)[: round(set_aside * len(names))].tolist()))
        for unknown in ((), aside[split.name]):
            steps.say(Message("trial_progress.without", fold=split.name))
            trial.run(split.train, split.test, frozenset(unknown), number)
            steps.done += 1
    steps.finish()
    return TakesResult(
        {
            kind: {method: add_counts(some).scores() for method, some in methods.items()}
            for kind, methods in trial.counts.items()
        },
        {kind: _mean(some) for kind, some in trial.precisions.items() if some},
        tuple(split.name for split in splits),
        aside,
        random_state,
        trial.n_frames / max(trial.label_seconds, 1e-9),
        time.perf_counter() - started,
    )


class _Trial:
    """Gathers what all performers' takes say."""

    def __init__(
        self,
        clips: Sequence[LabelledClip],
        feature_set: FeatureSet,
        n_trees: int,
        random_state: int,
        n_queries: int,
        n_jobs: int | None,
    ) -> None:
        self.clips, self.feature_set, self.n_trees = clips, feature_set, n_trees
        self.random_state, self.n_queries, self.n_jobs = random_state, n_queries, n_jobs
        self.features = np.stack([feature_set.compute(clip) for clip in clips])
        self.copies = describe_copies(clips, feature_set, random_state)
        self.counts: dict[str, dict[str, list[TimelineCounts]]] = {}
        self.precisions: dict[str, list[tuple[float, bool]]] = {KNOWN_QUERIES: [], NEW_QUERIES: []}
        self.n_frames, self.label_seconds = 0, 0.0

    def run(self, train: NDArray[np.intp], test: NDArray[np.intp], unknown: frozenset[str], number: int) -> None:
        """Learn from some clips, except those of unknown categories; label and search takes of the others."""
        kept = [int(k) for k in train if self.clips[k].category not in unknown]
        forest = make_forest(self.feature_set, self.n_trees, self.random_state, self.n_jobs)
        labels = np.array([self.clips[k].category for k in kept], dtype=np.str_)
        fit_forest(forest, self.features, np.array(kept), labels, self.copies, self.feature_set)
        known = [self.clips[k] for k in kept]
        labeller = train_labeller(known, random_state=self.random_state, n_jobs=self.n_jobs)
        judge = learn_judge(forest, self.features, np.array(kept), known, self.copies, self.feature_set)
        seconds = [len(clip.positions) / clip.frame_rate for clip in known]
        # Windows whose votes are counted: shares of the shortest and the longest clip.
        grid = choose_grid(seconds, 0.6, 1.6)
        kinds = (WITH_UNKNOWN, BOTH) if unknown else (AS_RECORDED, OTHER_TEMPO)
        for kind, other_tempo in zip(kinds, (False, True), strict=True):
            takes = self._join(test, number, other_tempo=other_tempo)
            self._label(kind, (forest, grid), (labeller, judge), takes, unknown)
            if not other_tempo:
                self._find(forest, takes, train, unknown, number)

    def _join(self, test: NDArray[np.intp], number: int, *, other_tempo: bool) -> list[JoinedTake]:
        draw = np.random.default_rng([self.random_state, number, int(other_tempo)])
        unseen = [self.clips[k] for k in test]
        takes = []
        for group in shuffle_into_takes(unseen, draw):
            spread = 1.0 if other_tempo else 0.0
            tempos = (2.0 ** draw.uniform(-spread, spread, len(group))).tolist()
            takes.append(join_clips([unseen[k] for k in group], draw, tempos=tempos))
        return takes

    def _label(
        self,
        kind: str,
        plain: tuple[MotionForest, WindowGrid],
        ours: tuple[TakeLabeller, StretchJudge | None],
        takes: Sequence[JoinedTake],
        unknown: frozenset[str],
    ) -> None:
        labeller, judge = ours
        counts = self.counts.setdefault(kind, {OURS: [], NEVER_UNKNOWN: [], FRAMEWISE: []})
        for take in takes:
            start = time.perf_counter()
            timeline = label_take(labeller, take, judge=judge, n_jobs=self.n_jobs)
            self.label_seconds += time.perf_counter() - start
            self.n_frames += round(timeline.duration * TAKE_RATE)
            truth = [
                TrueSegment(
                    one.start / TAKE_RATE,
                    one.stop / TAKE_RATE,
                    None if one.category in unknown else one.category,
                )
                for one in join_series(take.pieces)
            ]
            counts[OURS].append(compare_timeline(timeline.segments, truth, timeline.duration))
            said = label_take(labeller, take, judge=judge, threshold=0.0, n_jobs=self.n_jobs).segments
            counts[NEVER_UNKNOWN].append(compare_timeline(said, truth, timeline.duration))
            forest, grid = plain
            windows = describe_take(forest, self.feature_set, take, grid, n_jobs=self.n_jobs)
            votes = _label_frames(forest, windows)
            counts[FRAMEWISE].append(compare_timeline(votes, truth, timeline.duration))

    def _find(
        self,
        forest: MotionForest,
        takes: Sequence[JoinedTake],
        train: NDArray[np.intp],
        unknown: frozenset[str],
        number: int,
    ) -> None:
        """Look for clips of the others: of categories never trained where some are unknown, else of all."""
        draw = np.random.default_rng([self.random_state, number, 2])
        possible = [int(k) for k in train if not unknown or self.clips[k].category in unknown]
        shown = {piece.category for take in takes for piece in take.pieces}
        possible = [k for k in possible if self.clips[k].category in shown]
        seconds = [len(clip.positions) / clip.frame_rate for clip in self.clips]
        grid = choose_grid([seconds[k] for k in train])
        windows = [
            (str(k), describe_take(forest, self.feature_set, take, grid, n_jobs=self.n_jobs))
            for k, take in enumerate(takes)
        ]
        for k in draw.permutation(possible)[: self.n_queries]:
            query = describe_query(forest, self.feature_set, self.clips[k])
            found = find_in_takes(query, windows, limit=50)
            answer = _average_precision(found, takes, self.clips[k].category)
            self.precisions[NEW_QUERIES if unknown else KNOWN_QUERIES].append(answer)


def _label_frames(forest: MotionForest, take: TakeWindows) -> list[Segment]:
    """The plain way: each frame gets the category with most votes of the windows that it lies in."""
    votes = forest.histograms_of(take.leaves.astype(np.int64))
    sums = np.zeros((take.n_frames + 1, votes.shape[1]))
    np.add.at(sums, take.starts, votes)
    np.subtract.at(sums, take.stops, votes)
    best = np.cumsum(sums, axis=0)[:-1].argmax(axis=1)
    return [
        Segment(start / TAKE_RATE, stop / TAKE_RATE, str(forest.classes_[best[start]]), 1.0)
        for start, stop in find_equal_runs(best).tolist()
    ]


def _average_precision(found: Sequence[Found], takes: Sequence[JoinedTake], category: str) -> tuple[float, bool]:
    """Average precision over the pieces of a category, and whether the first answer is right."""
    pieces = [
        (str(k), (piece.start / TAKE_RATE, piece.stop / TAKE_RATE))
        for k, take in enumerate(takes)
        for piece in take.pieces
        if piece.category == category
    ]
    left, hits, total, first = list(pieces), 0, 0.0, False
    for rank, one in enumerate(found, 1):
        right = [p for p in left if p[0] == one.take and overlap(p[1], (one.start, one.stop)) >= 0.5]
        if right:
            left.remove(right[0])
            hits += 1
            total += hits / rank
            first = first or rank == 1
    return total / len(pieces), first


def _mean(some: Sequence[tuple[float, bool]]) -> FindScores:
    return FindScores(
        float(np.mean([precision for precision, _ in some])),
        float(np.mean([first for _, first in some])),
        len(some),
    )
