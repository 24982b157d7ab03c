"""Repetitions of a movement: made ones are counted and found, whatever the rate, the heading and the rests."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from oracles.standing import standing

from dousa.errors import InvalidMotionError
from dousa.motion import CanonicalMotion, canonicalise, compute_trajectories, count_repetitions
from dousa.motion.canonical.canonicalise import mirror_positions
from dousa.motion.canonical.joints import JOINT_INDEX
from dousa.motion.repetitions import count_crossings, fold_poses
from dousa.motion.synthetic import Performer, make_motion

BODY = canonicalise(compute_trajectories(make_motion("squat", Performer(), 0)))
SIDES = ("left", "right")


def raise_arms(times, seconds=1.2, rest=0.0, noise=0.0, fading=1.0, in_turn=False, rate=30.0) -> CanonicalMotion:
    """Hands up and down, with rests between."""
    draw = np.random.default_rng(times)
    up = 0.5 * (1.0 - np.cos(np.linspace(0.0, 2.0 * np.pi, round(seconds * rate), endpoint=False)))
    once = np.concatenate([up, np.zeros(round(rest * rate))])
    body = np.repeat(standing(), times * len(once), axis=0)
    for number in range(times):
        part = body[number * len(once) : (number + 1) * len(once)]
        for side in (SIDES[number % 2],) if in_turn else SIDES:
            for joint, share in (("elbow", 0.5), ("wrist", 0.9), ("hand", 1.0)):
                part[:, JOINT_INDEX[f"{side}_{joint}"], 1] += share * once * fading**number
    return replace(BODY, positions=body + noise * draw.normal(size=body.shape), frame_rate=rate, missing=None)


@pytest.mark.parametrize("times", [1, 2, 5, 12])
@pytest.mark.parametrize(
    "how", [{}, {"rest": 0.8}, {"noise": 0.03}, {"in_turn": True}, {"rate": 120.0}, {"seconds": 3.0}], ids=str
)
def test_made_repetitions_are_counted(times, how):
    assert count_repetitions(raise_arms(times, **how)).count == times


def test_each_is_found_where_it_is_and_a_clear_count_is_certain():
    found = count_repetitions(raise_arms(4, seconds=1.0, rest=1.0))
    np.testing.assert_allclose(found.spans, [(2.0 * k, 2.0 * k + 1.0) for k in range(4)], atol=0.25)
    assert (found.certainty, found.duration) == (1.0, 8.0)
    assert count_repetitions(raise_arms(8, fading=0.8)).certainty < 1.0


def test_who_stands_still_repeats_nothing():
    body = np.repeat(standing(), 300, axis=0)
    swaying = body + 0.003 * np.random.default_rng(0).normal(size=body.shape)
    for positions in (body, swaying, body[:1]):
        assert count_repetitions(replace(BODY, positions=positions, missing=None)).spans == ()


def test_what_drifts_slowly_is_no_repetition():
    motion = raise_arms(20)
    slope = np.linspace(0.0, 1.0, motion.n_frames)[:, None]
    positions = motion.positions.copy()
    for side in SIDES:
        positions[:, JOINT_INDEX[f"{side}_hand"]] += slope * [0.0, 0.0, 1.5]
    assert count_repetitions(replace(motion, positions=positions)).count == 20


@given(st.floats(-3.1, 3.1), st.floats(-5.0, 5.0))
def test_heading_place_and_side_do_not_matter(angle, away):
    motion = raise_arms(3, in_turn=True)
    cosine, sine = np.cos(angle), np.sin(angle)
    turn = np.array([[cosine, 0.0, -sine], [0.0, 1.0, 0.0], [sine, 0.0, cosine]])
    expected = fold_poses(motion.positions, 30.0)
    for positions in (motion.positions @ turn + away, mirror_positions(motion.positions)):
        np.testing.assert_allclose(fold_poses(positions, 30.0), expected, atol=1e-9)


def test_a_gap_is_filled_and_a_limb_that_is_never_seen_is_left_out():
    motion = raise_arms(5)
    positions = motion.positions.copy()
    positions[20:24] = np.nan
    positions[:, JOINT_INDEX["left_knee"]] = np.nan
    assert count_repetitions(replace(motion, positions=positions)).count == 5


def test_crossings_need_the_share_of_the_range():
    curve = np.array([0.0, 1.0, 0.4, 0.6, 0.0, 1.0, 0.0])
    assert [count_crossings(curve, share) for share in (0.0, 0.05, 0.3)] == [3, 3, 2]
    assert count_crossings(np.zeros(5)) == 0


@pytest.mark.parametrize("positions", [np.zeros((0, 20, 3)), np.zeros((3, 4, 3)), np.full((3, 20, 3), np.inf)])
def test_no_body_is_refused(positions):
    with pytest.raises(InvalidMotionError):
        count_repetitions(replace(BODY, positions=positions, missing=None))
