"""The files with the windows of many takes: which are of the library as it is now, and making those that are missing.

Takes that fit into memory are compared there. Of more than that, windows are kept in a folder beside the library, some
takes in each file. A file is of some takes as one forest described them, so nobody has to say what has changed: what
stands for both is compared, and takes that are in no file, or as they are no longer, are looked at without one. Where
these are many, a file is made of them; one that is of another forest, or half of whose takes are gone, is taken away.
"""

from __future__ import annotations

import os
import time
import zlib
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import sqlalchemy as sa

from dousa.library import schema
from dousa.library.engine import Database
from dousa.library.features import lacks
from dousa.library.forests import StoredForest, load_forest
from dousa.library.index.side_file import find_place, name_forest
from dousa.library.windows.portions import Portion, read_portion, write_portion
from dousa.library.windows.scanning import TakesOnDisk
from dousa.messages import Message
from dousa.retrieval.takes.windows import TAKE_RATE, TakeWindows, hop_of

MOST_IN_MEMORY = 1 << 29
"""Bytes of windows that are compared in memory, those of some 10 hours: of more a search uses files."""

PORTION_BYTES = 1 << 28
"""Of windows in memory that go into one file."""

_CLEARLY = 1.25  # of an estimate, which of short takes is a ninth too high
_ABANDONED = 86_400.0  # s after which nobody writes an unfinished file any more
_BYTES_A_FRAME = 27 * (2 + 8)  # of a pose, and of its running sums

Progress = Callable[[int, int, Message], None]


@dataclass(frozen=True, slots=True)
class _Take:
    """What stands for the content of a take, and its length in s."""

    stamp: int
    duration: float


