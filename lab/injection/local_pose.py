"""A body as rotations of its joints: every bone in the frame of the part that it hangs on.

The pelvis turns in the world, the chest on the pelvis; an upper arm has a direction in the chest's frame, a thigh in
the pelvis's. A forearm, hand, shank or foot has one in the frame that its parent bone carries along: the shortest
rotation from the limb's rest direction onto the bone. So a forearm at the rest direction is a straight elbow.
In every frame left is +X, up +Y, front +Z; the left side's values are the right side's with -X.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dousa.arrays import FloatArray
from dousa.motion import rotations
from dousa.motion.canonical.joints import CANONICAL_JOINTS, MIRRORED_JOINTS
from dousa.motion.canonical.joints import JOINT_INDEX as J
from lab.injection.edits import LIMB_BONES, put_together, slerp, take_apart
from lab.injection.edits import Body as WorldBody

_N_BONES = len(CANONICAL_JOINTS) - 1
_CHEST_BONES = tuple(J[name] - 1 for name in ("neck", "head", "left_shoulder", "right_shoulder"))
_PELVIS_BONES = tuple(J[name] - 1 for name in ("spine", "left_hip", "right_hip"))
_MIRRORED_BONES = [joint - 1 for joint in MIRRORED_JOINTS[1:]]

# The opposite of a rest direction, where its frame flips, is where no limb goes: an arm up and back across the body.
_ARM_REST, _LEG_REST = (0.5, -0.6, 0.62), (0.1, -0.97, 0.22)


def _make_rest() -> FloatArray:
    rest = np.zeros((_N_BONES, 3))
    for name, bones in LIMB_BONES.items():
        x, y, z = _ARM_REST if name.endswith("arm") else _LEG_REST
        rest[list(bones)] = (x if name.startswith("left") else -x, y, z)
    unit: FloatArray = rest / np.maximum(np.linalg.norm(rest, axis=1, keepdims=True), 1e-9)
    return unit


REST = _make_rest()
"""(19, 3) rest directions of the limbs' bones; 0 for those of the trunk."""

_CHAINS = np.array(list(LIMB_BONES.values()))  # (4, 3): upper, lower and end bone of each limb
_ON_CHEST = np.array([name.endswith("arm") for name in LIMB_BONES])[:, None, None]
_CROSS = np.zeros((3, 3, 3))  # a vector @ this is the matrix of the cross product with it
_CROSS[[0, 1, 2], [2, 0, 1], [1, 2, 0]] = 1.0
_CROSS[[0, 1, 2], [1, 2, 0], [2, 0, 1]] = -1.0


@dataclass(frozen=True, slots=True, eq=False)
class LocalPose:
    """Poses of a body, joint by joint.

    Parameters
    ----------
    root : (n, 3) m, place of the pelvis.
    pelvis : (n, 4) unit quaternions, in the world.
    chest : (n, 4) unit quaternions, in the pelvis's frame.
    bones : (n, 19, 3) unit directions, each in its parent's frame.
    lengths : (n, 19) m.
    """

    root: FloatArray
    pelvis: FloatArray
    chest: FloatArray
    bones: FloatArray
    lengths: FloatArray

    @property
    def n_frames(self) -> int:
        """Number of poses."""
        return len(self.root)

    def turned(self, angle: FloatArray) -> LocalPose:
        """The pelvis, and all on it, turned about the vertical by ``angle`` (n,) rad; the place stays."""
        vertical = np.stack([0.0 * angle, angle, 0.0 * angle], axis=-1)
        return replace(self, pelvis=rotations.multiply(rotations.from_axis_angle(vertical), self.pelvis))

    def mirrored(self) -> LocalPose:
        """What the left side does done by the right; of a body that faces +Z (`turned`)."""
        flip = np.array([1.0, 1.0, -1.0, -1.0])  # a rotation reflected in x = 0
        bones = self.bones[:, _MIRRORED_BONES] * (-1.0, 1.0, 1.0)
        return LocalPose(self.root, self.pelvis * flip, self.chest * flip, bones, self.lengths)

    def sampled(self, frames: FloatArray) -> LocalPose:
        """The poses at fractional frames (m,), held at the ends."""
        inside = np.clip(frames, 0.0, self.n_frames - 1.0)
        low = inside.astype(np.intp)
        high, share = np.minimum(low + 1, self.n_frames - 1), inside - low
        first, second = self.take(low), self.take(high)
        return blend(first, second, share)

    def take(self, frames: FloatArray | slice | np.ndarray[tuple[int], np.dtype[np.intp]]) -> LocalPose:
        """The poses at these whole frames."""
        index = frames if isinstance(frames, slice) else np.asarray(frames, dtype=np.intp)
        return LocalPose(
            self.root[index], self.pelvis[index], self.chest[index], self.bones[index], self.lengths[index]
        )


