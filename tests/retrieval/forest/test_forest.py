"""The motion forest against the paper's steps word by word, against scikit-learn, and its invariances."""

from collections import Counter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles import hamada

from dousa.errors import InvalidMotionError, NotTrainedError, OptionError, TrainingError
from dousa.retrieval import FEATURE_SETS, MotionForest, integrate, list_tests
from dousa.retrieval.forest import trees as trees_module


def clips(seed, n=30, frames=3, features=4, classes=4, steps=None):
    """Pose features with some of their category in them; of few different values if ``steps`` is given."""
    random = np.random.default_rng(seed)
    categories = random.integers(0, classes, n)
    pose = random.normal(size=(n, frames, features))
    pose += 1.5 * random.normal(size=(classes, 1, features))[categories]
    return (pose if steps is None else np.round(pose * steps) / steps), categories


def unfold(forest, tree=0):
    """The fast tree in the form of the oracle's, read through the forest's flat arrays."""
    trees, width = forest.trees_, forest.trees_.n_frames + 1

    def below(node):
        later, sooner, child = (int(value) for value in trees.nodes[node, :3])
        if child < 0:
            start, stop = trees.leaf_starts[-1 - child : 1 - child or None][:2]
            names = forest.classes_[trees.leaf_classes[start:stop]].tolist()
            return {"histogram": Counter(dict(zip(names, trees.leaf_counts[start:stop].tolist(), strict=True)))}
        t0, t1 = sooner % width, later % width
        return {
            "r": (later // width, t0, t1),
            "s": trees.cuts[node, 2] / (t1 - t0),
            "below": below(child),
            "above": below(child + 1),
        }

    return below(int(trees.roots[tree]))


def assert_same_tree(fast, slow):
    assert fast.keys() == slow.keys() - {"gain"}
    if "histogram" in fast:
        assert fast["histogram"] == slow["histogram"]
        return
    assert fast["r"] == slow["r"]
    assert fast["s"] == pytest.approx(slow["s"], abs=1e-9)
    assert_same_tree(fast["below"], slow["below"])
    assert_same_tree(fast["above"], slow["above"])


@settings(max_examples=40, deadline=None)
@given(
    st.integers(0, 2**32 - 1),
    st.integers(1, 40),
    st.integers(1, 6),
    st.sampled_from([None, 1, 4]),
    st.sampled_from([None, 1, 10, "sqrt", "all"]),
    st.sampled_from([0.0, 0.9]),
)
def test_trees_are_those_of_the_steps_word_by_word(seed, n, classes, steps, n_trials, max_entropy):
    pose, categories = clips(seed, n, classes=classes, steps=steps)
    options = {"n_trees": 2, "n_trials": n_trials, "max_entropy": max_entropy, "random_state": seed}
    forest = MotionForest(**options).fit(pose, categories)
    for tree, tree_seed in enumerate(np.random.SeedSequence(seed).generate_state(2, np.uint64)):
        trials = {None: 4, "sqrt": 4, "all": 24}.get(n_trials, n_trials)  # of 4 x 6 tests
        slow = hamada.Tree(pose.tolist(), categories.tolist(), trials, max_entropy, int(tree_seed))
        assert_same_tree(unfold(forest, tree), slow.root)


def test_histograms_are_those_of_section_3_4():
    pose, categories = clips(3, 60, classes=3, steps=2)
    query = clips(4, 20, classes=3)[0]  # with steps, thirds would lie on thresholds or not by rounding
    forest = MotionForest(n_trees=7, n_trials=2, max_entropy=1.0, random_state=5).fit(pose, categories)
    seeds = np.random.SeedSequence(5).generate_state(7, np.uint64)
    slow = [hamada.Tree(pose.tolist(), categories.tolist(), 2, 1.0, int(seed)) for seed in seeds]
    votes, leaves = np.zeros((20, 3)), np.zeros((20, 3))
    for k, clip in enumerate(query.tolist()):
        for tree in slow:
            histogram = tree.leaf(clip)
            votes[k, min(histogram, key=lambda c, h=histogram: (-h[c], c))] += 1 / 7
            for category, count in histogram.items():
                leaves[k, category] += count / histogram.total() / 7
    assert forest.predict_proba(query) == pytest.approx(votes)
    assert forest.predict_proba(query, histogram="leaves") == pytest.approx(leaves)
    assert (forest.predict(query) == forest.predict_proba(query).argmax(axis=1)).all()
    assert [forest.count_votes(clip) for clip in query] == pytest.approx(votes * 7)


def test_entropy_and_gain_are_those_of_scipy_and_scikit_learn():
    """The oracle itself: equations 6 and 7 against libraries that people trust."""
    scipy_stats = pytest.importorskip("scipy.stats")
    sklearn_tree = pytest.importorskip("sklearn.tree")
    pose, categories = clips(11, 50)
    counts = np.bincount(categories)
    assert hamada.entropy(categories.tolist()) == pytest.approx(scipy_stats.entropy(counts, base=2))
    columns = materialise(pose)
    stump = sklearn_tree.DecisionTreeClassifier(criterion="entropy", max_depth=1, random_state=0)
    tree = stump.fit(columns, categories).tree_
    parts = [categories[columns[:, tree.feature[0]] <= tree.threshold[0]].tolist()]
    parts.append(categories[columns[:, tree.feature[0]] > tree.threshold[0]].tolist())
    sizes = tree.n_node_samples / tree.n_node_samples[0]
    gain = tree.impurity[0] - sizes[1] * tree.impurity[1] - sizes[2] * tree.impurity[2]
    assert hamada.gain(categories.tolist(), parts) == pytest.approx(gain)
    slow = hamada.Tree(pose.tolist(), categories.tolist(), 10**6)
    assert slow.root["gain"] == pytest.approx(gain)


def materialise(pose):
    """Every mean of every feature over every interval, as scikit-learn needs them."""
    g = integrate(pose)
    tests = list_tests(pose.shape[2], pose.shape[1])
    means = [(g[:, i, t1] - g[:, i, t0]) / (t1 - t0) for _, i, _, t0, t1 in tests]
    return np.stack(means, axis=1).astype(np.float32).astype(np.float64)


def test_the_full_tree_is_that_of_scikit_learn_where_one_split_is_best():
    sklearn_tree = pytest.importorskip("sklearn.tree")
    tests = [(i, t0, t1) for _, i, _, t0, t1 in list_tests(3, 2).tolist()]
    compared = 0

    def compare(ours, theirs, inside):
        labels = categories[inside].tolist()
        found = [hamada.best_threshold(columns[inside, k].tolist(), labels) for k in range(len(tests))]
        gains = sorted((best[0] for best in found if best is not None), reverse=True)
        if len(set(labels)) < 2 or len(gains) < 2 or gains[0] - gains[1] < 1e-6:
            return 0  # a leaf, or several splits are equally good
        node = nodes[-1]
        assert ours["r"] == tests[theirs.feature[node]]
        assert ours["s"] == pytest.approx(theirs.threshold[node], abs=1e-5)
        is_below = columns[inside, theirs.feature[node]] <= theirs.threshold[node]
        total = 1
        for side, children, part in (
            ("below", theirs.children_left, inside[is_below]),
            ("above", theirs.children_right, inside[~is_below]),
        ):
            nodes.append(children[node])
            total += compare(ours[side], theirs, part)
            nodes.pop()
        return total

    for seed in range(12):
        # Steps of 2**-12: single precision, in which scikit-learn computes, tells the values apart alike.
        pose, categories = clips(seed, 60, frames=2, features=3, classes=3, steps=2**12)
        forest = MotionForest(n_trees=1, n_trials="all").fit(pose, categories)
        columns, nodes = materialise(pose), [0]
        peer = sklearn_tree.DecisionTreeClassifier(criterion="entropy", random_state=0)
        peer.fit(columns, categories)
        assert (forest.predict(pose) == peer.predict(columns)).all()
        compared += compare(unfold(forest), peer.tree_, np.arange(60))
    assert compared > 20


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from([None, 2]))
def test_the_order_of_the_clips_and_the_names_of_the_categories_do_not_matter(seed, steps):
    pose, categories = clips(seed, 50, classes=5, steps=steps)
    query = clips(seed + 1, 20, steps=steps)[0]
    random = np.random.default_rng(seed)
    order, names = random.permutation(50), random.permutation(5)
    forest = MotionForest(n_trees=5, random_state=1).fit(pose, categories)
    shuffled = MotionForest(n_trees=5, random_state=1).fit(pose[order], categories[order])
    assert shuffled.to_bytes() == forest.to_bytes()
    renamed = MotionForest(n_trees=5, random_state=1).fit(pose, names[categories])
    there = np.searchsorted(renamed.classes_, names[forest.classes_])
    shares = renamed.predict_proba(query, histogram="leaves")[:, there]
    assert shares == pytest.approx(forest.predict_proba(query, histogram="leaves"))


