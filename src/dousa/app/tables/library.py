"""What files and libraries hold, what became of files that were added, and what looking after a library found."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from datetime import datetime
from typing import TYPE_CHECKING, Any

from rich.table import Table

from dousa.app.output import warn
from dousa.app.tables.lines import SHOWN, make_table, print_line, print_some, say_line, to_cell
from dousa.messages import Message

if TYPE_CHECKING:
    from rich.console import Console

    from dousa.library import (
        AddReport,
        BackupReport,
        CheckReport,
        CompactReport,
        DuplicateGroup,
        JournalEntry,
        LabelReview,
        SavedSearch,
    )


def print_info(out: Console, answer: dict[str, Any]) -> None:
    """One file, as `dousa info` describes it."""
    table = Table(title=to_cell(answer["path"]), title_justify="left", show_header=False, box=None, padding=(0, 2))

    def add(name: str, content: Message, style: str | None = None) -> None:
        table.add_row(str(Message(name)), to_cell(str(content)), style=style)

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
    say_line(out, "adding.passed_over", counts=counts)
    for code, suffixes in _CONVERTED.items():
        found = [suffix for suffix, _ in passed_over if suffix in suffixes]
        if found:
            say_line(out, code, suffixes=found)


def print_add(out: Console, report: AddReport, *, shown: int = SHOWN) -> None:
    """What was added to a library, and what was not and why; ``shown`` notes, so that they fit on a screen."""
    rate = report.bytes / 1e6 / report.seconds if report.seconds > 0 else 0.0
    done = {"megabytes": report.bytes / 1e6, "seconds": report.seconds, "rate": rate}
    say_line(out, "adding.added", n=len(report.added), **done)
    codes = ("adding.replaced", "adding.moved", "adding.unchanged")
    for code, files in zip(codes, (report.replaced, report.moved, report.unchanged), strict=True):
        if files:
            say_line(out, code, n=len(files))
    if report.duplicates:
        pairs = [f"{item.path} = {item.same_as}" for item in report.duplicates]
        print_some(out, Message("adding.duplicates", n=len(pairs)), pairs)
    if report.skipped:
        reasons = [f"{item.path}: {item.reason}" for item in report.skipped]
        print_some(out, Message("adding.skipped", n=len(reasons)), reasons)
    if report.passed_over:
        _say_passed_over(out, report.passed_over)
    if report.labelled:
        say_line(out, "adding.labelled", n=len(report.labelled), segments=report.n_segments)
    if report.n_learned:
        code = "adding.learned_categories" if report.new_categories else "adding.learned"
        say_line(out, code, n=report.n_learned, new=len(report.new_categories))
    if report.other_kind:
        warn(Message("answers.other_kind", n=len(report.other_kind)))
    for text, count in Counter(text for _, text in report.warnings).most_common(shown):
        warn(Message("answers.note_of_files", note=text, n=count))
    listed = (report.added, report.replaced, report.moved, report.unchanged, report.duplicates, report.skipped)
    if not any(listed):
        warn(Message("answers.no_motion_files"))
    if report.other_labels:
        warn(Message("answers.other_labels", n=len(report.other_labels)))


_NAMED = ("text.in_file", "text.in_line")


def warn_of_files(notes: Iterable[tuple[str, Message]], *, shown: int = SHOWN) -> None:
    """What came up when files were read, on standard error: each once, with the file where it is the only one.

    The first ``shown`` of them, so that they fit on a screen.
    """
    files: dict[Message, list[str]] = {}
    for path, message in notes:
        files.setdefault(message, []).append(path)
    for message, paths in sorted(files.items(), key=lambda item: -len(item[1]))[:shown]:
        if len(paths) > 1:
            warn(Message("answers.note_of_files", note=message, n=len(paths)))
        else:
            warn(message if message.code in _NAMED else Message("text.in_file", path=paths[0], problem=message))
    if len(files) > shown:
        warn(Message("answers.more_notes", n=len(files) - shown))


_CLIP_COLUMNS = (
    *("columns.clip", "columns.kind", "columns.category", "columns.predicted", "columns.performer"),
    *("columns.seconds", "columns.rate", "columns.file"),
)


def print_clips(out: Console, rows: list[dict[str, Any]]) -> None:
    """Clips of a library, one in a row."""
    table = make_table(*_CLIP_COLUMNS, right=("columns.clip", "columns.seconds", "columns.rate"))
    for row in rows:
        labels = [to_cell(row[name] or "-") for name in ("category", "predicted_category", "performer")]
        length = f"{row['duration']:.1f}", f"{row['frame_rate']:g}"
        table.add_row(str(row["id"]), row["kind"], *labels, *length, to_cell(row["path"]))
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
    say_line(out, "stats.library", library=library, parts=parts, forest=forest)
    table = make_table("columns.category", "columns.clips", right=("columns.clips",))
    for name, count in stats["categories"].items():
        table.add_row(to_cell(name), str(count))
    if stats["n_unlabelled"]:
        table.add_row(str(Message("stats.no_category")), str(stats["n_unlabelled"]))
    out.print(table)


def print_label_review(out: Console, report: LabelReview, most: int) -> None:
    """Clips in doubt, the likeliest mistakes first, and how many were looked at."""
    for one in report.doubts[:most]:
        labels = {"category": one.category, "suggested": one.suggested}
        votes = {"votes": one.votes, "own": one.own_votes}
        say_line(out, "library_review.line", number=one.clip_id, path=one.path, **labels, **votes)
    if len(report.doubts) > most:
        say_line(out, "library_review.more", n=len(report.doubts) - most)
    say_line(out, "library_review.looked_at", n=len(report.doubts), judged=report.n_judged)
    if report.n_few:
        say_line(out, "library_review.few", n=report.n_few)
    if report.n_checked:
        say_line(out, "library_review.checked", n=report.n_checked)


def print_duplicates(out: Console, groups: Sequence[DuplicateGroup], most: int) -> None:
    """Groups of clips that are nearly the same."""
    for group in groups[:most]:
        say_line(out, "library_review.group", n=len(group.clip_ids), percent=100 * group.distance)
        for number, path, category in zip(group.clip_ids, group.paths, group.categories, strict=True):
            say_line(out, "library_review.member", number=number, path=path, category=category or "-")
    if len(groups) > most:
        say_line(out, "library_review.more", n=len(groups) - most)
    say_line(out, "library_review.groups", n=len(groups))


def print_messages(out: Console, report: BackupReport | CheckReport | CompactReport) -> None:
    """What a report says, line by line."""
    for message in report.to_messages():
        print_line(out, message)


def print_journal(out: Console, entries: Sequence[JournalEntry]) -> None:
    """The changes of a library that can be undone, the last first."""
    if not entries:
        say_line(out, "journal.empty")
    for entry in entries:
        when = datetime.fromisoformat(entry.made_at).astimezone().strftime("%Y-%m-%d %H:%M")
        values = {"number": entry.number, "when": when, "what": entry.what}
        line = str(Message("journal.line_undone" if entry.is_undone else "journal.line", **values))
        if entry.made_by:
            line += str(Message("journal.line_by", who=entry.made_by))
        if entry.kept_bytes:
            line += str(Message("journal.line_kept", megabytes=entry.kept_bytes / 1e6))
        print_line(out, line)


def print_tags(out: Console, counts: Mapping[str, int], searches: Sequence[SavedSearch]) -> None:
    """Tags with how often they are given, and searches that are kept."""
    if not counts and not searches:
        say_line(out, "library_tags.nothing_there")
    for name, n in counts.items():
        print_line(out, Message("library_tags.line", tag=name, n=n))
    for one in searches:
        if one.is_selection:
            message = Message("library_searches.selection", name=one.name, n=len(one.asked["clips"]))
        else:
            filters = tuple(f"{name}={value}" for name, value in one.asked.items())
            message = Message("library_searches.line", name=one.name, filters=filters)
        print_line(out, message)
