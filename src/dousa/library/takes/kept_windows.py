"""The windows of takes that a library keeps: described by its forest, and anew when that has learned.

Those of many takes lie in files, too (``library.windows``), which are made here when windows have been described.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

import sqlalchemy as sa

from dousa.errors import DousaError, LibraryDamagedError
from dousa.library import schema
from dousa.library.engine import Database, choose_jobs
from dousa.library.features import StoredMotion, find_feature_set, lacks, load_motions
from dousa.library.forests import StoredForest
from dousa.messages import Message
from dousa.retrieval.features.posed_motion import hide_joints

if TYPE_CHECKING:
    from dousa.retrieval.takes.windows import TakeWindows, WindowGrid

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
    from dousa.library.windows.keeper import WindowKeeper

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
