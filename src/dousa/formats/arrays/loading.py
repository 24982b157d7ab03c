"""What npy, npz and pickles hold, as one dictionary of arrays, numbers, texts, lists and dictionaries."""

from __future__ import annotations

import io
import os
from functools import partial
from typing import Any

import numpy as np

from dousa.errors import MotionFileError
from dousa.files.disk import read_bytes
from dousa.files.npz_arrays import open_npz, parse_head, read_head
from dousa.files.pickles import load_pickle
from dousa.formats.smpl_poses import are_poses, find_roles


def name_kind(path: str | os.PathLike[str]) -> str:
    """Return the name of a format of arrays: the suffix."""
    return os.path.splitext(os.fspath(path))[1].lower().lstrip(".")


def load_content(path: str | os.PathLike[str]) -> dict[Any, Any]:
    """Load the content of a file by its suffix; an array without a name is given under the name "".

    Raises
    ------
    MotionFileError : missing, damaged, objects that are no plain values.
    """
    return {"npy": _load_npy, "npz": _load_npz}.get(name_kind(path), load_pickle)(path)


def _load_npy(path: str | os.PathLike[str]) -> dict[Any, Any]:
    data = read_bytes(path)
    head = read_head(io.BytesIO(data))
    if head is None:
        raise MotionFileError(path, "arrays.no_npy")
    if b"'|O'" in head:
        return load_pickle(path, data[len(head) :])
    header, left = parse_head(head), len(data) - len(head)
    if header is None or header.dtype.kind not in "iuf":
        raise MotionFileError(path, "arrays.not_plain")
    if header.n_bytes != left:
        raise MotionFileError(path, "arrays.size", shape=str(header.shape), found=left)
    return {"": header.shape_data(np.frombuffer(data, header.dtype, offset=len(head)))}


def _load_npz(path: str | os.PathLike[str]) -> dict[Any, Any]:
    """The arrays of numbers and texts, and the dictionaries in the place of one; other members are left out.

    Of a body neither are meshes read, nor anything else that has three axes and no part in its poses.
    """
    content: dict[Any, Any] = {}
    refused: MotionFileError | None = None
    with open_npz(path, partial(MotionFileError, path)) as file:
        roles = find_roles(file.names)
        poses = set(roles.values()) if are_poses(roles) else None
        for name in file.names:
            pickled = file.read_pickled(name)
            try:
                if pickled is not None:
                    content[name] = load_pickle(path, pickled)
                    continue
                with file.open(name) as (header, _):
                    is_mesh = poses is not None and name not in poses and len(header.shape) > 2
                if not is_mesh:
                    content[name] = file.read(name, "iufU", most=file.most)
            except MotionFileError as error:
                if error.code in ("npz.ends", "npz.size", "npz.large", "npz.damaged"):
                    raise
                refused = error
    if refused is not None and not content:
        raise refused
    return content
