"""The 39 boolean relational features of motion templates.

Each feature is a yes-or-no question about a pose: is the right hand raised, are the feet crossed, is the root fast? The
generic features (side of a plane, speed along its normal, angle, speed) are those of Müller, Röder, Clausen, "Efficient
content-based retrieval of motion capture data", ACM TOG 24(3), 2005; the choice of 39 (arms F1-F14, legs F15-F26, the
whole body F27-F39) is that of Müller, Röder, "Motion templates for automatic classification and retrieval of motion
capture data", SCA 2006.

A measure has two thresholds: the answer turns yes at the strong one and stays yes until the weak one fails, to avoid
flicker. Thresholds are in body measures: ``humerus`` (upper arm), ``shoulders`` and ``hips`` (widths), ``height``;
speeds are per second.

Deviations, as the canonical joints have one spine joint instead of belly and chest: trunk directions run from pelvis to
neck (F5, F6, F27-F30, F32) or from spine to neck (F3, F4); leg planes contain the hip line and the leg (F15, F16),
which also works where the pelvis joint lies on the hip line. F35 and F36 use the sine of the angle of the shoulder line
to the hip plane; F38 is the largest horizontal distance between two joints, independent of the heading. The thresholds
of F37 and F38 are chosen for these joints and this height.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from dousa.arrays import BoolArray, FloatArray
from dousa.errors import InvalidMotionError
from dousa.motion.canonical.joints import JOINT_INDEX
from dousa.retrieval.features.posed_motion import check_shape


@dataclass(frozen=True, slots=True)
class RelationalFeature:
    """A yes-or-no question about a pose.

    Parameters
    ----------
    name : the positive answer in words.
    weak, strong : the answer turns yes when the measure exceeds ``strong`` and no when it falls to ``weak``.
    unit : of the thresholds: ``"humerus"``, ``"humerus/s"``, ``"shoulders"``, ``"hips"``, ``"height"``,
        ``"degrees"`` or ``"sine"``. Negative thresholds belong to measures that must stay small.
    """

    name: str
    weak: float
    strong: float
    unit: str


def _both(name: str, weak: float, strong: float, unit: str) -> tuple[RelationalFeature, RelationalFeature]:
    return (
        RelationalFeature(name.replace("this", "right").replace("other", "left"), weak, strong, unit),
        RelationalFeature(name.replace("this", "left").replace("other", "right"), weak, strong, unit),
    )


RELATIONAL_FEATURES: tuple[RelationalFeature, ...] = (
    *_both("this hand moving forwards", 1.3, 1.8, "humerus/s"),
    *_both("this hand above neck", 0.0, 0.2, "humerus"),
    *_both("this hand moving upwards", 1.3, 1.8, "humerus/s"),
    *_both("this elbow bent", 60.0, 70.0, "degrees"),
    RelationalFeature("hands far apart sideways", 2.0, 2.5, "shoulders"),
    RelationalFeature("hands approaching each other", 1.2, 1.4, "humerus/s"),
    *_both("this hand moving away from root", 1.2, 1.4, "humerus/s"),
    *_both("this hand fast", 2.0, 2.5, "humerus/s"),
    *_both("this foot behind other leg", 0.0, 0.38, "humerus"),
    *_both("this foot raised", 1.0, 1.2, "humerus"),
    RelationalFeature("feet far apart sideways", 1.8, 2.1, "hips"),
    *_both("this knee bent", 60.0, 70.0, "degrees"),
    RelationalFeature("feet crossed", 0.0, 0.125, "hips"),
    RelationalFeature("feet approaching each other sideways", 1.3, 1.5, "humerus/s"),
    RelationalFeature("feet moving apart sideways", 1.3, 1.5, "humerus/s"),
    *_both("this foot fast", 2.0, 2.5, "humerus/s"),
    *_both("this upper arm abducted", 25.0, 30.0, "degrees"),
    *_both("this thigh abducted", 45.0, 50.0, "degrees"),
    RelationalFeature("root behind the plane of feet and neck", 0.35, 0.5, "humerus"),
    RelationalFeature("spine horizontal", -30.0, -20.0, "degrees"),
    *_both("this hand lowered", -1.4, -1.2, "humerus"),
    *_both("shoulders rotated to the this", 0.35, 0.4, "sine"),
    RelationalFeature("body low", -0.9, -0.8, "height"),
    RelationalFeature("body stretched out sideways", 0.7, 0.8, "height"),
    RelationalFeature("root fast", 2.0, 2.3, "humerus/s"),
)
"""F1 to F39 in the publication's order; of pairs, right before left."""

