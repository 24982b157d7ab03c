"""The compiled loops find the cheapest of all courses, known courses, and the smallest inputs."""

from collections.abc import Sequence

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

from dousa.evaluation import compute_correlation_matrix
from dousa.evaluation.alignment.dynamic_programming import (
    accumulate_likeness,
    compare_stretches,
    compute_gains,
    extend_lines,
    find_ends,
    follow_lag,
    join_steps,
    switch_on,
    trace_lines,
    trace_repeats,
)

QUICK = settings(max_examples=60, deadline=None)
SHARES = st.floats(0.0, 1.0, width=32)
# Few values make ties, which are where a back-pointer goes wrong.
COARSE = st.sampled_from([0.0, 0.25, 0.5, 1.0])
PRICES = st.sampled_from([0.0, 0.1, 0.35, 0.8, 2.5, 1e9])


def draw_cost(data: st.DataObject, most_frames: int, most_columns: int) -> np.ndarray:
    shape = data.draw(st.tuples(st.integers(1, most_frames), st.integers(1, most_columns)))
    return data.draw(arrays(np.float64, shape, elements=data.draw(st.sampled_from([SHARES, COARSE]))))


def follow(cost: np.ndarray, jump: float, pause: float, outside: float) -> np.ndarray:
    return carry_on([cost], jump, pause, outside)


def carry_on(blocks: Sequence[np.ndarray], jump: float, pause: float, outside: float, kept: int = 0) -> np.ndarray:
    """The course of the kept frames, carried on block by block."""
    best, away = np.full(blocks[0].shape[1], np.inf), np.zeros(2)
    steps = join_steps([extend_lines(block, best, away, jump, pause, outside) for block in blocks], kept)
    return trace_lines(best, away, steps)


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
def test_the_lines_are_the_cheapest_of_all(data: st.DataObject, jump: float, pause: float, outside: float) -> None:
    cost = draw_cost(data, 5, 4)
    path = follow(cost, jump, pause, outside)
    assert path.shape == (len(cost),)
    expected = cheapest_lines(cost, jump, pause, outside)
    assert price_of_lines(cost, jump, pause, outside, path) == pytest.approx(expected)


def test_a_line_has_an_outside_before_and_after() -> None:
    cost = np.ones((20, 8))
    cost[np.arange(5, 13), np.arange(8)] = 0.0
    path = follow(cost, 25.0, 1e9, 0.75)
    assert np.array_equal(path, [-1] * 5 + list(range(8)) + [-1] * 7)


def test_a_jump_joins_two_lines_where_it_is_worth_its_price() -> None:
    cost = np.ones((35, 80))
    cost[np.arange(20), np.arange(20)] = 0.0
    cost[np.arange(20, 35), np.arange(50, 65)] = 0.0
    assert np.array_equal(follow(cost, 5.0, 1e9, 0.75), [*range(20), *range(50, 65)])
    # Dearer than being outside for the rest.
    assert np.array_equal(follow(cost, 30.0, 1e9, 0.75), [*range(20), *[-1] * 15])


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
    blocks = np.split(cost, cuts)
    whole = follow(cost, 5.0, 1e9, 0.75)
    # A course is traced through the frames that are kept; it does not depend on those before.
    for kept in (0, 40):
        np.testing.assert_array_equal(carry_on(blocks, 5.0, 1e9, 0.75, kept), whole[-kept:])


def similarity_of(seed: int, n: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    poses = np.cumsum(rng.normal(size=(n, 9, 3)), axis=0) * 0.2 + rng.normal(size=(9, 3))
    poses /= np.linalg.norm(poses, axis=-1, keepdims=True)
    return compute_correlation_matrix(poses, poses)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 999), st.integers(3, 30), st.integers(1, 6))
