"""Correspondence: the matrix and its paths against oracles and plain dynamic time warping, shifts, tempos, lines."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles import yamane_correlation as oracle

from dousa.errors import InvalidMotionError, OptionError
from dousa.evaluation.alignment.correspondence import (
    compute_correlation_matrix,
    compute_similarity,
    find_path,
)
from dousa.evaluation.posture.posture import LIMBS, compute_postures
from dousa.evaluation.posture.yaw import compute_complex_correlation, rotate_yaw
from dousa.formats.registry import read_motion
from dousa.motion import canonicalise

seeds = st.integers(0, 2**32 - 1)


def unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def dance(seed: int, n: int, rate: float = 30.0) -> np.ndarray:
    """A smooth made-up motion: each segment swings with its own few frequencies below 1 Hz."""
    rng = np.random.default_rng(seed)
    times = np.arange(n)[:, None, None, None] / rate
    frequency, phase = rng.uniform(0.1, 0.9, (9, 3, 4)), rng.uniform(0, 2 * np.pi, (9, 3, 4))
    swing = np.sin(2 * np.pi * frequency * times + phase).sum(axis=-1)
    return unit(0.4 * swing + unit(rng.normal(size=(9, 3))))


def costs(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return 1.0 - compute_similarity(a[:, None], b[None])


def price(a: np.ndarray, b: np.ndarray, path: np.ndarray, skip: float = 0.0) -> float:
    left_out = path[0].sum() + len(a) + len(b) - 2 - path[-1].sum()
    return float((1.0 - compute_similarity(a[path[:, 0]], b[path[:, 1]])).sum() + skip * left_out)


def check_steps(path: np.ndarray) -> None:
    steps = np.diff(path, axis=0)
    assert ((steps >= 0) & (steps <= 1)).all()
    assert (steps.sum(axis=1) > 0).all()


def mean_columns(path: np.ndarray) -> np.ndarray:
    return np.bincount(path[:, 0], path[:, 1]) / np.bincount(path[:, 0])


def test_path_is_that_of_plain_warping_cell_by_cell() -> None:
    a, b = dance(16, 90), dance(16, 70, rate=24.0)
    np.testing.assert_array_equal(find_path(a, b), oracle.warp(costs(a, b))[1])


@settings(max_examples=30, deadline=None)
@given(seeds, st.integers(1, 25), st.integers(1, 25))
def test_open_paths_are_the_cheapest(seed: int, n: int, m: int) -> None:
    rng = np.random.default_rng(seed)
    # Near enough to each other that some are paired and some are left out.
    base = unit(rng.normal(size=(9, 3)))
    a, b = (unit(base + 0.4 * rng.normal(size=(k, 9, 3))) for k in (n, m))
    cheapest, _ = oracle.warp(costs(a, b), skip=0.1)
    found = find_path(a, b, ends="open")
    check_steps(found)
    assert found[0].min() == 0 and (found[-1] == [n - 1, m - 1]).any()
    assert price(a, b, found, 0.1) == pytest.approx(cheapest, abs=1e-4)


@settings(max_examples=15, deadline=None)
@given(seeds, st.sampled_from(["fixed", "open"]))
def test_coarse_to_fine_finds_the_path_of_plain_warping(seed: int, ends: str) -> None:
    rng = np.random.default_rng(seed)
    b = dance(seed, 400)
    places = np.maximum.accumulate(np.clip(np.arange(300) * 1.3 + 8 * rng.normal(size=300).cumsum() / 5, 0, 399))
    a = unit(b[places.astype(int)] + 0.1 * rng.normal(size=(300, 9, 3)))
    found = find_path(a, b, radius=40, ends=ends, coarsest=50)
    check_steps(found)
    whole = find_path(a, b, ends=ends)
    skip = 0.1 if ends == "open" else 0.0
    assert price(a, b, found, skip) <= 1.02 * price(a, b, whole, skip) + 1e-6
    if ends == "fixed":
        assert np.median(np.abs(mean_columns(found) - mean_columns(whole))) <= 1.0


def test_band_of_any_shape_reaches_both_corners() -> None:
    for n, m in ((1, 100), (100, 1), (2, 97), (53, 100), (100, 8), (29, 28)):
        for radius in (1, 5):
            path = find_path(dance(1, n), dance(2, m), radius=radius, coarsest=7)
            check_steps(path)
            assert path[0].tolist() == [0, 0] and path[-1].tolist() == [n - 1, m - 1]


def test_other_order_is_the_same_path() -> None:
    a, b = dance(4, 80), unit(dance(4, 90)[5:] + 0.05)
    np.testing.assert_array_equal(find_path(a, b), find_path(b, a)[:, ::-1])


@pytest.mark.parametrize("lead", [40, -40])
def test_open_ends_leave_out_what_the_other_lacks(lead: int) -> None:
    whole = dance(5, 300)
    a, b = (whole, whole[40:]) if lead > 0 else (whole[40:], whole)
    path = find_path(a, b, ends="open")
    offset = path[:, 0] - path[:, 1]
    assert np.abs(offset - lead).max() <= 6  # a few frames at the corner may be paired with their neighbours
    assert (offset == lead).mean() > 0.95
    part = find_path(whole, whole[90:210], ends="open")
    assert part[0].tolist() == pytest.approx([90, 0], abs=6)
    assert part[-1].tolist() == pytest.approx([209, 119], abs=6)


def test_tempo_is_followed() -> None:
    slow, fast = dance(6, 400), dance(6, 200, rate=15.0)  # the same motion at half the frames
    path = find_path(slow, fast)
    np.testing.assert_allclose(path[:, 0], 2 * path[:, 1], atol=2)


@pytest.mark.parametrize(
    ("folder", "first", "second"),
    [("squat1Reps", "_bd_", "_bk_"), ("lieDownFloor", "_bd_", "_dg_"), ("throwBasketball", "_bk_", "_dg_")],
)
def test_real_takes_of_two_people(shared_data: Callable[[str], Path], folder: str, first: str, second: str) -> None:
    """Coarse to fine against plain warping over the whole matrix, at 30 frames/s for the oracle's sake."""
    takes = []
    for actor in (first, second):
        paths = sorted(p for p in shared_data(f"hdm05/{folder}").iterdir() if actor in p.name)
        takes.append(compute_postures(canonicalise(read_motion(paths[0])), 30.0).segments)
    a, b = takes
    _, expected = oracle.warp(costs(a, b))
    found = find_path(a, b, radius=20, coarsest=25)
    difference = np.abs(mean_columns(found) - mean_columns(np.array(expected)))
    assert np.median(difference) <= 1.0


