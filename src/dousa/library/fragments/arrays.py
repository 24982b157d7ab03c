"""Positions and features of rows, wherever they lie: in the row, or in a fragment that the row names.

Whoever writes such rows hands them to ``put_aside``, and whoever reads them asks ``read_blocks``. Checksums stand in
the database and are of the bytes themselves, so that nothing changes for who compares them. Blocks are written while
the others wait to write, before the transaction that names them ends: a fragment has all that rows name.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import sqlalchemy as sa

from dousa.errors import LibraryDamagedError
from dousa.library import schema
from dousa.library.engine import BESIDE
from dousa.library.fragments.store import FragmentStore, Place, open_fragments
from dousa.library.schema import PLACE, array_store
from dousa.library.seals.checksums import FEATURES, LIBRARY_NAME, STORE
from dousa.library.selection import fetch_in

ARRAYS = (
    schema.clip_trajectories.c.positions,
    schema.clip_features.c.pose_features,
    schema.removed_positions.c.positions,
)
"""The columns whose bytes may lie in fragments."""

_READ_AT_ONCE = 2**24  # bytes


def find_store(connection: sa.Connection) -> FragmentStore | None:
    """Where new blocks go; None where they stay in their rows."""
    row = connection.execute(sa.select(*STORE.columns)).one_or_none()
    if row is None:
        return None
    STORE.check(connection, row)
    return _open(connection, row.place)


def _open(connection: sa.Connection, place: str) -> FragmentStore:
    options = connection.get_execution_options()
    return open_fragments(place, options.get(BESIDE), str(options.get(LIBRARY_NAME, "")))


def open_store(connection: sa.Connection) -> FragmentStore:
    """Where the blocks are that rows name."""
    return find_store(connection) or _open(connection, "")


def put_aside(connection: sa.Connection, rows: Sequence[Mapping[str, Any]], column: str) -> list[dict[str, Any]]:
    """Rows that are going to be written, after their blocks were, where the library has fragments.

    Parameters
    ----------
    rows : with their checksums, all of one table.
    column : name of the one that has the bytes.
    """
    store = find_store(connection) if rows else None
    if store is None:
        return [{**row, **dict.fromkeys(PLACE)} for row in rows]
    places = store.append([row[column] for row in rows])
    return [{**row, column: b"", **place._asdict()} for row, place in zip(rows, places, strict=True)]


def place_of(row: Any) -> Place | None:
    """Where the bytes of a row lie; None where they are in the row."""
    return None if row.fragment is None else Place(row.fragment, row.first_byte or 0, row.n_bytes or 0)


def read_blocks(connection: sa.Connection, rows: Sequence[Any], column: str) -> list[bytes]:
    """The bytes of rows, in their order.

    Parameters
    ----------
    rows : with the columns ``PLACE`` and the one that has the bytes.
    column : its name.

    Raises
    ------
    LibraryDamagedError : a fragment is missing or too short.
    """
    return read_places(connection, [(row._mapping[column], place_of(row)) for row in rows])


def read_places(connection: sa.Connection, blocks: Sequence[tuple[bytes, Place | None]]) -> list[bytes]:
    """As ``read_blocks``, of bytes and places that were found; a place stands before the bytes."""
    wanted = [place for _, place in blocks if place is not None]
    if not wanted:
        return [data for data, _ in blocks]
    store = open_store(connection)
    found = store.read(wanted)
    for place, data in zip(wanted, found, strict=True):
        if len(data) != place.n_bytes:
            raise _incomplete(connection, store, place)
    blocks_found = iter(found)
    return [data if place is None else next(blocks_found) for data, place in blocks]


def _incomplete(connection: sa.Connection, store: FragmentStore, place: Place) -> LibraryDamagedError:
    library = connection.get_execution_options().get(LIBRARY_NAME, "")
    code = "library_fragments.cut_short" if place.fragment in store.sizes() else "library_fragments.missing"
    return LibraryDamagedError(code, library=library, fragment=place.fragment, where=store.where)


def look_at_blocks(connection: sa.Connection, rows: Sequence[Any], column: str) -> list[bytes]:
    """As ``read_blocks``, for who looks for damage: what is not there is empty or too short."""
    wanted = [place for place in map(place_of, rows) if place is not None]
    found = iter(open_store(connection).read(wanted) if wanted else ())
    return [row._mapping[column] if place_of(row) is None else next(found) for row in rows]


def in_portions(rows: Iterable[Any]) -> Iterator[list[Any]]:
    """Rows of positions, so many at a time that memory holds little of them, as they come."""
    some: list[Any] = []
    size = 0
    for row in rows:
        some.append(row)
        size += len(row.positions) if row.fragment is None else row.n_bytes or 0
        if size >= _READ_AT_ONCE:
            yield some
            some, size = [], 0
    if some:
        yield some


class FeatureRow(NamedTuple):
    """The columns of ``FEATURES``, wherever the features lie."""

    clip_id: int
    feature_set: str
    pose_features: bytes
    checksum: int | None


_FEATURES = sa.select(*FEATURES.columns, *(schema.clip_features.c[name] for name in PLACE))


def read_feature_rows(connection: sa.Connection, ids: Sequence[int]) -> list[FeatureRow]:
    """Rows of features that are there, in any order; LibraryDamagedError as of ``read_blocks``."""
    rows = list(fetch_in(connection, _FEATURES, schema.clip_features.c.clip_id, ids))
    return _with_features(rows, read_blocks(connection, rows, "pose_features"))


def look_at_feature_rows(connection: sa.Connection, ids: Sequence[int]) -> list[FeatureRow]:
    """As ``read_feature_rows``, for who looks for damage."""
    rows = list(fetch_in(connection, _FEATURES, schema.clip_features.c.clip_id, ids))
    return _with_features(rows, look_at_blocks(connection, rows, "pose_features"))


def _with_features(rows: Sequence[Any], blocks: Sequence[bytes]) -> list[FeatureRow]:
    found = zip(rows, blocks, strict=True)
    return [FeatureRow(row.clip_id, row.feature_set, data, row.checksum) for row, data in found]


def begin_store(connection: sa.Connection, place: str) -> None:
    """New blocks go to fragments from now on, in a folder or at a URL; empty for those beside a library file."""
    row = {"id": 1, "place": place}
    row["checksum"] = STORE.compute([row[column.name] for column in STORE.covered])
    connection.execute(sa.delete(array_store))
    connection.execute(sa.insert(array_store).values(**row))
