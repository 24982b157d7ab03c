"""What there is to know of the repetitions of an exercise, in sentences: the most important first."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from dousa.evaluation.errors.faults import WELL, Fault, describe_fault, drop_side
from dousa.evaluation.exercises.repetitions import FEWEST_FOR_TREND, AssessedRepetition, RepetitionsAssessment
from dousa.evaluation.exercises.trends import Trend
from dousa.evaluation.grade.score import round_grade
from dousa.evaluation.posture.range_of_motion import ANGLE_NAMES, ANGLES, PAIRED_ANGLES, compute_symmetry_index
from dousa.evaluation.words import format_time
from dousa.messages import Message

PAIR_NAMES: Mapping[str, Message] = {name: Message(f"exercise_table.{name}") for name in PAIRED_ANGLES}
"""Angle of both sides -> its name."""

SHORT = 85.0
"""Percent of the reference's range or reach below which a joint or a repetition is short, see docs/exercises.md."""
_SLOWER, _FASTER = 1.2, 1 / 1.2  # of the reference's duration
_MOST_ANGLES = 4  # that a table has room for


def choose_angles(assessment: RepetitionsAssessment, most: int = _MOST_ANGLES) -> tuple[str, ...]:
    """Choose the joint angles that move most in the reference, in the order of `ANGLES`: one of each joint.

    A shoulder that is raised has an elevation, a flexion and an abduction; the one that moves most stands for it, the
    same on both sides.
    """
    ranges = {name: value if math.isfinite(value) else 0.0 for name, value in assessment.reference_ranges.items()}
    kinds: dict[str, tuple[float, str]] = {}
    for name in ANGLES:
        kind = drop_side(name)
        joint = kind.split("_")[0]
        kinds[joint] = max(kinds.get(joint, (-1.0, "")), (ranges[name], kind))
    chosen = {kind for _, kind in kinds.values()}
    mine = [name for name in ANGLES if drop_side(name) in chosen]
    moving = [name for name in mine if name in assessment.angles] or mine[:1]
    kept = sorted(moving, key=lambda name: -ranges[name])[:most]
    return tuple(name for name in ANGLES if name in kept)


def choose_pair(assessment: RepetitionsAssessment) -> str | None:
    """Choose the angle of both sides that moves most in the reference; None if no angle moves on both."""
    pairs = [name for name in PAIRED_ANGLES if assessment.complete and name in assessment.complete[0].symmetry]
    return max(pairs, key=lambda name: assessment.reference_ranges[f"left_{name}"], default=None)


def describe_exercise(assessment: RepetitionsAssessment) -> tuple[Message, ...]:
    """Describe the repetitions, the most important first.

    Returns the grade; what was broken off or reaches less than `SHORT` percent; what was wrong in which repetitions;
    tempo and sides where they are clearly different. See `describe_trends` for trends.
    """
    said = [*_say_grade(assessment), *_say_broken_off(assessment), *_say_reach(assessment), *_say_faults(assessment)]
    return (*said, *_say_tempo(assessment), *_say_sides(assessment))


def to_answer(assessment: RepetitionsAssessment, language: str | None = None) -> dict[str, Any]:
    """Return its JSON with what `describe_exercise` and `describe_trends` say, as the command and the studio answer."""
    said = (*describe_exercise(assessment), *describe_trends(assessment))
    sentences = [message.render(language) for message in said]
    return {**assessment.to_json(language), "says": sentences, "says_codes": [message.code for message in said]}


def describe_worst(one: AssessedRepetition) -> Message:
    """Describe in a few words which joint of a repetition is furthest off, by how much and when; in brackets what is
    no more than people differ by who do it well."""
    if not one.faults:
        return Message("text.verbatim", text="–")
    worst = one.faults[0]
    values = {"angle": ANGLE_NAMES[worst.angle], "degrees": worst.degrees - worst.expected}
    code = "exercise_table.clear_worst" if worst.is_clear else "exercise_table.faint_worst"
    return Message(code, time=format_time(worst.time_s), **values)


