"""Reclaiming unused space of a library file and its fragments, and moving arrays from rows to fragments."""

from __future__ import annotations

import os
import secrets
import shutil
import sqlite3
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import sqlalchemy as sa

from dousa.errors import LibraryDamagedError, LibraryError
from dousa.library.history.journal import forget_kept, measure_kept
from dousa.library.results import Answer
from dousa.library.store import schema
from dousa.library.store.engine import Database, lock_for_writing
from dousa.library.store.fragments import ARRAYS, begin_store, find_store, make_name, read_blocks
from dousa.library.takes.windows import sweep_files
from dousa.messages import Count, Message, Progress

_BYTES_AT_ONCE = 2**25  # in one transaction, for which other writers wait, see docs/libraries.md


def begin_where_large(database: Database, *, begin_at: int = 100_000) -> int:
    """Let new arrays of a library file of ``begin_at`` clips go to fragments beside it.

    Return this number if the call began that, else 0. A file of fewer clips is easier to handle alone.
    """
    if database.engine.dialect.name != "sqlite" or database.is_read_only:
        return 0
    with database.reading() as connection:
        if find_store(connection) is not None:
            return 0
        # All but segments have positions, and counting positions directly would read the whole file.
        n_clips, n_segments = (
            connection.execute(sa.select(sa.func.count()).select_from(table)).scalar_one()
            for table in (schema.clips, schema.segments)
        )
        if n_clips - n_segments < begin_at:
            return 0
    with database.writing() as connection:
        if find_store(connection) is None:
            begin_store(connection, "")
    return begin_at


def choose_place(database: Database, place: str) -> None:
    """Let new arrays go to fragments at a given place; empty for beside a library file.

    LibraryError for a library file with fragments elsewhere, a server without a place, or another place than before.
    """
    on_server = database.engine.dialect.name != "sqlite"
    if bool(place) != on_server:
        code = "library_fragments.place_of_server" if on_server else "library_fragments.place_of_file"
        raise LibraryError(code, library=database.where)
    with database.writing() as connection:
        known = connection.execute(sa.select(schema.array_store.c.place)).scalar_one_or_none()
        if known is None:
            chosen = f"{_as_url(place)}/{secrets.token_hex(8)}" if place else ""
            begin_store(connection, chosen)
            find_store(connection)  # fails before anything is moved
        elif place and not known.startswith(f"{_as_url(place)}/"):
            raise LibraryError("library_fragments.other_place", library=database.where, place=known)


def _as_url(place: str) -> str:
    return place.rstrip("/") if "://" in place else os.fspath(Path(place).absolute())


def measure_rows(connection: sa.Connection) -> int:
    """Return the bytes of arrays stored in their rows."""
    sizes = (sa.select(sa.func.sum(sa.func.length(column))) for column in ARRAYS)
    return sum(int(connection.execute(query).scalar() or 0) for query in sizes)


def move_arrays(database: Database, progress: Count | None = None) -> int:
    """Move arrays from rows to fragments; return their bytes."""
    report = progress or (lambda done, total: None)
    with database.reading() as connection:
        total = measure_rows(connection)
    done = 0
    for column in ARRAYS:
        for size in _move_blocks(database, column, None, lambda: None):
            done += size
            report(done, max(total, done))
    report(done, done)
    return done


def _move_blocks(
    database: Database,
    column: sa.Column[Any],
    source: str | None,
    choose: Callable[[], str | None],
    *,
    most: int = _BYTES_AT_ONCE,
    most_rows: int = 500,
) -> Iterator[int]:
    """Move the blocks of a fragment, or those in their rows, to the fragments that are chosen (None: by the store).

    Yields the bytes of each transaction, of ``most`` bytes and rows.
    """
    key, table = schema.key_of(column.table), column.table
    n_bytes = sa.func.length(column) if source is None else table.c.n_bytes
    measured = sa.select(key, n_bytes).where(
        table.c.fragment.is_(None) if source is None else table.c.fragment == source
    )
    measured, last = measured.where(n_bytes > 0).order_by(key).limit(most_rows), 0
    while True:
        with database.writing() as connection:
            lock_for_writing(connection)
            store = find_store(connection)
            if store is None:
                raise LibraryDamagedError("library_fragments.no_store", library=database.where)
            numbers: list[int] = []
            size = 0
            for number, own in connection.execute(measured.where(key > last)):
                if numbers and size + own > most:
                    break
                numbers.append(number)
                size += own
            if not numbers:
                return
            rows = connection.execute(sa.select(table).where(key.in_(numbers)).order_by(key)).all()
            places = store.append(read_blocks(connection, rows, column.name), choose())
            changes = [
                {"of_row": number, column.name: b"", **place._asdict()}
                for number, place in zip(numbers, places, strict=True)
            ]
            connection.execute(sa.update(table).where(key == sa.bindparam("of_row")), changes)
        last = numbers[-1]
        yield size


