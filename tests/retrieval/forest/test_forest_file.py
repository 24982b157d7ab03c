"""A forest as bytes: nothing is lost, and damaged bytes neither crash nor hang."""

import functools
import io
import json
import zipfile

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dousa.errors import DousaError
from dousa.retrieval import MotionForest
from dousa.retrieval.forest.growth import StandingClips, grow_forest

RANDOM = np.random.default_rng(0)
POSE = RANDOM.normal(size=(40, 3, 4))
WORDS = np.array(["walk", "run", "kick left", "しこ"])[RANDOM.integers(0, 4, 40)]


@functools.cache
def forest_bytes():
    return MotionForest(n_trees=4, n_trials=3, max_entropy=0.5, random_state=2).fit(POSE, WORDS).to_bytes()


def arrays_of(data):
    with np.load(io.BytesIO(data)) as archive:
        return {name: archive[name] for name in archive.files}


def bytes_of(arrays):
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    return buffer.getvalue()


@pytest.mark.parametrize("categories", [WORDS, WORDS.astype(object), RANDOM.integers(-3, 3, 40), POSE[:, 0, 0] > 0])
def test_a_forest_comes_back_as_it_was(categories):
    forest = MotionForest(n_trees=4, n_trials="all", random_state=2, n_jobs=2).fit(POSE, categories)
    copy = MotionForest.from_bytes(forest.to_bytes())
    assert copy.get_params() == forest.get_params()
    assert copy.feature_names_ == forest.feature_names_
    assert (copy.predict(POSE) == forest.predict(POSE)).all()
    assert (copy.predict_proba(POSE, "leaves") == forest.predict_proba(POSE, "leaves")).all()
    assert copy.to_bytes() == forest.to_bytes()


