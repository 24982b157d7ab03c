"""Segments of takes judged as clips: as sure as those, unknown where those would be, overruled where they are surer."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from oracles.short_actions import ACTIONS, make_clip, make_library

from dousa.experiments.annotated.trial import cut_segments, learn_clip_judge
from dousa.motion.annotation import Stretch
from dousa.retrieval.features.posed_motion import AnnotatedTake
from dousa.retrieval.forest.stretches import StretchOpinions, cut_stretch
from dousa.retrieval.takes.label import combine_chances, label_take, weigh_chosen
from dousa.retrieval.takes.labeller_training import train_labeller
from dousa.retrieval.takes.live import LiveLabeller
from dousa.retrieval.takes.made_takes import join_clips
from dousa.retrieval.takes.repetitions import Chosen

STRANGE = ("bow", "kick")
CLIPS = [clip for clip in make_library(range(5), 3) if clip.category not in STRANGE]
LABELLER, JUDGE = train_labeller(CLIPS), learn_clip_judge(CLIPS, 0, None)
SHOWN = ("spread", "bow", "wave", "kick", "raise left")
TAKE = join_clips([make_clip(action, 7) for action in SHOWN], np.random.default_rng(3))
MIDDLES = [0.5 * (piece.start + piece.stop) / 30 for piece in TAKE.pieces]


def test_actions_that_nobody_taught_are_unknown():
    timeline = label_take(LABELLER, TAKE, judge=JUDGE)
    assert [timeline.category_at(when) for when in MIDDLES] == ["spread", None, "wave", None, "raise left"]
    assert timeline.threshold == 0.5


def test_live_segments_are_judged_too():
    live = LiveLabeller(LABELLER, height=TAKE.height, judge=JUDGE)
    answers = [live.push(pose, k / 30) for k, pose in enumerate(TAKE.positions)]
    settled = [one for answer in (*answers, live.finish()) if answer is not None for one in answer.settled]
    said = [next(one.category for one in settled if one.start <= when < one.stop) for when in MIDDLES]
    assert said == ["spread", None, "wave", None, "raise left"]


def test_with_a_threshold_of_nothing_nothing_is_unknown():
    still = replace(TAKE, positions=np.repeat(TAKE.positions[:1], 300, axis=0))
    for take in (TAKE, still):
        assert None not in [one.category for one in label_take(LABELLER, take, judge=JUDGE, threshold=0).segments]


def test_a_threshold_is_one_of_what_is_told():
    sure = [one.confidence for one in label_take(LABELLER, TAKE, judge=JUDGE, threshold=0).segments]
    said = label_take(LABELLER, TAKE, judge=JUDGE, threshold=0.9).segments
    assert all(one.confidence >= 0.9 for one in said if one.category)
    assert 0 < sum(one.category is not None for one in said) <= sum(one >= 0.9 for one in sure)


def test_a_stretch_is_as_sure_as_the_clip_that_is_cut_out_of_it():
    """What `dousa classify` asks of a clip, and the judge of the same frames in a take, give one number."""
    clip = make_clip("wave", 7)
    take = replace(TAKE, positions=np.concatenate([make_clip("spread", 7).positions, clip.positions]))
    start = len(take.positions) - len(clip.positions)
    features = JUDGE.feature_set.compute(clip)[None].astype(np.float32).astype(np.float64)
    as_clip = JUDGE.assessor.assess(JUDGE.assessor.forest.apply(features), features)
    seen = JUDGE.judge(replace(take, height=clip.height), [(start / 30, len(take.positions) / 30)], ["wave"])
    assert seen.guesses == (str(JUDGE.assessor.forest.classes_[as_clip.guess[0]]),) == ("wave",)
    assert seen.chances[0] == seen.guess_chances[0] == pytest.approx(float(as_clip.confidence[0]), abs=1e-12)


def test_what_the_clips_say_moves_the_confidence_that_is_told():
    assert combine_chances(0.9, 0.9) > 0.5 > combine_chances(0.9, 0.05)
    assert combine_chances(0.3, 0.99) > combine_chances(0.3, 0.5)
    assert 0 < combine_chances(0, 0) < combine_chances(1, 1) < 1


class _Says:
    """A judge of one opinion."""

    def __init__(self, *opinion):
        self.opinion = opinion

    def judge(self, motion, spans, categories):
        known, chance, guess, surer = self.opinion
        return StretchOpinions(np.array([known]), np.array([chance]), (guess,), np.array([surer]))


def weigh(sure, *opinion):
    """What becomes of a segment of "wave" of which the labeller is so sure."""
    offset, *weights = LABELLER.calibration
    evidence = np.array(weights) * (np.log(sure / (1 - sure)) - offset) / np.dot(weights, weights)
    chosen = Chosen(0, 60, LABELLER.classes.index("wave"), evidence)
    return weigh_chosen(LABELLER, [chosen], TAKE, _Says(*opinion))[0]


def test_a_category_is_overruled_only_by_a_judge_that_is_surer():
    assert LABELLER.classes[weigh(0.2, True, 0.02, "spread", 0.9).category] == "spread"
    for sure, other in ((0.8, 0.95), (0.2, 0.3)):
        kept = weigh(sure, True, 0.02, "spread", other)
        assert (LABELLER.classes[kept.category], kept.likely) == ("wave", False)
    assert weigh(0.2, True, 0.02, "never heard of", 0.9).category == LABELLER.classes.index("wave")


def test_of_categories_that_a_judge_does_not_know_the_labeller_speaks_alone():
    alone = weigh(0.97, False, 0.0, "spread", 0.99)
    assert alone.confidence == pytest.approx(0.97)
    assert (LABELLER.classes[alone.category], alone.likely) == ("wave", True)
    spared = JUDGE.sparing(frozenset(["wave"])).judge(TAKE, [(0.0, 2.0)], ["wave"])
    assert not spared.judged[0]


def test_stretches_are_cut_at_the_rate_of_their_recording():
    take = replace(TAKE, frame_rate=15.0)
    assert len(cut_stretch(take, 1.0, 3.0).positions) == 30
    assert len(cut_stretch(take, 1e6, 1e6).positions) == 1
    made = AnnotatedTake("a", "b", TAKE.positions, 30.0, TAKE.height, (Stretch(0, 1, None), Stretch(1, 2, "wave")))
    assert [(len(clip.positions), clip.category) for clip in cut_segments([made])] == [(30, "wave")]
    assert set(ACTIONS) > set(STRANGE)
