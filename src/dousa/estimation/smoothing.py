"""Smoothing of poses over time, forward and backward at once, so that nothing comes late."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

__all__ = ["smooth_poses"]

FloatArray = NDArray[np.float64]


def smooth_poses(
    poses: FloatArray, frame_rate: float, cutoff: float, breaks: Sequence[int] = ()
) -> FloatArray:
    """Poses with less jitter.

    Parameters
    ----------
    poses : (T, 7 + A), see `BodyModel`.
    frame_rate : Hz.
    cutoff : Hz, at which half of the power is left; the filter is a Gaussian, ends are repeated.
    breaks : frames at which the track was taken up anew: nothing is smoothed across them.

    Returns
    -------
    (T, 7 + A), of the same length; orientations by the mean of quaternions of one sign.
    """
    from scipy.ndimage import gaussian_filter1d

    sigma = np.sqrt(np.log(2.0)) / (2.0 * np.pi * cutoff) * frame_rate
    smooth = np.array(poses, np.float64)
    quaternions = smooth[:, 3:7]
    for t in range(1, len(smooth)):
        if quaternions[t] @ quaternions[t - 1] < 0:
            quaternions[t] *= -1.0
    edges = [0, *sorted({int(frame) for frame in breaks if 0 < frame < len(smooth)}), len(smooth)]
    for start, stop in pairwise(edges):
        smooth[start:stop] = gaussian_filter1d(smooth[start:stop], sigma, axis=0, mode="nearest")
    smooth[:, 3:7] /= np.linalg.norm(smooth[:, 3:7], axis=1, keepdims=True)
    return smooth
