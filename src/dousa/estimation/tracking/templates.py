"""Poses to begin a search with: those of people in everyday motion, or any that a body can take."""

from __future__ import annotations

from functools import lru_cache
from itertools import pairwise

import numpy as np

from dousa.arrays import FloatArray, IndexArray
from dousa.estimation.body.body import BodyModel
from dousa.estimation.body.kinematics import compute_points, point_names
from dousa.estimation.body.posing import lead_pose, standing_state
from dousa.motion import CANONICAL_JOINTS, canonicalise
from dousa.motion import rotations as rot

_COUNT = 56  # templates of a person, before standing, T-pose, arms up and lying
_CROUCH = 0.14  # statures from ankles to hips of somebody who crouches
_REACHES = (0.0, -0.9)
_RANDOM = 48  # templates of another body
_RATE = 3.0  # Hz at which the synthetic motions are looked at
_HIPS, _FRONT = ("left_hip", "right_hip"), (2, 0)


def is_person(body: BodyModel) -> bool:
    """Whether joints and tips bear the canonical names."""
    return set(CANONICAL_JOINTS) <= set(point_names(body))


def list_templates(body: BodyModel) -> FloatArray:
    """Poses (N, 7 + A) facing about +Z, of which one is near to nearly any pose.

    A person: frames of the package's synthetic motions, as different from each other as can be, and standing, arms to
    the sides, arms up and lying. Another body: at ease, and drawn at random within the limits. Made once per body.
    """
    arrays = (
        *(body.parents, body.offsets, body.rest, body.n_axes, body.axes, body.limits),
        *(body.tip_parts, body.tip_offsets, body.neutral),
    )
    key = (body.names, body.joints, body.tips, *(array.tobytes() for array in arrays))
    if key not in _made:
        if len(_made) >= _KEPT:
            _made.clear()
        poses = _person_poses(body) if is_person(body) else _random_poses(body)
        poses.flags.writeable = False
        _made[key] = poses
    return _made[key]


_made: dict[tuple[object, ...], FloatArray] = {}
_KEPT = 8


def _person_poses(body: BodyModel) -> FloatArray:
    scale = body.stature / 1.72
    poses = [lead_pose(body, scale * points) for points in _natural_points()]
    standing = standing_state(body)
    poses.append(standing)
    for height in (0.0, 0.9):
        poses.append(lead_pose(body, _raise_arms(body, standing, height)))
    for reach in _REACHES:
        poses.append(lead_pose(body, _crouch(body, standing, reach)))
    for axis in ((1.0, 0.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, 0.0, -1.0)):
        lying = standing.copy()
        lying[3:7] = rot.from_axis_angle(0.5 * np.pi * np.array(axis))
        poses.append(lying)
    return np.array(poses)


def _raise_arms(body: BodyModel, standing: FloatArray, height: float) -> FloatArray:
    """Canonical points of standing with both arms stretched out to the sides or, with ``height``, up."""
    names = point_names(body)
    points = compute_points(body, standing)[[names.index(name) for name in CANONICAL_JOINTS]]
    for side, sign in (("left", 1.0), ("right", -1.0)):
        rows = [CANONICAL_JOINTS.index(f"{side}_{joint}") for joint in ("shoulder", "elbow", "wrist", "hand")]
        way = np.array([sign * np.sqrt(1.0 - height * height), height, 0.0])
        for above, below in pairwise(rows):
            length = np.linalg.norm(points[below] - points[above])
            points[below] = points[above] + max(float(length), 0.05) * way
    return np.asarray(points)


def _crouch(body: BodyModel, standing: FloatArray, reach: float) -> FloatArray:
    """Canonical points of crouching with the heels down, knees apart, arms forward and, with ``reach`` < 0, down."""
    names = point_names(body)
    points = compute_points(body, standing)[[names.index(name) for name in CANONICAL_JOINTS]]
    place = {name: row for row, name in enumerate(CANONICAL_JOINTS)}
    down = points[place["left_hip"], 1] - points[place["left_ankle"], 1] - _CROUCH * body.stature
    legs = {place[side + joint] for side in ("left_", "right_") for joint in ("knee", "ankle", "toe")}
    above = [row for row in range(len(points)) if row not in legs]
    points[above] -= np.array([0.0, down, 0.1 * body.stature])
    for side, sign in (("left", 1.0), ("right", -1.0)):
        hip, ankle = points[place[f"{side}_hip"]], points[place[f"{side}_ankle"]]
        thigh = 0.245 * body.stature
        points[place[f"{side}_knee"]] = hip + thigh * np.array([0.45 * sign, 0.25, 0.86])
        points[place[f"{side}_ankle"]] = ankle + np.array([0.05 * sign, 0.0, 0.0])
        way = np.array([0.0, reach, np.sqrt(1.0 - reach * reach)])
        rows = [place[f"{side}_{joint}"] for joint in ("shoulder", "elbow", "wrist", "hand")]
        for upper, lower in pairwise(rows):
            points[lower] = points[upper] + 0.12 * body.stature * way
    return np.asarray(points)


