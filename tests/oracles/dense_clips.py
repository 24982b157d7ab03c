"""Clips ranked with all their votes, leaves and directions in memory, each measured: what a search must say."""

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from oracles import hamada

from dousa.library.search.leaf_index import LeafIndex
from dousa.library.search.parts import ClipPart, SparseVotes, encode_rows
from dousa.library.search.ranking import Asked
from dousa.library.store.forests import TreeAnswers
from dousa.retrieval.forest.likeness import Likeness, merge_votes
from dousa.retrieval.forest.pose_space import Curve
from dousa.retrieval.ranking.ranking import N_REFINED, rank_by_pose

N_PARTS = 64
NO_FEATURES = np.zeros((1, 0, 0))


@dataclass
class DenseClips:
    """Clips in the order of their numbers: votes in 64ths (N, C), leaves (N, n_trees), directions (N, K) or None."""

    ids: np.ndarray
    paths: list[str]
    given: list[str | None]
    predicted: list[str]
    votes: np.ndarray
    leaves: np.ndarray
    directions: np.ndarray | None
    poses: np.ndarray
    categories: tuple[str, ...]
    likeness: Likeness | None
    meanings: np.ndarray
    order: np.ndarray = field(init=False)

    def __post_init__(self):
        self.order = np.array(sorted(range(len(self.ids)), key=self.paths.__getitem__), np.intp)

    @property
    def labels(self):
        return [b if a is None else a for a, b in zip(self.given, self.predicted, strict=True)]

    def read_poses(self, numbers):
        return self.poses[np.searchsorted(self.ids, numbers)]

    def ask(self, row, mirrored=False):
        """One of the clips, as a motion to search for."""
        own = slice(row, row + 1)
        directions = None if self.directions is None else self.directions[own]
        answers = TreeAnswers(self.votes[own], self.leaves[own], self.categories, directions)
        return Asked(answers, NO_FEATURES, self.poses[row], mirrored)

    def chances(self, row):
        """Probabilities that clips mean the same as one; None where that was not learned."""
        if self.likeness is None or self.directions is None:
            return None
        shares = self.votes / (N_PARTS * self.leaves.shape[1])
        told = merge_votes(shares, self.meanings)
        return self.likeness.judge(told[row], self.directions[row], told, self.directions)

    def rank(self, row, k, by, category=None, among=None):
        """Places of the first k clips for one of them, with all that is said of each, and how many are alike."""
        keep = [
            place
            for place in self.order
            if category in (None, self.labels[place]) and (among is None or self.ids[place] in among)
        ]
        rows = np.array(keep, np.intp)
        cosines = None
        if self.directions is not None:
            cosines = np.round(self.directions[rows].astype(float) @ self.directions[row].astype(float), 6)
        order, histograms, leaves, poses, distances = self._rank_all(row, rows, by, cosines)
        chances, alike = self.chances(row), None
        if chances is not None:
            alike = chances[rows] >= self.likeness.threshold
            if by == "fused":
                order = order[np.argsort(~alike[order], kind="stable")]
        told = [
            (int(self.ids[rows[p]]), histograms[p], leaves[p], poses[p], distances[p],
             None if alike is None else bool(alike[p]), None if chances is None else chances[rows[p]])
            for p in order[:k]
        ]  # fmt: skip
        return told, None if alike is None else int(alike.sum())

    def _rank_all(self, row, rows, by, cosines):
        """The order of some rows, and their distances: eq. 8, leaves, poses of the first 64, and what orders them."""
        total = int(self.votes[row].sum())
        histograms = np.array([hamada.distance(self.votes[row].tolist(), self.votes[p].tolist()) for p in rows]) / total
        leaves = (self.leaves[rows] != self.leaves[row]).sum(axis=1) / self.leaves.shape[1]
        poses = np.full(len(rows), np.nan)
        if by in ("histogram", "leaves"):
            first, second = (histograms, leaves) if by == "histogram" else (leaves, histograms)
            return np.lexsort((second, first)), histograms, leaves, poses, first
        cheap = histograms * 2**-0.5 + 0.5 * leaves + (0 if cosines is None else 0.5 * (1.0 - cosines))
        order = np.argsort(cheap, kind="stable")
        refined = order[:N_REFINED]
        if len(refined):
            poses[refined] = rank_by_pose(self.poses[row], self.poses[rows[refined]])[1]
        worst = poses[refined].max(initial=0.0)
        distances = poses if by == "pose" else cheap + 8.0 * np.where(np.isnan(poses), worst, poses)
        order[:N_REFINED] = refined[np.argsort(distances[refined], kind="stable")]
        return order, histograms, leaves, poses, distances

    def make_index(self, *edges, dead=()):
        """The same as a ``LeafIndex`` of parts that begin at some rows; clips in ``dead`` are not as they were."""
        edges = (0, *edges, len(self.ids))
        parts = [self._make_part(slice(a, b)) for a, b in pairwise(edges)]
        votes = [self._make_votes(slice(a, b)) for a, b in pairwise(edges)]
        alive = [~np.isin(part.ids, list(dead)) if dead else None for part in parts]
        return LeafIndex(
            tuple(parts), tuple(votes), tuple(alive), revision=1, learned=(1, 1), categories=self.categories,
            likeness=self.likeness, meanings=self.meanings,
        )  # fmt: skip

    def _make_part(self, own):
        names = sorted({*self.predicted, *(name for name in self.given if name)}, reverse=True)
        codes, table, offsets = encode_rows(self.leaves[own], int(self.leaves.max(initial=0)) + 1)
        paths = [path.encode() for path in self.paths[own]]
        return ClipPart(
            self.ids[own],
            np.zeros((len(paths), 2), np.int64),
            np.array([-1 if name is None else names.index(name) for name in self.given[own]], np.int32),
            np.array([names.index(name) for name in self.predicted[own]], np.int32),
            tuple(names),
            np.cumsum([len(path) for path in paths], dtype=np.int64),
            np.frombuffer(b"".join(paths), np.uint8),
            codes,
            table,
            offsets,
            None if self.directions is None else self.directions[own],
        )

    def _make_votes(self, own):
        votes = self.votes[own].astype(np.int64)
        rows, categories = np.nonzero(votes)
        starts = np.concatenate([[0], np.cumsum((votes > 0).sum(axis=1))])
        lengths = np.linalg.norm(merge_votes(votes, self.meanings), axis=1)
        values = votes[rows, categories].astype(np.int32)
        return SparseVotes(starts, categories.astype(np.uint16), values, (votes**2).sum(axis=1), lengths)


