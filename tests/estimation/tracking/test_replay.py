"""Tracking a stretch once more, and which of two tracks stands from where on."""

from __future__ import annotations

import numpy as np

from dousa.estimation.body.human import make_human
from dousa.estimation.body.kinematics import compute_points
from dousa.estimation.body.posing import standing_state
from dousa.estimation.cameras.camera import make_ring
from dousa.estimation.raster.rendering import render
from dousa.estimation.tracking.beam import Replay, choose_switch, choose_track, narrow, replay, score_frames
from dousa.estimation.tracking.search_setup import SearchSetup
from dousa.estimation.tracking.settings import TrackerSettings

BODY = make_human(1.72)
CAMERAS = make_ring(3, size=(128, 96))
AREA = 900.0


def make_setup():
    return SearchSetup(BODY, CAMERAS, TrackerSettings(), 30.0, AREA)


def walk(n_frames=8):
    poses = np.tile(standing_state(BODY), (n_frames, 1))
    poses[:, 0] += 0.03 * np.arange(n_frames)
    poses[:, 7 + BODY.angle_names.index("left_elbow.1")] += 0.1 * np.arange(n_frames)
    return poses


def make_frames(setup, poses):
    views = render(BODY, poses, CAMERAS)
    return [setup.pack([view[number] for view in views]) for number in range(len(poses))]


def test_a_stretch_is_followed_either_way():
    setup, poses = narrow(make_setup(), AREA), walk()
    assert setup.beam == 1
    frames = make_frames(setup, poses)
    for order in (slice(None), slice(None, None, -1)):
        found = replay(setup, poses[order][0], frames[order])
        off = np.linalg.norm(compute_points(BODY, found.poses) - compute_points(BODY, poses[order]), axis=-1)
        assert off.mean() < 0.03
        np.testing.assert_allclose(found.scores, score_frames(setup, found.poses, frames[order]))


def test_where_nobody_is_seen_there_is_no_score():
    setup, poses = make_setup(), walk(2)
    frames = [make_frames(setup, poses)[0], setup.pack([None] * 3)]
    scores = score_frames(setup, poses, frames)
    assert scores[0] > 0.0
    assert scores[1] == 0.0


def test_the_new_track_stands_from_where_it_is_better():
    setup, poses = make_setup(), walk()
    bad = poses.copy()
    bad[5:, 0] += 0.4
    old = Replay(bad, np.where(np.arange(8) < 5, 100.0, 40.0))
    new = Replay(poses, np.full(8, 99.0))
    assert choose_switch(setup, old, new) == 5
    assert choose_switch(setup, old, Replay(poses, np.full(8, 20.0))) == 8
    assert choose_switch(setup, old, Replay(poses, np.full(8, 120.0))) == 0


def test_a_jump_must_be_worth_it():
    setup, poses = make_setup(), walk()
    away = poses.copy()
    away[:, 0] += 1.0
    old = Replay(poses, np.full(8, 50.0))
    slightly_better = Replay(away, np.where(np.arange(8) < 4, 40.0, 52.0))
    assert choose_switch(setup, old, slightly_better) == 8


def test_one_lost_limb_for_some_frames_decides_nothing():
    steady = Replay(walk(), np.full(8, 50.0))
    stumbling = Replay(walk(), np.where(np.arange(8) == 3, -500.0, 53.0))
    assert choose_track([steady, stumbling]) == 1
    assert choose_track([stumbling, steady]) == 0
