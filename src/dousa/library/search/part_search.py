"""Search where bodies lack joints: each clip is compared by the joints that it shares with the query.

Clips with the same joints form a group with one forest. To compare groups, the share of the body that was not
compared counts as the median distance, so legs alone are not nearer than a whole body with the same motion.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import FloatArray
from dousa.errors import InvalidMotionError
from dousa.library.results import Hit, SearchResult
from dousa.library.search.leaf_index import LeafIndex
from dousa.library.search.part_forests import PartForests, PartIndex
from dousa.library.search.ranking import PoseReader
from dousa.library.search.search import (
    Asked,
    Explaining,
    PartProgress,
    Searcher,
    Wanted,
    ask_forest,
    choose_best,
    judge,
    number_or_none,
)
from dousa.library.store.engine import Database
from dousa.library.store.features import StoredMotion, find_feature_set, load_motions, load_poses
from dousa.library.store.forests import ForestCache, StoredForest, TreeAnswers
from dousa.messages import Message
from dousa.retrieval.features.posed_motion import count_placed, is_comparable
from dousa.retrieval.forest.likeness import Likeness, merge_votes
from dousa.retrieval.ranking.ranking import DEFAULT_RANKING, RankedClips, RankingQuery, rank_clips


@dataclass(frozen=True, slots=True, eq=False)
class SearchIndex:
    """N clips, sorted by path, with all votes of the trees.

    Parameters
    ----------
    labels : given category of each clip, else the predicted one.
    answers : tree answers about the clips.
    rows : place of each clip by number.
    likeness : finds clips of the same meaning; None if not learned, as the next three.
    meanings : (C,) number of each category's meaning.
    told : (N, M) share of the trees that vote for each meaning.
    lengths : (N,) Euclidean lengths of ``told``.
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
    """Compute the probabilities (N,) that the clips mean the same as a motion; None if not learned."""
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


@dataclass(frozen=True, slots=True, eq=False)
class Group:
    """Clips (``places`` (N,) of ``index``) that share the same joints with a query, and the forest for these joints."""

    stored: StoredForest
    index: SearchIndex
    places: NDArray[np.intp]
    read_poses: PoseReader


class PartSearcher(Searcher):
    """Searches and classifies, also for bodies that lack joints."""

    def __init__(self, database: Database, forests: ForestCache, parts: PartForests) -> None:
        super().__init__(database, forests)
        self._parts = parts
        self._dense: tuple[LeafIndex, SearchIndex] | None = None

    def _search_parts(
        self,
        library: tuple[StoredForest, LeafIndex],
        query: tuple[str, StoredMotion],
        wanted: Wanted,
        progress: PartProgress | None,
    ) -> SearchResult:
        stored, index = library
        kept = self._dense
        if kept is None or kept[0] is not index:
            kept = self._dense = index, make_dense(index)
        return search_parts(self._database, self._parts, (stored, *kept), query, wanted, progress)

    def _choose_forest(
        self, stored: StoredForest, absent: Sequence[str], progress: PartProgress | None
    ) -> tuple[StoredForest | None, Message | None]:
        return self._parts.choose(stored, absent, progress)


def search_parts(
    database: Database,
    parts: PartForests,
    library: tuple[StoredForest, LeafIndex, SearchIndex],
    query: tuple[str, StoredMotion],
    wanted: Wanted,
    progress: PartProgress | None = None,
) -> SearchResult:
    """Find the clips nearest to a motion, where it or some of the clips lack joints.

    Parameters
    ----------
    library : its forest, and the clips that have all joints of this, sparse and with all votes.
    query : name and motion.
    progress : called while forests for parts are learned.

    Raises
    ------
    InvalidMotionError : the body lacks too many joints, or too few clips have those that are left.
    """
    main, (name, motion) = library[0], query
    stored, note = parts.choose(main, motion.absent, progress)
    if stored is None:
        assert note is not None
        raise InvalidMotionError(note)
    notes = [] if note is None else [note]
    motions = (motion, motion.mirror()) if wanted.mirror else (motion,)
    asked = [ask_forest(stored, one) for one in motions]
    verdicts = [judge(stored, one.answers, one.features, wanted.threshold)[0] for one in asked]
    groups, n_left_out = _group_clips(database, parts, library, motion.absent, progress)
    category = verdicts[0].guess if wanted.same_category else None
    hits = choose_best(_rank_groups(groups, motions, wanted, category), wanted.k)
    if wanted.explain:
        verdicts = Explaining(stored).verdicts(verdicts, motion)
        hits = _explain(database, groups, motion, hits)
    if any(hit.hidden != stored.hidden for hit in hits):
        notes.append(Message("partial.some_hits", n=sum(hit.hidden != stored.hidden for hit in hits)))
    if n_left_out:
        notes.append(Message("partial.left_out", n=n_left_out))
    return SearchResult(name, verdicts[0], hits, wanted.ranking, verdicts[1] if wanted.mirror else None, tuple(notes))


def _group_clips(
    database: Database,
    parts: PartForests,
    library: tuple[StoredForest, LeafIndex, SearchIndex],
    absent: Sequence[str],
    progress: PartProgress | None,
) -> tuple[list[Group], int]:
    """Group the clips by the joints that they share with a body, and count those that share too few."""
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
            groups.append(Group(main, index, rows, _reader_of(database, main)))
            continue
        part = parts.load(main, hidden, progress=progress) if is_comparable(hidden) else None
        if part is None:
            n_left_out += len(ids)
            continue
        groups.append(_make_group(part, ids))
    return groups, n_left_out


def _reader_of(database: Database, main: StoredForest) -> PoseReader:
    def read(ids: Sequence[int]) -> NDArray[np.float32]:
        with database.reading() as connection:
            return load_poses(connection, ids, main.feature_set)

    return read


def _make_group(part: PartIndex, ids: Sequence[int]) -> Group:
    rows = {clip_id: row for row, clip_id in enumerate(part.ids)}
    places = np.array(sorted(rows[clip_id] for clip_id in ids if clip_id in rows), np.intp)
    index = SearchIndex(part.ids, part.paths, part.labels, part.answers, rows)
    return Group(part.stored, index, places, lambda some: part.poses[[rows[clip_id] for clip_id in some]])


def _rank_groups(
    groups: Sequence[Group], motions: Sequence[StoredMotion], wanted: Wanted, category: str | None
) -> list[Hit]:
    """Return the first k clips of every group, with distances that are comparable between groups."""
    found: list[Hit] = []
    for number, motion in enumerate(motions):
        ranked = []
        for group in groups:
            places = group.places
            if category is not None:
                places = places[[group.index.labels[place] == category for place in places]]
            if wanted.among is not None:
                places = places[[group.index.ids[place] in wanted.among for place in places]]
            asked = replace(ask_forest(group.stored, motion), mirrored=bool(number))
            hits, distances = rank_places(group.index, asked, wanted.k, wanted.ranking, places, group.read_poses)
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


def _explain(database: Database, groups: Sequence[Group], motion: StoredMotion, hits: Sequence[Hit]) -> tuple[Hit, ...]:
    explaining = {group.stored.hidden: Explaining(group.stored) for group in groups}
    with database.reading() as connection:
        found = list(load_motions(connection, [hit.clip_id for hit in hits]))
    return tuple(explaining[hit.hidden].hits([hit], motion, [other])[0] for hit, other in zip(hits, found, strict=True))
