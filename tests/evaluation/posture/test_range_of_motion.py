"""Joint angles against poses that are bent by known angles."""

import dataclasses
import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dousa.arrays import FloatArray
from dousa.evaluation import ANGLES, compute_joint_angles, compute_symmetry_index
from dousa.evaluation.posture.range_of_motion import measure_ranges
from dousa.motion import CanonicalMotion, canonicalise, compute_trajectories, mirror_canonical
from dousa.motion.canonical.joints import JOINT_INDEX as J
from dousa.motion.synthetic import Performer, make_motion

STANDING = {
    "pelvis": (0, 1.0, 0), "spine": (0, 1.2, 0), "neck": (0, 1.5, 0), "head": (0, 1.7, 0),
    "left_shoulder": (0.2, 1.45, 0), "left_elbow": (0.2, 1.15, 0), "left_wrist": (0.2, 0.9, 0),
    "left_hand": (0.2, 0.8, 0), "left_hip": (0.1, 0.95, 0), "left_knee": (0.1, 0.5, 0), "left_ankle": (0.1, 0.05, 0),
    "left_toe": (0.1, 0.0, 0.15),
}  # fmt: skip


def make_pose() -> FloatArray:
    """Somebody standing upright, facing +Z, arms hanging."""
    pose = np.zeros((20, 3))
    for name, place in STANDING.items():
        pose[J[name]] = place
        if name.startswith("left_"):
            pose[J[name.replace("left_", "right_")]] = np.array(place) * [-1, 1, 1]
    return pose


def to_motion(*poses: FloatArray) -> CanonicalMotion:
    """Poses as a motion at 30 Hz."""
    mapping = canonicalise(compute_trajectories(make_motion("bow", Performer())))
    return dataclasses.replace(mapping, positions=np.stack(poses), frame_rate=30.0, missing=None)


def measure(pose: FloatArray) -> dict[str, float]:
    """All angles of a pose."""
    return {name: float(values[0]) for name, values in compute_joint_angles(to_motion(pose)).items()}


def point(pose: FloatArray, chain: tuple[str, ...], direction: tuple[float, float, float]) -> None:
    """Turn the bones of a chain of joints into a direction."""
    unit = np.array(direction) / np.linalg.norm(direction)
    lengths = [float(np.linalg.norm(pose[J[b]] - pose[J[a]])) for a, b in itertools.pairwise(chain)]
    for (before, after), length in zip(itertools.pairwise(chain), lengths, strict=True):
        pose[J[after]] = pose[J[before]] + length * unit


ARM = ("left_shoulder", "left_elbow", "left_wrist", "left_hand")


def test_standing_is_zero() -> None:
    assert measure(make_pose()) == pytest.approx(dict.fromkeys(ANGLES, 0.0), abs=1e-6)


@pytest.mark.parametrize("degrees", [10, 45, 90, 130, 175])
def test_an_arm_raised_forward_is_flexion_and_not_abduction(degrees: float) -> None:
    pose, angle = make_pose(), math.radians(degrees)
    point(pose, ARM, (0.0, -math.cos(angle), math.sin(angle)))
    found = measure(pose)
    assert found["left_shoulder_elevation"] == pytest.approx(degrees)
    if degrees < 150:  # straight overhead a single pose does not say in which plane
        assert found["left_shoulder_flexion"] == pytest.approx(degrees)
        assert found["left_shoulder_abduction"] == pytest.approx(0, abs=1e-6)
    assert found["right_shoulder_elevation"] == pytest.approx(0, abs=1e-6)


@pytest.mark.parametrize(("side", "out"), [("left", 1.0), ("right", -1.0)])
def test_an_arm_raised_sideways_is_abduction_on_either_side(side: str, out: float) -> None:
    pose = make_pose()
    point(pose, tuple(name.replace("left", side) for name in ARM), (out, 0.0, 0.0))
    found = measure(pose)
    assert found[f"{side}_shoulder_abduction"] == pytest.approx(90)
    assert found[f"{side}_shoulder_flexion"] == pytest.approx(0, abs=1e-6)


def test_an_arm_raised_forward_and_overhead_stays_flexion() -> None:
    poses = []
    for degrees in np.linspace(0, 178, 60):
        pose, angle = make_pose(), math.radians(degrees)
        # A little sideways: near the top this is all that the horizontal part holds.
        point(pose, ARM, (0.08 * math.sin(angle / 2), -math.cos(angle), math.sin(angle)))
        poses.append(pose)
    angles = compute_joint_angles(to_motion(*poses))
    assert angles["left_shoulder_flexion"].max() == pytest.approx(174, abs=5)
    assert np.abs(angles["left_shoulder_abduction"]).max() < 40