def make_clips(seed, n_clips=90, n_trees=6, *, n_leaves=3, learned=True, pooled=False):
    """Few trees and leaves, so that there are equals of every kind; votes follow from the leaves, as of a forest."""
    rng = np.random.default_rng(seed)
    categories = ("a", "b", "c", "d")
    share = rng.dirichlet([0.3] * 4, (n_trees, n_leaves))
    if not pooled:
        share = np.eye(4)[share.argmax(axis=2)]
    chosen = rng.integers(0, n_leaves, (n_clips, n_trees))
    votes = np.rint(N_PARTS * share[np.arange(n_trees), chosen].sum(axis=1)).astype(np.int32)
    directions = rng.normal(0, 1, (n_clips, 5)) + 3 * np.eye(5)[votes.argmax(axis=1)]
    directions = (directions / np.linalg.norm(directions, axis=1, keepdims=True)).astype(np.float32)
    given = [None if rng.random() < 0.2 else categories[rng.integers(4)] for _ in range(n_clips)]
    likeness = Likeness(None, Curve(-4.0, (4.0, 3.0)), 0.75, 0.9, 0.9) if learned else None
    return DenseClips(
        100 + 3 * np.arange(n_clips),
        [f"{place:03}" for place in rng.permutation(n_clips)],
        given,
        [categories[place] for place in votes.argmax(axis=1)],
        votes,
        (n_leaves * np.arange(n_trees) + chosen).astype(np.int32),
        directions if learned else None,
        rng.normal(0, 0.05, (n_clips, 4, 3)).astype(np.float32),
        categories,
        likeness,
        np.array([0, 1, 1, 2]),
    )
