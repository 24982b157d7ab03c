"""Yaw: eq. 3 to 7 against their literal transcription, known rotations, noise, and a wrong limb."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles import yamane_correlation as oracle
from oracles.wandering import make_wandering_motion

from dousa.arrays import FloatArray
from dousa.errors import InvalidMotionError, OptionError
from dousa.evaluation import assess
from dousa.evaluation.grade.references import compare
from dousa.evaluation.posture.posture import LIMBS, SEGMENTS, Working, compute_postures, thin_postures
from dousa.evaluation.posture.yaw import (
    BETWEEN_DEG,
    Offset,
    compute_complex_correlation,
    estimate_offset,
    estimate_robust_yaw,
    estimate_yaw,
    find_missing,
    learn_between,
    rotate_yaw,
    turn_segments,
)
from dousa.formats.registry import read_motion
from dousa.motion import canonicalise
from dousa.motion.canonical.joints import JOINT_INDEX as J

seeds = st.integers(0, 2**32 - 1)
angles = st.floats(-3.1, 3.1)


def unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def draw(seed: int, n: int = 5) -> np.ndarray:
    return unit(np.random.default_rng(seed).normal(size=(n, 9, 3)))


def apart(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Degrees between angles."""
    return np.degrees(np.abs(np.angle(np.exp(1j * (np.asarray(a) - b)))))


@settings(max_examples=40, deadline=None)
@given(seeds)
def test_correlation_is_that_of_the_paper(seed: int) -> None:
    a, b = draw(seed), draw(seed + 1)
    printed = compute_complex_correlation(a, b, normalisation="segment")
    whole = compute_complex_correlation(a, b)
    for frame in range(len(a)):
        x, y = oracle.to_paper(a[frame]), oracle.to_paper(b[frame])
        assert printed[frame] == pytest.approx(oracle.complex_correlation(x, y) / 9)
        assert whole[frame] == pytest.approx(oracle.pose_correlation(x, y))
        theta = oracle.phase(oracle.pose_correlation(x, y))
        assert estimate_yaw(a[frame], b[frame]) == pytest.approx(theta)


@settings(max_examples=40, deadline=None)
@given(seeds, angles)
def test_rotation_is_that_of_the_paper_and_is_found(seed: int, theta: float) -> None:
    a = draw(seed)
    turned = rotate_yaw(a, theta)
    expected = [oracle.turn(x, theta) for x in oracle.to_paper(a[0])]
    np.testing.assert_allclose(oracle.to_paper(turned[0]), expected, atol=1e-12)
    for normalisation in ("pose", "segment"):
        np.testing.assert_allclose(apart(estimate_yaw(turned, a, normalisation), theta), 0.0, atol=1e-6)
    found, trust = estimate_robust_yaw(turned, a)
    np.testing.assert_allclose(apart(found, theta), 0.0, atol=1e-6)
    np.testing.assert_allclose(trust, 1.0, atol=1e-9)
    np.testing.assert_allclose(np.abs(compute_complex_correlation(turned, a)), 1.0)
    np.testing.assert_allclose(rotate_yaw(turned, -theta), a, atol=1e-12)


@settings(max_examples=30, deadline=None)
@given(seeds, angles)
def test_turning_either_side_changes_only_the_phase(seed: int, theta: float) -> None:
    a, b = draw(seed), draw(seed + 1)
    weights = np.random.default_rng(seed).uniform(0.1, 2.0, 9)
    for normalisation in ("pose", "segment"):
        plain = compute_complex_correlation(a, b, normalisation, weights)
        np.testing.assert_allclose(
            compute_complex_correlation(rotate_yaw(a, theta), b, normalisation, weights),
            plain * np.exp(1j * theta),
            atol=1e-9,
        )
        np.testing.assert_allclose(compute_complex_correlation(b, a, normalisation, weights), plain.conj(), atol=1e-9)
        assert (np.abs(plain) <= 1.0 + 1e-9).all()


def test_weights_of_zero_leave_a_segment_out() -> None:
    a, b = draw(0), draw(1)
    b[:, :8] = rotate_yaw(a, -0.4)[:, :8]
    weights = np.array([1.0] * 8 + [0.0])
    np.testing.assert_allclose(estimate_yaw(a, b, weights=weights), 0.4)
    rows = np.tile(weights, (len(a), 1))
    np.testing.assert_allclose(estimate_yaw(a, b, weights=rows), 0.4)


def test_vertical_postures_have_no_yaw() -> None:
    upright = np.tile([0.0, 1.0, 0.0], (9, 1))
    for normalisation in ("pose", "segment"):
        assert compute_complex_correlation(upright, draw(0)[0], normalisation) == 0
    assert estimate_yaw(upright, upright) == 0
    assert estimate_robust_yaw(upright, upright)[0] == 0


