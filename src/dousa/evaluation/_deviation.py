"""How far each segment is from the reference's at the same time, and a little before and after.

The tensor of squared deviations over time, lag and segment is what all errors are told from: a shift is small at
another lag, a wrong limb is large at every lag, whatever the rest of the body does.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dousa.evaluation._working import Working, interpolate_segments
from dousa.evaluation.yaw import rotate_yaw
from dousa.motion._types import FloatArray

__all__ = [
    "MAX_LAG_S",
    "YAW_SCALE",
    "YAW_WINDOW_S",
    "Deviations",
    "choose_nearest",
    "compute_deviations",
]

MAX_LAG_S = 1.2
YAW_WINDOW_S = 0.6
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
    """

    squared: FloatArray
    yaw: FloatArray
    judged: NDArray[np.bool_]
    performance: FloatArray
    reference: FloatArray
    center: int
    step_s: float


def compute_deviations(
    reference: Working, performance: Working, frames: FloatArray, weights: FloatArray
) -> Deviations:
    """Compare every frame of the performance with the reference around ``frames`` (T,), at the working rate."""
    from dousa.evaluation._deviation_kernels import measure_deviations

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
    return Deviations(squared, yaw, judged, ours, theirs, reach, 1.0 / performance.frame_rate)


def choose_nearest(deviations: Deviations, other: Deviations) -> Deviations:
    """Deviations from the nearer of two takes; where one take is not seen, from the other one."""
    mine, its = deviations.squared, other.squared
    nearer = (its > 0.0) & ((its < mine) | (mine == 0.0))
    return replace(deviations, squared=np.where(nearer, its, mine))