def test_bad_input() -> None:
    a = dance(0, 20)
    with pytest.raises(InvalidMotionError, match="a: expected at least one frame"):
        find_path(a[:0], a)
    with pytest.raises(InvalidMotionError, match=r"b: expected shape"):
        find_path(a, a[:, :, :2])
    with pytest.raises(InvalidMotionError, match="b: expected finite"):
        find_path(a, a * np.nan)
    with pytest.raises(OptionError, match="radius"):
        find_path(a, a, radius=0)
    with pytest.raises(OptionError, match="'fixed' or 'open', got 'loose'"):
        find_path(a, a, ends="loose")
    with pytest.raises(OptionError, match="weights"):
        find_path(a, a, weights=[1.0] * 3)
    with pytest.raises(OptionError, match="lower the radius"):
        find_path(a, a, largest_gib=399 / 2**30)


def draw(seed: int, n: int = 5) -> np.ndarray:
    return unit(np.random.default_rng(seed).normal(size=(n, 9, 3)))


@settings(max_examples=40, deadline=None)
@given(seeds, st.booleans())
def test_matrix_is_that_of_the_oracle(seed: int, weighted: bool) -> None:
    a, b = draw(seed, 4), draw(seed + 1, 6)
    weights = np.random.default_rng(seed).uniform(0.0, 3.0, 9) if weighted else np.ones(9)
    matrix = compute_correlation_matrix(a, b, weights)
    assert (matrix.shape, matrix.dtype) == ((4, 6), np.float32)
    expected = [[oracle.similarity(oracle.to_paper(x), oracle.to_paper(y), list(weights)) for y in b] for x in a]
    np.testing.assert_allclose(matrix, expected, atol=1e-6)
    np.testing.assert_allclose(compute_similarity(a[:, None], b[None], weights), expected, atol=1e-12)


def test_similarity_is_the_best_mean_cosine_over_yaw() -> None:
    a, b = draw(0, 3), draw(1, 3)
    matrix = compute_correlation_matrix(a, b)
    for t in range(3):
        for u in range(3):
            best = oracle.best_mean_cosine(oracle.to_paper(a[t]), oracle.to_paper(b[u]))
            assert matrix[t, u] == pytest.approx(best, abs=2e-6)


