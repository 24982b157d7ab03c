"""The mirror image: twice is once, left is right, and up, time and the right hand rule stay."""

import re
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles.bodies import walking_body

from dousa.errors import InvalidMotionError
from dousa.motion import (
    CANONICAL_JOINTS,
    JOINT_INDEX,
    CanonicalMotion,
    canonicalise,
    mirror_canonical,
    mirror_positions,
)
from dousa.motion.canonical.tree_shape import compare_sides
from dousa.motion.synthetic.performers import draw_performer, make_motion
from dousa.retrieval import FEATURE_NAMES, compute_pose_features
from dousa.retrieval.features.channels import CHANNELS, compute_channels


def other_side(name):
    """Left for right and right for left, but not in "upright"."""
    return re.sub(r"(?<![a-z])(left|right)(?![a-z])", lambda m: {"left": "right"}.get(m[1], "left"), name)


def expect_mirrored(features):
    """The 56 features of the mirror image, told by their names alone."""
    columns = dict(zip(FEATURE_NAMES, features.T, strict=True))
    mirrored = []
    for name in FEATURE_NAMES:
        swapped = other_side(name)
        if swapped in columns:  # right hand above pelvis for left hand above pelvis
            mirrored.append(columns[swapped])
        elif name.startswith("distance"):  # left hand - right hand is right hand - left hand
            mirrored.append(columns[name])
        else:  # head left of pelvis, trunk leaning left: the other way
            assert "left" in name
            mirrored.append(-columns[name])
    return np.stack(mirrored, axis=1)


def wild_motion(seed, frames=5):
    random = np.random.default_rng(seed)
    return canonicalise(walking_body()).positions[:frames] + random.normal(size=(frames, 20, 3)) * 0.15


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_twice_is_the_motion_itself(seed):
    positions = wild_motion(seed)
    np.testing.assert_array_equal(mirror_positions(mirror_positions(positions)), positions)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_features_of_the_mirror_image_are_those_of_the_other_side(seed):
    positions = wild_motion(seed)
    features = compute_pose_features(positions, 1.7)
    mirrored = compute_pose_features(mirror_positions(positions), 1.7)
    np.testing.assert_allclose(mirrored, expect_mirrored(features), atol=1e-12)


def test_channels_of_the_mirror_image_are_those_of_the_other_side():
    """Of the extended features: directions to the left, and turns that a mirror shows the other way, change sign."""
    columns = {channel.name: number for number, channel in enumerate(CHANNELS)}
    positions = canonicalise(make_motion("punch", draw_performer(5))).positions
    channels, mirrored = compute_channels(positions, 1.7), compute_channels(mirror_positions(positions), 1.7)
    for name, column in columns.items():
        body, way = re.fullmatch(r"(.*?)((?: to the left|, seen from).*)?", name).groups(default="")
        pair = re.fullmatch(r"distance (.+) - (.+)", body)
        names = [other_side(body)] + ([f"distance {other_side(pair[2])} - {other_side(pair[1])}"] if pair else [])
        other = next(columns[one + way] for one in names if one + way in columns)
        sign = -1 if way and way != ", seen from the side" else 1
        np.testing.assert_allclose(mirrored[:, column], sign * channels[:, other], atol=1e-9, err_msg=name)


def test_one_pose_by_hand():
    positions = np.zeros((20, 3))
    positions[JOINT_INDEX["left_hand"]] = (0.5, 1.4, 0.2)
    positions[JOINT_INDEX["head"]] = (0.1, 1.6, 0.3)
    mirrored = mirror_positions(positions)
    np.testing.assert_array_equal(mirrored[JOINT_INDEX["right_hand"]], (-0.5, 1.4, 0.2))
    np.testing.assert_array_equal(mirrored[JOINT_INDEX["head"]], (-0.1, 1.6, 0.3))
    np.testing.assert_array_equal(mirrored[JOINT_INDEX["left_hand"]], 0.0)
    assert not np.signbit(mirrored[JOINT_INDEX["pelvis"]]).any()  # no -0


def test_heights_speeds_and_bones_stay():
    walk = canonicalise(make_motion("walk", draw_performer(3)))
    mirrored = mirror_canonical(walk)
    swapped = [CANONICAL_JOINTS.index(other_side(name)) for name in CANONICAL_JOINTS]
    np.testing.assert_array_equal(mirrored.positions[..., 1], walk.positions[:, swapped, 1])
    steps = [np.linalg.norm(np.diff(motion.positions, axis=0), axis=2) for motion in (walk, mirrored)]
    np.testing.assert_allclose(steps[1], steps[0][:, swapped], atol=1e-15)
    assert (mirrored.frame_rate, mirrored.height) == (walk.frame_rate, walk.height)
    assert not mirrored.positions.flags.writeable


def test_the_axes_stay_right_handed():
    for kind in ("walk", "clap"):
        motion = canonicalise(make_motion(kind, draw_performer(2)))
        assert compare_sides(motion.positions) == "agree"
        assert compare_sides(mirror_canonical(motion).positions) == "agree"


def test_what_was_not_seen_and_its_sources_change_sides():
    walk = canonicalise(make_motion("walk", draw_performer(1)))
    missing = np.zeros((walk.n_frames, 20), bool)
    missing[3, JOINT_INDEX["left_toe"]] = True
    motion = CanonicalMotion(
        walk.positions, walk.frame_rate, walk.height, walk.height_source, walk.mapping, ("a",), missing
    )
    mirrored = mirror_canonical(motion)
    assert mirrored.missing.sum() == 1
    assert mirrored.missing[3, JOINT_INDEX["right_toe"]]
    assert mirrored.mapping.sources["left_hand"] == walk.mapping.sources["right_hand"]
    assert mirrored.mapping.sources["head"] == walk.mapping.sources["head"]
    again = mirror_canonical(mirrored)
    assert again.mapping == walk.mapping
    assert again.warnings == ("a",)
    np.testing.assert_array_equal(again.missing, missing)


def test_other_things_with_positions_keep_their_other_fields():
    @dataclass(frozen=True)
    class Clip:
        name: str
        positions: np.ndarray

    clip = Clip("wave", wild_motion(4))
    mirrored = mirror_canonical(clip)
    assert mirrored.name == "wave"
    np.testing.assert_array_equal(mirrored.positions, mirror_positions(clip.positions))


@pytest.mark.parametrize("shape", [(20,), (5, 19, 3), (5, 20, 2), (3, 20)])
def test_other_shapes_are_refused(shape):
    with pytest.raises(InvalidMotionError, match=r"expected canonical positions \(\.\.\., 20, 3\)"):
        mirror_positions(np.zeros(shape))
