"""Joint angles as a physiotherapist reads them off a goniometer, from the canonical joints, and their ranges.

0 degrees is the neutral position: standing upright, arms hanging, elbows and knees straight. Shoulders and hips are
measured against the trunk. An arm (or thigh) is `elevation` degrees away from hanging, in a plane that is turned from
straight sideways; flexion is the forward share of the elevation and abduction the sideward share:

    elevation = angle between the upper arm and the trunk's downward direction
    flexion = elevation sin(plane), abduction = elevation cos(plane)

so that neither jumps when the arm points straight at the viewer, as angles of projections do. Straight overhead the
plane says nothing; there the one on the way is kept.

Source of neutral positions and directions: G. Wu et al., "ISB recommendation on definitions of joint coordinate systems
of various joints for the reporting of human joint motion, part II", J. Biomechanics 38, 981-992, 2005 (plane of
elevation, elevation); the shares are ours. Rotation about the long axis of a limb cannot be seen in joint centres.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from dousa.arrays import FloatArray
from dousa.evaluation.posture.posture import PostureSequence
from dousa.messages import Message
from dousa.motion import CanonicalMotion
from dousa.motion.canonical.joints import JOINT_INDEX as J
from dousa.motion.resampling import fill_gaps, smooth_gaussian

PAIRED_ANGLES: tuple[str, ...] = (
    "elbow_flexion",
    "shoulder_elevation",
    "shoulder_flexion",
    "shoulder_abduction",
    "hip_flexion",
    "hip_abduction",
    "knee_flexion",
)
"""Angles that each side has; their full names begin with ``left_`` or ``right_``."""

ANGLES: tuple[str, ...] = (
    *(f"{side}_{name}" for name in PAIRED_ANGLES for side in ("left", "right")),
    "trunk_lean",
    "trunk_forward_lean",
    "trunk_side_lean",
)
"""All joint angles, in the order of reports. ``trunk_lean`` is away from the vertical in any direction; to
the side, left is positive."""

ANGLE_NAMES: Mapping[str, Message] = {name: Message(f"joint_angles.{name}") for name in ANGLES}
"""Angle -> its name."""

MOVING_DEG = 20.0
"""A joint whose angle ranges over less is not what the exercise is about (docs/exercises.md)."""


@dataclass(frozen=True, slots=True)
class RangeOfMotion:
    """How far one joint angle goes in one repetition.

    Parameters
    ----------
    angle : of `ANGLES`.
    least_deg, most_deg : degrees.
    reference_deg : range of the reference, median of its repetitions; nan without one.
    """

    angle: str
    least_deg: float
    most_deg: float
    reference_deg: float = float("nan")

    @property
    def range_deg(self) -> float:
        """Degrees from the least to the most."""
        return self.most_deg - self.least_deg

    @property
    def percent(self) -> float:
        """Range as a percentage of the reference's; nan without one, or where the joint hardly moves in it."""
        return 100.0 * self.range_deg / self.reference_deg if self.reference_deg >= MOVING_DEG else float("nan")


def compute_joint_angles(motion: CanonicalMotion | PostureSequence) -> dict[str, FloatArray]:
    """Compute all joint angles over time.

    Parameters
    ----------
    motion : any frame rate, place and heading; gaps are filled from their neighbours in time.

    Returns
    -------
    Angle of `ANGLES` -> (T,) degrees; nan where joints coincide or were never seen.
    """
    positions = np.asarray(motion.positions, np.float64)
    if np.isnan(positions).any():
        positions = fill_gaps(positions)
    up, left, forward = compute_trunk_axes(positions)
    angles: dict[str, FloatArray] = {}
    for side, out in (("left", 1.0), ("right", -1.0)):
        shoulder, elbow, wrist = (positions[:, J[f"{side}_{name}"]] for name in ("shoulder", "elbow", "wrist"))
        hip, knee, ankle = (positions[:, J[f"{side}_{name}"]] for name in ("hip", "knee", "ankle"))
        angles[f"{side}_elbow_flexion"] = _angle_between(elbow - shoulder, wrist - elbow)
        angles[f"{side}_knee_flexion"] = _angle_between(knee - hip, ankle - knee)
        for name, limb in (("shoulder", elbow - shoulder), ("hip", knee - hip)):
            parts = np.stack([(limb * axis).sum(axis=1) for axis in (out * left, forward, -up)], axis=1)
            elevation, flexion, abduction = _split_elevation(parts)
            angles[f"{side}_{name}_flexion"], angles[f"{side}_{name}_abduction"] = flexion, abduction
            if name == "shoulder":
                angles[f"{side}_shoulder_elevation"] = elevation
    angles |= _measure_trunk(up, left)
    return {name: angles[name] for name in ANGLES}


