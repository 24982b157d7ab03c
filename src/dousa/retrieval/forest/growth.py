"""New categories without training again: the leaves of a forest take up new clips, and grow where they must.

A leaf that receives clips of another category becomes a small tree, grown by the forest's own rule from the clips in
it; the splits above stay. Growing categories below the median size also get points half way between two of
their clips (as in SMOTE: Chawla et al., Journal of Artificial Intelligence Research 16, 2002), which are counted in the
leaves only. A leaf of the training (``Trees.homes``) depends only on the clips in it, so the same clips give the same
forest, in any order and portions.

The cost is bounded: a leaf grows only where strangers from after the training are at least a 64th of its clips, and
from a sample of at most ``_MOST_DRAWN`` clips. In a very large library only a few examples of each leaf are read
(``examples``); the other clips of the training stay in the leaf, and later clips count there only from a share of 1 in
``_MOST_SILENT``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dousa.arrays import BoolArray, FloatArray, IntArray
from dousa.errors import InvalidMotionError, TrainingError
from dousa.retrieval.features.feature_sets import FeatureSet, list_tests
from dousa.retrieval.forest.forest import MotionForest, check_features
from dousa.retrieval.forest.standing_leaves import Keys, Pairs, StandingLeaves, choose_pairs, mix
from dousa.retrieval.forest.trees import (
    LeafEntries,
    Trees,
    collapse_leaves,
    grow_subtrees,
    make_stump,
    part_strangers,
    put_counts,
    replace_leaves,
)

_AT_ONCE = 4096  # clips whose features are read in one step; memory alone depends on it, by definition
_MOST_OTHERS = 64  # a leaf grows where this many times its strangers are at least all its clips (docs/retrieval.md)
_MOST_SILENT = 256  # later clips count beside examples where this many times their number is all (lab/notes/scaling.md)
_MOST_DRAWN = 256  # clips that a leaf grows from (docs/retrieval.md)


FeatureReader = Callable[[IntArray], FloatArray]

Examples = Callable[[IntArray], IntArray]
"""Returns the places (n, E) of examples of leaves (n,) of the training, -1 where a leaf has fewer."""


@dataclass(frozen=True, slots=True, eq=False)
class StandingClips:
    """The clips that a forest was trained with or has taken up since.

    Parameters
    ----------
    categories : (N,) words or whole numbers.
    leaves : (N, n_trees) of ``apply``.
    read_features : returns the features (n, T, F) of clips by their places (n,); called only for clips of growing
        leaves.
    keys : (N,) uint64 keys of the clips' contents, read for some clips only; their places by default, and then the
        forest depends on the order in which clips are added.
    later : (N,) whether each came after the training; by default none did.
    names : if given, the categories are places in it.
    examples : a few training clips of each leaf; the others are then not read, and stay where they are.
    """

    categories: ArrayLike
    leaves: NDArray[np.integer[Any]] | StandingLeaves
    read_features: FeatureReader
    keys: Keys | None = None
    later: BoolArray | None = None
    names: ArrayLike | None = None
    examples: Examples | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Growth:
    """The result of growing a forest.

    Parameters
    ----------
    forest : the new one; the old one stays as it was.
    leaves : (M, n_trees) of the new clips.
    moved : (K,) places of the standing clips that are now in other leaves.
    moved_leaves : (K, n_trees) their leaves, for ``forest.histograms_of``. With new categories, the histograms of all
        clips gain columns.
    changed : (L,) the leaves of the old forest that any clip may have left.
    stay : (L,) the new leaf of training clips in each old leaf; None where these are looked up as all others are.
    """

    forest: MotionForest
    leaves: IntArray
    moved: IntArray
    moved_leaves: IntArray
    changed: BoolArray
    stay: NDArray[np.int32] | None = None


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
    standing : all clips that it has taken up.
    features : (M, T, F) of the new clips; without any, the forest is unchanged.
    categories : (M,) of the new clips.
    keys : (M,) as those of the standing clips.
    feature_set : that of ``MotionForest.fit``.
    random_state : seed; one seed and set of clips give one forest, but for the numbers of its leaves, in any portions.

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
    stay = None
    if standing.examples is not None:
        stay = np.where(material.touched[home], home, np.arange(len(home), dtype=np.int32))
    return Growth(grown, grown.apply(features), moved, moved_leaves, changed, stay)


def find_changed(before: MotionForest, now: MotionForest) -> BoolArray:
    """Return (L,) which leaves of the grown forest ``now``, with all categories of ``before``, are new or vote
    differently.
    """
    starts, classes, weights = before.vote_entries
    new_starts, new_classes, new_weights = now.vote_entries
    lengths, new_lengths = np.diff(starts), np.diff(new_starts)
    changed = np.ones(len(new_lengths), np.bool_)
    same = np.flatnonzero(lengths == new_lengths[: len(lengths)])
    changed[same] = False
    own = lengths[same]
    inside = np.arange(int(own.sum())) - np.repeat(np.cumsum(own) - own, own)
    old, new = (np.repeat(some[:-1][same], own) + inside for some in (starts, new_starts))
    numbers = np.searchsorted(now.classes_, before.classes_)
    differ = (numbers[classes[old]] != new_classes[new]) | (weights[old] != new_weights[new])
    changed[np.repeat(same, own)[differ]] = True
    return changed


@dataclass(frozen=True, slots=True, eq=False)
class _Material:
    """Standing clips, then the new ones, then the points between clips, numbered through.

    leaves : (N, n_trees) of the standing clips.
    features : (M + P, T, F) of new clips and points.
    homes : (M + P, n_trees) leaves of the training that these reach.
    own : (N + M + P,) category numbers.
    later : (N + M + P,) whether each came after the training.
    keys : of the contents of all N + M + P.
    touched : (L,) whether a leaf of the training has received a clip or point, or lost a point.
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
        return len(self.own) - len(self.homes)

    @property
    def moving(self) -> StandingLeaves:
        """Return the leaves of the standing clips that follow the nodes."""
        return self.leaves if self.standing.examples is None else self.leaves.among(self.later[: self.n_standing])

    def find_examples(self, leaves: IntArray) -> list[IntArray]:
        """Return the examples of some leaves of the training; none where all clips are read."""
        if self.standing.examples is None or not len(leaves):
            return [np.zeros(0, np.int64)] * len(leaves)
        return [some[some >= 0] for some in self.standing.examples(leaves)]

    def read(self, rows: IntArray) -> FloatArray:
        known = rows < self.n_standing
        n_cells, n_columns = self.features.shape[1:]  # ordered as by ``order_for_trees``
        read = np.empty((len(rows), n_columns, n_cells), self.features.dtype).transpose(0, 2, 1)
        there = np.flatnonzero(known)
        for first in range(0, len(there), _AT_ONCE):  # no second copy of all
            some = there[first : first + _AT_ONCE]
            read[some] = self.standing.read_features(rows[some])
        read[~known] = self.features[rows[~known] - self.n_standing]
        return read


