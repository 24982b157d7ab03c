"""Learning from added clips, and the examples that leaves of a large forest grow from.

Clips are first written with the present tree answers and noted in ``unlearned``; the forest then learns from all noted
clips in one transaction, so a stopped program loses nothing. The result depends neither on the order of the clips nor
on how many are learned at a time.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import sqlalchemy as sa
from numpy.typing import NDArray

from dousa.arrays import BoolArray, FloatArray, IndexArray, IntArray
from dousa.errors import LibraryDamagedError
from dousa.library.search.leaf_index import ReadClips
from dousa.library.search.renewal import LearnedRows, keep_learned, read_standing, teach_rows
from dousa.library.store import schema
from dousa.library.store.checksums import EXAMPLES, LEAVES
from dousa.library.store.engine import Database, next_revision
from dousa.library.store.features import find_feature_set, load_features
from dousa.library.store.forests import StoredForest, TreeAnswers, find_leaves, load_forest, make_keys, update_forest
from dousa.library.store.rows import fetch_in, portions, seal_rows, update_rows
from dousa.library.store.schema import pack
from dousa.retrieval.forest.standing_leaves import MOST_EXAMPLES, StandingLeaves, choose_examples

if TYPE_CHECKING:
    from dousa.retrieval.forest.growth import Growth

_ID = 1  # of the only row, by definition


def choose_trained(
    stored: StoredForest, ids: IntArray, categories: NDArray[np.int32], answers: TreeAnswers
) -> NDArray[np.int32] | None:
    """Choose the clips (L, E) that are examples of each leaf, -1 for none; None if the forest needs no examples.

    ``ids``, ``categories`` : (N,), in the order of their contents; category -1 for none.
    ``answers`` : tree answers about the clips.
    """
    if not stored.forest.trees_.pooled:
        return None
    rows = np.flatnonzero((categories >= 0) & (ids < stored.first_later))
    return _choose(stored, (ids, categories), rows, lambda some: answers.leaves[some])


def _choose(
    stored: StoredForest,
    clips: tuple[IntArray, NDArray[Any]],
    rows: IndexArray,
    read_leaves: Callable[[IndexArray], NDArray[np.int32]],
    *,
    at_once: int = 16_384,
) -> NDArray[np.int32]:
    """Choose examples among some rows of clips (numbers, categories), whose leaves are read ``at_once``."""
    ids, categories = clips
    parts = (rows[start : start + at_once] for start in range(0, len(rows), at_once))
    handed = ((ids[some], categories[some].astype(np.int32), read_leaves(some)) for some in parts)
    return choose_examples(handed, stored.forest.trees_.n_leaves)


def make_examples(
    connection: sa.Connection, stored: StoredForest, ids: IntArray, categories: IntArray, leaves: StandingLeaves
) -> NDArray[np.int32]:
    """Choose examples as in ``choose_trained`` where none are stored; ``ids`` (N,) ascend, category -1 is none."""
    table, homes = schema.clips.c, stored.forest.trees_.home_leaves
    query = sa.select(table.id).where(table.id < stored.first_later).order_by(table.content_hash)
    ordered = np.fromiter(connection.execute(query).scalars(), np.int64)
    places = np.minimum(np.searchsorted(ids, ordered), max(len(ids) - 1, 0))
    places = places[(ids[places] == ordered) & (categories[places] >= 0)] if len(ids) else places[:0]
    return _choose(stored, (ids, categories), places, lambda some: homes[leaves.take(some)])


def find_places(kept: NDArray[np.int32], leaves: IndexArray, ids: IntArray) -> IntArray:
    """Return (n, E) places among ascending ids (N,) of the examples of some leaves (n,), -1 for missing ones."""
    wanted = kept[leaves]
    if not len(ids):
        return np.full(wanted.shape, -1)
    places = np.minimum(np.searchsorted(ids, wanted), len(ids) - 1)
    there: BoolArray = ids[places] == wanted
    return np.where(there, places, -1)


def load_examples(connection: sa.Connection, stored: StoredForest) -> NDArray[np.int32] | None:
    """Load the examples of a forest; None if they are missing or damaged."""
    row = connection.execute(sa.select(*EXAMPLES.columns)).first()
    if row is None or row.revision != stored.revision:
        return None
    try:
        EXAMPLES.check(connection, row)
    except LibraryDamagedError:
        return None
    kept = np.frombuffer(row.clips, "<i4")
    # Leaves that grew after the training have no examples, and higher numbers.
    return kept.reshape(-1, MOST_EXAMPLES) if len(kept) and not len(kept) % MOST_EXAMPLES else None


def save_examples(connection: sa.Connection, revision: int, kept: NDArray[np.int32] | None) -> None:
    """Replace the stored examples by those of the forest of a revision."""
    table = schema.leaf_examples
    connection.execute(sa.delete(table))
    if kept is not None:
        row = {"id": _ID, "revision": revision, "clips": pack(kept, "<i4")}
        connection.execute(sa.insert(table), seal_rows(table, [row]))


Stamp = tuple[int, int, int, tuple[int, ...]]
"""``revision`` and ``learned`` of the forest, ``clips_revision`` of the library, and numbers of unlearned clips."""


@dataclass(frozen=True, slots=True)
class Learned:
    """The number of added clips with a category from which a forest learned, and the new categories among theirs."""

    n_clips: int = 0
    new_categories: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class _Lesson:
    """The planned changes when a forest learns.

    Parameters
    ----------
    stamp : of the library when they were planned.
    stored : the forest after learning; None in an untrained library.
    rows : all clips after learning.
    examples : of the leaves, if they had to be made.
    """

    stamp: Stamp
    stored: StoredForest | None
    learned: Learned = Learned()
    rows: LearnedRows | None = None
    examples: NDArray[np.int32] | None = None


def learn_new(database: Database, known: StoredForest | None) -> tuple[StoredForest | None, Learned]:
    """Let the forest (``known`` if it is loaded) learn from all unlearned clips.

    Return the forest after learning, None before the training, and what it learned.
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
        return _Lesson(stamp, None) if stored is None else _work_out(connection, database.where, stored, stamp)

    stored, learned, rows = database.write_planned(plan, _write)
    if stored is not None and rows is not None:
        keep_learned(database, stored, rows)
    return stored, learned


