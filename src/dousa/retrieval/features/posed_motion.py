"""What retrieval takes for a motion, and whether it can be used."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from dousa.arrays import FloatArray
from dousa.errors import InvalidMotionError
from dousa.motion.annotation import Stretch
from dousa.motion.canonical.joints import CANONICAL_JOINTS

SLOWEST_RATE = 1.0
"""Hz: everything is brought to 30 Hz, so a rate near zero would fill the memory."""


class PosedMotion(Protocol):
    """A motion on canonical joints: a ``CanonicalMotion``, a ``LabelledClip`` or anything like them."""

    @property
    def positions(self) -> FloatArray:
        """(n, 20, 3) m, Y up, finite."""

    @property
    def frame_rate(self) -> float:
        """Hz."""

    @property
    def height(self) -> float:
        """m, of the performer."""


def check_motion(motion: PosedMotion) -> FloatArray:
    """The positions (n, 20, 3) of a motion.

    Raises
    ------
    InvalidMotionError : another shape, no frame, positions that are not finite, no body height.
    """
    points = check_shape(motion.positions, motion.height)
    if not np.isfinite(points).all():
        raise InvalidMotionError("posed_motion.not_finite")
    return points


def check_shape(positions: ArrayLike, height: float) -> FloatArray:
    """The positions (n, 20, 3); InvalidMotionError for another shape, no frame or no body height."""
    points = np.asarray(positions, np.float64)
    if points.ndim != 3 or points.shape[1:] != (len(CANONICAL_JOINTS), 3) or not len(points):
        raise InvalidMotionError("posed_motion.shape", shape=points.shape)
    if not (np.isfinite(height) and height > 0):
        raise InvalidMotionError("posed_motion.height", height=height)
    return points


def check_frame_rate(frame_rate: float) -> None:
    """Raise InvalidMotionError for a frame rate below ``SLOWEST_RATE``."""
    if not frame_rate >= SLOWEST_RATE:
        raise InvalidMotionError("posed_motion.rate", slowest=SLOWEST_RATE, rate=frame_rate)


@dataclass(frozen=True, slots=True, eq=False)
class LabelledClip:
    """A motion on canonical joints, with what it shows and who performs it.

    Parameters
    ----------
    name : path or other name, for messages.
    category : the label.
    performer : who moves; None where unknown.
    positions : (T, 20, 3) m.
    frame_rate : Hz.
    height : m, of the performer.
    """

    name: str
    category: str
    performer: str | None
    positions: FloatArray
    frame_rate: float
    height: float


@dataclass(frozen=True, slots=True, eq=False)
class AnnotatedTake:
    """An uncut recording on canonical joints, with what happens in it and who performs it.

    Parameters
    ----------
    name : path or other name, for messages.
    performer : who moves; None where unknown.
    positions : (T, 20, 3) m.
    frame_rate : Hz.
    height : m, of the performer.
    stretches : from beginning to end without gaps. One without a category shows what "nothing" and "between" look like,
        unless it is not ``counted``: then nobody can say what it is.
    """

    name: str
    performer: str | None
    positions: FloatArray
    frame_rate: float
    height: float
    stretches: tuple[Stretch, ...]
