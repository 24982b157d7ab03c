"""The trees of a forest in a few flat arrays: grown, put together, checked."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dousa.retrieval import _forest_kernels as kernels
from dousa.retrieval.integral import MEAN, SPREAD, TREND

__all__ = [
    "KIND_NAMES",
    "SAME_VALUE",
    "Test",
    "Trees",
    "TreesSpec",
    "evaluate_test",
    "grow_trees",
    "make_log_table",
    "read_test",
]

KIND_NAMES = ("mean", "spread", "trend")
"""Names of the kinds of tests, by their numbers in the kernels."""

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

SAME_VALUE = 1e-7
"""Values of a test closer than this share of the feature's largest value are one value."""


@dataclass(frozen=True, slots=True)
class TreesSpec:
    """How trees are grown: tests drawn at a node, bits of entropy of a leaf, bootstrap, random thresholds, workers."""

    n_trials: int
    max_entropy: float
    bootstrap: bool
    random_thresholds: bool
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
    only_means : whether no node asks for a spread or a trend.
    """

    nodes: NDArray[np.int32]
    roots: IntArray
    leaf_starts: IntArray
    leaf_classes: NDArray[np.int32]
    leaf_counts: NDArray[np.int32]
    n_features: int
    n_frames: int
    n_classes: int
    only_means: bool = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "only_means", not self.nodes[:, 3].any())

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


@dataclass(frozen=True, slots=True)
class Test:
    """What a node asks.

    Parameters
    ----------
    kind : number, see ``KIND_NAMES``.
    column, partner : columns of the features; the partner is the column itself for a mean.
    start, stop : t0 and t1.
    threshold : of the mean, spread or trend.
    """

    kind: int
    column: int
    partner: int
    start: int
    stop: int
    threshold: float


def read_test(trees: Trees, node: int) -> Test:
    """The test of an inner node."""
    width = trees.n_frames + 1
    later, sooner, partner = int(trees.nodes[node, 0]), int(trees.nodes[node, 1]), int(trees.nodes[node, 3])
    column, stop = divmod(later, width)
    start, cut = sooner % width, float(trees.cuts[node, 2])
    if partner == 0:
        return Test(MEAN, column, column, start, stop, cut / (stop - start))
    kind = SPREAD if partner > 0 else TREND
    return Test(kind, column, column + abs(partner) // width, start, stop, cut)


def evaluate_test(integrals: FloatArray, test: Test) -> float:
    """The value of a test for one clip, from its integrals (F, T + 1)."""
    length = test.stop - test.start
    difference = integrals[test.column, test.stop] - integrals[test.column, test.start]
    if test.kind == MEAN:
        return float(difference / length)
    other = integrals[test.partner, test.stop] - integrals[test.partner, test.start]
    if test.kind == SPREAD:
        return float(np.sqrt(max(other / length - (difference / length) ** 2, 0.0)))
    return float(12.0 * (other - 0.5 * (test.start + test.stop) * difference) / length**2)


def grow_trees(
    features: FloatArray,
    categories: NDArray[np.int32],
    n_classes: int,
    tests: IntArray,
    spec: TreesSpec,
    seeds: NDArray[np.uint64],
) -> Trees:
    """One tree per seed, whatever the number of workers.

    Parameters
    ----------
    features : (N, T, F) checked pose features.
    categories : (N,) 0 ... n_classes - 1.
    tests : (R, 5) what may be asked at a node, see ``_forest_kernels``.
    spec : how to grow.
    seeds : 64-bit, one per tree.
    """
    from joblib import Parallel, delayed, effective_n_jobs

    clips, frames, count = features.shape
    # Clips last: a test of all clips at a node reads two rows.
    integrals = np.zeros((count, frames + 1, clips))
    np.cumsum(features.transpose(2, 1, 0), axis=1, out=integrals[:, 1:])
    tolerances = SAME_VALUE * np.abs(features).max(axis=(0, 1))
    material = (integrals, tolerances, categories, tests, make_log_table(clips))
    # A few trees a task: with few clips a tree takes less time than handing it out.
    tasks = np.array_split(seeds, min(len(seeds), 4 * effective_n_jobs(spec.n_jobs)))
    grown = Parallel(n_jobs=spec.n_jobs, prefer="threads")(
        delayed(_grow_some)(material, n_classes, spec, some) for some in tasks
    )
    return _join([tree for some in grown for tree in some], (count, frames, n_classes))


def make_log_table(n: int) -> IntArray:
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
            *material, samples, spec.n_trials, spec.random_thresholds, limit, seed, work,
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
