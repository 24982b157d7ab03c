"""The versions of the tables, as numbered and named steps, each in a transaction of its own.

A new library is made from ``schema`` at once and every step is recorded as done; an older library takes the
steps that it lacks. To change a table: change ``schema`` and add a step that does the same to an old library.
To change the pose features: add a step too, which computes those of the stored clips anew.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime

import sqlalchemy as sa

import dousa
from dousa.errors import LibraryDamagedError, LibraryVersionError
from dousa.library import schema
from dousa.library._engine import mark_as_library, writing

__all__ = ["MIGRATIONS", "Migration", "applied_number", "create_tables", "migrate"]


@dataclass(frozen=True, slots=True)
class Migration:
    """One step from a version of the tables to the next.

    Parameters
    ----------
    number : position, from 1 without gaps.
    name : what it does, in words.
    apply : does it, on a connection that is in a transaction.
    """

    number: int
    name: str
    apply: Callable[[sa.Connection], None]


def _first_tables(connection: sa.Connection) -> None:
    schema.metadata.create_all(connection)


MIGRATIONS: tuple[Migration, ...] = (Migration(1, "first tables", _first_tables),)


def _record(connection: sa.Connection, step: Migration) -> None:
    connection.execute(
        sa.insert(schema.migrations).values(
            number=step.number,
            name=step.name,
            applied_at=datetime.now(UTC).isoformat(timespec="seconds"),
            dousa_version=dousa.__version__,
        )
    )


def create_tables(engine: sa.Engine, where: str) -> None:
    """Make the tables of a new library, all or none; does nothing if another program just did."""
    with writing(engine, where) as connection:
        if sa.inspect(connection).has_table(schema.migrations.name):
            return
        schema.metadata.create_all(connection)
        mark_as_library(connection)
        connection.execute(sa.insert(schema.library_state).values(id=1, revision=0, next_clip_id=1))
        for step in MIGRATIONS:
            _record(connection, step)


def applied_number(connection: sa.Connection, where: str) -> int:
    """Number of the last step that this library took.

    Raises
    ------
    LibraryVersionError : a step that this dousa does not know.
    LibraryDamagedError : no step at all.
    """
    query = sa.select(schema.migrations.c.number, schema.migrations.c.dousa_version)
    rows = connection.execute(query.order_by(schema.migrations.c.number)).all()
    if not rows:
        raise LibraryDamagedError(f"{where}: the library does not say which version it is")
    last = rows[-1]
    if last.number > MIGRATIONS[-1].number:
        raise LibraryVersionError(
            f"{where}: written by dousa {last.dousa_version} (tables {last.number}), this is dousa "
            f"{dousa.__version__} (tables {MIGRATIONS[-1].number}); run: pip install --upgrade dousa"
        )
    return int(last.number)


def migrate(engine: sa.Engine, where: str) -> None:
    """Take the steps that a library lacks, each in a transaction of its own."""
    for step in MIGRATIONS:
        with writing(engine, where) as connection:
            if applied_number(connection, where) < step.number:
                step.apply(connection)
                _record(connection, step)
