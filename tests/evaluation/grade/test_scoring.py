"""The grade: identity, the spread of the takes, missing values, both languages."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dousa.errors import InvalidMotionError
from dousa.evaluation.grade.score import UNCALIBRATED_SPREAD, compute_deviation, compute_score

degrees = st.floats(0.0, 60.0)


def test_deviation_is_the_mean_of_the_root_mean_square_in_degrees() -> None:
    residual = np.radians(np.array([[10.0] * 9, [20.0] * 9]))
    assert compute_deviation(residual) == pytest.approx(15.0)
    one_limb = np.zeros((3, 9))
    one_limb[:, 4] = np.radians(30.0)
    assert compute_deviation(one_limb) == pytest.approx(10.0)


def test_deviation_follows_the_weights() -> None:
    residual = np.zeros((4, 9))
    residual[:, 4] = np.radians(30.0)
    weights = np.ones(9)
    weights[4] = 0.0
    assert compute_deviation(residual, weights) == 0.0
    assert compute_deviation(residual, 5.0 * np.ones(9)) == pytest.approx(10.0)
    assert compute_deviation(residual, np.eye(9)[4]) == pytest.approx(30.0)


def test_what_is_not_seen_does_not_count() -> None:
    residual = np.radians(np.full((5, 9), 12.0))
    residual[0] = np.nan
    residual[2, 3:] = np.nan
    assert compute_deviation(residual) == pytest.approx(12.0)
    assert np.isnan(compute_deviation(np.full((5, 9), np.nan)))
    assert np.isnan(compute_deviation(np.empty((0, 9))))
    # Seen only where nothing weighs.
    only_trunk = np.full((5, 9), np.nan)
    only_trunk[:, 0] = 0.1
    assert np.isnan(compute_deviation(only_trunk, np.eye(9)[1]))


@pytest.mark.parametrize("shape", [(9,), (4, 8), (2, 4, 9)])
def test_other_shapes_are_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(InvalidMotionError, match="frames, 9"):
        compute_deviation(np.zeros(shape))


@pytest.mark.parametrize("takes", [[], [8.0], [8.0, 9.0, 7.5]])
def test_no_deviation_is_100(takes: list[float]) -> None:
    assert compute_score(0.0, takes)[0] == 100.0


def test_ten_points_for_each_standard_deviation_beyond_the_mean_of_the_takes() -> None:
    takes = [6.0, 8.0, 10.0]  # mean 8
    # Squares about the mean, the usual spread of 4 deg as one take more, over three.
    spread = ((4.0 + 0.0 + 4.0 + UNCALIBRATED_SPREAD**2) / 3.0) ** 0.5
    assert compute_score(8.0, takes)[0] == 100.0
    assert compute_score(8.0 + spread, takes)[0] == pytest.approx(90.0)
    assert compute_score(8.0 + 3.5 * spread, takes)[0] == pytest.approx(65.0)
    assert compute_score(100.0, takes)[0] == 0.0
    assert compute_score(15.0, takes)[2]


@pytest.mark.parametrize("takes", [[], [8.0], [8.0, float("nan")]])
def test_too_few_takes_are_not_calibrated(takes: list[float]) -> None:
    score, formula, calibrated = compute_score(2.0 * UNCALIBRATED_SPREAD, takes)
    assert score == pytest.approx(80.0)
    assert not calibrated
    assert "not calibrated" in str(formula)


def test_takes_that_happen_to_agree_do_not_make_the_grade_mad() -> None:
    assert compute_score(10.5, [10.0, 10.0])[0] > 95.0
    assert compute_score(0.5, [0.0, 0.0, 0.0, 0.0])[0] > 95.0


def test_nothing_to_compare_is_0_and_says_so() -> None:
    score, formula, _ = compute_score(float("nan"), [5.0, 6.0])
    assert score == 0.0
    assert "no moment" in str(formula)


def test_the_formula_holds_its_numbers() -> None:
    said = compute_score(10.0, [6.0, 8.0, 10.0])[1]
    formula, japanese = said.render("en"), said.render("ja")
    assert formula.startswith("100 - 10 x (10.0 - 8.0) / 2.8 = 92.9")
    assert "3 other takes" in formula
    assert japanese.startswith("100 - 10 × (10.0 - 8.0) / 2.8 = 92.9")
    assert "3テイク" in japanese
    assert "未校正" in compute_score(10.0, [])[1].render("ja")
    assert "limited to the range 0 to 100: 0" in str(compute_score(90.0, [])[1])


@given(degrees, degrees, st.lists(degrees, max_size=6))
def test_a_larger_deviation_never_scores_better(one: float, other: float, takes: list[float]) -> None:
    low, high = sorted([one, other])
    better, worse = compute_score(low, takes)[0], compute_score(high, takes)[0]
    assert 0.0 <= worse <= better <= 100.0
