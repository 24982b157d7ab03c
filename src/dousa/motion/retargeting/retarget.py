"""Retargeting of a motion to another skeleton.

Every joint of the character turns as its counterpart does from a reference pose in which both stand the same way (the
rest pose, or a frame where that is not a person's). Then each limb is aligned with the source's. The pelvis moves in
proportion to the length of the legs. Feet that stand are held in place by moving the pelvis and bending hip and knee,
which changes the direction of the legs where the proportions differ; a foot in the air goes with the pelvis.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np

from dousa.arrays import BoolArray, FloatArray
from dousa.messages import Message
from dousa.motion.canonical.canonicalise import CanonicalMotion, canonicalise
from dousa.motion.canonical.fitting import fit_motion
from dousa.motion.canonical.joints import JOINT_INDEX as J
from dousa.motion.canonical.recipes import JointMap
from dousa.motion.kinematics import forward_kinematics
from dousa.motion.retargeting.contacts import body_size, find_contacts
from dousa.motion.retargeting.planting import Foot, FootPlan, bend, level_foot, plan_foot, stand
from dousa.motion.retargeting.rig import LIMB_NAMES, LIMBS, SIDES, Rig, body_axes, build_rig
from dousa.motion.retargeting.transfer import Poses, Transfer, find_floor
from dousa.motion.rotations import conjugate, multiply, normalise, rotate
from dousa.motion.runs import find_runs
from dousa.motion.types import Motion, Trajectories, freeze


@dataclass(frozen=True, slots=True)
class LimbError:
    """Where a limb of the character points furthest beside that of the source.

    Parameters
    ----------
    limb : ``"left_shank"`` or another segment.
    angle : rad.
    frame : of the motion, from 0.
    """

    limb: str
    angle: float
    frame: int

    def describe(self) -> Message:
        """Return it for the user; frames count from 1."""
        limb = Message(f"body_segments.{self.limb}")
        return Message("retarget.worst", limb=limb, angle=math.degrees(self.angle), frame=self.frame + 1)


@dataclass(frozen=True, slots=True, eq=False)
class Retargeted:
    """A motion on another skeleton, and how well it fits.

    Parameters
    ----------
    motion : over the skeleton of the character; written to its format it keeps the character's layout.
    contacts : (T, 2) when the left and the right foot of the source stand.
    skating : m, 95th percentile of the distance of standing feet of the character from their places.
    direction_error : rad, mean angle between the limbs of the source and of the character.
    worst : the limb and frame of the greatest.
    scale : length of the character's legs over that of the source's.
    warnings : for the user.
    """

    motion: Motion
    contacts: BoolArray
    skating: float
    direction_error: float
    worst: LimbError
    scale: float
    warnings: tuple[Message, ...] = ()


def retarget(
    motion: Motion | Trajectories,
    character: Motion,
    *,
    joint_map: JointMap | None = None,
    plant_feet: bool = True,
    keep_reach: bool = False,
) -> Retargeted:
    """Put a motion onto another skeleton.

    Parameters
    ----------
    motion : the source; positions are fitted with rigid bones first.
    character : a motion, or a single pose, over the skeleton to move.
    joint_map : canonical joint -> name in the source.
    plant_feet : hold feet in place while they stand.
    keep_reach : keep the places of the hands relative to the pelvis, in proportion to the legs, instead of the
        directions of the arms: for holding or touching.

    Raises
    ------
    JointMappingError : joints of the source or of the character that cannot be mapped.
    """
    canonical = canonicalise(motion, joint_map, any_skeleton=True, whole=True)
    body = motion
    if not isinstance(body, Motion) or not np.isfinite(body.rotations.sum()) or canonical.mapping.sides == "disagree":
        body = fit_motion(canonical)
    source = build_rig(body, canonical if body is motion else canonicalise(body, whole=True))
    target_canonical = canonicalise(character, any_skeleton=True, whole=True)
    target = build_rig(character, target_canonical)
    made = Transfer(body, canonical, source, target, character).run()
    has_toes = all(f"{side}_toe" in rig.joints for rig in (source, target) for side in SIDES)
    joint = "toe" if has_toes else "ankle"
    contacts = find_contacts(canonical, joint)
    if plant_feet:
        made = _plant(made, target, source, canonical, target.leg / source.leg)
    if keep_reach:
        made = _reach(made, target, canonical, target.leg / source.leg)
    rotations, translations = _to_local(made, target, character)
    provenance = character.provenance
    if provenance is not None:
        provenance = dataclasses.replace(provenance.derive(), notes=())
    result = Motion(character.skeleton, freeze(rotations), freeze(translations), motion.frame_rate, provenance)
    places, _ = forward_kinematics(target.parents, rotations, translations)
    skating = measure_skating(places[:, [target.joints[f"{side}_{joint}"] for side in SIDES]], contacts)
    warnings = list(canonical.warnings)
    if target_canonical.mapping.sides == "disagree":
        warnings.append(Message("retarget.mirrored"))
    errors = measure_directions(canonical, places, target.joints)
    frame, limb = divmod(int(errors.argmax()), errors.shape[1])
    worst = LimbError(LIMB_NAMES[limb], float(errors[frame, limb]), frame)
    mean, scale = float(errors.mean()), target.leg / source.leg
    return Retargeted(result, contacts, skating, mean, worst, scale, tuple(warnings))


def measure_directions(canonical: CanonicalMotion, places: FloatArray, joints: dict[str, int]) -> FloatArray:
    """Compute angles (T, 8) rad between upper and lower limbs of a source and of places (T, J, 3) of a character."""
    angles = []
    for start, end in LIMBS:
        first = canonical.positions[:, J[end]] - canonical.positions[:, J[start]]
        second = places[:, joints[end]] - places[:, joints[start]]
        cosine = (first * second).sum(axis=1)
        angles.append(np.arctan2(np.linalg.norm(np.cross(first, second), axis=1), cosine))
    return np.stack(angles, axis=1)


def measure_skating(points: FloatArray, contacts: BoolArray) -> float:
    """Compute the 95th percentile of the distance (m) of standing feet (T, 2, 3) from their places.

    The place of a contact is the median of its frames; 0 without contacts.
    """
    away = [
        np.linalg.norm(points[start:end, side] - np.median(points[start:end, side], axis=0), axis=1)
        for side in range(2)
        for start, end in find_runs(contacts[:, side]).tolist()
    ]
    return float(np.percentile(np.concatenate(away), 95)) if away else 0.0


def _plant(poses: Poses, rig: Rig, source: Rig, canonical: CanonicalMotion, scale: float) -> Poses:
    places, floor = poses.places(rig), find_floor(canonical, source)
    plans = [_plan(poses, places, rig, source, canonical, side, scale, floor) for side in SIDES]
    moves = np.stack([plan.moves for plan in plans], axis=1)
    if not moves.any():
        return poses
    lines = np.stack([
        places[:, [rig.joints[f"{side}_{joint}"] for side in SIDES]] for joint in ("hip", "knee", "ankle")
    ], axis=2)  # fmt: skip
    bones = np.linalg.norm(np.diff(lines, axis=2), axis=-1)
    grounded = np.stack([plan.grounded for plan in plans], axis=1)
    weights = np.where(np.stack([plan.stands for plan in plans], axis=1), 1.0, 0.1)
    body, reached = stand(lines[:, :, 0], lines[:, :, 2], bones, moves, weights, poses.frame_rate)
    # A foot in the air goes with the body: its leg points as the source's.
    wanted = lines[:, :, 2] + body[:, None] + grounded[..., None] * (reached - body[:, None])
    moved = Poses(poses.world, poses.pelvis + body, poses.frame_rate)
    for column, side in enumerate(SIDES):
        moved = _bend_limb(moved, rig, [f"{side}_{joint}" for joint in ("hip", "knee", "ankle")], wanted[:, column])
        foot = rig.joints[f"{side}_ankle"]
        below = [joint for joint in range(len(rig.parents)) if foot in rig.ancestors(joint)]
        moved.world[:, below] = multiply(plans[column].turns[:, None], moved.world[:, below])
    return moved


def _plan(
    poses: Poses,
    places: FloatArray,
    rig: Rig,
    source: Rig,
    canonical: CanonicalMotion,
    side: str,
    scale: float,
    floor: float,
) -> FootPlan:
    ankle, toe = f"{side}_ankle", f"{side}_toe"
    known = toe in rig.joints and toe in source.joints
    points, rate, size = canonical.positions, canonical.frame_rate, body_size(canonical)
    lowest = [
        min(float(np.percentile(points[:, J[f"{one}_{joint}"], 1], 5)) for one in SIDES) - floor
        for joint in ("ankle", "toe")
    ]
    made = Foot(places[:, rig.joints[ankle]], places[:, rig.joints[toe]] if known else None, rig.foot_heights())
    own = Foot(points[:, J[ankle]], points[:, J[toe]] if known else None, (lowest[0], lowest[1]))
    level = level_foot(own, made, poses.world[:, rig.joints[ankle]], rig, side, rate, size)
    if made.toe is not None:
        made = dataclasses.replace(made, toe=made.ankle + rotate(level, made.toe - made.ankle))
    plan = plan_foot(own, made, scale, floor, rate, size)
    return dataclasses.replace(plan, turns=multiply(plan.turns, level))


def _reach(poses: Poses, rig: Rig, canonical: CanonicalMotion, scale: float) -> Poses:
    """Put hands where they were, relative to the middle of the hips."""
    points = canonical.positions
    middle = 0.5 * (points[:, J["left_hip"]] + points[:, J["right_hip"]])
    places = poses.places(rig)
    own = 0.5 * (places[:, rig.joints["left_hip"]] + places[:, rig.joints["right_hip"]])
    for side in SIDES:
        wanted = own + scale * (points[:, J[f"{side}_wrist"]] - middle)
        poses = _bend_limb(poses, rig, [f"{side}_{joint}" for joint in ("shoulder", "elbow", "wrist")], wanted)
    return poses


def _bend_limb(poses: Poses, rig: Rig, names: list[str], wanted: FloatArray) -> Poses:
    places = poses.places(rig)
    first, second, third = (rig.joints[name] for name in names)
    front = body_axes(places, rig.joints)[..., 2]
    outward = front if "hip" in names[0] else -front
    upper, lower = bend(places[:, first], places[:, second], places[:, third], wanted, outward)
    world = poses.world.copy()
    for joints, turn in ((rig.path(first, second), upper), (rig.path(second, third), lower)):
        for joint in joints:
            world[:, joint] = multiply(turn, world[:, joint])
    # What hangs beside the limb goes with it; what hangs at its end keeps its direction.
    for joint, parent in enumerate(rig.parents):
        line = rig.ancestors(joint)
        if joint in rig.path(first, second) + rig.path(second, third) or third in line:
            continue
        if second in line and parent >= 0:
            world[:, joint] = multiply(lower, world[:, joint])
        elif first in line and parent >= 0:
            world[:, joint] = multiply(upper, world[:, joint])
    return Poses(world, poses.pelvis, poses.frame_rate)


def _to_local(poses: Poses, rig: Rig, character: Motion) -> tuple[FloatArray, FloatArray]:
    n_frames = len(poses.world)
    rotations = np.array(poses.world)
    translations = np.tile(rig.offsets, (n_frames, 1, 1))
    for joint, parent in enumerate(rig.parents):
        if parent >= 0:
            rotations[:, joint] = multiply(conjugate(poses.world[:, parent]), poses.world[:, joint])
    # Joints above the pelvis stay where the character has them; the pelvis makes up for it.
    still = np.array(rig.offsets)
    places, world = forward_kinematics(rig.parents, rotations[:1], still[None])
    parent = rig.parents[rig.pelvis]
    if parent < 0:
        translations[:, rig.pelvis] = poses.pelvis
    else:
        translations[:, rig.pelvis] = rotate(conjugate(world[0, parent]), poses.pelvis - places[0, parent])
    return normalise(rotations), translations