def test_the_number_of_workers_does_not_matter():
    pose, categories = clips(0, 200, frames=5, features=6, classes=8)
    one = MotionForest(n_trees=11, random_state=3, n_jobs=1).fit(pose, categories)
    two = MotionForest(n_trees=11, random_state=3, n_jobs=2).fit(pose, categories)
    other = MotionForest(n_trees=11, random_state=4).fit(pose, categories)
    assert (one.trees_.nodes == two.trees_.nodes).all()
    assert one.trees_.nodes.shape != other.trees_.nodes.shape or (one.trees_.nodes != other.trees_.nodes).any()


def test_many_clips_are_sorted_as_few_are():
    """Above 64 clips a node sorts by digits, below by insertion."""
    pose, categories = clips(8, 300, frames=2, features=2, classes=6)
    forest = MotionForest(n_trees=1, n_trials="all").fit(pose, categories)
    slow = hamada.Tree(pose.tolist(), categories.tolist(), 10**6)
    assert_same_tree(unfold(forest), slow.root)


def test_noise_of_rounding_separates_nothing():
    pose = np.ones((4, 3, 2)) + np.array([0, 1e-15, 2e-15, 0])[:, None, None]
    forest = MotionForest(n_trees=2, random_state=0).fit(pose, ["a", "b", "a", "b"])
    assert forest.trees_.n_leaves == 2


