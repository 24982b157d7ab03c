"""Connections to the database of a library: everything that only SQLite needs, and errors in plain words.

A path becomes one SQLite file in WAL mode; a URL such as ``postgresql+psycopg://...`` is left to SQLAlchemy.
Transactions that write begin with ``BEGIN IMMEDIATE``: they wait for each other instead of failing half way.
"""

from __future__ import annotations

import os
import re
import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from json import JSONDecodeError
from pathlib import Path
from typing import Any
from urllib.parse import quote

import sqlalchemy as sa
from sqlalchemy import event, exc

from dousa.errors import LibraryDamagedError, LibraryError, LibraryLockedError
from dousa.library.schema import APPLICATION_ID

__all__ = [
    "check_mark",
    "is_url",
    "make_engine",
    "mark_as_library",
    "name_of",
    "plain_errors",
    "reading",
    "use_write_ahead_log",
    "writing",
]

_WRITES = "dousa_writes"
_READ_ONLY = "dousa_read_only"
_SQLITE_START = b"SQLite format 3\0"
_NOT_A_LIBRARY = "not a dousa library"


def is_url(path_or_url: str | os.PathLike[str]) -> bool:
    """Whether this names a database server rather than a file."""
    return isinstance(path_or_url, str) and "://" in path_or_url


def name_of(path_or_url: str | os.PathLike[str]) -> str:
    """What messages call a library: its path, or its URL without the password."""
    if not is_url(path_or_url):
        return os.fspath(path_or_url)
    try:
        return sa.make_url(str(path_or_url)).render_as_string(hide_password=True)
    except (exc.ArgumentError, ValueError):
        return re.sub(r"(?<=:)[^:@/]+(?=@)", "***", str(path_or_url))


def make_engine(
    path_or_url: str | os.PathLike[str], *, create: bool, read_only: bool, timeout: float
) -> sa.Engine:
    """An engine for a file or a URL; nothing is connected yet.

    Parameters
    ----------
    path_or_url : file of the library, or URL of a database.
    create : a missing file is made.
    read_only : nothing can be written through this engine.
    timeout : s to wait for another program that writes.

    Raises
    ------
    LibraryError : no such file or folder, a folder instead of a file, a URL that SQLAlchemy does not know.
    """
    if is_url(path_or_url):
        return _server_engine(str(path_or_url), read_only, timeout)
    path = Path(path_or_url).absolute()
    _check_place(path, create)
    engine = sa.create_engine(
        "sqlite+pysqlite://",
        creator=lambda: _connect(path, create, read_only, timeout),
        poolclass=sa.pool.QueuePool,
        pool_size=1,
        execution_options={_READ_ONLY: read_only},
    )
    event.listen(engine, "begin", _begin)
    return engine


def _server_engine(url: str, read_only: bool, timeout: float) -> sa.Engine:
    name = name_of(url)
    try:
        engine = sa.create_engine(url, execution_options={_READ_ONLY: read_only})
    except (exc.ArgumentError, exc.NoSuchModuleError, ValueError) as error:
        raise LibraryError(f"{name}: not the URL of a database: {error}") from error
    except ImportError as error:
        raise LibraryError(f"{name}: the driver is missing; run: pip install {error.name}") from error
    if engine.dialect.name == "sqlite":
        # It would lack all that we give a file: the log, foreign keys, writers that wait.
        raise LibraryError(f"{name}: expected a database server; name an SQLite file without sqlite://")
    if engine.dialect.name == "postgresql":

        def limit_waiting(connection: Any, record: Any) -> None:
            with connection.cursor() as cursor:
                cursor.execute(f"SET lock_timeout = {max(round(1000 * timeout), 1)}")
            connection.commit()

        event.listen(engine, "connect", limit_waiting)
    return engine