def describe_trends(assessment: RepetitionsAssessment, *, uneven_change: float = 0.5) -> tuple[Message, ...]:
    """Describe the trends that are distinguishable from chance, or say that there are none; nothing of too few.

    Of the joints those of `choose_angles` and `choose_pair`; all others are in ``assessment.trends``.
    """
    # uneven_change: percent a repetition: a slower change of the sides is of no use
    reported = {"duration_s", "score", "pause_s", "extent", *choose_angles(assessment)}
    pair = choose_pair(assessment)
    uneven = f"symmetry_{pair}"
    found = [
        _say_trend(name, trend)
        for name, trend in assessment.trends.items()
        if trend.distinguishable and (name in reported or (name == uneven and abs(trend.slope) >= uneven_change))
    ]
    enough = assessment.count >= FEWEST_FOR_TREND
    return tuple(found) or ((Message("exercise_table.no_trend"),) if enough else ())


def compute_median(values: Sequence[float]) -> float:
    """Compute the median of the finite values; nan if there are none."""
    known = [value for value in values if math.isfinite(value)]
    return float(np.median(known)) if known else math.nan


def _say_grade(assessment: RepetitionsAssessment, *, weak: float = 5.0) -> list[Message]:
    # weak: points below the median from which a repetition is named
    graded = [(one.score, number) for number, one in enumerate(assessment.repetitions, 1) if math.isfinite(one.score)]
    if not graded:
        return [Message("exercise_summary.no_grade")]
    scores = [score for score, _ in graded]
    below = compute_median(scores) - min(scores)
    median, low, high = (round_grade(score) for score in (compute_median(scores), min(scores), max(scores)))
    if low == high:
        return [Message("exercise_summary.grade_even", score=median)]
    if below < weak:
        return [Message("exercise_summary.grade", median=median, low=low, high=high)]
    return [Message("exercise_summary.grade_weakest", median=median, low=low, high=high, number=min(graded)[1])]


def _say_broken_off(assessment: RepetitionsAssessment) -> list[Message]:
    broken = {k: 100.0 * one.repetition.extent for k, one in _number(assessment) if not one.repetition.complete}
    if not broken:
        return []
    return [Message("exercise_summary.broken_off", who=_name_numbers(broken), percent=max(broken.values()))]


def _say_reach(assessment: RepetitionsAssessment) -> list[Message]:
    reached = {k: 100.0 * one.repetition.extent for k, one in _number(assessment) if one.repetition.complete}
    short = {k: percent for k, percent in reached.items() if percent < SHORT}
    if not short:
        return []
    percent = compute_median(list(short.values()))
    return [Message("exercise_summary.reach", who=_name_numbers(short), percent=percent)]


def _number(assessment: RepetitionsAssessment) -> Iterable[tuple[int, AssessedRepetition]]:
    return enumerate(assessment.repetitions, 1)


def _name_numbers(numbers: Collection[int]) -> Message:
    """Repetitions by their numbers; three in a row and more as "1 to 4"."""
    if len(numbers) == 1:
        return Message("exercise_summary.one", number=next(iter(numbers)))
    runs: list[list[int]] = []
    for number in sorted(numbers):
        if runs and number == runs[-1][-1] + 1:
            runs[-1].append(number)
        else:
            runs.append([number])
    said: list[Message | str] = []
    for run in runs:
        long = len(run) > 2
        said += [Message("exercise_summary.span", first=run[0], last=run[-1])] if long else map(str, run)
    return Message("exercise_summary.several", numbers=tuple(said))


