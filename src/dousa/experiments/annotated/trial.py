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
from dousa.experiments.runner import Progress, Steps, check_at_least, leave_performer_out, make_forest
from dousa.messages import Message
from dousa.retrieval.features.feature_sets import DEFAULT_FEATURE_SET, get_feature_set
from dousa.retrieval.features.posed_motion import AnnotatedTake, LabelledClip
from dousa.retrieval.takes.label import Segment, label_take
from dousa.retrieval.takes.labeller_training import train_labeller
from dousa.retrieval.takes.windows import describe_take

LabelTake = Callable[[AnnotatedTake], Mapping[str, Sequence[Segment]]]
"""Labels the motion of a take; the same method may answer in several ways, by name."""

LearnToLabel = Callable[[Sequence[AnnotatedTake]], LabelTake]
"""Learns from takes, and gives what labels others."""

OURS, NEVER_UNKNOWN = "dousa", "dousa, threshold 0"

_LEAST_SECONDS = 0.3  # of a segment that something is learned from


def run_annotated_takes_experiment(
    takes: Sequence[AnnotatedTake],
    *,
    methods: Mapping[str, LearnToLabel] | None = None,
    feature_set: str = DEFAULT_FEATURE_SET,
    n_trees: int = 100,
    random_state: int = 0,
    n_jobs: int | None = None,
    progress: Progress | None = None,
) -> AnnotatedTakesResult:
    """Label takes of performers left out in turn.

    Parameters
    ----------
    takes : with performers, and with segments of two categories or more.
    methods : others to compare with, by name.
    feature_set, n_trees : of the forests.
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
    learn_ours = _Ours(feature_set, n_trees, random_state, n_jobs).learn
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

    feature_set: str
    n_trees: int
    random_state: int
    n_jobs: int | None

    def learn(self, takes: Sequence[AnnotatedTake]) -> LabelTake:
        """A forest and a labeller of the segments."""
        kind = get_feature_set(self.feature_set)
        clips = [clip for take in takes for clip in cut_segments(take)]
        features = np.stack([kind.compute(clip) for clip in clips])
        forest = make_forest(kind, self.n_trees, self.random_state, self.n_jobs)
        forest.fit(features, [clip.category for clip in clips], feature_set=kind)
        labeller = train_labeller(
            forest, kind, clips, features=features, random_state=self.random_state, n_jobs=self.n_jobs
        )

        def label(take: AnnotatedTake) -> dict[str, Sequence[Segment]]:
            windows = describe_take(forest, kind, take, labeller.grid, n_jobs=self.n_jobs)
            return {
                OURS: label_take(labeller, windows).segments,
                NEVER_UNKNOWN: label_take(labeller, windows, threshold=0.0).segments,
            }

        return label


def cut_segments(take: AnnotatedTake) -> list[LabelledClip]:
    """The segments of a take that have a category, as clips; very short ones are left out."""
    clips = []
    for one in take.stretches:
        if one.category is None or one.stop - one.start < _LEAST_SECONDS:
            continue
        first, stop = round(one.start * take.frame_rate), round(one.stop * take.frame_rate)
        name = f"{take.name} {one.start:.2f} s"
        positions = take.positions[first:stop]
        clips.append(LabelledClip(name, one.category, take.performer, positions, take.frame_rate, take.height))
    return clips
