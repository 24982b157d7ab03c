"""The channels of the extended features against whole-array NumPy, and what they must not know."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles import slow_channels
from oracles.standing import standing

from dousa.errors import InvalidMotionError
from dousa.kernels import kernel
from dousa.motion.canonical.joints import CANONICAL_JOINTS
from dousa.retrieval.features.channel_kernels import find_angle, smooth
from dousa.retrieval.features.channels import CHANNELS, compute_channels, integrate_channels, sample_positions
from dousa.retrieval.features.pose_features import find_lateral_axis

HEIGHT = 1.7


def wander(n_frames, seed=0):
    """A standing body whose joints all wander."""
    generator = np.random.default_rng(seed)
    steps = generator.normal(0.0, 0.02, (n_frames, len(CANONICAL_JOINTS), 3))
    return standing() + np.cumsum(steps, axis=0)


@pytest.mark.parametrize("n_frames", [1, 2, 3, 40])
def test_channels_are_those_of_whole_arrays(n_frames):
    positions = wander(n_frames)
    expected = slow_channels.compute_channels(positions, HEIGHT)
    found = compute_channels(positions, HEIGHT)
    assert found.shape == (n_frames, len(CHANNELS))
    np.testing.assert_allclose(found, expected, atol=1e-9)


@pytest.mark.parametrize("lying", [(), (0, 1), (20, 21, 39), range(5, 40), range(40)])
@pytest.mark.parametrize("missing", [(), ("left_hip",), ("left_shoulder", "right_hip")])
def test_left_is_told_by_hips_or_shoulders_or_as_before(lying, missing):
    points = wander(40)
    # On one side: the lines of hips and shoulders stand upright.
    points[list(lying)] = points[list(lying)][..., [1, 0, 2]] + np.array([0.0, 0.0, 0.01])
    points[3] = points[3, :1]  # no line at all
    points[:, [CANONICAL_JOINTS.index(joint) for joint in missing]] = np.nan
    seen = points - points[:, :1]
    with np.errstate(invalid="ignore"):
        np.testing.assert_array_equal(find_lateral_axis(seen), slow_channels.find_lateral_axis(seen))


@settings(max_examples=25, deadline=None)
@given(turn=st.floats(-np.pi, np.pi), east=st.floats(-9, 9), north=st.floats(-9, 9), scale=st.floats(0.5, 2))
def test_channels_know_neither_place_nor_heading_nor_size(turn, east, north, scale):
    positions = wander(12)
    cos, sin = np.cos(turn), np.sin(turn)
    around = np.array([[cos, 0, sin], [0, 1, 0], [-sin, 0, cos]])
    moved = (positions @ around.T + [east, 0.3, north]) * scale
    np.testing.assert_allclose(compute_channels(moved, HEIGHT * scale), compute_channels(positions, HEIGHT), atol=1e-6)


def test_names_are_unique_and_in_words():
    names = [channel.name for channel in CHANNELS]
    assert len(set(names)) == len(names) == 86
    assert not any("_" in name for name in names)


def test_integrals_are_sums_over_motion_time():
    rows = compute_channels(wander(20), HEIGHT)
    times, integrals = integrate_channels(rows)
    speeds = [k for k, channel in enumerate(CHANNELS) if channel.name.startswith("speed of")]
    weights = (rows[:, speeds].sum(axis=1) + 0.5) / 30.0
    np.testing.assert_allclose(np.diff(times), weights)
    middles = 0.5 * (times[1:] + times[:-1])
    expected = np.concatenate([rows, rows**2, rows * middles[:, None]], axis=1) * weights[:, None]
    np.testing.assert_allclose(integrals[1:], np.cumsum(expected, axis=0), atol=1e-9)


@pytest.mark.parametrize(("rate", "count"), [(120.0, 25), (30.0, 100), (29.97, 100), (15.0, 200), (1.0, 3_000)])
def test_recordings_are_sampled_at_30_hz(rate, count):
    line = np.linspace(0.0, 1.0, 100)[:, None, None] * np.ones((1, 2, 3))
    sampled = sample_positions(line, rate)
    assert sampled.shape == (count, 2, 3)
    assert sampled.min() >= 0.0
    assert sampled.max() <= 1.0
    assert (np.diff(sampled[:, 0, 0]) >= 0).all()


@pytest.mark.parametrize("rate", [0.5, 1e-9, float("nan")])
def test_a_rate_near_zero_is_refused_before_it_fills_the_memory(rate):
    with pytest.raises(InvalidMotionError, match="frame rate of 1 Hz or more"):
        sample_positions(np.zeros((100, 2, 3)), rate)


def test_sampling_keeps_the_mean_of_a_fast_recording():
    values = np.random.default_rng(0).normal(size=(120, 1, 3))
    np.testing.assert_allclose(sample_positions(values, 120.0), values.reshape(30, 4, 1, 3).mean(axis=1))


@kernel
def smooth_rows(values, weights, out):
    smooth(values, weights, out)


@given(st.floats(-1e6, 1e6), st.floats(-1e6, 1e6))
def test_angles_are_those_of_numpy(y, x):
    assert find_angle.py_func(y + 0.0, x + 0.0) == pytest.approx(np.arctan2(y + 0.0, x + 0.0), rel=1e-15, abs=1e-300)


@pytest.mark.parametrize("n_frames", [1, 2, 5, 24, 40])
@pytest.mark.parametrize("width", [1, 2, 3, 4])
def test_narrow_rows_are_smoothed_as_wide_ones(n_frames, width):
    draw = np.random.default_rng(n_frames)
    narrow, weights = draw.normal(size=(n_frames, width)), draw.uniform(size=12)
    even, wide = np.empty(narrow.shape), np.empty((n_frames, 8))
    smooth_rows(narrow, weights, even)
    smooth_rows(np.pad(narrow, ((0, 0), (0, 8 - width))), weights, wide)
    np.testing.assert_array_equal(even, wide[:, :width])
