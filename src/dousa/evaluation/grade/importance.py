"""What matters in a dance: weights of the segments, learned from the takes of the reference.

What moves much, and alike in all takes, is what the dance is about; what hardly moves, or is done another way each
time, is not. The user's own weights are multiplied with these. The grade uses them, the finding of errors does not.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dousa.arrays import FloatArray
from dousa.evaluation.grade.parts import Measured
from dousa.evaluation.posture.posture import Working
from dousa.evaluation.posture.yaw import rotate_yaw

_LITTLE_DEG = 15.0  # of motion: what moves less is still looked at
_ALIKE_DEG = 5.0  # what takes of one person differ by anyway
_ALONE, _TOGETHER = 0.35, 0.5  # how much is made of it, with one take and with several
_MOST = 2.5


def learn_importance(takes: Sequence[Working], measured: Sequence[Measured]) -> FloatArray:
    """(9,) weights of the segments, of mean 1.

    Parameters
    ----------
    takes : of the reference, at the working rate.
    measured : of the further ones against the others; of one take there are none, and its amount of motion alone
        tells, mildly.
    """
    motion = np.mean([_measure_spread(take) for take in takes], axis=0) + _LITTLE_DEG
    seen = takes[0].seen.any(axis=0)
    if measured:
        apart = np.mean([_average(one.shape) for one in measured], axis=0)
        shares = (motion / (apart + _ALIKE_DEG)) ** _TOGETHER
    else:
        shares = motion**_ALONE
    shares /= shares[seen].mean() if seen.any() else 1.0
    shares = np.clip(shares, 1.0 / _MOST, _MOST)
    return np.asarray(shares / shares[seen].mean() if seen.any() else np.ones(9))


def _average(angles: FloatArray) -> FloatArray:
    """(9,) root mean square over time of (N, 9); 0 where nothing is known."""
    count = np.isfinite(angles).sum(axis=0)
    return np.asarray(np.sqrt(np.nansum(angles**2, axis=0) / np.maximum(count, 1)))


def _measure_spread(take: Working) -> FloatArray:
    """(9,) deg, root mean square of the angle from the mean direction, in the performer's own frame."""
    body = rotate_yaw(take.segments, -np.nan_to_num(take.heading))
    mean = body.mean(axis=0)
    mean /= np.maximum(np.linalg.norm(mean, axis=1, keepdims=True), 1e-9)
    cosine = np.clip(np.einsum("tsk,sk->ts", body, mean), -1.0, 1.0)
    spread: FloatArray = np.sqrt((np.degrees(np.arccos(cosine)) ** 2).mean(axis=0))
    return spread
