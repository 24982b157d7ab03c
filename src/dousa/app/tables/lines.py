"""Lines, cells and tables, as all answers have them, the notes below an answer, and tables of experiments."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

from rich.markup import escape
from rich.table import Table

from dousa.app.output import one_line, warn
from dousa.messages import Message

if TYPE_CHECKING:
    from rich.console import Console

    from dousa.experiments.table import ResultTable


def to_cell(text: Message | str) -> str:
    """The text as Rich shows it: square brackets are square brackets, and it is one line."""
    return escape(one_line(str(text)))


def print_line(out: Console, text: Message | str, **style: Any) -> None:
    """One line of an answer."""
    out.print(one_line(str(text)), markup=False, soft_wrap=True, **style)


def say_line(out: Console, code: str, /, **values: Any) -> None:
    """One line of an answer by its code."""
    print_line(out, Message(code, **values))


def make_table(*headings: Message | str, right: Sequence[Message | str] = ()) -> Table:
    """A table without lines, from headings or their codes; ``right`` are those of its columns of numbers."""
    table = Table(box=None)
    for heading in headings:
        words = heading if isinstance(heading, Message) else Message(heading)
        table.add_column(to_cell(words), justify="right" if heading in right else "left", overflow="fold")
    return table


SHOWN = 10  # lines of a list, so that the answer fits on the 24 lines of a terminal (VT100, 1978)


def name_side(mirrored: bool) -> str:
    """What stands in the column of sides."""
    return str(Message("columns.mirrored")) if mirrored else ""


def print_some(out: Console, heading: Message, lines: list[str], *, shown: int = SHOWN) -> None:
    """A heading and the first lines of a list: ``shown``, so that the answer fits on a screen."""
    out.print(str(heading), markup=False)
    for line in lines[:shown]:
        out.print(f"  {one_line(line)}", markup=False, soft_wrap=True)
    if len(lines) > shown:
        say_line(out, "adding.more", n=len(lines) - shown)


_OF_ANSWERS = ("partial.", "library_takes.")


def print_notes(out: Console, notes: Sequence[Message], path: str | None = None) -> None:
    """What was not compared, below the answer; and on standard error what came up when files were read.

    Parameters
    ----------
    out : where to print.
    notes : of an answer.
    path : the file that was read, where its notes do not name it.
    """
    for note in notes:
        if note.code.startswith(_OF_ANSWERS):
            print_line(out, f"  {note}")
        else:
            warn(note if path is None else Message("text.in_file", path=path, problem=note))


def print_tables(out: Console, tables: Iterable[ResultTable]) -> None:
    """Print tables one below the other, each with the lines that belong to it, in the language in use."""
    for answer in tables:
        for line in answer.preface:
            print_line(out, line)
        if answer.columns:
            out.print(_make_result_table(answer))
        for line in answer.notes:
            print_line(out, line)


def _make_result_table(answer: ResultTable) -> Table:
    look = {} if answer.framed else {"box": None}
    table = Table(title=to_cell(answer.title) or None, title_justify="left", **look)  # type: ignore[arg-type]
    for place, heading in enumerate(answer.columns):
        table.add_column(to_cell(heading), justify="left" if place < answer.n_words else "right")
    for number, row in enumerate(answer.rows):
        style = "bold" if number in answer.bold else None
        table.add_row(*map(to_cell, row), style=style, end_section=number in answer.sections)
    return table
