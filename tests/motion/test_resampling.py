"""Resampling, thinning and gap filling."""

import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dousa.errors import InvalidMotionError, OptionError
from dousa.motion import Motion, Provenance, Skeleton, Trajectories, fill_gaps, resample, thin
from dousa.motion.resampling import smooth_gaussian
from dousa.motion.rotations import from_axis_angle


def make_trajectories(n_frames=7, rate=30.0, seed=0):
    positions = np.random.default_rng(seed).normal(size=(n_frames, 3, 3))
    return Trajectories(("a", "b", "c"), positions, rate, provenance=Provenance("x", "trc", values=positions))


def make_turning(n_frames=5, rate=10.0, step=0.3):
    """One joint turning about Z at a constant speed, moving along X at a constant speed."""
    angle = np.arange(n_frames)[:, None, None] * step
    rotations = from_axis_angle(angle * np.array([0.0, 0.0, 1.0]))
    translations = angle * np.array([1.0, 0.0, 0.0])
    return Motion(Skeleton(("root",), [-1], [[0, 0, 0]]), rotations, translations, rate)


def test_the_same_rate_is_the_same_object():
    moving = make_trajectories()
    assert resample(moving, 30.0) is moving


def test_half_the_rate_takes_every_second_frame_exactly():
    moving = make_trajectories()
    thinned = resample(moving, 15)
    assert thinned.frame_rate == 15
    np.testing.assert_array_equal(thinned.positions, moving.positions[::2])
    assert thinned.provenance.values is None


def test_double_the_rate_puts_a_frame_between_two():
    moving = make_trajectories()
    doubled = resample(moving, 60)
    assert doubled.n_frames == 13
    np.testing.assert_array_equal(doubled.positions[::2], moving.positions)
    np.testing.assert_allclose(doubled.positions[1], moving.positions[:2].mean(0))


@given(rate=st.floats(0.5, 500))
def test_steady_turning_and_moving_stay_steady(rate):
    motion = make_turning()
    again = resample(motion, rate)
    seconds = np.arange(again.n_frames) / rate
    assert seconds[-1] <= 0.4 + 1e-6
    assert seconds[-1] > 0.4 - 1 / rate - 1e-6
    np.testing.assert_allclose(again.translations[:, 0, 0], 3.0 * seconds, atol=1e-9)
    expected = from_axis_angle(3.0 * seconds[:, None] * np.array([0.0, 0.0, 1.0]))
    np.testing.assert_allclose(again.rotations[:, 0], expected, atol=1e-9)


def test_rotations_take_the_shorter_arc():
    rotations = np.array([[[1.0, 0, 0, 0]], [[-np.cos(0.1), 0, 0, -np.sin(0.1)]]])
    motion = Motion(Skeleton(("r",), [-1], [[0, 0, 0]]), rotations, np.zeros((2, 1, 3)), 1.0)
    np.testing.assert_allclose(resample(motion, 2.0).rotations[1, 0], [np.cos(0.05), 0, 0, np.sin(0.05)])


def test_missing_stays_missing_and_does_not_spread():
    positions = np.ones((5, 2, 3))
    positions[2, 0] = np.nan
    moving = Trajectories(("a", "b"), positions, 10.0)
    doubled = np.isnan(resample(moving, 20.0).positions[:, 0, 0])
    assert np.flatnonzero(doubled).tolist() == [3, 4, 5]
    rotations = np.tile([1.0, 0, 0, 0], (3, 1, 1))
    rotations[1] = np.nan
    motion = Motion(Skeleton(("r",), [-1], [[0, 0, 0]]), rotations, np.zeros((3, 1, 3)), 10.0)
    assert np.isnan(resample(motion, 20.0).rotations[:, 0, 0]).tolist() == [False, True, True, True, False]


def test_one_frame_stays_one_frame():
    assert resample(make_trajectories(1), 120).n_frames == 1


@pytest.mark.parametrize("rate", [0, -1, float("nan"), float("inf"), 2e6])
def test_impossible_rates(rate):
    with pytest.raises(OptionError):
        resample(make_trajectories(), rate)


def test_too_many_frames():
    moving = Trajectories(("a",), np.zeros((3000, 1, 3)), 1.0)
    with pytest.raises(OptionError, match="would make"):
        resample(moving, 1e6)


def test_thin_takes_nearest_frames():
    assert thin(np.arange(10), 10).tolist() == list(range(10))
    assert thin(np.arange(5), 3).tolist() == [0, 2, 4]
    assert thin(np.arange(2), 5).tolist() == [0, 0, 1, 1, 1]
    assert thin(np.arange(9), 1).tolist() == [0]
    assert thin(np.zeros((7, 2, 3)), 4).shape == (4, 2, 3)


@given(frames=st.integers(1, 200), n=st.integers(2, 50))
def test_thin_is_nearest_to_equal_spacing(frames, n):
    chosen = thin(np.arange(frames), n)
    ideal = np.linspace(0, frames - 1, n)
    assert chosen[0] == 0
    assert chosen[-1] == frames - 1
    assert (np.abs(chosen - ideal) <= 0.5 + 1e-9).all()


def test_thin_refuses_nothing():
    with pytest.raises(OptionError):
        thin(np.arange(3), 0)
    with pytest.raises(InvalidMotionError):
        thin(np.zeros((0, 3)), 2)


def test_fill_gaps_bridges_holds_and_leaves_the_unseen():
    positions = np.full((5, 3, 3), np.nan)
    positions[1, 0], positions[3, 0] = 1.0, 3.0
    positions[:, 2] = 7.0
    filled = fill_gaps(positions)
    assert filled[:, 0, 0].tolist() == [1, 1, 2, 3, 3]
    assert np.isnan(filled[:, 1]).all()
    assert (filled[:, 2] == 7).all()
    assert np.isnan(positions[0, 0, 0]), "the argument is left alone"


def test_a_point_with_one_missing_coordinate_is_missing():
    positions = np.zeros((3, 1, 3))
    positions[1, 0] = [np.nan, 5.0, 5.0]
    assert (fill_gaps(positions) == 0).all()


@settings(max_examples=50)
@given(seed=st.integers(0, 10_000))
def test_fill_gaps_keeps_what_was_seen(seed):
    rng = np.random.default_rng(seed)
    positions = rng.normal(size=(8, 4, 3))
    hidden = rng.random((8, 4)) < 0.4
    positions[hidden] = np.nan
    filled = fill_gaps(positions)
    np.testing.assert_array_equal(filled[~hidden], positions[~hidden])
    assert np.isfinite(filled[:, ~hidden.all(0)]).all()
    np.testing.assert_array_equal(fill_gaps(filled), filled)


def test_fill_gaps_wants_points():
    with pytest.raises(InvalidMotionError):
        fill_gaps(np.zeros((3, 3)))


@pytest.mark.parametrize("deviation", [0.1, 0.3, 2.7, 30.0])
@pytest.mark.parametrize("shape", [(1, 3), (7,), (60, 4, 3)])
def test_little_is_smoothed_as_by_scipy(monkeypatch, deviation, shape):
    values = np.random.default_rng(0).normal(size=shape)
    values[shape[0] // 3, ...] = np.nan if shape[0] == 60 else 0.0
    wanted = smooth_gaussian(values, deviation, small=0)
    monkeypatch.delitem(sys.modules, "scipy.ndimage")
    np.testing.assert_array_equal(smooth_gaussian(values, deviation), wanted)
