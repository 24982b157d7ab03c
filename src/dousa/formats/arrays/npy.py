"""An npy file: joint positions, rows of features, or a pickled dictionary of motions."""

from __future__ import annotations

import os
import re
from typing import Any

import numpy as np

from dousa.errors import MotionFileError
from dousa.files.disk import read_bytes
from dousa.files.pickles import load_pickle
from dousa.formats.arrays.pickles import build_content
from dousa.formats.parts import load_once
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
    """Read an npy file: joint positions or SMPL poses, features of HumanML3D or Motion-X, or a dictionary of motions.

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
    return build_content(
        path, load_once(_load, path, person or animation), unit=unit, up=up, skeleton=skeleton,
        frame_rate=frame_rate, person=person, animation=animation,
    )  # fmt: skip


def _load(path: str | os.PathLike[str]) -> dict[Any, Any]:
    """The dictionary of a file of objects; else the array under the name ""."""
    data = read_bytes(path)
    if data[:6] != _MAGIC or len(data) < 12:
        raise MotionFileError(path, "arrays.no_npy")
    start = 12 if data[6] >= 2 else 10
    end = start + int.from_bytes(data[8:start], "little")
    header = _HEADER.fullmatch(data[start : min(end, 10_000)].decode("latin-1"))
    if header is None:
        raise MotionFileError(path, "arrays.not_plain")
    if header[1] == "|O":
        return load_pickle(path, data[end:])
    try:
        dtype = np.dtype(header[1])
    except TypeError:
        raise MotionFileError(path, "arrays.not_plain") from None
    shape = tuple(int(axis) for axis in header[3].replace(" ", "").split(",") if axis)
    if int(np.prod(shape, dtype=object)) * dtype.itemsize != len(data) - end:
        raise MotionFileError(path, "arrays.size", shape=str(shape), found=len(data) - end)
    return {"": np.frombuffer(data, dtype, offset=end).reshape(shape, order="F" if header[2] == "True" else "C")}
