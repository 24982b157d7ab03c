"""Compiled step of the running evaluation: one pose beside the reference around it."""

from __future__ import annotations

import numpy as np
from numba import njit

from dousa.motion._types import FloatArray

__all__ = ["compare_pose"]

_N_ROUNDS = 3


@njit(cache=True, nogil=True)
def compare_pose(
    ours: FloatArray,
    theirs: FloatArray,
    weights: FloatArray,
    theirs_seen: np.ndarray,
    scale: float,
    turns: FloatArray,
    past: FloatArray,
    squared: FloatArray,
) -> None:  # pragma: no cover - compiled
    """Squared chords of one pose at every lag, the yaw taken from this pose and those before it at equal lag.

    Parameters
    ----------
    ours : (9, 3) unit vectors.
    theirs : (K, 9, 3) of the reference around the same time.
    weights : (9,) of the segments, 0 where this pose is not seen.
    theirs_seen : (K, 9).
    scale : squared chord from which a segment loses its say.
    turns : (K, 2) sums over the past poses, the oldest taken off already; this pose is added.
    past : (K, 2) out, what this pose adds.
    squared : (K, 9) out, 0 where either is not seen.
    """
    along, across, fixed = np.empty(9), np.empty(9), np.empty(9)
    for k in range(len(theirs)):
        a, b = turns[k, 0], turns[k, 1]
        for s in range(9):
            x, y, z = ours[s, 0], ours[s, 1], ours[s, 2]
            p, q, r = theirs[k, s, 0], theirs[k, s, 1], theirs[k, s, 2]
            along[s] = z * r + x * p
            across[s] = x * r - z * p
            fixed[s] = 2.0 - 2.0 * y * q
            squared[k, s] = 0.0
        for _ in range(_N_ROUNDS):
            more_along, more_across = 0.0, 0.0
            for s in range(9):
                if weights[s] > 0.0 and theirs_seen[k, s]:
                    share = 1.0 / (1.0 + squared[k, s] / scale)
                    more_along += along[s] * weights[s] * share * share
                    more_across += across[s] * weights[s] * share * share
            a, b = turns[k, 0] + more_along, turns[k, 1] + more_across
            size = max(np.sqrt(a * a + b * b), 1e-12)
            a, b = a / size, b / size
            for s in range(9):
                squared[k, s] = max(fixed[s] - 2.0 * (along[s] * a + across[s] * b), 0.0)
        past[k, 0], past[k, 1] = more_along, more_across
        turns[k, 0] += more_along
        turns[k, 1] += more_across
        for s in range(9):
            if weights[s] == 0.0 or not theirs_seen[k, s]:
                squared[k, s] = 0.0
