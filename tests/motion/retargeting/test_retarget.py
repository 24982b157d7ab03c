"""Motions on other skeletons: directions, feet, timing, and back again."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dousa.errors import JointMappingError
from dousa.evaluation import advise, assess
from dousa.formats import read_character
from dousa.formats.registry import read_motion, write_motion
from dousa.motion import Motion, Skeleton, Trajectories, canonicalise, compute_trajectories, retarget
from dousa.motion.canonical.joints import JOINT_INDEX
from dousa.motion.kinematics import forward_kinematics
from dousa.motion.retargeting import find_contacts, measure_directions, measure_skating
from dousa.motion.retargeting.planting import Foot, bend, plan_foot, stand
from dousa.motion.retargeting.rig import LIMB_NAMES, build_rig
from dousa.motion.rotations import conjugate, multiply, rotate
from dousa.motion.runs import find_runs
from dousa.motion.synthetic import draw_performer, make_motion

CHARACTERS = {
    "mixamo": "mixamo_ganimator/Walk-In-Circle.bvh",
    "cmu": "pybvh/cmu_12_01_walk.bvh",
    "xia": "xia_deepmotionediting/neutral_16_000.bvh",
    "accad": "acclaim_male1_accad/Male1_B14_WalkTurnRight135.bvh",  # its rest pose is nobody's
    "smpl": "unsupported/amass_sample.npz",
}


def directions(source, made):
    """(T, 8) degrees between the limbs of a motion and those of its copy on another skeleton."""
    rig = build_rig(made, canonicalise(made))
    return np.degrees(measure_directions(canonicalise(source), compute_trajectories(made).positions, rig.joints))


def test_onto_itself_nothing_changes():
    motion = make_motion("walk", draw_performer(1))
    made = retarget(motion, motion, plant_feet=False)
    assert made.scale == pytest.approx(1)
    places, expected = (compute_trajectories(m).positions for m in (made.motion, motion))
    np.testing.assert_allclose(places, expected, atol=1e-3)  # the neck shares the turn of the head
    assert made.motion.frame_rate == motion.frame_rate


@pytest.mark.parametrize("category", ["walk", "squat", "jump", "clap", "bow"])
def test_directions_are_kept_and_feet_stand(category):
    motion, character = make_motion(category, draw_performer(1)), make_motion("bow", draw_performer(7))
    plain = retarget(motion, character, plant_feet=False)
    assert directions(motion, plain.motion).max() < 1e-4
    made = retarget(motion, character)
    assert made.contacts.any()
    assert made.skating < 0.01
    assert made.skating <= plain.skating + 1e-9
    assert directions(motion, made.motion).mean() < 5
    # The arms have no reason to change.
    np.testing.assert_allclose(directions(motion, made.motion)[:, [0, 1, 4, 5]], 0, atol=1e-4)
    assert made.motion.n_frames == motion.n_frames


@pytest.mark.parametrize("name", sorted(CHARACTERS))
@pytest.mark.parametrize("other", ["mixamo", "accad"])
def test_characters_of_others(shared_data, name, other):
    character = read_motion(shared_data(f"foreign/{CHARACTERS[name]}"))
    source = read_motion(shared_data(f"foreign/{CHARACTERS[other]}"))
    made = retarget(source, character)
    assert made.skating < 0.01
    assert np.degrees(made.direction_error) < 3.5
    assert made.motion.skeleton is character.skeleton
    assert made.motion.frame_rate == source.frame_rate
    # Nobody stands on the head, or with the back to the front.
    assert canonicalise(made.motion).mapping.sides in ("agree", canonicalise(character).mapping.sides)
    # There and back: limbs point where they did.
    there = retarget(source, character, plant_feet=False).motion
    back = retarget(there, source, plant_feet=False)
    assert np.degrees(back.direction_error) < 0.1
    assert directions(source, back.motion).max() < 3


def test_there_and_back_the_joints_turn_as_they_did(shared_data):
    """Both rest poses are people's: then the roll of the limbs comes back too, not just where they point."""
    source = read_motion(shared_data(f"foreign/{CHARACTERS['mixamo']}"))
    character = read_motion(shared_data(f"foreign/{CHARACTERS['xia']}"))
    there = retarget(source, character, plant_feet=False).motion
    back = retarget(there, source, plant_feet=False).motion
    rig = build_rig(source, canonicalise(source))
    limbs = [rig.joints[f"{side}_{j}"] for side in ("left", "right") for j in ("elbow", "knee")]
    cosine = np.abs((source.rotations[:, limbs] * back.rotations[:, limbs]).sum(axis=2))
    assert np.degrees(2 * np.arccos(np.clip(cosine, 0, 1))).max() < 3


