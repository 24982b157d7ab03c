"""Which frame rates recordings have: everything is brought to 30 Hz, so a rate near zero would fill the memory."""

from __future__ import annotations

from dousa.errors import InvalidMotionError

__all__ = ["SLOWEST_RATE", "check_frame_rate"]

SLOWEST_RATE = 1.0
"""Hz below which frames are no recording of a motion."""


def check_frame_rate(frame_rate: float) -> None:
    """Raise InvalidMotionError for a frame rate below ``SLOWEST_RATE``."""
    if not frame_rate >= SLOWEST_RATE:
        raise InvalidMotionError(
            f"expected a frame rate of {SLOWEST_RATE:g} Hz or more, got {frame_rate:g} Hz; is it right?"
        )
