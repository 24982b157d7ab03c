"""What a therapist would say of an exercise in a few sentences: how well, how far, how evenly, whether it tires."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from dousa.evaluation.exercises.range_of_motion import ANGLE_NAMES, ANGLES, PAIRED_ANGLES, compute_symmetry_index
from dousa.evaluation.exercises.repetitions import RepetitionsAssessment
from dousa.evaluation.exercises.trend import Trend
from dousa.evaluation.grade.score import round_grade
from dousa.messages import Message

PAIR_NAMES: Mapping[str, Message] = {
    "elbow_flexion": Message("exercise_table.elbow_flexion"),
    "shoulder_elevation": Message("exercise_table.shoulder_elevation"),
    "shoulder_flexion": Message("exercise_table.shoulder_flexion"),
    "shoulder_abduction": Message("exercise_table.shoulder_abduction"),
    "hip_flexion": Message("exercise_table.hip_flexion"),
    "hip_abduction": Message("exercise_table.hip_abduction"),
    "knee_flexion": Message("exercise_table.knee_flexion"),
}
"""Angle of both sides -> its name."""

SHORT, FAR = 85.0, 120.0
"""Percent of the reference's range: a joint that goes less far, or further, is told."""
_SLOWER, _FASTER = 1.2, 1 / 1.2  # of the reference's duration
_WEAK = 5.0  # points below the median from which a repetition is named
_UNEVEN = 15.0  # percent, symmetry index that is told
_UNEVEN_CHANGE = 0.5  # percent a repetition: a slower change of the sides is true, and of no use to anybody
_UNLIKE_REFERENCE = 10.0  # and by how much it must be beyond the reference's own
_MOST_ANGLES = 4  # that a table has room for


def choose_angles(assessment: RepetitionsAssessment, most: int = _MOST_ANGLES) -> tuple[str, ...]:
    """The joint angles that move most in the reference, in the order of `ANGLES`; of each joint one, at least one.

    A shoulder that is raised has an elevation, a flexion and an abduction; the one that moves most stands for it, the
    same on both sides.
    """
    ranges = {name: value if math.isfinite(value) else 0.0 for name, value in assessment.reference_ranges.items()}
    kinds: dict[str, tuple[float, str]] = {}
    for name in ANGLES:
        kind = _drop_side(name)
        joint = kind.split("_")[0]
        kinds[joint] = max(kinds.get(joint, (-1.0, "")), (ranges[name], kind))
    chosen = {kind for _, kind in kinds.values()}
    mine = [name for name in ANGLES if _drop_side(name) in chosen]
    moving = [name for name in mine if name in assessment.angles] or mine[:1]
    kept = sorted(moving, key=lambda name: -ranges[name])[:most]
    return tuple(name for name in ANGLES if name in kept)


def choose_pair(assessment: RepetitionsAssessment) -> str | None:
    """The angle of both sides that moves most in the reference; None if no angle moves on both."""
    pairs = [name for name in PAIRED_ANGLES if assessment.complete and name in assessment.complete[0].symmetry]
    return max(pairs, key=lambda name: assessment.reference_ranges[f"left_{name}"], default=None)


def describe_exercise(assessment: RepetitionsAssessment) -> tuple[Message, ...]:
    """How the repetitions went, the most important first; see `describe_trends` for how they develop.

    Parameters
    ----------
    assessment : at least one complete repetition.

    Returns
    -------
    The grade; what was broken off; the joints that go less than `SHORT` or more than `FAR` percent as far as in the
    reference in the median; tempo and sides where they are clearly different.
    """
    said = [*_say_grade(assessment), *_say_broken_off(assessment), *_say_ranges(assessment)]
    return (*said, *_say_tempo(assessment), *_say_sides(assessment))


def describe_trends(assessment: RepetitionsAssessment) -> tuple[Message, ...]:
    """The trends that can be told from chance, or that there are none.

    Of the joints those of `choose_angles` and `choose_pair`; all others are in ``assessment.trends``.
    """
    told = {"duration_s", "score", "pause_s", "extent", *choose_angles(assessment)}
    pair = choose_pair(assessment)
    uneven = f"symmetry_{pair}"
    found = [
        _say_trend(name, trend)
        for name, trend in assessment.trends.items()
        if trend.distinguishable and (name in told or (name == uneven and abs(trend.slope) >= _UNEVEN_CHANGE))
    ]
    return tuple(found) or (Message("exercise_table.no_trend"),)


def compute_median(values: Sequence[float]) -> float:
    """Of those that are finite; nan of none."""
    known = [value for value in values if math.isfinite(value)]
    return float(np.median(known)) if known else math.nan