def _check_place(path: Path, create: bool) -> None:
    # The functions of os.path say no, and do not raise, where a folder above cannot be looked into.
    if os.path.isdir(path):
        raise LibraryError(f"{path}: expected the file of a library, this is a folder")
    if not os.path.exists(path) and not create:
        raise LibraryError(f"no library at {path}; make one with: dousa add {path.name} PATH")
    if not os.path.isdir(path.parent):
        raise LibraryError(f"{path}: the folder {path.parent} does not exist; make it first")
    if os.path.exists(path) and _is_something_else(path):
        # SQLite would take a file of a few bytes for an empty database, and write over it.
        raise LibraryDamagedError(f"{path}: {_NOT_A_LIBRARY}; name the file that 'dousa add' made")


def _is_something_else(path: Path) -> bool:
    try:
        with open(path, "rb") as file:
            start = file.read(len(_SQLITE_START))
    except OSError:
        return False  # connecting says what is wrong
    return start not in (b"", _SQLITE_START)


def _connect(path: Path, create: bool, read_only: bool, timeout: float) -> sqlite3.Connection:
    # Also to read: a connection that may not write cannot clear its lock files away. ``writing`` refuses.
    mode = "rwc" if create else "rw"
    try:
        return _connect_as(path, f"mode={mode}", timeout)
    except sqlite3.OperationalError as error:
        # Where nobody may write, SQLite cannot make its lock files; if no log waits there, it can do without.
        # On a full disk it cannot make them either, but then a program that means to write must hear of that.
        kinds = ("SQLITE_CANTOPEN", "SQLITE_READONLY", *(("SQLITE_IOERR",) if read_only else ()))
        if error.sqlite_errorname.startswith(kinds) and not _has_log(path):
            return _connect_as(path, "mode=ro&immutable=1", timeout)
        raise


def _connect_as(path: Path, options: str, timeout: float) -> sqlite3.Connection:
    name = f"file:{quote(path.as_posix())}?{options}"
    connection = sqlite3.connect(
        name, uri=True, timeout=timeout, check_same_thread=False, isolation_level=None
    )
    try:
        connection.execute("SELECT count(*) FROM sqlite_master")
        connection.execute("PRAGMA foreign_keys = ON")
        # With WAL this survives a killed program; a power cut may lose the last commits, never the file.
        connection.execute("PRAGMA synchronous = NORMAL")
    except sqlite3.Error:
        connection.close()
        raise
    return connection


def _has_log(path: Path) -> bool:
    log = f"{path}-wal"
    return os.path.exists(log) and os.path.getsize(log) > 0


def _begin(connection: sa.Connection) -> None:
    writes = connection.get_execution_options().get(_WRITES, False)
    connection.exec_driver_sql("BEGIN IMMEDIATE" if writes else "BEGIN")


def check_mark(connection: sa.Connection, where: str) -> bool:
    """Whether an SQLite file is ours (true) or has no tables at all (false); servers are asked later.

    Raises
    ------
    LibraryDamagedError : a database of something else.
    """
    if connection.dialect.name != "sqlite":
        return sa.inspect(connection).has_table("dousa_migrations")
    mark = connection.exec_driver_sql("PRAGMA application_id").scalar_one()
    if mark == APPLICATION_ID:
        return True
    tables = connection.exec_driver_sql("SELECT count(*) FROM sqlite_master").scalar_one()
    if mark or tables:
        raise LibraryDamagedError(f"{where}: {_NOT_A_LIBRARY}, but an SQLite database of another program")
    return False


def mark_as_library(connection: sa.Connection) -> None:
    """Write the mark of a library into an SQLite file, inside the transaction that makes the tables."""
    if connection.dialect.name == "sqlite":
        connection.exec_driver_sql(f"PRAGMA application_id = {APPLICATION_ID}")


def use_write_ahead_log(engine: sa.Engine, where: str) -> None:
    """Switch an SQLite file to WAL: readers and one writer at the same time, and safe against kill -9.

    Where that cannot be (no permission, or another program is just doing it) the library works all the same.
    """
    if engine.dialect.name != "sqlite":
        return
    with suppress(LibraryError), plain_errors(where):
        raw = engine.raw_connection()
        try:
            raw.cursor().execute("PRAGMA journal_mode = WAL")
        finally:
            raw.close()


