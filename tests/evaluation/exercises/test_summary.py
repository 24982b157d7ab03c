"""What is said of an exercise: the grade, what was broken off, joints, tempo and sides, each where it is worth it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import pytest

from dousa.evaluation import ANGLES, AssessedRepetition, RangeOfMotion, Repetition, RepetitionsAssessment
from dousa.evaluation.exercises.repetitions import (
    adjust_for_many,
    choose_angles,
    choose_pair,
    compute_median,
    describe_exercise,
    describe_trends,
    estimate_trend,
)

NAN = float("nan")
KNEES = {"left_knee_flexion": 90.0, "right_knee_flexion": 90.0}


def make_repetition(
    start_s: float, score: float, ranges: Mapping[str, float], *, seconds: float = 2.0, extent: float = 1.0
) -> AssessedRepetition:
    frames = round(30 * start_s), round(30 * (start_s + seconds))
    found = Repetition(*frames, start_s, start_s + seconds, extent, extent >= 0.65)
    angles = tuple(RangeOfMotion(name, 0.0, ranges.get(name, 5.0), KNEES.get(name, 5.0)) for name in ANGLES)
    left, right = (ranges.get(f"{side}_knee_flexion", 90.0) for side in ("left", "right"))
    uneven = 200.0 * (left - right) / (left + right)
    return AssessedRepetition(found, seconds / 2.0, score, angles, {"knee_flexion": uneven}, NAN)


def make_exercise(repetitions: Sequence[AssessedRepetition]) -> RepetitionsAssessment:
    expected = {name: KNEES.get(name, 5.0) for name in ANGLES}
    complete = [one for one in repetitions if one.repetition.complete]
    trends = adjust_for_many({"score": estimate_trend([one.score for one in complete])})
    return RepetitionsAssessment(tuple(repetitions), tuple(KNEES), expected, 2.0, 1, trends, 30.0, 60.0)


def say(*repetitions: AssessedRepetition) -> list[str]:
    return [message.render("en") for message in describe_exercise(make_exercise(repetitions))]


def test_as_the_reference() -> None:
    assert say(make_repetition(1, 91, KNEES), make_repetition(4, 89, KNEES)) == [
        "grade 90 of 100 in the median (89 to 91)",
        "the joints go as far as in the reference (85 to 120 % of its range)",
    ]


def test_a_single_repetition_has_a_grade_without_a_range() -> None:
    assert say(make_repetition(1, 91, KNEES))[0] == "grade 91 of 100"


def test_the_weakest_is_named_where_it_stands_out() -> None:
    said = say(*(make_repetition(3 * k, 70 if k == 1 else 90, KNEES) for k in range(4)))
    assert said[0] == "grade 90 of 100 in the median (70 to 90); the weakest is repetition 2"


def test_numbers_count_what_was_broken_off_too() -> None:
    half = {name: 40.0 for name in KNEES}
    said = say(
        make_repetition(0, 90, KNEES),
        make_repetition(3, NAN, half, extent=0.4),
        make_repetition(6, 60, KNEES),
        make_repetition(9, NAN, half, extent=0.5),
        make_repetition(12, 90, KNEES),
    )
    assert said[0].endswith("the weakest is repetition 3")
    assert said[1] == "repetitions 2 and 4 were broken off: they reach 50 % of the movement at most"


def test_one_knee_that_bends_too_little() -> None:
    less = KNEES | {"right_knee_flexion": 60.0}
    said = say(make_repetition(1, 80, less), make_repetition(4, 80, less))
    assert said[1:] == [
        "right knee flexion: 60 deg in the median, 67 % of the reference's 90 deg",
        "knee flexion: the left goes 40 % further than the right in the median",
    ]


def test_going_further_and_slower() -> None:
    more = {name: 120.0 for name in KNEES}
    said = say(make_repetition(1, 80, more, seconds=3.0), make_repetition(6, 80, more, seconds=3.0))
    assert said[1] == "left knee flexion: 120 deg in the median, further than the reference's 90 deg (133 %)"
    assert said[-1] == "slower than the reference: 3.0 s in the median instead of 2.0 s"


def test_nothing_graded() -> None:
    assert say(make_repetition(1, NAN, KNEES))[0] == "no repetition could be graded"


@pytest.mark.parametrize("falls", [True, False])
def test_the_trend_is_said_if_there_is_one(falls: bool) -> None:
    scores = [95, 93, 91, 86, 84, 82, 77, 72] if falls else [90, 93, 88, 91, 90, 92, 89, 91]
    done = make_exercise([make_repetition(3 * k, score, KNEES) for k, score in enumerate(scores)])
    (message,) = describe_trends(done)
    assert message.code == ("exercise_table.trend_points" if falls else "exercise_table.no_trend")


def test_what_is_shown_is_what_moves() -> None:
    done = make_exercise([make_repetition(1, 90, KNEES)])
    assert choose_angles(done) == tuple(KNEES)
    assert choose_pair(done) == "knee_flexion"


def test_the_median_leaves_out_what_is_unknown() -> None:
    assert compute_median([1.0, NAN, 3.0]) == 2.0
    assert compute_median([NAN]) != compute_median([NAN])
