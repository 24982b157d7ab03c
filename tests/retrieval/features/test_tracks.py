"""Windows of a recording: cells of equal movement, read from integrals."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from oracles.node_tests import decide
from oracles.standing import standing

from dousa.errors import InvalidMotionError
from dousa.retrieval import FEATURE_SETS, MotionForest, compute_track, reduce_noise
from dousa.retrieval.features.channels import CHANNELS, compute_channels

EXTENDED, PAPER = FEATURE_SETS["extended"], FEATURE_SETS["paper"]


def recording(n_frames=90, seed=0, frame_rate=30.0):
    generator = np.random.default_rng(seed)
    steps = generator.normal(0.0, 0.02, (n_frames, 20, 3))
    return SimpleNamespace(positions=standing() + np.cumsum(steps, axis=0), frame_rate=frame_rate, height=1.7)


def slow_cells(motion, start, stop):
    """Cells from the overlap of each with each frame, in motion time."""
    rows = compute_channels(motion.positions, motion.height)
    speeds = [k for k, channel in enumerate(CHANNELS) if channel.name.startswith("speed of")]
    pace = rows[:, speeds].sum(axis=1) + 0.5
    frames = np.arange(len(rows))
    weights = pace * np.clip(np.minimum(frames + 1, stop) - np.maximum(frames, start), 0.0, None)
    ends = np.cumsum(weights) / weights.sum() * 10  # of the frames, in cells
    begins = ends - weights / weights.sum() * 10
    out = np.empty((10, EXTENDED.n_columns))
    for t in range(10):
        low, high = np.maximum(begins, t), np.minimum(ends, t + 1)
        share = np.clip(high - low, 0.0, None)
        out[t, :86] = share @ rows
        out[t, 86] = (stop - start) / 30.0
        out[t, 87:173] = share @ rows**2
        out[t, 173:] = (share * 0.5 * (low + high)) @ rows
    return out


@pytest.mark.parametrize(("start", "stop"), [(0, 90), (7, 51), (12.5, 33.25), (40, 43), (40.25, 40.75)])
def test_cells_are_means_over_motion_time(start, stop):
    motion = recording()
    found = compute_track(motion, EXTENDED).describe([start], [stop])[0]
    expected = slow_cells(motion, start, stop)
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("n_frames", [1, 2, 90])
def test_cells_of_windows_are_those_of_whole_arrays(n_frames):
    track = compute_track(recording(n_frames), EXTENDED)
    starts = np.array([0.0, 0.0, 0.3 * n_frames, n_frames - 1.0, 0.25])
    stops = np.array([n_frames, 0.5, 0.71 * n_frames, n_frames, min(0.75, n_frames)])
    frames = np.arange(n_frames + 1.0)
    begin, end = np.interp(starts, frames, track.times), np.interp(stops, frames, track.times)
    edges = np.interp(begin[:, None] + (end - begin)[:, None] * np.linspace(0, 1, 11), track.times, frames)
    edges[:, 0], edges[:, -1] = starts, stops
    np.testing.assert_array_equal(track.find_edges(starts, stops), edges)


def test_a_clip_is_the_window_of_all_its_frames():
    motion = recording()
    quiet = reduce_noise(motion)
    np.testing.assert_array_equal(EXTENDED.compute(motion), compute_track(quiet, EXTENDED).describe([0], [90])[0])


def test_rest_takes_little_of_the_cells():
    motion = recording(40)
    rest = np.repeat(motion.positions[:1], 120, axis=0)
    motion.positions = np.concatenate([rest, motion.positions])
    edges = compute_track(motion, EXTENDED).find_edges([0], [160])[0]
    assert edges[0] == 0
    assert edges[-1] == 160
    assert (np.diff(edges) > 0).all()
    assert (edges[1:-1] > 110).sum() >= 7  # of 9; by the clock 3 of them would lie there


def test_paper_windows_are_of_equal_length():
    track = compute_track(recording(), PAPER)
    np.testing.assert_allclose(track.find_edges([10], [60])[0], np.linspace(10, 60, 11))
    assert track.describe([10, 0], [60, 90]).shape == (2, 10, 56)


@pytest.mark.parametrize("windows", [([-1], [5]), ([5], [5]), ([0], [91]), ([0, 1], [5]), ([np.nan], [5])])
def test_windows_outside_are_refused(windows):
    with pytest.raises(InvalidMotionError, match="expected windows within 0"):
        compute_track(recording(), EXTENDED).describe(*windows)


@pytest.mark.parametrize("n_frames", [1, 2])
def test_a_recording_of_a_frame_or_two_has_features(n_frames):
    assert np.isfinite(EXTENDED.compute(recording(n_frames))).all()


@pytest.mark.parametrize(
    ("change", "message"),
    [({"positions": np.full((9, 20, 3), np.nan)}, "finite"), ({"height": 0.0}, "height"),
     ({"positions": np.zeros((0, 20, 3))}, "shape")],
)  # fmt: skip
def test_unusable_motions_are_refused(change, message):
    with pytest.raises(InvalidMotionError, match=message):
        compute_track(SimpleNamespace(**{**vars(recording()), **change}), EXTENDED)


def make_forest(feature_set, n_clips=12):
    clips = [recording(40, seed) for seed in range(n_clips)]
    features = np.stack([feature_set.compute(clip) for clip in clips])
    forest = MotionForest(20, thresholds=feature_set.thresholds, n_trials="sqrt", random_state=0)
    return forest.fit(features, np.arange(n_clips) % 3, feature_set=feature_set), features


def test_a_track_of_other_features_is_refused():
    forest, _ = make_forest(EXTENDED)
    with pytest.raises(InvalidMotionError, match="feature set 'paper'"):
        forest.apply_windows(compute_track(recording(), PAPER), [0], [10])


def test_decisions_tell_means_spreads_and_trends():
    forest, features = make_forest(EXTENDED)
    kinds = set()
    for decision in decide(forest, features[0]):
        cells = features[0][decision.start : decision.stop]
        column = EXTENDED.column_names.index(decision.feature)
        values, time = cells[:, column], cells[:, 173:].mean(axis=0)
        kinds.add(decision.kind)
        if decision.kind == "mean":
            expected = values.mean()
        elif decision.kind == "spread":
            expected = np.sqrt(max(cells[:, column + 87].mean() - values.mean() ** 2, 0.0))
        else:
            length, middle = decision.stop - decision.start, 0.5 * (decision.start + decision.stop)
            expected = 12.0 * (time[column] - middle * values.mean()) / length
        assert decision.value == pytest.approx(expected, abs=1e-9)
    assert kinds == {"mean", "spread", "trend"}


def test_the_trend_of_a_line_is_its_change():
    motion = recording(60)
    motion.positions[:] = standing()
    hand = 11
    motion.positions[:, hand, 1] += np.linspace(0.0, 0.6, 60)  # steady, so that motion time is the clock's
    cells = EXTENDED.compute(motion)
    column = [c.name for c in CHANNELS].index("right hand above the pelvis")
    value = 12.0 * (cells[:, 173 + column].mean() - 5.0 * cells[:, column].mean()) / 10
    assert value == pytest.approx(0.6 / 1.7, rel=0.05)


def test_sets_of_features_agree_with_their_tests():
    for feature_set in FEATURE_SETS.values():
        assert len(feature_set.column_names) == feature_set.n_columns
        assert feature_set.tests[:, 1:3].max() == feature_set.n_columns - 1
        assert len(np.unique(feature_set.tests, axis=0)) == len(feature_set.tests)
    assert len(PAPER.tests) == 3080
    assert len(EXTENDED.tests) == 1 + 3 * 86 * 55
    assert len(replace(PAPER, name="other").tests) == 3080
