"""A pupil over time as a table: a row an attempt, a column a kind of error."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.markup import escape
from rich.table import Table

from dousa.app.output import one_line
from dousa.messages import Message

if TYPE_CHECKING:
    from rich.console import Console

    from dousa.evaluation import Progress


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
