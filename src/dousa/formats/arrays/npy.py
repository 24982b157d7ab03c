"""An npy file: joint positions, rows of features, or a pickled dictionary of motions."""

from __future__ import annotations

import os
import re
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dousa.errors import MotionFileError
from dousa.files.disk import read_bytes
from dousa.files.pickles import load_pickle
from dousa.formats.arrays.features import FEATURES, MOTION_X, recover_joints
from dousa.formats.arrays.joints import build_joints, is_joint_array
from dousa.formats.arrays.pickles import build_content
from dousa.formats.parts import load_once
from dousa.formats.smpl import build_smpl
from dousa.motion import Motion, Trajectories

_MAGIC = b"\x93NUMPY"
_HEADER = re.compile(
    r"\{'descr': '([<>|=]?[iuf]\d{1,2}|\|O)', 'fortran_order': (True|False), 'shape': \(([\d, ]{0,200})\), ?\}\s*"
)


def read_npy(
    path: str | os.PathLike[str],
    *,
    unit: float | str | None = None,
    up: str | None = None,
    skeleton: str | os.PathLike[str] | None = None,
    frame_rate: float | None = None,
    person: str | None = None,
    animation: str | None = None,
) -> Motion | Trajectories:
    """Read an npy file: joint positions (T, J, 3), features of HumanML3D or Motion-X, or a dictionary of motions.

    Parameters
    ----------
    path : the file; nothing in it is executed.
    unit, up : by default inferred from the body.
    skeleton : body model of SMPL poses.
    frame_rate : Hz; by default that of the data set whose joints these are.
    person, animation : of a dictionary of motions, as for `read_pickle`.

    Raises
    ------
    MotionFileError : missing, damaged, another shape, an unknown number of joints, objects that are no plain values.
    """
    content, array = load_once(_load, path, person or animation)
    options: dict[str, Any] = {"unit": unit, "up": up, "frame_rate": frame_rate}
    if content is not None:
        return build_content(path, content, skeleton=skeleton, person=person, animation=animation, **options)
    if array.ndim == 2 and array.shape[1] == MOTION_X:
        arrays = {"poses": array[:, :156], "trans": array[:, 309:312], "betas": array[:, 312:]}
        return build_smpl(path, arrays.get, arrays, skeleton=skeleton, default_up="y", **options)
    if array.ndim == 2:
        array = recover_joints(path, array)
    return build_joints(path, "npy", array, **options)


def _load(path: str | os.PathLike[str]) -> tuple[dict[Any, Any] | None, NDArray[Any]]:
    """The dictionary of a file of objects, or of samples; else the array, without axes of length 1 if of features."""
    data = read_bytes(path)
    if data[:6] != _MAGIC or len(data) < 12:
        raise MotionFileError(path, "arrays.no_npy")
    start = 12 if data[6] >= 2 else 10
    end = start + int.from_bytes(data[8:start], "little")
    header = _HEADER.fullmatch(data[start : min(end, 10_000)].decode("latin-1"))
    if header is None:
        raise MotionFileError(path, "arrays.not_plain")
    if header[1] == "|O":
        return load_pickle(path, data[end:]), np.empty(0)
    try:
        dtype = np.dtype(header[1])
    except TypeError:
        raise MotionFileError(path, "arrays.not_plain") from None
    shape = tuple(int(axis) for axis in header[3].replace(" ", "").split(",") if axis)
    trimmed = tuple(axis for axis in shape if axis != 1)
    rows = len(trimmed) == 2 and trimmed[1] in (*FEATURES, MOTION_X)
    samples = len(trimmed) == 4 and is_joint_array(trimmed[1:])
    if len(shape) == 4 and shape[3] == 2:
        raise MotionFileError(path, "guard.flat")
    if not (rows or samples or is_joint_array(shape) or is_joint_array((*shape[:-1], 3 * (shape[-1:] == (4,))))):
        raise MotionFileError(path, "arrays.shape", found=str(shape))
    if int(np.prod(shape, dtype=object)) * dtype.itemsize != len(data) - end:
        raise MotionFileError(path, "arrays.size", shape=str(shape), found=len(data) - end)
    array = np.frombuffer(data, dtype, offset=end).reshape(shape, order="F" if header[2] == "True" else "C")
    if samples:
        _refuse_pixels(path, array)
        return {"motion": array.reshape(trimmed)}, array
    return None, array.reshape(trimmed) if rows else array


def _refuse_pixels(path: str | os.PathLike[str], array: NDArray[Any], far: float = 100.0) -> None:
    """Raise MotionFileError for points in pictures of several cameras, as FreeMoCap saves them, with MediaPipe's z.

    ``far`` : of x or y, of which none is below 0: no data set in metres has such places, and every picture.
    """
    low, high = (reduce(array[..., :2], axis=None) for reduce in (np.fmin.reduce, np.fmax.reduce))
    if low >= 0 and high > far:
        raise MotionFileError(path, "guard.flat")
