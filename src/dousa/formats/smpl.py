"""Poses of SMPL, SMPL-H and SMPL-X: the bodies, and AMASS npz, AIST++ pickles and similar files.

AMASS (Mahmood et al., AMASS: Archive of motion capture as surface shapes, ICCV 2019): ``poses`` (T, 156 or 165)
axis-angle rotations in rad, ``trans`` (T, 3) m, Z up, ``mocap_framerate``, ``betas``. AIST++ (Li et al., AI
choreographer, ICCV 2021): ``smpl_poses`` (T, 72), ``smpl_trans`` (T, 3), ``smpl_scaling``: metres are trans / scaling,
Y up, 60 Hz.

The joints are those of the mean body, or of the user's body model (`--read skeleton=FILE`) with the ``betas``.
"""

from __future__ import annotations

import os
import tomllib
from collections.abc import Callable, Mapping
from functools import lru_cache, partial
from importlib import resources
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import FloatArray
from dousa.errors import JointMappingError, MotionFileError, MotionWriteError
from dousa.files.disk import atomic_write
from dousa.files.npz_arrays import open_npz
from dousa.formats.assembly import rest_offsets, settle_motion
from dousa.messages import Message
from dousa.motion import Motion, Skeleton, Trajectories
from dousa.motion.canonical.recipes import JointMap
from dousa.motion.canonical.reference_frame import ReferenceFrame, from_reference_frame
from dousa.motion.rotations import from_axis_angle, identity, to_axis_angle

if TYPE_CHECKING:
    from dousa.motion.retargeting import Retargeted

JOINTS_OF = {22: "SMPL", 24: "SMPL", 52: "SMPL-H", 55: "SMPL-X"}
"""Model by its number of joints, by the definition of each; 22 are SMPL's without the hands."""


@lru_cache(maxsize=4)
def mean_body(n_joints: int) -> Skeleton:
    """Return the skeleton of the mean body with 22, 24 (SMPL), 52 (SMPL-H) or 55 (SMPL-X) joints.

    Offsets in m; the root's is the pelvis of the unmoved model.
    """
    table: dict[str, Any] = tomllib.loads(resources.files(__package__).joinpath("smpl_body.toml").read_text("utf-8"))
    rows = list(table["body"])
    if n_joints == 24:
        rows += table["smpl_hands"]
    if n_joints == 55:
        rows += table["face"]
    if n_joints >= 52:
        for side, sign in (("left", 1.0), ("right", -1.0)):
            for name, parent, (x, y, z) in table["fingers"]:
                rows.append([f"{side}_{name}", f"{side}_{parent}", [sign * x, y, z]])
    names = [row[0] for row in rows]
    parents = np.array([names.index(row[1]) if row[1] else -1 for row in rows], np.intp)
    return Skeleton(tuple(names), parents, np.array([row[2] for row in rows]))


def model_body(path: str | os.PathLike[str], n_joints: int, betas: FloatArray | None) -> Skeleton:
    """Build the skeleton of a body model file in npz form, for a body shape.

    Parameters
    ----------
    path : npz with ``v_template`` (V, 3), ``shapedirs`` (V, 3, B), ``J_regressor`` (J, V), as for SMPL-H and SMPL-X;
        SMPL's pickles must be converted first.
    n_joints : of the poses; the model may have more.
    betas : (B',) shape; None for the mean body.

    Raises
    ------
    MotionFileError : no such file, arrays that are missing or do not fit.
    """
    fail = partial(MotionFileError, path)
    if os.fspath(path).lower().endswith(".pkl"):
        raise fail(Message("smpl.model_pickle"))
    with open_npz(path, fail) as file:
        arrays: dict[str, NDArray[Any]] = {}
        for name, ndim in (("v_template", 2), ("shapedirs", 3), ("J_regressor", 2)):
            if name not in file:
                raise fail(Message("smpl.model_lacks", array=name))
            arrays[name] = file.read(name, "f", ndim, 2_000_000_000)  # the shapes of SMPL-X take 100 MB
    template, shapes, regressor = arrays["v_template"], arrays["shapedirs"], arrays["J_regressor"]
    mean = mean_body(n_joints)
    fits = template.shape[1:] == (3,) and shapes.shape[:2] == template.shape and regressor.shape[1] == len(template)
    if not fits or len(regressor) < n_joints:
        raise fail(Message("smpl.model_shape", joints=n_joints, found=len(regressor)))
    # The joints are linear in the shape: no vertex needs to be moved.
    joints = regressor @ template
    if betas is not None:
        count = min(len(betas), shapes.shape[2])
        joints = joints + np.tensordot(np.tensordot(regressor, shapes[..., :count], (1, 0)), betas[:count], (2, 0))
    joints = joints[:n_joints].astype(np.float64)
    if not np.isfinite(joints).all():
        raise fail(Message("smpl.model_shape", joints=n_joints, found=len(regressor)))
    return Skeleton(mean.names, mean.parents, rest_offsets(mean.parents.tolist(), joints))


