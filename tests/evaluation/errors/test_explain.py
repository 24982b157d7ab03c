"""Explanations: the class, the limbs and the size of errors put in by hand, and coverage both ways."""

from dataclasses import replace

import numpy as np
import pytest
from oracles.wrong_dances import ARM, be_late, choose, gather_dances, get_dance, place, turn_limb

from dousa.evaluation.errors.evidence import Evidence, find_stretches
from dousa.evaluation.errors.explain import Finding, compute_unreached, explain, find_best_span, follow_path
from dousa.evaluation.posture.posture import LIMBS
from dousa.motion import CanonicalMotion

MOTION = get_dance()
CHAINS = {
    "left_arm": [f"left_{joint}" for joint in ARM],
    "right_arm": [f"right_{joint}" for joint in ARM],
    "left_leg": ["left_hip", "left_knee", "left_ankle", "left_toe"],
    "right_leg": ["right_hip", "right_knee", "right_ankle", "right_toe"],
}


def find(performance: CanonicalMotion) -> list[Finding]:
    evidence = gather_dances(performance, MOTION)
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


@pytest.mark.parametrize("limb", list(CHAINS))
def test_a_limb_that_does_something_else_is_partial(limb: str) -> None:
    (finding,) = find(turn_limb(MOTION, CHAINS[limb], 45.0, 5.0, 7.0))
    assert finding.kind == "partial"
    assert set(finding.segments) <= set(LIMBS[limb])
    assert finding.start == pytest.approx(153, abs=10) and finding.end == pytest.approx(207, abs=10)
    assert 2.0 < finding.severity < 6.0


def test_nothing_wrong_has_no_explanation() -> None:
    assert find(MOTION) == []
    assert find(place(MOTION, 1.0, 2.0, 3.0, 1.2)) == []


def test_a_stretch_of_one_frame_or_of_tolerable_frames_has_none() -> None:
    evidence = gather_dances(MOTION, MOTION)
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


SHORT = get_dance(12.0)


def gather(performance: CanonicalMotion) -> Evidence:
    return gather_dances(performance, SHORT)


def measure_slowly(evidence: Evidence, moment: int, first: int, last: int) -> np.ndarray:
    """(9,) squared ratio to the nearest of many points between the frames."""
    center = evidence.center
    best, rest = np.inf, np.zeros(9)
    for frame in range(max(first, moment - center), min(last, moment + center + 1) - 1):
        far = evidence.deviations.squared[frame, center + moment - frame]
        far_next = evidence.deviations.squared[frame + 1, center + moment - frame - 1]
        step = evidence.deviations.performance[frame + 1] - evidence.deviations.performance[frame]
        for share in np.linspace(0.0, 1.0, 51):
            # The law of cosines along a straight way.
            between = (1 - share) * far + share * far_next - share * (1 - share) * (step**2).sum(axis=1)
            ratio = between / evidence.tolerance**2
            if ratio.sum() < best:
                best, rest = ratio.sum(), ratio
    return np.maximum(rest, 0.0)


def stop_short(start: int, end: int) -> CanonicalMotion:
    """Goes half the way to the pose in the middle, and back."""
    frames = np.arange(SHORT.n_frames, dtype=float)
    middle, half = 0.5 * (start + end), 0.25 * (end - start)
    inside = (frames > start) & (frames < end)
    away = np.abs(frames - middle)
    frames[inside] = np.where(frames < middle, start + half, end - half)[inside]
    outer = inside & (away > half)
    frames[outer] = np.arange(SHORT.n_frames)[outer]
    return choose(SHORT, np.rint(frames).astype(int))


def test_all_of_the_same_motion_is_reached() -> None:
    evidence = gather(SHORT)
    assert compute_unreached(evidence, 60, 120, 55, 125).max() < 0.02
    course, cost = follow_path(evidence, 60, 120)
    assert (course == evidence.center).all()
    assert cost.max() < 1e-9


def test_a_late_motion_is_on_the_path_and_reaches_it_all() -> None:
    evidence = gather(be_late(SHORT, 0.3, 3.0, 6.0))
    assert compute_unreached(evidence, 100, 170, 90, 185).max() < 0.5
    course, cost = follow_path(evidence, 90, 185)
    assert np.median(cost) < 0.5
    assert np.median(course[20:70]) == evidence.center - 9


def test_an_extreme_that_is_never_reached_is_told() -> None:
    evidence = gather(stop_short(128, 166))
    unreached = compute_unreached(evidence, 128, 166, 120, 174)
    assert unreached.max() > 5.0
    assert unreached[15:23].sum(axis=1).mean() > 5.0 * unreached[[0, 1, -2, -1]].sum(axis=1).mean()
    _, cost = follow_path(evidence, 120, 174)
    # Never off the path: only the extreme is left out.
    assert np.median(cost) < 1.0


@pytest.mark.parametrize("moment", [130, 140, 147, 160])
def test_the_nearest_point_lies_between_frames(moment: int) -> None:
    evidence = gather(stop_short(128, 166))
    found = compute_unreached(evidence, moment - 1, moment + 2, 120, 174)
    single = [measure_slowly(evidence, moment + step, 120, 174) for step in (-1, 0, 1)]
    assert found[1] == pytest.approx(np.mean(single, axis=0), abs=0.02)


def test_one_frame_is_enough() -> None:
    evidence = gather(SHORT)
    assert compute_unreached(evidence, 60, 63, 61, 62).shape == (3, 9)
    assert compute_unreached(evidence, 60, 61, 300, 310).max() == 0.0
    course, cost = follow_path(evidence, 60, 61)
    assert course.shape == cost.shape == (1,)


def test_the_path_stays_between_its_two_moments() -> None:
    evidence = gather(be_late(SHORT, 0.5, 3.0, 6.0))
    course, _ = follow_path(evidence, 120, 150)
    there = np.arange(120, 150) + course - evidence.center
    assert there.min() >= 120 and there.max() < 150


def test_gaps_are_reached() -> None:
    lost = np.zeros((SHORT.n_frames, 20), bool)
    lost[100:200] = True
    evidence = gather(replace(SHORT, missing=lost))
    assert compute_unreached(evidence, 120, 150, 110, 160).max() == 0.0
