"""A labeller learns from single examples."""

from dataclasses import replace

import numpy as np
import pytest

from dousa.errors import InvalidMotionError
from dousa.motion.synthetic.performers import make_library
from dousa.retrieval import LabelledClip, label_take, train_labeller
from dousa.retrieval.takes.labeller_training import Example, teach_labeller
from dousa.retrieval.takes.made_takes import join_clips

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
def labeller(clips):
    """Of the known categories of the first three performers."""
    performers = sorted({clip.performer for clip in clips})[:3]
    return train_labeller([clip for clip in clips if clip.category in KNOWN and clip.performer in performers])


@pytest.fixture(scope="module")
def take(clips):
    """A take of the other two performers with three lunges, and where these are, s."""
    performers = sorted({clip.performer for clip in clips})
    by = {(clip.performer, clip.category): clip for clip in clips}
    fourth, fifth = performers[3], performers[4]
    order = [
        (fourth, "walk"), (fourth, STRANGE), (fourth, "squat"), (fifth, STRANGE), (fourth, "wave_right"),
        (performers[2], STRANGE), (fourth, "jump"),
    ]  # fmt: skip
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


def test_one_example_names_the_similar_stretches(labeller, take):
    joined, lunges = take
    before = label_take(labeller, joined)
    assert STRANGE not in said_at(before, lunges)
    taught = teach_labeller(labeller, [Example(cut(joined, *lunges[0]), STRANGE)])
    assert taught.classes == (*labeller.classes, STRANGE)
    after = label_take(taught, joined)
    assert said_at(after, lunges) == [STRANGE] * 3
    others = [end + 1.5 for _, end in lunges]
    assert [after.category_at(when) for when in others] == [before.category_at(when) for when in others]


def test_an_example_of_a_known_category_adds_none(labeller, take):
    joined, lunges = take
    part = cut(joined, *lunges[0])
    taught = teach_labeller(labeller, [Example(part, "squat")])
    assert taught.classes == labeller.classes
    assert label_take(taught, part).category_at(0.5 * (lunges[0][1] - lunges[0][0])) == "squat"


def test_nothing_to_teach_changes_nothing(labeller, take):
    joined, lunges = take
    short = cut(joined, lunges[0][0], lunges[0][0] + 0.1)
    assert teach_labeller(labeller, []) is labeller
    assert teach_labeller(labeller, [Example(short, STRANGE)]) is labeller


def test_an_example_that_is_no_motion_is_refused(labeller, take):
    joined, lunges = take
    part = cut(joined, *lunges[0])
    with pytest.raises(InvalidMotionError, match=r"finite|NaN"):
        teach_labeller(labeller, [Example(replace(part, positions=part.positions * np.nan), STRANGE)])
