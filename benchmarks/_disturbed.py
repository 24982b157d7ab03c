"""Recordings as a slow and noisy depth camera would have them; not the generator that the training has."""

from __future__ import annotations

import numpy as np

from dousa.arrays import FloatArray

__all__ = ["KINECT_RATE", "make_kinect_like"]

KINECT_RATE = 15.0
_NOISE_M = 0.03  # standard deviation along each axis
_MISSING = 0.05  # of the joints in a frame
_GAP = 3  # frames that a joint is gone for, on average


def make_kinect_like(positions: FloatArray, frame_rate: float, generator: np.random.Generator) -> FloatArray:
    """The same at 15 Hz, with noise of 3 cm along each axis, and 5 % of the joints missing and bridged straight.

    Parameters
    ----------
    positions : (n, J, 3) m.
    frame_rate : Hz.
    generator : draws noise and gaps.

    Returns
    -------
    (m, J, 3) at ``KINECT_RATE``.
    """
    count = max(round(len(positions) * KINECT_RATE / frame_rate), 2)
    chosen = np.linspace(0, len(positions) - 1, count).round().astype(np.intp)
    points = positions[chosen] + generator.normal(0.0, _NOISE_M, (count, *positions.shape[1:]))
    frames = np.arange(count)
    for joint in range(points.shape[1]):
        begins = np.flatnonzero(generator.random(count) < _MISSING / _GAP)
        seen = np.ones(count, np.bool_)
        for begin in begins:
            seen[begin : begin + 1 + generator.poisson(_GAP - 1)] = False
        if seen.any() and not seen.all():
            for axis in range(3):
                points[~seen, joint, axis] = np.interp(frames[~seen], frames[seen], points[seen, joint, axis])
    return np.asarray(points)
