"""The body of synthetic performers: skeleton, rotations from degrees of freedom, and the floor."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from dousa.arrays import FloatArray
from dousa.motion import rotations as rot
from dousa.motion.kinematics import forward_kinematics
from dousa.motion.types import Motion, Skeleton

# Joint, parent, offset in statures: x to the left, y up, z forward. Segment lengths after Drillis and Contini
# (1966) as tabulated in Winter, "Biomechanics and Motor Control of Human Movement"; the performer's `legs`
# scales the legs, `arms` the arms, `width` what lies sideways.
_ARM = (
    ("shoulder", "spine", (0.108, 0.170, -0.004)),
    ("elbow", "shoulder", (0.0, -0.172, 0.0)),
    ("wrist", "elbow", (0.0, -0.148, 0.0)),
    ("hand", "wrist", (0.0, -0.056, 0.0)),
    ("hand_end", "hand", (0.0, -0.050, 0.0)),
)
# As the arm, after Winter.
_LEG = (
    ("hip", "pelvis", (0.052, -0.012, 0.0)),
    ("knee", "hip", (0.0, -0.240, 0.0)),
    ("ankle", "knee", (0.0, -0.242, 0.0)),
    ("toe", "ankle", (0.0, -0.028, 0.094)),
    ("toe_end", "toe", (0.0, -0.004, 0.040)),
)
# As the arm, after Winter.
_TRUNK = (
    ("pelvis", "", (0.0, 0.533, 0.0)),
    ("spine", "pelvis", (0.0, 0.112, 0.0)),
    ("neck", "spine", (0.0, 0.188, -0.006)),
    ("head", "neck", (0.0, 0.062, 0.014)),
    ("head_end", "head", (0.0, 0.105, 0.0)),
)


def build_skeleton(stature: float, legs: float, arms: float, width: float) -> Skeleton:
    """Build a person of 20 joints and 5 end sites, facing +Z with hanging arms, feet on the floor y = 0.

    Parameters
    ----------
    stature : m, from the floor to the top of the head.
    legs, arms, width : lengths of thigh and shin, of the arm, and across hips and shoulders, as shares of the
        average ones; the trunk makes up for the legs.
    """
    leg_gain = (legs - 1.0) * 0.482
    raised = {
        "pelvis": leg_gain,
        "spine": -0.4 * leg_gain,
        "neck": -0.6 * leg_gain,
        "shoulder": -0.6 * leg_gain,
    }
    scaled = {"knee": legs, "ankle": legs, "elbow": arms, "wrist": arms, "hand": arms}
    rows = [(name, parent, (x, y + raised.get(name, 0.0), z)) for name, parent, (x, y, z) in _TRUNK]
    # Depth first, as BVH files have it.
    for limb, side, sign in ((_ARM, "left", 1), (_ARM, "right", -1), (_LEG, "left", 1), (_LEG, "right", -1)):
        for name, parent, (x, y, z) in limb:
            height = y * scaled.get(name, 1.0) + raised.get(name, 0.0)
            middle = parent if parent in ("spine", "pelvis") else f"{side}_{parent}"
            rows.append((f"{side}_{name}", middle, (sign * width * x + 0.0, height, z)))  # no -0.0
    names = tuple(name for name, _, _ in rows)
    return Skeleton(
        names=names,
        parents=np.array([names.index(parent) if parent else -1 for _, parent, _ in rows]),
        offsets=stature * np.array([offset for _, _, offset in rows]),
        end_sites=np.array([name.endswith("_end") for name in names]),
    )


def _about(axis: int, degrees: FloatArray) -> FloatArray:
    """Quaternions (T, 4) about x (0), y (1) or z (2)."""
    return rot.from_euler(np.radians(degrees)[:, None], "XYZ"[axis])


def _chain(*quaternions: FloatArray) -> FloatArray:
    result = quaternions[0]
    for q in quaternions[1:]:
        result = rot.multiply(result, q)
    return result


def _trunk(pose: Mapping[str, FloatArray], pelvis_share: float = 0.45) -> dict[str, FloatArray]:
    """Pelvis, spine, neck and head; the spine bends the share of the trunk that the pelvis does not."""
    share = {"pelvis": pelvis_share, "spine": 1.0 - pelvis_share}
    joints = {
        name: _chain(_about(1, part * pose["twist"]), _about(2, -part * pose["lean"]), _about(0, part * pose["bend"]))
        for name, part in share.items()
    }
    joints["neck"] = _about(0, 0.4 * pose["nod"])
    joints["head"] = _chain(_about(1, pose["look"]), _about(0, 0.6 * pose["nod"]))
    return joints


def _arm(pose: Mapping[str, FloatArray], side: str, sign: float) -> dict[str, FloatArray]:
    """Upper arm: swung by arm_raise about a level axis that arm_side turns, then about itself."""
    plane = np.radians(sign * pose[f"{side}_arm_side"])
    axis = np.stack((-np.cos(plane), 0 * plane, np.sin(plane)), axis=-1)
    swing = rot.from_axis_angle(axis * np.radians(pose[f"{side}_arm_raise"])[:, None])
    # Held off the trunk only as long as the arm hangs: a raised arm has room.
    hanging = np.clip(np.cos(np.radians(pose[f"{side}_arm_raise"])), 0.0, 1.0)
    return {
        f"{side}_shoulder": _chain(
            _about(2, sign * hanging * pose[f"{side}_arm_out"]),
            swing,
            _about(1, sign * pose[f"{side}_arm_turn"]),
        ),
        f"{side}_elbow": _about(0, -pose[f"{side}_elbow"]),
    }


def _leg(pose: Mapping[str, FloatArray], side: str, sign: float, pelvis: FloatArray) -> dict[str, FloatArray]:
    """Thigh and sole are posed against the vertical, not the pelvis: a flat foot stays flat in a squat."""
    outward = _about(1, sign * pose[f"{side}_toe_out"])
    thigh = _chain(_about(2, sign * pose[f"{side}_spread"]), outward, _about(0, -pose[f"{side}_thigh"]))
    knee = _about(0, pose[f"{side}_knee"])
    foot = _chain(outward, _about(0, -pose[f"{side}_foot"]))
    return {
        f"{side}_hip": _chain(rot.conjugate(pelvis), thigh),
        f"{side}_knee": knee,
        f"{side}_ankle": _chain(rot.conjugate(_chain(thigh, knee)), foot),
    }


def compose_motion(skeleton: Skeleton, pose: Mapping[str, FloatArray], frame_rate: float, stature: float) -> Motion:
    """Compose a motion from degrees of freedom over time.

    The lowest point of the two soles is put on the floor, and the body moves so that the points which carry it
    stand still. In the air it keeps its speed and follows the line from take-off to landing, raised by `flight`.

    Parameters
    ----------
    skeleton : from `build_skeleton`.
    pose : every name of FREEDOMS -> (T,) degrees (flight: cm).
    frame_rate : Hz.
    stature : m.
    """
    joints = _trunk(pose)
    for side, sign in (("left", 1.0), ("right", -1.0)):
        joints |= _arm(pose, side, sign) | _leg(pose, side, sign, joints["pelvis"])
    joints["pelvis"] = _chain(_about(1, pose["turn"]), joints["pelvis"])
    frames = len(pose["turn"])
    rotations = rot.identity((frames, skeleton.n_joints))
    for name, q in joints.items():
        rotations[:, skeleton.names.index(name)] = q
    translations = np.tile(skeleton.offsets, (frames, 1, 1))
    translations[:, 0] = 0.0
    positions, world = forward_kinematics(skeleton.parents, rotations, translations)
    ankles = [skeleton.names.index(f"{side}_ankle") for side in ("left", "right")]
    # Heel, ball and tip; the height of the ankle after Winter.
    sole = stature * np.array([[0.0, -0.039, ahead] for ahead in (-0.040, 0.094, 0.134)])
    points = positions[:, ankles, None] + rot.rotate(world[:, ankles, None], sole)
    translations[:, 0] = _carry(points.reshape(frames, -1, 3), pose["flight"] / 100.0, frame_rate)
    return Motion(skeleton, rot.normalise(rotations), translations, frame_rate)


def _carry(
    points: FloatArray,
    flight: FloatArray,
    frame_rate: float,
    *,
    depth: float = 0.008,
    speed: float = 1.0,
    airborne: float = 0.01,
    inertia: float = 0.03,
) -> FloatArray:
    """Root positions (T, 3) from the sole points (T, P, 3) relative to the root and the flight (T,) in m.

    Parameters
    ----------
    depth, speed : m and m/s; a sole point so much higher, or faster past the body, carries e times less weight.
    airborne : m, above which the floor no longer drives the body.
    inertia : s, as a body does not change its speed at once when the other foot takes over.
    """
    frames = np.arange(len(points))
    standing = -points[..., 1].min(axis=1)
    grounded = frames[flight < airborne]
    root = np.zeros((len(points), 3))
    root[:, 1] = standing + flight
    if len(grounded):  # in the air the legs may be drawn up without the body coming down
        path = np.interp(frames, grounded, standing[grounded]) + flight
        root[:, 1] = np.maximum(path, standing)
    if len(points) < 3:
        return root
    moved = np.diff(points[..., ::2], axis=0)
    middle = 0.5 * (points[1:, :, 1] + points[:-1, :, 1])
    doubt = middle / depth + np.linalg.norm(moved, axis=2) * frame_rate / speed
    weights = np.exp(doubt.min(axis=1, keepdims=True) - doubt)
    weights /= weights.sum(axis=1, keepdims=True)
    steps = -np.einsum("tp,tpk->tk", weights, moved)
    carried = frames[:-1][np.maximum(flight[1:], flight[:-1]) < airborne]
    for axis, column in ((0, 0), (2, 1)):
        path = steps[:, column]
        if len(carried):
            path = np.interp(frames[:-1], carried, path[carried])
        root[1:, axis] = np.cumsum(_smooth(path, inertia * frame_rate))
    return root


def _smooth(values: FloatArray, frames: float) -> FloatArray:
    """Values (T,) under a Gaussian with a standard deviation of so many frames."""
    reach = max(int(np.ceil(3 * frames)), 1)
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / max(frames, 1e-6)) ** 2)
    return np.convolve(np.pad(values, reach, mode="edge"), kernel / kernel.sum(), mode="valid")