@lru_cache(maxsize=1)
def _natural_points() -> FloatArray:
    """Canonical points (N, 20, 3) m of a person of 1.72 m in everyday poses, at the origin, facing +Z."""
    from dousa.motion.synthetic.performers import CATEGORIES, Performer, make_motion

    performer = Performer()
    points = np.concatenate([canonicalise(make_motion(name, performer, 0, _RATE)).positions for name in CATEGORIES])
    points = np.concatenate((points, _mirror(points)))
    left, right = (CANONICAL_JOINTS.index(name) for name in _HIPS)
    across = points[:, left] - points[:, right]
    yaw = np.arctan2(-across[:, 2], across[:, 0])
    turned = rot.rotate(rot.from_axis_angle(np.stack((0 * yaw, -yaw, 0 * yaw), axis=-1))[:, None], points)
    turned -= turned[:, :1] * (1.0, 0.0, 1.0)
    return np.asarray(turned[_spread_out(turned, _COUNT)])


def _mirror(points: FloatArray) -> FloatArray:
    swapped = [CANONICAL_JOINTS.index(_other_side(name)) for name in CANONICAL_JOINTS]
    return points[:, swapped] * (-1.0, 1.0, 1.0)


def _other_side(name: str) -> str:
    if name.startswith("left_"):
        return "right_" + name[5:]
    return "left_" + name[6:] if name.startswith("right_") else name


def _spread_out(points: FloatArray, count: int) -> IndexArray:
    """Indices of the frames farthest from each other: each next one is the farthest from those before."""
    flat = points.reshape(len(points), -1)
    chosen = [int(np.argmin(((flat - flat.mean(axis=0)) ** 2).sum(axis=1)))]
    nearest = ((flat - flat[chosen[0]]) ** 2).sum(axis=1)
    while len(chosen) < min(count, len(flat)):
        chosen.append(int(nearest.argmax()))
        nearest = np.minimum(nearest, ((flat - flat[chosen[-1]]) ** 2).sum(axis=1))
    return np.array(chosen)


def _random_poses(body: BodyModel) -> FloatArray:
    """At ease, and angles drawn from the limits, nearer to ease in the first half."""
    rng = np.random.default_rng(0)
    limits = body.angle_limits
    used = np.arange(3) < body.n_axes[:, None]
    poses = np.zeros((_RANDOM, 7 + body.n_angles))
    poses[:, 3] = 1.0
    ease = np.clip(body.neutral[used], limits[:, 0], limits[:, 1])
    drawn = rng.uniform(limits[:, 0], limits[:, 1], (_RANDOM, body.n_angles))
    share = np.linspace(0.0, 1.0, _RANDOM)[:, None]
    poses[:, 7:] = ease + np.minimum(2.0 * share, 1.0) * (drawn - ease)
    return poses


def find_limbs(body: BodyModel) -> list[tuple[IndexArray, IndexArray]]:
    """Numbers in the pose row of the angles of each limb, and its parts: a branch that does not branch again."""
    parents, starts = body.parents, body.angle_starts
    children = [np.flatnonzero(parents == part) for part in range(body.n_parts)]
    limbs = []
    for part in range(1, body.n_parts):
        if len(children[parents[part]]) < 2:
            continue
        chain, end = [part], part
        while len(children[end]) == 1:
            end = int(children[end][0])
            chain.append(end)
        if len(children[end]) == 0:
            angles = [np.arange(starts[link], starts[link + 1]) for link in chain]
            found = 7 + np.concatenate(angles)
            if len(found):
                limbs.append((found, np.array(chain)))
    return limbs


def mirror_twins(body: BodyModel, pose: FloatArray, towards: FloatArray) -> list[FloatArray]:
    """Poses that cast nearly the same silhouettes with left and right exchanged.

    Parameters
    ----------
    body : a person.
    pose : (7 + A,).
    towards : (3,) unit vector, the way the cameras look.

    Returns
    -------
    The joints where they are with the names of the sides exchanged, so that the body faces the other way; and the
    joints mirrored along ``towards`` with the sides exchanged, which one distant camera cannot tell from the pose.
    """
    names = point_names(body)
    points = compute_points(body, pose)[[names.index(name) for name in CANONICAL_JOINTS]]
    swapped = points[[CANONICAL_JOINTS.index(_other_side(name)) for name in CANONICAL_JOINTS]]
    depths = (swapped - points[0]) @ towards
    mirrored = swapped - 2.0 * depths[:, None] * towards
    return [lead_pose(body, _turn_feet(swapped)), lead_pose(body, mirrored)]


def _turn_feet(points: FloatArray) -> FloatArray:
    """Feet and head of a body that was turned about: toes point the new way, folded knees stay where they are."""
    turned = points.copy()
    for side in ("left", "right"):
        ankle, toe = (CANONICAL_JOINTS.index(f"{side}_{joint}") for joint in ("ankle", "toe"))
        turned[toe] = points[ankle] - (points[toe] - points[ankle]) * (1.0, -1.0, 1.0)
    return turned
