"""The posture of an exercise over time, free of heading, and how far it is from rest."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dousa.arrays import FloatArray
from dousa.evaluation.posture.posture import PostureSequence, Working, thin_postures
from dousa.evaluation.posture.yaw import rotate_yaw
from dousa.motion.resampling import smooth_gaussian

_HEADING_S = 0.5  # standard deviation: who turns on the way turns slowly
_SMOOTH_S = 0.06
_RATE = 15.0  # Hz at which repetitions are looked for; their bounds are found at the full rate
_STILL = 0.6  # chord a second below which a body is at rest
_ALIKE = 0.35  # chord within which two postures are of one rest
_MOST_RESTS = 6


@dataclass(frozen=True, slots=True, eq=False)
class PostureCurve:
    """Postures without heading, as points of a space in which distances are chords.

    Parameters
    ----------
    fine : (T, 27) nine unit vectors in the body's frame, at the full rate.
    fine_rate : Hz.
    coarse : (U, 27) the same at about 15 Hz.
    stride : frames of ``fine`` in one of ``coarse``.
    place : (U, 2) m, where on the floor the body is.
    """

    fine: FloatArray
    fine_rate: float
    coarse: FloatArray
    stride: int
    place: FloatArray

    @property
    def rate(self) -> float:
        """Hz of ``coarse``."""
        return self.fine_rate / self.stride


def compute_curve(postures: PostureSequence) -> PostureCurve:
    """Take the heading off, which turns slowly, and smooth what a sensor adds."""
    rate = postures.frame_rate
    heading = _follow_heading(thin_postures(postures), postures.n_frames)
    turned = rotate_yaw(postures.segments, -heading).reshape(postures.n_frames, -1)
    fine = smooth_gaussian(turned, max(_SMOOTH_S * rate, 0.3))
    stride = max(1, round(rate / _RATE))
    return PostureCurve(
        fine, rate, np.ascontiguousarray(fine[::stride]), stride, postures.positions[::stride, 0][:, [0, 2]]
    )


def _follow_heading(working: Working, n_frames: int) -> FloatArray:
    smooth = smooth_gaussian(working.heading, _HEADING_S * working.frame_rate)
    places = np.arange(working.n_frames) * working.stride
    return np.interp(np.arange(n_frames), places, smooth)


def find_rests(curve: PostureCurve) -> FloatArray:
    """Postures in which the body often is and hardly moves, the most frequent one first.

    Returns
    -------
    (K, 27), K from 2 to 8: where the recording begins and ends are among them.
    """
    points = curve.coarse
    speed = np.linalg.norm(np.gradient(points, axis=0), axis=1) * curve.rate if len(points) > 1 else np.zeros(1)
    calm = 1.0 / (1.0 + (speed / _STILL) ** 2)
    some = points[:: max(1, len(points) // 400)]
    near = np.exp(-0.5 * _squared(some, points) / _ALIKE**2) * calm
    rests: list[FloatArray] = [points[0], points[-1]]  # who starts at once, or stops at once, is nowhere long
    left = np.ones(len(points))
    while len(rests) < _MOST_RESTS + 2:
        weight = near @ left
        best = int(weight.argmax())
        if weight[best] < 0.3 * curve.rate:
            break
        share = near[best] * left
        rests.append((share @ points) / max(share.sum(), 1e-9))
        left = left * (1.0 - np.exp(-0.5 * _squared(rests[-1][None], points)[0] / (2 * _ALIKE) ** 2))
    return np.array(rests)


def _squared(a: FloatArray, b: FloatArray) -> FloatArray:
    """(N, M) squared distances of (N, D) and (M, D)."""
    sums = (a * a).sum(axis=1)[:, None] + (b * b).sum(axis=1)[None] - 2.0 * (a @ b.T)
    return np.asarray(np.maximum(sums, 0.0))


def compare_displacements(curve: FloatArray, template: FloatArray) -> FloatArray:
    """(T, n) squared distances between displacements from rest, (T, D) and (n, D)."""
    return _squared(curve, template)