_POSES = ("poses", "smpl_poses", "fullpose", "pose", "body_pose", "pose_body")
_PARTS = (
    ("root_orient", "pose_body", "pose_hand"),
    ("global_orient", "body_pose"),
    ("root_orient", "pose_body"),
)
_PLACES = ("trans", "smpl_trans", "transl", "translation")
_RATES = ("mocap_framerate", "mocap_frame_rate", "frame_rate", "framerate", "fps")
AIST_RATE = 60.0
"""Hz of AIST++ (Li et al., ICCV 2021)."""

Get = Callable[[str], NDArray[Any] | None]


def find_poses(names: Mapping[str, Any] | tuple[str, ...]) -> bool:
    """Return whether the names of some arrays are those of SMPL poses."""
    return any(name in names for name in _POSES) or any(all(part in names for part in parts) for parts in _PARTS)


def read_smpl_npz(
    path: str | os.PathLike[str],
    *,
    unit: float | str | None = None,
    up: str | None = None,
    skeleton: str | os.PathLike[str] | None = None,
    frame_rate: float | None = None,
) -> Motion:
    """Read an npz file of SMPL poses, such as those of AMASS, over the 22 to 55 joints of the model.

    Parameters
    ----------
    path : the file.
    unit : metres per unit; by default metres.
    up : axis that points up; by default Z unless the body stands along another.
    skeleton : body model file in npz form; by default the mean body, whatever the file's ``betas``.
    frame_rate : Hz, if not in the file.

    Raises
    ------
    MotionFileError : missing, damaged, no poses, arrays that do not fit each other.
    """
    with open_npz(path, partial(MotionFileError, path)) as file:

        def get(name: str) -> NDArray[Any] | None:
            return file.read(name, "iuf", most=1_000_000_000) if name in file else None

        return build_smpl(path, get, unit=unit, up=up, skeleton=skeleton, frame_rate=frame_rate)


def build_smpl(
    path: str | os.PathLike[str],
    get: Get,
    *,
    unit: float | str | None,
    up: str | None,
    skeleton: str | os.PathLike[str] | None,
    frame_rate: float | None,
) -> Motion:
    """Build the motion of SMPL poses.

    Parameters
    ----------
    path : for messages and provenance.
    get : returns the array of a name, or None.
    unit, up, skeleton, frame_rate : as for `read_smpl_npz`.
    """
    poses = _read_poses(path, get)
    n_frames, n_joints = poses.shape[:2]
    notes = []
    betas = get("betas")
    betas = None if betas is None or betas.size == 0 else np.atleast_2d(betas)[0].astype(np.float64)
    if skeleton is not None:
        tree = model_body(skeleton, n_joints, betas)
    else:
        tree = mean_body(n_joints)
        notes.append(Message("smpl.mean_body", model=JOINTS_OF[n_joints]))
    scaling = get("smpl_scaling")
    rate = frame_rate or read_rate(get)
    if rate is None:
        rate = 30.0 if scaling is None else AIST_RATE
        notes.append(Message("arrays.assumed_rate", rate=rate))
    places = _read_places(path, get, n_frames, scaling)
    translations = np.tile(tree.offsets, (n_frames, 1, 1))
    with np.errstate(over="ignore", invalid="ignore"):
        translations[:, 0] += places
        rotations = from_axis_angle(poses)
    if not np.isfinite(poses).all():
        raise MotionFileError(path, "smpl.not_finite")
    return settle_motion(
        path, "smpl", tree, rotations, translations, rate,
        unit=unit, up=up, unit_in_file=1.0, default_up="z" if scaling is None else "y", rest_in_world=False,
        notes=tuple(notes),
    )  # fmt: skip