def _read_labels(categories: ArrayLike) -> NDArray[Any]:
    labels = np.asarray(categories)
    return labels.astype(np.str_) if labels.dtype == object else labels


def _number_labels(standing: StandingClips) -> tuple[NDArray[Any], IntArray]:
    """Return the categories, and (N,) the number of each clip's."""
    if standing.names is not None:
        return _read_labels(standing.names), np.asarray(standing.categories, np.int64)
    known, numbers = np.unique(_read_labels(standing.categories), return_inverse=True)
    return known, numbers


class _JoinedKeys:
    """Keys of the standing clips, followed by those of others."""

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
        return _JoinedKeys(self._standing, self._count, np.concatenate([self._others, more]))


def _gather(
    forest: MotionForest,
    standing: StandingClips,
    there: StandingLeaves,
    new: tuple[FloatArray, IntArray, NDArray[np.uint64] | None],
    own: NDArray[np.int32],
) -> _Material:
    """Gather the material of growing; ``new`` are features (M, T, F), leaves and keys."""
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
    """Return the median size of a category in the training."""
    sizes = np.bincount(own[~later])
    return int(np.median(sizes[sizes > 0])) if (~later).any() else 0


def _make_points(forest: MotionForest, material: _Material, pairs: Pairs) -> tuple[FloatArray, NDArray[np.int32]]:
    """Return features (P, T, F) half way between pairs of clips, and their leaves of the training (P, n_trees)."""
    rows, places = np.unique(np.concatenate([pairs.first, pairs.second]), return_inverse=True)
    ends = material.read(rows)
    points = ends[places[: len(pairs.first)]]
    points += ends[places[len(pairs.first) :]]
    points *= 0.5
    return points, forest.trees_.home_leaves[forest.apply(points)]


@dataclass(frozen=True, slots=True, eq=False)
class _Touched:
    """Leaves of the training that have received a clip or point, or lost a point.

    numbers : (K,) leaf numbers, ascending.
    counts, stayed : (K, C) clips counted in them, and those of them that never move.
    known : (K, C) categories that are no strangers there.
    usual : (K,) the category of most clips of the training.
    grows : (K,) whether there are enough strangers.
    """

    numbers: IntArray
    counts: IntArray
    stayed: IntArray
    known: BoolArray
    usual: IntArray
    grows: BoolArray


