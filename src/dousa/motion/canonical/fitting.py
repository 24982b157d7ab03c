"""From positions to joint rotations: a rigid canonical skeleton that follows measured points.

Trajectories (C3D, TRC) have no bones. `fit_motion` takes median bone lengths and turns the 20 canonical joints frame
by frame from the root outwards. Each bone is aimed from the fitted position of its joint, so that errors do not
accumulate. Pelvis and neck carry three bones each and are fitted by least squares (Kabsch, "A solution for the best
rotation to relate two sets of vectors", Acta Crystallographica A32, 1976). Limb bones get the least possible twist.
"""

from __future__ import annotations

import numpy as np

from dousa.arrays import FloatArray
from dousa.motion.canonical.canonicalise import CanonicalMotion, canonicalise, require_whole
from dousa.motion.canonical.joints import CANONICAL_JOINTS, CANONICAL_PARENTS
from dousa.motion.canonical.joints import JOINT_INDEX as J
from dousa.motion.rotations import between, conjugate, from_matrix, identity, multiply, rotate
from dousa.motion.types import Motion, Skeleton, Trajectories

# Directions of bones in the rest pose, by definition: facing +Z, arms to the sides, legs down, feet sloping forward.
_REST = {
    "neck": (0.0, 1.0, 0.0),
    **{f"left_{joint}": (1.0, 0.0, 0.0) for joint in ("elbow", "wrist", "hand")},
    **{f"right_{joint}": (-1.0, 0.0, 0.0) for joint in ("elbow", "wrist", "hand")},
    **{f"{side}_{joint}": (0.0, -1.0, 0.0) for side in ("left", "right") for joint in ("knee", "ankle")},
    **{f"{side}_toe": (0.0, -0.4, 0.9165) for side in ("left", "right")},
}
_CHILDREN = {
    joint: [child for child, parent in enumerate(CANONICAL_PARENTS) if parent == joint]
    for joint in range(len(CANONICAL_JOINTS))
}


def fit_motion(motion: Trajectories | CanonicalMotion) -> Motion:
    """Compute rotations of the 20 canonical joints that reproduce positions as well as rigid bones can.

    Bones have their median lengths; the root is the pelvis.

    Parameters
    ----------
    motion : trajectories of any skeleton or marker set (they are canonicalised), or a canonical motion.

    Raises
    ------
    JointMappingError : trajectories that cannot be canonicalised, or a part of a body.
    """
    canonical = require_whole(motion if isinstance(motion, CanonicalMotion) else canonicalise(motion))
    return fit_points(canonical.positions, canonical.frame_rate)


def fit_points(points: FloatArray, frame_rate: float) -> Motion:
    """Compute the rotations of `fit_motion` from canonical joints (T, 20, 3), m, Y up; Hz."""
    frames = {
        J["pelvis"]: _frames(points, "left_hip", "right_hip", "pelvis", "spine"),
        J["spine"]: _frames(points, "left_shoulder", "right_shoulder", "spine", "neck"),
        J["neck"]: _frames(points, "left_shoulder", "right_shoulder", "spine", "neck"),
    }
    offsets = _median_offsets(points, frames)
    rotations = _aim(points, offsets, frames)
    translations = np.tile(offsets, (len(points), 1, 1))
    translations[:, J["pelvis"]] = points[:, J["pelvis"]]
    skeleton = Skeleton(CANONICAL_JOINTS, np.array(CANONICAL_PARENTS), offsets)
    return Motion(skeleton, rotations, translations, frame_rate)


def _unit(vectors: FloatArray, instead: tuple[float, float, float]) -> FloatArray:
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.where(length > 1e-9, vectors / np.where(length > 1e-9, length, 1.0), instead)


def _frames(points: FloatArray, left: str, right: str, low: str, high: str) -> FloatArray:
    """Rotations (T, 3, 3) whose columns are left, up and front of a part of the trunk."""
    up = _unit(points[:, J[high]] - points[:, J[low]], (0.0, 1.0, 0.0))
    front = _unit(np.cross(points[:, J[left]] - points[:, J[right]], up), (0.0, 0.0, 1.0))
    return np.stack((np.cross(up, front), up, front), axis=-1)


def _median_offsets(points: FloatArray, frames: dict[int, FloatArray]) -> FloatArray:
    """Offsets (20, 3) m: median bone lengths; where a joint carries three bones, medians in its own frame."""
    offsets = np.zeros((len(CANONICAL_JOINTS), 3))
    for joint, parent in enumerate(CANONICAL_PARENTS):
        if parent < 0:
            continue
        bones = points[:, joint] - points[:, parent]
        length = np.median(np.linalg.norm(bones, axis=1))
        direction = np.array(_REST.get(CANONICAL_JOINTS[joint], (0.0, 0.0, 0.0)))
        if not direction.any():
            direction = np.median(np.einsum("tij,ti->tj", frames[parent], bones), axis=0)
            direction = _unit(direction, (0.0, 1.0, 0.0))
        offsets[joint] = length * direction
    return offsets


def _aim(points: FloatArray, offsets: FloatArray, frames: dict[int, FloatArray]) -> FloatArray:
    """Local rotations (T, 20, 4), from the root outwards."""
    n_frames = len(points)
    world = identity((n_frames, len(CANONICAL_JOINTS)))
    rotations = identity((n_frames, len(CANONICAL_JOINTS)))
    places = np.empty_like(points)
    for joint, parent in enumerate(CANONICAL_PARENTS):
        before = identity((n_frames,)) if parent < 0 else world[:, parent]
        places[:, joint] = points[:, joint] if parent < 0 else places[:, parent] + rotate(before, offsets[joint])
        children = _CHILDREN[joint]
        wanted = points[:, children] - places[:, joint, None]
        if not children:
            world[:, joint] = before
        elif len(children) > 1:
            world[:, joint] = _best_rotation(offsets[children], wanted)
        else:
            start = from_matrix(frames[joint]) if joint in frames else before
            swing = between(rotate(start, offsets[children[0]]), wanted[:, 0])
            world[:, joint] = multiply(swing, start)
        rotations[:, joint] = multiply(conjugate(before), world[:, joint])
    return rotations


def _best_rotation(offsets: FloatArray, wanted: FloatArray) -> FloatArray:
    """Least-squares unit quaternions (T, 4) that turn (n, 3) offsets into (T, n, 3) vectors."""
    u, _, vt = np.linalg.svd(np.einsum("tni,nj->tij", wanted, offsets))
    sign = np.linalg.det(u @ vt)
    u[:, :, 2] *= np.where(sign < 0, -1.0, 1.0)[:, None]
    return from_matrix(u @ vt)
