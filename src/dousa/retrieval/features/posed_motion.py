"""The motions that retrieval accepts, and the checks of them."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from contextlib import suppress
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from dousa.arrays import FloatArray
from dousa.errors import InvalidMotionError, OptionError
from dousa.messages import Message
from dousa.motion.annotation import Stretch
from dousa.motion.canonical.anthropometry import TRUNK_SHARE, stature_of_parts
from dousa.motion.canonical.geometry import STATURE_PER_HEIGHT
from dousa.motion.canonical.joints import CANONICAL_JOINTS, JOINT_INDEX, CanonicalPoses, find_absent
from dousa.motion.canonical.tree_shape import spread_frames

SLOWEST_RATE = 1.0
"""Hz (docs/studio.md): motions are resampled to 30 Hz, so a rate near zero would fill the memory."""


class PosedMotion(Protocol):
    """A motion on canonical joints, such as a ``CanonicalMotion`` or a ``LabelledClip``."""

    @property
    def positions(self) -> FloatArray:
        """(n, 20, 3) m, Y up, finite."""

    @property
    def frame_rate(self) -> float:
        """Hz."""

    @property
    def height(self) -> float:
        """m, of the performer."""


@dataclass(frozen=True, slots=True, eq=False)
class PlainMotion:
    """Positions (n, 20, 3) m with a frame rate (Hz) and a body height (m): a part of a recording, or one computed."""

    positions: FloatArray
    frame_rate: float
    height: float


def check_motion(motion: PosedMotion) -> FloatArray:
    """Return the positions (n, 20, 3) of a motion.

    Raises InvalidMotionError: another shape, no frame, positions that are not finite, no body height.
    """
    points = check_shape(motion.positions, motion.height)
    if not np.isfinite(points).all():
        raise InvalidMotionError("posed_motion.not_finite")
    return points


def check_shape(positions: ArrayLike, height: float) -> FloatArray:
    """Return the positions (n, 20, 3); InvalidMotionError for another shape, no frame or no body height."""
    points = np.asarray(positions, np.float64)
    if points.ndim != 3 or points.shape[1:] != (len(CANONICAL_JOINTS), 3) or not len(points):
        raise InvalidMotionError("posed_motion.shape", shape=points.shape)
    if not (np.isfinite(height) and height > 0):
        raise InvalidMotionError("posed_motion.height", height=height)
    return points


def check_frame_rate(frame_rate: float) -> None:
    """Raise InvalidMotionError for a frame rate below ``SLOWEST_RATE``."""
    if not frame_rate >= SLOWEST_RATE:
        raise InvalidMotionError("posed_motion.rate", slowest=SLOWEST_RATE, rate=frame_rate)


@dataclass(frozen=True, slots=True, eq=False)
class LabelledClip:
    """A motion on canonical joints with its category and performer.

    Parameters
    ----------
    name : path or other name, for messages.
    category : the label.
    performer : None where unknown.
    positions : (T, 20, 3) m.
    frame_rate : Hz.
    height : m, of the performer.
    """

    name: str
    category: str
    performer: str | None
    positions: FloatArray
    frame_rate: float
    height: float


@dataclass(frozen=True, slots=True, eq=False)
class AnnotatedTake:
    """An uncut recording on canonical joints with its annotation and performer.

    Parameters
    ----------
    name : path or other name, for messages.
    performer : None where unknown.
    positions : (T, 20, 3) m.
    frame_rate : Hz.
    height : m, of the performer.
    stretches : from beginning to end without gaps. One without a category is an example of "nothing" or "between", or
        is unclear if it is not ``counted``.
    """

    name: str
    performer: str | None
    positions: FloatArray
    frame_rate: float
    height: float
    stretches: tuple[Stretch, ...]


FRAME_JOINTS = ("pelvis", "left_hip", "right_hip", "left_shoulder", "right_shoulder", "neck")
"""Joints that give the body's place and heading."""

_LIMB_JOINTS = tuple(f"{side}_{joint}" for joint in ("elbow", "hand", "knee", "ankle") for side in ("left", "right"))
_WITH = (("hand", "wrist"), ("ankle", "toe"))
_PELVIS = JOINT_INDEX["pelvis"]


@dataclass(frozen=True, slots=True, eq=False)
class HiddenMotion(CanonicalPoses):
    """A motion with hidden joints, NaN in ``positions``, and the performer's ``height``, m, by the remaining bones."""

    height: float


def order_joints(joints: Iterable[str]) -> tuple[str, ...]:
    """Return canonical joints in their order, each once; OptionError for an unknown one."""
    asked = set(joints)
    unknown = sorted(asked.difference(CANONICAL_JOINTS))
    if unknown:
        raise OptionError("features.no_such_joint", joint=unknown[0], known=CANONICAL_JOINTS)
    return tuple(joint for joint in CANONICAL_JOINTS if joint in asked)


def is_comparable(hidden: Iterable[str]) -> bool:
    """Return whether a body without some joints can be compared: it needs a heading, and a limb that moves."""
    gone = set(hidden)
    faces = any(not gone & {f"left_{joint}", f"right_{joint}"} for joint in ("hip", "shoulder"))
    return faces and bool(set(_LIMB_JOINTS) - gone)


_PLACED_JOINTS = ("head", "neck", "left_shoulder", "right_shoulder", *_LIMB_JOINTS)


