"""Injected errors are what they say, where they say, and nothing else changes."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles.wandering import make_wandering_motion

from dousa.errors import OptionError
from dousa.evaluation.posture.posture import SEGMENTS, compute_segments
from dousa.evaluation.posture.yaw import estimate_yaw, rotate_yaw
from dousa.formats import ReadOptions, read_canonical
from dousa.motion.canonical.joints import CANONICAL_PARENTS
from lab.injection.edits import (
    VARIANTS,
    measure_angles,
    put_together,
    slerp,
    smooth_noise,
    take_apart,
    turn,
)
from lab.injection.injection import (
    KINDS,
    Limits,
    inject,
    inject_many,
    measure_range,
    simulate_performer,
)

ALL_VARIANTS = [(kind, variant) for kind in KINDS for variant in VARIANTS[kind]]
PARENTS = np.array(CANONICAL_PARENTS[1:])


@pytest.fixture(scope="module")
def motion():
    return make_wandering_motion(30.0, seed=1)


def bone_lengths(positions):
    return np.linalg.norm(positions[:, 1:] - positions[:, PARENTS], axis=2)


def angles_without_yaw(motion, other):
    """(T, 9) degrees."""
    mine, theirs = compute_segments(motion.positions), compute_segments(other.positions)
    return measure_angles(mine, rotate_yaw(theirs, estimate_yaw(mine, theirs)))


def move(positions, yaw, place):
    return turn(positions, np.array(yaw)) + np.array(place)


# The parts


def test_a_body_taken_apart_and_put_together_is_the_same(motion):
    assert np.allclose(put_together(take_apart(motion.positions)), motion.positions, atol=1e-12)


@given(st.integers(0, 2**32 - 1), st.floats(0, 1))
@settings(deadline=None, max_examples=50)
def test_slerp_stays_on_the_sphere_and_divides_the_angle(seed, share):
    a, b = np.random.default_rng(seed).standard_normal((2, 5, 3))
    a, b = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in (a, b))
    between = slerp(a, b, np.array(share))
    assert np.allclose(np.linalg.norm(between, axis=1), 1)
    assert np.allclose(measure_angles(a, between), share * measure_angles(a, b), atol=1e-5)


def test_slerp_between_opposite_directions_is_a_direction():
    up = np.array([[0.0, 1.0, 0.0]])
    middle = slerp(up, -up, np.array(0.5))
    assert np.allclose(np.linalg.norm(middle), 1)
    assert np.allclose(middle @ up.T, 0)


def test_noise_has_variance_one_and_the_correlation_time_asked_for():
    noise = smooth_noise(400, (3000,), 20.0, np.random.default_rng(0))
    assert noise.std() == pytest.approx(1.0, abs=0.02)
    assert (noise[100] * noise[120]).mean() == pytest.approx(np.exp(-1), abs=0.05)
    assert smooth_noise(1, (2,), 20.0, np.random.default_rng(0)).shape == (1, 2)


def test_range_is_the_largest_angle_between_any_two_directions():
    angle = np.radians(np.linspace(-20, 50, 71))
    swing = np.stack([np.sin(angle), np.cos(angle), 0 * angle], axis=1)[:, None]
    assert measure_range(swing) == pytest.approx([70.0])


# The performer


def test_a_steady_performer_differs_by_body_heading_and_place_only(motion):
    performer = simulate_performer(motion, 3, noise_deg=0, bias_deg=0, timing_ms=0)
    assert angles_without_yaw(motion, performer).max() < 1e-4
    ratio = bone_lengths(performer.positions) / bone_lengths(motion.positions)
    assert np.allclose(ratio, ratio[0])
    assert np.allclose(ratio[:, 3:7], ratio[:, 7:11])  # left arm, right arm
    assert ratio.std() > 0.01
    assert performer.frame_rate == motion.frame_rate and performer.n_frames == motion.n_frames


def test_the_performer_is_put_where_and_as_asked(motion):
    still = {"noise_deg": 0, "bias_deg": 0, "timing_ms": 0, "stature": 1.2}
    there = simulate_performer(motion, 3, **still, yaw=0.5, place=(1.0, -2.0))
    here = simulate_performer(motion, 3, **still, yaw=0.0, place=(0.0, 0.0))
    assert np.allclose(there.positions, move(here.positions, 0.5, (1.0, 0.0, -2.0)))
    assert there.height == pytest.approx(1.2 * motion.height)


def test_the_performer_wavers_as_much_as_asked(motion):
    squares = [
        angles_without_yaw(motion, simulate_performer(motion, seed, noise_deg=4, bias_deg=0, timing_ms=0)) ** 2
        for seed in range(10)
    ]
    # The yaw between the two takes a little of it away.
    assert np.sqrt(np.mean(squares)) == pytest.approx(4.0, rel=0.15)


def test_the_performer_comes_from_the_seed_alone(motion):
    first, again, other = (simulate_performer(motion, seed).positions for seed in (5, 5, 6))
    assert np.array_equal(first, again)
    assert not np.allclose(first, other)


def test_even_a_huge_timing_wobble_never_runs_backwards(motion):
    wild = simulate_performer(motion, 0, noise_deg=0, bias_deg=0, timing_ms=800)
    assert np.isfinite(wild.positions).all()


def test_a_single_frame_can_be_performed(motion):
    one = replace(motion, positions=motion.positions[:1])
    assert simulate_performer(one, 0).positions.shape == (1, 20, 3)


# Errors


@pytest.mark.parametrize(("kind", "variant"), ALL_VARIANTS)
def test_an_error_changes_its_window_only(motion, kind, variant):
    injection = inject(motion, kind, 4, variant=variant)
    error = injection.error
    assert (error.kind, error.variant) == (kind, variant)
    assert 0.3 <= error.start_s < error.end_s <= motion.duration - 0.3
    assert 0.4 <= error.duration_s <= 3.0
    changed = np.flatnonzero(np.abs(injection.motion.positions - motion.positions).max(axis=(1, 2)) > 1e-9)
    # What can be seen lies inside what was changed, which is not much longer.
    fade = 1.0 if kind == "shift" else 0.5
    assert changed[0] / 30 <= error.start_s <= changed[0] / 30 + fade
    assert changed[-1] / 30 - fade <= error.end_s <= (changed[-1] + 1) / 30
    assert np.allclose(bone_lengths(injection.motion.positions), bone_lengths(motion.positions))
    assert not injection.motion.positions.flags.writeable
    assert set(error.segments) <= set(SEGMENTS) and error.segments


@pytest.mark.parametrize(("kind", "variant"), ALL_VARIANTS)
def test_errors_fade_in_and_out(motion, kind, variant):
    """No jump that a body could not make: no step is much larger than what the clean motion does."""
    wrong = inject(motion, kind, 4, variant=variant).motion
    steps = measure_angles(*(compute_segments(wrong.positions)[k : len(wrong.positions) - 1 + k] for k in (0, 1)))
    assert steps.max() < 40.0  # degrees in 1/30 s


@pytest.mark.parametrize("kind", KINDS)
def test_the_seed_decides(motion, kind):
    first, again, other = (inject(motion, kind, seed) for seed in (7, 7, 8))
    assert first.error == again.error
    assert np.array_equal(first.motion.positions, again.motion.positions)
    assert first.error != other.error


@pytest.mark.parametrize("kind", KINDS)
@given(yaw=st.floats(-3, 3), x=st.floats(-5, 5))
@settings(deadline=None, max_examples=3)
def test_errors_do_not_depend_on_heading_and_place(motion, kind, yaw, x):
    moved = replace(motion, positions=move(motion.positions, yaw, (x, 0.0, 0.0)))
    here, there = inject(motion, kind, 2), inject(moved, kind, 2)
    assert (there.error.start_s, there.error.end_s) == (here.error.start_s, here.error.end_s)
    assert there.error.segments == here.error.segments
    assert np.allclose(there.motion.positions, move(here.motion.positions, yaw, (x, 0.0, 0.0)), atol=1e-6)


@pytest.mark.parametrize(("variant", "sign"), [("late", 1), ("early", -1)])
def test_a_shift_is_the_same_motion_at_another_time(motion, variant, sign):
    injection = inject(motion, "shift", 1, variant=variant, size=200.0, duration_s=2.5)
    assert injection.error.lag_ms == pytest.approx(sign * 200.0)
    assert injection.error.segments == SEGMENTS
    frame = round(0.5 * (injection.error.start_s + injection.error.end_s) * 30)
    expected = motion.positions[frame - sign * 6]
    assert np.allclose(injection.motion.positions[frame], expected, atol=2e-3)


@pytest.mark.parametrize("variant", VARIANTS["incomplete"])
def test_the_shortfall_is_the_range_that_is_lost(motion, variant):
    injection = inject(motion, "incomplete", 5, variant=variant)
    error = injection.error
    frames = slice(round(error.start_s * 30), round(error.end_s * 30))
    full, left = (measure_range(compute_segments(some.positions[frames])) for some in (motion, injection.motion))
    # The body hardly turns, so that directions in the world will do.
    loss = full - left
    named = [SEGMENTS.index(name) for name in error.segments]
    assert error.shortfall_deg == pytest.approx(loss[named].max(), abs=5.0)
    assert error.shortfall_deg >= 15.0 and 20.0 <= error.shortfall_percent <= 100.0
    assert error.lag_ms is None


def test_a_larger_share_missing_is_a_larger_shortfall(motion):
    limits = Limits(seen_deg=0.5, shortfall_deg=0, shortfall_percent=0)
    lost = [
        inject(motion, "incomplete", 5, variant="body shrunk", size=size, duration_s=2, limits=limits).error
        for size in (0.2, 0.4, 0.6)
    ]
    assert lost[0].shortfall_percent < lost[1].shortfall_percent < lost[2].shortfall_percent


@pytest.mark.parametrize("variant", VARIANTS["partial"])
def test_a_partial_error_leaves_the_other_segments_alone(motion, variant):
    injection = inject(motion, "partial", 6, variant=variant)
    angles = measure_angles(compute_segments(motion.positions), compute_segments(injection.motion.positions))
    named = [SEGMENTS.index(name) for name in injection.error.segments]
    others = [k for k in range(9) if k not in named]
    assert angles[:, others].max() < 8.0 and len(others) >= 5
    frames = slice(round(injection.error.start_s * 30), round(injection.error.end_s * 30))
    assert angles[frames][:, named].mean(axis=0).max() >= 25.0


def test_a_global_error_is_wrong_all_over(motion):
    injection = inject(motion, "global", 2)
    frames = slice(round(injection.error.start_s * 30), round(injection.error.end_s * 30))
    means = angles_without_yaw(motion, injection.motion)[frames].mean(axis=0)
    assert means.mean() >= 25.0 and (means >= 15.0).sum() >= 5
    assert injection.error.segments == SEGMENTS


def test_a_short_motion_borrows_from_others(motion):
    short = make_wandering_motion(2.0, seed=3)
    assert inject(short, "global", 0) is None
    donor = make_wandering_motion(3.0, seed=4, frame_rate=120.0)
    assert inject(short, "global", 0, donors=[donor]) is not None


def test_nothing_is_late_of_a_person_who_stands_still():
    still = make_wandering_motion(10.0, reach=0.0)
    assert inject(still, "shift", 0) is None
    assert inject(still, "incomplete", 0) is None
    assert inject(still, "global", 0) is None
    assert inject(still, "partial", 0).error.variant == "limb rotated"


def test_too_short_is_too_short(motion):
    for n_frames in (1, 2, 20):
        cut = replace(motion, positions=motion.positions[:n_frames])
        assert all(inject(cut, kind, 0) is None for kind in KINDS)


def test_several_errors_keep_apart(motion):
    injection = inject_many(motion, KINDS, 3)
    errors = injection.errors
    assert sorted(error.kind for error in errors) == sorted(KINDS)
    assert all(b.start_s - a.end_s >= 1.5 for a, b in pairwise(errors))
    crowded = inject_many(motion, KINDS * 10, 3)
    assert 4 < len(crowded.errors) < 40


def test_what_is_unknown_is_refused(motion):
    with pytest.raises(OptionError, match="kind: expected shift"):
        inject(motion, "late", 0)
    with pytest.raises(OptionError, match="variant: expected late or early"):
        inject(motion, "shift", 0, variant="sideways")
    with pytest.raises(OptionError, match="kind"):
        inject_many(motion, ("shift", "nothing"), 0)


@pytest.mark.parametrize(
    "recording",
    [
        "bandai_dance/dataset-1_dance-short_normal_001.bvh",
        "hdm05/kickLFront1Reps/HDM_bd_kickLFront1Reps_005_120.amc",
        "hdm05/throwBasketball/HDM_bk_throwBasketball_004_120.amc",
    ],
)
def test_real_motions_take_every_class(shared_data, recording):
    real, _ = read_canonical(str(shared_data(recording)), ReadOptions())
    donors = [make_wandering_motion(8.0, seed=9)]
    for kind in KINDS:
        injection = inject(real, kind, 0, donors=donors)
        assert injection is not None, kind
        assert np.isfinite(injection.motion.positions).all()
        assert np.isfinite(simulate_performer(injection.motion, 0).positions).all()
