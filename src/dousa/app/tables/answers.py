"""Answers of the commands as lines and tables for people; each prints to the console it is given."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.markup import escape
from rich.table import Table

from dousa.app.output import one_line, warn
from dousa.evaluation.words import format_time
from dousa.messages import Message

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rich.console import Console

    from dousa.app.pipelines.estimate import Estimation
    from dousa.evaluation import Assessment
    from dousa.experiments.table import ResultTable
    from dousa.library import (
        AddReport,
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

_SHOWN = 10


def _cell(text: Message | str) -> str:
    """The text as Rich shows it: square brackets are square brackets, and it is one line."""
    return escape(one_line(str(text)))


def _say(out: Console, code: str, /, **values: Any) -> None:
    """One line of an answer."""
    out.print(one_line(str(Message(code, **values))), markup=False, soft_wrap=True)


def _make_table(right: Sequence[str] = (), left: Sequence[str] = (), folded: str | None = None) -> Table:
    """A table without lines: codes of its columns of numbers, of words, and of a last one that may be broken."""
    table = Table(box=None)
    for code in (*right, *left):
        table.add_column(str(Message(code)), justify="right" if code in right else "left", overflow="fold")
    if folded is not None:
        table.add_column(str(Message(folded)), overflow="fold")
    return table


def print_info(out: Console, answer: dict[str, Any]) -> None:
    """One file, as `dousa info` describes it."""
    table = Table(title=_cell(answer["path"]), title_justify="left", show_header=False, box=None, padding=(0, 2))

    def add(name: str, content: Message, style: str | None = None) -> None:
        table.add_row(str(Message(name)), _cell(str(content)), style=style)

    holds = "info.rotations" if answer["holds"] == "rotations" else "info.positions"
    add("info.format", Message(holds, format=answer["format"]))
    length = {"n": answer["n_frames"], "rate": answer["frame_rate"], "seconds": answer["duration_s"]}
    add("info.length", Message("info.frames", **length))
    add("info.unit", Message("info.metres", unit=answer["unit_m"], source=answer["unit_source"]))
    add("info.up", Message("info.axis", axis=answer["up"], source=answer["up_source"]))
    mapping = answer["mapping"]
    if mapping is None:
        add("info.mapping", Message("info.not_understood"), "bold red")
    else:
        code = "info.table_and_derived" if mapping["derived"] else "info.table"
        add("info.mapping", Message(code, table=mapping["table"], derived=mapping["derived"]))
        add("info.sides", Message("info.names_and_geometry", agree=mapping["sides"]))
        if mapping["absent"]:
            add("info.absent", Message("text.verbatim", text=", ".join(mapping["absent"])), "yellow")
        height = {"height": answer["height_m"], "source": answer["height_source"], "stature": answer["stature_m"]}
        add("info.height", Message("info.height_from", **height))
    add("info.joints", Message("info.names", n=answer["n_joints"], joints=answer["joints"]))
    for warning in answer["warnings"]:
        add("info.note", Message("text.verbatim", text=warning), "yellow")
    _print_unpadded(out, table)


def _print_unpadded(out: Console, table: Table) -> None:
    """A table for people; in a file or pipe without the blanks that fill its rows to the longest."""
    if out.is_terminal:
        out.print(table)
        return
    with out.capture() as captured:
        out.print(table)
    rows = captured.get().splitlines()
    out.print("\n".join(row.rstrip() for row in rows), markup=False, soft_wrap=True)


_CONVERTED = {
    "adding.convert_blender": (".fbx", ".dae", ".blend", ".abc", ".usd", ".usda", ".usdc", ".usdz", ".ma", ".max"),
    "adding.convert_opensim": (".mot", ".sto"),
    "adding.convert_program": (".tak", ".trk", ".qtm", ".vsk", ".vss", ".vst", ".x2d", ".cap", ".trb", ".anb", ".htr",
                               ".gtr", ".mvn", ".tdf", ".bip", ".anim", ".mat"),
}  # fmt: skip


def _say_passed_over(out: Console, passed_over: Sequence[tuple[str, int]]) -> None:
    """How many files of which suffix no reader takes, and how those that hold motion can be converted."""
    counts = [f"{n} {suffix or '-'}" for suffix, n in passed_over]
    _say(out, "adding.passed_over", counts=counts)
    for code, suffixes in _CONVERTED.items():
        found = [suffix for suffix, _ in passed_over if suffix in suffixes]
        if found:
            _say(out, code, suffixes=found)


def print_add(out: Console, report: AddReport) -> None:
    """What was added to a library, and what was not and why."""
    rate = report.bytes / 1e6 / report.seconds if report.seconds > 0 else 0.0
    _say(
        out,
        "adding.added",
        n=len(report.added),
        megabytes=report.bytes / 1e6,
        seconds=report.seconds,
        rate=rate,
    )
    for said, files in (
        ("adding.replaced", report.replaced),
        ("adding.moved", report.moved),
        ("adding.unchanged", report.unchanged),
    ):
        if files:
            _say(out, said, n=len(files))
    if report.duplicates:
        pairs = [f"{item.path} = {item.same_as}" for item in report.duplicates]
        print_some(out, Message("adding.duplicates", n=len(pairs)), pairs)
    if report.skipped:
        print_some(
            out,
            Message("adding.skipped", n=len(report.skipped)),
            [f"{item.path}: {item.reason}" for item in report.skipped],
        )
    if report.passed_over:
        _say_passed_over(out, report.passed_over)
    if report.labelled:
        _say(out, "adding.labelled", n=len(report.labelled), segments=report.n_segments)
    if report.n_learned:
        code = "adding.learned_categories" if report.new_categories else "adding.learned"
        _say(out, code, n=report.n_learned, new=len(report.new_categories))
    if report.other_kind:
        warn(Message("answers.other_kind", n=len(report.other_kind)))
    for text, count in Counter(text for _, text in report.warnings).most_common(_SHOWN):
        warn(Message("answers.note_of_files", note=text, n=count))
    told = (report.added, report.replaced, report.moved, report.unchanged, report.duplicates, report.skipped)
    if not any(told):
        warn(Message("answers.no_motion_files"))
    if report.other_labels:
        warn(Message("answers.other_labels", n=len(report.other_labels)))


def warn_of_files(notes: Iterable[tuple[str, Message]]) -> None:
    """What came up when files were read, on standard error: each once, with the file where it is the only one."""
    files: dict[Message, list[str]] = {}
    for path, message in notes:
        files.setdefault(message, []).append(path)
    for message, paths in sorted(files.items(), key=lambda item: -len(item[1]))[:_SHOWN]:
        if len(paths) > 1:
            warn(Message("answers.note_of_files", note=message, n=len(paths)))
        else:
            warn(message if message.code in _NAMED else Message("text.in_file", path=paths[0], problem=message))
    if len(files) > _SHOWN:
        warn(Message("answers.more_notes", n=len(files) - _SHOWN))


_NAMED = ("text.in_file", "text.in_line")


def print_some(out: Console, heading: Message, lines: list[str]) -> None:
    """A heading and the first lines of a list."""
    out.print(str(heading), markup=False)
    for line in lines[:_SHOWN]:
        out.print(f"  {one_line(line)}", markup=False, soft_wrap=True)
    if len(lines) > _SHOWN:
        _say(out, "adding.more", n=len(lines) - _SHOWN)


def print_classes(out: Console, answers: Sequence[Classification]) -> None:
    """What files were taken for."""
    if not answers:
        warn(Message("answers.no_motion_files"))
    for answer in answers:
        if answer.verdict is not None:
            out.print(one_line(f"{answer.path}: {describe_verdict(answer.verdict)}"), markup=False, soft_wrap=True)
            _print_mirrored(out, answer.verdict, answer.mirrored)
            _print_notes(out, answer.notes, answer.path)
            _print_reasons(out, answer.verdict.explanation)


def describe_verdict(verdict: Verdict) -> str:
    """What a motion is taken for, and how surely: ``kick, 97% sure (votes: kick 87%, march 5%)``."""
    values: dict[str, Any] = {"guess": verdict.guess, "votes": describe_votes(verdict.histogram)}
    if verdict.confidence is None:
        return str(Message("verdict.unknown" if verdict.category is None else "verdict.named", **values))
    code = "verdict.perhaps" if verdict.perhaps else "verdict.unlikely"
    return str(Message(code if verdict.category is None else "verdict.sure", confidence=verdict.confidence, **values))


def _print_mirrored(out: Console, verdict: Verdict, mirrored: Verdict | None) -> None:
    if mirrored is not None:
        code = "verdict.mirrored_better" if mirrored.fits_better_than(verdict) else "verdict.mirrored"
        _say(out, code, verdict=describe_verdict(mirrored))


_OF_ANSWERS = ("partial.", "library_takes.")


def _print_notes(out: Console, notes: Sequence[Message], path: str | None = None) -> None:
    """What was not compared, below the answer; and on standard error what came up when files were read.

    Parameters
    ----------
    out : where to print.
    notes : of an answer.
    path : the file that was read, where its notes do not name it.
    """
    for note in notes:
        if note.code.startswith(_OF_ANSWERS):
            out.print(one_line(f"  {note}"), markup=False, soft_wrap=True)
        else:
            warn(note if path is None else Message("text.in_file", path=path, problem=note))


def _print_reasons(out: Console, reasons: Explanation | Likeness | None, indent: str = "  ") -> None:
    for reason in reasons.reasons if reasons is not None else ():
        out.print(one_line(f"{indent}{reason.text}"), markup=False, soft_wrap=True)


def print_search(out: Console, answer: SearchResult) -> None:
    """A query and the clips found."""
    verdict = answer.verdict
    out.print(one_line(f"{answer.query}: {describe_verdict(verdict)}"), markup=False, soft_wrap=True)
    _print_mirrored(out, verdict, answer.mirrored)
    _print_notes(out, answer.notes, answer.query)
    _print_reasons(out, verdict.explanation)
    if not answer.results:
        warn(Message("answers.no_clip_found"))
        return
    side = () if answer.mirrored is None else ("columns.side",)
    from dousa.retrieval.features.partial_bodies import name_parts

    differ = len({hit.hidden for hit in answer.results}) > 1
    table = _make_table(
        ("columns.rank", "columns.distance", "columns.same_leaf", "columns.poses"),
        ("columns.category", *side, *(("columns.without",) if differ else ())),
        "columns.file",
    )
    likely = [place for place, hit in enumerate(answer.results) if hit.alike is not False]
    if not likely:
        _say(out, "answers.none_alike")
    for place, hit in enumerate(answer.results):
        if place and likely and place == likely[-1] + 1:
            table.add_row(*[""] * (len(table.columns) - 1), str(Message("answers.no_longer_alike")))
        poses = "-" if hit.pose_distance is None else f"{hit.pose_distance:.3f}"
        numbers = (str(hit.rank), f"{hit.distance:.3f}", f"{hit.leaf_share:.0%}", poses)
        side = () if answer.mirrored is None else (_name_side(hit.mirrored),)
        without = (", ".join(map(str, name_parts(hit.hidden))),) if differ else ()
        style = "dim" if hit.alike is False else None
        table.add_row(*numbers, _cell(hit.category or "-"), *side, *without, _cell(hit.path), style=style)
    out.print(table)
    if answer.alike_count is not None and answer.alike_count > len(likely) and likely:
        _say(out, "answers.more_alike", n=answer.alike_count - len(likely), all=answer.alike_count)
    for hit in answer.results:
        if hit.likeness is not None and hit.likeness.reasons:
            out.print(one_line(f"{hit.rank}. {hit.path}"), markup=False, soft_wrap=True)
            _print_reasons(out, hit.likeness, "   ")


def print_text_search(out: Console, answer: TextResult) -> None:
    """What words found, and how they were understood."""
    for code, words in (("text_search.corrected", answer.corrections), ("text_search.replaced", answer.replaced)):
        for word, taken in words.items():
            _say(out, code, word=word, taken=taken)
    if not answer.n_searched:
        warn(Message("text_search.nothing_there"))
        return
    if not answer.results:
        _say(out, "text_search.nothing", text=answer.text, all=answer.n_searched)
        if answer.unknown:
            _say(out, "text_search.unknown", words=answer.unknown)
        if answer.near:
            _say(out, "text_search.near", words=answer.near)
        return
    _say(out, "text_search.found", text=answer.text, n=answer.n_found, all=answer.n_searched)
    table = _make_table(
        ("columns.rank", "columns.clip", "columns.fits"), ("columns.category", "columns.does"), "columns.file"
    )
    for hit in answer.results:
        does = str(Message("text_search.does", relations=tuple(map(describe_relation, hit.relations)))) or "-"
        numbers = (str(hit.rank), str(hit.clip_id), f"{hit.score:.0%}")
        table.add_row(*numbers, _cell(hit.category or "-"), _cell(does), _cell(hit.path))
    out.print(table)
    if answer.n_found > len(answer.results):
        _say(out, "text_search.more", n=answer.n_found - len(answer.results), all=answer.n_found)


def describe_relation(relation: Relation) -> Message:
    """What a motion does, and when it does it longest."""
    times = {"start": relation.start, "end": relation.end}
    return Message("text_search.relation", relation=relation.message, **times)


def describe_votes(histogram: dict[str, float], shown: int = 3) -> str:
    """The most voted categories with their shares: ``kick 87%, march 5%``."""
    best = sorted(histogram.items(), key=lambda item: -item[1])[:shown]
    return ", ".join(f"{name} {share:.0%}" for name, share in best if share > 0)


_CLIP_COLUMNS = (
    *("columns.clip", "columns.kind", "columns.category", "columns.predicted", "columns.performer"),
    *("columns.seconds", "columns.rate", "columns.file"),
)


def _name_side(mirrored: bool) -> str:
    return str(Message("columns.mirrored")) if mirrored else ""


def print_clips(out: Console, rows: list[dict[str, Any]]) -> None:
    """Clips of a library, one in a row."""
    table = Table(box=None)
    for code in _CLIP_COLUMNS:
        right = code in ("columns.clip", "columns.seconds", "columns.rate")
        table.add_column(str(Message(code)), justify="right" if right else "left", overflow="fold")
    for row in rows:
        labels = [_cell(row[name] or "-") for name in ("category", "predicted_category", "performer")]
        table.add_row(
            str(row["id"]),
            row["kind"],
            *labels,
            f"{row['duration']:.1f}",
            f"{row['frame_rate']:g}",
            _cell(row["path"]),
        )
    out.print(table)


def print_stats(out: Console, library: str, stats: dict[str, Any]) -> None:
    """A library in numbers."""
    forest = Message("stats.untrained")
    if stats["trained_at"]:
        features = stats["parameters"].get("feature_set", "paper")
        forest = Message("stats.trained", time=stats["trained_at"], features=features)
        if stats["n_learned"]:
            forest = Message("stats.learned_since", forest=forest, n=stats["n_learned"])
        if not stats["forest_is_current"]:
            forest = Message("stats.changed_since", forest=forest)
    parts = [Message("stats.clips", n=stats["n_clips"], minutes=stats["seconds"] / 60)]
    if stats["n_takes"]:
        parts.append(Message("stats.takes", n=stats["n_takes"], minutes=stats["take_seconds"] / 60))
    parts.append(Message("stats.performers", n=len(stats["performers"])))
    _say(out, "stats.library", library=library, parts=parts, forest=forest)
    table = Table(box=None)
    table.add_column(str(Message("columns.category")))
    table.add_column(str(Message("columns.clips")), justify="right")
    for name, count in stats["categories"].items():
        table.add_row(_cell(name), str(count))
    if stats["n_unlabelled"]:
        table.add_row(str(Message("stats.no_category")), str(stats["n_unlabelled"]))
    out.print(table)


def print_places(out: Console, answer: FindResult, *, mirrored: bool) -> None:
    """A query and the places that are like it, the surest first; a column says which are mirrored if that was asked."""
    takes = Message("stats.takes", n=answer.n_takes, minutes=answer.seconds / 60)
    _say(out, "places.query", query=answer.query, seconds=answer.duration, takes=takes)
    _print_notes(out, answer.notes)
    if not answer.results:
        warn(Message("answers.takes_too_short" if answer.n_takes else "answers.no_takes"))
        return
    # What the order goes by, where that was learned; else it is the score.
    sure = ("columns.sure",) if any(place.probability is not None for place in answer.results) else ()
    numbers = ("columns.rank", *sure, "columns.score", "columns.start", "columns.end", "columns.tempo")
    table = _make_table(numbers, ("columns.side",) if mirrored else (), "columns.take")
    likely = answer.alike_count if answer.alike_count is not None else len(answer.results)
    if not likely:
        _say(out, "answers.no_place_alike")
    for number, place in enumerate(answer.results):
        if number and number == likely:
            table.add_row(*[""] * (len(table.columns) - 1), str(Message("answers.no_longer_alike")))
        times = (format_time(place.start), format_time(place.end), f"{place.tempo:.2f}")
        side = (_name_side(place.mirrored),) if mirrored else ()
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
    side = f" ({_name_side(segment.mirrored)})" if segment.mirrored else ""
    named = one_line(name) + often + side
    return escape(str(Message("columns.perhaps", name=named)) if segment.perhaps else named)


def print_timeline(out: Console, answer: LabelledTake) -> None:
    """What happens in a take, one stretch in a row."""
    out.print(one_line(f"{answer.take}: {answer.timeline.duration:.1f} s"), markup=False, soft_wrap=True)
    _print_notes(out, answer.notes, answer.take)
    table = _make_table(("columns.start", "columns.end"), (), "columns.category")
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
    table = _make_table(("columns.start", "columns.end"), (), "columns.category")
    for one in given.rows:
        name = _cell(one.category) if one.category is not None else "-" if one.counted else "?"
        table.add_row(format_time(one.start), format_time(one.stop), name, style="dim" if one.category is None else "")
    out.print(table)


_GOOD, _FAIR = 0.75, 0.5  # overlap of model and silhouette
_SHOWN_STRETCHES = 6
_SHOWN_JOINTS = 5


def print_estimation(out: Console, done: Estimation) -> None:
    """Overlap per view, what was lost, how sure the joints are, and what was written.

    Parameters
    ----------
    out : where to print.
    done : the answer.
    """
    answer = done.estimate
    length = answer.n_frames / answer.frame_rate
    _say(
        out,
        "estimated.frames",
        n=answer.n_frames,
        rate=answer.frame_rate,
        seconds=length,
        speed=answer.frames_per_second,
        body=done.body,
        start=done.start,
    )
    table = Table(box=None)
    table.add_column(str(Message("columns.view")))
    for code in ("columns.overlap", "columns.worst", "columns.in_frame"):
        table.add_column(str(Message(code)), justify="right")
    for name, column in zip(done.views, answer.iou.T, strict=True):
        if not np.isfinite(column).any():
            table.add_row(_cell(name), str(Message("estimated.no_image")), "", "")
            continue
        worst = int(np.nanargmin(column))
        mean = float(np.nanmean(column))
        colour = "green" if mean >= _GOOD else "yellow" if mean >= _FAIR else "red"
        table.add_row(
            _cell(name),
            f"[{colour}]{mean:.2f}[/]",
            f"{column[worst]:.2f}",
            str(done.first_frame + worst),
        )
    out.print(table)
    lost = np.flatnonzero(answer.lost)
    if len(lost):
        frames = describe_frames(lost + done.first_frame)
        seconds = describe_seconds(lost + done.first_frame, answer.frame_rate)
        _say(out, "estimated.lost", n=len(lost), total=answer.n_frames, frames=frames, seconds=seconds)
    else:
        _say(out, "estimated.none_lost")
    _print_uncertainty(out, done)
    for path in done.outputs:
        _say(out, "estimated.wrote", path=path)


def describe_frames(frames: Sequence[int] | np.ndarray) -> str:
    """Numbers of frames as stretches: ``3-7, 12``."""
    return _describe_stretches(frames, lambda first, last: f"{first}" if first == last else f"{first}-{last}")


def describe_seconds(frames: Sequence[int] | np.ndarray, rate: float) -> str:
    """Stretches of frames in seconds: ``0.10-0.27, 0.40-0.43``."""
    return _describe_stretches(frames, lambda first, last: f"{first / rate:.2f}-{(last + 1) / rate:.2f}")


def _describe_stretches(frames: Sequence[int] | np.ndarray, describe: Callable[[int, int], str]) -> str:
    numbers = np.asarray(frames)
    if len(numbers) == 0:
        return str(Message("estimated.no_frames"))
    cuts = np.flatnonzero(np.diff(numbers) > 1) + 1
    stretches = [describe(int(part[0]), int(part[-1])) for part in np.split(numbers, cuts)]
    more = len(stretches) - _SHOWN_STRETCHES
    shown = ", ".join(stretches[:_SHOWN_STRETCHES])
    return str(Message("estimated.more_stretches", shown=shown, n=more)) if more > 0 else shown


def _print_uncertainty(out: Console, done: Estimation) -> None:
    answer = done.estimate
    kept = answer.uncertainty[~answer.lost] if (~answer.lost).any() else answer.uncertainty
    if not np.isfinite(kept).any():
        return
    means = np.nanmean(kept, axis=0) * 1000.0
    names = answer.points.names
    order = [joint for joint in np.argsort(-means) if np.isfinite(means[joint])]
    least_sure = ", ".join(f"{names[joint]} {means[joint]:.0f}" for joint in order[:_SHOWN_JOINTS])
    _say(out, "estimated.uncertainty", median=float(np.nanmedian(means)), joints=least_sure)
    hidden = answer.occluded.mean(axis=0)
    parts = [f"{answer.body.names[part]} {hidden[part]:.0%}" for part in np.argsort(-hidden) if hidden[part] >= 0.1]
    if parts:
        _say(out, "estimated.hidden", parts=parts[:_SHOWN_JOINTS])


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
    table = Table(title=_cell(answer.title) or None, title_justify="left", **look)  # type: ignore[arg-type]
    for place, heading in enumerate(answer.columns):
        table.add_column(_cell(heading), justify="left" if place < answer.n_words else "right")
    for number, row in enumerate(answer.rows):
        style = "bold" if number in answer.bold else None
        table.add_row(*map(_cell, row), style=style, end_section=number in answer.sections)
    return table
