"""The index of a large library in a file of its own, from which memory takes what a search looks at.

Reading a million clips row by row takes many seconds, and each program would do it again. The file can be deleted at
any time: it is made again, and what is in it is believed only where the checksums of the library's rows are those that
it was made from (``refresh``), and its own are right. It is written beside its place and renamed, so it is there whole
or as it was before.

What a forest learns changes what it says of some clips. These go into a second, later file, which says of which first
file it is: to write half a gigabyte again for a few clips would take as long as all else.

The parts of an index as one part, put together in portions: so a file of it is written with little in memory.
"""

from __future__ import annotations

import hashlib
import json
import mmap
import os
import struct
import sys
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import IO, Any, Protocol

import numpy as np
import sqlalchemy as sa
from numpy.typing import NDArray

from dousa.arrays import BoolArray, IndexArray, IntArray
from dousa.library.search.kernels import copy_runs, recode
from dousa.library.search.leaf_index import IndexedRows, LeafIndex, make_index
from dousa.library.search.parts import ClipPart, SparseVotes, choose_code, order_table
from dousa.library.store.forests import StoredForest

_AT_ONCE = 1 << 14  # clips

Portion = list[tuple[int, IndexArray, IndexArray]]
"""Of each part its number, rows of it, and the places where they come."""


class IndexedParts(Protocol):
    """What is put together: a ``LeafIndex``, or anything like it."""

    @property
    def parts(self) -> tuple[ClipPart, ...]:
        """The clips."""

    @property
    def votes(self) -> tuple[SparseVotes, ...]:
        """Their votes."""

    @property
    def alive(self) -> tuple[BoolArray | None, ...]:
        """For each part (N,) which of its clips are as they were; None for all."""


class MergedParts:
    """The clips of an index that are as they were, in the order of their numbers.

    Parameters
    ----------
    index : of at least one part.

    Raises
    ------
    ValueError : leaves that are in two trees, which only damaged rows without checksums have.
    """

    def __init__(self, index: IndexedParts) -> None:
        rows = [
            np.arange(len(part)) if own is None else np.flatnonzero(own)
            for part, own in zip(index.parts, index.alive, strict=True)
        ]
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
        """The leaves of all parts by their trees, where those of each tree begin, and the rank of each leaf there."""
        owners = np.full(max(int(part.table.max(initial=-1)) for part in self._parts) + 1, -1, np.int32)
        for part in self._parts:
            if not part.is_by_trees:
                raise ValueError
            trees = np.repeat(np.arange(self._n_trees), np.diff(np.append(part.offsets, len(part.table))))
            if ((owners[part.table] >= 0) & (owners[part.table] != trees)).any():
                raise ValueError
            owners[part.table] = trees
        return order_table(owners, self._n_trees)

    def arrays(self) -> Iterator[tuple[str, Iterator[NDArray[Any]]]]:
        """Names and contents of the arrays of a ``ClipPart`` and, as ``votes.NAME``, of a ``SparseVotes``."""
        yield "ids", self._take([part.ids for part in self._parts])
        yield "sums", self._take([part.sums for part in self._parts])
        yield "given", self._renumber([part.given for part in self._parts])
        yield "predicted", self._renumber([part.predicted for part in self._parts])
        paths = [(_starts_of(part.path_ends), part.path_bytes) for part in self._parts]
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
        """How many clips, and where they are; at least one portion."""
        for first in range(0, max(len(self), 1), _AT_ONCE):
            owners, rows = self._owners[first : first + _AT_ONCE], self._rows[first : first + _AT_ONCE]
            own = ((number, np.flatnonzero(owners == number)) for number in range(len(self._parts)))
            yield len(rows), [(number, rows[places], places) for number, places in own if len(places)]

    def _take(self, arrays: list[Any]) -> Iterator[NDArray[Any]]:
        for count, portion in self._portions():
            out = np.empty((count, *arrays[0].shape[1:]), arrays[0].dtype)
            for number, rows, places in portion:
                out[places] = arrays[number][rows]
            yield out

    def _renumber(self, arrays: list[NDArray[np.int32]]) -> Iterator[NDArray[Any]]:
        for count, portion in self._portions():
            out = np.empty(count, np.int32)
            for number, rows, places in portion:
                out[places] = self._numbers[number][arrays[number][rows]]
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
        """Where the runs of the clips end, one after the other."""
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


def _starts_of(ends: IntArray) -> IntArray:
    return np.concatenate([np.zeros(1, np.int64), ends])


