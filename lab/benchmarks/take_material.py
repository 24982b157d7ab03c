"""Long takes for the benchmarks: clips of a folder, or made ones, joined until they are long enough."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dousa.retrieval import MotionForest
from dousa.retrieval.features.feature_sets import DEFAULT_FEATURE_SET, FEATURE_SETS, FeatureSet
from dousa.retrieval.features.posed_motion import LabelledClip
from dousa.retrieval.takes.made_takes import JoinedTake, join_clips

__all__ = ["FEATURE_SET", "make_takes", "read_or_make_clips", "train_forest"]

FEATURE_SET: FeatureSet = FEATURE_SETS[DEFAULT_FEATURE_SET]


def read_or_make_clips(folder: Path | None, performer_from: str | None) -> list[LabelledClip]:
    """Labelled clips below a folder, or 20 synthetic performers with one motion of every category."""
    if folder is not None:
        from dousa.app.pipelines.experiment_clips import read_labelled_clips
        from dousa.formats import ReadOptions

        options = ReadOptions()
        return read_labelled_clips([folder], category_from="folder", performer_from=performer_from, options=options)[0]
    from dousa.motion import canonicalise, compute_trajectories
    from dousa.motion.synthetic.performers import CATEGORIES, draw_performer, make_motion

    clips = []
    for number in range(20):
        performer = draw_performer(number)
        for category in CATEGORIES:
            motion = canonicalise(compute_trajectories(make_motion(category, performer)))
            name = f"{category} {number}"
            clips.append(LabelledClip(name, category, str(number), motion.positions, motion.frame_rate, motion.height))
    return clips


def train_forest(clips: list[LabelledClip]) -> MotionForest:
    """The forest that `dousa train` makes."""
    forest = MotionForest(thresholds=FEATURE_SET.thresholds, random_state=0, n_jobs=2)
    features = np.stack([FEATURE_SET.compute(clip) for clip in clips])
    return forest.fit(features, [clip.category for clip in clips], feature_set=FEATURE_SET)


def make_takes(clips: list[LabelledClip], minutes: float, minutes_each: float = 10.0) -> list[JoinedTake]:
    """Takes of ten minutes, of clips in random order, until there are as many minutes."""
    draw = np.random.default_rng(0)
    mean = float(np.mean([len(clip.positions) / clip.frame_rate for clip in clips])) + 0.4
    takes = []
    for _ in range(max(1, round(minutes / minutes_each))):
        count = max(1, round(min(minutes, minutes_each) * 60 / mean))
        takes.append(join_clips([clips[k] for k in draw.integers(len(clips), size=count)], draw))
    return takes
