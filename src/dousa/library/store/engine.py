"""The database of a library: connections, everything specific to SQLite, and readable errors.

A path becomes one SQLite file in WAL mode; a URL such as ``postgresql+psycopg://...`` is left to SQLAlchemy.
Transactions that write begin with ``BEGIN IMMEDIATE``, on a server with a lock, so that they wait for each other.

SQLite applies any log that lies beside a file under its name: that of the library before a backup was copied over it,
too. Every transaction that writes therefore leaves a mark in the first page (``user_version``): its upper half
follows from the mark before it, its lower half is random. The first mark in a log follows from the file it began on.
"""

from __future__ import annotations

import os
import random
import re
import secrets
import sqlite3
import stat
import struct
import time
import zlib
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from json import JSONDecodeError
from pathlib import Path
from typing import Any, TypeVar
from urllib.parse import quote

import sqlalchemy as sa
from sqlalchemy import event, exc

from dousa.errors import LibraryDamagedError, LibraryError, LibraryLockedError, OptionError
from dousa.library.store.checksums import LIBRARY_NAME, STATE
from dousa.library.store.exchange import settle
from dousa.library.store.rows import fetch_rows, update_rows
from dousa.library.store.schema import APPLICATION_ID, library_state

BESIDE = "dousa_beside"
"""Execution option of a connection to a library file: the folder with its fragments, if any."""

STATE_ID = 1  # of the only row, by definition
_WRITES = "dousa_writes"
_READ_ONLY = "dousa_read_only"
_BUSY = 5.0  # s that SQLite waits by itself, not interruptible, and a transaction by definition
_LEAST_BYTES = 512  # the smallest page of SQLite: https://sqlite.org/fileformat.html, 1.3.2


Plan = TypeVar("Plan")
Result = TypeVar("Result")


def is_url(path_or_url: str | os.PathLike[str]) -> bool:
    """Return whether this is the URL of a database server rather than a file."""
    return isinstance(path_or_url, str) and "://" in path_or_url


def name_of(path_or_url: str | os.PathLike[str]) -> str:
    """Return the name of a library for messages: its path, or its URL without the password."""
    if not is_url(path_or_url):
        return os.fspath(path_or_url)
    try:
        return sa.make_url(str(path_or_url)).render_as_string(hide_password=True)
    except (exc.ArgumentError, ValueError):
        return re.sub(r"(?<=:)[^:@/]+(?=@)", "***", str(path_or_url))


def make_engine(path_or_url: str | os.PathLike[str], *, create: bool, read_only: bool, timeout: float) -> sa.Engine:
    """Make an engine for a file or a URL, without connecting; SQLite waits `_BUSY` s at most, not interruptible."""
    if is_url(path_or_url):
        return _server_engine(str(path_or_url), read_only, timeout)
    path = Path(os.path.realpath(path_or_url))  # as SQLite: logs and fragments lie beside the file, not beside a link
    if not os.path.exists(path):
        settle(path.parent)
    _check_place(path, create)
    engine = sa.create_engine(
        "sqlite+pysqlite://",
        creator=lambda: _connect(path, create, read_only, min(timeout, _BUSY)),
        poolclass=sa.pool.QueuePool,
        pool_size=1,
        execution_options={
            _READ_ONLY: read_only,
            LIBRARY_NAME: name_of(path_or_url),
            BESIDE: path.with_name(f"{path.name}.fragments"),
        },
    )
    event.listen(engine, "begin", _begin)
    event.listen(engine, "handle_error", _keep_connection)
    return engine


def _server_engine(url: str, read_only: bool, timeout: float) -> sa.Engine:
    name = name_of(url)
    try:
        # Reconnect to a server that was restarted.
        options = {_READ_ONLY: read_only, LIBRARY_NAME: name}
        engine = sa.create_engine(url, pool_pre_ping=True, execution_options=options)
    except (exc.ArgumentError, exc.NoSuchModuleError, ValueError) as error:
        raise LibraryError("library_file.not_a_url", library=name, reason=error) from error
    except ImportError as error:
        package = "'dousa[postgres]'" if error.name == "psycopg" else error.name
        raise LibraryError("library_file.driver_missing", library=name, package=package) from error
    if engine.dialect.name == "sqlite":
        # It would lack our settings for files: WAL, foreign keys, waiting writers.
        raise LibraryError("library_file.sqlite_url", library=name)
    if engine.dialect.name == "postgresql":

        def limit_waiting(connection: Any, record: Any) -> None:
            with connection.cursor() as cursor:
                cursor.execute(f"SET lock_timeout = {max(round(1000 * timeout), 1)}")
            connection.commit()

        event.listen(engine, "connect", limit_waiting)
    return engine


