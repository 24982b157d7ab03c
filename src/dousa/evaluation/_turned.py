"""The reference turned about the vertical onto the mean of a figure, by an angle that changes slowly."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dousa.evaluation._types import PostureSequence
from dousa.evaluation.eigenspace import Eigenspace
from dousa.evaluation.furi import Furi
from dousa.evaluation.yaw import rotate_yaw
from dousa.motion._types import FloatArray

__all__ = ["Turned", "turn_reference"]

_MARGIN_S = 1.0  # who is late shows the end of the figure before: not a wrong pose
_TURN_RATE = 30.0  # Hz, of the poses whose angle is measured
_TURN_WINDOW_S = (
    0.3  # of its median: longer than a near-vertical pose that faces anywhere, shorter than a spin
)


@dataclass(frozen=True, slots=True, eq=False)
class Turned:
    """Reference poses of a figure and a second around it, turned onto the figure's mean.

    Parameters
    ----------
    segments : (n, 9, 3).
    turn : (n,) rad by which they were turned, unwrapped.
    seen : (n,) where all segments are.
    first : frame of the reference.
    """

    segments: FloatArray
    turn: FloatArray
    seen: NDArray[np.bool_]
    first: int

    def find(self, figure: Furi) -> slice:
        """Where the figure lies in the arrays."""
        return slice(figure.start - self.first, figure.end - self.first)

    def find_turn(self, frames: FloatArray) -> FloatArray:
        """(N,) rad at fractional frames of the reference, ends held."""
        return np.interp(frames, self.first + np.arange(len(self.turn)), self.turn)


def turn_reference(reference: PostureSequence, figure: Furi, space: Eigenspace) -> Turned:
    """Turn the poses of a figure, and a second around it, onto its mean.

    Parameters
    ----------
    reference : the dance.
    figure : of it.
    space : of its label.

    Not in the paper, which turns each pose by itself: a pose that is nearly vertical in all segments may then be
    turned any way, and another way than its neighbours.
    """
    margin = round(_MARGIN_S * reference.frame_rate)
    part = slice(max(figure.start - margin, 0), min(figure.end + margin, reference.n_frames))
    segments, seen = reference.segments[part], np.all(reference.seen[part], axis=1)
    step = max(1, int(reference.frame_rate // _TURN_RATE))
    sample = np.arange(0, len(segments), step)
    half = round(0.5 * _TURN_WINDOW_S * reference.frame_rate / step)
    angle = _smooth_turn(np.unwrap(space.find_turn(segments[sample])), half)
    turn = np.interp(np.arange(len(segments)), sample, angle)
    return Turned(rotate_yaw(segments, turn), turn, seen, part.start)


def _smooth_turn(angle: FloatArray, half: int) -> FloatArray:
    """Median of the values around each, the ends repeated."""
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(angle, half, mode="edge"), 2 * half + 1)
    return np.median(windows, axis=1)
