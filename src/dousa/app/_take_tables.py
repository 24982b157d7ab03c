"""Answers about takes as tables for people; each prints to the console it is given."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.markup import escape
from rich.table import Table

from dousa.app._output import one_line, warn
from dousa.evaluation.words import format_time

if TYPE_CHECKING:
    from rich.console import Console

    from dousa.library import FindResult, LabelledTake

__all__ = ["print_places", "print_timeline"]


def print_places(out: Console, answer: FindResult, *, mirrored: bool) -> None:
    """A query and the places that are like it; a column says which are mirrored if that was looked for."""
    takes = (
        f"{answer.n_takes} {'take' if answer.n_takes == 1 else 'takes'}, {answer.seconds / 60:.1f} minutes"
    )
    out.print(one_line(f"{answer.query} ({answer.duration:.1f} s) in {takes}:"), markup=False, soft_wrap=True)
    if not answer.results:
        short = "nothing was found: the takes are shorter than half of the query"
        warn(short if answer.n_takes else "there are no takes to look into")
        return
    table = Table(box=None)
    for name in ("rank", "score", "start", "end", "tempo"):
        table.add_column(name, justify="right")
    if mirrored:
        table.add_column("")
    table.add_column("take", overflow="fold")
    for place in answer.results:
        times = (format_time(place.start), format_time(place.end), f"{place.tempo:.2f}")
        side = ("mirrored" if place.mirrored else "",) if mirrored else ()
        table.add_row(str(place.rank), f"{place.score:.2f}", *times, *side, escape(one_line(place.take)))
    out.print(table)


def print_timeline(out: Console, answer: LabelledTake) -> None:
    """What happens in a take, one stretch in a row."""
    out.print(one_line(f"{answer.take}: {answer.timeline.duration:.1f} s"), markup=False, soft_wrap=True)
    table = Table(box=None)
    for name in ("start", "end"):
        table.add_column(name, justify="right")
    table.add_column("category", overflow="fold")
    table.add_column("sure", justify="right")
    for segment in answer.timeline.segments:
        known = segment.category is not None
        table.add_row(
            format_time(segment.start),
            format_time(segment.stop),
            escape(one_line(segment.category)) if segment.category is not None else "unknown",
            f"{segment.confidence:.0%}",
            style=None if known else "dim",
        )
    out.print(table)
