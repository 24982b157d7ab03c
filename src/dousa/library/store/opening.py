"""Opening a library: makes its tables, or checks that they are of this version.

Who changes ``schema`` after a release gives ``TABLES`` the next number, and adds a step that brings libraries of the
release up to date in a transaction of its own. A feature set that changes gets another name: features of another set
than wanted are computed again from the stored positions.
"""

from __future__ import annotations

import os
from datetime import UTC, datetime

import sqlalchemy as sa

import dousa
from dousa.errors import LibraryDamagedError, LibraryError, LibraryVersionError, OptionError
from dousa.library.store import schema
from dousa.library.store.engine import (
    STATE_ID,
    Database,
    check_mark,
    is_url,
    make_engine,
    name_of,
    set_mark,
    use_write_ahead_log,
)
from dousa.library.store.rows import insert_rows
from dousa.library.store.schema import library_state

TABLES = 17
"""The version of the tables, by definition; a library records the one that it was made with."""


def _create_tables(database: Database) -> None:
    """Make the tables of a new library, all or none, unless another program just did."""
    with database.writing() as connection:
        if sa.inspect(connection).has_table(schema.migrations.name):
            return
        schema.metadata.create_all(connection)
        set_mark(connection)
        state = {"id": STATE_ID, "revision": 0, "next_clip_id": 1, "clips_revision": 0}
        insert_rows(connection, library_state, [state])
        made = {"applied_at": datetime.now(UTC).isoformat(timespec="seconds"), "dousa_version": dousa.__version__}
        connection.execute(sa.insert(schema.migrations).values(number=TABLES, name="tables", **made))


def check_version(connection: sa.Connection, where: str) -> None:
    """Raise LibraryVersionError for the tables of another dousa, LibraryDamagedError for those without a version."""
    query = sa.select(schema.migrations.c.number, schema.migrations.c.dousa_version)
    last = connection.execute(query.order_by(schema.migrations.c.number.desc())).first()
    if last is None:
        raise LibraryDamagedError("library_file.no_version", library=where)
    if last.number != TABLES:
        raise LibraryVersionError(
            "library_file.newer" if last.number > TABLES else "library_file.older",
            library=where,
            version=last.dousa_version,
            tables=last.number,
            own_version=dousa.__version__,
            own_tables=TABLES,
        )


def open_database(path_or_url: str | os.PathLike[str], *, create: bool, read_only: bool, timeout: float) -> Database:
    """Open a database with the tables of this version.

    LibraryError, of the kind that its name says, for no library, no permission, damage, another version or a lock;
    OptionError for create and read_only together.
    """
    if create and read_only:
        raise OptionError("library_file.create_read_only")
    where = name_of(path_or_url)
    engine = make_engine(path_or_url, create=create, read_only=read_only, timeout=timeout)
    database = Database(engine, where, timeout)
    try:
        _prepare(database, create, read_only)
    except BaseException:
        engine.dispose()
        raise
    return database


def _prepare(database: Database, create: bool, read_only: bool) -> None:
    where = database.where
    with database.reading() as connection:
        ours = check_mark(connection, where)
        if ours:
            check_version(connection, where)
    if not ours and not create:
        name = where if is_url(where) else os.path.basename(where)
        raise LibraryError("library_file.empty", library=where, name=name)
    if not ours:
        _create_tables(database)
    if not read_only:
        use_write_ahead_log(database)