def _write(connection: sa.Connection, lesson: _Lesson) -> tuple[StoredForest | None, Learned, LearnedRows | None]:
    stored, waiting = lesson.stored, lesson.stamp[3]
    table = schema.unlearned
    for some in portions(waiting):
        connection.execute(sa.delete(table).where(table.c.clip_id.in_(some)))
    if stored is None or not waiting:
        return stored, lesson.learned, None
    stored = replace(stored, learned=next_revision(connection))
    update_forest(connection, stored, lesson.learned.n_clips)
    if lesson.examples is not None:
        save_examples(connection, stored.revision, lesson.examples)
    rows = lesson.rows
    if rows is not None:
        rows = rows.sealed(update_rows(connection, LEAVES, rows.changes))
    return stored, lesson.learned, rows


def _read_stamp(connection: sa.Connection) -> Stamp:
    forests = schema.forests.c
    forest = connection.execute(sa.select(forests.revision, forests.learned)).first() or (0, 0)
    changed = connection.execute(sa.select(schema.library_state.c.clips_revision)).scalar() or 0
    waiting = connection.execute(sa.select(schema.unlearned.c.clip_id).order_by(schema.unlearned.c.clip_id)).scalars()
    return int(forest[0]), int(forest[1]), int(changed), tuple(waiting)


@dataclass(frozen=True, slots=True, eq=False)
class _Clips:
    """N clips that have leaves, sorted by number.

    ``given`` : (N,) places in ``names`` of the given categories, -1 for none.
    ``leaves`` : (N, n_trees), possibly in a file.
    """

    ids: IntArray
    given: IntArray
    names: list[str]
    leaves: StandingLeaves


def _work_out(connection: sa.Connection, where: str, stored: StoredForest, stamp: Stamp) -> _Lesson:
    rows = read_standing(connection, where, stored)
    clips = _gather_clips(rows)
    waiting = np.isin(clips.ids, stamp[3])
    new = np.flatnonzero(waiting & (clips.given >= 0))
    if not len(new):
        return _Lesson(stamp, stored)
    known = set(stored.categories)
    # Clips with a category that was given later and is unknown to the forest do not count in leaves.
    stands = np.array([*(name in known for name in clips.names), False])[clips.given] & ~waiting
    labels = np.array([clips.names[number] for number in clips.given[new]], dtype=np.str_)
    features = load_features(connection, stored.feature_set, clips.ids[new].tolist()).features
    examples, made = None, None
    if stored.forest.trees_.pooled:
        examples = load_examples(connection, stored)
        if examples is None:
            own = np.where(stands, clips.given, -1)
            examples = made = make_examples(connection, stored, clips.ids, own, clips.leaves)
    growth = _grow(connection, stored, clips, (stands, examples), (features, labels, clips.ids[new]))
    grown = stored.grown(growth.forest, features, labels)
    ids, leaves = _find_moved(connection, grown, clips, (stands, new), growth)
    learned = Learned(len(new), tuple(sorted(set(labels.tolist()) - known)))
    return _Lesson(stamp, grown, learned, teach_rows(stored, grown, rows, ids, leaves), made)


