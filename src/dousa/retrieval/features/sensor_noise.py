"""Noise that the sensor added: measured in the recording itself, and taken off before anything is asked of it.

A joint moves smoothly, the errors of a depth camera do not: each frame has its own. So the spline through a joint's
places that predicts the places left out best (generalised cross-validation: Craven and Wahba, Numerische Mathematik 31,
1979) tells how large the errors are, and all joints together tell it well. Each joint then gets the spline of least
expected error given that size (Mallows, "Some comments on C_p", Technometrics 15, 1973): one that hardly moves is
smoothed much, a hand that throws is not; so is one that is tracked worse than the others. Places far beyond the errors
are glitches; they count as what the spline says in their stead. It is the third derivative that a spline keeps small.

A recording whose errors are below half a millimetre comes back as it is: optical motion capture does. Nothing here
depends on the rate, the body or the movement.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import BoolArray, FloatArray
from dousa.motion.canonical.anthropometry import stature_of_parts
from dousa.motion.canonical.geometry import chain_height
from dousa.retrieval.features.channels import CHANNEL_RATE, sample_positions
from dousa.retrieval.features.posed_motion import PosedMotion, check_frame_rate, check_shape

_ORDER = 3  # the derivative that is kept small
_WEIGHTS = np.logspace(-3.0, 6.0, 28)  # of it; the last one leaves movements of some seconds
_FEWEST = 8  # frames in which noise and movement can be told apart
_NO_NOISE = 5e-4  # m
_GLITCH = 8.0  # standard deviations: what moves fast for a moment is no glitch; 5 did a little worse
_MEDIAN_OF_SQUARES = 2.366  # of three normal deviates together, chi-squared
_ROUNDS = 3
_AT_ONCE = 1 << 18  # frames of joints: an hour does not fill the memory
_END = 3  # frames whose mean is where a joint begins, or ends


@dataclass(frozen=True, slots=True, eq=False)
class QuietMotion:
    """A motion without the noise of its sensor; ``noise`` is the standard deviation of what was taken off, m."""

    positions: FloatArray
    frame_rate: float
    height: float
    noise: float


def reduce_noise(motion: PosedMotion) -> PosedMotion:
    """A motion without the noise of its sensor; itself, where there is none to speak of.

    Parameters
    ----------
    motion : of any frame rate and length; joints may be absent (NaN in all frames).

    Returns
    -------
    At ``CHANNEL_RATE``, where the recording was faster, else at its own rate. The height is that of the smoothed bones,
    which errors no longer lengthen.

    Raises
    ------
    InvalidMotionError : another shape than (n, 20, 3), no frame, no body height, a frame rate below 1 Hz.
    """
    points = check_shape(motion.positions, motion.height)
    check_frame_rate(motion.frame_rate)
    rate = min(motion.frame_rate, CHANNEL_RATE)
    if motion.frame_rate > CHANNEL_RATE:
        points = sample_positions(points, motion.frame_rate)
    there: BoolArray = np.all(np.isfinite(points), axis=(0, 2))
    if len(points) < _FEWEST or not there.any():
        return motion
    seen = points if there.all() else points[:, there]
    smooth, noise = smooth_places(seen)
    if smooth is seen:
        return motion
    quiet = smooth if there.all() else points.copy()
    quiet[:, there] = smooth
    before, after = _measure_bones(points), _measure_bones(quiet)
    share = after / before if before > 0 and after > 0 else 1.0
    return QuietMotion(quiet, rate, motion.height * share, noise)


def smooth_places(points: FloatArray) -> tuple[FloatArray, float]:
    """Smoothed places, and the standard deviation of the errors.

    Parameters
    ----------
    points : (n, J, 3) finite, n at least 3.

    Returns
    -------
    points : (n, J, 3); the same array where there is neither noise nor a glitch.
    noise : in the unit of the points, along each axis.
    """
    fit, noise = _fit_splines(points)
    believed = points
    for _ in range(_ROUNDS):
        if noise < _NO_NOISE:
            break
        squared = np.einsum("tjk,tjk->tj", points - fit, points - fit)
        # The median of the squares of three errors; a joint that is tracked badly has larger ones everywhere.
        glitches = squared > _GLITCH**2 / _MEDIAN_OF_SQUARES * np.median(squared, axis=0)
        if not glitches.any():
            break
        believed = np.where(glitches[:, :, None], fit, points)
        fit, noise = _fit_splines(believed)
    return (believed if noise < _NO_NOISE else fit), noise


def _fit_splines(points: FloatArray) -> tuple[FloatArray, float]:
    """The spline of each joint, and the standard deviation of the errors of all.

    In the frequencies of a recording that is reflected at its ends, the penalty of a spline is diagonal (Garcia,
    "Robust smoothing of gridded data", Computational Statistics and Data Analysis 54, 2010).
    """
    count = len(points)
    ends = min(_END, count // 2)
    first, last = points[:ends].mean(axis=0), points[-ends:].mean(axis=0)
    line = np.linspace(-0.5, 0.5, count)[:, None, None] * ((last - first) * count / (count - ends))
    some = max(_AT_ONCE // count, 1)
    groups = [slice(joint, joint + some) for joint in range(0, points.shape[1], some)]
    waves = [_to_waves(points[:, group] - line[:, group]) for group in groups]
    power = np.concatenate([np.sum(one.real**2 + one.imag**2, axis=2) for one in waves], axis=1) / (2.0 * count)
    power[0] /= 2.0
    kept, freedom = _list_splines(count)
    left = ((1.0 - kept) ** 2) @ power  # (L, J) squared residuals
    chosen = np.argmin(left / (count - freedom) ** 2, axis=0)
    sizes = left[chosen, np.arange(left.shape[1])] / (3.0 * (count - freedom[chosen, 0]))
    variance = float(np.median(sizes))
    # A joint whose errors are larger than the others' has them; one of which too little is thought has not.
    chosen = np.argmin(left + 6.0 * np.maximum(sizes, variance) * freedom, axis=0)
    smooth = line
    for group, one in zip(groups, waves, strict=True):
        smooth[:, group] += _from_waves(one * kept[chosen[group]].T[:, :, None])
    return smooth, float(np.sqrt(variance))


def _to_waves(values: FloatArray) -> NDArray[np.complex128]:
    """The frequencies (n, J, 3) of values (n, J, 3) that are reflected at their ends; the last, n, is always 0."""
    waves: NDArray[np.complex128] = np.fft.rfft(np.concatenate([values, values[::-1]]), axis=0)[:-1]
    return waves


def _from_waves(waves: NDArray[np.complex128]) -> FloatArray:
    values: FloatArray = np.fft.irfft(waves, 2 * len(waves), axis=0)[: len(waves)]
    return values


def _list_splines(count: int) -> tuple[FloatArray, FloatArray]:
    """What splines of every weight keep of each wave of so many frames (L, n), and their degrees of freedom (L, 1)."""
    stiffness = (2.0 - 2.0 * np.cos(np.pi * np.arange(count) / count)) ** _ORDER
    kept: FloatArray = 1.0 / (1.0 + _WEIGHTS[:, None] * stiffness)
    freedom: FloatArray = kept.sum(axis=1)[:, None]
    return kept, freedom


def _measure_bones(points: FloatArray) -> float:
    height = chain_height(points)
    return height if height > 0 else stature_of_parts(points)
