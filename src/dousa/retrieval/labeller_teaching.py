"""What a person corrects in a take: a labeller that learns from single examples, at once.

A labeller is fitted on thousands of windows; one more clip among them says next to nothing. So an example corrects what
the labeller would have said of its windows: the differences are spread over the leaves that the windows reach, such
that windows of the examples come out right, and other windows change as far as they share leaves with them (ridge
regression of the residuals, the number of shared leaves as kernel). Clips of other categories are held fast: what is
said of them must not change.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dousa.retrieval._leaf_weights import LeafWeights
from dousa.retrieval._trees import Trees
from dousa.retrieval.labelling import TakeLabeller
from dousa.retrieval.takes import TakeWindows

__all__ = ["Example", "carry_labeller", "teach_labeller"]

_RIDGE = (
    20.0  # beside the number of trees: how far an example gives way to others and to the clips that are held
)
_MOST_WINDOWS = 1500  # of all examples together
_MOST_OF_ONE = 120
_NOTHING = 0.3  # share of the example up to which a window counts as not covering it, as in the learning


@dataclass(frozen=True, slots=True, eq=False)
class Example:
    """A part of a recording that shows one category.

    Parameters
    ----------
    windows : of the part alone, of the labeller's forest.
    category : what it shows.
    """

    windows: TakeWindows
    category: str


def teach_labeller(
    labeller: TakeLabeller, examples: Sequence[Example], held: NDArray[Any] | None = None
) -> TakeLabeller:
    """A labeller that knows examples too.

    Parameters
    ----------
    labeller : learned with the forest that described the examples.
    examples : of categories old or new. One that is shorter than every window of the labeller teaches nothing.
    held : (H, n_trees) leaves of clips of other categories; what is said of them changes as little as can be.

    Returns
    -------
    A new labeller with the same calibration; new categories come last.

    Raises
    ------
    InvalidMotionError : windows of another forest.
    """
    classes = [*labeller.classes, *dict.fromkeys(one.category for one in examples)]
    classes = list(dict.fromkeys(classes))
    wider = _with_classes(labeller, classes)
    most = max(_MOST_WINDOWS // max(len(examples), 1), 8)
    chosen = [_choose_windows(one.windows, wider, min(most, _MOST_OF_ONE)) for one in examples]
    if not any(len(leaves) for leaves, _ in chosen):
        return labeller
    n_held = 0 if held is None else len(held)
    residuals = [np.zeros((n_held, len(classes)), np.float32)]
    for (leaves, covered), one in zip(chosen, examples, strict=True):
        scores = wider.score(leaves)
        wanted = np.minimum(scores, 0.0)  # it is none of the others
        own = classes.index(one.category)
        # A short window of a long walk looks like a whole walk of somebody else: nothing is taken from the category.
        wanted[:, own] = np.maximum(covered, scores[:, own])
        residuals.append(wanted - scores)
    weights = wider.leaf_weights.weights.copy()
    reached = [*([] if held is None else [held.astype(np.int32)]), *(leaves for leaves, _ in chosen)]
    _spread(weights, np.concatenate(reached), np.concatenate(residuals))
    return replace(wider, leaf_weights=LeafWeights(weights, wider.leaf_weights.offset))


def _with_classes(labeller: TakeLabeller, classes: Sequence[str]) -> TakeLabeller:
    """The labeller with categories at its end that no leaf speaks for."""
    known = labeller.leaf_weights
    n_new = len(classes) - len(labeller.classes)
    weights = np.concatenate([known.weights, np.zeros((len(known.weights), n_new), np.float32)], axis=1)
    offset = np.concatenate([known.offset, np.full(n_new, known.offset.min(), np.float32)])
    return replace(
        labeller, classes=tuple(classes), leaf_weights=LeafWeights(np.ascontiguousarray(weights), offset)
    )


def _choose_windows(
    windows: TakeWindows, labeller: TakeLabeller, most: int
) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """Leaves (W, n_trees) of some windows of an example, and how well each covers it, 0 to 1."""
    rows = windows.rows_within(labeller.grid)
    lengths = (windows.stops[rows] - windows.starts[rows]).astype(np.float64)
    shares = lengths / lengths.max(
        initial=1.0
    )  # of an example that is longer than all windows, the longest are right
    covered = np.maximum(shares - _NOTHING, 0.0) / (1.0 - _NOTHING)
    order = np.argsort(-shares, kind="stable")
    best, rest = order[: most // 2], order[most // 2 :]
    if len(rest) > most - len(best):
        rest = rest[np.linspace(0, len(rest) - 1, most - len(best)).astype(np.int64)]
    chosen = np.concatenate([best, rest])
    return windows.leaves[rows][chosen].astype(np.int32), covered[chosen].astype(np.float32)


def _spread(weights: NDArray[np.float32], leaves: NDArray[np.int32], residuals: NDArray[np.float32]) -> None:
    """Add what is missing (W, C) to the leaves (W, n_trees) of windows."""
    from scipy.sparse import csr_matrix

    n_windows, n_trees = leaves.shape
    ends = np.arange(0, leaves.size + 1, n_trees)
    reached = csr_matrix(
        (np.ones(leaves.size), leaves.ravel(), ends), shape=(n_windows, len(weights)), dtype=np.float64
    )
    shared = (reached @ reached.T).toarray()
    shared[np.diag_indices(n_windows)] += _RIDGE
    weights += (reached.T @ np.linalg.solve(shared, residuals.astype(np.float64))).astype(np.float32)


def carry_labeller(labeller: TakeLabeller, before: Trees, after: Trees) -> TakeLabeller:
    """The labeller of a forest for what the forest has grown into; a new leaf says what the old one said.

    Parameters
    ----------
    labeller : of the trees before.
    before, after : the trees; those after are grown out of those before (`dousa.retrieval.growth`).

    Returns
    -------
    A labeller of the same categories: those that the forest has learned since must be taught.
    """
    known = labeller.leaf_weights
    weights = known.weights[_find_origins(before, after)]
    return replace(labeller, leaf_weights=LeafWeights(np.ascontiguousarray(weights), known.offset))


def _find_origins(before: Trees, after: Trees) -> NDArray[np.int64]:
    """(L,) the leaf of the trees before that each leaf of the trees after has grown out of."""
    origins = np.zeros(after.n_leaves, np.int64)
    old, new = before.roots.astype(np.int64), after.roots.astype(np.int64)
    leaf = np.full(len(old), -1, np.int64)  # of the old tree, once it is reached
    while len(new):
        children = before.nodes[old, 2]
        leaf = np.where((leaf < 0) & (children < 0), -1 - children, leaf)
        below = after.nodes[new, 2]
        ended = below < 0
        origins[-1 - below[ended]] = leaf[ended]
        goes = ~ended
        step = np.where(leaf[goes] < 0, children[goes], old[goes])
        inside = (leaf[goes] < 0).astype(np.int64)
        old = np.concatenate([step, step + inside])  # within a leaf of the old tree there is nowhere to go
        new = np.concatenate([below[goes], below[goes] + 1]).astype(np.int64)
        leaf = np.concatenate([leaf[goes], leaf[goes]])
    return origins
