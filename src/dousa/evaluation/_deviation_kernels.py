"""Compiled loop of the deviations: the same diagonal after diagonal, without products of all poses in memory."""

from __future__ import annotations

import numpy as np
from numba import njit

from dousa.motion._types import FloatArray

__all__ = ["measure_deviations"]

_N_ROUNDS = 4
_LEAST = 1e-30  # of what is seen, far below rounding: 0 says that it is not seen


@njit(cache=True, nogil=True)
def measure_deviations(
    ours: FloatArray,
    theirs: FloatArray,
    ours_seen: np.ndarray,
    theirs_seen: np.ndarray,
    weights: FloatArray,
    half: int,
    scale: float,
) -> tuple[FloatArray, np.ndarray]:  # pragma: no cover - compiled
    """Squared chords at every lag after a common yaw that changes slowly and that no wrong limb bends.

    Parameters
    ----------
    ours : (T, 9, 3) unit vectors of the performance.
    theirs : (T + K - 1, 9, 3) of the reference on the performance's clock; frame t at lag column k meets t + k.
    ours_seen, theirs_seen : (T, 9) and (T + K - 1, 9).
    weights : (9,).
    half : the yaw is that of ``2 half + 1`` frames at equal lag.
    scale : squared chord from which a segment loses its say.

    Returns
    -------
    squared : (T, K, 9), 0 where either is not seen, and only there.
    turn : (T, K) complex of modulus 1, the yaw that turns the reference onto the performance.
    """
    n_frames, n_lags = len(ours), len(theirs) - len(ours) + 1
    squared = np.empty((n_frames, n_lags, 9))
    turn = np.empty((n_frames, n_lags), np.complex128)
    along, across = np.empty((n_frames, 9)), np.empty((n_frames, 9))
    upright, far = np.empty((n_frames, 9)), np.empty((n_frames, 9))
    weight, trust = np.empty((n_frames, 9)), np.empty((n_frames, 9))
    total = np.zeros((n_frames + 1, 2))
    for k in range(n_lags):
        for t in range(n_frames):
            for s in range(9):
                x, y, z = ours[t, s, 0], ours[t, s, 1], ours[t, s, 2]
                p, q, r = theirs[t + k, s, 0], theirs[t + k, s, 1], theirs[t + k, s, 2]
                along[t, s] = z * r + x * p
                across[t, s] = x * r - z * p
                upright[t, s] = 2.0 - 2.0 * y * q
                weight[t, s] = weights[s] if ours_seen[t, s] and theirs_seen[t + k, s] else 0.0
                trust[t, s] = weight[t, s]
        for _ in range(_N_ROUNDS):
            for t in range(n_frames):
                a, b = 0.0, 0.0
                for s in range(9):
                    a += along[t, s] * trust[t, s]
                    b += across[t, s] * trust[t, s]
                total[t + 1, 0] = total[t, 0] + a
                total[t + 1, 1] = total[t, 1] + b
            for t in range(n_frames):
                low, high = max(t - half, 0), min(t + half + 1, n_frames)
                a, b = total[high, 0] - total[low, 0], total[high, 1] - total[low, 1]
                size = max(np.sqrt(a * a + b * b), 1e-12)
                a, b = a / size, b / size
                for s in range(9):
                    far[t, s] = max(upright[t, s] - 2.0 * (along[t, s] * a + across[t, s] * b), 0.0)
                    share = 1.0 / (1.0 + far[t, s] / scale)
                    trust[t, s] = weight[t, s] * share * share
                turn[t, k] = complex(a, b)
        for t in range(n_frames):
            for s in range(9):
                squared[t, k, s] = (
                    max(far[t, s], _LEAST) if ours_seen[t, s] and theirs_seen[t + k, s] else 0.0
                )
    return squared, turn