def _check_place(path: Path, create: bool) -> None:
    # os.path functions return false, and do not raise, if a parent folder cannot be read.
    if os.path.isdir(path):
        raise LibraryError("library_file.is_folder", library=path)
    if not os.path.exists(path) and not create:
        raise LibraryError("library_file.missing", library=path, name=path.name)
    if not os.path.isdir(path.parent):
        raise LibraryError("library_file.no_folder", library=path, folder=path.parent)
    if os.path.exists(path):
        check_log(path, lambda: _read_mark(path))


def _read_mark(path: Path) -> int | None:
    """Return the mark in a file without its log, None if that cannot be read; LibraryDamagedError if it is no database.

    SQLite would treat a file of a few bytes as an empty database and overwrite it.

    On POSIX, closing a file drops all locks that the program has on it, those of its other connections too. SQLite
    knows that and closes later; otherwise another program would believe these connections gone and delete their log.
    """
    is_file = os.path.isfile(path)  # reading a pipe would block
    size = os.path.getsize(path)
    if is_file and not size:
        return 0
    try:
        if is_file and size >= _LEAST_BYTES:
            with closing(sqlite3.connect(_name_for_sqlite(path, "mode=ro&immutable=1"), uri=True)) as connection:
                return int(connection.execute("PRAGMA user_version").fetchone()[0])
    except sqlite3.Error as error:
        if getattr(error, "sqlite_errorname", "") != "SQLITE_NOTADB":
            return None  # connecting reports the error
    raise LibraryDamagedError("library_file.not_a_library", library=path)


def _name_for_sqlite(path: Path, options: str) -> str:
    return f"file:{quote(os.fsencode(path.as_posix()))}?{options}"


def _connect(path: Path, create: bool, read_only: bool, timeout: float) -> sqlite3.Connection:
    # Writable even for reading: a read-only connection cannot delete its lock files. ``writing`` refuses.
    mode = "rwc" if create else "rw"
    _free_lock_files(path)
    try:
        return _connect_as(path, f"mode={mode}", timeout)
    except sqlite3.OperationalError as error:
        # In a read-only folder SQLite cannot make its lock files; without a pending log it does not need them.
        # Nor can it on a full disk, but then a program that wants to write needs the error.
        kinds = ("SQLITE_CANTOPEN", "SQLITE_READONLY", *(("SQLITE_IOERR",) if read_only else ()))
        if error.sqlite_errorname.startswith(kinds) and not _has_log(path):
            return _connect_as(path, "mode=ro&immutable=1", timeout)
        raise


def _free_lock_files(path: Path) -> None:
    """Make lock files writable that SQLite left from a time when the library was not."""
    with suppress(OSError):
        mode = stat.S_IMODE(os.stat(path).st_mode)
        for lock in (f"{path}-shm", f"{path}-wal"):
            with suppress(FileNotFoundError):
                if mode & ~os.stat(lock).st_mode & 0o222:
                    os.chmod(lock, mode)


def _connect_as(path: Path, options: str, timeout: float) -> sqlite3.Connection:
    name = _name_for_sqlite(path, options)
    connection = sqlite3.connect(name, uri=True, timeout=timeout, check_same_thread=False, isolation_level=None)
    try:
        connection.execute("SELECT count(*) FROM sqlite_master")
        connection.execute("PRAGMA foreign_keys = ON")
        # A change that was answered outlives a power cut, for a wait for the disk each: docs/reliability.md.
        connection.execute("PRAGMA synchronous = FULL")
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


def _keep_connection(context: sa.engine.ExceptionContext) -> None:
    """Let Ctrl-C end a transaction as other errors do: a dropped connection would keep its lock for a while."""
    context.is_disconnect = False  # a file cannot go away


