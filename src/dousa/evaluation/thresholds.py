"""What is tolerated: from the performer's own steadiness, and from several takes of the reference."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dousa.evaluation._deviation import Deviations
from dousa.evaluation._evidence import SLACK_S
from dousa.evaluation._explain import Finding
from dousa.motion._types import FloatArray

__all__ = ["Tolerance", "measure_unsteadiness", "widen"]

_STEADIEST, _UNSTEADIEST = np.radians(3.0), np.radians(9.0)
_MULTIPLE = 2.4
_LEAST = np.radians(10.0)
_NEAR_S = 0.14
_WIDER = 1.2
_WOBBLE_S, _WOBBLE_PERCENTILE, _WOBBLE_MULTIPLE, _MOST_SLACK_S = 0.5, 20.0, 3.0, 0.3


@dataclass(frozen=True, slots=True, eq=False)
class Tolerance:
    """What is tolerated.

    Parameters
    ----------
    angle : (9,) rad, of each segment.
    lag_s : s.
    """

    angle: FloatArray
    lag_s: float = SLACK_S


def measure_unsteadiness(deviations: Deviations) -> Tolerance:
    """Tolerance from one performance: multiples of how far segments and time mostly are from the reference."""
    reach = max(1, round(_NEAR_S / deviations.step_s))
    center = deviations.center
    near = slice(max(center - reach, 0), center + reach + 1)
    nearest = deviations.squared[:, near].sum(axis=2).argmin(axis=1)
    left = np.take_along_axis(deviations.squared[:, near], nearest[:, None, None], axis=1)[:, 0]
    # The root mean square of a wavering direction is 1.2 times its median; errors hardly move the median.
    typical = 1.2 * np.sqrt(np.median(left, axis=0))
    steadiness = np.clip(typical, _STEADIEST, _UNSTEADIEST)
    return Tolerance(np.maximum(_MULTIPLE * steadiness, _LEAST), _measure_wobble(deviations))


def _measure_wobble(deviations: Deviations) -> float:
    """Lag in s that is forgiven: nobody is steadier than `SLACK_S`, many are less steady throughout."""
    center = deviations.center
    reach = min(round(_WOBBLE_S / deviations.step_s), center - 1)
    near = deviations.squared[:, center - reach - 1 : center + reach + 2].sum(axis=2)
    # One frame's minimum is noise; a few frames at the same lag have one.
    near = np.apply_along_axis(np.convolve, 0, near, np.ones(5) / 5.0, "same")
    nearest = near[:, 1:-1].argmin(axis=1) + 1
    rows = np.arange(len(near))
    left, here, right = (near[rows, nearest + step] for step in (-1, 0, 1))
    bend = np.maximum(left - 2.0 * here + right, 1e-6)
    lag = nearest - (reach + 1) + np.clip(0.5 * (left - right) / bend, -0.5, 0.5)
    # Of a pose that is held every moment is as good: what moves most tells the time.
    speed = ((deviations.reference[1:] - deviations.reference[:-1]) ** 2).sum(axis=(1, 2))
    moving = np.flatnonzero(speed >= np.percentile(speed, 60.0)) if len(speed) else rows
    typical = float(np.percentile(np.abs(lag[moving]), _WOBBLE_PERCENTILE)) * deviations.step_s
    return float(np.clip(_WOBBLE_MULTIPLE * typical, SLACK_S, _MOST_SLACK_S))


def widen(tolerance: Tolerance, found: Sequence[Finding]) -> Tolerance:
    """A little more tolerance of what was found: time for shifts, angles of the segments for the rest."""
    angle, lag_s = tolerance.angle.copy(), tolerance.lag_s
    for finding in found:
        if finding.kind == "shift":
            lag_s = max(lag_s, tolerance.lag_s * _WIDER, abs(finding.lag_s or 0.0))
        else:
            segments = list(finding.segments)
            angle[segments] = tolerance.angle[segments] * _WIDER
    return Tolerance(angle, lag_s)
