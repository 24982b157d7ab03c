"""Curves: eq. 8 to 14 against their transcription, identity, invariances, known errors, gaps, one frame."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from oracles import yamane_eigenspace as oracle
from oracles.wandering import make_wandering_motion

from dousa.evaluation import PostureSequence
from dousa.evaluation.alignment.pairing import compare_poses
from dousa.evaluation.figures.curves import Curves, compute_curves, turn_reference
from dousa.evaluation.figures.eigenspace import Eigenspace
from dousa.evaluation.figures.furi import Furi, find_furi, fit_furi_eigenspaces
from dousa.evaluation.posture.posture import SEGMENTS, compute_postures, interpolate_segments
from dousa.evaluation.posture.yaw import rotate_yaw
from dousa.motion import canonicalise
from dousa.motion.synthetic.dance import make_dance
from dousa.motion.synthetic.performers import Performer
from lab.injection.injection import simulate_performer

RATE = 30.0
FURI = (Furi(0, 90, "A"), Furi(90, 200, "B"), Furi(200, 240, "A"))
REFERENCE = compute_postures(make_wandering_motion(8, 1))
SPACES = fit_furi_eigenspaces(REFERENCE, FURI)
CLOCK = np.arange(REFERENCE.n_frames) / RATE
FOREARM = SEGMENTS.index("right_forearm")
TIMELY = ("d_space", "d_within", "d_path", "facing")


def compute(
    performance: PostureSequence,
    same: np.ndarray = CLOCK,
    matched: np.ndarray | None = None,
    more: tuple[PostureSequence, ...] = (),
    reference: PostureSequence = REFERENCE,
    furi: tuple[Furi, ...] = FURI,
    spaces: dict[str, Eigenspace] = SPACES,
) -> Curves:
    return compute_curves(reference, more, performance, same, same if matched is None else matched, furi, spaces)


def with_segments(segments: np.ndarray, seen: np.ndarray | None = None) -> PostureSequence:
    return replace(REFERENCE, segments=segments, seen=np.ones(segments.shape[:2], bool) if seen is None else seen)


def tilt(segments: np.ndarray, angle: float) -> np.ndarray:
    """Directions turned towards the vertical and past it, exactly by an angle."""
    across = np.cross(segments, [0.0, 1.0, 0.0])
    across /= np.linalg.norm(across, axis=-1, keepdims=True)
    upward = np.cross(across, segments)
    return segments * np.cos(angle) + upward * np.sin(angle)


def scramble(seed: int) -> np.ndarray:
    return with_noise(REFERENCE.segments, seed, 0.1)


def with_noise(segments: np.ndarray, seed: int, size: float) -> np.ndarray:
    noisy = segments + size * np.random.default_rng(seed).normal(size=segments.shape)
    return noisy / np.linalg.norm(noisy, axis=2, keepdims=True)


def test_furi_index_tells_the_figure_and_its_ends() -> None:
    curves = compute(REFERENCE)
    assert (curves.furi_index[[0, 89, 90, 199, 200, 239]] == [0, 0, 1, 1, 2, 2]).all()
    gap = compute(REFERENCE, furi=(FURI[0], FURI[2]))
    assert (gap.furi_index[90:200] == -1).all()
    assert np.isnan(gap.d_space[90:200]).all()
    assert np.isnan(gap.d_space_reference[90:200]).all()
    assert np.isfinite(gap.residual[90:200]).all()
    assert (compute(REFERENCE, furi=()).furi_index == -1).all()


def test_distances_are_those_of_the_paper() -> None:
    segments = scramble(3)
    curves = compute(with_segments(segments))
    for frame in (0, 40, 89, 90, 150, 239):
        space = SPACES[FURI[curves.furi_index[frame]].label]
        middle, phi = space.mean.ravel().tolist(), space.axes.T.tolist()
        figure = FURI[curves.furi_index[frame]]
        turned = turn_reference(REFERENCE, figure, space)
        x = turned.segments[frame - turned.first].ravel().tolist()
        y = rotate_yaw(segments[frame], curves.turn[frame]).ravel().tolist()
        assert curves.d_space[frame] == pytest.approx(oracle.distance_from_space(y, middle, phi))
        assert curves.d_space[frame] == pytest.approx(oracle.distance_from_space_by_residual(y, middle, phi))
        assert curves.d_within[frame] == pytest.approx(oracle.distance_within(x, y, middle, phi))
        assert curves.d_within[frame] == pytest.approx(oracle.distance_within_by_difference(x, y, phi))
        assert turned.first == max(figure.start - 30, 0)
        assert len(turned.segments) == min(figure.end + 30, 240) - turned.first
        path = [pose.ravel().tolist() for pose in turned.segments]
        assert curves.d_path[frame] == pytest.approx(oracle.distance_to_path(y, path))


def test_reference_and_performance_are_turned_alike() -> None:
    yaw = 0.7 + 0.1 * np.sin(CLOCK)
    curves = compute(with_segments(rotate_yaw(REFERENCE.segments, yaw)))
    for number, figure in enumerate(FURI):
        turned = turn_reference(REFERENCE, figure, SPACES[figure.label])
        part = slice(figure.start, figure.end)
        assert (curves.furi_index[part] == number).all()
        off = curves.turn[part] - turned.turn[turned.find(figure)] + yaw[part]
        assert np.abs(np.angle(np.exp(1j * off))).max() < 0.02


def test_the_turn_of_the_reference_is_that_of_its_poses_without_their_jumps() -> None:
    for figure in FURI:
        space = SPACES[figure.label]
        turned = turn_reference(REFERENCE, figure, space)
        part = REFERENCE.segments[turned.first : turned.first + len(turned.turn)]
        np.testing.assert_allclose(turned.segments, rotate_yaw(part, turned.turn), atol=1e-12)
        off = np.angle(np.exp(1j * (turned.turn - space.find_turn(part))))
        assert np.median(np.abs(off)) < np.radians(6.0)


def test_what_is_not_seen_has_no_turn() -> None:
    seen = np.ones((240, 9), bool)
    seen[50:60, FOREARM] = False
    curves = compute(with_segments(REFERENCE.segments, seen))
    assert (np.isnan(curves.turn) == np.isnan(curves.d_space)).all()
    assert np.isnan(curves.turn[50:60]).all()


@cache
def dance_to_demo(seed: int) -> tuple[PostureSequence, tuple[Furi, ...], dict[str, Eigenspace]]:
    """The dance of the demo, where several poses stand upright in all segments, and its figures."""
    reference = compute_postures(canonicalise(make_dance(Performer(), seed, 40.0).motion))
    furi = find_furi(reference)
    return reference, furi, fit_furi_eigenspaces(reference, furi)


@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.parametrize("offset", [0.0, 0.4])
def test_no_distance_jumps_where_nothing_differs(seed: int, offset: float) -> None:
    reference, furi, spaces = dance_to_demo(seed)
    frames = np.arange(reference.n_frames - 1) + offset
    segments = with_noise(interpolate_segments(reference.segments, frames), seed, np.radians(3.0))
    performance = replace(reference, segments=segments, seen=reference.seen[:-1], positions=reference.positions[:-1])
    same = frames / reference.frame_rate
    curves = compute(performance, same=same, reference=reference, furi=furi, spaces=spaces)
    assert np.nanmax(curves.d_within) < 4.0 * np.nanmedian(curves.d_within)
    assert np.nanmax(curves.d_path) < 2.0 * np.nanmedian(curves.d_path)
    # Beyond what the eigenspace leaves of the reference itself.
    at_reference = curves.d_space_reference[np.rint(frames).astype(int)]
    beyond = curves.d_space - at_reference
    assert np.nanmax(beyond) < 2.0 * np.nanmedian(curves.d_space)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_another_performer_makes_no_distance_jump(seed: int) -> None:
    reference, furi, spaces = dance_to_demo(seed)
    motion = canonicalise(make_dance(Performer(), seed, 40.0).motion)
    performance = compute_postures(simulate_performer(motion, seed + 7))
    same = np.arange(reference.n_frames) / reference.frame_rate
    curves = compute(performance, same=same, reference=reference, furi=furi, spaces=spaces)
    # What the pose differs by bounds all distances: they come from chords of the same segments.
    chords = np.linalg.norm(2.0 * np.sin(0.5 * curves.residual), axis=1)
    assert np.nanmax(curves.d_within - chords) < 1e-6
    assert np.nanmax(curves.d_space - curves.d_space_reference - chords) < 1e-6


def test_one_wrong_segment_has_its_angle_and_bends_no_other() -> None:
    segments = REFERENCE.segments.copy()
    segments[60:150, FOREARM] = tilt(segments[60:150, FOREARM], 0.6)
    curves = compute(with_segments(segments))
    assert curves.residual[60:150, FOREARM] == pytest.approx(0.6, abs=0.01)
    others = np.delete(curves.residual, FOREARM, axis=1)
    assert np.abs(others).max() < 0.02
    assert np.abs(curves.facing).max() < 0.02


def test_facing_tells_who_turns_away_and_wraps() -> None:
    theta = np.where(CLOCK < 5.0, 3.0, 3.0 + 1.0)
    curves = compute(with_segments(rotate_yaw(REFERENCE.segments, theta)))
    assert curves.facing[:140] == pytest.approx(0.0, abs=1e-3)
    assert curves.facing[160:] == pytest.approx(1.0, abs=1e-3)
    assert np.abs(curves.residual[160:]).max() < 1e-3


def test_range_that_is_halved_has_half_the_gain() -> None:
    # One forearm swings up and down; the rest of the body stands.
    segments = np.repeat(REFERENCE.segments[:1], 240, axis=0)
    swing = np.sin(2 * np.pi * 0.5 * CLOCK)

    def swinging(reach: float) -> PostureSequence:
        moved = segments.copy()
        angle = reach * swing
        zero = np.zeros_like(angle)
        moved[:, FOREARM] = np.stack([zero, np.sin(angle), np.cos(angle)], axis=1)
        return with_segments(moved)

    reference = swinging(0.8)
    spaces = fit_furi_eigenspaces(reference, FURI[:2])
    curves = compute(swinging(0.4), reference=reference, furi=FURI[:2], spaces=spaces)
    assert curves.gain[:, FOREARM] == pytest.approx(0.5, abs=0.02)
    # What stands still has no range to compare.
    assert np.isnan(np.delete(curves.gain, FOREARM, axis=1)).all()


@pytest.mark.parametrize("late", [0.2, -0.2])
def test_lag_is_the_median_of_each_figure(late: float) -> None:
    curves = compute(REFERENCE, matched=CLOCK - late)
    assert curves.lag_by_furi == pytest.approx(late)
    unknown = np.where(CLOCK < 3.0, np.nan, CLOCK)
    assert np.isnan(compute(REFERENCE, matched=unknown).lag_by_furi).tolist() == [True, False, False]


def test_who_is_late_keeps_the_gain_and_the_path() -> None:
    reference = compute_postures(make_wandering_motion(8, 1))
    late = with_segments(np.concatenate([np.repeat(reference.segments[:1], 9, axis=0), reference.segments[:-9]]))
    curves = compute(late, matched=np.maximum(CLOCK - 0.3, 0.0))
    assert np.nanmax(curves.d_path) < 1e-6
    assert np.nanmax(curves.d_within) > 0.3
    assert np.nanmedian(curves.gain) == pytest.approx(1.0, abs=0.05)


def test_outside_the_reference_nothing_is_compared() -> None:
    for same in (CLOCK + 4.0, np.where(CLOCK + 4.0 < 8.0, CLOCK + 4.0, np.nan)):
        curves = compute(with_segments(np.roll(REFERENCE.segments, -120, axis=0)), same=same)
        assert np.isfinite(curves.residual[:120]).all()
        assert np.abs(curves.residual[:120]).max() < 1e-6
        for name in (*TIMELY, "residual"):
            assert np.isnan(getattr(curves, name)[121:]).all()
        assert (curves.furi_index[121:] == -1).all()
        # The first figure is not reached at all.
        assert np.isnan(curves.gain[0]).all()
        assert np.isnan(curves.lag_by_furi[0])
        assert np.nanmedian(curves.gain[1:]) == pytest.approx(1.0)
    nowhere = compute(REFERENCE, same=CLOCK + 100.0)
    assert np.isnan(nowhere.residual).all()
    assert np.isnan(nowhere.gain).all()
    assert np.isnan(nowhere.facing).all()


def test_gaps_are_not_judged() -> None:
    seen = np.ones((240, 9), bool)
    seen[50:80, FOREARM] = False
    seen[100:110] = False
    segments = REFERENCE.segments.copy()
    segments[50:80, FOREARM] = [0.0, -1.0, 0.0]
    curves = compute(with_segments(segments, seen))
    assert (np.isnan(curves.residual) == ~seen).all()
    assert np.nanmax(curves.residual) < 1e-6
    hidden = ~seen.all(axis=1)
    for name in ("d_space", "d_within", "d_path"):
        assert (np.isnan(getattr(curves, name)) == hidden).all()
    # A yaw is known wherever a segment is.
    assert (np.isnan(curves.facing) == ~seen.any(axis=1)).all()
    behind = compute(with_segments(REFERENCE.segments), reference=replace(REFERENCE, seen=seen), same=CLOCK)
    assert (np.isnan(behind.residual) == ~seen).all()
    nothing = compute(with_segments(segments, np.zeros((240, 9), bool)))
    assert np.isnan(nothing.residual).all()
    assert np.isnan(nothing.gain).all()


def test_more_takes_show_how_far_takes_are_apart() -> None:
    takes = tuple(with_segments(scramble(seed)) for seed in (4, 5))
    curves = compute(REFERENCE, more=takes)
    single = [compute(take) for take in takes]
    apart = np.maximum(single[0].d_within, single[1].d_within)
    assert curves.d_within_reference == pytest.approx(apart)
    away = np.max([curves.d_space, single[0].d_space, single[1].d_space], axis=0)
    assert curves.d_space_reference == pytest.approx(away)


def test_a_performer_of_another_build_is_near_everywhere() -> None:
    performance = compute_postures(simulate_performer(make_wandering_motion(8, 1), 2))
    curves = compute(performance)
    assert np.degrees(np.median(curves.residual)) < 6.0
    assert np.nanmedian(curves.gain) == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize("count", [1, 2])
def test_one_frame_is_compared(count: int) -> None:
    short = replace(
        REFERENCE,
        segments=REFERENCE.segments[:count],
        seen=REFERENCE.seen[:count],
        positions=REFERENCE.positions[:count],
    )
    furi = (Furi(0, count, "A"),)
    curves = compute(short, same=CLOCK[:count], reference=short, furi=furi, spaces=fit_furi_eigenspaces(short, furi))
    assert np.abs(curves.residual).max() < 1e-9
    assert curves.gain.shape == (1, 9)


def test_poses_between_frames_are_interpolated() -> None:
    middle = 0.5 * (REFERENCE.segments[:-1] + REFERENCE.segments[1:])
    middle /= np.linalg.norm(middle, axis=2, keepdims=True)
    curves = compute(with_segments(middle), same=CLOCK[:-1] + 0.5 / RATE)
    assert np.abs(curves.residual).max() < 1e-6
    assert np.abs(curves.d_within).max() < 0.02


def test_poses_that_never_meet_have_no_yaw() -> None:
    nothing = np.zeros((4, 9), bool)
    residual, yaw = compare_poses(REFERENCE.segments[:4], REFERENCE.segments[:4], nothing, RATE)
    assert np.isnan(residual).all()
    assert np.isnan(yaw).all()
