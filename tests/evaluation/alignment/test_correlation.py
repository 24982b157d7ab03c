"""The correlation matrix: S is the best mean cosine over yaw, |C| is the paper's and blind to height."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles import yamane_correlation as oracle

from dousa.errors import InvalidMotionError, OptionError
from dousa.evaluation.alignment import correspondence
from dousa.evaluation.alignment.correspondence import compute_correlation_matrix, compute_similarity
from dousa.evaluation.posture.posture import LIMBS
from dousa.evaluation.posture.yaw import compute_complex_correlation, rotate_yaw

seeds = st.integers(0, 2**32 - 1)


def unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


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
def test_tiles_and_threads_change_nothing(shape: tuple[int, int], monkeypatch: pytest.MonkeyPatch) -> None:
    a, b = draw(6, shape[0]), draw(7, shape[1])
    alone = compute_correlation_matrix(a, b)
    monkeypatch.setattr(correspondence, "_WORTH_THREADS", 0)
    np.testing.assert_array_equal(compute_correlation_matrix(a, b), alone)
    np.testing.assert_allclose(alone, compute_similarity(a[:, None], b[None]), atol=1e-6)


def test_no_frames_make_an_empty_matrix() -> None:
    assert compute_correlation_matrix(draw(0)[:0], draw(1)).shape == (0, 5)


def test_bad_input(monkeypatch: pytest.MonkeyPatch) -> None:
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
    monkeypatch.setattr(correspondence, "_MOST_PAIRS", 24)
    with pytest.raises(OptionError, match="5 x 5 is too large"):
        compute_correlation_matrix(a, a)
