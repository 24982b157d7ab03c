"""Lines: identity, known offsets and tempos, nothing in common, one frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from oracles.wandering import make_wandering_motion

from dousa.evaluation.alignment.lines import align
from dousa.evaluation.posture.posture import Working, compute_postures, thin_postures
from dousa.motion import CanonicalMotion
from lab.injection.injection import simulate_performer

EVEN = np.ones(9)
TEMPOS = ("same", "free")


def work(motion: CanonicalMotion) -> Working:
    return thin_postures(compute_postures(motion))


def stretch(motion: CanonicalMotion, factor: float) -> CanonicalMotion:
    """The same, factor times as long."""
    times = np.linspace(0, motion.n_frames - 1, round(motion.n_frames * factor))
    low = np.minimum(times.astype(int), motion.n_frames - 2)
    share = (times - low)[:, None, None]
    return replace(motion, positions=motion.positions[low] * (1 - share) + motion.positions[low + 1] * share)


def choose(motion: CanonicalMotion, frames: np.ndarray) -> CanonicalMotion:
    return replace(motion, positions=motion.positions[frames])


def first(working: Working, count: int) -> Working:
    return replace(
        working,
        segments=working.segments[:count],
        seen=working.seen[:count],
        heading=working.heading[:count],
    )


@pytest.mark.parametrize("tempo", TEMPOS)
@pytest.mark.parametrize("frame_rate", [30.0, 120.0])
def test_a_motion_lies_on_itself(tempo: str, frame_rate: float) -> None:
    motion = work(make_wandering_motion(10, 1, frame_rate))
    found = align(motion, motion, tempo, EVEN)
    assert np.abs(found.frames - np.arange(motion.n_frames)).max() < 1e-6
    assert len(found.runs) == 1
    assert found.mismatch < 1e-3
    assert found.tempo == pytest.approx(1.0)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("late", [7, 25, 60])
def test_a_known_offset_is_found(late: int, seed: int) -> None:
    motion = make_wandering_motion(15, seed)
    played = simulate_performer(choose(motion, np.arange(late, motion.n_frames)), seed)
    found = align(work(motion), work(played), "same", EVEN)
    assert np.abs(found.frames - np.arange(played.n_frames) - late).max() < 1.0
    before = np.concatenate([np.zeros(late, int), np.arange(motion.n_frames)])
    found = align(work(motion), work(simulate_performer(choose(motion, before), seed)), "same", EVEN)
    assert np.abs(found.frames - np.arange(len(before)) + late).max() < 1.0


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("factor", [0.6, 0.8, 1.0, 1.25, 1.6])
def test_a_free_tempo_is_found(factor: float, seed: int) -> None:
    motion = make_wandering_motion(20, seed)
    played = work(simulate_performer(stretch(motion, factor), seed))
    found = align(work(motion), played, "free", EVEN)
    assert found.tempo == pytest.approx(factor, rel=0.02)
    assert len(found.runs) == 1
    assert np.abs(found.frames - np.arange(played.n_frames) / factor).max() < 5.0


def test_a_pose_that_is_held_is_crossed_at_the_tempo_of_the_rest() -> None:
    moving = make_wandering_motion(20, 4)
    held = choose(moving, np.concatenate([np.zeros(90, int), np.arange(moving.n_frames)]))
    for factor in (0.7, 1.4):
        played = work(simulate_performer(stretch(held, factor), 1))
        found = align(work(held), played, "free", EVEN)
        assert np.abs(found.frames - np.arange(played.n_frames) / factor).max() < 8.0


@pytest.mark.parametrize("tempo", TEMPOS)
def test_a_figure_left_out_makes_two_lines(tempo: str) -> None:
    motion = make_wandering_motion(30, 2)
    kept = np.concatenate([np.arange(450), np.arange(600, 900)])
    found = align(work(motion), work(simulate_performer(choose(motion, kept), 1)), tempo, EVEN)
    assert len(found.runs) == 2
    assert found.runs[1].start == pytest.approx(450, abs=6)
    away = np.abs(found.frames - kept)
    assert np.median(away) < 1.0
    # No frame lies between the lines.
    assert (np.minimum(away, np.abs(away - 150)) < 3.0).all()


@pytest.mark.parametrize("tempo", TEMPOS)
def test_motions_with_nothing_in_common_have_lines_that_mean_nothing(tempo: str) -> None:
    one, other = work(make_wandering_motion(10, 10)), work(make_wandering_motion(12, 20))
    assert align(one, other, tempo, EVEN).mismatch > 0.7
    noise = np.random.default_rng(0).normal(size=other.segments.shape)
    noise /= np.linalg.norm(noise, axis=2, keepdims=True)
    found = align(one, replace(other, segments=noise), tempo, EVEN)
    assert found.mismatch > 0.7
    assert np.isfinite(found.frames).all()


@pytest.mark.parametrize("tempo", TEMPOS)
@pytest.mark.parametrize("counts", [(1, 1), (1, 2), (2, 1), (2, 2), (1, 60), (60, 1), (3, 60), (60, 3)])
def test_a_few_frames_are_enough(counts: tuple[int, int], tempo: str) -> None:
    motion = work(make_wandering_motion(4, 3))
    reference, performance = first(motion, counts[0]), first(motion, counts[1])
    found = align(reference, performance, tempo, EVEN)
    assert found.frames.shape == (counts[1],)
    assert np.isfinite(found.frames).all()
    assert np.isfinite([found.tempo, found.mismatch]).all()
