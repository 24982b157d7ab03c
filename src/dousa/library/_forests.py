"""The forest in the library, and what its trees say of clips."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

import numpy as np
import sqlalchemy as sa
from numpy.typing import NDArray

from dousa.errors import DousaError, LibraryDamagedError, LibraryVersionError
from dousa.library import schema
from dousa.library._arrays import pack, stack

if TYPE_CHECKING:
    from dousa.motion._types import FloatArray
    from dousa.retrieval import MotionForest

__all__ = [
    "FEATURE_SHAPE",
    "StoredForest",
    "TreeAnswers",
    "ask_trees",
    "load_features",
    "load_features_of",
    "load_forest",
    "load_outline",
    "save_answers",
    "save_forest",
]

FEATURE_SHAPE = (10, 56)
"""Frames and pose features of a clip."""

_FOREST_ID = 1
_ROWS_AT_ONCE = 1000


@dataclass(frozen=True, slots=True, eq=False)
class StoredForest:
    """A forest and the revision of the library that it belongs to."""

    forest: MotionForest
    revision: int
    categories: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class TreeAnswers:
    """What the trees of a forest say of N clips.

    Parameters
    ----------
    votes : (N, n_categories) int32, how many trees name each category: the histogram H of section 3.4, times
        the number of trees. Whole numbers, so that equal histograms are equal to the last bit.
    leaves : (N, n_trees) int32, the leaf that each clip reaches in each tree.
    categories : names, in the order of the votes.
    """

    votes: NDArray[np.int32]
    leaves: NDArray[np.int32]
    categories: tuple[str, ...]

    def __getitem__(self, rows: slice) -> TreeAnswers:
        """The same of some of the clips."""
        return TreeAnswers(self.votes[rows], self.leaves[rows], self.categories)

    def shares(self) -> FloatArray:
        """(N, n_categories) share of the trees that name each category: the histograms."""
        return self.votes / self.leaves.shape[1]

    def predicted(self) -> list[str]:
        """The most voted category of each clip; between equals the first in order."""
        return [self.categories[index] for index in self.votes.argmax(axis=1)]


def ask_trees(stored: StoredForest, features: FloatArray) -> TreeAnswers:
    """Run clips down all trees.

    Parameters
    ----------
    stored : the forest.
    features : (N, 10, 56).
    """
    leaves = stored.forest.apply(features)
    votes = np.rint(stored.forest.histograms_of(leaves) * leaves.shape[1]).astype(np.int32)
    return TreeAnswers(votes, leaves.astype(np.int32), stored.categories)


def load_outline(connection: sa.Connection) -> tuple[tuple[str, ...], int] | None:
    """Categories and number of trees of the forest, without the forest; None before the training.

    Raises
    ------
    LibraryDamagedError : no number of trees.
    """
    table = schema.forests.c
    query = sa.select(table.categories, table.parameters).where(table.id == _FOREST_ID)
    row = connection.execute(query).one_or_none()
    if row is None:
        return None
    n_trees = row.parameters.get("n_trees") if isinstance(row.parameters, dict) else None
    if not isinstance(n_trees, int) or n_trees < 1:
        raise LibraryDamagedError(f"the forest has {n_trees!r} trees; run: dousa train")
    return tuple(str(name) for name in row.categories), n_trees


def load_forest(
    connection: sa.Connection, where: str, known: StoredForest | None = None
) -> StoredForest | None:
    """The forest of the library, None before the training.

    Parameters
    ----------
    connection : in a transaction.
    where : the library, for messages.
    known : the forest as it was loaded before; returned where it is still the one.

    Raises
    ------
    LibraryDamagedError : bytes that are not a forest.
    LibraryVersionError : a forest of other pose features.
    """
    table = schema.forests.c
    query = sa.select(table.revision).where(table.id == _FOREST_ID)
    revision = connection.execute(query).scalar_one_or_none()
    if revision is None or (known is not None and known.revision == revision):
        return None if revision is None else known
    row = connection.execute(sa.select(table.data, table.categories).where(table.id == _FOREST_ID)).one()
    from dousa.retrieval import FEATURE_NAMES, MotionForest

    try:
        forest = MotionForest.from_bytes(row.data)
        categories = tuple(str(name) for name in row.categories)
        if tuple(str(name) for name in forest.classes_) != categories:
            raise LibraryDamagedError("its categories are not those of the library")
    except DousaError as error:
        raise LibraryDamagedError(f"{where}: the forest is damaged ({error}); run: dousa train") from error
    if forest.feature_names_ != FEATURE_NAMES:
        raise LibraryVersionError(
            f"{where}: its clips are described by other pose features than those of this dousa; "
            "add their files to a new library"
        )
    return StoredForest(forest, int(revision), categories)


def save_forest(
    connection: sa.Connection, stored: StoredForest, parameters: dict[str, Any], n_clips: int
) -> None:
    """Put a forest in the place of the one before."""
    connection.execute(sa.delete(schema.forests))
    connection.execute(
        sa.insert(schema.forests).values(
            id=_FOREST_ID,
            revision=stored.revision,
            trained_at=datetime.now(UTC).isoformat(timespec="seconds"),
            categories=list(stored.categories),
            parameters=parameters,
            n_clips=n_clips,
            data=stored.forest.to_bytes(),
        )
    )


def save_answers(connection: sa.Connection, ids: Sequence[int], answers: TreeAnswers) -> None:
    """Write what the trees say of clips of which nothing is written yet."""
    rows = [
        {
            "clip_id": clip_id,
            "predicted_category": category,
            "votes": pack(votes, "<i4"),
            "leaves": pack(leaves, "<i4"),
        }
        for clip_id, category, votes, leaves in zip(
            ids, answers.predicted(), answers.votes, answers.leaves, strict=True
        )
    ]
    for some in _portions(rows):
        connection.execute(sa.insert(schema.clip_histograms), some)


def load_features(connection: sa.Connection) -> tuple[list[int], FloatArray, list[str | None]]:
    """Numbers, features (N, 10, 56) and categories of all clips, in the order of their numbers."""
    clips, features = schema.clips.c, schema.clip_features.c
    query = sa.select(clips.id, clips.category, features.pose_features)
    query = query.join(schema.clip_features, features.clip_id == clips.id).order_by(clips.id)
    rows = connection.execute(query).all()
    array = stack([row.pose_features for row in rows], "<f8", FEATURE_SHAPE, "features")
    return [row.id for row in rows], array, [row.category for row in rows]


def load_features_of(connection: sa.Connection, ids: Sequence[int]) -> FloatArray:
    """Features (N, 10, 56) of some clips, in the order of these numbers; at most a portion of them."""
    table = schema.clip_features.c
    query = sa.select(table.clip_id, table.pose_features).where(table.clip_id.in_(ids))
    found = {row[0]: row[1] for row in connection.execute(query).all()}
    if len(found) != len(ids):
        raise LibraryDamagedError(
            f"expected features of {len(ids)} clips, found {len(found)}; add them again"
        )
    return stack([found[clip_id] for clip_id in ids], "<f8", FEATURE_SHAPE, "features")


def _portions(rows: Sequence[dict[str, Any]]) -> Iterable[Sequence[dict[str, Any]]]:
    return (rows[start : start + _ROWS_AT_ONCE] for start in range(0, len(rows), _ROWS_AT_ONCE))
