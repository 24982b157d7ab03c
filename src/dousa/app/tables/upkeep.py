"""What a check of a library found, what can be undone, and tags, as lines for people."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import datetime
from typing import TYPE_CHECKING

from dousa.app.output import one_line
from dousa.messages import Message

if TYPE_CHECKING:
    from rich.console import Console

    from dousa.library import CheckReport, JournalEntry, SavedSearch


def print_check(out: Console, report: CheckReport) -> None:
    """What is damaged and what can be done, or that nothing is."""
    for message in report.to_messages():
        out.print(one_line(str(message)), markup=False, soft_wrap=True)


def print_journal(out: Console, entries: Sequence[JournalEntry]) -> None:
    """The changes of a library that can be undone, the last first."""
    if not entries:
        out.print(str(Message("journal.empty")), markup=False)
    for entry in entries:
        when = datetime.fromisoformat(entry.made_at).astimezone().strftime("%Y-%m-%d %H:%M")
        values = {"number": entry.number, "when": when, "what": entry.what}
        line = str(Message("journal.line_undone" if entry.is_undone else "journal.line", **values))
        if entry.kept_bytes:
            line += str(Message("journal.line_kept", megabytes=entry.kept_bytes / 1e6))
        out.print(one_line(line), markup=False, soft_wrap=True)


def print_tags(out: Console, counts: Mapping[str, int], searches: Sequence[SavedSearch]) -> None:
    """Tags with how often they are given, and searches that are kept."""
    if not counts and not searches:
        out.print(str(Message("library_tags.nothing_there")), markup=False)
    for name, n in counts.items():
        out.print(one_line(str(Message("library_tags.line", tag=name, n=n))), markup=False, soft_wrap=True)
    for one in searches:
        if one.is_selection:
            message = Message("library_searches.selection", name=one.name, n=len(one.asked["clips"]))
        else:
            filters = tuple(f"{name}={value}" for name, value in one.asked.items())
            message = Message("library_searches.line", name=one.name, filters=filters)
        out.print(one_line(str(message)), markup=False, soft_wrap=True)
