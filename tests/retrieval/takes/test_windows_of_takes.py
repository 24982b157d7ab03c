"""Takes as windows: the grid, what is kept, kernels against slow loops, bytes."""

import functools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles.short_actions import make_clip, make_library
from oracles.slow_takes import parts_of, pose_distance

from dousa.errors import DousaError, InvalidMotionError, OptionError
from dousa.retrieval import FEATURE_SETS, MotionForest, compute_track, reduce_noise
from dousa.retrieval.takes import moment_kernels as kernels
from dousa.retrieval.takes.made_takes import join_clips
from dousa.retrieval.takes.windows import TakeWindows, WindowGrid, choose_grid, describe_take, place_windows

SET = FEATURE_SETS["extended"]
GRID = WindowGrid((32, 48, 64))
TAKE = join_clips([make_clip("bow", 4), make_clip("kick", 4)], np.random.default_rng(0))
RANDOM = np.random.default_rng(1)


@functools.cache
def a_forest():
    clips = make_library((0, 1), 2)
    poses = np.stack([SET.compute(clip) for clip in clips])
    forest = MotionForest(n_trees=12, thresholds="random", random_state=0)
    return forest.fit(poses, [clip.category for clip in clips], feature_set=SET)


@functools.cache
def seen_windows():
    return describe_take(a_forest(), SET, TAKE, GRID)


def test_every_frame_lies_in_windows_of_every_length():
    starts, stops = place_windows(GRID, 101)
    for length in GRID.lengths:
        some = stops - starts == length
        assert starts[some][0] == 0
        assert stops[some][-1] == 101
        assert (np.diff(starts[some]) <= length / 5).all()
    assert (np.diff(stops - starts) >= 0).all()


@pytest.mark.parametrize(("n_frames", "count"), [(0, 0), (1, 0), (31, 0), (32, 1), (36, 2), (37, 2), (38, 3)])
def test_short_takes_have_few_windows(n_frames, count):
    assert len(place_windows(WindowGrid((32,)), n_frames)[0]) == count


def test_the_grid_follows_the_clips():
    assert choose_grid([2.0, 2.0], 0.8, 1.25).lengths == (48, 64)
    assert choose_grid([0.1]).lengths == (16,)
    assert choose_grid([2.0]).lengths == (32, 48, 64, 96, 128)
    assert WindowGrid((16, 24, 64)).within(20, 30).lengths == (24,)
    assert WindowGrid((16, 24, 64)).within(300, 400).lengths == (64,)


@pytest.mark.parametrize("lengths", [(), (8,), (16, 16), (24, 16), (20,), (8192,), (16.5,)])
def test_impossible_grids_are_refused(lengths):
    with pytest.raises(OptionError, match="window lengths"):
        WindowGrid(lengths)


@pytest.mark.parametrize("durations", [[], [0.0], [float("nan")]])
def test_a_grid_needs_durations(durations):
    with pytest.raises(OptionError, match="durations"):
        choose_grid(durations)


def test_leaves_are_those_of_the_whole_recording():
    track = compute_track(reduce_noise(TAKE), SET)
    cells = track.describe(seen_windows().starts, seen_windows().stops)
    np.testing.assert_array_equal(seen_windows().leaves, a_forest().apply(cells))
    assert seen_windows().leaves.dtype == np.uint16
    assert seen_windows().n_frames == len(TAKE.positions)


def test_chunks_and_threads_change_nothing():
    seen = []
    again = describe_take(a_forest(), SET, TAKE, GRID, n_jobs=2, chunk=30, progress=lambda *step: seen.append(step))
    # The heading is smoothed over time: what lies far outside a chunk touches its last digits only.
    assert (again.leaves == seen_windows().leaves).mean() > 0.999
    assert seen[-1] == (len(TAKE.positions), len(TAKE.positions))


@pytest.mark.parametrize("n_frames", [1, 5, 20])
def test_a_take_too_short_for_windows_is_described(n_frames):
    short = replace(TAKE, positions=TAKE.positions[:n_frames])
    windows = describe_take(a_forest(), SET, short, GRID)
    assert windows.leaves.shape == (0, 12)
    assert windows.n_frames == n_frames


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"positions": np.zeros((0, 20, 3))}, "canonical positions"),
        ({"positions": np.zeros((9, 19, 3))}, "canonical positions"),
        ({"positions": np.full((9, 20, 3), np.nan)}, "finite"),
        ({"height": 0.0}, "height"),
    ],
)
def test_impossible_takes_are_refused(change, message):
    with pytest.raises(InvalidMotionError, match=message):
        describe_take(a_forest(), SET, replace(TAKE, **change), GRID)


def test_windows_come_back_from_bytes():
    again = TakeWindows.from_bytes(seen_windows().to_bytes())
    assert again.grid == seen_windows().grid
    assert again.duration == seen_windows().duration
    np.testing.assert_array_equal(again.leaves, seen_windows().leaves)
    np.testing.assert_array_equal(again.sums, seen_windows().sums)
    assert again.to_bytes() == seen_windows().to_bytes()


@settings(max_examples=60, deadline=None)
@given(st.data())
def test_damaged_bytes_are_refused_or_harmless(data):
    damaged = bytearray(seen_windows().to_bytes())
    for _ in range(data.draw(st.integers(1, 3))):
        damaged[data.draw(st.integers(0, len(damaged) - 1))] = data.draw(st.integers(0, 255))
    cut = data.draw(st.integers(0, len(damaged)))
    for some in (bytes(damaged), bytes(damaged[:cut])):
        try:
            TakeWindows.from_bytes(some)
        except DousaError:
            continue


def test_pose_distances_equal_the_slow_ones():
    poses = RANDOM.normal(size=(90, 27))
    sums = np.concatenate([np.zeros((1, 27)), np.cumsum(poses, axis=0)])
    query = RANDOM.normal(size=(21, 27))
    starts, stops = np.array([0, 3, 50, 2]), np.array([16, 90, 61, 10])
    found = np.empty(4)
    kernels.compare_poses(sums, starts, stops, parts_of(query), np.inf, found)
    expected = [pose_distance(poses[a:b], query) for a, b in zip(starts, stops, strict=True)]
    np.testing.assert_allclose(found, expected, rtol=1e-12)


def test_leaf_shares_equal_the_slow_ones():
    leaves = RANDOM.integers(0, 9, (20, 7)).astype(np.uint16)
    query = leaves[3].copy()
    shares = np.empty(20)
    kernels.compare_leaves(leaves, query, shares)
    np.testing.assert_allclose(shares, (leaves == query).mean(axis=1))


def test_a_real_take_is_described_at_thirty_frames_a_second(shared_data):
    from dousa.formats.registry import read_motion
    from dousa.motion import canonicalise

    motion = canonicalise(read_motion(shared_data("cmu86/86_01.amc")))
    windows = describe_take(a_forest(), SET, motion, GRID)
    assert windows.n_frames == round(4579 / 4)
    assert windows.duration == pytest.approx(4579 / 120)
    assert np.isfinite(windows.sums).all()
