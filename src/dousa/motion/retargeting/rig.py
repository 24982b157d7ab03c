"""A skeleton for retargeting: its canonical joints, its bones, and a reference pose."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dousa.arrays import FloatArray
from dousa.motion.canonical.canonicalise import CanonicalMotion
from dousa.motion.kinematics import forward_kinematics
from dousa.motion.rotations import conjugate, from_matrix, identity, rotate
from dousa.motion.types import Motion

SIDES = ("left", "right")
LIMBS: tuple[tuple[str, str], ...] = tuple(
    (f"{side}_{start}", f"{side}_{end}")
    for side in SIDES
    for start, end in (("shoulder", "elbow"), ("elbow", "wrist"), ("hip", "knee"), ("knee", "ankle"))
)
"""Bones whose direction is kept exactly: from joint to joint."""

LIMB_NAMES: tuple[str, ...] = tuple(
    f"{side}_{segment}" for side in SIDES for segment in ("upper_arm", "forearm", "thigh", "shank")
)
"""Their names."""

TIPS: tuple[tuple[str, str], ...] = tuple(
    (f"{side}_{start}", f"{side}_{end}") for side in SIDES for start, end in (("wrist", "hand"), ("ankle", "toe"))
)
"""As the limbs, where both skeletons have the tip."""


@dataclass(frozen=True, slots=True, eq=False)
class Rig:
    """A skeleton for retargeting.

    Parameters
    ----------
    names, parents : of all joints.
    offsets : (J, 3) m, usual local positions; real files have others than their OFFSETs.
    joints : canonical joint -> index of the joint that stands for it.
    pelvis, chest, head : joints that carry the hips, the shoulders, and the head.
    world : (J, 4) orientations in the reference pose.
    places : (J, 3) positions in the reference pose.
    body : (4,) orientation of the body in the reference pose: left, up and front along x, y and z.
    leg : m, hip to ankle, along the bones.
    """

    names: tuple[str, ...]
    parents: list[int]
    offsets: FloatArray
    joints: dict[str, int]
    pelvis: int
    chest: int
    head: int
    world: FloatArray
    places: FloatArray
    body: FloatArray
    leg: float

    def direction(self, start: str, end: str) -> FloatArray:
        """Return the vector (3,) from joint to joint in the reference pose, of any length."""
        vector: FloatArray = self.places[self.joints[end]] - self.places[self.joints[start]]
        return vector

    def foot_heights(self) -> tuple[float, float]:
        """Return the height (m) over the floor of ankles and toes in a standing foot; without toes, usual ones.

        The floor is at the lowest joint of the reference pose, in which one foot may be lifted.
        """
        up = rotate(conjugate(self.body), self.places)[:, 1]
        lowest = min(up[joint] for joint in range(len(self.parents)) if self.pelvis in self.ancestors(joint))
        heights = []
        for joint in ("ankle", "toe"):
            known = [up[self.joints[f"{side}_{joint}"]] for side in SIDES if f"{side}_{joint}" in self.joints]
            heights.append(float(min(known) - lowest) if known else 0.0)
        if heights[1] == 0.0 and not any(f"{side}_toe" in self.joints for side in SIDES):
            heights[0] = max(heights[0], 0.08 * self.leg)
        return heights[0], heights[1]

    def path(self, start: int, end: int) -> list[int]:
        """Return the joints from ``start`` down to, and without, ``end``."""
        chain = []
        joint = self.parents[end]
        while joint != start and joint >= 0:
            chain.append(joint)
            joint = self.parents[joint]
        return [start, *reversed(chain)]

    def ancestors(self, joint: int) -> list[int]:
        """Return the joint and all above it, from below."""
        chain = []
        while joint >= 0:
            chain.append(joint)
            joint = self.parents[joint]
        return chain


def build_rig(motion: Motion, canonical: CanonicalMotion) -> Rig:
    """Build the rig of a motion with known canonical joints; the reference is the rest pose if that is a person's."""
    skeleton = motion.skeleton
    names, parents = skeleton.names, skeleton.parents.tolist()
    joints = {joint: names.index(sources[0]) for joint, sources in canonical.mapping.sources.items()}
    with np.errstate(invalid="ignore"):
        offsets = np.nanmedian(motion.translations, axis=0)
    offsets = np.where(np.isfinite(offsets), offsets, skeleton.offsets)
    lines = {joint: _line(parents, index) for joint, index in joints.items()}
    pelvis = _meeting(lines["left_hip"], lines["right_hip"])
    chest = _meeting(lines["left_shoulder"], lines["right_shoulder"])
    ends = skeleton.end_sites
    top = joints.get("head", joints.get("neck", chest))
    above = _line(parents, top)
    head = next((joint for joint in above if not ends[joint]), chest)
    if chest not in above:
        head = chest
    world, places = _choose_reference(motion, offsets, joints)
    legs = []
    for side in SIDES:
        hip, knee, ankle = (places[joints[f"{side}_{joint}"]] for joint in ("hip", "knee", "ankle"))
        legs.append(np.linalg.norm(hip - knee) + np.linalg.norm(knee - ankle))
    body = from_matrix(body_axes(places, joints))
    return Rig(names, parents, offsets, joints, pelvis, chest, head, world, places, body, float(np.mean(legs)))