def test_elbow_knee_hip_and_trunk() -> None:
    pose = make_pose()
    point(pose, ("left_elbow", "left_wrist"), (0.0, 0.0, 1.0))
    point(pose, ("right_hip", "right_knee"), (0.0, -math.cos(1.0), math.sin(1.0)))
    point(pose, ("right_knee", "right_ankle"), (0.0, -1.0, 0.0))
    found = measure(pose)
    assert found["left_elbow_flexion"] == pytest.approx(90)
    assert found["right_hip_flexion"] == pytest.approx(math.degrees(1.0))
    assert found["right_knee_flexion"] == pytest.approx(math.degrees(1.0))
    bent = make_pose()
    upper = [J[name] for name in ("neck", "head", "left_shoulder", "right_shoulder")]
    bent[upper, 2] += 0.55 * math.tan(0.4) * (bent[upper, 1] - 0.95) / 0.55
    assert measure(bent)["trunk_forward_lean"] == pytest.approx(math.degrees(0.4))
    assert measure(bent)["trunk_side_lean"] == pytest.approx(0, abs=1e-6)


def test_a_trunk_that_bends_down_beyond_the_horizontal_does_not_lean_to_the_side() -> None:
    up = np.array([[0.05, math.cos(angle), math.sin(angle)] for angle in np.linspace(0.1, 2.0, 60)])
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    poses = np.repeat(make_pose()[None], len(up), axis=0)
    for name in ("neck", "head", "left_shoulder", "right_shoulder"):
        poses[:, J[name]] += 0.5 * (up - [0.0, 1.0, 0.0])
    angles = compute_joint_angles(to_motion(*poses))
    assert angles["trunk_forward_lean"].max() > 95
    assert np.abs(angles["trunk_side_lean"]).max() < 10


@given(yaw=st.floats(-3.1, 3.1), scale=st.floats(0.6, 1.3), x=st.floats(-5, 5))
def test_place_heading_and_stature_do_not_matter(yaw: float, scale: float, x: float) -> None:
    motion = canonicalise(compute_trajectories(make_motion("squat", Performer(), 1)))
    turn = np.array([[math.cos(yaw), 0, math.sin(yaw)], [0, 1, 0], [-math.sin(yaw), 0, math.cos(yaw)]])
    moved = dataclasses.replace(motion, positions=scale * motion.positions @ turn.T + [x, 0, 0])
    before, after = compute_joint_angles(motion), compute_joint_angles(moved)
    for name in ANGLES:
        np.testing.assert_allclose(after[name], before[name], atol=1e-5)


def test_the_mirror_image_changes_sides() -> None:
    motion = canonicalise(compute_trajectories(make_motion("kick_left", Performer(), 1)))
    before, after = compute_joint_angles(motion), compute_joint_angles(mirror_canonical(motion))
    for name in ANGLES:
        other = name.replace("left_", "right_") if name.startswith("left_") else name.replace("right_", "left_")
        sign = -1.0 if name == "trunk_side_lean" else 1.0
        np.testing.assert_allclose(after[other], sign * before[name], atol=1e-6)


def test_one_wrong_frame_is_no_range() -> None:
    angles = {name: np.zeros(60) for name in ANGLES}
    angles["left_knee_flexion"] = np.r_[np.zeros(30), 150.0, np.zeros(29)]
    found = {one.angle: one for one in measure_ranges(angles, 0, 60, 30.0)}
    assert found["left_knee_flexion"].range_deg < 1e-9


def test_the_percentage_of_a_joint_that_hardly_moves_is_not_told() -> None:
    angles = {name: np.linspace(0, 30, 60) for name in ANGLES}
    found = {
        one.angle: one for one in measure_ranges(angles, 0, 60, 30.0, {"trunk_lean": 5.0, "left_hip_flexion": 60.0})
    }
    assert math.isnan(found["trunk_lean"].percent)
    assert found["left_hip_flexion"].percent == pytest.approx(50, abs=3)


def test_symmetry_index() -> None:
    assert compute_symmetry_index(50, 50) == 0
    assert compute_symmetry_index(60, 40) == pytest.approx(40)
    assert compute_symmetry_index(40, 60) == pytest.approx(-40)
    assert compute_symmetry_index(30, 0) == pytest.approx(200)
    assert math.isnan(compute_symmetry_index(0, 0))
    assert math.isnan(compute_symmetry_index(math.nan, 4))
