"""Known or unknown and growing leaves, word for word in plain Python, without any speed."""

import math

import numpy as np

from dousa.retrieval.forest.pose_space import fit_pose_basis


def votes_for(forest, leaves, category):
    """Share of the trees whose leaf has most clips of a category, the first of equals."""
    named = 0
    for leaf in leaves:
        counts = leaf_counts(forest, leaf)
        best = max(counts.values())
        named += min(name for name, count in counts.items() if count == best) == category
    return named / len(leaves)


def leaf_counts(forest, leaf):
    """Clips of each category in a leaf."""
    trees = forest.trees_
    return {
        str(forest.classes_[trees.leaf_classes[k]]): int(trees.leaf_counts[k])
        for k in range(trees.leaf_starts[leaf], trees.leaf_starts[leaf + 1])
    }


def share_of_company(leaves, others):
    """Mean over the trees of the share of other clips that stand in the same leaf."""
    together = [sum(other[t] == leaf for other in others) / len(others) for t, leaf in enumerate(leaves)]
    return sum(together) / len(together)


def company_scores(leaves, category, stored, categories):
    """Company of clips of a category, in proportion to what its own clips have of each other."""
    own = [row for row, name in zip(stored, categories, strict=True) if name == category]
    usual = [share_of_company(row, own[:k] + own[k + 1 :]) for k, row in enumerate(own)]
    return share_of_company(leaves, own) / (sum(usual) / len(usual))


def area_under_curve(scores, positive):
    """Over all pairs of a positive and a negative: is the positive higher? Equals count half."""
    pairs = [
        1.0 if p > n else 0.5 if p == n else 0.0
        for p, yes in zip(scores, positive, strict=True)
        if yes
        for n, other in zip(scores, positive, strict=True)
        if not other
    ]
    return sum(pairs) / len(pairs)


def path_of(trees, values):
    """Nodes on the way down the first tree, given a function that answers a node's test, and the leaf."""
    node, path = int(trees.roots[0]), []
    while trees.nodes[node, 2] >= 0:
        path.append(node)
        node = int(trees.nodes[node, 2]) + bool(values(node))
    return path, -1 - int(trees.nodes[node, 2])


def middle_of(points):
    """The mean of some points."""
    return [sum(values) / len(points) for values in zip(*points, strict=True)]


def cosine(one, other):
    """Of the angle between two points, seen from the origin."""
    dot = sum(a * b for a, b in zip(one, other, strict=True))
    return dot / math.sqrt(sum(a * a for a in one) * sum(b * b for b in other))


def fit_pose_space(features, categories, feature_set=None, others=None):
    """The space of clips (N, T, F) of categories (N,), beside motions of no category."""
    parts = [features] if others is None else [features, others]
    basis = fit_pose_basis(parts, feature_set)
    return basis.fit(np.concatenate([basis.place(part) for part in parts]), categories)


def compare(space, features, categories):
    """The cosine (N,) of each clip with its category."""
    cosines = space.compare_all(space.place(features))
    return cosines[np.arange(len(cosines)), np.searchsorted(space.categories, categories)]
