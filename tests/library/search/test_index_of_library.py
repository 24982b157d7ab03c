"""The index of a library says what is written in its rows, and searches answer as by measuring every clip."""

from __future__ import annotations

import numpy as np
import pytest
import sqlalchemy as sa
from oracles.dense_clips import DenseClips

from dousa.library import Library
from dousa.library.search.leaf_index import number_meanings, read_index
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
