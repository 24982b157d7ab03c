"""What the judge sees, against slow readings of the definitions and against motion with known errors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from oracles.wrong_dances import ARM, be_late, get_dance, shrink_arm, turn_limb

from dousa.evaluation.errors.descriptors import LIMB_OF, N_LIMBS, Descriptors, describe_moments, mark_findings
from dousa.evaluation.errors.evidence import Deviations, compute_deviations, gather_evidence
from dousa.evaluation.errors.explain import Finding
from dousa.evaluation.posture.posture import compute_postures, thin_postures
from dousa.motion import CanonicalMotion

MOTION = get_dance()
EVEN = np.ones(9)
FEATURES = 21  # of a limb in one window
OWN, BEST, LAG, GAIN, PATH, UNREACHED = 0, 1, 2, 6, 13, 14
WINDOW_S = (0.5, 1.0, 2.0)


def compare(performance: CanonicalMotion) -> Deviations:
    theirs, ours = (thin_postures(compute_postures(motion)) for motion in (MOTION, performance))
    return compute_deviations(theirs, ours, np.arange(float(ours.n_frames)), EVEN)


def describe(deviations: Deviations) -> Descriptors:
    evidence = gather_evidence(deviations, np.full(9, np.radians(10.0)), 0.07, EVEN)
    return describe_moments(evidence, np.zeros(len(deviations.judged)), 1, [])


def look(descriptors: Descriptors, limb: int, window: int, name: int, start_s: float, end_s: float) -> np.ndarray:
    part = (descriptors.frames >= 30 * start_s) & (descriptors.frames < 30 * end_s)
    return descriptors.limbs[part, limb, window * FEATURES + name]


def test_deviations_at_the_same_and_the_best_time_are_means_over_the_window() -> None:
    deviations = compare(turn_limb(MOTION, [f"left_{joint}" for joint in ARM], 40.0, 5.0, 8.0))
    found = describe(deviations)
    reach = 24
    columns = slice(deviations.center - reach, deviations.center + reach + 1)
    for moment in (20, 90, 97, 200):
        frame = int(found.frames[moment])
        for window, seconds in enumerate(WINDOW_S):
            half = round(0.5 * seconds * 30)
            rows = slice(max(frame - half, 0), frame + half + 1)
            for limb in range(N_LIMBS):
                squared = np.minimum(deviations.squared[rows, columns][:, :, limb == LIMB_OF], 1.3).mean(axis=(0, 2))
                priced = squared + 2e-3 / 30 * np.abs(np.arange(-reach, reach + 1))
                best = int(priced.argmin())
                row = found.limbs[moment, limb, window * FEATURES :]
                assert row[OWN] == pytest.approx(np.sqrt(squared[reach]), abs=1e-5)
                assert row[BEST] == pytest.approx(np.sqrt(squared[best]), abs=1e-5)
                assert row[LAG] == pytest.approx(abs(best - reach) / 30, abs=1e-6)


@pytest.mark.parametrize("lag_s", [-0.3, 0.25])
def test_a_lag_is_seen_in_every_limb_that_moves(lag_s: float) -> None:
    found = describe(compare(be_late(MOTION, lag_s, 5.0, 9.0)))
    lags = [np.median(look(found, limb, 1, LAG, 6.0, 8.0)) for limb in (1, 2)]
    assert lags == pytest.approx([abs(lag_s)] * 2, abs=0.04)


def test_a_smaller_arm_has_its_gain_and_leaves_part_of_the_path_unreached() -> None:
    found = describe(compare(shrink_arm(MOTION, "left", 0.5, 5.0, 8.0)))
    assert np.median(look(found, 1, 1, GAIN, 5.5, 7.5)) == pytest.approx(0.5, abs=0.15)
    assert np.median(look(found, 2, 1, GAIN, 5.5, 7.5)) == pytest.approx(1.0, abs=0.02)
    assert look(found, 1, 2, UNREACHED, 5.5, 7.5).mean() > look(found, 2, 2, UNREACHED, 5.5, 7.5).mean()


def test_who_does_as_the_reference_has_nothing_to_see() -> None:
    found = describe(compare(MOTION))
    for name in (OWN, BEST, LAG, PATH, UNREACHED):
        assert np.abs(found.limbs[:, :, [name, FEATURES + name]]).max() < 1e-6
    assert np.isfinite(found.limbs).all() and np.isfinite(found.body).all()


def test_findings_are_marked_where_they_are() -> None:
    limb, body = (
        Finding("shift", 5, 9, (1, 2), 2.0, 6, lag_s=-0.2),
        Finding("global", 20, 30, tuple(range(9)), 99.0, 21),
    )
    marks = mark_findings([limb, body], 40)
    assert np.flatnonzero(marks[:, 1].any(axis=1)).tolist() == [*range(5, 9), *range(20, 30)]
    assert marks[6, 1].tolist() == [2.0, 0.0, 0.0, 0.0, -0.2, 0.0, 4.0]
    assert not marks[6, N_LIMBS].any() and marks[25, N_LIMBS, 3] == 10.0


@pytest.mark.parametrize("count", [1, 2, 5])
def test_a_few_frames_are_enough(count: int) -> None:
    working = thin_postures(compute_postures(MOTION))

    few = replace(
        working, segments=working.segments[:count], seen=working.seen[:count], heading=working.heading[:count]
    )
    found = describe(compute_deviations(few, few, np.arange(float(count)), EVEN))
    assert np.isfinite(found.limbs).all() and len(found.frames) == -(-count // 2)
