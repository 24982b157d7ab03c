"""The plainest measures of how far a repetition is from its references; larger is worse.

Joints are centred at the pelvis, turned to face the same way by the mean line of hips and shoulders, divided by the
body's height, and brought to 40 frames. Every measure is the least over references and the mirrored performance.
"""

from __future__ import annotations

import numba
import numpy as np

from dousa.arrays import FloatArray
from dousa.evaluation import compute_joint_angles
from dousa.motion import JOINT_INDEX, CanonicalMotion, mirror_canonical

N_FRAMES = 40
NAMES = ("joints rms", "joints DTW", "ranges", "displacement DTW")
_LINES = (("left_hip", "right_hip"), ("left_shoulder", "right_shoulder"))


def normalise_joints(motion: CanonicalMotion) -> FloatArray:
    """(40, 3 J) centred, facing one way, of unit height, evenly in time."""
    positions = motion.positions - motion.positions[:, :1]
    across = sum((positions[:, JOINT_INDEX[a]] - positions[:, JOINT_INDEX[b]]).mean(axis=0) for a, b in _LINES)
    angle = np.arctan2(across[2], across[0])
    cos, sin = np.cos(angle), np.sin(angle)
    turned = positions @ np.array([[cos, 0, -sin], [0, 1, 0], [sin, 0, cos]]) / motion.height
    rows = np.linspace(0.0, len(turned) - 1.0, N_FRAMES)
    flat = turned.reshape(len(turned), -1)
    return np.stack([np.interp(rows, np.arange(len(flat)), column) for column in flat.T], axis=1).astype(np.float32)


@numba.njit(cache=True)
def _warp(cost: FloatArray) -> float:
    n, m = cost.shape
    total, steps = np.full((n, m), np.inf), np.zeros((n, m))
    for i in range(n):
        for j in range(m):
            best, length = (0.0, 0.0) if i == 0 and j == 0 else (np.inf, 0.0)
            if i > 0 and j > 0 and total[i - 1, j - 1] < best:
                best, length = total[i - 1, j - 1], steps[i - 1, j - 1]
            if i > 0 and total[i - 1, j] < best:
                best, length = total[i - 1, j], steps[i - 1, j]
            if j > 0 and total[i, j - 1] < best:
                best, length = total[i, j - 1], steps[i, j - 1]
            total[i, j], steps[i, j] = best + cost[i, j], length + 1.0
    return total[n - 1, m - 1] / steps[n - 1, m - 1]


def measure_warping(a: FloatArray, b: FloatArray) -> float:
    """Mean distance along the path of dynamic time warping; joints that one of both lacks are left out."""
    seen = np.isfinite(a).all(axis=0) & np.isfinite(b).all(axis=0)
    a, b = a[:, seen], b[:, seen]
    square = (a**2).sum(axis=1)[:, None] + (b**2).sum(axis=1) - 2.0 * a @ b.T
    return float(_warp(np.sqrt(np.maximum(square, 0.0).astype(np.float64))))


class Plain:
    """What the plain measures need of one motion."""

    def __init__(self, motion: CanonicalMotion) -> None:
        self.joints = normalise_joints(motion)
        self.displacement = self.joints - self.joints[:3].mean(axis=0)
        angles = compute_joint_angles(motion).values()
        self.ranges = np.array([np.ptp(one[np.isfinite(one)]) if np.isfinite(one).any() else 0.0 for one in angles])


def measure_plainly(references: list[Plain], both: list[Plain]) -> dict[str, float]:
    """All measures of a performance and its mirror image against references."""
    rows = [
        (
            float(np.sqrt(np.nanmean((one.joints - reference.joints) ** 2))),
            measure_warping(one.joints, reference.joints),
            float(np.abs(one.ranges - reference.ranges).mean()),
            measure_warping(one.displacement, reference.displacement),
        )
        for reference in references
        for one in both
    ]
    return dict(zip(NAMES, np.min(rows, axis=0).tolist(), strict=True))


def make_both(motion: CanonicalMotion) -> list[Plain]:
    """A motion and its mirror image."""
    return [Plain(motion), Plain(mirror_canonical(motion))]


def find_lags(reference: FloatArray, performance: FloatArray, frame_rate: float) -> FloatArray:
    """(T,) s, lag of a limb (T, n) that best explains two seconds around each frame."""
    reach, half = round(0.7 * frame_rate), round(frame_rate)
    shifts = np.arange(-reach, reach + 1)
    kernel = np.ones(2 * half + 1)
    costs = []
    for shift in shifts:
        rows = np.clip(np.arange(len(performance)) - shift, 0, len(reference) - 1)
        costs.append(np.convolve(((performance - reference[rows]) ** 2).sum(axis=1), kernel, mode="same"))
    return shifts[np.argmin(costs, axis=0)] / frame_rate