def rewrite_fragments(database: Database, progress: Count | None = None, *, small: float = 1 / 8) -> None:
    """Rewrite fragments that have unused blocks, and join those below the share ``small`` of a full one."""
    report = progress or (lambda done, total: None)
    with database.reading() as connection:
        store, used = find_store(connection), measure_used(connection)
    if store is None:
        return
    sizes = store.sizes()
    sparse = [name for name, size in sizes.items() if 0 < used[name] < size]
    few = [name for name, size in sizes.items() if 0 < used[name] == size < small * store.full]
    chosen = sorted([*sparse, *(few if len(few) > 1 else [])])
    total, done, into = sum(used[name] for name in chosen), 0, make_name(list(sizes))

    def choose() -> str:
        nonlocal into
        if (there := store.sizes()).get(into, 0) >= store.full:
            into = make_name(list(there))
        return into

    for name, column in product(chosen, ARRAYS):
        for size in _move_blocks(database, column, name, choose):
            done += size
            report(done, total)
    report(total, total)


def measure_used(connection: sa.Connection) -> Counter[str]:
    """Return the used bytes of each fragment."""
    used: Counter[str] = Counter()
    for column in ARRAYS:
        table = column.table.c
        query = sa.select(table.fragment, sa.func.sum(table.n_bytes)).where(table.fragment.is_not(None))
        for name, size in connection.execute(query.group_by(table.fragment)):
            used[name] += int(size)
    return used


def drop_unused(database: Database, timeout: float, *, pause: float = 0.1) -> int:
    """Delete unused fragments once no reader sees an earlier state of the library; return their bytes.

    If there still is such a reader after the timeout, s, they are left for the next time; it is looked for every
    ``pause`` s.
    """
    deadline = time.monotonic() + timeout
    while _has_readers(database):
        if time.monotonic() >= deadline:
            return 0
        time.sleep(pause)
    freed = 0
    # Under the write lock: a block is written before the row that names it.
    with database.writing() as connection:
        lock_for_writing(connection)
        store, used = find_store(connection), measure_used(connection)
        if store is None:
            return 0
        for name, size in store.sizes().items():
            if name not in used:
                store.delete(name)
                freed += size
    return freed


def _has_readers(database: Database) -> bool:
    """Return whether an earlier transaction is still open."""
    if database.engine.dialect.name == "sqlite":
        with database.alone() as connection:
            # Busy if a reader still needs the log.
            return bool(connection.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchone()[0])
    with database.reading() as connection:
        others = "SELECT count(*) FROM pg_stat_activity WHERE datname = current_database() AND pid <> pg_backend_pid()"
        return bool(connection.execute(sa.text(f"{others} AND backend_xmin IS NOT NULL")).scalar_one())


@dataclass(frozen=True, slots=True)
class CompactReport(Answer):
    """The result of ``Library.compact``.

    Parameters
    ----------
    before, after : bytes of its file and its fragments; of a database server only of fragments.
    forgotten, moved : bytes of removed clips kept for an undo, and of arrays moved to fragments.
    n_fragments : number of fragments.
    swept : bytes of unused take files beside the library.
    """

    library: str
    before: int
    after: int
    forgotten: int = 0
    moved: int = 0
    n_fragments: int = 0
    swept: int = 0

    def to_messages(self) -> Iterator[Message]:
        """Return messages about moved arrays, deleted clips, and the size before and after."""
        if self.moved:
            yield Message("library_compact.moved", megabytes=self.moved / 1e6, n=self.n_fragments)
        if self.forgotten:
            yield Message("library_compact.forgotten", megabytes=self.forgotten / 1e6)
        if self.swept:
            yield Message("library_compact.swept", megabytes=self.swept / 1e6)
        if self.before:
            yield Message("library_compact.done", before=self.before / 1e6, after=self.after / 1e6)


def _go_on() -> int:
    return 0


def compact_library(
    database: Database, fragments: str | None = None, progress: Progress | None = None
) -> CompactReport:
    """Delete what is not needed, and move arrays to fragments if asked; as ``Library.compact``."""
    report = progress or (lambda done, total, what: None)

    def tell(what: Message) -> Count:
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
    with database.writing() as writing:  # only after the check for free space
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
    """Return the bytes of a library file and its fragments, and the number of these."""
    with database.reading() as connection:
        store = find_store(connection)
        sizes = {} if store is None else store.sizes()
    n_fragments, size = len(sizes), sum(sizes.values())
    if database.engine.dialect.name == "sqlite":
        size += os.path.getsize(database.where)
    return size, n_fragments


def _check_room(database: Database, place: str) -> None:
    """Raise LibraryError if there is no room for the arrays to move."""
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
    """Return the bytes of a library file without its unused room, and the free bytes of its disk."""
    with database.reading() as reading:
        kept = measure_kept(reading)
    with database.alone() as connection:
        pages, unused, size = (
            connection.execute(f"PRAGMA {name}").fetchone()[0] for name in ("page_count", "freelist_count", "page_size")
        )
    # SQLite writes a copy beside the file, then overwrites it.
    free = shutil.disk_usage(os.path.dirname(os.path.abspath(database.where))).free
    return (pages - unused) * size - kept, free


def _vacuum(database: Database, *, steps: int = 10_000) -> None:
    """Rewrite a library file without its unused room, all or nothing; Ctrl-C is noticed after ``steps`` of SQLite."""
    with database.alone() as connection:
        connection.set_progress_handler(_go_on, steps)
        try:
            connection.execute("VACUUM")
        except sqlite3.OperationalError as error:
            if error.sqlite_errorname == "SQLITE_INTERRUPT":
                raise KeyboardInterrupt from error
            raise
        finally:
            connection.set_progress_handler(None, 0)
        connection.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchall()