def check_mark(connection: sa.Connection, where: str) -> bool:
    """Return whether this is a library (true) or has no tables yet (false); LibraryDamagedError for another file."""
    if connection.dialect.name != "sqlite":
        return sa.inspect(connection).has_table("dousa_migrations")
    mark = connection.exec_driver_sql("PRAGMA application_id").scalar_one()
    if mark == APPLICATION_ID:
        return True
    tables = connection.exec_driver_sql("SELECT count(*) FROM sqlite_master").scalar_one()
    if mark or tables:
        raise LibraryDamagedError("library_file.other_database", library=where)
    return False


def set_mark(connection: sa.Connection) -> None:
    """Mark an SQLite file as a dousa library."""
    if connection.dialect.name == "sqlite":
        connection.exec_driver_sql(f"PRAGMA application_id = {APPLICATION_ID}")


def use_write_ahead_log(database: Database) -> None:
    """Switch an SQLite file to WAL: readers and one writer at the same time, and safe against kill -9.

    If that fails (no permission, or another program is doing it) the library still works.
    """
    if database.engine.dialect.name != "sqlite":
        return
    with suppress(LibraryError), database.alone() as connection:
        connection.execute("PRAGMA journal_mode = WAL")


@dataclass(frozen=True, slots=True)
class Database:
    """The database of a library; every transaction begins here, and waits ``timeout`` s for other writers."""

    engine: sa.Engine
    where: str
    timeout: float = _BUSY

    @property
    def is_read_only(self) -> bool:
        """Whether it was opened read-only."""
        return bool(self.engine.get_execution_options().get(_READ_ONLY))

    @contextmanager
    def reading(self) -> Iterator[sa.Connection]:
        """Open a transaction that sees the library as of its first query."""
        with _plain_errors(self.where), self.engine.connect() as connection:
            if self.engine.dialect.name == "postgresql":
                connection.execution_options(isolation_level="REPEATABLE READ")
            with connection.begin():
                yield connection

    @contextmanager
    def writing(self) -> Iterator[sa.Connection]:
        """Open a transaction that writes all or nothing; LibraryError if the database is read-only."""
        if self.is_read_only:
            raise LibraryError("library_file.opened_read_only", library=self.where)
        with _plain_errors(self.where), self.engine.connect() as connection:
            connection.execution_options(**{_WRITES: True})
            with self._begin_writing(connection):
                if self.engine.dialect.name == "postgresql":
                    # One writer at a time, as with a file: a server would let all begin, and some would fail.
                    connection.execute(sa.select(sa.func.pg_advisory_xact_lock(APPLICATION_ID)))
                elif self.engine.dialect.name == "sqlite":
                    leave_mark(connection)
                yield connection

    def _begin_writing(self, connection: sa.Connection) -> sa.RootTransaction:
        """Begin a transaction that writes, after the others; LibraryLockedError if that takes too long."""
        deadline = time.monotonic() + self.timeout
        while True:
            try:
                return connection.begin()
            except exc.OperationalError as error:
                busy = getattr(error.orig, "sqlite_errorname", "").startswith("SQLITE_BUSY")
                if not busy or time.monotonic() >= deadline:
                    raise
            _pause()

    @contextmanager
    def alone(self) -> Iterator[sqlite3.Connection]:
        """Return the raw connection of an SQLite file, outside any transaction."""
        with _plain_errors(self.where):
            raw = self.engine.raw_connection()
            try:
                yield raw.driver_connection  # type: ignore[misc]
            finally:
                raw.close()

    def check_writable(self) -> None:
        """Raise LibraryError if nothing can be written; called before long work."""
        with self.writing() as connection:
            state = library_state.c
            connection.execute(sa.update(library_state).where(state.id == STATE_ID).values(id=STATE_ID))

    def keep(self, write: Callable[[sa.Connection], object]) -> None:
        """Write what can be made again, unless the library cannot be written; LibraryDamagedError as usual."""
        try:
            with self.writing() as connection:
                write(connection)
        except LibraryDamagedError:
            raise
        except LibraryError:
            return

    def write_planned(
        self,
        plan: Callable[[sa.Connection, Plan | None], Plan],
        write: Callable[[sa.Connection, Plan], Result],
        *,
        attempts: int = 3,
    ) -> Result:
        """Plan a change while others may write, then write it in one transaction.

        After a write by another program it is planned again; after this many attempts others have to wait. ``plan``
        gets a connection and its last result, and writes nothing; ``write`` writes the plan, in a library unchanged
        since.
        """
        planned: Plan | None = None
        for attempt in range(attempts + 1):
            with self.reading() as connection:
                seen = read_revision(connection)
                planned = plan(connection, planned)
            with self.writing() as connection:
                lock_for_writing(connection)
                if read_revision(connection) == seen:
                    return write(connection, planned)
                if attempt == attempts:
                    return write(connection, plan(connection, planned))
            _pause()
        raise AssertionError