@pytest.fixture(scope="module")
def dance(shared_data: Callable[[str], Path]) -> np.ndarray:
    path = next(shared_data("bandai_dance").glob("*.bvh"))
    return compute_postures(canonicalise(read_motion(path))).segments[::4]


def disturb(segments: np.ndarray, degrees: float, rng: np.random.Generator) -> np.ndarray:
    return unit(segments + rng.normal(size=segments.shape) * np.radians(degrees))


def test_noise_of_upright_segments_does_not_vote(dance: np.ndarray) -> None:
    rng = np.random.default_rng(0)
    theta = rng.uniform(-np.pi, np.pi, len(dance))
    noisy = disturb(rotate_yaw(dance, -theta), 3.0, rng)
    error = {
        name: np.sqrt(np.mean(apart(estimate_yaw(dance, noisy, name), theta) ** 2)) for name in ("pose", "segment")
    }
    assert error["pose"] < 2.5
    assert error["segment"] > 2.0 * error["pose"]
    robust = np.sqrt(np.mean(apart(estimate_robust_yaw(dance, noisy)[0], theta) ** 2))
    assert robust < 1.1 * error["pose"]


@pytest.mark.parametrize("limb", ["left_arm", "right_arm", "left_leg", "right_leg"])
def test_one_wrong_limb_does_not_bend_the_robust_yaw(dance: np.ndarray, limb: str) -> None:
    rng = np.random.default_rng(1)
    theta = rng.uniform(-np.pi, np.pi, len(dance))
    wrong = disturb(rotate_yaw(dance, -theta), 2.0, rng)
    wrong[:, LIMBS[limb]] = unit(rng.normal(size=(len(dance), len(LIMBS[limb]), 3)))
    plain = apart(estimate_yaw(dance, wrong), theta)
    found, trust = estimate_robust_yaw(dance, wrong)
    robust = apart(found, theta)
    assert np.median(robust) < 2.0 < np.median(plain)
    assert np.percentile(robust, 95) < 0.3 * np.percentile(plain, 95)
    others = [number for number in range(9) if number not in LIMBS[limb]]
    assert np.median(trust[:, others]) > 0.9
    assert np.median(trust[:, LIMBS[limb]]) < 0.3


def test_shapes_broadcast_and_one_frame_works() -> None:
    a = draw(0)
    assert estimate_yaw(a, a[0]).shape == (5,)
    assert estimate_yaw(a[:, None], a[None]).shape == (5, 5)
    theta, trust = estimate_robust_yaw(a[:1], a[:1])
    assert (theta.shape, trust.shape) == ((1,), (1, 9))
    assert rotate_yaw(a[0], np.linspace(0, 1, 4)).shape == (4, 9, 3)
    np.testing.assert_allclose(estimate_robust_yaw(a, a, n_rounds=0)[0], 0.0, atol=1e-12)


def test_bad_input() -> None:
    a = draw(0)
    with pytest.raises(InvalidMotionError, match=r"b: expected shape \(\.\.\., 9, 3\), got \(5, 8, 3\)"):
        estimate_yaw(a, a[:, :8])
    gap = a.copy()
    gap[2, 3] = np.nan
    for function in (estimate_yaw, estimate_robust_yaw, compute_complex_correlation):
        with pytest.raises(InvalidMotionError, match="nan"):
            function(a, gap)
    with pytest.raises(InvalidMotionError):
        rotate_yaw([["x"]], 0.0)
    with pytest.raises(OptionError, match="'pose' or 'segment', got 'limb'"):
        compute_complex_correlation(a, a, "limb")
    with pytest.raises(OptionError, match="weights"):
        estimate_yaw(a, a, weights=[1, 2, 3])
    with pytest.raises(OptionError, match="n_rounds"):
        estimate_robust_yaw(a, a, n_rounds=-1)


MOTION = make_wandering_motion(30, 1)
REFERENCE = thin_postures(compute_postures(MOTION, name="reference"))
FRAMES = np.arange(REFERENCE.n_frames)
PAIRS = np.column_stack([FRAMES, FRAMES])


def turn_body(vectors: FloatArray, frames: slice = slice(None)) -> Working:
    """The reference by a body whose segments are turned in its own frame, in some of the frames."""
    heading, segments = REFERENCE.heading[frames], np.array(REFERENCE.segments)
    segments[frames] = rotate_yaw(turn_segments(rotate_yaw(segments[frames], -heading), vectors), heading)
    return replace(REFERENCE, segments=segments)


def make_vectors(degrees: float, *names: str) -> FloatArray:
    """Rotation vectors about the front axis, of these segments."""
    vectors = np.zeros((9, 3))
    vectors[[SEGMENTS.index(name) for name in names], 2] = np.radians(degrees)
    return vectors


