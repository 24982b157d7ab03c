"""Transfer of the turns of a motion to another skeleton, before feet and hands are put in their places."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dousa.arrays import FloatArray
from dousa.motion.canonical.canonicalise import CanonicalMotion
from dousa.motion.canonical.joints import JOINT_INDEX as J
from dousa.motion.kinematics import forward_kinematics
from dousa.motion.retargeting.rig import LIMBS, SIDES, TIPS, Rig
from dousa.motion.rotations import between, conjugate, identity, multiply, normalise, rotate
from dousa.motion.types import Motion


@dataclass(slots=True, eq=False)
class Poses:
    """Poses of the character in the world: orientations (T, J, 4), place (T, 3) of the pelvis joint."""

    world: FloatArray
    pelvis: FloatArray
    frame_rate: float

    def places(self, rig: Rig) -> FloatArray:
        """Compute places (T, J, 3) from the pelvis down; joints above it lie at it."""
        places = np.tile(self.pelvis[:, None], (1, len(rig.parents), 1))
        below = {rig.pelvis}
        for joint, parent in enumerate(rig.parents):
            if parent in below:
                below.add(joint)
                places[:, joint] = places[:, parent] + rotate(self.world[:, parent], rig.offsets[joint])
        return places


@dataclass(eq=False)
class Transfer:
    """Orientations of all joints of the character, and the path of its pelvis.

    Parameters
    ----------
    body, canonical, source : rotations, canonical joints and rig of the source.
    target, character : rig and motion of the character.
    """

    body: Motion
    canonical: CanonicalMotion
    source: Rig
    target: Rig
    character: Motion

    def __post_init__(self) -> None:
        body = self.body
        self.positions, world = forward_kinematics(body.skeleton.parents, body.rotations, body.translations)
        self.turns = multiply(world, conjugate(self.source.world))
        self.facing = multiply(self.source.body, conjugate(self.target.body))
        self.made = identity((len(world), len(self.target.parents)))
        self.done: set[int] = set()

    def run(self) -> Poses:
        """Compute the poses of the character."""
        self._trunk()
        least: dict[str, FloatArray | None] = {}
        for start, end in (*LIMBS, *TIPS):
            least[end] = self._limb(start, end, least.get(start))
        self._rest()
        return Poses(self.made, self._move_pelvis(), self.body.frame_rate)

    def _set(self, joint: int, turns: FloatArray) -> None:
        """Turn a joint from the reference pose as the source does."""
        self.made[:, joint] = multiply(turns, multiply(self.facing, self.target.world[joint]))
        self.done.add(joint)

    def _trunk(self) -> None:
        source, target = self.source, self.target
        low, high, top = (self.turns[:, joint] for joint in (source.pelvis, source.chest, source.head))
        self._set(target.pelvis, low)
        if target.chest != target.pelvis:
            self._spread(target.pelvis, target.chest, low, high)
        if target.head not in (target.chest, target.pelvis) and target.chest in target.ancestors(target.head):
            self._spread(target.chest, target.head, high, top)
        for side in SIDES:
            line, other = (rig.ancestors(rig.joints[f"{side}_shoulder"]) for rig in (target, source))
            between_them = line[1 : line.index(target.chest)] if target.chest in line else []
            own = other[1 : other.index(source.chest)] if source.chest in other else []
            for joint in between_them:
                self._set(joint, self.turns[:, own[0]] if own else high)

    def _spread(self, start: int, end: int, first: FloatArray, last: FloatArray) -> None:
        """Spread the turn of a chain over its joints."""
        chain = [*self.target.path(start, end)[1:], end]
        short = np.where((first * last).sum(axis=1, keepdims=True) < 0, -last, last)
        for number, joint in enumerate(chain, 1):
            share = number / len(chain)
            self._set(joint, normalise((1 - share) * first + share * short))

    def _limb(self, start: str, end: str, above: FloatArray | None) -> FloatArray | None:
        """Turn a bone as the source's and align it; return the alignment, for the next bone."""
        source, target = self.source, self.target
        if start not in source.joints or start not in target.joints:
            return above
        joint = target.joints[start]
        turns, faced = self.turns[:, source.joints[start]], multiply(self.facing, target.world[joint])
        self.done.add(joint)
        if end not in source.joints or end not in target.joints:
            self.made[:, joint] = multiply(turns, faced if above is None else multiply(above, faced))
            return above
        # Where both point the same way the limb's roll is the same; else the least turn from one to the other.
        after = source.direction(start, end)
        least = between(rotate(self.facing, target.direction(start, end)), after)
        made = multiply(turns, multiply(least, faced))
        self.made[:, joint] = multiply(between(rotate(turns, after), self._direction(start, end)), made)
        return least

    def _direction(self, start: str, end: str) -> FloatArray:
        if (start, end) in LIMBS:
            points = self.canonical.positions
            return points[:, J[end]] - points[:, J[start]]
        joints = self.source.joints
        return self.positions[:, joints[end]] - self.positions[:, joints[start]]

    def _rest(self) -> None:
        """Keep joints without a counterpart as they are to their parent; same names, as fingers, follow."""
        target, source = self.target, self.source
        named = {name: index for index, name in reversed(list(enumerate(source.names)))}
        used = set(source.joints.values())
        raw = self.character.rotations[0]
        for joint, parent in enumerate(target.parents):
            if joint in self.done:
                continue
            other = named.get(target.names[joint], -1)
            if parent < 0 or joint in target.ancestors(target.pelvis):
                local = raw[joint] if np.isfinite(raw[joint]).all() else np.array([1.0, 0, 0, 0])
                self.made[:, joint] = local if parent < 0 else multiply(self.made[:, parent], local)
            elif other >= 0 and other not in used and source.parents[other] >= 0:
                above = source.parents[other]
                bent = multiply(conjugate(self.turns[:, above]), self.turns[:, other])
                still = multiply(conjugate(target.world[parent]), target.world[joint])
                frame = multiply(conjugate(source.world[above]), multiply(self.facing, target.world[parent]))
                local = multiply(conjugate(frame), multiply(_in_frame(bent, source.world[above]), frame))
                self.made[:, joint] = multiply(self.made[:, parent], multiply(local, still))
            else:
                still = multiply(conjugate(target.world[parent]), target.world[joint])
                self.made[:, joint] = multiply(self.made[:, parent], still)

    def _move_pelvis(self) -> FloatArray:
        """(T, 3): the middle of the hips moves as the source's, in proportion to the legs."""
        target, points = self.target, self.canonical.positions
        scale = target.leg / self.source.leg
        middle = 0.5 * (points[:, J["left_hip"]] + points[:, J["right_hip"]])
        floor = find_floor(self.canonical, self.source)
        start = middle[0].copy()
        start[1] = floor
        wanted = start + scale * (middle - start)
        poses = Poses(self.made, np.zeros((len(points), 3)), 1.0)
        places = poses.places(target)
        own = 0.5 * (places[:, target.joints["left_hip"]] + places[:, target.joints["right_hip"]])
        moved: FloatArray = wanted - own
        return moved


def _in_frame(turns: FloatArray, frame: FloatArray) -> FloatArray:
    """Turns of the world as turns of the axes of a frame."""
    return multiply(conjugate(frame), multiply(turns, frame))


def find_floor(canonical: CanonicalMotion, rig: Rig) -> float:
    """Return the height (m) of the floor: second percentile of the toes less their height in a standing foot.

    Ankles are used where there are no toes.
    """
    ankle, toe = rig.foot_heights()
    over = []
    for side in SIDES:
        known = f"{side}_toe" in rig.joints
        over.append(canonical.positions[:, J[f"{side}_{'toe' if known else 'ankle'}"], 1] - (toe if known else ankle))
    return float(np.percentile(over, 2))
