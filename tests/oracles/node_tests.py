"""The tests of a forest's nodes, read and evaluated one by one: what the compiled way down must do."""

from typing import NamedTuple

import numpy as np

from dousa.retrieval.features.feature_sets import MEAN, SPREAD, TREND, integrate
from dousa.retrieval.forest.trees import KIND_NAMES


class Test(NamedTuple):
    """A test over cells ``start`` ... ``stop`` - 1; the partner of a mean is its column."""

    kind: int
    column: int
    partner: int
    start: int
    stop: int
    threshold: float


class Decision(NamedTuple):
    """One test of a tree on a clip, and its result."""

    tree: int
    node: int
    feature: str
    kind: str
    start: int
    stop: int
    threshold: float
    value: float


def read_test(trees, node):
    width = trees.n_frames + 1
    later, sooner, partner = int(trees.nodes[node, 0]), int(trees.nodes[node, 1]), int(trees.nodes[node, 3])
    column, stop = divmod(later, width)
    start, cut = sooner % width, float(trees.cuts[node, 2])
    if partner == 0:
        return Test(MEAN, column, column, start, stop, cut / (stop - start))
    return Test(SPREAD if partner > 0 else TREND, column, column + abs(partner) // width, start, stop, cut)


def evaluate_test(integrals, test):
    """The value of a test for one clip, from its integrals (F, T + 1)."""
    length = test.stop - test.start
    difference = integrals[test.column, test.stop] - integrals[test.column, test.start]
    if test.kind == MEAN:
        return float(difference / length)
    other = integrals[test.partner, test.stop] - integrals[test.partner, test.start]
    if test.kind == SPREAD:
        return float(np.sqrt(max(other / length - (difference / length) ** 2, 0.0)))
    return float(12.0 * (other - 0.5 * (test.start + test.stop) * difference) / length**2)


def decide(forest, clip):
    """Every test of one clip (T, F) on its way down all trees, in order."""
    trees, integrals, asked = forest.trees_, integrate(clip[None])[0], []
    for tree, root in enumerate(trees.roots):
        node = int(root)
        while trees.nodes[node, 2] >= 0:
            test = read_test(trees, node)
            value = evaluate_test(integrals, test)
            name, kind = forest.feature_names_[test.column], KIND_NAMES[test.kind]
            asked.append(Decision(tree, node, name, kind, test.start, test.stop, test.threshold, value))
            node = int(trees.nodes[node, 2]) + bool(value > test.threshold)
    return asked
