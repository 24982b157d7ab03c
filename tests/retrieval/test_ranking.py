"""Ranking against equation 8."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from oracles import hamada

from dousa.errors import InvalidMotionError
from dousa.retrieval import rank_by_histogram


@given(st.integers(1, 6), st.integers(0, 9), st.integers(0, 2**32 - 1))
def test_distances_are_those_of_equation_8_and_ascend(classes, clips, seed):
    random = np.random.default_rng(seed)
    query, histograms = random.random(classes), random.random((clips, classes))
    order, distances = rank_by_histogram(query, histograms)
    assert distances.tolist() == pytest.approx([hamada.distance(query, row) for row in histograms])
    assert sorted(order) == list(range(clips))
    assert (np.diff(distances[order]) >= 0).all()


def test_equals_keep_their_order():
    order, distances = rank_by_histogram([1.0, 0.0], [[0.0, 1.0], [1.0, 0.0], [0.0, 1.0], [1.0, 0.0]])
    assert order.tolist() == [1, 3, 0, 2]
    assert distances.tolist() == pytest.approx([2**0.5, 0, 2**0.5, 0])


@pytest.mark.parametrize(
    ("query", "histograms"),
    [([1.0], [[1.0, 0.0]]), ([[1.0]], [[1.0]]), ([1.0], [1.0]), ([np.nan], [[1.0]]), ([1.0], [[np.inf]])],
)
def test_bad_histograms_are_refused(query, histograms):
    with pytest.raises(InvalidMotionError):
        rank_by_histogram(query, histograms)
