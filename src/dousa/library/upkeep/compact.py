"""Giving back the room in a library file that removed clips have left."""

from __future__ import annotations

import os
import shutil
import sqlite3
from dataclasses import dataclass
from typing import Any

from dousa.errors import LibraryError
from dousa.library.engine import Database
from dousa.library.journal.entries import forget_kept, measure_kept

_STEPS = 10_000  # of the database between two looks at whether somebody wants to stop


@dataclass(frozen=True, slots=True)
class CompactReport:
    """The answer of ``Library.compact``.

    Parameters
    ----------
    library : its path.
    before, after : bytes of its file; 0 of a database server.
    forgotten : bytes of removed clips that were kept for an undo.
    """

    library: str
    before: int
    after: int
    forgotten: int = 0

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return {"library": self.library, "before": self.before, "after": self.after, "forgotten": self.forgotten}


def _go_on() -> int:
    return 0


def compact_library(database: Database) -> CompactReport:
    """Write the file anew without its unused room, all or nothing; as ``Library.compact``."""
    if database.engine.dialect.name != "sqlite":
        with database.writing() as writing:
            forgotten = forget_kept(writing)
        if not forgotten:
            raise LibraryError("library_compact.server", library=database.where)
        return CompactReport(database.where, 0, 0, forgotten)
    database.check_writable()
    path = database.where
    before = os.path.getsize(path)
    with database.reading() as reading:
        kept = measure_kept(reading)
    with database.alone() as connection:
        pages, free, size = (
            connection.execute(f"PRAGMA {name}").fetchone()[0] for name in ("page_count", "freelist_count", "page_size")
        )
        # What is left is written beside the file, and then over it.
        needed, there = (pages - free) * size - kept, shutil.disk_usage(os.path.dirname(os.path.abspath(path))).free
        if needed > there:
            raise LibraryError("library_compact.disk", library=path, needed=needed / 1e6, free=there / 1e6)
        with database.writing() as writing:  # not before the space is known to be there
            forgotten = forget_kept(writing)
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
    return CompactReport(path, before, os.path.getsize(path), forgotten)
