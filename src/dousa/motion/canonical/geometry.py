"""Height, rest pose and glitches of canonical points (T, 20, 3) in any unit; NaN where a joint was not seen."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import numpy as np

from dousa.arrays import BoolArray, FloatArray
from dousa.motion.canonical.anthropometry import find_directions, find_medians, stature_of_parts
from dousa.motion.canonical.joints import JOINT_INDEX as J
from dousa.motion.canonical.recipes import Recipe
from dousa.motion.canonical.tree_shape import score_sides
from dousa.motion.types import Trajectories

# The bone chain of the paper's body height: from head to toe, both legs counted half; then pelvis to the
# middle of the hips.
_LEG = (("hip", "knee"), ("knee", "ankle"), ("ankle", "toe"))
_CHAIN = (
    ("head", "neck"),
    ("neck", "spine"),
    ("spine", "pelvis"),
    *((f"{side}_{upper}", f"{side}_{lower}") for upper, lower in _LEG for side in ("left", "right")),
)
CHAIN_BONES = np.array([[J[a], J[b], J[b]] for a, b in _CHAIN] + [[J["pelvis"], J["left_hip"], J["right_hip"]]])
"""The bones of the chain: one end, and two joints in the middle of which the other end lies."""

# The rows that make them of the joints, by this definition.
_BONES = np.einsum("k,nkj->nj", [1.0, -0.5, -0.5], np.eye(len(J))[CHAIN_BONES])

# A standing body is shorter than its bones end to end: the spine is curved, the legs are apart. Measured on the
# upright rest poses of HDM05: 0.957 to 0.976.
_POSTURE = 0.967

CHAIN_SHARES = _POSTURE * np.array([1.0, 1.0, 1.0, 0.5, 0.5, 0.5, 0.5, 0.2, 0.2, 1.0])
"""Of the bones of the chain, what each adds to the height: by definition each leg half.

A standing foot slopes: the ankle is higher than the toe joint by 0.4 of their distance.
"""

STATURE_PER_HEIGHT = 1.1
"""The crown of the head and the sole of the foot lie beyond the joints.