def _pause(most: float = 0.2) -> None:
    """Wait at random, ``most`` s at most, so that two writers do not keep colliding."""
    time.sleep(random.uniform(0, most))


@contextmanager
def _plain_errors(where: str) -> Iterator[None]:
    """Convert database errors inside the block to LibraryError and its kinds."""
    try:
        yield
    except exc.DBAPIError as error:
        raise translate_error(error.orig, where) from error
    except sqlite3.Error as error:
        raise translate_error(error, where) from error
    except UnicodeEncodeError as error:
        text = str(error.object).encode(errors="backslashreplace").decode()
        raise OptionError("library_file.not_unicode", text=text) from error
    except (exc.SQLAlchemyError, UnicodeDecodeError, JSONDecodeError) as error:
        raise LibraryDamagedError("library_file.content_damaged", library=where, reason=error) from error


_SQLITE_PROBLEMS: dict[str, tuple[type[LibraryError], str]] = {
    "SQLITE_BUSY": (LibraryLockedError, "library_file.locked"),
    "SQLITE_LOCKED": (LibraryLockedError, "library_file.locked"),
    "SQLITE_NOTADB": (LibraryDamagedError, "library_file.not_a_library"),
    "SQLITE_CORRUPT": (LibraryDamagedError, "library_file.cut_short"),
    "SQLITE_FULL": (LibraryError, "library_file.disk_full"),
    "SQLITE_READONLY": (LibraryError, "library_file.read_only"),
    "SQLITE_CANTOPEN": (LibraryError, "library_file.cannot_open"),
    "SQLITE_PERM": (LibraryError, "library_file.no_permission"),
    "SQLITE_IOERR": (LibraryError, "library_file.disk_failed"),
    "SQLITE_TOOBIG": (LibraryError, "library_file.motion_too_long"),
}
_SERVER_PROBLEMS: dict[str, tuple[type[LibraryError], str]] = {
    "55P03": (LibraryLockedError, "library_file.locked"),
    "40P01": (LibraryLockedError, "library_file.locked"),
    "53100": (LibraryError, "library_file.server_disk_full"),
    "25006": (LibraryError, "library_file.server_read_only"),
    "42501": (LibraryError, "library_file.server_no_permission"),
}


def translate_error(error: BaseException | None, where: str) -> LibraryError:
    """Return the error of a driver as a LibraryError of the library with this name."""
    name = getattr(error, "sqlite_errorname", None) or ""
    primary = "_".join(name.split("_")[:2])  # such as SQLITE_IOERR of SQLITE_IOERR_WRITE
    known = _SQLITE_PROBLEMS.get(primary) or _SERVER_PROBLEMS.get(str(getattr(error, "sqlstate", "")))
    if known is not None:
        kind, code = known
        return kind(code, library=where)
    # Driver errors often have several lines.
    reason = " ".join(str(error).split())
    gone = str(getattr(error, "sqlstate", "")) in ("42P01", "42703")
    if gone or (name == "SQLITE_ERROR" and "no such" in reason):
        return LibraryDamagedError("library_file.table_missing", library=where, reason=reason)
    return LibraryError("library_file.database_error", library=where, reason=reason)


def read_revision(connection: sa.Connection) -> int:
    """Return the number of the last write."""
    return int(_read_state(connection).revision)


def _read_state(connection: sa.Connection) -> Any:
    row = next(fetch_rows(connection, STATE), None)
    if row is None:
        raise LibraryDamagedError("library_file.no_state")
    return row


