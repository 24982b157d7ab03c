"""Search where bodies lack joints: each clip is compared by the joints that it shares with the query.

Clips with the same joints form a group with one forest. To compare groups, the share of the body that was not
compared counts as the median distance, so legs alone are not nearer than a whole body with the same motion.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import FloatArray
from dousa.library.results import Hit
from dousa.library.search.leaf_index import LeafIndex
from dousa.library.search.part_forests import DenseIndex, PartForests
from dousa.library.search.ranking import Asked, PoseReader, ask_forest, make_hits
from dousa.library.store.engine import Database
from dousa.library.store.features import StoredMotion, find_feature_set, load_poses
from dousa.library.store.forests import StoredForest, TreeAnswers
from dousa.messages import Progress
from dousa.retrieval.features.posed_motion import count_placed, is_comparable
from dousa.retrieval.forest.likeness import merge_votes
from dousa.retrieval.ranking.ranking import DEFAULT_RANKING, RankedClips, RankingQuery, rank_clips


def make_dense(index: LeafIndex) -> DenseIndex:
    """Return the clips of an index with all their votes."""
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
    answers = TreeAnswers(np.concatenate(votes)[rows], np.concatenate(leaves)[rows], index.categories, placed)
    return DenseIndex(
        tuple(index.clip_id(row) for row in rows.tolist()),
        tuple(index.path(row).decode() for row in rows.tolist()),
        tuple(index.label(row) for row in rows.tolist()),
        answers,
        index.likeness,
        index.meanings,
    )


def find_alike(index: DenseIndex, asked: Asked) -> FloatArray | None:
    """Compute the probabilities (N,) that the clips mean the same as a motion; None if not learned."""
    directions, own = index.answers.directions, asked.answers.directions
    if index.likeness is None or index.meanings is None or directions is None or own is None:
        return None
    meant = merge_votes(asked.answers.shares(), index.meanings)[0]
    return index.likeness.judge(meant, own[0], index.meant, directions, index.lengths)


def rank_places(
    index: DenseIndex, asked: Asked, k: int, by: str, places: NDArray[np.intp] | None, read_poses: PoseReader
) -> tuple[list[Hit], FloatArray]:
    """Return the first k clips for a motion among some places of the index, and the distances of all of these."""
    votes, leaves = index.answers.votes, index.answers.leaves
    directions, own = index.answers.directions, asked.answers.directions
    rows = np.arange(len(index.ids)) if places is None else places
    clips = RankedClips(
        votes if places is None else votes[places],
        leaves if places is None else leaves[places],
        lambda chosen: read_poses([index.ids[row] for row in rows[chosen]]),
        # Rounded, so that a clip has distance 0 from itself.
        None if directions is None or own is None else np.round(directions[rows] @ own[0].astype(np.float64), 6),
    )
    ranking = rank_clips(by, RankingQuery(asked.answers.votes[0], asked.answers.leaves[0], asked.poses), clips)
    order, chances = ranking.order, find_alike(index, asked)
    similar = None if chances is None or index.likeness is None else chances[rows] >= index.likeness.threshold
    if similar is not None and by == DEFAULT_RANKING:
        order = order[np.argsort(~similar[order], kind="stable")]
    order = order[:k]
    named = [(index.ids[row], index.paths[row], index.labels[row]) for row in rows[order].tolist()]
    measures = ranking.histogram[order], ranking.leaves[order], ranking.pose[order], ranking.distances[order]
    chance = None if chances is None else chances[rows[order]]
    hits = make_hits(named, measures, chance, None if similar is None else similar[order], asked.mirrored)
    return hits, ranking.distances


@dataclass(frozen=True, slots=True, eq=False)
class Group:
    """Clips (``places`` (N,) of ``index``) that share the same joints with a query, and the forest for these joints."""

    stored: StoredForest
    index: DenseIndex
    places: NDArray[np.intp]
    read_poses: PoseReader


def group_clips(
    database: Database,
    parts: PartForests,
    library: tuple[StoredForest, LeafIndex, DenseIndex],
    absent: Sequence[str],
    progress: Progress | None,
) -> tuple[list[Group], int]:
    """Group the clips by the joints that they share with a body, and count those that share too few.

    Parameters
    ----------
    library : its forest, and the clips that have all joints of this, sparse and with all votes.
    absent : joints that the body lacks.
    progress : called while forests for parts are learned.
    """
    main, leaf_index, index = library
    whole = find_feature_set(find_feature_set(main.feature_set).base)
    members: dict[tuple[str, ...], list[int]] = defaultdict(list)
    members[find_feature_set(main.feature_set).without(absent).hidden] += index.ids
    for clip_id, lacking in leaf_index.partial.items():
        members[whole.without([*absent, *lacking.split()]).hidden].append(clip_id)
    groups, n_left_out = [], 0
    for hidden, ids in members.items():
        if not ids:
            continue
        if hidden == main.hidden:
            rows = np.array([index.rows[clip_id] for clip_id in ids if clip_id in index.rows], np.intp)
            groups.append(Group(main, index, rows, partial(_read_poses, database, main)))
            continue
        part = parts.load(main, hidden, progress=progress) if is_comparable(hidden) else None
        if part is None:
            n_left_out += len(ids)
            continue
        places = np.array(sorted(part.index.rows[clip_id] for clip_id in ids if clip_id in part.index.rows), np.intp)
        groups.append(Group(part.stored, part.index, places, part.read_poses))
    return groups, n_left_out


def _read_poses(database: Database, main: StoredForest, ids: Sequence[int]) -> NDArray[np.float32]:
    with database.reading() as connection:
        return load_poses(connection, ids, main.feature_set)


def rank_groups(
    groups: Sequence[Group],
    motions: Sequence[StoredMotion],
    k: int,
    by: str,
    category: str | None,
    among: frozenset[int] | None,
) -> list[Hit]:
    """Return the first k clips of every group, with distances that are comparable between groups.

    ``motions`` : the query, and its mirror image if wanted.
    ``by``, ``category``, ``among`` : as in ``search_index``.
    """
    found: list[Hit] = []
    for number, motion in enumerate(motions):
        ranked = []
        for group in groups:
            places = group.places
            if category is not None:
                places = places[[group.index.labels[place] == category for place in places]]
            if among is not None:
                places = places[[group.index.ids[place] in among for place in places]]
            asked = ask_forest(group.stored, motion, mirrored=bool(number))
            hits, distances = rank_places(group.index, asked, k, by, places, group.read_poses)
            ranked.append((count_placed(group.stored.hidden), group.stored.hidden, hits, _find_median(distances)))
        most, _, _, typical = max(ranked, key=lambda one: one[0], default=(1, (), [], 0.0))
        for n_placed, hidden, hits, _ in ranked:
            share = n_placed / most
            found += [replace(_blend(hit, share, typical), hidden=hidden) for hit in hits]
    return found


def _find_median(distances: FloatArray) -> float:
    known = distances[~np.isnan(distances)]
    return float(np.median(known)) if len(known) else 0.0


def _blend(hit: Hit, share: float, typical: float) -> Hit:
    if hit.rank_distance is None or share == 1.0:
        return hit
    return replace(hit, rank_distance=share * hit.rank_distance + (1.0 - share) * typical)
