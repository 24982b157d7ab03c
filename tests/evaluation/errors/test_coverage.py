"""Two-way coverage: identity, an extreme that is never reached, and the straight way between two frames."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from oracles.wrong_dances import be_late, choose, get_dance

from dousa.evaluation.errors.evidence import Evidence, compute_deviations, gather_evidence
from dousa.evaluation.errors.explain import compute_unreached, follow_path
from dousa.evaluation.posture.posture import compute_postures, thin_postures
from dousa.motion import CanonicalMotion

TOLERANCE = np.full(9, np.radians(10.0))
MOTION = get_dance(12.0)


def gather(performance: CanonicalMotion) -> Evidence:
    theirs, ours = (thin_postures(compute_postures(motion)) for motion in (MOTION, performance))
    deviations = compute_deviations(theirs, ours, np.arange(float(ours.n_frames)), np.ones(9))
    return gather_evidence(deviations, TOLERANCE, 0.07, np.ones(9))


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
    frames = np.arange(MOTION.n_frames, dtype=float)
    middle, half = 0.5 * (start + end), 0.25 * (end - start)
    inside = (frames > start) & (frames < end)
    away = np.abs(frames - middle)
    frames[inside] = np.where(frames < middle, start + half, end - half)[inside]
    outer = inside & (away > half)
    frames[outer] = np.arange(MOTION.n_frames)[outer]
    return choose(MOTION, np.rint(frames).astype(int))


def test_all_of_the_same_motion_is_reached() -> None:
    evidence = gather(MOTION)
    assert compute_unreached(evidence, 60, 120, 55, 125).max() < 0.02
    course, cost = follow_path(evidence, 60, 120)
    assert (course == evidence.center).all()
    assert cost.max() < 1e-9


def test_a_late_motion_is_on_the_path_and_reaches_it_all() -> None:
    evidence = gather(be_late(MOTION, 0.3, 3.0, 6.0))
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
    evidence = gather(MOTION)
    assert compute_unreached(evidence, 60, 63, 61, 62).shape == (3, 9)
    assert compute_unreached(evidence, 60, 61, 300, 310).max() == 0.0
    course, cost = follow_path(evidence, 60, 61)
    assert course.shape == cost.shape == (1,)


def test_the_path_stays_between_its_two_moments() -> None:
    evidence = gather(be_late(MOTION, 0.5, 3.0, 6.0))
    course, _ = follow_path(evidence, 120, 150)
    there = np.arange(120, 150) + course - evidence.center
    assert there.min() >= 120 and there.max() < 150


def test_gaps_are_reached() -> None:
    lost = np.zeros((MOTION.n_frames, 20), bool)
    lost[100:200] = True
    evidence = gather(replace(MOTION, missing=lost))
    assert compute_unreached(evidence, 120, 150, 110, 160).max() == 0.0