@settings(max_examples=150, deadline=None)
@given(st.data())
def test_any_damage_is_noticed_or_harmless(data):
    damaged = bytearray(forest_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        damaged[data.draw(st.integers(0, len(damaged) - 1))] = data.draw(st.integers(0, 255))
    cut = data.draw(st.integers(0, len(damaged)))
    for candidate in (bytes(damaged), bytes(damaged[:cut])):
        try:
            forest = MotionForest.from_bytes(candidate)
        except DousaError:
            continue
        forest.predict(np.zeros((2, forest.trees_.n_frames, forest.trees_.n_features)))


@pytest.mark.slow
@settings(max_examples=150, deadline=None)
@given(st.data())
def test_any_wrong_number_is_noticed_or_harmless(data):
    """Damage that the zip's checksums cannot see, as somebody made the file on purpose."""
    arrays = arrays_of(forest_bytes())
    name = data.draw(st.sampled_from(["nodes", "roots", "leaf_starts", "leaf_classes", "leaf_counts", "sizes"]))
    flat = arrays[name].reshape(-1)
    limits = np.iinfo(flat.dtype)
    numbers = st.one_of(st.integers(-5, 300), st.integers(int(limits.min), int(limits.max)))
    flat[data.draw(st.integers(0, len(flat) - 1))] = data.draw(numbers)
    try:
        forest = MotionForest.from_bytes(bytes_of(arrays))
    except DousaError:
        return
    clip = np.zeros((1, 3, 4))
    if (forest.trees_.n_frames, forest.trees_.n_features) == (3, 4):
        forest.predict_proba(clip, "leaves")
        forest.predict(clip)


@functools.cache
def grown_bytes():
    forest = MotionForest.from_bytes(forest_bytes())
    there = StandingClips(WORDS, forest.apply(POSE), lambda rows: POSE[rows])
    return grow_forest(forest, there, POSE[:3] + 0.1, np.array(["crawl"] * 3)).forest.to_bytes()


def test_a_forest_that_has_grown_comes_back_with_what_its_training_left():
    forest, trained = (MotionForest.from_bytes(data) for data in (grown_bytes(), forest_bytes()))
    assert forest.to_bytes() == grown_bytes()
    starts, classes, counts = forest.trees_.trained
    assert np.array_equal(starts, trained.trees_.leaf_starts)
    assert np.array_equal(counts, trained.trees_.leaf_counts)
    assert (forest.classes_[classes] == trained.classes_[trained.trees_.leaf_classes]).all()


@pytest.mark.parametrize(
    ("damage", "problem"),
    [
        (lambda a: a.pop("trained_counts"), "other arrays"),
        (lambda a: a.pop("homes"), "leaves of the training"),
        (lambda a: a.update(trained_starts=a["trained_starts"][:-1]), "leaves of the training"),
        (lambda a: a.update(trained_starts=a["trained_starts"][:1]), "leaves of the training"),
        (lambda a: a.update(trained_classes=a["trained_classes"] + np.int32(9)), "does not exist"),
        (lambda a: a.update(trained_counts=np.zeros_like(a["trained_counts"])), "does not exist"),
    ],
)
def test_grown_forests_that_cannot_be_are_refused(damage, problem):
    arrays = arrays_of(grown_bytes())
    damage(arrays)
    with pytest.raises(DousaError, match=problem):
        MotionForest.from_bytes(bytes_of(arrays))


def with_cycle(arrays):
    inner = np.flatnonzero(arrays["nodes"][:, 2] > 2)[0]
    arrays["nodes"][inner, 2] = 0


@pytest.mark.parametrize(
    ("damage", "problem"),
    [
        (with_cycle, "child"),
        (lambda a: a.update(version=np.int64(3)), r"another version of dousa \(3, not 4\)"),
        (lambda a: a.update(version=np.array("one")), "version"),
        (lambda a: a.pop("roots"), "other arrays"),
        (lambda a: a.update(more=np.zeros(3)), "other arrays"),
        (lambda a: a.update(nodes=a["nodes"].astype(np.int64)), "bad nodes"),
        (lambda a: a.update(nodes=a["nodes"][:, :5].copy()), "bad nodes"),
        (lambda a: a.update(nodes=np.asfortranarray(a["nodes"])), "bad nodes"),
        (lambda a: a.update(nodes=a["nodes"][:0]), "bad nodes"),
        (lambda a: a.update(roots=a["roots"][::-1].copy()), "bad roots"),
        (lambda a: a.update(sizes=np.array([0, 3, 4])), "bad sizes"),
        (lambda a: a.update(sizes=np.array([4, 2**62, 4])), "bad sizes"),
        (lambda a: a.update(classes=a["classes"][:2]), "categories"),
        (lambda a: a.update(classes=a["classes"][[0, 0, 1, 2]]), "twice"),
        (lambda a: a.update(feature_names=np.arange(4)), "feature names"),
        (lambda a: a.update(parameters=np.array("{")), "damaged"),
        (lambda a: a.update(parameters=np.array("[1]")), "parameters"),
        (lambda a: a.update(parameters=np.array(json.dumps({"n_trees": -1}))), "n_trees"),
        (lambda a: a.update(parameters=np.array(json.dumps({"evil": 1}))), "evil"),
        (lambda a: a["nodes"].view(np.float64)[:, 2].fill(np.nan), "threshold|leaf"),
    ],
)
def test_forests_that_cannot_be_are_refused(damage, problem):
    arrays = arrays_of(forest_bytes())
    damage(arrays)
    with pytest.raises(DousaError, match=problem):
        MotionForest.from_bytes(bytes_of(arrays))


def test_pickles_and_compressed_bytes_are_refused():
    arrays = arrays_of(forest_bytes())
    arrays["classes"] = np.array(["a", "b", "c", object()], dtype=object)
    with pytest.raises(DousaError, match="damaged or other"):
        MotionForest.from_bytes(bytes_of(arrays))
    squeezed = io.BytesIO()
    with (
        zipfile.ZipFile(io.BytesIO(forest_bytes())) as plain,
        zipfile.ZipFile(squeezed, "w", zipfile.ZIP_DEFLATED) as other,
    ):
        for name in plain.namelist():
            other.writestr(name, plain.read(name))
    with pytest.raises(DousaError, match="compressed"):
        MotionForest.from_bytes(squeezed.getvalue())


@pytest.mark.parametrize("data", [b"", b"PK", b"forest" * 100], ids=len)
def test_other_bytes_are_refused(data):
    with pytest.raises(DousaError, match="the forest: damaged or other"):
        MotionForest.from_bytes(data)


def test_half_a_forest_is_refused():
    with pytest.raises(DousaError, match="the forest: damaged or other"):
        MotionForest.from_bytes(forest_bytes()[: len(forest_bytes()) // 2])