def lock_for_writing(connection: sa.Connection) -> None:
    """Wait for other writers, without counting this write yet."""
    connection.execute(sa.select(library_state.c.revision).with_for_update())


def next_revision(connection: sa.Connection) -> int:
    """Count this write and return its number."""
    lock_for_writing(connection)
    revision = read_revision(connection) + 1
    update_rows(connection, STATE, {STATE_ID: {"revision": revision}})
    return revision


def note_changed_clips(connection: sa.Connection) -> None:
    """Record that this write changes clips or categories, which the forest has not learned."""
    update_rows(connection, STATE, {STATE_ID: {"clips_revision": read_revision(connection)}})


def next_clip_id(connection: sa.Connection) -> int:
    """Return the number of the next new clip."""
    return int(_read_state(connection).next_clip_id)


def take_clip_ids(connection: sa.Connection, count: int) -> range:
    """Reserve numbers for new clips, never used before; after ``next_revision`` in the same transaction."""
    first = next_clip_id(connection)
    update_rows(connection, STATE, {STATE_ID: {"next_clip_id": first + count}})
    return range(first, first + count)


def check_jobs(n_jobs: int | None) -> None:
    """Raise OptionError for zero jobs."""
    if n_jobs == 0:
        raise OptionError("library_add.no_jobs")


def choose_jobs(n_jobs: int | None) -> int | None:
    """Return the number for joblib: as given, else that of ``joblib.parallel_config``, else every core."""
    import joblib

    check_jobs(n_jobs)
    # None asks joblib for the configured number; its default argument asks for all cores.
    return -1 if n_jobs is None and joblib.effective_n_jobs(None) == 1 else n_jobs


# Of https://sqlite.org/fileformat.html, 1.3.14, 4.1 and 4.2: place of the mark in the first page; header of a log
# (magic, version, bytes of a page, checkpoint, two salts, two checksums) and of a frame (page, size, salts, checksums).
_MARK = struct.Struct(">60xi")
_LOG = struct.Struct(">IIII8s8x")
_FRAME = struct.Struct(">II8s8x")


def leave_mark(connection: sa.Connection) -> None:
    """Leave the next mark in a transaction that writes to an SQLite file."""
    before = connection.exec_driver_sql("PRAGMA user_version").scalar_one()
    mark = _follow(before) << 16 | secrets.randbits(16)
    connection.exec_driver_sql(f"PRAGMA user_version = {mark - (1 << 32 if mark >> 31 else 0)}")


def _follow(mark: int) -> int:
    """Return the upper half of the mark after this one."""
    return zlib.crc32(struct.pack(">i", mark)) >> 16


def check_log(path: Path, read_mark: Callable[[], int | None], *, tries: int = 5, pause: float = 0.02) -> None:
    """Raise LibraryDamagedError if the log beside a library belongs to another file, or another state of it.

    ``read_mark`` : returns the mark in the file alone, None if that cannot be read. Programs that write meanwhile may
    change it between two looks: only a log that fits in none of ``tries`` looks, ``pause`` s apart, is another's.
    """
    log = Path(f"{path}-wal")
    for _ in range(tries):
        mark = read_mark()
        first: int | None = None
        for found in _list_marks(log):
            first = found if first is None else first
            # It was written from this state of the file on, or this state is one of its own, copied back from it.
            if mark is None or found == mark or (first & 0xFFFFFFFF) >> 16 == _follow(mark):
                return
        if first is None or mark is None:  # no log, or that of a dousa which left no marks
            return
        time.sleep(pause)
    raise LibraryDamagedError("library_file.other_log", library=path, log=log.name)


def _list_marks(log: Path) -> Iterator[int]:
    """Yield the marks in a log, the first first."""
    try:
        with open(log, "rb") as file:
            magic, _, size, _, salts = _LOG.unpack(file.read(_LOG.size))
            while magic >> 1 == 0x377F0682 >> 1:
                page, _, own = _FRAME.unpack(file.read(_FRAME.size))
                if own != salts:  # left from before the log began again
                    return
                if page == 1:
                    (mark,) = _MARK.unpack(file.read(_MARK.size))
                    yield mark
                    file.seek(size - _MARK.size, 1)
                else:
                    file.seek(size, 1)
    except (OSError, struct.error):
        return
