"""The beam: what is settled, forgotten and saved; stretches tracked once more, and which of two tracks stands."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles.slow_search import random_body, random_pose, two_cameras

from dousa.estimation.body.human import make_human
from dousa.estimation.body.kinematics import compute_points, pose_difference, step_poses
from dousa.estimation.body.posing import standing_state
from dousa.estimation.cameras.camera import make_ring
from dousa.estimation.raster.rendering import render
from dousa.estimation.tracking.beam import Beam, Replay, _Track, choose_switch, choose_track, replay, score_frames
from dousa.estimation.tracking.search_setup import Frame, SearchSetup
from dousa.estimation.tracking.settings import TrackerSettings

seeds = st.integers(0, 2**32 - 1)


def make_shop(n_kept=3, lag=4, **chosen):
    body = random_body(np.random.default_rng(3))
    return SearchSetup(body, two_cameras(), TrackerSettings(beam=n_kept, lag=lag, **chosen), 30.0, 300.0)


def frame_of(setup, number):
    """A frame that somebody is in; its first word tells which."""
    bits = np.zeros((2, setup.height, setup.n_words), np.uint64)
    bits[0, 0, 0] = number + 1
    return Frame(bits, np.array([True, False]))


class ScriptedBeam(Beam):
    """Draws scores by lot instead of searching; the first number of a pose is its name."""

    def __init__(self, setup, seed):
        start = random_pose(np.random.default_rng(0), setup.body)
        start[0] = 0.0
        super().__init__(setup, start)
        self.rng, self.came_from, self.names = np.random.default_rng(seed), {}, 0

    def _search(self, task):
        pose = self._tracks[task[0]].pose.copy()
        pose[7:] = self.rng.choice([0.0, 0.5, 1.0], len(pose) - 7)  # now and then the same pose twice
        return float(self.rng.normal()), task[0], pose, np.zeros(self.setup.n_axes)

    def _revisit(self, task):
        _, number, pose, _, _ = task
        self.names += 1
        pose = pose.copy()
        pose[0] = self.names
        self.came_from[self.names] = self._tracks[number].pose[0]
        velocity = self.rng.normal(size=self.setup.n_axes)
        return _Track(float(self.rng.normal()), pose, velocity, number)


def line_of(beam):
    """Names of the poses from which the best present one came, oldest first."""
    line = [beam.best[0]]
    while line[-1] in beam.came_from:
        line.append(beam.came_from[line[-1]])
    return line[::-1]


@settings(max_examples=40, deadline=None)
@given(seeds, st.integers(1, 4), st.integers(1, 6), st.integers(0, 15))
def test_settled_poses_are_one_line(seed, n_kept, lag, n_steps):
    setup = make_shop(n_kept, lag)
    beam = ScriptedBeam(setup, seed)
    beam.begin(frame_of(setup, 0))
    settled = []
    for number in range(1, n_steps + 1):
        beam.step(frame_of(setup, number))
        assert 1 <= len(beam._tracks) <= n_kept
        assert beam._tracks[0].score == 0.0
        new = list(beam.settle(lag))
        assert len(new) == (number >= lag)
        settled += new
        assert settled == [] or line_of(beam)[: len(settled)] == [one.pose[0] for one in settled]
    settled += beam.settle(0)
    assert [one.pose[0] for one in settled] == line_of(beam)
    assert [int(one.frame.bits[0, 0, 0]) - 1 for one in settled] == list(range(n_steps + 1))


@settings(max_examples=20, deadline=None)
@given(seeds, st.integers(1, 3), st.integers(2, 12))
def test_what_does_not_come_from_the_settled_pose_is_forgotten(seed, lag, n_steps):
    setup = make_shop(3, lag)
    beam = ScriptedBeam(setup, seed)
    beam.begin(frame_of(setup, 0))
    for number in range(1, n_steps + 1):
        beam.step(frame_of(setup, number))
        for one in beam.settle(lag):
            for track in beam._tracks:
                name = track.pose[0]
                while name in beam.came_from and name != one.pose[0]:
                    name = beam.came_from[name]
                assert name == one.pose[0]


@settings(max_examples=20, deadline=None)
@given(seeds, st.integers(1, 9))
def test_a_saved_beam_settles_the_same(seed, n_steps):
    setup = make_shop(3, 4)
    beam = ScriptedBeam(setup, seed)
    beam.begin(frame_of(setup, 0))
    for number in range(1, n_steps + 1):
        beam.step(frame_of(setup, number))
        list(beam.settle(4))
    state = beam.save()
    frames = [frame for _, frame in beam._pending]
    other = ScriptedBeam(setup, seed)
    other.load(state, frames)
    for one, same in zip(beam._tracks, other._tracks, strict=True):
        assert (one.score, one.parent) == (same.score, same.parent)
        np.testing.assert_array_equal(one.velocity, same.velocity)
    np.testing.assert_array_equal(beam.best, other.best)
    for one, same in zip(beam.settle(0), other.settle(0), strict=True):
        np.testing.assert_array_equal(one.pose, same.pose)
        assert one.frame is same.frame


def test_what_is_replaced_hangs_on_the_line():
    setup = make_shop(3, 4)
    beam = ScriptedBeam(setup, 1)
    beam.begin(frame_of(setup, 0))
    for number in range(1, 5):
        beam.step(frame_of(setup, number))
    line = line_of(beam)
    assert [one.pose[0] for one in beam.line] == line
    rng = np.random.default_rng(5)
    anew = np.array([random_pose(rng, setup.body) for _ in range(2)])
    beam.replace_newest(anew)
    assert len(beam._tracks) == 1
    np.testing.assert_array_equal(beam.best, anew[-1])
    np.testing.assert_allclose(step_poses(anew[0], beam._tracks[0].velocity), anew[1], atol=1e-9)
    settled = list(beam.settle(0))
    assert [one.pose[0] for one in settled[:-2]] == line[:-2]
    np.testing.assert_array_equal([one.pose for one in settled[-2:]], anew)
    assert [one.frame.bits[0, 0, 0] for one in settled] == [frame_of(setup, n).bits[0, 0, 0] for n in range(5)]


def test_where_nobody_is_seen_inertia_goes_on_and_slows_down():
    setup = make_shop(2, 4, damping=(0.5,))
    beam = ScriptedBeam(setup, 2)
    velocity = 0.01 * np.ones(setup.n_axes)
    beam._tracks = [_Track(0.0, beam.best, velocity, 0)]
    beam.begin(frame_of(setup, 0))
    before = beam.best
    beam.step(Frame(np.zeros((2, setup.height, setup.n_words), np.uint64), np.zeros(2, bool)))
    np.testing.assert_allclose(beam.best[:3], before[:3] + 0.005)
    np.testing.assert_allclose(beam._tracks[0].velocity, 0.5 * velocity)
    limits = setup.body.angle_limits
    assert ((beam.best[7:] >= limits[:, 0]) & (beam.best[7:] <= limits[:, 1])).all()
    assert len(list(beam.settle(0))) == 2


@settings(max_examples=40, deadline=None)
@given(seeds)
def test_the_difference_of_poses_is_the_way_between_them(seed):
    rng = np.random.default_rng(seed)
    body = random_body(rng)
    before, steps = random_pose(rng, body), rng.uniform(-0.8, 0.8, 6 + body.n_angles)
    after = step_poses(before, steps)
    assert np.linalg.norm(after[3:7]) == pytest.approx(1.0)
    np.testing.assert_allclose(pose_difference(before, after), steps, atol=1e-9)
    after[3:7] *= -1.0
    np.testing.assert_allclose(pose_difference(before, after), steps, atol=1e-9)


BODY = make_human(1.72)
CAMERAS = make_ring(3, size=(128, 96))
AREA = 900.0


def make_setup(n_kept=None):
    return SearchSetup(BODY, CAMERAS, TrackerSettings(beam=n_kept), 30.0, AREA)


def walk(n_frames=8):
    poses = np.tile(standing_state(BODY), (n_frames, 1))
    poses[:, 0] += 0.03 * np.arange(n_frames)
    poses[:, 7 + BODY.angle_names.index("left_elbow.1")] += 0.1 * np.arange(n_frames)
    return poses


def make_frames(setup, poses):
    views = render(BODY, poses, CAMERAS)
    return [setup.pack([view[number] for view in views]) for number in range(len(poses))]


def test_a_stretch_is_followed_either_way():
    setup, poses = make_setup(1), walk()
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
