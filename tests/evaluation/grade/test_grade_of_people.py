"""The grade on recordings of real people: other takes of one person, a part of a motion, another motion."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dousa.evaluation import Assessment, assess
from dousa.formats.motion_files import read_canonical
from dousa.motion import CanonicalMotion
from dousa.motion.canonical.joints import JOINT_INDEX as J

Shared = Callable[[str], Path]


def read_takes(shared: Shared, motion: str, person: str) -> list[CanonicalMotion]:
    return [read_canonical(path)[0] for path in sorted(shared(f"hdm05/{motion}").glob(f"HDM_{person}_*"))]


def read_exercise(shared: Shared, number: int, label: str) -> list[CanonicalMotion]:
    return [read_canonical(path)[0] for path in sorted(shared(f"irds/g{number}/{label}").glob("*.trc"))]


@pytest.mark.parametrize(("motion", "count"), [("squat1Reps", 6), ("kickLFront1Reps", 5)])
@pytest.mark.parametrize("person", ["bd", "bk"])
def test_the_next_take_of_one_person_is_good(shared_data: Shared, motion: str, count: int, person: str) -> None:
    takes = read_takes(shared_data, motion, person)
    assert assess(takes[:count], takes[count]).score >= 80.0


def test_a_physiotherapist_agrees(shared_data: Shared) -> None:
    correct, wrong = (read_exercise(shared_data, 4, label) for label in ("correct", "incorrect"))
    good, bad = ([assess(correct[:5], one).score for one in some] for some in (correct[5:], wrong))
    assert min(good) > max(bad)


def sit_down(motion: CanonicalMotion) -> CanonicalMotion:
    """The same with the legs of somebody who sits: thighs to the front, shanks down."""
    points = np.array(motion.positions)
    across = (points[:, J["left_hip"]] - points[:, J["right_hip"]]).mean(axis=0)
    front = np.cross(across / np.linalg.norm(across), [0.0, 1.0, 0.0])
    jitter = 0.01 * np.random.default_rng(0).standard_normal((2, 2, len(points), 3))
    for number, side in enumerate(("left", "right")):
        hip = points[:, J[f"{side}_hip"]]
        points[:, J[f"{side}_knee"]] = hip + 0.42 * front - [0.0, 0.05, 0.0] + jitter[number, 0]
        points[:, J[f"{side}_ankle"]] = hip + 0.45 * front - [0.0, 0.45, 0.0] + jitter[number, 1]
    return replace(motion, positions=points)


def codes(found: Assessment) -> list[str]:
    return [one.code for one in found.warnings]


def test_who_sits_gets_the_grade_of_the_arms(shared_data: Shared) -> None:
    correct = read_exercise(shared_data, 4, "correct")
    standing, sitting = (assess(correct[:5], one) for one in (correct[5], sit_down(correct[5])))
    assert "assessment.not_judged" in codes(sitting) and "assessment.not_judged" not in codes(standing)
    assert sitting.score == pytest.approx(standing.score, abs=6.0)
    seated = assess([sit_down(one) for one in correct[:5]], correct[5])
    assert seated.score == pytest.approx(standing.score, abs=6.0)


def test_a_part_of_a_motion_is_no_good_performance(shared_data: Shared) -> None:
    dance = read_canonical(shared_data("bandai_dance/dataset-1_dance-short_normal_001.bvh"))[0]
    dance = replace(dance, positions=dance.positions[:1200])
    part = assess(dance, replace(dance, positions=dance.positions[130:210]))
    assert part.coverage < 0.2 and part.score < 20.0
    assert assess(dance, dance).coverage > 0.995


def test_another_motion_is_told_instead_of_a_grade(shared_data: Shared) -> None:
    squats, falls = (read_takes(shared_data, motion, "bd") for motion in ("squat1Reps", "lieDownFloor"))
    found = assess(squats[:3], falls[0])
    assert np.isnan(found.score) and "assessment.unlike" in codes(found)
    assert found.to_json()["score"] is None and found.to_json()["score_interval"] == [None, None]