def _line(parents: list[int], joint: int) -> list[int]:
    line = []
    while joint >= 0:
        line.append(joint)
        joint = parents[joint]
    return line


def _meeting(first: list[int], second: list[int]) -> int:
    """The lowest joint above two others."""
    return next((joint for joint in first[1:] if joint in second[1:]), first[-1])


def body_axes(places: FloatArray, joints: dict[str, int]) -> FloatArray:
    """Compute axes (..., 3, 3) of a body as columns left, up, front from places (..., J, 3)."""

    def middle(joint: str) -> FloatArray:
        mean: FloatArray = 0.5 * (places[..., joints[f"left_{joint}"], :] + places[..., joints[f"right_{joint}"], :])
        return mean

    up = middle("shoulder") - middle("hip")
    across = places[..., joints["left_hip"], :] - places[..., joints["right_hip"], :]
    across = across + places[..., joints["left_shoulder"], :] - places[..., joints["right_shoulder"], :]
    up = up / np.maximum(np.linalg.norm(up, axis=-1, keepdims=True), 1e-9)
    front = np.cross(across, up)
    front = front / np.maximum(np.linalg.norm(front, axis=-1, keepdims=True), 1e-9)
    return np.stack((np.cross(up, front), up, front), axis=-1)


def _choose_reference(
    motion: Motion, offsets: FloatArray, joints: dict[str, int], most: int = 400
) -> tuple[FloatArray, FloatArray]:
    """Orientations and places of the rest pose where a person stands in it, else of the nearest of ``most`` frames."""
    parents = motion.skeleton.parents
    rest = identity((len(parents),))
    still = np.array(offsets)
    places, world = forward_kinematics(parents, rest, still)
    if _likeness(places[None], joints)[0] > 0:
        return world, places
    step = max(1, motion.n_frames // most)
    turns = motion.rotations[::step]
    seen = np.isfinite(turns.sum(axis=(1, 2)))
    turns = turns[seen] if seen.any() else rest[None]
    all_places, all_world = forward_kinematics(parents, turns, np.tile(still, (len(turns), 1, 1)))
    best = int(np.argmax(_likeness(all_places, joints)))
    return all_world[best], all_places[best]


def _likeness(places: FloatArray, joints: dict[str, int], straight: float = 0.9, opposite: float = 0.85) -> FloatArray:
    """Likeness (T,) of a pose to standing with straight arms and legs; positive for such a pose.

    Parameters
    ----------
    straight : least length of a limb from end to end, as a share of its bones.
    opposite : least cosine between the trunk and the legs turned round.
    """

    def at(joint: str) -> FloatArray:
        return places[:, joints[joint]]

    def middle(joint: str) -> FloatArray:
        mean: FloatArray = 0.5 * (at(f"left_{joint}") + at(f"right_{joint}"))
        return mean

    margins = []
    for side in SIDES:
        for chain in (("shoulder", "elbow", "wrist"), ("hip", "knee", "ankle")):
            a, b, c = (at(f"{side}_{joint}") for joint in chain)
            whole = np.linalg.norm(a - b, axis=1) + np.linalg.norm(b - c, axis=1)
            margins.append(np.linalg.norm(a - c, axis=1) / np.maximum(whole, 1e-9) - straight)
    trunk, legs = middle("shoulder") - middle("hip"), middle("ankle") - middle("hip")
    scale = np.linalg.norm(trunk, axis=1) * np.linalg.norm(legs, axis=1)
    margins.append(-(trunk * legs).sum(axis=1) / np.maximum(scale, 1e-9) - opposite)
    likeness: FloatArray = np.min(margins, axis=0)
    return likeness
