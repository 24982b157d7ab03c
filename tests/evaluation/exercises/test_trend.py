"""Trends over repetitions: slope, exact test, ties."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dousa.evaluation import Trend, estimate_trend
from dousa.evaluation.exercises.repetitions import adjust_for_many


def brute_p_value(values: list[float]) -> float:
    """Share of all orders with a score at least as far from 0."""

    def score(order: tuple[float, ...]) -> int:
        return int(sum(np.sign(b - a) for a, b in itertools.combinations(order, 2)))

    here = abs(score(tuple(values)))
    orders = list(itertools.permutations(values))
    return sum(abs(score(order)) >= here for order in orders) / len(orders)


@given(st.permutations(list(range(6))))
def test_the_exact_test_counts_orders(order: list[int]) -> None:
    assert estimate_trend(order).p_value == pytest.approx(brute_p_value([float(v) for v in order]))


def test_a_steady_rise_of_five_can_be_told_from_chance_and_of_four_it_cannot() -> None:
    five, four = estimate_trend([1.0, 1.2, 1.4, 1.6, 1.8]), estimate_trend([1.0, 1.2, 1.4, 1.6])
    assert five.slope == pytest.approx(0.2)
    assert five.p_value == pytest.approx(2 / math.factorial(5))
    assert five.distinguishable
    assert four.p_value == pytest.approx(2 / math.factorial(4))
    assert not four.distinguishable


def test_one_outlier_does_not_move_the_slope() -> None:
    assert estimate_trend([1.0, 2.0, 3.0, 400.0, 5.0, 6.0, 7.0]).slope == pytest.approx(1.0)


def test_a_missing_value_keeps_its_place() -> None:
    found = estimate_trend([1.0, math.nan, 3.0, 4.0])
    assert found.slope == pytest.approx(1.0)
    assert found.n == 3


@pytest.mark.parametrize("values", [[], [3.0], [math.nan, 1.0]])
def test_less_than_two_values_have_no_trend(values: list[float]) -> None:
    found = estimate_trend(values)
    assert math.isnan(found.slope)
    assert not found.distinguishable


def test_equal_values_have_no_trend() -> None:
    found = estimate_trend([2.0] * 8)
    assert (found.slope, found.p_value) == (0.0, 1.0)


def test_chance_alone_is_called_a_trend_no_more_often_than_it_says() -> None:
    rng = np.random.default_rng(4)
    called = [estimate_trend(rng.normal(size=8)).distinguishable for _ in range(600)]
    assert np.mean(called) <= 0.05 + 3 * math.sqrt(0.05 * 0.95 / 600)


def test_many_measures_of_chance_are_called_a_trend_together_in_one_recording_of_twenty() -> None:
    rng = np.random.default_rng(7)
    called = []
    for _ in range(300):
        trends = {str(measure): estimate_trend(rng.normal(size=8)) for measure in range(12)}
        called.append(any(trend.distinguishable for trend in adjust_for_many(trends).values()))
    assert np.mean(called) <= 0.05 + 3 * math.sqrt(0.05 * 0.95 / 300)


def test_the_adjustment_by_hand() -> None:
    trends = {name: Trend(1.0, p, 9) for name, p in (("a", 0.01), ("b", 0.04), ("c", 0.03), ("d", math.nan))}
    adjusted = adjust_for_many(trends)
    assert [adjusted[name].adjusted_p for name in "abc"] == pytest.approx([0.03, 0.06, 0.06])
    assert math.isnan(adjusted["d"].adjusted_p)
    assert [adjusted[name].distinguishable for name in "abcd"] == [True, False, False, False]
