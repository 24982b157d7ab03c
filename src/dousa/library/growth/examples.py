"""The examples that leaves of a large forest grow from: kept with the training, or made when they are first needed.

They follow from the clips of the training, so they are no loss where they are gone or damaged: who needs them makes
them from what is there.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import sqlalchemy as sa
from numpy.typing import NDArray

from dousa.arrays import BoolArray, IndexArray, IntArray
from dousa.errors import LibraryDamagedError
from dousa.library import schema
from dousa.library.forests import StoredForest, TreeAnswers
from dousa.library.schema import pack
from dousa.library.seals.checksums import EXAMPLES, seal_rows
from dousa.retrieval.forest.standing_leaves import MOST_EXAMPLES, StandingLeaves, choose_examples

_AT_ONCE = 16_384  # clips

_ID = 1


def choose_trained(
    stored: StoredForest, ids: IntArray, categories: NDArray[np.int32], answers: TreeAnswers
) -> NDArray[np.int32] | None:
    """Numbers of the clips that are examples, of each leaf (L, E), -1 for none; None where the forest needs none.

    Parameters
    ----------
    ids, categories : (N,), in the order of their contents; -1 for a clip without a category.
    answers : what the trees say of them.
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
) -> NDArray[np.int32]:
    """Examples among some rows of clips (numbers, categories), whose leaves are read in portions."""
    ids, categories = clips
    portions = (rows[start : start + _AT_ONCE] for start in range(0, len(rows), _AT_ONCE))
    handed = ((ids[some], categories[some].astype(np.int32), read_leaves(some)) for some in portions)
    return choose_examples(handed, stored.forest.trees_.n_leaves)


def make_examples(
    connection: sa.Connection, stored: StoredForest, ids: IntArray, categories: IntArray, leaves: StandingLeaves
) -> NDArray[np.int32]:
    """The same of the clips of a library that an older dousa trained, or whose examples are gone.

    Parameters
    ----------
    ids, categories : (N,) ascending numbers, and categories, -1 for none.
    leaves : of these clips.
    """
    table, homes = schema.clips.c, stored.forest.trees_.home_leaves
    query = sa.select(table.id).where(table.id < stored.first_later).order_by(table.content_hash)
    ordered = np.fromiter(connection.execute(query).scalars(), np.int64)
    places = np.minimum(np.searchsorted(ids, ordered), max(len(ids) - 1, 0))
    places = places[(ids[places] == ordered) & (categories[places] >= 0)] if len(ids) else places[:0]
    return _choose(stored, (ids, categories), places, lambda some: homes[leaves.take(some)])


def find_places(kept: NDArray[np.int32], leaves: IndexArray, ids: IntArray) -> IntArray:
    """(n, E) places among ids (N,), ascending, of the examples of some leaves (n,); -1 for those that are not there."""
    wanted = kept[leaves]
    if not len(ids):
        return np.full(wanted.shape, -1)
    places = np.minimum(np.searchsorted(ids, wanted), len(ids) - 1)
    there: BoolArray = ids[places] == wanted
    return np.where(there, places, -1)


def load_examples(connection: sa.Connection, stored: StoredForest) -> NDArray[np.int32] | None:
    """Those that are kept for a forest; None where there are none, or damaged ones."""
    row = connection.execute(sa.select(*EXAMPLES.columns)).first()
    if row is None or row.revision != stored.revision:
        return None
    try:
        EXAMPLES.check(connection, row)
    except LibraryDamagedError:
        return None
    kept = np.frombuffer(row.clips, "<i4")
    # Leaves that grew since the training have none: they are numbered behind those that it made.
    return kept.reshape(-1, MOST_EXAMPLES) if len(kept) and not len(kept) % MOST_EXAMPLES else None


def save_examples(connection: sa.Connection, revision: int, kept: NDArray[np.int32] | None) -> None:
    """Keep the examples of a forest, whose training was of a revision, in the place of those before."""
    table = schema.leaf_examples
    connection.execute(sa.delete(table))
    if kept is not None:
        row = {"id": _ID, "revision": revision, "clips": pack(kept, "<i4")}
        connection.execute(sa.insert(table), seal_rows(table, [row]))
