"""How well real takes of people never seen are labelled, by what was learned from the annotated takes of others.

One performer at a time is left out. What is learned comes from the takes of the others alone: their segments, and what
lies between them, which shows what nothing looks like. Frames of which nobody can say what they are do not count.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dousa.errors import TrainingError
from dousa.experiments.annotated.scores import AnnotatedTakesResult, FrameTally
from dousa.experiments.runner import (
    Steps,
    check_at_least,
    describe_copies,
    fit_forest,
    learn_judge,
    leave_performer_out,
    make_forest,
)
from dousa.messages import Message, Progress
from dousa.retrieval.features.feature_sets import DEFAULT_FEATURE_SET, get_feature_set
from dousa.retrieval.features.posed_motion import AnnotatedTake, LabelledClip
from dousa.retrieval.forest.stretches import StretchJudge, cut_stretch
from dousa.retrieval.takes.label import Segment, label_take
from dousa.retrieval.takes.labeller_training import train_labeller

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