@contextmanager
def reading(engine: sa.Engine, where: str) -> Iterator[sa.Connection]:
    """A connection in one transaction that sees the library as it stands at its first query."""
    with plain_errors(where), engine.connect() as connection:
        if engine.dialect.name == "postgresql":
            connection.execution_options(isolation_level="REPEATABLE READ")
        with connection.begin():
            yield connection


@contextmanager
def writing(engine: sa.Engine, where: str) -> Iterator[sa.Connection]:
    """A connection in one transaction that writes all or nothing; LibraryError where it was opened to be read."""
    if engine.get_execution_options().get(_READ_ONLY):
        raise LibraryError(f"{where}: opened read-only; open it for writing to change it")
    with plain_errors(where), engine.connect() as connection:
        connection.execution_options(**{_WRITES: True})
        with connection.begin():
            yield connection


@contextmanager
def plain_errors(where: str) -> Iterator[None]:
    """Errors of the database inside the block become LibraryError and its kinds.

    Parameters
    ----------
    where : the library, as a person named it.
    """
    try:
        yield
    except exc.DBAPIError as error:
        raise _translate(error.orig, where) from error
    except sqlite3.Error as error:
        raise _translate(error, where) from error
    except (exc.SQLAlchemyError, UnicodeDecodeError, JSONDecodeError) as error:
        raise LibraryDamagedError(f"{where}: the content is damaged: {error}") from error


_SQLITE_PROBLEMS: tuple[tuple[str, type[LibraryError], str], ...] = (
    (
        "SQLITE_BUSY",
        LibraryLockedError,
        "another program is writing to the library; try again when it is done",
    ),
    (
        "SQLITE_LOCKED",
        LibraryLockedError,
        "another program is writing to the library; try again when it is done",
    ),
    ("SQLITE_NOTADB", LibraryDamagedError, f"{_NOT_A_LIBRARY}; name the file that 'dousa add' made"),
    ("SQLITE_CORRUPT", LibraryDamagedError, "the file is damaged or cut short; make the library again"),
    ("SQLITE_FULL", LibraryError, "the disk is full; free some space and run the command again"),
    (
        "SQLITE_READONLY",
        LibraryError,
        "the library is read-only; change its permissions or copy it elsewhere",
    ),
    ("SQLITE_CANTOPEN", LibraryError, "cannot be opened; check the permissions of the file and its folder"),
    ("SQLITE_PERM", LibraryError, "no permission; change the permissions of the file"),
    ("SQLITE_IOERR", LibraryError, "the disk cannot be read or written; is it full?"),
    ("SQLITE_TOOBIG", LibraryError, "the motion is too long for the database"),
)
_SERVER_PROBLEMS: dict[str, tuple[type[LibraryError], str]] = {
    "55P03": (LibraryLockedError, "another program is writing to the library; try again when it is done"),
    "53100": (LibraryError, "the disk of the database is full"),
    "25006": (LibraryError, "the database is read-only"),
    "42501": (LibraryError, "no permission in this database"),
}


def _translate(error: BaseException | None, where: str) -> LibraryError:
    name = getattr(error, "sqlite_errorname", None) or ""
    for start, kind, problem in _SQLITE_PROBLEMS:
        if name.startswith(start):
            return kind(f"{where}: {problem}")
    kind, problem = _SERVER_PROBLEMS.get(str(getattr(error, "sqlstate", "")), (LibraryError, ""))
    if problem:
        return kind(f"{where}: {problem}")
    if name == "SQLITE_ERROR" and "no such" in str(error):
        return LibraryDamagedError(f"{where}: the file is damaged: {error}")
    return LibraryError(f"{where}: {' '.join(str(error).split())}")  # drivers like to speak in several lines
