"""The points that other programs find, in their order, by the names that dousa has for them.

A scheme is told by its number of points. Left is the person's left.
"""

from __future__ import annotations

from dousa.estimation.keypoints.keypoints import MEDIAPIPE_NAMES


def _pairs(words: str) -> tuple[str, ...]:
    """Names for a left and a right point each."""
    return tuple(f"{side}_{word}" for word in words.split() for side in ("left", "right"))


COCO_17 = ("nose", *_pairs("eye ear shoulder elbow wrist hip knee ankle"))
_FEET = ("left_big_toe", "left_small_toe", "left_heel", "right_big_toe", "right_small_toe", "right_heel")
BODY_25 = (
    "nose", "neck", "right_shoulder", "right_elbow", "right_wrist", "left_shoulder", "left_elbow", "left_wrist",
    "mid_hip", "right_hip", "right_knee", "right_ankle", "left_hip", "left_knee", "left_ankle", "right_eye", "left_eye",
    "right_ear", "left_ear", *_FEET,
)  # fmt: skip
COCO_18 = (
    "nose", "neck", "right_shoulder", "right_elbow", "right_wrist", "left_shoulder", "left_elbow", "left_wrist",
    "right_hip", "right_knee", "right_ankle", "left_hip", "left_knee", "left_ankle", "right_eye", "left_eye",
    "right_ear", "left_ear",
)  # fmt: skip
HALPE_26 = (*COCO_17, "head_top", "neck", "mid_hip", *_pairs("big_toe small_toe heel"))
WHOLE_BODY = (*COCO_17, *_FEET)  # of 133; those of face and hands are left out

SCHEMES: dict[int, tuple[str, ...]] = {
    17: COCO_17,
    18: COCO_18,
    25: BODY_25,
    26: HALPE_26,
    33: MEDIAPIPE_NAMES,
    133: WHOLE_BODY,
    136: HALPE_26,
}
"""Names by the number of points: COCO, OpenPose (COCO and BODY_25), Halpe, MediaPipe, COCO-WholeBody, Halpe's whole."""
