"""Leaves of large forests grow from a few kept clips: the training is not read, and its clips stay where they are."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles import plain_novelty as slow

from dousa.retrieval import MotionForest
from dousa.retrieval.forest import growth, trees
from dousa.retrieval.forest.growth import StandingClips, find_changed, grow_forest
from dousa.retrieval.forest.standing_leaves import choose_examples
from dousa.retrieval.forest.trees import Subtree, part_strangers


def make_clips(seed=0, n_categories=6, each=40, spread=0.8, frames=3, columns=4):
    """Features (N, T, F), categories, and keys in another order."""
    rng = np.random.default_rng(seed)
    patterns = rng.normal(size=(n_categories, frames, columns))
    own = np.repeat(np.arange(n_categories), each)
    features = patterns[own] + spread * rng.normal(size=(len(own), frames, columns))
    return features, np.array([f"c{c}" for c in own]), rng.permutation(len(own)).astype(np.uint64)


def train(monkeypatch, features, categories, n_trees=6, drawn=40):
    """A forest whose trees grow from some of the clips, so that their leaves have several categories."""
    monkeypatch.setattr(trees, "MOST_GROWN", drawn)
    forest = MotionForest(n_trees, random_state=0, n_jobs=1).fit(features, categories)
    assert forest.trees_.pooled
    return forest


def keep(forest, features, categories, keys):
    """Examples of its leaves (L, E), as places among the clips."""
    order = np.argsort(keys)
    numbers = np.unique(categories, return_inverse=True)[1].astype(np.int32)
    leaves = forest.apply(features)
    return choose_examples([(order, numbers[order], leaves[order])], forest.trees_.n_leaves)


def take_up(forest, clips, n_trained, kept, portions):
    """The forest after some portions of the clips, the leaves of all, and which clips of the training were read."""
    features, categories, keys = clips
    rows, leaves, read = np.arange(n_trained), forest.apply(features[:n_trained]), set()
    for some in portions:

        def give(places, rows=rows):
            read.update(places[places < n_trained].tolist())
            return features[rows[places]]

        standing = StandingClips(
            categories[rows], leaves, give, keys[rows], np.arange(len(rows)) >= n_trained, examples=kept.__getitem__
        )
        grown = grow_forest(forest, standing, features[some], categories[some], keys=keys[some])
        leaves[grown.moved] = grown.moved_leaves
        rows, leaves = np.concatenate([rows, some]), np.concatenate([leaves, grown.leaves])
        forest = MotionForest.from_bytes(grown.forest.to_bytes())
        assert np.array_equal(forest.apply(features[rows[n_trained:]]), leaves[n_trained:])
    return forest, rows, leaves, read


def split(clips, names, more=()):
    """The same clips, those of some categories and some more last; and how many come first."""
    late = np.isin(clips[1], names)
    late[list(more)] = True
    order = np.argsort(late, kind="stable")
    return tuple(part[order] for part in clips), int((~late).sum())


def test_a_new_category_is_learned_from_examples_alone(monkeypatch):
    clips, n_trained = split(make_clips(), ["c2"])
    features, categories, keys = clips
    forest = train(monkeypatch, features[:n_trained], categories[:n_trained])
    kept = keep(forest, features[:n_trained], categories[:n_trained], keys[:n_trained])
    before = forest.apply(features[:n_trained])
    new = np.arange(n_trained, n_trained + 10)
    grown, _, leaves, read = take_up(forest, clips, n_trained, kept, [new])
    assert np.array_equal(leaves[:n_trained], before)
    assert read <= set(kept[kept >= 0].tolist())
    rest = np.arange(n_trained + 10, len(features))
    assert (grown.predict(features[new]) == "c2").all()
    assert (grown.predict(features[rest]) == "c2").mean() > 0.6
    right = [(one.predict(features[:n_trained]) == categories[:n_trained]).mean() for one in (forest, grown)]
    assert right[1] > right[0] - 0.1


def test_leaves_count_what_stands_in_them(monkeypatch):
    """The clips of the training where it left them, the others where the nodes lead them; and the points between."""
    clips, n_trained = split(make_clips(), ["c2"], more=(3, 50, 220))
    features, categories, keys = clips
    forest = train(monkeypatch, features[:n_trained], categories[:n_trained])
    kept = keep(forest, features[:n_trained], categories[:n_trained], keys[:n_trained])
    new = np.arange(n_trained, len(features))  # all 40 of the category: no points between them
    grown, rows, leaves, _ = take_up(forest, clips, n_trained, kept, [new])
    assert grown.trees_.n_leaves > forest.trees_.n_leaves
    counts: dict[int, dict[str, int]] = {}
    for row, own in zip(rows, leaves, strict=True):
        for leaf in own.tolist():
            there = counts.setdefault(leaf, {})
            there[str(categories[row])] = there.get(str(categories[row]), 0) + 1
    for leaf, there in counts.items():
        assert slow.leaf_counts(grown, leaf) == there
    assert grown.trees_.leaf_counts.sum() == len(rows) * 6


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 1000), st.data(), st.sampled_from([(2, 256), (64, 3)]))
def test_the_same_clips_give_the_same_forest_in_whatever_portions(seed, data, most):
    later = np.random.default_rng(seed).choice(200, 6, replace=False)
    clips, n_trained = split(make_clips(seed, each=20, n_categories=5), ["c1"], more=later[later < 100])
    features, categories, keys = clips
    new = np.arange(n_trained, len(features))
    order = np.array(data.draw(st.permutations(new.tolist())))
    cuts = sorted(data.draw(st.sets(st.integers(1, len(new) - 1), max_size=4)))
    with pytest.MonkeyPatch.context() as patch:
        forest = train(patch, features[:n_trained], categories[:n_trained], n_trees=4, drawn=24)
        kept = keep(forest, features[:n_trained], categories[:n_trained], keys[:n_trained])
        patch.setattr(growth, "_MOST_OTHERS", most[0])  # 2: leaves become trees, and leaves again
        patch.setattr(growth, "_MOST_DRAWN", most[1])
        patch.setattr(growth, "_AT_ONCE", 5)
        at_once, in_turns = (take_up(forest, clips, n_trained, kept, p)[0] for p in ([new], np.split(order, cuts)))
    for histogram in ("votes", "leaves"):
        both = [one.predict_proba(features, histogram) for one in (at_once, in_turns)]
        assert np.array_equal(*both)
    entries = [np.bincount(t.leaf_classes, t.leaf_counts**2.0) for t in (at_once.trees_, in_turns.trees_)]
    assert np.array_equal(*entries)


def test_clips_of_categories_that_a_leaf_knows_are_only_counted(monkeypatch):
    made = make_clips()
    some = np.arange(5, 240, 20)  # once more: their categories are in all leaves that they reach
    features, categories = (np.concatenate([part, part[some]]) for part in made[:2])
    keys, n_trained = np.arange(len(features)).astype(np.uint64), len(made[0])
    clips = features, categories, keys
    forest = train(monkeypatch, features[:n_trained], categories[:n_trained])
    kept = keep(forest, features[:n_trained], categories[:n_trained], keys[:n_trained])
    grown, *_, read = take_up(forest, clips, n_trained, kept, [np.arange(n_trained, len(features))])
    assert not read
    assert np.array_equal(grown.trees_.nodes, forest.trees_.nodes)
    assert grown.trees_.leaf_counts.sum() == 6 * len(features)


@pytest.mark.parametrize("how", ["at once", "one by one"])
def test_a_leaf_votes_as_before_until_enough_came_later(monkeypatch, how):
    """Clips that are one of fewer than so many of its clips change nothing in it; one more, and all of them count."""
    features, categories, _ = make_clips(n_categories=2, each=60, spread=2.0)
    n_trained, keys = len(features), np.arange(2 * len(features)).astype(np.uint64)
    clips = np.concatenate([features, features]), np.concatenate([categories, categories]), keys
    forest = train(monkeypatch, features, categories)
    kept = keep(forest, features, categories, keys[:n_trained])
    monkeypatch.setattr(growth, "_MOST_SILENT", 10)
    for count in range(1, 12):
        new = np.arange(n_trained, n_trained + count)
        portions = [new] if how == "at once" else np.split(new, count)
        grown, rows, leaves, _ = take_up(forest, clips, n_trained, kept, portions)
        assert np.array_equal(grown.trees_.nodes, forest.trees_.nodes)
        for leaf in range(forest.trees_.n_leaves):
            there = (leaves == leaf).any(axis=1)
            later = int(there[n_trained:].sum())
            if 10 * later < there.sum():
                there[n_trained:] = False
            names, counts = np.unique(clips[1][rows[there]], return_counts=True)
            assert slow.leaf_counts(grown, leaf) == dict(zip(names.tolist(), counts.tolist(), strict=True))
        changed = find_changed(forest, grown)
        same = [slow.leaf_counts(one, leaf) for leaf in np.flatnonzero(~changed).tolist() for one in (forest, grown)]
        shares = [{name: count / sum(own.values()) for name, count in own.items()} for own in same]
        assert shares[::2] == shares[1::2]
    assert changed.any() and not changed.all()


def test_a_leaf_whose_examples_are_gone_only_counts(monkeypatch):
    clips, n_trained = split(make_clips(), ["c2"])
    features, categories, _ = clips
    forest = train(monkeypatch, features[:n_trained], categories[:n_trained])
    gone = np.full((forest.trees_.n_leaves, 8), -1)
    grown, *_, read = take_up(forest, clips, n_trained, gone, [np.arange(n_trained, len(features))])
    assert not read
    assert np.array_equal(grown.trees_.nodes, forest.trees_.nodes)
    assert grown.trees_.leaf_counts.sum() == 6 * len(features)


def test_what_votes_otherwise_is_told(monkeypatch):
    """A clip votes as before, for categories of the same names, unless it stands in a leaf that has changed."""
    clips, n_trained = split(make_clips(), ["c2"], more=(3, 50, 220))
    features, categories, keys = clips
    forest = train(monkeypatch, features[:n_trained], categories[:n_trained])
    kept = keep(forest, features[:n_trained], categories[:n_trained], keys[:n_trained])
    names = np.where(categories == "c2", "a0", categories)  # all others get another number
    some = np.arange(n_trained, n_trained + 20)
    grown, _, leaves, _ = take_up(forest, (features, names, keys), n_trained, kept, [some])
    changed = find_changed(forest, grown)
    assert len(changed) == grown.trees_.n_leaves
    stay = ~changed[leaves[:n_trained]].any(axis=1)
    assert 0 < stay.sum() < n_trained
    before, now = (one.histograms_of(leaves[:n_trained]) for one in (forest, grown))
    assert np.array_equal(now[stay], np.pad(before[stay], ((0, 0), (1, 0))))
    for leaf in np.flatnonzero(changed[: forest.trees_.n_leaves]).tolist():
        assert slow.leaf_counts(forest, leaf) != slow.leaf_counts(grown, leaf)
    assert not find_changed(grown, grown).any()


def test_clips_that_an_older_dousa_moved_come_back(monkeypatch):
    """Where a leaf had grown from all its clips, and a stranger comes again, those of the training return to it."""
    clips, n_trained = split(make_clips(), ["c2"])
    features, categories, keys = clips
    forest = train(monkeypatch, features[:n_trained], categories[:n_trained])
    kept = keep(forest, features[:n_trained], categories[:n_trained], keys[:n_trained])
    before, new = forest.apply(features[:n_trained]), np.arange(n_trained, n_trained + 10)
    plain = StandingClips(categories[:n_trained], before, lambda places: features[places], keys[:n_trained])
    old = grow_forest(forest, plain, features[new], categories[new], keys=keys[new])
    leaves = before.copy()
    leaves[old.moved] = old.moved_leaves
    assert len(old.moved)
    rows = np.arange(n_trained + 10)
    standing = StandingClips(
        categories[rows], np.concatenate([leaves, old.leaves]), lambda places: features[places], keys[rows],
        rows >= n_trained, examples=kept.__getitem__,
    )  # fmt: skip
    more = np.arange(n_trained + 10, len(features))
    again = grow_forest(old.forest, standing, features[more], categories[more], keys=keys[more])
    assert again.stay is not None
    leaves[again.moved[again.moved < n_trained]] = again.moved_leaves[again.moved < n_trained]
    homes = old.forest.trees_.home_leaves
    touched = np.isin(before, homes[old.forest.apply(features[more])])
    assert np.array_equal(leaves[touched], before[touched])
    assert np.array_equal(again.stay[old.forest.apply(features[:n_trained])][touched], before[touched])


def choose_slowly(categories, leaves, n_leaves, most):
    """One clip after the other; where a leaf is full, one of the most frequent category makes room for a rarer one."""
    kept = [[] for _ in range(n_leaves)]
    for clip, own in enumerate(leaves):
        for leaf in own:
            there = kept[leaf]
            if len(there) < most:
                there.append(clip)
                continue
            counts = {c: sum(categories[other] == c for other in there) for c in categories[there]}
            largest = max(counts.values())
            if largest > counts.get(categories[clip], 0) + 1:
                last = {c: max(k for k, other in enumerate(there) if categories[other] == c) for c in counts}
                first = next(c for c in categories[there] if counts[c] == largest)
                there[last[first]] = clip
    return kept


@given(st.integers(0, 500), st.integers(1, 6), st.sampled_from([1, 2, 3, 8]), st.integers(1, 40))
def test_examples_are_of_each_category_as_many(seed, n_categories, most, at_once):
    rng = np.random.default_rng(seed)
    categories = rng.integers(0, n_categories, 60).astype(np.int32)
    leaves = np.stack([rng.integers(0, 3, 60), 3 + rng.integers(0, 4, 60)], axis=1).astype(np.int32)
    parts = [slice(start, start + at_once) for start in range(0, 60, at_once)]
    kept = choose_examples([(np.arange(60)[p], categories[p], leaves[p]) for p in parts], 7, most)
    for leaf, (own, slowly) in enumerate(zip(kept, choose_slowly(categories, leaves, 7, most), strict=True)):
        there = np.flatnonzero((leaves == leaf).any(axis=1))
        assert own[own >= 0].tolist() == slowly
        assert len(slowly) == min(most, len(there))
        counts = np.bincount(categories[slowly], minlength=n_categories)
        left = np.bincount(categories[there], minlength=n_categories) > counts
        assert counts.max(initial=0) <= counts[left].min(initial=most) + 1


def test_what_is_no_stranger_stays_one_leaf():
    """Of four leaves, two have more strangers (class 1 and 2) than others (class 0)."""
    nodes = np.zeros((7, 6), np.int32)
    nodes[:, 2] = [1, 3, 5, -1, -2, -3, -4]
    starts, classes, counts = np.array([0, 1, 3, 4, 6]), np.array([0, 0, 1, 2, 0, 1]), np.array([5, 1, 3, 2, 4, 4])
    parted = part_strangers(Subtree(9, nodes, starts, classes.astype(np.int32), counts.astype(np.int32)), 0)
    assert parted.nodes[:, 2].tolist() == [1, 3, 5, -1, -2, -3, -1]
    assert (parted.n_leaves, parted.leaf_starts.tolist()) == (3, [0, 1, 3, 4])
    assert (parted.leaf_classes.tolist(), parted.leaf_counts.tolist()) == ([0, 0, 1, 2], [9, 1, 3, 2])
    for usual in (3, 0):  # nobody else, and no strangers
        own = np.full(6, 1 if usual else 0, np.int32)
        stump = part_strangers(Subtree(9, nodes, starts, own, counts.astype(np.int32)), usual)
        assert (len(stump.nodes), stump.leaf_counts.tolist()) == (1, [19])
