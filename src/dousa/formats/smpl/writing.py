"""Writing of AMASS-like npz: poses of SMPL-H, for methods of machine learning that read AMASS."""

from __future__ import annotations

import os

import numpy as np

from dousa.arrays import FloatArray
from dousa.errors import JointMappingError, MotionWriteError
from dousa.files.disk import atomic_write
from dousa.formats.smpl.body import mean_body
from dousa.motion import Motion, Trajectories, retarget
from dousa.motion.canonical.recipes import JointMap
from dousa.motion.canonical.reference_frame import ReferenceFrame, from_reference_frame
from dousa.motion.retargeting import Retargeted
from dousa.motion.rotations import identity, to_axis_angle

_JOINTS = 52
_BETAS = 16


def write_amass(motion: Motion, path: str | os.PathLike[str]) -> None:
    """Write SMPL poses as AMASS has them: ``poses`` (T, 156), ``trans``, ``betas``, ``gender``; Z up.

    A motion of another skeleton is put onto that of the mean body first (`dousa.motion.retarget`); missing hands do not
    move.

    Raises
    ------
    MotionWriteError : joints that cannot be mapped, missing rotations, a disk error.
    """
    body = mean_body(_JOINTS)
    if not is_smpl(motion):
        try:
            motion = put_onto_smpl(motion).motion
        except JointMappingError as error:
            raise MotionWriteError(path, "smpl.other_skeleton", reason=error.problem) from error
    names = motion.skeleton.names
    if not (np.isfinite(motion.rotations).all() and np.isfinite(motion.translations[:, 0]).all()):
        raise MotionWriteError(path, "smpl.gaps")
    turned = from_reference_frame(motion, ReferenceFrame(up="z"))
    poses = np.zeros((motion.n_frames, _JOINTS, 3))
    vectors: FloatArray = to_axis_angle(turned.rotations)
    for joint, name in enumerate(body.names):
        if name in names:
            poses[:, joint] = vectors[:, names.index(name)]
    with atomic_write(path) as file:
        np.savez(
            file,
            allow_pickle=False,
            poses=poses.reshape(motion.n_frames, -1),
            # Readers put the pelvis at its place in the mean body plus this.
            trans=turned.translations[:, 0] - body.offsets[0],
            betas=np.zeros(_BETAS),
            dmpls=np.zeros((motion.n_frames, 8)),
            gender=np.array("neutral"),
            mocap_framerate=np.array(float(motion.frame_rate)),
        )


def put_onto_smpl(motion: Motion | Trajectories, joint_map: JointMap | None = None) -> Retargeted:
    """Retarget a whole body to the mean body of SMPL; ``joint_map`` : canonical joint -> name in the motion.

    JointMappingError for joints that cannot be mapped, or a part of a body.
    """
    skeleton = mean_body(22)
    still = identity((1, skeleton.n_joints))
    character = Motion(skeleton, still, skeleton.offsets[None], motion.frame_rate)
    return retarget(motion, character, joint_map=joint_map)


def is_smpl(motion: Motion) -> bool:
    """Return whether the joints of a motion are those of SMPL, with its tree."""
    body, skeleton = mean_body(22), motion.skeleton
    if skeleton.names[0] != body.names[0] or any(name not in skeleton.names for name in body.names):
        return False
    places = [skeleton.names.index(name) for name in body.names]
    return all(
        skeleton.parents[place] == (places[parent] if parent >= 0 else -1)
        for place, parent in zip(places, body.parents, strict=True)
    )
