"""Segments of takes judged as clips: named by votes and labeller together, known where those would be."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from oracles.short_actions import ACTIONS, make_clip, make_library

from dousa.experiments.annotated_takes import cut_segments, learn_clip_judge
from dousa.motion.annotation import Stretch
from dousa.motion.canonical.joints import JOINT_INDEX
from dousa.retrieval.features.posed_motion import AnnotatedTake
from dousa.retrieval.features.sensor_noise import measure_unsteadiness
from dousa.retrieval.forest.evidence import EVIDENCE
from dousa.retrieval.forest.stretches import StretchOpinions, cut_stretch
from dousa.retrieval.takes.label import combine_chances, label_take, make_timeline, weigh_chosen
from dousa.retrieval.takes.labeller_training import train_labeller
from dousa.retrieval.takes.live import LiveLabeller
from dousa.retrieval.takes.made_takes import join_clips
from dousa.retrieval.takes.repetitions import Chosen

STRANGE = ("bow", "kick")
SHOWN = ("spread", "bow", "wave", "kick", "raise left")


# Made when a test asks, once: whoever collects the tests need not wait for them.


@cache
def known_clips():
    return [clip for clip in make_library(range(5), 3) if clip.category not in STRANGE]


@cache
def learned_labeller():
    return train_labeller(known_clips())


@cache
def learned_judge():
    return learn_clip_judge(known_clips(), 0, None)


@cache
def shown_take():
    return join_clips([make_clip(action, 7) for action in SHOWN], np.random.default_rng(3))


def middles():
    return [0.5 * (piece.start + piece.stop) / 30 for piece in shown_take().pieces]


def test_actions_that_nobody_taught_are_unknown():
    timeline = label_take(learned_labeller(), shown_take(), judge=learned_judge())
    assert [timeline.category_at(when) for when in middles()] == ["spread", None, "wave", None, "raise left"]
    assert timeline.threshold == 0.5


def test_live_segments_are_judged_too():
    live = LiveLabeller(learned_labeller(), height=shown_take().height, judge=learned_judge())
    answers = [live.push(pose, k / 30) for k, pose in enumerate(shown_take().positions)]
    settled = [one for answer in (*answers, live.finish()) if answer is not None for one in answer.settled]
    said = [next(one.category for one in settled if one.start <= when < one.stop) for when in middles()]
    assert said == ["spread", None, "wave", None, "raise left"]


def test_a_threshold_is_one_of_what_is_told():
    sure = [
        one.confidence
        for one in label_take(learned_labeller(), shown_take(), judge=learned_judge(), threshold=0).segments
    ]
    said = label_take(learned_labeller(), shown_take(), judge=learned_judge(), threshold=0.9).segments
    assert all(one.confidence >= 0.9 for one in said if one.category)
    assert 0 < sum(one.category is not None for one in said) <= sum(one >= 0.9 for one in sure)


def judge(names, spans, shares=None, judge=None):
    """What is thought of stretches of the take that were found as some categories, and show these unless told."""
    given = np.array([[float(name == one) for one in learned_labeller().classes] for name in names])
    return (judge or learned_judge()).judge(
        shown_take(), spans, names, given if shares is None else np.array(shares), learned_labeller().classes
    )


def span_of(action):
    piece = shown_take().pieces[SHOWN.index(action)]
    return piece.start / 30, piece.stop / 30


def test_a_stretch_is_known_where_the_clip_that_is_cut_out_of_it_is():
    """What `dousa classify` asks of a clip, and the judge of the same frames in a take, is one evidence."""
    spans = [span_of(action) for action in SHOWN]
    seen = judge(["wave"] * len(spans), spans, np.full((len(spans), len(learned_labeller().classes)), 0.2))
    features = np.stack([learned_judge().feature_set.compute(cut_stretch(shown_take(), *span)) for span in spans])
    features = features.astype(np.float32).astype(np.float64)
    as_clips = learned_judge().assessor.assess(learned_judge().assessor.forest.apply(features), features)
    assert seen.names == tuple(learned_judge().assessor.forest.classes_[as_clips.guess])
    assert seen.sure.tolist() == (~as_clips.unknown).tolist() == [True, False, True, False, True]
    np.testing.assert_allclose(seen.typical, as_clips.evidence[:, EVIDENCE.index("typical")])


def test_the_name_is_what_the_votes_and_the_labeller_make_likeliest_together():
    clear, doubtful = span_of("wave"), span_of("bow")
    assert judge(["wave", "spread"], [clear, clear]).names == ("wave", "wave")
    for_spread = []
    for share in (0.0, 0.1, 0.5, 1.0):
        shares = [[share if name == "spread" else (1 - share) / 2 for name in learned_labeller().classes]]
        seen = judge(["wave"], [doubtful], shares)
        for_spread.append(seen.leads[0] * (1 if seen.names == ("spread",) else -1))
    assert for_spread == sorted(for_spread)
    assert for_spread[0] < for_spread[-1]


def test_a_noisy_sensor_makes_bones_unsteady():
    clip = make_clip("wave", 7)
    steady = measure_unsteadiness(clip)
    rough = clip.positions + np.random.default_rng(2).normal(0, 0.03, clip.positions.shape)
    assert measure_unsteadiness(replace(clip, positions=rough)) > 2 * steady
    half = replace(clip, positions=np.where(np.arange(20)[:, None] < 9, clip.positions, np.nan))
    assert 0 <= measure_unsteadiness(half) < 2 * steady + 0.01
    assert measure_unsteadiness(replace(clip, positions=np.full_like(clip.positions, np.nan))) == 0.0
    long = measure_unsteadiness(replace(clip, positions=clip.positions * 3))
    assert long == pytest.approx(steady)


@pytest.mark.parametrize("count", [1, 2, 31])
def test_unsteadiness_is_the_median_spread_of_a_bone(count):
    """By its definition, in plain NumPy; bones of no length, or with an end that is missing, are left out."""
    points = np.random.default_rng(count).normal(size=(count, 20, 3))
    points[:, JOINT_INDEX["left_knee"]] = points[:, JOINT_INDEX["left_hip"]]
    points[-1, JOINT_INDEX["right_elbow"]] = np.nan
    bones = [("shoulder", "elbow"), ("elbow", "hand"), ("hip", "knee"), ("knee", "ankle")]
    ends = [(JOINT_INDEX[f"{side}_{a}"], JOINT_INDEX[f"{side}_{b}"]) for side in ("left", "right") for a, b in bones]
    lengths = [np.linalg.norm(points[:, a] - points[:, b], axis=1) for a, b in ends]
    spreads = [own.std() / np.median(own) for own in lengths if np.isfinite(own).all() and np.median(own) > 0]
    assert len(spreads) == 5
    clip = make_clip("wave", 7)
    assert measure_unsteadiness(replace(clip, positions=points)) == pytest.approx(np.median(spreads), rel=1e-12)


def opinion(*, judged=True, name="wave", lead=2.0, typical=0.0, unsteady=0.02, sure=False, possible=False):
    """Of one stretch."""
    numbers = (np.array([number]) for number in (lead, typical, unsteady, sure, sure or possible))
    return StretchOpinions(np.array([judged]), (name,), *numbers)


def test_all_that_is_seen_moves_the_confidence_that_is_told():
    def chance(placed=1.0, **seen):
        return float(combine_chances(np.array([placed]), opinion(**seen))[0])

    # No name is right where there is nothing, however sure the clips are of it.
    assert chance(0.01, lead=7.0, typical=1.0) < 0.01
    assert chance(0.5) == pytest.approx(0.5 * chance())
    assert chance(lead=6.0) > chance() > chance(lead=-3.0)
    assert chance(typical=0.2) > chance() > chance(typical=-0.3)
    # What is less typical than usual is no stranger where the sensor is noisy.
    assert chance(typical=-0.3) < 0.5 < chance(typical=-0.3, unsteady=0.2)
    assert 0 < chance(lead=-7.0, typical=-2.0) < chance(lead=7.0, typical=1.0) < 1


class _Says:
    """A judge of one opinion."""

    def __init__(self, one):
        self.opinion = one
        self.spans = []

    def judge(self, motion, spans, found, shares, categories, n_jobs=None):
        self.spans = list(spans)
        return self.opinion


def weigh(sure, one):
    """What becomes of a segment of "wave" of which the labeller is so sure."""
    offset, *weights = learned_labeller().calibration
    evidence = np.array(weights) * (np.log(sure / (1 - sure)) - offset) / np.dot(weights, weights)
    chosen = Chosen(0, 60, learned_labeller().classes.index("wave"), evidence)
    return weigh_chosen(learned_labeller(), [chosen], shown_take(), _Says(one))[0]


def test_a_segment_is_named_where_it_is_likely_or_would_be_as_a_clip():
    told = weigh(0.8, opinion(name="spread", lead=5.0))
    assert (learned_labeller().classes[told.category], told.likely) == ("spread", True)
    assert told.confidence > 0.5
    doubtful = opinion(lead=0.0, typical=-0.3)
    assert not weigh(0.3, doubtful).likely
    assert weigh(0.3, replace(doubtful, sure=np.array([True]))).likely


def test_what_a_clip_would_perhaps_be_is_perhaps_in_a_take_too():
    names = learned_labeller().classes
    doubtful = weigh(0.3, opinion(name="spread", lead=0.0, typical=-0.3, possible=True))
    assert (doubtful.likely, doubtful.possible, names[doubtful.category]) == (False, True, "spread")
    strange = weigh(0.3, opinion(lead=0.0, typical=-0.3))
    assert not strange.likely and not strange.possible
    after, last = replace(strange, start=60, stop=120), replace(strange, start=120, stop=180)
    perhaps, unknown = make_timeline([doubtful, after, last], [False] * 3, names, 6.0, 0.5).segments
    assert (perhaps.category, perhaps.guess, perhaps.perhaps, perhaps.start) == (None, "spread", True, 0.0)
    assert perhaps.confidence == doubtful.confidence  # that it is that
    assert (unknown.category, unknown.guess, unknown.perhaps) == (None, None, False)
    assert unknown.confidence == pytest.approx(1 - strange.confidence)  # that it is nothing known; both as one
    (named,) = make_timeline([doubtful], [True], names, 2.0, 0.0).segments
    assert (named.category, named.guess, named.perhaps) == ("spread", None, False)


def test_frames_that_come_live_are_perhaps_something_as_those_of_a_take(monkeypatch):
    says = _Says(opinion(name="spread", lead=0.0, typical=-0.9, possible=True))
    live = LiveLabeller(learned_labeller(), height=shown_take().height, judge=says)
    answers = [live.push(pose, k / 30) for k, pose in enumerate(shown_take().positions)]
    told = [one for one in (*answers, live.finish()) if one is not None]
    settled = [part for one in told for part in one.settled if part.perhaps]
    assert {part.guess for part in settled} == {"spread"} and not any(part.category for part in settled)
    said = [one.to_json() for one in told if one.guess is not None]
    assert {(one["category"], one["unknown"], one["perhaps"], one["guess"]) for one in said} == {
        (None, True, True, "spread")
    }


def test_of_categories_that_a_judge_does_not_know_the_labeller_speaks_alone():
    alone = weigh(0.97, opinion(judged=False, name="spread", lead=6.0, sure=True))
    assert alone.confidence == pytest.approx(0.97)
    assert (learned_labeller().classes[alone.category], alone.likely) == ("wave", True)
    sparing = learned_judge().sparing(frozenset(["wave"]))
    spared = judge(["wave", "spread"], [span_of("wave"), span_of("spread")], judge=sparing)
    assert spared.judged.tolist() == [False, True]
    assert "wave" not in judge(["spread"], [span_of("wave")], judge=sparing).names
    nothing = learned_judge().sparing(frozenset(learned_labeller().classes))
    assert not judge(["wave"], [span_of("wave")], judge=nothing).judged.any()


def test_what_is_repeated_without_a_rest_is_judged_by_its_parts():
    """As a whole, a series is like no clip."""
    parts = ((0, 30), (30, 60), (60, 90))
    whole = Chosen(
        0, 90, learned_labeller().classes.index("wave"), np.zeros(6), shares=np.eye(len(learned_labeller().classes))[0]
    )
    three = StretchOpinions(
        np.ones(3, bool),
        ("wave", "spread", "wave"),
        np.array([3.0, 1.0, 2.0]),
        np.array([0.1, -0.2, 0.4]),
        np.array([0.01, 0.02, 0.03]),
        np.array([True, True, False]),
        np.array([True, True, False]),
    )
    told = _Says(three)
    (weighed,) = weigh_chosen(learned_labeller(), [replace(whole, parts=parts)], shown_take(), told)
    assert learned_labeller().classes[weighed.category] == "wave"
    assert told.spans == [(0.0, 1.0), (1.0, 2.0), (2.0, 3.0)]
    both = opinion(lead=(3.0 - 1.0 + 2.0) / 3, typical=0.1, unsteady=0.02)
    own = learned_labeller().place(np.zeros((1, 6)))
    assert weighed.confidence == pytest.approx(float(combine_chances(own, both)[0]))


def test_of_a_long_series_a_few_parts_are_looked_at():
    parts = tuple((30 * k, 30 * k + 30) for k in range(13))
    chosen = Chosen(0, 390, 0, np.zeros(6), shares=np.eye(len(learned_labeller().classes))[0], parts=parts)
    told = _Says(
        StretchOpinions(
            np.ones(5, bool), (learned_labeller().classes[0],) * 5, *np.zeros((3, 5)), *np.ones((2, 5), bool)
        )
    )
    (weighed,) = weigh_chosen(learned_labeller(), [chosen], shown_take(), told)
    assert weighed.likely
    assert told.spans == [(3.0 * k, 3.0 * k + 1.0) for k in range(5)]


def test_stretches_are_cut_at_the_rate_of_their_recording():
    take = replace(shown_take(), frame_rate=15.0)
    assert len(cut_stretch(take, 1.0, 3.0).positions) == 30
    assert len(cut_stretch(take, 1e6, 1e6).positions) == 1
    made = AnnotatedTake(
        "a", "b", shown_take().positions, 30.0, shown_take().height, (Stretch(0, 1, None), Stretch(1, 2, "wave"))
    )
    assert [(len(clip.positions), clip.category) for clip in cut_segments([made])] == [(30, "wave")]
    assert set(ACTIONS) > set(STRANGE)


def test_threads_change_no_segment():
    long = replace(shown_take(), positions=np.tile(shown_take().positions, (14, 1, 1)))
    timeline = label_take(learned_labeller(), long, judge=learned_judge())
    assert len(timeline.segments) > 32
    assert label_take(learned_labeller(), long, judge=learned_judge(), n_jobs=2) == timeline
