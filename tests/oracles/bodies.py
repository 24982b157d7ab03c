"""A walking stick figure and a robot's arm: positions made by hand, no code of the package but its types."""

import numpy as np

from dousa.estimation.body.body import BodyModel
from dousa.motion import Trajectories

# name, parent, rest position in m: a T-pose that faces +Z, Y up, left at +X.
_BODY = (
    ("Hips", None, (0.0, 0.95, 0.0)),
    ("Spine", "Hips", (0.0, 1.07, -0.01)),
    ("Spine1", "Spine", (0.0, 1.2, -0.01)),
    ("Chest", "Spine1", (0.0, 1.33, -0.01)),
    ("Neck", "Chest", (0.0, 1.43, 0.0)),
    ("Head", "Neck", (0.0, 1.53, 0.02)),
    ("Head_end", "Head", (0.0, 1.7, 0.02)),
    ("LeftShoulder", "Chest", (0.05, 1.4, 0.0)),
    ("LeftArm", "LeftShoulder", (0.18, 1.41, 0.0)),
    ("LeftForeArm", "LeftArm", (0.47, 1.41, 0.0)),
    ("LeftHand", "LeftForeArm", (0.72, 1.41, 0.0)),
    ("LeftHandMiddle1", "LeftHand", (0.82, 1.41, 0.0)),
    ("LeftHandMiddle1_end", "LeftHandMiddle1", (0.88, 1.41, 0.0)),
    ("LeftUpLeg", "Hips", (0.09, 0.9, 0.0)),
    ("LeftLeg", "LeftUpLeg", (0.09, 0.49, 0.0)),
    ("LeftFoot", "LeftLeg", (0.09, 0.08, -0.01)),
    ("LeftToeBase", "LeftFoot", (0.09, 0.02, 0.12)),
    ("LeftToeBase_end", "LeftToeBase", (0.09, 0.02, 0.18)),
)


def _mirrored(name: str | None) -> str | None:
    return name.replace("Left", "Right") if name else name


def _all_rows() -> list[tuple[str, str | None, tuple[float, float, float]]]:
    rows = list(_BODY)
    for name, parent, (x, y, z) in _BODY:
        if name.startswith("Left"):
            rows.append((str(_mirrored(name)), _mirrored(parent), (-x, y, z)))
    return rows


def _turn_x(points: np.ndarray, centre: np.ndarray, angle: float) -> np.ndarray:
    """Points turned about the X axis through a centre; a positive angle brings what hangs down to the front."""
    c, s = np.cos(angle), np.sin(angle)
    return centre + (points - centre) @ np.array([[1, 0, 0], [0, c, s], [0, -s, c]]).T


def walking_body(n_frames: int = 20, frame_rate: float = 30.0) -> Trajectories:
    """Trajectories of a T-posed figure that walks along +Z, arms lowered, knees bending."""
    rows = _all_rows()
    names = tuple(row[0] for row in rows)
    parents = np.array([-1 if row[1] is None else names.index(row[1]) for row in rows])
    rest = np.array([row[2] for row in rows])
    below = {n: _descendants(names.index(n), parents) for n in names}
    positions = np.empty((n_frames, len(names), 3))
    for t in range(n_frames):
        pose = rest.copy()
        phase = 2 * np.pi * t / 20
        for side, sign in (("Left", 1.0), ("Right", -1.0)):
            arm = below[f"{side}Arm"]
            shoulder = pose[names.index(f"{side}Arm")]
            local = pose[arm] - shoulder
            pose[arm] = shoulder + np.stack([0.2 * local[:, 0], -0.98 * np.abs(local[:, 0]), local[:, 2]], axis=1)
            swing = 0.5 * sign * np.sin(phase)
            for joint, angle in ((f"{side}Arm", -swing), (f"{side}ForeArm", 0.4), (f"{side}UpLeg", swing + 0.2)):
                pose[below[joint]] = _turn_x(pose[below[joint]], pose[names.index(joint)], angle)
            knee = 0.5 + 0.3 * sign * np.cos(phase)
            pose[below[f"{side}Leg"]] = _turn_x(pose[below[f"{side}Leg"]], pose[names.index(f"{side}Leg")], -knee)
        positions[t] = pose + np.array([0.0, 0.0, 0.04 * t])
    return Trajectories(names, positions, frame_rate, parents, rest)


def _descendants(joint: int, parents: np.ndarray) -> list[int]:
    found = [joint]
    for child, parent in enumerate(parents):
        if parent in found:
            found.append(child)
    return found


def robot_arm() -> BodyModel:
    """A robot's arm: a base that is bolted down, a turning shoulder, two hinges and a hand."""
    axes, limits = np.zeros((4, 3, 3)), np.zeros((4, 3, 2))
    axes[1, 0], axes[1, 1], axes[1, 2] = (1, 0, 0), (0, 0, 1), (0, 1, 0)
    axes[2, 0] = axes[3, 0] = (1, 0, 0)
    limits[1, :] = (-1.5, 1.5)
    limits[2:, 0] = (0.0, 2.5)
    return BodyModel(
        names=("base", "upper", "lower", "claw"),
        joints=("base", "shoulder", "elbow", "wrist"),
        parents=[-1, 0, 1, 2],
        offsets=[[0, 0, 0], [0, 0.5, 0], [0, 0.6, 0], [0, 0.4, 0]],
        rest=np.tile([1.0, 0, 0, 0], (4, 1)),
        n_axes=[0, 3, 1, 1],
        axes=axes,
        limits=limits,
        spheres=np.tile([0, 0, 0, 0.1], (4, 1)),
        sphere_starts=[0, 1, 2, 3, 4],
        tips=("left_foot_of_base", "right_foot_of_base", "claw"),
        tip_parts=[0, 0, 3],
        tip_offsets=[[0.3, 0, 0], [-0.3, 0, 0], [0, 0.2, 0]],
        stature=1.7,
    )
