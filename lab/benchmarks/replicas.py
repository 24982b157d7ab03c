"""A large library for searches, made of the rows of a small one that is trained: what a search costs depends on these.

Each new clip has the leaves of one clip of the small library, a third of them exchanged for those of another of its
category, the direction between both, and the poses and the words of the first. It has neither positions nor features.
"""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import sqlalchemy as sa

from dousa.library import Library
from dousa.library.store import schema
from dousa.library.store.checksums import LABELS, LEAVES, POSES, RELATIONS, Seal, seal_positions
from dousa.library.store.engine import next_revision, note_changed_clips, take_clip_ids
from dousa.library.store.forests import StoredForest, count_votes, load_forest
from dousa.library.store.rows import seal_rows
from dousa.library.takes.portions import Portion, read_portion
from dousa.library.takes.scanning import TakesOnDisk
from dousa.retrieval.takes.windows import TAKE_RATE, TakeWindows

AT_ONCE = 20_000
EXCHANGED = 0.3


def replicate(path: Path, n_clips: int) -> None:
    """Add rows to a trained library, a file, until it has so many clips."""
    chance = np.random.default_rng(0)
    with Library.open(path) as library:
        with library.database.reading() as connection:
            stored = load_forest(connection, library.name)
            assert stored is not None
            known = _Known(connection)
        for start in range(len(known.clips), n_clips, AT_ONCE):
            with library.database.writing() as connection:
                next_revision(connection)
                note_changed_clips(connection)
                known.add(connection, stored, min(AT_ONCE, n_clips - start), chance)


def replicate_take(path: Path, hours: float) -> int:
    """Add takes made of the one take of a trained library, a file, until it has so many hours; how many there are.

    Each is of somebody who stands and moves a little differently: to the poses of every joint a constant and a slow
    movement are added, and a third of the leaves of a window are those of another of the same length. Positions are
    those of the one take.
    """
    clips, windows, arrays = schema.clips, schema.take_windows, schema.clip_trajectories
    chance = np.random.default_rng(0)
    with Library.open(path) as library:
        with library.database.reading() as connection:
            row = connection.execute(sa.select(clips).where(clips.c.kind == schema.TAKE)).one()._mapping
            own = connection.execute(sa.select(windows).where(windows.c.clip_id == row["id"])).one()
            data = connection.execute(sa.select(arrays.c.positions).where(arrays.c.clip_id == row["id"])).scalar_one()
        count = max(round(hours * 3600 / row["duration"]), 1)
        known = TakeWindows.from_bytes(own.data)
        for _ in range(count - 1):
            made = vary(known, chance).to_bytes()
            with library.database.writing() as connection:
                next_revision(connection)
                (number,) = take_clip_ids(connection, 1)
                new = {**row, "id": number, "path": f"{row['path']}.{number}", "content_hash": f"{number:064}"}
                connection.execute(sa.insert(clips), seal_rows(clips, [new]))
                sums = seal_positions(number, data)
                connection.execute(sa.insert(arrays), [{"clip_id": number, "positions": data, "block_checksums": sums}])
                connection.execute(sa.insert(windows), [{**own._mapping, "clip_id": number, "data": made}])
    return count


def vary(take: TakeWindows, chance: np.random.Generator) -> TakeWindows:
    """A take of somebody else who does nearly the same."""
    n_values = take.poses.shape[1]
    times = np.arange(take.n_frames)[:, None] / TAKE_RATE
    waves = np.sin(times * chance.uniform(0.1, 1.0, n_values) + chance.uniform(0, 6.3, n_values))
    moved = take.poses + chance.normal(0, 0.03, n_values) + chance.uniform(0, 0.03, n_values) * waves
    lengths = take.stops - take.starts
    leaves = take.leaves.copy()
    for length in take.grid.lengths:
        rows = np.flatnonzero(lengths == length)
        other = chance.random((len(rows), leaves.shape[1])) < EXCHANGED
        leaves[rows] = np.where(other, take.leaves[chance.permutation(rows)], take.leaves[rows])
    return TakeWindows(take.grid, leaves, moved.astype(np.float16), take.duration)


