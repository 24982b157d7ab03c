"""How well takes of people never seen are labelled and searched.

One performer at a time is left out. A forest and a labeller learn from the clips of the others; the clips of the one
left out are joined into takes, with blends between them (`join_clips`), so that the truth is known. Four kinds:
as recorded; each piece 0.5 to 2 times as fast; and both with a share of the categories set aside before the training,
so that their pieces are unknown. For the search, clips of the others are looked for in the takes: of categories that
the forest knows, and of those set aside.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dousa.errors import OptionError
from dousa.retrieval._experiment_result import LabelledClip
from dousa.retrieval._joined_takes import JoinedTake, join_clips, shuffle_into_takes
from dousa.retrieval.feature_sets import DEFAULT_FEATURE_SET, FeatureSet, get_feature_set
from dousa.retrieval.finding import Found, describe_query, find_in_takes, overlap
from dousa.retrieval.forest import MotionForest
from dousa.retrieval.labeller_training import train_labeller
from dousa.retrieval.labelling import Segment, TakeLabeller, label_take
from dousa.retrieval.splits import leave_performer_out
from dousa.retrieval.takes import TAKE_RATE, TakeWindows, choose_grid, describe_take
from dousa.retrieval.timeline_metrics import (
    TimelineCounts,
    TimelineScores,
    TrueSegment,
    add_counts,
    compare_timeline,
)

__all__ = ["FindScores", "TakesResult", "run_takes_experiment"]

Progress = Callable[[int, int, str], None]

OURS, NEVER_UNKNOWN = "leaf weights, best sequence", "the same, all said"
FRAMEWISE = "votes, frame by frame"
AS_RECORDED, OTHER_TEMPO = "as recorded", "tempo 0.5 to 2"
WITH_UNKNOWN, BOTH = "unknown pieces", "unknown pieces, tempo 0.5 to 2"
KNOWN_QUERIES, NEW_QUERIES = "known categories", "categories never trained"


@dataclass(frozen=True, slots=True)
class FindScores:
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

    def to_json(self) -> dict[str, Any]:
        """Plain numbers."""
        return {name: getattr(self, name) for name in self.__slots__}


@dataclass(frozen=True, slots=True)
class TakesResult:
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

    def to_json(self) -> dict[str, Any]:
        """Plain dictionaries, lists, numbers and strings, ready for ``json.dumps``."""
        return {
            "labelled": {
                kind: {method: scores.to_json() for method, scores in methods.items()}
                for kind, methods in self.labelled.items()
            },
            "found": {kind: scores.to_json() for kind, scores in self.found.items()},
            "performers": list(self.performers),
            "set_aside": {name: list(categories) for name, categories in self.set_aside.items()},
            "random_state": self.random_state,
            "label_frames_per_second": self.label_frames_per_second,
            "seconds": self.seconds,
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
    if not 0 <= set_aside < 1 or n_queries < 0 or random_state < 0:
        raise OptionError(
            f"expected set_aside of 0 to below 1, n_queries and random_state of 0 or more, "
            f"got {set_aside}, {n_queries} and {random_state}"
        )
    started = time.perf_counter()
    trial = _Trial(clips, get_feature_set(feature_set), n_trees, random_state, n_queries, n_jobs)
    names = sorted({clip.category for clip in clips})
    splits = leave_performer_out([clip.performer for clip in clips])
    aside: dict[str, tuple[str, ...]] = {}
    for number, split in enumerate(splits):
        draw = np.random.default_rng([random_state, number])
        aside[split.name] = tuple(sorted(draw.permutation(names)[: round(set_aside * len(names))].tolist()))
        for step, unknown in enumerate(((), aside[split.name])):
            if progress is not None:
                progress(2 * number + step, 2 * len(splits), f"without {split.name}")
            trial.run(split.train, split.test, frozenset(unknown), number)
    if progress is not None:
        progress(2 * len(splits), 2 * len(splits), "done")
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
        self.counts: dict[str, dict[str, list[TimelineCounts]]] = {}
        self.precisions: dict[str, list[tuple[float, bool]]] = {KNOWN_QUERIES: [], NEW_QUERIES: []}
        self.n_frames, self.label_seconds = 0, 0.0

    def run(
        self, train: NDArray[np.intp], test: NDArray[np.intp], unknown: frozenset[str], number: int
    ) -> None:
        """Learn from some clips, except those of unknown categories; label and search takes of the others."""
        kept = [int(k) for k in train if self.clips[k].category not in unknown]
        forest = MotionForest(
            self.n_trees,
            thresholds=self.feature_set.thresholds,
            n_trials=self.feature_set.n_trials,
            random_state=self.random_state,
            n_jobs=self.n_jobs,
        ).fit(self.features[kept], [self.clips[k].category for k in kept], feature_set=self.feature_set)
        labeller = train_labeller(
            forest,
            self.feature_set,
            [self.clips[k] for k in kept],
            features=self.features[kept],
            random_state=self.random_state,
            n_jobs=self.n_jobs,
        )
        kinds = (WITH_UNKNOWN, BOTH) if unknown else (AS_RECORDED, OTHER_TEMPO)
        for kind, other_tempo in zip(kinds, (False, True), strict=True):
            takes = self._join(test, number, other_tempo=other_tempo)
            self._label(kind, forest, labeller, takes, unknown)
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
        forest: MotionForest,
        labeller: TakeLabeller,
        takes: Sequence[JoinedTake],
        unknown: frozenset[str],
    ) -> None:
        counts = self.counts.setdefault(kind, {OURS: [], NEVER_UNKNOWN: [], FRAMEWISE: []})
        for take in takes:
            start = time.perf_counter()
            windows = describe_take(forest, self.feature_set, take, labeller.grid, n_jobs=self.n_jobs)
            segments = label_take(labeller, windows).segments
            self.label_seconds += time.perf_counter() - start
            self.n_frames += windows.n_frames
            truth = [
                TrueSegment(
                    one.start / TAKE_RATE,
                    one.stop / TAKE_RATE,
                    None if one.category in unknown else one.category,
                )
                for one in take.pieces
            ]
            counts[OURS].append(compare_timeline(segments, truth, windows.duration))
            said = label_take(labeller, windows, threshold=0.0).segments
            counts[NEVER_UNKNOWN].append(compare_timeline(said, truth, windows.duration))
            plain = _label_frames(forest, windows)
            counts[FRAMEWISE].append(compare_timeline(plain, truth, windows.duration))

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
    edges = np.concatenate([[0], np.flatnonzero(np.diff(best)) + 1, [len(best)]])
    return [
        Segment(start / TAKE_RATE, stop / TAKE_RATE, str(forest.classes_[best[start]]), 1.0)
        for start, stop in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True)
    ]


def _average_precision(
    found: Sequence[Found], takes: Sequence[JoinedTake], category: str
) -> tuple[float, bool]:
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
