"""Keys of an animation: sampling times, and interpolation (glTF 2.0, appendix C)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dousa.arrays import FloatArray, IndexArray

_USUAL_RATES = (12.5, 15, 20, 24, 25, 30, 48, 50, 60, 72, 90, 100, 120, 125, 144, 150, 180, 200, 240, 250, 300, 480)
_SAME_RATE, _MEASURED, _EVEN = 2e-3, 1e-4, 0.02
_FASTEST, _MOST_FRAMES = 1000.0, 10_000_000


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
        """Interpolate values (T, n) at some times; before the first and after the last key the value is held."""
        points = self._points()
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
        return _slerp(start, end, share)

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


def _slerp(start: FloatArray, end: FloatArray, share: FloatArray) -> FloatArray:
    cosine = (start * end).sum(axis=1, keepdims=True)
    end = np.where(cosine < 0, -end, end)
    angle = np.arccos(np.clip(np.abs(cosine), 0.0, 1.0))
    sine = np.where(angle > 1e-5, np.sin(angle), 1.0)
    first = np.where(angle > 1e-5, np.sin((1 - share) * angle) / sine, 1 - share)
    second = np.where(angle > 1e-5, np.sin(share * angle) / sine, share)
    turned: FloatArray = first * start + second * end
    return turned


def choose_times(inputs: list[FloatArray]) -> tuple[FloatArray, float]:
    """Choose even times (T,) that meet the keys of all curves, and their rate in Hz.

    The rate is one over the usual step between keys, rounded to a usual rate within its precision.
    """
    first, last = min(float(times[0]) for times in inputs), max(float(times[-1]) for times in inputs)
    finest = max(inputs, key=len)
    steps = np.diff(finest)
    steps = steps[steps > 1.0 / _FASTEST]
    step = float(np.median(steps)) if len(steps) else 1.0 / 30
    even = len(steps) == len(finest) - 1 > 0 and (np.abs(steps - step) < _EVEN * step).all()
    # Over the whole length, as single steps are rounded to 32 bits.
    rate = len(steps) / float(finest[-1] - finest[0]) if even else 1.0 / step
    usual = min(_USUAL_RATES, key=lambda other: abs(other - rate))
    if abs(usual - rate) <= (_MEASURED if even else _SAME_RATE) * rate:
        rate = float(usual)
    count = min(round((last - first) * rate) + 1, _MOST_FRAMES)
    return first + np.arange(count) / rate, rate
