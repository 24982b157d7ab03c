"""Both dancers at the same moments, seen from the body of the one who shows it: left, up and front."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import FloatArray
from dousa.evaluation.posture.posture import PostureSequence, interpolate_segments
from dousa.evaluation.posture.yaw import WRONG_CHORD, ComplexArray, get_horizontal, rotate_yaw
from dousa.motion import JOINT_INDEX as J

_MARGIN_S = 0.5
_YAW_S = 0.5  # the yaw is that of half a second
_ROUNDS = 4
_SUSTAINED_S = 0.4


@dataclass(frozen=True, slots=True, eq=False)
class PosePairs:
    """Poses of the same moments in the reference's body frame: x to its left, y up, z to its front.

    Parameters
    ----------
    ours : (N, 9, 3) unit vectors of the performance, turned onto the reference.
    theirs : (N, 9, 3) of the reference.
    judged : (N, 9) whether both are seen, and the moment has a place in the reference.
    times : (N,) s of the performance.
    reference_times : (N,) s of the reference; nan where it has none.
    frame_rate : Hz.
    """

    ours: FloatArray
    theirs: FloatArray
    judged: NDArray[np.bool_]
    times: FloatArray
    reference_times: FloatArray
    frame_rate: float

    @property
    def angles(self) -> FloatArray:
        """(N, 9) rad between both; 0 where not judged."""
        chord = np.linalg.norm(self.ours - self.theirs, axis=2)
        return np.where(self.judged, 2.0 * np.arcsin(np.minimum(0.5 * chord, 1.0)), 0.0)

    def cut(self, start_s: float, end_s: float) -> PosePairs:
        """The moments of a span of the performance, one at least."""
        last = len(self.times) - 1
        first = int(np.clip(np.searchsorted(self.times, start_s), 0, last))
        end = int(np.clip(np.searchsorted(self.times, end_s, "right"), first + 1, last + 1))
        return self._slice(slice(first, end))

    def find_worst(self, segments: list[int]) -> PosePairs:
        """The moments around the one where these segments are farthest off for some time (0.4 s)."""
        half = max(0, round(0.5 * _SUSTAINED_S * self.frame_rate))
        off = (self.angles[:, segments] ** 2).sum(axis=1)
        total = np.cumsum(np.pad(off, (half + 1, half)))
        middle = int(np.argmax(total[2 * half + 1 :] - total[: len(off)]))
        return self._slice(slice(max(middle - half, 0), middle + half + 1))

    def _slice(self, span: slice) -> PosePairs:
        return PosePairs(
            self.ours[span],
            self.theirs[span],
            self.judged[span],
            self.times[span],
            self.reference_times[span],
            self.frame_rate,
        )


class PairedDancers:
    """A performance and its reference, of which the poses of any span can be had.

    Parameters
    ----------
    reference, performance : at one frame rate.
    same_time : (T,) s, reference time of each frame of the performance; nan where it has none.
    first_s : performance time of the first frame.
    """

    def __init__(
        self, reference: PostureSequence, performance: PostureSequence, same_time: FloatArray, first_s: float = 0.0
    ) -> None:
        self._reference, self._performance = reference, performance
        self._same_time, self._first_s = same_time, first_s

    def pair(self, start_s: float, end_s: float) -> PosePairs | None:
        """The poses of a span of the performance; None if nothing of it is judged."""
        rate, count = self._performance.frame_rate, self._performance.n_frames
        if not (np.isfinite(start_s) and np.isfinite(end_s)) or count == 0:
            return None
        first = int(np.clip(np.floor((start_s - self._first_s - _MARGIN_S) * rate), 0, count - 1))
        last = int(np.clip(np.ceil((end_s - self._first_s + _MARGIN_S) * rate) + 1, first + 1, count))
        found = self._pair(slice(first, last)).cut(start_s, end_s)
        return found if found.judged.any() else None

    def _pair(self, span: slice) -> PosePairs:
        rate, reference = self._performance.frame_rate, self._reference
        there = np.asarray(self._same_time[span], np.float64)
        inside = np.isfinite(there)
        frames = np.clip(np.where(inside, there, 0.0) * reference.frame_rate, 0.0, reference.n_frames - 1.0)
        seen = reference.seen[np.floor(frames).astype(np.intp)] & reference.seen[np.ceil(frames).astype(np.intp)]
        judged = self._performance.seen[span] & seen & inside[:, None]
        theirs, ours = interpolate_segments(reference.segments, frames), self._performance.segments[span]
        lines = _find_lines(reference.positions[np.rint(frames).astype(np.intp)])
        own = _find_lines(self._performance.positions[span])
        half = max(0, round(0.5 * _YAW_S * rate))
        yaw = _estimate_yaw(ours, theirs, own, lines, judged, half)
        # A line from right to left points a quarter turn to the left of where the body faces.
        front = np.angle(_smooth(lines.sum(axis=1) * inside, half)) - 0.5 * np.pi
        times = self._first_s + np.arange(span.start, span.stop) / rate
        return PosePairs(rotate_yaw(ours, -yaw - front), rotate_yaw(theirs, -front), judged, times, there, rate)


def _find_lines(positions: FloatArray) -> ComplexArray:
    """(N, 2) horizontal parts of the lines through both hips and through both shoulders, of length 1, to the left."""
    across = [positions[:, J[f"left_{name}"]] - positions[:, J[f"right_{name}"]] for name in ("hip", "shoulder")]
    found: ComplexArray = np.stack([one[:, 2] + 1j * one[:, 0] for one in across], axis=1)
    size = np.abs(found)
    return np.divide(found, size, out=np.zeros_like(found), where=np.isfinite(size) & (size > 1e-6))


def _estimate_yaw(
    ours: FloatArray,
    theirs: FloatArray,
    own_lines: ComplexArray,
    lines: ComplexArray,
    judged: NDArray[np.bool_],
    half: int,
) -> FloatArray:
    """(N,) rad that turns the reference onto the performance.

    Of somebody who stands upright with the arms out, the segments alone do not tell which of both arms is wrong;
    hips and shoulders do. So the estimate begins with these, and segments that are far off lose weight.
    """
    straight = (own_lines * lines.conj()).sum(axis=1)
    products = get_horizontal(ours) * get_horizontal(theirs).conj()
    fixed = 2.0 - 2.0 * ours[..., 1] * theirs[..., 1]
    turn = _smooth(straight, half)
    for _ in range(_ROUNDS):
        squared = np.maximum(fixed - 2.0 * (products * turn.conj()[:, None]).real, 0.0)
        trust = judged / (1.0 + squared / WRONG_CHORD**2) ** 2
        turn = _smooth((products * trust).sum(axis=1) + straight, half)
    return np.angle(turn)


def _smooth(values: ComplexArray, half: int) -> ComplexArray:
    """Sums over a window."""
    total = np.cumsum(np.pad(values, (half + 1, half)))
    summed: ComplexArray = total[2 * half + 1 :] - total[: len(values)]
    size = np.abs(summed)
    return np.divide(summed, size, out=np.ones_like(summed), where=size > 1e-9)
