"""The windows of the takes: described once, when a take is added or the forest is trained, and kept."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import sqlalchemy as sa

from dousa.library import schema
from dousa.library._describing import StoredMotion, find_feature_set, load_motions
from dousa.library._engine import reading, writing
from dousa.library._forests import StoredForest
from dousa.library._jobs import choose_jobs
from dousa.library.ingest import ClipRecord

if TYPE_CHECKING:
    from dousa.retrieval.takes import TakeWindows, WindowGrid

__all__ = [
    "DescribedTakes",
    "describe_records",
    "describe_takes",
    "describe_windows",
    "refresh_windows",
    "save_windows",
]


@dataclass(frozen=True, slots=True)
class DescribedTakes:
    """Windows of takes that were read but are not written yet.

    Parameters
    ----------
    learned : of the forest that described them.
    windows : bytes by path.
    """

    learned: int | None = None
    windows: dict[str, bytes] = field(default_factory=dict)

    def of(self, stored: StoredForest, records: Mapping[int, ClipRecord]) -> dict[int, bytes]:
        """Windows by the number of the take, described anew where another forest did."""
        known = self.windows if stored.learned == self.learned else {}
        return {
            clip_id: known.get(record.path) or describe_windows(stored, record.to_motion()).to_bytes()
            for clip_id, record in records.items()
        }


def describe_windows(
    stored: StoredForest, motion: StoredMotion, n_jobs: int | None = 1, grid: WindowGrid | None = None
) -> TakeWindows:
    """The windows of a recording.

    Parameters
    ----------
    stored : the forest.
    motion : of any length; a very short one has no windows.
    n_jobs : parts described at a time.
    grid : which windows; by default those that the library keeps.
    """
    from dousa.retrieval.takes import describe_take

    kind = find_feature_set(stored.feature_set)
    return describe_take(stored.forest, kind, motion, grid or stored.grid, n_jobs=choose_jobs(n_jobs))


def describe_records(
    stored: StoredForest | None, records: Sequence[ClipRecord], n_jobs: int | None = None
) -> DescribedTakes:
    """Describe the takes among files that were read."""
    if stored is None:
        return DescribedTakes()
    windows = {
        record.path: describe_windows(stored, record.to_motion(), n_jobs).to_bytes()
        for record in records
        if record.kind == schema.TAKE
    }
    return DescribedTakes(stored.learned, windows)


def describe_takes(
    connection: sa.Connection,
    stored: StoredForest,
    known: Mapping[int, bytes] | None = None,
    n_jobs: int | None = 1,
    progress: Callable[[int, int], None] | None = None,
) -> dict[int, bytes]:
    """Windows of all takes, by number.

    Parameters
    ----------
    connection : in a transaction.
    stored : the forest.
    known : windows that this forest described already.
    n_jobs : parts of a take described at a time.
    progress : called with (takes described, takes to describe).
    """
    table = schema.clips.c
    ids = list(connection.execute(sa.select(table.id).where(table.kind == schema.TAKE)).scalars())
    windows = {clip_id: known[clip_id] for clip_id in ids if known and clip_id in known}
    new = [clip_id for clip_id in ids if clip_id not in windows]
    for done, clip_id in enumerate(new, 1):
        (motion,) = load_motions(connection, [clip_id])  # one at a time: they are long
        windows[clip_id] = describe_windows(stored, motion, n_jobs).to_bytes()
        if progress is not None:
            progress(done, len(new))
    return windows


def save_windows(connection: sa.Connection, stored: StoredForest, windows: Mapping[int, bytes]) -> None:
    """Write the windows of takes of which nothing is written yet."""
    if windows:
        rows = [
            {"clip_id": clip_id, "learned": stored.learned, "data": data} for clip_id, data in windows.items()
        ]
        connection.execute(sa.insert(schema.take_windows), rows)


def refresh_windows(engine: sa.Engine, where: str, stored: StoredForest, n_jobs: int | None) -> None:
    """Describe the takes anew that an earlier state of the forest described; each is written when it is done."""
    clips, table = schema.clips.c, schema.take_windows.c
    query = sa.select(clips.id).where(clips.kind == schema.TAKE)
    query = query.join(schema.take_windows, table.clip_id == clips.id, isouter=True)
    with reading(engine, where) as connection:
        stale = list(
            connection.execute(query.where(table.learned.is_distinct_from(stored.learned))).scalars()
        )
    for clip_id in stale:
        with reading(engine, where) as connection:
            (motion,) = load_motions(connection, [clip_id])
        windows = describe_windows(stored, motion, n_jobs).to_bytes()
        with writing(engine, where) as connection:
            now = connection.execute(sa.select(schema.forests.c.learned)).scalar_one_or_none()
            there = connection.execute(sa.select(clips.id).where(clips.id == clip_id)).scalar_one_or_none()
            if now != stored.learned or there is None:
                return  # another program has changed the library, and sees to it
            connection.execute(sa.delete(schema.take_windows).where(table.clip_id == clip_id))
            save_windows(connection, stored, {clip_id: windows})
