"""Growing leaves: what stays, what moves, what the counts say, and how near it comes to training anew."""

import itertools
import tracemalloc
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles import plain_novelty as slow
from oracles.node_tests import decide, evaluate_test, read_test

from dousa.errors import InvalidMotionError, NotTrainedError, TrainingError
from dousa.retrieval import MotionForest, integrate
from dousa.retrieval.forest import growth, standing_leaves, trees
from dousa.retrieval.forest.growth import StandingClips, grow_forest
from dousa.retrieval.forest.trees import prepare_leaves


def make_clips(seed=0, n_categories=6, each=6, spread=0.6, frames=3, columns=4):
    """Features (N, T, F) and categories."""
    rng = np.random.default_rng(seed)
    patterns = rng.normal(size=(n_categories, frames, columns))
    own = np.repeat(np.arange(n_categories), each)
    return patterns[own] + spread * rng.normal(size=(len(own), frames, columns)), np.array([f"c{c}" for c in own])


def split_off(features, categories, names, count):
    """Places of the clips that train, and of those that come later: ``count`` of each of some categories."""
    later = np.concatenate([np.flatnonzero(categories == name)[:count] for name in names])
    return np.flatnonzero(~np.isin(categories, names)), later


def stand(forest, features, categories):
    return StandingClips(categories, forest.apply(features), lambda rows: features[rows])


def grow(forest, features, categories, old, new, **options):
    standing = stand(forest, features[old], categories[old])
    return grow_forest(forest, standing, features[new], categories[new], **options)


@pytest.fixture(params=["best", "random"])
def forest_and_clips(request):
    features, categories = make_clips()
    old, new = split_off(features, categories, ["c2", "c5"], 3)
    forest = MotionForest(12, thresholds=request.param, random_state=0)
    return forest.fit(features[old], categories[old]), features, categories, old, new


def test_old_splits_stay_where_they_are(forest_and_clips):
    forest, features, categories, old, new = forest_and_clips
    grown = grow(forest, features, categories, old, new).forest
    assert len(grown.trees_.nodes) > len(forest.trees_.nodes)
    for before, after in zip(decisions_of(forest, features), decisions_of(grown, features), strict=True):
        for tree in range(12):
            asked = [one[1:] for one in before if one[0] == tree]
            assert asked == [one[1:] for one in after if one[0] == tree][: len(asked)]


@pytest.mark.parametrize("by_an_older_dousa", [False, True])
def test_a_leaf_of_copies_alone_is_one_when_points_have_come_and_gone(by_an_older_dousa):
    """Copies teach a tree in the stead of their clips, and no clip stands in leaves that only they made."""
    features, categories = make_clips(n_categories=12, each=8, spread=0.8)
    old, new = split_off(features, categories, ["c2", "c5"], 8)
    copies = features[old] + np.random.default_rng(5).normal(0, 1.2, (len(old), *features.shape[1:]))
    both = np.concatenate([features[old], copies])
    trained = MotionForest(12, random_state=0).fit(both, categories[old], copied=np.arange(len(old)))
    keys = mix_keys(len(features))

    def take_up(forest, standing, leaves, some):
        there = StandingClips(
            categories[standing],
            leaves,
            lambda places: features[standing[places]],
            keys[standing],
            np.isin(standing, new),
        )
        return grow_forest(forest, there, features[some], categories[some], keys=keys[some])

    forest, standing, leaves, emptied = trained, old, trained.apply(features[old]), 0
    for one in new:
        growth = take_up(forest, standing, leaves, np.array([one]))
        leaves[growth.moved] = growth.moved_leaves
        leaves, standing, forest = np.concatenate([leaves, growth.leaves]), np.append(standing, one), growth.forest
        if by_an_older_dousa:  # which did not keep what the training left
            forest = forest.with_trees(replace(forest.trees_, trained=None), forest.classes_)
        trees = forest.trees_
        assert (np.diff(trees.leaf_starts) > 0).all()
        assert trees.leaf_shares().sum() == pytest.approx(trees.leaf_votes().sum())
        reached = np.zeros(trees.n_leaves, np.bool_)
        reached[-1 - trees.nodes[trees.nodes[:, 2] < 0, 2]] = True
        empty = np.flatnonzero(reached & (trees.leaf_votes() == 0))
        emptied += len(empty)
        assert not np.isin(leaves, empty).any()
        again = MotionForest.from_bytes(forest.to_bytes())
        assert np.array_equal(again.predict_proba(features), forest.predict_proba(features))
        assert (again.trees_.trained is None) == by_an_older_dousa
    assert (emptied > 0) == by_an_older_dousa
    if by_an_older_dousa:
        return
    at_once = take_up(trained, old, trained.apply(features[old]), new).forest
    probes = np.concatenate([features, copies])
    assert np.allclose(at_once.predict_proba(probes), forest.predict_proba(probes))


