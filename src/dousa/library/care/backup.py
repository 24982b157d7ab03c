"""Backup and restore of libraries: a copy is a library itself, compared with its checksums before it gets its name."""

from __future__ import annotations

import os
import sqlite3
import time
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import sqlalchemy as sa

from dousa.errors import LibraryDamagedError, LibraryError, LibraryLockedError
from dousa.files.disk import sync_folder
from dousa.library.care.damage import find_damage
from dousa.library.results import Answer
from dousa.library.store import schema
from dousa.library.store.engine import Database, check_mark, is_url, make_engine, name_of, translate_error
from dousa.library.store.exchange import exchange, prepare, settle
from dousa.library.store.fragments import ARRAYS, Place, begin_store, find_store, open_store, put_aside, read_blocks
from dousa.library.store.opening import check_version, open_database
from dousa.messages import Count, Message, Progress


@dataclass(frozen=True, slots=True)
class BackupReport(Answer):
    """The result of ``Library.backup`` and ``Library.restore``.

    Parameters
    ----------
    library : the new library, a path or URL.
    n_clips : clips and takes.
    n_rows : rows compared with their checksums.
    n_bytes : of its file and fragments; 0 on a database server.
    replaced : folder with the library that was there before; None if there was none.
    seconds : time it took.
    """

    library: str
    n_clips: int
    n_rows: int
    n_bytes: int
    replaced: str | None
    seconds: float

    def to_messages(self) -> Iterator[Message]:
        """Return what was written, and where the replaced library is."""
        if self.replaced is not None:
            yield Message("library_backup.replaced", folder=self.replaced)
        values = {"library": self.library, "clips": self.n_clips, "rows": self.n_rows, "seconds": self.seconds}
        yield Message("library_backup.done", megabytes=self.n_bytes / 1e6, **values)


def back_up(source: Database, to: str | os.PathLike[str], progress: Progress | None = None) -> BackupReport:
    """Copy a library to a new file; as ``Library.backup``."""
    if is_url(to):
        raise LibraryError("library_backup.to_file", library=name_of(to))
    settle(Path(to).absolute().parent)
    if os.path.lexists(to):
        raise LibraryError("library_backup.exists", library=os.fspath(to))
    return _write(source, Path(to).absolute(), progress)


def restore(
    backup: str | os.PathLike[str], to: str | os.PathLike[str], progress: Progress | None = None
) -> BackupReport:
    """Put a copy of a library in the place of another, or into an empty database; as ``Library.restore``."""
    engine = make_engine(backup, create=False, read_only=True, timeout=5.0)
    source = Database(engine, name_of(backup))
    try:
        with source.reading() as connection:
            if not check_mark(connection, source.where):
                raise LibraryError("library_file.empty", library=source.where, name=source.where)
            check_version(connection, source.where)
        if is_url(to):
            return _fill(source, str(to), progress)
        path = Path(os.path.realpath(to))  # a link to the library stays one
        if path == Path(os.path.realpath(backup)):
            raise LibraryError("library_backup.same", library=source.where)
        _leave_log(path)
        return _write(source, path, progress)
    finally:
        engine.dispose()


def _leave_log(path: Path) -> None:
    """Let a library file take in its log; LibraryLockedError if another program has it open."""
    try:
        database = Database(make_engine(path, create=False, read_only=False, timeout=1.0), os.fspath(path))
    except LibraryError:  # there is none, or nothing that can be read: it is put aside as it is
        return
    try:
        with database.alone() as connection:
            connection.execute("PRAGMA journal_mode = DELETE").fetchone()
    except LibraryLockedError:
        raise LibraryLockedError("library_backup.in_use", library=database.where) from None
    except LibraryError:
        return
    finally:
        database.engine.dispose()


def _write(source: Database, path: Path, progress: Progress | None) -> BackupReport:
    start = time.perf_counter()
    with prepare(path) as folder:
        new = folder / "new" / path.name
        if source.engine.dialect.name == "sqlite":
            _copy_file(source, new, path, _counting(progress, "library_backup.copying"))
            database = open_database(new, create=False, read_only=False, timeout=5.0)
        else:
            database = open_database(new, create=True, read_only=False, timeout=5.0)
        try:
            if source.engine.dialect.name != "sqlite":
                _copy_rows(source, database, _counting(progress, "library_backup.copying"))
            n_clips, n_rows = _verify(database, source.where, progress)
            with database.alone() as connection:
                connection.execute("PRAGMA journal_mode = DELETE").fetchone()  # one file, without a log
        finally:
            database.engine.dispose()
        n_bytes = sum(file.stat().st_size for file in (folder / "new").rglob("*") if file.is_file())
        _leave_log(path)  # what has come while this was copied is kept as well
        replaced = exchange(folder, path)
    return BackupReport(os.fspath(path), n_clips, n_rows, n_bytes, replaced, time.perf_counter() - start)


