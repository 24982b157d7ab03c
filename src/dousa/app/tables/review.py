"""Labels that are likely wrong and clips that are nearly the same, as lines for people."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from dousa.app.tables.lines import say_line

if TYPE_CHECKING:
    from rich.console import Console

    from dousa.library import DuplicateGroup, LabelReview


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