def blend(first: LocalPose, second: LocalPose, share: FloatArray) -> LocalPose:
    """From the first poses (share 0) to the second ones (1), joint by joint; ``share`` (n,)."""
    wide = share[:, None]
    return LocalPose(
        first.root + wide * (second.root - first.root),
        rotations.slerp(first.pelvis, second.pelvis, share),
        rotations.slerp(first.chest, second.chest, share),
        slerp(first.bones, second.bones, wide[..., None]),
        first.lengths + wide * (second.lengths - first.lengths),
    )


def to_local(positions: FloatArray) -> LocalPose:
    """Canonical positions (n, 20, 3) m as joints; `to_positions` is the inverse."""
    body = take_apart(positions)
    up = positions[:, J["neck"]] - positions[:, J["pelvis"]]
    pelvis = _find_frame(positions[:, J["left_hip"]] - positions[:, J["right_hip"]], up)
    chest_up = positions[:, J["neck"]] - positions[:, J["spine"]]
    chest = _find_frame(positions[:, J["left_shoulder"]] - positions[:, J["right_shoulder"]], chest_up)
    on_pelvis, on_chest = rotations.to_matrix(pelvis), rotations.to_matrix(chest)
    bones = np.empty_like(body.directions)
    # A row vector times a rotation matrix is the vector turned back.
    bones[:, _PELVIS_BONES] = body.directions[:, _PELVIS_BONES] @ on_pelvis
    bones[:, _CHEST_BONES] = body.directions[:, _CHEST_BONES] @ on_chest
    frames = np.where(_ON_CHEST, on_chest[:, None], on_pelvis[:, None])
    for chain in _CHAINS.T:
        bones[:, chain] = (body.directions[:, chain, None] @ frames)[:, :, 0]
        frames = frames @ _find_swings(REST[chain], bones[:, chain])
    turned = rotations.multiply(rotations.conjugate(pelvis), chest)
    return LocalPose(body.root, pelvis, turned, bones, body.lengths)


def to_positions(pose: LocalPose) -> FloatArray:
    """Canonical positions (n, 20, 3) m."""
    on_pelvis = rotations.to_matrix(pose.pelvis)
    on_chest = on_pelvis @ rotations.to_matrix(pose.chest)
    directions = np.empty_like(pose.bones)
    directions[:, _PELVIS_BONES] = pose.bones[:, _PELVIS_BONES] @ on_pelvis.swapaxes(1, 2)
    directions[:, _CHEST_BONES] = pose.bones[:, _CHEST_BONES] @ on_chest.swapaxes(1, 2)
    frames = np.where(_ON_CHEST, on_chest[:, None], on_pelvis[:, None])
    for chain in _CHAINS.T:
        directions[:, chain] = (frames @ pose.bones[:, chain, :, None])[..., 0]
        frames = frames @ _find_swings(REST[chain], pose.bones[:, chain])
    return put_together(WorldBody(pose.root, directions, pose.lengths))


def _find_swings(start: FloatArray, end: FloatArray) -> FloatArray:
    """Matrices (n, 4, 3, 3) of the shortest rotations from ``start`` (4, 3) to ``end`` (n, 4, 3), unit vectors."""
    cosine = (end * start).sum(axis=-1)
    axis = (end[..., None, :] @ (start @ _CROSS.reshape(3, 9)).reshape(-1, 3, 3).swapaxes(1, 2))[..., 0, :]
    skew = (axis @ _CROSS.reshape(3, 9)).reshape(*axis.shape, 3)
    swings: FloatArray = np.eye(3) + skew + skew @ skew / np.maximum(1.0 + cosine, 1e-9)[..., None, None]
    return swings


def _find_frame(left: FloatArray, up: FloatArray) -> FloatArray:
    """Quaternions (n, 4) of the frame with Y along ``up`` and X as near to ``left`` (n, 3) as that allows."""
    y = up / np.maximum(np.linalg.norm(up, axis=1, keepdims=True), 1e-9)
    x = left - (left * y).sum(axis=1, keepdims=True) * y
    x /= np.maximum(np.linalg.norm(x, axis=1, keepdims=True), 1e-9)
    upright = np.isfinite(x).all(axis=1) & (np.linalg.norm(x, axis=1) > 0.5) & (np.linalg.norm(y, axis=1) > 0.5)
    axes = np.stack([x, y, np.cross(x, y)], axis=-1)
    return rotations.from_matrix(np.where(upright[:, None, None], axes, np.eye(3)))
