"""The array of an npy file, or what is pickled in it."""

from __future__ import annotations

import os
import re
from typing import Any

import numpy as np

from dousa.errors import MotionFileError
from dousa.files.disk import read_bytes
from dousa.files.pickles import load_pickle

_MAGIC = b"\x93NUMPY"
_HEADER = re.compile(
    r"\{'descr': '([<>|=]?[iuf]\d{1,2}|\|O)', 'fortran_order': (True|False), 'shape': \(([\d, ]{0,200})\), ?\}\s*"
)


def load_npy(path: str | os.PathLike[str]) -> dict[Any, Any]:
    """Load the dictionary of a file of objects; else the array, under the name "".

    Raises
    ------
    MotionFileError : missing, damaged, objects that are no plain values.
    """
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
