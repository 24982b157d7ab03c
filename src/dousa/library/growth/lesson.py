"""What a forest learns from new clips, and what follows for the others: worked out before anything is written.

The work takes seconds in a large library, so it is done on a snapshot, without keeping others from writing. A lesson is
written only if the forest and the clips are still those that it was worked out for (``Lesson.fits``).
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import sqlalchemy as sa
from numpy.typing import NDArray

from dousa.arrays import FloatArray
from dousa.library import schema
from dousa.library.features import Description, describe_clip, find_feature_set, lacks, load_features
from dousa.library.forests import StoredForest, TreeAnswers, ask_trees, count_votes, find_leaves
from dousa.library.ingest import ClipRecord
from dousa.library.schema import pack, stack
from dousa.library.seals.checksums import LABELS, LEAVES
from dousa.library.takes import describe_windows
from dousa.library.text.store import describe_relations
from dousa.retrieval.forest.calibration import Assessor

if TYPE_CHECKING:
    from dousa.retrieval.forest.growth import Growth

Stamp = tuple[int, int, int]
"""Of what a forest learns from: its ``revision`` and ``learned``, and the ``clips_revision`` of the library."""


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
class Lesson:
    """What follows from new clips, segments and takes.

    Parameters
    ----------
    stamp : of the library for which it was worked out.
    names : of the motions, with all that the lesson depends on.
    stored : the forest as it has learned; None in a library that is not trained.
    learned : what it learned.
    changes : by number, the values of other clips in ``clip_leaves`` that change.
    described : place among the motions, and features and poses, of those that the forest is asked about.
    answers : what it says of these.
    windows : by place, of takes.
    relations : by place, as JSON.
    """

    stamp: Stamp
    names: tuple[Any, ...]
    stored: StoredForest | None
    learned: Learned = Learned()
    changes: Mapping[int, dict[str, Any]] = field(default_factory=dict)
    described: Mapping[int, Description] = field(default_factory=dict)
    answers: TreeAnswers | None = None
    windows: Mapping[int, bytes] = field(default_factory=dict)
    relations: Sequence[list[list[Any]]] = ()

    def fits(self, stamp: Stamp, fresh: Sequence[ClipRecord], gone: Collection[int]) -> bool:
        """Whether it holds for these motions, in a library of this stamp from which some clips go."""
        return self.stamp == stamp and self.names == _name_all(fresh, gone)


def _name_all(fresh: Sequence[ClipRecord], gone: Collection[int]) -> tuple[Any, ...]:
    names = ("path", "content_hash", "category", "kind")
    return (tuple(sorted(gone)), *(tuple(record.row[name] for name in names) for record in fresh))


def read_stamp(connection: sa.Connection) -> Stamp:
    """The stamp of a library as it is."""
    forests = schema.forests.c
    forest = connection.execute(sa.select(forests.revision, forests.learned)).first() or (0, 0)
    changed = connection.execute(sa.select(schema.library_state.c.clips_revision)).scalar() or 0
    return int(forest[0]), int(forest[1]), int(changed)


def work_out(
    connection: sa.Connection,
    stored: StoredForest | None,
    fresh: Sequence[ClipRecord],
    gone: Collection[int],
    known: Lesson | None = None,
) -> Lesson:
    """What follows from new motions, with the labels in their rows.

    Parameters
    ----------
    stored : the forest of the library, None before the training.
    gone : numbers of clips that make room for the new ones.
    known : a lesson that was worked out before; returned where it fits.
    """
    stamp = read_stamp(connection)
    if known is not None and known.fits(stamp, fresh, gone):
        return known
    relations = [describe_relations(record.motion) for record in fresh]
    lesson = Lesson(stamp, _name_all(fresh, gone), stored, relations=relations)
    if stored is None:
        return lesson
    # Bodies that lack joints that it asks about are told apart by forests of their own, when they are needed.
    whole = [place for place, record in enumerate(fresh) if not lacks(stored.feature_set, record.row["absent"])]
    clips = [place for place in whole if fresh[place].row["kind"] == schema.CLIP]
    if clips:
        lesson = _learn(connection, lesson, stored, {place: fresh[place] for place in clips}, gone)
    grown = lesson.stored
    assert grown is not None
    windows = {
        place: describe_windows(grown, fresh[place].motion, None).to_bytes()
        for place in whole
        if fresh[place].row["kind"] == schema.TAKE
    }
    return replace(lesson, windows=windows)


def _learn(
    connection: sa.Connection,
    lesson: Lesson,
    stored: StoredForest,
    clips: Mapping[int, ClipRecord],
    gone: Collection[int],
) -> Lesson:
    """The lesson of clips: those that have a category teach the forest, and it is asked about all."""
    described = {place: _describe(stored, record) for place, record in clips.items()}
    features = np.stack([description.features for description in described.values()])
    categories = [record.row["category"] for record in clips.values()]
    labelled = [row for row, category in enumerate(categories) if category is not None]
    lesson = replace(lesson, described=described)
    if not labelled:
        return replace(lesson, answers=ask_trees(stored, features))
    labels = np.array([categories[row] for row in labelled], dtype=np.str_)
    grown, changes = _teach(connection, stored, (features[labelled], labels), gone)
    new = tuple(sorted(set(labels.tolist()) - set(stored.categories)))
    return replace(
        lesson,
        stored=grown,
        learned=Learned(len(labelled), new),
        changes=changes,
        answers=ask_trees(grown, features),
    )


def _describe(stored: StoredForest, record: ClipRecord) -> Description:
    """Features and poses of a clip; computed here only if the forest changed while the file was read."""
    known = record.description
    if known is not None and known.feature_set == stored.feature_set:
        return known
    return describe_clip(record.motion, stored.feature_set)


@dataclass(frozen=True, slots=True, eq=False)
class _Standing:
    """Clips that stand in the leaves: numbers (N,), categories, predicted categories, leaves (N, n_trees)."""

    ids: list[int]
    categories: list[str | None]
    predicted: list[str]
    leaves: NDArray[np.int32]


def _teach(
    connection: sa.Connection,
    stored: StoredForest,
    new: tuple[FloatArray, NDArray[np.str_]],
    gone: Collection[int],
) -> tuple[StoredForest, dict[int, dict[str, Any]]]:
    """The forest after features (M, frames, columns) of M new categories, and what it changes for others."""
    features, labels = new
    standing = _read_standing(connection, stored, gone)
    known = set(stored.categories)
    # Clips that were given a category later that the forest does not know stand in no leaf of theirs.
    taught = np.array([row for row, name in enumerate(standing.categories) if name in known], dtype=np.int64)
    growth = _grow(connection, stored, standing, taught, features, labels)
    assessor = stored.assessor
    if assessor is not None:
        assessor = Assessor(growth.forest, assessor.calibration.with_clips(features, labels))
    categories = tuple(str(name) for name in growth.forest.classes_)
    grown = replace(stored, forest=growth.forest, categories=categories, assessor=assessor)
    leaves = standing.leaves.copy()
    leaves[taught[growth.moved]] = growth.moved_leaves
    others = np.setdiff1d(np.arange(len(standing.ids)), taught)
    if len(others):
        ids = [standing.ids[row] for row in others]
        leaves[others] = find_leaves(grown, load_features(connection, stored.feature_set, ids).features)
    return grown, _compare_answers(grown, standing, leaves)


def _grow(
    connection: sa.Connection,
    stored: StoredForest,
    standing: _Standing,
    taught: NDArray[np.int64],
    features: FloatArray,
    labels: NDArray[np.str_],
) -> Growth:
    """The forest with new clips, beside those of the standing ones that it knows."""
    from dousa.retrieval.forest.growth import StandingClips, grow_forest

    def read_features(places: NDArray[np.int64]) -> FloatArray:
        ids = [standing.ids[row] for row in taught[places]]
        return load_features(connection, stored.feature_set, ids).features

    categories = np.array([standing.categories[row] for row in taught], dtype=np.str_)
    clips = StandingClips(categories, standing.leaves[taught], read_features)
    kind = find_feature_set(stored.feature_set)
    return grow_forest(stored.forest, clips, features, labels, feature_set=kind)


def _read_standing(connection: sa.Connection, stored: StoredForest, gone: Collection[int]) -> _Standing:
    clips, table = schema.clips.c, schema.clip_leaves.c
    query = sa.select(*LABELS.columns, *LEAVES.columns)
    query = query.join(schema.clip_leaves, table.clip_id == clips.id).order_by(clips.id)
    left = set(gone)
    rows = [row for row in connection.execute(query) if row.id not in left]
    for row in rows:
        LABELS.check(connection, row)
        LEAVES.check(connection, row)
    leaves = stack([row.leaves for row in rows], "<i4", (len(stored.forest.trees_.roots),), "leaves")
    count_votes(stored, leaves)  # there are such leaves
    predicted = [row.predicted_category for row in rows]
    return _Standing([row.id for row in rows], [row.category for row in rows], predicted, leaves)


def _compare_answers(stored: StoredForest, standing: _Standing, leaves: NDArray[np.int32]) -> dict[int, dict[str, Any]]:
    """The leaves and the guesses that have changed, by number."""
    predicted = count_votes(stored, leaves).predicted()
    moved = (leaves != standing.leaves).any(axis=1)
    return {
        number: {"predicted_category": now, "leaves": pack(leaves[row], "<i4")}
        for row, (number, now, before) in enumerate(zip(standing.ids, predicted, standing.predicted, strict=True))
        if moved[row] or now != before
    }
