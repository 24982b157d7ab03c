"""Small trees that replace leaves, and grown ones collapsed back into one leaf."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import FloatArray, IntArray
from dousa.retrieval.forest.trees import Trees, TreesSpec, grow_some, prepare_leaves


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
