"""The tests of a forest, read once from its nodes, and the answers of clips at all nodes at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import ArrayLike

from dousa.arrays import BoolArray, FloatArray, IntArray
from dousa.errors import InvalidMotionError
from dousa.retrieval.features.channels import Channel
from dousa.retrieval.features.feature_sets import DURATION, FEATURE_SETS, MEAN, SPREAD, TREND
from dousa.retrieval.forest.forest import MotionForest
from dousa.retrieval.forest.trees import KIND_NAMES, Trees


@njit(cache=True, nogil=True)
def sum_upwards(children: IntArray, leaves: FloatArray, sums: FloatArray) -> None:
    """Sum the leaves below every node into ``sums`` (M,)."""
    for node in range(len(children) - 1, -1, -1):
        child = children[node]
        sums[node] = leaves[-1 - child] if child < 0 else sums[child] + sums[child + 1]


@njit(cache=True, nogil=True)
def _expect(
    root: int,
    extra: int,
    mark: int,
    children: IntArray,
    above: BoolArray,
    other: BoolArray,
    relation: IntArray,
    sizes: FloatArray,
    values: FloatArray,
    removed: BoolArray,
    places: IntArray,
    weights: FloatArray,
    seen: IntArray,
) -> float:
    """Return the expected value of the leaf that both clips reach together.

    At a node with a removed relation, or ``extra``, they go to both children with the shares of the training clips
    there; elsewhere they follow their answers, and add nothing once they part. Other relations are marked in ``seen``
    with ``mark``.
    """
    expected = 0.0
    places[0], weights[0] = root, 1.0
    depth = 1
    while depth > 0:
        depth -= 1
        node, weight = places[depth], weights[depth]
        child = children[node]
        if child < 0:
            expected += weight * values[-1 - child]
            continue
        asked = relation[node]
        if removed[asked] or asked == extra:
            share = sizes[child] / sizes[node]
            places[depth], weights[depth] = child, weight * share
            places[depth + 1], weights[depth + 1] = child + 1, weight * (1.0 - share)
            depth += 2
            continue
        if mark >= 0:
            seen[asked] = mark
        if above[node] == other[node]:
            places[depth], weights[depth] = child + np.int64(above[node]), weight
            depth += 1
    return expected


@njit(cache=True, nogil=True)
def ablate(
    roots: IntArray,
    children: IntArray,
    above: BoolArray,
    other: BoolArray,
    relation: IntArray,
    sizes: FloatArray,
    values: FloatArray,
    removed: BoolArray,
    places: IntArray,
    weights: FloatArray,
    seen: IntArray,
    without: FloatArray,
) -> float:
    """Compute the mean value of the leaves of two clips over the trees, and that without each relation.

    Parameters
    ----------
    roots : (n_trees,) first node of each tree.
    above, other : (M,) answers of two clips at every node; equal for one clip.
    sizes : (M,) training clips at each node.
    values : (L,) value of each leaf: 1 where it votes for the category.
    removed : (R,) relations already removed, also from the mean returned.
    places, weights, seen : memory for (M + 2,), (M + 2,) and (R,).
    without : (R,) filled with the mean without each relation as well.
    """
    total = 0.0
    without[:] = 0.0
    seen[:] = -1
    for tree in range(len(roots)):
        root = roots[tree]
        value = _expect(root, -1, tree, children, above, other, relation, sizes, values, removed, places, weights, seen)
        total += value
        for number in range(len(without)):
            if seen[number] == tree:
                without[number] += value - _expect(
                    root, number, -1, children, above, other, relation, sizes, values, removed, places, weights,
                    seen,
                )  # fmt: skip
    for number in range(len(without)):
        without[number] = (total - without[number]) / len(roots)
    return total / len(roots)


@dataclass(frozen=True, slots=True)
class Question:
    """The test of a node: the ``kind`` of value of a channel over the cells ``start ... stop - 1``."""

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
    channels : (F,) of the columns of the features.
    relations : names of the relations tested; one empty name if there are none.
    children : (M,) left child or ``-1 - leaf``.
    kind, column, partner, start, stop : (M,) see ``tree_kernels``; meaningless at leaves.
    threshold : (M,) of the mean, spread or trend.
    relation : (M,) number of the relation.
    sizes : (M,) training clips at each node.
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
        """Compute the (M,) values of all tests for a clip (T, F); InvalidMotionError for another shape or NaN."""
        pose = np.asarray(clip, dtype=np.float64)
        wanted = (self.trees.n_frames, self.trees.n_features)
        if pose.shape != wanted or not np.isfinite(pose).all():
            raise InvalidMotionError(
                "explain.not_finite" if pose.shape == wanted else "explain.shape",
                wanted=wanted,
                shape=pose.shape,
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
        """Return the (M,) sums over the leaves below every node."""
        sums = np.empty(len(self.children))
        sum_upwards(self.children, leaves, sums)
        return sums

    def follow(self, above: BoolArray, trees: BoolArray) -> tuple[IntArray, IntArray]:
        """Return the inner nodes on the paths of a clip with answers (M,) in some trees, and the child of each."""
        places = self.trees.roots[trees]
        nodes = []
        while len(places):
            places = places[self.children[places] >= 0]
            nodes.append(places)
            places = self.children[places] + above[places]
        asked = np.concatenate(nodes) if nodes else np.zeros(0, np.int64)
        return asked, self.children[asked] + above[asked]

    def find_leaves(self, above: BoolArray) -> IntArray:
        """Return the (n_trees,) leaves of a clip with these answers."""
        places = self.trees.roots.copy()
        while True:
            inner = np.flatnonzero(self.children[places] >= 0)
            if not len(inner):
                return -1 - self.children[places]
            places[inner] = self.children[places[inner]] + above[places[inner]]

    def question(self, node: int) -> Question:
        """Return the test of an inner node."""
        return Question(
            self.channels[self.column[node]],
            KIND_NAMES[self.kind[node]],
            int(self.start[node]),
            int(self.stop[node]),
            float(self.threshold[node]),
        )


def read_questions(forest: MotionForest) -> Questions:
    """Read the tests of a trained forest; NotTrainedError before ``fit``."""
    trees, width = forest.trees_, forest.trees_.n_frames + 1
    nodes = trees.nodes.astype(np.int64)
    children, shift = nodes[:, 2], nodes[:, 3]
    column, stop = np.divmod(nodes[:, 0], width)
    start = nodes[:, 1] % width
    leaf = children < 0
    column[leaf], start[leaf], stop[leaf], shift[leaf] = 0, 0, 1, 0
    kind = np.where(shift == 0, MEAN, np.where(shift > 0, SPREAD, TREND))
    # The stored threshold of a mean is multiplied by the length of the interval.
    threshold = trees.cuts[:, 2] / np.where(kind == MEAN, stop - start, 1)
    channels = _find_channels(forest.feature_names_)
    asked = np.unique(column[~leaf])  # columns of squares and moments occur as partners only
    names = tuple(dict.fromkeys(channels[i].relation for i in asked)) or ("",)
    number = np.zeros(len(channels), np.int64)
    number[asked] = [names.index(channels[i].relation) for i in asked]
    sizes = np.empty(len(nodes))
    per_leaf = np.add.reduceat(trees.leaf_counts, trees.leaf_starts[:-1]).astype(np.float64)
    sum_upwards(children.copy(), per_leaf, sizes)
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
    known = {channel.name: channel for features in FEATURE_SETS.values() for channel in features.channels}
    known[DURATION.name] = DURATION
    return tuple(known.get(name, Channel(name, name, "")) for name in names)