def mix_keys(count):
    return standing_leaves.mix(np.arange(count, dtype=np.uint64), np.ones(1, np.uint64))


def decisions_of(forest, features):
    return [
        [
            (one.tree, one.feature, one.kind, one.start, one.stop, one.threshold, one.value)
            for one in decide(forest, clip)
        ]
        for clip in features
    ]


def test_only_moved_clips_stand_in_other_leaves(forest_and_clips):
    forest, features, categories, old, new = forest_and_clips
    growth = grow(forest, features, categories, old, new)
    before, after = forest.apply(features[old]), growth.forest.apply(features[old])
    assert np.array_equal(np.flatnonzero((before != after).any(axis=1)), growth.moved)
    assert np.array_equal(after[growth.moved], growth.moved_leaves)
    assert np.array_equal(growth.forest.apply(features[new]), growth.leaves)
    untouched = np.setdiff1d(before, forest.apply(features[new]))
    assert np.isin(untouched, after).mean() > 0.9


@pytest.mark.parametrize("most_drawn", [3, 256])
def test_leaves_count_the_clips_that_stand_in_them(monkeypatch, most_drawn):
    monkeypatch.setattr(growth, "_MOST_DRAWN", most_drawn)
    features, categories = make_clips(each=4)
    old, new = split_off(features, categories, ["c2"], 4)  # as large as the others: no points between
    forest = MotionForest(10, random_state=0).fit(features[old], categories[old])
    grown = grow(forest, features, categories, old, new).forest
    everyone = np.concatenate([old, new])
    standing: dict[int, Counter[str]] = {}
    for clip, leaves in zip(everyone, grown.apply(features[everyone]), strict=True):
        for leaf in leaves:
            standing.setdefault(int(leaf), Counter())[str(categories[clip])] += 1
    assert len(standing) == grown.trees_.n_leaves
    for leaf, counts in standing.items():
        assert slow.leaf_counts(grown, leaf) == dict(counts)


def test_paths_follow_the_nodes(forest_and_clips):
    forest, features, categories, old, new = forest_and_clips
    grown = grow(forest, features, categories, old, new).forest
    for clip, leaves in zip(features, grown.apply(features), strict=True):
        integrals = integrate(clip[None])[0]

        def is_above(node, integrals=integrals):
            test = read_test(grown.trees_, node)
            return evaluate_test(integrals, test) > test.threshold

        path, leaf = slow.path_of(grown.trees_, is_above)
        assert leaf == leaves[0]
        assert path == sorted(path)


def test_every_clip_keeps_or_gets_its_category(forest_and_clips):
    forest, features, categories, old, new = forest_and_clips
    grown = grow(forest, features, categories, old, new).forest
    assert list(grown.classes_) == ["c0", "c1", "c2", "c3", "c4", "c5"]
    for rows in (old, new):
        assert (grown.predict(features[rows]) == categories[rows]).all()


def test_small_categories_are_filled_up_to_the_usual_size():
    features, categories = make_clips(each=8)
    for count, filled in ((2, 3), (4, 8), (8, 8)):  # 2 clips have one point between them, 4 have six
        old, new = split_off(features, categories, ["c2"], count)
        forest = MotionForest(3, random_state=0).fit(features[old], categories[old])
        trees = grow(forest, features, categories, old, new).forest.trees_
        assert trees.leaf_counts[trees.leaf_classes == 2].sum() == 3 * filled


