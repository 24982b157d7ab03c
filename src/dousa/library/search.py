"""Ranking the clips of a library by their likeness to a motion, and to its mirror image.

What clips are ordered by is told in ``dousa.retrieval.ranking``; here is what the library keeps in memory for it, and
how two orders become one. The path decides last, so that the order never depends on when a clip was added.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from operator import itemgetter

import numpy as np
import sqlalchemy as sa
from numpy.typing import NDArray

from dousa.library import schema
from dousa.library._arrays import stack
from dousa.library._forests import StoredForest, TreeAnswers, count_votes
from dousa.library.answers import Hit
from dousa.motion._types import FloatArray
from dousa.retrieval.ranking import RankedClips, RankingQuery, rank_clips

__all__ = ["Asked", "PoseReader", "SearchIndex", "load_index", "search_index"]

PoseReader = Callable[[Sequence[int]], NDArray[np.float32]]
"""Gives (n, cells, columns), the pose sequences of clips of these numbers."""

_CLEARLY = 0.95  # of the distance: a mirror image must be nearer than that, as many motions are their own


@dataclass(frozen=True, slots=True, eq=False)
class Asked:
    """A motion that is searched for.

    Parameters
    ----------
    answers, features : what the trees say of it, and what they say it of; one row each.
    poses : its pose sequence.
    mirrored : whether it is the mirror image of the query.
    """

    answers: TreeAnswers
    features: FloatArray
    poses: NDArray[np.float32]
    mirrored: bool = False


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


def load_index(connection: sa.Connection, revision: int, stored: StoredForest) -> SearchIndex:
    """Read what the trees say of all clips.

    Parameters
    ----------
    connection : in a transaction.
    revision : of the library in this transaction.
    stored : its forest.

    Raises
    ------
    LibraryDamagedError : leaves that are not as many as the trees, or that the forest does not have.
    """
    clips, table = schema.clips.c, schema.clip_leaves.c
    query = sa.select(clips.id, clips.path, clips.category, table.predicted_category, table.leaves)
    query = query.join(schema.clip_leaves, table.clip_id == clips.id)
    # Sorted here: databases differ in how they order text.
    rows = sorted(connection.execute(query).all(), key=itemgetter(1))
    ids, paths, given, predicted, leaves = zip(*rows, strict=True) if rows else ((),) * 5
    answers = count_votes(stored, stack(leaves, "<i4", (len(stored.forest.trees_.roots),), "leaves"))
    return SearchIndex(
        revision=revision,
        ids=ids,
        paths=paths,
        labels=tuple(b if a is None else a for a, b in zip(given, predicted, strict=True)),
        answers=answers,
        rows={clip_id: row for row, clip_id in enumerate(ids)},
    )


def search_index(
    index: SearchIndex,
    asked: Sequence[Asked],
    k: int,
    by: str,
    category: str | None,
    read_poses: PoseReader,
) -> tuple[Hit, ...]:
    """The k clips that are most like a motion, or like its mirror image.

    Parameters
    ----------
    index : the clips.
    asked : the motion, and its mirror image if that is searched for too.
    k : how many.
    by : one of ``dousa.retrieval.ranking.RANKINGS``.
    category : only clips of this category; of all if None.
    read_poses : asked once for each motion.

    Raises
    ------
    OptionError : an unknown ranking.
    """
    places = None
    if category is not None:
        places = np.flatnonzero(np.array(index.labels, dtype=object) == category)
    first = [_rank(index, one, k, by, places, read_poses) for one in asked]
    if len(first) == 1:
        return tuple(_number(first[0]))
    best: dict[int, Hit] = {}
    for hit in sorted((hit for hits in first for hit in hits), key=_mirrored_last):
        best.setdefault(hit.clip_id, hit)
    return tuple(_number(list(best.values())[:k]))


def _rank(
    index: SearchIndex, asked: Asked, k: int, by: str, places: NDArray[np.intp] | None, read_poses: PoseReader
) -> list[Hit]:
    """The first k clips for one motion, among those at some places of the index."""
    votes, leaves = index.answers.votes, index.answers.leaves
    rows = np.arange(len(index.ids)) if places is None else places
    clips = RankedClips(
        votes if places is None else votes[places],
        leaves if places is None else leaves[places],
        lambda chosen: read_poses([index.ids[row] for row in rows[chosen]]),
    )
    ranking = rank_clips(
        by, RankingQuery(asked.answers.votes[0], asked.answers.leaves[0], asked.poses), clips
    )
    hits = []
    for place in ranking.order[:k]:
        row = int(rows[place])
        hits.append(
            Hit(
                path=index.paths[row],
                category=index.labels[row],
                distance=float(ranking.histogram[place]),
                rank=0,
                clip_id=index.ids[row],
                leaf_share=1.0 - float(ranking.leaves[place]),
                pose_distance=_number_or_none(ranking.pose[place]),
                rank_distance=_number_or_none(ranking.distances[place]),
                mirrored=asked.mirrored,
            )
        )
    return hits


def _number_or_none(value: np.float64) -> float | None:
    return None if np.isnan(value) else float(value)


def _mirrored_last(hit: Hit) -> tuple[bool, float]:
    """By the distance, where mirrored clips must be clearly nearer; clips whose poses were not compared come last."""
    far = hit.rank_distance is None
    distance = hit.distance if hit.rank_distance is None else hit.rank_distance
    return far, distance / _CLEARLY if hit.mirrored else distance


def _number(hits: Sequence[Hit]) -> list[Hit]:
    return [replace(hit, rank=rank) for rank, hit in enumerate(hits, start=1)]
