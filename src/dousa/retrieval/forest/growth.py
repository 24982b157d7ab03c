"""New categories without training again: the leaves of a forest take up new clips, and grow where they must.

New clips run down the trees. Where one arrives in a leaf of another category, the leaf becomes a small tree, grown by
the forest's own rule from the clips that stand in it; the splits above stay as they are. So what the forest has
learned is kept, and the work is that of a few leaves.

A category of few clips is met by few leaves only, and a query falls between them. So while a category that receives
clips is smaller than half of the others are, points half way between two of its clips stand beside them (as in SMOTE:
Chawla et al., Journal of Artificial Intelligence Research 16, 2002): features are means over cells of time, and so is
the mean of two of them. These points live in the counts of the leaves only.

The order in which clips are added matters a little: each time, the leaves grow by what stands in them then.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dousa.arrays import FloatArray, IntArray
from dousa.errors import InvalidMotionError, TrainingError
from dousa.retrieval.features.feature_sets import FeatureSet
from dousa.retrieval.features.integral import list_tests
from dousa.retrieval.forest.forest import MotionForest
from dousa.retrieval.forest.trees import Trees, TreesSpec, grow_some, prepare_material

_MOST_LISTED = 1_000_000  # pairs; of more some are drawn


@dataclass(frozen=True, slots=True, eq=False)
class Subtree:
    """What takes the place of one leaf.

    Parameters
    ----------
    leaf : the leaf, numbered through the forest.
    nodes : (m, 6) int32 as in ``Trees``, children and leaves counted from 0.
    leaf_starts, leaf_classes, leaf_counts : as in ``Trees``, of the subtree's own leaves.
    """

    leaf: int
    nodes: NDArray[np.int32]
    leaf_starts: IntArray
    leaf_classes: NDArray[np.int32]
    leaf_counts: NDArray[np.int32]

    @property
    def n_leaves(self) -> int:
        """Leaves of the subtree."""
        return len(self.leaf_starts) - 1


def grow_subtrees(
    features: FloatArray,
    categories: NDArray[np.int32],
    n_classes: int,
    tests: IntArray,
    spec: TreesSpec,
    members: Sequence[tuple[int, IntArray]],
    seeds: NDArray[np.uint64],
) -> list[Subtree]:
    """One subtree for each leaf, by the forest's own rule; a leaf of one category stays one.

    Parameters
    ----------
    features, categories, n_classes, tests, spec : as in ``grow_trees``; bootstrap and workers are not used.
    members : for each leaf its number and the clips that stand in it.
    seeds : 64-bit, one per leaf.
    """
    material = prepare_material(features, categories, tests, max(len(inside) for _, inside in members))
    drawn = ((inside.copy(), seed) for (_, inside), seed in zip(members, seeds, strict=True))
    grown = grow_some(material, n_classes, spec, drawn)
    return [Subtree(leaf, *tree) for (leaf, _), tree in zip(members, grown, strict=True)]


def replace_leaves(trees: Trees, subtrees: Sequence[Subtree], n_classes: int) -> Trees:
    """The trees with subtrees in the place of some of their leaves.

    Old nodes keep their tests and their order. The first leaf of a subtree takes the number of the leaf that it
    replaces, the others are numbered on behind all leaves; so a clip in any other leaf stays where it is.

    Parameters
    ----------
    trees : whose leaf classes are numbered as in the subtrees.
    subtrees : of different leaves.
    n_classes : C of the new trees.
    """
    old = trees.nodes[:, 2]
    node_of_leaf = np.empty(trees.n_leaves, np.int64)
    node_of_leaf[-1 - old[old < 0]] = np.flatnonzero(old < 0)
    home = np.searchsorted(trees.roots, [node_of_leaf[one.leaf] for one in subtrees], side="right") - 1
    added = np.bincount(home, [len(one.nodes) - 1 for one in subtrees], len(trees.roots)).astype(np.int64)
    shifts = np.concatenate([[0], np.cumsum(added)])
    lengths = np.diff(np.append(trees.roots, len(trees.nodes)))
    nodes = np.zeros((len(trees.nodes) + int(shifts[-1]), 6), np.int32)
    place = np.arange(len(trees.nodes)) + np.repeat(shifts[:-1], lengths)
    nodes[place] = trees.nodes
    inner = old >= 0
    nodes[place[inner], 2] += np.repeat(shifts[:-1], lengths)[inner].astype(np.int32)
    free = trees.roots + lengths + shifts[:-1]  # where the next subtree of each tree goes
    n_leaves = trees.n_leaves
    for one, tree in zip(subtrees, home, strict=True):
        numbers = np.append(one.leaf, n_leaves + np.arange(one.n_leaves - 1))
        n_leaves += one.n_leaves - 1
        moved = one.nodes.copy()
        children = one.nodes[:, 2]
        # The subtree's root takes the place of the leaf, so its other nodes begin one earlier.
        moved[:, 2] = np.where(children < 0, -1 - numbers[-1 - np.minimum(children, -1)], children + free[tree] - 1)
        nodes[place[node_of_leaf[one.leaf]]] = moved[0]
        nodes[free[tree] : free[tree] + len(moved) - 1] = moved[1:]
        free[tree] += len(moved) - 1
    entries = _replace_entries(trees, subtrees)
    return Trees(nodes, trees.roots + shifts[:-1], *entries, trees.n_features, trees.n_frames, n_classes)


def _replace_entries(
    trees: Trees, subtrees: Sequence[Subtree]
) -> tuple[IntArray, NDArray[np.int32], NDArray[np.int32]]:
    """Starts, classes and counts of all leaves in the order of their new numbers."""
    starts = trees.leaf_starts
    rows = list(zip(starts[:-1].tolist(), starts[1:].tolist(), strict=True))
    classes, counts = [trees.leaf_classes], [trees.leaf_counts]
    end = int(starts[-1])
    for one in subtrees:
        ends = (one.leaf_starts + end).tolist()
        rows[one.leaf] = (ends[0], ends[1])
        rows.extend(pairwise(ends[1:]))
        classes.append(one.leaf_classes)
        counts.append(one.leaf_counts)
        end = ends[-1]
    begins, stops = np.array(rows, np.int64).T
    sizes = stops - begins
    new_starts = np.concatenate([[0], np.cumsum(sizes)])
    picked = np.repeat(begins - new_starts[:-1], sizes) + np.arange(new_starts[-1])
    return new_starts, np.concatenate(classes)[picked], np.concatenate(counts)[picked]


FeatureReader = Callable[[IntArray], FloatArray]


@dataclass(frozen=True, slots=True, eq=False)
class StandingClips:
    """The clips that a forest was trained with, or has taken up since.

    Parameters
    ----------
    categories : (N,) words or whole numbers.
    leaves : (N, n_trees) as ``apply`` gives them.
    read_features : gives the features (n, T, F) of some clips by their places (n,); it is asked only for those whose
        leaves grow.
    """

    categories: ArrayLike
    leaves: NDArray[np.integer[Any]]
    read_features: FeatureReader


@dataclass(frozen=True, slots=True, eq=False)
class Growth:
    """What has become of a forest.

    Parameters
    ----------
    forest : the new one; the old one stays as it was.
    leaves : (M, n_trees) of the new clips.
    moved : (K,) places of the standing clips that have come into other leaves.
    moved_leaves : (K, n_trees) of theirs. The histograms of these clips change, and where there are new categories
        those of all clips get their columns: ``forest.histograms_of(leaves)``.
    """

    forest: MotionForest
    leaves: IntArray
    moved: IntArray
    moved_leaves: IntArray


def grow_forest(
    forest: MotionForest,
    standing: StandingClips,
    features: ArrayLike,
    categories: ArrayLike,
    *,
    feature_set: FeatureSet | None = None,
    random_state: int = 0,
) -> Growth:
    """Take up new clips, of categories old or new.

    Parameters
    ----------
    forest : trained, or grown before.
    standing : all clips that it knows.
    features : (M, T, F) of the new clips; without any, the forest comes back as it is.
    categories : (M,) theirs.
    feature_set : that of ``MotionForest.fit``.
    random_state : seed; the same seed and clips give the same forest.

    Returns
    -------
    Growth

    Raises
    ------
    NotTrainedError : the forest is not trained.
    TrainingError : categories of another kind than the forest's, or not one for each clip.
    InvalidMotionError : features of another shape, or not finite.
    """
    leaves = forest.apply(features)
    known, labels = _read_labels(standing.categories), _read_labels(categories)
    if len(known) != len(standing.leaves) or standing.leaves.shape[1:] != leaves.shape[1:]:
        raise InvalidMotionError("growth.leaves", clips=len(known), trees=leaves.shape[1], shape=standing.leaves.shape)
    if not len(leaves):
        return Growth(forest, leaves, np.zeros(0, np.int64), leaves[:0])
    if labels.shape != (len(leaves),) or labels.dtype.kind != forest.classes_.dtype.kind:
        kind = forest.classes_.dtype
        raise TrainingError("growth.labels", kind=kind, clips=len(leaves), found=labels.dtype, shape=labels.shape)
    if not np.isin(known, forest.classes_).all():
        raise TrainingError("growth.categories")
    classes = np.unique(np.concatenate([forest.classes_, labels]))
    own = np.searchsorted(classes, np.concatenate([known, labels]).astype(classes.dtype)).astype(np.int32)
    generator = np.random.default_rng(random_state)
    material = _Material(standing, np.asarray(features, np.float64), leaves.astype(np.int64), own)
    material = material.with_points(_choose_pairs(own, len(known), generator), forest)
    grown, involved = _grow(forest, material, classes, feature_set, generator)
    if not len(involved):
        return Growth(grown, grown.apply(features), involved, leaves[:0])
    now = grown.apply(standing.read_features(involved))
    changed = (now != standing.leaves[involved]).any(axis=1)
    return Growth(grown, grown.apply(features), involved[changed], now[changed])


@dataclass(frozen=True, slots=True, eq=False)
class _Material:
    """Standing clips, then the new ones and the points between clips, all numbered through.

    Parameters
    ----------
    features, leaves : of what is new, (M, T, F) and (M, n_trees).
    own : (N + M,) number of each one's category.
    """

    standing: StandingClips
    features: FloatArray
    leaves: IntArray
    own: NDArray[np.int32]

    @property
    def n_standing(self) -> int:
        """N."""
        return len(self.own) - len(self.leaves)

    def read(self, rows: IntArray) -> FloatArray:
        """Features of any of them."""
        known = rows < self.n_standing
        read = np.empty((len(rows), *self.features.shape[1:]))
        if known.any():
            read[known] = self.standing.read_features(rows[known])
        read[~known] = self.features[rows[~known] - self.n_standing]
        return read

    def with_points(self, pairs: IntArray, forest: MotionForest) -> _Material:
        """The same with the points half way between pairs (P, 2) of clips of one category."""
        if not len(pairs):
            return self
        points = 0.5 * (self.read(pairs[:, 0]) + self.read(pairs[:, 1]))
        return _Material(
            self.standing,
            np.concatenate([self.features, points]),
            np.concatenate([self.leaves, forest.apply(points)]),
            np.concatenate([self.own, self.own[pairs[:, 0]]]),
        )


def _read_labels(categories: ArrayLike) -> NDArray[Any]:
    labels = np.asarray(categories)
    return labels.astype(np.str_) if labels.dtype == object else labels


def _choose_pairs(own: NDArray[np.int32], n_standing: int, generator: np.random.Generator) -> IntArray:
    """(P, 2) pairs of clips of one category, one of them new at least, to fill small categories up."""
    sizes = np.bincount(own[:n_standing])
    usual = int(np.median(sizes[sizes > 0])) if n_standing else 0
    chosen = [np.zeros((0, 2), np.int64)]
    for category in np.unique(own[n_standing:]):
        inside = np.flatnonzero(own == category)
        missing = usual - len(inside)
        if missing <= 0:
            continue
        starts, n_pairs = _number_pairs(int((inside < n_standing).sum()), len(inside))
        if n_pairs <= _MOST_LISTED:
            numbers = generator.permutation(n_pairs)[:missing]
        else:
            numbers = generator.choice(n_pairs, min(missing, n_pairs), replace=False)
        first = np.searchsorted(starts, numbers, side="right") - 1
        second = np.maximum(first + 1, (inside < n_standing).sum()) + numbers - starts[first]
        chosen.append(np.stack([inside[first], inside[second]], axis=1))
    return np.concatenate(chosen)


def _number_pairs(n_standing: int, n: int) -> tuple[IntArray, int]:
    """Pairs of n clips of which one is new at least, numbered through: where those of each first clip begin (n,), and
    how many there are. The second clip comes behind the first; the standing clips come before the new ones.
    """
    counts = n - np.maximum(np.arange(n, dtype=np.int64) + 1, n_standing)
    starts = np.cumsum(counts) - counts
    return starts, int(counts.sum())


def _grow(
    forest: MotionForest,
    material: _Material,
    classes: NDArray[Any],
    feature_set: FeatureSet | None,
    generator: np.random.Generator,
) -> tuple[MotionForest, IntArray]:
    """The grown forest, and the standing clips in the leaves that the new ones have reached."""
    trees = _renumber(forest, classes)
    members = _list_members(material, trees.n_leaves)
    rows, places = np.unique(np.concatenate([inside for _, inside in members]), return_inverse=True)
    ends = np.cumsum([len(inside) for _, inside in members])[:-1]
    local = zip((leaf for leaf, _ in members), np.split(places, ends), strict=True)
    tests = list_tests(trees.n_features, trees.n_frames) if feature_set is None else feature_set.tests
    subtrees = grow_subtrees(
        material.read(rows),
        material.own[rows],
        len(classes),
        tests,
        forest.make_spec(len(tests)),
        list(local),
        generator.integers(0, 2**63, len(members)).astype(np.uint64),
    )
    grown = forest.with_trees(replace_leaves(trees, subtrees, len(classes)), classes)
    return grown, rows[rows < material.n_standing]


def _renumber(forest: MotionForest, classes: NDArray[Any]) -> Trees:
    """The trees of a forest with its categories numbered among all categories."""
    numbers = np.searchsorted(classes, forest.classes_).astype(np.int32)
    own = numbers[forest.trees_.leaf_classes]
    return replace(forest.trees_, leaf_classes=own, n_classes=len(classes))


def _list_members(material: _Material, n_leaves: int) -> list[tuple[int, IntArray]]:
    """The leaves that new clips and points have reached, in order, and everything that stands in each."""
    reached = np.zeros(n_leaves, bool)
    reached[material.leaves] = True
    everyone = np.concatenate([material.standing.leaves.astype(np.int64), material.leaves])
    clips, trees = np.nonzero(reached[everyone])
    leaves = everyone[clips, trees]
    order = np.lexsort((clips, leaves))
    numbers, starts = np.unique(leaves[order], return_index=True)
    return list(zip(numbers.tolist(), np.split(clips[order], starts[1:]), strict=True))
