"""Exact search for the nearest clips, with a lower bound of the distance to skip the others.

The sparse votes of a clip bound its distance, so leaves and directions, ten times as many bytes, are compared only for
clips whose bound is within the distance of the last wanted clip. The order is that of ``dousa.retrieval.ranking``;
equals are sorted by path.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import BoolArray, FloatArray, IndexArray
from dousa.errors import OptionError
from dousa.library.search.kernels import find_limit
from dousa.library.search.leaf_index import IndexQuery, LeafIndex
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

_SLACK = 1e-5  # for float32 and rounded cosines
_WEIGHTS = {"histogram": (1.0, 0.0), "leaves": (0.0, 1.0)}
_BEYOND = 1e9  # the bound of excluded clips is infinite
_FEW = 256  # extra clips compared first, for a closer limit

PoseReader = Callable[[Sequence[int]], NDArray[np.float32]]
"""Returns the pose sequences (n, cells, columns) of n clip numbers."""


@dataclass(frozen=True, slots=True, eq=False)
class Ranked:
    """The first clips in order.

    Parameters
    ----------
    rows : (M,) of the index.
    histograms, leaves, poses, distances : (M,) as in ``dousa.retrieval.ranking.ranking.Ranking``.
    chances : (M,) probability that they mean the same as the query; None if not learned, as the next two.
    alike : (M,) whether this reaches the threshold.
    all_alike : rows of all clips that reach it.
    """

    rows: IndexArray
    histograms: FloatArray
    leaves: FloatArray
    poses: FloatArray
    distances: FloatArray
    chances: FloatArray | None
    alike: BoolArray | None
    all_alike: IndexArray | None


class _Comparison:
    """Distances of the clips of an index from one query: lower bounds of all, and those computed so far."""

    def __init__(self, index: LeafIndex, query: IndexQuery, by: str, chosen: BoolArray) -> None:
        self._index, self._query, self._by = index, query, by
        weights = _WEIGHTS.get(by, (HISTOGRAM_SCALE, LEAVES_WEIGHT))
        self._bounds, self._told = index.bound(query, weights)
        self._chosen = chosen
        self._bounds[~chosen] = np.inf
        self.n_clips = int(chosen.sum())
        self.has_directions = index.has_directions and query.direction is not None
        size = len(chosen)
        self._known = np.zeros(size, np.bool_)
        self.histograms, self.leaves, self._cosines = np.empty(size), np.empty(size), np.empty(size)
        self.keys = np.empty(size)

    def measure(self, rows: IndexArray) -> None:
        """Compare those clips of ascending rows that were not compared before."""
        rows = rows[~self._known[rows]]
        if not len(rows):
            return
        found = self._index.compare(self._query, rows)
        self._known[rows] = True
        self.histograms[rows], self.leaves[rows] = found.histograms, found.leaves
        self._cosines[rows] = found.cosines
        # Rounded, so that a clip has distance 0 from itself.
        cosines = np.round(found.cosines, 6) if self.has_directions else None
        keys = {"histogram": found.histograms, "leaves": found.leaves}
        self.keys[rows] = keys[self._by] if self._by in keys else add_up(found.histograms, found.leaves, cosines)

    def find_nearest(self, count: int, among: IndexArray | None = None) -> IndexArray:
        """Return the rows of the nearest clips in order, among all chosen clips or some of them."""
        if among is None and count < self.n_clips:
            rows = np.flatnonzero(self._bounds <= min(find_limit(self._bounds, 4 * count + _FEW), _BEYOND))
            self.measure(rows)
            if len(rows) > count:
                limit = np.partition(self.keys[rows], count - 1)[count - 1]
                rows = np.flatnonzero(self._bounds <= limit + _SLACK)
                self.measure(rows)
                rows = rows[self.keys[rows] <= limit]
        else:
            rows = np.flatnonzero(self._chosen) if among is None else among
            self.measure(rows)
        return self._sort(rows, count)

    def _sort(self, rows: IndexArray, count: int) -> IndexArray:
        """Sort rows by key, then by the other measure, then by path, and return the first."""
        others = {"histogram": self.leaves, "leaves": self.histograms}
        second = others[self._by][rows] if self._by in others else np.zeros(len(rows))
        rows = rows[np.lexsort((second, self.keys[rows]))]
        path = self._index.path
        found: list[int] = []
        for _, equals in groupby(rows.tolist(), self._name_place):
            own = list(equals)
            found += own if len(own) == 1 else sorted(own, key=path)
            if len(found) >= count:
                break
        return np.array(found[:count], np.intp)

    def _name_place(self, row: int) -> tuple[float, float]:
        others = {"histogram": self.leaves, "leaves": self.histograms}
        return self.keys[row], others[self._by][row] if self._by in others else 0.0

    def find_alike(self) -> IndexArray | None:
        """Return the rows of the chosen clips like the query; None if not learned."""
        likeness = self._index.likeness
        if likeness is None or not self.has_directions:
            return None
        intercept, slopes = likeness.curve.intercept, likeness.curve.slopes
        with np.errstate(divide="ignore"):
            least = np.log(likeness.threshold) - np.log1p(-likeness.threshold) - intercept - slopes[1] - _SLACK
        rows = np.flatnonzero((slopes[0] * self._told >= least) & self._chosen)
        self.measure(rows)
        return rows[self._judge(rows) >= likeness.threshold]

    def _judge(self, rows: IndexArray) -> FloatArray:
        likeness = self._index.likeness
        assert likeness is not None
        return likeness.curve.evaluate(np.column_stack([self._told[rows], self._cosines[rows]]))

    def judge(self, rows: IndexArray) -> FloatArray | None:
        """Compute the probabilities (M,) that compared clips mean the same as the query."""
        return self._judge(rows) if self._index.likeness is not None and self.has_directions else None


def rank_index(
    index: LeafIndex, query: IndexQuery, k: int, by: str, chosen: BoolArray, read_poses: PoseReader
) -> Ranked:
    """Return the first k clips for a query.

    Parameters
    ----------
    by : one of ``dousa.retrieval.ranking.ranking.RANKINGS``.
    chosen : (N,) which rows to search.
    read_poses : called at most once.

    Raises
    ------
    OptionError : an unknown ranking.
    """
    if by not in RANKINGS:
        raise OptionError("ranking.unknown", known=RANKINGS, found=by)
    clips = _Comparison(index, query, by, chosen)
    alike = clips.find_alike()
    if by in ("histogram", "leaves"):
        rows = clips.find_nearest(k)
        distances, poses = clips.keys[rows], np.full(len(rows), np.nan)
    else:
        rows = _list_candidates(clips, k, alike if by == DEFAULT_RANKING else None)
        refined = np.arange(min(N_REFINED, len(rows)))
        poses = np.full(len(rows), np.nan)
        if len(refined):
            own = [index.clip_id(int(row)) for row in rows[refined]]
            poses[refined] = rank_by_pose(query.poses, read_poses(own))[1]
        distances = poses if by == "pose" else fuse(clips.keys[rows], poses, refined)
        order = np.arange(len(rows))
        order[: len(refined)] = np.argsort(distances[refined], kind="stable")
        if alike is not None and by == DEFAULT_RANKING:
            order = order[np.argsort(~np.isin(rows[order], alike), kind="stable")]
        order = order[:k]
        rows, distances, poses = rows[order], distances[order], poses[order]
    return Ranked(
        rows,
        clips.histograms[rows],
        clips.leaves[rows],
        poses,
        distances,
        clips.judge(rows),
        None if alike is None else np.isin(rows, alike),
        alike,
    )


def _list_candidates(clips: _Comparison, k: int, alike: IndexArray | None) -> IndexArray:
    """Return rows that include the first k, sorted by the distance without poses."""
    if alike is None:
        return clips.find_nearest(max(k, N_REFINED))
    if len(alike) < k:
        rows = clips.find_nearest(N_REFINED + 2 * k)
        more = alike
    else:
        rows = clips.find_nearest(N_REFINED)
        more = clips.find_nearest(N_REFINED + k, alike)
    return clips.find_nearest(len(rows) + len(more), np.union1d(rows, more))