def test_one_category_is_always_the_answer():
    forest = MotionForest(random_state=0).fit(np.zeros((2, 10, 56)), ["walk", "walk"])
    assert forest.predict(np.ones((3, 10, 56))).tolist() == ["walk"] * 3
    assert forest.predict_proba(np.ones((3, 10, 56))).tolist() == [[1.0]] * 3
    assert forest.predict(np.ones((0, 10, 56))).shape == (0,)


def test_bootstrap_leaves_some_clips_out():
    pose, categories = clips(5, 60)
    forest = MotionForest(n_trees=4, bootstrap=True, random_state=0).fit(pose, categories)
    plain = MotionForest(n_trees=4, random_state=0).fit(pose, categories)
    assert forest.trees_.leaf_counts.sum() == plain.trees_.leaf_counts.sum() == 4 * 60
    assert (forest.predict(pose) == categories).mean() > 0.8
    assert forest.trees_.n_leaves != plain.trees_.n_leaves


@pytest.mark.parametrize(
    "options",
    [
        {"n_trees": 0}, {"n_trees": 2.5}, {"n_trees": True}, {"n_trials": 0}, {"n_trials": "some"},
        {"max_entropy": -0.1}, {"max_entropy": float("nan")}, {"max_entropy": "0"}, {"bootstrap": "yes"},
        {"random_state": -1}, {"n_jobs": 0},
    ],
    ids=str,
)  # fmt: skip
def test_options_out_of_range_are_refused(options):
    with pytest.raises(OptionError, match=next(iter(options))):
        MotionForest(**options)
    with pytest.raises(OptionError):
        MotionForest().set_params(**options)


def test_unknown_parameters_and_histograms_are_refused():
    with pytest.raises(OptionError, match="no parameter 'depth'"):
        MotionForest().set_params(depth=3)
    forest = MotionForest(n_trees=1).fit(np.zeros((2, 3, 4)), [0, 1])
    with pytest.raises(OptionError, match="votes"):
        forest.predict_proba(np.zeros((2, 3, 4)), histogram="mean")
    with pytest.raises(OptionError, match="feature names"):
        forest.fit(np.zeros((2, 3, 4)), [0, 1], feature_names=["one"])


def test_a_forest_without_training_says_so():
    forest = MotionForest()
    for ask in (
        lambda: forest.predict(np.zeros((1, 10, 56))),
        lambda: forest.classes_,
        lambda: forest.feature_names_,
        lambda: forest.count_votes(np.zeros((10, 56))),
        forest.to_bytes,
    ):
        with pytest.raises(NotTrainedError, match="fit"):
            ask()


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e200])
def test_values_that_are_no_features_are_refused(value):
    pose, categories = clips(0)
    forest = MotionForest(n_trees=2, random_state=0).fit(pose, categories)
    pose[7, 1, 2] = value
    with pytest.raises(InvalidMotionError):
        MotionForest(n_trees=2).fit(pose, categories)
    if not np.isfinite(value):
        with pytest.raises(InvalidMotionError, match="clip 7"):
            forest.predict(pose)
        with pytest.raises(InvalidMotionError, match="finite"):
            forest.count_votes(pose[7])


