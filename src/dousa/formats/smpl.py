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
from collections.abc import Iterable, Mapping
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
from dousa.formats.guard import Clock
from dousa.formats.smpl_poses import JOINTS_OF, Get, Rotations, bare_name, find_roles, read_rotations
from dousa.messages import Message
from dousa.motion import Motion, Skeleton, Trajectories
from dousa.motion.canonical.recipes import JointMap
from dousa.motion.canonical.reference_frame import ReferenceFrame, from_reference_frame
from dousa.motion.rotations import identity, rotate, to_axis_angle

if TYPE_CHECKING:
    from dousa.motion.retargeting import Retargeted


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


_RATES = ("mocap_framerate", "mocap_frame_rate", "frame_rate", "framerate", "fps")
AIST_RATE = 60.0
"""Hz of AIST++ (Li et al., ICCV 2021)."""


def build_smpl(
    path: str | os.PathLike[str],
    get: Get,
    names: Iterable[str],
    *,
    unit: float | str | None,
    up: str | None,
    skeleton: str | os.PathLike[str] | None,
    frame_rate: float | None,
    default_up: str | None = "z",
    notes: tuple[Message, ...] = (),
    turns: FloatArray | None = None,
) -> Motion:
    """Build the motion of SMPL poses.

    Parameters
    ----------
    path : for messages and provenance.
    get : returns the array of a name, or None.
    names : of the arrays.
    unit, up : of the file; by default metres, and the axis along which the body stands.
    skeleton : body model file in npz form; by default the mean body, whatever the file's ``betas``.
    frame_rate, notes : Hz, if not in the file; for the user, on the reading.
    default_up : usual in such files, for those without AIST++'s scaling.
    turns : (T, J, 4) rotations, if they have been read.

    Raises
    ------
    MotionFileError : no poses, arrays that do not fit each other.
    """
    roles = find_roles(names)
    rotations = _read_poses(path, get, roles, turns)
    n_frames, n_joints = rotations.shape[:2]
    betas = get(roles.get("betas", ""))
    if betas is not None:
        betas = betas.reshape(-1, betas.shape[-1])[0].astype(np.float64) if betas.ndim and betas.size else None
    if skeleton is not None:
        tree = model_body(skeleton, n_joints, betas)
    else:
        tree = mean_body(n_joints)
        notes = (*notes, Message("smpl.mean_body", model=JOINTS_OF[n_joints]))
    scaling = get(roles.get("scaling", ""))
    rate = frame_rate or read_rate(get)
    if rate is None:
        rate = 30.0 if scaling is None else AIST_RATE
        notes = (*notes, Message("arrays.assumed_rate", rate=rate))
    found = get(roles.get("places", ""))
    if found is None and n_frames > 1:
        notes = (*notes, Message("smpl.no_places"))
    places = _read_places(path, found, n_frames, scaling)
    numbers = get(roles.get("numbers", ""))
    numbers = numbers.reshape(-1).astype(np.float64) if numbers is not None and numbers.size == n_frames else None
    translations = np.tile(tree.offsets, (n_frames, 1, 1))
    with np.errstate(over="ignore", invalid="ignore"):
        # EasyMocap turns the whole body about the origin, the pelvis too.
        turned = bare_name(roles.get("root", "")) == "rh"
        translations[:, 0] = (rotate(rotations[:, 0], tree.offsets[0]) if turned else tree.offsets[0]) + places
    return settle_motion(
        path, "smpl", tree, rotations, translations, Clock(rate, None, numbers),
        unit=unit, up=up, unit_in_file=1.0, default_up=default_up if scaling is None else "y", rest_in_world=False,
        notes=notes,
    )  # fmt: skip


def _read_poses(
    path: str | os.PathLike[str], get: Get, roles: Mapping[str, str], turns: FloatArray | None
) -> FloatArray:
    """(T, J, 4) local rotations of 22, 24, 52 or 55 joints."""
    with np.errstate(over="ignore", invalid="ignore"):
        read = read_rotations(get, roles) if turns is None else Rotations(turns)
    if read.turns is None and read.found:
        known = tuple(form * count for form in (3, 6, 9) for count in JOINTS_OF)
        raise MotionFileError(path, "smpl.width", found=read.found, known=known)
    if read.turns is None:
        raise MotionFileError(path, "smpl.no_poses", found=())
    if not np.isfinite(read.turns).all():
        raise MotionFileError(path, "smpl.not_finite")
    return read.turns


def _read_places(
    path: str | os.PathLike[str], places: NDArray[Any] | None, n_frames: int, scaling: NDArray[Any] | None
) -> FloatArray:
    """(T, 3) m."""
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
