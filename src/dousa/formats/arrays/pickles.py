"""Pickled dictionaries of SMPL poses or of joint positions."""

from __future__ import annotations

import os
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dousa.errors import MotionFileError
from dousa.files.pickles import load_pickle
from dousa.formats.arrays.joints import build_joints, find_joints
from dousa.formats.smpl import AIST_RATE, build_smpl, find_poses, read_rate
from dousa.motion import Motion, Trajectories


def read_pickle(
    path: str | os.PathLike[str],
    *,
    unit: float | str | None = None,
    up: str | None = None,
    skeleton: str | os.PathLike[str] | None = None,
    frame_rate: float | None = None,
) -> Motion | Trajectories:
    """Read a pickled dictionary of SMPL poses or of joint positions, such as those of AIST++.

    Parameters
    ----------
    path : the file; nothing in it is executed.
    unit, up, skeleton, frame_rate : as for `read_smpl_npz`; joint positions take no skeleton.

    Raises
    ------
    MotionFileError : missing, damaged, something other than arrays, no poses.
    """
    content = load_pickle(path)
    arrays = {name: _as_array(value) for name, value in content.items()}
    if find_poses(arrays):
        return build_smpl(path, arrays.get, unit=unit, up=up, skeleton=skeleton, frame_rate=frame_rate)
    name = find_joints({key: array for key, array in arrays.items() if array is not None})
    if name is None:
        raise MotionFileError(path, "pickles.no_motion", found=tuple(content)[:12])
    points = arrays[name]
    assert points is not None
    rate = frame_rate or read_rate(arrays.get) or (AIST_RATE if name.startswith("keypoints3d") else None)
    return build_joints(path, "pkl", points, unit=unit, up=up, frame_rate=rate)


def _as_array(value: Any) -> NDArray[Any] | None:
    if isinstance(value, bool | str | bytes | dict) or value is None:
        return None
    try:
        array = np.asarray(value)
    except ValueError:  # lists of unequal lengths
        return None
    return array if array.dtype.kind in "iuf" else None
