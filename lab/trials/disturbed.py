"""Recordings as a slow and noisy depth camera would have them; not the generator that the training has."""

from __future__ import annotations

import numpy as np

from dousa.arrays import FloatArray

__all__ = ["KINECT_RATE", "make_drifting", "make_kinect_like", "make_rough"]

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


def make_drifting(positions: FloatArray, generator: np.random.Generator) -> FloatArray:
    """The same with errors of 1.5 to 4 cm that last, and joints that are held for up to a third of a second.

    Parameters
    ----------
    positions : (n, J, 3) m, at 30 Hz.
    generator : draws the errors.
    """
    stay, errors = generator.uniform(0.5, 0.95), generator.normal(size=positions.shape)
    for frame in range(1, len(errors)):
        errors[frame] = stay * errors[frame - 1] + np.sqrt(1.0 - stay**2) * errors[frame]
    spread = np.exp(generator.normal(0.0, 0.4, (1, positions.shape[1], 1)))
    points = positions + errors * spread * generator.uniform(0.015, 0.04) / np.sqrt(3.0)
    for frame, joint in np.argwhere(generator.random(points.shape[:2]) < 0.005):
        points[frame : frame + generator.integers(3, 10), joint] = points[max(frame - 1, 0), joint]
    return np.asarray(points)


def make_rough(positions: FloatArray, frame_rate: float, generator: np.random.Generator) -> FloatArray:
    """The same at 15 Hz, with noise of 4 cm along each axis, a tenth of the joints held, and some leaping by 20 cm.

    Parameters
    ----------
    positions : (n, J, 3) m.
    frame_rate : Hz.
    generator : draws all that.

    Returns
    -------
    (m, J, 3) at ``KINECT_RATE``.
    """
    count = max(round(len(positions) * KINECT_RATE / frame_rate), 2)
    chosen = np.linspace(0, len(positions) - 1, count).round().astype(np.intp)
    noise = 0.04 * np.exp(generator.normal(0.0, 0.3, (1, positions.shape[1], 1)))
    points = positions[chosen] + generator.normal(size=(count, *positions.shape[1:])) * noise
    for frame, joint in np.argwhere(generator.random(points.shape[:2]) < 0.025):
        points[frame : frame + 1 + generator.poisson(3), joint] = points[max(frame - 1, 0), joint]
    leaping = generator.random(points.shape[:2]) < 0.02
    points[leaping] += generator.normal(0.0, 0.2, (int(leaping.sum()), 3))
    return np.asarray(points)
