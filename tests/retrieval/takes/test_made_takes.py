"""Made takes: motions as another person may do them, disturbed clips, and the truth of series."""

from dataclasses import replace

import numpy as np
import pytest
from oracles.short_actions import make_clip

from dousa.motion import canonicalise
from dousa.motion.canonical.canonicalise import mirror_positions
from dousa.motion.canonical.joints import CANONICAL_PARENTS
from dousa.motion.synthetic.performers import make_gesture
from dousa.retrieval.takes import made_takes as disturbances
from dousa.retrieval.takes.made_takes import Piece, disturb_motion, join_series, move_differently


@pytest.fixture(scope="module")
def points():
    return canonicalise(make_gesture(3)).positions


def bone_lengths(points):
    parents = np.array(CANONICAL_PARENTS)
    return np.linalg.norm(points[:, 1:] - points[:, parents[1:]], axis=2)


@pytest.mark.parametrize("seed", range(6))
def test_somebody_else_stands_on_the_same_floor(points, seed):
    moved = move_differently(points, np.random.default_rng(seed))
    assert moved.shape == points.shape
    np.testing.assert_allclose(moved[..., 1].min(axis=1), points[..., 1].min(axis=1), atol=1e-9)
    np.testing.assert_allclose(moved[:, 0, ::2], points[:, 0, ::2], atol=0.2)
    assert 0.005 < np.linalg.norm(moved - points, axis=2).mean() < 0.5


def test_nobody_else_moves_as_it_was(points):
    moved = move_differently(points, np.random.default_rng(0), most_held=0.0, most_extent=0.0, most_placed=0.0)
    np.testing.assert_allclose(moved, points, atol=1e-6)


def test_bones_that_are_only_held_otherwise_stay_as_long(points):
    moved = move_differently(points, np.random.default_rng(1), most_placed=0.0)
    np.testing.assert_allclose(bone_lengths(moved), bone_lengths(points), atol=1e-6)
    assert np.abs(moved - points).max() > 0.01


def test_less_extent_brings_bones_nearer_to_their_mean(points):
    wrists = [6, 10]
    ways = []
    for seed in range(8):
        generator = np.random.default_rng(seed)
        moved = move_differently(points, generator, most_held=0.0, most_placed=0.0, most_extent=0.8)
        ways.append([part[:, wrists].std(axis=0).sum() for part in (moved, points)])
    ratios = np.array(ways)[:, 0] / np.array(ways)[:, 1]
    assert ratios.min() < 0.95 and ratios.max() > 1.05


def test_who_holds_both_sides_alike_does_so_in_the_mirror(points):
    moved = move_differently(points, np.random.default_rng(2), symmetric=1.0)
    image = move_differently(mirror_positions(points), np.random.default_rng(2), symmetric=1.0)
    np.testing.assert_allclose(image, mirror_positions(moved), atol=1e-6)


def test_the_trunk_has_a_frame_in_any_pose(points):
    lying = points @ np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    frames = disturbances._frame_trunks(np.concatenate([points, lying]))
    np.testing.assert_allclose(frames.transpose(0, 2, 1) @ frames, np.broadcast_to(np.eye(3), frames.shape), atol=1e-6)
    np.testing.assert_allclose(np.linalg.det(frames), 1.0, atol=1e-6)


def test_one_frame_is_enough(points):
    assert np.isfinite(move_differently(points[:1], np.random.default_rng(0))).all()


def test_a_clip_is_disturbed_by_its_seed_alone_and_some_errors_last():
    clip = make_clip("wave", 7)
    seen = [disturb_motion(clip, np.random.default_rng(seed)) for seed in range(12)]
    again = disturb_motion(clip, np.random.default_rng(3))
    np.testing.assert_array_equal(again.positions, seen[3].positions)
    length = len(clip.positions) / clip.frame_rate
    assert all(np.isfinite(one.positions).all() and one.positions.shape[1:] == (20, 3) for one in seen)
    assert all(abs(len(one.positions) / one.frame_rate - length) < 0.2 for one in seen)
    assert len({one.frame_rate for one in seen}) > 3
    short = replace(clip, positions=clip.positions[:1])
    assert np.isfinite(disturb_motion(short, np.random.default_rng(0)).positions).all()


def test_the_truth_of_made_takes_says_series_as_a_labeller_does():
    shown = "kick bow bow spread spread spread kick kick kick kick".split()
    pieces = [Piece(10.0 * k, 10.0 * (k + 1), name) for k, name in enumerate(shown)]
    joined = join_series(pieces)
    assert [one.category for one in joined] == ["kick", "bow", "bow", "spread", "kick"]
    assert [(one.start, one.stop) for one in joined[3:]] == [(30.0, 60.0), (60.0, 100.0)]
    nothing = [Piece(10.0 * k, 10.0 * (k + 1), None) for k in range(4)]
    assert join_series(nothing) == nothing
