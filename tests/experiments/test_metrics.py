"""Scores against scikit-learn, and the cases that are known beforehand."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dousa.errors import OptionError
from dousa.experiments.metrics import Scores, compute_confusion_matrix, compute_scores, list_confusions

pairs = st.lists(st.tuples(st.sampled_from("abcdef"), st.sampled_from("abcdefxy")), min_size=1, max_size=60)


@settings(max_examples=150, deadline=None)
@given(pairs)
def test_scores_are_those_of_scikit_learn(pairs: list[tuple[str, str]]) -> None:
    metrics = pytest.importorskip("sklearn.metrics")
    truth, predicted = (list(column) for column in zip(*pairs, strict=True))
    precision, recall, f_measure, _ = metrics.precision_recall_fscore_support(
        truth, predicted, labels=np.unique(truth), average="macro", zero_division=0
    )
    scores = compute_scores(truth, predicted)
    assert scores.recall == pytest.approx(recall)
    assert scores.precision == pytest.approx(precision)
    assert scores.f_measure == pytest.approx(f_measure)
    assert scores.accuracy == pytest.approx(metrics.accuracy_score(truth, predicted))
    matrix, categories = compute_confusion_matrix(truth, predicted)
    if len(categories) > 1:  # scikit-learn warns of a matrix of one
        np.testing.assert_array_equal(matrix, metrics.confusion_matrix(truth, predicted, labels=categories))


def test_perfect_scores() -> None:
    assert compute_scores(["a", "b", "b"], ["a", "b", "b"]) == Scores(1.0, 1.0, 1.0, 1.0)
    assert list_confusions(["a", "b"], ["a", "b"]) == ()


def test_all_wrong_and_never_predicted() -> None:
    assert compute_scores(["a", "b"], ["b", "c"]) == Scores(0.0, 0.0, 0.0, 0.0)


def test_a_worked_example() -> None:
    # a: 1 of 2 found, all 1 named right; b: 2 of 2 found, 2 of 3 named right
    scores = compute_scores(["a", "a", "b", "b"], ["a", "b", "b", "b"])
    assert scores.recall == pytest.approx(0.75)
    assert scores.precision == pytest.approx((1 + 2 / 3) / 2)
    assert scores.f_measure == pytest.approx((2 / 3 + 4 / 5) / 2)
    assert scores.accuracy == pytest.approx(0.75)


def test_nothing_to_score() -> None:
    assert compute_scores([], []) == Scores(0.0, 0.0, 0.0, 0.0)
    matrix, categories = compute_confusion_matrix([], [])
    assert matrix.shape == (0, 0) and len(categories) == 0
    assert list_confusions([], []) == ()


def test_worst_confusions_come_first() -> None:
    truth = ["a"] * 4 + ["b"] * 2 + ["c"] * 9
    predicted = ["b", "b", "c", "a"] + ["a", "a"] + ["c"] * 8 + ["a"]
    found = list_confusions(truth, predicted)
    assert [(one.truth, one.predicted, one.count) for one in found] == [
        ("b", "a", 2),
        ("a", "b", 2),
        ("a", "c", 1),
        ("c", "a", 1),
    ]
    assert found[0].share == 1.0 and found[3].share == pytest.approx(1 / 9)
    assert len(list_confusions(truth, predicted, limit=2)) == 2


@pytest.mark.parametrize(("truth", "predicted"), [(["a"], []), ([["a"]], [["a"]]), (["a", "b"], ["a"])])
def test_unequal_input_is_refused(truth: list, predicted: list) -> None:
    with pytest.raises(OptionError, match="one true and one predicted"):
        compute_scores(truth, predicted)
