"""The windows of the takes of a library, described again when its forest has learned.

Those of many takes are also in files (``takes.portions``), which are found and made here.
"""

from __future__ import annotations

import os
import zlib
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import sqlalchemy as sa

from dousa.errors import DousaError, LibraryDamagedError
from dousa.files.disk import remove_left_overs
from dousa.library.search.side_file import find_place, name_forest
from dousa.library.store import schema
from dousa.library.store.engine import Database, choose_jobs
from dousa.library.store.features import StoredMotion, find_feature_set, lacks, load_motions
from dousa.library.store.forests import StoredForest, load_forest
from dousa.library.takes.portions import Portion, read_portion, write_portion
from dousa.library.takes.scanning import TakesOnDisk
from dousa.messages import Count, Message, Progress
from dousa.retrieval.features.posed_motion import hide_joints
from dousa.retrieval.takes.windows import N_SMALL, TAKE_RATE, TakeWindows, hop_of

if TYPE_CHECKING:
    from dousa.retrieval.takes.windows import WindowGrid


@dataclass(frozen=True, slots=True)
class _Take:
    """Checksum of the content of a take, and its duration in s."""

    stamp: int
    duration: float


class WindowKeeper:
    """The files of one library, whose headers stay in memory."""

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
        *,
        in_memory: int = 1 << 29,
        in_a_file: int = 1 << 28,
        margin: float = 1.25,
    ) -> TakesOnDisk | None:
        """Open the files of windows, and make missing ones; None if the wanted windows fit in memory.

        Parameters
        ----------
        stored : the forest that describes the windows.
        asked : numbers of the wanted takes; None for all.
        read : returns the windows of a take.
        progress : called with (takes done, takes, message) while files are made.
        in_memory : bytes of windows that are compared in memory, some 10 hours; for more, a search uses files.
        in_a_file : bytes in memory of the windows of one file.
        margin : of the estimate of these bytes before files are made; it is a ninth too high for short takes.
        """
        takes = _list_takes(connection, stored)
        wanted = takes.values() if asked is None else [takes[number] for number in asked if number in takes]
        if _estimate(stored, (take.duration for take in wanted)) <= in_memory:
            return None
        folder = find_place(connection, self._database.where, "windows")
        forest = name_forest(stored)
        portions = self._load(folder, forest)
        places = _place(portions, takes)
        pending = [number for number in sorted(takes) if number not in places]
        waiting = _estimate(stored, (takes[number].duration for number in pending))
        if self._writes and waiting >= margin * in_a_file:
            kept, _ = _sweep(folder, portions, places)
            pending = [number for number in sorted(takes) if number not in _place(kept, takes)]
            making = _Making(folder, forest, stored.forest.trees_.n_leaves, takes, in_a_file)
            self._writes = making.make(pending, read, progress)
            portions = self._load(folder, forest)
            places = _place(portions, takes)
        return TakesOnDisk(portions, places)

    def drop(self, path: Path, *, damaged: bool) -> None:
        """Stop using a file, and delete it if it is damaged."""
        for key in [key for key in self._known if key[0] == str(path)]:
            self._known[key] = None
        if damaged and not self._database.is_read_only:
            with suppress(OSError):
                path.unlink()

    def _load(self, folder: Path, forest: list[int]) -> list[Portion]:
        """Read the headers of the files of a forest, sorted by name."""
        found: dict[tuple[str, int, int], Portion | None] = {}
        for path in sorted(folder.glob(f"*{SUFFIX}")):
            with suppress(OSError):
                state = os.stat(path)
                key = str(path), state.st_mtime_ns, state.st_size
                found[key] = self._known[key] if key in self._known else read_portion(path)
        self._known = found
        return [portion for portion in found.values() if portion is not None and portion.forest == forest]


MOST_KEPT = 1 << 29
"""Bytes of windows that stay in memory (docs/takes.md): some 10 hours of takes, 20 in a training."""

SUFFIX = ".windows"
"""Suffix of the files."""


