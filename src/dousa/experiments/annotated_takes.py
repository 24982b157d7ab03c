"""How well real takes of people never seen are labelled, by what was learned from the annotated takes of others.

One performer at a time is left out. What is learned comes from the takes of the others alone: their segments, and what
lies between them, which shows what nothing looks like. Frames of which nobody can say what they are do not count.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from dousa.errors import TrainingError
from dousa.experiments.metrics import Confusion, TimelineCounts, TimelineScores, add_counts, compare_timeline, name_at
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
from dousa.retrieval.features.feature_sets import DEFAULT_FEATURE_SET, get_feature_set
from dousa.retrieval.features.posed_motion import AnnotatedTake, LabelledClip
from dousa.retrieval.forest.stretches import StretchJudge, cut_stretch
from dousa.retrieval.takes.label import Segment, label_take
from dousa.retrieval.takes.labeller_training import train_labeller
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


LabelTake = Callable[[AnnotatedTake], Mapping[str, Sequence[Segment]]]
"""Labels the motion of a take; the same method may answer in several ways, by name."""

LearnToLabel = Callable[[Sequence[AnnotatedTake]], LabelTake]
"""Learns from takes, and gives what labels others."""

OURS, NEVER_UNKNOWN = "dousa", "dousa, threshold 0"


def run_annotated_takes_experiment(
    takes: Sequence[AnnotatedTake],
    *,
    methods: Mapping[str, LearnToLabel] | None = None,
    random_state: int = 0,
    n_jobs: int | None = None,
    progress: Progress | None = None,
) -> AnnotatedTakesResult:
    """Label takes of performers left out in turn.

    Parameters
    ----------
    takes : with performers, and with segments of two categories or more.
    methods : others to compare with, by name.
    random_state : seed.
    n_jobs : threads; None for one.
    progress : called with the steps done, their number, and what comes next.

    Raises
    ------
    TrainingError : no takes, fewer than two performers, a take without a performer, fewer than two categories.
    """
    check_at_least(seed=(random_state, 0))
    started = time.perf_counter()
    names = {one.category for take in takes for one in take.stretches if one.category is not None}
    if len(names) < 2:
        raise TrainingError("trials.few_annotated", takes=len(takes), found=sorted(names))
    splits = leave_performer_out([take.performer for take in takes])
    learn_ours = _Ours(random_state, n_jobs).learn
    tallies: dict[str, FrameTally] = {}
    steps = Steps(progress, len(splits))
    for split in splits:
        steps.say(Message("trial_progress.without", fold=split.name))
        for learn in (learn_ours, *(methods or {}).values()):
            label = learn([takes[k] for k in split.train])
            for k in split.test:
                for name, said in label(takes[k]).items():
                    tallies.setdefault(name, FrameTally()).count(takes[k], said)
        steps.done += 1
    steps.finish()
    return AnnotatedTakesResult(
        {name: tally.scores() for name, tally in tallies.items()},
        {
            name: {person: right[True] / right.total() for person, right in sorted(tally.people.items())}
            for name, tally in tallies.items()
        },
        tallies[OURS].confusions(12),
        len(takes),
        sum(len(take.positions) / take.frame_rate for take in takes),
        sum(one.category is not None for take in takes for one in take.stretches),
        len(names),
        random_state,
        time.perf_counter() - started,
    )


@dataclass(frozen=True, slots=True)
class _Ours:
    """What `dousa train` and `dousa label` do."""

    random_state: int
    n_jobs: int | None

    def learn(self, takes: Sequence[AnnotatedTake]) -> LabelTake:
        """A labeller of what happens in the takes."""
        labeller = train_labeller([], takes, random_state=self.random_state, n_jobs=self.n_jobs)
        judge = learn_clip_judge(cut_segments(takes), self.random_state, self.n_jobs)

        def label(take: AnnotatedTake) -> dict[str, Sequence[Segment]]:
            return {
                name: label_take(labeller, take, judge=judge, threshold=threshold, n_jobs=self.n_jobs).segments
                for name, threshold in ((OURS, None), (NEVER_UNKNOWN, 0.0))
            }

        return label


def cut_segments(takes: Sequence[AnnotatedTake]) -> list[LabelledClip]:
    """The segments of takes that have a category, as clips."""
    clips = []
    for take in takes:
        for one in take.stretches:
            if one.category is not None:
                part = cut_stretch(take, one.start, one.stop)
                name = f"{take.name} {one.start:.2f}"
                clips.append(
                    LabelledClip(name, one.category, take.performer, part.positions, part.frame_rate, part.height)
                )
    return clips


def learn_clip_judge(clips: Sequence[LabelledClip], random_state: int, n_jobs: int | None) -> StretchJudge | None:
    """The forest of some clips that judges segments, as `dousa train` learns it."""
    kind = get_feature_set(DEFAULT_FEATURE_SET)
    features = np.stack([kind.compute(clip) for clip in clips])
    copies = describe_copies(clips, kind, random_state)
    forest = make_forest(kind, 100, random_state, n_jobs)
    rows, labels = np.arange(len(clips)), np.array([clip.category for clip in clips], dtype=np.str_)
    fit_forest(forest, features, rows, labels, copies, kind)
    return learn_judge(forest, features, rows, clips, copies, kind)
