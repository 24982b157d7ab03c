"""Errors over key poses are what they say, where they say, and nothing else changes."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import pytest
from oracles.wandering import make_wandering_motion

from dousa.evaluation.posture.posture import LIMBS, SEGMENTS, compute_segments
from dousa.evaluation.posture.yaw import estimate_yaw, rotate_yaw
from dousa.motion.canonical.joints import CANONICAL_PARENTS
from dousa.motion.canonical.joints import JOINT_INDEX as J
from lab.injection.key_edits import KEYFRAME_VARIANTS
from lab.injection.keyframes import inject_keyframes, perform_keyframes

PARENTS = np.array(CANONICAL_PARENTS[1:])
CHANGES_AROUND_S = 1.7  # of what is seen: onset, fade, and a stillness that hides a lag


@pytest.fixture(scope="module")
def motion():
    return make_wandering_motion(12.0, seed=1)


@pytest.fixture(scope="module")
def donors():
    return [make_wandering_motion(5.0, seed=seed) for seed in (7, 8)]


@pytest.fixture(scope="module")
def injections(motion, donors):
    made = [inject_keyframes(motion, np.random.default_rng(seed), donors, 1) for seed in range(120)]
    assert all(made)
    return made


def of_kind(injections, kind):
    found = [each for each in injections if each.error.kind == kind]
    assert len(found) >= 10
    return found


def bone_lengths(positions):
    return np.linalg.norm(positions[:, 1:] - positions[:, PARENTS], axis=2)


def angles_between(known, wrong):
    return np.degrees(np.arccos(np.clip(np.sum(known * wrong, axis=-1), -1, 1)))


def cut(motion, error, around_s=0.0):
    first = max(0, round((error.start_s - around_s) * motion.frame_rate))
    return np.arange(first, min(motion.n_frames, round((error.end_s + around_s) * motion.frame_rate) + 1))


def at(values, frames):
    low = np.clip(np.floor(frames).astype(int), 0, len(values) - 2)
    share = (frames - low)[:, None, None]
    return values[low] * (1 - share) + values[low + 1] * share


def measure_lags(motion, injection):
    """Best lag in s of each stretch of 0.3 s of much movement, by trying them all."""
    error, rate = injection.error, motion.frame_rate
    chosen = [SEGMENTS.index(name) for name in error.segments]
    known, wrong = (compute_segments(each.positions)[:, chosen] for each in (motion, injection.motion))
    frames, width = cut(motion, error), round(0.3 * rate)
    tried = np.arange(-0.5, 0.51, 0.02)
    lags = []
    for first in range(0, len(frames) - width, 2):
        here = frames[first : first + width]
        if angles_between(wrong[here[0]], wrong[here[-1]]).max() < 15:
            continue
        off = [np.square(at(known, here - lag * rate) - wrong[here]).sum() for lag in tried]
        lags.append(tried[int(np.argmin(off))])
    return np.array(lags)


def test_all_kinds_and_variants_are_made(injections, donors):
    made = {(each.error.kind, each.error.variant) for each in injections}
    assert {kind for kind, _ in made} == set(KEYFRAME_VARIANTS)
    assert made <= {(kind, variant) for kind, variants in KEYFRAME_VARIANTS.items() for variant in variants}
    assert len(made) >= 11


def test_bone_lengths_rate_and_frames_stay(injections, motion):
    for injection in injections:
        assert np.allclose(bone_lengths(injection.motion.positions), bone_lengths(motion.positions), atol=1e-9)
        assert injection.motion.frame_rate == motion.frame_rate
        assert not injection.motion.positions.flags.writeable


def test_nothing_changes_outside(injections, motion):
    for injection in injections:
        outside = np.setdiff1d(np.arange(motion.n_frames), cut(motion, injection.error, CHANGES_AROUND_S))
        assert np.array_equal(injection.motion.positions[outside], motion.positions[outside])


def test_other_limbs_keep_their_directions(injections, motion):
    known = compute_segments(motion.positions)
    for injection in injections:
        error = injection.error
        groups = [set(LIMBS[name]) for name in LIMBS]
        named = {SEGMENTS.index(name) for name in error.segments}
        if error.variant.startswith("body") or error.kind == "global":
            continue
        others = sorted(index for limb in groups if not limb & named for index in limb)
        if error.variant.startswith("pair"):
            others = [index for index in others if (index in (1, 2, 3, 4)) != bool(named & {1, 2, 3, 4})]
        assert others
        assert angles_between(known, compute_segments(injection.motion.positions))[:, others].max() < 1e-3


def test_spans_are_what_is_seen(injections, motion):
    known = compute_segments(motion.positions)
    for injection in injections:
        error = injection.error
        assert 0.0 <= error.start_s < error.end_s <= motion.duration
        if error.kind not in ("partial", "incomplete"):
            continue
        chosen = [SEGMENTS.index(name) for name in error.segments]
        angles = angles_between(known, compute_segments(injection.motion.positions))[:, chosen].max(axis=1)
        seen = np.flatnonzero(angles >= 8.0) / motion.frame_rate
        assert (error.start_s, error.end_s) == pytest.approx((seen[0], seen[-1]))


def test_the_measured_lag_is_the_true_one(injections, motion):
    misses = []
    for injection in of_kind(injections, "shift")[:20]:
        error = injection.error
        assert 100.0 <= abs(error.lag_ms) <= 400.0
        lags = 1e3 * measure_lags(motion, injection) * np.sign(error.lag_ms)
        if len(lags):
            misses.append(np.percentile(lags, 90) - abs(error.lag_ms))
    assert len(misses) >= 10
    assert np.median(np.abs(misses)) <= 15.0
    assert np.percentile(np.abs(misses), 90) <= 40.0


def test_incomplete_motion_has_less_range(injections, motion):
    for injection in of_kind(injections, "incomplete"):
        error = injection.error
        assert error.shortfall_deg >= 12.0
        assert error.shortfall_percent >= 15.0
        frames = cut(motion, error, 0.5)
        known, wrong = (compute_segments(each.positions)[frames] for each in (motion, injection.motion))
        lost = [
            np.degrees(np.arccos((part @ part.T).min()) - np.arccos((other @ other.T).min()))
            for part, other in (
                (known[:, SEGMENTS.index(name)].clip(-1, 1), wrong[:, SEGMENTS.index(name)].clip(-1, 1))
                for name in error.segments
            )
        ]
        assert max(lost) > 5.0


def test_partial_and_global_errors_are_large(injections, motion):
    known = compute_segments(motion.positions)
    for injection in of_kind(injections, "partial"):
        frames = cut(motion, injection.error)
        angles = angles_between(known, compute_segments(injection.motion.positions))[frames]
        assert angles.max(axis=1).mean() >= 20.0
    for injection in of_kind(injections, "global"):
        assert set(injection.error.segments) == set(SEGMENTS)
        frames = cut(motion, injection.error)
        wrong = compute_segments(injection.motion.positions)
        wrong = rotate_yaw(wrong, estimate_yaw(known, wrong))
        assert angles_between(known, wrong)[frames].mean() >= 24.0


def test_the_same_seed_gives_the_same_and_another_does_not(motion, donors):
    one, same, other = (inject_keyframes(motion, np.random.default_rng(seed), donors, 2) for seed in (5, 5, 6))
    assert one.errors == same.errors
    assert np.array_equal(one.motion.positions, same.motion.positions)
    assert not np.array_equal(one.motion.positions, other.motion.positions)
    assert not np.array_equal(*(perform_keyframes(motion, np.random.default_rng(seed)).positions for seed in (1, 2)))
    assert np.array_equal(*(perform_keyframes(motion, np.random.default_rng(1)).positions for _ in range(2)))


def test_two_errors_come_in_order_and_may_overlap(motion, donors):
    overlapping, apart = 0, 0
    for seed in range(40):
        injection = inject_keyframes(motion, np.random.default_rng(seed), donors, 2)
        assert 1 <= len(injection.errors) <= 2
        assert np.allclose(bone_lengths(injection.motion.positions), bone_lengths(motion.positions), atol=1e-9)
        if len(injection.errors) < 2:
            continue
        one, other = injection.errors
        assert one.start_s <= other.start_s
        if one.end_s <= other.start_s:
            apart += 1
            continue
        overlapping += 1
        if set(one.segments) & set(other.segments):
            assert {"shift"} < {one.kind, other.kind}
            assert 9 in (len(one.segments), len(other.segments))
    assert overlapping >= 10
    assert apart >= 5


@pytest.mark.parametrize(("seconds", "rate"), [(1.5, 30.0), (1.6, 120.0), (4.0, 15.0), (6.0, 59.94), (60.0, 30.0)])
def test_any_length_and_frame_rate(seconds, rate, donors):
    frames = np.arange(round(seconds * rate)) * 30.0 / rate
    source = make_wandering_motion(seconds + 0.5, seed=3)
    motion = replace(source, positions=at(source.positions, frames), frame_rate=rate)
    made = [inject_keyframes(motion, np.random.default_rng(seed), donors, 1) for seed in range(12)]
    assert sum(each is not None for each in made) >= 6
    for injection in filter(None, made):
        assert injection.motion.n_frames == motion.n_frames
        assert np.isfinite(injection.motion.positions).all()


def test_without_donors_and_without_movement(motion):
    assert inject_keyframes(motion, np.random.default_rng(0), [], 1) is not None
    assert inject_keyframes(motion, np.random.default_rng(0), [], 0) is None
    still = replace(motion, positions=np.repeat(motion.positions[:1], 90, axis=0))
    for seed in range(8):
        injection = inject_keyframes(still, np.random.default_rng(seed), [], 1)
        assert injection is None or injection.error.kind in ("partial", "global")
    short = replace(motion, positions=motion.positions[:9])
    assert inject_keyframes(short, np.random.default_rng(0), [], 1) is None


def test_another_performer_does_the_same_a_little_differently(motion):
    known = compute_segments(motion.positions)
    for seed in range(10):
        other = perform_keyframes(motion, np.random.default_rng(seed))
        assert other.positions.shape == motion.positions.shape
        wrong = compute_segments(other.positions)
        angles = angles_between(known, rotate_yaw(wrong, estimate_yaw(known, wrong)))
        assert 2.0 < angles.mean() < 10.0
        assert np.percentile(angles, 99) < 28.0
        ratios = np.median(bone_lengths(other.positions) / bone_lengths(motion.positions), axis=0)
        assert (ratios > 0.8).all()
        assert (ratios < 1.25).all()
        sides = [(ratios[J[f"{side}_{name}"] - 1] for side in ("left", "right")) for name in ("elbow", "knee", "wrist")]
        assert all(left == pytest.approx(right, rel=0.01) for left, right in sides)
        assert other.height == pytest.approx(motion.height, rel=0.13)


def test_four_seconds_at_30_hz_take_less_than_100_ms(donors):
    motion = make_wandering_motion(4.0, seed=2)
    spent = time.process_time()
    for seed in range(10):
        inject_keyframes(motion, np.random.default_rng(seed), donors, 1)
    assert (time.process_time() - spent) / 10 < 0.1
