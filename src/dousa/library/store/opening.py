"""Opening a library: makes its tables, or migrates them to this version.

Migrations are numbered and named steps, each in a transaction of its own. A new library is made from ``schema`` and
every step is recorded as done; an older library takes its missing steps. To change a table: change ``schema`` and add a
step that does the same to an old library. To change a feature set: rename it, or add a step that empties
``clip_features.feature_set``; features of another set than wanted are computed again from the stored positions.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import product
from typing import Any

import sqlalchemy as sa

import dousa
from dousa.errors import LibraryDamagedError, LibraryError, LibraryVersionError, OptionError
from dousa.library.store import schema
from dousa.library.store.checksums import seal_rows
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
from dousa.library.store.schema import library_state


@dataclass(frozen=True, slots=True)
class Migration:
    """One step from a version of the tables to the next.

    Parameters
    ----------
    number : position, from 1 without gaps.
    name : short description.
    apply : called with a connection in a transaction.
    """

    number: int
    name: str
    apply: Callable[[sa.Connection], None]


def _add(*parts: sa.Table | tuple[sa.Table, str]) -> Callable[[sa.Connection], None]:
    """Return a step that adds tables, or a column or index of one by its name, unless an earlier step has made them."""

    def apply(connection: sa.Connection) -> None:
        for part in parts:
            if isinstance(part, sa.Table):
                part.create(connection, checkfirst=True)
            elif part[1] in part[0].c:
                _add_missing_column(connection, *part)
            else:
                next(index for index in part[0].indexes if index.name == part[1]).create(connection, checkfirst=True)

    return apply


def _takes_and_feature_sets(connection: sa.Connection) -> None:
    """Add takes, named feature sets and learning leaves; drop histograms, which follow from the leaves."""
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
        known = {**row.parameters, "feature_set": "paper"}  # the only set then
        values = {"learned": row.revision, "parameters": known}
        connection.execute(sa.update(forests).where(forests.c.id == row.id).values(**values))
    schema.clip_poses.create(connection)
    schema.clip_leaves.create(connection)
    schema.take_windows.create(connection)
    names = ["clip_id", "predicted_category", "leaves"]
    copied: Any = sa.select(*map(sa.column, names)).select_from(sa.table("clip_histograms"))
    connection.execute(sa.insert(schema.clip_leaves).from_select(names, copied))
    connection.execute(sa.DDL("DROP TABLE clip_histograms"))  # type: ignore[no-untyped-call]


def _labellers_of_moments(connection: sa.Connection) -> None:
    """Drop labellers of an earlier version; another is learned when a take is labelled."""
    connection.execute(sa.update(schema.forests).values(labeller=None))


def _checksums(connection: sa.Connection) -> None:
    """Add a checksum for each row, filled by ``Library.check``."""
    for table in schema.metadata.sorted_tables:
        if not sa.inspect(connection).has_table(table.name):
            continue  # added by a later step
        for column in table.c:
            if "checksum" in column.name:
                _add_missing_column(connection, table, column.name)


def _sensor_noise(connection: sa.Connection) -> None:
    """Drop extended features computed from positions with sensor noise; they are computed again when needed."""
    table = schema.clip_features
    old = table.c.feature_set.startswith("extended", autoescape=True)
    connection.execute(sa.update(table).where(old).values(feature_set="", checksum=None))


def _clips_to_learn(connection: sa.Connection) -> None:
    """Add clips still to be learned; all present ones have been learned, or are not known to the forest."""
    schema.unlearned.create(connection, checkfirst=True)
    _add_missing_column(connection, schema.forests, "first_later")
    following = connection.execute(sa.select(library_state.c.next_clip_id)).scalar()
    connection.execute(sa.update(schema.forests).values(first_later=following))


def _add_missing_column(connection: sa.Connection, table: sa.Table, name: str) -> None:
    """Add a column, unless an earlier step made the table in its present form."""
    if name not in {known["name"] for known in sa.inspect(connection).get_columns(table.name)}:
        _add_column(connection, table, name)


def _add_column(connection: sa.Connection, table: sa.Table, name: str) -> None:
    column = sa.schema.CreateColumn(table.c[name]).compile(dialect=connection.dialect)
    connection.execute(sa.DDL(f"ALTER TABLE {table.name} ADD COLUMN {column}"))  # type: ignore[no-untyped-call]


_WITH_BLOCKS = (schema.clip_trajectories, schema.clip_features, schema.removed_positions)

# The versions of the tables, by definition: each library records the numbers of its steps.
MIGRATIONS: tuple[Migration, ...] = (
    Migration(1, "first tables", _add()),  # every library has them
    Migration(2, "takes and feature sets", _takes_and_feature_sets),
    Migration(3, "annotated takes", _add(schema.segments, schema.take_annotations)),
    Migration(4, "words", _add(schema.clip_relations)),
    Migration(5, "parts of bodies", _add((schema.clips, "absent"), schema.part_forests)),
    Migration(6, "likeness", _add((schema.forests, "likeness"), (schema.clip_leaves, "direction"))),
    Migration(7, "labellers of moments", _labellers_of_moments),
    Migration(8, "checksums", _checksums),
    Migration(9, "sensor noise", _sensor_noise),
    Migration(10, "labellers of discriminants", _labellers_of_moments),
    Migration(
        11, "journal, tags and saved searches", _add(schema.clip_tags, schema.saved_searches, *schema.JOURNAL_TABLES)
    ),
    Migration(12, "clips to be learned", _clips_to_learn),
    Migration(
        13,
        "indices of checksums",
        _add((schema.clips, "ix_clips_label_checksum"), (schema.clip_leaves, "ix_clip_leaves_checksum")),
    ),
    # Positions and features may be in fragments; present ones stay in their rows.
    Migration(14, "fragments", _add(schema.array_store, *product(_WITH_BLOCKS, schema.PLACE))),
    Migration(15, "labellers of parts", _add((schema.part_forests, "labeller"))),  # learned when a take is labelled
    # Examples of leaves of large forests are chosen in the next add; the indices are for adding.
    Migration(
        16,
        "examples of leaves",
        _add(
            schema.leaf_examples,
            (schema.clips, "ix_clips_size"),
            (schema.clip_relations, "ix_clip_relations_version"),
        ),
    ),
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


def _create_tables(database: Database) -> None:
    """Make the tables of a new library, all or none, unless another program just did."""
    with database.writing() as connection:
        if sa.inspect(connection).has_table(schema.migrations.name):
            return
        schema.metadata.create_all(connection)
        set_mark(connection)
        state = {"id": STATE_ID, "revision": 0, "next_clip_id": 1, "clips_revision": 0}
        connection.execute(sa.insert(library_state), seal_rows(library_state, [state]))
        for step in MIGRATIONS:
            _record(connection, step)


def _applied_number(connection: sa.Connection, where: str) -> int:
    query = sa.select(schema.migrations.c.number, schema.migrations.c.dousa_version)
    rows = connection.execute(query.order_by(schema.migrations.c.number)).all()
    if not rows:
        raise LibraryDamagedError("library_file.no_version", library=where)
    last = rows[-1]
    if last.number > MIGRATIONS[-1].number:
        raise LibraryVersionError(
            "library_file.newer",
            library=where,
            version=last.dousa_version,
            tables=last.number,
            own_version=dousa.__version__,
            own_tables=MIGRATIONS[-1].number,
        )
    return int(last.number)


def _migrate(database: Database) -> None:
    for step in MIGRATIONS:
        with database.writing() as connection:
            if _applied_number(connection, database.where) < step.number:
                step.apply(connection)
                _record(connection, step)


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
        number = _applied_number(connection, where) if ours else 0
    if not ours and not create:
        name = where if is_url(where) else os.path.basename(where)
        raise LibraryError("library_file.empty", library=where, name=name)
    if not ours:
        _create_tables(database)
    elif number < MIGRATIONS[-1].number:
        if read_only:
            raise LibraryVersionError(
                "library_file.older", library=where, tables=number, own_tables=MIGRATIONS[-1].number
            )
        _migrate(database)
    if not read_only:
        use_write_ahead_log(database)
