"""Describe in a few words what a body does, without a forest: both hands above the head, a step to the side, a turn.

Each relation is a question about the pose or the path in every frame at 30 Hz, in the body-fixed system of the features
(left, up, forward; body heights). A relation is kept if it holds long enough, with its longest stretch; for a pair of
limbs it names both where it holds for both at once, else the one. The thresholds are not learned.
The words are messages, ``relations.NAME``, in both languages.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import BoolArray, FloatArray
from dousa.messages import Message
from dousa.motion.canonical.joints import JOINT_INDEX
from dousa.retrieval.features.channels import CHANNEL_RATE, sample_positions
from dousa.retrieval.features.pose_features import find_lateral_axis
from dousa.retrieval.features.posed_motion import PosedMotion, place_pelvis
from dousa.retrieval.words import relation_kernels as kernels

RELATIONS_VERSION = 1
"""Version of the questions by definition; a library recomputes relations of other versions."""

# In the order of the rows of the kernels: name, limb, limbs, and whether it is a short event.
_OF_ARMS = (
    ("above_head", "hand", "hands", False),
    ("arm_level", "arm", "arms", False),
    ("arm_aside", "arm", "arms", False),
    ("arm_ahead", "arm", "arms", False),
    ("elbow_bent", "elbow", "elbows", False),
)
_OF_HANDS = (
    ("hands_together", "", "", False),
    ("hands_meet", "", "", True),
    ("arms_crossed", "", "", False),
    ("hand_waves", "hand", "hands", False),
    ("arm_circles", "arm", "arms", False),
    ("hand_thrust", "hand", "hands", True),
    ("hand_behind", "hand", "hands", False),
    ("hand_low", "hand", "hands", False),
    ("hand_at_head", "hand", "hands", False),
)
_OF_LEGS = (
    ("foot_raised", "foot", "feet", False),
    ("knee_raised", "knee", "knees", False),
    ("kicks_forward", "leg", "legs", True),
    ("steps_aside", "foot", "feet", False),
    ("legs_apart", "", "", False),
)
_OF_BODY = (
    ("lying", "", "", False),
    ("body_low", "", "", False),
    ("bent_forward", "", "", False),
    ("gets_up", "", "", True),
    ("gets_down", "", "", True),
)
_OF_TRAVEL = (
    ("walks", "", "", False),
    ("runs", "", "", False),
    ("walks_back", "", "", False),
    ("goes_left", "", "", False),
    ("goes_right", "", "", False),
    ("turns_left", "", "", False),
    ("turns_right", "", "", False),
    ("stands_still", "", "", False),
)
_OF_JUMPS = (("in_the_air", "", "", True),)
_QUESTIONS = (*_OF_ARMS, *_OF_HANDS, *_OF_LEGS, *_OF_BODY, *_OF_TRAVEL, *_OF_JUMPS)
_IS_EVENT = np.array([is_event for _, _, _, is_event in _QUESTIONS])

_HEAD, _NECK = JOINT_INDEX["head"], JOINT_INDEX["neck"]
_ARMS, _LEGS = (
    np.array([[JOINT_INDEX[f"{side}_{joint}"] for joint in joints] for side in ("left", "right")])
    for joints in (("shoulder", "elbow", "wrist", "hand"), ("knee", "ankle"))
)


@dataclass(frozen=True, slots=True)
class Relation:
    """Something that a body does in a motion.

    Parameters
    ----------
    name : the code of its message without the section, such as ``"above_head"``.
    part : the limbs, such as ``"both_hands"``; empty for the body.
    share : of the motion for which it holds, 0 to 1.
    start, end : s, the longest stretch of it.
    """

    name: str
    part: str
    share: float
    start: float
    end: float

    @property
    def message(self) -> Message:
        """The relation in words."""
        code = f"relations.{self.name}"
        return Message(code, part=Message(f"relations.{self.part}")) if self.part else Message(code)


def find_relations(motion: PosedMotion) -> tuple[Relation, ...]:
    """Find the relations of a motion, in a fixed order; missing joints (NaN) give none."""
    holds = _ask(*_pose(motion))
    stretches = np.empty((len(_QUESTIONS), 3, 3), np.int64)
    kernels.find_stretches(holds, stretches)
    return _keep(stretches, holds.shape[2])


def _pose(motion: PosedMotion) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return a motion in body heights: (T, 20, 3) left, up and forward of the pelvis, (T, 20) heights above the floor,
    (T, 2) x and z of the direction to the left, (T, 2) speed of the pelvis along x and z, a second, and (T,) radians
    that the body has turned to the left since the beginning.
    """
    positions = place_pelvis(motion.positions, motion.height)  # of a body that lacks it
    points = _smooth(sample_positions(positions, motion.frame_rate)) / motion.height
    with np.errstate(invalid="ignore", divide="ignore"):
        left = _smooth(find_lateral_axis(points - points[:, :1]), width=15)
    count = len(points)
    body, speed = np.empty_like(points), np.empty((count, 2))
    lowest, turned = np.empty(count), np.empty(count)
    kernels.turn(points, left, CHANNEL_RATE, body, lowest, speed, turned)
    # Without feet the floor is unknown, and so are heights.
    feet = points[:, _LEGS[:, 1], 1]
    floor = _usual(lowest, 5) if np.isfinite(feet).any() else np.nan
    # The speed varies with every step.
    return body, points[..., 1] - floor, left, _smooth(speed, width=21), turned