def _read_poses(path: str | os.PathLike[str], get: Get) -> FloatArray:
    """(T, J, 3) rotation vectors of 22, 24, 52 or 55 joints."""
    found = None
    for parts in _PARTS:
        arrays = [get(part) for part in parts]
        present = [array for array in arrays if array is not None]
        if len(present) == len(parts) and len({len(array) for array in present if array.ndim}) == 1:
            found = np.concatenate([array.reshape(len(array), -1) for array in present], axis=1)
            break
    if found is None:
        found = next((array for array in map(get, _POSES) if array is not None), None)
    if found is None or found.ndim not in (2, 3) or 0 in found.shape:
        raise MotionFileError(path, "smpl.no_poses", found=())
    flat = found.reshape(len(found), -1)
    width = flat.shape[1]
    if width == 63:  # a body without its root, which then does not turn
        flat, width = np.concatenate((np.zeros((len(flat), 3)), flat), axis=1), 66
    if width % 3 or width // 3 not in JOINTS_OF:
        raise MotionFileError(path, "smpl.width", found=width, known=tuple(3 * count for count in JOINTS_OF))
    return flat.reshape(len(flat), -1, 3).astype(np.float64)


def _read_places(path: str | os.PathLike[str], get: Get, n_frames: int, scaling: NDArray[Any] | None) -> FloatArray:
    """(T, 3) m."""
    places = next((array for array in map(get, _PLACES) if array is not None), None)
    if places is None:
        return np.zeros((n_frames, 3))
    if places.shape not in ((n_frames, 3), (n_frames, 1, 3)):
        raise MotionFileError(path, "smpl.places", found=str(places.shape), frames=n_frames)
    places = places.reshape(n_frames, 3).astype(np.float64)
    if scaling is None:
        return places
    scale = float(scaling.reshape(-1)[0]) if scaling.size else 0.0
    if not 0 < scale < np.inf:
        raise MotionFileError(path, "smpl.scaling", found=repr(scale))
    return places / scale


def read_rate(get: Get) -> float | None:
    """Read the rate in Hz, under one of its names in files of poses."""
    for name in _RATES:
        array = get(name)
        if array is not None and array.size == 1 and 0 < float(array.reshape(-1)[0]) <= 1e6:
            return float(array.reshape(-1)[0])
    return None


def write_amass(motion: Motion, path: str | os.PathLike[str]) -> None:
    """Write SMPL poses as AMASS has them: ``poses`` (T, 156), ``trans``, ``betas``, ``gender``; Z up.

    A motion of another skeleton is put onto that of the mean body first (`dousa.motion.retarget`); missing hands do not
    move.

    Raises
    ------
    MotionWriteError : joints that cannot be mapped, missing rotations, a disk error.
    """
    n_joints, n_betas = 52, 16  # of SMPL-H in AMASS
    body = mean_body(n_joints)
    if not is_smpl(motion):
        try:
            motion = put_onto_smpl(motion).motion
        except JointMappingError as error:
            raise MotionWriteError(path, "smpl.other_skeleton", reason=error.problem) from error
    names = motion.skeleton.names
    if not (np.isfinite(motion.rotations).all() and np.isfinite(motion.translations[:, 0]).all()):
        raise MotionWriteError(path, "smpl.gaps")
    turned = from_reference_frame(motion, ReferenceFrame(up="z"))
    poses = np.zeros((motion.n_frames, n_joints, 3))
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
            betas=np.zeros(n_betas),
            dmpls=np.zeros((motion.n_frames, 8)),
            gender=np.array("neutral"),
            mocap_framerate=np.array(float(motion.frame_rate)),
        )


def put_onto_smpl(motion: Motion | Trajectories, joint_map: JointMap | None = None) -> Retargeted:
    """Retarget a whole body to the mean body of SMPL; ``joint_map`` : canonical joint -> name in the motion.

    JointMappingError for joints that cannot be mapped, or a part of a body.
    """
    from dousa.motion import retarget

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
