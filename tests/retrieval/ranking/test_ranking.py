"""Ranking by equation 8, leaves, warped poses and all three, and the pose sequences that are compared."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from oracles import hamada
from oracles.pose_distance import warp_distance

from dousa.errors import InvalidMotionError, OptionError
from dousa.motion import canonicalise, compute_trajectories
from dousa.motion.synthetic.performers import draw_performer, make_motion
from dousa.retrieval.features.feature_sets import FEATURE_SETS, compute_track
from dousa.retrieval.ranking.ranking import (
    POSE_CELLS,
    RANKINGS,
    RankedClips,
    RankingQuery,
    compare_histograms,
    compare_leaves,
    compute_pose_sequence,
    rank_by_pose,
    rank_clips,
    warp_distances,
)


@given(st.integers(1, 6), st.integers(0, 9), st.integers(0, 2**32 - 1))
def test_distances_are_those_of_equation_8_and_ascend(classes, clips, seed):
    random = np.random.default_rng(seed)
    query, histograms = random.random(classes), random.random((clips, classes))
    distances = compare_histograms(query, histograms)
    order = np.argsort(distances, kind="stable")
    assert distances.tolist() == pytest.approx([hamada.distance(query, row) for row in histograms])
    assert sorted(order) == list(range(clips))
    assert (np.diff(distances[order]) >= 0).all()


def test_equals_keep_their_order():
    distances = compare_histograms([1.0, 0.0], [[0.0, 1.0], [1.0, 0.0], [0.0, 1.0], [1.0, 0.0]])
    order = np.argsort(distances, kind="stable")
    assert order.tolist() == [1, 3, 0, 2]
    assert distances.tolist() == pytest.approx([2**0.5, 0, 2**0.5, 0])


@pytest.mark.parametrize(
    ("query", "histograms"),
    [([1.0], [[1.0, 0.0]]), ([[1.0]], [[1.0]]), ([1.0], [1.0]), ([np.nan], [[1.0]]), ([1.0], [[np.inf]])],
)
def test_bad_histograms_are_refused(query, histograms):
    with pytest.raises(InvalidMotionError):
        compare_histograms(query, histograms)


def test_votes_give_the_distances_of_shares_without_rounding():
    votes = np.array([[7, 3, 0], [0, 3, 7], [3, 7, 0]], np.int32)
    distances = compare_histograms(votes[0], votes)
    order = np.argsort(distances, kind="stable")
    assert order.tolist() == [0, 2, 1]
    assert (distances**2).round(9).tolist() == [0, 98, 32]
    shares = compare_histograms(votes[0] / 10, votes / 10)
    assert shares == pytest.approx(distances / 10)


@given(st.integers(1, 6), st.integers(0, 9), st.integers(0, 2**32 - 1))
def test_leaves_are_the_share_of_trees_that_disagree(trees, clips, seed):
    random = np.random.default_rng(seed)
    query, leaves = random.integers(0, 3, trees), random.integers(0, 3, (clips, trees))
    distances = compare_leaves(query, leaves)
    assert distances.tolist() == [sum(a != b for a, b in zip(query, row, strict=True)) / trees for row in leaves]


def test_poses_come_nearest_first():
    poses = np.stack([np.full((4, 2), value) for value in (0.5, 0.0, 0.2)])
    order, distances = rank_by_pose(np.zeros((4, 2)), poses)
    assert order.tolist() == [1, 2, 0]
    assert distances == pytest.approx(np.array([0.5, 0.0, 0.2]) * np.sqrt(2) * 4 / 8)
    assert len(rank_by_pose(np.zeros((4, 2)), np.zeros((0, 4, 2)))[0]) == 0


@pytest.mark.parametrize(
    ("rank", "query", "clips"),
    [
        (compare_leaves, [1], [[1, 2]]),
        (compare_leaves, [], np.zeros((2, 0))),
        (rank_by_pose, np.zeros((3, 2)), np.zeros((1, 4, 2))),
        (rank_by_pose, np.zeros((3, 2)), np.zeros((3, 2))),
        (rank_by_pose, np.full((3, 2), np.nan), np.zeros((1, 3, 2))),
        (rank_by_pose, np.zeros((3, 2)), np.full((1, 3, 2), np.inf)),
    ],
)
def test_bad_leaves_and_poses_are_refused(rank, query, clips):
    with pytest.raises(InvalidMotionError):
        rank(query, clips)


def made(n_clips, seed=0):
    """A query and clips of random votes, leaves and poses; and which poses were asked for."""
    random = np.random.default_rng(seed)
    votes = random.multinomial(10, [0.25] * 4, size=n_clips + 1).astype(np.int32)
    leaves = random.integers(0, 4, (n_clips + 1, 10)).astype(np.int32)
    poses = random.random((n_clips + 1, 6, 3)).astype(np.float32) / 10
    asked = []

    def read_poses(rows):
        asked.append(rows.tolist())
        return poses[1:][rows]

    query = RankingQuery(votes[0], leaves[0], poses[0])
    return query, RankedClips(votes[1:], leaves[1:], read_poses), poses, asked


@given(st.integers(0, 30), st.integers(1, 40), st.integers(0, 2**32 - 1))
def test_fusion_is_the_sum_of_its_distances(n_clips, n_refined, seed):
    query, clips, poses, asked = made(n_clips, seed)
    answer = rank_clips("fused", query, clips, n_refined)
    histogram = compare_histograms(query.histogram / 10, clips.histograms / 10)
    leaves = compare_leaves(query.leaves, clips.leaves)
    pose = rank_by_pose(poses[0], poses[1:])[1]
    cheap = answer.histogram * 2**-0.5 + 0.5 * answer.leaves  # to the last bit, as equals keep their order
    first = np.argsort(cheap, kind="stable")[:n_refined]
    assert answer.histogram == pytest.approx(histogram)
    assert answer.leaves == pytest.approx(leaves)
    assert sorted(answer.order[: len(first)]) == sorted(first)
    assert answer.distances[first] == pytest.approx(cheap[first] + 8 * pose[first])
    assert answer.pose[first] == pytest.approx(pose[first])
    assert np.isnan(np.delete(answer.pose, first)).all()
    assert sorted(answer.order) == list(range(n_clips))
    assert (np.diff(answer.distances[answer.order]) >= -1e-12).all()
    assert answer.order[len(first) :].tolist() == np.argsort(cheap, kind="stable")[n_refined:].tolist()
    assert len(asked) == (n_clips > 0)


def test_histogram_and_leaves_need_no_poses_and_settle_equals_by_each_other():
    query, clips, _, asked = made(40, seed=3)
    for by, other in (("histogram", "leaves"), ("leaves", "histogram")):
        answer = rank_clips(by, query, clips)
        first, second = getattr(answer, by), getattr(answer, other)
        keys = list(zip(first[answer.order], second[answer.order], strict=True))
        assert keys == sorted(keys)
        assert (answer.distances == first).all()
    assert asked == []


def test_pose_orders_the_best_and_leaves_the_others_behind():
    query, clips, poses, _ = made(20, seed=5)
    answer = rank_clips("pose", query, clips, n_refined=8)
    refined = answer.order[:8]
    assert (np.diff(answer.pose[refined]) >= 0).all() and np.isnan(answer.pose[answer.order[8:]]).all()
    assert answer.distances[refined] == pytest.approx(rank_by_pose(poses[0], poses[1:])[1][refined])


def test_the_same_clip_comes_first():
    query, clips, poses, _ = made(20)
    same = RankedClips(np.vstack([clips.histograms, query.histogram]), np.vstack([clips.leaves, query.leaves]), None)
    everything = np.concatenate([poses[1:], poses[:1]])
    same = RankedClips(same.histograms, same.leaves, everything.__getitem__)
    for by in RANKINGS:
        answer = rank_clips(by, query, same)
        assert answer.order[0] == 20 and answer.distances[20] == pytest.approx(0, abs=1e-6)


def test_unknown_rankings_are_refused():
    query, clips, _, _ = made(2)
    with pytest.raises(OptionError, match=r"fused.*got 'best'"):
        rank_clips("best", query, clips)
    with pytest.raises(OptionError, match="1 or more"):
        rank_clips("fused", query, clips, 0)


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


def test_distance_is_symmetric_without_a_band():
    random = np.random.default_rng(1)
    one, other = random.normal(size=(7, 3)), random.normal(size=(11, 3))
    assert measure(one, [other], np.inf) == pytest.approx(measure(other, [one], np.inf), rel=1e-5)


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


def test_one_joint_apart_is_its_share_of_the_root_mean_square(clip):
    """Twelve joints that are all 0.1 body heights off are at distance 0.1 of a pose from another."""
    sequence = compute_pose_sequence(clip)
    moved = sequence.copy()
    moved[:, np.arange(0, 36, 3)] += 0.1 / np.sqrt(12)
    # A straight path has 16 pairs and is divided by 32; warping may find a cheaper one.
    assert 0.01 < rank_by_pose(sequence, moved[None])[1][0] <= 0.05 + 1e-6


def test_sequences_do_not_know_place_heading_or_size(clip):
    turn = np.array([[0.6, 0.0, 0.8], [0.0, 1.0, 0.0], [-0.8, 0.0, 0.6]])
    moved = clip.positions @ turn.T * 1.2 + [3.0, 0.0, -2.0]

    class Moved:
        positions, frame_rate, height = moved, clip.frame_rate, clip.height * 1.2

    assert compute_pose_sequence(Moved()) == pytest.approx(compute_pose_sequence(clip), abs=1e-4)
