"""Repetitions of an exercise as a table for people and as CSV."""

from __future__ import annotations

import csv
import io
import math
from typing import TYPE_CHECKING

from rich.markup import escape
from rich.table import Table

from dousa.app.output import one_line
from dousa.evaluation.exercises.range_of_motion import ANGLE_NAMES, ANGLES, PAIRED_ANGLES
from dousa.evaluation.words import format_time
from dousa.messages import Message

if TYPE_CHECKING:
    from rich.console import Console

    from dousa.evaluation import AssessedRepetition, RepetitionsAssessment, Trend

PAIR_NAMES = {
    "elbow_flexion": Message("exercise_table.elbow_flexion"),
    "shoulder_elevation": Message("exercise_table.shoulder_elevation"),
    "shoulder_flexion": Message("exercise_table.shoulder_flexion"),
    "shoulder_abduction": Message("exercise_table.shoulder_abduction"),
    "hip_flexion": Message("exercise_table.hip_flexion"),
    "hip_abduction": Message("exercise_table.hip_abduction"),
    "knee_flexion": Message("exercise_table.knee_flexion"),
}
"""Angle of both sides -> its name."""

_HEADINGS = (
    Message("exercise_table.number"),
    Message("exercise_table.time"),
    Message("exercise_table.duration"),
    Message("exercise_table.tempo"),
    Message("exercise_table.grade"),
)
_MOST_ANGLES = 4  # that a table has room for


def choose_angles(assessment: RepetitionsAssessment, most: int = _MOST_ANGLES) -> tuple[str, ...]:
    """The joint angles that move most in the reference, in the order of `ANGLES`; of each joint one, at least one.

    A shoulder that is raised has an elevation, a flexion and an abduction; the one that moves most stands for it, the
    same on both sides.
    """
    ranges = {name: value if math.isfinite(value) else 0.0 for name, value in assessment.reference_ranges.items()}
    kinds: dict[str, tuple[float, str]] = {}
    for name in ANGLES:
        kind = name.removeprefix("left_").removeprefix("right_")
        joint = kind.split("_")[0]
        kinds[joint] = max(kinds.get(joint, (-1.0, "")), (ranges[name], kind))
    chosen = {kind for _, kind in kinds.values()}
    mine = [name for name in ANGLES if name.removeprefix("left_").removeprefix("right_") in chosen]
    moving = [name for name in mine if name in assessment.angles] or mine[:1]
    kept = sorted(moving, key=lambda name: -ranges[name])[:most]
    return tuple(name for name in ANGLES if name in kept)


def print_repetitions(out: Console, assessment: RepetitionsAssessment) -> None:
    """The count, a row for each repetition, the trends, in the language in use."""
    incomplete = len(assessment.repetitions) - assessment.count
    head = Message("exercise_table.count", n=assessment.count, incomplete=incomplete, seconds=assessment.reference_s)
    out.print(str(head), markup=False, soft_wrap=True)
    angles = choose_angles(assessment)
    sides = _most_telling_pair(assessment)
    table = Table(box=None)
    for heading in _HEADINGS:
        table.add_column(str(heading), justify="right", overflow="fold")
    for name in angles:
        degrees = assessment.reference_ranges[name]
        heading = Message("exercise_table.range", angle=ANGLE_NAMES[name], degrees=degrees)
        table.add_column(escape(str(heading)), justify="right", overflow="fold")
    if sides is not None:
        table.add_column(str(Message("exercise_table.symmetry")), justify="right", overflow="fold")
    for number, one in enumerate(assessment.repetitions, 1):
        table.add_row(*(escape(one_line(cell)) for cell in _row(number, one, angles, sides)))
    out.print(table)
    for line in describe_trends(assessment):
        out.print(str(line), markup=False, soft_wrap=True)


def _most_telling_pair(assessment: RepetitionsAssessment) -> str | None:
    """The angle of both sides that moves most in the reference."""
    pairs = [name for name in PAIRED_ANGLES if assessment.complete and name in assessment.complete[0].symmetry]
    return max(pairs, key=lambda name: assessment.reference_ranges[f"left_{name}"], default=None)


def _row(number: int, one: AssessedRepetition, angles: tuple[str, ...], sides: str | None) -> list[str]:
    found = one.repetition
    cells = [str(number), f"{format_time(found.start_s)}-{format_time(found.end_s)}", f"{found.duration_s:.2f}"]
    if found.complete:
        cells += [_number(one.tempo, 2), _number(one.score, 0)]
    else:
        cells += ["", str(Message("exercise_table.incomplete", percent=100 * found.extent))]
    for name in angles:
        ranged = one.get_range(name)
        text = Message("exercise_table.degrees", degrees=ranged.range_deg, percent=ranged.percent)
        cells.append(str(text) if math.isfinite(ranged.percent) else _number(ranged.range_deg, 0))
    if sides is not None:
        cells.append(f"{one.symmetry[sides]:+.0f}" if math.isfinite(one.symmetry[sides]) else "–")
    return cells


def _number(value: float, digits: int) -> str:
    return f"{value:.{digits}f}" if math.isfinite(value) else "–"


def describe_trends(assessment: RepetitionsAssessment) -> list[Message]:
    """The trends that can be told from chance, or that there are none."""
    found = [_say_trend(name, trend) for name, trend in assessment.trends.items() if trend.distinguishable]
    return found or [Message("exercise_table.no_trend")]


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


def to_repetitions_csv(assessment: RepetitionsAssessment) -> bytes:
    """A row for each repetition, the incomplete ones too: all angles in degrees, nothing where there is no value."""
    pairs = tuple(assessment.repetitions[0].symmetry) if assessment.repetitions else ()
    names = ["number", "complete", "start_s", "end_s", "duration_s", "pause_s", "extent", "tempo", "score"]
    names += [f"{angle}_{what}" for angle in ANGLES for what in ("least_deg", "most_deg", "range_deg", "reference_deg")]
    names += [f"{pair}_symmetry_percent" for pair in pairs]
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(names)
    for number, one in enumerate(assessment.repetitions, 1):
        found = one.repetition
        row: list[object] = [number, int(found.complete)]
        row += [_cell(value, 3) for value in (found.start_s, found.end_s, found.duration_s, one.pause_s, found.extent)]
        row += [_cell(one.tempo, 3), _cell(one.score, 1)]
        for ranged in one.ranges:
            values = (ranged.least_deg, ranged.most_deg, ranged.range_deg, ranged.reference_deg)
            row += [_cell(value, 1) for value in values]
        writer.writerow(row + [_cell(one.symmetry[pair], 1) for pair in pairs])
    return text.getvalue().encode()


def _cell(value: float, digits: int) -> str:
    return f"{value:.{digits}f}" if math.isfinite(value) else ""
