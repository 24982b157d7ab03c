"""Insertion of new clips, takes and segments, with relations, tree answers and windows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any

import numpy as np
import sqlalchemy as sa

from dousa.library.search.text_store import describe_relations, keep_relations, save_relations
from dousa.library.store import schema
from dousa.library.store.checksums import seal_positions
from dousa.library.store.engine import note_changed_clips, take_clip_ids
from dousa.library.store.features import Description, describe_clip, lacks, pack_positions, save_descriptions
from dousa.library.store.forests import StoredForest, TreeAnswers, ask_trees, note_unlearned, save_answers
from dousa.library.store.fragments import put_aside
from dousa.library.store.ingest import ClipRecord
from dousa.library.store.rows import insert_rows
from dousa.library.takes.windows import describe_windows, save_windows


@dataclass(frozen=True, slots=True, eq=False)
class Arrival:
    """The derived data of new clips, segments and takes.

    Parameters
    ----------
    stored : the forest of the answers; None in an untrained library.
    names : path, content hash and kind of each motion.
    described : features and poses of clips with all joints of the forest, by place among the motions.
    answers : tree answers about these.
    windows : of takes, by place.
    relations : of all motions, as JSON.
    """

    stored: StoredForest | None
    names: tuple[Any, ...]
    described: Mapping[int, Description] = field(default_factory=dict)
    answers: TreeAnswers | None = None
    windows: Mapping[int, bytes] = field(default_factory=dict)
    relations: Sequence[list[list[Any]]] = ()


def describe_arrival(stored: StoredForest | None, fresh: Sequence[ClipRecord], known: Arrival | None = None) -> Arrival:
    """Compute the derived data of new motions.

    ``stored`` : the forest of the library; None before the training.
    ``known`` : earlier data, returned if it is still valid.
    """
    names = tuple((record.path, record.row["content_hash"], record.row["kind"]) for record in fresh)
    if known is not None and known.names == names and known.stored is stored:
        return known
    relations = [describe_relations(record.motion) for record in fresh]
    if stored is None:
        return Arrival(None, names, relations=relations)
    # Bodies that lack joints of the forest have their own forests, learned when needed.
    whole = [place for place, record in enumerate(fresh) if not lacks(stored.feature_set, record.row["absent"])]
    described = {p: _describe(stored, fresh[p]) for p in whole if fresh[p].row["kind"] == schema.CLIP}
    answers = None
    if described:
        answers = ask_trees(stored, np.stack([description.features for description in described.values()]))
    windows = {
        place: describe_windows(stored, fresh[place].motion, None).to_bytes()
        for place in whole
        if fresh[place].row["kind"] == schema.TAKE
    }
    return Arrival(stored, names, described, answers, windows, relations)


def _describe(stored: StoredForest, record: ClipRecord) -> Description:
    """Return features and poses of a clip, computed only if the forest changed while the file was read."""
    known = record.description
    if known is not None and known.feature_set == stored.feature_set:
        return known
    return describe_clip(record.motion, stored.feature_set)


def insert_clips(connection: sa.Connection, fresh: Sequence[ClipRecord], arrival: Arrival) -> None:
    """Write new clips, takes and segments with their derived data, as of this transaction.

    The forest learns from them later (``lesson.learn_new``), in a transaction of its own.
    """
    numbers = list(take_clip_ids(connection, len(fresh)))
    _insert_rows(connection, numbers, fresh)
    save_relations(connection, dict(zip(numbers, arrival.relations, strict=True)))
    keep_relations(connection)
    if any(record.row["kind"] == schema.CLIP for record in fresh):
        note_changed_clips(connection)
    if arrival.stored is None:
        return
    if arrival.answers is not None:
        asked = [numbers[place] for place in arrival.described]
        save_descriptions(connection, asked, list(arrival.described.values()))
        save_answers(connection, asked, arrival.answers)
        taught = [numbers[place] for place in arrival.described if fresh[place].row["category"] is not None]
        note_unlearned(connection, taught)
    save_windows(connection, arrival.stored, {numbers[place]: data for place, data in arrival.windows.items()})


def _insert_rows(connection: sa.Connection, numbers: Sequence[int], fresh: Sequence[ClipRecord]) -> None:
    now = datetime.now(UTC).isoformat(timespec="seconds")
    rows = [{**record.row, "id": number, "added_at": now} for number, record in zip(numbers, fresh, strict=True)]
    insert_rows(connection, schema.clips, rows)
    positions: list[dict[str, Any]] = []
    places: list[dict[str, Any]] = []
    for number, record in zip(numbers, fresh, strict=True):
        if record.place is None:
            data = pack_positions(record.motion)
            positions.append({"clip_id": number, "positions": data, "block_checksums": seal_positions(number, data)})
        else:
            places.append({"clip_id": number, **record.place})
    if positions:
        connection.execute(sa.insert(schema.clip_trajectories), put_aside(connection, positions, "positions"))
    insert_rows(connection, schema.segments, places)
