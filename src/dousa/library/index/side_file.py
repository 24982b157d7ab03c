"""The index of a large library in a file of its own, from which memory takes what a search looks at.

Reading a million clips row by row takes many seconds, and each program would do it again. The file can be deleted at
any time: it is made again, and what is in it is believed only where the checksums of the library's rows are those that
it was made from (``refresh``), and its own are right.
"""

from __future__ import annotations

import hashlib
import json
import mmap
import os
import struct
import zlib
from collections.abc import Collection
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import sqlalchemy as sa
from numpy.typing import NDArray

from dousa.arrays import BoolArray
from dousa.library import schema
from dousa.library.engine import next_clip_id, read_revision
from dousa.library.forests import StoredForest
from dousa.library.index.leaf_index import IndexedRows, LeafIndex
from dousa.library.index.parts import ClipPart, SparseVotes, read_part
from dousa.library.index.refresh import BLOCK, KnownRows, compare_rows, make_index, read_index, refresh_index
from dousa.library.selection import portions

FEWEST_CLIPS = 16_384
"""From which on a library has such a file: fewer are read as fast from their rows."""

_MAGIC = b"dousa index 1\n\0\0"
_ALIGNED = 64
_PART = ("ids", "sums", "given", "predicted", "path_ends", "path_bytes", "codes", "table", "offsets", "directions")
_VOTES = ("starts", "categories", "votes", "squares", "lengths")
_OWN = len(_MAGIC) + 12  # magic, length of the header, its checksum


def find_place(connection: sa.Connection, where: str) -> Path:
    """Where the file of a library is: beside its own, or in the folder of caches where a server has it."""
    if connection.dialect.name == "sqlite":
        path = next(row[2] for row in connection.exec_driver_sql("PRAGMA database_list") if row[1] == "main")
        return Path(f"{path}-search")
    name = hashlib.sha256(where.encode()).hexdigest()[:32]
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "dousa" / f"{name}-search"


def _name_forest(stored: StoredForest) -> list[int]:
    """What votes depend on besides the leaves."""
    sums = [zlib.crc32(np.ascontiguousarray(part).data) for part in stored.forest.vote_entries]
    return [stored.revision, stored.learned, *sums]


