"""The windows of takes that a library keeps: described by its forest, and anew when that has learned.

Those of many takes lie in files, too (``takes.portions``), which are made here when windows have been described.

The files with the windows of many takes: which are of the library as it is now, and making those that are missing.
"""

from __future__ import annotations

import os
import time
import zlib
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import sqlalchemy as sa

from dousa.errors import DousaError, LibraryDamagedError
from dousa.library.search.side_file import find_place, name_forest
from dousa.library.store import schema
from dousa.library.store.engine import Database, choose_jobs
from dousa.library.store.features import StoredMotion, find_feature_set, lacks, load_motions
from dousa.library.store.forests import StoredForest, load_forest
from dousa.library.takes.portions import Portion, read_portion, write_portion
from dousa.library.takes.scanning import TakesOnDisk
from dousa.messages import Message
from dousa.retrieval.features.posed_motion import hide_joints
from dousa.retrieval.takes.windows import TAKE_RATE, TakeWindows, hop_of

if TYPE_CHECKING:
    from dousa.retrieval.takes.windows import WindowGrid

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


MOST_KEPT = 1 << 29
"""Bytes of windows that stay in memory: some 10 hours of takes, 20 in a training."""


def describe_windows(
    stored: StoredForest, motion: StoredMotion, n_jobs: int | None = 1, grid: WindowGrid | None = None
) -> TakeWindows:
    """The windows of a recording, by default those that the library keeps; a very short one has none."""
    from dousa.retrieval.takes.windows import describe_take

    kind = find_feature_set(stored.feature_set)
    seen = hide_joints(motion, kind.hidden)
    return describe_take(stored.forest, kind, seen, grid or stored.grid, n_jobs=choose_jobs(n_jobs))


def describe_takes(
    connection: sa.Connection,
    stored: StoredForest,
    known: Mapping[int, bytes] | None = None,
    n_jobs: int | None = 1,
    progress: Callable[[int, int], None] | None = None,
) -> dict[int, bytes]:
    """Windows of takes, by number, but those that this forest described already are ``known``.

    Of all, unless these are many: then of some, and ``refresh_windows`` describes the others when they are written.
    ``progress`` is called with (takes described, takes to describe).
    """
    table = schema.clips.c
    rows = connection.execute(sa.select(table.id, table.absent).where(table.kind == schema.TAKE))
    ids = [row.id for row in rows if not lacks(stored.feature_set, row.absent)]
    windows = {clip_id: known[clip_id] for clip_id in ids if known and clip_id in known}
    new = [clip_id for clip_id in ids if clip_id not in windows]
    size = sum(map(len, windows.values()))
    for done, clip_id in enumerate(new, 1):
        if size > MOST_KEPT:
            break
        (motion,) = load_motions(connection, [clip_id])  # one at a time: they are long
        windows[clip_id] = describe_windows(stored, motion, n_jobs).to_bytes()
        size += len(windows[clip_id])
        if progress is not None:
            progress(done, len(new))
    return windows


def save_windows(connection: sa.Connection, stored: StoredForest, windows: Mapping[int, bytes]) -> None:
    """Write the windows of takes of which nothing is written yet."""
    if windows:
        rows = [{"clip_id": clip_id, "learned": stored.learned, "data": data} for clip_id, data in windows.items()]
        connection.execute(sa.insert(schema.take_windows), rows)


def refresh_windows(
    database: Database,
    stored: StoredForest,
    n_jobs: int | None,
    progress: Callable[[int, int], None] | None = None,
) -> None:
    """Describe the takes anew that an earlier state of the forest described; each is written when it is done.

    ``progress`` is called with (takes described, takes to describe).
    """
    clips, table = schema.clips.c, schema.take_windows.c
    query = sa.select(clips.id, clips.absent).where(clips.kind == schema.TAKE)
    query = query.join(schema.take_windows, table.clip_id == clips.id, isouter=True)
    with database.reading() as connection:
        rows = connection.execute(query.where(table.learned.is_distinct_from(stored.learned)))
        stale = [row.id for row in rows if not lacks(stored.feature_set, row.absent)]
    for done, clip_id in enumerate(stale, 1):
        with database.reading() as connection:
            (motion,) = load_motions(connection, [clip_id])
        windows = describe_windows(stored, motion, n_jobs).to_bytes()
        if not replace_windows(database, stored, clip_id, windows):
            return  # another program has changed the library, and sees to it
        if progress is not None:
            progress(done, len(stale))


def replace_windows(database: Database, stored: StoredForest, clip_id: int, windows: bytes) -> bool:
    """Write the windows of a take, if forest and take are still there."""
    clips, table = schema.clips.c, schema.take_windows
    with database.writing() as connection:
        now = connection.execute(sa.select(schema.forests.c.learned)).scalar_one_or_none()
        there = connection.execute(sa.select(clips.id).where(clips.id == clip_id)).scalar_one_or_none()
        if now != stored.learned or there is None:
            return False
        connection.execute(sa.delete(table).where(table.c.clip_id == clip_id))
        save_windows(connection, stored, {clip_id: windows})
    return True


def read_windows(connection: sa.Connection, where: str, stored: StoredForest, clip_id: int) -> TakeWindows | None:
    """Windows of a take as this forest described them; None where that has not been.

    Raises
    ------
    LibraryDamagedError : bytes that are no windows, or of another forest.
    """
    from dousa.retrieval.takes.windows import TakeWindows

    table = schema.take_windows.c
    query = sa.select(table.data).where(table.learned == stored.learned, table.clip_id == clip_id)
    data = connection.execute(query).scalar_one_or_none()
    if data is None:
        return None
    try:
        windows = TakeWindows.from_bytes(data)
    except DousaError as error:
        raise LibraryDamagedError("library_takes.damaged", library=where, number=clip_id, problem=error) from error
    # Leaves are looked up by number, so there must be such leaves.
    trees, leaves = stored.forest.trees_, windows.leaves
    if leaves.shape[1] != len(trees.roots) or (leaves.size and leaves.max() >= trees.n_leaves):
        raise LibraryDamagedError("library_takes.other_forest", library=where, number=clip_id)
    return windows


def make_window_files(
    database: Database,
    stored: StoredForest,
    n_jobs: int | None = None,
    progress: Callable[[int, int, Message], None] | None = None,
) -> None:
    """Make the files in which takes are searched for which memory has no room, so that no search needs to.

    ``progress`` is called with (takes done, takes, what is done) where there are such takes. To be called when windows
    are up to date: ``refresh_windows``.
    """
    with database.reading() as connection:
        if connection.execute(sa.select(schema.take_windows.c.clip_id).limit(1)).first() is None:
            return

    def read(clip_id: int) -> TakeWindows:
        try:
            windows = read_windows(connection, database.where, stored, clip_id)
        except LibraryDamagedError:  # a search says so, or a check
            windows = None
        if windows is None:
            (motion,) = load_motions(connection, [clip_id])
            windows = describe_windows(stored, motion, n_jobs)
        return windows

    with database.reading() as connection:
        WindowKeeper(database).open(connection, stored, None, read, progress)
