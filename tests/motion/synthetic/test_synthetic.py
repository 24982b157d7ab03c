"""Synthetic motions: the same seeds give the same bodies, and the bodies move as bodies do."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from dousa.errors import OptionError
from dousa.motion import CANONICAL_JOINTS, canonicalise, compute_trajectories, forward_kinematics
from dousa.motion import rotations as rot
from dousa.motion.synthetic.performers import (
    CATEGORIES,
    Performer,
    draw_performer,
    make_library,
    make_motion,
    make_skeleton,
)
from dousa.motion.synthetic.scores import FREEDOMS, SCORES, evaluate_track, parse_score

AIRBORNE = {"jump", "jumping_jack", "run"}
TIPS = [f"{side}_{name}" for side in ("left", "right") for name in ("ankle", "toe", "toe_end")]
PEOPLE = tuple(draw_performer(seed) for seed in (1, 5, 11, 23))


@cache
def _moves(category):
    return [compute_trajectories(make_motion(category, person)) for person in PEOPLE]


def test_there_are_enough_categories():
    assert len(CATEGORIES) >= 16
    assert list(CATEGORIES) == sorted(CATEGORIES)


@pytest.mark.parametrize("category", CATEGORIES)
def test_same_seeds_same_motion_and_other_seeds_other_motion(category):
    first, second = (make_motion(category, draw_performer(3), seed=1) for _ in range(2))
    np.testing.assert_array_equal(first.rotations, second.rotations)
    np.testing.assert_array_equal(first.translations, second.translations)
    for other in (make_motion(category, draw_performer(3), seed=2), make_motion(category, draw_performer(4), 1)):
        assert other.n_frames != first.n_frames or not np.array_equal(other.rotations, first.rotations)


@pytest.mark.parametrize("category", CATEGORIES)
def test_bones_keep_their_lengths_and_values_are_finite(category):
    for moved in _moves(category):
        assert np.isfinite(moved.positions).all()
        children = np.flatnonzero(moved.parents >= 0)
        bones = moved.positions[:, children] - moved.positions[:, moved.parents[children]]
        lengths = np.linalg.norm(bones, axis=2)
        np.testing.assert_allclose(lengths, np.broadcast_to(lengths[0], lengths.shape), atol=1e-9)


@pytest.mark.parametrize("category", CATEGORIES)
def test_feet_stay_near_the_floor_and_never_sink(category):
    for moved in _moves(category):
        lowest = moved.select(TIPS)[..., 1].min(axis=1)
        assert lowest.min() > -0.005
        assert (lowest.max() < 0.4) if category in AIRBORNE else (lowest.max() < 0.03)
        assert np.mean(lowest < 0.03) > 0.35  # even runners and jumpers come down


@pytest.mark.parametrize("category", CATEGORIES)
def test_the_foot_that_carries_does_not_slide(category):
    """In nearly all frames on the ground some point of the feet (almost) stands still."""
    for moved in _moves(category):
        feet = moved.select(TIPS)
        speed = np.linalg.norm(np.diff(feet[..., ::2], axis=0), axis=2).min(axis=1) * moved.frame_rate
        grounded = feet[1:, :, 1].min(axis=1) < 0.02
        # Taking off and landing, and rolling over the ball of the foot, are no sliding.
        assert np.percentile(speed[grounded], 60 if category in AIRBORNE else 85) < 0.6


@pytest.mark.parametrize("category", CATEGORIES)
def test_knees_and_elbows_bend_the_right_way(category):
    for person in PEOPLE:
        motion = make_motion(category, person)
        skeleton = motion.skeleton
        positions, world = forward_kinematics(skeleton.parents, motion.rotations, motion.translations)
        for side in ("left", "right"):
            for upper, middle, tip, sign in (("hip", "knee", "ankle", -1), ("shoulder", "elbow", "wrist", 1)):
                a, b, c = (skeleton.index(f"{side}_{name}") for name in (upper, middle, tip))
                # In the axes of the upper bone, which hangs along -y: the lower one may only swing along z.
                bone = rot.rotate(rot.conjugate(world[:, a]), positions[:, c] - positions[:, b])
                assert (sign * bone[:, 2]).min() > -1e-9
                assert np.abs(bone[:, 0]).max() < 1e-9
                angle = np.degrees(np.arctan2(np.abs(bone[:, 2]), -bone[:, 1]))
                assert angle.max() <= 150.0 + 1e-6


@pytest.mark.parametrize("category", CATEGORIES)
def test_left_is_left_and_the_performer_faces_forward(category):
    for person in PEOPLE:
        motion = make_motion(category, person)
        moved = compute_trajectories(motion)
        first = dict(zip(moved.names, moved.positions[0], strict=True))
        for joint in ("shoulder", "hip"):
            assert first[f"left_{joint}"][0] > first[f"right_{joint}"][0]
        planted = min(("left", "right"), key=lambda side: first[f"{side}_toe"][1])
        assert first[f"{planted}_toe"][2] > first[f"{planted}_ankle"][2]
        assert canonicalise(motion).mapping.sides == "agree"


def test_sided_categories_use_their_side():
    for person in (*PEOPLE, replace(PEOPLE[0], left_handed=True), replace(PEOPLE[0], left_handed=False)):
        for side, other in (("left", "right"), ("right", "left")):
            kick = compute_trajectories(make_motion(f"kick_{side}", person))
            heights = kick.select([f"{side}_ankle", f"{other}_ankle"])[..., 1].max(axis=0)
            assert heights[0] > heights[1] + 0.25
            wave = compute_trajectories(make_motion(f"wave_{side}", person))
            hands = wave.select([f"{side}_hand", f"{other}_hand", f"{side}_shoulder"])[..., 1].max(axis=0)
            assert hands[0] > hands[2] > hands[1]


def test_left_handed_performers_throw_with_the_left():
    for left_handed, side in ((True, "left"), (False, "right")):
        throw = compute_trajectories(make_motion("throw", replace(PEOPLE[0], left_handed=left_handed)))
        reach = throw.select(["left_hand", "right_hand"])[..., 1].max(axis=0)
        assert ("left", "right")[int(reach.argmax())] == side


def test_motions_do_what_their_names_say():
    def played(category):
        return compute_trajectories(make_motion(category, Performer()))

    walk, run = played("walk"), played("run")
    forward = [np.diff(moved.select(["pelvis"])[:, 0, 2]).mean() * 30 for moved in (walk, run)]
    assert 0.6 < forward[0] < 2.0 < forward[1] < 6.0
    march = played("march").select(["pelvis"])[:, 0]
    assert np.linalg.norm(march[-1, ::2] - march[0, ::2]) < 0.6
    turned = played("turn_around")
    across = turned.select(["left_hip"])[:, 0] - turned.select(["right_hip"])[:, 0]
    assert across[0, 0] > 0 > across[-1, 0]
    squat, sit = (played(name).select(["pelvis"])[:, 0, 1] for name in ("squat", "sit_down"))
    assert squat.min() < 0.65 * squat[0]
    assert abs(squat[-1] - squat[0]) < 0.03
    assert sit[-1] < 0.65 * sit[0]
    jump = played("jump")
    assert jump.select(["left_toe", "right_toe"])[..., 1].min(axis=1).max() > 0.15


def test_performers_differ_within_human_bounds():
    people = [draw_performer(seed) for seed in range(200)]
    statures = np.array([person.stature for person in people])
    assert statures.min() >= 1.45
    assert statures.max() <= 1.95
    assert np.ptp([person.tempo for person in people]) > 0.4
    assert 0.15 < np.mean([person.left_handed for person in people]) < 0.45
    assert draw_performer(7) == draw_performer(7) != draw_performer(8)


@pytest.mark.parametrize("seed", range(6))
def test_the_skeleton_stands_upright_on_the_floor(seed):
    person = draw_performer(seed)
    skeleton = make_skeleton(person)
    assert set(CANONICAL_JOINTS) <= set(skeleton.names)
    rest = np.array(skeleton.offsets)
    for joint, parent in enumerate(skeleton.parents):
        if parent >= 0:
            rest[joint] += rest[parent]
    assert rest[skeleton.index("head_end"), 1] == pytest.approx(person.stature, rel=1e-6)
    assert 0 <= rest[:, 1].min() < 0.02
    assert rest[skeleton.index("left_hand"), 0] > 0 > rest[skeleton.index("right_hand"), 0]


@pytest.mark.parametrize("frame_rate", [10.0, 60.0, 120.0])
def test_other_frame_rates_show_the_same_motion(frame_rate):
    usual, other = (make_motion("squat", Performer(), 0, rate) for rate in (30.0, frame_rate))
    assert other.frame_rate == frame_rate
    assert other.duration == pytest.approx(usual.duration, abs=0.2)
    lowest = [motion.translations[:, 0, 1].min() for motion in (usual, other)]
    assert lowest[0] == pytest.approx(lowest[1], abs=0.02)


def test_a_library_holds_every_category_performer_and_take():
    clips = list(make_library(2, 2, seed=4, categories=("walk", "bow")))
    assert [(category, person.name, take) for category, person, take, _ in clips] == [
        (category, f"performer{number:02d}", take)
        for category in ("walk", "bow")
        for number in range(2)
        for take in range(2)
    ]
    again = list(make_library(2, 2, seed=4, categories=("walk", "bow")))
    assert all(np.array_equal(a[3].rotations, b[3].rotations) for a, b in zip(clips, again, strict=True))
    other = next(make_library(1, 1, seed=5, categories=("walk",)))
    assert other[1].stature != clips[0][1].stature


def test_what_cannot_be_made_is_refused():
    with pytest.raises(OptionError, match="expected a synthetic category, got 'fly'"):
        make_motion("fly", Performer())
    with pytest.raises(OptionError, match="frame rate"):
        make_motion("walk", Performer(), frame_rate=0)
    with pytest.raises(OptionError, match="frame rate"):
        make_motion("walk", Performer(), frame_rate=1e9)
    with pytest.raises(OptionError, match="seed"):
        make_motion("walk", Performer(), seed=-1)
    with pytest.raises(OptionError, match="at least one performer"):
        next(make_library(0))


class TestScores:
    def test_curves_go_through_their_keys_and_never_beyond(self):
        for score in SCORES.values():
            for name, (phases, values) in score.tracks.items():
                assert name in FREEDOMS
                periodic = score.kind != "once"
                at_keys = evaluate_track((phases, values), phases[phases < 1], periodic)
                np.testing.assert_allclose(at_keys, values[phases < 1], atol=1e-9)
                between = evaluate_track((phases, values), np.linspace(0, 1, 500), periodic)
                assert between.min() >= values.min() - 1e-9
                assert between.max() <= values.max() + 1e-9

    def test_both_and_alternate_fill_the_two_sides(self):
        score = parse_score("cycle 1.0 x2-3\nboth_elbow 0:10 .5:20\nalternate_thigh 0:30 .25:0")
        assert score.rounds == (2, 3)
        np.testing.assert_array_equal(score.tracks["left_elbow"], score.tracks["right_elbow"])
        np.testing.assert_allclose(score.tracks["right_thigh"], [[0.5, 0.75], [30, 0]])

    def test_mirroring_twice_changes_nothing(self):
        score = SCORES["throw"]
        twice = score.mirrored().mirrored()
        assert twice.tracks.keys() == score.tracks.keys()
        for name, track in score.tracks.items():
            np.testing.assert_array_equal(track, twice.tracks[name])

    @pytest.mark.parametrize("text", ["dance 1.0", "cycle 1.0\nleft_ear 0:1"])
    def test_what_is_no_score_is_refused(self, text):
        with pytest.raises(ValueError, match="expected"):
            parse_score(text)
