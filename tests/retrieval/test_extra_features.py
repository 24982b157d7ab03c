"""The optional features: turning, travel, velocity, duration."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dousa.errors import InvalidMotionError
from dousa.motion import CANONICAL_JOINTS
from dousa.retrieval import EXTRA_FEATURE_NAMES, compute_extra_features

POSE = np.zeros((20, 3))
POSE[CANONICAL_JOINTS.index("left_hip")] = (0.1, 0, 0)  # faces Z
POSE[CANONICAL_JOINTS.index("right_hip")] = (-0.1, 0, 0)
POSE[CANONICAL_JOINTS.index("left_hand")] = (0.3, -0.2, 0.1)


def about_y(angle):
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])


def clip(frames=11, turn=0.0, travel=(0.0, 0.0, 0.0)):
    share = np.linspace(0, 1, frames)
    poses = np.stack([POSE @ about_y(turn * t).T for t in share]) + share[:, None, None] * np.array(travel)
    return SimpleNamespace(positions=poses, height=2.0, frame_rate=10.0)


def named(canonical, n_frames=10):
    return dict(zip(EXTRA_FEATURE_NAMES, compute_extra_features(canonical, n_frames).T, strict=True))


def test_words_mean_what_they_say():
    still = named(clip())
    assert all(not values.any() for name, values in still.items() if name != "duration of the clip")
    assert still["duration of the clip"].tolist() == pytest.approx([1.1] * 10)
    moving = named(clip(turn=np.pi * 1.5, travel=(0.4, 0.2, 1.0)))
    assert moving["body turned to the left since the start"][-1] == pytest.approx(1.5 * np.pi)
    assert moving["body moved to the left since the start"][-1] == pytest.approx(0.2)
    assert moving["body moved upwards since the start"][-1] == pytest.approx(0.1)
    assert moving["body moved forwards since the start"][-1] == pytest.approx(0.5)
    raising = clip()
    raising.positions[:, CANONICAL_JOINTS.index("left_hand"), 1] += np.linspace(0, 2, 11)
    assert named(raising, 11)["left hand moving upwards"].tolist() == pytest.approx([0.1] * 11)


@given(st.floats(-7, 7), st.floats(-5, 5), st.floats(0.3, 3))
def test_place_heading_and_stature_do_not_matter(angle, place, scale):
    here = clip(turn=2.0, travel=(0.4, 0.2, 1.0))
    there = SimpleNamespace(
        positions=here.positions * scale @ about_y(angle).T + place, height=2.0 * scale, frame_rate=10.0
    )
    assert compute_extra_features(there) == pytest.approx(compute_extra_features(here), abs=1e-9)


def test_one_frame_stands_still():
    assert not compute_extra_features(clip(1), 1)[:, :-1].any()
    assert compute_extra_features(clip(1), 10).shape == (10, 26)


def test_bad_clips_are_refused():
    bad = clip()
    bad.height = 0.0
    with pytest.raises(InvalidMotionError, match="height"):
        compute_extra_features(bad)
    bad = clip()
    bad.positions[0, 0, 0] = np.nan
    with pytest.raises(InvalidMotionError, match="finite"):
        compute_extra_features(bad)
