"""What a forest learns from clips that were added: worked out beside other writers, then written at once.

Clips are written first, with what the forest says of them as it is, and noted in ``unlearned``; whoever adds clips lets
the forest learn from all that are noted, once, when the last is written. A program that is stopped in between loses
nothing: the next one learns from what it wrote. What comes out depends on the clips, and neither on their order nor on
how many were learned at a time.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from hashlib import blake2b
from typing import TYPE_CHECKING, Any

import numpy as np
import sqlalchemy as sa
from numpy.typing import NDArray

from dousa.arrays import BoolArray, FloatArray, IndexArray
from dousa.library import schema
from dousa.library.engine import Database, next_revision
from dousa.library.features import find_feature_set, load_features
from dousa.library.forests import StoredForest, check_leaves, find_leaves, load_forest, name_votes, update_forest
from dousa.library.schema import pack, stack
from dousa.library.seals.checksums import LABELS, LEAVES, update_rows
from dousa.library.selection import portions
from dousa.retrieval.forest.calibration import Assessor

if TYPE_CHECKING:
    from dousa.retrieval.forest.growth import Growth

Stamp = tuple[int, int, int, tuple[int, ...]]
"""Of what a forest learns from: its ``revision`` and ``learned``, the ``clips_revision`` of the library, and the clips
that it has still to learn."""


@dataclass(frozen=True, slots=True)
class Learned:
    """What a forest learned from clips that were added.

    Parameters
    ----------
    n_clips : clips that have a category.
    new_categories : those that the forest did not know.
    """

    n_clips: int = 0
    new_categories: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class _Lesson:
    """What follows from the clips that a forest has still to learn.

    Parameters
    ----------
    stamp : of the library for which it was worked out.
    stored : the forest as it has learned; None in a library that is not trained.
    learned : what it learned.
    changes : by number, the values in ``clip_leaves`` that change.
    """

    stamp: Stamp
    stored: StoredForest | None
    learned: Learned = Learned()
    changes: Mapping[int, dict[str, Any]] = field(default_factory=dict)


def learn_new(database: Database, known: StoredForest | None) -> tuple[StoredForest | None, Learned]:
    """Let the forest learn from the clips that it has still to learn.

    Parameters
    ----------
    known : the forest as it was loaded before, if it was.

    Returns
    -------
    The forest as it is then, None before the training, and what it learned.
    """
    with database.reading() as connection:
        forest = load_forest(connection, database.where, known)
        waiting = connection.execute(sa.select(schema.unlearned.c.clip_id).limit(1)).first()
    if forest is None or waiting is None:
        return forest, Learned()

    def plan(connection: sa.Connection, before: _Lesson | None) -> _Lesson:
        stamp = _read_stamp(connection)
        if before is not None and before.stamp == stamp:
            return before
        stored = load_forest(connection, database.where, forest)
        return _Lesson(stamp, None) if stored is None else _work_out(connection, stored, stamp)

    return database.write_planned(plan, _write)


def _write(connection: sa.Connection, lesson: _Lesson) -> tuple[StoredForest | None, Learned]:
    stored, waiting = lesson.stored, lesson.stamp[3]
    table = schema.unlearned
    for some in portions(waiting):
        connection.execute(sa.delete(table).where(table.c.clip_id.in_(some)))
    if stored is None or not waiting:
        return stored, lesson.learned
    stored = replace(stored, learned=next_revision(connection))
    update_forest(connection, stored, lesson.learned.n_clips)
    update_rows(connection, LEAVES, lesson.changes)
    return stored, lesson.learned


def _read_stamp(connection: sa.Connection) -> Stamp:
    forests = schema.forests.c
    forest = connection.execute(sa.select(forests.revision, forests.learned)).first() or (0, 0)
    changed = connection.execute(sa.select(schema.library_state.c.clips_revision)).scalar() or 0
    waiting = connection.execute(sa.select(schema.unlearned.c.clip_id).order_by(schema.unlearned.c.clip_id)).scalars()
    return int(forest[0]), int(forest[1]), int(changed), tuple(waiting)


@dataclass(frozen=True, slots=True, eq=False)
class _Clips:
    """Clips that have leaves: numbers (N,), categories, keys of their contents, predicted ones, leaves (N, n_trees)."""

    ids: NDArray[np.int64]
    categories: list[str | None]
    keys: NDArray[np.uint64]
    predicted: list[str]
    leaves: NDArray[np.int32]


def _work_out(connection: sa.Connection, stored: StoredForest, stamp: Stamp) -> _Lesson:
    clips = _read_clips(connection, stored)
    waiting = np.isin(clips.ids, stamp[3])
    named = np.array([name is not None for name in clips.categories], bool)
    new = np.flatnonzero(waiting & named)
    if not len(new):
        return _Lesson(stamp, stored)
    known = set(stored.categories)
    # Clips that were given a category later that the forest does not know stand in no leaf of theirs.
    stands = np.array([name in known for name in clips.categories], bool) & ~waiting
    labels = np.array([clips.categories[row] for row in new], dtype=np.str_)
    features = load_features(connection, stored.feature_set, clips.ids[new].tolist()).features
    growth = _grow(connection, stored, clips, np.flatnonzero(stands), (features, labels, clips.keys[new]))
    assessor = stored.assessor
    if assessor is not None:
        assessor = Assessor(growth.forest, assessor.calibration.with_clips(features, labels))
    categories = tuple(str(name) for name in growth.forest.classes_)
    grown = replace(stored, forest=growth.forest, categories=categories, assessor=assessor)
    leaves = _find_all_leaves(connection, grown, clips, (stands, new), growth)
    learned = Learned(len(new), tuple(sorted(set(labels.tolist()) - known)))
    return _Lesson(stamp, grown, learned, _compare_answers(grown, clips, leaves))


def _grow(
    connection: sa.Connection,
    stored: StoredForest,
    clips: _Clips,
    standing: IndexArray,
    new: tuple[FloatArray, NDArray[np.str_], NDArray[np.uint64]],
) -> Growth:
    """The forest with new clips (features, categories, keys), beside those that it knows."""
    from dousa.retrieval.forest.growth import StandingClips, grow_forest

    def read_features(places: NDArray[np.int64]) -> FloatArray:
        return load_features(connection, stored.feature_set, clips.ids[standing[places]].tolist()).features

    categories = np.array([clips.categories[row] for row in standing], dtype=np.str_)
    later = clips.ids[standing] >= stored.first_later
    there = StandingClips(categories, clips.leaves[standing], read_features, clips.keys[standing], later)
    features, labels, keys = new
    kind = find_feature_set(stored.feature_set)
    return grow_forest(stored.forest, there, features, labels, keys=keys, feature_set=kind)


def _read_clips(connection: sa.Connection, stored: StoredForest) -> _Clips:
    clips, table = schema.clips.c, schema.clip_leaves.c
    query = sa.select(*LABELS.columns, *LEAVES.columns, clips.content_hash)
    query = query.join(schema.clip_leaves, table.clip_id == clips.id).order_by(clips.id)
    own = len(LABELS.columns)
    rows = connection.execute(query).all()
    columns = list(zip(*rows, strict=True)) if rows else [()] * (own + len(LEAVES.columns) + 1)
    names = [column.name for column in (*LABELS.columns, *LEAVES.columns)]
    LABELS.check_all(connection, columns[:own])
    LEAVES.check_all(connection, columns[own:-1])
    leaves = stack(columns[own + names[own:].index("leaves")], "<i4", (len(stored.forest.trees_.roots),), "leaves")
    check_leaves(stored, leaves)
    return _Clips(
        np.array(columns[0], np.int64),
        list(columns[names.index("category")]),
        np.array([int.from_bytes(blake2b(text.encode(), digest_size=8).digest()) for text in columns[-1]], np.uint64),
        list(columns[names.index("predicted_category")]),
        leaves,
    )


def _find_all_leaves(
    connection: sa.Connection,
    grown: StoredForest,
    clips: _Clips,
    taught: tuple[BoolArray, IndexArray],
    growth: Growth,
) -> NDArray[np.int32]:
    """The leaves (N, n_trees) of all clips: ``taught`` are those that stand in leaves, and the new ones."""
    stands, new = taught
    leaves = clips.leaves.copy()
    leaves[np.flatnonzero(stands)[growth.moved]] = growth.moved_leaves
    leaves[new] = growth.leaves
    others = ~stands
    others[new] = False
    rows = np.flatnonzero(others)
    rows = rows[growth.changed[clips.leaves[rows]].any(axis=1)]
    if len(rows):
        leaves[rows] = find_leaves(
            grown, load_features(connection, grown.feature_set, clips.ids[rows].tolist()).features
        )
    return leaves


def _compare_answers(stored: StoredForest, clips: _Clips, leaves: NDArray[np.int32]) -> dict[int, dict[str, Any]]:
    """The leaves and the guesses that have changed, by number."""
    predicted = name_votes(stored, leaves)
    moved = (leaves != clips.leaves).any(axis=1)
    return {
        int(number): {"predicted_category": now, "leaves": pack(leaves[row], "<i4")}
        for row, (number, now, before) in enumerate(zip(clips.ids, predicted, clips.predicted, strict=True))
        if moved[row] or now != before
    }
