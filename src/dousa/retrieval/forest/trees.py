"""The trees of a forest in a few flat arrays: growing, joining, counting, and replacing leaves by small trees."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import FloatArray, IntArray
from dousa.errors import InvalidMotionError
from dousa.retrieval.forest import growing_kernels as kernels
from dousa.retrieval.forest.tree_kernels import find_leaves
from dousa.workers.current import current_cluster
from dousa.workers.threads import count_threads, map_pieces

KIND_NAMES = ("mean", "spread", "trend")
"""Names of the kinds of tests, by their numbers in the kernels."""

_SAME_VALUE = 1e-7
"""Values of a test closer than this share of the feature's largest value count as equal: by definition of IEEE 754 two
float32 next to each other differ by up to 1.2e-7 of their value."""


@dataclass(frozen=True, slots=True)
class TreesSpec:
    """How trees are grown: tests drawn at a node, bits of entropy of a leaf, bootstrap, random thresholds, workers."""

    n_trials: int
    max_entropy: float
    bootstrap: bool
    random_thresholds: bool
    n_jobs: int | None


class LeafEntries(NamedTuple):
    """Leaf entries of the training: starts (L + 1,), categories and counts."""

    starts: IntArray
    classes: NDArray[np.int32]
    counts: NDArray[np.int32]

    def of(self, leaf: int, n_classes: int) -> IntArray:
        """Return (C,) clips of each category in one leaf."""
        own = slice(int(self.starts[leaf]), int(self.starts[leaf + 1]))
        return np.bincount(self.classes[own], self.counts[own], n_classes).astype(np.int64)


@dataclass(frozen=True, slots=True, eq=False)
class Trees:
    """Trees one behind the other; ``tree_kernels`` describes the layout of a node.

    Parameters
    ----------
    nodes : (M, 6) int32.
    roots : (n_trees,) index of each tree's first node.
    leaf_starts : (L + 1,) start of the entries of each leaf.
    leaf_classes, leaf_counts : (E,) int32, category and number of training clips of each entry; an entry of 0 clips in
        an empty leaf or one without a node.
    n_features, n_frames, n_classes : F, T and C.
    homes : (L,) int32, the leaf of the training that each leaf has grown from; None where nothing has grown. The first
        leaf of each keeps its number.
    pooled : whether the leaves hold clips, of several categories, that the trees did not grow from: a tree then votes
        by the shares in its leaf.
    trained : the leaf entries of the training, where something has grown since; None where nothing has, or the leaves
        are pooled.
    only_means : whether no node tests a spread or a trend.
    """

    nodes: NDArray[np.int32]
    roots: IntArray
    leaf_starts: IntArray
    leaf_classes: NDArray[np.int32]
    leaf_counts: NDArray[np.int32]
    n_features: int
    n_frames: int
    n_classes: int
    homes: NDArray[np.int32] | None = None
    pooled: bool = False
    trained: LeafEntries | None = None
    only_means: bool = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "only_means", not self.nodes[:, 3].any())

    @property
    def cuts(self) -> FloatArray:
        """Return a (M, 3) view of the nodes; column 2 is the threshold (of a mean: times the interval's length)."""
        return self.nodes.view(np.float64)

    @property
    def n_leaves(self) -> int:
        return len(self.leaf_starts) - 1

    @property
    def home_leaves(self) -> NDArray[np.int32]:
        """Return (L,) ``homes``, also where nothing has grown."""
        return np.arange(self.n_leaves, dtype=np.int32) if self.homes is None else self.homes

    def find_leaves(self, features: FloatArray, at_once: int = 16) -> IntArray:
        """Return (N, n_trees) the leaf that each clip reaches in each tree; InvalidMotionError where it is not finite.

        ``features`` (N, T, F) of any kind and order, for which ``at_once`` clips are copied, so that they stay in the
        cache.
        """
        leaves = np.empty((len(features), len(self.roots)), np.int64)
        integral = np.zeros(self.n_features * (self.n_frames + 1))
        is_ready = features.dtype == np.float64 and features.flags.carray
        work, trees = np.empty((2, len(self.roots)), np.int64), (self.nodes, self.cuts, self.roots, self.only_means)
        for first in range(0, len(features), at_once):
            some = slice(first, first + at_once)
            pose = features[some] if is_ready else np.array(features[some], np.float64, order="C")
            bad = find_leaves(pose, *trees, integral, work, leaves[some])
            if bad >= 0:
                raise InvalidMotionError("forest.not_finite", clip=first + bad)
        return leaves

    def leaf_shares(self) -> FloatArray:
        """Return (E,) every entry's share of its leaf's clips: the leaf's histogram."""
        sizes = np.add.reduceat(self.leaf_counts, self.leaf_starts[:-1])
        shares: FloatArray = self.leaf_counts / np.repeat(np.maximum(sizes, 1), np.diff(self.leaf_starts))
        return shares

    def leaf_categories(self) -> NDArray[np.int32]:
        """Return (L,) the most frequent category of each leaf, the first of equals."""
        leaf = np.repeat(np.arange(self.n_leaves), np.diff(self.leaf_starts))
        order = np.lexsort((self.leaf_classes, -self.leaf_counts, leaf))
        return self.leaf_classes[order[self.leaf_starts[:-1]]]

    def leaf_votes(self) -> FloatArray:
        """Return (L,) 1, or 0 for a leaf without clips, which does not vote."""
        return np.maximum.reduceat(self.leaf_counts > 0, self.leaf_starts[:-1]).astype(np.float64)


def grow_trees(
    features: FloatArray,
    categories: NDArray[np.int32],
    n_classes: int,
    tests: IntArray,
    spec: TreesSpec,
    seeds: NDArray[np.uint64],
    copied: IntArray,
    largest: FloatArray,
) -> Trees:
    """Grow one tree per seed, the same for any number of workers; above ``MOST_GROWN`` clips, from a sample for each
    tree.

    Parameters
    ----------
    features : (N + K, T, F) checked pose features, float64 or float32; not copied if ordered by ``order_for_trees``.
    categories : (N + K,) 0 ... n_classes - 1.
    tests : (R, 5) see ``tree_kernels``.
    spec : how to grow.
    seeds : 64-bit, one per tree.
    copied : (K,) clips of which the last K are copies: a tree learns one or the other.
    largest : (F,) of ``measure_columns``.
    """
    frames, count = features.shape[1:]
    clips = len(features) - len(copied)
    material = prepare_material(features, _SAME_VALUE * largest, categories, tests, min(clips, MOST_GROWN))
    # A few trees a task: with few clips a tree takes less time than its dispatch.
    cluster = None if spec.n_jobs == 1 else current_cluster()
    workers = count_threads(spec.n_jobs) if cluster is None else cluster.n_threads
    tasks = np.array_split(seeds, min(len(seeds), 4 * workers))
    grow = partial(_grow_seeds, material, n_classes, spec, copied)
    if cluster is not None:
        grown = list(cluster.map(grow, tasks, most=1))
    else:
        grown = map_pieces(grow, tasks, spec.n_jobs, at_a_time=1)
    trees = _join([tree for some in grown for tree in some], (count, frames, n_classes))
    if clips <= MOST_GROWN:
        return trees
    return _count_again(trees, features[:clips], categories[:clips], spec.n_jobs)


def _count_again(
    trees: Trees, features: FloatArray, categories: NDArray[np.int32], n_jobs: int | None, at_once: int = 4096
) -> Trees:
    """Count all clips in the leaves of trees that were grown from samples; ``at_once`` go down the trees in a task."""
    leaves = np.empty((len(features), len(trees.roots)), np.int32)
    parts = [slice(start, start + at_once) for start in range(0, len(features), at_once)]

    def find(part: slice) -> None:
        leaves[part] = trees.find_leaves(features[part])

    map_pieces(find, parts, n_jobs, at_a_time=1)
    keys, counts = [], []
    for column in leaves.T:  # leaves are numbered tree by tree, so keys ascend
        own, found = np.unique(column.astype(np.int64) * trees.n_classes + categories, return_counts=True)
        keys.append(own)
        counts.append(found)
    return replace(put_counts(trees, np.concatenate(keys), np.concatenate(counts)), pooled=True)


def put_counts(trees: Trees, keys: IntArray, counts: IntArray) -> Trees:
    """Replace the clips counted in some leaves.

    ``keys``, ``counts``: (K,) distinct leaf * ``n_classes`` + category, and the number of clips. Other leaves keep
    theirs: rounding may take a clip past the leaf that it made.
    """
    leaf = np.repeat(np.arange(trees.n_leaves), np.diff(trees.leaf_starts))
    left = ~np.isin(leaf, keys // trees.n_classes)
    all_keys = np.concatenate([keys, leaf[left] * trees.n_classes + trees.leaf_classes[left]])
    order = np.argsort(all_keys, kind="stable")
    all_counts = np.concatenate([counts, trees.leaf_counts[left]])[order].astype(np.int32)
    number, classes = np.divmod(all_keys[order], trees.n_classes)
    starts = np.searchsorted(number, np.arange(trees.n_leaves + 1))
    return replace(trees, leaf_starts=starts, leaf_classes=classes.astype(np.int32), leaf_counts=all_counts)


MOST_GROWN = 100_000
"""Clips that one tree is grown from; of more, each tree draws a sample, then counts all clips in its leaves
(docs/scaling.md)."""


def _draw_some(categories: NDArray[np.int32], n_classes: int, seed: np.uint64, least_drawn: int = 20) -> IntArray:
    """Draw a sample, ascending: of each category the same share, but ``least_drawn`` clips if it has as many."""
    sizes = np.bincount(categories, minlength=n_classes)
    least = min(least_drawn, MOST_GROWN // n_classes)
    share = (MOST_GROWN - least * n_classes) / len(categories)
    wanted = np.minimum(np.maximum((sizes * share).astype(np.int64), least), sizes)
    # The first of each category, in random order.
    order = np.lexsort((np.random.default_rng(int(seed)).random(len(categories)), categories))
    rank = np.arange(len(categories)) - np.repeat(np.cumsum(sizes) - sizes, sizes)
    return np.sort(order[rank < wanted[categories[order]]])


def measure_columns(features: FloatArray) -> FloatArray:
    """Return (F,) the largest size of each column of features (N, T, F); not finite where a value is not."""
    if not len(features):
        return np.zeros(features.shape[2])
    # Over the clips first, where NumPy is fastest.
    sizes = np.maximum(features.max(axis=0), -features.min(axis=0))
    largest: FloatArray = sizes.max(axis=0).astype(np.float64)
    return largest


def order_for_trees(features: FloatArray) -> FloatArray:
    """Store features (N, T, F) in memory as (N, F, T), copied if needed, as a test reads cells of one column."""
    return np.ascontiguousarray(features.transpose(0, 2, 1)).transpose(0, 2, 1)


Material = tuple[NDArray[Any], ...]

GrownTree = tuple[NDArray[np.int32], IntArray, NDArray[np.int32], NDArray[np.int32]]


def prepare_material(
    features: FloatArray, tolerances: FloatArray, categories: NDArray[np.int32], tests: IntArray, largest: int
) -> Material:
    """Prepare the input of ``grow_some`` for trees of at most ``largest`` clips; the rest as in ``grow_trees``.

    Values of a column (F,) that are closer than its tolerance count as equal.
    """
    number = np.arange(largest + 1)
    logarithms = np.rint(number * np.log2(np.maximum(number, 1)) * kernels.FIXED_POINT).astype(np.int64)
    return order_for_trees(features).transpose(0, 2, 1), tolerances, categories, tests, logarithms


def prepare_leaves(
    features: FloatArray, categories: NDArray[np.int32], tests: IntArray, largest: int, at_once: int = 1024
) -> Material:
    """Prepare the same with the largest sizes of each clip's columns as tolerances, which then depend on a tree's clips
    only.
    """
    sizes = np.empty((len(features), features.shape[2]), features.dtype)
    for start in range(0, len(features), at_once):
        sizes[start : start + at_once] = np.abs(features[start : start + at_once]).max(axis=1)
    return prepare_material(features, sizes, categories, tests, largest)


def grow_some(
    material: Material, n_classes: int, spec: TreesSpec, drawn: Iterable[tuple[IntArray, np.uint64]]
) -> list[GrownTree]:
    """Grow a tree for each (clips, permuted in place, and seed); return nodes, leaf starts, classes and counts."""
    largest = len(material[4]) - 1
    nodes, starts = np.zeros((2 * largest - 1, 6), np.int32), np.zeros(largest + 1, np.int64)
    classes, counts = np.zeros(largest, np.int32), np.zeros(largest, np.int32)
    work = kernels.Workspace.create(material[0], largest, n_classes, len(material[3]))
    limit = spec.max_entropy * kernels.FIXED_POINT
    trees = []
    features, tolerances, *others = material
    for samples, seed in drawn:
        own = tolerances
        if tolerances.ndim == 2:
            own = _SAME_VALUE * tolerances[samples].max(axis=0).astype(np.float64)
        n_nodes, n_leaves = kernels.grow_tree(
            features, own, *others, samples, spec.n_trials, spec.random_thresholds, limit, seed, work,
            nodes, nodes.view(np.float64), starts, classes, counts,
        )  # fmt: skip
        entries = starts[n_leaves]
        kept = nodes[:n_nodes], starts[: n_leaves + 1], classes[:entries], counts[:entries]
        trees.append((kept[0].copy(), kept[1].copy(), kept[2].copy(), kept[3].copy()))
    return trees


def _grow_seeds(
    material: Material, n_classes: int, spec: TreesSpec, copied: IntArray, seeds: NDArray[np.uint64]
) -> list[GrownTree]:
    """Grow a tree for each seed from all clips, a bootstrap or other sample; half of the clips by their copies."""
    clips = len(material[0]) - len(copied)
    share = min(1.0, 0.5 * clips / max(len(copied), 1))

    def draw(seed: np.uint64) -> IntArray:
        generator = np.random.default_rng(int(seed))
        some = _draw_some(material[2][:clips], n_classes, seed) if clips > MOST_GROWN else np.arange(clips)
        drawn = some[np.sort(generator.integers(0, len(some), len(some)))] if spec.bootstrap else some
        if not len(copied):
            return drawn
        learned = np.arange(clips)
        chosen = np.flatnonzero(generator.random(len(copied)) < share)
        learned[copied[chosen]] = clips + chosen
        return learned[drawn]

    return grow_some(material, n_classes, spec, ((draw(seed), seed) for seed in seeds))


def _join(trees: list[GrownTree], sizes: tuple[int, int, int]) -> Trees:
    """Join trees one behind the other, with children and leaves numbered through."""
    first_node, first_leaf, first_entry = 0, 0, 0
    roots, starts = [], [np.zeros(1, np.int64)]
    for nodes, leaf_starts, _, _ in trees:
        children = nodes[:, 2]
        children += np.where(children < 0, -first_leaf, first_node).astype(np.int32)
        roots.append(first_node)
        starts.append(leaf_starts[1:] + first_entry)
        first_node += len(nodes)
        first_leaf += len(leaf_starts) - 1
        first_entry += int(leaf_starts[-1])
    all_nodes, _, classes, counts = zip(*trees, strict=True)
    return Trees(
        np.concatenate(all_nodes),
        np.array(roots, np.int64),
        np.concatenate(starts),
        np.concatenate(classes),
        np.concatenate(counts),
        *sizes,
    )


@dataclass(frozen=True, slots=True, eq=False)
class Subtree:
    """A tree that replaces one leaf.

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
        return len(self.leaf_starts) - 1


def grow_subtrees(
    features: FloatArray,
    n_classes: int,
    tests: IntArray,
    spec: TreesSpec,
    members: Sequence[tuple[int, IntArray, NDArray[np.int32]]],
    seeds: NDArray[np.uint64],
) -> list[Subtree]:
    """Grow one subtree for each leaf by the forest's own rule; a leaf of one category stays one.

    Parameters
    ----------
    features, n_classes, tests, spec : as in ``grow_trees``; bootstrap and workers are not used.
    members : number, clips, and their categories, for each leaf.
    seeds : 64-bit, one per leaf.
    """
    if not members:
        return []
    categories = np.zeros(len(features), np.int32)
    material = prepare_leaves(features, categories, tests, max(len(inside) for _, inside, _ in members))

    def hand_out() -> Iterator[tuple[IntArray, np.uint64]]:
        for (_, inside, own), seed in zip(members, seeds, strict=True):
            categories[inside] = own  # shared with the material; leaves grow one at a time
            yield inside.copy(), seed

    grown = grow_some(material, n_classes, spec, hand_out())
    return [Subtree(leaf, *tree) for (leaf, *_), tree in zip(members, grown, strict=True)]


def part_strangers(subtree: Subtree, usual: int) -> Subtree:
    """Merge all leaves but those with more strangers than other clips into the first leaf.

    Returns a single leaf where either are missing; ``usual`` is the category of all clips that are no strangers.
    """
    owner = np.repeat(np.arange(subtree.n_leaves), np.diff(subtree.leaf_starts))
    is_usual = subtree.leaf_classes == usual
    known = np.bincount(owner[is_usual], subtree.leaf_counts[is_usual], subtree.n_leaves)
    strange = np.bincount(owner[~is_usual], subtree.leaf_counts[~is_usual], subtree.n_leaves)
    apart = strange > known
    counts = np.bincount(subtree.leaf_classes, subtree.leaf_counts).astype(np.int64)
    if apart.all() or not apart.any():
        return make_stump(subtree.leaf, counts)
    numbers = np.where(apart, np.cumsum(apart), 0)
    nodes = subtree.nodes.copy()
    outer = nodes[:, 2] < 0
    nodes[outer, 2] = -1 - numbers[-1 - nodes[outer, 2]]
    kept = apart[owner]
    first = np.array([usual], np.int32), np.array([max(int(known[~apart].sum()), 1)], np.int32)
    starts = np.concatenate([[0, 1], 1 + np.cumsum(np.diff(subtree.leaf_starts)[apart])])
    classes = np.concatenate([first[0], subtree.leaf_classes[kept]])
    return Subtree(subtree.leaf, nodes, starts, classes, np.concatenate([first[1], subtree.leaf_counts[kept]]))


def make_stump(leaf: int, counts: IntArray) -> Subtree:
    """Make a single leaf with ``counts`` (C,) of clips, which may all be 0."""
    classes = np.flatnonzero(counts).astype(np.int32) if counts.any() else np.zeros(1, np.int32)
    node = np.array([[0, 0, -1, 0, 0, 0]], np.int32)
    return Subtree(leaf, node, np.array([0, len(classes)]), classes, counts[classes].astype(np.int32))


def collapse_leaves(trees: Trees, leaves: IntArray) -> Trees:
    """Collapse what has grown from some leaves of the training back into one leaf each.

    The other grown leaves keep their numbers without a node: ``replace_leaves`` reuses or empties them.
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
    """Replace some leaves of the trees by subtrees.

    Old nodes keep their tests and order. The first leaf of a subtree takes the number of the replaced leaf, the others
    free numbers of the same home, else numbers behind all leaves; a clip in any other leaf stays where it is.

    Parameters
    ----------
    trees : with leaf classes numbered as in the subtrees.
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
    return Trees(nodes, trees.roots + shifts[:-1], *entries, *sizes, homes, trees.pooled, trees.trained)


def _number_leaves(
    trees: Trees, subtrees: Sequence[Subtree], node_of_leaf: IntArray
) -> tuple[list[IntArray], NDArray[np.int32], list[int]]:
    """Return the leaf numbers of each subtree, the homes of all leaves, and the leaves without a node."""
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
    """Return starts, classes and counts of all leaves in the order of their numbers."""
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