_SIDES = ("right", "left")
_SHORT_WINDOW = 0.1  # s, over which positions are averaged for speeds
_LONG_WINDOW = 0.25  # s, for directed hand movements, which are slower than tremor
_SMALLEST_MEASURE = 1e-6  # m


def compute_relational_features(positions: ArrayLike, frame_rate: float, height: float) -> BoolArray:
    """Compute the 39 features of every frame: (T, 39) bool, columns as ``RELATIONAL_FEATURES``.

    Parameters
    ----------
    positions : (T, 20, 3) m, canonical joints, Y up, finite; the thresholds are for 30 Hz.
    frame_rate : Hz.
    height : m, of the performer.

    Raises
    ------
    InvalidMotionError : positions of another shape or not finite; a rate or height not above zero.

    Source: Müller, Röder 2006, table 1; deviations in the module's docstring.
    """
    joints = check_shape(positions, height)
    if not np.isfinite(joints).all():
        raise InvalidMotionError("posed_motion.not_finite")
    if not (np.isfinite(frame_rate) and frame_rate > 0):
        raise InvalidMotionError("posed_motion.rate_and_height", rate=frame_rate, height=height)
    body = _Body(joints, float(frame_rate), float(height))
    measures = np.stack([*_hands(body), *_feet(body), *_whole_body(body)], axis=1)
    scale = np.array([body.sizes[feature.unit.removesuffix("/s")] for feature in RELATIONAL_FEATURES])
    weak = np.array([feature.weak for feature in RELATIONAL_FEATURES]) * scale
    strong = np.array([feature.strong for feature in RELATIONAL_FEATURES]) * scale
    return apply_hysteresis(measures > weak, measures > strong)


class _Body:
    """Positions by name, and body measures and directions shared by questions."""

    def __init__(self, joints: FloatArray, frame_rate: float, height: float) -> None:
        self.joints = joints
        self.frame_rate = frame_rate
        arms = [self._length(f"{side}_shoulder", f"{side}_elbow") for side in _SIDES]
        self.sizes = {
            "humerus": max(float(np.mean(arms)), _SMALLEST_MEASURE),
            "shoulders": max(self._length("left_shoulder", "right_shoulder"), _SMALLEST_MEASURE),
            "hips": max(self._length("left_hip", "right_hip"), _SMALLEST_MEASURE),
            "height": height,
            "degrees": np.pi / 180.0,
            "sine": 1.0,
        }
        self.hip_line = _unit(self["left_hip"] - self["right_hip"])
        self.shoulder_line = _unit(self["left_shoulder"] - self["right_shoulder"])
        self.trunk = _unit(self["neck"] - self["pelvis"])
        hips = 0.5 * (self["left_hip"] + self["right_hip"])
        self.forward = _unit(np.cross(self.hip_line, self["neck"] - hips))
        self.lowest = joints[:, :, 1].min(axis=1)

    def __getitem__(self, name: str) -> FloatArray:
        return self.joints[:, JOINT_INDEX[name]]

    def _length(self, one: str, other: str) -> float:
        # The median over time, as bones of camera skeletons vary in length.
        return float(np.median(np.linalg.norm(self[one] - self[other], axis=1)))

    def velocity(self, points: FloatArray, window: float = _SHORT_WINDOW) -> FloatArray:
        """Return the (T, 3) velocity in m/s of points averaged over a window in seconds."""
        if len(points) < 2:
            return np.zeros_like(points)
        half = round(window * self.frame_rate) // 2
        if half:
            padded = np.pad(points, ((half, half), (0, 0)), mode="edge")
            sums = np.cumsum(np.vstack([np.zeros((1, 3)), padded]), axis=0)
            width = 2 * half + 1
            points = (sums[width:] - sums[:-width]) / width
        return np.gradient(points, 1.0 / self.frame_rate, axis=0)


def _dot(a: FloatArray, b: FloatArray) -> FloatArray:
    found: FloatArray = np.einsum("tk,tk->t", a, b)
    return found


def _unit(vectors: FloatArray) -> FloatArray:
    """Scale vectors to length 1; a zero vector stays zero, so questions on it are negative."""
    lengths = np.linalg.norm(vectors, axis=-1, keepdims=True)
    found: FloatArray = np.divide(vectors, lengths, out=np.zeros_like(vectors), where=lengths > 1e-12)
    return found


