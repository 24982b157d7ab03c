"""Listing, counting, removing and relabelling clips."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import sqlalchemy as sa

from dousa.library import schema
from dousa.library._revision import read_revision
from dousa.library.reports import ClipInfo, LibraryStats
from dousa.library.selection import UNCHANGED, Unchanged, portions

__all__ = ["count_by", "delete_clips", "list_clips", "set_labels", "summarise"]


def list_clips(connection: sa.Connection, ids: Sequence[int] | None = None) -> list[ClipInfo]:
    """Clips without their arrays, in the order of their paths; all of them, or those of these numbers."""
    clips, histograms = schema.clips, schema.clip_histograms
    columns = [clips.c[name] for name in ClipInfo.__dataclass_fields__ if name in clips.c]
    query = sa.select(*columns, histograms.c.predicted_category)
    query = query.join(histograms, histograms.c.clip_id == clips.c.id, isouter=True)
    if ids is None:
        rows = connection.execute(query).mappings().all()
    else:
        rows = [
            row
            for some in portions(ids)
            for row in connection.execute(query.where(clips.c.id.in_(some))).mappings()
        ]
    # Sorted here: databases differ in how they order text.
    return [
        ClipInfo(**{**row, "warnings": tuple(row["warnings"])})
        for row in sorted(rows, key=lambda row: row["path"])
    ]


def count_by(connection: sa.Connection, label: str) -> dict[str, int]:
    """Number of clips of each category or performer, by name."""
    column = schema.clips.c[label]
    query = sa.select(column, sa.func.count()).where(column.is_not(None)).group_by(column)
    return {row[0]: int(row[1]) for row in sorted(connection.execute(query).all(), key=lambda row: row[0])}


def summarise(connection: sa.Connection) -> LibraryStats:
    """The library in numbers."""
    clips, forests = schema.clips.c, schema.forests.c
    sums = (
        sa.func.count(),
        sa.func.sum(clips.n_frames),
        sa.func.sum(clips.duration),
        sa.func.count(clips.category),
    )
    n_clips, n_frames, seconds, n_labelled = connection.execute(
        sa.select(*sums).select_from(schema.clips)
    ).one()
    query = sa.select(forests.trained_at, forests.n_clips, forests.parameters, forests.revision)
    forest = connection.execute(query).one_or_none()
    revision = read_revision(connection)
    return LibraryStats(
        n_clips=int(n_clips),
        n_frames=int(n_frames or 0),
        seconds=float(seconds or 0.0),
        n_unlabelled=int(n_clips - n_labelled),
        categories=count_by(connection, "category"),
        performers=count_by(connection, "performer"),
        trained_at=forest.trained_at if forest else None,
        n_trained=int(forest.n_clips) if forest else 0,
        parameters=dict(forest.parameters) if forest else {},
        forest_is_current=bool(forest and forest.revision == revision),
        revision=revision,
    )


def delete_clips(connection: sa.Connection, ids: Sequence[int]) -> None:
    """Remove clips with all their arrays."""
    for some in portions(ids):
        connection.execute(sa.delete(schema.clips).where(schema.clips.c.id.in_(some)))


def set_labels(
    connection: sa.Connection,
    ids: Sequence[int],
    category: str | Unchanged | None,
    performer: str | Unchanged | None,
) -> None:
    """Change the category or performer of clips."""
    given: dict[str, Any] = {"category": category, "performer": performer}
    values = {name: value for name, value in given.items() if value is not UNCHANGED}
    for some in portions(ids):
        connection.execute(sa.update(schema.clips).where(schema.clips.c.id.in_(some)).values(**values))
