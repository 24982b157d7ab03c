"""Trees of the skeletons of Motive and Qualisys by their usual names, for tables that name no parents."""

from __future__ import annotations

import os.path
from itertools import pairwise

from dousa.motion.canonical.naming import group_owners

_SIDES = ("L", "R")
_FINGERS = ("Thumb", "Index", "Middle", "Ring", "Pinky")

_MOTIVE_CHAINS = [
    "Hip Ab Chest Neck Head",
    "Hip Ab Spine2 Spine3 Spine4 Chest",
    *(f"Chest {s}Shoulder {s}UArm {s}FArm {s}Hand" for s in _SIDES),
    *(f"Hip {s}Thigh {s}Shin {s}Foot {s}Toe" for s in _SIDES),
    *(f"{s}Hand {s}{finger}1 {s}{finger}2 {s}{finger}3" for s in _SIDES for finger in _FINGERS),
]
_FBX_CHAINS = [
    "Hips Spine Spine1 Spine2 Spine3 Spine4 Neck Neck1 Head",
    *(f"TRUNK {s}Shoulder {s}Arm {s}ForeArm {s}ForeArmRoll {s}Hand" for s in ("Left", "Right")),
    *(f"Hips {s}UpLeg {s}Leg {s}Foot {s}ToeBase" for s in ("Left", "Right")),
    *(f"{s}Hand {s}Hand{f}1 {s}Hand{f}2 {s}Hand{f}3 {s}Hand{f}4" for s in ("Left", "Right") for f in _FINGERS),
    *(f"{s}Hand {s}InHand{f} {s}Hand{f}1" for s in ("Left", "Right") for f in _FINGERS),
]


def guess_parents(names: list[str]) -> dict[str, str]:
    """Return the parent of each joint of Motive's or Qualisys' skeletons by name, per person; {} for other names.

    Joints that a skeleton lacks are skipped, and so is what all names of a person begin with.
    """
    parents: dict[str, str] = {}
    for joints in (group_owners(tuple(names)) or {"": tuple(range(len(names)))}).values():
        own = [names[joint] for joint in joints]
        shared = os.path.commonprefix(own) if len(own) > 1 else ""  # noqa: RUF071
        cut = 1 + max(shared.rfind(sign) for sign in ":_ ")
        before = {name[cut:]: name for name in own}
        found = _guess_tree(list(before))
        if not found:
            return {}
        parents |= {before[child]: before[parent] for child, parent in found.items()}
    return parents


def _guess_tree(names: list[str]) -> dict[str, str]:
    """The parents of the joints of one skeleton."""
    present = set(names)
    chains = _MOTIVE_CHAINS if "Hip" in present else _FBX_CHAINS if "Hips" in present else []
    trunk = [name for name in ("Hips", "Spine", "Spine1", "Spine2", "Spine3", "Spine4") if name in present]
    parents: dict[str, str] = {}
    for chain in chains:
        joints = [trunk[-1] if name == "TRUNK" and trunk else name for name in chain.split()]
        for parent, child in pairwise([name for name in joints if name in present]):
            parents[child] = parent
    roots = [name for name in names if name not in parents]
    return parents if len(roots) == 1 else {}
