"""Gain: motions of a known size, in vectors and in angles, whole stretches and windows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles.wrong_dances import get_dance, lose, shrink_arm

from dousa.evaluation.errors.evidence import (
    GROUPS,
    Deviations,
    compute_deviations,
    find_shrunk,
    fit_gain,
    measure_missing_range,
    measure_ranges,
)
from dousa.evaluation.posture.posture import LIMBS, compute_postures, thin_postures
from dousa.motion import CanonicalMotion

TOLERANCE = np.full(9, np.radians(10.0))
QUICK = settings(max_examples=25, deadline=None)


def unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def swing(count: int = 40, reach: float = 0.9, seed: int = 0) -> np.ndarray:
    """(T, 2, 3): an upper arm and a forearm that swing about any axes."""
    rng = np.random.default_rng(seed)
    middle, axis = unit(rng.normal(size=(2, 3))), rng.normal(size=(2, 3))
    axis = unit(axis - (axis * middle).sum(axis=1, keepdims=True) * middle)
    angle = reach * np.sin(np.linspace(0.0, 7.0, count))[:, None, None]
    return np.cos(angle) * middle + np.sin(angle) * axis


def deviate(reference: CanonicalMotion, performance: CanonicalMotion) -> Deviations:
    theirs, ours = (thin_postures(compute_postures(motion)) for motion in (reference, performance))
    return compute_deviations(theirs, ours, np.arange(float(ours.n_frames)), np.ones(9))


@given(gain=st.floats(0.3, 0.95), seed=st.integers(0, 1000))
@QUICK
def test_shrunk_angles_have_their_gain(gain: float, seed: int) -> None:
    reference = swing(seed=seed)
    smaller = swing(reach=0.9 * gain, seed=seed)
    fit = fit_gain(smaller, reference, TOLERANCE[:2])
    assert fit.gain == pytest.approx(gain, abs=0.04)
    assert fit.unexplained < 0.05
    assert np.abs(fit.predict(reference) - smaller).max() < 0.08
    assert fit.compute_rest(smaller, reference, TOLERANCE[:2]).max() < 0.3


@given(gain=st.floats(0.3, 0.95), seed=st.integers(0, 1000))
@QUICK
def test_averaged_vectors_have_about_their_gain(gain: float, seed: int) -> None:
    reference = swing(seed=seed)
    smaller = unit(reference.mean(axis=0) + gain * (reference - reference.mean(axis=0)))
    fit = fit_gain(smaller, reference, TOLERANCE[:2])
    assert fit.gain == pytest.approx(gain, abs=0.12)
    assert np.degrees(np.arccos(np.clip((fit.predict(reference) * smaller).sum(axis=2), -1, 1))).max() < 6.0


def test_the_same_motion_has_gain_one_and_so_has_one_held_elsewhere() -> None:
    reference = swing()
    same = fit_gain(reference, reference, TOLERANCE[:2])
    assert same.gain == pytest.approx(1.0)
    assert np.allclose(same.predict(reference), reference)
    assert same.compute_rest(reference, reference, TOLERANCE[:2]).max() < 1e-12
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    still = fit_gain(np.broadcast_to(reference[:1], reference.shape), reference @ turn, TOLERANCE[:2])
    assert still.gain == pytest.approx(0.0, abs=1e-9)


def test_a_moment_that_is_wrong_does_not_bend_the_gain() -> None:
    reference = swing(count=60)
    smaller = swing(count=60, reach=0.54)
    smaller[20:26] = -smaller[20:26]
    assert fit_gain(smaller, reference, TOLERANCE[:2]).gain == pytest.approx(0.6, abs=0.06)


def test_nothing_that_moves_is_no_error() -> None:
    still = np.broadcast_to(swing()[:1], (30, 2, 3))
    fit = fit_gain(still, still, TOLERANCE[:2])
    assert np.isfinite([fit.gain, fit.unexplained, fit.off_center]).all()
    assert np.isfinite(fit.predict(still)).all()
    one = fit_gain(still[:1], still[:1], TOLERANCE[:2])
    assert np.isfinite(one.gain)


def test_windows_of_a_shrunk_arm_are_found() -> None:
    motion = get_dance(12.0)
    deviations = deviate(motion, shrink_arm(motion, "left", 0.5, 5.0, 7.4))
    windows = find_shrunk(deviations, TOLERANCE, 30.0)
    assert windows
    covered = np.zeros(360, bool)
    for start, end in windows:
        assert not covered[start:end].any()  # apart
        covered[start:end] = True
    assert covered[160:210].mean() > 0.7
    assert not covered[:135].any() and not covered[240:].any()


def test_a_larger_motion_and_the_same_motion_are_not_shrunk() -> None:
    motion = get_dance(12.0)
    for performance in (motion, shrink_arm(motion, "left", 1.4, 5.0, 7.4)):
        assert find_shrunk(deviate(motion, performance), TOLERANCE, 30.0) == []


def test_no_window_looks_into_a_gap() -> None:
    motion = get_dance(12.0)
    smaller = shrink_arm(motion, "left", 0.5, 5.0, 7.4)
    gone = lose(smaller, ["left_elbow", "left_wrist"], 4.9, 7.5)
    assert find_shrunk(deviate(motion, gone), TOLERANCE, 30.0) == []


def test_motions_shorter_than_a_window_have_none() -> None:
    motion = get_dance(12.0)
    few = replace(motion, positions=motion.positions[:15])
    assert find_shrunk(deviate(few, few), TOLERANCE, 30.0) == []


def test_the_body_and_each_limb_are_groups() -> None:
    assert set(GROUPS) == {"body", *LIMBS}
    assert np.array_equal(GROUPS["body"], np.arange(9))


@given(reach=st.floats(0.05, 1.5))
@QUICK
def test_the_range_of_a_swing_is_twice_its_reach(reach: float) -> None:
    dense = swing(count=80, reach=reach)
    # The sine comes within a frame of both ends.
    assert measure_ranges(dense) == pytest.approx(2 * reach, rel=0.01)
    assert measure_ranges(dense[:1]) == pytest.approx(0.0, abs=1e-7)


def test_missing_range_is_that_of_the_segment_that_lacks_most() -> None:
    reference = np.zeros((60, 9, 3))
    reference[..., 1] = 1.0
    reference[:, 3:5] = swing(60, 0.8, 1)
    smaller = reference.copy()
    smaller[:, 3:5] = swing(60, 0.5, 1)
    missing, share = measure_missing_range(reference, smaller, smaller, np.array([3, 4]))
    assert missing == pytest.approx(0.6, abs=0.02)
    assert share == pytest.approx(0.6 / 1.6, abs=0.02)
    assert measure_missing_range(smaller, reference, reference, np.array([3, 4]))[0] == 0.0
