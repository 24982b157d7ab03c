"""Evidence: ratios and what is forgiven, the lag to a fraction of a frame, and the stretches that differ."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from oracles.wrong_dances import ARM, be_late, choose, get_dance, lose, place, shrink_arm, turn_limb

from dousa.evaluation.errors.evidence import (
    CAP,
    Evidence,
    at_lag,
    compute_deviations,
    find_stretches,
    gather_evidence,
    refine_lag,
)
from dousa.evaluation.posture.posture import compute_postures, thin_postures
from dousa.motion import CanonicalMotion
from lab.injection.injection import simulate_performer

TOLERANCE = np.full(9, np.radians(10.0))
EVEN = np.ones(9)
LEFT_ARM = [f"left_{joint}" for joint in ARM]
MOTION = get_dance(12.0)


def gather(performance: CanonicalMotion, reference: CanonicalMotion = MOTION, weights: np.ndarray = EVEN) -> Evidence:
    theirs, ours = (thin_postures(compute_postures(motion)) for motion in (reference, performance))
    deviations = compute_deviations(theirs, ours, np.arange(float(ours.n_frames)), weights)
    return gather_evidence(deviations, TOLERANCE, 0.07, weights)


def test_values_at_a_lag_are_those_of_the_column() -> None:
    ratio = np.random.default_rng(0).random((5, 7, 9))
    course = np.array([0, 6, 3, 2, 2])
    found = at_lag(ratio, course)
    for t, column in enumerate(course):
        assert np.array_equal(found[t], ratio[t, column])


def test_ratios_are_squares_in_multiples_of_the_tolerance_up_to_a_cap() -> None:
    evidence = gather(turn_limb(MOTION, LEFT_ARM, 15.0, 4.0, 7.0))
    apart = evidence.deviations.performance - evidence.deviations.reference
    assert evidence.punctual == pytest.approx((apart**2).sum(axis=2) / np.radians(10.0) ** 2, abs=1e-6)
    assert 1.0 < evidence.punctual[120:210, 1].max() < 1.5**2 + 0.3
    far = gather(turn_limb(MOTION, LEFT_ARM, 120.0, 4.0, 7.0))
    assert far.ratio.max() == CAP
    # A weight counts after the cap.
    weights = np.array([1.0, 2.0, 2.0, *[0.5] * 6])
    heavy = gather(turn_limb(MOTION, LEFT_ARM, 120.0, 4.0, 7.0), weights=weights)
    assert heavy.ratio[..., 1].max() == 2.0 * CAP and heavy.ratio[..., 3].max() <= 0.5 * CAP


def test_a_small_lag_is_forgiven_a_larger_one_is_not() -> None:
    slightly = gather(choose(MOTION, np.maximum(np.arange(360) - 2, 0)))
    assert slightly.slack == 2
    assert slightly.ordinary[30:330].max() < 1e-6
    assert slightly.punctual[30:330].sum(axis=1).mean() > 0.02
    late = gather(choose(MOTION, np.maximum(np.arange(360) - 9, 0)))
    moving = late.ordinary[30:330].sum(axis=1) > 3.0
    assert np.abs(late.course[30:330][moving] - (late.center - 9)).max() <= 1
    assert find_stretches(late)


def test_identity_has_no_evidence() -> None:
    for motion in (MOTION, place(MOTION, 2.0, 1.0, 3.0, 0.8)):
        evidence = gather(motion)
        assert evidence.ordinary.max() < 1e-9
        assert (evidence.course == evidence.center).all()
        assert np.abs(refine_lag(evidence, evidence.course)).max() == 0.0
        assert find_stretches(evidence) == []


@pytest.mark.parametrize("lag_s", [-0.31, -0.12, 0.145, 0.2, 0.42])
def test_the_lag_is_found_to_a_fraction_of_a_frame(lag_s: float) -> None:
    evidence = gather(be_late(MOTION, lag_s, 3.0, 8.0))
    lag = refine_lag(evidence, evidence.course)
    away = np.abs(lag[120:210] - lag_s)
    assert np.percentile(away, 85) < 0.005 and away.max() < 0.035
    # Also from the middle on.
    assert np.array_equal(refine_lag(evidence, evidence.course[120:], 120)[20:-20], lag[140:-20])


def test_what_is_wrong_is_a_stretch() -> None:
    for wrong in (
        turn_limb(MOTION, LEFT_ARM, 40.0, 5.0, 7.0),
        be_late(MOTION, 0.3, 5.0, 7.4),
        shrink_arm(MOTION, "right", 0.4, 5.0, 7.4),
    ):
        stretches = find_stretches(gather(wrong))
        assert len(stretches) == 1
        start, end = stretches[0]
        assert 145 <= start <= 175 and 195 <= end <= 226


def test_a_clean_performance_has_hardly_a_stretch() -> None:
    found = sum(len(find_stretches(gather(simulate_performer(MOTION, seed)))) for seed in range(5))
    assert found <= 1


def test_moments_near_each_other_are_one_stretch() -> None:
    near = turn_limb(turn_limb(MOTION, LEFT_ARM, 60.0, 4.0, 5.5), LEFT_ARM, 60.0, 5.6, 7.0)
    apart = turn_limb(turn_limb(MOTION, LEFT_ARM, 60.0, 3.0, 4.0), LEFT_ARM, 60.0, 6.0, 7.0)
    assert len(find_stretches(gather(near))) == 1
    assert len(find_stretches(gather(apart))) == 2


@pytest.mark.parametrize("who", ["performance", "reference"])
def test_gaps_are_no_evidence(who: str) -> None:
    gone = lose(MOTION, LEFT_ARM, 4.0, 7.0)
    evidence = gather(gone) if who == "performance" else gather(MOTION, gone)
    assert find_stretches(evidence) == []
    assert np.abs(refine_lag(evidence, evidence.near)).max() < 0.02


def test_an_arm_that_is_wrong_beside_a_gap_is_not_late() -> None:
    wrong = turn_limb(MOTION, LEFT_ARM, 60.0, 5.0, 7.0)
    stretches = find_stretches(gather(wrong, lose(MOTION, LEFT_ARM, 7.0, 8.0)))
    assert len(stretches) == 1


@pytest.mark.parametrize("count", [2, 5, 12])
def test_a_few_frames_are_enough(count: int) -> None:
    few = replace(MOTION, positions=MOTION.positions[:count])
    evidence = gather(few, few)
    assert find_stretches(evidence) == []
    assert refine_lag(evidence, evidence.course).shape == (count,)
