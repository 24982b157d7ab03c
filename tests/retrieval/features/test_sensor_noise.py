"""What a sensor adds is measured and taken off; what moves smoothly stays."""

from types import SimpleNamespace

import numpy as np
import pytest
from oracles.slow_noise import smooth_places as smooth_slowly
from oracles.standing import standing

from dousa.errors import InvalidMotionError
from dousa.motion.canonical.geometry import CHAIN_BONES, CHAIN_SHARES, chain_height
from dousa.motion.canonical.joints import JOINT_INDEX
from dousa.retrieval import reduce_noise
from dousa.retrieval.features.noise_kernels import measure_chain
from dousa.retrieval.features.sensor_noise import reduce_noise_of_all, smooth_together

HAND = JOINT_INDEX["right_hand"]


def wave(n_frames=60, frame_rate=15.0):
    """A hand that goes up and down once a second by 20 cm, on a body that walks and does not bend."""
    seconds = np.arange(n_frames) / frame_rate
    positions = np.repeat(standing().reshape(1, 20, 3), n_frames, axis=0)
    positions[..., 2] += 0.8 * seconds[:, None]
    positions[:, HAND, 1] += 0.2 * np.sin(2.0 * np.pi * seconds)
    return SimpleNamespace(positions=positions, frame_rate=frame_rate, height=1.7)


def disturb(motion, size, seed=0):
    noise = np.random.default_rng(seed).normal(0.0, size, motion.positions.shape)
    return SimpleNamespace(positions=motion.positions + noise, frame_rate=motion.frame_rate, height=motion.height)


def size_of(errors):
    return float(np.sqrt(np.mean(errors**2)))


@pytest.mark.parametrize("frame_rate", [10.0, 30.0, 120.0])
def test_what_has_no_noise_comes_back_as_it_is(frame_rate):
    motion = wave(round(4 * frame_rate), frame_rate)
    assert reduce_noise(motion) is motion


@pytest.mark.parametrize("size", [0.005, 0.01, 0.03, 0.06])
def test_noise_is_measured_and_reduced(size):
    clean = wave()
    noisy = disturb(clean, size)
    quiet = reduce_noise(noisy)
    assert quiet.noise == pytest.approx(size, rel=0.1)
    assert size_of(quiet.positions - clean.positions) < 0.5 * size
    still = quiet.positions[:, JOINT_INDEX["head"]] - clean.positions[:, JOINT_INDEX["head"]]
    assert size_of(still) < 0.35 * size  # what hardly moves is smoothed more than a hand
    assert np.ptp(quiet.positions[:, HAND, 1]) == pytest.approx(0.4, abs=1.5 * size + 0.01)


@pytest.mark.parametrize("n_frames", [1, 2, 9, 60])
def test_the_chain_of_bones_is_as_long_as_the_slow_one(n_frames):
    points = disturb(wave(n_frames), 0.04).positions
    found = measure_chain(points, CHAIN_BONES, CHAIN_SHARES, np.empty(n_frames))
    assert found == pytest.approx(chain_height(points), rel=1e-14)


def test_a_fast_recording_is_brought_to_thirty_frames():
    quiet = reduce_noise(disturb(wave(480, 120.0), 0.02))
    assert (len(quiet.positions), quiet.frame_rate) == (120, 30.0)
    assert quiet.noise == pytest.approx(0.01, rel=0.1)  # means of four frames


def test_a_glitch_leaves_little_trace():
    clean = wave()
    leaping = disturb(clean, 0.003)
    leaping.positions[20, HAND] += (0.5, 0.3, -0.4)
    quiet = reduce_noise(leaping)
    assert np.linalg.norm(quiet.positions[20, HAND] - clean.positions[20, HAND]) < 0.25 * np.sqrt(0.5)
    assert size_of(quiet.positions[40:] - clean.positions[40:]) < 0.003


def test_a_turned_and_moved_recording_gives_the_turned_and_moved_answer():
    noisy = disturb(wave(), 0.02)
    turn = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
    moved = SimpleNamespace(positions=noisy.positions @ turn.T + (3.0, 0.0, -2.0), frame_rate=15.0, height=1.7)
    np.testing.assert_allclose(
        reduce_noise(moved).positions, reduce_noise(noisy).positions @ turn.T + (3.0, 0.0, -2.0), atol=1e-9
    )


def test_joints_that_are_absent_stay_so():
    noisy = disturb(wave(), 0.02)
    whole = reduce_noise(noisy)
    noisy.positions[:, HAND] = np.nan
    part = reduce_noise(noisy)
    assert np.isnan(part.positions[:, HAND]).all()
    others = np.arange(20) != HAND
    np.testing.assert_allclose(part.positions[:, others], whole.positions[:, others], atol=0.01)


@pytest.mark.parametrize("n_frames", [8, 9, 60, 61, 299, 301])
@pytest.mark.parametrize("size", [0.0, 0.002, 0.03])
def test_compiled_loops_find_what_the_slow_ones_do(n_frames, size):
    points = disturb(wave(n_frames, 30.0), size).positions
    generator = np.random.default_rng(n_frames)
    for count in range(4):  # glitches, of which the later rounds find some
        (found,), (noise,) = smooth_together(points[None])
        expected, slowly = smooth_slowly(points)
        assert (found is None) == (expected is points)
        assert noise == pytest.approx(slowly, abs=1e-12)
        np.testing.assert_allclose(points if found is None else found, expected, rtol=0, atol=1e-12)
        for _ in range(1 + count):
            points[generator.integers(n_frames), generator.integers(20)] += generator.normal(0, 0.3, 3)


def test_groups_of_joints_change_nothing():
    points = disturb(wave(), 0.02).positions[None]
    np.testing.assert_allclose(smooth_together(points, at_once=180)[0], smooth_together(points)[0], atol=1e-12)


def test_motions_together_are_those_one_by_one():
    """Clean and noisy ones, with glitches and without a hand, of one length and of others, fast and too short."""
    motions = [wave(), wave(60, 120.0), wave(5)]
    motions += [disturb(wave(length, rate), 0.02, seed) for seed, (length, rate) in enumerate([(60, 15.0)] * 4)]
    motions += [disturb(wave(240, 120.0), 0.02), disturb(wave(60, 30.0), 0.01), disturb(wave(61, 30.0), 0.01)]
    motions[3].positions[20, HAND] += 0.5
    motions[4].positions[:, HAND] = np.nan
    for motion, found in zip(motions, reduce_noise_of_all(motions), strict=True):
        alone = reduce_noise(motion)
        assert (found is motion) == (alone is motion)
        assert (found.frame_rate, found.height) == (alone.frame_rate, alone.height)
        np.testing.assert_array_equal(found.positions, alone.positions)


@pytest.mark.parametrize(
    ("change", "code"),
    [({"positions": np.zeros((4, 19, 3))}, "posed_motion.shape"), ({"height": 0.0}, "posed_motion.height"),
     ({"frame_rate": 0.5}, "posed_motion.rate")],
)  # fmt: skip
def test_what_is_no_motion_is_refused(change, code):
    with pytest.raises(InvalidMotionError) as refused:
        reduce_noise(SimpleNamespace(**{**vars(wave()), **change}))
    assert refused.value.code == code
