"""New categories without training again: the leaves of a forest take up new clips, and grow where they must.

New clips run down the trees. Where one arrives in a leaf of another category, the leaf becomes a small tree, grown by
the forest's own rule from all the clips that stand in it; the splits above stay as they are. So what the forest has
learned is kept, and the work is that of a few leaves.

A category of few clips is met by few leaves only, and a query falls between them. So while a category that receives
clips is smaller than half of the others are, points half way between two of its clips stand beside them (as in SMOTE:
Chawla et al., Journal of Artificial Intelligence Research 16, 2002): features are means over cells of time, and so is
the mean of two of them. These points live in the counts of the leaves only.

What becomes of a leaf of the training follows from the clips that stand in it and from nothing else: not from their
order, nor from what stood in it before (``Trees.homes`` says which leaf of the training each leaf grew from, and a leaf
that is met again is grown anew). So the same clips give the same forest, in whatever portions they were added.

In a large library a leaf has hundreds of clips, and where each tree grew from a sample, of several categories. So what
growing costs is bounded: a leaf grows only when the strangers that came after the training are a 64th of it (one among
hundreds is the mistake of a tree, and to part it from them, all of them would have to be looked at), it grows from a
sample of its clips where these are many, and the others are read in portions, to see where they stand then.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dousa.arrays import BoolArray, FloatArray, IntArray
from dousa.errors import InvalidMotionError, TrainingError
from dousa.retrieval.features.feature_sets import FeatureSet
from dousa.retrieval.features.integral import list_tests
from dousa.retrieval.forest.forest import MotionForest, check_features
from dousa.retrieval.forest.points import Keys, Pairs, choose_pairs, mix
from dousa.retrieval.forest.standing_leaves import StandingLeaves
from dousa.retrieval.forest.trees import Trees, TreesSpec, grow_some, prepare_leaves, put_counts

_AT_ONCE = 4096  # clips whose features are read
_MOST_OTHERS = 64  # a leaf grows where this many times the strangers in it are all of its clips, or more
_MOST_DRAWN = 256  # clips that a leaf grows from


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
    if not members:
        return []
    material = prepare_leaves(features, categories, tests, max(len(inside) for _, inside in members))
    drawn = ((inside.copy(), seed) for (_, inside), seed in zip(members, seeds, strict=True))
    grown = grow_some(material, n_classes, spec, drawn)
    return [Subtree(leaf, *tree) for (leaf, _), tree in zip(members, grown, strict=True)]


def collapse_leaves(trees: Trees, leaves: IntArray) -> Trees:
    """The trees with what has grown from some leaves of the training put back into one leaf each.

    The other leaves that grew from one keep their numbers, but nothing leads to them: ``replace_leaves`` uses them, or
    leaves them without clips.
    """
    homes = trees.home_leaves
    again = np.zeros(trees.n_leaves, bool)
    again[leaves] = True
    again &= np.bincount(homes, minlength=trees.n_leaves) > 1
    children = trees.nodes[:, 2].astype(np.int64)
    inner = np.flatnonzero(children >= 0)
    parents = np.full(len(children), -1)
    parents[children[inner]] = parents[children[inner] + 1] = inner
    owners = np.full(len(children), -1)
    outer = np.flatnonzero(children < 0)
    own = homes[-1 - children[outer]]
    owners[outer] = np.where(again[own], own, -1)
    while True:  # upwards, while both sides are of one home
        left = owners[children[inner]]
        found = (left >= 0) & (left == owners[children[inner] + 1]) & (owners[inner] < 0)
        if not found.any():
            break
        owners[inner[found]] = left[found]
    above = np.where(parents >= 0, owners[parents], -1)
    gone = (owners >= 0) & (above == owners)
    nodes = trees.nodes.copy()
    tops = np.flatnonzero((owners >= 0) & ~gone)
    nodes[tops] = 0
    nodes[tops, 2] = -1 - owners[tops]
    shifted = np.cumsum(~gone) - 1
    inner = np.flatnonzero(nodes[:, 2] >= 0)
    nodes[inner, 2] = shifted[nodes[inner, 2]]
    return replace(trees, nodes=np.ascontiguousarray(nodes[~gone]), roots=shifted[trees.roots])


def replace_leaves(trees: Trees, subtrees: Sequence[Subtree], n_classes: int) -> Trees:
    """The trees with subtrees in the place of some of their leaves.

    Old nodes keep their tests and their order. The first leaf of a subtree takes the number of the leaf that it
    replaces, the others numbers that ``collapse_leaves`` left of the same home, or else numbers behind all leaves; so a
    clip in any other leaf stays where it is.

    Parameters
    ----------
    trees : whose leaf classes are numbered as in the subtrees.
    subtrees : of different leaves of the training.
    n_classes : C of the new trees.
    """
    old = trees.nodes[:, 2]
    node_of_leaf = np.full(trees.n_leaves, -1, np.int64)
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
    numbers, homes, unused = _number_leaves(trees, subtrees, node_of_leaf)
    for one, own, tree in zip(subtrees, numbers, home, strict=True):
        moved = one.nodes.copy()
        children = one.nodes[:, 2]
        # The subtree's root takes the place of the leaf, so its other nodes begin one earlier.
        moved[:, 2] = np.where(children < 0, -1 - own[-1 - np.minimum(children, -1)], children + free[tree] - 1)
        nodes[place[node_of_leaf[one.leaf]]] = moved[0]
        nodes[free[tree] : free[tree] + len(moved) - 1] = moved[1:]
        free[tree] += len(moved) - 1
    entries = _replace_entries(trees, subtrees, numbers, unused, len(homes))
    sizes = trees.n_features, trees.n_frames, n_classes
    return Trees(nodes, trees.roots + shifts[:-1], *entries, *sizes, homes, trees.pooled)


def _number_leaves(
    trees: Trees, subtrees: Sequence[Subtree], node_of_leaf: IntArray
) -> tuple[list[IntArray], NDArray[np.int32], list[int]]:
    """The numbers of the leaves of each subtree, the homes of all leaves then, and leaves that nothing leads to."""
    homes = trees.home_leaves
    spare: dict[int, list[int]] = {}
    for leaf in np.flatnonzero(node_of_leaf < 0):
        spare.setdefault(int(homes[leaf]), []).append(int(leaf))
    numbers, more, n_leaves = [], [homes], trees.n_leaves
    for one in subtrees:
        free = spare.pop(one.leaf, [])
        own = [one.leaf, *free[: one.n_leaves - 1]]
        spare[one.leaf] = free[one.n_leaves - 1 :]
        missing = one.n_leaves - len(own)
        numbers.append(np.array([*own, *range(n_leaves, n_leaves + missing)]))
        more.append(np.full(missing, one.leaf, np.int32))
        n_leaves += missing
    return numbers, np.concatenate(more), [leaf for free in spare.values() for leaf in free]


def _replace_entries(
    trees: Trees, subtrees: Sequence[Subtree], numbers: Sequence[IntArray], unused: Sequence[int], n_leaves: int
) -> tuple[IntArray, NDArray[np.int32], NDArray[np.int32]]:
    """Starts, classes and counts of all leaves in the order of their numbers."""
    starts = trees.leaf_starts
    begins, stops = np.zeros((2, n_leaves), np.int64)
    begins[: trees.n_leaves], stops[: trees.n_leaves] = starts[:-1], starts[1:]
    classes, counts = [trees.leaf_classes], [trees.leaf_counts]
    end = int(starts[-1])
    for one, own in zip(subtrees, numbers, strict=True):
        ends = one.leaf_starts + end
        begins[own], stops[own] = ends[:-1], ends[1:]
        classes.append(one.leaf_classes)
        counts.append(one.leaf_counts)
        end = int(ends[-1])
    classes.append(np.zeros(1, np.int32))
    counts.append(np.zeros(1, np.int32))
    begins[unused], stops[unused] = end, end + 1
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
    keys : (N,) uint64, that stand for the contents of the clips; their places by default, and then the forest depends
        on the order in which clips are added. Read for some clips only.
    later : (N,) whether each was taken up after the training; by default none was.
    names : where there are some, the categories are places in it.
    """

    categories: ArrayLike
    leaves: NDArray[np.integer[Any]] | StandingLeaves
    read_features: FeatureReader
    keys: Keys | None = None
    later: BoolArray | None = None
    names: ArrayLike | None = None


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
    changed : (L,) the leaves of the old forest from which any clip, also one that the forest was not taught, may have
        come into others.
    """

    forest: MotionForest
    leaves: IntArray
    moved: IntArray
    moved_leaves: IntArray
    changed: BoolArray


def grow_forest(
    forest: MotionForest,
    standing: StandingClips,
    features: ArrayLike,
    categories: ArrayLike,
    *,
    keys: NDArray[np.uint64] | None = None,
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
    keys : (M,) as those of the standing clips.
    feature_set : that of ``MotionForest.fit``.
    random_state : seed; the same seed and clips give the same forest but for the numbers of its leaves, however many
        are added at a time.

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
    labels, (known, numbers) = _read_labels(categories), _number_labels(standing)
    there = StandingLeaves.of(standing.leaves, forest.trees_.n_leaves)
    if len(numbers) != len(there) or there.n_trees != leaves.shape[1]:
        shape = (len(there), there.n_trees)
        raise InvalidMotionError("growth.leaves", clips=len(numbers), trees=leaves.shape[1], shape=shape)
    if not len(leaves):
        nothing = np.zeros(forest.trees_.n_leaves, bool)
        return Growth(forest, leaves, np.zeros(0, np.int64), leaves[:0], nothing)
    if labels.shape != (len(leaves),) or labels.dtype.kind != forest.classes_.dtype.kind:
        kind = forest.classes_.dtype
        raise TrainingError("growth.labels", kind=kind, clips=len(leaves), found=labels.dtype, shape=labels.shape)
    if not np.isin(known[np.unique(numbers)], forest.classes_).all():
        raise TrainingError("growth.categories")
    classes = np.unique(np.concatenate([forest.classes_, labels]))
    stand = np.searchsorted(classes, known.astype(classes.dtype))[numbers]
    own = np.concatenate([stand, np.searchsorted(classes, labels.astype(classes.dtype))]).astype(np.int32)
    material = _gather(forest, standing, there, (check_features(features), leaves, keys), own)
    grown, growing, reached = _grow(forest, material, classes, feature_set, random_state)
    moved, moved_leaves = _move(forest, material, *reached)
    home = forest.trees_.home_leaves
    changed = growing[home] | (material.touched[home] & (home != np.arange(len(home))))
    return Growth(grown, grown.apply(features), moved, moved_leaves, changed)


@dataclass(frozen=True, slots=True, eq=False)
class _Material:
    """Standing clips, then the new ones, then the points between clips, all numbered through.

    Parameters
    ----------
    leaves : (N, n_trees) in which the standing ones are.
    features : (M + P, T, F) of what does not stand.
    homes : (M + P, n_trees) leaves of the training that it reaches.
    own : (N + M + P,) number of each one's category.
    later : (N + M + P,) whether it came after the training.
    keys : of the contents of all N + M + P.
    touched : (L,) whether a leaf of the training must be looked at: something has come, or a point has gone.
    """

    standing: StandingClips
    leaves: StandingLeaves
    features: FloatArray
    homes: NDArray[np.int32]
    own: NDArray[np.int32]
    later: BoolArray
    keys: Keys
    touched: BoolArray

    @property
    def n_standing(self) -> int:
        """N."""
        return len(self.own) - len(self.homes)

    def read(self, rows: IntArray) -> FloatArray:
        """Features of any of them."""
        known = rows < self.n_standing
        n_cells, n_columns = self.features.shape[1:]  # in the order in which trees read them
        read = np.empty((len(rows), n_columns, n_cells), self.features.dtype).transpose(0, 2, 1)
        there = np.flatnonzero(known)
        for first in range(0, len(there), _AT_ONCE):  # so that they are in memory once
            some = there[first : first + _AT_ONCE]
            read[some] = self.standing.read_features(rows[some])
        read[~known] = self.features[rows[~known] - self.n_standing]
        return read


def _read_labels(categories: ArrayLike) -> NDArray[Any]:
    labels = np.asarray(categories)
    return labels.astype(np.str_) if labels.dtype == object else labels


def _number_labels(standing: StandingClips) -> tuple[NDArray[Any], IntArray]:
    """Categories, and (N,) which of them each clip has."""
    if standing.names is not None:
        return _read_labels(standing.names), np.asarray(standing.categories, np.int64)
    known, numbers = np.unique(_read_labels(standing.categories), return_inverse=True)
    return known, numbers


class _JoinedKeys:
    """Keys of the standing clips, and behind them those of others."""

    def __init__(self, standing: Keys, count: int, others: NDArray[np.uint64]) -> None:
        self._standing, self._count, self._others = standing, count, others

    def __getitem__(self, places: IntArray) -> NDArray[np.uint64]:
        keys = np.empty(len(places), np.uint64)
        stand = places < self._count
        if stand.any():
            keys[stand] = self._standing[places[stand]]
        keys[~stand] = self._others[places[~stand] - self._count]
        return keys

    def join(self, more: NDArray[np.uint64]) -> _JoinedKeys:
        """With some more behind them."""
        return _JoinedKeys(self._standing, self._count, np.concatenate([self._others, more]))


def _gather(
    forest: MotionForest,
    standing: StandingClips,
    there: StandingLeaves,
    new: tuple[FloatArray, IntArray, NDArray[np.uint64] | None],
    own: NDArray[np.int32],
) -> _Material:
    """What there is to grow from; ``new`` are features (M, T, F), leaves and keys."""
    features, leaves, new_keys = new
    count, total = len(own) - len(features), len(own)
    plain = np.arange(total, dtype=np.uint64)
    keys = _JoinedKeys(plain, count, plain[count:])
    if standing.keys is not None and new_keys is not None:
        keys = _JoinedKeys(standing.keys, count, new_keys)
    later = np.arange(total) >= count
    if standing.later is not None:
        later[:count] = standing.later
    homes = forest.trees_.home_leaves
    here = homes[leaves]
    touched = np.zeros(forest.trees_.n_leaves, bool)
    touched[here] = True
    usual = _count_usual(own, later)
    before = choose_pairs(own[:count], keys, later[:count], usual)
    after = choose_pairs(own, keys, later, usual)
    material = _Material(standing, there, features, here, own, later, keys, touched)
    coming, going = after.without(before), before.without(after)
    points, point_homes = _make_points(forest, material, after)
    touched[point_homes[coming]] = True
    touched[_make_points(forest, material, before.take(going))[1]] = True
    return _Material(
        standing,
        there,
        np.concatenate([features, points]),
        np.concatenate([here, point_homes]),
        np.concatenate([own, own[after.first]]),
        np.append(later, np.ones(len(points), np.bool_)),
        keys.join(after.keys),
        touched,
    )


def _count_usual(own: NDArray[np.int32], later: BoolArray) -> int:
    """Clips of a category in the training, in the middle of all categories."""
    sizes = np.bincount(own[~later])
    return int(np.median(sizes[sizes > 0])) if (~later).any() else 0


def _make_points(forest: MotionForest, material: _Material, pairs: Pairs) -> tuple[FloatArray, NDArray[np.int32]]:
    """Features (P, T, F) half way between pairs of clips, and the leaves of the training (P, n_trees) they reach."""
    rows, places = np.unique(np.concatenate([pairs.first, pairs.second]), return_inverse=True)
    ends = material.read(rows)
    points = ends[places[: len(pairs.first)]]
    points += ends[places[len(pairs.first) :]]
    points *= 0.5
    return points, forest.trees_.home_leaves[forest.apply(points)]


def _grow(
    forest: MotionForest,
    material: _Material,
    classes: NDArray[Any],
    feature_set: FeatureSet | None,
    random_state: int,
) -> tuple[MotionForest, BoolArray, tuple[IntArray, NDArray[np.int32]]]:
    """The grown forest, which leaves of the training became trees now, and the clips of these with their leaves."""
    trees = _renumber(forest, classes)
    numbers = np.flatnonzero(material.touched)
    counts, strangers = _count_members(material, trees, numbers, len(classes))
    sizes = counts.sum(axis=1)
    grows = (strangers > 0) & (strangers * _MOST_OTHERS >= sizes)
    stumps = [_make_stump(int(leaf), row) for leaf, row in zip(numbers[~grows], counts[~grows], strict=True)]
    growing = np.zeros(trees.n_leaves, bool)
    growing[numbers[grows]] = True
    clips, leaves = _list_members(material, trees, growing)
    rows, places = np.unique(clips, return_inverse=True)
    order = np.lexsort((material.keys[rows][places], leaves))  # keys may be read: of each clip once
    parts = np.split(clips[order], np.cumsum(sizes[grows])[:-1]) if grows.any() else []
    drawn = [_draw(part, material.own[part]) for part in parts]
    known = np.unique(np.concatenate([np.zeros(0, np.int64), *drawn]))
    features = material.read(known)
    tests = list_tests(trees.n_features, trees.n_frames) if feature_set is None else feature_set.tests
    subtrees = grow_subtrees(
        features,
        material.own[known],
        len(classes),
        tests,
        forest.make_spec(len(tests)),
        [(int(leaf), np.searchsorted(known, some)) for leaf, some in zip(numbers[grows], drawn, strict=True)],
        mix(numbers[grows].astype(np.uint64), np.full(1, random_state, np.uint64)),
    )
    subtrees = sorted(stumps + subtrees, key=lambda one: one.leaf)
    plain = collapse_leaves(trees, numbers)
    grown = forest.with_trees(replace_leaves(plain, subtrees, len(classes)), classes)
    now = _look_up(grown, material, rows, (known, features))
    large = np.isin(leaves, numbers[grows][sizes[grows] > _MOST_DRAWN])
    if large.any():
        there = now[places[large], _tree_of_leaves(trees)[leaves[large]]].astype(np.int64)
        keys, found = np.unique(there * len(classes) + material.own[clips[large]], return_counts=True)
        grown = forest.with_trees(put_counts(grown.trees_, keys, found), classes)
    return grown, growing, (rows, now)


def _draw(members: IntArray, categories: NDArray[np.int32]) -> IntArray:
    """The members of a leaf that it grows from, in the order in which they were given: of each category as many."""
    if len(members) <= _MOST_DRAWN:
        return members
    order = np.argsort(categories, kind="stable")
    counts = np.bincount(categories)
    rank = np.empty(len(members), np.int64)
    rank[order] = np.arange(len(members)) - np.repeat(np.cumsum(counts) - counts, counts)
    return members[np.sort(np.argsort(rank, kind="stable")[:_MOST_DRAWN])]


def _look_up(
    grown: MotionForest, material: _Material, rows: IntArray, known: tuple[IntArray, FloatArray]
) -> NDArray[np.int32]:
    """(n, n_trees) the leaves of some rows, ascending, of which some were read already, with their features."""
    numbers, features = known
    leaves = np.empty((len(rows), material.leaves.n_trees), np.int32)
    is_known = np.isin(rows, numbers)
    there = np.flatnonzero(is_known)
    for first in range(0, len(there), _AT_ONCE):
        leaves[there[first : first + _AT_ONCE]] = grown.apply(features[first : min(first + _AT_ONCE, len(there))])
    others = np.flatnonzero(~is_known)
    for first in range(0, len(others), _AT_ONCE):
        some = others[first : first + _AT_ONCE]
        leaves[some] = grown.apply(material.read(rows[some]))
    return leaves


def _tree_of_leaves(trees: Trees) -> IntArray:
    """(L,) the tree of each leaf that something leads to."""
    children = trees.nodes[:, 2]
    outer = np.flatnonzero(children < 0)
    owners = np.zeros(trees.n_leaves, np.int64)
    owners[-1 - children[outer]] = np.searchsorted(trees.roots, outer, side="right") - 1
    return owners


def _make_stump(leaf: int, counts: IntArray) -> Subtree:
    """A leaf that stays one, with so many clips of each category."""
    classes = np.flatnonzero(counts).astype(np.int32)
    node = np.array([[0, 0, -1, 0, 0, 0]], np.int32)
    return Subtree(leaf, node, np.array([0, len(classes)]), classes, counts[classes].astype(np.int32))


def _renumber(forest: MotionForest, classes: NDArray[Any]) -> Trees:
    """The trees of a forest with its categories numbered among all categories."""
    numbers = np.searchsorted(classes, forest.classes_).astype(np.int32)
    own = numbers[forest.trees_.leaf_classes]
    return replace(forest.trees_, leaf_classes=own, n_classes=len(classes))


def _count_members(material: _Material, trees: Trees, numbers: IntArray, n_classes: int) -> tuple[IntArray, IntArray]:
    """(K, C), what stands in K leaves of the training; and (K,) the strangers among it.

    These came after the training, and are not of the most frequent category of those that were there.
    """
    ranks = np.full(trees.n_leaves, -1)
    ranks[numbers] = np.arange(len(numbers))
    own = (material.own + n_classes * material.later).astype(np.int32)
    both = material.leaves.count(ranks[trees.home_leaves], own, 2 * n_classes)
    there = ranks[material.homes]
    clips, columns = np.nonzero(there >= 0)
    np.add.at(both, (there[clips, columns], own[material.n_standing + clips]), 1)
    trained, later = both[:, :n_classes], both[:, n_classes:]
    counts = trained + later
    usual = np.where(trained.any(axis=1), trained.argmax(axis=1), counts.argmax(axis=1))
    return counts, later.sum(axis=1) - later[np.arange(len(numbers)), usual]


def _list_members(material: _Material, trees: Trees, growing: BoolArray) -> tuple[IntArray, IntArray]:
    """Everything that stands in some leaves of the training, and in which."""
    homes = trees.home_leaves
    clips, leaves = material.leaves.list(growing[homes])
    new, columns = np.nonzero(growing[material.homes])
    others = material.homes[new, columns].astype(np.int64)
    return np.concatenate([clips, material.n_standing + new]), np.concatenate([homes[leaves], others])


def _move(
    before: MotionForest, material: _Material, rows: IntArray, now: NDArray[np.int32]
) -> tuple[IntArray, IntArray]:
    """Places of the standing clips that are in other leaves now, and their leaves.

    Parameters
    ----------
    rows, now : all that stand in a leaf that became a tree, ascending, and their leaves (n, n_trees).
    """
    standing, trees = material.leaves, before.trees_
    count = np.searchsorted(rows, material.n_standing)
    rows, now = rows[:count], now[:count]
    # In a leaf that had grown, and is one again, are clips whose features were not read: they need none.
    home = trees.home_leaves
    back = material.touched[home] & (home != np.arange(trees.n_leaves))
    found = standing.find(back) if back.any() else np.zeros(0, np.int64)
    others = np.setdiff1d(found, rows)
    plain = standing.take(others)
    plain = np.where(back[plain], home[plain], plain)
    everyone, leaves = np.concatenate([rows, others]), np.concatenate([now, plain])
    changed = (leaves != standing.take(everyone)).any(axis=1)
    order = np.argsort(everyone[changed], kind="stable")
    return everyone[changed][order], leaves[changed][order].astype(np.int64)
