"""The grade of a performance and every error, the repetitions of an exercise, and a pupil over time."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from dousa.app.tables.lines import make_table, print_line, to_cell
from dousa.evaluation.exercises.summary import (
    choose_angles,
    choose_pair,
    describe_exercise,
    describe_trends,
    describe_worst,
)
from dousa.evaluation.grade.score import round_grade
from dousa.evaluation.posture.range_of_motion import ANGLE_NAMES
from dousa.evaluation.words import KINDS, LAPSE_KINDS, format_time, group_segments
from dousa.messages import Message

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from dousa.evaluation import AssessedRepetition, Assessment, Progress, RepetitionsAssessment
    from dousa.motion import RepetitionCount


def describe_coverage(assessment: Assessment) -> Message:
    """How much of the reference was danced, and which segments were not looked at."""
    percent = 100.0 * assessment.coverage
    if not assessment.not_judged:
        return Message("graded.coverage", percent=percent)
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

    if not assessment.is_other_dance:
        print_line(out, describe_coverage(assessment))
    is_graded = math.isfinite(assessment.score)
    grade = _describe_grade(assessment) if is_graded else assessment.score_formula
    print_line(out, grade, style="bold")
    points = advise(assessment, "brief")
    good = praise(assessment)
    for number, advice in enumerate(points, start=1):
        place = f"{number}. " if len(points) > 1 else ""
        print_line(out, f"{place}{advice.message}")
    if good is not None and good.furi:
        print_line(out, good.message)
    if detail == "brief":
        more = len(assessment.events) + len(assessment.lapses) - sum(max(len(point.times), 1) for point in points)
        if more > 0:
            print_line(out, Message("graded.more", n=more))
        return
    if is_graded:
        print_line(out, assessment.score_formula)
    _print_errors(out, assessment)


def _print_errors(out: Console, assessment: Assessment) -> None:
    rows = _list_rows(assessment)
    if rows:
        headings = ("graded.time", "graded.furi", "graded.error", "graded.severity", "graded.difference")
        table = make_table(*headings, right=("graded.furi", "graded.severity"))
        for _, cells in sorted(rows, key=lambda row: row[0]):
            table.add_row(*map(to_cell, cells))
        out.print(table)
    if rows and not assessment.events:
        print_line(out, Message("graded.no_errors"))
    if assessment.gaps:
        seconds = _covered([(start, end) for start, end, _ in assessment.gaps])
        print_line(out, Message("graded.gaps", seconds=seconds))


def _describe_grade(assessment: Assessment) -> Message:
    low, high = (f"{round_grade(value):.0f}" for value in assessment.score_interval)
    values = {"score": f"{round_grade(assessment.score):.0f}", "low": low, "high": high, "n": assessment.n_references}
    return Message("graded.calibrated" if assessment.calibrated else "graded.uncalibrated", **values)


def _list_rows(assessment: Assessment) -> list[tuple[float, tuple[str, ...]]]:
    """Start (s) and cells of each error and lapse."""
    rows: list[tuple[float, tuple[str, ...]]] = []
    for event in assessment.events:
        furi = "" if event.furi is None else str(event.furi + 1)
        cells = furi, str(KINDS[event.kind]), f"{event.severity:.1f}", str(event.message)
        rows.append((event.start_s, (_span(event.start_s, event.end_s), *cells)))
    for lapse in assessment.lapses:
        kind = str(Message("graded.lapse", kind=LAPSE_KINDS[lapse.kind]))
        rows.append((lapse.start_s, (_span(lapse.start_s, lapse.end_s), "", kind, "", str(lapse.message))))
    return rows


def _span(start: float, end: float) -> str:
    return f"{format_time(start)}-{format_time(end)}"


def _covered(spans: list[tuple[float, float]]) -> float:
    """Seconds that lie in at least one span."""
    total, reached = 0.0, float("-inf")
    for start, end in sorted(spans):
        total += max(end - max(start, reached), 0.0)
        reached = max(reached, end)
    return total


def print_count(out: Console, name: str, found: RepetitionCount) -> None:
    """The repetitions of a recording, in the language in use: how many, how sure, and when."""
    values = {"name": name, "n": found.count, "seconds": found.duration, "certainty": 100.0 * found.certainty}
    print_line(out, Message("repetition_count.found" if found.spans else "repetition_count.none", **values))
    if found.spans:
        print_line(out, Message("text.verbatim", text="  ".join(_span(start, end) for start, end in found.spans)))


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
        print_line(out, line)
    if detail == "full":
        out.print(_make_table(assessment))
    for line in describe_trends(assessment):
        print_line(out, line)


def _make_table(assessment: RepetitionsAssessment) -> Table:
    angles = choose_angles(assessment, 2)
    sides = choose_pair(assessment)
    headings = [Message(f"exercise_table.{name}") for name in ("number", "time", "duration", "tempo", "grade")]
    for name in angles:
        degrees = assessment.reference_ranges[name]
        headings.append(Message("exercise_table.range", angle=ANGLE_NAMES[name], degrees=degrees))
    if sides is not None:
        headings.append(Message("exercise_table.symmetry"))
    headings.append(Message("exercise_table.worst"))
    table = make_table(*headings, right=headings)
    for number, one in enumerate(assessment.repetitions, 1):
        table.add_row(*map(to_cell, _row(number, one, angles, sides)))
    return table


def _row(number: int, one: AssessedRepetition, angles: tuple[str, ...], sides: str | None) -> list[str]:
    found = one.repetition
    cells = [str(number), _span(found.start_s, found.end_s), f"{found.duration_s:.2f}"]
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
    return [*cells, str(describe_worst(one))]


def _number(value: float, digits: int) -> str:
    return f"{value:.{digits}f}" if math.isfinite(value) else "–"


def print_progress(out: Console, progress: Progress) -> None:
    """The sentence, and the attempts below each other."""
    from dousa.evaluation.advice.progress import describe_errors

    print_line(out, progress.summary)
    numbers: list[Message | str] = ["progress.grade", *KINDS.values(), "progress.lapses"]
    table = make_table("progress.attempt", *numbers, right=numbers)
    for one in progress.attempts:
        score = "-" if one.score is None else f"{round_grade(one.score):.0f}"
        cells = [str(describe_errors(kind, one)) for kind in KINDS]
        table.add_row(to_cell(one.name), score, *cells, str(one.lapses))
    out.print(table)
