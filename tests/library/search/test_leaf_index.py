"""The index of a library holds its rows, and searches that look closely at few clips answer as measuring all would."""

import numpy as np
import pytest
import sqlalchemy as sa
from oracles.dense_clips import DenseClips, make_clips

from dousa.library import Library
from dousa.library.search import leaf_index
from dousa.library.search.kernels import find_limit
from dousa.library.search.leaf_index import LeafIndex, number_meanings, read_index
from dousa.library.search.ranking import rank_rows
from dousa.library.store import schema
from dousa.library.store.engine import read_revision
from dousa.library.store.features import load_poses
from dousa.library.store.forests import load_forest
from dousa.retrieval.ranking.ranking import RANKINGS


def read_densely(library: Library) -> DenseClips:
    """All clips that have leaves, from their rows, with the votes of their trees."""
    clips, table = schema.clips.c, schema.clip_leaves.c
    columns = clips.id, clips.path, clips.category, table.predicted_category, table.leaves, table.direction
    query = sa.select(*columns).join(schema.clip_leaves, table.clip_id == clips.id).order_by(clips.id)
    with library.database.reading() as connection:
        stored = load_forest(connection, library.name)
        rows = connection.execute(query).all()
        poses = load_poses(connection, [row.id for row in rows], stored.feature_set)
    ids, paths, given, predicted, leaves, directions = (list(column) for column in zip(*rows, strict=True))
    reached = np.array([np.frombuffer(own, "<i4") for own in leaves])
    shares = stored.forest.histograms_of(reached.astype(np.int64))
    learned = stored.likeness is not None
    return DenseClips(
        np.array(ids), paths, given, predicted, np.rint(shares * 64 * reached.shape[1]).astype(np.int32), reached,
        np.array([np.frombuffer(own, "<f4") for own in directions]) if learned else None, poses, stored.categories,
        stored.likeness, number_meanings(stored.categories),
    )  # fmt: skip


def check_searches(library: Library, numbers=(1, 8, 14)) -> None:
    """Every ranking of some clips is that of the dense comparison."""
    clips = read_densely(library)
    for number in numbers:
        for by in RANKINGS:
            for k in (3, 200):
                answer = library.search(number, k, ranking=by)
                expected, count = clips.rank(int(np.searchsorted(clips.ids, number)), k, by)
                assert [hit.clip_id for hit in answer.results] == [one[0] for one in expected]
                assert [hit.alike for hit in answer.results] == [one[5] for one in expected]
                own = [hit.distance for hit in answer.results], [one[1] for one in expected]
                assert own[0] == own[1]
                told = [np.nan if hit.rank_distance is None else hit.rank_distance for hit in answer.results]
                assert np.array_equal(told, [one[4] for one in expected], equal_nan=True)
                assert answer.alike_count == count


def test_a_search_says_what_a_comparison_of_all_says(library):
    check_searches(library)


def test_it_does_so_after_every_change(library, moves, write_move, tmp_path):
    library.search(1)
    library.remove([2, 9])
    check_searches(library)
    library.relabel([3, 4], category="nod")
    check_searches(library, (3, 8))
    for seed in range(4):
        write_move(tmp_path / "more" / "bow" / f"{seed}.bvh", "bow", 50 + seed)
    library.add(tmp_path / "more", n_jobs=1)
    check_searches(library, (1, 17, 19))
    library.relabel([5], category=None)
    library.undo()
    library.undo()
    check_searches(library, (1, 5, 8))
    library.train(n_trees=7)
    check_searches(library, (1, 5))


def test_the_index_has_the_rows_of_the_library(library):
    clips = read_densely(library)
    with library.database.reading() as connection:
        stored = load_forest(connection, library.name)
        index = read_index(connection, read_revision(connection), stored)
    assert index.n_clips == len(clips.ids) == 15
    for row, number in enumerate(clips.ids.tolist()):
        own = index.answers_of(number)
        assert np.array_equal(own.votes[0], clips.votes[row]) and np.array_equal(own.leaves[0], clips.leaves[row])
    assert index.find(10**6) is None


