"""Writing new clips, takes and segments with everything that belongs to them."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime
from typing import Any

import sqlalchemy as sa

from dousa.library import schema
from dousa.library.engine import note_changed_clips, take_clip_ids
from dousa.library.features import pack_positions, save_descriptions
from dousa.library.forests import note_unlearned, save_answers
from dousa.library.fragments.arrays import put_aside
from dousa.library.growth.arrival import Arrival
from dousa.library.ingest import ClipRecord
from dousa.library.seals.checksums import seal_positions, seal_rows
from dousa.library.takes.kept_windows import save_windows
from dousa.library.text.store import keep_relations, save_relations


def insert_clips(connection: sa.Connection, fresh: Sequence[ClipRecord], arrival: Arrival) -> None:
    """Write new clips, takes and segments, with the labels in their rows, and everything that belongs to them.

    The forest has those that have a category still to learn: ``lesson.learn_new`` follows in a transaction of its own.

    Parameters
    ----------
    arrival : what follows from them, in the library as it is in this transaction.
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
    connection.execute(sa.insert(schema.clips), seal_rows(schema.clips, rows))
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
    if places:
        connection.execute(sa.insert(schema.segments), seal_rows(schema.segments, places))
