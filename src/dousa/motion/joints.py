"""The canonical joints: what every motion is mapped to before it is compared.

``CANONICAL_JOINTS`` fixes the order of the second axis of every canonical array (T, 20, 3).
``CANONICAL_PARENTS`` is the tree they are drawn and measured in (pelvis is the root).
"""

from __future__ import annotations

__all__ = ["CANONICAL_JOINTS", "CANONICAL_PARENTS", "JOINT_INDEX", "MIRRORED_JOINTS"]

CANONICAL_JOINTS: tuple[str, ...] = (
    "pelvis",
    "spine",
    "neck",
    "head",
    "left_shoulder",
    "left_elbow",
    "left_wrist",
    "left_hand",
    "right_shoulder",
    "right_elbow",
    "right_wrist",
    "right_hand",
    "left_hip",
    "left_knee",
    "left_ankle",
    "left_toe",
    "right_hip",
    "right_knee",
    "right_ankle",
    "right_toe",
)

JOINT_INDEX: dict[str, int] = {name: index for index, name in enumerate(CANONICAL_JOINTS)}

_PARENT_NAMES: dict[str, str] = {
    "spine": "pelvis",
    "neck": "spine",
    "head": "neck",
    "left_shoulder": "neck",
    "left_elbow": "left_shoulder",
    "left_wrist": "left_elbow",
    "left_hand": "left_wrist",
    "right_shoulder": "neck",
    "right_elbow": "right_shoulder",
    "right_wrist": "right_elbow",
    "right_hand": "right_wrist",
    "left_hip": "pelvis",
    "left_knee": "left_hip",
    "left_ankle": "left_knee",
    "left_toe": "left_ankle",
    "right_hip": "pelvis",
    "right_knee": "right_hip",
    "right_ankle": "right_knee",
    "right_toe": "right_ankle",
}

CANONICAL_PARENTS: tuple[int, ...] = tuple(
    JOINT_INDEX[_PARENT_NAMES[name]] if name in _PARENT_NAMES else -1 for name in CANONICAL_JOINTS
)


def _mirror(name: str) -> str:
    if name.startswith("left_"):
        return "right_" + name[5:]
    return "left_" + name[6:] if name.startswith("right_") else name


MIRRORED_JOINTS: tuple[int, ...] = tuple(JOINT_INDEX[_mirror(name)] for name in CANONICAL_JOINTS)
"""Index of each joint's mirror image: left and right change places, the trunk stays."""
