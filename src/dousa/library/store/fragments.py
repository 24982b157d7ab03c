"""Positions and features of rows, stored in the row or in a fragment that the row names.

Writers pass such rows to ``put_aside``, readers call ``read_blocks``. Checksums are in the database and cover the bytes
themselves. Blocks are written under the write lock, before the transaction that names them ends, so that a fragment has
all that rows name. Fragments are append-only files of blocks of bytes, in a folder or in object storage.
"""

from __future__ import annotations

import errno
import os
import re
import secrets
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import sqlalchemy as sa

from dousa.errors import LibraryDamagedError, LibraryError
from dousa.extras import require
from dousa.files.disk import sync_folder
from dousa.library.store import schema
from dousa.library.store.checksums import FEATURES, LIBRARY_NAME, STORE
from dousa.library.store.engine import BESIDE
from dousa.library.store.rows import fetch_in, fetch_rows, insert_rows
from dousa.library.store.schema import PLACE, array_store

MOST_BYTES = 2**28
"""Size at which a fragment is closed and another begun (docs/libraries.md); larger ones take longer to rewrite."""

_NAME = re.compile(r"\d{6,}-[0-9a-f]{8}\.blocks")
_EXTRAS = {"s3": ("s3fs", "s3"), "s3a": ("s3fs", "s3")}  # package and extra of dousa, by URL scheme


class Place(NamedTuple):
    """The place of a block: name of the fragment, first byte in it, and number of bytes."""

    fragment: str
    first_byte: int
    n_bytes: int


def is_name(name: Any) -> bool:
    """Return whether a fragment can have this name."""
    return isinstance(name, str) and _NAME.fullmatch(name) is not None


def make_name(known: Sequence[str]) -> str:
    """Return a unique name for a new fragment, which sorts after the others."""
    last = max((int(name.partition("-")[0]) for name in known), default=0)
    return f"{last + 1:06}-{secrets.token_hex(4)}.blocks"


class FolderFragments:
    """Fragments as files of a folder, made when the first block is written.

    ``library`` : its name in messages; ``where`` is that of the store.
    """

    def __init__(self, folder: Path, library: str, *, full: int = MOST_BYTES) -> None:
        self.folder, self.library, self.where, self.full = folder, library, os.fspath(folder), full

    def append(self, blocks: Sequence[bytes], into: str | None = None) -> list[Place]:
        """Write blocks to disk, into a fragment of this name if possible."""
        with _plain_errors(self.library, self.where):
            self.folder.mkdir(parents=True, exist_ok=True)
            name = into or self._choose()
            path = self.folder / name
            is_new = not path.exists()
            with open(path, "ab") as file:
                end = file.seek(0, os.SEEK_END)
                file.writelines(blocks)
                file.flush()
                os.fsync(file.fileno())
            if is_new:
                sync_folder(self.folder)
        return list(_lay_out(name, end, blocks))

    def _choose(self) -> str:
        sizes = self.sizes()
        newest = max(sizes, default=None)
        return newest if newest is not None and sizes[newest] < self.full else make_name(list(sizes))

    def read(self, places: Sequence[Place]) -> list[bytes]:
        """Read blocks in the order of their places; missing or incomplete ones are shorter."""
        found = [b""] * len(places)
        by_name: dict[str, list[int]] = {}
        for number, place in enumerate(places):
            if is_name(place.fragment) and place.first_byte >= 0 and place.n_bytes >= 0:
                by_name.setdefault(place.fragment, []).append(number)
        with _plain_errors(self.library, self.where):
            for name, numbers in by_name.items():
                with suppress(FileNotFoundError, NotADirectoryError), open(self.folder / name, "rb") as file:
                    size = os.fstat(file.fileno()).st_size
                    for number in numbers:
                        _, first, length = places[number]
                        file.seek(min(first, size))
                        found[number] = file.read(min(length, size))
        return found

    def sizes(self) -> dict[str, int]:
        """Return the bytes of all fragments, by name."""
        with _plain_errors(self.library, self.where):
            if not self.folder.is_dir():
                return {}
            with os.scandir(self.folder) as entries:
                return {entry.name: entry.stat().st_size for entry in entries if is_name(entry.name)}

    def delete(self, name: str) -> None:
        """Delete a fragment, and the folder with the last one."""
        with _plain_errors(self.library, self.where), suppress(FileNotFoundError):
            os.unlink(self.folder / name)
        with suppress(OSError):
            self.folder.rmdir()


