"""Rows of the tables: read with their checksums compared, written with them, in portions that every database takes."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, TypeVar

import sqlalchemy as sa

from dousa.library.store.checksums import SEALS, Seal
from dousa.library.store.schema import key_of

Item = TypeVar("Item")


def portions(ids: Sequence[Item], *, at_once: int = 500) -> Iterable[Sequence[Item]]:
    """Split numbers, or rows, into lists short enough for one query, whose values databases limit.

    SQLite before 3.32 allows 999 (https://sqlite.org/limits.html).
    """
    return (ids[start : start + at_once] for start in range(0, len(ids), at_once))


def fetch_in(
    connection: sa.Connection, query: sa.Select[Any], column: sa.ColumnElement[Any], values: Sequence[Any]
) -> Iterator[Any]:
    """Yield rows of a query whose column has one of these values."""
    for some in portions(values):
        yield from connection.execute(query.where(column.in_(some)))


def fetch_rows(
    connection: sa.Connection,
    seal: Seal,
    keys: Sequence[Any] | None = None,
    *where: sa.ColumnElement[bool],
    order: sa.ColumnElement[Any] | None = None,
) -> Iterator[Any]:
    """Yield the sealed rows of a table, those of some keys if given; LibraryDamagedError for a wrong checksum."""
    query = sa.select(*seal.columns).where(*where).order_by(order)
    key = seal.covered[0]
    rows: list[Any] = list(fetch_in(connection, query, key, keys)) if keys is not None else []
    if keys is None:
        rows += connection.execute(query)
    if rows:
        seal.check_all(connection, list(zip(*rows, strict=True)))
    yield from rows


def insert_rows(connection: sa.Connection, table: sa.Table, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write new rows, with their checksums."""
    for some in portions(rows):
        connection.execute(sa.insert(table), seal_rows(table, some))


def delete_rows(connection: sa.Connection, table: sa.Table, keys: Sequence[Any]) -> None:
    """Delete the rows with these keys, as far as there are any."""
    for some in portions(keys):
        connection.execute(sa.delete(table).where(key_of(table).in_(some)))


def seal_rows(table: sa.Table, rows: Iterable[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Return rows for an insert into a table, with their checksums."""
    sealed = [dict(row) for row in rows]
    for seal in SEALS:
        if seal.checksum.table is table and sealed:
            sums = seal.compute_all([[row[column.name] for row in sealed] for column in seal.covered])
            for row, own in zip(sealed, sums, strict=True):
                row[seal.checksum.name] = own
    return sealed


def update_rows(connection: sa.Connection, seal: Seal, changes: Mapping[Any, Mapping[str, Any]]) -> dict[Any, int]:
    """Change covered values of rows, by key, and return their new checksums.

    LibraryDamagedError for a row that is damaged already, as a new checksum would hide that.
    """
    key, table = seal.covered[0], seal.checksum.table
    names = [column.name for column in seal.covered]
    sums: dict[Any, int] = {}
    keys = sorted(changes)  # in disk order, so that each portion is written while its pages are cached
    for some in portions(keys):
        rows = list(fetch_rows(connection, seal, some))
        if not rows:
            continue
        news = [[changes[row[0]].get(name, value) for name, value in zip(names, row, strict=False)] for row in rows]
        by_columns: dict[tuple[str, ...], list[dict[str, Any]]] = {}
        own = seal.compute_all(list(zip(*news, strict=True)))
        for row, checksum in zip(rows, own, strict=True):
            sums[row[0]] = checksum
            new = {"of_row": row[0], **changes[row[0]], seal.checksum.name: checksum}
            by_columns.setdefault(tuple(new), []).append(new)
        for group in by_columns.values():
            connection.execute(sa.update(table).where(key == sa.bindparam("of_row")), group)
    return sums
