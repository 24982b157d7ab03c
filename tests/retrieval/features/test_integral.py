"""Integral features against equations 3-5."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from oracles import hamada

from dousa.errors import InvalidMotionError, OptionError
from dousa.retrieval import compute_interval_means, integrate, list_tests


@given(st.integers(1, 4), st.integers(1, 7), st.integers(1, 4), st.integers(0, 2**32 - 1))
def test_every_mean_is_that_of_the_equations(clips, frames, features, seed):
    pose = np.random.default_rng(seed).normal(size=(clips, frames, features))
    integrals = integrate(pose)
    assert integrals.shape == (clips, features, frames + 1)
    for clip in range(clips):
        for i in range(features):
            series = pose[clip, :, i].tolist()
            assert integrals[clip, i].tolist() == pytest.approx(hamada.integral(series))
            for t0 in range(frames):
                for t1 in range(t0 + 1, frames + 1):
                    mean = compute_interval_means(integrals, t0, t1)[clip, i]
                    assert mean == pytest.approx(hamada.mean_by_sum(series, t0, t1), abs=1e-12)
                    assert mean == hamada.mean_by_integral(integrals[clip, i], t0, t1)


def test_the_paper_has_3080_tests():
    tests = list_tests(56, 10)
    assert tests.tolist() == [[0, i, i, t0, t1] for i, t0, t1 in hamada.parameters(56, 10)]
    assert len(tests) == 3080


def test_no_clips_have_no_integrals():
    assert integrate(np.zeros((0, 10, 56))).shape == (0, 56, 11)


@pytest.mark.parametrize("shape", [(10, 56), (3, 0, 56), (3, 10, 0), (3,)])
def test_other_shapes_are_refused(shape):
    with pytest.raises(InvalidMotionError, match="expected pose features"):
        integrate(np.zeros(shape))


@pytest.mark.parametrize(("start", "stop"), [(0, 0), (3, 2), (-1, 2), (0, 11)])
def test_intervals_outside_the_clip_are_refused(start, stop):
    with pytest.raises(OptionError, match="interval"):
        compute_interval_means(np.zeros((2, 11)), start, stop)