def count_placed(hidden: Iterable[str]) -> int:
    """Count the joints of a body by which poses are compared."""
    return len(set(_PLACED_JOINTS).difference(hidden))


_SIDED = (
    # Word for both sides, for one side, and the joints without which the part is missing; larger parts first.
    ("arms", "arm", ("elbow", "hand")),
    ("hands", "hand", ("hand",)),
    ("elbows", "elbow", ("elbow",)),
    ("shoulders", "shoulder", ("shoulder",)),
    ("legs", "leg", ("knee", "ankle")),
    ("feet", "foot", ("ankle",)),
    ("knees", "knee", ("knee",)),
    ("hips", "hip", ("hip",)),
)


def name_parts(joints: Iterable[str]) -> tuple[Message, ...]:
    """Return everyday names of missing joints: the arms, the left leg, the head."""
    gone = set(joints)
    named: list[str] = []
    for single in ("head", "neck"):
        if single in gone and not (single == "neck" and "head" in gone):
            named.append(single)
    covered: set[str] = set()
    for both, one, ends in _SIDED:
        sides = [side for side in ("left", "right") if {f"{side}_{end}" for end in ends} <= gone - covered]
        covered |= {f"{side}_{end}" for side in sides for end in ends}
        if len(sides) == 2:
            named.append(both)
        elif sides:
            named.append(f"{sides[0]}_{one}")
    if "pelvis" in gone and "hips" not in named:
        named.append("pelvis")
    named += ["spine"] if not named and "spine" in gone else []
    named += ["toes"] if not named and gone else []
    # Shoulders and neck are not mentioned beside other missing parts.
    without = {"shoulders", "left_shoulder", "right_shoulder", "neck"} if len(named) > 1 else set()
    return tuple(Message(f"body_part.{name}") for name in named if name not in without)


def hide_joints(motion: PosedMotion, hidden: Collection[str]) -> PosedMotion:
    """Hide some joints, as if they had not been recorded; return the motion itself if there are none.

    Parameters
    ----------
    motion : canonical positions in m, of a whole body or a part.
    hidden : canonical joints.

    Returns a motion whose hidden joints are NaN, and whose height follows from the remaining bones.
    """
    if not hidden:
        return motion
    joints = set(order_joints(hidden))
    # Without a hand there is no wrist either: each is derived from the other where it is not recorded.
    joints |= {
        f"{side}_{beyond}" for side in ("left", "right") for joint, beyond in _WITH if f"{side}_{joint}" in joints
    }
    positions = np.array(motion.positions, np.float64)
    positions[:, [JOINT_INDEX[joint] for joint in joints]] = np.nan
    height = stature_of_parts(spread_frames(positions)) / STATURE_PER_HEIGHT
    return HiddenMotion(positions, motion.frame_rate, height if height > 0 else motion.height)


def complete_positions(
    positions: ArrayLike, height: float, hidden: Iterable[str], needed: Collection[str]
) -> FloatArray:
    """Fill gaps in positions: hidden joints, which are not tested, lie on the pelvis.

    Parameters
    ----------
    positions : (n, 20, 3) m, Y up.
    height : m, of the performer.
    hidden : joints whose positions are ignored.
    needed : joints that are used; others that are NaN in all frames are hidden too.

    Returns (n, 20, 3) finite. A hidden pelvis lies between the hips, else a standing trunk's length, for this height,
    below the neck or shoulders; else at a hip or shoulder. Raises InvalidMotionError: needed joints have no place.
    """
    points = np.asarray(positions, np.float64)
    gone = set(hidden)
    if not gone and np.isfinite(points).all():
        return points
    points = points.copy()
    gone |= set(find_absent(points)).difference(needed)
    if "pelvis" in gone:
        points[:, _PELVIS] = _make_pelvis(points, height, gone)
    points[:, [JOINT_INDEX[joint] for joint in gone]] = points[:, _PELVIS, None]
    if not np.isfinite(points).all():
        raise InvalidMotionError("posed_motion.not_finite")
    return points


def place_pelvis(positions: FloatArray, height: float) -> FloatArray:
    """Put a missing pelvis where ``complete_positions`` does, in positions (n, 20, 3).

    Other absent joints stay NaN; so does the pelvis where no joint gives its place.
    """
    gone = set(find_absent(positions))
    if "pelvis" not in gone:
        return positions
    placed = np.array(positions, np.float64)
    with suppress(InvalidMotionError):
        placed[:, _PELVIS] = _make_pelvis(placed, height, gone)
    return placed


def _make_pelvis(points: FloatArray, height: float, gone: set[str]) -> FloatArray:
    def middle(*joints: str) -> FloatArray | None:
        there = [JOINT_INDEX[joint] for joint in joints if joint not in gone]
        mean: FloatArray | None = points[:, there].mean(axis=1) if len(there) == len(joints) else None
        return mean

    hips = middle("left_hip", "right_hip")
    if hips is not None:
        return hips
    for joints in (("neck",), ("left_shoulder", "right_shoulder")):
        top = middle(*joints)
        if top is not None:
            below: FloatArray = top - np.array([0.0, TRUNK_SHARE * STATURE_PER_HEIGHT * height, 0.0])
            return below
    for joint in ("left_hip", "right_hip", "left_shoulder", "right_shoulder"):
        single = middle(joint)
        if single is not None:
            return single
    raise InvalidMotionError("posed_motion.not_finite")