@pytest.mark.parametrize("facing", [0.0, 2.0])
def test_an_offset_is_found_whatever_the_heading(facing: float) -> None:
    vectors = make_vectors(8.0, "left_upper_arm", "left_forearm")
    body = turn_body(vectors)
    body = replace(body, segments=rotate_yaw(body.segments, facing), heading=body.heading + facing)
    found = estimate_offset(REFERENCE, body, PAIRS)
    sizes = np.degrees(np.linalg.norm(found.measured, axis=1))
    assert sizes[1:3] == pytest.approx(8.0, abs=1.0)
    assert sizes[[0, 5, 6, 7, 8]].max() < 1.0
    np.testing.assert_allclose(found.degrees[1:3], sizes[1:3], atol=1.0)


def test_errors_in_less_than_half_of_the_time_do_not_bend_it() -> None:
    wrong = turn_body(make_vectors(50.0, "right_upper_arm"), slice(0, 400))
    found = estimate_offset(REFERENCE, wrong, PAIRS)
    assert np.degrees(np.linalg.norm(found.measured[3])) < 2.0


def test_of_more_than_bodies_differ_by_the_rest_stays() -> None:
    found = estimate_offset(REFERENCE, turn_body(make_vectors(60.0, "left_upper_arm")), PAIRS)
    assert np.degrees(np.linalg.norm(found.measured[1])) == pytest.approx(60.0, abs=6.0)
    assert found.degrees[1] < 2.0 * BETWEEN_DEG[1]


def test_a_short_clip_hardly_determines_an_offset() -> None:
    vectors = make_vectors(8.0, "left_upper_arm")
    shares = [
        estimate_offset(REFERENCE, turn_body(vectors), PAIRS[: round(30 * seconds)]).degrees[1] / 8.0
        for seconds in (1.0, 3.0, 30.0)
    ]
    assert shares == sorted(shares)
    assert shares[0] < 0.7 and shares[2] > 0.9


def test_an_error_of_most_of_a_short_clip_is_still_seen() -> None:
    wrong = turn_body(make_vectors(40.0, "left_upper_arm"), slice(0, 36))
    short = replace(wrong, segments=wrong.segments[:60], seen=wrong.seen[:60], heading=wrong.heading[:60])
    found = compare([REFERENCE], short, "same", np.ones(9))
    chords = np.sqrt(found.deviations.squared[:36, found.deviations.center, 1])
    assert np.median(np.degrees(2.0 * np.arcsin(0.5 * chords))) > 25.0


def test_takes_of_several_people_widen_the_limit_and_those_of_one_narrow_it() -> None:
    nothing = np.zeros((9, 3))
    same = Offset(nothing, nothing, np.ones(9), np.zeros(9, bool))
    other = replace(same, measured=nothing + np.radians([20.0, 0.0, 0.0]))
    usual = np.radians(BETWEEN_DEG)
    assert (learn_between([same] * 4) < usual).all()
    assert (learn_between([other] * 4) > usual).all()


def sit(positions: FloatArray) -> FloatArray:
    """Thighs to the front, shanks down, both still."""
    seated = np.array(positions)
    for side in ("left", "right"):
        hip = seated[:, J[f"{side}_hip"]]
        seated[:, J[f"{side}_knee"]] = hip + np.array([0.0, -0.02, 0.4])
        seated[:, J[f"{side}_ankle"]] = hip + np.array([0.0, -0.42, 0.4])
    return seated


def test_who_sits_is_judged_by_the_arms() -> None:
    # The legs of this reference hardly move, and it does not turn.
    positions = np.array(MOTION.positions)
    for name in ("hip", "knee", "ankle"):
        for side in ("left", "right"):
            joint = J[f"{side}_{name}"]
            positions[:, joint] = positions[:, J["pelvis"]] + (positions[0, joint] - positions[0, J["pelvis"]])
    standing = replace(MOTION, positions=positions)
    found = assess(standing, replace(standing, positions=sit(positions)))
    assert np.isnan(found.residual[:, 5:]).all()
    assert found.events == ()
    assert found.score > 90.0


def test_a_limb_that_is_held_still_is_no_missing_part() -> None:
    # A breath of motion is enough: who does not move a limb that should move makes an error.
    segments = np.array(REFERENCE.segments)
    breath = 0.01 * np.sin(FRAMES / 7.0)
    segments[:, 1] = np.column_stack([breath, -np.sqrt(1.0 - breath**2), np.zeros(len(FRAMES))])
    assert not find_missing(REFERENCE, replace(REFERENCE, segments=segments)).any()
    segments[:, 1] = [0.0, -1.0, 0.0]
    assert np.flatnonzero(find_missing(REFERENCE, replace(REFERENCE, segments=segments))).tolist() == [1]


def test_what_is_never_seen_is_missing() -> None:
    seen = np.array(REFERENCE.seen)
    seen[:, [6, 8]] = False
    assert np.flatnonzero(find_missing(replace(REFERENCE, seen=seen), REFERENCE)).tolist() == [6, 8]