def test_positions_onto_a_character(shared_data):
    character = read_motion(shared_data(f"foreign/{CHARACTERS['mixamo']}"))
    walk = canonicalise(make_motion("walk", draw_performer(2))).to_trajectories()
    made = retarget(Trajectories(walk.names, walk.positions, walk.frame_rate), character)
    assert made.skating < 0.01
    assert np.degrees(made.direction_error) < 5


def test_the_file_is_the_character_s(tmp_path, shared_data):
    source = shared_data(f"foreign/{CHARACTERS['xia']}")
    made = retarget(make_motion("walk", draw_performer(2)), read_character(source))
    write_motion(made.motion, tmp_path / "x.bvh")
    ours, theirs = ((tmp_path / "x.bvh").read_text(), source.read_text())
    for word in ("ROOT", "JOINT", "CHANNELS"):
        lines = [[line.split() for line in text.splitlines() if line.split()[:1] == [word]] for text in (ours, theirs)]
        assert lines[0] == lines[1]
    again = read_motion(tmp_path / "x.bvh", unit=made.motion.provenance.unit, up=made.motion.provenance.up)
    expected = compute_trajectories(made.motion).positions
    np.testing.assert_allclose(compute_trajectories(again).positions, expected, atol=1e-6)


def test_into_somebody_s_mesh(tmp_path, shared_data):
    character = read_character(shared_data("foreign/unsupported/mixamo.glb"))
    motion = make_motion("clap", draw_performer(2))
    write_motion(retarget(motion, character).motion, tmp_path / "x.glb")
    again = read_motion(tmp_path / "x.glb")
    assert directions(motion, again).mean() < 5
    assert directions(motion, again)[:, [0, 1, 4, 5]].max() < 0.1


def test_amass_of_anybody(tmp_path):
    motion = make_motion("squat", draw_performer(4))
    write_motion(motion, tmp_path / "x.amass.npz")
    again = read_motion(tmp_path / "x.amass.npz")
    assert again.frame_rate == motion.frame_rate
    assert directions(motion, again)[:, [0, 1, 4, 5]].max() < 0.1


def test_hands_reach_what_they_reached():
    """The distance between the hands of somebody who claps grows with the legs, and with nothing else."""
    motion, character = make_motion("clap", draw_performer(1)), make_motion("clap", draw_performer(9))
    made = retarget(motion, character, keep_reach=True)
    first, second = (canonicalise(m) for m in (motion, made.motion))
    hands = [first.to_trajectories().names.index(f"{side}_wrist") for side in ("left", "right")]
    gaps = [np.linalg.norm(c.positions[:, hands[0]] - c.positions[:, hands[1]], axis=1) for c in (first, second)]
    np.testing.assert_allclose(gaps[1], made.scale * gaps[0], atol=0.02)


def test_what_is_no_body_is_refused():
    skeleton = Skeleton(("a", "b"), [-1, 0], [[0, 0, 0], [0, 1, 0]])
    stick = Motion(skeleton, np.tile([1.0, 0, 0, 0], (2, 2, 1)), np.tile(skeleton.offsets, (2, 1, 1)), 30.0)
    body = make_motion("walk", draw_performer(1))
    for source, character in ((stick, body), (body, stick)):
        with pytest.raises(JointMappingError):
            retarget(source, character)


