"""Ranking by warped poses, and the pose sequences that are compared."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from oracles.pose_distance import warp_distance

from dousa.errors import InvalidMotionError
from dousa.motion import canonicalise, compute_trajectories
from dousa.motion.synthetic.performers import draw_performer, make_motion
from dousa.retrieval.features.feature_sets import FEATURE_SETS, compute_track
from dousa.retrieval.ranking.ranking import (
    POSE_CELLS,
    compute_pose_sequence,
    rank_by_pose,
    warp_distances,
)


def test_poses_come_nearest_first():
    poses = np.stack([np.full((4, 2), value) for value in (0.5, 0.0, 0.2)])
    order, distances = rank_by_pose(np.zeros((4, 2)), poses)
    assert order.tolist() == [1, 2, 0]
    assert distances == pytest.approx(np.array([0.5, 0.0, 0.2]) * np.sqrt(2) * 4 / 8)
    assert len(rank_by_pose(np.zeros((4, 2)), np.zeros((0, 4, 2)))[0]) == 0


@pytest.mark.parametrize(
    ("query", "clips"),
    [
        (np.zeros((3, 2)), np.zeros((1, 4, 2))),
        (np.zeros((3, 2)), np.zeros((3, 2))),
        (np.full((3, 2), np.nan), np.zeros((1, 3, 2))),
        (np.zeros((3, 2)), np.full((1, 3, 2), np.inf)),
    ],
)
def test_bad_poses_are_refused(query, clips):
    with pytest.raises(InvalidMotionError):
        rank_by_pose(query, clips)


def measure(query, others, reach):
    frames = np.concatenate(others).astype(np.float32)
    stops = np.cumsum([len(one) for one in others])
    starts = stops - [len(one) for one in others]
    distances = np.empty(len(others))
    warp_distances(query.astype(np.float32), frames, starts, stops, reach, distances)
    return distances


@given(
    st.integers(1, 12),
    st.lists(st.integers(1, 14), min_size=1, max_size=4),
    st.sampled_from([0.0, 1.0, 2.0, 3.5, np.inf]),
    st.integers(0, 2**32 - 1),
)
def test_distances_are_those_of_the_oracle(n, lengths, reach, seed):
    random = np.random.default_rng(seed)
    query, others = random.normal(size=(n, 3)), [random.normal(size=(m, 3)) for m in lengths]
    wanted = [warp_distance(query, other, reach) for other in others]
    assert measure(query, others, reach) == pytest.approx(wanted, rel=1e-5)


def test_a_sequence_is_at_no_distance_from_itself_even_slowed_down():
    query = np.random.default_rng(0).normal(size=(9, 4))
    assert measure(query, [query, np.repeat(query, 2, axis=0), query[::-1]], np.inf)[:2] == pytest.approx([0, 0])
    assert measure(query, [query[::-1]], np.inf) > 0.1


@pytest.fixture(scope="module")
def clip():
    return canonicalise(compute_trajectories(make_motion("squat", draw_performer(1), seed=1)))


def test_cells_are_means_over_motion_time(clip):
    """Of the first column, by a fine sum: the frames' values weighed with the time that each lies in the cell."""
    track = compute_track(clip, FEATURE_SETS["extended"])
    values = np.diff(track.integrals[:, 0]) / np.diff(track.times)
    edges = np.linspace(track.times[0], track.times[-1], POSE_CELLS + 1)
    for cell in range(POSE_CELLS):
        inside = np.clip(track.times, edges[cell], edges[cell + 1])
        weights = np.diff(inside)
        mean = (weights * values).sum() / weights.sum() / np.sqrt(12)
        assert compute_pose_sequence(clip)[cell, 0] == pytest.approx(mean, rel=1e-4, abs=1e-6)


def test_sequences_do_not_know_place_heading_or_size(clip):
    turn = np.array([[0.6, 0.0, 0.8], [0.0, 1.0, 0.0], [-0.8, 0.0, 0.6]])
    moved = clip.positions @ turn.T * 1.2 + [3.0, 0.0, -2.0]

    class Moved:
        positions, frame_rate, height = moved, clip.frame_rate, clip.height * 1.2

    assert compute_pose_sequence(Moved()) == pytest.approx(compute_pose_sequence(clip), abs=1e-4)
