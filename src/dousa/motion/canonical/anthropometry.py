"""Checks whether canonical points can be those of a person: widths, sides, and proportions of limbs and trunk.

The typical ratios are those of the skeletons and marker sets of some 30 producers, measured with `measure_proportions`.
They scatter more between producers, who place the same joint differently, than between people.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, isnan, log, nan

import numpy as np

from dousa.arrays import FloatArray
from dousa.motion.canonical.joints import JOINT_INDEX

_PAIRED = (("hip", "knee"), ("knee", "ankle"), ("shoulder", "elbow"), ("elbow", "wrist"))
_BONES = (
    *((f"{side}_{upper}", f"{side}_{lower}") for upper, lower in _PAIRED for side in ("left", "right")),
    ("left_hip", "right_hip"),
    ("left_shoulder", "right_shoulder"),
    ("pelvis", "neck"),
)
_ENDS = np.array([JOINT_INDEX[end] for end, _ in _BONES])
_STARTS = np.array([JOINT_INDEX[start] for _, start in _BONES])

# Ratio: typical value and scatter of its logarithm, as measured; least and greatest that a map may give.
_RATIOS = {
    "arm_per_leg": (0.62, 0.13, 0.35, 1.3),
    "trunk_per_leg": (0.58, 0.25, 0.15, 1.6),
    "thigh_per_shank": (1.04, 0.15, 0.45, 2.2),
    "upper_arm_per_forearm": (1.12, 0.2, 0.4, 2.5),
    "hips_per_leg": (0.23, 0.3, 0.04, 0.7),
    "shoulders_per_leg": (0.43, 0.2, 0.1, 1.2),
    "left_per_right": (1.0, 0.1, 0.45, 2.2),
}


def score_ratio(name: str, value: float) -> float:
    """Square the standard score of the logarithm of a ratio: how unlike a person's it is, at most 16."""
    typical, scatter, _, _ = _RATIOS[name]
    return min((log(max(value, 1e-3) / typical) / scatter) ** 2, 16.0)


@dataclass(frozen=True, slots=True)
class Proportions:
    """Ratios between the bones of a body.

    Parameters
    ----------
    ratios : by name, as in ``_RATIOS``; NaN where a joint is absent.
    left_per_right : the largest ratio of a bone to the same bone of the other side, at least 1.
    """

    ratios: dict[str, float]
    left_per_right: float

    @property
    def faults(self) -> tuple[str, ...]:
        """Return the ratios that no map of a person gives."""
        wrong = [name for name, value in self.ratios.items() if value < _RATIOS[name][2] or value > _RATIOS[name][3]]
        # Kinects see a shank up to 1.7 times as long as the other.
        return (*wrong, "left_per_right") if self.left_per_right > 2.2 else tuple(wrong)

    @property
    def oddity(self) -> float:
        """Return the sum of squared standard scores of the logarithms: how unlike a person."""
        return sum(score_ratio(name, value) for name, value in self.ratios.items() if not isnan(value))

    @property
    def is_person(self) -> bool:
        """Return whether a person can have these bones."""
        return not self.faults and self.oddity <= 30.0  # people and rigs of people reach 21, a dog 35


def measure_proportions(points: FloatArray) -> Proportions:
    """Measure a body of (T, 20, 3) canonical points in any unit, axes and handedness; a few frames are enough."""
    middle = _measure_bones(points)
    *limbs, hips, shoulders, trunk = middle.tolist()
    pairs = list(zip(limbs[::2], limbs[1::2], strict=True))
    thigh, shank, upper, fore = (
        right if isnan(left) else left if isnan(right) else 0.5 * (left + right) for left, right in pairs
    )
    leg, arm = thigh + shank, upper + fore
    ratios = {
        "arm_per_leg": _divide(arm, leg),
        "trunk_per_leg": _divide(trunk, leg),
        "thigh_per_shank": _divide(thigh, shank),
        "upper_arm_per_forearm": _divide(upper, fore),
        "hips_per_leg": _divide(hips, leg),
        "shoulders_per_leg": _divide(shoulders, leg),
    }
    sides = (_divide(max(pair), min(pair)) for pair in pairs if not isnan(sum(pair)))
    return Proportions(ratios, max((ratio for ratio in sides if not isnan(ratio)), default=1.0))


