"""What motions are taken for, the clips that a motion or words found, and what happens where in takes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from dousa.app.output import one_line, warn
from dousa.app.tables.lines import make_table, name_side, print_line, print_notes, say_line, to_cell
from dousa.evaluation.words import format_time
from dousa.messages import Message

if TYPE_CHECKING:
    from rich.console import Console

    from dousa.library import (
        Classification,
        FindResult,
        LabelledTake,
        SearchResult,
        TakeAnnotation,
        TextResult,
        Verdict,
    )
    from dousa.retrieval import Explanation, Likeness, Segment
    from dousa.retrieval.words.relations import Relation


def print_classes(out: Console, answers: Sequence[Classification]) -> None:
    """What files were taken for."""
    if not answers:
        warn(Message("answers.no_motion_files"))
    for answer in answers:
        if answer.verdict is not None:
            print_line(out, f"{answer.path}: {describe_verdict(answer.verdict)}")
            print_mirrored(out, answer.verdict, answer.mirrored)
            print_notes(out, answer.notes, answer.path)
            print_reasons(out, answer.verdict.explanation)


def describe_verdict(verdict: Verdict) -> str:
    """What a motion is taken for, and how surely: ``kick, 97% sure (votes: kick 87%, march 5%)``."""
    values: dict[str, Any] = {"guess": verdict.guess, "votes": describe_votes(verdict.histogram)}
    if verdict.confidence is None:
        return str(Message("verdict.unknown" if verdict.category is None else "verdict.named", **values))
    code = "verdict.perhaps" if verdict.perhaps else "verdict.unlikely"
    return str(Message(code if verdict.category is None else "verdict.sure", confidence=verdict.confidence, **values))


def describe_votes(histogram: dict[str, float], shown: int = 3) -> str:
    """The most voted categories with their shares: ``kick 87%, march 5%``."""
    best = sorted(histogram.items(), key=lambda item: -item[1])[:shown]
    return ", ".join(f"{name} {share:.0%}" for name, share in best if share > 0)


def print_mirrored(out: Console, verdict: Verdict, mirrored: Verdict | None) -> None:
    if mirrored is not None:
        code = "verdict.mirrored_better" if mirrored.fits_better_than(verdict) else "verdict.mirrored"
        say_line(out, code, verdict=describe_verdict(mirrored))


def print_reasons(out: Console, reasons: Explanation | Likeness | None, indent: str = "  ") -> None:
    for reason in reasons.reasons if reasons is not None else ():
        print_line(out, f"{indent}{reason.text}")


def print_search(out: Console, answer: SearchResult, *, detail: bool = False) -> None:
    """A query and the clips found; in detail also the numbers that the likeness is made of."""
    verdict = answer.verdict
    print_line(out, f"{answer.query}: {describe_verdict(verdict)}")
    print_mirrored(out, verdict, answer.mirrored)
    print_notes(out, answer.notes, answer.query)
    print_reasons(out, verdict.explanation)
    if not answer.results:
        warn(Message("answers.no_clip_found"))
        return
    side = () if answer.mirrored is None else ("columns.side",)
    from dousa.retrieval.features.posed_motion import name_parts

    differ = len({hit.hidden for hit in answer.results}) > 1
    measures = ("columns.votes", "columns.trees", "columns.poses") if detail else ()
    numbers = ("columns.rank", *measures, "columns.likeness")
    without = ("columns.without",) if differ else ()
    headings = ("columns.rank", "columns.category", "columns.likeness", *measures, *side, *without, "columns.file")
    table = make_table(*headings, right=numbers)
    likely = [place for place, hit in enumerate(answer.results) if hit.alike is not False]
    if not likely:
        say_line(out, "answers.none_alike")
    for place, hit in enumerate(answer.results):
        if place and likely and place == likely[-1] + 1:
            table.add_row(*[""] * (len(table.columns) - 1), str(Message("answers.no_longer_alike")))
        poses = "-" if hit.pose_distance is None else f"{hit.pose_distance:.3f}"
        measured = (f"{hit.distance:.3f}", f"{hit.leaf_share:.0%}", poses) if detail else ()
        likeness = answer.likenesses[place]
        percent = "-" if likeness is None else f"{likeness:.0%}"
        side = () if answer.mirrored is None else (name_side(hit.mirrored),)
        without = (", ".join(map(str, name_parts(hit.hidden))),) if differ else ()
        style = "dim" if hit.alike is False else None
        row = (str(hit.rank), to_cell(hit.category or "-"), percent, *measured, *side, *without, to_cell(hit.path))
        table.add_row(*row, style=style)
    out.print(table)
    if answer.alike_count is not None and answer.alike_count > len(likely) and likely:
        say_line(out, "answers.more_alike", n=answer.alike_count - len(likely), all=answer.alike_count)
    for hit in answer.results:
        if hit.likeness is not None and hit.likeness.reasons:
            print_line(out, f"{hit.rank}. {hit.path}")
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
    numbers = ("columns.rank", "columns.clip", "columns.fits")
    table = make_table(*numbers, "columns.category", "columns.does", "columns.file", right=numbers)
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
    table = make_table(*numbers, *(("columns.side",) if mirrored else ()), "columns.take", right=numbers)
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
            to_cell(place.take),
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
    return to_cell(Message("columns.perhaps", name=named) if segment.perhaps else named)


def print_timeline(out: Console, answer: LabelledTake) -> None:
    """What happens in a take, one stretch in a row."""
    print_line(out, f"{answer.take}: {answer.timeline.duration:.1f} s")
    print_notes(out, answer.notes, answer.take)
    numbers = ("columns.start", "columns.end", "columns.sure")
    table = make_table("columns.start", "columns.end", "columns.category", "columns.sure", right=numbers)
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
    print_line(out, f"{given.path}: {given.duration:.1f} s")
    times = ("columns.start", "columns.end")
    table = make_table(*times, "columns.category", right=times)
    for one in given.rows:
        name = to_cell(one.category) if one.category is not None else "-" if one.counted else "?"
        table.add_row(format_time(one.start), format_time(one.stop), name, style="dim" if one.category is None else "")
    out.print(table)