def compute_trunk_axes(positions: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Compute up, left and forward of the trunk, (T, 3) unit vectors each, of positions (T, 20, 3)."""
    hips = 0.5 * (positions[:, J["left_hip"]] + positions[:, J["right_hip"]])
    up = _unit(positions[:, J["neck"]] - hips)
    across = positions[:, J["left_shoulder"]] - positions[:, J["right_shoulder"]]
    across = across + positions[:, J["left_hip"]] - positions[:, J["right_hip"]]
    left = _unit(across - (across * up).sum(axis=1, keepdims=True) * up)
    return up, left, np.cross(left, up)


def measure_ranges(
    angles: Mapping[str, FloatArray],
    start: int,
    end: int,
    frame_rate: float,
    reference: Mapping[str, float] = {},
    *,
    smooth_s: float = 0.05,
) -> tuple[RangeOfMotion, ...]:
    """Measure the ranges of all angles in the frames from ``start`` up to ``end``, single outliers smoothed away.

    Parameters
    ----------
    angles : of `compute_joint_angles`.
    start, end : frames, half-open, at least one.
    frame_rate : Hz.
    reference : angle -> range in degrees.
    """
    ranges = []
    for name in ANGLES:
        values = angles[name][start:end]
        values = values[np.isfinite(values)]
        if len(values):
            values = smooth_gaussian(_drop_spikes(values), max(smooth_s * frame_rate, 0.3))
        least, most = (float(values.min()), float(values.max())) if len(values) else (float("nan"),) * 2
        ranges.append(RangeOfMotion(name, least, most, reference.get(name, float("nan"))))
    return tuple(ranges)


def compute_symmetry_index(left: float, right: float) -> float:
    """Compute how much further the left side goes than the right one, in percent of their mean.

        SI = 100 (left - right) / (0.5 (left + right))

    Parameters
    ----------
    left, right : ranges of motion, 0 or above, any unit.

    Returns
    -------
    -200 to 200, 0 if both are equal; nan if both are 0 or one is unknown.

    Source: R. O. Robinson, W. Herzog, B. M. Nigg, "Use of force platform variables to quantify the effects of
    chiropractic manipulation on gait symmetry", J. Manipulative and Physiological Therapeutics 10(4), 172-176, 1987;
    there for ground reaction forces.
    """
    total = left + right
    return 200.0 * (left - right) / total if total > 0 else float("nan")


def _unit(vectors: FloatArray) -> FloatArray:
    lengths = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.asarray(vectors / np.where(lengths > 1e-9, lengths, np.nan))


def _angle_between(a: FloatArray, b: FloatArray) -> FloatArray:
    """(T,) degrees, exact for small angles too."""
    a, b = _unit(a), _unit(b)
    return np.asarray(np.degrees(2.0 * np.arctan2(np.linalg.norm(a - b, axis=1), np.linalg.norm(a + b, axis=1))))


def _split_elevation(parts: FloatArray, *, overhead: float = 0.4) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Elevation, and its forward and outward shares, degrees, of limbs (T, 3): out, forward, down."""
    # overhead: share of the arm that points away from the trunk's axis; less says nothing about the plane
    out, ahead, down = _unit(parts).T
    aside = np.hypot(out, ahead)
    elevation = np.degrees(np.arctan2(aside, down))
    plane = np.arctan2(ahead, out)
    unclear = (aside < overhead) & (down < 0)
    clear = np.flatnonzero(~unclear & np.isfinite(plane))
    if unclear.any() and len(clear):
        plane = np.interp(np.arange(len(plane)), clear, np.unwrap(plane[clear]))
    return elevation, elevation * np.sin(plane), elevation * np.cos(plane)


def _measure_trunk(up: FloatArray, left: FloatArray) -> dict[str, FloatArray]:
    """Lean away from the vertical, forward and to the left, in the frame that the hips and shoulders face."""
    level = _unit(left * [1.0, 0.0, 1.0])
    ahead = np.cross(level, [0.0, 1.0, 0.0])
    aside = np.hypot(up[:, 0], up[:, 2])
    total = np.degrees(np.arctan2(aside, up[:, 1]))
    # As shares of the lean: an angle of the projection is anything once the trunk lies.
    share = total / np.maximum(aside, 1e-9)
    forward, side = ((up * axis).sum(axis=1) * share for axis in (ahead, level))
    return {"trunk_lean": total, "trunk_forward_lean": forward, "trunk_side_lean": side}


def _drop_spikes(values: FloatArray) -> FloatArray:
    """The median of three frames: one wrong frame of a sensor is no range of motion."""
    if len(values) < 3:
        return values
    middle = np.median(np.stack([values[:-2], values[1:-1], values[2:]]), axis=0)
    return np.concatenate([middle[:1], middle, middle[-1:]])