_MAGIC = b"dousa index 2\n\0\0"
_START = struct.Struct("<16sQQI")  # magic; place, length and checksum of the header, which comes last
_ALIGNED = 64
_PART = ("ids", "sums", "given", "predicted", "path_ends", "path_bytes", "codes", "table", "offsets", "directions")
_VOTES = ("starts", "categories", "votes", "squares", "lengths")


def find_place(connection: sa.Connection, where: str, kind: str = "search") -> Path:
    """Where the file of a library is: beside its own, or in the folder of caches where a server has it.

    Parameters
    ----------
    kind : what it is, at the end of its name.
    """
    if connection.dialect.name == "sqlite":
        path = next(row[2] for row in connection.exec_driver_sql("PRAGMA database_list") if row[1] == "main")
        return Path(f"{path}-{kind}")
    name = hashlib.sha256(where.encode()).hexdigest()[:32]
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "dousa" / f"{name}-{kind}"


def name_forest(stored: StoredForest) -> list[int]:
    """What votes depend on besides the leaves."""
    sums = [zlib.crc32(np.ascontiguousarray(part).data) for part in stored.forest.vote_entries]
    return [stored.revision, stored.learned, *sums]


@dataclass(frozen=True, slots=True)
class Base:
    """Which file a later one is of.

    Parameters
    ----------
    checksum : of its header, which has those of its arrays.
    categories : of the forest when it was written, in the order of its votes.
    """

    checksum: int
    categories: tuple[str, ...]


class KeptIndex(IndexedParts, Protocol):
    """What is written: a ``LeafIndex``, or anything like it."""

    @property
    def source(self) -> IndexedRows | None:
        """What it was read from."""


def write_side_file(path: Path, stored: StoredForest, index: KeptIndex) -> bool:
    """Write an index; false where that cannot be, or another program is just doing it: the file is not needed.

    Parameters
    ----------
    stored : the forest of its leaves and votes.
    """
    if index.source is None or not index.source.is_sealed:
        return False  # nobody could tell later whether it is of the library as it is
    try:
        merged = MergedParts(index)
        path.parent.mkdir(parents=True, exist_ok=True)
        with create_alone(path) as file:
            if file is not None:
                _write_file(file, stored, merged, index.source)
        if file is not None:
            with suppress(OSError):  # it is of the file before, and believed no more
                _place_later(path).unlink()
        return file is not None
    except (OSError, ValueError):
        return False


def write_later_file(path: Path, stored: StoredForest, index: KeptIndex, base: Base) -> bool:
    """Write what has changed since a file was written; false as of ``write_side_file``.

    Parameters
    ----------
    index : its first part is that of the file at the path, whose clips have their votes of that time still.
    base : of that file.
    """
    if index.source is None or not index.source.is_sealed:
        return False
    alive = index.alive[0]
    dead = np.zeros(0, np.int64) if alive is None else np.flatnonzero(~alive)
    try:
        merged = MergedParts(_Others(index))
        with create_alone(_place_later(path)) as file:
            if file is not None:
                more = {"base": base.checksum, "categories": base.categories}
                _write_file(file, stored, merged, index.source, more, dead)
        return file is not None
    except (OSError, ValueError):
        return False


def _place_later(path: Path) -> Path:
    return path.with_name(f"{path.name}-later")


class _Others:
    """All parts of an index but the first."""

    def __init__(self, index: KeptIndex) -> None:
        self.parts, self.votes, self.alive = index.parts[1:], index.votes[1:], index.alive[1:]


@contextmanager
def create_alone(path: Path) -> Iterator[IO[bytes] | None]:
    """An empty file that takes the place of another when it is written; None where another program has it.

    It has one name, so what a killed program left is written over; that it is alone with it says a lock.
    """
    temporary = path.with_name(f"{path.name}.part")
    with open(os.open(temporary, os.O_RDWR | os.O_CREAT | getattr(os, "O_BINARY", 0), 0o666), "r+b") as file:
        try:
            _lock(file)
            alone = os.path.samestat(os.fstat(file.fileno()), os.stat(temporary))  # and not renamed in between
        except OSError:
            alone = False
        if not alone:
            yield None
            return
        file.truncate(0)
        try:
            yield file
            file.flush()
            if sys.platform == "win32":  # which renames no open file
                file.close()
            os.replace(temporary, path)
        except BaseException:
            with suppress(OSError):
                os.unlink(temporary)
            raise


def _lock(file: IO[bytes]) -> None:
    """Lock a file until it is closed; OSError where another has."""
    if sys.platform == "win32":
        import msvcrt

        msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
    else:
        import fcntl

        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)


