"""Splits: nothing lost, nothing in both, halves per category, performers apart."""

from collections import Counter

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dousa.errors import OptionError, TrainingError
from dousa.experiments.runner import leave_performer_out, split_half


@given(
    st.lists(st.sampled_from("abcd"), min_size=2, max_size=40).filter(lambda labels: max(Counter(labels).values()) > 1),
    st.integers(0, 99),
)
def test_half_of_every_category_trains(labels: list[str], seed: int) -> None:
    split = split_half(labels, seed)
    assert sorted([*split.train, *split.test]) == list(range(len(labels)))
    trained, tested = Counter(labels[k] for k in split.train), Counter(labels[k] for k in split.test)
    for category, count in Counter(labels).items():
        assert trained[category] == (count + 1) // 2
        assert tested[category] == count // 2


def test_the_seed_decides() -> None:
    labels = ["a"] * 30 + ["b"] * 30
    np.testing.assert_array_equal(split_half(labels, 1).test, split_half(labels, 1).test)
    assert split_half(labels, 1).test.tolist() != split_half(labels, 2).test.tolist()


def test_a_category_with_one_clip_trains() -> None:
    split = split_half(["a", "b", "b"], 0)
    assert 0 in split.train and len(split.test) == 1


def test_nothing_left_to_test() -> None:
    with pytest.raises(TrainingError, match="none is left to test"):
        split_half(["a", "b"], 0)
    with pytest.raises(TrainingError, match="got none"):
        split_half([], 0)


def test_performers_are_left_out_one_by_one() -> None:
    performers = ["kim", "bo", "kim", "al", "bo"]
    splits = leave_performer_out(performers)
    assert [split.name for split in splits] == ["al", "bo", "kim"]
    for split in splits:
        assert {performers[k] for k in split.test} == {split.name}
        assert split.name not in {performers[k] for k in split.train}
        assert sorted([*split.train, *split.test]) == list(range(5))


def test_performers_must_be_known_and_several() -> None:
    with pytest.raises(TrainingError, match=r"1 of 2 have none.*clip 1"):
        leave_performer_out(["al", None])
    with pytest.raises(TrainingError, match="at least two"):
        leave_performer_out(["al", "al"])
    with pytest.raises(TrainingError, match="got none"):
        leave_performer_out([])


@pytest.mark.parametrize(("share", "counts"), [(0.3, (3, 1)), (0.5, (5, 1)), (0.9, (9, 1)), (0.31, (4, 1))])
def test_another_share_of_each_category_trains(share, counts):
    labels = ["a"] * 10 + ["b"] * 1
    split = split_half(labels, 0, share)
    trained = [labels[k] for k in split.train]
    assert (trained.count("a"), trained.count("b")) == counts
    assert sorted([*split.train, *split.test]) == list(range(11))


@pytest.mark.parametrize("share", [0.0, 1.0, -0.5, float("nan")])
def test_shares_out_of_range_are_refused(share):
    with pytest.raises(OptionError, match="share of training clips between 0 and 1"):
        split_half(["a"] * 4, 0, share)