class ObjectFragments:
    """Fragments as objects below a URL that fsspec supports, such as ``s3://bucket/moves``; as ``FolderFragments``."""

    def __init__(self, url: str, library: str, *, full: int = MOST_BYTES) -> None:
        self.library, self.where, self.full = library, url, full
        kind = url.partition("://")[0]
        if kind in _EXTRAS:
            require(*_EXTRAS[kind])
        core = require("fsspec.core", "s3")
        with _plain_errors(library, url):
            self._files, self._root = core.url_to_fs(url)

    def append(self, blocks: Sequence[bytes], into: str | None = None) -> list[Place]:
        """Write blocks, always into a new fragment."""
        name = f"{int(time.time()):010}-{secrets.token_hex(4)}.blocks"  # needs no list of existing fragments
        with _plain_errors(self.library, self.where):
            self._files.pipe_file(f"{self._root}/{name}", b"".join(blocks))
        return list(_lay_out(name, 0, blocks))

    def read(self, places: Sequence[Place]) -> list[bytes]:
        """Read blocks in the order of their places; neighbours are read together."""
        spans = _join([place for place in places if is_name(place.fragment)], self.full)
        paths = [f"{self._root}/{name}" for name, _, _ in spans]
        starts, ends = [first for _, first, _ in spans], [first + n for _, first, n in spans]
        with _plain_errors(self.library, self.where):
            got = self._files.cat_ranges(paths, starts, ends, on_error="return") if spans else []
            for one in got:
                if isinstance(one, Exception) and not isinstance(one, FileNotFoundError):
                    raise one
        data = {span: b"" if isinstance(one, Exception) else one for span, one in zip(spans, got, strict=True)}
        found = []
        for place in places:
            offsets = {span: place.first_byte - span.first_byte for span in data if span.fragment == place.fragment}
            own = [span for span, offset in offsets.items() if 0 <= offset <= span.n_bytes - place.n_bytes]
            start = offsets[own[0]] if own else 0
            found.append(data[own[0]][start : start + place.n_bytes] if own else b"")
        return found

    def sizes(self) -> dict[str, int]:
        """Return the bytes of all fragments, by name."""
        with _plain_errors(self.library, self.where), suppress(FileNotFoundError):
            self._files.invalidate_cache(self._root)
            listed = self._files.ls(self._root, detail=True)
            found = {one["name"].rpartition("/")[2]: int(one["size"] or 0) for one in listed}
            return {name: size for name, size in found.items() if is_name(name)}
        return {}

    def delete(self, name: str) -> None:
        """Delete a fragment."""
        with _plain_errors(self.library, self.where), suppress(FileNotFoundError):
            self._files.rm_file(f"{self._root}/{name}")


FragmentStore: TypeAlias = FolderFragments | ObjectFragments


def _join(places: Sequence[Place], most: int, *, gap: int = 2**16) -> list[Place]:
    """Join places to spans of ``most`` bytes, with gaps of so many bytes: a larger gap saves requests, not bytes."""
    spans: list[Place] = []
    for place in sorted(set(places)):
        last = spans[-1] if spans else None
        end = place.first_byte + place.n_bytes
        if last is not None and last.fragment == place.fragment:
            reached = last.first_byte + last.n_bytes
            if place.first_byte <= reached + gap and end - last.first_byte <= most:
                spans[-1] = last._replace(n_bytes=max(end, reached) - last.first_byte)
                continue
        spans.append(place)
    return spans


def _lay_out(name: str, start: int, blocks: Sequence[bytes]) -> Iterator[Place]:
    for block in blocks:
        yield Place(name, start, len(block))
        start += len(block)


def _list_client_errors() -> tuple[type[Exception], ...]:
    """Return the errors of object storage clients besides system errors."""
    module = sys.modules.get("botocore.exceptions")
    return () if module is None else (module.BotoCoreError, module.ClientError)


@contextmanager
def _plain_errors(library: str, where: str) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            raise LibraryError("library_fragments.disk_full", library=library, where=where) from error
        raise LibraryError("library_fragments.unusable", library=library, where=where, reason=error) from error
    except Exception as error:
        # ValueError: a URL scheme unknown to fsspec; ImportError: its package is not installed.
        if not isinstance(error, (ValueError, ImportError, *_list_client_errors())):
            raise
        raise LibraryError("library_fragments.unusable", library=library, where=where, reason=error) from error


