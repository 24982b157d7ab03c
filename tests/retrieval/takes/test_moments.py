"""Discriminants of moments, and the sequence of segments, held to slow transcriptions."""

import itertools

import numpy as np
import pytest
from oracles.short_actions import ACTIONS, make_clip
from oracles.slow_sequence import best_value, value_of

from dousa.motion.canonical.canonicalise import mirror_positions
from dousa.retrieval.takes.made_takes import join_clips
from dousa.retrieval.takes.moment_kernels import find_best_sequence
from dousa.retrieval.takes.moment_model import (
    MomentModel,
    choose_scale,
    describe_moments,
    mirror_moments,
    sharpen,
)
from dousa.retrieval.takes.moment_sums import MomentRows, MomentSums, solve_positive, sum_moments
from dousa.retrieval.takes.sequence import Run, SequenceModel, SequenceWeights, fit_lengths, join_phases


@pytest.mark.parametrize("seed", range(8))
def test_the_best_sequence_is_that_of_trying_all(seed):
    draw = np.random.default_rng(seed)
    n, count, most = int(draw.integers(1, 7)), int(draw.integers(1, 4)), 7
    evidence, opening, closing = (draw.normal(size=(n, count)) for _ in range(3))
    lengths, again = draw.normal(size=(most, count)), draw.uniform(-1, 2, count)
    tables = evidence, opening, closing, lengths, np.full(count, -9.0), again
    begins, before, numbers = np.empty((3, n + 3, count), np.int32)
    state = find_best_sequence(*tables, *np.empty((2, n + 1, count)), np.empty((2, count)), numbers, begins, before)
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


def test_a_long_run_is_cut_where_its_category_ends_and_begins():
    """Also where it was likelier to be one."""
    shares = np.full((50, 7), 0.01, np.float32)
    edges = [4, 13, 25, 33, 45]
    shares[:, 1] = 0.9
    for start, stop in itertools.pairwise(edges):
        shares[[start, stop - 1], 1] = 0.05
        shares[start, 0] = shares[stop - 1, 2] = 0.85
    model = SequenceModel(np.log([60.0, 60.0, 60.0]), np.full(3, 0.4), SequenceWeights(1.0, 0.0, 1.0))
    parts = model.cut_repetitions(shares, Run(4, 45, 0))
    assert [(one.start, one.stop, one.state) for one in parts] == [(a, b, 0) for a, b in itertools.pairwise(edges)]
    assert model.cut_repetitions(shares, Run(4, 25, 0)) == [Run(4, 25, 0)]
    # Nothing says where: all that matters is how long each is.
    even = np.tile(np.float32([0.3, 0.3, 0.3, 0.02, 0.02, 0.02, 0.04]), (45, 1))
    lengths = [one.stop - one.start for one in model.cut_repetitions(even, Run(0, 45, 0))]
    assert sum(lengths) == 45
    assert max(lengths) <= 24
    np.testing.assert_allclose(join_phases(shares).sum(axis=1), shares.sum(axis=1), rtol=1e-6)


def test_lengths_are_those_of_the_segments():
    model = fit_lengths([[30.0] * 50, [60.0, 120.0], []], SequenceWeights())
    np.testing.assert_allclose(np.exp(model.log_lengths[:2]), [30.0, np.sqrt(60.0 * 120.0)])
    assert model.spreads[0] < model.spreads[1]
    wider = model.with_lengths([[90.0]])
    np.testing.assert_allclose(np.exp(wider.log_lengths[2]), 90.0)
    assert wider.log_lengths[-1] == model.log_lengths[-1]


def make_moments(count, seed):
    """Values (count, 12) of four states, of which every third value tells something."""
    draw = np.random.default_rng(seed)
    states = draw.integers(0, 4, count)
    centres = np.random.default_rng(9).normal(size=(4, 12)) * (np.arange(12) % 3 == 0) * 4.0
    return (draw.normal(size=(count, 12)) + centres[states]).astype(np.float32), states


def test_discriminants_are_those_of_the_weighted_least_squares():
    values, states = make_moments(5000, 0)  # more than a block
    weigh, ridge = np.array([1.0, 2.0, 0.5, 1.0]), 0.3
    scale = choose_scale(values)
    codes = scale.encode(values)
    found = sum_moments(scale, codes, np.arange(5000), states, weigh).solve(ridge)
    seen = np.column_stack([(codes - scale.means) / scale.spreads, np.ones(5000)]).astype(np.float64)
    roots = np.sqrt(weigh[states])[:, None]
    # A penalty is as many more moments of nothing.
    penalty = np.sqrt(ridge * weigh[states].sum()) * np.eye(13)[:12]
    rows = np.concatenate([seen * roots, penalty])
    wanted = np.concatenate([np.eye(4)[states] * roots, np.zeros((12, 4))])
    np.testing.assert_allclose(found, np.linalg.lstsq(rows, wanted, rcond=None)[0], atol=2e-4)