def test_shapes_that_disagree_are_refused():
    forest = MotionForest(n_trees=2, random_state=0).fit(*clips(0))
    for shape in ((3, 4), (2, 4, 4), (2, 3, 5), (2, 0, 4)):
        with pytest.raises(InvalidMotionError, match="shape"):
            forest.predict(np.zeros(shape))
    for clip in (np.zeros((3, 5)), np.zeros((3, 4), np.float32)):
        with pytest.raises(InvalidMotionError, match="float64"):
            forest.count_votes(clip)
    with pytest.raises(InvalidMotionError, match="numbers"):
        forest.predict([[["high"]]])
    with pytest.raises(TrainingError, match="got none"):
        MotionForest().fit(np.zeros((0, 3, 4)), [])
    for categories in ([0, 1], [[0], [1], [2]], [0.5, 1.5, 2.5], [None, "a", "b"]):
        with pytest.raises(TrainingError, match="categor"):
            MotionForest().fit(np.zeros((3, 3, 4)), np.array(categories))


@pytest.mark.parametrize(("thresholds", "dtype"), [("best", np.float32), ("random", np.float64)])
def test_each_clip_of_the_training_comes_to_the_leaf_that_counts_it(thresholds, dtype):
    """Also where a node has so many clips that some of them choose its test: all of them are parted by it."""
    features = FEATURE_SETS["extended"]
    random = np.random.default_rng(0)
    categories = random.integers(0, 3, 5000)
    pose = np.repeat(random.normal(size=(3, 10, 1)), features.n_columns, axis=2)[categories] + random.normal(
        size=(5000, 10, features.n_columns)
    )
    pose[:, :, 1 + len(features.channels) : 1 + 2 * len(features.channels)] **= 2
    forest = MotionForest(2, n_trials=3, thresholds=thresholds, random_state=0)
    forest.fit(pose.astype(dtype), categories, feature_set=features)
    trees, counted = forest.trees_, np.zeros((forest.trees_.n_leaves, 3), int)
    np.add.at(counted, (forest.apply(pose.astype(dtype)), categories[:, None]), 1)
    leaf = np.repeat(np.arange(trees.n_leaves), np.diff(trees.leaf_starts))
    stored = np.zeros_like(counted)
    stored[leaf, trees.leaf_classes] = trees.leaf_counts
    assert (counted == stored).all()
    assert (stored.max(axis=1) == stored.sum(axis=1)).all()  # grown until every leaf is of one category
    assert (forest.predict(pose.astype(dtype)) == categories).mean() > 0.99


@pytest.mark.slow
def test_some_clips_of_a_large_node_choose_as_well_as_all():
    """Categories overlap, and nodes have up to 4,000 clips."""
    random = np.random.default_rng(1)
    categories = random.integers(0, 8, 5000)
    pose = random.normal(size=(5000, 4, 12)) + 0.8 * random.normal(size=(8, 1, 12))[categories]
    forest = MotionForest(10, n_trials=12, random_state=0).fit(pose[:4000], categories[:4000])
    sklearn_ensemble = pytest.importorskip("sklearn.ensemble")
    peer = sklearn_ensemble.RandomForestClassifier(10, max_features=12, bootstrap=False, random_state=0)
    columns = materialise(pose)
    peer.fit(columns[:4000], categories[:4000])
    ours, theirs = (one == categories[4000:] for one in (forest.predict(pose[4000:]), peer.predict(columns[4000:])))
    assert ours.mean() > theirs.mean() - 0.02


def test_half_of_the_clips_of_each_tree_are_copies():
    pose, categories = clips(0, n=40)
    forest = MotionForest(n_trees=30, random_state=0)
    alone = forest.fit(np.concatenate([pose, pose]), categories, copied=np.arange(40))
    # Copies that are the same say nothing new: the same trees, whichever of the two each of them learned.
    np.testing.assert_array_equal(
        alone.predict_proba(pose), MotionForest(n_trees=30, random_state=0).fit(pose, categories).predict_proba(pose)
    )
    assert alone.trees_.leaf_counts.sum() == 30 * 40
    # Far away copies, one of each clip: a tree has clips there if it learned copies, here if it learned clips.
    far = MotionForest(n_trees=30, random_state=0).fit(np.concatenate([pose, pose + 100]), categories, copied=range(40))
    alike = [np.mean(far.predict_proba(some)[np.arange(40), categories]) for some in (pose, pose + 100)]
    assert alike == pytest.approx([0.75, 0.75], abs=0.2)


