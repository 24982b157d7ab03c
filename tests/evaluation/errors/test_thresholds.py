"""Tolerance: least and most, steadier and less steady performers, and what errors do to it."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import pytest
from oracles.wrong_dances import ARM, be_late, get_dance, turn_limb

from dousa.evaluation.errors.deviation import compute_deviations
from dousa.evaluation.errors.evidence import SLACK_S, Tolerance, measure_unsteadiness
from dousa.evaluation.errors.explain import Finding
from dousa.evaluation.grade.references import compare, find_errors, prepare_references, widen
from dousa.evaluation.posture.posture import LIMBS, compute_postures, thin_postures
from dousa.experiments.injection.injection import simulate_performer
from dousa.motion import CanonicalMotion

EVEN = np.ones(9)
MOTION = get_dance()
LEFT_ARM = [f"left_{joint}" for joint in ARM]


def measure(performance: CanonicalMotion) -> Tolerance:
    theirs, ours = (thin_postures(compute_postures(motion)) for motion in (MOTION, performance))
    return measure_unsteadiness(compute_deviations(theirs, ours, np.arange(float(ours.n_frames)), EVEN))


def learn(motions: Sequence[CanonicalMotion]) -> Tolerance:
    tolerance = prepare_references([compute_postures(motion) for motion in motions], "same", EVEN).tolerance
    assert tolerance is not None
    return tolerance


def test_of_the_steadiest_the_least_is_tolerated() -> None:
    tolerance = measure(MOTION)
    assert np.degrees(tolerance.angle) == pytest.approx(10.0)
    assert tolerance.lag_s == SLACK_S


def test_of_the_less_steady_more_is_tolerated_up_to_a_bound() -> None:
    steadiness = [
        measure(simulate_performer(MOTION, 1, noise_deg=noise, bias_deg=0.0, timing_ms=5.0)).angle.mean()
        for noise in (2.0, 7.0, 12.0, 40.0)
    ]
    assert all(a <= b + 1e-12 for a, b in pairwise(steadiness))
    assert np.degrees(steadiness[0]) < 11.0 < np.degrees(steadiness[1])
    assert np.degrees(steadiness[-1]) == pytest.approx(21.6, abs=0.5)


def test_an_error_hardly_moves_the_tolerance() -> None:
    clean = simulate_performer(MOTION, 3, noise_deg=6.0)
    wrong = turn_limb(clean, LEFT_ARM, 60.0, 4.0, 8.0)
    assert measure(wrong).angle == pytest.approx(measure(clean).angle, rel=0.25)
    assert measure(be_late(MOTION, 0.3, 4.0, 8.0)).lag_s == SLACK_S


def test_no_lag_is_forgiven_without_bound() -> None:
    for performance in (be_late(MOTION, 0.45, 1.0, 19.0), simulate_performer(MOTION, 2, timing_ms=200.0)):
        assert SLACK_S <= measure(performance).lag_s <= 0.3


def test_what_was_found_is_tolerated_a_little_more() -> None:
    start = Tolerance(np.full(9, 0.2), 0.07)
    partial = Finding("partial", 0, 30, (1, 2), 2.0, 10)
    wider = widen(start, [partial])
    assert (wider.angle[[1, 2]] > 0.2).all() and (wider.angle[[0, *range(3, 9)]] == 0.2).all()
    assert wider.lag_s == 0.07
    late = widen(start, [Finding("shift", 0, 30, tuple(range(9)), 2.0, 10, -0.2)])
    assert late.lag_s >= 0.2 and (late.angle == 0.2).all()
    assert widen(start, []).lag_s == 0.07
    # The given one stays as it is.
    assert (start.angle == 0.2).all()


def test_one_take_tells_nothing() -> None:
    assert prepare_references([compute_postures(MOTION)], "same", EVEN).tolerance is None


def test_takes_that_agree_leave_a_margin_only() -> None:
    same = learn([MOTION, MOTION, MOTION])
    more = learn([MOTION] * 6)
    assert (same.angle >= np.radians(10.0)).all() and (more.angle <= same.angle).all()
    assert np.degrees(same.angle).max() < 25.0


def test_what_one_take_does_is_tolerated_in_the_next() -> None:
    habit = turn_limb(MOTION, LEFT_ARM, 35.0, 6.0, 8.0)
    takes = [MOTION, simulate_performer(habit, 1), simulate_performer(MOTION, 2)]
    references = prepare_references([compute_postures(take) for take in takes], "same", EVEN)
    assert references.tolerance is not None
    performance = thin_postures(compute_postures(simulate_performer(habit, 5)))
    comparison = compare(references.working, performance, "same", EVEN)
    found = find_errors(comparison, references.tolerance, EVEN)
    assert not any(set(one.segments) & set(LIMBS["left_arm"]) for one in found)
    alone = compare(references.working[:1], performance, "same", EVEN)
    assert any(
        set(one.segments) & set(LIMBS["left_arm"])
        for one in find_errors(alone, measure_unsteadiness(alone.deviations), EVEN)
    )


def test_the_takes_have_no_error_beside_each_other() -> None:
    takes = [simulate_performer(MOTION, seed, noise_deg=5.0, timing_ms=40.0) for seed in range(3)]
    postures = [compute_postures(take) for take in takes]
    references = prepare_references(postures, "same", EVEN)
    assert references.tolerance is not None
    for number, take in enumerate(postures[1:], start=1):
        others = [one for index, one in enumerate(references.working) if index != number]
        comparison = compare(others, thin_postures(take), "same", EVEN)
        assert find_errors(comparison, references.tolerance, EVEN) == []