def _divide(one: float, other: float) -> float:
    return one / other if other else nan if one == 0 or isnan(one) else inf


def walks_on_fours(
    points: FloatArray,
    measured: Proportions,
    fore_legs: float = 0.76,
    across: float = -0.4,
    along: float = 0.6,
    mostly: float = 0.8,
) -> bool:
    """Return whether a body is a four-legged animal's: fore legs as long as hind legs, and down beside them.

    In most frames the legs go across the trunk and the arms along the legs; a crawling person has shorter arms.

    Parameters
    ----------
    points : (T, 20, 3) canonical points, any unit, axes and handedness; some frames over the whole motion.
    measured : of these points.
    fore_legs : share of the legs from which on arms may be fore legs; the arms of people are 0.55 to 0.75 of them.
    across, along : cosine between trunk and legs, and between arms and legs, from which on they go so.
    mostly : share of the frames.
    """
    if not measured.ratios["arm_per_leg"] > fore_legs:
        return False
    at = {joint: points[:, index] for joint, index in JOINT_INDEX.items()}
    trunk, leg, arm = (
        find_directions(at["neck"] - at["pelvis"]),
        find_directions(at["left_ankle"] + at["right_ankle"] - at["left_hip"] - at["right_hip"]),
        find_directions(at["left_wrist"] + at["right_wrist"] - at["left_shoulder"] - at["right_shoulder"]),
    )
    fours = ((trunk * leg).sum(axis=1) > across) & ((arm * leg).sum(axis=1) > along)
    return bool(fours.mean() > mostly)


def find_directions(vectors: FloatArray) -> FloatArray:
    """Return vectors (..., 3) of length 1; NaN for those of no length."""
    size = np.linalg.norm(vectors, axis=-1, keepdims=True)
    with np.errstate(invalid="ignore"):
        directions: FloatArray = vectors / np.where(size > 0, size, np.nan)
    return directions


def _measure_bones(points: FloatArray) -> FloatArray:
    """Median lengths of `_BONES` over the frames that show them, NaN where no frame does."""
    bones = points[:, _ENDS] - points[:, _STARTS]
    return find_medians(np.sqrt(np.einsum("tjk,tjk->tj", bones, bones)))


def find_medians(values: FloatArray) -> FloatArray:
    """Compute medians (K,) of values (T, K) without NaN, faster than ``np.nanmedian``; NaN where all are."""
    if not len(values):
        return np.full(values.shape[1], np.nan)
    ordered = np.sort(values, axis=0)  # what is missing comes last
    half, odd = divmod(len(ordered), 2)
    medians: FloatArray = ordered[half] if odd else 0.5 * (ordered[half - 1] + ordered[half])
    if np.isnan(ordered[-1]).any():
        columns = np.arange(values.shape[1])
        seen = len(ordered) - np.isnan(ordered).sum(axis=0)
        medians = 0.5 * (ordered[np.maximum(seen - 1, 0) // 2, columns] + ordered[seen // 2, columns])
    return medians


TRUNK_SHARE = 0.288
"""Hips to shoulders as a share of the stature (Winter)."""

# Lengths as shares of the stature. Limbs, between joint centres: de Leva, "Adjustments to Zatsiorsky-Seluyanov's
# segment inertia parameters", J. Biomechanics 29 (1996), table 4. Widths and trunk: Winter, Biomechanics and motor
# control of human movement (4th ed. 2009), fig. 4.1.
_SHARES = {
    "thigh": 0.2425,
    "shank": 0.249,
    "upper_arm": 0.162,
    "forearm": 0.154,
    "shoulders": 0.259,
    "trunk": TRUNK_SHARE,
}


def stature_of_parts(points: FloatArray) -> float:
    """Estimate the stature from a part of a body, (T, 20, 3) canonical points, in their unit; NaN if impossible."""
    middle = _measure_bones(points)
    limbs = np.repeat([_SHARES[name] for name in ("thigh", "shank", "upper_arm", "forearm")], 2)
    found = np.sort(middle[:8] / limbs)  # what is missing comes last
    if np.isnan(found[0]):
        found = np.sort(middle[9:11] / np.array([_SHARES["shoulders"], _SHARES["trunk"]]))
    seen = int(np.count_nonzero(~np.isnan(found)))
    return float(0.5 * (found[max(seen - 1, 0) // 2] + found[seen // 2]))
