"""A large library for searches, made of the rows of a small one that is trained: what a search costs depends on these.

Each new clip has the leaves of one clip of the small library, a third of them exchanged for those of another of its
category, the direction between both, and the poses and the words of the first. It has neither positions nor features.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import sqlalchemy as sa

from dousa.library import Library, schema
from dousa.library.engine import next_revision, note_changed_clips, take_clip_ids
from dousa.library.forests import StoredForest, load_forest, name_votes
from dousa.library.seals.checksums import LABELS, LEAVES, POSES, RELATIONS, Seal, seal_positions, seal_rows

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
    """Add rows of its one take to a trained library, a file, until it has so many hours; returns how many there are."""
    clips, windows, arrays = schema.clips, schema.take_windows, schema.clip_trajectories
    with Library.open(path) as library:
        with library.database.reading() as connection:
            row = connection.execute(sa.select(clips).where(clips.c.kind == schema.TAKE)).one()._mapping
            own = connection.execute(sa.select(windows).where(windows.c.clip_id == row["id"])).one()
            data = connection.execute(sa.select(arrays.c.positions).where(arrays.c.clip_id == row["id"])).scalar_one()
        count = max(round(hours * 3600 / row["duration"]), 1)
        for _ in range(count - 1):
            with library.database.writing() as connection:
                next_revision(connection)
                (number,) = take_clip_ids(connection, 1)
                new = {**row, "id": number, "path": f"{row['path']}.{number}", "content_hash": f"{number:064}"}
                connection.execute(sa.insert(clips), seal_rows(clips, [new]))
                sums = seal_positions(number, data)
                connection.execute(sa.insert(arrays), [{"clip_id": number, "positions": data, "block_checksums": sums}])
                connection.execute(sa.insert(windows), [{**own._mapping, "clip_id": number}])
    return count


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
        told = [ids, name_votes(stored, leaves), [leaf.tobytes() for leaf in leaves], [way.tobytes() for way in ways]]
        _insert(connection, LEAVES, told)


def _insert(
    connection: sa.Connection, seal: Seal, columns: list[list[Any]], more: dict[str, list[Any]] | None = None
) -> None:
    """Rows of a table by columns, with their checksums, past SQLAlchemy, which takes ten times as long."""
    values = {column.name: own for column, own in zip(seal.covered, columns, strict=True)}
    values |= {seal.checksum.name: seal.compute_all(columns), **(more or {})}
    text = f"INSERT INTO {seal.checksum.table.name} ({', '.join(values)}) VALUES ({', '.join('?' * len(values))})"
    connection.exec_driver_sql(text, list(zip(*values.values(), strict=True)))
