"""The counter of writes.

Every transaction that writes locks its row first: in a database that locks rows this makes the writers wait
for each other, as ``BEGIN IMMEDIATE`` does in SQLite.
"""

from __future__ import annotations

import sqlalchemy as sa

from dousa.errors import LibraryDamagedError
from dousa.library.schema import library_state

__all__ = ["lock_for_writing", "next_revision", "note_changed_clips", "read_revision", "take_clip_ids"]


def read_revision(connection: sa.Connection) -> int:
    """Number of the last write."""
    revision = connection.execute(sa.select(library_state.c.revision)).scalar_one_or_none()
    if revision is None:
        raise LibraryDamagedError("the library does not say which state it is in; make it again")
    return int(revision)


def lock_for_writing(connection: sa.Connection) -> None:
    """Wait for other writers, without counting this write yet."""
    connection.execute(sa.select(library_state.c.revision).with_for_update())


def next_revision(connection: sa.Connection) -> int:
    """Count this write, and return its number."""
    connection.execute(sa.update(library_state).values(revision=library_state.c.revision + 1))
    return read_revision(connection)


def note_changed_clips(connection: sa.Connection) -> None:
    """Clips or their categories change in this write: the forest has not learned from them as they are now."""
    connection.execute(sa.update(library_state).values(clips_revision=library_state.c.revision))


def take_clip_ids(connection: sa.Connection, count: int) -> range:
    """Numbers for new clips, never used before; after ``next_revision`` in the same transaction."""
    first = connection.execute(sa.select(library_state.c.next_clip_id)).scalar_one()
    connection.execute(sa.update(library_state).values(next_clip_id=first + count))
    return range(first, first + count)