def test_clips_it_knows_already_split_nothing():
    features, categories = make_clips()
    forest = MotionForest(8, random_state=0).fit(features, categories)
    growth = grow(forest, features, categories, np.arange(len(features)), np.arange(3))
    assert np.array_equal(growth.forest.trees_.nodes, forest.trees_.nodes)
    assert not len(growth.moved)
    assert growth.forest.trees_.leaf_counts.sum() == forest.trees_.leaf_counts.sum() + 8 * 3


def test_one_seed_gives_one_forest_and_the_old_one_stays_as_it_was(forest_and_clips):
    forest, features, categories, old, new = forest_and_clips
    before = forest.to_bytes()
    grown = [grow(forest, features, categories, old, new, random_state=seed).forest.to_bytes() for seed in (1, 1, 2)]
    assert grown[0] == grown[1]
    assert grown[0] != grown[2]
    nothing = grow(forest, features, categories, old, old[:0])
    assert nothing.forest is forest and forest.to_bytes() == before
    assert nothing.leaves.shape == (0, 12) and not len(nothing.moved)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 1000), st.integers(1, 4), st.integers(1, 5), st.booleans())
def test_it_can_grow_again_and_be_stored(seed, first, second, bootstrap):
    features, categories = make_clips(seed)
    old, new = split_off(features, categories, ["c1", "c4"], 6)
    forest = MotionForest(4, bootstrap=bootstrap, random_state=seed).fit(features[old], categories[old])
    rows, leaves = old, forest.apply(features[old])
    for some in (new[:first], new[first : first + second]):
        standing = StandingClips(categories[rows], leaves, lambda picked, rows=rows: features[rows[picked]])
        growth = grow_forest(forest, standing, features[some], categories[some], random_state=seed)
        leaves[growth.moved] = growth.moved_leaves
        rows, leaves = np.concatenate([rows, some]), np.concatenate([leaves, growth.leaves])
        forest = MotionForest.from_bytes(growth.forest.to_bytes())
        assert np.array_equal(forest.apply(features[rows]), leaves)
    assert (forest.predict(features[rows]) == categories[rows]).mean() > (0.8 if bootstrap else 0.9)


def test_it_comes_near_to_training_anew():
    features, categories = make_clips(3, n_categories=10, each=20, spread=0.5, frames=4, columns=6)
    old, new = split_off(features, categories, ["c3", "c7"], 5)
    test = np.setdiff1d(np.arange(len(features)), np.concatenate([old, new]))
    old = old[np.arange(len(old)) % 2 == 0]
    test = np.concatenate([test, np.setdiff1d(np.arange(len(features)), np.concatenate([old, new, test]))])
    forest = MotionForest(60, random_state=0).fit(features[old], categories[old])
    grown = grow(forest, features, categories, old, new).forest
    both = np.concatenate([old, new])
    anew = MotionForest(60, random_state=0).fit(features[both], categories[both])
    right = [(one.predict(features[test]) == categories[test]).mean() for one in (forest, grown, anew)]
    assert right[0] < 0.9
    assert right[1] > right[2] - 0.03


class TestErrors:
    def test_untrained(self):
        with pytest.raises(NotTrainedError):
            grow_forest(MotionForest(2), StandingClips([], np.zeros((0, 2), int), lambda rows: rows), [], [])

    def test_leaves_of_another_forest(self, forest_and_clips):
        forest, features, categories, old, new = forest_and_clips
        standing = StandingClips(categories[old], np.zeros((len(old), 3), int), lambda rows: features[rows])
        with pytest.raises(InvalidMotionError, match="expected leaves"):
            grow_forest(forest, standing, features[new], categories[new])

    @pytest.mark.parametrize("labels", [["c1"], [1, 2, 3, 4, 5, 6], [["c1"] * 6]])
    def test_categories_of_another_kind(self, forest_and_clips, labels):
        forest, features, categories, old, new = forest_and_clips
        with pytest.raises(TrainingError, match="expected a category"):
            grow_forest(forest, stand(forest, features[old], categories[old]), features[new], labels)

    def test_standing_clips_of_strange_categories(self, forest_and_clips):
        forest, features, categories, old, new = forest_and_clips
        standing = stand(forest, features[old], np.full(len(old), "strange"))
        with pytest.raises(TrainingError, match="retrain"):
            grow_forest(forest, standing, features[new], categories[new])


