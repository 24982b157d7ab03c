"""The rate at which errors are looked for: postures averaged down to about 30 a second."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dousa.evaluation._types import PostureSequence
from dousa.motion._types import FloatArray
from dousa.motion.joints import JOINT_INDEX as J

__all__ = ["WORKING_RATE", "Working", "interpolate_segments", "thin_postures"]

WORKING_RATE = 30.0
"""Hz; errors of a dance last half a second and more, so more frames only cost time."""

_HEADING_S = 0.3


@dataclass(frozen=True, slots=True, eq=False)
class Working:
    """Postures at the working rate.

    Parameters
    ----------
    segments : (T, 9, 3) unit vectors.
    seen : (T, 9).
    heading : (T,) rad, unwrapped, which way hips and shoulders face.
    frame_rate : Hz.
    stride : frames of the full rate in one of these.
    """

    segments: FloatArray
    seen: NDArray[np.bool_]
    heading: FloatArray
    frame_rate: float
    stride: int

    @property
    def n_frames(self) -> int:
        """Number of poses."""
        return len(self.segments)

    def to_seconds(self, frame: float) -> float:
        """Time of a frame: the middle of the frames that it is the mean of."""
        return (frame + 0.5 * (self.stride - 1) / self.stride) / self.frame_rate


def thin_postures(postures: PostureSequence) -> Working:
    """Average groups of frames so that about `WORKING_RATE` a second are left; what is left over is dropped."""
    stride = max(1, round(postures.frame_rate / WORKING_RATE))
    stride = min(stride, postures.n_frames)
    count = postures.n_frames // stride
    groups = postures.segments[: count * stride].reshape(count, stride, 9, 3).mean(axis=1)
    length = np.linalg.norm(groups, axis=2, keepdims=True)
    groups = groups / np.maximum(length, 1e-9)
    seen: NDArray[np.bool_] = np.all(postures.seen[: count * stride].reshape(count, stride, 9), axis=1)
    rate = postures.frame_rate / stride
    heading = _measure_heading(postures.positions[: count * stride : stride], round(0.5 * _HEADING_S * rate))
    return Working(groups, seen, heading, rate, stride)


def _measure_heading(positions: FloatArray, half: int) -> FloatArray:
    """(T,) rad about +Y of the front of the body, averaged over ``2 half + 1`` frames."""
    left, right = (
        positions[:, J[f"{side}_hip"]] + positions[:, J[f"{side}_shoulder"]] for side in ("left", "right")
    )
    across = left - right
    front = across[:, 2] + 1j * across[:, 0]
    total = np.cumsum(np.pad(front, (half + 1, half), mode="edge"))
    return np.unwrap(np.angle(total[2 * half + 1 :] - total[: -2 * half - 1]))


def interpolate_segments(segments: FloatArray, frames: FloatArray) -> FloatArray:
    """Unit vectors at fractional frames, ends held; (N, 9, 3) for (N,) frames."""
    frames = np.clip(frames, 0.0, len(segments) - 1.0)
    low = np.minimum(frames.astype(np.intp), max(len(segments) - 2, 0))
    high = np.minimum(low + 1, len(segments) - 1)
    share = (frames - low)[:, None, None]
    mixed = segments[low] * (1.0 - share) + segments[high] * share
    return mixed / np.maximum(np.linalg.norm(mixed, axis=2, keepdims=True), 1e-9)
