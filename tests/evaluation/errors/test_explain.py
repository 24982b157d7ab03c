"""Explanations: the class, the limbs and the size of errors put in by hand."""

from __future__ import annotations

import numpy as np
import pytest
from oracles.wrong_dances import (
    ARM,
    be_late,
    choose,
    get_dance,
    place,
    shrink_arm,
    swap_section,
    turn_limb,
)

from dousa.evaluation.errors.evidence import compute_deviations, find_stretches, gather_evidence
from dousa.evaluation.errors.explain import Finding, explain, find_best_span
from dousa.evaluation.posture.posture import LIMBS, compute_postures, thin_postures
from dousa.motion import CanonicalMotion

TOLERANCE = np.full(9, np.radians(10.0))
MOTION = get_dance()
CHAINS = {
    "left_arm": [f"left_{joint}" for joint in ARM],
    "right_arm": [f"right_{joint}" for joint in ARM],
    "left_leg": ["left_hip", "left_knee", "left_ankle", "left_toe"],
    "right_leg": ["right_hip", "right_knee", "right_ankle", "right_toe"],
}


def find(performance: CanonicalMotion) -> list[Finding]:
    theirs, ours = (thin_postures(compute_postures(motion)) for motion in (MOTION, performance))
    deviations = compute_deviations(theirs, ours, np.arange(float(ours.n_frames)), np.ones(9))
    evidence = gather_evidence(deviations, TOLERANCE, 0.07, np.ones(9))
    return [one for start, end in find_stretches(evidence) for one in explain(evidence, start, end)]


@pytest.mark.parametrize("lag_s", [-0.5, -0.25, 0.2, 0.35, 0.6])
def test_a_shift_has_its_lag(lag_s: float) -> None:
    (finding,) = find(be_late(MOTION, lag_s, 5.0, 9.0))
    assert finding.kind == "shift"
    assert finding.lag_s == pytest.approx(lag_s, abs=0.02)
    assert finding.start == pytest.approx(155, abs=15) and finding.end == pytest.approx(265, abs=15)
    assert len(finding.segments) == 9
    assert finding.shortfall is None
    assert finding.start <= finding.worst < finding.end
    assert finding.severity == pytest.approx(abs(lag_s) / 0.0667, rel=0.1)


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("gain", [0.4, 0.65])
def test_an_arm_that_is_short_is_incomplete(side: str, gain: float) -> None:
    (finding,) = find(shrink_arm(MOTION, side, gain, 5.0, 8.0))
    assert finding.kind == "incomplete"
    assert set(finding.segments) == set(LIMBS[f"{side}_arm"])
    assert finding.lag_s is None
    assert finding.shortfall is not None and finding.shortfall_share is not None
    assert finding.shortfall_share == pytest.approx(1.0 - gain, abs=0.17)
    assert finding.start == pytest.approx(155, abs=15) and finding.end == pytest.approx(235, abs=15)


@pytest.mark.parametrize("limb", list(CHAINS))
def test_a_limb_that_does_something_else_is_partial(limb: str) -> None:
    (finding,) = find(turn_limb(MOTION, CHAINS[limb], 45.0, 5.0, 7.0))
    assert finding.kind == "partial"
    assert set(finding.segments) <= set(LIMBS[limb])
    assert finding.start == pytest.approx(153, abs=10) and finding.end == pytest.approx(207, abs=10)
    assert 2.0 < finding.severity < 6.0


def test_another_section_is_global() -> None:
    (finding,) = find(swap_section(MOTION, 5.0, 7.0, 13.0))
    assert finding.kind == "global"
    assert finding.segments == tuple(range(9))
    assert finding.start == pytest.approx(152, abs=10) and finding.end == pytest.approx(208, abs=10)


def test_nothing_wrong_has_no_explanation() -> None:
    assert find(MOTION) == []
    assert find(place(MOTION, 1.0, 2.0, 3.0, 1.2)) == []


def test_a_stretch_of_one_frame_or_of_tolerable_frames_has_none() -> None:
    ours = thin_postures(compute_postures(MOTION))
    deviations = compute_deviations(ours, ours, np.arange(float(ours.n_frames)), np.ones(9))
    evidence = gather_evidence(deviations, TOLERANCE, 0.07, np.ones(9))
    assert explain(evidence, 100, 101) == []
    assert explain(evidence, 100, 160) == []


def test_an_arm_that_is_wrong_while_late_is_told_too() -> None:
    both = be_late(turn_limb(MOTION, CHAINS["right_arm"], 25.0, 6.0, 7.0), 0.5, 4.0, 10.0)
    found = find(both)
    assert {one.kind for one in found} == {"shift", "partial"}
    partial = next(one for one in found if one.kind == "partial")
    assert set(partial.segments) <= set(LIMBS["right_arm"])
    assert next(one for one in found if one.kind == "shift").lag_s == pytest.approx(0.5, abs=0.02)


def test_two_errors_far_apart_are_two() -> None:
    found = find(be_late(turn_limb(MOTION, CHAINS["left_leg"], 40.0, 3.0, 5.0), -0.3, 9.0, 13.0))
    assert [one.kind for one in found] == ["partial", "shift"]


def test_holding_a_pose_too_early_leaves_the_extreme_out() -> None:
    # To the middle of the way to the raised arms, then back.
    frames = np.arange(MOTION.n_frames)
    frames[137:157] = 137
    frames[157:176] = np.linspace(137, 128, 19).round().astype(int)
    found = find(choose(MOTION, frames))
    assert found and all(one.kind != "global" for one in found[:1])


@pytest.mark.parametrize(
    ("gains", "expected"),
    [([-1, 2, 3, -1, 4, -9, 5], (1, 5)), ([-1.0], (0, 1)), ([1.0, 1.0], (0, 2)), ([-3.0, -1.0], (1, 2))],
)
def test_the_best_span_has_the_largest_sum(gains: list[float], expected: tuple[int, int]) -> None:
    assert find_best_span(np.array(gains)) == expected
    sums = {(a, b): sum(gains[a:b]) for a in range(len(gains)) for b in range(a + 1, len(gains) + 1)}
    assert sums[expected] == max(sums.values())