def test_contrast_is_that_of_plain_means(seed: int, n: int, radius: int) -> None:
    similarity = similarity_of(seed, n)
    gains = np.concatenate([*compute_gains(similarity, radius, 0.01, 10.0, at_once=7)])
    away = 1.0 - similarity.astype(float)
    for i in range(n):
        assert not gains[i, : i + 1].any()
        for j in range(i + 1, n):
            sides = {
                "left": away[i, max(0, j - radius) : j],
                "right": away[i, j + 1 : j + 1 + radius],
                "above": away[max(0, i - radius) : i, j],
                "below": away[i + 1 : i + 1 + radius, j],
            }
            mean = {name: s.mean() for name, s in sides.items() if 2 * len(s) > radius or name in ("left", "below")}
            beside = min(mean["left"], mean.get("right", np.inf))
            ahead = min(mean["below"], mean.get("above", np.inf))
            wanted = np.log((0.5 * (beside + ahead) + 0.01) / (max(away[i, j], 0.0) + 0.01))
            assert gains[i, j] == pytest.approx(wanted, abs=1e-3)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 999), st.integers(2, 12), st.integers(2, 12))
def test_stretches_are_compared_by_warping(seed: int, rows: int, columns: int) -> None:
    similarity = similarity_of(seed, rows + columns)
    apart, within = compare_stretches(similarity, np.array([0, rows, rows + columns]), 100.0)
    away = np.maximum(1.0 - similarity.astype(float), 0.0)

    def best(i: int, j: int) -> float:
        if i < 0 or j < 0:
            return np.inf
        if (i, j) not in known:
            cost = away[i, rows + j]
            steps = best(i - 1, j - 1) + 2 * cost, best(i - 1, j) + cost, best(i, j - 1) + cost
            known[i, j] = 2 * cost if i == j == 0 else min(steps)
        return known[i, j]

    known: dict[tuple[int, int], float] = {}
    assert apart[0, 1] == apart[1, 0] == pytest.approx(best(rows - 1, columns - 1) / (rows + columns), abs=1e-6)
    assert within[0, 0] == pytest.approx((1.0 - similarity[:rows, :rows].astype(float)).mean(), abs=1e-5)
    limited, _ = compare_stretches(similarity, np.array([0, rows, rows + columns]), 1.1)
    ratio = max(rows, columns) / min(rows, columns)
    assert np.isinf(limited[0, 1]) == (ratio > 1.1 + 1e-9) or ratio == pytest.approx(1.1)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 999), st.integers(4, 24), st.integers(2, 5))
def test_likeness_is_that_of_the_plain_recurrence(seed: int, n: int, min_lag: int) -> None:
    similarity = similarity_of(seed, n)
    gains = np.concatenate([*compute_gains(similarity, 3, 0.01, 10.0)])
    moving = np.random.default_rng(seed).uniform(0.0, 1.0, n)
    toll, tolerated = 0.2, 0.3
    score, step = accumulate_likeness(similarity, np.array_split(gains, 3), moving, min_lag, toll, tolerated, np.inf)
    wanted = np.zeros((n, n))
    for i in range(n):
        for j in range(i + min_lag, n):
            away = 1.0 - float(similarity[i, j])
            gain = moving[i] * moving[j] * float(gains[i, j]) - toll
            gain -= min(max(away - tolerated, 0.0) / tolerated, 2.0)
            ways = [0.0]
            ways += [wanted[i - 1, j - 1]] if i >= 1 else []
            ways += [wanted[i - 2, j - 1] - toll] if i >= 2 else []
            ways += [wanted[i - 1, j - 2] - toll] if i >= 1 else []
            wanted[i, j] = max(max(ways) + gain, 0.0)
    np.testing.assert_allclose(score, wanted, atol=1e-4)
    assert not step[score == 0.0].any()


def test_a_repetition_is_walked_back_from_its_end_once() -> None:
    n, lag = 40, 20
    score, step = np.zeros((n, n), np.float32), np.zeros((n, n), np.uint8)
    for k in range(12):
        score[k + 2, k + 2 + lag], step[k + 2, k + 2 + lag] = 1.0 + k, k > 0
    ends = find_ends(score, 3.0)
    assert ends.tolist() == [[13, 33]]
    (pairs,) = trace_repeats(score, step, np.repeat(ends, 2, axis=0), 3, 4, 2.0)  # the second walk finds the first's
    assert pairs.tolist() == [[13 - k, 33 - k] for k in range(12)]
    assert find_ends(score, 20.0).shape == (0, 2)