def find_files(connection: sa.Connection, where: str) -> list[Path]:
    """List the files of a library of name ``where``."""
    return sorted(find_place(connection, where, "windows").glob(f"*{SUFFIX}"))


def sweep_files(database: Database) -> int:
    """Delete the files that no search would use, and return their size in bytes."""
    with database.reading() as connection:
        stored = load_forest(connection, database.where)
        takes = {} if stored is None else _list_takes(connection, stored)
        folder = find_place(connection, database.where, "windows")
    forest = None if stored is None else name_forest(stored)
    read = map(read_portion, sorted(folder.glob(f"*{SUFFIX}")))
    portions = [one for one in read if one is not None and one.forest == forest]
    size = _sweep(folder, portions, _place(portions, takes))[1]
    with suppress(OSError):
        folder.rmdir()  # if it is empty
    return size


def _sweep(
    folder: Path, portions: Sequence[Portion], places: Mapping[int, tuple[int, int]]
) -> tuple[list[Portion], int]:
    """Delete files of other forests, files with at most half of their takes in use, and those of killed programs.

    Return the files that are left, and the bytes of those that are deleted.
    """
    alive = [0] * len(portions)
    for portion, _ in places.values():
        alive[portion] += 1
    kept = [one for one, count in zip(portions, alive, strict=True) if 2 * count > len(one.ids)]
    names = {one.path for one in kept}
    size = remove_left_overs(folder)
    for path in folder.glob(f"*{SUFFIX}"):
        with suppress(OSError):
            if path not in names:
                size += path.stat().st_size
                path.unlink()
    return kept, size


def _list_takes(connection: sa.Connection, stored: StoredForest) -> dict[int, _Take]:
    """List the takes, by number, that have all joints of the forest."""
    table = schema.clips.c
    columns = table.id, table.content_hash, table.read_options, table.n_frames, table.frame_rate, table.height
    query = sa.select(*columns, table.duration, table.absent).where(table.kind == schema.TAKE)
    return {
        row.id: _Take(zlib.crc32(repr(tuple(row[:-2])).encode()), row.duration)
        for row in connection.execute(query)
        if not lacks(stored.feature_set, row.absent)
    }


def _estimate(stored: StoredForest, durations: Iterable[float]) -> float:
    """Estimate the bytes of the windows of takes in memory: those of each, and poses with their running sums."""
    a_window = len(stored.forest.trees_.roots) * (2 if stored.forest.trees_.n_leaves < 2**16 else 4) + 16
    a_frame = N_SMALL * (2 + 8) + sum(a_window / hop_of(length) for length in stored.grid.lengths)
    return sum(durations) * TAKE_RATE * a_frame


def _place(portions: Sequence[Portion], takes: Mapping[int, _Take]) -> dict[int, tuple[int, int]]:
    """Return, by number, file and place of each unchanged take."""
    places: dict[int, tuple[int, int]] = {}
    for place, portion in enumerate(portions):
        for own, (number, stamp) in enumerate(zip(portion.ids.tolist(), portion.stamps.tolist(), strict=True)):
            if number in takes and takes[number].stamp == stamp:
                places.setdefault(number, (place, own))
    return places


@dataclass(frozen=True, slots=True)
class _Making:
    """Makes files of the takes of a library."""

    folder: Path
    forest: list[int]
    n_leaves: int
    takes: Mapping[int, _Take]
    in_a_file: int

    def make(self, pending: Sequence[int], read: Callable[[int], TakeWindows], progress: Progress | None) -> bool:
        """Make all full files, unless another program makes them; return False if they cannot be written."""
        waiting: list[tuple[int, int, TakeWindows]] = []
        size = 0
        for done, number in enumerate(pending):
            if progress is not None:
                progress(done, len(pending), Message("library_takes.keeping"))
            waiting.append((number, self.takes[number].stamp, read(number)))
            size += waiting[-1][2].n_bytes
            if size >= self.in_a_file:
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