def _angle(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the angle in radians between directions, accurate near 0 and pi."""
    found: FloatArray = np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), _dot(a, b))
    return found


def _flexion(body: _Body, upper: str, middle: str, lower: str) -> list[FloatArray]:
    return [
        _angle(body[f"{s}_{middle}"] - body[f"{s}_{upper}"], body[f"{s}_{lower}"] - body[f"{s}_{middle}"])
        for s in _SIDES
    ]


def _hands(body: _Body) -> list[FloatArray]:
    """Measures of F1 to F14."""
    wrists = [body[f"{side}_wrist"] for side in _SIDES]
    from_neck = [body.velocity(wrist - body["neck"], _LONG_WINDOW) for wrist in wrists]
    upper_spine = _unit(body["neck"] - body["spine"])
    right, left = wrists
    between = _unit(right - left)
    from_root = [wrist - body["pelvis"] for wrist in wrists]
    return [
        *(_dot(speed, body.forward) for speed in from_neck),
        *(_dot(wrist - body["neck"], upper_spine) for wrist in wrists),
        *(_dot(speed, body.trunk) for speed in from_neck),
        *_flexion(body, "shoulder", "elbow", "wrist"),
        np.abs(_dot(left - right, body.shoulder_line)),
        -_dot(body.velocity(right - left), between),
        *(_dot(body.velocity(offset), _unit(offset)) for offset in from_root),
        *(np.linalg.norm(body.velocity(wrist), axis=1) for wrist in wrists),
    ]


def _feet(body: _Body) -> list[FloatArray]:
    """Measures of F15 to F26."""
    ankles = {side: body[f"{side}_ankle"] for side in _SIDES}
    behind = []
    for side, other in (("right", "left"), ("left", "right")):
        hip = body[f"{other}_hip"]
        ahead_of_leg = _unit(np.cross(body.hip_line, hip - ankles[other]))
        behind.append(-_dot(ankles[side] - hip, ahead_of_leg))
    spread = ankles["left"] - ankles["right"]
    sideways = _dot(body.velocity(spread), body.hip_line)
    speeds = [
        np.minimum(*(np.linalg.norm(body.velocity(body[f"{side}_{j}"]), axis=1) for j in ("ankle", "toe")))
        for side in _SIDES
    ]
    apart = _dot(spread, body.hip_line)
    return [
        *behind,
        *(ankles[side][:, 1] - body.lowest for side in _SIDES),
        np.abs(apart),
        *_flexion(body, "hip", "knee", "ankle"),
        -apart,
        -sideways,
        sideways,
        *speeds,
    ]


def _whole_body(body: _Body) -> list[FloatArray]:
    """Measures of F27 to F39."""
    ankles_line = body["left_ankle"] - body["right_ankle"]
    between_ankles = 0.5 * (body["left_ankle"] + body["right_ankle"])
    ahead = _unit(np.cross(ankles_line, body["neck"] - between_ankles))
    up = np.broadcast_to(np.array([0.0, 1.0, 0.0]), body.trunk.shape)
    left_ahead = _dot(body.shoulder_line, body.forward)  # the shoulders are turned to the right
    ground = body.joints[:, :, ::2]
    # The widest pair of joints, as the extent along fixed axes varies with the heading.
    x, z = (ground[:, :, None, k] - ground[:, None, :, k] for k in (0, 1))
    width = np.sqrt((x * x + z * z).max(axis=(1, 2)))
    down = -body.trunk
    return [
        *(_angle(down, body[f"{side}_elbow"] - body[f"{side}_shoulder"]) for side in _SIDES),
        *(_angle(down, body[f"{side}_knee"] - body[f"{side}_hip"]) for side in _SIDES),
        -_dot(body["pelvis"] - between_ankles, ahead),
        -np.abs(_angle(body.trunk, up) - 0.5 * np.pi),
        *(body.lowest - body[f"{side}_wrist"][:, 1] for side in _SIDES),
        left_ahead,
        -left_ahead,
        -np.ptp(body.joints[:, :, 1], axis=1),
        width,
        np.linalg.norm(body.velocity(body["pelvis"]), axis=1),
    ]


def apply_hysteresis(weak: BoolArray, strong: BoolArray) -> BoolArray:
    """Return true from a frame where ``strong`` holds until ``weak`` fails; both (T, F)."""
    frames = np.arange(len(weak))[:, None]
    last_strong = np.maximum.accumulate(np.where(strong, frames, -1), axis=0)
    last_failure = np.maximum.accumulate(np.where(weak, -1, frames), axis=0)
    return last_strong > last_failure
