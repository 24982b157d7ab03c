"""What is right in the labels of annotated takes: frames that show something, the rest, segments, people, mistakes.

Frames are at 30 Hz; those of which nobody can say what they show do not count.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from dousa.experiments.metrics import Confusion, TimelineCounts, TimelineScores, add_counts, compare_timeline, name_at
from dousa.experiments.table import Cell, Result, ResultTable, show
from dousa.messages import Message
from dousa.retrieval.features.posed_motion import AnnotatedTake
from dousa.retrieval.takes.label import Segment
from dousa.retrieval.takes.windows import TAKE_RATE

NOTHING = ""
"""What a frame shows, or is called, where no category is."""


@dataclass(frozen=True, slots=True)
class AnnotatedScores(Result):
    """Shares from 0 to 1; nan where there is nothing to count.

    Parameters
    ----------
    annotated_right : of the frames that show a category, those that are called by it.
    rest_called : of the frames that show nothing, those that are called something.
    timeline : as for joined takes; its frame accuracy is of all frames that count.
    """

    annotated_right: float
    rest_called: float
    timeline: TimelineScores


@dataclass(frozen=True, slots=True)
class AnnotatedTakesResult(Result):
    """What was reached.

    Parameters
    ----------
    scores : by method.
    by_performer : by method, then by performer: the share of the annotated frames that is right.
    confusions : frames of the first method, most frequent first; an empty name is nothing, or unknown.
    n_takes, seconds_of_takes, n_segments, n_categories : what there was.
    random_state : seed.
    seconds : for everything.
    """

    scores: dict[str, AnnotatedScores]
    by_performer: dict[str, dict[str, float]]
    confusions: tuple[Confusion, ...]
    n_takes: int
    seconds_of_takes: float
    n_segments: int
    n_categories: int
    random_state: int
    seconds: float

    def to_tables(self) -> tuple[ResultTable, ...]:
        """Scores by method, shares by performer, and what was taken for what."""
        heads: dict[str, Cell] = {
            "precision": Message("trial_words.precision"),
            "recall": Message("trial_words.recall"),
            "f_measure": "F",
            "boundary_error_s": Message("trial_takes.boundary_error"),
        }
        counts = {"takes": self.n_takes, "minutes": self.seconds_of_takes / 60, "segments": self.n_segments}
        scores = ResultTable(
            (
                Message("trial_takes.method"),
                Message("trial_takes.annotated_right"),
                Message("trial_takes.rest_called"),
                Message("trial_takes.all_right"),
                *heads.values(),
            ),
            tuple(
                (
                    name,
                    show(one.annotated_right),
                    show(one.rest_called),
                    show(one.timeline.frame_accuracy),
                    *(show(getattr(one.timeline, head)) for head in heads),
                )
                for name, one in self.scores.items()
            ),
            title=Message("trial_takes.annotated", people=len(next(iter(self.by_performer.values()), {})), **counts),
            bold=frozenset({0}),
        )
        people = ResultTable(
            (Message("trial_takes.left_out"), *self.by_performer),
            tuple(
                (person, *(show(shares[person]) for shares in self.by_performer.values()))
                for person in next(iter(self.by_performer.values()), {})
            ),
            title=Message("trial_takes.by_person"),
        )
        nothing = Message("trial_takes.nothing")
        confused = ResultTable(
            (Message("trial_takes.shows"), Message("trial_takes.called"), Message("trial_takes.share")),
            tuple((one.truth or nothing, one.predicted or nothing, show(one.share)) for one in self.confusions),
            title=Message("trial_takes.confused"),
            n_words=2,
        )
        how = ResultTable(notes=(Message("trial_takes.annotated_how", seed=self.random_state),))
        return (scores, people, *([confused] if self.confusions else []), how)


@dataclass(slots=True)
class FrameTally:
    """Frames of takes, as one method calls them."""

    frames: Counter[tuple[str, str]] = field(default_factory=Counter)
    timelines: list[TimelineCounts] = field(default_factory=list)
    people: dict[str, Counter[bool]] = field(default_factory=dict)

    def count(self, take: AnnotatedTake, said: Sequence[Segment]) -> None:
        """Count what is said of a take."""
        duration = len(take.positions) / take.frame_rate
        times = np.asarray((np.arange(round(duration * TAKE_RATE)) + 0.5) / TAKE_RATE, np.float64)
        called = name_at(times, [(one.start, one.stop, one.category) for one in said])
        for stretch in take.stretches:
            if not stretch.counted:
                continue
            inside = called[(times >= stretch.start) & (times < stretch.stop)]
            truth = stretch.category or NOTHING
            self.frames.update((truth, str(name)) for name in inside)
            if truth:
                right = self.people.setdefault(str(take.performer), Counter())
                right.update((inside == truth).tolist())
        self.timelines.append(compare_timeline(said, take.stretches, duration))

    def scores(self) -> AnnotatedScores:
        """The shares of all takes."""
        shown = sum(count for (truth, _), count in self.frames.items() if truth)
        right = sum(count for (truth, name), count in self.frames.items() if truth and truth == name)
        rest = sum(count for (truth, _), count in self.frames.items() if not truth)
        called = sum(count for (truth, name), count in self.frames.items() if not truth and name)
        nan = float("nan")
        timeline = add_counts(self.timelines).scores()
        return AnnotatedScores(right / shown if shown else nan, called / rest if rest else nan, timeline)

    def confusions(self, limit: int) -> tuple[Confusion, ...]:
        """The most frequent mistakes."""
        totals: Counter[str] = Counter()
        for (truth, _), count in self.frames.items():
            totals[truth] += count
        wrong = [
            Confusion(truth, name, count, count / totals[truth])
            for (truth, name), count in self.frames.items()
            if truth != name
        ]
        return tuple(sorted(wrong, key=lambda one: (-one.count, one.truth, one.predicted))[:limit])
