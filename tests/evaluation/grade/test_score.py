"""The grade: identity, order, what is left out, doubt, both languages; and real people."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dousa.evaluation import Assessment, assess
from dousa.evaluation.grade.movement import PARTS
from dousa.evaluation.grade.score import compute_grade, load_model, round_grade
from dousa.formats.motion_files import read_canonical
from dousa.motion import CanonicalMotion
from dousa.motion.canonical.joints import JOINT_INDEX as J

MODEL = load_model()
NOTHING = np.zeros(len(PARTS))
parts_of_a_grade = st.lists(st.floats(0.0, 60.0), min_size=len(PARTS), max_size=len(PARTS)).map(np.array)
extents, counts = st.floats(0.2, 3.0), st.integers(1, 9)


def make_parts(distance: float) -> np.ndarray:
    """Parts at such a distance, all from the path."""
    return MODEL.floors * np.expm1(distance / MODEL.strengths) * np.eye(len(PARTS))[0]


def test_the_numbers_that_are_shipped_make_sense() -> None:
    assert MODEL.floors.shape == MODEL.strengths.shape == (len(PARTS),)
    assert (MODEL.strengths > 0.0).all() and (MODEL.floors > 0.0).all()
    assert MODEL.curve[0].tolist() == [0.0, 100.0] and MODEL.curve[-1, 1] == 0.0
    assert (np.diff(MODEL.curve, axis=0) * [1.0, -1.0] > 0.0).all()
    assert (np.diff(MODEL.doubt) <= 0.0).all()  # more takes of the reference leave less doubt


@given(parts_of_a_grade, st.integers(0, len(PARTS) - 1), st.floats(0.0, 40.0), extents)
def test_more_of_any_part_never_grades_better(parts: np.ndarray, number: int, more: float, extent: float) -> None:
    worse = parts + more * np.eye(len(PARTS))[number]
    grades = [np.nan_to_num(compute_grade(one, extent, 1.0, 3).score) for one in (worse, parts)]
    assert grades[0] <= grades[1]


@given(st.floats(0.0, 1.5), st.floats(0.1, 1.0), st.floats(0.1, 1.0))
def test_what_is_left_out_counts(distance: float, one: float, other: float) -> None:
    found = [compute_grade(make_parts(distance), 1.0, share, 1) for share in sorted((one, other))]
    less, more = np.nan_to_num([one.score for one in found])
    assert less <= more <= 100.0 and less <= 100.0 * (found[0].coverage + 0.05) + 1e-3


def test_the_interval_holds_the_grade_and_narrows_with_more_takes() -> None:
    widths = []
    for count in (1, 3, 5):
        found = compute_grade(make_parts(0.7), 1.0, 1.0, count)
        low, high = found.interval
        assert low <= found.score <= high
        widths.append(high - low)
    assert widths[0] >= widths[1] >= widths[2] > 0.0


@pytest.mark.parametrize(
    ("parts", "coverage", "code"),
    [
        (make_parts(1.01 * MODEL.unlike), 1.0, "grade.unlike"),
        (NOTHING, 0.07, "grade.hardly"),
        (NOTHING + np.nan, 1.0, "grade.nothing"),
    ],
)
def test_no_grade_says_why(parts: np.ndarray, coverage: float, code: str) -> None:
    found = compute_grade(parts, 1.0, coverage, 1)
    assert np.isnan(found.score) and np.isnan(found.interval).all() and found.formula.code == code


@given(st.floats(0.0, 100.0))
def test_a_grade_without_decimals_is_that_of_the_answer(score: float) -> None:
    whole = round_grade(score)
    assert whole == round_grade(round(score, 1)) and whole == int(whole) and abs(whole - score) <= 0.55
    assert (round_grade(76.45), round_grade(76.5), round_grade(76.44), round_grade(77.5)) == (77.0, 77.0, 76.0, 78.0)
    assert np.isnan(round_grade(float("nan")))


def test_the_formula_holds_its_numbers() -> None:
    found = compute_grade(make_parts(0.7), 1.0, 0.5, 1)
    for language in ("en", "ja"):
        said = found.formula.render(language)
        assert f"= {round_grade(found.score):.0f}" in said and "55 %" in said and f"{make_parts(0.7)[0]:.1f}" in said


Shared = Callable[[str], Path]


def read_takes(shared: Shared, motion: str, person: str) -> list[CanonicalMotion]:
    return [read_canonical(path)[0] for path in sorted(shared(f"hdm05/{motion}").glob(f"HDM_{person}_*"))]


def read_exercise(shared: Shared, number: int, label: str) -> list[CanonicalMotion]:
    return [read_canonical(path)[0] for path in sorted(shared(f"irds/g{number}/{label}").glob("*.trc"))]


@pytest.mark.parametrize(("motion", "count"), [("squat1Reps", 6), ("kickLFront1Reps", 5)])
@pytest.mark.parametrize("person", ["bd", pytest.param("bk", marks=pytest.mark.slow)])
def test_the_next_take_of_one_person_is_good(shared_data: Shared, motion: str, count: int, person: str) -> None:
    takes = read_takes(shared_data, motion, person)
    assert assess(takes[:count], takes[count]).score >= 65.0


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
    assert part.coverage < 0.2 and np.isnan(part.score) and part.score_formula.code == "grade.hardly"
    assert assess(dance, dance).coverage > 0.995


def test_another_motion_is_told_instead_of_a_grade(shared_data: Shared) -> None:
    squats, falls = (read_takes(shared_data, motion, "bd") for motion in ("squat1Reps", "lieDownFloor"))
    found = assess(squats[:3], falls[0])
    assert np.isnan(found.score) and "assessment.unlike" in codes(found)
    assert found.to_json()["score"] is None and found.to_json()["score_interval"] == [None, None]