def _fill(source: Database, url: str, progress: Progress | None) -> BackupReport:
    start = time.perf_counter()
    database = open_database(url, create=True, read_only=False, timeout=60.0)
    try:
        _copy_rows(source, database, _counting(progress, "library_backup.copying"))
        n_clips, n_rows = _verify(database, source.where, progress)
    finally:
        database.engine.dispose()
    return BackupReport(database.where, n_clips, n_rows, 0, None, time.perf_counter() - start)


def _counting(progress: Progress | None, code: str) -> Count:
    return lambda done, total: None if progress is None else progress(done, total, Message(code))


def _verify(database: Database, source: str, progress: Progress | None) -> tuple[int, int]:
    """Compare everything with its checksum; returns clips and rows, LibraryDamagedError if something is damaged."""
    findings = find_damage(database, _counting(progress, "library_check.checking"), forests=False)
    if findings.faults:
        first = next(iter(findings.faults)).what
        raise LibraryDamagedError("library_backup.damaged", library=source, what=first, n=len(findings.faults))
    return findings.n_clips, findings.n_rows


def _copy_file(source: Database, new: Path, path: Path, tell: Count) -> None:
    """Copy a library file and its fragments as of one moment, while others may write; ``path`` is named in errors."""
    # A transaction that reads: as long as it lasts, no fragment that it sees is deleted.
    with source.reading() as connection, closing(sqlite3.connect(new)) as copy:
        raw = connection.connection.driver_connection
        assert isinstance(raw, sqlite3.Connection)
        connection.exec_driver_sql("SELECT count(*) FROM sqlite_master").scalar_one()
        try:
            raw.backup(copy, pages=2**12, progress=lambda status, left, total: tell(total - left, total), sleep=0.0)
            copy.execute("PRAGMA journal_mode = DELETE").fetchone()
        except sqlite3.OperationalError as error:
            if error.sqlite_errorname.endswith("READ"):
                raise
            raise translate_error(error, os.fspath(path)) from error
        store = open_store(connection)
        for name, size in store.sizes().items():
            target = new.with_name(f"{new.name}.fragments")
            target.mkdir(exist_ok=True)
            with open(target / name, "xb") as file:
                for first in range(0, size, 2**24):  # bytes at a time, so that they fit in memory
                    file.write(store.read([Place(name, first, min(2**24, size - first))])[0])
                file.flush()
                os.fsync(file.fileno())
        sync_folder(new.with_name(f"{new.name}.fragments"))


def _copy_rows(source: Database, target: Database, tell: Count) -> None:
    """Copy all rows to a library without clips, in one transaction; blocks of bytes go where the target has them."""
    with source.reading() as reading, target.writing() as writing:
        for table in (schema.clips, schema.journal):  # of clips that were removed, an undo brings some back
            if writing.execute(sa.select(schema.key_of(table)).limit(1)).first() is not None:
                raise LibraryError("library_backup.not_empty", library=target.where)
        tables = schema.metadata.sorted_tables
        for table in tables:
            writing.execute(sa.delete(table))
        in_file = target.engine.dialect.name == "sqlite"
        if in_file and find_store(reading) is not None:
            begin_store(writing, "")
        counts = [reading.execute(sa.select(sa.func.count()).select_from(table)).scalar_one() for table in tables]
        done, total = 0, sum(counts)
        for table in tables:
            if table is schema.array_store:
                continue
            column = next((one.name for one in ARRAYS if one.table is table), None)
            query = sa.select(table).order_by(schema.key_of(table))
            for rows in reading.execution_options(yield_per=16).execute(query).partitions():
                values = [dict(row._mapping) for row in rows]
                if column is not None:
                    blocks = read_blocks(reading, rows, column)
                    values = put_aside(
                        writing, [{**one, column: data} for one, data in zip(values, blocks, strict=True)], column
                    )
                writing.execute(sa.insert(table), values)
                done += len(rows)
                tell(done, total)


__all__ = ["BackupReport", "back_up", "restore"]
