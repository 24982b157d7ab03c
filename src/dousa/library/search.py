"""Ranking the clips of a library by the likeness of their histograms.

The distance is eq. 8 of Hamada, Kuriyama, Mukai: Euclidean, between the histograms of votes, ascending (the
paper calls it a similarity and sorts the other way). It is computed from whole numbers of votes, so that
equal distances are equal to the last bit.

Clips that the forest learned from have nearly all votes in one category, so most clips of a category are at
one distance; the paper leaves their order open. Among them the proximity of Breiman and Cutler's random forests
decides: the share of trees in which query and clip end in the same leaf, the largest first. Where categories are
easily told apart, that share is often 1; then the Euclidean distance of the 10 x 56 pose features decides. The
path comes last, so that the order never depends on when a clip was added.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from operator import itemgetter
from typing import TYPE_CHECKING

import numpy as np
import sqlalchemy as sa
from numpy.typing import NDArray

from dousa.errors import LibraryDamagedError
from dousa.library import schema
from dousa.library._arrays import stack
from dousa.library._forests import TreeAnswers
from dousa.library.reports import Hit, SearchResult
from dousa.library.selection import portions
from dousa.retrieval.ranking import rank_by_histogram

if TYPE_CHECKING:
    from dousa.motion._types import FloatArray

__all__ = ["Asked", "FeatureReader", "SearchIndex", "load_index", "order_histogram", "rank_clips"]

FeatureReader = Callable[[Sequence[int]], "FloatArray"]


@dataclass(frozen=True, slots=True, eq=False)
class Asked:
    """A query.

    Parameters
    ----------
    name : for the answer.
    answers : what the trees say of it.
    features : (10, 56) its pose features.
    """

    name: str
    answers: TreeAnswers
    features: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class SearchIndex:
    """What a search needs of all clips, in the order of their paths.

    Parameters
    ----------
    revision : of the library when it was read.
    ids, paths : of the clips.
    labels : category of each clip; the forest's, where nobody gave it one.
    answers : what the trees say of the clips.
    rows : place of each clip number in the above.
    """

    revision: int
    ids: tuple[int, ...]
    paths: tuple[str, ...]
    labels: tuple[str, ...]
    answers: TreeAnswers
    rows: dict[int, int]

    def answers_of(self, clip_id: int) -> TreeAnswers:
        """What the trees say of one clip."""
        row = self.rows[clip_id]
        return self.answers[row : row + 1]


def load_index(
    connection: sa.Connection, revision: int, categories: tuple[str, ...], n_trees: int
) -> SearchIndex:
    """Read what the trees say of all clips.

    Parameters
    ----------
    connection : in a transaction.
    revision : of the library in this transaction.
    categories, n_trees : of its forest.

    Raises
    ------
    LibraryDamagedError : votes that are not as many as the trees, arrays of another length.
    """
    clips, table = schema.clips.c, schema.clip_histograms.c
    query = sa.select(
        clips.id, clips.path, clips.category, table.predicted_category, table.votes, table.leaves
    )
    query = query.join(schema.clip_histograms, table.clip_id == clips.id)
    # Sorted here: databases differ in how they order text.
    rows = sorted(connection.execute(query).all(), key=itemgetter(1))
    ids, paths, given, predicted, votes, leaves = zip(*rows, strict=True) if rows else ((),) * 6
    answers = TreeAnswers(
        stack(votes, "<i4", (len(categories),), "histograms"),
        stack(leaves, "<i4", (n_trees,), "leaves"),
        categories,
    )
    if (answers.votes < 0).any() or (answers.votes.sum(axis=1) != n_trees).any():
        raise LibraryDamagedError(f"expected histograms of {n_trees} votes, got others; run: dousa train")
    return SearchIndex(
        revision=revision,
        ids=ids,
        paths=paths,
        labels=tuple(b if a is None else a for a, b in zip(given, predicted, strict=True)),
        answers=answers,
        rows={clip_id: row for row, clip_id in enumerate(ids)},
    )


def order_histogram(categories: Sequence[str], shares: FloatArray) -> dict[str, float]:
    """Share of each category, the largest first, then by name."""
    order = np.argsort(-shares, kind="stable")
    return {categories[index]: float(shares[index]) for index in order}


def rank_clips(
    index: SearchIndex, asked: Asked, k: int, same_category: bool, read_features: FeatureReader
) -> SearchResult:
    """The k clips that are most like a query.

    Parameters
    ----------
    index : the clips.
    asked : the query.
    k : how many.
    same_category : whether only clips of the query's category are looked at, as in the paper.
    read_features : reads (N, 10, 56) of a portion of clips by their numbers; asked only for clips that nothing
        else orders.
    """
    category = asked.answers.predicted()[0]
    n_trees = asked.answers.leaves.shape[1]
    distances = rank_by_histogram(asked.answers.votes[0], index.answers.votes)[1] / n_trees
    rows = np.arange(len(index.ids))
    if same_category:
        rows = np.flatnonzero(np.array(index.labels, dtype=object) == category)
    if k < len(rows):
        # The leaves are asked only where they can decide: up to the k-th distance, equals included.
        rows = rows[distances[rows] <= np.partition(distances[rows], k - 1)[k - 1]]
    common = np.count_nonzero(index.answers.leaves[rows] == asked.answers.leaves[0], axis=1)
    keys = np.stack([distances[rows], -common / n_trees], axis=1)
    best = _order(
        keys, k, lambda tied: _compare(asked, [index.ids[row] for row in rows[tied]], read_features)
    )
    hits = tuple(
        Hit(index.paths[row], index.labels[row], float(distance), rank, index.ids[row], 0.0 - float(share))
        for rank, (row, (distance, share)) in enumerate(zip(rows[best], keys[best], strict=True), start=1)
    )
    histogram = order_histogram(asked.answers.categories, asked.answers.shares()[0])
    return SearchResult(asked.name, category, histogram, hits)


def _order(keys: FloatArray, k: int, compare: Callable[[NDArray[np.intp]], FloatArray]) -> NDArray[np.intp]:
    """The first k rows of ``keys`` (N, 2) in ascending order; ``compare`` orders rows of equal keys."""
    order = np.lexsort((keys[:, 1], keys[:, 0]))
    if not len(order):
        return order
    changes = (keys[order[1:]] != keys[order[:-1]]).any(axis=1)
    group = np.append(0, np.cumsum(changes))
    tied = (np.bincount(group)[group] > 1) & (group <= group[min(k, len(order)) - 1])
    last = np.zeros(len(order))
    if tied.any():
        last[tied] = compare(order[tied])
    return order[np.lexsort((order, last, group))][:k]


def _compare(asked: Asked, ids: Sequence[int], read_features: FeatureReader) -> FloatArray:
    """(N,) distance of the pose features of clips from those of the query."""
    distances = []
    for some in portions(ids):
        apart = (read_features(some) - asked.features).reshape(len(some), -1)
        distances.append(np.sqrt(np.einsum("nf,nf->n", apart, apart)))
    return np.concatenate(distances)