def copy_windows(path: Path, hours: float) -> tuple[TakesOnDisk, int]:
    """Takes on disk of so many hours, the files of windows beside a library and copies of these; and how many."""
    files = sorted(Path(f"{path}-windows").glob("*.windows"))
    known = [portion for portion in map(read_portion, files) if portion is not None]
    portions: list[Portion] = []
    places: dict[int, tuple[int, int]] = {}
    seconds = 0.0
    while seconds < 3600 * hours:
        one = known[len(portions) % len(known)]
        there = one.path
        if len(portions) >= len(known):
            there = Path(shutil.copyfile(one.path, f"{path}-windows/{len(portions):06}.copy"))
        ids = len(places) + np.arange(len(one.ids))
        places.update({number: (len(portions), place) for place, number in enumerate(ids.tolist())})
        portions.append(replace(one, path=there, ids=ids))
        seconds += float(one.durations.sum())
    return TakesOnDisk(portions, places), len(places)


class _Known:
    """The clips of the small library."""

    def __init__(self, connection: sa.Connection) -> None:
        clips, leaves, poses = schema.clips, schema.clip_leaves, schema.clip_poses
        query = sa.select(clips).join(leaves, leaves.c.clip_id == clips.c.id).order_by(clips.c.id)
        self.clips = [row._mapping for row in connection.execute(query)]
        reached = connection.execute(sa.select(leaves.c.leaves, leaves.c.direction).order_by(leaves.c.clip_id)).all()
        self._leaves = np.stack([np.frombuffer(row.leaves, "<i4") for row in reached])
        self._directions = np.stack([np.frombuffer(row.direction, "<f4") for row in reached])
        self._poses = list(connection.execute(sa.select(poses.c.poses).order_by(poses.c.clip_id)).scalars())
        words = schema.clip_relations.c
        kept = connection.execute(sa.select(words.version, words.relations).order_by(words.clip_id)).all()
        self._words = [(row.version, row.relations, json.dumps(row.relations)) for row in kept]
        names, self._numbers = np.unique([clip["category"] for clip in self.clips], return_inverse=True)
        self._of_category = [np.flatnonzero(self._numbers == number) for number in range(len(names))]

    def add(self, connection: sa.Connection, stored: StoredForest, count: int, chance: np.random.Generator) -> None:
        first = chance.integers(len(self.clips), size=count)
        drawn = chance.random(count)
        own = [self._of_category[number] for number in self._numbers[first]]
        second = np.array([rows[int(share * len(rows))] for rows, share in zip(own, drawn, strict=True)])
        other = chance.random((count, self._leaves.shape[1])) < EXCHANGED
        leaves = np.where(other, self._leaves[second], self._leaves[first])
        ways = self._directions[first] + np.float32(EXCHANGED) * self._directions[second]
        ways /= np.linalg.norm(ways, axis=1, keepdims=True)
        ids = list(take_clip_ids(connection, count))
        rows = [self.clips[row] for row in first]
        paths = [f"{row['path']}.{number}" for row, number in zip(rows, ids, strict=True)]
        labels = [ids, paths, *([row[c.name] for row in rows] for c in LABELS.covered[2:])]
        names = [c.name for c in schema.clips.c if c.name not in {*(k.name for k in LABELS.columns), "checksum"}]
        rest: list[list[Any]] = [["[]" if name == "warnings" else row[name] for row in rows] for name in names]
        rest[names.index("content_hash")] = [f"{number:064}" for number in ids]
        _insert(connection, LABELS, labels, dict(zip(names, rest, strict=True)))
        _insert(connection, POSES, [ids, [self._poses[row] for row in first]])
        words = [self._words[row] for row in first]
        sums = RELATIONS.compute_all([ids, [version for version, _, _ in words], [own for _, own, _ in words]])
        said = [(number, *row[::2], own) for number, row, own in zip(ids, words, sums, strict=True)]
        text = "INSERT INTO clip_relations (clip_id, version, relations, checksum) VALUES (?, ?, ?, ?)"
        connection.exec_driver_sql(text, said)
        some = (leaves[start : start + 1024] for start in range(0, len(leaves), 1024))  # votes take memory
        voted = [name for few in some for name in count_votes(stored, few).predicted()]
        told = [ids, voted, [leaf.tobytes() for leaf in leaves], [way.tobytes() for way in ways]]
        _insert(connection, LEAVES, told)


def _insert(
    connection: sa.Connection, seal: Seal, columns: list[list[Any]], more: dict[str, list[Any]] | None = None
) -> None:
    """Rows of a table by columns, with their checksums, past SQLAlchemy, which takes ten times as long."""
    values = {column.name: own for column, own in zip(seal.covered, columns, strict=True)}
    values |= {seal.checksum.name: seal.compute_all(columns), **(more or {})}
    text = f"INSERT INTO {seal.checksum.table.name} ({', '.join(values)}) VALUES ({', '.join('?' * len(values))})"
    connection.exec_driver_sql(text, list(zip(*values.values(), strict=True)))
