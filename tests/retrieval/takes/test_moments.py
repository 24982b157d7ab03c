"""Trees over moments, and the sequence of segments, held to slow transcriptions."""

from __future__ import annotations

import numpy as np
import pytest
from oracles.slow_sequence import best_value, value_of

from dousa.retrieval.takes.moment_forest import choose_scale, grow_moment_forest
from dousa.retrieval.takes.moment_kernels import find_best_sequence
from dousa.retrieval.takes.sequence import SequenceModel, SequenceWeights, fit_lengths, join_phases


@pytest.mark.parametrize("seed", range(8))
def test_the_best_sequence_is_that_of_trying_all(seed):
    draw = np.random.default_rng(seed)
    n, count, most = int(draw.integers(1, 7)), int(draw.integers(1, 4)), 7
    evidence, opening, closing = (draw.normal(size=(n, count)) for _ in range(3))
    lengths, again = draw.normal(size=(most, count)), draw.uniform(-1, 2, count)
    begins, before = np.empty((n + 1, count), np.int32), np.empty((n + 1, count), np.int32)
    state = find_best_sequence(evidence, opening, closing, lengths, np.full(count, -9.0), again, begins, before)
    parts, states, stop = [], [], n
    while stop > 0:
        parts.append((int(begins[stop, state]), stop))
        states.append(int(state))
        stop, state = begins[stop, state], before[stop, state]
    ours = value_of(parts[::-1], states[::-1], evidence, opening, closing, lengths, again)
    assert ours == pytest.approx(best_value(evidence, opening, closing, lengths, again))


def test_a_segment_longer_than_the_table_is_one():
    shares = np.zeros((900, 7), np.float32)
    shares[:, 1] = 1.0
    model = SequenceModel(np.log([30.0, 30.0, 30.0]), np.full(3, 0.4), SequenceWeights(1.0, 0.0, 0.0))
    assert {run.state for run in model.find_runs(shares)} == {0}
    assert model.find_runs(shares[:0]) == []


def test_what_begins_and_ends_parts_two_of_one_category():
    shares = np.full((20, 7), 0.001, np.float32)
    shares[:, 1] = 1.0
    for edge in (0, 10):
        shares[edge], shares[edge + 9] = 0.001, 0.001
        shares[edge, 0] = shares[edge + 9, 2] = 1.0
    model = SequenceModel(np.log([60.0, 60.0, 60.0]), np.full(3, 0.4), SequenceWeights(1.0, 0.0, 1.0))
    assert [(run.start, run.stop, run.state) for run in model.find_runs(shares)] == [(0, 10, 0), (10, 20, 0)]
    np.testing.assert_allclose(join_phases(shares).sum(axis=1), shares.sum(axis=1), rtol=1e-6)


def test_lengths_are_those_of_the_segments():
    model = fit_lengths([[30.0] * 50, [60.0, 120.0], []], SequenceWeights())
    np.testing.assert_allclose(np.exp(model.log_lengths[:2]), [30.0, np.sqrt(60.0 * 120.0)])
    assert model.spreads[0] < model.spreads[1]
    wider = model.with_lengths([[90.0]])
    np.testing.assert_allclose(np.exp(wider.log_lengths[2]), 90.0)
    assert wider.log_lengths[-1] == model.log_lengths[-1]


def test_trees_know_what_they_saw_and_do_not_depend_on_threads():
    draw = np.random.default_rng(0)
    labels = draw.integers(0, 4, 600)
    values = (draw.normal(size=(600, 12)) + labels[:, None] * (np.arange(12) % 3 == 0)).astype(np.float32)
    scale = choose_scale(values)
    codes = scale.encode(values)
    forests = [
        grow_moment_forest(codes, labels, np.ones(600), scale, 4, 20, random_state=3, n_jobs=jobs) for jobs in (1, 2)
    ]
    leaves = [forest.apply(codes) for forest in forests]
    np.testing.assert_array_equal(*leaves)
    shares = forests[0].judge(leaves[0])
    np.testing.assert_allclose(shares.sum(axis=1), 1.0, atol=1e-5)
    assert (shares.argmax(axis=1) == labels).mean() > 0.95
    fresh = draw.integers(0, 4, 300)
    unseen = (draw.normal(size=(300, 12)) + fresh[:, None] * (np.arange(12) % 3 == 0)).astype(np.float32)
    assert (forests[0].judge(forests[0].apply(scale.encode(unseen))).argmax(axis=1) == fresh).mean() > 0.6


def test_leaves_are_reached_as_the_nodes_say():
    draw = np.random.default_rng(1)
    values = draw.normal(size=(200, 5)).astype(np.float32)
    scale = choose_scale(values)
    codes = scale.encode(values)
    forest = grow_moment_forest(codes, draw.integers(0, 3, 200), np.ones(200), scale, 3, 3, random_state=0)
    for row, reached in zip(codes[:20], forest.apply(codes[:20]), strict=True):
        for root, leaf in zip(forest.roots, reached, strict=True):
            node = int(root)
            while forest.nodes[node, 2] >= 0:
                value, threshold, left = forest.nodes[node]
                node = int(left) + int(row[value] > threshold)
            assert leaf == -1 - forest.nodes[node, 2]
