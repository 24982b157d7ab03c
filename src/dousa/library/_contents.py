"""Listing, counting, removing and relabelling clips."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import sqlalchemy as sa

from dousa.library import schema
from dousa.library._revision import note_changed_clips, read_revision
from dousa.library.reports import ClipInfo, LibraryStats
from dousa.library.selection import UNCHANGED, Unchanged, portions

__all__ = ["count_by", "delete_clips", "list_clips", "set_labels", "summarise"]


def list_clips(connection: sa.Connection, ids: Sequence[int] | None = None) -> list[ClipInfo]:
    """Clips and takes without their arrays, in the order of their paths; all of them, or those of these numbers."""
    clips, leaves = schema.clips, schema.clip_leaves
    columns = [clips.c[name] for name in ClipInfo.__dataclass_fields__ if name in clips.c]
    query = sa.select(*columns, leaves.c.predicted_category)
    query = query.join(leaves, leaves.c.clip_id == clips.c.id, isouter=True)
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
    """Number of clips of each category, or of clips and takes of each performer, by name."""
    column = schema.clips.c[label]
    query = sa.select(column, sa.func.count()).where(column.is_not(None)).group_by(column)
    if label == "category":
        query = query.where(schema.clips.c.kind == schema.CLIP)
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
    by_kind = {
        kind: connection.execute(sa.select(*sums).select_from(schema.clips).where(clips.kind == kind)).one()
        for kind in (schema.CLIP, schema.TAKE)
    }
    n_clips, n_frames, seconds, n_labelled = by_kind[schema.CLIP]
    n_takes, _, take_seconds, _ = by_kind[schema.TAKE]
    columns = (forests.trained_at, forests.n_clips, forests.n_learned, forests.parameters, forests.revision)
    forest = connection.execute(sa.select(*columns)).one_or_none()
    changed = connection.execute(sa.select(schema.library_state.c.clips_revision)).scalar_one_or_none()
    revision = read_revision(connection)
    return LibraryStats(
        n_clips=int(n_clips),
        n_frames=int(n_frames or 0),
        seconds=float(seconds or 0.0),
        n_takes=int(n_takes),
        take_seconds=float(take_seconds or 0.0),
        n_unlabelled=int(n_clips - n_labelled),
        categories=count_by(connection, "category"),
        performers=count_by(connection, "performer"),
        trained_at=forest.trained_at if forest else None,
        n_trained=int(forest.n_clips) if forest else 0,
        n_learned=int(forest.n_learned) if forest else 0,
        parameters=dict(forest.parameters) if forest else {},
        forest_is_current=bool(forest and forest.revision >= (changed or 0)),
        revision=revision,
    )


def delete_clips(connection: sa.Connection, ids: Sequence[int]) -> None:
    """Remove clips and takes with all their arrays, after ``next_revision`` in the same transaction."""
    if _any_clip(connection, ids):
        note_changed_clips(connection)
    for some in portions(ids):
        connection.execute(sa.delete(schema.clips).where(schema.clips.c.id.in_(some)))


def _any_clip(connection: sa.Connection, ids: Sequence[int]) -> bool:
    """Whether clips are among clips and takes."""
    table = schema.clips.c
    query = sa.select(sa.func.count()).select_from(schema.clips).where(table.kind == schema.CLIP)
    return any(connection.execute(query.where(table.id.in_(some))).scalar_one() for some in portions(ids))


def set_labels(
    connection: sa.Connection,
    ids: Sequence[int],
    category: str | Unchanged | None,
    performer: str | Unchanged | None,
) -> None:
    """Change the category or performer of clips and takes, after ``next_revision`` in the same transaction."""
    if category is not UNCHANGED and _any_clip(connection, ids):
        note_changed_clips(connection)
    given: dict[str, Any] = {"category": category, "performer": performer}
    values = {name: value for name, value in given.items() if value is not UNCHANGED}
    for some in portions(ids):
        connection.execute(sa.update(schema.clips).where(schema.clips.c.id.in_(some)).values(**values))
