"""Writing of a VMD file: a key of every bone in every frame, legs by their turns, with IK switched off.

The motion is put onto the mean body (template.toml) first, unless it has the bones of MMD already. Place and turn of
the root, which many models do not have, go where all have them: the place into センター, the turn into 上半身 and
下半身.
"""

from __future__ import annotations

import os
import struct

import numpy as np

from dousa.arrays import FloatArray
from dousa.errors import JointMappingError, MotionWriteError
from dousa.files.disk import atomic_write
from dousa.formats.assembly import add_ends
from dousa.formats.mmd.models import template
from dousa.formats.mmd.reading import UNIT, build_skeleton, list_kept
from dousa.formats.mmd.vmd import encode_keys
from dousa.motion import Motion, Skeleton, forward_kinematics, resample
from dousa.motion.kinematics import compute_rest_positions
from dousa.motion.rotations import identity

RATE = 30.0
"""Hz of the frames of a VMD file, by the definition of the format."""

_IK = ("左足ＩＫ", "右足ＩＫ", "左つま先ＩＫ", "右つま先ＩＫ")
_HALVES = ("上半身", "下半身")


def write_vmd(motion: Motion, path: str | os.PathLike[str]) -> None:
    """Write a motion of the standard bones of MikuMikuDance, at 30 Hz, for models of any size.

    Parameters
    ----------
    motion : of any whole body; one with the bones of MMD, such as `read_vmd` returns, keeps its turns.
    path : ending in ``.vmd``.

    Raises
    ------
    MotionWriteError : joints that cannot be mapped, missing rotations, a disk error.
    """
    if not all(name in motion.skeleton.names for name in (*_HALVES, "左足", "右足", "左腕", "右腕")):
        motion = _put_onto_template(motion, path)
    motion = resample(motion, RATE)
    if not (np.isfinite(motion.rotations).all() and np.isfinite(motion.translations[:, 0]).all()):
        raise MotionWriteError(path, "mmd.gaps")
    data = encode_keys("dousa", _list_keys(motion))
    # No faces, camera, lights and shadows; then the model shown, with IK off, from the first frame on.
    data += struct.pack("<4I", 0, 0, 0, 0) + struct.pack("<IIBI", 1, 0, 1, len(_IK))
    data += b"".join(struct.pack("<20sB", name.encode("cp932"), 0) for name in _IK)
    with atomic_write(path) as file:
        file.write(data)


def _put_onto_template(motion: Motion, path: str | os.PathLike[str]) -> Motion:
    from dousa.motion import retarget

    model = template()
    body, ends = build_skeleton(model, list_kept(model))
    whole, _, _ = add_ends(body, identity((1, body.n_joints)), body.offsets[None], ends)
    skeleton = Skeleton(whole.names, whole.parents, whole.offsets * UNIT, whole.end_sites)
    character = Motion(skeleton, identity((1, skeleton.n_joints)), skeleton.offsets[None], motion.frame_rate)
    try:
        return retarget(motion, character).motion
    except JointMappingError as error:
        raise MotionWriteError(path, "mmd.other_skeleton", reason=error.problem) from error


def _list_keys(motion: Motion) -> dict[str, tuple[FloatArray, FloatArray]]:
    """By bone: places (T, 3) moved from rest in units of MMD, and turns (T, 4); one row where a bone never moves."""
    skeleton = motion.skeleton
    positions, world = forward_kinematics(skeleton.parents, motion.rotations, motion.translations)
    upper = skeleton.names.index(_HALVES[0])
    moved = (positions[:, upper] - compute_rest_positions(skeleton)[upper]) / UNIT
    keys = {"センター": (moved, identity((len(moved),)))}
    for joint, name in enumerate(skeleton.names):
        if skeleton.end_sites[joint] or skeleton.parents[joint] < 0:
            continue
        turns = world[:, joint] if name in _HALVES else motion.rotations[:, joint]
        if np.ptp(turns, axis=0).max() == 0:
            turns = turns[:1]
        keys[name] = (np.zeros((len(turns), 3)), turns)
    return keys
