"""The index of a large library in a memory-mapped file, as reading a million clips row by row takes many seconds.

The file can be deleted at any time. It is used only where its own checksums are right and those of the library's rows
are as it recorded them (``leaf_index.refresh_index``). It is renamed into place, so it is always whole. Clips that
changed as a forest learned go into a second, later file, as writing half a gigabyte again would take too long.
"""

from __future__ import annotations

import hashlib
import json
import mmap
import os
import struct
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import IO, Any

import numpy as np
import sqlalchemy as sa
from numpy.typing import NDArray

from dousa.arrays import IndexArray, IntArray
from dousa.files.disk import create_alone
from dousa.library.search.kernels import copy_runs, recode
from dousa.library.search.leaf_index import Base, IndexedRows, LeafIndex, ReadClips, make_index
from dousa.library.search.parts import ClipPart, SparseVotes, choose_code, order_table
from dousa.library.store.forests import StoredForest

Portion = list[tuple[int, IndexArray, IndexArray]]
"""For each part its number, rows of it, and their places in the portion."""


class MergedParts:
    """The unchanged clips of an index of at least one part, sorted by number and merged in portions to save memory.

    ``at_once`` : clips of a portion.
    """

    def __init__(self, index: ReadClips, *, at_once: int = 1 << 14) -> None:
        self._at_once = at_once
        rows = [np.flatnonzero(own) for own in index.list_alive()]
        used = [number for number, some in enumerate(rows) if len(some)] or [0]
        self._parts = tuple(index.parts[number] for number in used)
        self._votes = tuple(index.votes[number] for number in used)
        rows = [rows[number] for number in used]
        ids = np.concatenate([part.ids[some] for part, some in zip(self._parts, rows, strict=True)])
        order = np.argsort(ids, kind="stable")
        self._owners = np.repeat(np.arange(len(rows), dtype=np.int16), [len(some) for some in rows])[order]
        self._rows = np.concatenate(rows)[order]
        self.names = tuple(dict.fromkeys(name for part in self._parts for name in part.names))
        self._numbers = [np.array([*map(self.names.index, part.names), -1], np.int32) for part in self._parts]
        self._n_trees = self._parts[0].codes.shape[1]
        self._table, self._offsets, self._ranks = self._order_leaves()

    def __len__(self) -> int:
        return len(self._rows)

    def _order_leaves(self) -> tuple[NDArray[np.int32], IntArray, IntArray]:
        """Return the leaves of all parts as ``order_table`` does."""
        owners = np.full(max(int(part.table.max(initial=-1)) for part in self._parts) + 1, -1, np.int32)
        for part in self._parts:
            owners[part.table] = np.repeat(np.arange(self._n_trees), np.diff(np.append(part.offsets, len(part.table))))
        return order_table(owners, self._n_trees)

    def arrays(self) -> Iterator[tuple[str, Iterator[NDArray[Any]]]]:
        """Yield the names and arrays of a ``ClipPart`` and, as ``votes.NAME``, of a ``SparseVotes``."""
        yield "ids", self._take([part.ids for part in self._parts])
        yield "sums", self._take([part.sums for part in self._parts])
        yield "given", self._take([part.given for part in self._parts], self._numbers)
        yield "predicted", self._take([part.predicted for part in self._parts], self._numbers)
        paths = [(np.append(np.int64(0), part.path_ends), part.path_bytes) for part in self._parts]
        yield "path_ends", self._ends([starts for starts, _ in paths])
        yield "path_bytes", self._runs([starts for starts, _ in paths], [own for _, own in paths])
        yield "codes", self._codes()
        yield "table", iter([self._table])
        yield "offsets", iter([self._offsets])
        if all(part.directions is not None for part in self._parts):
            yield "directions", self._take([part.directions for part in self._parts])
        starts = [votes.starts for votes in self._votes]
        yield "votes.starts", self._ends(starts, np.zeros(1, np.int64))
        yield "votes.categories", self._runs(starts, [votes.categories for votes in self._votes])
        yield "votes.votes", self._runs(starts, [votes.votes for votes in self._votes])
        yield "votes.squares", self._take([votes.squares for votes in self._votes])
        yield "votes.lengths", self._take([votes.lengths for votes in self._votes])

    def _portions(self) -> Iterator[tuple[int, Portion]]:
        """Yield the number of clips and their places for each portion; at least one."""
        for first in range(0, max(len(self), 1), self._at_once):
            owners, rows = self._owners[first : first + self._at_once], self._rows[first : first + self._at_once]
            own = ((number, np.flatnonzero(owners == number)) for number in range(len(self._parts)))
            yield len(rows), [(number, rows[places], places) for number, places in own if len(places)]

    def _take(self, arrays: list[Any], numbers: list[NDArray[np.int32]] | None = None) -> Iterator[NDArray[Any]]:
        """Yield the values of arrays, or what the ``numbers`` of each part have in their places."""
        for count, portion in self._portions():
            out = np.empty((count, *arrays[0].shape[1:]), arrays[0].dtype)
            for number, rows, places in portion:
                own = arrays[number][rows]
                out[places] = own if numbers is None else numbers[number][own]
            yield out

    def _codes(self) -> Iterator[NDArray[Any]]:
        kind = choose_code(self._ranks)
        ranks = [self._ranks[part.table] for part in self._parts]
        for count, portion in self._portions():
            out = np.empty((count, self._n_trees), kind)
            for number, rows, places in portion:
                part = self._parts[number]
                recode(part.codes, rows, part.offsets, ranks[number], places, out)
            yield out

    def _lengths(self, starts: list[IntArray]) -> Iterator[tuple[Portion, IntArray]]:
        for count, portion in self._portions():
            lengths = np.zeros(count, np.int64)
            for number, rows, places in portion:
                lengths[places] = starts[number][rows + 1] - starts[number][rows]
            yield portion, lengths

    def _ends(self, starts: list[IntArray], before: IntArray | None = None) -> Iterator[NDArray[Any]]:
        """Yield the ends of the runs of the clips."""
        if before is not None:
            yield before
        end = 0
        for _, lengths in self._lengths(starts):
            ends = end + np.cumsum(lengths)
            end = int(ends[-1]) if len(ends) else end
            yield ends

    def _runs(self, starts: list[IntArray], values: list[NDArray[Any]]) -> Iterator[NDArray[Any]]:
        for portion, lengths in self._lengths(starts):
            ends = np.cumsum(lengths)
            out = np.empty(int(ends[-1]) if len(ends) else 0, values[0].dtype)
            for number, rows, places in portion:
                copy_runs(values[number], starts[number], rows, ends[places], out)
            yield out


