"""Reasons: what ablation says word by word, and that what was put into the data is what comes out in words."""

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles import slow_ablation
from oracles.node_tests import decide

from dousa.errors import InvalidMotionError, NotTrainedError, OptionError
from dousa.motion import canonicalise
from dousa.motion.synthetic.performers import draw_performer, make_motion
from dousa.retrieval import FEATURE_NAMES, FEATURE_SETS, Explainer, MotionForest
from dousa.retrieval.explain.explanation import read_questions
from dousa.retrieval.forest.growth import StandingClips, grow_forest

KINDS = ("walk", "clap", "bow", "wave_left")


def clips(seed, n=40, frames=3, features=5, classes=4):
    random = np.random.default_rng(seed)
    categories = random.integers(0, classes, n)
    pose = random.normal(size=(n, frames, features))
    pose += random.normal(size=(classes, 1, features))[categories]
    return pose, categories


def columns_of(forest, relation):
    questions = read_questions(forest)
    return {column for column, channel in enumerate(questions.channels) if channel.relation == relation}


@pytest.fixture(scope="module", params=["paper", "extended"])
def known(request):
    """A forest of made motions on each set of features, with clips that it has not seen."""
    features = FEATURE_SETS[request.param]
    motions = [(kind, canonicalise(make_motion(kind, draw_performer(k)))) for k in range(9) for kind in KINDS]
    pose = np.stack([features.compute(motion) for _, motion in motions])
    categories = np.array([kind for kind, _ in motions])
    durations = [motion.duration for _, motion in motions]
    forest = MotionForest(30, thresholds=features.thresholds, random_state=0)
    forest.fit(pose[:28], categories[:28], feature_set=features)
    return forest, pose[28:], categories[28:].tolist(), durations[28:]


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(2, 40), st.sampled_from([0.0, 0.9]))
def test_votes_without_a_relation_are_those_of_the_walk_word_by_word(seed, n, max_entropy):
    pose, categories = clips(seed, n)
    forest = MotionForest(5, max_entropy=max_entropy, random_state=seed).fit(pose, categories)
    clip = clips(seed + 1)[0][0]
    explainer = Explainer(forest)
    for category in forest.classes_.tolist():
        without = explainer.votes_without(clip, category)
        for relation, vote in without.items():
            slow = slow_ablation.vote_without(forest, clip, category, columns_of(forest, relation))
            assert vote == pytest.approx(slow, abs=1e-12)


def test_the_answers_lead_to_the_leaves_of_the_forest(known):
    forest, pose, _, _ = known
    questions = read_questions(forest)
    for clip in pose:
        above = questions.evaluate(clip) > questions.threshold
        np.testing.assert_array_equal(questions.find_leaves(above), forest.apply(clip[None])[0])
        asked, _ = questions.follow(above, np.ones(len(forest.trees_.roots), bool))
        assert sorted(asked.tolist()) == sorted(decision.node for decision in decide(forest, clip))


def test_every_reason_lowers_the_vote_and_says_by_how_much(known):
    forest, pose, _, durations = known
    explainer = Explainer(forest)
    for clip, duration in zip(pose, durations, strict=True):
        told = explainer.explain(clip, duration, limit=4)
        votes = forest.predict_proba(clip[None])[0]
        assert told.category == forest.predict(clip[None])[0]
        assert told.vote == pytest.approx(votes.max())
        assert 1 <= len(told.reasons) <= 4
        assert len({reason.relation for reason in told.reasons}) == len(told.reasons)
        removed = set()
        for reason in told.reasons:
            own = columns_of(forest, reason.relation)
            slow = slow_ablation.vote_without(forest, clip, told.category, own)
            assert reason.vote_before == told.vote
            assert reason.vote_without == pytest.approx(slow)
            assert reason.vote_without < reason.vote_before
            removed |= own
        all_gone = slow_ablation.vote_without(forest, clip, told.category, removed)
        assert told.vote_without_all == pytest.approx(all_gone)
        assert told.vote_without_all <= told.reasons[0].vote_without
        assert told.reasons[0].vote_without == min(explainer.votes_without(clip).values())


