"""Writing what was read: the rows of a new clip or take, and what the forest says of it and learns from it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

import numpy as np
import sqlalchemy as sa

from dousa.library import schema
from dousa.library._describing import Description, describe_clip
from dousa.library._features import save_descriptions
from dousa.library._forests import StoredForest, ask_trees, save_answers
from dousa.library._learning import Learned, learn_clips
from dousa.library._revision import note_changed_clips, take_clip_ids
from dousa.library._take_windows import DescribedTakes, save_windows
from dousa.library.ingest import ClipRecord

__all__ = ["Fresh", "Labels", "insert_clips"]

Labels = dict[str, str | None]


@dataclass(frozen=True, slots=True, eq=False)
class Fresh:
    """A clip or take to be written.

    Parameters
    ----------
    record : the motion.
    labels : its category and performer.
    option_text : what was said about the file.
    """

    record: ClipRecord
    labels: Labels
    option_text: str


def insert_clips(
    connection: sa.Connection,
    fresh: Sequence[Fresh],
    stored: StoredForest | None,
    takes: DescribedTakes,
    revision: int,
) -> tuple[StoredForest | None, Learned]:
    """Write new clips and takes with everything that belongs to them.

    Parameters
    ----------
    connection : in a transaction that writes.
    fresh : what to write.
    stored : the forest of the library, if it has one.
    takes : windows of takes that were described before.
    revision : of the library in this transaction.

    Returns
    -------
    The forest, after it learned from the clips that have a category; and what it learned.
    """
    ids = take_clip_ids(connection, len(fresh))
    rows = [_clip_row(clip_id, item) for clip_id, item in zip(ids, fresh, strict=True)]
    connection.execute(sa.insert(schema.clips), rows)
    positions = [
        {"clip_id": clip_id, "positions": item.record.positions}
        for clip_id, item in zip(ids, fresh, strict=True)
    ]
    connection.execute(sa.insert(schema.clip_trajectories), positions)
    clips = {
        clip_id: item for clip_id, item in zip(ids, fresh, strict=True) if item.record.kind == schema.CLIP
    }
    recordings = {
        clip_id: item.record for clip_id, item in zip(ids, fresh, strict=True) if clip_id not in clips
    }
    if clips:
        note_changed_clips(connection)
    if stored is None:
        return None, Learned()
    learned = Learned()
    if clips:
        stored, learned = _insert_answers(connection, clips, stored, revision)
    save_windows(connection, stored, takes.of(stored, recordings))
    return stored, learned


def _insert_answers(
    connection: sa.Connection, clips: Mapping[int, Fresh], stored: StoredForest, revision: int
) -> tuple[StoredForest, Learned]:
    """What the trees say of new clips, after they learned from those that have a category."""
    numbers = list(clips)
    described = [_describe(stored, item.record) for item in clips.values()]
    save_descriptions(connection, numbers, described)
    features = np.stack([description.features for description in described])
    labels = [item.labels["category"] for item in clips.values()]
    stored, learned = learn_clips(connection, stored, features, labels, revision)
    save_answers(connection, numbers, ask_trees(stored, features))
    return stored, learned


def _describe(stored: StoredForest, record: ClipRecord) -> Description:
    """Features and poses of a clip; computed here only if the forest changed while the file was read."""
    known = record.description
    if known is not None and known.feature_set == stored.feature_set:
        return known
    return describe_clip(record.to_motion(), stored.feature_set)


def _clip_row(clip_id: int, fresh: Fresh) -> dict[str, Any]:
    record = fresh.record
    return {
        "id": clip_id,
        "path": record.path,
        "content_hash": record.content_hash,
        "fingerprint": record.state.fingerprint,
        "size": record.state.size,
        "read_options": fresh.option_text,
        "category": fresh.labels["category"],
        "performer": fresh.labels["performer"],
        "format": record.format,
        "n_frames": record.n_frames,
        "frame_rate": record.frame_rate,
        "duration": record.duration,
        "height": record.height,
        "joint_table": record.joint_table,
        "warnings": list(record.warnings),
        "added_at": datetime.now(UTC).isoformat(timespec="seconds"),
        "kind": record.kind,
    }
