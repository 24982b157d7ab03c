"""The 56 pose features: relations between parts of one body, independent of place, heading and height.

Source: Hamada et al., section 2.2: (a) positions of joints in a body-fixed system, (b) distances between two joints,
(c) inclination of the trunk against the axes of that system; lengths are divided by the body height (eq. 2). The paper
counts 56 and lists none; ``FEATURES`` was chosen on HDM05 and UTD-MHAD with performers left out, and on one training
half of Bandai Namco.

The body-fixed system has its origin in the pelvis. Its lateral axis points to the performer's left along the hips, made
horizontal; its vertical axis is gravity's; forward follows by the right-hand rule.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from dousa.arrays import FloatArray
from dousa.errors import InvalidMotionError, OptionError
from dousa.motion.canonical.joints import JOINT_INDEX
from dousa.retrieval.features.channel_kernels import find_lateral_directions
from dousa.retrieval.features.posed_motion import PosedMotion, check_shape

_LEFT, _UP, _FORWARD = 0, 1, 2

# Direction -> the words that join it to the pelvis, axis, sign, by the definition of the body-fixed system above.
_DIRECTIONS = {
    "left": ("left of", _LEFT, 1.0),
    "right": ("right of", _LEFT, -1.0),
    "above": ("above", _UP, 1.0),
    "in front": ("in front of", _FORWARD, 1.0),
}

HIPS, SHOULDERS = (
    np.array([JOINT_INDEX[f"{side}_{joint}"] for side in ("left", "right")]) for joint in ("hip", "shoulder")
)
"""Indices of the left one and the right one."""


@dataclass(frozen=True, slots=True)
class Feature:
    """One pose feature.

    Parameters
    ----------
    name : in words.
    kind : ``"position"`` in the body-fixed system, ``"distance"`` or ``"inclination"``.
    joints : its canonical joints.
    axis : of the body-fixed system: 0 left, 1 up, 2 forward; None for a distance.
    sign : -1 where the name has right: positions of arms and legs grow outwards on both sides.
    unit : ``"body heights"`` or ``"radians"``.
    """

    name: str
    kind: Literal["position", "distance", "inclination"]
    joints: tuple[str, ...]
    axis: int | None = None
    sign: float = 1.0
    unit: str = "body heights"


def say_joint(joint: str) -> str:
    """Return the everyday word of a joint: the ankle is the foot."""
    return joint.replace("_", " ").replace("ankle", "foot")


def _position(joint: str, direction: str) -> Feature:
    link, axis, sign = _DIRECTIONS[direction]
    return Feature(f"{say_joint(joint)} {link} pelvis", "position", (joint, "pelvis"), axis, sign)


def _distance(one: str, other: str) -> Feature:
    return Feature(f"distance {say_joint(one)} - {say_joint(other)}", "distance", (one, other))


def _inclination(name: str, axis: int) -> Feature:
    return Feature(name, "inclination", ("pelvis", "neck"), axis, 1.0, "radians")


def _list_features() -> tuple[Feature, ...]:
    positions = [_position("head", direction) for direction in ("left", "above", "in front")]
    distances = [_distance(f"left_{joint}", f"right_{joint}") for joint in ("hand", "elbow", "knee", "ankle")]
    for side, other in (("left", "right"), ("right", "left")):
        for joint in ("elbow", "hand", "ankle"):
            positions += [_position(f"{side}_{joint}", direction) for direction in (side, "above", "in front")]
        for joint in ("knee", "toe"):
            positions += [_position(f"{side}_{joint}", direction) for direction in (side, "in front")]
        positions += [_position(f"{side}_shoulder", direction) for direction in ("above", "in front")]
        positions.append(_position(f"{side}_hip", "above"))
        hand = f"{side}_hand"
        touched = ("head", f"{other}_shoulder", "spine", f"{side}_hip", f"{side}_knee", f"{side}_ankle")
        distances += [_distance(hand, joint) for joint in touched]
        distances.append(_distance(f"{side}_elbow", f"{other}_knee"))
    inclinations = [
        _inclination("trunk leaning left", _LEFT),
        _inclination("trunk away from upright", _UP),
        _inclination("trunk leaning forward", _FORWARD),
    ]
    return (*positions, *distances, *inclinations)


FEATURES: tuple[Feature, ...] = _list_features()
"""The 56 features in their order: positions, distances, inclinations."""

FEATURE_NAMES: tuple[str, ...] = tuple(feature.name for feature in FEATURES)
"""Their names in words."""

_POSITIONS = [feature for feature in FEATURES if feature.kind == "position"]
_DISTANCES = [feature for feature in FEATURES if feature.kind == "distance"]
_POSITION_JOINTS, _DISTANCE_FROM, _DISTANCE_TO = (
    np.array([JOINT_INDEX[feature.joints[end]] for feature in some])
    for some, end in ((_POSITIONS, 0), (_DISTANCES, 0), (_DISTANCES, 1))
)
_POSITION_AXES, _POSITION_SIGNS = (
    np.array([getattr(feature, name) for feature in _POSITIONS]) for name in ("axis", "sign")
)


def compute_pose_features(positions: ArrayLike, height: float) -> FloatArray:
    """Compute the 56 features of every pose.

    Parameters
    ----------
    positions : (T, 20, 3) m, canonical joints in the order of ``CANONICAL_JOINTS``, Y up, without gaps.
    height : m, body height of eq. 1.

    Returns (T, 56) in body heights and radians, in the order of ``FEATURES``. Raises InvalidMotionError: another shape,
    positions that are not finite, a height that is not above 0.

    Source: Hamada et al., eq. 2 and section 2.2.
    """
    points = check_shape(positions, height)
    normalised = (points - points[:, :1]) / height
    if not np.isfinite(normalised).all():
        raise InvalidMotionError("posed_motion.not_finite")
    body = turn_to_body(normalised)
    where = body[:, _POSITION_JOINTS, _POSITION_AXES] * _POSITION_SIGNS
    apart = body[:, _DISTANCE_FROM] - body[:, _DISTANCE_TO]
    distances = np.sqrt(np.einsum("tdk,tdk->td", apart, apart))
    return np.concatenate([where, distances, _trunk_inclination(body)], axis=1)


def compute_clip_features(canonical: PosedMotion, n_frames: int = 10, samples_per_frame: int = 8) -> FloatArray:
    """Compute the 56 features of a clip thinned to equally long parts.

    Parameters
    ----------
    canonical : the clip; in a short one, frames repeat.
    n_frames : T, at least 1; 10 in the paper.
    samples_per_frame : poses, equally spaced over a part, that are averaged; 1 takes the middle pose alone.

    Returns (n_frames, 56). Raises OptionError: a number below 1.

    Source: Hamada et al., section 2.3. The paper thins to single frames; means of parts are closer to the integral of
    eq. 3 and separate people better on every data set tried (docs/retrieval.md).

    >>> canonical = dousa.canonicalise(dousa.read_motion("wave.bvh"))
    >>> dousa.compute_clip_features(canonical).shape
    (10, 56)
    """
    if n_frames < 1 or samples_per_frame < 1:
        raise OptionError("features.samples", frames=repr(n_frames), samples=repr(samples_per_frame))
    wanted = n_frames * samples_per_frame
    # In whole numbers: a middle between two frames is the later one, independent of rounding.
    middles = (2 * np.arange(wanted) + 1) * len(canonical.positions) // (2 * wanted)
    poses = compute_pose_features(canonical.positions[middles], canonical.height)
    parts: FloatArray = poses.reshape(n_frames, samples_per_frame, -1).mean(axis=1)
    return parts


def turn_to_body(points: FloatArray) -> FloatArray:
    """Turn (T, 20, 3), from the pelvis with Y up, into body axes: left, up, forward."""
    left = find_lateral_axis(points)
    body = np.empty_like(points)
    across, along = left[:, :1], left[:, 1:]  # x and z of the lateral axis; forward is lateral x vertical
    x, z = points[:, :, 0], points[:, :, 2]
    body[:, :, _LEFT] = x * across + z * along
    body[:, :, _UP] = points[:, :, 1]
    body[:, :, _FORWARD] = z * across - x * along
    return body


def find_lateral_axis(points: FloatArray) -> FloatArray:
    """Return (T, 2) unit x and z of the direction to the left: of the hips, else the shoulders, else as before."""
    left = np.empty((len(points), 2))
    find_lateral_directions(np.ascontiguousarray(points, np.float64), HIPS, SHOULDERS, left)
    return left


def _trunk_inclination(body: FloatArray) -> FloatArray:
    """Return (T, 3) angles of pelvis -> neck: out of the sagittal plane, off the vertical, out of the frontal plane.

    The first and last are the right angle less the angle to the axis, so that upright is 0 for all three.
    """
    trunk = body[:, JOINT_INDEX["neck"]]
    sideways, up, forward = trunk[:, _LEFT], trunk[:, _UP], trunk[:, _FORWARD]
    # arctan2 is exact near the poles where arccos is not, and 0 for a trunk of no length.
    return np.stack(
        [
            np.arctan2(sideways, np.hypot(up, forward)),
            np.arctan2(np.hypot(sideways, forward), up),
            np.arctan2(forward, np.hypot(up, sideways)),
        ],
        axis=1,
    )
