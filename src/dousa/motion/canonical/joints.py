"""The canonical joints that every motion is mapped to before comparison.

``CANONICAL_JOINTS`` fixes the order of the second axis of every canonical array (T, 20, 3).
``CANONICAL_PARENTS`` is their tree; the pelvis is the root.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from dousa.arrays import BoolArray, FloatArray

# Every chain begins with the joint that it hangs on.
_CHAINS = (
    "pelvis spine neck head",
    "neck left_shoulder left_elbow left_wrist left_hand",
    "neck right_shoulder right_elbow right_wrist right_hand",
    "pelvis left_hip left_knee left_ankle left_toe",
    "pelvis right_hip right_knee right_ankle right_toe",
)

_PARENT_NAMES = {child: parent for chain in _CHAINS for parent, child in pairwise(chain.split())}

CANONICAL_JOINTS: tuple[str, ...] = ("pelvis", *_PARENT_NAMES)

JOINT_INDEX: dict[str, int] = {name: index for index, name in enumerate(CANONICAL_JOINTS)}

CANONICAL_PARENTS: tuple[int, ...] = tuple(
    JOINT_INDEX[_PARENT_NAMES[name]] if name in _PARENT_NAMES else -1 for name in CANONICAL_JOINTS
)
"""Index of each joint's parent, -1 for the pelvis, by the definition of the chains."""


def _mirror(name: str) -> str:
    if name.startswith("left_"):
        return "right_" + name[5:]
    return "left_" + name[6:] if name.startswith("right_") else name


MIRRORED_JOINTS: tuple[int, ...] = tuple(JOINT_INDEX[_mirror(name)] for name in CANONICAL_JOINTS)
"""Index of each joint's mirror image: left and right change places, the trunk stays."""


@dataclass(frozen=True, slots=True, eq=False)
class CanonicalPoses:
    """Base of all motions of canonical joints.

    Parameters
    ----------
    positions : (T, 20, 3) m, order of `CANONICAL_JOINTS`.
    frame_rate : Hz.
    """

    positions: FloatArray
    frame_rate: float

    @property
    def n_frames(self) -> int:
        """Number of poses."""
        return len(self.positions)

    @property
    def duration(self) -> float:
        """Seconds from the first pose to the end of the last."""
        return self.n_frames / self.frame_rate


def find_absent(positions: FloatArray) -> tuple[str, ...]:
    """Return the joints of (T, 20, 3) without a position in any frame, in their order."""
    if len(positions) == 0 or not np.isnan(positions[0]).any():
        return ()
    never: BoolArray = np.all(np.isnan(positions), axis=(0, 2))
    return tuple(joint for joint, gone in zip(CANONICAL_JOINTS, never, strict=True) if gone)