def list_pairs_slowly(own, keys, later, usual):
    """All pairs of a category with a clip that came later are listed; those of the smallest keys are taken."""
    chosen = set()
    for category in set(own[later].tolist()):
        inside = np.flatnonzero(own == category)
        pairs = [frozenset(pair) for pair in itertools.combinations(inside.tolist(), 2) if later[list(pair)].any()]
        drawn = {pair: standing_leaves.mix(*np.sort(keys[list(pair)])[:, None])[0] for pair in pairs}
        chosen |= set(sorted(pairs, key=drawn.__getitem__)[: max(usual - len(inside), 0)])
    return chosen


@given(
    own=st.lists(st.integers(0, 4), min_size=1, max_size=60),
    n_later=st.integers(1, 8),
    usual=st.integers(0, 40),
    filled=st.sampled_from([10, 10**6]),
)
def test_pairs_are_drawn_among_all_that_have_a_later_clip(own, n_later, usual, filled):
    own = np.array(own, np.int32)
    keys = np.random.default_rng(0).integers(0, 2**63, len(own)).astype(np.uint64)
    later = np.arange(len(own)) >= len(own) - n_later
    slow = list_pairs_slowly(own, keys, later, min(usual, filled))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(standing_leaves, "MOST_FILLED", filled)
        pairs = standing_leaves.choose_pairs(own, keys, later, usual)
    found = [frozenset(pair) for pair in zip(pairs.first.tolist(), pairs.second.tolist(), strict=True)]
    assert len(set(found)) == len(found)
    assert set(found) == slow


@pytest.mark.parametrize("sizes", [(20_000, 20_000), (20_000, 20_000, 5_000), (20_000, 20_000, 100)])
def test_one_clip_more_of_a_large_category_lists_no_pairs(sizes):
    own = np.append(np.repeat(np.arange(len(sizes)), sizes), len(sizes) - 1).astype(np.int32)
    keys = standing_leaves.mix(np.arange(len(own), dtype=np.uint64), np.zeros(1, np.uint64))
    later = np.arange(len(own)) == len(own) - 1
    tracemalloc.start()
    pairs = standing_leaves.choose_pairs(own, keys, later, 20_000)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    missing = standing_leaves.MOST_FILLED - sizes[-1] - 1
    assert len(pairs.first) == (min(missing, sizes[-1]) if missing > 0 else 0)
    assert peak < 60_000_000


def take_up(forest, features, categories, keys, old, portions):
    """The forest after some portions of clips, and the leaves of all."""
    rows, leaves = old, forest.apply(features[old])
    for some in portions:
        later = np.arange(len(rows)) >= len(old)
        standing = StandingClips(
            categories[rows], leaves, lambda picked, rows=rows: features[rows[picked]], keys[rows], later
        )
        growth = grow_forest(forest, standing, features[some], categories[some], keys=keys[some])
        leaves[growth.moved] = growth.moved_leaves
        rows, leaves = np.concatenate([rows, some]), np.concatenate([leaves, growth.leaves])
        forest = MotionForest.from_bytes(growth.forest.to_bytes())
        assert np.array_equal(forest.apply(features[rows]), leaves)
    return forest


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 1000), st.data(), st.sampled_from(["best", "random"]), st.sampled_from([(2, 256), (64, 3)]))
def test_the_same_clips_give_the_same_forest_in_whatever_portions(seed, data, thresholds, most):
    features, categories = make_clips(seed, n_categories=5, each=8, spread=0.9)
    old, new = split_off(features, categories, ["c1"], 8)
    more = np.random.default_rng(seed).choice(old, 6, replace=False)
    old, new = np.setdiff1d(old, more), np.concatenate([new, more])
    forest = MotionForest(4, thresholds=thresholds, random_state=seed).fit(features[old], categories[old])
    keys = np.random.default_rng(seed).integers(0, 2**63, len(features)).astype(np.uint64)
    order = np.array(data.draw(st.permutations(new.tolist())))
    cuts = sorted(data.draw(st.sets(st.integers(1, len(new) - 1), max_size=4)))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(growth, "_MOST_OTHERS", most[0])  # 2: leaves become trees, and leaves again
        patch.setattr(growth, "_MOST_DRAWN", most[1])
        patch.setattr(growth, "_AT_ONCE", 5)
        at_once = take_up(forest, features, categories, keys, old, [new])
        in_turns = take_up(forest, features, categories, keys, old, np.split(order, cuts))
    assert decisions_of(at_once, features) == decisions_of(in_turns, features)
    entries = [np.bincount(t.leaf_classes, t.leaf_counts**2.0) for t in (at_once.trees_, in_turns.trees_)]
    assert np.array_equal(*entries)
    for histogram in ("votes", "leaves"):
        both = [one.predict_proba(features, histogram) for one in (at_once, in_turns)]
        assert np.array_equal(*both)