ARRAYS = (
    schema.clip_trajectories.c.positions,
    schema.clip_features.c.pose_features,
    schema.removed_positions.c.positions,
)
"""The columns whose bytes may be in fragments."""


def find_store(connection: sa.Connection) -> FragmentStore | None:
    """Return the store for new blocks; None if they stay in their rows."""
    row = next(fetch_rows(connection, STORE), None)
    return None if row is None else _open(connection, row.place)


def _open(connection: sa.Connection, place: str) -> FragmentStore:
    """Open the fragments of a library at a folder or URL; those of a library file are in the folder beside it."""
    options = connection.get_execution_options()
    beside, library = options.get(BESIDE), str(options.get(LIBRARY_NAME, ""))
    # Do not trust places named in a file: it may come from an unknown source.
    if beside is not None:
        return FolderFragments(beside, library)
    if "://" in place and not place.startswith("file://"):
        return ObjectFragments(place, library)
    return FolderFragments(Path(place.removeprefix("file://")), library)


def open_store(connection: sa.Connection) -> FragmentStore:
    """Return the store of the blocks that rows name."""
    return find_store(connection) or _open(connection, "")


def put_aside(connection: sa.Connection, rows: Sequence[Mapping[str, Any]], column: str) -> list[dict[str, Any]]:
    """Return rows of one table, with checksums, to write; in a library with fragments their blocks are written first.

    ``column`` is the name of the column with the bytes.
    """
    store = find_store(connection) if rows else None
    if store is None:
        return [{**row, **dict.fromkeys(PLACE)} for row in rows]
    places = store.append([row[column] for row in rows])
    return [{**row, column: b"", **place._asdict()} for row, place in zip(rows, places, strict=True)]


def place_of(row: Any) -> Place | None:
    """Return the place of the bytes of a row; None if they are in the row."""
    return None if row.fragment is None else Place(row.fragment, row.first_byte or 0, row.n_bytes or 0)


def read_blocks(connection: sa.Connection, rows: Sequence[Any], column: str) -> list[bytes]:
    """Read the bytes of rows, in their order; LibraryDamagedError if a fragment is missing or too short.

    ``rows`` : with the columns ``PLACE`` and the one with the bytes.
    ``column`` : its name.
    """
    return read_places(connection, [(row._mapping[column], place_of(row)) for row in rows])


def read_places(connection: sa.Connection, blocks: Sequence[tuple[bytes, Place | None]]) -> list[bytes]:
    """Return bytes as ``read_blocks``; those with a place are read from there."""
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
    """Read blocks as ``read_blocks``, to find damage: missing bytes are empty or too short."""
    wanted = [place for place in map(place_of, rows) if place is not None]
    found = iter(open_store(connection).read(wanted) if wanted else ())
    return [row._mapping[column] if place_of(row) is None else next(found) for row in rows]


def in_portions(rows: Iterable[Any], *, n_bytes: int = 2**24) -> Iterator[list[Any]]:
    """Yield rows of positions in portions of about ``n_bytes``, so that they fit in memory."""
    some: list[Any] = []
    size = 0
    for row in rows:
        some.append(row)
        size += len(row.positions) if row.fragment is None else row.n_bytes or 0
        if size >= n_bytes:
            yield some
            some, size = [], 0
    if some:
        yield some


_FEATURES = sa.select(*FEATURES.columns, *(schema.clip_features.c[name] for name in PLACE))


def read_feature_rows(
    connection: sa.Connection,
    ids: Sequence[int],
    read: Callable[[sa.Connection, Sequence[Any], str], list[bytes]] = read_blocks,
) -> list[tuple[Any, ...]]:
    """Read existing rows of features, with the columns of ``FEATURES``, in any order.

    ``read`` reads the features in rows and fragments: ``read_blocks``, or ``look_at_blocks`` to find damage.
    """
    rows = list(fetch_in(connection, _FEATURES, schema.clip_features.c.clip_id, ids))
    found = zip(rows, read(connection, rows, "pose_features"), strict=True)
    return [(row.clip_id, row.feature_set, data, row.checksum) for row, data in found]


def begin_store(connection: sa.Connection, place: str) -> None:
    """Let new blocks go to fragments, in a folder or at a URL; empty for beside a library file."""
    connection.execute(sa.delete(array_store))
    insert_rows(connection, array_store, [{"id": 1, "place": place}])
