"""A varied performer differs in what was asked for, as much as was asked, and in nothing else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from oracles.wandering import make_wandering_motion

from dousa.motion.canonical.joints import CANONICAL_PARENTS
from lab.injection.edits import measure_angles, measure_segments, turn_onto
from lab.injection.performers import Variation, vary_performer

PARENTS = np.array(CANONICAL_PARENTS[1:])
NONE = Variation(posture=0, unsteadiness=0, tempo=0, tilt=0, build=0, facing=0, sensor=0)


@pytest.fixture(scope="module")
def motion():
    return make_wandering_motion(20.0, seed=1)


def bone_lengths(positions):
    return np.linalg.norm(positions[:, 1:] - positions[:, PARENTS], axis=2)


def measure_difference(motion, other):
    """(T, 9) degrees after yaw."""
    mine, theirs = measure_segments(motion.positions), measure_segments(other.positions)
    return measure_angles(turn_onto(theirs, mine), mine)


def test_without_any_variation_it_is_the_motion_itself(motion):
    same = vary_performer(motion, 0, NONE)
    # But for the floor, which is found robustly.
    assert np.allclose(same.positions[..., [0, 2]], motion.positions[..., [0, 2]], atol=1e-9)
    assert measure_difference(motion, same).max() < 1e-6
    assert same.height == motion.height


def test_facing_and_build_leave_the_directions(motion):
    other = vary_performer(motion, 1, replace(NONE, build=1, facing=1))
    # The trunk runs from between the hips, which move apart.
    assert measure_difference(motion, other).max() < 0.5
    ratio = bone_lengths(other.positions) / bone_lengths(motion.positions)
    assert np.allclose(ratio, ratio[0])
    assert np.allclose(ratio[:, 4:7], ratio[:, 8:11])  # elbow, wrist, hand
    assert ratio[0].std() > 0.01


def test_the_tilt_of_the_sensor_is_of_three_degrees_at_most(motion):
    for seed in range(10):
        tilted = vary_performer(motion, seed, replace(NONE, tilt=1))
        angles = measure_angles(measure_segments(tilted.positions), measure_segments(motion.positions))
        assert 0 < angles.max() <= 3.0001


def test_tempo_varies_by_tens_of_milliseconds_and_never_runs_backwards():
    slide = make_wandering_motion(30.0, seed=3)
    positions = slide.positions.copy()
    positions[..., 0] += np.arange(slide.n_frames)[:, None]  # a clock: 1 m a frame
    clock = replace(slide, positions=positions)
    for seed in range(8):
        danced = vary_performer(clock, seed, replace(NONE, tempo=1))
        frames = danced.positions[:, 0, 0] - slide.positions[:, 0, 0].mean()
        off = 1000 * (frames - np.arange(clock.n_frames)) / 30.0
        assert 5 <= np.sqrt((off**2).mean()) <= 50
        assert (np.diff(danced.positions[:, 0, 0]) > -0.05).all()


def test_posture_is_another_throughout_and_the_same_for_the_person(motion):
    found = []
    for seed in range(12):
        other = vary_performer(motion, seed, replace(NONE, posture=1))
        angles = measure_difference(motion, other)
        found.append(angles.mean())
        assert np.allclose(bone_lengths(other.positions), bone_lengths(motion.positions))
        assert angles.max() < 45
    assert 1.0 < np.mean(found) < 10.0
    assert np.std(found) > 0.5


def test_unsteadiness_is_slow_and_small(motion):
    angles = measure_difference(motion, vary_performer(motion, 4, replace(NONE, unsteadiness=1)))
    assert 0.3 < angles.mean() < 6.0


def test_some_sensors_jitter_and_some_say_what_they_missed(motion):
    others = [vary_performer(motion, seed, replace(NONE, sensor=1)) for seed in range(40)]
    stretched = [np.ptp(bone_lengths(other.positions), axis=0).max() > 1e-4 for other in others]
    marked = [other for other in others if other.missing is not None]
    assert 6 <= sum(stretched) <= 28
    assert 0 < len(marked) < sum(stretched)
    for other in marked:
        assert other.missing.shape == other.positions.shape[:2]
        assert 0 < other.missing.mean() < 0.1
    assert all(np.isfinite(other.positions).all() for other in others)


def test_the_performer_comes_from_the_seed_alone(motion):
    first, again, other = (vary_performer(motion, seed).positions for seed in (5, 5, 6))
    assert np.array_equal(first, again)
    assert not np.allclose(first, other)


def test_a_single_frame_and_two_can_be_performed(motion):
    for n in (1, 2):
        assert vary_performer(replace(motion, positions=motion.positions[:n]), 0).positions.shape == (n, 20, 3)