def write_side_file(path: Path, stored: StoredForest, index: LeafIndex) -> bool:
    """Write an index of one part; false where that cannot be: it is not needed."""
    if len(index.parts) != 1 or index.alive[0] is not None or index.source is None:
        return False
    part, votes = index.parts[0], index.votes[0]
    arrays = {name: getattr(part, name) for name in _PART if getattr(part, name) is not None}
    arrays |= {f"votes.{name}": getattr(votes, name) for name in _VOTES} | {"rows": index.source.sums}
    described, place = [], 0
    for name, array in arrays.items():
        whole = np.ascontiguousarray(array)
        described.append([name, whole.dtype.str, list(whole.shape), place, zlib.crc32(whole.data)])
        place += -(-whole.nbytes // _ALIGNED) * _ALIGNED
    partial = sorted(index.source.partial.items())
    header = {"arrays": described, "forest": _name_forest(stored), "names": part.names, "partial": partial}
    text = json.dumps(header).encode()
    temporary = path.with_name(f"{path.name}.{os.getpid()}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with open(temporary, "wb") as file:
            file.write(_MAGIC + struct.pack("<QI", len(text), zlib.crc32(text)) + text)
            for array in arrays.values():
                file.write(b"\0" * (-file.tell() % _ALIGNED))
                file.write(np.ascontiguousarray(array).data)
        os.replace(temporary, path)
    except OSError:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)
        return False
    return True


def read_side_file(path: Path, stored: StoredForest) -> LeafIndex | None:
    """The index in a file, with arrays that stay there until they are looked at; None where it is none, or damaged.

    It is of the library at some time: ``refresh_index`` brings it up to date.
    """
    found = _read_file(path, stored)
    if found is None:
        return None
    part, rows, header, arrays = found
    try:
        votes = None
        if header["forest"] == _name_forest(stored):
            votes = SparseVotes(*(arrays[f"votes.{name}"] for name in _VOTES))
    except (KeyError, TypeError):
        return None
    return make_index(-1, stored, rows, part, votes)


@dataclass(frozen=True, slots=True, eq=False)
class SideRows:
    """Clips as a file has them, without votes: see ``refresh.KnownRows``."""

    parts: tuple[ClipPart]
    alive: tuple[None]
    source: IndexedRows


def read_side_rows(path: Path, stored: StoredForest) -> SideRows | None:
    """The clips of a file, without what only searches ask for; None as of ``read_side_file``."""
    found = _read_file(path, stored, {*_PART, "rows"} - {"path_bytes", "directions"})
    return None if found is None else SideRows((found[0],), (None,), found[1])


def _read_file(
    path: Path, stored: StoredForest, wanted: Collection[str] | None = None
) -> tuple[ClipPart, IndexedRows, dict[str, Any], dict[str, NDArray[Any]]] | None:
    """The clips in a file, its header and arrays; of these all, or those that are wanted and read."""
    try:
        with open(path, "rb") as file:
            data = mmap.mmap(
                file.fileno(), 0, access=mmap.ACCESS_COPY
            )  # numba compiles again for what cannot be written
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
    if data[: len(_MAGIC)] != _MAGIC:
        raise ValueError
    length, checksum = struct.unpack("<QI", data[len(_MAGIC) : _OWN])
    text = data[_OWN : _OWN + length]
    if zlib.crc32(text) != checksum:
        raise ValueError
    header: dict[str, Any] = json.loads(text)
    start = -(-(_OWN + length) // _ALIGNED) * _ALIGNED
    arrays = {}
    for name, kind, shape, place, own in header["arrays"]:
        if wanted is not None and name not in wanted:
            continue
        array = np.frombuffer(data, kind, int(np.prod(shape)), start + place).reshape(shape)
        if zlib.crc32(array.data) != own:
            raise ValueError
        arrays[name] = array
    return header, arrays


def load_index(
    connection: sa.Connection, where: str, stored: StoredForest, known: LeafIndex | None, *, may_write: bool
) -> LeafIndex:
    """The index of a library as it is now.

    Parameters
    ----------
    where : name of the library.
    known : the index that was loaded before, if one was.
    may_write : whether a file may be made for a large library.

    Raises
    ------
    LibraryDamagedError : a wrong checksum; leaves that are not as many as the trees, or that the forest does not have.
    """
    revision = read_revision(connection)
    if known is not None and (known.revision, known.learned) == (revision, (stored.revision, stored.learned)):
        return known
    place = find_place(connection, where)
    if known is None:
        known = read_side_file(place, stored)
    index = None if known is None else refresh_index(connection, revision, stored, known)
    if index is None:
        index = read_index(connection, revision, stored)
        if may_write and index.n_clips >= FEWEST_CLIPS:
            write_side_file(place, stored, index)
    return index


def read_standing(
    connection: sa.Connection, where: str, stored: StoredForest, *, may_write: bool
) -> list[tuple[ClipPart, BoolArray]]:
    """All clips that have leaves, and which rows are of clips as they are now; of a large library out of its file.

    Parameters
    ----------
    where : name of the library.
    may_write : whether the file may be made where there is none.

    Raises
    ------
    LibraryDamagedError : as of ``read_part``, of what is read from the library.
    """
    clips = schema.clips.c
    known: KnownRows | None = read_side_rows(find_place(connection, where), stored)
    n_clips = connection.execute(sa.select(sa.func.count()).select_from(schema.clip_leaves)).scalar_one()
    if known is None and n_clips >= FEWEST_CLIPS:
        known = load_index(connection, where, stored, None, may_write=may_write)
    compared = None if known is None else compare_rows(connection, known)
    if known is None or compared is None:
        blocks = range(0, next_clip_id(connection), BLOCK)
        part = read_part(connection, stored, (clips.id.between(first, first + BLOCK - 1) for first in blocks))
        return [(part, np.ones(len(part), np.bool_))]
    *_, fresh, alive = compared
    some = read_part(connection, stored, (clips.id.in_(ids) for ids in portions(fresh.tolist())))
    return [*zip(known.parts, alive, strict=True), (some, np.ones(len(some), np.bool_))]
