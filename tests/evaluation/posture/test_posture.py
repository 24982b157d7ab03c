"""Postures from joints: directions, gaps, frame rates, the mirror."""

import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles import yamane_correlation as oracle

from dousa.errors import InvalidMotionError, OptionError
from dousa.evaluation import read_weights
from dousa.evaluation.posture.posture import (
    LIMBS,
    MIRRORED_SEGMENTS,
    SEGMENT_JOINTS,
    SEGMENTS,
    check_weights,
    compute_postures,
    compute_segments,
)
from dousa.formats.registry import read_motion
from dousa.motion import JOINT_INDEX, CanonicalMotion, canonicalise

J = JOINT_INDEX


@pytest.fixture(scope="module")
def walker() -> CanonicalMotion:
    from dousa.motion.synthetic.performers import CATEGORIES, draw_performer, make_motion

    return canonicalise(make_motion(CATEGORIES[0], draw_performer(0)))


def with_missing(motion: CanonicalMotion, cells: list[tuple[slice, str]]) -> CanonicalMotion:
    missing = np.zeros(motion.positions.shape[:2], bool)
    for frames, joint in cells:
        missing[frames, J[joint]] = True
    return dataclasses.replace(motion, missing=missing)


def test_names_agree() -> None:
    assert len(SEGMENTS) == len(SEGMENT_JOINTS) == len(MIRRORED_SEGMENTS) == 9
    assert sorted(number for limb in LIMBS.values() for number in limb) == list(range(9))
    for number, name in enumerate(SEGMENTS):
        other = name.replace("left", "?").replace("right", "left").replace("?", "right")
        assert SEGMENTS[MIRRORED_SEGMENTS[number]] == other


def test_segments_are_those_of_the_paper(walker: CanonicalMotion) -> None:
    points = walker.positions[7]
    pairs = [(points[J[start]], points[J[end]]) for start, end in SEGMENT_JOINTS]
    pairs[0] = (0.5 * (points[J["left_hip"]] + points[J["right_hip"]]), points[J["neck"]])
    expected = oracle.posture_vector(pairs)
    np.testing.assert_allclose(compute_segments(points).ravel(), expected, atol=1e-12)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0.2, 5.0))
def test_place_and_stature_drop_out(seed: int, stature: float) -> None:
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(3, 20, 3))
    moved = stature * points + rng.normal(size=3)
    np.testing.assert_allclose(compute_segments(moved), compute_segments(points), atol=1e-9)
    # The length of one bone drops out too: an elbow farther out, and all that hangs on it.
    arm = [J[f"left_{name}"] for name in ("elbow", "wrist", "hand")]
    longer = points.copy()
    longer[:, arm] += 0.7 * (points[:, J["left_elbow"]] - points[:, J["left_shoulder"]])[:, None]
    np.testing.assert_allclose(compute_segments(longer), compute_segments(points), atol=1e-9)


def test_segment_of_no_length_is_missing() -> None:
    points = np.random.default_rng(0).normal(size=(20, 3))
    points[J["left_wrist"]] = points[J["left_elbow"]]
    points[J["right_ankle"]] = np.nan
    segments = compute_segments(points)
    gone = np.isnan(segments).any(axis=1)
    assert [SEGMENTS[number] for number in np.flatnonzero(gone)] == ["left_forearm", "right_shank"]


def test_what_is_not_seen_is_filled_and_marked(walker: CanonicalMotion) -> None:
    whole = compute_postures(walker)
    assert whole.seen.all()
    gap = slice(10, 16)
    postures = compute_postures(with_missing(walker, [(gap, "left_elbow")]))
    lost = np.zeros_like(postures.seen)
    lost[gap, 1:3] = True
    np.testing.assert_array_equal(postures.seen, ~lost)
    np.testing.assert_array_equal(postures.segments[~lost], whole.segments[~lost])
    np.testing.assert_allclose(np.linalg.norm(postures.segments, axis=2), 1.0, atol=1e-12)
    middle = postures.segments[9, 1] * 4 + postures.segments[16, 1] * 3  # frame 12 is 3 of 7 frames into the gap
    np.testing.assert_allclose(postures.segments[12, 1], middle / np.linalg.norm(middle), atol=1e-12)