def _grow(
    forest: MotionForest,
    material: _Material,
    classes: NDArray[Any],
    feature_set: FeatureSet | None,
    random_state: int,
) -> tuple[MotionForest, BoolArray, tuple[IntArray, NDArray[np.int32]]]:
    """Return the grown forest, which leaves of the training became trees, and the clips of these with their leaves."""
    trees = _renumber(forest, classes)
    touched = _look_at_leaves(material, trees, len(classes))
    chosen = touched.numbers[touched.grows]
    growing = np.zeros(trees.n_leaves, bool)
    growing[chosen] = True
    clips, leaves = _list_members(material, trees, growing)
    rows, places = np.unique(clips, return_inverse=True)
    order = np.lexsort((material.keys[rows][places], leaves))  # each clip's key is read once
    parts = np.split(clips[order], np.searchsorted(leaves[order], chosen[1:])) if len(chosen) else []
    shown = material.find_examples(chosen)
    drawn = [np.concatenate([few, _draw(part, material.own[part])]) for few, part in zip(shown, parts, strict=True)]
    known = np.unique(np.concatenate([np.zeros(0, np.int64), *drawn]))
    features = material.read(known)
    tests = list_tests(trees.n_features, trees.n_frames) if feature_set is None else feature_set.tests
    subtrees = grow_subtrees(
        features,
        len(classes),
        tests,
        forest.make_spec(len(tests)),
        [
            (int(leaf), np.searchsorted(known, some), own)
            for leaf, some, own in zip(chosen, drawn, _name_clips(material, touched, drawn), strict=True)
        ],
        mix(chosen.astype(np.uint64), np.full(1, random_state, np.uint64)),
    )
    if material.standing.examples is not None:
        usual = touched.usual[touched.grows].tolist()
        subtrees = [part_strangers(one, most) for one, most in zip(subtrees, usual, strict=True)]
    others = zip(touched.numbers[~touched.grows], touched.counts[~touched.grows], strict=True)
    subtrees = sorted([make_stump(int(leaf), row) for leaf, row in others] + subtrees, key=lambda one: one.leaf)
    plain = collapse_leaves(trees, touched.numbers)
    grown = forest.with_trees(replace_leaves(plain, subtrees, len(classes)), classes)
    now = _look_up(grown, material, rows, (known, features))
    return _count_again(grown, material, touched, (clips, leaves), now[places]), growing, (rows, now)


def _name_clips(material: _Material, touched: _Touched, drawn: list[IntArray]) -> list[NDArray[np.int32]]:
    """Return the categories by which the clips of growing leaves are separated."""
    own = [material.own[some] for some in drawn]
    if material.standing.examples is None:
        return own
    # All clips that are no strangers count as one category: they have their share of the vote already.
    leaves = np.flatnonzero(touched.grows)
    return [
        np.where(touched.known[leaf, some], touched.usual[leaf], some).astype(np.int32)
        for leaf, some in zip(leaves, own, strict=True)
    ]


def _count_again(
    grown: MotionForest,
    material: _Material,
    touched: _Touched,
    members: tuple[IntArray, IntArray],
    now: NDArray[np.int32],
) -> MotionForest:
    """Count all clips in the leaves that grew from a sample.

    members : clips, and the leaves in which they stood.
    now : (M, n_trees) their new leaves.
    """
    trees, n_classes = grown.trees_, grown.trees_.n_classes
    clips, leaves = members
    some = touched.grows & (touched.counts.sum(axis=1) > _MOST_DRAWN)
    if material.standing.examples is not None:
        some = touched.grows
    again = np.isin(leaves, touched.numbers[some])
    if not again.any():
        return grown
    there = now[again, _tree_of_leaves(trees)[leaves[again]]].astype(np.int64)
    place, own = np.nonzero(touched.stayed * some[:, None])
    keys = np.concatenate([there * n_classes + material.own[clips[again]], touched.numbers[place] * n_classes + own])
    counts = np.concatenate([np.ones(len(there), np.int64), touched.stayed[place, own]])
    keys, places = np.unique(keys, return_inverse=True)
    found = np.bincount(places, counts).astype(np.int64)
    return grown.with_trees(put_counts(trees, keys, found), grown.classes_)


