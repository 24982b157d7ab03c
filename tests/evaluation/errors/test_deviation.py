"""Deviations against plain loops; identity, yaw, a wrong limb, gaps, several takes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles.slow_deviations import measure
from oracles.wrong_dances import ARM, choose, get_dance, lose, place, turn_limb

from dousa.evaluation.errors.evidence import MAX_LAG_S, YAW_SCALE, compute_deviations, merge_takes
from dousa.evaluation.posture.posture import Working, compute_postures, interpolate_segments, thin_postures
from dousa.motion import CanonicalMotion

EVEN = np.ones(9)


def work(motion: CanonicalMotion) -> Working:
    return thin_postures(compute_postures(motion))


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
    assert np.allclose(np.exp(1j * found.yaw), np.exp(1j * yaw), atol=1e-7)
    # 0 says that a segment is not seen, and nothing else.
    assert np.array_equal(found.squared == 0.0, squared == 0.0)


@pytest.mark.parametrize("yaw", [0.0, 0.4, 3.0, -2.2])
def test_the_same_motion_elsewhere_does_not_deviate(yaw: float) -> None:
    motion = get_dance(8.0)
    reference, performance = work(motion), work(place(motion, yaw, 1.0, -2.0, 1.3))
    found = compute_deviations(reference, performance, np.arange(240.0), EVEN)
    assert found.squared[:, found.center].max() < 1e-12
    assert found.judged.all()
    assert np.abs(np.exp(1j * found.yaw[:, found.center]) - np.exp(1j * yaw)).max() < 1e-6
    assert np.abs(found.performance - found.reference).max() < 1e-6
    # At another lag a dancer is elsewhere.
    assert found.squared[:, found.center + 15].sum(axis=1).mean() > 0.1


def test_both_are_turned_so_that_the_reference_faces_one_way() -> None:
    motion = get_dance()
    reference = work(motion)
    found = compute_deviations(reference, reference, np.arange(float(reference.n_frames)), EVEN)
    straight = work(motion).heading
    assert np.ptp(straight) > np.pi  # the dance has a turn
    cosine, sine = np.cos(straight)[:, None], np.sin(straight)[:, None]
    x = found.reference[..., 0] * cosine + found.reference[..., 2] * sine
    z = found.reference[..., 2] * cosine - found.reference[..., 0] * sine
    assert np.allclose(np.stack([x, found.reference[..., 1], z], axis=2), reference.segments, atol=1e-9)


def test_a_shift_is_small_at_its_lag() -> None:
    motion = get_dance(10.0)
    late = choose(motion, np.maximum(np.arange(300) - 9, 0))
    found = compute_deviations(work(motion), work(late), np.arange(300.0), EVEN)
    inner = slice(60, 280)
    assert found.squared[inner, found.center - 9].max() < 1e-9
    assert found.squared[inner, found.center].sum(axis=1).mean() > 0.05


def test_a_wrong_limb_does_not_bend_the_yaw() -> None:
    motion = get_dance(10.0)
    wrong = turn_limb(motion, [f"left_{joint}" for joint in ARM], 70.0, 4.0, 7.0)
    found = compute_deviations(work(motion), work(wrong), np.arange(300.0), EVEN)
    assert np.degrees(np.abs(found.yaw[:, found.center]).max()) < 2.5
    left = np.sqrt(found.squared[135:195, found.center])
    assert np.degrees(left[:, [0, 3, 4, 5, 6, 7, 8]].max()) < 3.0
    assert np.degrees(left[:, 1:3].mean()) > 40.0


def test_what_is_not_seen_is_not_judged() -> None:
    motion = get_dance(8.0)
    gone = lose(motion, ["left_wrist"], 3.0, 4.0)
    for reference, performance in ((motion, gone), (gone, motion)):
        found = compute_deviations(work(reference), work(performance), np.arange(240.0), EVEN)
        lost = ~found.judged
        assert lost[:, 2].sum() == 30 and lost[:, [0, 1, *range(3, 9)]].sum() == 0
        assert (found.squared[lost[:, 2], found.center, 2] == 0.0).all()
        assert (found.squared[:, found.center][found.judged] > 0.0).all()


def test_outside_the_reference_nothing_is_judged() -> None:
    motion = get_dance(8.0)
    found = compute_deviations(work(motion), work(motion), np.arange(240.0) + 100.0, EVEN)
    assert found.judged[:141].all() and not found.judged[142:].any()
    assert np.isfinite(found.squared).all()


def test_the_nearer_take_counts_and_a_gap_in_it_excuses_nothing() -> None:
    motion = get_dance(8.0)
    wrong = turn_limb(motion, [f"left_{joint}" for joint in ARM], 50.0, 2.0, 6.0)
    clock = np.arange(240.0)
    far = compute_deviations(work(motion), work(wrong), clock, EVEN)
    near = compute_deviations(work(wrong), work(wrong), clock, EVEN)
    gone = compute_deviations(work(lose(motion, ["left_elbow", "left_wrist"], 2.0, 6.0)), work(wrong), clock, EVEN)
    for pair in ((far, near), (near, far)):
        assert np.allclose(merge_takes(pair).squared[:, far.center], near.squared[:, far.center], atol=1e-9)
    for pair in ((far, gone), (gone, far)):
        both = merge_takes(pair).squared[70:170, far.center]
        assert np.allclose(both[:, 1:3], far.squared[70:170, far.center, 1:3], rtol=0.2)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_a_few_frames_are_enough(count: int) -> None:
    working = work(get_dance(8.0))
    few = replace(
        working, segments=working.segments[:count], seen=working.seen[:count], heading=working.heading[:count]
    )
    for pair in ((few, working), (working, few), (few, few)):
        found = compute_deviations(*pair, np.arange(float(pair[1].n_frames)), EVEN)
        assert np.isfinite(found.squared).all() and np.isfinite(found.performance).all()


def test_postures_between_frames_are_unit_vectors_and_ends_are_held() -> None:
    segments = work(get_dance(8.0)).segments
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
    assert working.to_seconds(0) == pytest.approx(0.5 * (stride - 1) / rate)


def test_where_a_take_is_not_seen_the_others_speak() -> None:
    dance = get_dance()
    hidden = lose(dance, ["left_elbow", "left_wrist"], 2.0, 5.0)
    first, second = work(dance), work(hidden)
    frames = np.arange(first.n_frames, dtype=np.float64)
    takes = [compute_deviations(take, first, frames, EVEN) for take in (first, second)]
    merged = merge_takes(takes)
    assert not takes[1].judged.all() and takes[0].judged.all()
    assert np.allclose(merged.reference, takes[0].reference, atol=1e-9)
    assert merged.spread.max() < 1e-9
