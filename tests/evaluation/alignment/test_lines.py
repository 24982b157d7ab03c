"""Lines: identity, known offsets and tempos, nothing in common; lapses of each kind where they were made."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from oracles.wandering import make_wandering_motion, stretch
from oracles.wrong_dances import EVEN, choose, first_frames, thin

from dousa.evaluation import Lapse
from dousa.evaluation.alignment.lines import align, find_lapses
from dousa.formats.registry import read_motion
from dousa.motion import CanonicalMotion, canonicalise
from lab.injection.injection import KINDS, inject, simulate_performer

TEMPOS = ("same", "free")


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("late", [7, 25, 60])
def test_a_known_offset_is_found(late: int, seed: int) -> None:
    motion = make_wandering_motion(15, seed)
    played = simulate_performer(choose(motion, np.arange(late, motion.n_frames)), seed)
    found = align(thin(motion), thin(played), "same", EVEN)
    assert np.abs(found.frames - np.arange(played.n_frames) - late).max() < 1.0
    before = np.concatenate([np.zeros(late, int), np.arange(motion.n_frames)])
    found = align(thin(motion), thin(simulate_performer(choose(motion, before), seed)), "same", EVEN)
    assert np.abs(found.frames - np.arange(len(before)) + late).max() < 1.0


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("factor", [0.6, 0.8, 1.0, 1.25, 1.6])
def test_a_free_tempo_is_found(factor: float, seed: int) -> None:
    motion = make_wandering_motion(20, seed)
    played = thin(simulate_performer(stretch(motion, round(factor * motion.n_frames)), seed))
    found = align(thin(motion), played, "free", EVEN)
    assert found.tempo == pytest.approx(factor, rel=0.02)
    assert len(found.runs) == 1
    assert np.abs(found.frames - np.arange(played.n_frames) / factor).max() < 5.0


def test_a_pose_that_is_held_is_crossed_at_the_tempo_of_the_rest() -> None:
    moving = make_wandering_motion(20, 4)
    held = choose(moving, np.concatenate([np.zeros(90, int), np.arange(moving.n_frames)]))
    for factor in (0.7, 1.4):
        played = thin(simulate_performer(stretch(held, round(factor * held.n_frames)), 1))
        found = align(thin(held), played, "free", EVEN)
        assert np.abs(found.frames - np.arange(played.n_frames) / factor).max() < 8.0


@pytest.mark.parametrize("tempo", TEMPOS)
def test_a_figure_left_out_makes_two_lines(tempo: str) -> None:
    motion = make_wandering_motion(30, 2)
    kept = np.concatenate([np.arange(450), np.arange(600, 900)])
    found = align(thin(motion), thin(simulate_performer(choose(motion, kept), 1)), tempo, EVEN)
    assert len(found.runs) == 2
    assert found.runs[1].start == pytest.approx(450, abs=6)
    away = np.abs(found.frames - kept)
    assert np.median(away) < 1.0
    # No frame lies between the lines.
    assert (np.minimum(away, np.abs(away - 150)) < 3.0).all()


@pytest.mark.parametrize("tempo", TEMPOS)
def test_motions_with_nothing_in_common_have_lines_that_mean_nothing(tempo: str) -> None:
    one, other = thin(make_wandering_motion(10, 10)), thin(make_wandering_motion(12, 20))
    assert align(one, other, tempo, EVEN).mismatch > 0.7
    noise = np.random.default_rng(0).normal(size=other.segments.shape)
    noise /= np.linalg.norm(noise, axis=2, keepdims=True)
    found = align(one, replace(other, segments=noise), tempo, EVEN)
    assert found.mismatch > 0.7
    assert np.isfinite(found.frames).all()


@pytest.mark.parametrize("tempo", TEMPOS)
@pytest.mark.parametrize("counts", [(1, 1), (1, 2), (2, 1), (2, 2), (1, 60), (60, 1), (3, 60), (60, 3)])
def test_a_few_frames_are_enough(counts: tuple[int, int], tempo: str) -> None:
    motion = thin(make_wandering_motion(4, 3))
    reference, performance = first_frames(motion, counts[0]), first_frames(motion, counts[1])
    found = align(reference, performance, tempo, EVEN)
    assert found.frames.shape == (counts[1],)
    assert np.isfinite(found.frames).all()
    assert np.isfinite([found.tempo, found.mismatch]).all()


RATE = 30
DANCE = "bandai_dance/dataset-1_dance-short_normal_001.bvh"


def make_lapse(motion: CanonicalMotion, kind: str, at_s: float) -> tuple[CanonicalMotion, tuple[float, ...]]:
    """A motion with a lapse at a moment, and the spans that belong to it."""
    here, at = motion.positions, round(at_s * RATE)
    other = make_wandering_motion(3, 77).positions
    end = motion.n_frames / RATE
    parts: dict[str, list[np.ndarray]] = {
        "skip": [here[:at], here[at + 150 :]],
        "repeat": [here[:at], here[at - 150 :]],
        "stop": [here[:at], here[[at] * 90], here[at:]],
        "late start": [here[120:]],
        "early end": [here[:-120]],
        "lead-in": [other, here],
        "lead-out": [here, other],
    }
    spans: dict[str, tuple[float, ...]] = {
        "skip": (at_s, at_s, at_s, at_s + 5),
        "repeat": (at_s, at_s + 5, at_s - 5, at_s),
        "stop": (at_s, at_s + 3, at_s, at_s),
        "late start": (0, 0, 0, 4),
        "early end": (end - 4, end - 4, end - 4, end),
        "lead-in": (0, 3, 0, 0),
        "lead-out": (end, end + 3, end, end),
    }
    return replace(motion, positions=np.concatenate(parts[kind])), spans[kind]


LAPSES = ("skip", "repeat", "stop", "late start", "early end", "lead-in", "lead-out")


def look(reference: CanonicalMotion, performance: CanonicalMotion, tempo: str = "same") -> tuple[Lapse, ...]:
    one, other = (thin(motion) for motion in (reference, performance))
    return find_lapses(align(one, other, tempo, EVEN), one, other)


def check(motion: CanonicalMotion, kind: str, at_s: float, tempo: str, seed: int) -> None:
    played, spans = make_lapse(motion, kind, at_s)
    found = look(motion, simulate_performer(played, seed), tempo)
    assert [lapse.kind for lapse in found] == [kind]
    (lapse,) = found
    measured = (lapse.start_s, lapse.end_s, lapse.reference_start_s, lapse.reference_end_s)
    assert measured == pytest.approx(spans, abs=0.7)
    assert all(lapse.says.render(language) for language in ("en", "ja"))


@pytest.mark.parametrize("tempo", TEMPOS)
@pytest.mark.parametrize("kind", LAPSES)
@pytest.mark.parametrize("seed", range(2))
def test_a_lapse_is_found_where_it_is(kind: str, tempo: str, seed: int) -> None:
    check(make_wandering_motion(30, seed), kind, 12.0 + seed, tempo, seed)


@pytest.mark.parametrize("tempo", TEMPOS)
@pytest.mark.parametrize("kind", LAPSES)
def test_a_lapse_of_a_real_dance_is_found(kind: str, tempo: str, shared_data: Callable[[str], Path]) -> None:
    dance = canonicalise(read_motion(shared_data(DANCE)))
    check(dance, kind, 31.0, tempo, 3)


@pytest.mark.parametrize("kind", ["skip", "repeat", "stop"])
def test_a_second_is_enough(kind: str) -> None:
    motion = make_wandering_motion(30, 5)
    frames = np.arange(motion.n_frames)
    parts = {
        "skip": np.r_[frames[:400], frames[430:]],
        "repeat": np.r_[frames[:400], frames[370:]],
        "stop": np.r_[frames[:400], np.full(30, 400), frames[400:]],
    }
    found = look(motion, simulate_performer(choose(motion, parts[kind]), 2))
    assert [lapse.kind for lapse in found] == [kind]


@pytest.mark.parametrize("tempo", TEMPOS)
@pytest.mark.parametrize("seed", range(3))
def test_noise_is_no_lapse(tempo: str, seed: int) -> None:
    motion = make_wandering_motion(20, seed)
    assert look(motion, motion, tempo) == ()
    assert look(motion, simulate_performer(motion, seed), tempo) == ()


@pytest.mark.parametrize("tempo", TEMPOS)
@pytest.mark.parametrize("kind", KINDS)
def test_an_error_of_form_is_no_lapse(kind: str, tempo: str, shared_data: Callable[[str], Path]) -> None:
    dance = canonicalise(read_motion(shared_data(DANCE)))
    for seed in range(3):
        injection = inject(dance, kind, seed)
        assert injection is not None
        assert look(dance, simulate_performer(injection.motion, seed), tempo) == ()


def test_several_lapses_come_in_order() -> None:
    motion = make_wandering_motion(60, 6)
    frames = np.arange(motion.n_frames)
    parts = np.r_[frames[120:500], frames[650:1100], np.full(90, 1100), frames[1100:-120]]
    found = look(motion, simulate_performer(choose(motion, parts), 1))
    assert [lapse.kind for lapse in found] == ["late start", "skip", "stop", "early end"]
    starts = [lapse.start_s for lapse in found]
    assert starts == sorted(starts)


def test_ends_that_differ_by_half_a_second_are_normal() -> None:
    motion = make_wandering_motion(4, 7)
    assert look(motion, simulate_performer(choose(motion, np.arange(15, 110)), 1)) == ()


@pytest.mark.parametrize("counts", [(1, 1), (2, 1), (1, 2), (2, 2)])
def test_one_frame_has_no_lapse(counts: tuple[int, int]) -> None:
    motion = make_wandering_motion(2, 8)
    reference, performance = (choose(motion, np.arange(count)) for count in counts)
    assert look(reference, performance) == ()
