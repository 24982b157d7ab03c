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

from dousa.arrays import BoolArray, FloatArray
from dousa.library.results import Hit
from dousa.library.search.leaf_index import LeafIndex
from dousa.library.search.part_forests import PartForests
from dousa.library.search.ranking import PoseReader, ask_forest, rank_rows
from dousa.library.store.engine import Database
from dousa.library.store.features import StoredMotion, find_feature_set, load_poses
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
            chosen = group.chosen & group.index.choose(category, among)
            asked = ask_forest(group.stored, motion, mirrored=bool(number))
            found_here = rank_rows(group.index, asked, int(chosen.sum()), by, chosen, group.read_poses)
            median, hidden = _find_median(found_here.distances), group.stored.hidden
            ranked.append((count_placed(hidden), hidden, found_here.hits(k), median))
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
