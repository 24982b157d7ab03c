"""Sketches of windows: what they say of a distance, and the loop that scans them."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles.slow_takes import near_sketches, pose_distance

from dousa.library.takes import portions
from dousa.library.takes.portions import Sketcher, cut_windows, sketch_windows
from dousa.library.takes.scanning import scan_sketches
from dousa.retrieval.takes.find import cut_parts
from dousa.retrieval.takes.windows import TakeWindows, WindowGrid, count_windows, place_windows

GRID = WindowGrid((16, 24, 32, 48))


def make_windows(seed: int, n_frames: int = 400) -> TakeWindows:
    """A take whose joints go to and fro, each at its own tempo."""
    draw = np.random.default_rng(seed)
    times = np.arange(n_frames)[:, None]
    poses = 0.3 * np.sin(times * draw.uniform(0.01, 0.2, 27) + draw.uniform(0, 6, 27)) + draw.normal(0, 0.3, 27)
    n_windows = len(place_windows(GRID, n_frames)[0])
    return TakeWindows(GRID, np.zeros((n_windows, 3), np.uint16), poses.astype(np.float16), n_frames / 30)


def fit(*windows: TakeWindows) -> Sketcher:
    return Sketcher.fit(np.concatenate([cut_windows(one, slice(None)) for one in windows]))


@given(st.integers(1, 30), st.integers(0, 60), st.integers(0, 10**6), st.floats(0, 400))
@settings(max_examples=40, deadline=None)
def test_the_loop_finds_what_the_oracle_finds(n_values, count, seed, most):
    draw = np.random.default_rng(seed)
    sketches = draw.integers(-127, 128, (n_values + 1, count)).astype(np.int8)
    query = draw.normal(0, 40, n_values).astype(np.float32)
    rests = draw.uniform(0, 1e4, 256).astype(np.float32)
    n_marks = int(draw.integers(0, 6))
    marks, leaves = (
        draw.integers(0, 3, (count, n_marks)).astype(np.uint8),
        draw.integers(0, 3, n_marks).astype(np.uint8),
    )
    asked = query, rests, leaves, draw.uniform(0, 50, n_marks + 1), float(draw.uniform(0.1, 2))
    first, last = sorted(draw.integers(0, count + 1, 2).tolist())
    rows, costs = np.empty(count, np.int64), np.empty(count)
    found = scan_sketches(sketches, marks, first, last, *asked, most, rows, costs)
    every = dict(near_sketches(sketches, marks, first, last, *asked, np.inf))
    clearly = {row for row, cost in every.items() if cost < most - 1e-3 * (1 + most)}
    assert clearly <= set(rows[:found].tolist())
    assert np.allclose(costs[:found], [every[row] for row in rows[:found].tolist()], rtol=1e-4)
    assert (costs[:found] <= most).all()


def test_more_windows_than_are_in_hand_at_a_time():
    count = 2 * 2048 + 5
    sketches = np.zeros((3, count), np.int8)
    sketches[0, -1], sketches[2] = 7, -128
    marks = np.zeros((count, 1), np.uint8)
    rows, costs = np.empty(count, np.int64), np.empty(count)
    asked = np.array([7, 0], np.float32), np.zeros(256, np.float32), np.zeros(1, np.uint8), np.array([9.0, 1.0]), 1.0
    assert scan_sketches(sketches, marks, 0, count, *asked, 3.0, rows, costs) == 1
    assert (rows[0], costs[0]) == (count - 1, 1.0)


def test_a_sketch_says_nearly_how_far_a_window_is():
    """Coordinates are exact but for rounding; of the rests it is known between which bounds their distance is."""
    windows = [make_windows(seed) for seed in range(6)]
    sketcher = fit(*windows)
    query = make_windows(9, 40).poses
    coordinates, rests = sketcher.ask(cut_parts(query))
    step = sketcher.steps[0]
    own_rest = sketcher.place(cut_parts(query)[None])[1][0]
    for one in windows:
        sketches = sketcher.sketch(cut_windows(one, slice(None))).astype(int)
        for row in range(0, len(one.starts), 17):
            distance = pose_distance(one.poses[one.starts[row] : one.stops[row]].astype(float), query.astype(float))
            inside = step * np.sqrt(((sketches[:-1, row] - coordinates) ** 2).sum())
            told = step * np.sqrt(((sketches[:-1, row] - coordinates) ** 2).sum() + rests[sketches[-1, row] + 128])
            rest = (sketches[-1, row] + 128) * sketcher.steps[1]
            slack = step * 4 + sketcher.steps[1]
            assert np.hypot(inside, rest - own_rest) - slack <= distance <= np.hypot(inside, rest + own_rest) + slack
            assert np.hypot(inside, rest - own_rest) - slack <= told <= np.hypot(inside, rest + own_rest) + slack


def test_windows_that_are_all_alike_have_sketches():
    still = TakeWindows(
        GRID, np.zeros((len(place_windows(GRID, 60)[0]), 3), np.uint16), np.ones((60, 27), np.float16), 2.0
    )
    sketcher = fit(still)
    sketches = sketcher.sketch(cut_windows(still, slice(None)))
    assert not sketches[:-1].any()
    coordinates, rests = sketcher.ask(cut_parts(still.poses))
    assert coordinates == pytest.approx(0, abs=1e-2) and rests[0] == pytest.approx(0, abs=1)


@pytest.mark.parametrize("at_once", [1, 7, 10_000])
def test_of_a_long_take_some_windows_at_a_time_are_sketched(monkeypatch, at_once):
    one = make_windows(3)
    sketcher = fit(one)
    whole = sketcher.sketch(cut_windows(one, slice(None)))
    monkeypatch.setitem(portions._cut.__kwdefaults__, "at_once", at_once)
    rows = [some for length in GRID.lengths for some in portions._cut(portions._rows(one, length), len(one.starts))]
    assert np.array_equal(
        np.concatenate([np.arange(len(one.starts))[some] for some in rows]), np.arange(len(one.starts))
    )
    assert (
        np.abs(sketch_windows(sketcher, one, slice(None)).astype(int) - whole).max() <= 1
    )  # sums are rounded otherwise
    assert sketch_windows(sketcher, one, slice(5, 5)).shape == (len(whole), 0)
    assert np.abs(sketch_windows(sketcher, one, slice(5, 24)).astype(int) - whole[:, 5:24]).max() <= 1


@given(st.sampled_from([16, 24, 32, 48, 64, 96, 4096]), st.integers(0, 5000))
def test_windows_are_counted_without_placing_them(length, n_frames):
    assert count_windows(length, n_frames) == len(place_windows(WindowGrid((length,)), n_frames)[0])
