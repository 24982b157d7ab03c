"""Another body in words: which way it is held throughout, and what of it cannot be judged."""

from __future__ import annotations

import numpy as np

from dousa.arrays import FloatArray
from dousa.evaluation.posture.offset import Offset
from dousa.evaluation.posture.posture import LIMBS, SEGMENTS, Working
from dousa.evaluation.posture.yaw import rotate_yaw
from dousa.evaluation.words import group_segments
from dousa.messages import Message

_LEAST_DEG = 5.0
_ALIKE_DEG = 6.0  # left and right that differ by less are said as one
_SIDES = {"left_arm": "right_arm", "left_leg": "right_leg"}


def describe_offset(offset: Offset, reference: Working) -> tuple[Message, ...]:
    """What a person should know of another body: "both arms are 8 deg further from the body throughout".

    Parameters
    ----------
    offset : of the performer.
    reference : the first take.
    """
    body = rotate_yaw(reference.segments, -np.nan_to_num(reference.heading)).mean(axis=0)
    moved = np.degrees(np.cross(offset.taken, body))
    found = {}
    for limb, segments in LIMBS.items():
        way, degrees = _find_way(limb, moved[list(segments)].mean(axis=0))
        if degrees > _LEAST_DEG:
            found[limb] = (way, degrees)
    said = []
    for limb, (way, degrees) in found.items():
        other = _SIDES.get(limb, "")
        pair = found.get(other, ("", 0.0))
        if limb in _SIDES.values():
            first = next(one for one, second in _SIDES.items() if second == limb)
            if _belong(found.get(first, ("", 0.0)), (way, degrees)):
                continue
        together = _belong((way, degrees), pair)
        segments = (*LIMBS[limb], *LIMBS[other]) if together else LIMBS[limb]
        who = group_segments(SEGMENTS[index] for index in segments)
        size = 0.5 * (degrees + pair[1]) if together else degrees
        said.append(Message("assessment.offset", who=who, degrees=size, way=_WAYS[way]))
    if offset.missing.any():
        who = group_segments(SEGMENTS[index] for index in np.flatnonzero(offset.missing))
        said.append(Message("assessment.not_judged", who=who))
    return tuple(said)


_WAYS = {
    "out": Message("offset_ways.out"),
    "in": Message("offset_ways.in"),
    "up": Message("offset_ways.up"),
    "down": Message("offset_ways.down"),
    "forward": Message("offset_ways.forward"),
    "back": Message("offset_ways.back"),
    "left": Message("offset_ways.left"),
    "right": Message("offset_ways.right"),
}


def _find_way(limb: str, moved: FloatArray) -> tuple[str, float]:
    """The direction in which a limb is mostly moved, and how far, from (3,) deg to the left, up and front."""
    axis = int(np.abs(moved).argmax())
    forward = bool(moved[axis] > 0.0)
    if axis == 1:
        way = "up" if forward else "down"
    elif axis == 2:
        way = "forward" if forward else "back"
    elif limb == "trunk":
        way = "left" if forward else "right"
    else:
        way = "out" if forward == limb.startswith("left") else "in"
    return way, float(abs(moved[axis]))


def _belong(one: tuple[str, float], other: tuple[str, float]) -> bool:
    return one[0] == other[0] != "" and abs(one[1] - other[1]) < _ALIKE_DEG
