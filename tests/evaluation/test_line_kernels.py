"""The compiled loops find the cheapest of all courses, known courses, and the smallest inputs."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from oracles.line_courses import (
    best_switching,
    cheapest_lag,
    cheapest_lines,
    price_of_lag,
    price_of_lines,
    worth_of_switching,
)

from dousa.evaluation._line_kernels import extend_lines, follow_lag, follow_lines, switch_on

QUICK = settings(max_examples=60, deadline=None)
SHARES = st.floats(0.0, 1.0, width=32)
# Few values make ties, which are where a back-pointer goes wrong.
COARSE = st.sampled_from([0.0, 0.25, 0.5, 1.0])
PRICES = st.sampled_from([0.0, 0.1, 0.35, 0.8, 2.5, 1e9])


def draw_cost(data: st.DataObject, most_frames: int, most_columns: int) -> np.ndarray:
    shape = data.draw(st.tuples(st.integers(1, most_frames), st.integers(1, most_columns)))
    return data.draw(arrays(np.float64, shape, elements=data.draw(st.sampled_from([SHARES, COARSE]))))


@given(data=st.data(), slope=PRICES)
@QUICK
def test_the_lag_course_is_the_cheapest_of_all(data: st.DataObject, slope: float) -> None:
    cost = draw_cost(data, 6, 4)
    course = follow_lag(cost, slope)
    assert course.shape == (len(cost),)
    assert price_of_lag(cost, slope, course) == pytest.approx(cheapest_lag(cost, slope))


@given(data=st.data(), price=PRICES)
@QUICK
def test_the_on_and_off_sequence_is_the_best_of_all(data: st.DataObject, price: float) -> None:
    values = st.one_of(st.floats(-3.0, 3.0, width=32), st.sampled_from([-1.0, 0.0, 1.0]))
    score = data.draw(arrays(np.float64, data.draw(st.integers(1, 10)), elements=values))
    states = switch_on(score, price)
    assert states.shape == score.shape and states.dtype == bool
    assert worth_of_switching(score, price, states) == pytest.approx(best_switching(score, price), abs=1e-9)


@given(data=st.data(), jump=PRICES, pause=PRICES, outside=SHARES)
@QUICK
def test_the_lines_are_the_cheapest_of_all(
    data: st.DataObject, jump: float, pause: float, outside: float
) -> None:
    cost = draw_cost(data, 5, 4)
    path = follow_lines(cost, jump, pause, outside)
    assert path.shape == (len(cost),)
    expected = cheapest_lines(cost, jump, pause, outside)
    assert price_of_lines(cost, jump, pause, outside, path) == pytest.approx(expected)


def test_a_line_is_followed_from_end_to_end() -> None:
    cost = 1.0 - np.eye(12)
    assert np.array_equal(follow_lines(cost, 25.0, 1e9, 0.75), np.arange(12))


def test_a_line_has_an_outside_before_and_after() -> None:
    cost = np.ones((20, 8))
    cost[np.arange(5, 13), np.arange(8)] = 0.0
    path = follow_lines(cost, 25.0, 1e9, 0.75)
    assert np.array_equal(path, [-1] * 5 + list(range(8)) + [-1] * 7)


def test_a_jump_joins_two_lines_where_it_is_worth_its_price() -> None:
    cost = np.ones((35, 80))
    cost[np.arange(20), np.arange(20)] = 0.0
    cost[np.arange(20, 35), np.arange(50, 65)] = 0.0
    assert np.array_equal(follow_lines(cost, 5.0, 1e9, 0.75), [*range(20), *range(50, 65)])
    # Dearer than being outside for the rest.
    assert np.array_equal(follow_lines(cost, 30.0, 1e9, 0.75), [*range(20), *[-1] * 15])


def test_a_slower_course_pauses() -> None:
    here = np.arange(30)
    cost = 1.0 - (here[:, None] // 2 == np.arange(15))
    assert np.array_equal(follow_lines(cost, 25.0, 0.35, 0.9), here // 2)


def test_nothing_in_common_is_outside_throughout() -> None:
    assert (follow_lines(np.ones((9, 7)), 25.0, 1e9, 0.75) == -1).all()


def test_a_lag_that_grows_is_followed() -> None:
    expected = np.repeat([3, 4, 5, 6, 5], 10)
    cost = 4.0 * np.abs(np.arange(9) - expected[:, None])
    assert np.array_equal(follow_lag(cost, 2.0), expected)
    # A change that costs more than it explains is not made.
    assert len(set(follow_lag(cost, 1e3))) == 1


def test_a_stretch_must_be_worth_two_changes() -> None:
    score = np.full(30, -1.0)
    score[10:20] = 1.5
    assert np.array_equal(np.flatnonzero(switch_on(score, 7.0)), np.arange(10, 20))
    assert not switch_on(score, 8.0).any()
    # Also at the ends of the recording.
    assert switch_on(np.full(5, 1.0), 2.0).all()
    assert not switch_on(np.full(5, 1.0), 3.0).any()


@pytest.mark.parametrize("cuts", [(60,), (1, 2, 30, 59), tuple(range(1, 60))])
def test_lines_that_are_carried_on_are_those_of_the_whole(cuts: tuple[int, ...]) -> None:
    rng = np.random.default_rng(len(cuts))
    cost = rng.uniform(0.3, 1.0, (60, 50))
    cost[np.arange(5, 30), np.arange(5, 30)] = 0.02
    cost[np.arange(32, 55), np.arange(20, 43)] = 0.02
    best, outside = np.full(50, np.inf), np.zeros(2)
    origin, ended = np.empty((60, 50), np.int32), np.empty(60, np.int32)
    first = 0
    for last in sorted({*cuts, 60}):
        part = slice(first, last)
        extend_lines(cost[part], best, outside, 5.0, 1e9, 0.75, origin[part], ended[part])
        first = last
    path, row, place = np.full(60, -1), 59, int(best.argmin())
    if outside[1] < best[place]:
        while ended[row] == -2:
            row -= 1
        place, row = int(ended[row]), row - 1
    while row >= 0 and place >= 0:
        path[row] = place
        place, row = int(origin[row, place]), row - 1
    np.testing.assert_array_equal(path, follow_lines(cost, 5.0, 1e9, 0.75))
