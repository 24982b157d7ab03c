"""The 56 pose features: their meaning, what they must not depend on, and their integrals (equations 3-5)."""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles import hamada, pose_features
from oracles.standing import standing

from dousa.errors import InvalidMotionError, OptionError
from dousa.motion import CANONICAL_JOINTS, MIRRORED_JOINTS
from dousa.retrieval import (
    FEATURE_NAMES,
    FEATURES,
    compute_clip_features,
    compute_pose_features,
    integrate,
    list_tests,
)


def named(features):
    return dict(zip(FEATURE_NAMES, features.T, strict=True))


def random_motion(seed, frames=6):
    """Wild poses whose hips say where left is."""
    random = np.random.default_rng(seed)
    scale = np.full((20, 1), 0.15)
    scale[[CANONICAL_JOINTS.index("left_hip"), CANONICAL_JOINTS.index("right_hip")]] = 0.02
    return standing() + random.normal(size=(frames, 20, 3)) * scale


def turned(positions, angle):
    c, s = np.cos(angle), np.sin(angle)
    return positions @ np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]).T


def test_there_are_56_with_names_of_their_own():
    assert len(FEATURES) == len(set(FEATURE_NAMES)) == 56
    for feature in FEATURES:
        assert set(feature.joints) <= set(CANONICAL_JOINTS)
        assert feature.unit == ("radians" if feature.kind == "inclination" else "body heights")


@given(st.integers(0, 2**32 - 1), st.floats(0.5, 2.5))
def test_every_feature_is_what_its_description_says(seed, height):
    positions = turned(random_motion(seed, 2), seed % 7)
    features = compute_pose_features(positions, height)
    for frame, row in enumerate(features):
        pose = dict(zip(CANONICAL_JOINTS, positions[frame].tolist(), strict=True))
        wanted = [pose_features.feature(feature, pose, height) for feature in FEATURES]
        assert row.tolist() == pytest.approx(wanted, abs=1e-6)


@given(st.integers(0, 2**32 - 1), st.floats(-7, 7), st.floats(0.2, 5.0), st.tuples(*[st.floats(-20, 20)] * 3))
def test_place_heading_and_stature_do_not_matter(seed, angle, scale, place):
    positions = random_motion(seed)
    moved = turned(positions * scale, angle) + np.array(place)
    assert compute_pose_features(moved, 1.7 * scale) == pytest.approx(compute_pose_features(positions, 1.7), abs=1e-9)


@given(st.integers(0, 2**32 - 1))
def test_the_mirror_image_exchanges_left_and_right(seed):
    positions = random_motion(seed)
    mirrored = positions[:, MIRRORED_JOINTS] * np.array([-1.0, 1.0, 1.0])
    here, there = (named(compute_pose_features(p, 1.7)) for p in (positions, mirrored))

    def mirror_name(name):
        return name.replace("left", "#").replace("right", "left").replace("#", "right")

    for name, values in here.items():
        other = mirror_name(name)
        if other in there and other != name:
            assert values == pytest.approx(there[other], abs=1e-9)


def test_words_mean_what_they_say():
    rest = named(compute_pose_features(standing(), 1.7))
    assert rest["trunk away from upright"] == pytest.approx(0, abs=1e-12)
    raised = named(compute_pose_features(standing(right_hand=(-0.3, 1.9, 0.4)), 1.7))
    assert raised["right hand above pelvis"][0] == pytest.approx(0.9 / 1.7)
    assert raised["right hand in front of pelvis"][0] == pytest.approx(0.4 / 1.7)
    assert raised["right hand right of pelvis"][0] == pytest.approx(0.3 / 1.7)
    assert raised["left hand above pelvis"] == rest["left hand above pelvis"]
    bowing = named(compute_pose_features(standing(neck=(0.0, 1.0, 0.5)), 1.7))
    assert bowing["trunk leaning forward"][0] == pytest.approx(np.pi / 2)
    assert bowing["trunk away from upright"][0] == pytest.approx(np.pi / 2)
    leaning = named(compute_pose_features(standing(neck=(0.3, 1.3, 0.0)), 1.7))
    assert leaning["trunk leaning left"][0] == pytest.approx(np.pi / 4)


