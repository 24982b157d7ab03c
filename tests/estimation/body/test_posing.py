"""Inverse kinematics, standing, and bodies made from recorded skeletons."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles.bodies import robot_arm, walking_body

from dousa.errors import BodyModelError
from dousa.estimation.body.human import make_human
from dousa.estimation.body.kinematics import compute_points, place_parts, point_names
from dousa.estimation.body.posing import compute_angles, fit_pose, fit_poses, standing_state
from dousa.estimation.body.skeleton_body import body_from_motion, fit_body
from dousa.motion import CANONICAL_JOINTS, JOINT_INDEX, canonicalise
from dousa.motion import rotations as rot

BODY = make_human(1.7)
ORDER = [point_names(BODY).index(name) for name in CANONICAL_JOINTS]


def some_pose(seed, share=0.7, body=BODY):
    """Anywhere in the world, the angles within a share of their limits about their middle."""
    rng = np.random.default_rng(seed)
    limits = body.angle_limits
    pose = np.empty(7 + body.n_angles)
    pose[:3] = rng.uniform(-3, 3, 3)
    pose[3:7] = rot.normalise(rng.normal(size=4))
    pose[7:] = limits.mean(axis=1) + share * rng.uniform(-0.5, 0.5, len(limits)) * np.ptp(limits, axis=1)
    return pose


def canonical_places(body, pose):
    return compute_points(body, pose)[..., ORDER, :]


@given(seed=st.integers(0, 10_000), part=st.integers(1, 14))
@settings(max_examples=60, deadline=None)
def test_angles_of_a_rotation_are_those_that_made_it(seed, part):
    pose = some_pose(seed, share=0.95)
    rotations, _ = place_parts(BODY, pose)
    local = rot.from_matrix(rotations[BODY.parents[part]].T @ rotations[part])
    first = 7 + BODY.angle_starts[part]
    own = pose[first : first + BODY.n_axes[part]]
    if BODY.n_axes[part] == 3 and np.hypot(own[0], own[1]) > 3.1:
        return  # past the half turn the swing is told the other way round
    np.testing.assert_allclose(compute_angles(BODY, part, local), own, atol=1e-6)


def test_angles_stay_within_the_limits():
    elbow = BODY.names.index("left_forearm")
    back = rot.from_axis_angle(np.array([1.0, 0.0, 0.0]))
    np.testing.assert_allclose(compute_angles(BODY, elbow, back), BODY.limits[elbow, 0, 0])


@given(seed=st.integers(0, 10_000))
@settings(max_examples=30, deadline=None)
def test_a_pose_of_the_body_itself_is_found_again(seed):
    places = canonical_places(BODY, some_pose(seed, share=0.6))
    pose, residual = fit_pose(BODY, places)
    assert residual < 0.02
    limits = BODY.angle_limits
    assert ((limits[:, 0] <= pose[7:]) & (pose[7:] <= limits[:, 1])).all()
    assert np.linalg.norm(pose[3:7]) == pytest.approx(1.0)


@given(seed=st.integers(0, 10_000), turn=st.floats(-3.1, 3.1))
@settings(max_examples=10, deadline=None)
def test_the_world_may_be_turned_and_moved(seed, turn):
    places = canonical_places(BODY, some_pose(seed, share=0.3))
    yaw = rot.to_matrix(rot.from_axis_angle(np.array([0.0, turn, 0.0])))
    pose, _ = fit_pose(BODY, places)
    moved, _ = fit_pose(BODY, places @ yaw.T + [1.0, 0.2, -4.0])
    np.testing.assert_allclose(
        canonical_places(BODY, moved), canonical_places(BODY, pose) @ yaw.T + [1.0, 0.2, -4.0], atol=5e-3
    )


def test_joints_that_are_missing_are_made_up_from_the_rest():
    pose = standing_state(BODY)
    pose[7 + BODY.angle_names.index("left_elbow.1")] = 1.2
    places = canonical_places(BODY, pose)
    for gone in ("spine", "left_hand", "right_hand", "head", "right_toe"):
        places[JOINT_INDEX[gone]] = np.nan
    found, residual = fit_pose(BODY, places)
    assert residual < 1e-3
    assert np.linalg.norm(canonical_places(BODY, found) - canonical_places(BODY, pose), axis=1).max() < 0.05
    named = {name: places[JOINT_INDEX[name]] for name in CANONICAL_JOINTS} | {"left_ear": (0, 0, 0)}
    np.testing.assert_allclose(fit_pose(BODY, named)[0], found, atol=1e-9)


def test_another_persons_bones_bend_no_joint():
    other = make_human(1.55, measures={"thigh": 0.45, "upper_arm": 0.2})
    places = canonical_places(other, standing_state(other))
    pose, residual = fit_pose(BODY, places)
    assert residual < 0.08
    knees = [7 + BODY.angle_names.index(f"{side}_knee.1") for side in ("left", "right")]
    assert np.abs(pose[knees]).max() < 0.15


def test_a_start_is_kept_where_the_joints_do_not_tell():
    start = standing_state(BODY)
    start[7 + BODY.angle_names.index("left_wrist.1")] = 0.7
    places = canonical_places(BODY, start)
    places[JOINT_INDEX["left_hand"]] = np.nan
    pose, _ = fit_pose(BODY, places, start)
    np.testing.assert_allclose(pose, start, atol=1e-3)


def test_any_tree_is_posed():
    robot = robot_arm()
    pose = np.array([0.3, 0, 1, 1, 0, 0, 0, 0.4, -0.3, 0.9, 1.2, 0.7])
    places = dict(zip(point_names(robot), compute_points(robot, pose), strict=True))
    # The name of the claw is a tip's and a part's; only points count.
    found, residual = fit_pose(robot, places)
    assert residual < 1e-3
    np.testing.assert_allclose(found[7:], pose[7:], atol=0.02)
    np.testing.assert_array_equal(standing_state(robot)[7:], 0.0)


@pytest.mark.parametrize(
    ("positions", "message"),
    [
        (np.zeros((19, 3)), r"expected shape \(20, 3\), got \(19, 3\)"),
        (np.full((20, 3), np.nan), "at least three joints .* got 0"),
        (np.zeros((20, 3)), "not in one line"),
        (np.arange(20)[:, None] * np.ones(3), "not in one line"),
        ({"nose": (0, 0, 0)}, "at least three joints .* of pelvis, spine"),
        ({"pelvis": (0, 0)}, r"pelvis: expected 3 numbers, got shape \(2,\)"),
    ],
)
def test_too_little_to_pose_is_said(positions, message):
    with pytest.raises(BodyModelError, match=message):
        fit_pose(BODY, positions)


def test_a_start_of_another_body_is_said():
    places = canonical_places(BODY, standing_state(BODY))
    with pytest.raises(BodyModelError, match="start: expected a pose of 37 finite numbers"):
        fit_pose(BODY, places, np.zeros(12))


def test_a_motion_is_posed_frame_by_frame_over_gaps():
    walk = canonicalise(walking_body(12)).positions.copy()
    body = fit_body(BODY, walk)
    walk[3] = np.nan
    walk[5, 7] = np.nan
    poses, residuals = fit_poses(body, walk)
    assert poses.shape == (12, 37) and np.isnan(residuals).tolist() == [t == 3 for t in range(12)]
    np.testing.assert_array_equal(poses[3], poses[2])
    assert np.nanmax(residuals) < 0.04
    walk[0] = np.nan
    poses, _ = fit_poses(body, walk)
    np.testing.assert_array_equal(poses[0], poses[1])
    with pytest.raises(BodyModelError, match="at least three joints"):
        fit_poses(body, np.full((4, 20, 3), np.nan))
    with pytest.raises(BodyModelError, match=r"\(T, 20, 3\)"):
        fit_poses(body, walk[0])


@pytest.mark.parametrize("seed", range(4))
def test_a_body_takes_the_bones_of_another(seed):
    told = {"thigh": 0.47, "shank": 0.4, "upper_arm": 0.25, "forearm": 0.29, "shoulder_breadth": 0.36}
    other = make_human(1.7, measures={**told, "trunk": 0.5, "hip_breadth": 0.18})
    poses = np.stack([standing_state(other), *(some_pose(seed + k, 0.3, other) for k in range(1))])
    fitted = fit_body(BODY, canonical_places(other, poses))
    lengths, wanted = (np.linalg.norm(body.offsets, axis=1) for body in (fitted, other))
    np.testing.assert_allclose(lengths[3:], wanted[3:], rtol=0.08)
    limbs = [fitted.joints.index(f"left_{name}") for name in ("knee", "ankle", "elbow", "wrist")]
    np.testing.assert_allclose(lengths[limbs], wanted[limbs], rtol=1e-6)
    np.testing.assert_allclose(fitted.offsets[:, 0], -np.concatenate(
        [fitted.offsets[:3, 0], fitted.offsets[6:9, 0], fitted.offsets[3:6, 0], fitted.offsets[12:, 0],
         fitted.offsets[9:12, 0]]), atol=1e-9)  # fmt: skip
    assert fit_pose(fitted, canonical_places(other, poses[0]))[1] < 0.02


def test_a_body_of_twice_the_size_is_the_same_body_twice_as_large():
    places = canonical_places(BODY, standing_state(BODY))
    grown = fit_body(BODY, 2.0 * places)
    assert grown.stature == pytest.approx(3.4, rel=1e-3)
    np.testing.assert_allclose(grown.offsets, 2.0 * BODY.offsets, atol=2e-3)
    np.testing.assert_allclose(grown.spheres, 2.0 * BODY.spheres, atol=4e-3)
    same = fit_body(BODY, places)
    np.testing.assert_allclose(same.offsets, BODY.offsets, atol=1e-3)


def test_wrong_points_leave_the_bodys_own_proportions():
    places = canonical_places(BODY, standing_state(BODY))[None].repeat(3, axis=0)
    places[:, JOINT_INDEX["left_wrist"]] += [5.0, 0.0, 0.0]
    places[:, JOINT_INDEX["right_shoulder"]] = places[:, JOINT_INDEX["left_shoulder"]]
    places[:, JOINT_INDEX["neck"]] = np.nan
    fitted = fit_body(BODY, places)
    shares = np.linalg.norm(fitted.offsets[1:], axis=1) / np.linalg.norm(BODY.offsets[1:], axis=1)
    assert shares.min() > 0.9 and shares.max() < 1.2
    np.testing.assert_allclose(
        fitted.offsets[BODY.joints.index("left_shoulder"), 0], -fitted.offsets[BODY.joints.index("right_shoulder"), 0]
    )


def test_left_and_right_that_differ_are_kept_apart():
    places = canonical_places(BODY, standing_state(BODY))
    knee, ankle = places[JOINT_INDEX["left_knee"]], places[JOINT_INDEX["left_ankle"]]
    places[JOINT_INDEX["left_ankle"]] = knee + 0.75 * (ankle - knee)
    fitted = fit_body(BODY, places)
    shank = {side: fitted.offsets[BODY.joints.index(f"{side}_ankle"), 1] for side in ("left", "right")}
    assert shank["left"] == pytest.approx(0.75 * shank["right"], rel=0.01)


def test_bones_of_any_tree_are_fitted():
    robot = robot_arm()
    other = replace(robot, offsets=robot.offsets * [1, 1.2, 1], tip_offsets=robot.tip_offsets * 1.1)
    pose = np.array([0, 0, 0, 1, 0, 0, 0, 0.4, -0.3, 0.9, 1.2, 0.7])
    places = dict(zip(point_names(other), compute_points(other, pose), strict=True))
    fitted = fit_body(robot, places)
    np.testing.assert_allclose(fitted.offsets[2:, 1], other.offsets[2:, 1], rtol=1e-6)


def test_nothing_to_measure_is_said():
    with pytest.raises(BodyModelError, match="both ends of a bone"):
        fit_body(BODY, {"pelvis": (0, 0, 0), "left_elbow": (0, 1, 0)})
    with pytest.raises(BodyModelError, match=r"\(T, 20, 3\)"):
        fit_body(BODY, np.zeros((4, 3)))
    with pytest.raises(BodyModelError, match="left_knee: expected shape"):
        fit_body(BODY, {"left_knee": np.zeros(4)})


def test_the_body_of_a_walking_figure():
    walk = walking_body(20)
    body = body_from_motion(walk)
    assert 1.6 < body.stature < 1.95
    assert -body.offsets[body.joints.index("left_knee"), 1] == pytest.approx(0.41, abs=0.005)
    assert -body.offsets[body.joints.index("right_wrist"), 1] == pytest.approx(0.25, abs=0.005)
    assert fit_poses(body, canonicalise(walk).positions)[1].max() < 0.04
    same = body_from_motion(canonicalise(walk))
    np.testing.assert_array_equal(same.offsets, body.offsets)


@pytest.mark.parametrize(
    "clip",
    [
        pytest.param("bd_squat", marks=pytest.mark.slow),
        pytest.param("bk_rotatearms", marks=pytest.mark.slow),
        "cmu86_walk",
        pytest.param("dg_kick", marks=pytest.mark.slow),
    ],
)
def test_recorded_people_are_posed_within_two_centimetres(shared_data, clip):
    with np.load(shared_data(f"silhouette_bench/{clip}_clean.npz")) as data:
        names = [str(name) for name in data["joint_names"]]
        positions, stature = data["joint_positions"][::5], float(data["stature"])
    table = make_human(stature)
    assert np.mean([fit_pose(table, dict(zip(names, frame, strict=True)))[1] for frame in positions]) < 0.04
    own = fit_body(table, {name: positions[:, index] for index, name in enumerate(names)})
    assert own.stature == pytest.approx(stature, rel=0.05)
    assert fit_poses(own, positions, names)[1].mean() < 0.02
