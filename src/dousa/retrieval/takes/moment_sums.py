"""Weighted sums over the moments of recordings, and the discriminants that they give (`moment_model`)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from dousa.arrays import FloatArray, IntArray
from dousa.motion.runs import find_equal_runs
from dousa.retrieval.takes.moment_model import Codes, Floats, Scale

_Kind = TypeVar("_Kind", np.float32, np.float64)

_LEAST = 1e-3  # penalty, in moments, on the offset and at least on others: by definition, no sum is singular


@dataclass(frozen=True, slots=True, eq=False)
class MomentSums:
    """Weighted sums over moments: ``squares`` (F + 1, F + 1) of scores, and ``shown`` (F + 1, S) of scores by state."""

    squares: Floats
    shown: Floats

    @classmethod
    def zero(cls, n_values: int, n_states: int) -> MomentSums:
        """Return the sums of no moment."""
        size = n_values + 1
        return cls(np.zeros((size, size), np.float32), np.zeros((size, n_states), np.float32))

    def add(self, other: MomentSums) -> None:
        """Add the sums of other moments."""
        np.add(self.squares, other.squares, out=self.squares)
        np.add(self.shown, other.shown, out=self.shown)

    def solve(self, ridge: float) -> Floats:
        """Return the (F + 1, S) discriminants; ``ridge`` is the penalty as a share of the weight of all moments."""
        penalised = self.squares.copy()
        places = np.arange(len(penalised) - 1)
        penalised[places, places] += np.float32(max(ridge * float(penalised[-1, -1]), _LEAST))
        penalised[-1, -1] += np.float32(_LEAST)
        return solve_positive(penalised, self.shown)

    @property
    def weights(self) -> Floats:
        """Return the (S,) weight of the moments of each state."""
        weights: Floats = self.shown[-1]
        return weights


@dataclass(frozen=True, slots=True, eq=False)
class MomentRows:
    """The moments themselves, which give the discriminants of their sums sooner where they are fewer than the values.

    ``scores`` (M, F + 1) times the roots of their weights, ``products`` (M, M) of these without the last column, and
    ``shown`` (M, S), the roots of the weights in the column of the state.
    """

    scores: Floats
    products: FloatArray
    shown: FloatArray

    @classmethod
    def create(cls, scale: Scale, codes: Codes, states: IntArray, weights: FloatArray) -> MomentRows:
        """Weigh moments of bytes (M, F) and states (M,) by the ``weights`` (S,) of the states."""
        roots = np.sqrt(weights[states])
        scores = scale.standardise(codes) * roots[:, None].astype(np.float32)
        shown = np.zeros((len(codes), len(weights)))
        shown[np.arange(len(codes)), states] = roots
        return cls(scores, (scores[:, :-1] @ scores[:, :-1].T).astype(np.float64), shown)

    def take(self, rows: IntArray) -> MomentRows:
        """Return some of the moments."""
        return MomentRows(self.scores[rows], self.products[np.ix_(rows, rows)], self.shown[rows])

    def solve(self, ridge: float) -> Floats:
        """Return the discriminants as ``MomentSums``, by the identity of Hastie et al., exercise 18.4."""
        ones = self.scores[:, -1].astype(np.float64)
        pull = max(ridge * float(ones @ ones), _LEAST)
        gram = self.products / pull + np.outer(ones, ones) / _LEAST
        gram[np.diag_indices(len(gram))] += 1.0
        shares = solve_positive(gram, self.shown)
        inside = self.scores[:, :-1].T @ (shares / pull).astype(np.float32)
        return np.concatenate([inside, (ones @ shares / _LEAST)[None].astype(np.float32)])

    @property
    def weights(self) -> FloatArray:
        """Return the (S,) weight of the moments of each state."""
        weights: FloatArray = (self.shown**2).sum(axis=0)
        return weights


def solve_positive(squares: NDArray[_Kind], shown: NDArray[_Kind]) -> NDArray[_Kind]:
    """Solve ``squares`` (F, F), symmetric and positive definite, for ``shown`` (F, S); returns (F, S).

    The general solution, three times as slow, is used where rounding leaves no factor.
    """
    try:
        found = cho_solve(cho_factor(squares, lower=True, check_finite=False), shown, check_finite=False)
    except LinAlgError:
        found = np.linalg.solve(squares, shown)
    return np.asarray(found, squares.dtype)


def sum_moments(
    scale: Scale, codes: Codes, rows: IntArray, states: IntArray, weights: FloatArray, at_once: int = 2048
) -> MomentSums:
    """Sum over ``rows`` of ``codes`` (N, F), with ``states`` (N,) in 0 ... S - 1 and ``weights`` (S,) of the states.

    ``at_once`` moments are standardised.
    """
    sums = MomentSums.zero(codes.shape[1], len(weights))
    rows = rows[np.argsort(states[rows], kind="stable")]
    for first in range(0, len(rows), at_once):
        some = rows[first : first + at_once]
        of = states[some]
        roots = np.sqrt(weights[of]).astype(np.float32)[:, None]
        scores = scale.standardise(codes[some])
        scores *= roots
        np.add(sums.squares, scores.T @ scores, out=sums.squares)
        scores *= roots
        begins = find_equal_runs(of)[:, 0]
        sums.shown[:, of[begins]] += np.add.reduceat(scores, begins, axis=0).T
    return sums
