"""What happens where in takes: places that are like a motion, timelines, labels that were given."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.markup import escape

from dousa.app.output import one_line, warn
from dousa.app.tables.lines import make_table, name_side, print_notes, say_line, to_cell
from dousa.evaluation.words import format_time
from dousa.messages import Message

if TYPE_CHECKING:
    from rich.console import Console

    from dousa.library import FindResult, LabelledTake, TakeAnnotation
    from dousa.retrieval import Segment


def print_places(out: Console, answer: FindResult, *, mirrored: bool) -> None:
    """A query and the places that are like it, the surest first; a column says which are mirrored if that was asked."""
    takes = Message("stats.takes", n=answer.n_takes, minutes=answer.seconds / 60)
    say_line(out, "places.query", query=answer.query, seconds=answer.duration, takes=takes)
    print_notes(out, answer.notes)
    if not answer.results:
        warn(Message("answers.takes_too_short" if answer.n_takes else "answers.no_takes"))
        return
    # What the order goes by, where that was learned; else it is the score.
    sure = ("columns.sure",) if any(place.probability is not None for place in answer.results) else ()
    numbers = ("columns.rank", *sure, "columns.score", "columns.start", "columns.end", "columns.tempo")
    table = make_table(numbers, ("columns.side",) if mirrored else (), "columns.take")
    likely = answer.alike_count if answer.alike_count is not None else len(answer.results)
    if not likely:
        say_line(out, "answers.no_place_alike")
    for number, place in enumerate(answer.results):
        if number and number == likely:
            table.add_row(*[""] * (len(table.columns) - 1), str(Message("answers.no_longer_alike")))
        times = (format_time(place.start), format_time(place.end), f"{place.tempo:.2f}")
        side = (name_side(place.mirrored),) if mirrored else ()
        chance = "-" if place.probability is None else f"{place.probability:.0%}"
        table.add_row(
            str(place.rank),
            *((chance,) if sure else ()),
            f"{place.score:.2f}",
            *times,
            *side,
            escape(one_line(place.take)),
            style="dim" if place.alike is False else None,
        )
    out.print(table)


def _name_segment(segment: Segment) -> str:
    """The category, how often it is done where that is more than once, and whether left and right are swapped."""
    name = segment.category or segment.guess
    if name is None:
        return str(Message("columns.unknown"))
    often = f" × {segment.repetitions}" if segment.repetitions > 1 else ""
    side = f" ({name_side(segment.mirrored)})" if segment.mirrored else ""
    named = one_line(name) + often + side
    return escape(str(Message("columns.perhaps", name=named)) if segment.perhaps else named)


def print_timeline(out: Console, answer: LabelledTake) -> None:
    """What happens in a take, one stretch in a row."""
    out.print(one_line(f"{answer.take}: {answer.timeline.duration:.1f} s"), markup=False, soft_wrap=True)
    print_notes(out, answer.notes, answer.take)
    table = make_table(("columns.start", "columns.end"), (), "columns.category")
    table.add_column(str(Message("columns.sure")), justify="right")
    for segment in answer.timeline.segments:
        known = segment.category is not None
        table.add_row(
            format_time(segment.start),
            format_time(segment.stop),
            _name_segment(segment),
            f"{segment.confidence:.0%}",
            style=None if known else "dim",
        )
    out.print(table)


def print_given(out: Console, given: TakeAnnotation) -> None:
    """The labels that a take was given, one in a row."""
    out.print(one_line(f"{given.path}: {given.duration:.1f} s"), markup=False, soft_wrap=True)
    table = make_table(("columns.start", "columns.end"), (), "columns.category")
    for one in given.rows:
        name = to_cell(one.category) if one.category is not None else "-" if one.counted else "?"
        table.add_row(format_time(one.start), format_time(one.stop), name, style="dim" if one.category is None else "")
    out.print(table)
