"""What retrieval takes for a motion, and whether it can be used."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from dousa.errors import InvalidMotionError
from dousa.motion.joints import CANONICAL_JOINTS

__all__ = ["SLOWEST_RATE", "PosedMotion", "check_frame_rate", "check_motion"]

SLOWEST_RATE = 1.0
"""Hz: everything is brought to 30 Hz, so a rate near zero would fill the memory."""


class PosedMotion(Protocol):
    """A motion on canonical joints: a ``CanonicalMotion``, a ``LabelledClip`` or anything like them."""

    @property
    def positions(self) -> NDArray[np.float64]:
        """(n, 20, 3) m, Y up, finite."""

    @property
    def frame_rate(self) -> float:
        """Hz."""

    @property
    def height(self) -> float:
        """m, of the performer."""


def check_motion(motion: PosedMotion) -> NDArray[np.float64]:
    """The positions (n, 20, 3) of a motion.

    Raises
    ------
    InvalidMotionError : another shape, no frame, positions that are not finite, no body height.
    """
    points = np.asarray(motion.positions, np.float64)
    if points.ndim != 3 or points.shape[1:] != (len(CANONICAL_JOINTS), 3) or not len(points):
        raise InvalidMotionError(f"expected canonical positions (frames, 20, 3), got shape {points.shape}")
    if not (np.isfinite(motion.height) and motion.height > 0):
        raise InvalidMotionError(f"expected a body height above 0 m, got {motion.height}")
    if not np.isfinite(points).all():
        raise InvalidMotionError("expected finite positions, got NaN or infinity; canonicalise fills gaps")
    return points


def check_frame_rate(frame_rate: float) -> None:
    """Raise InvalidMotionError for a frame rate below ``SLOWEST_RATE``."""
    if not frame_rate >= SLOWEST_RATE:
        raise InvalidMotionError(
            f"expected a frame rate of {SLOWEST_RATE:g} Hz or more, got {frame_rate:g} Hz; is it right?"
        )
