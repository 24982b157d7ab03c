"""Tables of experiments."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

from rich.table import Table

from dousa.app.output import one_line
from dousa.app.tables.lines import to_cell

if TYPE_CHECKING:
    from rich.console import Console

    from dousa.experiments.table import ResultTable


def print_tables(out: Console, tables: Iterable[ResultTable]) -> None:
    """Print tables one below the other, each with the lines that belong to it, in the language in use."""
    for answer in tables:
        for line in answer.preface:
            out.print(one_line(str(line)), markup=False, soft_wrap=True)
        if answer.columns:
            out.print(_make_result_table(answer))
        for line in answer.notes:
            out.print(one_line(str(line)), markup=False, soft_wrap=True)


def _make_result_table(answer: ResultTable) -> Table:
    look = {} if answer.framed else {"box": None}
    table = Table(title=to_cell(answer.title) or None, title_justify="left", **look)  # type: ignore[arg-type]
    for place, heading in enumerate(answer.columns):
        table.add_column(to_cell(heading), justify="left" if place < answer.n_words else "right")
    for number, row in enumerate(answer.rows):
        style = "bold" if number in answer.bold else None
        table.add_row(*map(to_cell, row), style=style, end_section=number in answer.sections)
    return table
