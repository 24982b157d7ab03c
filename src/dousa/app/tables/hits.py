"""The clips that a motion or words found."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dousa.app.output import one_line, warn
from dousa.app.tables.lines import make_table, name_side, print_notes, say_line, to_cell
from dousa.app.tables.verdicts import describe_verdict, print_mirrored, print_reasons
from dousa.messages import Message

if TYPE_CHECKING:
    from rich.console import Console

    from dousa.library import SearchResult, TextResult
    from dousa.retrieval.words.relations import Relation


def print_search(out: Console, answer: SearchResult) -> None:
    """A query and the clips found."""
    verdict = answer.verdict
    out.print(one_line(f"{answer.query}: {describe_verdict(verdict)}"), markup=False, soft_wrap=True)
    print_mirrored(out, verdict, answer.mirrored)
    print_notes(out, answer.notes, answer.query)
    print_reasons(out, verdict.explanation)
    if not answer.results:
        warn(Message("answers.no_clip_found"))
        return
    side = () if answer.mirrored is None else ("columns.side",)
    from dousa.retrieval.features.partial_bodies import name_parts

    differ = len({hit.hidden for hit in answer.results}) > 1
    table = make_table(
        ("columns.rank", "columns.distance", "columns.same_leaf", "columns.poses"),
        ("columns.category", *side, *(("columns.without",) if differ else ())),
        "columns.file",
    )
    likely = [place for place, hit in enumerate(answer.results) if hit.alike is not False]
    if not likely:
        say_line(out, "answers.none_alike")
    for place, hit in enumerate(answer.results):
        if place and likely and place == likely[-1] + 1:
            table.add_row(*[""] * (len(table.columns) - 1), str(Message("answers.no_longer_alike")))
        poses = "-" if hit.pose_distance is None else f"{hit.pose_distance:.3f}"
        numbers = (str(hit.rank), f"{hit.distance:.3f}", f"{hit.leaf_share:.0%}", poses)
        side = () if answer.mirrored is None else (name_side(hit.mirrored),)
        without = (", ".join(map(str, name_parts(hit.hidden))),) if differ else ()
        style = "dim" if hit.alike is False else None
        table.add_row(*numbers, to_cell(hit.category or "-"), *side, *without, to_cell(hit.path), style=style)
    out.print(table)
    if answer.alike_count is not None and answer.alike_count > len(likely) and likely:
        say_line(out, "answers.more_alike", n=answer.alike_count - len(likely), all=answer.alike_count)
    for hit in answer.results:
        if hit.likeness is not None and hit.likeness.reasons:
            out.print(one_line(f"{hit.rank}. {hit.path}"), markup=False, soft_wrap=True)
            print_reasons(out, hit.likeness, "   ")


def print_text_search(out: Console, answer: TextResult) -> None:
    """What words found, and how they were understood."""
    for code, words in (("text_search.corrected", answer.corrections), ("text_search.replaced", answer.replaced)):
        for word, taken in words.items():
            say_line(out, code, word=word, taken=taken)
    if not answer.n_searched:
        warn(Message("text_search.nothing_there"))
        return
    if not answer.results:
        say_line(out, "text_search.nothing", text=answer.text, all=answer.n_searched)
        if answer.unknown:
            say_line(out, "text_search.unknown", words=answer.unknown)
        if answer.near:
            say_line(out, "text_search.near", words=answer.near)
        return
    say_line(out, "text_search.found", text=answer.text, n=answer.n_found, all=answer.n_searched)
    table = make_table(
        ("columns.rank", "columns.clip", "columns.fits"), ("columns.category", "columns.does"), "columns.file"
    )
    for hit in answer.results:
        does = str(Message("text_search.does", relations=tuple(map(describe_relation, hit.relations)))) or "-"
        numbers = (str(hit.rank), str(hit.clip_id), f"{hit.score:.0%}")
        table.add_row(*numbers, to_cell(hit.category or "-"), to_cell(does), to_cell(hit.path))
    out.print(table)
    if answer.n_found > len(answer.results):
        say_line(out, "text_search.more", n=answer.n_found - len(answer.results), all=answer.n_found)


def describe_relation(relation: Relation) -> Message:
    """What a motion does, and when it does it longest."""
    times = {"start": relation.start, "end": relation.end}
    return Message("text_search.relation", relation=relation.message, **times)
