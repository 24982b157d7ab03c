"""Reading of npz files by content: dousa's own motion, SMPL poses, or positions of joints."""

from __future__ import annotations

import os
from typing import Any

from dousa.errors import MotionFileError
from dousa.files.npz_arrays import NpzFile, open_npz
from dousa.formats.arrays.joints import build_joints, find_joints, is_joint_array
from dousa.formats.npz import read_npz
from dousa.formats.smpl import build_smpl, find_poses
from dousa.messages import Message
from dousa.motion import Motion, Trajectories

_MOST_BYTES = 1_000_000_000
_RATES = ("frame_rate", "fps", "framerate", "mocap_framerate", "mocap_frame_rate")


def read_any_npz(
    path: str | os.PathLike[str],
    *,
    unit: float | str | None = None,
    up: str | None = None,
    skeleton: str | os.PathLike[str] | None = None,
    frame_rate: float | None = None,
) -> Motion | Trajectories:
    """Read an npz file; its kind follows from its arrays.

    Parameters
    ----------
    path : a file that dousa wrote, one of SMPL poses (AMASS), or one with an array (T, J, 3) of joints.
    unit, up : if not in the file; dousa's own has both.
    skeleton : body model of SMPL poses.
    frame_rate : Hz, of arrays without one.

    Raises
    ------
    MotionFileError : missing, damaged, or none of these.
    """

    def fail(message: Message) -> MotionFileError:
        return MotionFileError(path, message)

    with open_npz(path, fail) as file:
        if find_poses(file.names):
            return build_smpl(path, lambda name: _read(file, name), unit=unit, up=up, skeleton=skeleton,
                              frame_rate=frame_rate)  # fmt: skip
        name = None if "format" in file else find_joints(_shapes(file))
        if name is None:
            return read_npz(path, unit=unit, up=up)
        points = file.read(name, "iuf", most=_MOST_BYTES)
        rate = frame_rate
        for key in _RATES:
            if rate is None and key in file:
                given = _read(file, key)
                rate = float(given.reshape(-1)[0]) if given is not None and given.size == 1 else None
        names = next((file.read_texts(key) for key in ("joint_names", "names") if _is_text(file, key)), None)
    return build_joints(path, "npz", points, unit=unit, up=up, frame_rate=rate, names=names)


def _read(file: NpzFile, name: str) -> Any:
    if name not in file:
        return None
    with file.open(name) as (header, _):
        if header.dtype.kind not in "iuf":
            return None
    return file.read(name, "iuf", most=_MOST_BYTES)


def _is_text(file: NpzFile, name: str) -> bool:
    if name not in file:
        return False
    with file.open(name) as (header, _):
        return header.dtype.kind == "U" and len(header.shape) == 1


class _Shape:
    """Shape of an unread array, for `find_joints`."""

    def __init__(self, shape: tuple[int, ...], kind: str) -> None:
        self.shape, self.is_joints = shape, kind in "iuf" and is_joint_array(shape)


def _shapes(file: NpzFile) -> dict[str, Any]:
    shapes = {}
    for name in file.names:
        try:
            with file.open(name) as (header, _):
                shapes[name] = _Shape(header.shape, header.dtype.kind)
        except MotionFileError:  # an array of objects, such as names
            continue
    return {name: shape for name, shape in shapes.items() if shape.is_joints}
