"""Leaves of a forest become small trees: grown from the clips that stand in them, and put in their place."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from dousa.retrieval import _forest_kernels as kernels
from dousa.retrieval._trees import SAME_VALUE, Trees, TreesSpec, make_log_table

__all__ = ["Subtree", "grow_subtrees", "replace_leaves"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


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
    clips, frames, count = features.shape
    integrals = np.zeros((count, frames + 1, clips))
    np.cumsum(features.transpose(2, 1, 0), axis=1, out=integrals[:, 1:])
    tolerances = SAME_VALUE * np.abs(features).max(axis=(0, 1))
    largest = max(len(inside) for _, inside in members)
    table = make_log_table(largest)
    nodes, starts = np.zeros((2 * largest - 1, 6), np.int32), np.zeros(largest + 1, np.int64)
    classes, counts = np.zeros(largest, np.int32), np.zeros(largest, np.int32)
    work = kernels.Workspace.create(largest, n_classes, len(tests))
    limit, cuts = spec.max_entropy * kernels.FIXED_POINT, nodes.view(np.float64)
    grown = []
    for (leaf, inside), seed in zip(members, seeds, strict=True):
        n_nodes, n_leaves = kernels.grow_tree(  # type: ignore[call-arg]
            integrals, tolerances, categories, tests, table, inside.copy(), spec.n_trials,
            spec.random_thresholds, limit, seed, work, nodes, cuts, starts, classes, counts,
        )  # fmt: skip
        entries = starts[n_leaves]
        grown.append(
            Subtree(
                leaf,
                nodes[:n_nodes].copy(),
                starts[: n_leaves + 1].copy(),
                classes[:entries].copy(),
                counts[:entries].copy(),
            )
        )
    return grown


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
        moved[:, 2] = np.where(
            children < 0, -1 - numbers[-1 - np.minimum(children, -1)], children + free[tree] - 1
        )
        nodes[place[node_of_leaf[one.leaf]]] = moved[0]
        nodes[free[tree] : free[tree] + len(moved) - 1] = moved[1:]
        free[tree] += len(moved) - 1
    return Trees(
        nodes,
        trees.roots + shifts[:-1],
        *_replace_entries(trees, subtrees),
        trees.n_features,
        trees.n_frames,
        n_classes,
    )


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
