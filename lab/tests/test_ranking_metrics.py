"""Scores of rankings: by hand, against scikit-learn, and their bootstrap intervals."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sklearn.metrics import average_precision_score, ndcg_score

from dousa.errors import OptionError
from lab.ranking.metrics import RANKING_SCORES, bootstrap_interval, score_ranking


def test_a_perfect_ranking_scores_1_but_for_what_is_too_few():
    scores = score_ranking([True] * 12 + [False] * 5)
    assert scores.as_row() == pytest.approx((1, 1, 1, 1, 1))
    few = score_ranking([True] * 3 + [False] * 5)
    assert few.as_row() == pytest.approx((1, 0.3, 1, 1, 1))
    assert score_ranking([True]).as_row() == pytest.approx((1, 0.1, 1, 1, 1))
    assert len(few.as_row()) == len(RANKING_SCORES)


def test_a_ranking_by_hand():
    scores = score_ranking([False, True, False, False, True])
    assert scores.p_at_1 == 0 and scores.p_at_10 == pytest.approx(0.2)
    assert scores.average_precision == pytest.approx((1 / 2 + 2 / 5) / 2)
    assert scores.r_precision == pytest.approx(1 / 2)
    best = 1 + 1 / np.log2(3)
    assert scores.ndcg_at_10 == pytest.approx((1 / np.log2(3) + 1 / np.log2(6)) / best)


def test_the_worst_ranking():
    scores = score_ranking([False] * 20 + [True])
    assert scores.as_row() == pytest.approx((0, 0, 1 / 21, 0, 0))


@pytest.mark.parametrize("relevant", [[], [False], [False] * 4])
def test_nothing_relevant_has_no_score(relevant):
    assert np.isnan(score_ranking(relevant).as_row()).all()


@given(st.lists(st.booleans(), min_size=2, max_size=40).filter(any))
def test_scores_are_those_of_scikit_learn(relevant):
    falling = -np.arange(float(len(relevant)))
    scores = score_ranking(relevant)
    assert scores.average_precision == pytest.approx(average_precision_score(relevant, falling))
    wanted = ndcg_score([np.array(relevant, float)], [falling], k=10)
    assert scores.ndcg_at_10 == pytest.approx(wanted)
    assert all(0 <= score <= 1 + 1e-12 for score in scores.as_row())


def test_one_yes_or_no_for_each_clip():
    with pytest.raises(OptionError, match="shape"):
        score_ranking([[True, False]])


def test_interval_holds_the_mean_and_is_that_of_the_normal_distribution():
    values = np.random.default_rng(0).normal(0.5, 0.1, 400)
    interval = bootstrap_interval(values, n_resamples=4000)
    assert interval.mean == pytest.approx(values.mean())
    half = 1.96 * values.std() / 20
    assert interval.low == pytest.approx(values.mean() - half, abs=0.0015)
    assert interval.high == pytest.approx(values.mean() + half, abs=0.0015)
    assert interval == bootstrap_interval(values, n_resamples=4000)
    assert interval != bootstrap_interval(values, n_resamples=4000, random_state=1)


def test_groups_are_drawn_whole():
    values, groups = np.repeat([0.0, 1.0], 50), np.repeat(["al", "bo"], 50)
    together = bootstrap_interval(values, groups=groups)
    assert (together.low, together.mean, together.high) == (0.0, 0.5, 1.0)
    apart = bootstrap_interval(values)
    assert 0.35 < apart.low < 0.5 < apart.high < 0.65


def test_one_value_and_none():
    assert bootstrap_interval([0.25]) == bootstrap_interval([0.25, 0.25])
    assert np.isnan(bootstrap_interval([]).mean)


@pytest.mark.parametrize(
    "options",
    [{"n_resamples": 0}, {"confidence": 1.0}, {"confidence": 0.0}, {"groups": ["al"]}],
)
def test_wrong_options_are_refused(options):
    with pytest.raises(OptionError):
        bootstrap_interval([0.1, 0.2], **options)
