"""What a leaf says about a window: weights of every leaf for every category, fitted on windows of joined takes.

The trees are grown on whole clips, and say little of windows that cut an action or hold parts of two. So each leaf gets
a weight for each category, such that the sum over the leaves of a window comes near to how well the window covers an
action of the category: least squares on windows of takes joined from the training clips, the trees unchanged. Source:
"global refinement" of random forests, Ren, Cao, Wei, Sun, CVPR 2015, there with a hinge loss.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dousa.retrieval._joined_takes import Piece

__all__ = ["LeafWeights", "covered_pieces", "fit_leaf_weights"]

_RIDGE = 1000.0
_ITERATIONS = 15
_NOTHING = 0.3  # overlap (intersection over union) up to which a window counts as not covering an action


@dataclass(frozen=True, slots=True, eq=False)
class LeafWeights:
    """Weights of leaves.

    Parameters
    ----------
    weights : (leaves, C) float32.
    offset : (C,) float32, the score of a window of which the leaves say nothing.
    """

    weights: NDArray[np.float32]
    offset: NDArray[np.float32]

    def score(self, leaves: NDArray[Any]) -> NDArray[np.float32]:
        """(W, C) how well windows with leaves (W, n_trees) cover an action of each category; about 0 to 1."""
        from dousa.retrieval._takes_kernels import score_windows

        scores = np.empty((len(leaves), len(self.offset)), np.float32)
        scores[:] = self.offset
        score_windows(leaves, self.weights, scores)
        return scores


def covered_pieces(
    starts: NDArray[np.int64], stops: NDArray[np.int64], pieces: Sequence[Piece]
) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """For each window the piece that it covers best, and the intersection over union with it."""
    begins, ends = np.array([piece.start for piece in pieces]), np.array([piece.stop for piece in pieces])
    shared = np.minimum(stops[:, None], ends) - np.maximum(starts[:, None], begins)
    union = np.maximum(stops[:, None], ends) - np.minimum(starts[:, None], begins)
    overlaps = np.maximum(shared, 0.0) / union
    best = overlaps.argmax(axis=1)
    return best, np.take_along_axis(overlaps, best[:, None], axis=1)[:, 0]


def fit_leaf_weights(
    leaves: NDArray[Any],
    categories: NDArray[np.intp],
    overlaps: NDArray[np.float64],
    n_leaves: int,
    n_categories: int,
) -> LeafWeights:
    """Least squares with a penalty on large weights, by conjugate gradients, all categories at once.

    Parameters
    ----------
    leaves : (W, n_trees) of windows.
    categories : (W,) number of the category that each covers best, -1 for one that is not known.
    overlaps : (W,) how well, intersection over union.
    """
    from scipy.sparse import csr_matrix

    wanted = np.zeros((len(leaves), n_categories), np.float32)
    known = np.flatnonzero(categories >= 0)
    wanted[known, categories[known]] = np.maximum(overlaps[known] - _NOTHING, 0.0) / (1.0 - _NOTHING)
    offset = wanted.mean(axis=0)
    ends = np.arange(0, leaves.size + 1, leaves.shape[1])
    reached = csr_matrix(
        (np.ones(leaves.size, np.float32), leaves.ravel().astype(np.int32), ends),
        shape=(len(leaves), n_leaves),
    )
    return LeafWeights(_solve(reached, wanted - offset), offset)


def _solve(reached: Any, wanted: NDArray[np.float32]) -> NDArray[np.float32]:
    """(leaves, C) weights w that make |reached w - wanted|^2 + ridge |w|^2 small."""
    back = reached.T.tocsr()
    weights = np.zeros((reached.shape[1], wanted.shape[1]), np.float32)
    residual = np.asarray(back @ wanted)
    direction = residual.copy()
    size = np.einsum("lc,lc->c", residual, residual)
    for _ in range(_ITERATIONS):
        ahead = back @ (reached @ direction) + _RIDGE * direction
        step = size / np.maximum(np.einsum("lc,lc->c", direction, ahead), 1e-30)
        weights += step * direction
        residual -= step * ahead
        smaller = np.einsum("lc,lc->c", residual, residual)
        direction = residual + direction * (smaller / np.maximum(size, 1e-30))
        size = smaller
    return weights.astype(np.float32)
