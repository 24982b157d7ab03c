"""A search that looks closely at few clips says what one says that measures all of them."""

from __future__ import annotations

import numpy as np
import pytest
from oracles.dense_clips import DenseClips, make_clips

from dousa.library.search import leaf_index
from dousa.library.search.kernels import find_limit
from dousa.library.search.leaf_index import IndexQuery, LeafIndex
from dousa.library.search.ranking import Ranked, rank_index
from dousa.retrieval.ranking.ranking import RANKINGS


def ask(clips: DenseClips, row: int) -> IndexQuery:
    direction = None if clips.directions is None else clips.directions[row]
    return IndexQuery(clips.votes[row], clips.leaves[row], clips.poses[row], direction)


def search(clips: DenseClips, index: LeafIndex, row: int, k: int, by: str, category=None, among=None) -> Ranked:
    return rank_index(index, ask(clips, row), k, by, index.choose(category, among), clips.read_poses)


def compare(index: LeafIndex, found: Ranked, expected, count) -> None:
    assert [index.clip_id(row) for row in found.rows.tolist()] == [one[0] for one in expected]
    for place, one in enumerate(expected):
        own = found.histograms, found.leaves, found.poses, found.distances
        assert np.array_equal([column[place] for column in own], one[1:5], equal_nan=True)
        assert (None if found.alike is None else bool(found.alike[place])) == one[5]
        if found.chances is not None:
            assert found.chances[place] == pytest.approx(one[6], abs=1e-12)
    assert (None if found.all_alike is None else len(found.all_alike)) == count


@pytest.mark.parametrize("by", RANKINGS)
@pytest.mark.parametrize("learned", [True, False])
@pytest.mark.parametrize("pooled", [True, False])
def test_the_first_clips_are_those_of_all(by, learned, pooled):
    for seed in range(6):
        clips = make_clips(seed, 400, 5 + seed, n_leaves=2 + 3 * seed, learned=learned, pooled=pooled)
        index = clips.make_index()
        for row, k in ((0, 1), (7, 10), (50, 64), (123, 150), (7, 399), (9, 1000)):
            expected = clips.rank(row, k, by)
            compare(index, search(clips, index, row, k, by), *expected)


@pytest.mark.parametrize("by", RANKINGS)
def test_several_threads_say_the_same(by, monkeypatch):
    monkeypatch.setattr(leaf_index, "_FEWEST", 20)
    monkeypatch.setattr(leaf_index.os, "cpu_count", lambda: 3)
    clips = make_clips(21, 401, pooled=True)
    for k in (10, 1000):
        index = clips.make_index(130)
        compare(index, search(clips, index, 8, k, by), *clips.rank(8, k, by))


@pytest.mark.parametrize("by", RANKINGS)
def test_parts_are_one_library(by):
    clips = make_clips(11, 300)
    whole, parts = clips.make_index(), clips.make_index(1, 250, 250)
    for row in (0, 260):
        one, other = (search(clips, index, row, 30, by) for index in (whole, parts))
        assert one.rows.tolist() == other.rows.tolist()
        assert np.array_equal(one.distances, other.distances, equal_nan=True)


@pytest.mark.parametrize("by", RANKINGS)
def test_of_a_category_and_of_some_numbers_come_only_these(by):
    clips = make_clips(12, 300)
    index = clips.make_index(100)
    among = frozenset(clips.ids[::2].tolist()) | {7}
    for category, some in (("b", None), (None, among), ("c", among), ("unheard of", None), (None, frozenset())):
        expected = clips.rank(5, 20, by, category, some)
        compare(index, search(clips, index, 5, 20, by, category, some), *expected)


def test_clips_that_are_no_more_are_never_found():
    clips = make_clips(13, 200)
    dead = set(clips.ids[::3].tolist())
    index = clips.make_index(80, dead=dead)
    left = frozenset(clips.ids.tolist()) - dead
    compare(index, search(clips, index, 1, 40, "fused"), *clips.rank(1, 40, "fused", among=left))
    assert index.n_clips == len(left)
    assert all((index.find(number) is None) == (number in dead) for number in clips.ids.tolist())


def test_what_is_told_of_one_clip_is_all_that_is_known():
    clips = make_clips(14, 50)
    index = clips.make_index(20)
    for row, number in enumerate(clips.ids.tolist()):
        own = index.answers_of(number)
        assert np.array_equal(own.votes[0], clips.votes[row]) and np.array_equal(own.leaves[0], clips.leaves[row])
        assert np.array_equal(own.directions[0], clips.directions[row])
        place = index.find(number)
        assert index.path(place).decode() == clips.paths[row] and index.label(place) == clips.labels[row]


def test_leaves_that_two_trees_share_are_compared_as_they_are():
    """Such rows are damaged, but have no checksum to say so."""
    clips = make_clips(15, 60)
    clips.leaves[:, 1] = clips.leaves[:, 0]
    index = clips.make_index(30)
    found = search(clips, index, 3, 60, "leaves")
    expected, _ = clips.rank(3, 60, "leaves")
    assert found.leaves.tolist() == [one[2] for one in expected]


def test_a_limit_lets_enough_pass():
    chance = np.random.default_rng(0)
    bounds = chance.uniform(0, 2.2, 5000)
    bounds[::7] = np.inf
    for least in (1, 10, 4000):
        assert (bounds <= find_limit(bounds, least)).sum() >= least
    assert find_limit(bounds, 5000) == np.inf
