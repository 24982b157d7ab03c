"""What a table of labels says of its take once some of its segments are removed from the library."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import sqlalchemy as sa

from dousa.library import schema
from dousa.library.seals.checksums import ANNOTATIONS, update_rows
from dousa.library.selection import fetch_in

Spans = Mapping[int, Sequence[tuple[float, float]]]
"""By number of the take: (start, stop) s."""


def find_leaving(connection: sa.Connection, ids: Sequence[int]) -> Spans:
    """Where the segments among some clips lie that tables said, in takes that are not among them.

    What somebody named by hand is no part of a table: without it there is what the table says.
    """
    table, going = schema.segments.c, set(ids)
    query = sa.select(table.take_id, table.start_s, table.end_s)
    query = query.join(schema.take_annotations, schema.take_annotations.c.take_id == table.take_id)
    found: dict[int, list[tuple[float, float]]] = {}
    for row in fetch_in(connection, query.where(sa.not_(table.by_hand)), table.clip_id, ids):
        if row.take_id not in going:
            found.setdefault(int(row.take_id), []).append((row.start_s, row.end_s))
    return found


def leave_open(connection: sa.Connection, removed: Spans) -> None:
    """Nobody can say what happens where a label was removed: it is not nothing. A take without any has no table.

    After the segments are gone, in the same transaction.

    Parameters
    ----------
    removed : of `find_leaving`.
    """
    segments, tables = schema.segments.c, schema.take_annotations
    there = {row.take_id for row in fetch_in(connection, sa.select(segments.take_id), segments.take_id, list(removed))}
    for take in removed.keys() - there:
        connection.execute(sa.delete(tables).where(tables.c.take_id == take))
    query = sa.select(*ANNOTATIONS.columns)
    changes = {}
    for row in fetch_in(connection, query, tables.c.take_id, sorted(there)):
        ANNOTATIONS.check(connection, row)
        changes[int(row.take_id)] = {"unclear": sorted([*map(list, row.unclear), *map(list, removed[row.take_id])])}
    update_rows(connection, ANNOTATIONS, changes)
