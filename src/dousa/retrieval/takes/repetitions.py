"""How often an action is repeated within a segment: by the period at which its movement resembles itself.

Velocities of the joints in the body-fixed system are compared with themselves some time later (autocorrelation, over
what overlaps). Rest counts for nothing in velocities, and there and back cancel out, so a single motion resembles
itself at no later time. The shortest time with nearly the highest peak is the period; the moving part of the segment
divided by it is the count.
"""

from __future__ import annotations

import numpy as np

from dousa.arrays import FloatArray
from dousa.retrieval.takes.windows import TAKE_RATE, compute_small_poses

_SMOOTHING = 2.0  # frames, standard deviation
_SHORTEST = 0.3  # s, of a period
_LONGEST = 0.62  # share of the moving part that a period may last
_ALIKE = 0.4  # correlation from which a motion resembles itself
_NEARLY = 0.8  # share of the highest peak that a shorter period needs
_MOVING = 0.15  # share of the speed that is exceeded a tenth of the time
_REST, _AROUND = 9, 20  # frames that a rest lasts, and on either side of where it is looked for


def count_repetitions(sampled: FloatArray, height: float) -> int:
    """Repetitions of what a part of a recording shows; 1 where nothing is repeated.

    Parameters
    ----------
    sampled : (n, 20, 3) m, canonical joints at 30 Hz.
    height : m.
    """
    if len(sampled) < 2 * _SHORTEST * TAKE_RATE:
        return 1
    velocities = _measure_velocities(sampled, height)
    speeds = np.sqrt((velocities**2).sum(axis=1))
    moving = np.flatnonzero(speeds > _MOVING * np.percentile(speeds, 90))
    if not len(moving):
        return 1
    velocities = velocities[moving[0] : moving[-1] + 1]
    likeness = correlate(velocities)
    least = round(_SHORTEST * TAKE_RATE)
    peaks = 1 + np.flatnonzero((likeness[1:-1] >= likeness[:-2]) & (likeness[1:-1] > likeness[2:]))
    peaks = peaks[peaks >= least]
    if not len(peaks) or likeness[peaks].max() < _ALIKE:
        return 1
    period = peaks[likeness[peaks] >= _NEARLY * likeness[peaks].max()][0]
    return max(round(len(velocities) / float(period)), 1)


def is_rest(sampled: FloatArray, height: float, place: int) -> bool:
    """Whether the body rests about a frame of a part, rather than going on.

    Parameters
    ----------
    sampled : (n, 20, 3) m, canonical joints at 30 Hz.
    height : m.
    place : frame.
    """
    speeds = np.sqrt((_measure_velocities(sampled, height) ** 2).sum(axis=1))
    still = speeds <= _MOVING * np.percentile(speeds, 90)
    around = still[max(place - _AROUND, 0) : place + _AROUND]
    edges = np.flatnonzero(np.diff(np.concatenate([[False], around, [False]]).astype(np.int8)))
    return bool(len(edges)) and int((edges[1::2] - edges[::2]).max()) >= _REST


def _measure_velocities(sampled: FloatArray, height: float) -> FloatArray:
    """(n, 27) body heights a frame, of nine joints in the body-fixed system."""
    from dousa.retrieval.features.channels import smooth_positions

    poses = compute_small_poses(smooth_positions(sampled, _SMOOTHING), height).astype(np.float64)
    velocities: FloatArray = np.gradient(poses, axis=0)
    return velocities


def correlate(velocities: FloatArray) -> FloatArray:
    """(L,) how much velocities (n, K) resemble themselves 0, 1, 2 ... frames later, -1 to 1; L a share of n."""
    n = len(velocities)
    most = max(round(_LONGEST * n), 1)
    size = 1 << (2 * n - 1).bit_length()
    spectrum = np.fft.rfft(velocities, size, axis=0)
    products = np.fft.irfft((spectrum * spectrum.conj()).sum(axis=1), size)[:most]
    energy = np.concatenate([[0.0], np.cumsum((velocities**2).sum(axis=1))])
    lags = np.arange(most)
    before, after = energy[n - lags], energy[n] - energy[lags]
    likeness: FloatArray = products / np.maximum(np.sqrt(before * after), 1e-12)
    return likeness
