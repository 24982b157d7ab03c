"""New categories without training again: the leaves of a forest take up new clips, and grow where they must.

New clips run down the trees. Where one arrives in a leaf of another category, the leaf becomes a small tree, grown by
the forest's own rule from all the clips that stand in it; the splits above stay as they are. So what the forest has
learned is kept, and the work is that of a few leaves.

A category of few clips is met by few leaves only, and a query falls between them. So while a category that receives
clips is smaller than half of the others are, points half way between two of its clips stand beside them (as in SMOTE:
Chawla et al., Journal of Artificial Intelligence Research 16, 2002): features are means over cells of time, and so is
the mean of two of them. These points live in the counts of the leaves only.

What becomes of a leaf of the training follows from the clips that stand in it and from nothing else: not from their
order, nor from what stood in it before (``Trees.homes`` says which leaf of the training each leaf grew from; a leaf
that is met again is grown anew, and one from which all points have gone is as the training left it). So the same clips
give the same forest, in whatever portions they were added.

In a large library a leaf has hundreds of clips, and where each tree grew from a sample, of several categories. So what
growing costs is bounded: a leaf grows only when the strangers that came after the training are a 64th of it (one among
hundreds is the mistake of a tree, and to part it from them, all of them would have to be looked at), it grows from a
sample of its clips where these are many, and the others are read in portions, to see where they stand then.

Of a library so large that its trees grow from samples not even that is read. Each leaf of the training has a few of its
clips as examples (``leaves.examples``). It grows where strangers, which are then clips of categories that are less than
a 64th of what the training left in it, are a 64th of it; and what grows parts these from the examples. The clips of the
training stay in the leaf, which keeps its number and its counts, whatever nodes lead to it: none of them is read, and
none moves. Nor does a leaf vote otherwise for a clip more among hundreds: those that came later count in it where they
are a 64th of it, so that most clips of the library keep their votes.
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
from dousa.retrieval.forest.subtrees import (
    collapse_leaves,
    grow_subtrees,
    make_stump,
    part_strangers,
    replace_leaves,
)
from dousa.retrieval.forest.trees import LeafEntries, Trees, put_counts

_AT_ONCE = 4096  # clips whose features are read
_MOST_OTHERS = 64  # a leaf grows where this many times the strangers in it are all of its clips, or more
_MOST_SILENT = 256  # clips that came later count beside examples where this many times they are all clips of the leaf
_MOST_DRAWN = 256  # clips that a leaf grows from


FeatureReader = Callable[[IntArray], FloatArray]

Examples = Callable[[IntArray], IntArray]
"""Gives the places (n, E) of examples of some leaves of the training (n,), -1 where one has fewer."""


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
    examples : of each leaf a few clips of the training; the others are not read then, and stay where they are.
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
    stay : (L,) the leaf in which clips of the training are that were in each of the old forest; None where these are
        looked up as all others are.
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
    stay = None
    if standing.examples is not None:
        stay = np.where(material.touched[home], home, np.arange(len(home), dtype=np.int32))
    return Growth(grown, grown.apply(features), moved, moved_leaves, changed, stay)


def find_changed(before: MotionForest, now: MotionForest) -> BoolArray:
    """(L,) which leaves of a forest that has grown vote otherwise than before, or were not there.

    Parameters
    ----------
    before, now : of categories that are among those of the other.
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

    @property
    def moving(self) -> StandingLeaves:
        """Leaves of the standing clips that go where the nodes lead them."""
        return self.leaves if self.standing.examples is None else self.leaves.among(self.later[: self.n_standing])

    def find_examples(self, leaves: IntArray) -> list[IntArray]:
        """Those of some leaves of the training; none where all that stands in them is read."""
        if self.standing.examples is None or not len(leaves):
            return [np.zeros(0, np.int64)] * len(leaves)
        return [some[some >= 0] for some in self.standing.examples(leaves)]

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


@dataclass(frozen=True, slots=True, eq=False)
class _Touched:
    """Leaves of the training to which something has come, or from which a point has gone.

    Parameters
    ----------
    numbers : (K,) which, ascending.
    counts, stayed : (K, C) what counts in them, and what of it never moves.
    known : (K, C) categories that are no strangers there.
    usual : (K,) the category of most clips of the training.
    grows : (K,) whether strangers are many enough.
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
    """The grown forest, which leaves of the training became trees now, and the clips of these with their leaves."""
    trees = _renumber(forest, classes)
    touched = _look_at_leaves(material, trees, len(classes))
    chosen = touched.numbers[touched.grows]
    growing = np.zeros(trees.n_leaves, bool)
    growing[chosen] = True
    clips, leaves = _list_members(material, trees, growing)
    rows, places = np.unique(clips, return_inverse=True)
    order = np.lexsort((material.keys[rows][places], leaves))  # keys may be read: of each clip once
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
    """Categories by which the clips that leaves grow from are parted."""
    own = [material.own[some] for some in drawn]
    if material.standing.examples is None:
        return own
    # Whatever is no stranger is one there: it has its share of the vote already.
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
    """The same forest with all clips in the leaves that grew from some.

    Parameters
    ----------
    members : clips and the leaves in which they stood.
    now : (M, n_trees) where these are.
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
        some = there[first : first + _AT_ONCE]
        leaves[some] = grown.apply(features[np.searchsorted(numbers, rows[some])])
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


def _renumber(forest: MotionForest, classes: NDArray[Any]) -> Trees:
    """The trees of a forest with its categories numbered among all, and with what the training left in its leaves."""
    numbers = np.searchsorted(classes, forest.classes_).astype(np.int32)
    own, trees = numbers[forest.trees_.leaf_classes], forest.trees_
    trained = trees.trained
    if trained is not None:
        trained = trained._replace(classes=numbers[trained.classes])
    elif trees.homes is None and not trees.pooled:
        trained = LeafEntries(trees.leaf_starts, own, trees.leaf_counts)
    return replace(trees, leaf_classes=own, n_classes=len(classes), trained=trained)


def _look_at_leaves(material: _Material, trees: Trees, n_classes: int) -> _Touched:
    """What stands in the leaves of the training that are touched, and which of them grow.

    Strangers came after the training, and are not of the most frequent category of those that were there; where that is
    told by examples, of none that is a ``_MOST_OTHERS``th of these. There a leaf votes as the training left it until
    as many of its clips came later.
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
    if trees.trained is not None:  # disturbed copies, too, which stand nowhere
        for row in np.flatnonzero(~later.any(axis=1)):
            counts[row] = trees.trained.of(int(numbers[row]), n_classes)
    return _Touched(numbers, counts, trained if by_examples else np.zeros_like(trained), known, usual, grows)


def _list_members(material: _Material, trees: Trees, growing: BoolArray) -> tuple[IntArray, IntArray]:
    """What stands in some leaves of the training and is no clip that stays there, and in which."""
    homes = trees.home_leaves
    clips, leaves = material.moving.list(growing[homes])
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