def _write_file(
    file: IO[bytes],
    stored: StoredForest,
    merged: MergedParts,
    rows: IndexedRows,
    more: Mapping[str, Any] | None = None,
    dead: IntArray | None = None,
) -> None:
    """Write the clips of an index, what they were read from, and what a later file has more."""
    file.write(bytes(_ALIGNED))  # for the start, when the rest is there
    described = []
    others = [("rows", iter([rows.sums]))] if dead is None else [("rows", iter([rows.sums])), ("dead", iter([dead]))]
    for name, portions_of_it in (*merged.arrays(), *others):
        file.write(bytes(-file.tell() % _ALIGNED))
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


@dataclass(frozen=True, slots=True, eq=False)
class KeptRows:
    """Clips as files have them: see ``refresh.KnownRows``.

    Parameters
    ----------
    parts, alive : those of the file, and of the later one where there is one.
    source : what they were read from.
    votes : of the parts; None where the forest has learned since.
    base : of the file; None where its votes are not known.
    """

    parts: tuple[ClipPart, ...]
    alive: tuple[BoolArray | None, ...]
    source: IndexedRows
    votes: tuple[SparseVotes, ...] | None
    base: Base | None


def read_side_rows(path: Path, stored: StoredForest) -> KeptRows | None:
    """The clips of a file, and of what came later; None where there is none, or a damaged one.

    Arrays stay in the files until they are looked at.
    """
    forest = name_forest(stored)
    first = _read_file(path, stored, forest)
    if first is None:
        return None
    later = _read_file(_place_later(path), stored, forest, first.checksum)
    if later is None:
        base = None if first.votes is None else Base(first.checksum, stored.categories)
        own = None if first.votes is None else (first.votes,)
        return KeptRows((first.part,), (None,), first.rows, own, base)
    try:
        alive = np.ones(len(first.part), np.bool_)
        alive[later.dead] = False
        base = None if later.votes is None else Base(first.checksum, tuple(map(str, later.header["categories"])))
        votes = None
        if base is not None and later.votes is not None:
            kept = _read_file(path, stored, None) if first.votes is None else first
            if kept is None or kept.checksum != first.checksum or kept.votes is None:
                return None
            votes = renumber_votes(kept.votes, base.categories, stored.categories), later.votes
    except (IndexError, KeyError, TypeError, ValueError):
        return None
    return KeptRows((first.part, later.part), (alive, None), later.rows, votes, base)


def renumber_votes(votes: SparseVotes, before: Sequence[str], now: Sequence[str]) -> SparseVotes:
    """The same votes for categories among which there are others; ValueError where one is gone."""
    numbers = [now.index(name) for name in before]
    if numbers == list(range(len(numbers))):
        return votes
    return replace(votes, categories=np.array(numbers, np.uint16)[votes.categories])


def read_side_file(path: Path, stored: StoredForest) -> tuple[LeafIndex, bool] | None:
    """The index in files, with arrays that stay there until they are looked at, and whether it has their votes.

    None as of ``read_side_rows``. It is of the library at some time: ``refresh_index`` brings it up to date.
    """
    kept = read_side_rows(path, stored)
    if kept is None:
        return None
    index = make_index(-1, stored, kept.source, kept.parts, kept.votes)
    return replace(index, alive=kept.alive, n_kept=len(kept.parts)), kept.votes is not None


@dataclass(frozen=True, slots=True, eq=False)
class _File:
    """What a file has; ``votes`` only where they are wanted, ``dead`` only of a later one."""

    part: ClipPart
    rows: IndexedRows
    header: dict[str, Any]
    checksum: int
    votes: SparseVotes | None
    dead: IntArray


def _read_file(path: Path, stored: StoredForest, forest: list[int] | None, base: int | None = None) -> _File | None:
    """A file; None where it is not there, damaged, of other trees, or later than another file.

    Parameters
    ----------
    forest : its votes are wanted where they are of this one; None for any.
    base : of the file that it must be later than.
    """
    try:
        with open(path, "rb") as file:
            # Numba would compile again for what cannot be written.
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
    """Arrays, of votes where these are wanted; ValueError where a checksum is wrong."""
    arrays = {}
    for name, kind, shape, start, own in described:
        if name.startswith("votes.") and not has_votes:
            continue
        array = np.frombuffer(data, kind, int(np.prod(shape)), start).reshape(shape)
        if zlib.crc32(array.data) != own:
            raise ValueError
        arrays[name] = array
    return arrays
