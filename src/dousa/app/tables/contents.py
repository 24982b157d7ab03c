"""What a library holds: its clips, and its numbers."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rich.table import Table

from dousa.app.tables.lines import say_line, to_cell
from dousa.messages import Message

if TYPE_CHECKING:
    from rich.console import Console

_CLIP_COLUMNS = (
    *("columns.clip", "columns.kind", "columns.category", "columns.predicted", "columns.performer"),
    *("columns.seconds", "columns.rate", "columns.file"),
)


def print_clips(out: Console, rows: list[dict[str, Any]]) -> None:
    """Clips of a library, one in a row."""
    table = Table(box=None)
    for code in _CLIP_COLUMNS:
        right = code in ("columns.clip", "columns.seconds", "columns.rate")
        table.add_column(str(Message(code)), justify="right" if right else "left", overflow="fold")
    for row in rows:
        labels = [to_cell(row[name] or "-") for name in ("category", "predicted_category", "performer")]
        table.add_row(
            str(row["id"]),
            row["kind"],
            *labels,
            f"{row['duration']:.1f}",
            f"{row['frame_rate']:g}",
            to_cell(row["path"]),
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
    say_line(out, "stats.library", library=library, parts=parts, forest=forest)
    table = Table(box=None)
    table.add_column(str(Message("columns.category")))
    table.add_column(str(Message("columns.clips")), justify="right")
    for name, count in stats["categories"].items():
        table.add_row(to_cell(name), str(count))
    if stats["n_unlabelled"]:
        table.add_row(str(Message("stats.no_category")), str(stats["n_unlabelled"]))
    out.print(table)
