"""The index of a large library in a file of its own, from which memory takes what a search looks at.

Reading a million clips row by row takes many seconds, and each program would do it again. The file can be deleted at
any time: it is made again, and what is in it is believed only where the checksums of the library's rows are those that
it was made from (``refresh``), and its own are right. It is written beside its place and renamed, so it is there whole
or as it was before.
"""

from __future__ import annotations

import hashlib
import json
import mmap
import os
import struct
import sys
import zlib
from collections.abc import Collection, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, Protocol

import numpy as np
import sqlalchemy as sa
from numpy.typing import NDArray

from dousa.library.forests import StoredForest
from dousa.library.index.leaf_index import IndexedRows, LeafIndex
from dousa.library.index.merging import IndexedParts, MergedParts
from dousa.library.index.parts import ClipPart, SparseVotes
from dousa.library.index.refresh import make_index

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
        return file is not None
    except (OSError, ValueError):
        return False


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


def _write_file(file: IO[bytes], stored: StoredForest, merged: MergedParts, rows: IndexedRows) -> None:
    file.write(bytes(_ALIGNED))  # for the start, when the rest is there
    described = []
    for name, portions_of_it in (*merged.arrays(), ("rows", iter([rows.sums]))):
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
    }
    text, place = json.dumps(header).encode(), file.tell()
    file.write(text)
    file.seek(0)
    file.write(_START.pack(_MAGIC, place, len(text), zlib.crc32(text)))


def read_side_file(path: Path, stored: StoredForest) -> tuple[LeafIndex, bool] | None:
    """The index in a file, with arrays that stay there until they are looked at, and whether it has their votes.

    None where there is none, or a damaged one. It is of the library at some time: ``refresh_index`` brings it up to
    date.
    """
    found = _read_file(path, stored)
    if found is None:
        return None
    part, rows, header, arrays = found
    try:
        votes = None
        if header["forest"] == name_forest(stored):
            votes = SparseVotes(*(arrays[f"votes.{name}"] for name in _VOTES))
    except (KeyError, TypeError):
        return None
    return make_index(-1, stored, rows, part, votes), votes is not None


@dataclass(frozen=True, slots=True, eq=False)
class SideRows:
    """Clips as a file has them, without votes: see ``refresh.KnownRows``."""

    parts: tuple[ClipPart]
    alive: tuple[None]
    source: IndexedRows


def read_side_rows(path: Path, stored: StoredForest) -> SideRows | None:
    """The clips of a file, without their votes; None as of ``read_side_file``."""
    found = _read_file(path, stored, {*_PART, "rows"})
    return None if found is None else SideRows((found[0],), (None,), found[1])


def _read_file(
    path: Path, stored: StoredForest, wanted: Collection[str] | None = None
) -> tuple[ClipPart, IndexedRows, dict[str, Any], dict[str, NDArray[Any]]] | None:
    """The clips in a file, its header and arrays; of these all, or those that are wanted and read."""
    try:
        with open(path, "rb") as file:
            # Numba would compile again for what cannot be written.
            data = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_COPY)
    except (OSError, ValueError):
        return None
    try:
        header, arrays = _read_arrays(data, wanted)
        if header["forest"][0] != stored.revision:
            return None
        fields = {name: arrays.get(name) for name in _PART}
        part = ClipPart(**fields, names=tuple(header["names"]))  # type: ignore[arg-type]
        rows = IndexedRows(arrays["rows"], {int(number): str(absent) for number, absent in header["partial"]})
        if part.codes.shape[1:] != (len(stored.forest.trees_.roots),):
            return None
    except (AttributeError, KeyError, TypeError, ValueError, struct.error):
        return None
    return part, rows, header, arrays


def _read_arrays(data: mmap.mmap, wanted: Collection[str] | None) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """The header and the arrays, or those that are wanted; ValueError where a checksum is wrong."""
    magic, place, length, checksum = _START.unpack_from(data)
    text = data[place : place + length]
    if magic != _MAGIC or zlib.crc32(text) != checksum:
        raise ValueError
    header: dict[str, Any] = json.loads(text)
    arrays = {}
    for name, kind, shape, start, own in header["arrays"]:
        if wanted is not None and name not in wanted:
            continue
        array = np.frombuffer(data, kind, int(np.prod(shape)), start).reshape(shape)
        if zlib.crc32(array.data) != own:
            raise ValueError
        arrays[name] = array
    return header, arrays
