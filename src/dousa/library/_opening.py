"""Opening a library: is it one, is it ours, is it of a version we know; making and updating it."""

from __future__ import annotations

import os

import sqlalchemy as sa

from dousa.errors import LibraryError, LibraryVersionError, OptionError
from dousa.library._engine import check_mark, is_url, make_engine, name_of, reading, use_write_ahead_log
from dousa.library.migrations import MIGRATIONS, applied_number, create_tables, migrate

__all__ = ["open_engine"]


def open_engine(
    path_or_url: str | os.PathLike[str], *, create: bool, read_only: bool, timeout: float
) -> tuple[sa.Engine, str]:
    """An engine whose tables are there and of this version, and the name of the library for messages.

    Raises
    ------
    LibraryError : there is no library, or no permission; LibraryDamagedError, LibraryVersionError,
        LibraryLockedError as their names say.
    OptionError : create and read_only together.
    """
    if create and read_only:
        raise OptionError("a library cannot be made read-only: expected create or read_only, got both")
    where = name_of(path_or_url)
    engine = make_engine(path_or_url, create=create, read_only=read_only, timeout=timeout)
    try:
        _prepare(engine, where, create, read_only)
    except BaseException:
        engine.dispose()
        raise
    return engine, where


def _prepare(engine: sa.Engine, where: str, create: bool, read_only: bool) -> None:
    with reading(engine, where) as connection:
        ours = check_mark(connection, where)
        number = applied_number(connection, where) if ours else 0
    if not ours and not create:
        name = where if is_url(where) else os.path.basename(where)
        raise LibraryError(f"{where}: empty, not yet a library; make one with: dousa add {name} PATH")
    if not ours:
        create_tables(engine, where)
    elif number < MIGRATIONS[-1].number:
        if read_only:
            raise LibraryVersionError(
                f"{where}: written by an older dousa (tables {number}, now {MIGRATIONS[-1].number}); "
                "open it once for writing and it is brought up to date"
            )
        migrate(engine, where)
    if not read_only:
        use_write_ahead_log(engine, where)