def test_the_numbers_of_a_reason_are_those_of_one_decision(known):
    forest, pose, _, durations = known
    for clip, duration in zip(pose, durations, strict=True):
        decisions = [(d.feature, d.kind, d.threshold, d.value, d.start, d.stop) for d in decide(forest, clip)]
        for reason in Explainer(forest).explain(clip, duration).reasons:
            cells = (round(10 * reason.start / duration), round(10 * reason.end / duration))
            assert any(
                (reason.channel, reason.kind, *cells) == (feature, kind, start, stop)
                and reason.threshold == pytest.approx(threshold)
                and reason.value == pytest.approx(value, abs=1e-9)
                for feature, kind, threshold, value, start, stop in decisions
            )
            assert reason.above == (reason.value > reason.threshold)
            assert 0 <= reason.away <= reason.others


def test_what_was_put_in_comes_out_in_words():
    """Two categories that differ in one thing: the right hand, high in the middle of the one."""
    random = np.random.default_rng(0)
    pose = 0.01 * random.normal(size=(60, 10, 56))
    categories = np.repeat(["rest", "reach"], 30)
    hand = FEATURE_NAMES.index("right hand above pelvis")
    pose[30:, 4:6, hand] += 0.4
    forest = MotionForest(50, n_trials=600, random_state=0).fit(pose, categories)
    told = Explainer(forest).explain(pose[40], duration=2.0)
    assert told.category == "reach"
    assert told.vote == 1.0
    first = told.reasons[0]
    assert first.channel == "right hand above pelvis"
    assert first.above
    assert first.start < 1.0 < first.end
    assert first.vote_without < 0.6
    assert first.away > 0.9 * first.others
    when = f"from {first.start:.1f} s to {first.end:.1f} s"
    assert first.text.render().startswith(f"the right hand is higher than usual {when}: on average {first.value:.2f}")
    assert first.text.render().endswith(f"above the pelvis (most others: less than {first.threshold:.2f})")
    resting = Explainer(forest).explain(pose[0], duration=2.0)
    assert resting.reasons[0].channel == "right hand above pelvis"
    assert not resting.reasons[0].above
    assert resting.reasons[0].text.render().startswith("the right hand is lower than usual from ")


