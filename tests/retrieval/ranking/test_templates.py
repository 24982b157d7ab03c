"""Motion templates: kernels against slow oracles, learning, classification, damaged input."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles import motion_templates as oracle

from dousa.errors import NotTrainedError, OptionError, TrainingError
from dousa.retrieval.ranking.templates import (
    MotionTemplates,
    _equalise,
    _learn_average,
    _merge,
    _round_off,
    merge_along_path,
    warped_costs,
)


def answers(seed: int, frames: int, features: int = 39) -> np.ndarray:
    """Random yes and no that stay for some frames, as real ones do."""
    generator = np.random.default_rng(seed)
    return (np.cumsum(generator.random((frames, features)) < 0.2, axis=0) % 2).astype(float)


def stretched(motion: np.ndarray, generator: np.random.Generator) -> np.ndarray:
    """The same answers at an uneven tempo: every frame once to three times."""
    return np.repeat(motion, generator.integers(1, 4, len(motion)), axis=0)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 9), st.integers(1, 9), st.integers(1, 5), st.booleans())
def test_merging_matches_the_oracle(seed: int, n: int, m: int, features: int, binary: bool) -> None:
    generator = np.random.default_rng(seed)
    reference, motion = generator.random((n, features)), generator.random((m, features))
    if binary:  # equal costs occur all the time
        reference, motion = reference.round(), motion.round()
    values, weights, cost = oracle.merge(reference, [motion, reference])
    sums, fast_weights = np.zeros_like(reference), np.zeros(n)
    fast_cost = merge_along_path(reference, np.ascontiguousarray(motion.T), sums, fast_weights)
    fast_cost += merge_along_path(reference, np.ascontiguousarray(reference.T), sums, fast_weights)
    assert fast_cost == pytest.approx(cost, abs=1e-12)
    np.testing.assert_allclose(fast_weights / 2, weights, atol=1e-12)
    np.testing.assert_allclose(sums / fast_weights[:, None], values, atol=1e-12)
    assert fast_weights.sum() == pytest.approx(n + m)  # every frame of every motion counts once


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 12))
def test_equalising_matches_the_oracle_and_keeps_the_mean(seed: int, frames: int) -> None:
    generator = np.random.default_rng(seed)
    values, weights = generator.random((frames, 3)), generator.random(frames) * 3 + 0.05
    fast = _equalise(values, weights)
    np.testing.assert_allclose(fast, oracle.equalise(values, weights), atol=1e-9)
    np.testing.assert_allclose(fast.mean(axis=0), np.average(values, axis=0, weights=weights), atol=1e-9)


def test_distances_match_the_oracle() -> None:
    motions = [answers(k, 5 + k) for k in range(6)]
    templates = MotionTemplates(n_iterations=2).fit(motions, list("aabbcc"))
    queries = [answers(50 + k, 3 + 4 * k).astype(bool) for k in range(4)]
    got = templates.distances(queries)
    expected = [[oracle.template_distance(t, q) for t in templates.templates_] for q in queries]
    np.testing.assert_allclose(got, expected, atol=1e-12)
    assert ((got >= 0) & (got <= 1)).all()
    assert any((template == -1).any() for template in templates.templates_)


def test_kernel_with_one_frame_each() -> None:
    assert warped_costs(np.array([[0.25]]), np.array([0, 1]))[0] == pytest.approx(0.25)


def test_the_average_of_one_motion_at_several_tempos_is_that_motion() -> None:
    generator = np.random.default_rng(0)
    motion = np.unique(answers(4, 20), axis=0)[::-1]  # frames that all differ, so that warping is exact
    average = _learn_average([stretched(motion, generator) for _ in range(4)], 12, 10)
    # Frames of equal weight are cut across the changes, so a little is mixed there; nothing else is.
    assert np.abs(average - average.round()).mean() < 0.06
    template = _round_off(average, 0.1)
    assert oracle.template_distance(template, motion) == pytest.approx(0.0, abs=1e-12)


def test_entries_that_vary_become_grey() -> None:
    generator = np.random.default_rng(1)
    motion = answers(7, 15)
    variants = []
    for k in range(6):
        variant = motion.copy()
        variant[:, 5] = k % 2  # half of them say yes, half no
        variants.append(stretched(variant, generator))
    templates = MotionTemplates().fit(variants, ["a"] * 6)
    assert (templates.templates_[0][:, 5] == -1).all()
    others = np.delete(templates.templates_[0], 5, axis=1)
    assert (others >= 0).mean() > 0.9
    assert templates.distances([variants[0], variants[1]]).max() < 0.02


def test_unseen_tempos_are_recognised() -> None:
    generator = np.random.default_rng(2)
    bases = {name: answers(ord(name), 20) for name in "abcd"}
    train = [(stretched(base, generator), name) for name, base in bases.items() for _ in range(5)]
    test = [(stretched(base, generator), name) for name, base in bases.items() for _ in range(3)]
    templates = MotionTemplates().fit([m for m, _ in train], [name for _, name in train])
    assert templates.predict([m for m, _ in test]).tolist() == [name for _, name in test]
    assert templates.classes_.tolist() == ["a", "b", "c", "d"]


def test_threads_change_nothing() -> None:
    motions = [answers(k, 10 + k) for k in range(9)]
    one = MotionTemplates().fit(motions, list("aaabbbccc"))
    two = MotionTemplates(n_jobs=2).fit(motions, list("aaabbbccc"))
    for a, b in zip(one.averages_, two.averages_, strict=True):
        np.testing.assert_array_equal(a, b)
    np.testing.assert_array_equal(one.distances(motions), two.distances(motions))


def test_few_references_of_many_motions_still_average_all() -> None:
    motions = [answers(k % 3, 12) for k in range(12)]
    average = _learn_average(motions, 3, 2)
    assert ((average >= 0) & (average <= 1)).all()
    merged, _ = _merge(motions[0], motions)
    assert len(merged) == 12  # the mean length of the motions


def test_questions_without_clips_get_no_answers() -> None:
    templates = MotionTemplates().fit([answers(1, 8), answers(2, 8)], ["a", "b"])
    assert templates.distances([]).shape == (0, 2)
    assert templates.predict([]).shape == (0,)


def test_bad_use_is_refused() -> None:
    with pytest.raises(NotTrainedError, match="fit"):
        MotionTemplates().predict([answers(1, 3)])
    with pytest.raises(TrainingError, match="at least one clip"):
        MotionTemplates().fit([], [])
    with pytest.raises(TrainingError, match="a category for each"):
        MotionTemplates().fit([answers(1, 3)], ["a", "b"])
    for wrong in ({"threshold": 0.5}, {"n_iterations": 0}):
        with pytest.raises(OptionError, match="expected"):
            MotionTemplates(**wrong)