class WindowKeeper:
    """The files of one library; what was read of them stays in memory."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._known: dict[tuple[str, int, int], Portion | None] = {}
        self._writes = not database.is_read_only

    def open(
        self,
        connection: sa.Connection,
        stored: StoredForest,
        asked: Collection[int] | None,
        read: Callable[[int], TakeWindows],
        progress: Progress | None = None,
    ) -> TakesOnDisk | None:
        """Takes whose windows are in files, as the library is now; None where memory has room for those asked about.

        Parameters
        ----------
        stored : the forest by which they are described.
        asked : numbers of takes; None for all.
        read : gives the windows of a take.
        progress : called with (takes done, takes, what is done) while files are made.
        """
        takes = _list_takes(connection, stored)
        wanted = takes.values() if asked is None else [takes[number] for number in asked if number in takes]
        if _estimate(stored, (take.duration for take in wanted)) <= MOST_IN_MEMORY:
            return None
        folder = find_place(connection, self._database.where, "windows")
        forest = name_forest(stored)
        portions = self._load(folder, forest)
        places = _place(portions, takes)
        pending = [number for number in sorted(takes) if number not in places]
        waiting = _estimate(stored, (takes[number].duration for number in pending))
        if self._writes and waiting >= _CLEARLY * PORTION_BYTES:
            kept, _ = _sweep(folder, portions, places)
            pending = [number for number in sorted(takes) if number not in _place(kept, takes)]
            making = _Making(folder, forest, stored.forest.trees_.n_leaves, takes)
            self._writes = making.make(pending, read, progress)
            portions = self._load(folder, forest)
            places = _place(portions, takes)
        return TakesOnDisk(portions, places)

    def drop(self, path: Path, *, damaged: bool) -> None:
        """Use a file no more, and take it away if it is damaged: one that cannot be opened may be as good as ever."""
        for key in [key for key in self._known if key[0] == str(path)]:
            self._known[key] = None
        if damaged and not self._database.is_read_only:
            with suppress(OSError):
                path.unlink()

    def _load(self, folder: Path, forest: list[int]) -> list[Portion]:
        """The files of a forest, by their names."""
        found: dict[tuple[str, int, int], Portion | None] = {}
        for path in sorted(folder.glob(f"*{SUFFIX}")):
            with suppress(OSError):
                state = os.stat(path)
                key = str(path), state.st_mtime_ns, state.st_size
                found[key] = self._known[key] if key in self._known else read_portion(path)
        self._known = found
        return [portion for portion in found.values() if portion is not None and portion.forest == forest]


SUFFIX = ".windows"
"""Of the names of the files."""


def find_files(connection: sa.Connection, where: str) -> list[Path]:
    """The files of a library, ``where`` as it is named."""
    return sorted(find_place(connection, where, "windows").glob(f"*{SUFFIX}"))


def sweep_files(database: Database) -> int:
    """Take away the files that no search would use; how many bytes these had."""
    with database.reading() as connection:
        stored = load_forest(connection, database.where)
        takes = {} if stored is None else _list_takes(connection, stored)
        folder = find_place(connection, database.where, "windows")
    forest = None if stored is None else name_forest(stored)
    read = map(read_portion, sorted(folder.glob(f"*{SUFFIX}")))
    portions = [one for one in read if one is not None and one.forest == forest]
    size = _sweep(folder, portions, _place(portions, takes))[1]
    with suppress(OSError):
        folder.rmdir()  # if nothing is left in it
    return size


def _sweep(
    folder: Path, portions: Sequence[Portion], places: Mapping[int, tuple[int, int]]
) -> tuple[list[Portion], int]:
    """Take away files of another forest, and those with fewer takes of the library than others.

    Returns
    -------
    The rest, and the bytes of what is gone.
    """
    alive = [0] * len(portions)
    for portion, _ in places.values():
        alive[portion] += 1
    kept = [one for one, count in zip(portions, alive, strict=True) if 2 * count > len(one.ids)]
    names = {one.path for one in kept}
    size = 0
    for path in (*folder.glob(f"*{SUFFIX}"), *folder.glob(f"*{SUFFIX}.part")):
        with suppress(OSError):
            state = path.stat()
            # An unfinished file is of a program that was killed, or writes it now.
            if path not in names and (path.suffix == SUFFIX or time.time() - state.st_mtime > _ABANDONED):
                path.unlink()
                size += state.st_size
    return kept, size


def _list_takes(connection: sa.Connection, stored: StoredForest) -> dict[int, _Take]:
    """The takes, by number, of which the forest describes windows."""
    table = schema.clips.c
    columns = table.id, table.content_hash, table.read_options, table.n_frames, table.frame_rate, table.height
    query = sa.select(*columns, table.duration, table.absent).where(table.kind == schema.TAKE)
    return {
        row.id: _Take(zlib.crc32(repr(tuple(row[:-2])).encode()), row.duration)
        for row in connection.execute(query)
        if not lacks(stored.feature_set, row.absent)
    }


def _estimate(stored: StoredForest, durations: Iterable[float]) -> float:
    """Bytes of windows of takes in memory, nearly."""
    a_window = len(stored.forest.trees_.roots) * (2 if stored.forest.trees_.n_leaves < 2**16 else 4) + 16
    a_frame = _BYTES_A_FRAME + sum(a_window / hop_of(length) for length in stored.grid.lengths)
    return sum(durations) * TAKE_RATE * a_frame


def _place(portions: Sequence[Portion], takes: Mapping[int, _Take]) -> dict[int, tuple[int, int]]:
    """By number, file and place of each take that is as it was."""
    places: dict[int, tuple[int, int]] = {}
    for place, portion in enumerate(portions):
        for own, (number, stamp) in enumerate(zip(portion.ids.tolist(), portion.stamps.tolist(), strict=True)):
            if number in takes and takes[number].stamp == stamp:
                places.setdefault(number, (place, own))
    return places


@dataclass(frozen=True, slots=True)
class _Making:
    """Makes files of takes.

    Parameters
    ----------
    folder, forest, n_leaves : where, and of which forest.
    takes : of the library.
    """

    folder: Path
    forest: list[int]
    n_leaves: int
    takes: Mapping[int, _Take]

    def make(self, pending: Sequence[int], read: Callable[[int], TakeWindows], progress: Progress | None) -> bool:
        """Make files of takes, but of few that are left over; false where they cannot be written.

        Where another program makes the same ones they are left to it.
        """
        waiting: list[tuple[int, int, TakeWindows]] = []
        size = 0
        for done, number in enumerate(pending):
            if progress is not None:
                progress(done, len(pending), Message("library_takes.keeping"))
            waiting.append((number, self.takes[number].stamp, read(number)))
            size += waiting[-1][2].n_bytes
            if size >= PORTION_BYTES:
                try:
                    if not self._write(waiting):
                        break
                except OSError:
                    return False
                waiting, size = [], 0
        if progress is not None and pending:
            progress(len(pending), len(pending), Message("library_takes.keeping"))
        return True

    def _write(self, waiting: Sequence[tuple[int, int, TakeWindows]]) -> bool:
        some = [one for one in waiting if len(one[2].leaves)]
        if not some:
            return True
        name = zlib.crc32(repr((self.forest, [one[:2] for one in some])).encode())
        self.folder.mkdir(parents=True, exist_ok=True)
        path = self.folder / f"{some[0][0]:010}-{name:08x}{SUFFIX}"
        return write_portion(path, self.forest, some, self.n_leaves)
