"""Poses of SMPL, SMPL-H and SMPL-X: AMASS npz, AIST++ pickles, and similar files.

AMASS (Mahmood et al., AMASS: Archive of motion capture as surface shapes, ICCV 2019): ``poses`` (T, 156 or 165)
axis-angle rotations in rad, ``trans`` (T, 3) m, Z up, ``mocap_framerate``, ``betas``. AIST++ (Li et al., AI
choreographer, ICCV 2021): ``smpl_poses`` (T, 72), ``smpl_trans`` (T, 3), ``smpl_scaling``: metres are trans / scaling,
Y up, 60 Hz.

The joints are those of the mean body, or of the user's body model (`--read skeleton=FILE`) with the ``betas``.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import FloatArray
from dousa.errors import MotionFileError
from dousa.files.npz_arrays import NpzFile, open_npz
from dousa.formats.poses import settle_motion
from dousa.formats.smpl.body import JOINTS_OF, mean_body, model_body
from dousa.messages import Message
from dousa.motion import Motion
from dousa.motion.rotations import from_axis_angle

_POSES = ("poses", "smpl_poses", "fullpose", "pose", "body_pose", "pose_body")
_PARTS = (
    ("root_orient", "pose_body", "pose_hand"),
    ("global_orient", "body_pose"),
    ("root_orient", "pose_body"),
)
_PLACES = ("trans", "smpl_trans", "transl", "translation")
_RATES = ("mocap_framerate", "mocap_frame_rate", "frame_rate", "framerate", "fps")
AIST_RATE, _USUAL_RATE = 60.0, 30.0
_MOST_BYTES = 1_000_000_000

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

    def fail(message: Message) -> MotionFileError:
        return MotionFileError(path, message)

    with open_npz(path, fail) as file:
        return build_smpl(path, _numbers_of(file), unit=unit, up=up, skeleton=skeleton, frame_rate=frame_rate)


def _numbers_of(file: NpzFile) -> Get:
    def get(name: str) -> NDArray[Any] | None:
        return file.read(name, "iuf", most=_MOST_BYTES) if name in file else None

    return get


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
        rate = _USUAL_RATE if scaling is None else AIST_RATE
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
