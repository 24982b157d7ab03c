"""The grade of a performance and every error, the repetitions of an exercise, and a pupil over time."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from rich.markup import escape
from rich.table import Table

from dousa.app.output import one_line
from dousa.evaluation.exercises.range_of_motion import ANGLE_NAMES
from dousa.evaluation.exercises.repetitions import choose_angles, choose_pair, describe_exercise, describe_trends
from dousa.evaluation.grade.score import round_grade
from dousa.evaluation.words import format_time
from dousa.messages import Message

if TYPE_CHECKING:
    from rich.console import Console

    from dousa.evaluation import AssessedRepetition, Assessment, Progress, RepetitionsAssessment


def describe_coverage(assessment: Assessment) -> Message:
    """How much of the reference was danced, and which segments were not looked at."""
    percent = 100.0 * assessment.coverage
    if not assessment.not_judged:
        return Message("graded.coverage", percent=percent)
    from dousa.evaluation.words import group_segments

    return Message("graded.coverage_of_rest", percent=percent, who=group_segments(assessment.not_judged))


def print_assessment(out: Console, assessment: Assessment, detail: str = "full") -> None:
    """The grade and what to work on first; in full also how the grade came about, and every error in order of time.

    Parameters
    ----------
    out : where to print.
    assessment : the answer.
    detail : of `dousa.evaluation.advise`.
    """
    from dousa.evaluation import advise, praise

    out.print(str(describe_coverage(assessment)), markup=False)
    is_graded = math.isfinite(assessment.score)
    grade = _describe_grade(assessment) if is_graded else assessment.score_formula
    out.print(str(grade), style="bold", markup=False, soft_wrap=True)
    points = advise(assessment, "brief")
    good = praise(assessment)
    for number, advice in enumerate(points, start=1):
        place = f"{number}. " if len(points) > 1 else ""
        out.print(f"{place}{one_line(str(advice.message))}", markup=False, soft_wrap=True)
    if good is not None and good.furi:
        out.print(str(good.message), markup=False, soft_wrap=True)
    if detail == "brief":
        more = len(assessment.events) + len(assessment.lapses) - sum(max(len(point.times), 1) for point in points)
        if more > 0:
            out.print(str(Message("graded.more", n=more)), markup=False, soft_wrap=True)
        return
    if is_graded:
        out.print(str(assessment.score_formula), markup=False, soft_wrap=True)
    _print_errors(out, assessment)


def _print_errors(out: Console, assessment: Assessment) -> None:
    rows = _event_rows(assessment) + _lapse_rows(assessment)
    if rows:
        table = Table(box=None)
        for name in ("graded.time", "graded.furi", "graded.error", "graded.severity", "graded.difference"):
            right = name in ("graded.furi", "graded.severity")
            table.add_column(str(Message(name)), justify="right" if right else "left", overflow="fold")
        for _, cells in sorted(rows, key=lambda row: row[0]):
            table.add_row(*(escape(one_line(cell)) for cell in cells))
        out.print(table)
    if rows and not assessment.events:
        out.print(str(Message("graded.no_errors")), markup=False)
    if assessment.gaps:
        seconds = _covered([(start, end) for start, end, _ in assessment.gaps])
        out.print(str(Message("graded.gaps", seconds=seconds)), markup=False)


def _describe_grade(assessment: Assessment) -> Message:
    from dousa.evaluation.grade.score import round_grade

    low, high = (f"{round_grade(value):.0f}" for value in assessment.score_interval)
    values = {"score": f"{round_grade(assessment.score):.0f}", "low": low, "high": high, "n": assessment.n_references}
    if assessment.calibrated:
        return Message("graded.calibrated", **values)
    return Message("graded.uncalibrated", **values)


Row = tuple[float, tuple[str, str, str, str, str]]


def _event_rows(assessment: Assessment) -> list[Row]:
    from dousa.evaluation.words import KINDS

    return [
        (
            event.start_s,
            (
                _span(event.start_s, event.end_s),
                "" if event.furi is None else str(event.furi + 1),
                str(KINDS[event.kind]),
                f"{event.severity:.1f}",
                str(event.message),
            ),
        )
        for event in assessment.events
    ]


def _lapse_rows(assessment: Assessment) -> list[Row]:
    from dousa.evaluation.words import LAPSE_KINDS

    return [
        (
            lapse.start_s,
            (
                _span(lapse.start_s, lapse.end_s),
                "",
                str(Message("graded.lapse", kind=LAPSE_KINDS[lapse.kind])),
                "",
                str(lapse.message),
            ),
        )
        for lapse in assessment.lapses
    ]


def _span(start: float, end: float) -> str:
    from dousa.evaluation.words import format_time

    return f"{format_time(start)}-{format_time(end)}"


def _covered(spans: list[tuple[float, float]]) -> float:
    """Seconds that lie in at least one span."""
    total, reached = 0.0, float("-inf")
    for start, end in sorted(spans):
        total += max(end - max(start, reached), 0.0)
        reached = max(reached, end)
    return total


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
    assessment : the answer.
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


def print_progress(out: Console, progress: Progress) -> None:
    """The sentence, and the attempts below each other.

    Parameters
    ----------
    out : where to print.
    progress : the answer.
    """
    from dousa.evaluation.advice.progress import describe_errors
    from dousa.evaluation.grade.score import round_grade
    from dousa.evaluation.words import KINDS

    out.print(one_line(str(progress.summary)), markup=False, soft_wrap=True)
    table = Table(box=None)
    table.add_column(str(Message("progress.attempt")), overflow="fold")
    for heading in (Message("progress.grade"), *KINDS.values(), Message("progress.lapses")):
        table.add_column(str(heading), justify="right")
    for one in progress.attempts:
        score = "-" if one.score is None else f"{round_grade(one.score):.0f}"
        cells = [str(describe_errors(kind, one)) for kind in KINDS]
        table.add_row(escape(one_line(one.name)), score, *cells, str(one.lapses))
    out.print(table)
