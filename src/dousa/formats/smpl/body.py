"""Trees and rest joints of SMPL, SMPL-H and SMPL-X: of the mean body, or of a model file."""

from __future__ import annotations

import os
import tomllib
from functools import lru_cache
from importlib import resources
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import FloatArray
from dousa.errors import MotionFileError
from dousa.files.npz_arrays import open_npz
from dousa.messages import Message
from dousa.motion import Skeleton

JOINTS_OF = {22: "SMPL", 24: "SMPL", 52: "SMPL-H", 55: "SMPL-X"}
"""Model by its number of joints; 22 are SMPL's without the hands."""

_MOST_BYTES = 2_000_000_000  # of an array of a model file: the shapes of SMPL-X take 100 MB


@lru_cache(maxsize=4)
def mean_body(n_joints: int) -> Skeleton:
    """Return the skeleton of the mean body with 22, 24 (SMPL), 52 (SMPL-H) or 55 (SMPL-X) joints.

    Offsets in m; the root's is the pelvis of the unmoved model.
    """
    table: dict[str, Any] = tomllib.loads(resources.files(__package__).joinpath("body.toml").read_text("utf-8"))
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

    def fail(message: Message) -> MotionFileError:
        return MotionFileError(path, message)

    if os.fspath(path).lower().endswith(".pkl"):
        raise fail(Message("smpl.model_pickle"))
    with open_npz(path, fail) as file:
        arrays: dict[str, NDArray[Any]] = {}
        for name, ndim in (("v_template", 2), ("shapedirs", 3), ("J_regressor", 2)):
            if name not in file:
                raise fail(Message("smpl.model_lacks", array=name))
            arrays[name] = file.read(name, "f", ndim, _MOST_BYTES)
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
    offsets = joints.copy()
    offsets[1:] -= joints[mean.parents[1:]]
    return Skeleton(mean.names, mean.parents, offsets)
