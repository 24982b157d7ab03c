"""The trees of a forest in a few flat arrays: grown, put together, checked."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dousa.retrieval import _forest_kernels as kernels
from dousa.retrieval.integral import list_tests

__all__ = ["Trees", "TreesSpec", "grow_trees"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

_SAME_VALUE = 1e-7
"""Values of a test closer than this share of the feature's largest value are one value."""


@dataclass(frozen=True, slots=True)
class TreesSpec:
    """How trees are grown: tests drawn at a node, bits of entropy of a leaf, bootstrap, workers (joblib)."""

    n_trials: int
    max_entropy: float
    bootstrap: bool
    n_jobs: int | None


@dataclass(frozen=True, slots=True, eq=False)
class Trees:
    """Trees one behind the other; the layout of a node is told in ``_forest_kernels``.

    Parameters
    ----------
    nodes : (M, 6) int32.
    roots : (n_trees,) index of each tree's first node.
    leaf_starts : (L + 1,) where the entries of each leaf begin.
    leaf_classes, leaf_counts : (E,) int32, the category and the number of training clips of each entry.
    n_features, n_frames, n_classes : F, T and C.
    """

    nodes: NDArray[np.int32]
    roots: IntArray
    leaf_starts: IntArray
    leaf_classes: NDArray[np.int32]
    leaf_counts: NDArray[np.int32]
    n_features: int
    n_frames: int
    n_classes: int

    @property
    def cuts(self) -> FloatArray:
        """(M, 3) view of the nodes; column 2 is the threshold of the difference of two integrals."""
        return self.nodes.view(np.float64)

    @property
    def n_leaves(self) -> int:
        """Leaves of all trees together."""
        return len(self.leaf_starts) - 1

    def leaf_shares(self) -> FloatArray:
        """(E,) every entry's share of its leaf's clips: the leaf's histogram."""
        sizes = np.add.reduceat(self.leaf_counts, self.leaf_starts[:-1])
        shares: FloatArray = self.leaf_counts / np.repeat(sizes, np.diff(self.leaf_starts))
        return shares

    def leaf_categories(self) -> NDArray[np.int32]:
        """(L,) the most frequent category of each leaf, the first of equals."""
        leaf = np.repeat(np.arange(self.n_leaves), np.diff(self.leaf_starts))
        order = np.lexsort((self.leaf_classes, -self.leaf_counts, leaf))
        return self.leaf_classes[order[self.leaf_starts[:-1]]]


def grow_trees(
    features: FloatArray,
    categories: NDArray[np.int32],
    n_classes: int,
    spec: TreesSpec,
    seeds: NDArray[np.uint64],
) -> Trees:
    """One tree per seed, whatever the number of workers.

    Parameters
    ----------
    features : (N, T, F) checked pose features.
    categories : (N,) 0 ... n_classes - 1.
    spec : how to grow.
    seeds : 64-bit, one per tree.
    """
    from joblib import Parallel, delayed, effective_n_jobs

    clips, frames, count = features.shape
    # Clips last: a test of all clips at a node reads two rows.
    integrals = np.zeros((count, frames + 1, clips))
    np.cumsum(features.transpose(2, 1, 0), axis=1, out=integrals[:, 1:])
    tolerances = _SAME_VALUE * np.abs(features).max(axis=(0, 1))
    material = (integrals, tolerances, categories, list_tests(count, frames), _log_table(clips))
    # A few trees a task: with few clips a tree takes less time than handing it out.
    tasks = np.array_split(seeds, min(len(seeds), 4 * effective_n_jobs(spec.n_jobs)))
    grown = Parallel(n_jobs=spec.n_jobs, prefer="threads")(
        delayed(_grow_some)(material, n_classes, spec, some) for some in tasks
    )
    return _join([tree for some in grown for tree in some], (count, frames, n_classes))


def _log_table(n: int) -> IntArray:
    """k log2 k for k = 0 ... n, in fixed point."""
    number = np.arange(n + 1)
    return np.rint(number * np.log2(np.maximum(number, 1)) * kernels.FIXED_POINT).astype(np.int64)


_Tree = tuple[NDArray[np.int32], IntArray, NDArray[np.int32], NDArray[np.int32]]


def _grow_some(
    material: tuple[NDArray[Any], ...], n_classes: int, spec: TreesSpec, seeds: NDArray[np.uint64]
) -> list[_Tree]:
    """Nodes, leaf starts, leaf classes and leaf counts of each tree."""
    clips = material[0].shape[2]
    nodes, starts = np.zeros((2 * clips - 1, 6), np.int32), np.zeros(clips + 1, np.int64)
    classes, counts = np.zeros(clips, np.int32), np.zeros(clips, np.int32)
    work = kernels.Workspace.create(clips, n_classes, len(material[3]))
    limit = spec.max_entropy * kernels.FIXED_POINT
    trees = []
    for seed in seeds:
        samples = np.arange(clips)
        if spec.bootstrap:
            samples = np.sort(np.random.default_rng(int(seed)).integers(0, clips, clips))
        n_nodes, n_leaves = kernels.grow_tree(  # type: ignore[call-arg]
            *material, samples, spec.n_trials, limit, seed, work,
            nodes, nodes.view(np.float64), starts, classes, counts,
        )  # fmt: skip
        entries = starts[n_leaves]
        trees.append(
            (
                nodes[:n_nodes].copy(),
                starts[: n_leaves + 1].copy(),
                classes[:entries].copy(),
                counts[:entries].copy(),
            )
        )
    return trees


def _join(trees: list[_Tree], sizes: tuple[int, int, int]) -> Trees:
    """Trees one behind the other, with children and leaves numbered through."""
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
    return Trees(
        np.concatenate([nodes for nodes, _, _, _ in trees]),
        np.array(roots, np.int64),
        np.concatenate(starts),
        np.concatenate([classes for _, _, classes, _ in trees]),
        np.concatenate([counts for _, _, _, counts in trees]),
        *sizes,
    )
