"""Height, hips from markers, and the two sides of the body."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from oracles.bodies import walking_body

from dousa.formats.registry import read_motion
from dousa.motion import CANONICAL_JOINTS, JOINT_INDEX, MIRRORED_JOINTS, canonicalise, compute_trajectories
from dousa.motion.canonical.geometry import chain_height, hips_from_markers, measure_rest
from dousa.motion.canonical.recipes import named_recipes
from dousa.motion.canonical.tree_shape import compare_sides, compute_forward, score_sides


def _points() -> np.ndarray:
    return canonicalise(walking_body()).positions.copy()


def test_chain_height_of_the_made_figure() -> None:
    # By hand, m: head 0.27, neck to Spine1 0.2302.., to pelvis 0.2502.., hips 0.05, thigh 0.41, shank 0.4101, foot
    expected = np.hypot(0.27, 0.02) + np.hypot(0.23, 0.01) + np.hypot(0.25, 0.01) + 0.05
    expected += 0.41 + np.hypot(0.41, 0.01) + 0.4 * np.hypot(0.06, 0.13)
    assert chain_height(_points()) == pytest.approx(0.967 * expected, rel=1e-9)


@given(st.floats(0.01, 1000), st.floats(-np.pi, np.pi))
def test_height_and_sides_follow_scale_and_yaw(scale: float, yaw: float) -> None:
    points = _points()
    turn = np.array([[np.cos(yaw), 0, np.sin(yaw)], [0, 1, 0], [-np.sin(yaw), 0, np.cos(yaw)]])
    moved = scale * points @ turn.T + 5.0
    assert chain_height(moved) == pytest.approx(scale * chain_height(points), rel=1e-9)
    assert score_sides(moved) == pytest.approx(score_sides(points), abs=1e-6)


def test_height_survives_missing_frames_and_bones_of_no_length() -> None:
    points = _points()
    whole = chain_height(points)
    points[2] = np.nan
    assert chain_height(points) == pytest.approx(whole, rel=1e-6)
    assert np.isnan(chain_height(np.full((3, 20, 3), np.nan)))
    assert chain_height(np.zeros((1, 20, 3))) == 0.0


def test_mirrored_points_disagree_and_swapped_names_restore() -> None:
    points = _points()
    assert compare_sides(points) == "agree"
    assert compare_sides(points * [1, 1, -1]) == "disagree"
    assert compare_sides((points * [1, 1, -1])[:, list(MIRRORED_JOINTS)]) == "agree"
    assert score_sides(points * [-1, 1, 1]) == pytest.approx(-score_sides(points))


def test_sides_of_nothing_are_unclear() -> None:
    assert compare_sides(np.zeros((4, 20, 3))) == "unclear"
    assert compare_sides(np.full((4, 20, 3), np.nan)) == "unclear"


def test_a_bone_of_no_length_hides_no_side() -> None:
    points = _points()
    points[:, JOINT_INDEX["left_elbow"]] = points[:, JOINT_INDEX["left_shoulder"]]
    assert compare_sides(points) == "agree"


def test_forward_is_where_the_figure_walks() -> None:
    np.testing.assert_allclose(compute_forward(_points()), np.tile([0.0, 0.0, 1.0], (20, 1)), atol=0.1)


def test_hips_from_markers_by_hand() -> None:
    # ASIS 0.25 m apart facing +Z, sacrum 0.1 m behind: Bell's shares of the width.
    left, right, sacrum, knees = (
        np.array([row]) for row in ([0.125, 1.0, 0.1], [-0.125, 1.0, 0.1], [0, 1.0, 0.0], [0, 0.5, 0.1])
    )
    hips = hips_from_markers(left, right, sacrum, knees)
    np.testing.assert_allclose(hips[0], [[0.09, 0.925, 0.0525], [-0.09, 0.925, 0.0525]])
    mirrored = hips_from_markers(*(x * [1, 1, -1] for x in (left, right, sacrum, knees)))
    np.testing.assert_allclose(mirrored[0], hips[0] * [1, 1, -1])


def test_rest_pose_counts_only_where_upright() -> None:
    body = walking_body()
    recipe = named_recipes(body.names)[0]
    assert recipe is not None and body.rest_positions is not None
    rest = measure_rest(recipe, body.rest_positions)
    assert rest is not None
    assert (rest.height, rest.axis) == (pytest.approx(1.68), 1)
    folded = np.array(body.rest_positions)
    legs = [i for i, name in enumerate(body.names) if "Leg" in name or "Foot" in name or "Toe" in name]
    folded[legs, 1] = 1.8 - folded[legs, 1]
    assert measure_rest(recipe, folded) is None
    assert measure_rest(recipe, np.full_like(folded, np.nan)) is None
    assert measure_rest(recipe, None) is None


def test_both_heights_agree_on_hdm05(shared_data) -> None:
    for file in (
        sorted(shared_data("hdm05").glob("squat1Reps/*_001_*.amc"))
        + sorted(shared_data("hdm05").glob("grabHighR/*"))[::6]
    ):
        canonical = canonicalise(read_motion(file))
        assert canonical.height_source == "rest pose"
        assert chain_height(canonical.positions) == pytest.approx(canonical.height, rel=0.03)


@pytest.mark.parametrize("folder", ["hdm05", "bandai", "utd_mhad/skeleton"])
def test_names_and_geometry_agree_in_all_recordings(folder: str, shared_data) -> None:
    files = sorted(p for p in shared_data(folder).rglob("*") if p.suffix.lower() in (".amc", ".bvh", ".c3d"))
    for file in files[:: max(1, len(files) // 40)]:
        motion = read_motion(file)
        moving = motion if folder.startswith("utd") else compute_trajectories(motion)
        canonical = canonicalise(moving)
        assert canonical.mapping.sides == "agree", file
        assert score_sides(canonical.positions * [-1, 1, 1]) < -0.08
        assert len(CANONICAL_JOINTS) == canonical.positions.shape[1] == len(JOINT_INDEX)
