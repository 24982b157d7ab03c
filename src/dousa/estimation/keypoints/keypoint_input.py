"""Reading the keypoints of one view, whichever program found them."""

from __future__ import annotations

import os

from dousa.errors import KeypointError
from dousa.estimation.keypoints.keypoint_files import read_keypoint_npz
from dousa.estimation.keypoints.keypoints import ViewKeypoints


def read_keypoints(path: str | os.PathLike[str]) -> ViewKeypoints:
    """Read the keypoints of one view.

    Parameters
    ----------
    path : an npz file of dousa (see `keypoint_files`).

    Raises
    ------
    KeypointError : missing, damaged, or of an unknown form.
    """
    if not os.path.exists(path):
        raise KeypointError("keypoints.missing").at(path)
    return read_keypoint_npz(path)
