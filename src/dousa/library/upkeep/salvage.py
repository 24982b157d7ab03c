"""Saving what can be read of a library whose file is damaged in its structure: row by row, into a new file."""

from __future__ import annotations

import os
import sqlite3
from collections.abc import Iterator
from contextlib import closing, suppress
from pathlib import Path
from typing import Any
from urllib.parse import quote

import sqlalchemy as sa

from dousa.library import schema
from dousa.library.engine import Database
from dousa.library.opening import open_database
from dousa.library.seals.checksums import seal_rows

# Forests for parts of bodies are learned again, examples of leaves chosen again, the state is counted again. What was
# changed cannot be undone any more.
_LEFT_OUT = (
    schema.migrations, schema.library_state, schema.part_forests, schema.leaf_examples, *schema.JOURNAL_TABLES,
)  # fmt: skip


def salvage_library(database: Database) -> dict[int, str]:
    """Copy every row that can be read into a new file, which takes the place of the old one.

    The old one is kept beside it, its name followed by ``.damaged``.

    Returns
    -------
    Names of clips that could not be saved, by number, where an index still has them.
    """
    path = Path(database.where)
    with suppress(sqlite3.Error), database.alone() as connection:
        connection.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchall()
    database.engine.dispose()
    new = path.with_name(f"{path.name}.salvaged")
    for end in ("", "-wal", "-shm"):
        Path(f"{new}{end}").unlink(missing_ok=True)
    fresh = open_database(new, create=True, read_only=False, timeout=5.0)
    name = f"file:{quote(os.fsencode(path.absolute().as_posix()))}?mode=ro"
    try:
        with closing(sqlite3.connect(name, uri=True)) as source:
            saved, lost = _copy(source, fresh)
        with fresh.alone() as connection:
            connection.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchall()
    finally:
        fresh.engine.dispose()
    for end in ("-wal", "-shm", ""):
        if os.path.exists(f"{path}{end}"):
            os.replace(f"{path}{end}", f"{path}.damaged{end}")
    os.replace(new, path)
    return {number: lost[number] for number in sorted(lost.keys() - saved)}


def _copy(source: sqlite3.Connection, fresh: Database) -> tuple[set[int], dict[int, str]]:
    """Copy the rows; returns the numbers of the clips that are there now, and of all that an index knows."""
    known = _read_names(source)
    last = max([_read_next(source), *(number + 1 for number in known)])
    saved: set[int] = set()
    for table in schema.metadata.sorted_tables:
        if table in _LEFT_OUT:
            continue
        keys = range(1, 2) if table is schema.forests else range(1, last)
        for rows in _read_rows(source, table, keys):
            if table is schema.clips:
                saved |= {row["id"] for row in rows}
            owners = [name for name in ("clip_id", "take_id") if name in table.c]
            _insert(fresh, table, [row for row in rows if all(row[name] in saved for name in owners)])
    with fresh.writing() as connection:
        learned = connection.execute(sa.select(sa.func.max(schema.forests.c.learned))).scalar() or 0
        state = {"id": 1, "revision": learned + 1, "next_clip_id": last, "clips_revision": learned + 1}
        connection.execute(sa.delete(schema.library_state))
        connection.execute(sa.insert(schema.library_state), seal_rows(schema.library_state, [state]))
    return saved, known


def _insert(fresh: Database, table: sa.Table, rows: list[dict[str, Any]]) -> None:
    """Write raw values; a row that breaks a rule of the tables (two of one name) is left out."""
    names = [column.name for column in table.c]
    statement = f"INSERT OR IGNORE INTO {table.name} ({', '.join(names)}) VALUES ({', '.join('?' * len(names))})"
    with fresh.alone() as connection:
        connection.execute("BEGIN")
        connection.executemany(statement, [tuple(row[name] for name in names) for row in rows])
        connection.execute("COMMIT")


def _read_names(source: sqlite3.Connection) -> dict[int, str]:
    names: dict[int, str] = {}
    with suppress(sqlite3.Error):
        for path, number in source.execute("SELECT path, id FROM clips INDEXED BY sqlite_autoindex_clips_1"):
            names[number] = str(path)
    return names


def _read_next(source: sqlite3.Connection) -> int:
    with suppress(sqlite3.Error):
        rows = source.execute("SELECT max(next_clip_id) FROM library_state").fetchall()
        if rows and isinstance(rows[0][0], int) and schema.is_id(rows[0][0]):
            return int(rows[0][0])
    return 1


def _read_rows(source: sqlite3.Connection, table: sa.Table, keys: range) -> Iterator[list[dict[str, Any]]]:
    """The rows that can be read, a few at a time."""
    names = [column.name for column in table.c]
    key = next(iter(table.primary_key)).name
    statement = f"SELECT {', '.join(names)} FROM {table.name} WHERE {key} = ?"
    rows: list[dict[str, Any]] = []
    for number in keys:
        with suppress(sqlite3.Error, UnicodeDecodeError):
            rows += [dict(zip(names, row, strict=True)) for row in source.execute(statement, (number,)).fetchmany(1)]
        if len(rows) >= 64:
            yield rows
            rows = []
    yield rows
