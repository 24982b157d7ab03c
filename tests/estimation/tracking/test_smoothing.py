"""Smoothing of poses: no delay, no change of what is still, nothing across a break."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dousa.estimation.tracking.tracker import smooth_poses
from dousa.motion import rotations as rot


def poses_of(values, rate=30.0):
    """(T, 9) poses that turn about the vertical by the first value and bend two joints by the others."""
    values = np.asarray(values, float)
    poses = np.zeros((len(values), 9))
    poses[:, 3:7] = rot.from_axis_angle(values[:, :1] * (0.0, 1.0, 0.0))
    poses[:, 7:] = values[:, 1:]
    return poses


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 12), st.floats(0.5, 20.0))
def test_what_is_still_stays(seed, n_frames, cutoff):
    pose = np.random.default_rng(seed).normal(size=9)
    pose[3:7] /= np.linalg.norm(pose[3:7])
    poses = np.tile(pose, (n_frames, 1))
    np.testing.assert_allclose(smooth_poses(poses, 30.0, cutoff), poses, atol=1e-12)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_time_backwards_gives_the_same_backwards(seed):
    poses = poses_of(np.random.default_rng(seed).normal(0.0, 0.3, (40, 3)))
    there = smooth_poses(poses, 30.0, 4.0)
    back = smooth_poses(poses[::-1], 30.0, 4.0)[::-1]
    sign = np.sign((there[:, 3:7] * back[:, 3:7]).sum(axis=1, keepdims=True))
    np.testing.assert_allclose(there[:, 3:7], sign * back[:, 3:7], atol=1e-9)
    np.testing.assert_allclose(there[:, 7:], back[:, 7:], atol=1e-9)


def test_a_swing_comes_neither_late_nor_early():
    t = np.arange(300) / 30.0
    swing = np.sin(2 * np.pi * 1.0 * t)
    smooth = smooth_poses(poses_of(np.stack((swing, swing, swing), axis=1)), 30.0, 6.0)[:, 7]
    lags = [float(smooth[20:280] @ swing[20 + lag : 280 + lag]) for lag in range(-5, 6)]
    assert int(np.argmax(lags)) == 5


@pytest.mark.parametrize("rate", [30.0, 120.0])
def test_half_of_the_power_is_left_at_the_cut_off(rate):
    t = np.arange(int(20 * rate)) / rate
    swing = np.cos(2 * np.pi * 2.0 * t)
    poses = poses_of(np.stack((0 * t, swing, swing), axis=1))
    smooth = smooth_poses(poses, rate, 2.0)[:, 7]
    inside = slice(len(t) // 4, -len(t) // 4)
    assert (smooth[inside] @ smooth[inside]) / (swing[inside] @ swing[inside]) == pytest.approx(0.5, abs=0.01)


def test_the_sign_of_a_quaternion_says_nothing():
    turning = poses_of(np.linspace(0.0, 6.0, 60)[:, None] * (1.0, 0.0, 0.0))
    flipped = turning.copy()
    flipped[::3, 3:7] *= -1.0
    expected, found = smooth_poses(turning, 30.0, 6.0), smooth_poses(flipped, 30.0, 6.0)
    dots = (expected[:, 3:7] * found[:, 3:7]).sum(axis=1)
    np.testing.assert_allclose(np.abs(dots), 1.0, atol=1e-12)
    assert (found[1:, 3:7] * found[:-1, 3:7]).sum(axis=1).min() > 0.9  # nothing jumps for what is written out
    np.testing.assert_allclose(np.linalg.norm(found[:, 3:7], axis=1), 1.0, atol=1e-12)


def test_nothing_is_smoothed_across_a_break():
    step = np.repeat((0.0, 1.0), 20)
    poses = poses_of(np.stack((0 * step, step, step), axis=1))
    np.testing.assert_allclose(smooth_poses(poses, 30.0, 3.0, breaks=[20]), poses, atol=1e-12)
    assert np.abs(smooth_poses(poses, 30.0, 3.0) - poses).max() > 0.2
    np.testing.assert_allclose(smooth_poses(poses, 30.0, 3.0, breaks=[0, 20, 20, 40, 99]), poses, atol=1e-12)


def test_the_argument_is_left_alone():
    poses = poses_of(np.random.default_rng(0).normal(size=(10, 3)))
    before = poses.copy()
    smooth_poses(poses, 30.0, 2.0)
    np.testing.assert_array_equal(poses, before)
