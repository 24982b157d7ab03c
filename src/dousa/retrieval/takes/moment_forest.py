"""Extremely randomised trees over the moments of recordings: how likely each category is at a moment.

Source: Geurts, Ernst, Wehenkel, "Extremely randomized trees", Machine Learning 63, 2006. A value is one of 256 steps
between the lowest and the highest that a sample of the training moments shows, so a tree needs a byte a value; a node
of many moments chooses its test by some of them. Leaves keep shares of categories, and only those that are not 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import FloatArray, IntArray
from dousa.messages import Message
from dousa.retrieval.forest.forest_file import check

Codes = NDArray[np.uint8]

_LEAST = 2  # moments in a leaf
_MOST_LOOKED = 256  # moments by which a node chooses its test
_N_TRIES = 32  # tests of a node: about the square root of the number of values


@dataclass(frozen=True, slots=True, eq=False)
class Scale:
    """How values become bytes.

    Parameters
    ----------
    lows : (F,) float32, what becomes 0.
    scales : (F,) float32, steps a unit.
    """

    lows: NDArray[np.float32]
    scales: NDArray[np.float32]

    def encode(self, values: NDArray[np.float32]) -> Codes:
        """(M, F) bytes of the values of moments."""
        from dousa.retrieval.takes.moment_kernels import encode

        codes = np.empty(values.shape, np.uint8)
        encode(values, self.lows, self.scales, codes)
        return codes


def choose_scale(values: NDArray[np.float32]) -> Scale:
    """The scale on which all but the outermost of some moments (M, F) lie."""
    low, high = np.percentile(values, (1.0, 99.0), axis=0).astype(np.float32)
    return Scale(low, (256.0 / np.maximum(high - low, 1e-6)).astype(np.float32))


@dataclass(frozen=True, slots=True, eq=False)
class MomentForest:
    """Trees.

    Parameters
    ----------
    scale : of the values.
    nodes : (N, 3) int32: feature, threshold, left child; of a leaf -1 - its number stands for the child.
    roots : (n_trees,) int32.
    leaf_starts : (L + 1,) int32, where the categories of each leaf begin.
    leaf_categories, leaf_shares : (K,) int32 and float32; the shares of a leaf sum to 1 / n_trees.
    n_categories : S.
    """

    scale: Scale
    nodes: NDArray[np.int32]
    roots: NDArray[np.int32]
    leaf_starts: NDArray[np.int32]
    leaf_categories: NDArray[np.int32]
    leaf_shares: NDArray[np.float32]
    n_categories: int

    def apply(self, codes: Codes) -> NDArray[np.int32]:
        """(M, n_trees) the leaves that moments (M, F) reach."""
        from dousa.retrieval.takes.moment_kernels import reach_leaves

        leaves = np.empty((len(codes), len(self.roots)), np.int32)
        reach_leaves(codes, self.nodes, self.roots, leaves)
        return leaves

    def judge(self, leaves: NDArray[np.int32]) -> NDArray[np.float32]:
        """(M, S) probabilities of the categories at moments, from their leaves (M, n_trees)."""
        from dousa.retrieval.takes.moment_kernels import add_leaves

        shares = np.zeros((len(leaves), self.n_categories), np.float32)
        add_leaves(leaves, self.leaf_starts, self.leaf_categories, self.leaf_shares, shares)
        return shares

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """Plain arrays by name."""
        return {
            "lows": self.scale.lows,
            "scales": self.scale.scales,
            "nodes": self.nodes,
            "roots": self.roots,
            "leaf_starts": self.leaf_starts,
            "leaf_categories": self.leaf_categories,
            "leaf_shares": self.leaf_shares,
        }


FOREST_ARRAYS = ("lows", "scales", "nodes", "roots", "leaf_starts", "leaf_categories", "leaf_shares")
"""Names of the arrays of a forest."""


def read_moment_forest(
    arrays: dict[str, NDArray[Any]], n_categories: int, n_values: int, what: Message
) -> MomentForest:
    """The forest of stored arrays; DousaError that ``what`` is damaged where no tree could be run down."""
    lows, scales, nodes, roots, starts, categories, shares = (arrays[name] for name in FOREST_ARRAYS)
    right = all(one.shape == (n_values,) and one.dtype == np.float32 for one in (lows, scales))
    check(right and bool(np.isfinite(lows).all() and np.isfinite(scales).all()), what, "bad scale")
    right = nodes.dtype == np.int32 and nodes.ndim == 2 and nodes.shape[1] == 3 and len(nodes) > 0
    check(right and nodes.flags.c_contiguous, what, "bad nodes")
    right = roots.dtype == np.int32 and roots.ndim == 1 and len(roots) > 0
    check(right and bool(((roots >= 0) & (roots < len(nodes))).all()), what, "bad roots")
    right = starts.dtype == np.int32 and starts.ndim == 1 and len(starts) > 1 and int(starts[0]) == 0
    right = right and categories.dtype == np.int32 and shares.dtype == np.float32 and categories.ndim == 1
    check(right and shares.shape == categories.shape, what, "bad leaves")
    right = bool((np.diff(starts) >= 0).all()) and int(starts[-1]) == len(categories)
    right = right and bool(((categories >= 0) & (categories < n_categories)).all() and np.isfinite(shares).all())
    check(right, what, "bad leaves")
    children = nodes[:, 2]
    inner = children >= 0
    # A child stands behind its parent, so every way down ends.
    right = bool((children[inner] > np.flatnonzero(inner)).all() and (children[inner] + 1 < len(nodes)).all())
    right = right and bool(((nodes[inner, 0] >= 0) & (nodes[inner, 0] < n_values)).all())
    check(right and bool((-1 - children[~inner] < len(starts) - 1).all()), what, "bad nodes")
    return MomentForest(Scale(lows, scales), nodes, roots, starts, categories, shares, n_categories)


def grow_moment_forest(
    codes: Codes,
    labels: IntArray,
    weights: FloatArray,
    scale: Scale,
    n_categories: int,
    n_trees: int,
    *,
    random_state: int,
    n_jobs: int | None = None,
) -> MomentForest:
    """Grow trees over moments.

    Parameters
    ----------
    codes : (N, F) values of moments.
    labels : (N,) from 0 to below ``n_categories``.
    weights : (N,) above 0.
    random_state : seed; the same seed gives the same trees.
    n_jobs : threads; None for one. The result does not depend on it.
    """
    import joblib

    seeds = np.random.SeedSequence(random_state).generate_state(n_trees)
    by_value = np.ascontiguousarray(codes.T)
    jobs = (joblib.delayed(_grow_tree)(by_value, codes, labels, weights, n_categories, int(seed)) for seed in seeds)
    trees: Sequence[_Tree] = joblib.Parallel(n_jobs=n_jobs, prefer="threads")(jobs)
    n_nodes = np.cumsum([0] + [len(tree.nodes) for tree in trees])
    n_leaves = np.cumsum([0] + [len(tree.counts) for tree in trees])
    nodes = np.concatenate([tree.nodes for tree in trees])
    for k in range(n_trees):
        child = nodes[n_nodes[k] : n_nodes[k + 1], 2]
        child += np.where(child >= 0, n_nodes[k], -n_leaves[k]).astype(np.int32)
    starts = np.concatenate([[0], np.cumsum(np.concatenate([tree.counts for tree in trees]))])
    return MomentForest(
        scale,
        nodes,
        n_nodes[:-1].astype(np.int32),
        starts.astype(np.int32),
        np.concatenate([tree.categories for tree in trees]),
        (np.concatenate([tree.shares for tree in trees]) / n_trees).astype(np.float32),
        n_categories,
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Tree:
    nodes: NDArray[np.int32]
    counts: IntArray  # (L,) categories of each leaf
    categories: NDArray[np.int32]
    shares: FloatArray


def _grow_tree(
    by_value: Codes, codes: Codes, labels: IntArray, weights: FloatArray, n_categories: int, seed: int
) -> _Tree:
    from dousa.retrieval.takes.moment_kernels import grow

    n = len(labels)
    nodes, leaf_of, chosen = np.empty((2 * n, 3), np.int32), np.empty(n, np.int64), np.empty(n, np.int64)
    settings = (n_categories, _N_TRIES, _LEAST, _MOST_LOOKED, seed)
    n_nodes, _ = grow(by_value, codes, labels, weights, *settings, chosen, nodes, leaf_of)
    pairs, where = np.unique(leaf_of * n_categories + labels[chosen], return_inverse=True)
    sums = np.bincount(where, weights=weights[chosen])
    leaves, categories = np.divmod(pairs, n_categories)
    shares = sums / np.bincount(leaves, weights=sums)[leaves]
    return _Tree(nodes[:n_nodes].copy(), np.bincount(leaves), categories.astype(np.int32), shares)
