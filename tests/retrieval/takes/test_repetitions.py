"""What is repeated in a take is one action that says how often, and mirrored actions are told from mirror images."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from oracles.short_actions import ACTIONS, make_clip, make_library

from dousa.experiments.annotated_takes import learn_clip_judge
from dousa.motion.canonical.canonicalise import mirror_positions
from dousa.retrieval.takes.label import label_take
from dousa.retrieval.takes.labeller_training import train_labeller
from dousa.retrieval.takes.made_takes import join_clips
from dousa.retrieval.takes.repetitions import Chosen, count_all, divide_cycles, find_phases, lay_mirrored

EVIDENCE = np.ones(1)
BOWS = [make_clip("bow", 1, trial) for trial in range(3)]


def list_parts(joined, apart=0):
    """The pieces as a labeller would give them, each a little too short."""
    return [Chosen(round(one.start), round(one.stop) - apart, 0, EVIDENCE) for one in joined.pieces]


def test_three_neighbours_are_one_action_repeated_with_or_without_rests():
    joined = join_clips(BOWS, np.random.default_rng(0))
    for apart in (0, 20):
        (one,) = count_all(list_parts(joined, apart), joined.positions)
        assert (one.start, one.repetitions) == (0, 3)
        assert one.stop == len(joined.positions) - apart


def test_two_neighbours_and_others_in_between_stay_apart():
    joined = join_clips(BOWS, np.random.default_rng(0))
    parts = list_parts(joined)
    assert [one.repetitions for one in count_all(parts[:2], joined.positions)] == [1, 1]
    parts[1] = replace(parts[1], category=1)
    found = count_all(parts, joined.positions)
    assert [(one.start, one.category, one.repetitions) for one in found] == [
        (one.start, one.category, 1) for one in parts
    ]


def test_one_that_is_twice_as_long_as_usual_and_one_more_are_a_series():
    joined = join_clips(BOWS, np.random.default_rng(0))
    first, second, third = list_parts(joined)
    longer = replace(first, stop=second.stop, parts=((first.start, first.stop), (second.start, second.stop)))
    (one,) = count_all([longer, third], joined.positions)
    assert (one.start, one.stop, one.repetitions) == (0, third.stop, 3)
    # By itself it is what it was, and two that are no longer than usual are two.
    assert count_all([longer], joined.positions)[0].parts == longer.parts
    assert len(count_all([replace(longer, parts=()), third], joined.positions)) == 2


def test_a_long_rest_parts_what_is_repeated():
    still = np.repeat(BOWS[0].positions[-1:], 120, axis=0)
    pieces = [BOWS[0].positions, still, BOWS[1].positions, still, BOWS[2].positions]
    edges = np.cumsum([0, *map(len, pieces)]).tolist()
    parts = [Chosen(*span, 0, EVIDENCE) for span in list(pairwise(edges))[::2]]
    assert [one.repetitions for one in count_all(parts, np.concatenate(pieces))] == [1, 1, 1]


def test_what_is_unlikely_parts_no_series_unless_it_lasts():
    joined = join_clips(BOWS, np.random.default_rng(0))
    first, second, third = list_parts(joined, apart=24)
    slip = Chosen(first.stop + 2, second.start, 1, EVIDENCE, likely=False)
    (one,) = count_all([first, slip, second, third], joined.positions)
    assert (one.start, one.stop, one.category, one.repetitions) == (0, third.stop, 0, 3)
    for between in (replace(slip, likely=True), replace(slip, start=first.stop - 30)):
        shorter = replace(first, stop=min(first.stop, between.start))
        assert len(count_all([shorter, between, second, third], joined.positions)) == 4
    # Two are no series, and what lies between them stays.
    found = count_all([first, slip, second], joined.positions)
    assert [one.category for one in found] == [0, 1, 0]


def test_a_series_is_as_sure_as_its_surest_part():
    joined = join_clips(BOWS, np.random.default_rng(0))
    first, second, third = list_parts(joined)
    parts = [
        replace(first, confidence=0.3, likely=False),
        replace(second, confidence=0.9, mirrored=True),
        replace(third, confidence=0.95, likely=False),
    ]
    (one,) = count_all(parts, joined.positions)
    assert (one.start, one.stop, one.repetitions) == (0, third.stop, 3)
    assert (one.likely, one.confidence, one.mirrored) == (True, 0.9, True)
    (one,) = count_all([replace(part, likely=False) for part in parts], joined.positions)
    assert (one.likely, one.confidence, one.possible) == (False, 0.95, False)
    # Which part it is as sure of has no say in whether any is perhaps that.
    doubtful = [replace(part, likely=False, possible=part is parts[0]) for part in parts]
    (one,) = count_all(doubtful, joined.positions)
    assert (one.likely, one.confidence, one.possible) == (False, 0.95, True)


@pytest.fixture(scope="module")
def labeller():
    actions = ("bow", "kick", "spread", "wave")
    return train_labeller([make_clip(name, person, k) for name in actions for person in range(4) for k in range(2)])


def test_a_labeller_knows_what_one_repetition_is(labeller):
    assert labeller.phases[labeller.classes.index("bow")] == 1
    take = join_clips(
        [make_clip(name, 5, k) for name in ("kick", "bow", "spread") for k in range(4)], np.random.default_rng(1)
    )
    said = label_take(labeller, take, threshold=0.0).segments
    assert [(one.category, one.repetitions) for one in said] == [("kick", 4), ("bow", 4), ("spread", 4)]


def test_left_and_right_are_one_repetition_where_most_clips_show_two_cycles():
    assert [find_phases(counts) for counts in ([2, 2, 2, 3], [2, 2, 3, 3], [3, 3, 3], [])] == [2, 1, 1, 1]
    assert [divide_cycles(cycles, 2) for cycles in (1, 2, 3, 4, 9)] == [1, 1, 2, 2, 5]


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