def _smooth(values: FloatArray, width: int = 5) -> FloatArray:
    """Return the moving average over ``width`` frames, at the ends over fewer, as the joints of a Kinect jump."""
    half = min(width // 2, (len(values) - 1) // 2)
    if half < 1:
        return np.array(values, np.float64)
    flat = values.reshape(len(values), -1)
    even = np.empty(flat.shape)
    kernels.average(flat, half, np.zeros((len(flat) + 1, flat.shape[1])), even)
    return even.reshape(values.shape)


def _ask(body: FloatArray, heights: FloatArray, left: FloatArray, speed: FloatArray, turned: FloatArray) -> BoolArray:
    """Return (Q, 2, T) whether each question holds in a frame, on the left and right; of the body, on the left."""
    holds = np.zeros((len(_QUESTIONS), 2, len(body)), np.bool_)
    rows = np.cumsum([0, *map(len, (_OF_ARMS, _OF_HANDS, _OF_LEGS, _OF_BODY, _OF_TRAVEL, _OF_JUMPS))])
    arms, hands, legs, trunk, travel, jumps = (holds[first:last] for first, last in pairwise(rows))
    tenth = max(len(body) // 10, 1)
    kernels.ask_arms(body, _HEAD, _ARMS, arms)
    kernels.ask_hands(body, heights, _HEAD, _ARMS, CHANNEL_RATE, np.empty((len(body), 3)), hands)
    starts = np.array([_usual(body[:tenth, ankle, 0], 50) for ankle in _LEGS[:, 1]])
    kernels.ask_legs(body, heights, _LEGS, CHANNEL_RATE, starts, legs)
    pelvis, feet = heights[:, 0], np.minimum(*heights[:, _LEGS[:, 1]].T)
    rise = float(pelvis[-tenth:].mean() - pelvis[:tenth].mean())
    kernels.ask_body(body, heights, _HEAD, _NECK, rise, CHANNEL_RATE, trunk)
    jumps[0, 0] = (feet > _usual(feet, 20) + 0.05) & (pelvis > _usual(pelvis, 50) + 0.02) & ~trunk[0, 0]
    kernels.ask_travel(body, heights, speed, left, turned, _ARMS[:, 3], CHANNEL_RATE, travel)
    return holds


def _usual(values: FloatArray, percent: float) -> float:
    """Return the percentile of the finite values, interpolated linearly; NaN if there are none."""
    ordered = np.sort(values[np.isfinite(values)])
    if not len(ordered):
        return float("nan")
    place = (len(ordered) - 1) * percent / 100.0
    below = int(place)
    above = ordered[min(below + 1, len(ordered) - 1)]
    return float(ordered[below] + (above - ordered[below]) * (place - below))


def _keep(
    stretches: NDArray[np.int64], n_frames: int, share: float = 0.2, seconds: float = 0.5, event: float = 0.13
) -> tuple[Relation, ...]:
    """Return the relations that hold long enough, from ``kernels.find_stretches``.

    A pose must hold for a ``share`` of the motion or for ``seconds``, an event for ``event`` s.
    """
    least = max(min(share * n_frames / CHANNEL_RATE, seconds), event)
    lengths = (stretches[:, :, 2] - stretches[:, :, 1]) / CHANNEL_RATE
    kept = lengths >= np.where(_IS_EVENT, event, least)[:, None] - 1e-9
    relations = []
    for question, part in zip(*(places.tolist() for places in np.nonzero(kept)), strict=True):
        name, limb, limbs, _ = _QUESTIONS[question]
        count, start, end = stretches[question, part].tolist()
        limb_name = (f"both_{limbs}", f"left_{limb}", f"right_{limb}")[part] if limb else ""
        times = round(start / CHANNEL_RATE, 3), round(end / CHANNEL_RATE, 3)
        relations.append(Relation(name, limb_name, round(count / n_frames, 4), *times))
    return tuple(relations)
