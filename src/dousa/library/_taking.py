"""Takes that are looked into: those of the library with the windows that it keeps, and files described on the fly."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import sqlalchemy as sa

from dousa.errors import DousaError, LibraryDamagedError, LibraryError, MotionFileError
from dousa.library import schema
from dousa.library._describing import StoredMotion, load_motions, round_positions
from dousa.library._forests import StoredForest
from dousa.library._queries import name_query, read_query
from dousa.library._take_windows import describe_windows
from dousa.library.ingest import (
    ClipRecord,
    ReadOptions,
    ReadTask,
    find_motion_files,
    is_unicode,
    look_at,
    read_clips,
)
from dousa.library.reports import Skipped
from dousa.library.selection import portions

if TYPE_CHECKING:
    from dousa.retrieval.takes import TakeWindows, WindowGrid

__all__ = ["Describing", "ReadTake", "TakeShelf", "check_single"]


@dataclass(frozen=True, slots=True, eq=False)
class ReadTake:
    """A take with its windows.

    Parameters
    ----------
    path : its file.
    clip_id : its number in the library, None for a file that is not there.
    windows : of the present forest.
    """

    path: str
    clip_id: int | None
    windows: TakeWindows


@dataclass(frozen=True, slots=True)
class Describing:
    """How takes are described that are not kept.

    Parameters
    ----------
    stored : the forest.
    grid : windows that they are cut into.
    options : what is said about files.
    n_jobs : files read, and parts described, at a time.
    """

    stored: StoredForest
    grid: WindowGrid
    options: ReadOptions
    n_jobs: int | None

    def describe(self, motion: StoredMotion) -> TakeWindows:
        """The windows of a recording."""
        return describe_windows(self.stored, motion, self.n_jobs, self.grid)


class TakeShelf:
    """Keeps the windows of the library's takes in memory until the forest or the takes change.

    Parameters
    ----------
    where : the library, for messages.
    """

    def __init__(self, where: str) -> None:
        self._where = where
        self._learned: int | None = None
        self._windows: dict[int, TakeWindows] = {}

    def all_takes(self, connection: sa.Connection, stored: StoredForest) -> list[ReadTake]:
        """Every take of the library, in the order of their paths.

        Raises
        ------
        LibraryError : there are none.
        """
        table = schema.clips.c
        query = sa.select(table.id, table.path).where(table.kind == schema.TAKE)
        rows = sorted(connection.execute(query).all(), key=lambda row: row.path)
        if not rows:
            raise LibraryError(
                f"{self._where}: the library holds no takes; name files to look into, or add recordings with: "
                f"dousa add --takes"
            )
        windows = self._read(connection, stored, [row.id for row in rows])
        return [ReadTake(row.path, row.id, windows[row.id]) for row in rows]

    def chosen(
        self, connection: sa.Connection, describing: Describing, wanted: Sequence[Any]
    ) -> tuple[list[ReadTake], list[Skipped]]:
        """Takes by number, file or folder, or as motions, each once; and the files that cannot be used.

        A file that is in the library, and has not changed since, is not read: its windows are kept.

        Raises
        ------
        LibraryError : no clip or take of a number.
        """
        takes: list[ReadTake] = []
        skipped: list[Skipped] = []
        seen: set[str] = set()
        for item in wanted:
            some: Sequence[ReadTake]
            if isinstance(item, int):
                some = (self._by_number(connection, describing, item),)
            elif isinstance(item, str | os.PathLike):
                some, missing = self._by_path(connection, describing, item)
                skipped += missing
            else:
                motion = round_positions(read_query(item, describing.options))
                takes.append(ReadTake(name_query(item), None, describing.describe(motion)))
                continue  # motions may have one name
            takes += [take for take in some if take.path not in seen]
            seen.update(take.path for take in some)
        return takes, skipped

    def _by_number(self, connection: sa.Connection, describing: Describing, number: int) -> ReadTake:
        table = schema.clips.c
        query = sa.select(table.path, table.kind).where(table.id == number)
        row = connection.execute(query).one_or_none() if schema.is_id(number) else None
        if row is None:
            raise LibraryError(f"{self._where}: no clip or take {number}; see: dousa list")
        if row.kind == schema.TAKE:
            return ReadTake(row.path, number, self._read(connection, describing.stored, [number])[number])
        (motion,) = load_motions(connection, [number])
        return ReadTake(row.path, number, describing.describe(motion))

    def _by_path(
        self, connection: sa.Connection, describing: Describing, path: str | os.PathLike[str]
    ) -> tuple[list[ReadTake], list[Skipped]]:
        files, skipped = find_motion_files([path])
        paths = [str(file.path) for file in files]
        rows = self._rows(connection, paths or [os.path.abspath(path)])
        if not paths and rows:  # its file is gone, and the library kept it
            paths, skipped = list(rows), []
        else:
            rows = {name: row for name, row in rows.items() if _is_as_stored(row, describing.options)}
        kept = self._read(connection, describing.stored, [rows[name].id for name in paths if name in rows])
        tasks = [ReadTask(name, describing.options, kind=schema.TAKE) for name in paths if name not in rows]
        read = {answer.path: answer for answer in read_clips(tasks, describing.n_jobs)}
        takes = []
        for name in paths:
            answer = read.get(name)
            if isinstance(answer, ClipRecord):
                takes.append(ReadTake(name, None, describing.describe(answer.to_motion())))
            elif name in rows:
                takes.append(ReadTake(name, rows[name].id, kept[rows[name].id]))
        return takes, [*skipped, *(answer for answer in read.values() if isinstance(answer, Skipped))]

    def _rows(self, connection: sa.Connection, paths: Sequence[str]) -> dict[str, Any]:
        """Takes of the library, by path."""
        table = schema.clips.c
        query = sa.select(table.id, table.path, table.fingerprint, table.read_options)
        query = query.where(table.kind == schema.TAKE)
        names = [path for path in paths if is_unicode(path)]
        return {
            row.path: row
            for some in portions(names)
            for row in connection.execute(query.where(table.path.in_(some)))
        }

    def _read(
        self, connection: sa.Connection, stored: StoredForest, ids: Sequence[int]
    ) -> dict[int, TakeWindows]:
        """Windows by number; those that are not stored are described."""
        from dousa.retrieval.takes import TakeWindows

        if self._learned != stored.learned:
            self._learned, self._windows = stored.learned, {}
        table = schema.take_windows.c
        for some in portions([clip_id for clip_id in ids if clip_id not in self._windows]):
            query = sa.select(table.clip_id, table.data).where(table.clip_id.in_(some))
            query = query.where(table.learned == stored.learned)
            for row in connection.execute(query):
                try:
                    self._windows[row.clip_id] = TakeWindows.from_bytes(row.data)
                except DousaError as error:
                    raise LibraryDamagedError(f"{self._where}: take {row.clip_id}: {error}") from error
                self._check(stored, row.clip_id)
        for clip_id in ids:
            if clip_id not in self._windows:
                (motion,) = load_motions(connection, [clip_id])
                self._windows[clip_id] = describe_windows(stored, motion, None)
        return {clip_id: self._windows[clip_id] for clip_id in ids}

    def _check(self, stored: StoredForest, clip_id: int) -> None:
        """Leaves are looked up by number, so there must be such leaves."""
        trees, leaves = stored.forest.trees_, self._windows[clip_id].leaves
        if leaves.shape[1] != len(trees.roots) or (leaves.size and leaves.max() >= trees.n_leaves):
            raise LibraryDamagedError(
                f"{self._where}: take {clip_id} has windows of another forest; run: dousa train {self._where}"
            )


def check_single(take: Any) -> None:
    """MotionFileError for a folder of other than one recording, before any of them is read."""
    if isinstance(take, str | os.PathLike) and os.path.isdir(take):
        files, _ = find_motion_files([take])
        if len(files) != 1:
            raise MotionFileError(os.fspath(take), f"expected one take, found {len(files)} files there")


def _is_as_stored(row: Any, options: ReadOptions) -> bool:
    """Whether a file has not changed since it was stored, and would be understood in the same way."""
    if row.read_options != options.describe():
        return False
    try:
        return bool(look_at(row.path, options).fingerprint == row.fingerprint)
    except (DousaError, OSError):
        return False  # reading the file says what is wrong
