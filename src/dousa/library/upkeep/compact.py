"""Giving back the room that removed clips have left, in a library file and in fragments, and moving arrays there."""

from __future__ import annotations

import os
import shutil
import sqlite3
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from dousa.errors import LibraryError
from dousa.library.engine import Database
from dousa.library.fragments.moving import (
    choose_place,
    drop_unused,
    measure_fragments,
    measure_rows,
    move_arrays,
    rewrite_fragments,
)
from dousa.library.journal.entries import forget_kept, measure_kept
from dousa.library.windows.keeper import sweep_files
from dousa.messages import Message

_STEPS = 10_000  # of the database between two looks at whether somebody wants to stop

CompactProgress = Callable[[int, int, Message], None]
"""Called with (kB done, kB, what is being done)."""


@dataclass(frozen=True, slots=True)
class CompactReport:
    """The answer of ``Library.compact``.

    Parameters
    ----------
    library : its path.
    before, after : bytes of its file and its fragments; of a database server only those of fragments.
    forgotten : bytes of removed clips that were kept for an undo.
    moved : bytes of arrays that were moved from the file, or the tables, to fragments.
    n_fragments : how many there are.
    swept : bytes of files of takes, beside the library, that no search would use.
    """

    library: str
    before: int
    after: int
    forgotten: int = 0
    moved: int = 0
    n_fragments: int = 0
    swept: int = 0

    def to_messages(self) -> Iterator[Message]:
        """What was moved, what is forgotten, and what the file was and is."""
        if self.moved:
            yield Message("library_compact.moved", megabytes=self.moved / 1e6, n=self.n_fragments)
        if self.forgotten:
            yield Message("library_compact.forgotten", megabytes=self.forgotten / 1e6)
        if self.swept:
            yield Message("library_compact.swept", megabytes=self.swept / 1e6)
        if self.before:
            yield Message("library_compact.done", before=self.before / 1e6, after=self.after / 1e6)

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return {
            "library": self.library,
            "before": self.before,
            "after": self.after,
            "forgotten": self.forgotten,
            "moved": self.moved,
            "n_fragments": self.n_fragments,
            "swept": self.swept,
        }


def _go_on() -> int:
    return 0


def compact_library(
    database: Database, fragments: str | None = None, progress: CompactProgress | None = None
) -> CompactReport:
    """Leave out what nobody needs, and move arrays to fragments where that is asked for; as ``Library.compact``."""
    report = progress or (lambda done, total, what: None)

    def tell(what: Message) -> Callable[[int, int], None]:
        return lambda done, total: report(done // 1000, total // 1000, what)

    in_file = database.engine.dialect.name == "sqlite"
    database.check_writable()
    before, _ = _measure(database)
    moved = 0
    if fragments is not None:
        _check_room(database, fragments)
        choose_place(database, fragments)
        moved = move_arrays(database, tell(Message("library_compact.moving")))
    if in_file:
        needed, free = _measure_room(database)
        if needed > free:
            raise LibraryError("library_compact.disk", library=database.where, needed=needed / 1e6, free=free / 1e6)
    with database.writing() as writing:  # not before the space is known to be there
        forgotten = forget_kept(writing)
    rewrite_fragments(database, tell(Message("library_compact.rewriting")))
    if in_file:
        _vacuum(database)
    drop_unused(database, min(database.timeout, 5.0))
    swept = sweep_files(database)
    after, n_fragments = _measure(database)
    if not in_file and not (forgotten or moved or n_fragments or swept):
        raise LibraryError("library_compact.server", library=database.where)
    return CompactReport(database.where, before, after, forgotten, moved, n_fragments, swept)


def _measure(database: Database) -> tuple[int, int]:
    """Bytes of a library, and how many fragments it has."""
    with database.reading() as connection:
        n_fragments, size = measure_fragments(connection)
    if database.engine.dialect.name == "sqlite":
        size += os.path.getsize(database.where)
    return size, n_fragments


def _check_room(database: Database, place: str) -> None:
    """LibraryError where the arrays that are going to be moved find no room."""
    if "://" in place:
        return
    folder = os.path.abspath(place or os.path.dirname(os.path.abspath(database.where)))
    while not os.path.exists(folder):
        folder = os.path.dirname(folder)
    with database.reading() as connection:
        needed = measure_rows(connection)
    free = shutil.disk_usage(folder).free
    if needed > free:
        raise LibraryError("library_compact.disk", library=database.where, needed=needed / 1e6, free=free / 1e6)


def _measure_room(database: Database) -> tuple[int, int]:
    """Bytes that a library file without its unused room needs, and those that are free on its disk."""
    with database.reading() as reading:
        kept = measure_kept(reading)
    with database.alone() as connection:
        pages, unused, size = (
            connection.execute(f"PRAGMA {name}").fetchone()[0] for name in ("page_count", "freelist_count", "page_size")
        )
    # What is left is written beside the file, and then over it.
    free = shutil.disk_usage(os.path.dirname(os.path.abspath(database.where))).free
    return (pages - unused) * size - kept, free


def _vacuum(database: Database) -> None:
    """Write a library file anew without its unused room, all or nothing."""
    with database.alone() as connection:
        # Called while SQLite works, so that Ctrl-C is noticed.
        connection.set_progress_handler(_go_on, _STEPS)
        try:
            connection.execute("VACUUM")
        except sqlite3.OperationalError as error:
            if error.sqlite_errorname == "SQLITE_INTERRUPT":
                raise KeyboardInterrupt from error
            raise
        finally:
            connection.set_progress_handler(None, 0)
        connection.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchall()
