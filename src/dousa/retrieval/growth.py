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

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dousa.errors import InvalidMotionError, TrainingError
from dousa.retrieval._regrowing import grow_subtrees, replace_leaves
from dousa.retrieval._trees import Trees
from dousa.retrieval.feature_sets import FeatureSet
from dousa.retrieval.forest import MotionForest
from dousa.retrieval.integral import list_tests

__all__ = ["Growth", "StandingClips", "grow_forest"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
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
        raise InvalidMotionError(
            f"expected leaves ({len(known)}, {leaves.shape[1]}) of the standing clips, got {standing.leaves.shape}"
        )
    if not len(leaves):
        return Growth(forest, leaves, np.zeros(0, np.int64), leaves[:0])
    if labels.shape != (len(leaves),) or labels.dtype.kind != forest.classes_.dtype.kind:
        raise TrainingError(
            f"expected a category of the kind {forest.classes_.dtype} for each of {len(leaves)} clips, "
            f"got {labels.dtype} {labels.shape}"
        )
    if not np.isin(known, forest.classes_).all():
        raise TrainingError("expected standing clips of the forest's categories, got others; train again")
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
        first, second = np.triu_indices(len(inside), k=1)
        pairs = np.stack([inside[first], inside[second]], axis=1)
        pairs = pairs[(pairs >= n_standing).any(axis=1)]
        missing = usual - len(inside)
        if missing > 0:
            chosen.append(pairs[generator.permutation(len(pairs))[:missing]])
    return np.concatenate(chosen)


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
    return forest.with_trees(replace_leaves(trees, subtrees, len(classes)), classes), rows[
        rows < material.n_standing
    ]


def _renumber(forest: MotionForest, classes: NDArray[Any]) -> Trees:
    """The trees of a forest with its categories numbered among all categories."""
    trees = forest.trees_
    numbers = np.searchsorted(classes, forest.classes_).astype(np.int32)
    return Trees(
        trees.nodes,
        trees.roots,
        trees.leaf_starts,
        numbers[trees.leaf_classes],
        trees.leaf_counts,
        trees.n_features,
        trees.n_frames,
        len(classes),
    )


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
