"""Rows of features of a motion, as networks of text and motion learn them, turned back into a motion.

HumanML3D (Guo et al., Generating diverse and natural 3D human motions from text, CVPR 2022; ``recover_from_ric``): with
J joints a row has 12 J - 1 numbers: half the turn of the root about Y in a frame, its velocity along X and Z in its own
heading, its height, the places of the other joints seen from the root in its heading, and rotations, velocities and
contacts, which say the same again. 263 are 22 joints, 251 the 21 of KIT-ML. Motion-X (Lin et al., 2023): 322 numbers;
the first 156 are rotation vectors of SMPL-H, 309 to 311 the place of the root.
"""

from __future__ import annotations

import os

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import FloatArray
from dousa.errors import MotionFileError
from dousa.motion.rotations import rotate

FEATURES = {263: 22, 251: 21}
"""Joints by the width of a row, by the definition of HumanML3D."""

MOTION_X = 322
"""Width of a row of Motion-X, by its definition."""


def recover_joints(path: str | os.PathLike[str], rows: NDArray[np.floating], uneven: float = 0.1) -> FloatArray:
    """Compute the places of joints (T, J, 3) m, Y up, from rows (T, 263) or (T, 251).

    Parameters
    ----------
    path : for the message.
    rows : as they are, not divided by their spread over a data set.
    uneven : share by which the shanks, left and right, vary at most (standard deviation): the bones of rows that were
        divided by their spread, or are of another kind, have no length.

    Raises
    ------
    MotionFileError : rows that make no body.
    """
    values = rows.astype(np.float64)
    n_joints = FEATURES[values.shape[1]]
    heading = np.concatenate(([0.0], np.cumsum(values[:-1, 0])))
    # The quaternion has the angle itself, not half of it: a row holds half of the turn.
    back = np.stack((np.cos(heading), 0 * heading, -np.sin(heading), 0 * heading), axis=1)
    steps = np.zeros((len(values), 3))
    steps[1:, 0], steps[1:, 2] = values[:-1, 1], values[:-1, 2]
    root = np.cumsum(rotate(back, steps), axis=0)
    others = values[:, 4 : 4 + 3 * (n_joints - 1)].reshape(len(values), n_joints - 1, 3)
    joints = rotate(back[:, None], others) + root[:, None]
    root[:, 1] = values[:, 3]
    joints = np.concatenate((root[:, None], joints), axis=1)
    lengths = np.linalg.norm(joints[:, _KNEES[n_joints]] - joints[:, _ANKLES[n_joints]], axis=-1)
    if not (np.isfinite(lengths).all() and lengths.mean() > 0 and lengths.std() <= uneven * lengths.mean()):
        raise MotionFileError(path, "arrays.features", found=rows.shape[1])
    return joints


# Left and right in the order of the joints (layouts.toml), by the definition of HumanML3D and KIT-ML.
_KNEES, _ANKLES = {22: [4, 5], 21: [17, 12]}, {22: [7, 8], 21: [18, 13]}