def test_hips_without_direction_give_way_to_shoulders():
    positions = standing(left_hip=(0.0, 0.95, 0.0), right_hip=(0.0, 0.95, 0.0))
    wanted = named(compute_pose_features(standing(), 1.7))
    found = named(compute_pose_features(turned(positions, 1.0), 1.7))
    for name in ("left hand left of pelvis", "left foot in front of pelvis", "head in front of pelvis"):
        assert found[name] == pytest.approx(wanted[name])


@pytest.mark.parametrize("sideways", [0, 1])
def test_lying_on_the_side_keeps_the_last_direction(sideways):
    """Both lines vertical: the frame before decides, or at the start the frame after."""
    upright = turned(standing(), 0.7)
    column = {name: (0.0, 1.0, 0.0) for name in ("left_hip", "right_hip", "left_shoulder", "right_shoulder")}
    vertical = turned(standing(**column), 0.7)
    clip = np.concatenate([vertical, upright] if sideways == 0 else [upright, vertical])
    features = named(compute_pose_features(clip, 1.7))
    for name in ("left hand left of pelvis", "left hand in front of pelvis", "right foot in front of pelvis"):
        assert features[name][0] == pytest.approx(features[name][1])


def test_a_point_of_a_body_has_finite_features():
    assert not compute_pose_features(np.zeros((3, 20, 3)), 1.7).any()


@settings(max_examples=30)
@given(st.integers(1, 40), st.integers(1, 15), st.integers(1, 4))
def test_a_frame_is_the_mean_of_poses_spread_over_its_part(frames, n_frames, samples):
    positions = standing() + np.arange(frames)[:, None, None] * np.linspace(0, 0.01, 20)[:, None]
    features = compute_clip_features(SimpleNamespace(positions=positions, height=1.7), n_frames, samples)
    every = compute_pose_features(positions, 1.7)
    assert features.shape == (n_frames, 56)
    for part in range(n_frames):
        at = [int((part + (k + 0.5) / samples) / n_frames * frames + 1e-9) for k in range(samples)]
        assert np.allclose(features[part], every[at].mean(axis=0))


def test_bad_arrays_are_refused():
    for positions in (np.zeros((4, 19, 3)), np.zeros((0, 20, 3)), np.zeros((20, 3))):
        with pytest.raises(InvalidMotionError, match="20, 3"):
            compute_pose_features(positions, 1.7)
    gap = standing()
    gap[0, 3, 1] = np.nan
    with pytest.raises(InvalidMotionError, match="finite"):
        compute_pose_features(gap, 1.7)
    for height in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(InvalidMotionError, match="height"):
            compute_pose_features(standing(), height)
    for numbers in ((0, 8), (10, 0)):
        with pytest.raises(OptionError, match="n_frames"):
            compute_clip_features(SimpleNamespace(positions=standing(), height=1.7), *numbers)


@given(st.integers(0, 4), st.integers(1, 7), st.integers(1, 4), st.integers(0, 2**32 - 1))
def test_every_mean_is_that_of_the_equations(clips, frames, features, seed):
    pose = np.random.default_rng(seed).normal(size=(clips, frames, features))
    integrals = integrate(pose)
    assert integrals.shape == (clips, features, frames + 1)
    for clip in range(clips):
        for i in range(features):
            series = pose[clip, :, i].tolist()
            assert integrals[clip, i].tolist() == pytest.approx(hamada.integral(series))
            for t0 in range(frames):
                for t1 in range(t0 + 1, frames + 1):
                    mean = hamada.mean_by_integral(integrals[clip, i], t0, t1)
                    assert mean == pytest.approx(hamada.mean_by_sum(series, t0, t1), abs=1e-12)


def test_the_paper_has_3080_tests():
    tests = list_tests(56, 10)
    assert tests.tolist() == [[0, i, i, t0, t1] for i, t0, t1 in hamada.parameters(56, 10)]
    assert len(tests) == 3080


@pytest.mark.parametrize("shape", [(10, 56), (3, 0, 56), (3, 10, 0), (3,)])
def test_other_shapes_are_refused(shape):
    with pytest.raises(InvalidMotionError, match="expected pose features"):
        integrate(np.zeros(shape))
