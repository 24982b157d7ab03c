"""A labeller learns from single examples, and follows its forest when that grows."""

from __future__ import annotations

import numpy as np
import pytest

from dousa.errors import InvalidMotionError
from dousa.motion.synthetic.performers import make_library
from dousa.retrieval import LabelledClip, MotionForest, get_feature_set, label_take, train_labeller
from dousa.retrieval.forest.growth import StandingClips, grow_forest
from dousa.retrieval.takes.labeller_training import Example, carry_labeller, teach_labeller
from dousa.retrieval.takes.leaf_weights import join_clips
from dousa.retrieval.takes.windows import describe_take

KNOWN = ("squat", "wave_right", "walk", "jump")
STRANGE = "lunge"


@pytest.fixture(scope="module")
def clips():
    """Clips of five performers in five categories."""
    from dousa.motion import canonicalise

    found = []
    for category, performer, _, moving in make_library(5, categories=(*KNOWN, STRANGE)):
        motion = canonicalise(moving)
        name = performer.name
        found.append(
            LabelledClip(f"{name}_{category}", category, name, motion.positions, motion.frame_rate, motion.height)
        )
    return found


@pytest.fixture(scope="module")
def trained(clips):
    """Feature set, features, forest and labeller of the known categories of the first three performers."""
    kind = get_feature_set("extended")
    performers = sorted({clip.performer for clip in clips})[:3]
    known = [clip for clip in clips if clip.category in KNOWN and clip.performer in performers]
    features = np.stack([kind.compute(clip) for clip in known])
    forest = MotionForest(n_trees=40, random_state=0)
    forest.fit(features, [clip.category for clip in known], feature_set=kind)
    return kind, known, features, forest, train_labeller(forest, kind, known, features=features)


@pytest.fixture(scope="module")
def take(clips):
    """A take of the other two performers with three lunges, and where these are, s."""
    performers = sorted({clip.performer for clip in clips})
    by = {(clip.performer, clip.category): clip for clip in clips}
    fourth, fifth = performers[3], performers[4]
    order = [
        (fourth, "walk"),
        (fourth, STRANGE),
        (fourth, "squat"),
        (fifth, STRANGE),
        (fourth, "wave_right"),
        (performers[2], STRANGE),
        (fourth, "jump"),
    ]
    joined = join_clips([by[one] for one in order], np.random.default_rng(0))
    rate = joined.frame_rate
    return joined, [(piece.start / rate, piece.stop / rate) for piece in joined.pieces if piece.category == STRANGE]


def cut(joined, start, end):
    """A part of a joined take as a clip of its own."""
    first, last = round(start * joined.frame_rate), round(end * joined.frame_rate)
    return LabelledClip("part", STRANGE, None, joined.positions[first:last], joined.frame_rate, joined.height)


def said_at(timeline, spans):
    """Category in the middle of each part."""
    return [timeline.category_at(0.5 * (start + end)) for start, end in spans]


def test_one_example_names_the_similar_stretches(trained, take):
    kind, _, features, forest, labeller = trained
    joined, lunges = take
    windows = describe_take(forest, kind, joined, labeller.grid)
    before = label_take(labeller, windows)
    assert STRANGE not in said_at(before, lunges)
    part = cut(joined, *lunges[0])
    taught = teach_labeller(
        labeller, [Example(describe_take(forest, kind, part, labeller.grid), STRANGE)], forest.apply(features)
    )
    after = label_take(taught, windows)
    assert said_at(after, lunges) == [STRANGE] * 3
    others = [end + 1.5 for _, end in lunges]
    assert [after.category_at(when) for when in others] == [before.category_at(when) for when in others]


def test_nothing_to_teach_changes_nothing(trained, take):
    kind, _, _, forest, labeller = trained
    joined, lunges = take
    short = cut(joined, lunges[0][0], lunges[0][0] + 0.1)
    example = Example(describe_take(forest, kind, short, labeller.grid), STRANGE)
    assert teach_labeller(labeller, []) is labeller
    assert teach_labeller(labeller, [example]) is labeller


def test_an_example_of_another_forest_is_refused(trained, take):
    kind, known, features, _, labeller = trained
    joined, lunges = take
    other = MotionForest(n_trees=10, random_state=1)
    other.fit(features, [clip.category for clip in known], feature_set=kind)
    part = describe_take(other, kind, cut(joined, *lunges[0]), labeller.grid)
    with pytest.raises(InvalidMotionError, match="another forest"):
        teach_labeller(labeller, [Example(part, STRANGE)])


def test_a_grown_forest_keeps_what_its_labeller_knew(trained, take):
    """A leaf that became a small tree says what it said, in all its new leaves: every score stays."""
    kind, known, features, forest, labeller = trained
    joined, lunges = take
    standing = StandingClips([clip.category for clip in known], forest.apply(features), lambda rows: features[rows])
    new = kind.compute(cut(joined, *lunges[0]))[None]
    grown = grow_forest(forest, standing, new, [STRANGE], feature_set=kind).forest
    assert grown.trees_.n_leaves > forest.trees_.n_leaves
    carried = carry_labeller(labeller, forest.trees_, grown.trees_)
    old = describe_take(forest, kind, joined, labeller.grid)
    now = describe_take(grown, kind, joined, labeller.grid)
    assert (old.leaves != now.leaves).any()
    np.testing.assert_array_equal(carried.score(now.leaves), labeller.score(old.leaves))