@settings(deadline=None, max_examples=50)
@given(seed=st.integers(0, 2**31))
def test_bending_reaches_and_keeps_lengths(seed):
    rng = np.random.default_rng(seed)
    root, middle, end = rng.normal(size=(3, 20, 3))
    upper, lower = np.linalg.norm(middle - root, axis=1), np.linalg.norm(end - middle, axis=1)
    direction = rng.normal(size=(20, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    inside = np.abs(upper - lower) * 1.01 + rng.uniform(size=20) * 0.99 * (upper + lower - np.abs(upper - lower) * 1.02)
    wanted = root + inside[:, None] * direction
    first, second = bend(root, middle, end, wanted, rng.normal(size=(20, 3)))
    knee = root + rotate(first, middle - root)
    reached = knee + rotate(second, end - middle)
    np.testing.assert_allclose(reached, wanted, atol=1e-6)
    far = bend(root, middle, end, root + 100 * direction, direction)
    stretched = rotate(far[0], middle - root) + rotate(far[1], end - middle)
    np.testing.assert_allclose(np.linalg.norm(stretched, axis=1), upper + lower, rtol=1e-3)


def test_a_straight_leg_bends_to_the_front():
    root, middle, end = (np.array([[0.0, y, 0.0]]) for y in (1.0, 0.5, 0.0))
    first, _ = bend(root, middle, end, np.array([[0.0, 0.2, 0.0]]), np.array([[0.0, 0.0, 1.0]]))
    assert rotate(first, middle - root)[0, 2] > 0.2


def roll(length):
    """A foot (T, 3) m, ankle and toe, at 60 Hz: it stands, rolls over its toe, swings, and stands again."""
    rise = np.interp(np.arange(120), [40, 70, 90], [0.0, 1.0, 0.0])
    forward = np.interp(np.arange(120), [70, 90], [0.0, 0.5])
    toe = np.stack((0 * rise, 0.02 + np.interp(np.arange(120), [70, 80, 90], [0, 0.1, 0]), forward), axis=1)
    back = np.stack((0 * rise, np.sin(0.4 + rise), -np.cos(0.4 + rise)), axis=1)
    return toe + length * back, toe


@pytest.mark.parametrize("longer", [0.7, 1.0, 1.6])
def test_a_foot_rolls_over_its_own_toe(longer):
    """The source's toe stands still while its heel rises, so does the character's, whose foot is longer or shorter."""
    rng = np.random.default_rng(0)
    ankle, toe = roll(0.15)
    drift = np.cumsum(rng.normal(size=(120, 3)), axis=0) * 0.003  # a walk on legs of other proportions
    made = ankle + drift, ankle + drift + longer * (toe - ankle)
    plan = plan_foot(Foot(ankle, toe, (0.08, 0.02)), Foot(*made, (longer * 0.08, 0.02)), 1.0, 0.0, 60.0, 1.0)
    moved = made[0] + plan.moves
    tip = moved + rotate(plan.turns, made[1] - made[0])
    for still in (slice(0, 66), slice(94, 120)):
        assert np.linalg.norm(tip[still] - np.median(tip[still], axis=0), axis=1).max() < 0.005
    assert np.linalg.norm(moved[:38] - np.median(moved[:38], axis=0), axis=1).max() < 0.005
    np.testing.assert_allclose(tip[:60, 1], 0.02, atol=0.01)
    # In the air no leap: it changes little from frame to frame.
    assert np.abs(np.diff(plan.moves[66:94], axis=0)).max() < 0.03


@pytest.mark.parametrize(("higher", "wanted"), [(0.3, 0.3), (0.1, 0.1), (0.02, 0.0), (-0.02, 0.0)])
def test_a_foot_stands_on_a_step_or_on_the_floor_and_not_between(higher, wanted):
    ankle, toe = (points + np.array([0.0, higher, 0.0]) for points in roll(0.15))
    plan = plan_foot(Foot(ankle, toe, (0.08, 0.02)), Foot(ankle, toe, (0.08, 0.02)), 1.0, 0.0, 60.0, 1.0)
    np.testing.assert_allclose(toe[:38, 1] + plan.moves[:38, 1], 0.02 + wanted, atol=0.006)


def test_feet_are_flat_where_the_source_s_are(shared_data):
    """The right foot of this skeleton lies sole up in its rest pose; on a character it stands on its sole."""
    source = read_motion(shared_data("hdm05/kickLFront1Reps/HDM_bd_kickLFront1Reps_005_120.amc"))
    character = read_character(shared_data("foreign/unsupported/mixamo.glb"))
    made = retarget(source, character)
    rig = build_rig(character, canonicalise(character))
    places = compute_trajectories(made.motion).positions
    _, world = forward_kinematics(rig.parents, made.motion.rotations, made.motion.translations)
    for column, side in enumerate(("left", "right")):
        ankle, toe = (rig.joints[f"{side}_{joint}"] for joint in ("ankle", "toe"))
        since = multiply(world[:, ankle], conjugate(rig.world[ankle]))
        up = rotate(since, rotate(rig.body, np.array([0.0, 1.0, 0.0])))[made.contacts[:, column], 1]
        assert np.median(up) > 0.9
        assert (places[made.contacts[:, column], ankle, 1] > places[made.contacts[:, column], toe, 1]).all()


def legs(bent):
    """Hips and ankles (60, 2, 3) m of legs with bones of half a metre, and the bones; bent (2,) rad."""
    hips = np.tile([[0.1, 1.0, 0.0], [-0.1, 1.0, 0.0]], (60, 1, 1))
    ankles = hips.copy()
    ankles[..., 1] -= np.cos(np.asarray(bent) / 2)
    return hips, ankles, np.full((60, 2, 2), 0.5)


def test_what_both_feet_need_the_body_does():
    hips, ankles, bones = legs([0.2, 0.9])
    moves = np.ones((60, 2, 3)) * [0.1, -0.2, 0.3]
    body, reached = stand(hips, ankles, bones, moves, np.ones((60, 2)), 60.0)
    np.testing.assert_allclose(body, moves[:, 0], atol=1e-6)
    np.testing.assert_allclose(reached, moves, atol=1e-6)


def test_the_body_follows_the_straighter_leg_along_it():
    """A slip of a centimetre on one foot: a bent knee takes it up, a straight one stays as it is."""
    hips, ankles, bones = legs([0.1, 1.0])
    moves = np.zeros((60, 2, 3))
    moves[:, 0, 1] = 0.01
    body, reached = stand(hips, ankles, bones, moves, np.ones((60, 2)), 60.0)
    assert (body[:, 1] > 0.009).all()
    assert np.abs(reached - moves).max() < 0.001


def test_the_body_goes_down_where_a_foot_is_out_of_reach():
    hips, ankles, bones = legs([0.1, 0.1])
    moves, weights = np.zeros((60, 2, 3)), np.ones((60, 2))
    moves[20:40, 0, 0] = 0.6
    body, _ = stand(hips, ankles, bones, moves, weights, 60.0)
    assert -0.25 < body[30, 1] < -0.03
    assert np.abs(np.diff(body[:, 1])).max() < 0.1
    weights[:, 0] = 0.0  # not reached for
    assert abs(stand(hips, ankles, bones, moves, weights, 60.0)[0][30, 1]) < 0.01


@pytest.mark.parametrize("other", [None, "bvh_test3"])
def test_a_dance_on_another_body_gets_no_advice(shared_data, other):
    """Nor on its own: where a knee is nearly straight, a centimetre of a foot that is held bends it by 15 degrees."""
    dance = read_motion(shared_data("bandai_dance/dataset-1_dance-short_normal_001.bvh"))
    character = read_motion(shared_data(f"foreign/pybvh/{other}.bvh")) if other else dance
    made = retarget(dance, character)
    assert made.skating < 0.005
    judged = assess(canonicalise(dance, whole=True), canonicalise(made.motion, whole=True))
    assert [one.message.code for one in advise(judged) if one.segments] == []


@pytest.mark.parametrize("name", ["kickLFront1Reps/HDM_dg_kickLFront1Reps_013_120", "hopBothLegs1hops/HDM_dg"])
@pytest.mark.parametrize("other", sorted(set(CHARACTERS) - {"smpl"}))
def test_a_leg_in_the_air_points_as_the_source_s(shared_data, name, other):
    """Standing feet are held; a foot that is kicked or leaps goes with the body."""
    path = sorted(shared_data("hdm05").glob(f"{name}*.amc"))[0]
    source, character = read_motion(path), read_character(shared_data("foreign") / CHARACTERS[other])
    made = retarget(source, character)
    points = canonicalise(source, whole=True).positions[..., 1]
    away = directions(source, made.motion)
    for side in ("left", "right"):
        ankle, toe = (points[:, JOINT_INDEX[f"{side}_{joint}"]] for joint in ("ankle", "toe"))
        air = (ankle > np.percentile(ankle, 5) + 0.15) & (toe > np.percentile(toe, 5) + 0.10)
        legs = [LIMB_NAMES.index(f"{side}_{segment}") for segment in ("thigh", "shank")]
        assert away[air][:, legs].max(initial=0.0) < 5
    assert made.worst.angle == pytest.approx(np.radians(away.max()), abs=1e-3)
    assert made.skating < 0.02


def test_key_frames_are_no_motion(shared_data):
    """21 poses at 1 Hz: whether a foot stands cannot be told, and none is held."""
    poses = read_motion(shared_data("foreign/mixamo_ganimator/Baseball-Milling-Idle-edited-keyframes.bvh"))
    made = retarget(poses, make_motion("walk", draw_performer(1)))
    assert not made.contacts.any()
    assert np.degrees(made.direction_error) < 0.1


def test_contacts_of_a_walk():
    motion = canonicalise(make_motion("walk", draw_performer(1)))
    contacts = find_contacts(motion)
    # A walker stands on one foot most of the time, and lifts each; rolling off the toe is not standing.
    assert contacts.any(axis=1).mean() > 0.3
    assert not contacts.all(axis=0).any()
    toes = motion.positions[:, [motion.to_trajectories().names.index(f"{s}_toe") for s in ("left", "right")]]
    assert measure_skating(toes, contacts) < 0.1
    for side in range(2):
        assert all(end - start >= 2 for start, end in find_runs(contacts[:, side]))