def describe_windows(
    stored: StoredForest, motion: StoredMotion, n_jobs: int | None = 1, grid: WindowGrid | None = None
) -> TakeWindows:
    """Describe the windows of a recording, by default of the library's grid; a very short one has none."""
    from dousa.retrieval.takes.windows import describe_take

    kind = find_feature_set(stored.feature_set)
    seen = hide_joints(motion, kind.hidden)
    return describe_take(stored.forest, kind, seen, grid or stored.grid, n_jobs=choose_jobs(n_jobs))


def describe_takes(
    connection: sa.Connection,
    stored: StoredForest,
    known: Mapping[int, bytes] | None = None,
    n_jobs: int | None = 1,
    progress: Count | None = None,
    *,
    room: int = MOST_KEPT,
) -> dict[int, bytes]:
    """Describe the windows of takes, by number, until memory is full; ``refresh_windows`` describes the others.

    Parameters
    ----------
    known : windows that this forest has described already.
    progress : called with (takes described, takes to describe).
    room : bytes of windows in memory.
    """
    table = schema.clips.c
    rows = connection.execute(sa.select(table.id, table.absent).where(table.kind == schema.TAKE))
    ids = [row.id for row in rows if not lacks(stored.feature_set, row.absent)]
    windows = {clip_id: known[clip_id] for clip_id in ids if known and clip_id in known}
    new = [clip_id for clip_id in ids if clip_id not in windows]
    size = sum(map(len, windows.values()))
    for done, clip_id in enumerate(new, 1):
        if size > room:
            break
        (motion,) = load_motions(connection, [clip_id])  # one at a time: they are long
        windows[clip_id] = describe_windows(stored, motion, n_jobs).to_bytes()
        size += len(windows[clip_id])
        if progress is not None:
            progress(done, len(new))
    return windows


def save_windows(connection: sa.Connection, stored: StoredForest, windows: Mapping[int, bytes]) -> None:
    """Write the windows of takes that have none yet."""
    if windows:
        rows = [{"clip_id": clip_id, "learned": stored.learned, "data": data} for clip_id, data in windows.items()]
        connection.execute(sa.insert(schema.take_windows), rows)


def refresh_windows(
    database: Database, stored: StoredForest, n_jobs: int | None, progress: Count | None = None
) -> None:
    """Describe and write each take without windows of the present forest.

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
            return  # another program has changed the library, and refreshes it
        if progress is not None:
            progress(done, len(stale))


def replace_windows(database: Database, stored: StoredForest, clip_id: int, windows: bytes) -> bool:
    """Write the windows of a take; return False if the forest has changed or the take is gone."""
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
    """Read the windows of a take that this forest has described; None if there are none.

    LibraryDamagedError if the bytes are no windows, or of another forest.
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
    # Leaves are looked up by number, so they must exist.
    trees, leaves = stored.forest.trees_, windows.leaves
    if leaves.shape[1] != len(trees.roots) or (leaves.size and leaves.max() >= trees.n_leaves):
        raise LibraryDamagedError("library_takes.other_forest", library=where, number=clip_id)
    return windows


def make_window_files(
    database: Database, stored: StoredForest, n_jobs: int | None = None, progress: Progress | None = None
) -> None:
    """Make the files of takes that do not fit in memory, after ``refresh_windows``, so that no search needs to.

    ``progress`` is called with (takes done, takes, message).
    """
    with database.reading() as connection:
        if connection.execute(sa.select(schema.take_windows.c.clip_id).limit(1)).first() is None:
            return

    def read(clip_id: int) -> TakeWindows:
        try:
            windows = read_windows(connection, database.where, stored, clip_id)
        except LibraryDamagedError:  # reported by a search or a check
            windows = None
        if windows is None:
            (motion,) = load_motions(connection, [clip_id])
            windows = describe_windows(stored, motion, n_jobs)
        return windows

    with database.reading() as connection:
        WindowKeeper(database).open(connection, stored, None, read, progress)
