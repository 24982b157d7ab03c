"""Curves of glTF: keys of one property of a node, and even times that meet them.

Recordings have a key in every frame. Animators set keys where something changes, some of them a second apart: these
are sampled at 30 to 60 Hz.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from dousa.arrays import FloatArray, IndexArray
from dousa.motion.rotations import normalise, slerp


@dataclass(frozen=True, slots=True, eq=False)
class Curve:
    """The keys of one property of a node.

    Parameters
    ----------
    times : (K,) s, ascending.
    values : (K, n); of a cubic spline (3 K, n): tangent in, value, tangent out.
    kind : ``"LINEAR"``, ``"STEP"`` or ``"CUBICSPLINE"``.
    turns : whether the values are quaternions.
    """

    times: FloatArray
    values: FloatArray
    kind: str
    turns: bool

    def is_sound(self) -> bool:
        """Whether times and values fit together and are usable numbers."""
        per_key = 3 if self.kind == "CUBICSPLINE" else 1
        width = 4 if self.turns else 3
        if not len(self.times) or self.values.shape != (per_key * len(self.times), width):
            return False
        if self.turns and not (np.linalg.norm(self._points(), axis=1) > 1e-6).all():
            return False
        return bool((np.diff(self.times) >= 0).all() and abs(self.times).max() < 1e6)

    def _points(self) -> FloatArray:
        return self.values[1::3] if self.kind == "CUBICSPLINE" else self.values

    def sample(self, times: FloatArray) -> FloatArray:
        """Interpolate values (T, n) at even times; before the first and after the last key the value is held.

        What turns at a key is met at the time nearest to it: a blow between two times does not vanish.
        """
        points = self._points()
        times = self._meet_turns(times)
        after = np.clip(np.searchsorted(self.times, times, side="right"), 1, max(len(self.times) - 1, 1))
        before = after - 1
        if len(self.times) == 1:
            return np.repeat(points, len(times), axis=0)
        span = self.times[after] - self.times[before]
        share = np.clip((times - self.times[before]) / np.where(span > 0, span, 1.0), 0.0, 1.0)
        # A key that was meant: not 0.99999 of the way to it.
        share = np.where(share < 1e-4, 0.0, np.where(share > 1 - 1e-4, 1.0, share))[:, None]
        if self.kind == "STEP":
            return np.where(share < 1, points[before], points[after])
        if self.kind == "CUBICSPLINE":
            return self._spline(before, after, share, span[:, None])
        start, end = points[before], points[after]
        if not self.turns:
            return start + share * (end - start)
        return slerp(normalise(start), normalise(end), share[:, 0])

    def _meet_turns(self, times: FloatArray, least: float = 0.01) -> FloatArray:
        """Put those of the keys where a value turns, begins or ends to move, for the times nearest to them.

        ``least`` : share of the range of the values by which a step counts. Of several keys the one that stands out
        most from its neighbours is met.
        """
        if len(self.times) < 3 or len(times) < 2:
            return times
        points = self._points()
        if self.turns:
            flips = np.cumsum((points[1:] * points[:-1]).sum(axis=1) < 0) % 2 == 1
            points = np.concatenate((points[:1], np.where(flips[:, None], -points[1:], points[1:])))
        steps = np.diff(points, axis=0)
        signs = np.sign(steps) * (np.abs(steps) > least * np.ptp(points, axis=0).max())
        turning = np.flatnonzero((signs[1:] != signs[:-1]).any(axis=1)) + 1
        middle = (points[turning - 1] + points[turning + 1]) / 2
        turning = turning[np.argsort(np.abs(points[turning] - middle).max(axis=1), kind="stable")]
        turning = np.concatenate((turning, [len(points) - 1]))
        step = (times[-1] - times[0]) / (len(times) - 1)
        places = np.rint((self.times[turning] - times[0]) / step).astype(np.intp)
        inside = (places >= 0) & (places < len(times))
        met = times.copy()
        met[places[inside]] = self.times[turning[inside]]
        return met

    def _spline(self, before: IndexArray, after: IndexArray, share: FloatArray, span: FloatArray) -> FloatArray:
        points, tangents_in, tangents_out = self.values[1::3], self.values[0::3], self.values[2::3]
        square, cube = share**2, share**3
        value: FloatArray = (
            (2 * cube - 3 * square + 1) * points[before]
            + span * (cube - 2 * square + share) * tangents_out[before]
            + (3 * square - 2 * cube) * points[after]
            + span * (cube - square) * tangents_in[after]
        )
        return value


# Hz, by the definition of docs/formats.md.
_SLOWEST_RECORDING, _LEAST, _MOST = 10.0, 30.0, 60.0

_RARE, _MANY = 0.2, 9
"""Hz, and steps: so many even keys so far apart are frames with seconds that are wrong, by definition of
docs/formats.md. They are kept, and `dousa.formats.guard` decides on their rate."""

_USUAL = (10, 12.5, 15, 20, 24, 25, 30, 48, 50, 60, 72, 90, 100, 120, 125, 144, 150, 180, 200, 240, 250, 300, 480)
"""Hz, rates of cameras and of systems, by definition."""


def choose_times(
    inputs: list[FloatArray],
    *,
    even_by: float = 0.02,
    fastest: float = 1000.0,
    most_frames: int = 10_000_000,
) -> tuple[FloatArray, float]:
    """Choose even times (T,) that meet the keys of all curves, and their rate in Hz.

    The rate is that of the keys if these are even, also one that no recording has; else the lowest from 30 to 60 Hz at
    which each key falls on a frame, else 60 Hz or, of more keys, theirs.

    Parameters
    ----------
    inputs : (K,) s of the keys of each curve.
    even_by : share of a step by which a key may lie beside its frame.
    fastest : Hz; shorter steps are none.
    most_frames : of the result.
    """
    first, last = min(float(times[0]) for times in inputs), max(float(times[-1]) for times in inputs)
    keys = np.unique(np.concatenate(inputs)) - first
    finest = max(inputs, key=len)
    steps = np.diff(finest)
    steps = steps[steps > 1.0 / fastest]
    measured = 1.0 / float(np.median(steps)) if len(steps) else _LEAST
    if len(steps) == len(finest) - 1 > 0 and (np.abs(steps * measured - 1) < even_by).all():
        # Over the whole length, as single steps are rounded to 32 bits.
        measured = len(steps) / float(finest[-1] - finest[0])
        if measured < _RARE and len(steps) >= _MANY:
            return finest, measured
    rate = max(measured, _MOST)
    for candidate in _list_rates(measured):
        frames = keys * candidate
        if (np.abs(frames - np.rint(frames)) <= even_by + 1e-6 * frames).all():
            rate = candidate
            break
    count = min(round((last - first) * rate) + 1, most_frames)
    return first + np.arange(count) / rate, rate


def _list_rates(measured: float, same: float = 1e-4, rounded: float = 2e-3) -> Iterator[float]:
    """Rates that may meet all keys, of which most are one step of a ``measured`` rate apart.

    ``same``, ``rounded`` : share of a rate within which it is a usual one: of a whole recording, and of single steps.
    """
    usual = min(_USUAL, key=lambda other: abs(other - measured))
    near = abs(usual - measured) / measured
    if measured >= _SLOWEST_RECORDING * (1 - same):  # times of 32 bits
        if near <= rounded:
            yield float(usual)
        if near > same:
            yield measured
    for rate in (*(rate for rate in _USUAL if _LEAST <= rate <= _MOST), measured * math.ceil(_LEAST / measured)):
        if rate <= _MOST:
            yield float(rate)
