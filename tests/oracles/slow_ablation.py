"""What a forest would vote if it knew nothing of some columns: every branch walked, word by word."""

from oracles.node_tests import evaluate_test, read_test

from dousa.retrieval.features.feature_sets import integrate


def count_clips(trees, node):
    """Training clips of each category below a node."""
    child = int(trees.nodes[node, 2])
    if child >= 0:
        return [a + b for a, b in zip(count_clips(trees, child), count_clips(trees, child + 1), strict=True)]
    counts = [0] * trees.n_classes
    for entry in range(trees.leaf_starts[-1 - child], trees.leaf_starts[-child]):
        counts[trees.leaf_classes[entry]] += int(trees.leaf_counts[entry])
    return counts


def expect(trees, node, clips, is_removed, worth):
    """The expected worth of the leaf that all clips reach together below a node; nothing once they part."""
    child = int(trees.nodes[node, 2])
    if child < 0:
        return worth(node, count_clips(trees, node))
    test = read_test(trees, node)
    if is_removed(test.column):
        sizes = [sum(count_clips(trees, child + side)) for side in (0, 1)]
        return sum(sizes[side] / sum(sizes) * expect(trees, child + side, clips, is_removed, worth) for side in (0, 1))
    answers = {bool(evaluate_test(integrals, test) > test.threshold) for integrals in clips}
    return expect(trees, child + answers.pop(), clips, is_removed, worth) if len(answers) == 1 else 0.0


def vote_without(forest, clip, category, removed):
    """Share of the trees that name a category, without the columns in ``removed``."""
    number = forest.classes_.tolist().index(category)

    def worth(_, counts):
        return float(counts.index(max(counts)) == number)

    return _mean(forest, [clip], removed, worth)


def alike_without(forest, one, other, removed):
    """Share of the trees in which two clips end in one leaf, without the columns in ``removed``."""
    return _mean(forest, [one, other], removed, lambda node, counts: 1.0)


def _mean(forest, clips, removed, worth):
    trees = forest.trees_
    integrals = [integrate(clip[None])[0] for clip in clips]
    values = [expect(trees, int(root), integrals, lambda column: column in removed, worth) for root in trees.roots]
    return sum(values) / len(values)
