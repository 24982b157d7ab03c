"""The learned judge: boosted trees, and errors decoded from their probabilities."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from dousa.evaluation.errors.judge import BODY_CLASSES, LIMB_CLASSES, BoostedTrees, Decoding, decode, follow_classes


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


RATE = 15.0
PLAIN = Decoding(change=2.0, shortest_s=0.25, surest=0.0)


def make_logs(
    limbs: dict[tuple[int, str], tuple[int, int]], body: dict[str, tuple[int, int]], n: int = 60, sure: float = 0.9
) -> tuple[np.ndarray, np.ndarray]:
    """Log probabilities where classes are sure in spans of moments and nothing is wrong elsewhere."""
    by_limb, whole = np.full((n, 5, 4), 0.02), np.full((n, 4), 0.02)
    by_limb[:, :, 0], whole[:, 0] = sure, sure
    for (limb, name), (start, end) in limbs.items():
        by_limb[start:end, limb] = 0.02
        by_limb[start:end, limb, LIMB_CLASSES.index(name)] = sure
    for name, (start, end) in body.items():
        whole[start:end] = 0.02
        whole[start:end, BODY_CLASSES.index(name)] = sure
    return np.log(by_limb), np.log(whole)


def test_nothing_wrong_is_no_error() -> None:
    assert decode(*make_logs({}, {}), RATE, PLAIN) == []


def test_an_error_has_its_span_and_limb() -> None:
    (found,) = decode(*make_logs({(1, "partial"): (10, 30)}, {}), RATE, PLAIN)
    assert (found.kind, found.start, found.end, found.limbs) == ("partial", 10, 30, (1,))
    assert found.segments == (1, 2)


def test_limbs_that_err_alike_together_are_one_error() -> None:
    logs = make_logs({(1, "shift"): (10, 30), (2, "shift"): (12, 31), (3, "partial"): (12, 31)}, {})
    both, leg = sorted(decode(*logs, RATE, PLAIN), key=lambda one: one.limbs)
    assert (both.kind, both.limbs, both.start, both.end) == ("shift", (1, 2), 10, 31)
    assert (leg.kind, leg.limbs) == ("partial", (3,))


def test_the_body_explains_limbs_but_not_another_class() -> None:
    logs = make_logs({(1, "shift"): (10, 30), (2, "partial"): (10, 30)}, {"shift": (8, 32)})
    body, limb = decode(*logs, RATE, PLAIN)
    assert (body.kind, body.limbs) == ("shift", (0, 1, 2, 3, 4))
    assert (limb.kind, limb.limbs) == ("partial", (2,))
    (only,) = decode(*make_logs({(2, "partial"): (10, 30)}, {"global": (8, 32)}), RATE, PLAIN)
    assert only.kind == "global"


def test_a_flicker_is_bridged_and_a_short_error_is_none() -> None:
    limbs, body = make_logs({(1, "partial"): (10, 30)}, {})
    limbs[20, 1] = np.log([0.6, 0.1, 0.1, 0.2])
    (found,) = decode(limbs, body, RATE, PLAIN)
    assert (found.start, found.end) == (10, 30)
    assert decode(*make_logs({(1, "partial"): (10, 13)}, {}), RATE, PLAIN) == []


def worth(course: tuple[int, ...], scores: np.ndarray, change: float) -> float:
    changes = sum(a != b for a, b in itertools.pairwise(course))
    return float(sum(scores[t, c] for t, c in enumerate(course))) - change * changes


def test_the_course_is_the_best_of_all() -> None:
    rng = np.random.default_rng(1)
    for _ in range(20):
        scores, change = rng.standard_normal((6, 3)), float(rng.uniform(0.2, 2.0))
        best = max(worth(course, scores, change) for course in itertools.product(range(3), repeat=6))
        found = tuple(int(c) for c in follow_classes(scores, change))
        assert worth(found, scores, change) == pytest.approx(best)