def _draw(members: IntArray, categories: NDArray[np.int32]) -> IntArray:
    """Sample the members of a leaf for growing, evenly over the categories, in the order given."""
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
    """Return (n, n_trees) the leaves of ascending rows; ``known`` are rows already read, with their features."""
    numbers, features = known
    leaves = np.empty((len(rows), material.leaves.n_trees), np.int32)
    is_known = np.isin(rows, numbers)
    for places, read in (
        (np.flatnonzero(is_known), lambda clips: features[np.searchsorted(numbers, clips)]),
        (np.flatnonzero(~is_known), material.read),
    ):
        for first in range(0, len(places), _AT_ONCE):
            some = places[first : first + _AT_ONCE]
            leaves[some] = grown.apply(read(rows[some]))
    return leaves


def _tree_of_leaves(trees: Trees) -> IntArray:
    """Return (L,) the tree of each leaf that a node leads to."""
    children = trees.nodes[:, 2]
    outer = np.flatnonzero(children < 0)
    owners = np.zeros(trees.n_leaves, np.int64)
    owners[-1 - children[outer]] = np.searchsorted(trees.roots, outer, side="right") - 1
    return owners


def _renumber(forest: MotionForest, classes: NDArray[Any]) -> Trees:
    """Return the trees with their categories numbered among all, and with the leaf entries of the training."""
    numbers = np.searchsorted(classes, forest.classes_).astype(np.int32)
    own, trees = numbers[forest.trees_.leaf_classes], forest.trees_
    trained = trees.trained
    if trained is not None:
        trained = trained._replace(classes=numbers[trained.classes])
    elif trees.homes is None and not trees.pooled:
        trained = LeafEntries(trees.leaf_starts, own, trees.leaf_counts)
    return replace(trees, leaf_classes=own, n_classes=len(classes), trained=trained)


def _look_at_leaves(material: _Material, trees: Trees, n_classes: int) -> _Touched:
    """Count the clips in the touched leaves of the training, and choose those that grow.

    Strangers came later and are not of the leaf's most frequent training category; with examples, of no category with a
    ``_MOST_OTHERS``th of the training clips. With examples, a leaf with few later clips keeps its votes.
    """
    numbers = np.flatnonzero(material.touched)
    ranks = np.full(trees.n_leaves, -1)
    ranks[numbers] = np.arange(len(numbers))
    own = (material.own + n_classes * material.later).astype(np.int32)
    both = material.leaves.count(ranks[trees.home_leaves], own, 2 * n_classes)
    there = ranks[material.homes]
    clips, columns = np.nonzero(there >= 0)
    np.add.at(both, (there[clips, columns], own[material.n_standing + clips]), 1)
    trained, later = both[:, :n_classes], both[:, n_classes:]
    counts, sizes = trained + later, both.sum(axis=1)
    usual = np.where(trained.any(axis=1), trained.argmax(axis=1), counts.argmax(axis=1))
    by_examples = material.standing.examples is not None
    known = np.zeros(counts.shape, np.bool_)
    if by_examples:
        known = (trained > 0) & (trained * _MOST_OTHERS >= trained.sum(axis=1, keepdims=True))
    known[np.arange(len(numbers)), usual] = True
    strangers = np.where(known, 0, later).sum(axis=1)
    grows = (strangers > 0) & (strangers * _MOST_OTHERS >= sizes)
    if by_examples:
        grows[grows] = [len(some) > 0 for some in material.find_examples(numbers[grows])]
        few = later.sum(axis=1) * _MOST_SILENT < sizes
        counts[few] = trained[few]
    if trees.trained is not None:  # these include disturbed copies, which are no standing clips
        for row in np.flatnonzero(~later.any(axis=1)):
            counts[row] = trees.trained.of(int(numbers[row]), n_classes)
    return _Touched(numbers, counts, trained if by_examples else np.zeros_like(trained), known, usual, grows)


def _list_members(material: _Material, trees: Trees, growing: BoolArray) -> tuple[IntArray, IntArray]:
    """List the clips in growing leaves of the training that may move, and the leaf of each."""
    homes = trees.home_leaves
    clips, leaves = material.moving.list(growing[homes])
    new, columns = np.nonzero(growing[material.homes])
    others = material.homes[new, columns].astype(np.int64)
    return np.concatenate([clips, material.n_standing + new]), np.concatenate([homes[leaves], others])


def _move(
    before: MotionForest, material: _Material, rows: IntArray, now: NDArray[np.int32]
) -> tuple[IntArray, IntArray]:
    """Return the places of the standing clips that are in other leaves now, and their leaves.

    ``rows``, ``now``: all clips in a leaf that became a tree, ascending, and their leaves (n, n_trees).
    """
    standing, trees = material.leaves, before.trees_
    count = np.searchsorted(rows, material.n_standing)
    rows, now = rows[:count], now[:count]
    # Clips of a leaf that had grown and is a single one again were not read: they go to that leaf.
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