By D. A. Winter's proportions (fig. 4.1) eye level is at 0.936 of the stature and the ankle at 0.039: a chain from
there to between the ankle and the floor makes 0.90 to 0.94 of it.
"""


def chain_height(points: FloatArray) -> float:
    """Compute the height along the bones, median over frames: head-neck-spine-pelvis-hip-knee-ankle-toe.

    The height of eq. 1 on an upright body, for (T, 20, 3) canonical points in their unit; NaN if a joint is never seen.
    """
    bones = _BONES @ points
    heights = np.sqrt(np.einsum("tjk,tjk->tj", bones, bones)) @ CHAIN_SHARES
    return float(find_medians(heights[:, None])[0])


@dataclass(frozen=True, slots=True)
class RestPose:
    """Measures of an upright rest pose.

    Parameters
    ----------
    height : eq. 1 of Hamada et al.: max(Y) - min(Y) over the joints, Y being the axis the body stands along.
    axis : that axis, 0 to 2.
    chain : `chain_height` of the rest pose.
    """

    height: float
    axis: int
    chain: float

    def fits(self, chain: float, mismatch: float = 0.1) -> bool:
        """Return whether the moving body has these bones, but for a share: files may replace the offsets."""
        return abs(self.chain - chain) <= mismatch * chain


def measure_rest(recipe: Recipe, rest_positions: FloatArray | None) -> RestPose | None:
    """Measure a rest pose, once per skeleton; None unless trunk and both legs are upright along one axis.

    Parameters
    ----------
    recipe : canonical mapping of the skeleton.
    rest_positions : (J, 3) rest pose in any unit and axes, None if unknown.
    """
    return None if rest_positions is None else _measure_rest(recipe, rest_positions.tobytes())


@lru_cache(maxsize=256)
def _measure_rest(recipe: Recipe, rest_bytes: bytes) -> RestPose | None:
    rest = body_points(recipe, np.frombuffer(rest_bytes).reshape(1, -1, 3))
    pose = rest[0]
    trunk = pose[J["neck"]] - pose[J["pelvis"]]
    legs = [pose[J[f"{side}_hip"]] - pose[J[f"{side}_ankle"]] for side in ("left", "right")]
    limbs = np.stack([trunk, *legs])
    axis = int(np.argmax(np.abs(trunk)))
    along = limbs[:, axis] * np.sign(trunk[axis])
    if not (along > 0.9 * np.sqrt((limbs * limbs).sum(axis=1))).all():
        return None
    return RestPose(float(np.ptp(pose[:, axis])), axis, chain_height(rest))


def estimate_stature(sample: Trajectories, points: FloatArray | None) -> float:
    """Estimate the stature from some frames, in their unit; NaN if it cannot be estimated.

    ``points`` : canonical points of the sample; None if the joints are unknown: then the extent of all points is used.
    """
    if points is not None:
        height = chain_height(points)
        if height > 0:
            return STATURE_PER_HEIGHT * height
        part = stature_of_parts(points)
        if part > 0:
            return part
    seen = sample.positions[~np.isnan(sample.positions).any(axis=(1, 2))]
    return float(np.median(np.ptp(seen, axis=1).max(axis=1))) if len(seen) else float("nan")


def body_points(recipe: Recipe, positions: FloatArray, *, metres: bool = False) -> FloatArray:
    """Compute canonical points (T, 20, 3) in the unit of the positions, with joint centres from markers where needed.

    ``metres`` : whether the unit is metres; then the hip regression with absolute lengths is used.
    """
    points = recipe.apply(positions)
    if recipe.pelvis_markers:
        left, right, sacrum = (positions[:, list(indices)].mean(axis=1) for indices in recipe.pelvis_markers)
        below = points[:, [J[f"{side}_{joint}"] for joint in ("knee", "ankle") for side in ("left", "right")]]
        hips = hips_from_markers(left, right, sacrum, _seen_mean(below), metres=metres)
        middle = hips.mean(axis=1)
        if "pelvis" in recipe.sources:  # the middle between the joints, as the file has it
            hips += (points[:, J["pelvis"]] - middle)[:, None]
        else:
            points[:, J["pelvis"]] = middle
        points[:, [J["left_hip"], J["right_hip"]]] = hips
    if recipe.skin:
        move_inside(points, recipe.skin)
    return points


def _seen_mean(points: FloatArray) -> FloatArray:
    there: BoolArray = ~np.any(np.isnan(points), axis=2)
    total = np.where(there[..., None], points, 0.0).sum(axis=1)
    with np.errstate(invalid="ignore"):
        mean: FloatArray = total / there.sum(axis=1)[:, None]
    return mean


def find_leaps(
    points: FloatArray,
    frame_rate: float,
    *,
    fastest: float = 10.0,
    least: float = 0.1,
    back: float = -0.5,
    similar: float = 0.4,
    at_once: int = 4096,
) -> BoolArray:
    """Find joints (T, 20) that leap for one frame and come back: glitches of a recording.

    The fastest hands and feet take longer to turn round.

    Parameters
    ----------
    points : (T, 20, 3) m.
    frame_rate : Hz.
    fastest, least : m/s and m of a leap, out and back.
    back : largest cosine between the way out and the way back.
    similar : the shorter of both as a share of the longer.
    at_once : frames looked at at a time: their memory.
    """
    found = np.zeros(points.shape[:2], bool)
    for first in range(1, len(points) - 1, at_once):
        last = min(first + at_once, len(points) - 1)
        steps = np.diff(points[first - 1 : last + 1], axis=0)
        squared = np.einsum("tjk,tjk->tj", steps, steps)
        far = np.sqrt(squared) > max(least, fastest / frame_rate)
        both = far[:-1] & far[1:]
        if both.any():
            returned = np.einsum("tjk,tjk->tj", steps[:-1], steps[1:])
            both &= np.minimum(squared[:-1], squared[1:]) > similar**2 * np.maximum(squared[:-1], squared[1:])
            found[first:last] = both & (returned < back * np.sqrt(squared[:-1] * squared[1:]))
    return found


# Breadths over the bones as shares of the stature: Ross & Wilson, "A stratagem for proportional growth assessment",
# Acta Paediatrica Belgica 28 suppl. (1974): femur 9.52 cm, ankle 6.68, humerus 6.48, between the acromia 38.04, at
# 170.18. A marker stands 7 mm off the bone (skin, and half of a ball of 9 to 14 mm).
_STATURE = 170.18
_MARKER = 0.7 / _STATURE  # as Ross & Wilson 1974
_KNEE, _ANKLE, _ELBOW = (0.5 * breadth / _STATURE + _MARKER for breadth in (9.52, 6.68, 6.48))
_BIACROMIAL = 38.04 / _STATURE  # Ross & Wilson 1974
# Rab, Petuskey, Bagley, "A method for determination of upper extremity kinematics", Gait & Posture 15 (2002).
_SHOULDER_DROP = 0.17  # of the distance between the acromia, down the trunk


def hips_from_markers(
    left_asis: FloatArray, right_asis: FloatArray, sacrum: FloatArray, below: FloatArray, *, metres: bool = False
) -> FloatArray:
    """Compute hip joint centres (T, 2, 3), left and right, from markers on the pelvis.

    In metres: Harrington et al., "Prediction of the hip joint centre in adults, children, and patients with cerebral
    palsy based on magnetic resonance imaging", J. Biomechanics 40 (2007): from the middle of the front spines (ASIS)
    33 % of their distance and 7.3 mm to the side, 30 % of it and 10.9 mm down, and back 24 % of the depth of the
    pelvis (from there to the middle of the back spines, or the sacrum) and 9.9 mm, in the plane of the spines. In an
    unknown unit: Bell, Brand, Pedersen, "Prediction of hip joint centre location from external landmarks", Human
    Movement Science 8 (1989): 36 % of the distance to the side, 19 % back and 30 % down.

    Parameters
    ----------
    left_asis, right_asis, sacrum : (T, 3).
    below : (T, 3) middle of the knees: the side of the plane that is down, in either handedness.
    metres : whether the unit is metres.
    """
    middle = 0.5 * (left_asis + right_asis)
    lateral = left_asis - right_asis
    width = np.linalg.norm(lateral, axis=-1, keepdims=True)
    with np.errstate(invalid="ignore"):  # markers that coincide
        lateral = lateral / width
    back = sacrum - middle
    back = back - (back * lateral).sum(axis=-1, keepdims=True) * lateral
    depth = np.linalg.norm(back, axis=-1, keepdims=True)
    with np.errstate(invalid="ignore"):
        back = back / depth
    down = np.cross(back, lateral)
    if np.nansum((below - middle) * down) < 0:
        down = -down
    if metres:
        base = middle + (0.24 * depth + 0.0099) * back + (0.30 * width + 0.0109) * down
        aside = 0.33 * width + 0.0073
    else:
        base = middle + width * (0.19 * back + 0.30 * down)
        aside = 0.36 * width
    return np.stack((base + aside * lateral, base - aside * lateral), axis=-2)


def move_inside(points: FloatArray, skin: frozenset[str]) -> None:
    """Move joints with a marker on one side only to the joint centres; changes the points.

    Knee, ankle and elbow move inwards by half the breadth of bone and marker along the axis of the joint: across the
    plane of a bent limb, parallel to hips or shoulders for a straight one. Shoulders move down the trunk.

    Parameters
    ----------
    points : (T, 20, 3) canonical points; hips already made.
    skin : canonical joints that are such markers.
    """
    stature = stature_of_parts(points)
    if not skin or not stature > 0:
        return
    _lower_shoulders(points, skin, stature)
    hips, shoulders = _outward(points, "hip"), _outward(points, "shoulder")
    legs, arms = _limbs(("hip", "knee", "ankle")), _limbs(("shoulder", "elbow", "wrist"))
    hand = -1.0 if score_sides(points) < 0 else 1.0
    for side, sign in (("left", 1.0), ("right", -1.0)):
        leg, arm = legs[side], arms[side]
        raw = points[:, leg].copy()
        for _ in range(2):  # the second time with the plane of a limb that is nearly in place
            axis = _joint_axis(points, leg, sign * hips, sign * hand, stature * _KNEE)
            if f"{side}_knee" in skin:
                points[:, leg[1]] = raw[:, 1] - stature * _KNEE * _bounded(axis)
            if f"{side}_ankle" in skin:
                shank = points[:, leg[1]] - raw[:, 2]
                points[:, leg[2]] = raw[:, 2] - stature * _ANKLE * _bounded(_across(axis, shank))
        if f"{side}_elbow" in skin:
            axis = _joint_axis(points, arm, sign * shoulders, -sign * hand, stature * _ELBOW)
            points[:, arm[1]] -= stature * _ELBOW * _bounded(axis)


def _limbs(joints: tuple[str, ...]) -> dict[str, list[int]]:
    return {side: [J[f"{side}_{joint}"] for joint in joints] for side in ("left", "right")}


def _across(vectors: FloatArray, axis: FloatArray) -> FloatArray:
    """The part of vectors (T, 3) across an axis (T, 3), not normalised."""
    along = find_directions(axis)
    across: FloatArray = vectors - (vectors * along).sum(axis=1, keepdims=True) * along
    return across


def _bounded(axis: FloatArray, sure: float = 0.25) -> FloatArray:
    """A direction (T, 3) of length 1; shorter where the vector is too short, 0 where it is unknown.

    ``sure`` : sine of a bend from which on the plane of a limb gives the axis of its joint.
    """
    size = np.linalg.norm(axis, axis=1, keepdims=True)
    bounded: FloatArray = np.nan_to_num(axis / np.maximum(size, sure))
    return bounded


def _outward(points: FloatArray, joint: str) -> FloatArray:
    """Unit vectors (T, 3) from the right to the left of a pair; of the other pair where it is missing."""
    pairs = [
        find_directions(points[:, J[f"left_{one}"]] - points[:, J[f"right_{one}"]])
        for one in (joint, "hip", "shoulder")
    ]
    found = pairs[0]
    for other in pairs[1:]:
        found = np.where(np.isnan(found), other, found)
    return found


def _normal(points: FloatArray, limb: list[int], off: float) -> tuple[FloatArray, FloatArray]:
    """Across the plane of a limb (T, 3), as long as the sine of its bend; and the direction of its upper bone.

    ``off`` : how far the marker may lie off the joint: it bends a straight limb to any side, which is no bend.
    """
    bones = [points[:, a] - points[:, b] for a, b in pairwise(limb)]
    upper, lower = (find_directions(bone) for bone in bones)
    normal = np.cross(upper, lower)
    with np.errstate(invalid="ignore", divide="ignore"):
        seeming = off * sum(1.0 / np.linalg.norm(bone, axis=1) for bone in bones)
        surplus = np.linalg.norm(normal, axis=1) / seeming - 1.0
    return normal * np.clip(surplus, 0.0, 1.0)[:, None], upper


def _joint_axis(
    points: FloatArray, limb: list[int], outward: FloatArray, sense: float, off: float, bent: float = 2.0
) -> FloatArray:
    """Outward axis (T, 3) of the middle joint of a limb, longer where it is better known.

    Parameters
    ----------
    off : from the marker to the joint.
    sense : 1 if the cross product of upper and lower bone points outwards, -1 if inwards.
    bent : weight of a bent limb for the axis, against the trunk's.
    """
    normal, upper = _normal(points, limb, off)
    aside = _across(outward, upper)
    axis: FloatArray = np.nan_to_num(aside) + sense * bent * np.nan_to_num(normal)
    return np.where(np.isnan(upper), np.nan, axis)


def _lower_shoulders(points: FloatArray, skin: frozenset[str], stature: float) -> None:
    """Move shoulders from the acromia down the trunk, by Rab et al. (2002)."""
    places = [J[f"{side}_shoulder"] for side in ("left", "right") if f"{side}_shoulder" in skin]
    if not places:
        return
    both = points[:, [J["left_shoulder"], J["right_shoulder"]]]
    width = float(np.nanmedian(np.linalg.norm(both[:, 0] - both[:, 1], axis=1))) if _seen(both) else np.nan
    if not width > 0:
        width = _BIACROMIAL * stature
    top, low = (
        _first_seen(points, joints) for joints in (("neck", "left_shoulder", "right_shoulder"), ("pelvis", "spine"))
    )
    points[:, places] += np.nan_to_num(_SHOULDER_DROP * width * find_directions(low - top))[:, None]


def _first_seen(points: FloatArray, joints: tuple[str, ...]) -> FloatArray:
    """The first of some joints that any frame shows (T, 3); NaN if there is none."""
    return next(
        (one for one in (points[:, J[joint]] for joint in joints) if _seen(one[:, None])), points[:, 0] * np.nan
    )


def _seen(points: FloatArray) -> bool:
    """Whether any frame shows all of some points (T, K, 3)."""
    return bool((~np.isnan(points).any(axis=(1, 2))).any())