@pytest.mark.parametrize("size", [1, 100])
def test_systems_are_solved_as_in_general(size: int):
    draw = np.random.default_rng(size)
    values, shown = draw.normal(size=(2 * size, size)), draw.normal(size=(size, 5)).astype(np.float32)
    squares = (values.T @ values + np.eye(size)).astype(np.float32)
    wanted = np.linalg.solve(squares.astype(np.float64), shown)
    np.testing.assert_allclose(solve_positive(squares, shown), wanted, atol=1e-4 * abs(wanted).max())


def test_what_rounding_left_without_a_factor_is_solved_too():
    squares = np.array([[1.0, 2.0], [2.0, 1.0]], np.float32)  # its values are 3 and -1
    np.testing.assert_allclose(solve_positive(squares, np.eye(2, dtype=np.float32)) @ squares, np.eye(2), atol=1e-6)


@pytest.mark.parametrize("ridge", [0.0, 0.4, 6.4])
def test_moments_fewer_than_values_have_the_discriminants_of_their_sums(ridge):
    draw = np.random.default_rng(0)
    values, states = draw.normal(size=(90, 300)).astype(np.float32), draw.integers(0, 4, 90)
    scale, weigh = choose_scale(values), np.array([1.0, 0.5, 2.0, 0.7])
    codes, rows = scale.encode(values), np.flatnonzero(draw.random(90) < 0.7)
    scores, own = scale.standardise(codes[rows]).astype(np.float64), weigh[states[rows]][:, None]
    squares, shown = scores.T @ (own * scores), scores.T @ (own * np.eye(4)[states[rows]])
    squares[np.diag_indices(301)] += [max(ridge * own.sum(), 1e-3)] * 300 + [1e-3]
    wanted = np.linalg.solve(squares, shown)
    found = MomentRows.create(scale, codes, states, weigh).take(rows)
    np.testing.assert_allclose(found.solve(ridge), wanted, atol=1e-5 * abs(wanted).max())
    np.testing.assert_allclose(found.weights, np.bincount(states[rows], own[:, 0]))


def test_sums_of_some_are_those_of_all_less_the_others():
    values, states = make_moments(600, 1)
    scale, weigh = choose_scale(values), np.ones(4)
    codes = scale.encode(values)
    whole = sum_moments(scale, codes, np.arange(600), states, weigh)
    parts = MomentSums.zero(12, 4)
    for first in (0, 250):
        parts.add(sum_moments(scale, codes, np.arange(first, 250 if first == 0 else 600), states, weigh))
    np.testing.assert_allclose(parts.squares, whole.squares, atol=1e-2)
    np.testing.assert_allclose(parts.shown, whole.shown, atol=1e-2)


def test_moments_never_seen_are_known_by_their_discriminants():
    values, states = make_moments(600, 2)
    scale = choose_scale(values)
    weights = sum_moments(scale, scale.encode(values), np.arange(600), states, np.ones(4)).solve(0.1)
    model = MomentModel(scale, weights, 8.0)
    unseen, fresh = make_moments(300, 3)
    scores = model.judge(unseen)
    shares = sharpen(scores, model.sharpness)
    np.testing.assert_allclose(shares.sum(axis=1), 1.0, atol=1e-5)
    assert (shares.argmax(axis=1) == fresh).mean() > 0.85
    # What is judged are the values; bytes are nearly as good.
    np.testing.assert_allclose(scores, scale.standardise(scale.encode(unseen)) @ weights, atol=0.02)


def test_the_moments_of_a_mirror_image_are_told_from_those_of_the_recording():
    clip = join_clips([make_clip(action, 3) for action in ACTIONS], np.random.default_rng(0))
    own, image = (
        np.concatenate([values for _, values in describe_moments(points, clip.height)])
        for points in (clip.positions, mirror_positions(clip.positions))
    )
    np.testing.assert_allclose(mirror_moments(own), image, atol=1e-5)
    np.testing.assert_array_equal(mirror_moments(mirror_moments(own)), own)
    assert np.abs(own - image).max() > 0.1
