"""Exact search for the nearest clips, with a lower bound of the distance to skip the others.

The sparse votes of a clip bound its distance, so leaves and directions, ten times as many bytes, are compared only for
clips whose bound is within the distance of the last wanted clip. The order is that of ``dousa.retrieval.ranking``;
equals are sorted by path.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import BoolArray, FloatArray, IndexArray
from dousa.errors import OptionError
from dousa.library.results import MIRROR_DISTANCE, Hit
from dousa.library.search.kernels import find_limit
from dousa.library.search.leaf_index import LeafIndex
from dousa.library.store.features import StoredMotion, describe_clip
from dousa.library.store.forests import StoredForest, TreeAnswers, ask_trees
from dousa.retrieval.ranking.ranking import (
    DEFAULT_RANKING,
    HISTOGRAM_SCALE,
    LEAVES_WEIGHT,
    N_REFINED,
    RANKINGS,
    add_up,
    fuse,
    rank_by_pose,
)

PoseReader = Callable[[Sequence[int]], NDArray[np.float32]]
"""Returns the pose sequences (n, cells, columns) of n clip numbers."""


@dataclass(frozen=True, slots=True, eq=False)
class Asked:
    """A motion to search for.

    Parameters
    ----------
    answers, features : tree answers, and the features that they are about; one row each.
    poses : pose sequence.
    mirrored : whether it is the mirror image of the query.
    """

    answers: TreeAnswers
    features: FloatArray
    poses: NDArray[np.float32]
    mirrored: bool = False


def ask_forest(stored: StoredForest, motion: StoredMotion, mirrored: bool = False) -> Asked:
    """Ask the trees about a motion that is not stored."""
    described = describe_clip(motion, stored.feature_set)
    features = described.features[None]
    return Asked(ask_trees(stored, features), features, described.poses, mirrored)


def _number_or_none(value: np.float64) -> float | None:
    return None if np.isnan(value) else float(value)


def choose_best(hits: Iterable[Hit], k: int) -> tuple[Hit, ...]:
    """Return the nearest k clips among the hits of several searches, each clip once."""
    best: dict[int, Hit] = {}
    for hit in sorted(hits, key=_mirrored_last):
        best.setdefault(hit.clip_id, hit)
    return number_hits(list(best.values())[:k])


def _mirrored_last(hit: Hit) -> tuple[tuple[bool, bool], float]:
    """Sort by distance with a handicap for mirrored clips; unlike clips come later, those without poses last."""
    far = hit.rank_distance is None, hit.alike is False
    distance = hit.distance if hit.rank_distance is None else hit.rank_distance
    return far, distance / MIRROR_DISTANCE if hit.mirrored else distance


def number_hits(hits: Iterable[Hit]) -> tuple[Hit, ...]:
    """Give hits their ranks, from 1."""
    return tuple(replace(hit, rank=rank) for rank, hit in enumerate(hits, start=1))


class _Comparison:
    """Distances of the clips of an index from one motion: lower bounds of all, and those computed so far.

    ``slack`` : added to a bound for the rounding of float32 numbers and cosines; larger compares more clips.
    """

    def __init__(
        self, index: LeafIndex, query: TreeAnswers, by: str, chosen: BoolArray, *, slack: float = 1e-5
    ) -> None:
        self._index, self._query, self._by, self._slack = index, query, by, slack
        weights = {"histogram": (1.0, 0.0), "leaves": (0.0, 1.0)}.get(by, (HISTOGRAM_SCALE, LEAVES_WEIGHT))
        self._bounds, self._meant = index.bound(query, weights)
        self._chosen = chosen
        self._bounds[~chosen] = np.inf
        self.n_clips = int(chosen.sum())
        self.has_directions = index.has_directions and query.directions is not None
        size = len(chosen)
        self._known = np.zeros(size, np.bool_)
        self.histograms, self.leaves, self._cosines = np.empty(size), np.empty(size), np.empty(size)
        self.keys = np.empty(size)

    def measure(self, rows: IndexArray) -> None:
        """Compare those clips of ascending rows that were not compared before."""
        rows = rows[~self._known[rows]]
        if not len(rows):
            return
        histograms, leaves, angles = self._index.compare(self._query, rows)
        self._known[rows] = True
        self.histograms[rows], self.leaves[rows], self._cosines[rows] = histograms, leaves, angles
        # Rounded, so that a clip has distance 0 from itself.
        cosines = np.round(angles, 6) if self.has_directions else None
        keys = {"histogram": histograms, "leaves": leaves}
        self.keys[rows] = keys[self._by] if self._by in keys else add_up(histograms, leaves, cosines)

    def find_nearest(self, count: int, among: IndexArray | None = None, *, more: int = 256) -> IndexArray:
        """Return the rows of the nearest clips in order, among all chosen clips or some of them.

        ``more`` clips than four times the count are compared first: more make a closer limit for the others.
        """
        if among is None and count < self.n_clips:
            rows = np.flatnonzero(self._bounds <= min(find_limit(self._bounds, 4 * count + more), np.finfo(float).max))
            self.measure(rows)
            if len(rows) > count:
                limit = np.partition(self.keys[rows], count - 1)[count - 1]
                rows = np.flatnonzero(self._bounds <= limit + self._slack)
                self.measure(rows)
                rows = rows[self.keys[rows] <= limit]
        else:
            rows = np.flatnonzero(self._chosen) if among is None else among
            self.measure(rows)
        return self._sort(rows, count)

    def _sort(self, rows: IndexArray, count: int) -> IndexArray:
        """Sort rows by key, then by the other measure, then by path, and return the first."""
        others = {"histogram": self.leaves, "leaves": self.histograms}.get(self._by, np.zeros(len(self.keys)))
        rows = rows[np.lexsort((others[rows], self.keys[rows]))]
        found: list[int] = []
        for _, equals in groupby(rows.tolist(), lambda row: (self.keys[row], others[row])):
            own = list(equals)
            found += own if len(own) == 1 else sorted(own, key=self._index.path)
            if len(found) >= count:
                break
        return np.array(found[:count], np.intp)

    def find_similar(self) -> IndexArray | None:
        """Return the rows of the chosen clips like the query; None if not learned."""
        likeness = self._index.likeness
        if likeness is None or not self.has_directions:
            return None
        intercept, slopes = likeness.curve.intercept, likeness.curve.slopes
        with np.errstate(divide="ignore"):
            least = np.log(likeness.threshold) - np.log1p(-likeness.threshold) - intercept - slopes[1] - self._slack
        rows = np.flatnonzero((slopes[0] * self._meant >= least) & self._chosen)
        self.measure(rows)
        chances = self.judge(rows)
        assert chances is not None, "both ask the same"
        return rows[chances >= likeness.threshold]

    def judge(self, rows: IndexArray) -> FloatArray | None:
        """Compute the probabilities (M,) that compared clips mean the same as the query; None if not learned."""
        likeness = self._index.likeness
        if likeness is None or not self.has_directions:
            return None
        return likeness.curve.evaluate(np.column_stack([self._meant[rows], self._cosines[rows]]))


@dataclass(frozen=True, slots=True, eq=False)
class RankedRows:
    """Rows (M,) of an index in the order of a ranking.

    Parameters
    ----------
    distances, poses : (M,) to rank by, and of poses; NaN where these were not compared.
    similar : rows of all clips that mean the same; None if that was not learned.
    """

    index: LeafIndex
    asked: Asked
    rows: IndexArray
    distances: FloatArray
    poses: FloatArray
    similar: IndexArray | None
    clips: _Comparison

    def hits(self, k: int) -> list[Hit]:
        """Return the first k as hits; their ranks follow."""
        rows, clips = self.rows[:k], self.clips
        chances = clips.judge(rows)
        reached = None if self.similar is None else np.isin(rows, self.similar)
        return [
            Hit(
                self.index.path(row).decode(),
                self.index.label(row),
                distance=float(clips.histograms[row]),
                rank=0,
                clip_id=self.index.clip_id(row),
                leaf_share=1.0 - float(clips.leaves[row]),
                pose_distance=_number_or_none(self.poses[place]),
                rank_distance=_number_or_none(self.distances[place]),
                mirrored=self.asked.mirrored,
                alike=None if reached is None else bool(reached[place]),
                probability=None if chances is None else round(float(chances[place]), 4),
            )
            for place, row in enumerate(rows.tolist())
        ]


def rank_rows(index: LeafIndex, asked: Asked, k: int, by: str, chosen: BoolArray, read_poses: PoseReader) -> RankedRows:
    """Rank the first k clips for a motion; OptionError for an unknown ranking.

    Parameters
    ----------
    by : one of ``dousa.retrieval.ranking.ranking.RANKINGS``.
    chosen : (N,) which rows to search.
    read_poses : called at most once.
    """
    if by not in RANKINGS:
        raise OptionError("ranking.unknown", known=RANKINGS, found=by)
    clips = _Comparison(index, asked.answers, by, chosen)
    similar = clips.find_similar()
    if by in ("histogram", "leaves"):
        rows = clips.find_nearest(k)
        return RankedRows(index, asked, rows, clips.keys[rows], np.full(len(rows), np.nan), similar, clips)
    rows = _list_candidates(clips, k, similar if by == DEFAULT_RANKING else None)
    refined = np.arange(min(N_REFINED, len(rows)))
    poses = np.full(len(rows), np.nan)
    if len(refined):
        own = [index.clip_id(int(row)) for row in rows[refined]]
        poses[refined] = rank_by_pose(asked.poses, read_poses(own))[1]
    distances = poses if by == "pose" else fuse(clips.keys[rows], poses, refined)
    order = np.arange(len(rows))
    order[: len(refined)] = np.argsort(distances[refined], kind="stable")
    if similar is not None and by == DEFAULT_RANKING:
        order = order[np.argsort(~np.isin(rows[order], similar), kind="stable")]
    order = order[:k]
    return RankedRows(index, asked, rows[order], distances[order], poses[order], similar, clips)


def _list_candidates(clips: _Comparison, k: int, similar: IndexArray | None) -> IndexArray:
    """Return rows that include the first k, sorted by the distance without poses."""
    if similar is None:
        return clips.find_nearest(max(k, N_REFINED))
    if len(similar) < k:
        rows = clips.find_nearest(N_REFINED + 2 * k)
        more = similar
    else:
        rows = clips.find_nearest(N_REFINED)
        more = clips.find_nearest(N_REFINED + k, similar)
    return clips.find_nearest(len(rows) + len(more), np.union1d(rows, more))
