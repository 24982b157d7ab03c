"""An action done with the other hand or foot is told from the mirror image, unless the library tells sides apart."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from oracles.short_actions import ACTIONS, make_clip, make_library

from dousa.experiments.annotated.trial import learn_clip_judge
from dousa.retrieval.takes.label import label_take
from dousa.retrieval.takes.labeller_training import train_labeller
from dousa.retrieval.takes.made_takes import join_clips, mirror_positions
from dousa.retrieval.takes.repetitions import Chosen, lay_mirrored

SHOWN = ("bow", "kick", "spread", "wave")
CLIPS = make_library(range(5), 3)
ONE_SIDED = [clip for clip in CLIPS if clip.category in SHOWN]


@pytest.fixture(scope="module")
def learned():
    return train_labeller(ONE_SIDED), learn_clip_judge(ONE_SIDED, 0, None)


@pytest.fixture(scope="module")
def take():
    """Left-handed."""
    joined = join_clips([make_clip(action, 7) for action in SHOWN], np.random.default_rng(3))
    return replace(joined, positions=mirror_positions(joined.positions))


def test_a_left_handed_person_waves_and_kicks_too(learned, take):
    labeller, judge = learned
    assert not labeller.tells_sides
    segments = label_take(labeller, take, judge=judge).segments
    assert [one.category for one in segments] == list(SHOWN)
    assert {one.category for one in segments if one.mirrored} >= {"kick", "wave"}
    own = replace(take, positions=mirror_positions(take.positions))
    assert not any(one.mirrored for one in label_take(labeller, own, judge=judge).segments)


def test_threads_change_nothing_and_no_moment_is_left_out(learned, take):
    labeller, judge = learned
    long = replace(take, positions=np.tile(take.positions, (16, 1, 1)))
    timeline = label_take(labeller, long, judge=judge, threshold=0.0)
    assert label_take(labeller, long, judge=judge, threshold=0.0, n_jobs=2) == timeline
    assert None not in [one.category for one in timeline.segments]
    assert any(one.mirrored for one in timeline.segments)


def test_where_the_library_tells_sides_apart_the_other_side_is_another_action(take):
    labeller = train_labeller(CLIPS)
    assert {"raise left", "raise right"} < set(ACTIONS)
    assert labeller.tells_sides
    assert not any(one.mirrored for one in label_take(labeller, take, threshold=0.0).segments)


def test_one_category_has_no_counterpart():
    assert not train_labeller([clip for clip in CLIPS if clip.category == "raise left"]).tells_sides


def action(start, stop, category, confidence, *, likely=True):
    return Chosen(start, stop, category, np.ones(1), confidence=confidence, likely=likely)


def test_mirrored_actions_are_laid_over_what_is_less_likely():
    own = [action(0, 60, 0, 0.9), action(60, 120, 1, 0.4, likely=False), action(120, 200, 2, 0.9)]
    laid = lay_mirrored(own, [action(50, 130, 3, 0.98)], 15)
    assert [(one.start, one.stop, one.category, one.mirrored) for one in laid] == [
        (0, 50, 0, False),
        (50, 130, 3, True),
        (130, 200, 2, False),
    ]
    # What would be left of the last is too short.
    laid = lay_mirrored(own, [action(55, 190, 3, 0.99)], 15)
    assert [(one.start, one.stop, one.category) for one in laid] == [(0, 55, 0), (55, 190, 3)]


@pytest.mark.parametrize(
    "mirrored",
    [
        action(60, 120, 3, 0.9),  # more likely than not, but not clearly
        action(60, 120, 3, 0.98, likely=False),
        action(0, 60, 3, 0.96),  # hardly likelier than what is there
        action(0, 60, 0, 0.99),  # the same
    ],
)
def test_else_what_is_there_stays(mirrored):
    own = [action(0, 60, 0, 0.9), action(60, 120, 1, 0.4, likely=False)]
    assert lay_mirrored(own, [mirrored], 15) == own
    assert lay_mirrored([], [], 15) == []