def test_ends_are_held_and_never_seen_is_constant(walker: CanonicalMotion) -> None:
    motion = with_missing(walker, [(slice(0, 4), "right_knee"), (slice(None), "neck")])
    postures = compute_postures(motion)
    np.testing.assert_allclose(postures.segments[:4, 7], np.tile(postures.segments[4, 7], (4, 1)), atol=1e-12)
    np.testing.assert_array_equal(postures.segments[:, 0], np.tile([0.0, 1.0, 0.0], (motion.n_frames, 1)))
    assert not postures.seen[:, 0].any()


def test_opposite_neighbours_leave_a_direction(walker: CanonicalMotion) -> None:
    positions = walker.positions[:3].copy()
    shoulder, elbow = positions[0, J["left_shoulder"]].copy(), positions[0, J["left_elbow"]].copy()
    for frame, end in ((0, elbow), (1, shoulder), (2, 2 * shoulder - elbow)):
        positions[frame, J["left_shoulder"]], positions[frame, J["left_elbow"]] = shoulder, end
    postures = compute_postures(dataclasses.replace(walker, positions=positions, missing=None))
    assert postures.seen[:, 1].tolist() == [True, False, True]
    np.testing.assert_allclose(postures.segments[1, 1], postures.segments[0, 1], atol=1e-12)


def test_other_frame_rates(walker: CanonicalMotion) -> None:
    own = compute_postures(walker)
    twice = compute_postures(walker, 2 * walker.frame_rate, name="twice")
    assert (twice.n_frames, twice.frame_rate, twice.name) == (2 * own.n_frames - 1, 2 * walker.frame_rate, "twice")
    np.testing.assert_array_equal(twice.segments[::2], own.segments)
    half = compute_postures(walker, walker.frame_rate / 2)
    assert half.n_frames == (own.n_frames - 1) // 2 + 1
    np.testing.assert_array_equal(half.segments, own.segments[::2])
    odd = compute_postures(walker, 0.77 * walker.frame_rate)
    assert odd.n_frames == int((own.n_frames - 1) * 0.77 + 1e-9) + 1
    middle = 0.5 * (walker.positions[3] + walker.positions[4])
    np.testing.assert_allclose(twice.segments[7], compute_segments(middle), atol=1e-12)


def test_gaps_at_another_frame_rate_reach_to_the_seen_neighbours(walker: CanonicalMotion) -> None:
    postures = compute_postures(with_missing(walker, [(slice(10, 11), "left_ankle")]), 2 * walker.frame_rate)
    assert np.flatnonzero(~postures.seen[:, 6]).tolist() == [19, 20, 21]
    assert postures.seen[:, :6].all()


def test_positions_that_are_missing_are_gaps(walker: CanonicalMotion) -> None:
    positions = walker.positions.copy()
    positions[5:8, J["right_wrist"]] = np.nan
    postures = compute_postures(dataclasses.replace(walker, positions=positions))
    assert np.flatnonzero(~postures.seen[:, 4]).tolist() == [5, 6, 7]
    assert np.isfinite(postures.positions).all() and np.isfinite(postures.segments).all()


def test_one_frame(walker: CanonicalMotion) -> None:
    one = dataclasses.replace(walker, positions=walker.positions[:1], missing=None)
    assert compute_postures(one).n_frames == 1
    assert compute_postures(one, 240.0).n_frames == 1
    gone = dataclasses.replace(one, missing=np.ones((1, 20), bool))
    postures = compute_postures(gone)
    assert not postures.seen.any()
    np.testing.assert_allclose(np.linalg.norm(postures.segments, axis=2), 1.0)


def test_arrays_are_read_only(walker: CanonicalMotion) -> None:
    postures = compute_postures(walker, 31.0)
    for array in (postures.segments, postures.seen, postures.positions):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0


