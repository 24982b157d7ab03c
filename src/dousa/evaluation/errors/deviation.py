"""How far each segment is from the reference's at the same time, and a little before and after.

The tensor of squared deviations over time, lag and segment is what all errors are found from: a shift is small at
another lag, a wrong limb is large at every lag, whatever the rest of the body does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numba import njit
from numpy.typing import NDArray

from dousa.arrays import FloatArray
from dousa.evaluation.posture.posture import Working, interpolate_segments
from dousa.evaluation.posture.yaw import rotate_yaw

MAX_LAG_S = 1.2
YAW_WINDOW_S = 0.6
_SPREAD_S = 0.3
YAW_SCALE = np.radians(12.0)  # chord from which a segment loses its say in the heading


@dataclass(frozen=True, slots=True, eq=False)
class Deviations:
    """Squared deviations.

    Parameters
    ----------
    squared : (T, K, 9) squared chord between the segments of the performance at t and of the reference at the same
        time + lag column, turned by the common yaw; 0 where either is not seen, and only there.
    yaw : (T, K) rad that turn the reference onto the performance.
    judged : (T, 9) both seen, and inside the reference.
    performance, reference : (T, 9, 3) unit vectors at the same time, the reference turned onto the performance, and
        both turned so that the reference's body always faces the same way: what is left is the motion of the limbs.
    center : column of no lag.
    step_s : s from column to column.
    spread : (T, 9) rad, how much takes of the reference differ at each moment; 0 of one take.
    """

    squared: FloatArray
    yaw: FloatArray
    judged: NDArray[np.bool_]
    performance: FloatArray
    reference: FloatArray
    center: int
    step_s: float
    spread: FloatArray


def compute_deviations(reference: Working, performance: Working, frames: FloatArray, weights: FloatArray) -> Deviations:
    """Compare every frame of the performance with the reference around ``frames`` (T,), at the working rate."""

    # However slow the camera, there are lags to both sides.
    reach = max(2, round(MAX_LAG_S * performance.frame_rate))
    count = performance.n_frames
    # The reference on the performance's clock, going on before and after it.
    before = frames[0] + np.arange(-reach, 0)
    after = frames[-1] + np.arange(1, reach + 1)
    clock = np.concatenate([before, frames, after])
    inside = (clock >= -1.0) & (clock <= reference.n_frames)
    moved = interpolate_segments(reference.segments, clock)
    near = np.clip(np.rint(clock).astype(np.intp), 0, reference.n_frames - 1)
    # Before its start and after its end the reference stands still; errors are judged inside it only.
    seen = reference.seen[near]
    half = max(1, round(0.5 * YAW_WINDOW_S * performance.frame_rate))
    squared, turn = measure_deviations(
        np.ascontiguousarray(performance.segments),
        moved,
        np.ascontiguousarray(performance.seen),
        seen,
        np.asarray(weights, np.float64),
        half,
        YAW_SCALE**2,
    )
    here = slice(reach, reach + count)
    judged = performance.seen & seen[here] & inside[here, None]
    yaw = np.angle(turn)
    facing = np.interp(frames, np.arange(reference.n_frames), reference.heading)
    theirs = rotate_yaw(moved[here], -facing)
    ours = rotate_yaw(performance.segments, -facing - yaw[:, reach])
    return Deviations(squared, yaw, judged, ours, theirs, reach, 1.0 / performance.frame_rate, np.zeros(judged.shape))


def merge_takes(takes: Sequence[Deviations]) -> Deviations:
    """Deviations from the nearest of several takes, and how much the takes differ.

    Parameters
    ----------
    takes : deviations of one performance from each take, along the same line; the first tells what is judged.

    Returns
    -------
    The smallest deviations of all; the reference is the median of the takes, so that one take's slip does not count,
    and the spread the median angle of the takes from it, averaged over 0.3 s. Where a take is not seen the others
    speak.
    """
    first = takes[0]
    if len(takes) == 1:
        return first
    squared = first.squared
    for other in takes[1:]:
        squared = take_nearest(squared, other.squared)
    poses = np.stack([take.reference for take in takes])
    # What is judged of no take is of no interest; any of them may stand for it.
    known = np.stack([take.judged for take in takes]) | ~np.any([take.judged for take in takes], axis=0)
    middle = _take_median(poses, known[..., None])
    middle /= np.maximum(np.linalg.norm(middle, axis=2, keepdims=True), 1e-9)
    far = _take_median(np.linalg.norm(poses - middle, axis=3), known)
    half = max(1, round(0.5 * _SPREAD_S / first.step_s))
    total = np.cumsum(np.pad(far, ((half + 1, half), (0, 0)), mode="edge"), axis=0)
    spread = (total[2 * half + 1 :] - total[: -2 * half - 1]) / (2 * half + 1)
    return replace(first, squared=squared, reference=middle, spread=spread)


def _take_median(values: FloatArray, known: NDArray[np.bool_]) -> FloatArray:
    """Median over the takes (first axis) of what is known; something of each is."""
    if known.all():
        return np.asarray(np.median(values, axis=0))
    return np.asarray(np.nanmedian(np.where(known, values, np.nan), axis=0))


def take_nearest(mine: FloatArray, its: FloatArray) -> FloatArray:
    """The smaller of two squared deviations, of which 0 is none."""
    return np.where((its > 0.0) & ((its < mine) | (mine == 0.0)), its, mine)


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
                squared[t, k, s] = max(far[t, s], _LEAST) if ours_seen[t, s] and theirs_seen[t + k, s] else 0.0
    return squared, turn
