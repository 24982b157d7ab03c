"""Splines that take a sensor's noise off, with whole arrays of NumPy, all joints anew in every round.

It says what the compiled loops of ``dousa.retrieval.features.sensor_noise`` compute.
"""

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import FloatArray

_ORDER = 3  # the derivative that is kept small
_WEIGHTS = np.logspace(-3.0, 6.0, 28)  # of it; the last one leaves movements of some seconds
_FEWEST = 8  # frames in which noise and movement can be told apart
_NO_NOISE = 5e-4  # m
_GLITCH = 8.0  # standard deviations: what moves fast for a moment is no glitch; 5 did a little worse
_MEDIAN_OF_SQUARES = 2.366  # of three normal deviates together, chi-squared
_ROUNDS = 3
_AT_ONCE = 1 << 18  # frames of joints: an hour does not fill the memory
_END = 3  # frames whose mean is where a joint begins, or ends


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
