"""The versions of the tables, as numbered and named steps, each in a transaction of its own.

A new library is made from ``schema`` at once and every step is recorded as done; an older library takes the
steps that it lacks. To change a table: change ``schema`` and add a step that does the same to an old library.
To change a set of features: give it another name, or add a step that empties ``clip_features.feature_set``; features
of another set than the one asked for are computed anew from the stored positions.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

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
    """Nothing to do: every library has them."""


def _takes_and_feature_sets(connection: sa.Connection) -> None:
    """Takes, sets of features by name, leaves that learn; histograms, which follow from the leaves, go."""
    for table, column in (
        (schema.clips, "kind"),
        (schema.clip_features, "feature_set"),
        (schema.forests, "learned"),
        (schema.forests, "window_lengths"),
        (schema.forests, "n_learned"),
        (schema.forests, "calibration"),
        (schema.forests, "labeller"),
        (schema.library_state, "clips_revision"),
    ):
        _add_column(connection, table, column)
    state = schema.library_state
    connection.execute(sa.update(state).values(clips_revision=state.c.revision))
    forests = schema.forests
    for row in connection.execute(sa.select(forests.c.id, forests.c.revision, forests.c.parameters)).all():
        known = {**row.parameters, "feature_set": "paper"}  # there was no other set
        values = {"learned": row.revision, "parameters": known}
        connection.execute(sa.update(forests).where(forests.c.id == row.id).values(**values))
    schema.clip_poses.create(connection)
    schema.clip_leaves.create(connection)
    schema.take_windows.create(connection)
    names = [column.name for column in schema.clip_leaves.c]
    copied: Any = sa.select(*map(sa.column, names)).select_from(sa.table("clip_histograms"))
    connection.execute(sa.insert(schema.clip_leaves).from_select(names, copied))
    connection.execute(sa.DDL("DROP TABLE clip_histograms"))


def _add_column(connection: sa.Connection, table: sa.Table, name: str) -> None:
    column = sa.schema.CreateColumn(table.c[name]).compile(dialect=connection.dialect)
    connection.execute(sa.DDL(f"ALTER TABLE {table.name} ADD COLUMN {column}"))


MIGRATIONS: tuple[Migration, ...] = (
    Migration(1, "first tables", _first_tables),
    Migration(2, "takes and feature sets", _takes_and_feature_sets),
)


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
