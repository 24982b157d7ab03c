"""The grade of a performance, what to work on, and every error."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from rich.markup import escape
from rich.table import Table

from dousa.app.output import one_line
from dousa.messages import Message

if TYPE_CHECKING:
    from rich.console import Console

    from dousa.evaluation import Assessment


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
    said = advise(assessment, "brief")
    good = praise(assessment)
    for number, one in enumerate(said, start=1):
        place = f"{number}. " if len(said) > 1 else ""
        out.print(f"{place}{one_line(str(one.message))}", markup=False, soft_wrap=True)
    if good is not None and good.furi:
        out.print(str(good.message), markup=False, soft_wrap=True)
    if detail == "brief":
        more = len(assessment.events) + len(assessment.lapses) - sum(max(len(one.times), 1) for one in said)
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
    """The grade with its interval."""
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
