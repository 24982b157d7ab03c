"""Deviations, evidence and gain: against plain loops, and of motions whose errors have a known size."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles.slow_deviations import measure
from oracles.wrong_dances import (
    ARM,
    EVEN,
    be_late,
    choose,
    first_frames,
    gather_dances,
    get_dance,
    lose,
    place,
    thin,
    turn_limb,
)

from dousa.evaluation.errors.deviations import MAX_LAG_S, YAW_SCALE, compute_deviations, merge_takes
from dousa.evaluation.errors.evidence import (
    CAP,
    Evidence,
    measure_missing_range,
    measure_ranges,
    refine_lag,
)
from dousa.evaluation.posture.posture import Working, compute_postures, interpolate_segments, thin_postures
from dousa.motion import CanonicalMotion

LEFT_ARM = [f"left_{joint}" for joint in ARM]
MOTION = get_dance(12.0)


def gather(performance: CanonicalMotion, reference: CanonicalMotion = MOTION, weights: np.ndarray = EVEN) -> Evidence:
    return gather_dances(performance, reference, weights)


def take_all(evidence: Evidence) -> np.ndarray:
    """(T, K, 9) ratios at every lag."""
    columns = range(evidence.deviations.squared.shape[1])
    return np.stack([evidence.ratio.at_lag(np.full(len(evidence.near), k)) for k in columns], axis=1)


def test_values_at_a_lag_are_those_of_the_column() -> None:
    evidence = gather(turn_limb(MOTION, LEFT_ARM, 15.0, 4.0, 7.0))
    whole = take_all(evidence)
    course = np.array([0, 6, 3, 2, 2])
    found = evidence.ratio.at_lag(course, 150)
    for t, column in enumerate(course):
        assert np.array_equal(found[t], whole[150 + t, column])
    arm = np.array([1, 2])
    np.testing.assert_allclose(evidence.ratio.sum_up(arm), whole[:, :, arm].sum(axis=2), atol=1e-4)


def test_ratios_are_squares_in_multiples_of_the_tolerance_up_to_a_cap() -> None:
    evidence = gather(turn_limb(MOTION, LEFT_ARM, 15.0, 4.0, 7.0))
    apart = evidence.deviations.performance - evidence.deviations.reference
    assert evidence.punctual == pytest.approx((apart**2).sum(axis=2) / np.radians(10.0) ** 2, abs=1e-6)
    assert 1.0 < evidence.punctual[120:210, 1].max() < 1.5**2 + 0.3
    far = gather(turn_limb(MOTION, LEFT_ARM, 120.0, 4.0, 7.0))
    assert take_all(far).max() == CAP
    # A weight counts after the cap.
    weights = np.array([1.0, 2.0, 2.0, *[0.5] * 6])
    heavy = gather(turn_limb(MOTION, LEFT_ARM, 120.0, 4.0, 7.0), weights=weights)
    most = take_all(heavy).max(axis=(0, 1))
    assert most[1] == 2.0 * CAP and most[3] <= 0.5 * CAP


def test_a_small_lag_is_forgiven_a_larger_one_is_not() -> None:
    slightly = gather(choose(MOTION, np.maximum(np.arange(360) - 2, 0)))
    assert slightly.slack == 2
    assert slightly.ordinary[30:330].max() < 1e-6
    assert slightly.punctual[30:330].sum(axis=1).mean() > 0.02
    late = gather(choose(MOTION, np.maximum(np.arange(360) - 9, 0)))
    moving = late.ordinary[30:330].sum(axis=1) > 3.0
    assert np.abs(late.course[30:330][moving] - (late.center - 9)).max() <= 1


@pytest.mark.parametrize("lag_s", [-0.31, -0.12, 0.145, 0.2, 0.42])
def test_the_lag_is_found_to_a_fraction_of_a_frame(lag_s: float) -> None:
    evidence = gather(be_late(MOTION, lag_s, 3.0, 8.0))
    lag = refine_lag(evidence, evidence.course)
    away = np.abs(lag[120:210] - lag_s)
    assert np.percentile(away, 85) < 0.005 and away.max() < 0.035
    # Also from the middle on.
    assert np.array_equal(refine_lag(evidence, evidence.course[120:], 120)[20:-20], lag[140:-20])


@pytest.mark.parametrize("who", ["performance", "reference"])
def test_gaps_are_no_evidence(who: str) -> None:
    gone = lose(MOTION, LEFT_ARM, 4.0, 7.0)
    evidence = gather(gone) if who == "performance" else gather(MOTION, gone)
    assert evidence.ordinary.max() < 0.5
    assert np.abs(refine_lag(evidence, evidence.near)).max() < 0.02


@pytest.mark.parametrize("count", [2, 5, 12])
def test_a_few_frames_are_no_evidence(count: int) -> None:
    few = replace(MOTION, positions=MOTION.positions[:count])
    evidence = gather(few, few)
    assert evidence.ordinary.max() < 1e-9
    assert refine_lag(evidence, evidence.course).shape == (count,)


def draw_working(rng: np.random.Generator, count: int, rate: float, gaps: float) -> Working:
    """A walk on the sphere, so that neighbours in time are alike."""
    segments = rng.normal(size=(1, 9, 3)) + np.cumsum(0.3 * rng.normal(size=(count, 9, 3)), axis=0)
    segments /= np.linalg.norm(segments, axis=2, keepdims=True)
    seen = rng.random((count, 9)) >= gaps
    return Working(segments, seen, np.zeros(count), rate, 1)


@given(seed=st.integers(0, 10_000), rate=st.sampled_from([2.0, 4.0, 7.0]), gaps=st.sampled_from([0.0, 0.2]))
@settings(max_examples=12, deadline=None)
def test_deviations_are_those_of_plain_loops(seed: int, rate: float, gaps: float) -> None:
    rng = np.random.default_rng(seed)
    reference = draw_working(rng, 7, rate, gaps)
    performance = draw_working(rng, 6, rate, gaps)
    weights = rng.uniform(0.2, 2.0, 9)
    frames = rng.uniform(-2.0, 2.0) + rng.uniform(0.5, 1.5) * np.arange(6)
    found = compute_deviations(reference, performance, frames, weights)
    reach, half = round(MAX_LAG_S * rate), max(1, round(0.3 * rate))
    squared, yaw = measure(
        (reference.segments, reference.seen),
        (performance.segments, performance.seen),
        frames,
        weights,
        reach=reach,
        half=half,
        scale=YAW_SCALE,
    )
    assert found.center == reach
    assert found.step_s == pytest.approx(1.0 / rate)
    assert np.allclose(found.squared, squared, atol=1e-9)
    assert np.allclose(np.exp(1j * found.yaw), np.exp(1j * yaw[:, reach]), atol=1e-7)
    # 0 says that a segment is not seen, and nothing else.
    assert np.array_equal(found.squared == 0.0, squared == 0.0)


@pytest.mark.parametrize("yaw", [0.0, 0.4, 3.0, -2.2])
def test_the_same_motion_elsewhere_does_not_deviate(yaw: float) -> None:
    motion = get_dance(8.0)
    reference, performance = thin(motion), thin(place(motion, yaw, 1.0, -2.0, 1.3))
    found = compute_deviations(reference, performance, np.arange(240.0), EVEN)
    assert found.squared[:, found.center].max() < 1e-12
    assert found.judged.all()
    assert np.abs(np.exp(1j * found.yaw) - np.exp(1j * yaw)).max() < 1e-6
    assert np.abs(found.performance - found.reference).max() < 1e-6
    # At another lag a dancer is elsewhere.
    assert found.squared[:, found.center + 15].sum(axis=1).mean() > 0.1


def test_both_are_turned_so_that_the_reference_faces_one_way() -> None:
    motion = get_dance()
    reference = thin(motion)
    found = compute_deviations(reference, reference, np.arange(float(reference.n_frames)), EVEN)
    straight = thin(motion).heading
    assert np.ptp(straight) > np.pi  # the dance has a turn
    cosine, sine = np.cos(straight)[:, None], np.sin(straight)[:, None]
    x = found.reference[..., 0] * cosine + found.reference[..., 2] * sine
    z = found.reference[..., 2] * cosine - found.reference[..., 0] * sine
    assert np.allclose(np.stack([x, found.reference[..., 1], z], axis=2), reference.segments, atol=1e-9)


def test_a_shift_is_small_at_its_lag() -> None:
    motion = get_dance(10.0)
    late = choose(motion, np.maximum(np.arange(300) - 9, 0))
    found = compute_deviations(thin(motion), thin(late), np.arange(300.0), EVEN)
    inner = slice(60, 280)
    assert found.squared[inner, found.center - 9].max() < 1e-9
    assert found.squared[inner, found.center].sum(axis=1).mean() > 0.05


def test_a_wrong_limb_does_not_bend_the_yaw() -> None:
    motion = get_dance(10.0)
    wrong = turn_limb(motion, [f"left_{joint}" for joint in ARM], 70.0, 4.0, 7.0)
    found = compute_deviations(thin(motion), thin(wrong), np.arange(300.0), EVEN)
    assert np.degrees(np.abs(found.yaw).max()) < 2.5
    left = np.sqrt(found.squared[135:195, found.center])
    assert np.degrees(left[:, [0, 3, 4, 5, 6, 7, 8]].max()) < 3.0
    assert np.degrees(left[:, 1:3].mean()) > 40.0


def test_what_is_not_seen_is_not_judged() -> None:
    motion = get_dance(8.0)
    gone = lose(motion, ["left_wrist"], 3.0, 4.0)
    for reference, performance in ((motion, gone), (gone, motion)):
        found = compute_deviations(thin(reference), thin(performance), np.arange(240.0), EVEN)
        lost = ~found.judged
        assert lost[:, 2].sum() == 30 and lost[:, [0, 1, *range(3, 9)]].sum() == 0
        assert (found.squared[lost[:, 2], found.center, 2] == 0.0).all()
        assert (found.squared[:, found.center][found.judged] > 0.0).all()


def test_outside_the_reference_nothing_is_judged() -> None:
    motion = get_dance(8.0)
    found = compute_deviations(thin(motion), thin(motion), np.arange(240.0) + 100.0, EVEN)
    assert found.judged[:141].all() and not found.judged[142:].any()
    assert np.isfinite(found.squared).all()


def test_the_nearer_take_counts_and_a_gap_in_it_excuses_nothing() -> None:
    motion = get_dance(8.0)
    wrong = turn_limb(motion, [f"left_{joint}" for joint in ARM], 50.0, 2.0, 6.0)
    clock = np.arange(240.0)
    far = compute_deviations(thin(motion), thin(wrong), clock, EVEN)
    near = compute_deviations(thin(wrong), thin(wrong), clock, EVEN)
    gone = compute_deviations(thin(lose(motion, ["left_elbow", "left_wrist"], 2.0, 6.0)), thin(wrong), clock, EVEN)
    for pair in ((far, near), (near, far)):
        assert np.allclose(merge_takes(pair).squared[:, far.center], near.squared[:, far.center], atol=1e-9)
    for pair in ((far, gone), (gone, far)):
        both = merge_takes(pair).squared[70:170, far.center]
        assert np.allclose(both[:, 1:3], far.squared[70:170, far.center, 1:3], rtol=0.2)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_a_few_frames_are_enough(count: int) -> None:
    working = thin(get_dance(8.0))
    few = first_frames(working, count)
    for pair in ((few, working), (working, few), (few, few)):
        found = compute_deviations(*pair, np.arange(float(pair[1].n_frames)), EVEN)
        assert np.isfinite(found.squared).all() and np.isfinite(found.performance).all()


def test_postures_between_frames_are_unit_vectors_and_ends_are_held() -> None:
    segments = thin(get_dance(8.0)).segments
    frames = np.array([-3.0, 0.0, 10.25, 238.9, 239.0, 500.0])
    found = interpolate_segments(segments, frames)
    assert np.allclose(np.linalg.norm(found, axis=2), 1.0)
    assert np.allclose(found[[0, 1]], segments[0]) and np.allclose(found[[4, 5]], segments[239])
    assert np.allclose(interpolate_segments(segments[:1], frames), segments[0])


@pytest.mark.parametrize(("rate", "stride"), [(10.0, 1), (30.0, 1), (59.94, 2), (120.0, 4), (100.0, 3)])
def test_working_frames_are_means_of_groups(rate: float, stride: int) -> None:
    motion = replace(lose(get_dance(4.0), ["left_wrist"], 1.0, 1.1), frame_rate=rate)
    postures = compute_postures(motion)
    working = thin_postures(postures)
    assert working.stride == stride and working.frame_rate == pytest.approx(rate / stride)
    assert working.n_frames == postures.n_frames // stride
    group = postures.segments[stride : 2 * stride].mean(axis=0)
    assert np.allclose(working.segments[1], group / np.linalg.norm(group, axis=1, keepdims=True))
    # A group is seen if all of it is.
    lost = np.flatnonzero(~working.seen[:, 2])
    assert np.array_equal(lost, np.unique(np.arange(30, 33) // stride))


def test_where_a_take_is_not_seen_the_others_speak() -> None:
    dance = get_dance()
    hidden = lose(dance, ["left_elbow", "left_wrist"], 2.0, 5.0)
    first, second = thin(dance), thin(hidden)
    frames = np.arange(first.n_frames, dtype=np.float64)
    takes = [compute_deviations(take, first, frames, EVEN) for take in (first, second)]
    merged = merge_takes(takes)
    assert not takes[1].judged.all() and takes[0].judged.all()
    assert np.allclose(merged.reference, takes[0].reference, atol=1e-9)
    assert merged.spread.max() < 1e-9


QUICK = settings(max_examples=25, deadline=None)


def unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def swing(count: int = 40, reach: float = 0.9, seed: int = 0) -> np.ndarray:
    """(T, 2, 3): an upper arm and a forearm that swing about any axes."""
    rng = np.random.default_rng(seed)
    middle, axis = unit(rng.normal(size=(2, 3))), rng.normal(size=(2, 3))
    axis = unit(axis - (axis * middle).sum(axis=1, keepdims=True) * middle)
    angle = reach * np.sin(np.linspace(0.0, 7.0, count))[:, None, None]
    return np.cos(angle) * middle + np.sin(angle) * axis


@given(reach=st.floats(0.05, 1.5))
@QUICK
def test_the_range_of_a_swing_is_twice_its_reach(reach: float) -> None:
    dense = swing(count=80, reach=reach)
    # The sine comes within a frame of both ends.
    assert measure_ranges(dense) == pytest.approx(2 * reach, rel=0.01)
    assert measure_ranges(dense[:1]) == pytest.approx(0.0, abs=1e-7)


def test_missing_range_is_that_of_the_segment_that_lacks_most() -> None:
    reference = np.zeros((60, 9, 3))
    reference[..., 1] = 1.0
    reference[:, 3:5] = swing(60, 0.8, 1)
    smaller = reference.copy()
    smaller[:, 3:5] = swing(60, 0.5, 1)
    missing, share = measure_missing_range(reference, smaller, np.array([3, 4]))
    assert missing == pytest.approx(0.6, abs=0.02)
    assert share == pytest.approx(0.6 / 1.6, abs=0.02)
    assert measure_missing_range(smaller, reference, np.array([3, 4]))[0] == 0.0