def test_bad_input(walker: CanonicalMotion) -> None:
    with pytest.raises(InvalidMotionError, match=r"expected shape \(\.\.\., 20, 3\), got \(4, 19, 3\)"):
        compute_segments(np.zeros((4, 19, 3)))
    for positions, problem in (
        (walker.positions[:0], "at least one frame"),
        (walker.positions[:, :19], r"\(frames, 20, 3\)"),
        (np.full((2, 20, 3), np.inf), "infinite"),
    ):
        with pytest.raises(InvalidMotionError, match=problem):
            compute_postures(dataclasses.replace(walker, positions=positions, missing=None))
    with pytest.raises(InvalidMotionError, match="missing: expected shape"):
        compute_postures(dataclasses.replace(walker, missing=np.zeros((3, 20), bool)))
    for rate in (0.0, -1.0, np.nan, 1e7):
        with pytest.raises(OptionError, match="frame rate"):
            compute_postures(walker, rate)
    for weights in ([1.0] * 8, [0.0] * 9, [-1.0] + [1.0] * 8, [np.nan] * 9, 1.0):
        with pytest.raises(OptionError, match="weights"):
            check_weights(weights)


def test_real_postures(shared_data: Callable[[str], Path]) -> None:
    path = next(shared_data("bandai_dance").glob("*.bvh"))
    postures = compute_postures(canonicalise(read_motion(path)), 60.0, path.stem)
    np.testing.assert_allclose(np.linalg.norm(postures.segments, axis=2), 1.0, atol=1e-12)
    mean = postures.segments.mean(axis=0)
    assert mean[0, 1] > 0.8 and (mean[5:, 1] < -0.7).all()  # trunk up, legs down


@pytest.fixture
def weights(tmp_path):
    def read(text):
        path = tmp_path / "weights.toml"
        path.write_text(text, encoding="utf-8")
        return read_weights(path)

    return read


def test_what_is_not_named_weighs_one(weights):
    assert weights("trunk = 2") == {**dict.fromkeys(SEGMENTS, 1.0), "trunk": 2.0}


@pytest.mark.parametrize(
    "text",
    [
        "left_forearm = 0\nleft_arm = 3\narms = 2\nlegs = 0.5\n",
        "[weights]\narms = 2 # hands\nleft_arm = 3\nlegs = 0.5\nleft_forearm = 0",
        "Left Forearm = 0\nleft-arm = 3\narms = 2\n\nlegs = .5  # no TOML",
    ],
)
def test_exact_names_lie_over_coarse_ones(weights, text):
    found = weights(text)
    assert list(found) == list(SEGMENTS)
    assert found["left_upper_arm"] == 3 and found["left_forearm"] == 0
    assert found["right_upper_arm"] == found["right_forearm"] == 2
    assert {found[name] for name in SEGMENTS if "thigh" in name or "shank" in name} == {0.5}
    assert found["trunk"] == 1


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("tail = 1", "'tail' is no segment; there are: arms, legs, left_arm"),
        ("arms = -1", "'arms': expected a weight from 0 to a million, got -1"),
        ("arms = nan", "got nan"),
        ("arms = inf", "got inf"),
        ("arms = true", "got True"),
        ('arms = "much"', "got 'much'"),
        ("arms = 1e9", "a million"),
        ("arms = []", "got []"),
        ("trunk = 0\narms = 0\nlegs = 0", "every segment weighs 0"),
        ("", "expected lines 'segment = number', got none"),
        ("# nothing", "got none"),
        ("arms", ":1: expected 'segment = number', got 'arms'"),
        ("left arm = 2\nleft arm = 3", ":2: 'left arm' is given a second time"),
        ("left_arm = 2\nLEFT_ARM = 3", "given a second time"),
        ("left arm = two", ":1: expected a number for 'left arm', got 'two'"),
        ("left.arm = 2", "'arm' is no segment"),
    ],
)
def test_what_cannot_be_meant_is_refused(weights, text, says):
    with pytest.raises(OptionError) as caught:
        weights(text)
    assert says in str(caught.value) and "weights.toml" in str(caught.value)


def test_files_that_are_no_text(tmp_path):
    (tmp_path / "a").write_bytes(b"\xff\xfe\x00")
    (tmp_path / "big").write_bytes(b"#" * 1_000_001)
    for path, says in ((tmp_path / "a", "UTF-8"), (tmp_path / "big", "1 MB"), (tmp_path / "none", "cannot be read"),
                       (tmp_path, "cannot be read")):  # fmt: skip
        with pytest.raises(OptionError, match=says):
            read_weights(path)