def test_a_leaf_of_very_many_clips_grows_for_more_than_one_stranger():
    rng = np.random.default_rng(0)
    features = rng.normal(size=(402, 3, 2)) + np.repeat([0.0, 9.0], 201)[:, None, None]
    categories = np.repeat(["near", "far"], 201)
    forest = MotionForest(5, random_state=0).fit(features, categories)
    for count, grows in ((1, False), (3, False), (4, True)):
        added = rng.normal(size=(count, 3, 2)) + 30.0
        standing = stand(forest, features, categories)
        read = []
        seen = StandingClips(categories, standing.leaves, lambda rows, read=read: read.append(rows) or features[rows])
        grown = grow_forest(forest, seen, added, ["near"] * count)
        assert (grown.forest.trees_.n_leaves > forest.trees_.n_leaves) == grows
        assert sum(map(len, read)) == (201 if grows else 0)
        assert grown.forest.trees_.leaf_counts.sum() == 5 * (402 + count)
        assert grown.changed.any() == grows


def test_a_leaf_that_was_mixed_from_the_beginning_grows_only_for_strangers():
    """Trees of very many clips grow from samples: their leaves hold several categories from the beginning."""
    rng = np.random.default_rng(0)
    features = rng.normal(size=(60, 3, 2)) + np.repeat([0.0, 0.1, 9.0], 20)[:, None, None]
    categories = np.repeat(["near", "beside", "far"], 20)
    forest = MotionForest(5, max_entropy=1.0, random_state=0).fit(features, categories)
    assert (np.diff(forest.trees_.leaf_starts) > 1).any()
    for name, grows in (("far", False), ("beside", True)):
        both = grow_forest(forest, stand(forest, features, categories), rng.normal(size=(1, 3, 2)) + 9.0, [name])
        assert both.changed.any() == grows


def test_a_leaf_of_many_clips_grows_from_some_of_each_category(monkeypatch):
    monkeypatch.setattr(growth, "_MOST_DRAWN", 16)
    rng = np.random.default_rng(0)
    features = rng.normal(size=(600, 3, 2)) + np.repeat([0.0, 9.0], 300)[:, None, None]
    categories = np.repeat(["near", "far"], 300)
    forest = MotionForest(5, random_state=0).fit(features, categories)
    drawn = []
    monkeypatch.setattr(
        trees, "prepare_leaves", lambda some, *more: drawn.append(len(some)) or prepare_leaves(some, *more)
    )
    new = rng.normal(size=(10, 3, 2)) - 20.0
    grown = grow_forest(forest, stand(forest, features, categories), new, ["new"] * 10).forest
    assert drawn
    assert max(drawn) <= 5 * 16
    assert (grown.predict(new) == "new").all()
    assert (grown.predict(features) == categories).mean() > 0.99
    assert grown.trees_.leaf_counts.sum() == 5 * 610 + 5 * 45  # the points between the new ones
