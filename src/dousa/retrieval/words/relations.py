"""Describe in a few words what a body does, without a forest: both hands above the head, a step to the side, a turn.

Each relation is a question about the pose or the path in every frame at 30 Hz, in the body-fixed system of the features
(left, up, forward; body heights). A relation is kept if it holds long enough, with its longest stretch; for a pair of
limbs it names both where it holds for both at once, else the one. The thresholds are not learned.
The words are messages, ``relations.NAME``, in both languages.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dousa.messages import Message
from dousa.motion.canonical.joints import JOINT_INDEX
from dousa.retrieval.features.channels import CHANNEL_RATE, sample_positions
from dousa.retrieval.features.pose_features import HIPS, SHOULDERS
from dousa.retrieval.features.posed_motion import PosedMotion, place_pelvis
from dousa.retrieval.words.relation_kernels import find_stretches

RELATIONS_VERSION = 1
"""Version of the questions by definition; a library recomputes relations of other versions."""

# In the order of the rows of the kernel: name, limb, limbs, and whether it is a short event.
_QUESTIONS = (
    ("above_head", "hand", "hands", False),
    ("arm_level", "arm", "arms", False),
    ("arm_aside", "arm", "arms", False),
    ("arm_ahead", "arm", "arms", False),
    ("elbow_bent", "elbow", "elbows", False),
    ("hands_together", "", "", False),
    ("hands_meet", "", "", True),
    ("arms_crossed", "", "", False),
    ("hand_waves", "hand", "hands", False),
    ("arm_circles", "arm", "arms", False),
    ("hand_thrust", "hand", "hands", True),
    ("hand_behind", "hand", "hands", False),
    ("hand_low", "hand", "hands", False),
    ("hand_at_head", "hand", "hands", False),
    ("foot_raised", "foot", "feet", False),
    ("knee_raised", "knee", "knees", False),
    ("kicks_forward", "leg", "legs", True),
    ("steps_aside", "foot", "feet", False),
    ("legs_apart", "", "", False),
    ("lying", "", "", False),
    ("body_low", "", "", False),
    ("bent_forward", "", "", False),
    ("gets_up", "", "", True),
    ("gets_down", "", "", True),
    ("walks", "", "", False),
    ("runs", "", "", False),
    ("walks_back", "", "", False),
    ("goes_left", "", "", False),
    ("goes_right", "", "", False),
    ("turns_left", "", "", False),
    ("turns_right", "", "", False),
    ("stands_still", "", "", False),
    ("in_the_air", "", "", True),
)
_IS_EVENT = np.array([is_event for _, _, _, is_event in _QUESTIONS])

_TRUNK = np.array([JOINT_INDEX["head"], JOINT_INDEX["neck"]])
_ARMS, _LEGS = (
    np.array([[JOINT_INDEX[f"{side}_{joint}"] for joint in joints] for side in ("left", "right")])
    for joints in (("shoulder", "elbow", "wrist", "hand"), ("knee", "ankle"))
)
_SIDES = np.stack([HIPS, SHOULDERS])


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
    positions = place_pelvis(motion.positions, motion.height)  # of a body that lacks it
    points = np.array(sample_positions(positions, motion.frame_rate), np.float64, order="C")
    n, stretches = len(points), np.empty((len(_QUESTIONS), 3, 3), np.int64)
    find_stretches(
        points.reshape(n, -1), points, float(motion.height), CHANNEL_RATE, _TRUNK, _ARMS, _LEGS, _SIDES,
        np.empty(points.shape), np.empty((n + 1, points[0].size)), np.empty((2, n, 2)), np.empty((n, 3)),
        np.empty((n, 3)), np.zeros((len(_QUESTIONS), 2, n), np.bool_), stretches,
    )  # fmt: skip
    return _keep(stretches, n)


def _keep(
    stretches: NDArray[np.int64], n_frames: int, share: float = 0.2, seconds: float = 0.5, event: float = 0.13
) -> tuple[Relation, ...]:
    """Return the relations that hold long enough, from ``find_stretches``.

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
