"""Search where bodies lack joints: each clip is compared by the joints that it shares with the query.

Clips with the same joints form a group with one forest. To compare groups, the share of the body that was not
compared counts as the median distance, so legs alone are not nearer than a whole body with the same motion.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import BoolArray, FloatArray
from dousa.library.results import Hit
from dousa.library.search.leaf_index import LeafIndex
from dousa.library.search.part_forests import PartForests
from dousa.library.search.ranking import Asked, PoseReader, RankedRows, choose_best, number_hits, rank_rows
from dousa.library.store.engine import Database
from dousa.library.store.features import find_feature_set, load_poses
from dousa.library.store.forests import StoredForest
from dousa.messages import Progress
from dousa.retrieval.features.posed_motion import count_placed, is_comparable


@dataclass(frozen=True, slots=True, eq=False)
class Group:
    """Clips (``chosen`` (N,) of ``index``) that share the same joints with a query, and the forest for these joints."""

    stored: StoredForest
    index: LeafIndex
    chosen: BoolArray
    read_poses: PoseReader


def group_clips(
    database: Database,
    parts: PartForests,
    main: StoredForest,
    index: LeafIndex,
    absent: Sequence[str],
    progress: Progress | None,
) -> tuple[list[Group], int]:
    """Group the clips by the joints that they share with a body, and count those that share too few.

    Parameters
    ----------
    main, index : forest of the library, and the clips that have all joints of this.
    absent : joints that the body lacks.
    progress : called while forests for parts are learned.
    """
    whole = find_feature_set(find_feature_set(main.feature_set).base)
    members: dict[tuple[str, ...], list[int]] = defaultdict(list)
    members[find_feature_set(main.feature_set).without(absent).hidden] += index.list_ids()
    for clip_id, lacking in index.partial.items():
        members[whole.without([*absent, *lacking.split()]).hidden].append(clip_id)
    groups, n_left_out = [], 0
    for hidden, ids in members.items():
        if not ids:
            continue
        if hidden == main.hidden:
            groups.append(Group(main, index, index.living, partial(_read_poses, database, main)))
            continue
        part = parts.load(main, hidden, progress=progress) if is_comparable(hidden) else None
        if part is None:
            n_left_out += len(ids)
            continue
        groups.append(Group(part.stored, part.index, part.index.choose(None, ids), part.read_poses))
    return groups, n_left_out


def _read_poses(database: Database, main: StoredForest, ids: Sequence[int]) -> NDArray[np.float32]:
    with database.reading() as connection:
        return load_poses(connection, ids, main.feature_set)


def rank_groups(
    groups: Sequence[Group],
    ask: Callable[[Group], Sequence[Asked]],
    k: int,
    by: str,
    category: str | None = None,
    among: Collection[int] | None = None,
) -> tuple[tuple[Hit, ...], int | None]:
    """Find the k clips that are most like a motion, or like its mirror image, with comparable distances.

    OptionError for an unknown ranking.

    Parameters
    ----------
    ask : returns the motion, and its mirror image if wanted, as the forest of a group sees them.
    by : one of ``dousa.retrieval.ranking.ranking.RANKINGS``.
    category, among : search only clips of this category, or of these numbers; None for all.

    Returns
    -------
    The clips, and the number of all that are similar; None if likeness was not learned, or there are several groups.
    """
    ranked: list[list[tuple[Group, RankedRows]]] = []
    for group in groups:
        chosen = group.chosen & group.index.choose(category, among)
        count = k if len(groups) == 1 else int(chosen.sum())  # several groups need the median of all distances
        rows = (rank_rows(group.index, one, count, by, chosen, group.read_poses) for one in ask(group))
        ranked.append([(group, found) for found in rows])
    hits = [hit for side in zip(*ranked, strict=True) for hit in _make_comparable(side, k)]
    if len(ranked) != 1:
        return choose_best(hits, k), None
    similar = [found.similar for _, found in ranked[0] if found.similar is not None]
    n_alike = len(np.unique(np.concatenate(similar))) if len(similar) == len(ranked[0]) else None
    return number_hits(hits) if len(ranked[0]) == 1 else choose_best(hits, k), n_alike


def _make_comparable(ranked: Sequence[tuple[Group, RankedRows]], k: int) -> Iterator[Hit]:
    """Yield the first k clips of every group, with distances that are comparable between groups."""
    placed = [count_placed(group.stored.hidden) for group, _ in ranked]
    most = max(placed)
    typical = _find_median(ranked[placed.index(most)][1].distances)
    for (group, found), n_placed in zip(ranked, placed, strict=True):
        for hit in found.hits(k):
            yield replace(_blend(hit, n_placed / most, typical), hidden=group.stored.hidden)


def _find_median(distances: FloatArray) -> float:
    known = distances[~np.isnan(distances)]
    return float(np.median(known)) if len(known) else 0.0


def _blend(hit: Hit, share: float, typical: float) -> Hit:
    if hit.rank_distance is None or share == 1.0:
        return hit
    return replace(hit, rank_distance=share * hit.rank_distance + (1.0 - share) * typical)
