"""How often an action is repeated: made cycles are counted, single motions and rests are one."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from oracles.short_actions import ACTIONS, make_clip
from oracles.slow_tallies import correlate as correlate_slowly
from oracles.slow_tallies import measure_tallies as measure_slowly
from oracles.standing import standing

from dousa.motion.canonical.joints import JOINT_INDEX
from dousa.retrieval.counting.counter import (
    COUNTED,
    TALLIES,
    choose_count,
    correlate,
    count_repetitions,
    count_swings,
    describe_counts,
    find_usual,
    measure_parts,
    measure_tallies,
    name_evidence,
    use_weights,
)
from dousa.retrieval.counting.tally_kernels import find_axes, find_period, fold, read_quantile, sort_into, square

HEIGHT = 1.7


def raise_arms(times, seconds=1.2, rest=0.0, noise=0.0, fading=1.0, sides=("left", "right")):
    """Hands up and down, with rests between."""
    draw = np.random.default_rng(times)
    up = 0.5 * (1.0 - np.cos(np.linspace(0.0, 2.0 * np.pi, round(seconds * 30), endpoint=False)))
    once = np.concatenate([up, np.zeros(round(rest * 30))])
    strength = np.concatenate([once * fading**number for number in range(times)])
    body = np.repeat(standing(), len(strength), axis=0)
    for side in sides:
        for joint, share in (("elbow", 0.5), ("wrist", 0.9), ("hand", 1.0)):
            body[:, JOINT_INDEX[f"{side}_{joint}"], 1] += share * strength
    return body + noise * draw.normal(size=body.shape)


def wave(times, seconds=0.7, way=0.6, rest=0.4, noise=0.0, turned_back=True):
    """A hand that is raised, waves and is lowered."""
    draw = np.random.default_rng(times)
    ramp = 0.5 * (1.0 - np.cos(np.linspace(0.0, np.pi, round(way * 30))))
    aside = np.sin(np.linspace(0.0, 2.0 * np.pi * times, round(times * seconds * 30), endpoint=False))
    held, still = np.ones(len(aside)), np.zeros(round(rest * 30))
    up = np.concatenate([still, ramp, held, *([ramp[::-1], still] if turned_back else [])])
    body = np.repeat(standing(), len(up), axis=0)
    for joint, share in (("elbow", 0.4), ("wrist", 0.9), ("hand", 1.0)):
        body[:, JOINT_INDEX[f"left_{joint}"], 1] += 0.9 * share * up
    first = len(still) + len(ramp)
    for joint, share in (("wrist", 0.7), ("hand", 1.0)):
        body[first : first + len(aside), JOINT_INDEX[f"left_{joint}"], 0] += 0.15 * share * aside
    return body + noise * draw.normal(size=body.shape)


def alternate_arms(times, seconds=0.8):
    """One hand up and down, then the other, as often."""
    left, right = (raise_arms(1, seconds, sides=(side,)) for side in ("left", "right"))
    return np.concatenate([left, right] * times)


@pytest.mark.parametrize("times", [1, 2, 3, 5, 8, 30])
@pytest.mark.parametrize(
    "options", [{}, {"noise": 0.02}, {"seconds": 0.7}, {"seconds": 4.0}, {"rest": 0.2}, {"rest": 1.5, "noise": 0.01}]
)
def test_made_cycles_are_counted(times, options):
    assert count_repetitions(raise_arms(times, **options), HEIGHT) == times


def test_parts_of_a_recording_are_tallied_as_each_alone_is():
    take = np.concatenate([raise_arms(3), alternate_arms(2), raise_arms(30, noise=0.02), raise_arms(2, rest=0.5)])
    cuts = np.array([0, 1, 90, 108, 204, 204 + 400, len(take)])
    spans = np.stack([cuts[:-1], cuts[1:]], axis=1)
    expected = [measure_tallies(take[start:stop], HEIGHT) for start, stop in spans]
    np.testing.assert_array_equal(measure_parts(take, spans, HEIGHT), expected)
    assert measure_parts(take, spans[:0], HEIGHT).shape == (0, len(TALLIES))


@pytest.mark.parametrize("noise", [0.0, 0.004, 0.03])
def test_tallies_are_those_of_the_slow_code(noise):
    draw = np.random.default_rng(int(1000 * noise))
    for number, action in enumerate([*ACTIONS] * 4):
        clip = np.concatenate([make_clip(action, number).positions] * (1 + number % 3))[: 400 - 7 * number]
        clip = clip + noise * draw.normal(size=clip.shape)
        found, expected = measure_tallies(clip, HEIGHT), measure_slowly(clip, HEIGHT)
        np.testing.assert_array_equal(found[: len(COUNTED)], expected[: len(COUNTED)])
        np.testing.assert_allclose(found, expected, rtol=1e-12)


@pytest.mark.parametrize("times", [3, 4, 7, 12, 30])
@pytest.mark.parametrize(
    "options", [{}, {"noise": 0.01}, {"seconds": 1.2, "way": 0.3}, {"rest": 0.0}, {"turned_back": False}]
)
def test_what_a_raised_hand_does_is_counted(times, options):
    motion = wave(times, **options)
    assert count_repetitions(motion, HEIGHT) == times
    np.testing.assert_allclose(measure_tallies(motion, HEIGHT), measure_slowly(motion, HEIGHT), rtol=1e-12)
    spans = np.array([[0, len(motion)], [0, 30]])
    together = measure_parts(motion, spans, HEIGHT)
    np.testing.assert_array_equal(together, [measure_tallies(motion[slice(*span)], HEIGHT) for span in spans])


ONCE = {
    **{f"a hand that waves {times} times": wave(times) for times in (0, 1)},
    **{action: make_clip(action, 1).positions for action in ("bow", "kick", "raise left", "spread")},
    **{f"a rest of {n_frames} frames": np.repeat(standing(), n_frames, axis=0) for n_frames in (1, 2, 5, 60)},
}


@pytest.mark.parametrize("motion", ONCE.values(), ids=ONCE)
def test_a_single_action_and_a_rest_are_done_once(motion):
    assert count_repetitions(motion, HEIGHT) == 1


@given(st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=40), st.floats(0, 1))
def test_quantiles_are_those_of_numpy(values, share):
    assert read_quantile(np.sort(values), share) == pytest.approx(np.quantile(values, share), rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("times", [3, 5])
def test_what_fades_is_counted_to_its_end(times):
    assert count_repetitions(raise_arms(times, fading=0.8), HEIGHT) == times


@pytest.mark.parametrize("times", [1, 2, 4, 7])
def test_the_clips_of_a_category_say_what_one_repetition_is(times):
    usual = find_usual([measure_tallies(alternate_arms(1, seconds), HEIGHT) for seconds in (0.7, 0.8, 1.0)])
    assert count_repetitions(alternate_arms(times), HEIGHT, usual) == times


def test_clips_of_several_cycles_teach_the_cycle():
    usual = find_usual([measure_tallies(raise_arms(times), HEIGHT) for times in (3, 4, 5, 3)])
    assert usual[TALLIES.index("duration")] == pytest.approx(1.2, rel=0.1)
    assert [count_repetitions(raise_arms(times), HEIGHT, usual) for times in (2, 3, 6)] == [2, 3, 6]


def test_without_clips_nothing_is_usual():
    usual = find_usual([])
    assert np.isnan(usual).all()
    assert choose_count(measure_tallies(raise_arms(4), HEIGHT), usual) == 4


def test_tallies_of_amounts_are_in_their_units():
    tallies = dict(zip(TALLIES, measure_tallies(raise_arms(2, seconds=1.5), HEIGHT), strict=True))
    assert tallies["duration"] == pytest.approx(3.0)
    assert 2.0 < tallies["moving"] <= 3.0
    assert tallies["periods"] == pytest.approx(2.0, abs=0.2)


def test_turning_and_moving_about_changes_no_tally():
    motion = raise_arms(3, noise=0.002)
    turned = motion[..., [2, 1, 0]] * (1.0, 1.0, -1.0) + (3.0, 0.0, -2.0)
    np.testing.assert_allclose(measure_tallies(turned, HEIGHT), measure_tallies(motion, HEIGHT), rtol=1e-6)


@pytest.mark.parametrize("n_frames", [2, 9, 100, 256, 257, 700])
def test_short_and_long_parts_are_correlated_alike(n_frames):
    velocities = np.random.default_rng(n_frames).normal(size=(n_frames, 27))
    np.testing.assert_allclose(correlate(velocities), correlate_slowly(velocities), rtol=0, atol=1e-12)


@given(st.lists(st.integers(0, 12), min_size=1, max_size=40), st.integers(1, 6))
def test_swings_are_those_of_prominent_peaks(values, least):
    find_peaks = pytest.importorskip("scipy.signal").find_peaks
    curve = np.array(values, np.float64)
    tops, bottoms = count_swings(curve, float(least))
    if np.ptp(curve) < least:
        assert (tops, bottoms) == (0, 0)
        return
    for found, one in ((tops, curve), (bottoms, -curve)):
        padded = np.concatenate([[one.min() - least], one, [one.min() - least]])
        # Peaks as high as one before them are as prominent as what lies between them is deep: each counts once.
        peaks, told = find_peaks(padded + 1e-9 * np.arange(len(padded)), prominence=least - 1e-6)
        assert len(peaks) == len(told["prominences"]) == found


def test_evidence_has_a_name_for_every_column():
    tallies, counts = measure_tallies(raise_arms(3), HEIGHT), np.arange(1, 6)
    for usual in (None, np.maximum(tallies, 0.5) / 3):
        named = name_evidence(usual is not None)
        assert describe_counts(tallies, counts, usual).shape == (5, len(named))
        assert len(set(named)) == len(named)
    best = describe_counts(tallies, counts, usual)[:, named.index(("duration", "near_usual"))]
    assert best.argmax() == 2
    assert best[2] == pytest.approx(0.0)


def test_other_weights_count_otherwise_meanwhile():
    tallies = measure_tallies(raise_arms(3), HEIGHT)
    few = np.zeros(len(name_evidence(False)))
    few[0] = 1.0
    with use_weights({"alone": few, "known": np.zeros(len(name_evidence(True)))}):
        assert choose_count(tallies) == 1
    assert choose_count(tallies) == 3


@given(st.lists(st.floats(0.0, 1e4), min_size=len(TALLIES), max_size=len(TALLIES)))
def test_any_tallies_give_a_count_of_at_least_one(values):
    tallies = np.array(values)
    assert 1 <= choose_count(tallies) <= min(1.2 * tallies[: len(COUNTED)].max() + 2.0, 500.0)
    assert choose_count(tallies, np.maximum(tallies, 0.5)) >= 1


def test_actions_of_a_small_world_repeated():
    for action in ACTIONS:
        clips = [make_clip(action, 1, trial).positions for trial in range(4)]
        usual = find_usual([measure_tallies(make_clip(action, 2, trial).positions, HEIGHT) for trial in range(4)])
        assert count_repetitions(np.concatenate(clips), HEIGHT, usual) == 4


def find_directions(matrix: np.ndarray, count: int) -> np.ndarray:
    axes = np.empty((count, len(matrix)))
    find_axes(matrix.copy(), np.empty((6, len(matrix))), axes)
    return axes


@pytest.mark.parametrize("size", [2, 3, 14, 27])
@pytest.mark.parametrize("rank", [1, 2, 40])
@pytest.mark.parametrize("scale", [1e-9, 1.0, 1e4])
def test_directions_are_the_eigenvectors_of_the_largest_values(size, rank, scale):
    draw = np.random.default_rng(size + 100 * rank)
    curves = draw.normal(size=(size, rank)) * draw.uniform(0.2, 1.0, (size, 1)) * scale
    matrix = curves @ curves.T
    values, vectors = np.linalg.eigh(matrix)
    first, second = find_directions(matrix, 2)
    assert abs(first @ vectors[:, -1]) == pytest.approx(1.0, abs=1e-12)
    assert second @ matrix @ second == pytest.approx(values[-2], rel=1e-9, abs=1e-12 * values[-1])
    np.testing.assert_allclose([first @ first, second @ second, first @ second], [1.0, 1.0, 0.0], atol=1e-12)


@pytest.mark.parametrize(
    "matrix", [np.zeros((5, 5)), np.eye(5), np.diag([1.0, 4.0, 4.0, 2.0, 0.0]), np.full((5, 5), 3.0)]
)
def test_directions_of_equal_values_are_some_of_theirs(matrix):
    axes = find_directions(matrix, 2)
    np.testing.assert_allclose(axes @ axes.T, np.eye(2), atol=1e-12)
    expected = np.sort(np.linalg.eigvalsh(matrix))[:-3:-1]
    np.testing.assert_allclose(np.diag(axes @ matrix @ axes.T), expected, atol=1e-9)


@given(st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=70))
def test_values_are_put_in_order(values):
    ordered = np.empty(len(values))
    sort_into(np.array(values), ordered, np.empty(len(values)))
    np.testing.assert_array_equal(ordered, np.sort(values))


def test_what_both_sides_do_has_the_size_of_the_mean_with_the_mirror_image():
    draw = np.random.default_rng(0)
    poses, others = draw.normal(size=(9, 40)), np.array([0, 2, 1])  # a joint in the middle, and one on either side
    even = np.empty((5, 40))
    fold(poses, others, even)
    joints = poses.reshape(3, 3, 40)
    whole = (0.5 * (joints + joints[others] * np.array([-1.0, 1.0, 1.0])[:, None])).reshape(9, 40)
    np.testing.assert_allclose(even.T @ even, whole.T @ whole, atol=1e-12)


def test_products_are_those_of_curves_without_their_means():
    curves = np.random.default_rng(0).normal(size=(6, 50)) + np.arange(6)[:, None]
    products = np.empty((6, 6))
    square(curves, np.empty(curves.shape), products)
    np.testing.assert_allclose(products, np.cov(curves) * 49, atol=1e-9)


@pytest.mark.parametrize(
    ("likeness", "lag"),
    [
        ([1.0, 0.5, 0.0, 0.6, 0.1, 0.9, 0.2], 5), ([1.0, 0.5, 0.0, 0.8, 0.1, 0.9, 0.2], 3),
        ([1.0, 0.9, 1.0, 0.1, 0.0], 2), ([1.0, 0.1, 0.2, 0.1, 0.0], 0), ([1.0, 0.9, 0.8, 0.9], 0), ([1.0], 0),
    ],
)  # fmt: skip
def test_the_period_is_the_first_lag_that_is_nearly_the_best(likeness, lag):
    assert find_period(np.array(likeness), 2, 0.3, 0.8) == lag


def test_the_best_count_is_that_of_what_describes_all_of_them():
    draw = np.random.default_rng(3)
    known = [measure_tallies(make_clip(action, 1).positions, 1.7) for action in ACTIONS]
    for trial in range(200):
        tallies = known[trial % len(known)] * draw.integers(1, 9) * draw.uniform(0.8, 1.2, len(TALLIES))
        tallies[: len(COUNTED)] = np.rint(2.0 * tallies[: len(COUNTED)]) / 2.0
        weights = {"alone": draw.normal(size=52), "known": draw.normal(size=136)}
        with use_weights(weights):
            for usual in (None, find_usual([known[trial % len(known)]])):
                highest = max(tallies[: len(COUNTED)].max(), 0.0 if usual is None else (tallies / usual).max())
                counts = np.arange(1, min(int(1.2 * highest) + 2, 500) + 1)
                scores = describe_counts(tallies, counts, usual) @ weights["alone" if usual is None else "known"]
                found = choose_count(tallies, usual)
                assert counts[0] <= found <= counts[-1]
                assert scores[found - 1] == pytest.approx(scores.max(), abs=1e-9)
