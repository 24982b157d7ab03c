"""Height, rest pose and glitches of canonical points (T, 20, 3) in any unit; NaN where a joint was not seen."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from dousa.arrays import BoolArray, FloatArray
from dousa.motion.canonical.anthropometry import stature_of_parts
from dousa.motion.canonical.joint_centres import hips_from_markers, move_inside
from dousa.motion.canonical.joints import JOINT_INDEX as J
from dousa.motion.canonical.recipes import Recipe
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
_BONES = np.zeros((len(_CHAIN) + 1, len(J)))

for _bone, (_a, _b) in enumerate(_CHAIN):
    _BONES[_bone, [J[_a], J[_b]]] = 1.0, -1.0

_BONES[-1, [J["pelvis"], J["left_hip"], J["right_hip"]]] = 1.0, -0.5, -0.5

# A standing body is shorter than its bones end to end: the spine is curved, the legs are apart. Measured on the
# upright rest poses of HDM05: 0.957 to 0.976.
_POSTURE = 0.967

# A standing foot slopes: the ankle is higher than the toe joint by this share of their distance.
_FOOT_SLOPE = 0.4
CHAIN_SHARES = _POSTURE * np.array([1.0, 1.0, 1.0, 0.5, 0.5, 0.5, 0.5, 0.5 * _FOOT_SLOPE, 0.5 * _FOOT_SLOPE, 1.0])
"""Of the bones of the chain, what each adds to the height."""

CHAIN_BONES = np.array([[J[a], J[b], J[b]] for a, b in _CHAIN] + [[J["pelvis"], J["left_hip"], J["right_hip"]]])
"""The bones of the chain: one end, and two joints in the middle of which the other end lies."""

STATURE_PER_HEIGHT = 1.1
"""The crown of the head and the sole of the foot lie beyond the joints."""

_MAX_REST_MISMATCH = 0.1  # a rest pose whose bones are longer or shorter than the moving ones is not believed
_UPRIGHT = 0.9  # cosine; a rest pose with trunk and legs this well along an axis is upright


def chain_height(points: FloatArray) -> float:
    """Compute the height along the bones, median over frames: head-neck-spine-pelvis-hip-knee-ankle-toe.

    The height of eq. 1 on an upright body, for (T, 20, 3) canonical points in their unit; NaN if a joint is never seen.
    """
    bones = _BONES @ points
    return _median(np.sqrt(np.einsum("tjk,tjk->tj", bones, bones)) @ CHAIN_SHARES)


def _median(values: FloatArray) -> float:
    middle = float(np.median(values))
    if not np.isnan(middle):
        return middle
    seen = values[~np.isnan(values)]
    return float(np.median(seen)) if len(seen) else float("nan")


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

    def fits(self, chain: float) -> bool:
        """Return whether the moving body has these bones: files may replace the offsets frame by frame."""
        return abs(self.chain - chain) <= _MAX_REST_MISMATCH * chain


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
    if not (along > _UPRIGHT * np.sqrt((limbs * limbs).sum(axis=1))).all():
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
        points[:, [J["left_hip"], J["right_hip"]]] = hips
        points[:, J["pelvis"]] = hips.mean(axis=1)
    if recipe.skin:
        move_inside(points, recipe.skin)
    return points


def _seen_mean(points: FloatArray) -> FloatArray:
    there: BoolArray = ~np.any(np.isnan(points), axis=2)
    total = np.where(there[..., None], points, 0.0).sum(axis=1)
    with np.errstate(invalid="ignore"):
        mean: FloatArray = total / there.sum(axis=1)[:, None]
    return mean


# m/s; m; cosine between the way out and the way back; the shorter of both as a share of the longer
_LEAP_SPEED, _LEAST_LEAP, _BACK, _ALIKE = 10.0, 0.1, -0.5, 0.4


def find_leaps(points: FloatArray, frame_rate: float) -> BoolArray:
    """Find joints (T, 20) that leap for one frame and come back: glitches of a recording.

    A leap goes out and back at over 10 m/s, by at least 10 cm: the fastest hands and feet take longer to turn round.

    Parameters
    ----------
    points : (T, 20, 3) m.
    frame_rate : Hz.
    """
    found = np.zeros(points.shape[:2], bool)
    steps = np.diff(points, axis=0)
    squared = np.einsum("tjk,tjk->tj", steps, steps)
    far = np.sqrt(squared) > max(_LEAST_LEAP, _LEAP_SPEED / frame_rate)
    both = far[:-1] & far[1:]
    if both.any():
        back = np.einsum("tjk,tjk->tj", steps[:-1], steps[1:])
        alike = np.minimum(squared[:-1], squared[1:]) > _ALIKE**2 * np.maximum(squared[:-1], squared[1:])
        found[1:-1] = both & alike & (back < _BACK * np.sqrt(squared[:-1] * squared[1:]))
    return found
