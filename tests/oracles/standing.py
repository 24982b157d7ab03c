"""A person who stands, on canonical joints."""

import numpy as np

from dousa.motion import CANONICAL_JOINTS

STANDING = {
    "pelvis": (0.0, 1.0, 0.0), "spine": (0.0, 1.2, 0.0), "neck": (0.0, 1.5, 0.0), "head": (0.0, 1.7, 0.05),
    "left_shoulder": (0.2, 1.45, 0.0), "left_elbow": (0.25, 1.15, 0.0), "left_wrist": (0.25, 0.9, 0.05),
    "left_hand": (0.25, 0.82, 0.06), "left_hip": (0.1, 0.95, 0.0), "left_knee": (0.1, 0.5, 0.02),
    "left_ankle": (0.1, 0.08, 0.0), "left_toe": (0.12, 0.02, 0.15),
}  # fmt: skip


def standing(**moved):
    """(1, 20, 3): a person of 1.7 m who faces Z, with some joints elsewhere."""
    pose = dict(STANDING)
    for name, (x, y, z) in STANDING.items():
        if name.startswith("left_"):
            pose["right_" + name[5:]] = (-x, y, z)
    pose |= moved
    return np.array([[pose[name] for name in CANONICAL_JOINTS]])