def _drop_side(angle: str) -> str:
    return angle.removeprefix("left_").removeprefix("right_")


def _say_grade(assessment: RepetitionsAssessment) -> list[Message]:
    graded = [(one.score, number) for number, one in enumerate(assessment.repetitions, 1) if math.isfinite(one.score)]
    if not graded:
        return [Message("exercise_summary.no_grade")]
    scores = [score for score, _ in graded]
    below = compute_median(scores) - min(scores)
    median, low, high = (round_grade(score) for score in (compute_median(scores), min(scores), max(scores)))
    if low == high:
        return [Message("exercise_summary.grade_even", score=median)]
    if below < _WEAK:
        return [Message("exercise_summary.grade", median=median, low=low, high=high)]
    return [Message("exercise_summary.grade_weakest", median=median, low=low, high=high, number=min(graded)[1])]


def _say_broken_off(assessment: RepetitionsAssessment) -> list[Message]:
    broken = [
        (number, 100.0 * one.repetition.extent)
        for number, one in enumerate(assessment.repetitions, 1)
        if not one.repetition.complete
    ]
    if not broken:
        return []
    if len(broken) == 1:
        number, percent = broken[0]
        return [Message("exercise_summary.broken_off", number=number, percent=percent)]
    numbers = [str(number) for number, _ in broken]
    return [Message("exercise_summary.several_broken_off", numbers=numbers, percent=max(one for _, one in broken))]


def _say_ranges(assessment: RepetitionsAssessment) -> list[Message]:
    said = []
    compared = 0
    for name in choose_angles(assessment):
        degrees = compute_median([one.get_range(name).range_deg for one in assessment.complete])
        expected = assessment.reference_ranges[name]
        percent = compute_median([one.get_range(name).percent for one in assessment.complete])
        compared += math.isfinite(percent)
        if percent < SHORT or percent > FAR:
            code = "exercise_summary.short" if percent < SHORT else "exercise_summary.far"
            values = {"degrees": degrees, "expected": expected, "percent": percent}
            said.append(Message(code, angle=ANGLE_NAMES[name], **values))
    if not said and compared:
        return [Message("exercise_summary.full_range", short=SHORT, far=FAR)]
    return said


def _say_tempo(assessment: RepetitionsAssessment) -> list[Message]:
    tempo = compute_median([one.tempo for one in assessment.complete])
    seconds = compute_median([one.repetition.duration_s for one in assessment.complete])
    if tempo >= _SLOWER or tempo <= _FASTER:
        code = "exercise_summary.slower" if tempo >= _SLOWER else "exercise_summary.faster"
        return [Message(code, seconds=seconds, expected=assessment.reference_s)]
    return []


def _say_sides(assessment: RepetitionsAssessment) -> list[Message]:
    pair = choose_pair(assessment)
    if pair is None:
        return []
    uneven = compute_median([one.symmetry[pair] for one in assessment.complete])
    left, right = (assessment.reference_ranges[f"{side}_{pair}"] for side in ("left", "right"))
    own = compute_symmetry_index(left, right)
    if not (abs(uneven) >= _UNEVEN and abs(uneven - own) >= _UNLIKE_REFERENCE):
        return []
    code = "exercise_summary.left_further" if uneven > 0 else "exercise_summary.right_further"
    return [Message(code, angle=PAIR_NAMES[pair], percent=abs(uneven))]


def _say_trend(name: str, trend: Trend) -> Message:
    if name == "duration_s":
        what = Message("exercise_table.measure_duration")
        return Message("exercise_table.trend_seconds", what=what, slope=trend.slope, p=trend.adjusted_p)
    if name == "pause_s":
        what = Message("exercise_table.measure_pause")
        return Message("exercise_table.trend_seconds", what=what, slope=trend.slope, p=trend.adjusted_p)
    if name == "score":
        what = Message("exercise_table.measure_score")
        return Message("exercise_table.trend_points", what=what, slope=trend.slope, p=trend.adjusted_p)
    if name == "extent":
        what = Message("exercise_table.measure_extent")
        return Message("exercise_table.trend_percent", what=what, slope=100 * trend.slope, p=trend.adjusted_p)
    if name.startswith("symmetry_"):
        what = Message("exercise_table.measure_symmetry", angle=PAIR_NAMES[name.removeprefix("symmetry_")])
        return Message("exercise_table.trend_percent", what=what, slope=trend.slope, p=trend.adjusted_p)
    return Message("exercise_table.trend_degrees", what=ANGLE_NAMES[name], slope=trend.slope, p=trend.adjusted_p)
