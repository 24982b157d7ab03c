"""Trees in arrays say what the trees say that they were made from."""

from __future__ import annotations

import numpy as np
import pytest

from dousa.evaluation.errors.judge import BoostedTrees


def test_exported_trees_answer_as_scikit_learn_does() -> None:
    ensemble = pytest.importorskip("sklearn.ensemble")
    from lab.training.judge_trees import export_trees

    rng = np.random.default_rng(0)
    features = rng.standard_normal((600, 6)).astype(np.float32)
    classes = (features[:, 0] * features[:, 1] > 0).astype(int) + 2 * (features[:, 2] > 0.5)
    model = ensemble.HistGradientBoostingClassifier(max_iter=12, max_leaf_nodes=8).fit(features, classes)
    trees = export_trees(model)
    assert np.exp(trees.predict_log_proba(features)) == pytest.approx(model.predict_proba(features), abs=1e-5)
    again = BoostedTrees.from_arrays(trees.to_arrays("a"), "a")
    assert (again.predict_log_proba(features) == trees.predict_log_proba(features)).all()


def test_a_stump_by_hand() -> None:
    """One round, two classes, one question each: x <= 1 speaks for the first class."""
    trees = BoostedTrees(
        feature=np.zeros(6, np.uint16),
        threshold=np.array([1.0, 2.0, 0.0, 1.0, 0.0, 2.0], np.float32),
        left=np.array([1, -1, -1, 4, -1, -1], np.int32),
        right=np.array([2, -1, -1, 5, -1, -1], np.int32),
        roots=np.array([[0, 3]], np.int32),
        start=np.array([0.5, 0.0]),
    )
    logits = np.array([[2.5, 0.0], [0.5, 2.0]])
    expected = logits - np.log(np.exp(logits).sum(axis=1, keepdims=True))
    assert trees.predict_log_proba([[1.0], [1.1]]) == pytest.approx(expected)
