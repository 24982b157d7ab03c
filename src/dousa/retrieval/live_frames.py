"""Frames of a live motion as lines of JSON, one frame a line.

Before the frames may stand one line that says what is known of all: ``{"height": 1.7, "frame_rate": 30}``, either or
both. A frame is ``{"time": 0.033, "joints": {"left_hand": [x, y, z], ...}}`` with the names of ``CANONICAL_JOINTS``, or
``{"time": 0.033, "positions": [[x, y, z], ...]}`` with all 20 in their order; metres, seconds, Y up. Where the frame
rate was told, the time may be left out. A joint that is missing or null stays where it was last seen; the first frame
needs all.
"""

from __future__ import annotations

import json
import reprlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from math import isnan
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dousa.errors import InvalidMotionError
from dousa.motion.joints import CANONICAL_JOINTS, JOINT_INDEX

__all__ = ["LiveFrame", "LiveFrameParser", "read_live_frames"]

_N_JOINTS = len(CANONICAL_JOINTS)


@dataclass(frozen=True, slots=True, eq=False)
class LiveFrame:
    """One frame.

    Parameters
    ----------
    time : s.
    positions : (20, 3) m.
    held : joints that were missing and stay where they were.
    """

    time: float
    positions: NDArray[np.float64]
    held: tuple[str, ...] = ()


class LiveFrameParser:
    """Reads lines one at a time and remembers what a later line needs.

    Attributes
    ----------
    height, frame_rate : of the header; None where it did not say.
    """

    def __init__(self) -> None:
        self.height: float | None = None
        self.frame_rate: float | None = None
        self._last: NDArray[np.float64] | None = None
        self._line = 0
        self._frames = 0

    def parse(self, line: str) -> LiveFrame | None:
        """The frame of a line; None for an empty line and for the header.

        Raises
        ------
        InvalidMotionError : with the number of the line, and what was expected.
        """
        self._line += 1
        if not line.strip():
            return None
        try:
            said = json.loads(line)
        except (ValueError, RecursionError) as error:
            raise self._wrong(f"expected one JSON object a line: {error}") from error
        if not isinstance(said, dict):
            raise self._wrong(f"expected a JSON object, got {type(said).__name__}")
        if "joints" not in said and "positions" not in said:
            self._take_header(said)
            return None
        positions, held = self._read_positions(said)
        frame = LiveFrame(self._read_time(said), positions, held)
        self._last = positions
        self._frames += 1
        return frame

    @property
    def line(self) -> int:
        """Number of the last line that was read, from 1."""
        return self._line

    def _wrong(self, problem: str) -> InvalidMotionError:
        return InvalidMotionError(f"line {self._line}: {problem}")

    def _take_header(self, said: dict[str, Any]) -> None:
        strange = sorted(set(said) - {"height", "frame_rate"})
        if strange or not said or self._frames:
            names = reprlib.repr(", ".join(sorted(said))) if said else "nothing"
            raise self._wrong(f"expected a frame with 'joints' or 'positions', got {names}")
        if "height" in said:
            self.height = self._read_number(said["height"], "height in m", 0.1, 10.0)
        if "frame_rate" in said:
            self.frame_rate = self._read_number(said["frame_rate"], "frame_rate in Hz", 0.1, 1e5)

    def _read_number(self, value: object, what: str, least: float, most: float) -> float:
        right = isinstance(value, int | float) and not isinstance(value, bool)
        if not right or not least <= float(value) <= most:  # type: ignore[arg-type]
            raise self._wrong(f"expected {what} from {least:g} to {most:g}, got {reprlib.repr(value)}")
        return float(value)  # type: ignore[arg-type]

    def _read_time(self, said: dict[str, Any]) -> float:
        if "time" in said:
            return self._read_number(said["time"], "time in s", -1e12, 1e12)
        if self.frame_rate is None:
            raise self._wrong("expected 'time' in s, as no header told a frame_rate")
        return self._frames / self.frame_rate

    def _read_positions(self, said: dict[str, Any]) -> tuple[NDArray[np.float64], tuple[str, ...]]:
        named = said.get("joints")
        if "positions" in said:
            listed = said["positions"]
            if not isinstance(listed, list) or len(listed) != _N_JOINTS:
                count = len(listed) if isinstance(listed, list) else type(listed).__name__
                raise self._wrong(f"expected 'positions' of {_N_JOINTS} joints, got {count}")
            named = dict(zip(CANONICAL_JOINTS, listed, strict=True))
        if not isinstance(named, dict):
            raise self._wrong(f"expected 'joints' as an object of names, got {type(named).__name__}")
        strange = sorted(set(named) - set(JOINT_INDEX))
        if strange:
            raise self._wrong(
                f"no joint {reprlib.repr(strange[0])}; the joints are: {', '.join(CANONICAL_JOINTS)}"
            )
        positions = np.full((_N_JOINTS, 3), np.nan)
        for name, place in named.items():
            if place is not None:
                positions[JOINT_INDEX[name]] = self._read_place(name, place)
        return self._hold(positions)

    def _read_place(self, name: str, place: object) -> list[float]:
        if not isinstance(place, list) or len(place) != 3:
            raise self._wrong(f"expected [x, y, z] for {name}, got {reprlib.repr(place)}")
        # NaN, which JSON does not have but Python writes, is a joint not seen, as null is.
        if any(value is None or (isinstance(value, float) and isnan(value)) for value in place):
            return [np.nan] * 3
        if not all(type(value) in (int, float) and abs(value) < 1e9 for value in place):
            raise self._wrong(f"expected [x, y, z] in m for {name}, got {reprlib.repr(place)}")
        return [float(value) for value in place]

    def _hold(self, positions: NDArray[np.float64]) -> tuple[NDArray[np.float64], tuple[str, ...]]:
        missing = np.isnan(positions).any(axis=1)
        if not missing.any():
            return positions, ()
        names = tuple(CANONICAL_JOINTS[k] for k in np.flatnonzero(missing))
        if self._last is None:
            raise self._wrong(f"the first frame needs all {_N_JOINTS} joints; missing: {', '.join(names)}")
        positions[missing] = self._last[missing]
        return positions, names


def read_live_frames(lines: Iterable[str], parser: LiveFrameParser | None = None) -> Iterator[LiveFrame]:
    """The frames of lines as they come.

    Parameters
    ----------
    lines : of a file or of standard input.
    parser : to know the header; None for one of its own.

    Raises
    ------
    InvalidMotionError : a line that is no frame, with its number.
    """
    reader = parser or LiveFrameParser()
    for line in lines:
        frame = reader.parse(line)
        if frame is not None:
            yield frame