def _say_faults(assessment: RepetitionsAssessment, *, most: int = 3) -> list[Message]:
    """Faults that several repetitions share are said together, one of both sides once, the gravest first."""
    found: dict[tuple[str, str, bool], dict[int, Fault]] = {}
    for number, one in _number(assessment):
        for fault in one.faults:
            if fault.is_clear:
                found.setdefault((fault.angle, fault.kind, fault.degrees > fault.expected), {})[number] = fault
    groups: list[tuple[float, Message]] = []
    for (angle, kind, more), faults in found.items():
        side, _, other = angle.partition("_")
        twin = found.get((f"right_{other}", kind, more), {}) if side == "left" else {}
        if side == "right" and faults.keys() == found.get((f"left_{other}", kind, more), {}).keys():
            continue
        both = faults.keys() == twin.keys()
        some = [*faults.values(), *(twin.values() if both else ())]
        phase = Counter(fault.phase for fault in some).most_common(1)[0][0]
        degrees, expected = (compute_median([getattr(one, name) for one in some]) for name in ("degrees", "expected"))
        what = describe_fault(f"both_{other}" if both else angle, kind, phase, degrees, expected)
        everywhere = len(faults) == len(assessment.repetitions) > 1
        who = Message("exercise_summary.every") if everywhere else _name_numbers(faults)
        groups.append((sum(one.severity for one in some), Message("exercise_summary.fault", who=who, what=what)))
    if groups:
        return [message for _, message in sorted(groups, key=lambda group: -group[0])[:most]]
    worst = max(
        (fault for one in assessment.repetitions for fault in one.faults), key=lambda f: f.severity, default=None
    )
    if worst is None:
        return []
    well = compute_median([one.score for one in assessment.complete]) >= WELL  # not where nothing has a grade
    return [Message("exercise_summary.as_reference" if well else "exercise_summary.furthest", worst=worst.message)]


def _say_tempo(assessment: RepetitionsAssessment) -> list[Message]:
    tempo = compute_median([one.tempo for one in assessment.complete])
    seconds = compute_median([one.repetition.duration_s for one in assessment.complete])
    if tempo >= _SLOWER or tempo <= _FASTER:
        code = "exercise_summary.slower" if tempo >= _SLOWER else "exercise_summary.faster"
        return [Message(code, seconds=seconds, expected=assessment.reference_s)]
    return []


def _say_sides(
    assessment: RepetitionsAssessment, *, unlike_reference: float = 10.0, least_uneven: float = 15.0
) -> list[Message]:
    # least_uneven: percent, symmetry index that is reported
    # unlike_reference: and by how much it must be beyond the reference's own
    pair = choose_pair(assessment)
    if pair is None:
        return []
    uneven = compute_median([one.symmetry[pair] for one in assessment.complete])
    left, right = (assessment.reference_ranges[f"{side}_{pair}"] for side in ("left", "right"))
    own = compute_symmetry_index(left, right)
    if not (abs(uneven) >= least_uneven and abs(uneven - own) >= unlike_reference):
        return []
    code = "exercise_summary.left_further" if uneven > 0 else "exercise_summary.right_further"
    less = 100.0 * (200.0 - abs(uneven)) / (200.0 + abs(uneven))  # the smaller side in percent of the larger one
    return [Message(code, angle=PAIR_NAMES[pair], percent=less)]


def _say_trend(name: str, trend: Trend) -> Message:
    code, slope = "exercise_table.trend_degrees", trend.slope
    if name in ("duration_s", "pause_s"):
        code, what = "exercise_table.trend_seconds", Message(f"exercise_table.measure_{name.removesuffix('_s')}")
    elif name == "score":
        code, what = "exercise_table.trend_points", Message("exercise_table.measure_score")
    elif name == "extent":
        code, what, slope = "exercise_table.trend_percent", Message("exercise_table.measure_extent"), 100 * slope
    elif name.startswith("symmetry_"):
        angle = PAIR_NAMES[name.removeprefix("symmetry_")]
        code, what = "exercise_table.trend_percent", Message("exercise_table.measure_symmetry", angle=angle)
    else:
        what = ANGLE_NAMES[name]
    return Message(code, what=what, slope=slope, p=trend.adjusted_p)
