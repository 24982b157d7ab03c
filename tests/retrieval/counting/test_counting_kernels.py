"""What is compiled of counting: directions, orders and the best count are those of NumPy's plain ways."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from oracles.short_actions import ACTIONS, make_clip

from dousa.retrieval.counting.counter import (
    COUNTED,
    TALLIES,
    choose_count,
    describe_counts,
    find_usual,
    measure_tallies,
    use_weights,
)
from dousa.retrieval.counting.tally_kernels import find_axes, find_period, fold, sort_into, square


def find_directions(matrix: np.ndarray, count: int) -> np.ndarray:
    axes = np.empty((count, len(matrix)))
    find_axes(matrix.copy(), np.empty((6, len(matrix))), axes)
    return axes


@pytest.mark.parametrize("size", [2, 3, 14, 27])
@pytest.mark.parametrize("rank", [1, 2, 40])
@pytest.mark.parametrize("scale", [1e-9, 1.0, 1e4])
def test_directions_are_the_eigenvectors_of_the_largest_values(size, rank, scale):
    draw = np.random.default_rng(size + 100 * rank)
    curves = draw.normal(size=(size, rank)) * draw.uniform(0.2, 1.0, (size, 1)) * scale
    matrix = curves @ curves.T
    values, vectors = np.linalg.eigh(matrix)
    first, second = find_directions(matrix, 2)
    assert abs(first @ vectors[:, -1]) == pytest.approx(1.0, abs=1e-12)
    assert second @ matrix @ second == pytest.approx(values[-2], rel=1e-9, abs=1e-12 * values[-1])
    np.testing.assert_allclose([first @ first, second @ second, first @ second], [1.0, 1.0, 0.0], atol=1e-12)


@pytest.mark.parametrize(
    "matrix", [np.zeros((5, 5)), np.eye(5), np.diag([1.0, 4.0, 4.0, 2.0, 0.0]), np.full((5, 5), 3.0)]
)
def test_directions_of_equal_values_are_some_of_theirs(matrix):
    axes = find_directions(matrix, 2)
    np.testing.assert_allclose(axes @ axes.T, np.eye(2), atol=1e-12)
    expected = np.sort(np.linalg.eigvalsh(matrix))[:-3:-1]
    np.testing.assert_allclose(np.diag(axes @ matrix @ axes.T), expected, atol=1e-9)


@given(st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=70))
def test_values_are_put_in_order(values):
    ordered = np.empty(len(values))
    sort_into(np.array(values), ordered, np.empty(len(values)))
    np.testing.assert_array_equal(ordered, np.sort(values))


def test_what_both_sides_do_has_the_size_of_the_mean_with_the_mirror_image():
    draw = np.random.default_rng(0)
    poses, others = draw.normal(size=(9, 40)), np.array([0, 2, 1])  # a joint in the middle, and one on either side
    even = np.empty((5, 40))
    fold(poses, others, even)
    joints = poses.reshape(3, 3, 40)
    whole = (0.5 * (joints + joints[others] * np.array([-1.0, 1.0, 1.0])[:, None])).reshape(9, 40)
    np.testing.assert_allclose(even.T @ even, whole.T @ whole, atol=1e-12)


def test_products_are_those_of_curves_without_their_means():
    curves = np.random.default_rng(0).normal(size=(6, 50)) + np.arange(6)[:, None]
    products = np.empty((6, 6))
    square(curves, np.empty(curves.shape), products)
    np.testing.assert_allclose(products, np.cov(curves) * 49, atol=1e-9)


@pytest.mark.parametrize(
    ("likeness", "lag"),
    [
        ([1.0, 0.5, 0.0, 0.6, 0.1, 0.9, 0.2], 5),
        ([1.0, 0.5, 0.0, 0.8, 0.1, 0.9, 0.2], 3),
        ([1.0, 0.9, 1.0, 0.1, 0.0], 2),
        ([1.0, 0.1, 0.2, 0.1, 0.0], 0),
        ([1.0, 0.9, 0.8, 0.9], 0),
        ([1.0], 0),
    ],
)
def test_the_period_is_the_first_lag_that_is_nearly_the_best(likeness, lag):
    assert find_period(np.array(likeness), 2, 0.3, 0.8) == lag


def test_the_best_count_is_that_of_what_describes_all_of_them():
    draw = np.random.default_rng(3)
    known = [measure_tallies(make_clip(action, 1).positions, 1.7) for action in ACTIONS]
    for trial in range(200):
        tallies = known[trial % len(known)] * draw.integers(1, 9) * draw.uniform(0.8, 1.2, len(TALLIES))
        tallies[: len(COUNTED)] = np.rint(2.0 * tallies[: len(COUNTED)]) / 2.0
        weights = {"alone": draw.normal(size=52), "known": draw.normal(size=136)}
        with use_weights(weights):
            for usual in (None, find_usual([known[trial % len(known)]])):
                highest = max(tallies[: len(COUNTED)].max(), 0.0 if usual is None else (tallies / usual).max())
                counts = np.arange(1, min(int(1.2 * highest) + 2, 500) + 1)
                scores = describe_counts(tallies, counts, usual) @ weights["alone" if usual is None else "known"]
                found = choose_count(tallies, usual)
                assert counts[0] <= found <= counts[-1]
                assert scores[found - 1] == pytest.approx(scores.max(), abs=1e-9)
