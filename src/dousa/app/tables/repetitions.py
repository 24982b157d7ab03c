"""Repetitions of an exercise as a table for people and as CSV."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from rich.markup import escape
from rich.table import Table

from dousa.app.output import one_line
from dousa.evaluation.exercises.range_of_motion import ANGLE_NAMES
from dousa.evaluation.exercises.summary import choose_angles, choose_pair, describe_exercise, describe_trends
from dousa.evaluation.grade.score import round_grade
from dousa.evaluation.words import format_time
from dousa.messages import Message

if TYPE_CHECKING:
    from rich.console import Console

    from dousa.evaluation import AssessedRepetition, RepetitionsAssessment

_HEADINGS = (
    Message("exercise_table.number"),
    Message("exercise_table.time"),
    Message("exercise_table.duration"),
    Message("exercise_table.tempo"),
    Message("exercise_table.grade"),
)


def print_repetitions(out: Console, assessment: RepetitionsAssessment, detail: str = "full") -> None:
    """The count, what to know first, a row for each repetition, and the trends, in the language in use.

    Parameters
    ----------
    out : where it goes.
    assessment : what is told.
    detail : ``"brief"`` leaves out the table.
    """
    incomplete = len(assessment.repetitions) - assessment.count
    head = Message("exercise_table.count", n=assessment.count, incomplete=incomplete, seconds=assessment.reference_s)
    for line in (head, *describe_exercise(assessment)):
        out.print(str(line), markup=False, soft_wrap=True)
    if detail == "full":
        out.print(_make_table(assessment))
    for line in describe_trends(assessment):
        out.print(str(line), markup=False, soft_wrap=True)


def _make_table(assessment: RepetitionsAssessment) -> Table:
    angles = choose_angles(assessment)
    sides = choose_pair(assessment)
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
    return table


def _row(number: int, one: AssessedRepetition, angles: tuple[str, ...], sides: str | None) -> list[str]:
    found = one.repetition
    cells = [str(number), f"{format_time(found.start_s)}-{format_time(found.end_s)}", f"{found.duration_s:.2f}"]
    if found.complete:
        cells += [_number(one.tempo, 2), _number(round_grade(one.score), 0)]
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