def test_a_forest_that_learned_copies_knows_what_noise_does():
    pose, categories = clips(1, n=400)
    shift = np.zeros(pose.shape[2])
    shift[:2] = 4.0  # what the sensor adds to two of four features
    query, expected = pose[200:] + shift, categories[200:]
    pose, categories = pose[:200], categories[:200]
    plain = MotionForest(random_state=0).fit(pose, categories)
    taught = MotionForest(random_state=0).fit(np.concatenate([pose, pose + shift]), categories, copied=range(200))
    right = [np.mean(forest.predict(query) == expected) for forest in (plain, taught)]
    assert right[1] > right[0] + 0.1


@pytest.mark.parametrize("copied", [[0, 0], [-1], [7], [[1]]])
def test_copies_of_clips_that_are_not_there_are_refused(copied):
    pose, categories = clips(0, n=8)
    with pytest.raises(TrainingError, match="copied: expected different clips"):
        MotionForest(n_trees=2).fit(pose, categories[: 8 - len(copied)], copied=copied)


@pytest.mark.parametrize("bootstrap", [False, True])
def test_trees_of_very_many_clips_grow_from_some_and_count_all(monkeypatch, bootstrap):
    monkeypatch.setattr(trees_module, "MOST_GROWN", 300)
    random = np.random.default_rng(4)
    categories = np.concatenate([random.integers(0, 4, 2400), np.full(15, 4)])  # one of them is rare
    pose = random.normal(size=(2415, 3, 6)) + 2.0 * random.normal(size=(5, 1, 6))[categories]
    forests = [
        MotionForest(12, bootstrap=bootstrap, random_state=0, n_jobs=n_jobs).fit(pose[::2], categories[::2])
        for n_jobs in (1, 2)
    ]
    trees = forests[0].trees_
    counted = np.zeros((trees.n_leaves, 5), int)
    np.add.at(counted, (forests[0].apply(pose[::2]), categories[::2, None]), 1)
    leaf = np.repeat(np.arange(trees.n_leaves), np.diff(trees.leaf_starts))
    assert (counted[leaf, trees.leaf_classes] == trees.leaf_counts).all()
    assert trees.leaf_counts.sum() == 12 * len(pose[::2])
    assert trees.n_leaves < 12 * 300
    right = forests[0].predict(pose[1::2]) == categories[1::2]
    assert right.mean() > 0.9 and right[categories[1::2] == 4].mean() > 0.5
    assert forests[0].to_bytes() == forests[1].set_params(n_jobs=1).to_bytes()
    assert (np.unique(trees.nodes[trees.roots], axis=0).shape[0]) > 1  # each tree has drawn its own


def test_trees_that_grow_from_some_share_their_votes(monkeypatch):
    """Leaves then hold clips of several categories, of which the most frequent one alone says less."""
    monkeypatch.setattr(trees_module, "MOST_GROWN", 500)
    random = np.random.default_rng(0)
    patterns = random.normal(size=(40, 4, 12))

    def draw(count):
        own = random.integers(0, 40, count)
        noise = random.normal(size=(count, 1, 12)) + random.normal(size=(count, 4, 12))
        return patterns[own] + 1.2 * noise, own

    (pose, categories), (query, expected) = draw(2400), draw(1000)
    forest = MotionForest(30, random_state=0).fit(pose, categories)
    forest = MotionForest.from_bytes(forest.to_bytes())
    named = forest.trees_.leaf_categories()[forest.apply(query)]
    votes = np.stack([np.bincount(row, minlength=40) for row in named])
    right = [(guess == expected).mean() for guess in (votes.argmax(axis=1), forest.predict(query))]
    assert right[1] > right[0] + 0.03
    assert np.array_equal(forest.predict_proba(query), forest.predict_proba(query, "leaves"))
    assert np.allclose([forest.count_votes(clip) / 30 for clip in query[:50]], forest.predict_proba(query[:50]))
