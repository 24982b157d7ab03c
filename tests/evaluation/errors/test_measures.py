"""Sizes of errors that were put in by hand: lag, missing range, segments."""

from __future__ import annotations

import numpy as np
import pytest
from oracles.wrong_dances import ARM, be_late, get_dance, shrink_arm, turn_limb

from dousa.evaluation.errors.evidence import compute_deviations, gather_evidence
from dousa.evaluation.errors.explain import Finding
from dousa.evaluation.errors.judge import Suspect
from dousa.evaluation.errors.measures import measure_suspects
from dousa.evaluation.posture.posture import LIMBS, compute_postures, thin_postures
from dousa.motion import CanonicalMotion

MOTION = get_dance()
ALL, LEFT_ARM = (0, 1, 2, 3, 4), (1,)


def measure(performance: CanonicalMotion, kind: str, start_s: float, end_s: float, limbs: tuple[int, ...]) -> Finding:
    theirs, ours = (thin_postures(compute_postures(motion)) for motion in (MOTION, performance))
    deviations = compute_deviations(theirs, ours, np.arange(float(ours.n_frames)), np.ones(9))
    evidence = gather_evidence(deviations, np.full(9, np.radians(10.0)), 0.07, np.ones(9))
    frames = np.arange(0, ours.n_frames, 2)
    (found,) = measure_suspects(evidence, [Suspect(kind, round(15 * start_s), round(15 * end_s), limbs, 1.0)], frames)
    # A shift begins and ends where it is seen to, later and earlier than where it was suspected.
    most = 9 if kind == "shift" else 2
    assert -2 <= found.start - 30 * start_s <= most and -most <= found.end - 30 * end_s <= 2
    return found


@pytest.mark.parametrize("lag_s", [-0.4, -0.2, 0.12, 0.3, 0.5])
def test_a_shift_has_its_lag(lag_s: float) -> None:
    found = measure(be_late(MOTION, lag_s, 5.0, 9.0), "shift", 5.0, 9.0, ALL)
    assert found.lag_s == pytest.approx(lag_s, abs=0.025)
    assert found.segments == tuple(range(9)) and found.shortfall is None


@pytest.mark.parametrize("gain", [0.4, 0.7])
def test_an_arm_that_is_short_lacks_range(gain: float) -> None:
    found = measure(shrink_arm(MOTION, "left", gain, 5.0, 8.0), "incomplete", 5.0, 8.0, LEFT_ARM)
    assert found.segments == LIMBS["left_arm"] and found.lag_s is None
    assert found.shortfall is not None and found.shortfall_share is not None
    assert found.shortfall_share == pytest.approx(1.0 - gain, abs=0.2)
    assert 5 * 30 - 2 <= found.worst <= 8 * 30 + 2


def test_of_a_wrong_limb_the_segments_that_are_wrong_are_named() -> None:
    found = measure(turn_limb(MOTION, [f"left_{j}" for j in ARM], 60.0, 5.0, 8.0), "partial", 5.0, 8.0, LEFT_ARM)
    assert set(found.segments) <= {1, 2} and found.segments
    assert found.severity > 2.0


def test_what_nobody_saw_is_no_error() -> None:
    theirs = thin_postures(compute_postures(MOTION))
    outside = compute_deviations(theirs, theirs, np.arange(float(theirs.n_frames)) + 1e4, np.ones(9))
    evidence = gather_evidence(outside, np.full(9, np.radians(10.0)), 0.07, np.ones(9))
    suspects = [Suspect("partial", 10, 30, LEFT_ARM, 1.0)]
    assert measure_suspects(evidence, suspects, np.arange(0, theirs.n_frames, 2)) == []
    assert measure_suspects(evidence, suspects, np.arange(0)) == []