@settings(max_examples=40, deadline=None)
@given(seeds, st.floats(-3.0, 3.0), st.sampled_from(["cosine", "planar"]))
def test_facing_does_not_matter_nor_which_side_is_which(seed: int, theta: float, similarity: str) -> None:
    a, b = draw(seed, 4), draw(seed + 1, 6)
    matrix = compute_correlation_matrix(a, b, similarity=similarity)
    for one, other in ((rotate_yaw(a, theta), b), (a, rotate_yaw(b, theta))):
        np.testing.assert_allclose(compute_correlation_matrix(one, other, similarity=similarity), matrix, atol=1e-6)
    np.testing.assert_allclose(compute_correlation_matrix(b, a, similarity=similarity), matrix.T, atol=1e-6)
    assert (np.abs(matrix) <= 1.0).all()
    own = compute_correlation_matrix(a, rotate_yaw(a, theta), similarity=similarity)
    np.testing.assert_allclose(np.diag(own), 1.0, atol=1e-6)


def test_planar_is_the_modulus_of_the_complex_correlation() -> None:
    a, b = draw(2), draw(3, 8)
    weights = np.arange(1.0, 10.0)
    expected = np.abs(compute_complex_correlation(a[:, None], b[None], weights=weights))
    matrix = compute_correlation_matrix(a, b, weights, similarity="planar")
    np.testing.assert_allclose(matrix, expected, atol=1e-6)
    upright = np.tile([0.0, 1.0, 0.0], (1, 9, 1))
    assert compute_correlation_matrix(upright, b, similarity="planar").max() == 0


def test_only_the_cosine_sees_height() -> None:
    """Arms raised against arms lowered by the same angle: the same from above, not the same posture."""
    a = np.tile([0.0, -1.0, 0.0], (1, 9, 1))
    a[0, 0] = 0.0, 1.0, 0.0
    a[0, LIMBS["left_arm"]] = unit(np.array([1.0, 0.8, 0.2]))
    a[0, LIMBS["right_arm"]] = unit(np.array([-1.0, 0.8, 0.2]))
    b = a.copy()
    b[0, [*LIMBS["left_arm"], *LIMBS["right_arm"]], 1] *= -1.0
    assert compute_correlation_matrix(a, b, similarity="planar")[0, 0] == pytest.approx(1.0, abs=1e-6)
    assert compute_correlation_matrix(a, b)[0, 0] < 0.7


def test_a_segment_of_no_weight_does_not_count() -> None:
    a = draw(4)
    b = a.copy()
    b[:, 3] = draw(5)[:, 3]
    weights = [1.0] * 9
    weights[3] = 0.0
    for similarity in ("cosine", "planar"):
        matrix = compute_correlation_matrix(a, b, weights, similarity)
        np.testing.assert_allclose(np.diag(matrix), 1.0, atol=1e-6)


@pytest.mark.parametrize("shape", [(1, 1), (1, 70), (130, 1), (65, 17), (200, 31)])
def test_tiles_and_threads_change_nothing(shape: tuple[int, int]) -> None:
    a, b = draw(6, shape[0]), draw(7, shape[1])
    alone = compute_correlation_matrix(a, b)
    np.testing.assert_array_equal(compute_correlation_matrix(a, b, worth_threads=0), alone)
    np.testing.assert_allclose(alone, compute_similarity(a[:, None], b[None]), atol=1e-6)


def test_no_frames_make_an_empty_matrix() -> None:
    assert compute_correlation_matrix(draw(0)[:0], draw(1)).shape == (0, 5)


def test_bad_input_of_the_matrix() -> None:
    a = draw(0)
    with pytest.raises(InvalidMotionError, match=r"a: expected shape \(frames, 9, 3\), got \(9, 3\)"):
        compute_correlation_matrix(a[0], a)
    gap = a.copy()
    gap[0, 0] = np.nan
    with pytest.raises(InvalidMotionError, match="b: expected finite"):
        compute_correlation_matrix(a, gap)
    with pytest.raises(OptionError, match="'cosine' or 'planar', got 'sine'"):
        compute_correlation_matrix(a, a, similarity="sine")
    with pytest.raises(OptionError, match=r"weights: .*got \(5, 9\)"):
        compute_correlation_matrix(a, a, np.ones((5, 9)))
    with pytest.raises(OptionError, match="5 x 5 is too large"):
        compute_correlation_matrix(a, a, largest_gib=99 / 2**30)
