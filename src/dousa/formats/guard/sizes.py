"""Sizes: declared against found; limits of joints, markers and memory, checked before anything is allocated."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Mapping

from dousa.errors import MotionFileError
from dousa.messages import Message

MOST_POINTS = 10_000
"""Joints or markers of a file, by definition: a mesh of SMPL has 6,890 vertices, a set of markers some hundred."""

_MOST_BYTES = 16
"""Bytes of memory for each byte of a file, by definition: 50 MB may take 0.8 GB."""

_FREE_BYTES = 256_000_000
"""Bytes that any file may take, by definition."""


def check_points(path: str | os.PathLike[str], count: int, line: int | None = None) -> None:
    """Raise MotionFileError if a file claims or holds more joints or markers than any body has."""
    if count > MOST_POINTS:
        raise MotionFileError(path, "guard.many_points", line, found=count, most=MOST_POINTS)


def check_memory(path: str | os.PathLike[str], needed: int, held: int) -> None:
    """Raise MotionFileError if what a file declares would take far more memory than the file is large.

    Parameters
    ----------
    path : for the message.
    needed : bytes that its content takes as arrays.
    held : bytes of the file.
    """
    if needed > max(_FREE_BYTES, _MOST_BYTES * held):
        raise MotionFileError(path, "guard.memory", needed=needed / 1e6, held=held / 1e6)


def check_even(path: str | os.PathLike[str], counts: Mapping[int, int]) -> int:
    """Return how many values every frame has; MotionFileError if one has others than most, as melted numbers make.

    ``counts`` : by number of the frame, of frames in which something was seen.
    """
    usual = Counter(counts.values()).most_common(1)[0][0]
    odd = [frame for frame, count in counts.items() if count != usual]
    if odd:
        raise MotionFileError(path, "guard.uneven", frame=odd[0], expected=usual, found=counts[odd[0]])
    return usual


def compare_points(declared: float | None, found: int) -> tuple[Message, ...]:
    """Note a declared number of markers or segments that is not that of their names; NaN and None declare none."""
    if declared is None or declared == found or not declared >= 0:
        return ()
    return (Message("guard.point_count", declared=f"{declared:,.0f}", found=found),)


def compare_bytes(declared: int, held: int) -> tuple[Message, ...]:
    """Note bytes that a file has beyond what its header declares, or lacks."""
    if held == declared:
        return ()
    return (Message("guard.bytes_over" if held > declared else "guard.bytes_lacking", n=abs(held - declared)),)