@dataclass(frozen=True, slots=True, eq=False)
class _Keys:
    """Keys of the contents of clips, read when needed."""

    connection: sa.Connection
    ids: IntArray

    def __getitem__(self, places: IntArray) -> NDArray[np.uint64]:
        clips = schema.clips.c
        wanted = self.ids[places].tolist()
        query = sa.select(clips.id, clips.content_hash)
        found = {row.id: row.content_hash for row in fetch_in(self.connection, query, clips.id, wanted)}
        return make_keys(found[number] for number in wanted)


def _grow(
    connection: sa.Connection,
    stored: StoredForest,
    clips: _Clips,
    there: tuple[BoolArray, NDArray[np.int32] | None],
    new: tuple[FloatArray, NDArray[np.str_], IntArray],
) -> Growth:
    """Grow the forest by new clips (features, categories, numbers).

    ``there`` is which clips it has learned, and the examples of its leaves, if there are any.
    """
    from dousa.retrieval.forest.growth import StandingClips, grow_forest

    stands, kept = there
    ids = clips.ids[stands]

    def read_features(places: NDArray[np.int64]) -> FloatArray:
        return load_features(connection, stored.feature_set, ids[places].tolist()).features

    standing = StandingClips(
        clips.given[stands],
        clips.leaves.only(stands),
        read_features,
        _Keys(connection, ids),
        ids >= stored.first_later,
        np.array([*clips.names], np.str_),
        None if kept is None else lambda leaves: find_places(kept, leaves, ids),
    )
    features, labels, numbers = new
    keys = _Keys(connection, numbers)[np.arange(len(numbers))]
    kind = find_feature_set(stored.feature_set)
    return grow_forest(stored.forest, standing, features, labels, keys=keys, feature_set=kind)


def _gather_clips(rows: ReadClips) -> _Clips:
    from dousa.retrieval.forest.standing_leaves import LeafCodes, StandingLeaves

    parts = list(zip(rows.parts, rows.list_alive(), strict=True))
    ids = np.concatenate([part.ids[alive] for part, alive in parts])
    order = np.argsort(ids, kind="stable")
    places = np.empty(len(ids), np.int64)
    places[order] = np.arange(len(ids))
    names = sorted({name for part, _ in parts for name in part.names})
    numbers = {name: number for number, name in enumerate(names)}
    labels, codes, start = [], [], 0
    for part, alive in parts:
        own = np.full(len(part), -1)
        own[alive] = places[start : start + int(alive.sum())]
        start += int(alive.sum())
        codes.append(LeafCodes(part.codes, part.table, part.offsets, own))
        renumbered = np.array([*(numbers[name] for name in part.names), -1])
        labels.append(renumbered[part.given[alive]])
    return _Clips(ids[order], np.concatenate(labels)[order], names, StandingLeaves(codes, len(ids)))


def _find_moved(
    connection: sa.Connection,
    grown: StoredForest,
    clips: _Clips,
    taught: tuple[BoolArray, IntArray],
    growth: Growth,
    *,
    at_once: int = 16_384,
) -> tuple[IntArray, NDArray[np.int32]]:
    """Return the ascending numbers of the clips that moved to other leaves, and these.

    ``taught`` is which clips the forest has learned, and the rows of the new ones; ``at_once`` clips are compared.
    """
    stands, new = taught
    rows = [np.flatnonzero(stands)[growth.moved], new]
    leaves = [growth.moved_leaves, growth.leaves]
    others = ~stands
    others[new] = False
    if growth.stay is not None:  # clips of the training stay
        trained = others & (clips.ids < grown.first_later)
        others &= ~trained
        where = np.flatnonzero(trained)
        back = where[clips.leaves.only(trained).find(growth.stay != np.arange(len(growth.stay)))]
        rows.append(back)
        leaves.append(growth.stay[clips.leaves.take(back)].astype(np.int64))
    if others.any():
        where = np.flatnonzero(others)
        again = where[clips.leaves.only(others).find(growth.changed)]
        if len(again):
            rows.append(again)
            features = load_features(connection, grown.feature_set, clips.ids[again].tolist()).features
            leaves.append(find_leaves(grown, features).astype(np.int64))
    places, now = np.concatenate(rows), np.concatenate(leaves).astype(np.int32)
    differs = np.empty(len(places), np.bool_)
    for first in range(0, len(places), at_once):
        some = slice(first, first + at_once)
        differs[some] = (now[some] != clips.leaves.take(places[some])).any(axis=1)
    order = np.flatnonzero(differs)[np.argsort(places[differs], kind="stable")]
    return clips.ids[places[order]], now[order]