_MAGIC = b"dousa index 3\n\0\0"
_START = struct.Struct("<16sQQI")  # magic; place, length and checksum of the header at the end
_PART = ("ids", "sums", "given", "predicted", "path_ends", "path_bytes", "codes", "table", "offsets", "directions")
_VOTES = ("starts", "categories", "votes", "squares", "lengths")


def find_place(connection: sa.Connection, where: str, kind: str = "search") -> Path:
    """Return the path of a file of a library, beside an SQLite file or else in the user's cache; ``kind`` ends it."""
    if connection.dialect.name == "sqlite":
        path = next(row[2] for row in connection.exec_driver_sql("PRAGMA database_list") if row[1] == "main")
        return Path(f"{path}-{kind}")
    name = hashlib.sha256(where.encode()).hexdigest()[:32]
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "dousa" / f"{name}-{kind}"


def name_forest(stored: StoredForest) -> list[int]:
    """Return numbers that identify the forest and its votes."""
    sums = [zlib.crc32(np.ascontiguousarray(part).data) for part in stored.forest.vote_entries]
    return [stored.revision, stored.learned, *sums]


def write_side_file(path: Path, stored: StoredForest, index: ReadClips, base: Base | None = None) -> bool:
    """Write an index of a forest; return False if it cannot be written or another program is writing it.

    ``base`` : of the file at ``path``, if only the changes since are written, into a later one: then the first part of
    the index is that of the file, and its unchanged clips have the same votes.
    """
    if index.source is None:
        return False
    place, written, more, dead = path, index, None, None
    if base is not None:
        place, dead = _place_later(path), np.flatnonzero(~index.list_alive()[0])
        written = replace(index, parts=index.parts[1:], votes=index.votes[1:], alive=index.alive[1:])
        more = {"base": base.checksum, "categories": base.categories}
    try:
        merged = MergedParts(written)
        path.parent.mkdir(parents=True, exist_ok=True)
        with create_alone(place) as file:
            if file is not None:
                _write_file(file, stored, merged, index.source, more, dead)
        if file is not None and base is None:
            with suppress(OSError):  # it belongs to the previous file
                _place_later(path).unlink()
        return file is not None
    except (OSError, ValueError):
        return False


def _place_later(path: Path) -> Path:
    return path.with_name(f"{path.name}-later")


def _write_file(
    file: IO[bytes],
    stored: StoredForest,
    merged: MergedParts,
    rows: IndexedRows,
    more: Mapping[str, Any] | None = None,
    dead: IntArray | None = None,
    *,
    aligned: int = 64,
) -> None:
    """Write the clips of an index, the checksums of their rows, and the extras of a later file.

    Arrays begin at multiples of ``aligned`` bytes, such as a line of the processor's cache.
    """
    file.write(bytes(aligned))  # for the start, which is written last
    described = []
    others = [("rows", iter([rows.sums]))] if dead is None else [("rows", iter([rows.sums])), ("dead", iter([dead]))]
    for name, portions_of_it in (*merged.arrays(), *others):
        file.write(bytes(-file.tell() % aligned))
        place, count, checksum = file.tell(), 0, 0
        for array in portions_of_it:
            data = np.ascontiguousarray(array)
            file.write(data.data)
            count, checksum = count + len(data), zlib.crc32(data.data, checksum)
        described.append([name, data.dtype.str, [count, *data.shape[1:]], place, checksum])
    header = {
        "arrays": described,
        "forest": name_forest(stored),
        "names": merged.names,
        "partial": sorted(rows.partial.items()),
        **(more or {}),
    }
    text, place = json.dumps(header).encode(), file.tell()
    file.write(text)
    file.seek(0)
    file.write(_START.pack(_MAGIC, place, len(text), zlib.crc32(text)))


