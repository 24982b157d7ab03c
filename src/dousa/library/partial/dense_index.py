"""Clips with all their votes, for searches that need to know how far every clip is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import FloatArray
from dousa.library.forests import TreeAnswers
from dousa.library.index.leaf_index import LeafIndex
from dousa.library.index.ranking import PoseReader
from dousa.library.results import Hit
from dousa.library.search import Asked, number_or_none
from dousa.retrieval.forest.likeness import Likeness, merge_votes
from dousa.retrieval.ranking.ranking import DEFAULT_RANKING, RankedClips, RankingQuery, rank_clips


@dataclass(frozen=True, slots=True, eq=False)
class SearchIndex:
    """What the trees say of clips, in the order of their paths, with the votes of all.

    Parameters
    ----------
    ids, paths : of the clips.
    labels : category of each clip; the forest's, where nobody gave it one.
    answers : what the trees say of the clips.
    rows : place of each clip number in the above.
    likeness : tells which clips are alike; None where that was not learned, as the next two.
    meanings : (C,) number of what each category means; categories of one meaning have the same.
    told : (N, M) share of the trees that vote for each meaning.
    lengths : (N,) Euclidean lengths of these.
    """

    ids: tuple[int, ...]
    paths: tuple[str, ...]
    labels: tuple[str, ...]
    answers: TreeAnswers
    rows: dict[int, int]
    likeness: Likeness | None = None
    meanings: NDArray[np.intp] | None = None
    told: FloatArray | None = None
    lengths: FloatArray | None = None


def make_dense(index: LeafIndex) -> SearchIndex:
    """The clips of an index with all their votes."""
    chosen = np.flatnonzero(index.living)
    rows = np.array(sorted(chosen.tolist(), key=index.path), np.intp)
    votes, leaves, directions = [], [], []
    for part, own in zip(index.parts, index.votes, strict=True):
        some = np.zeros((len(part), len(index.categories)), np.int32)
        some[np.repeat(np.arange(len(part)), np.diff(own.starts)), own.categories] = own.votes
        votes.append(some)
        leaves.append(part.leaves(slice(None)))
        if part.directions is not None:
            directions.append(part.directions)
    placed = np.concatenate(directions)[rows] if index.has_directions and directions else None
    told = TreeAnswers(np.concatenate(votes)[rows], np.concatenate(leaves)[rows], index.categories, placed)
    merged = merge_votes(told.shares(), index.meanings)
    ids = tuple(index.clip_id(row) for row in rows.tolist())
    return SearchIndex(
        ids,
        tuple(index.path(row).decode() for row in rows.tolist()),
        tuple(index.label(row) for row in rows.tolist()),
        told,
        {clip_id: row for row, clip_id in enumerate(ids)},
        index.likeness,
        index.meanings,
        merged,
        np.linalg.norm(merged, axis=1),
    )


def find_alike(index: SearchIndex, asked: Asked) -> FloatArray | None:
    """Probabilities (N,) that the clips mean the same as a motion; None where that was not learned."""
    directions, own = index.answers.directions, asked.answers.directions
    if index.likeness is None or index.meanings is None or index.told is None or directions is None or own is None:
        return None
    told = merge_votes(asked.answers.shares(), index.meanings)[0]
    return index.likeness.judge(told, own[0], index.told, directions, index.lengths)


def rank_places(
    index: SearchIndex,
    asked: Asked,
    k: int,
    by: str,
    places: NDArray[np.intp] | None,
    read_poses: PoseReader,
) -> tuple[list[Hit], FloatArray]:
    """The first k clips for one motion, among those at some places of the index, and how far each of these is."""
    votes, leaves = index.answers.votes, index.answers.leaves
    directions, own = index.answers.directions, asked.answers.directions
    rows = np.arange(len(index.ids)) if places is None else places
    clips = RankedClips(
        votes if places is None else votes[places],
        leaves if places is None else leaves[places],
        lambda chosen: read_poses([index.ids[row] for row in rows[chosen]]),
        # Rounded, so that a clip is no distance from itself.
        None if directions is None or own is None else np.round(directions[rows] @ own[0].astype(np.float64), 6),
    )
    ranking = rank_clips(by, RankingQuery(asked.answers.votes[0], asked.answers.leaves[0], asked.poses), clips)
    order, chances = ranking.order, find_alike(index, asked)
    alike = None if chances is None or index.likeness is None else chances[rows] >= index.likeness.threshold
    if alike is not None and by == DEFAULT_RANKING:
        order = order[np.argsort(~alike[order], kind="stable")]
    hits = []
    for place in order[:k]:
        row = int(rows[place])
        hits.append(
            Hit(
                path=index.paths[row],
                category=index.labels[row],
                distance=float(ranking.histogram[place]),
                rank=0,
                clip_id=index.ids[row],
                leaf_share=1.0 - float(ranking.leaves[place]),
                pose_distance=number_or_none(ranking.pose[place]),
                rank_distance=number_or_none(ranking.distances[place]),
                mirrored=asked.mirrored,
                alike=None if alike is None else bool(alike[place]),
                probability=None if chances is None else round(float(chances[row]), 4),
            )
        )
    return hits, ranking.distances
