"""Compiled loops of the explanations: how many clips came through each node, and votes without some of the tests.

Nodes are told by ``children`` (M,): the left child (the right child stands next to it, both behind their parent), or
``-1 - leaf``. ``relation`` (M,) is the number of the relation that a node asks about.
"""

from __future__ import annotations

import numpy as np
from numba import njit

__all__ = ["ablate", "sum_upwards"]


@njit(cache=True, nogil=True)
def sum_upwards(children, leaves, sums):
    """The sums over the leaves below every node, into ``sums`` (M,)."""
    for node in range(len(children) - 1, -1, -1):
        child = children[node]
        sums[node] = leaves[-1 - child] if child < 0 else sums[child] + sums[child + 1]


@njit(cache=True, nogil=True)
def _expect(
    root, extra, mark, children, above, other, relation, sizes, values, removed, places, weights, seen
):
    """The expected value of the leaf that both clips reach, if removed tests send them on together by lot.

    At a node that asks about a removed relation, or about ``extra``, they go to either child with the share of
    the training clips that went there; elsewhere they follow their answers, and count no more once they part.
    Relations that were asked are marked in ``seen`` with ``mark``.
    """
    expected = 0.0
    places[0], weights[0] = root, 1.0
    depth = 1
    while depth > 0:
        depth -= 1
        node, weight = places[depth], weights[depth]
        child = children[node]
        if child < 0:
            expected += weight * values[-1 - child]
            continue
        asked = relation[node]
        if removed[asked] or asked == extra:
            share = sizes[child] / sizes[node]
            places[depth], weights[depth] = child, weight * share
            places[depth + 1], weights[depth + 1] = child + 1, weight * (1.0 - share)
            depth += 2
            continue
        if mark >= 0:
            seen[asked] = mark
        if above[node] == other[node]:
            places[depth], weights[depth] = child + np.int64(above[node]), weight
            depth += 1
    return expected


@njit(cache=True, nogil=True)
def ablate(
    roots, children, above, other, relation, sizes, values, removed, places, weights, seen, without
):  # fmt: skip
    """The mean over the trees of what their leaves are worth, as it is and without each relation.

    Parameters
    ----------
    roots : (n_trees,) first node of each tree.
    above, other : (M,) the answers of two clips to the test of every node; twice the same for one clip.
    sizes : (M,) training clips at each node.
    values : (L,) what each leaf is worth: 1 where it votes for the category.
    removed : (R,) relations that are left out anyway.
    places, weights, seen : memory for (M + 2,), (M + 2,) and (R,).
    without : (R,) out: the same without this relation too.

    Returns
    -------
    The mean without the ``removed`` relations alone.
    """
    total = 0.0
    without[:] = 0.0
    seen[:] = -1
    for tree in range(len(roots)):
        root = roots[tree]
        value = _expect(
            root, -1, tree, children, above, other, relation, sizes, values, removed, places, weights, seen
        )
        total += value
        for number in range(len(without)):
            if seen[number] == tree:
                without[number] += value - _expect(
                    root, number, -1, children, above, other, relation, sizes, values, removed, places, weights,
                    seen,
                )  # fmt: skip
    for number in range(len(without)):
        without[number] = (total - without[number]) / len(roots)
    return total / len(roots)
