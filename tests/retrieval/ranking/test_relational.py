"""Relational features: every question answered yes and no by a made pose, oracles, invariances."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles import relational_features as oracle

from dousa.errors import InvalidMotionError
from dousa.motion.canonical.joints import CANONICAL_JOINTS, JOINT_INDEX, MIRRORED_JOINTS
from dousa.retrieval.ranking.templates import RELATIONAL_FEATURES, apply_hysteresis, compute_relational_features

RATE = 30.0
HEIGHT = 1.7
NAMES = [feature.name for feature in RELATIONAL_FEATURES]

_RIGHT = {
    "shoulder": (-0.18, 1.40, 0.0), "elbow": (-0.20, 1.10, 0.0), "wrist": (-0.20, 0.85, 0.02),
    "hand": (-0.20, 0.75, 0.03), "hip": (-0.10, 0.90, 0.0), "knee": (-0.10, 0.50, 0.01), "ankle": (-0.10, 0.08, 0.0),
    "toe": (-0.10, 0.02, 0.15),
}  # fmt: skip


def standing() -> np.ndarray:
    """(20, 3) a person who stands and faces +Z, the left side at +X."""
    pose = np.zeros((20, 3))
    for name, place in {"pelvis": 0.95, "spine": 1.15, "neck": 1.45, "head": 1.70}.items():
        pose[JOINT_INDEX[name], 1] = place
    for part, place in _RIGHT.items():
        pose[JOINT_INDEX[f"right_{part}"]] = place
        pose[JOINT_INDEX[f"left_{part}"]] = np.multiply(place, (-1, 1, 1))
    return pose


def posed(**changes: tuple[float, float, float]) -> np.ndarray:
    pose = standing()
    for name, place in changes.items():
        pose[JOINT_INDEX[name]] = place
    return pose


def moving(joints: str, velocity: tuple[float, float, float]) -> np.ndarray:
    """15 frames in which the named joints (a part of their names) move at m/s."""
    motion = np.repeat(standing()[None], 15, axis=0)
    steps = (np.arange(15) - 7)[:, None, None] / RATE * np.asarray(velocity)
    chosen = [k for k, name in enumerate(CANONICAL_JOINTS) if joints in name]
    motion[:, chosen] += steps
    return motion


def yes(positions: np.ndarray) -> set[str]:
    """The questions answered yes in the middle frame."""
    motion = positions if positions.ndim == 3 else np.repeat(positions[None], 5, axis=0)
    answers = compute_relational_features(motion, RATE, HEIGHT)
    return {name for name, answer in zip(NAMES, answers[len(motion) // 2], strict=True) if answer}


def lying() -> np.ndarray:
    """On the back, head towards -Z."""
    pose = standing()
    return np.stack([pose[:, 0], pose[:, 2], -pose[:, 1]], axis=1)


def turned_shoulders(angle: float) -> np.ndarray:
    pose = standing()
    for name in ("left_shoulder", "right_shoulder"):
        x, y, z = pose[JOINT_INDEX[name]]
        pose[JOINT_INDEX[name]] = (x * np.cos(angle), y, x * np.sin(angle) + z)
    return pose


def sideways_feet(distance: float) -> np.ndarray:
    return posed(right_ankle=(-distance / 2, 0.08, 0.0), left_ankle=(distance / 2, 0.08, 0.0))


CASES: dict[str, np.ndarray] = {
    "right hand moving forwards": moving("right_wrist", (0, 0, 0.9)),
    "right hand above neck": posed(right_wrist=(-0.2, 1.6, 0.1)),
    "right hand moving upwards": moving("right_wrist", (0, 0.9, 0)),
    "right elbow bent": posed(right_wrist=(-0.2, 1.10, 0.25)),
    "hands far apart sideways": posed(right_wrist=(-0.7, 1.4, 0.0), left_wrist=(0.7, 1.4, 0.0)),
    "hands approaching each other": moving("right_wrist", (0.6, 0, 0)),
    "right hand moving away from root": moving("right_wrist", (-0.6, -0.3, 0)),
    "right hand fast": moving("right_wrist", (0, 0, -1.0)),
    "right foot behind left leg": posed(right_ankle=(-0.1, 0.08, -0.3)),
    "right foot raised": posed(right_ankle=(-0.1, 0.45, -0.3), right_toe=(-0.1, 0.4, -0.2)),
    "feet far apart sideways": sideways_feet(0.5),
    "right knee bent": posed(right_ankle=(-0.1, 0.5, -0.4)),
    "feet crossed": sideways_feet(-0.1),
    "feet approaching each other sideways": moving("right_ankle", (0.7, 0, 0)),
    "feet moving apart sideways": moving("right_ankle", (-0.7, 0, 0)),
    "right foot fast": moving("right", (0, 0, 1.0)),
    "right upper arm abducted": posed(right_elbow=(-0.5, 1.35, 0.0)),
    "right thigh abducted": posed(right_knee=(-0.1, 0.85, 0.4)),
    "root behind the plane of feet and neck": posed(pelvis=(0, 0.7, -0.4)),
    "spine horizontal": lying(),
    "right hand lowered": posed(right_wrist=(-0.2, 0.2, 0.2)),
    "shoulders rotated to the right": turned_shoulders(0.6),
    "shoulders rotated to the left": turned_shoulders(-0.6),
    "body low": standing() * (1, 0.7, 1),
    "body stretched out sideways": lying(),
    "root fast": moving("", (0, 0, 1.0)),
}


def mirrored(positions: np.ndarray) -> np.ndarray:
    return positions[..., list(MIRRORED_JOINTS), :] * (-1, 1, 1)


def mirrored_name(name: str) -> str:
    return name.replace("right", "?").replace("left", "right").replace("?", "left")


def random_motion(seed: int, frames: int = 20) -> np.ndarray:
    generator = np.random.default_rng(seed)
    drift = np.cumsum(generator.normal(0, 0.03, (frames, 20, 3)), axis=0)
    return standing() + drift + generator.normal(0, 0.05, (1, 20, 3))


def test_there_are_39_questions_with_different_names() -> None:
    assert len(NAMES) == len(set(NAMES)) == 39
    assert all(feature.strong > feature.weak for feature in RELATIONAL_FEATURES)


def test_a_standing_person_answers_no_to_everything() -> None:
    assert yes(standing()) == set()


@pytest.mark.parametrize("name", CASES)
def test_every_question_is_answered_yes(name: str) -> None:
    assert name in yes(CASES[name])
    assert mirrored_name(name) in yes(mirrored(CASES[name]))


def test_every_question_has_a_case() -> None:
    assert set(CASES) | {mirrored_name(name) for name in CASES} == set(NAMES)


def test_answers_match_the_literal_ones() -> None:
    for seed in range(10):
        motion = random_motion(seed, frames=1 + 3 * seed)
        answers = compute_relational_features(motion, RATE, HEIGHT)
        for side in ("right", "left"):
            column = {name: answers[:, k].tolist() for k, name in enumerate(NAMES)}
            assert column[f"{side} hand moving forwards"] == oracle.hand_moving_forwards(motion, RATE, side)
            assert column[f"{side} elbow bent"] == oracle.elbow_bent(motion, side)
            assert column[f"{side} hand fast"] == oracle.hand_fast(motion, RATE, side)


@given(st.lists(st.integers(0, 2), min_size=1, max_size=30))
def test_hysteresis_matches_a_state_machine(levels: list[int]) -> None:
    weak = [level >= 1 for level in levels]
    strong = [level == 2 for level in levels]
    fast = apply_hysteresis(np.array(weak)[:, None], np.array(strong)[:, None])[:, 0]
    assert fast.tolist() == oracle.hysteresis(weak, strong)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 1000), st.floats(-3.1, 3.1), st.floats(0.3, 3.0), st.floats(-50, 50))
def test_place_heading_and_size_do_not_matter(seed: int, yaw: float, size: float, shift: float) -> None:
    motion = random_motion(seed)
    c, s = np.cos(yaw), np.sin(yaw)
    other = size * motion @ np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]]) + (shift, 0.5, -shift)
    expected = compute_relational_features(motion, RATE, HEIGHT)
    got = compute_relational_features(other, RATE, size * HEIGHT)
    assert (expected != got).mean() < 0.01  # a measure may sit on its threshold


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 1000))
def test_a_mirrored_motion_answers_with_sides_exchanged(seed: int) -> None:
    motion = random_motion(seed)
    order = [NAMES.index(mirrored_name(name)) for name in NAMES]
    expected = compute_relational_features(motion, RATE, HEIGHT)[:, order]
    np.testing.assert_array_equal(compute_relational_features(mirrored(motion), RATE, HEIGHT), expected)


def test_one_frame_has_no_speed() -> None:
    answers = compute_relational_features(standing()[None], RATE, HEIGHT)
    assert answers.shape == (1, 39) and not answers.any()


def test_a_body_without_length_answers_without_warnings() -> None:
    answers = compute_relational_features(np.zeros((4, 20, 3)), RATE, HEIGHT)
    assert {NAMES[k] for k in np.flatnonzero(answers.any(axis=0))} <= {
        "body low",
        "right hand lowered",
        "left hand lowered",
    }


@pytest.mark.parametrize(
    ("positions", "rate", "height"),
    [
        (np.zeros((4, 19, 3)), 30.0, 1.7), (np.zeros((0, 20, 3)), 30.0, 1.7), (np.full((4, 20, 3), np.nan), 30.0, 1.7),
        (np.zeros((4, 20, 3)), 0.0, 1.7), (np.zeros((4, 20, 3)), 30.0, np.nan),
    ],
)  # fmt: skip
def test_bad_input_is_refused(positions: np.ndarray, rate: float, height: float) -> None:
    with pytest.raises(InvalidMotionError, match="expected"):
        compute_relational_features(positions, rate, height)