@pytest.mark.parametrize("category", ["wave", "bow"])
def test_of_the_same_category_and_of_some_clips(library, category):
    clips = read_densely(library)
    number = library.clips(category=category)[0].id
    answer = library.search(number, 20, same_category=True, among=range(1, 9))
    place = int(np.searchsorted(clips.ids, number))
    expected, count = clips.rank(place, 20, "fused", category, set(range(1, 9)))
    assert [hit.clip_id for hit in answer.results] == [one[0] for one in expected]
    assert answer.alike_count == count


def search(clips: DenseClips, index: LeafIndex, row: int, k: int, by: str, category=None, among=None):
    found = rank_rows(index, clips.ask(row), k, by, index.choose(category, among), clips.read_poses)
    return found.hits(k), found.similar


def compare(found, expected, count) -> None:
    hits, similar = found
    assert [hit.clip_id for hit in hits] == [one[0] for one in expected]
    for hit, one in zip(hits, expected, strict=True):
        own = hit.distance, hit.leaf_share, hit.pose_distance, hit.rank_distance
        distances = [np.nan if value is None else value for value in own]
        assert np.array_equal(distances, [one[1], 1.0 - one[2], *one[3:5]], equal_nan=True)
        assert hit.alike == one[5]
        assert hit.probability == (None if one[6] is None else pytest.approx(one[6], abs=0.5001e-4))
    assert (None if similar is None else len(similar)) == count


@pytest.mark.parametrize("by", RANKINGS)
@pytest.mark.parametrize("learned", [True, False])
@pytest.mark.parametrize("pooled", [True, False])
def test_the_first_clips_are_those_of_all(by, learned, pooled):
    for seed in (0, 5):
        clips = make_clips(seed, 400, 5 + seed, n_leaves=2 + 3 * seed, learned=learned, pooled=pooled)
        index = clips.make_index()
        for row, k in ((0, 1), (7, 10), (50, 64), (123, 150), (7, 399), (9, 1000)):
            expected = clips.rank(row, k, by)
            compare(search(clips, index, row, k, by), *expected)


@pytest.mark.parametrize("by", RANKINGS)
def test_several_threads_say_the_same(by, monkeypatch):
    monkeypatch.setitem(leaf_index._share_out.__kwdefaults__, "fewest", 20)
    monkeypatch.setattr(leaf_index.os, "cpu_count", lambda: 3)
    clips = make_clips(21, 401, pooled=True)
    for k in (10, 1000):
        index = clips.make_index(130)
        compare(search(clips, index, 8, k, by), *clips.rank(8, k, by))


@pytest.mark.parametrize("by", RANKINGS)
def test_of_a_category_and_of_some_numbers_come_only_these(by):
    clips = make_clips(12, 300)
    index = clips.make_index(100)
    among = frozenset(clips.ids[::2].tolist()) | {7}
    for category, some in (("b", None), (None, among), ("c", among), ("unheard of", None), (None, frozenset())):
        expected = clips.rank(5, 20, by, category, some)
        compare(search(clips, index, 5, 20, by, category, some), *expected)


def test_clips_that_are_no_more_are_never_found():
    clips = make_clips(13, 200)
    dead = set(clips.ids[::3].tolist())
    index = clips.make_index(80, dead=dead)
    left = frozenset(clips.ids.tolist()) - dead
    compare(search(clips, index, 1, 40, "fused"), *clips.rank(1, 40, "fused", among=left))
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


def test_a_limit_lets_enough_pass():
    chance = np.random.default_rng(0)
    bounds = chance.uniform(0, 2.2, 5000)
    bounds[::7] = np.inf
    for least in (1, 10, 4000):
        assert (bounds <= find_limit(bounds, least)).sum() >= least
    assert find_limit(bounds, 5000) == np.inf
