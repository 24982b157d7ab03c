"""Clips that are added teach the forest at once: the leaves that they reach take them up, and grow where they must.

The questions of the trees stay as they are until the next training. The clips that stood in a leaf that grew come into
other leaves, so theirs are written anew in the same transaction; the windows of takes are described anew afterwards.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import sqlalchemy as sa
from numpy.typing import NDArray

from dousa.library import schema
from dousa.library._arrays import pack, stack
from dousa.library._describing import find_feature_set
from dousa.library._features import load_features
from dousa.library._forests import StoredForest, count_votes, find_leaves, update_forest
from dousa.motion._types import FloatArray

if TYPE_CHECKING:
    from dousa.retrieval import MotionForest
    from dousa.retrieval.calibration import Assessor
    from dousa.retrieval.growth import Growth

__all__ = ["Learned", "learn_clips"]


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
class _Standing:
    """Clips that stand in the leaves: numbers (N,), categories, what they were taken for, leaves (N, n_trees)."""

    ids: list[int]
    categories: list[str | None]
    predicted: list[str]
    leaves: NDArray[np.int32]


def learn_clips(
    connection: sa.Connection,
    stored: StoredForest,
    features: FloatArray,
    categories: Sequence[str | None],
    revision: int,
) -> tuple[StoredForest, Learned]:
    """Teach a forest new clips, and write it and the answers that change.

    Parameters
    ----------
    connection : in a transaction that writes; the leaves of the new clips are not written yet.
    stored : the forest.
    features : (M, frames, columns) of the new clips.
    categories : (M,) theirs; a clip without one teaches nothing.
    revision : of the library in this transaction.

    Returns
    -------
    The forest that has learned, and what; the same forest where there was nothing to learn.
    """
    labelled = [row for row, category in enumerate(categories) if category is not None]
    if not labelled:
        return stored, Learned()
    labels = np.array([categories[row] for row in labelled], dtype=np.str_)
    standing = _read_standing(connection, stored)
    known = set(stored.categories)
    # Clips that were given a category later that the forest does not know stand in no leaf of theirs.
    taught = np.array([row for row, name in enumerate(standing.categories) if name in known], dtype=np.int64)
    growth = _grow(connection, stored, standing, taught, features[labelled], labels)
    grown = replace(
        stored,
        forest=growth.forest,
        categories=tuple(str(name) for name in growth.forest.classes_),
        assessor=_extend(stored.assessor, growth.forest, features[labelled], labels),
        learned=revision,
    )
    update_forest(connection, grown, len(labelled))
    leaves = standing.leaves.copy()
    leaves[taught[growth.moved]] = growth.moved_leaves
    others = np.setdiff1d(np.arange(len(standing.ids)), taught)
    if len(others):
        ids = [standing.ids[row] for row in others]
        leaves[others] = find_leaves(grown, load_features(connection, stored.feature_set, ids).features)
    _update_answers(connection, grown, standing, leaves)
    return grown, Learned(len(labelled), tuple(sorted(set(labels.tolist()) - known)))


def _grow(
    connection: sa.Connection,
    stored: StoredForest,
    standing: _Standing,
    taught: NDArray[np.int64],
    features: FloatArray,
    labels: NDArray[np.str_],
) -> Growth:
    """The forest with new clips, beside those of the standing ones that it knows."""
    from dousa.retrieval.growth import StandingClips, grow_forest

    def read_features(places: NDArray[np.int64]) -> FloatArray:
        ids = [standing.ids[row] for row in taught[places]]
        return load_features(connection, stored.feature_set, ids).features

    categories = np.array([standing.categories[row] for row in taught], dtype=np.str_)
    clips = StandingClips(categories, standing.leaves[taught], read_features)
    kind = find_feature_set(stored.feature_set)
    return grow_forest(stored.forest, clips, features, labels, feature_set=kind)


def _extend(
    assessor: Assessor | None, forest: MotionForest, features: FloatArray, labels: NDArray[np.str_]
) -> Assessor | None:
    """What tells known motions from unknown ones, with new clips among the known."""
    from dousa.retrieval.calibration import Assessor

    if assessor is None:
        return None
    return Assessor(forest, assessor.calibration.with_clips(features, labels))


def _read_standing(connection: sa.Connection, stored: StoredForest) -> _Standing:
    clips, table = schema.clips.c, schema.clip_leaves.c
    query = sa.select(clips.id, clips.category, table.predicted_category, table.leaves)
    query = query.join(schema.clip_leaves, table.clip_id == clips.id).order_by(clips.id)
    rows = connection.execute(query).all()
    leaves = stack([row.leaves for row in rows], "<i4", (len(stored.forest.trees_.roots),), "leaves")
    count_votes(stored, leaves)  # there are such leaves
    return _Standing(
        [row.id for row in rows],
        [row.category for row in rows],
        [row.predicted_category for row in rows],
        leaves,
    )


def _update_answers(
    connection: sa.Connection, stored: StoredForest, standing: _Standing, leaves: NDArray[np.int32]
) -> None:
    """Write the leaves and the guesses that have changed."""
    predicted = count_votes(stored, leaves).predicted()
    moved = (leaves != standing.leaves).any(axis=1)
    rows = [
        {
            "of_clip": standing.ids[row],
            "predicted_category": predicted[row],
            "leaves": pack(leaves[row], "<i4"),
        }
        for row in range(len(standing.ids))
        if moved[row] or predicted[row] != standing.predicted[row]
    ]
    if rows:
        table = schema.clip_leaves
        statement = sa.update(table).where(table.c.clip_id == sa.bindparam("of_clip"))
        connection.execute(statement, rows)