def read_side_rows(path: Path, stored: StoredForest) -> ReadClips | None:
    """Map the clips of a file and of its later one; None if the file is missing or damaged.

    There are no votes if the forest has learned since.
    """
    forest = name_forest(stored)
    first = _read_file(path, stored, forest)
    if first is None:
        return None
    later = _read_file(_place_later(path), stored, forest, first.checksum)
    if later is None:
        base = None if first.votes is None else Base(first.checksum, stored.categories)
        return ReadClips((first.part,), () if first.votes is None else (first.votes,), (None,), first.rows, base)
    try:
        alive = np.ones(len(first.part), np.bool_)
        alive[later.dead] = False
        base = None if later.votes is None else Base(first.checksum, tuple(map(str, later.header["categories"])))
        votes: tuple[SparseVotes, ...] = ()
        if base is not None and later.votes is not None:
            kept = _read_file(path, stored, None) if first.votes is None else first
            if kept is None or kept.checksum != first.checksum or kept.votes is None:
                return None
            votes = renumber_votes(kept.votes, base.categories, stored.categories), later.votes
    except (IndexError, KeyError, TypeError, ValueError):
        return None
    return ReadClips((first.part, later.part), votes, (alive, None), later.rows, base)


def renumber_votes(votes: SparseVotes, before: Sequence[str], now: Sequence[str]) -> SparseVotes:
    """Renumber the categories of votes from one list of names to another; ValueError if one is missing."""
    numbers = [now.index(name) for name in before]
    if numbers == list(range(len(numbers))):
        return votes
    return replace(votes, categories=np.array(numbers, np.uint16)[votes.categories])


def read_side_file(path: Path, stored: StoredForest) -> tuple[LeafIndex, bool] | None:
    """Map the index in files, and return whether it has their votes; None as ``read_side_rows`` does.

    It may be out of date: see ``refresh_index``.
    """
    kept = read_side_rows(path, stored)
    if kept is None or kept.source is None:
        return None
    index = make_index(-1, stored, kept.source, kept.parts, kept.votes or None)
    return replace(index, alive=kept.alive, n_kept=len(kept.parts)), bool(kept.votes)


@dataclass(frozen=True, slots=True, eq=False)
class _File:
    """The contents of a file; ``votes`` if wanted, ``dead`` (rows of the first file) of a later one."""

    part: ClipPart
    rows: IndexedRows
    header: dict[str, Any]
    checksum: int
    votes: SparseVotes | None
    dead: IntArray


def _read_file(path: Path, stored: StoredForest, forest: list[int] | None, base: int | None = None) -> _File | None:
    """Map a file; None if it is missing, damaged, or of other trees or another ``base``.

    ``forest`` : votes are read if they are of this forest; None for any.
    ``base`` : checksum of the first file that a later one must belong to.
    """
    try:
        with open(path, "rb") as file:
            # Numba would compile again for read-only arrays.
            data = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_COPY)
    except (OSError, ValueError):
        return None
    try:
        magic, place, length, checksum = _START.unpack_from(data)
        text = data[place : place + length]
        if magic != _MAGIC or zlib.crc32(text) != checksum:
            return None
        header: dict[str, Any] = json.loads(text)
        if header["forest"][0] != stored.revision or header.get("base") != base:
            return None
        has_votes = forest is None or header["forest"] == forest
        arrays = _read_arrays(data, header["arrays"], has_votes)
        fields = {name: arrays.get(name) for name in _PART}
        part = ClipPart(**fields, names=tuple(header["names"]))  # type: ignore[arg-type]
        rows = IndexedRows(arrays["rows"], {int(number): str(absent) for number, absent in header["partial"]})
        if part.codes.shape[1:] != (len(stored.forest.trees_.roots),):
            return None
        votes = SparseVotes(*(arrays[f"votes.{name}"] for name in _VOTES)) if has_votes else None
        dead = arrays.get("dead", np.zeros(0, np.int64))
    except (AttributeError, KeyError, TypeError, ValueError, struct.error):
        return None
    return _File(part, rows, header, checksum, votes, dead)


def _read_arrays(data: mmap.mmap, described: Sequence[Any], has_votes: bool) -> dict[str, NDArray[Any]]:
    """Map the arrays, those of votes if wanted; ValueError for a wrong checksum."""
    arrays = {}
    for name, kind, shape, start, own in described:
        if name.startswith("votes.") and not has_votes:
            continue
        array = np.frombuffer(data, kind, int(np.prod(shape)), start).reshape(shape)
        if zlib.crc32(array.data) != own:
            raise ValueError
        arrays[name] = array
    return arrays
