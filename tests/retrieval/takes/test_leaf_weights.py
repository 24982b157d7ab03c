"""Weights of leaves and corrections of them, held to the same computed with sparse matrices of SciPy, bit for bit."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse import csr_matrix

from dousa.retrieval.takes.labeller_training import spread_corrections
from dousa.retrieval.takes.leaf_weights import LeafWeights, fit_leaf_weights

TREES, LEAVES_OF_TREE = 7, 11


def reach(leaves, dtype):
    ends = np.arange(0, leaves.size + 1, leaves.shape[1])
    ones = np.ones(leaves.size, dtype)
    return csr_matrix((ones, leaves.ravel().astype(np.int32), ends), shape=(len(leaves), TREES * LEAVES_OF_TREE))


def draw_leaves(rng, count, dtype):
    """(W, trees) one leaf of each tree."""
    drawn = rng.integers(0, LEAVES_OF_TREE, (count, TREES)) + np.arange(TREES) * LEAVES_OF_TREE
    return drawn.astype(dtype)


def fit_with_scipy(leaves, categories, overlaps, n_categories):
    wanted = np.zeros((len(leaves), n_categories), np.float32)
    known = np.flatnonzero(categories >= 0)
    wanted[known, categories[known]] = np.maximum(overlaps[known] - 0.3, 0.0) / 0.7
    offset = wanted.mean(axis=0)
    reached = reach(leaves, np.float32)
    back = reached.T.tocsr()
    weights = np.zeros((reached.shape[1], n_categories), np.float32)
    residual = np.asarray(back @ (wanted - offset))
    direction = residual.copy()
    size = np.einsum("lc,lc->c", residual, residual)
    for _ in range(15):
        ahead = back @ (reached @ direction) + 1000.0 * direction
        step = size / np.maximum(np.einsum("lc,lc->c", direction, ahead), 1e-30)
        weights += step * direction
        residual -= step * ahead
        smaller = np.einsum("lc,lc->c", residual, residual)
        direction = residual + direction * (smaller / np.maximum(size, 1e-30))
        size = smaller
    return LeafWeights(weights.astype(np.float32), offset)


@pytest.mark.parametrize("dtype", [np.uint16, np.int32])
@pytest.mark.parametrize("seed", range(3))
def test_the_fit_is_that_of_sparse_matrices(seed, dtype):
    rng = np.random.default_rng(seed)
    leaves = draw_leaves(rng, 200, dtype)
    categories, overlaps = rng.integers(-1, 4, 200), rng.random(200)
    ours = fit_leaf_weights(leaves, categories, overlaps, TREES * LEAVES_OF_TREE, 4)
    theirs = fit_with_scipy(leaves, categories, overlaps, 4)
    np.testing.assert_array_equal(ours.weights, theirs.weights)
    np.testing.assert_array_equal(ours.offset, theirs.offset)
    assert np.any(ours.weights)


@pytest.mark.parametrize("seed", range(3))
def test_corrections_are_those_of_sparse_matrices(seed):
    rng = np.random.default_rng(seed)
    leaves = draw_leaves(rng, 60, np.int32)
    residuals = rng.normal(size=(60, 4)).astype(np.float32)
    before = rng.normal(size=(TREES * LEAVES_OF_TREE, 4)).astype(np.float32)
    reached = reach(leaves, np.float64)
    shared = (reached @ reached.T).toarray()
    shared[np.diag_indices(60)] += 20.0
    theirs = before + (reached.T @ np.linalg.solve(shared, residuals.astype(np.float64))).astype(np.float32)
    ours = before.copy()
    spread_corrections(ours, leaves, residuals)
    np.testing.assert_array_equal(ours, theirs)
    assert np.any(ours != before)
