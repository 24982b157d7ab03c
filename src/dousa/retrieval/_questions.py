"""What a forest asks, read once from its nodes, and what clips answer, at all nodes at a time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dousa.errors import InvalidMotionError
from dousa.retrieval import _explain_kernels as kernels
from dousa.retrieval._trees import KIND_NAMES, Trees
from dousa.retrieval.channels import Channel
from dousa.retrieval.feature_sets import DURATION, FEATURE_SETS
from dousa.retrieval.forest import MotionForest
from dousa.retrieval.integral import MEAN, SPREAD, TREND

__all__ = ["Question", "Questions", "read_questions"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Question:
    """What one node asks: the ``kind`` of value of a channel over the cells ``start ... stop - 1``."""

    channel: Channel
    kind: str
    start: int
    stop: int
    threshold: float


@dataclass(frozen=True, slots=True, eq=False)
class Questions:
    """The tests of all nodes of a forest.

    Parameters
    ----------
    trees : of the forest.
    channels : (F,) what the columns of the features are.
    relations : the names of the different relations that are asked about; one empty name if nothing is.
    children : (M,) left child or ``-1 - leaf``.
    kind, column, partner, start, stop : (M,) see ``_forest_kernels``; of no meaning at leaves.
    threshold : (M,) of the mean, spread or trend.
    relation : (M,) number of the relation.
    sizes : (M,) training clips that came to each node.
    """

    trees: Trees
    channels: tuple[Channel, ...]
    relations: tuple[str, ...]
    children: IntArray
    kind: IntArray
    column: IntArray
    partner: IntArray
    start: IntArray
    stop: IntArray
    threshold: FloatArray
    relation: IntArray
    sizes: FloatArray

    def evaluate(self, clip: ArrayLike) -> FloatArray:
        """The value of every node's test for a clip (T, F): (M,); InvalidMotionError for another shape or NaN."""
        pose = np.asarray(clip, dtype=np.float64)
        wanted = (self.trees.n_frames, self.trees.n_features)
        if pose.shape != wanted or not np.isfinite(pose).all():
            raise InvalidMotionError(
                f"expected finite features of shape {wanted}, got shape {pose.shape}"
                + (" with NaN or infinity" if pose.shape == wanted else "")
            )
        integrals = np.zeros((pose.shape[1], pose.shape[0] + 1))
        np.cumsum(pose.T, axis=1, out=integrals[:, 1:])
        length = (self.stop - self.start).astype(np.float64)
        difference = integrals[self.column, self.stop] - integrals[self.column, self.start]
        values: FloatArray = difference / length
        for kind in (SPREAD, TREND):
            at = np.flatnonzero(self.kind == kind)
            start, stop, partner = self.start[at], self.stop[at], self.partner[at]
            other = integrals[partner, stop] - integrals[partner, start]
            if kind == SPREAD:
                values[at] = np.sqrt(np.maximum(other / length[at] - values[at] ** 2, 0.0))
            else:
                middle = 0.5 * (start + stop)
                values[at] = 12.0 * (other - middle * difference[at]) / length[at] ** 2
        return values

    def sum_leaves(self, leaves: FloatArray) -> FloatArray:
        """(M,) the sums over the leaves below every node."""
        sums = np.empty(len(self.children))
        kernels.sum_upwards(self.children, leaves, sums)
        return sums

    def follow(self, above: BoolArray, trees: BoolArray) -> tuple[IntArray, IntArray]:
        """The inner nodes on the way of a clip with these answers (M,) down some trees, and the child taken at each."""
        places = self.trees.roots[trees]
        nodes = []
        while len(places):
            places = places[self.children[places] >= 0]
            nodes.append(places)
            places = self.children[places] + above[places]
        asked = np.concatenate(nodes) if nodes else np.zeros(0, np.int64)
        return asked, self.children[asked] + above[asked]

    def find_leaves(self, above: BoolArray) -> IntArray:
        """(n_trees,) the leaf that a clip with these answers reaches in each tree."""
        places = self.trees.roots.copy()
        while True:
            inner = np.flatnonzero(self.children[places] >= 0)
            if not len(inner):
                return -1 - self.children[places]
            places[inner] = self.children[places[inner]] + above[places[inner]]

    def question(self, node: int) -> Question:
        """What an inner node asks."""
        return Question(
            self.channels[self.column[node]],
            KIND_NAMES[self.kind[node]],
            int(self.start[node]),
            int(self.stop[node]),
            float(self.threshold[node]),
        )


def read_questions(forest: MotionForest) -> Questions:
    """The questions of a trained forest; NotTrainedError before ``fit``."""
    trees, width = forest.trees_, forest.trees_.n_frames + 1
    nodes = trees.nodes.astype(np.int64)
    children, shift = nodes[:, 2], nodes[:, 3]
    column, stop = np.divmod(nodes[:, 0], width)
    start = nodes[:, 1] % width
    leaf = children < 0
    column[leaf], start[leaf], stop[leaf], shift[leaf] = 0, 0, 1, 0
    kind = np.where(shift == 0, MEAN, np.where(shift > 0, SPREAD, TREND))
    # The threshold of a mean is kept times the length of the interval.
    threshold = trees.cuts[:, 2] / np.where(kind == MEAN, stop - start, 1)
    channels = _find_channels(forest.feature_names_)
    asked = np.unique(column[~leaf])  # columns of squares and moments are asked as partners only
    names = tuple(dict.fromkeys(channels[i].relation for i in asked)) or ("",)
    number = np.zeros(len(channels), np.int64)
    number[asked] = [names.index(channels[i].relation) for i in asked]
    sizes = np.empty(len(nodes))
    per_leaf = np.add.reduceat(trees.leaf_counts, trees.leaf_starts[:-1]).astype(np.float64)
    kernels.sum_upwards(children.copy(), per_leaf, sizes)
    return Questions(
        trees=trees,
        channels=channels,
        relations=names,
        children=children.copy(),
        kind=kind,
        column=column,
        partner=column + np.abs(shift) // width,
        start=start,
        stop=stop,
        threshold=threshold,
        relation=number[column],
        sizes=sizes,
    )


def _find_channels(names: tuple[str, ...]) -> tuple[Channel, ...]:
    """The channels by their names; a column of no known set is its own relation, in no unit."""
    known = {channel.name: channel for features in FEATURE_SETS.values() for channel in features.channels}
    known[DURATION.name] = DURATION
    return tuple(known.get(name, Channel(name, name, "")) for name in names)