def test_the_second_reason_is_what_the_first_does_not_say():
    """Two channels that say the same and a third one: the third comes second."""
    random = np.random.default_rng(1)
    categories = np.arange(80) % 4
    pose = 0.05 * random.normal(size=(80, 3, 4))
    pose[:, :, 0] += (categories // 2)[:, None]
    pose[:, :, 1] += (categories // 2)[:, None]
    pose[:, :, 2] += (categories % 2)[:, None]
    forest = MotionForest(200, n_trials=24, random_state=0)
    forest.fit(pose, categories, ["one", "the same", "another", "noise"])
    told = Explainer(forest).explain(pose[1], 1.0, limit=2)
    assert {told.reasons[0].channel, told.reasons[1].channel} & {"another"}
    assert {reason.channel for reason in told.reasons} <= {"one", "the same", "another"}


def test_another_category_can_be_explained_and_one_without_votes_has_no_reasons(known):
    forest, pose, _, durations = known
    votes = forest.predict_proba(pose)
    clip, second = np.argwhere((votes > 0) & (votes < votes.max(axis=1, keepdims=True)))[0]
    told = Explainer(forest).explain(pose[clip], durations[clip], forest.classes_[second])
    assert told.vote == pytest.approx(votes[clip, second])
    assert all(reason.vote_without < told.vote for reason in told.reasons)
    clip, none = np.argwhere(votes == 0)[0]
    told = Explainer(forest).explain(pose[clip], durations[clip], forest.classes_[none])
    assert (told.vote, told.reasons, told.vote_without_all) == (0.0, (), 0.0)


def test_what_two_clips_share_is_what_holds_their_leaves_together(known):
    forest, pose, categories, durations = known
    one, other = (k for k, category in enumerate(categories) if category == categories[0])
    told = Explainer(forest).explain_pair(pose[one], pose[other], (durations[one], durations[other]))
    leaves = forest.apply(pose[[one, other]])
    assert told.alike == pytest.approx((leaves[0] == leaves[1]).mean())
    assert told.alike > 0.2
    assert told.reasons
    for reason in told.reasons:
        slow = slow_ablation.alike_without(forest, pose[one], pose[other], columns_of(forest, reason.relation))
        assert reason.alike_without == pytest.approx(slow)
        assert reason.alike_without < reason.alike_before == told.alike
        assert (reason.value > reason.threshold) == (reason.other_value > reason.threshold) == reason.above
        assert reason.start / durations[one] == pytest.approx(reason.other_start / durations[other])


def test_two_clips_without_a_common_leaf_share_nothing():
    pose = np.repeat([0.0, 1.0], 5)[:, None, None] * np.ones((1, 2, 3))
    forest = MotionForest(4, random_state=0).fit(pose, np.repeat(["a", "b"], 5))
    told = Explainer(forest).explain_pair(pose[0], pose[9], (1.0, 1.0))
    assert (told.alike, told.reasons, told.alike_without_all) == (0.0, (), 0.0)


def test_a_forest_that_asks_nothing_gives_no_reasons():
    pose, _ = clips(0, n=5)
    forest = MotionForest(3, random_state=0).fit(pose, ["one"] * 5)
    told = Explainer(forest).explain(pose[0], 1.0)
    assert (told.category, told.vote, told.reasons, told.vote_without_all) == ("one", 1.0, (), 1.0)
    assert Explainer(forest).explain_pair(pose[0], pose[1], (1.0, 1.0)).alike == 1.0


def test_a_forest_that_has_taken_up_a_category_explains_it():
    pose, categories = clips(5, n=60)
    old = categories < 3
    forest = MotionForest(10, random_state=0).fit(pose[old], categories[old])
    standing = StandingClips(categories[old], forest.apply(pose[old]), lambda places: pose[old][places])
    grown = grow_forest(forest, standing, pose[~old][:-1], categories[~old][:-1]).forest
    explainer, clip = Explainer(grown), pose[~old][-2]
    assert explainer.explain(clip, 1.0).category == 3
    for relation, vote in explainer.votes_without(clip, 3).items():
        slow = slow_ablation.vote_without(grown, clip, 3, columns_of(grown, relation))
        assert vote == pytest.approx(slow, abs=1e-12)


def test_categories_as_numbers_and_the_answer_as_json():
    pose, categories = clips(3)
    forest = MotionForest(20, random_state=0).fit(pose, categories)
    told = Explainer(forest).explain(pose[0], 1.5)
    assert isinstance(told.category, int)
    assert Explainer(forest).explain(pose[0], 1.5, category=told.category) == told
    read = json.loads(json.dumps(told.to_json()))
    assert read["reasons"][0]["text"] == str(told.reasons[0].text)


def test_wrong_calls_are_told(known):
    forest, pose, _, _ = known
    with pytest.raises(NotTrainedError):
        Explainer(MotionForest()).explain(pose[0], 1.0)
    with pytest.raises(InvalidMotionError, match="expected finite features of shape"):
        Explainer(forest).explain(pose[0][:, :3], 1.0)
    with pytest.raises(InvalidMotionError, match="NaN or infinity"):
        Explainer(forest).explain(np.full_like(pose[0], np.nan), 1.0)
    with pytest.raises(OptionError, match="knows no category 'swim'"):
        Explainer(forest).explain(pose[0], 1.0, "swim")
    with pytest.raises(OptionError, match="at least one reason"):
        Explainer(forest).explain(pose[0], 1.0, limit=0)
    for duration in (0.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(OptionError, match="expected a duration in s above 0"):
            Explainer(forest).explain(pose[0], duration)
        with pytest.raises(OptionError, match="expected a duration in s above 0"):
            Explainer(forest).explain_pair(pose[0], pose[1], (1.0, duration))
