"""How far off a tracked pose probably is: one figure from what the silhouettes show and the body does not, and back.

Outlines differ by a few centimetres because bodies and segmentations do; a limb that was missed leaves a patch behind,
and one that is in a wrong place sticks out. So what counts is what lies deeper than such a rim. The expected error of a
frame is a product of powers of patches and overhang, and the error's logarithm is distributed normally about it; the
constants are those of a regression, see docs/estimation.md. Joints share it by how far each can be moved unnoticed.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import erf

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import BoolArray, FloatArray
from dousa.estimation.tracking.search_setup import Frame, SearchSetup

LOST_ERROR = 0.15
"""m, mean error of the joints of a frame that is called lost (of a person of usual stature)."""

_RIM = 0.015  # of a standing silhouette's height: what bodies and segmentations differ by
_ASPECT = 0.22  # area of a standing person's silhouette over the square of its height
_WINDOW_S = 0.13  # to either side: tracks are lost and found in more than a frame
_LEAST = 0.004  # share of the silhouettes that is no patch worth the name
_PATCHES, _OVERHANG, _SCALE = 0.495, 0.128, 0.119  # powers, and the logarithm of the error (m) where both are one
_HABIT, _OFTEN, _ENOUGH = 0.7, 0.1, 10  # of what nine frames in ten leave, a share that is no error: shadows, clothes
_ONE_VIEW = 1.5  # of the logarithm, where lines of sight do not meet
_SPREAD, _SPREAD_ONE_VIEW = 0.387, 0.671  # of the logarithm
_LOST = 0.2  # probability of an error above `LOST_ERROR`
_USUAL_STATURE = 1.72  # m
_RIGID = 0.03  # m: what a joint is off by that no movement of its own tells


def erode(bits: NDArray[np.uint64], steps: int) -> NDArray[np.uint64]:
    """Pictures of bits (..., H, words) without what lies within ``steps`` rows and columns of a rim, like a diamond."""
    one, last = np.uint64(1), np.uint64(63)
    for _ in range(steps):
        left = bits << one
        left[..., 1:] |= bits[..., :-1] >> last
        right = bits >> one
        right[..., :-1] |= bits[..., 1:] << last
        kept = bits & left & right
        kept[..., 1:, :] &= bits[..., :-1, :]
        kept[..., :-1, :] &= bits[..., 1:, :]
        kept[..., 0, :] = 0
        kept[..., -1, :] = 0
        bits = kept
    return bits


class PatchMeasure:
    """Measures what of the silhouettes no part covers, and what of the body lies outside them.

    Parameters
    ----------
    area : px, mean area of a silhouette at the working size.
    """

    def __init__(self, area: float) -> None:
        self.area = max(area, 1.0)
        self.steps = max(1, round(_RIM * float(np.sqrt(self.area / _ASPECT))))

    def measure(self, drawn: NDArray[np.uint64], frame: Frame) -> FloatArray:
        """Patches and overhang (2,) of the drawn body (V, H, words): shares of a usual silhouette, means of the views.

        Of a frame in which nobody is seen they are nan.
        """
        seen = frame.seen
        if not seen.any():
            return np.full(2, np.nan)
        silhouettes, body = frame.bits[seen], drawn[seen]
        both = (erode(silhouettes & ~body, self.steps), erode(body & ~silhouettes, self.steps))
        counts = np.array([np.bitwise_count(deep).sum() for deep in both], np.float64)
        return np.asarray(counts / (self.area * seen.sum()))


@dataclass(frozen=True, slots=True, eq=False)
class Doubt:
    """How far to trust a track.

    Parameters
    ----------
    errors : (T, P + K) m, expected error of each joint and tip.
    lost : (T,) true where the mean error is too likely above `LOST_ERROR`, and where nobody is seen.
    """

    errors: FloatArray
    lost: BoolArray


class ErrorModel:
    """Tells how far off poses probably are.

    Parameters
    ----------
    setup : body, cameras and settings.
    meet : whether the lines of sight of the views meet, so that they tell depth.
    """

    def __init__(self, setup: SearchSetup, meet: bool) -> None:
        self.scale = setup.body.stature / _USUAL_STATURE
        self.frame_rate = setup.frame_rate
        self.shift, self.spread = (0.0, _SPREAD) if meet else (_ONE_VIEW, _SPREAD_ONE_VIEW)

    def judge(self, patches: FloatArray, widths: FloatArray, habit: float | None = None) -> Doubt:
        """Doubt of frames in succession.

        Parameters
        ----------
        patches : (T, 2) patches and overhang, nan where nobody is seen.
        widths : (T, P + K) m, how far each point can be moved unnoticed.
        habit : see `find_habit`; of these frames by default.
        """
        seen = np.asarray(np.isfinite(patches).all(axis=1))
        found = np.where(seen[:, None], _average(patches, seen, round(_WINDOW_S * self.frame_rate)), 1.0)
        found[:, 0] = np.maximum(found[:, 0] - (find_habit(patches) if habit is None else habit), 0.0)
        middle = _SCALE + self.shift + np.log(found + _LEAST) @ (_PATCHES, _OVERHANG)
        expected = np.exp(middle + 0.5 * self.spread**2)
        above = np.array([0.5 * (1.0 + erf(z)) for z in (middle - np.log(LOST_ERROR)) / (self.spread * np.sqrt(2.0))])
        own = np.hypot(widths, _RIGID * self.scale)
        errors = self.scale * expected[:, None] * own / own.mean(axis=1, keepdims=True)
        return Doubt(errors, np.asarray((above > _LOST) | ~seen))


def find_habit(patches: FloatArray) -> float:
    """What patches (T, 2) have in nearly every frame, so that it tells of shadows or clothes and not of an error."""
    seen = patches[np.isfinite(patches[:, 0]), 0]
    return _HABIT * float(np.quantile(seen, _OFTEN)) if len(seen) >= _ENOUGH else 0.0


def _average(values: FloatArray, known: BoolArray, reach: int) -> FloatArray:
    """Means (T, n) over the known frames within ``reach``; 0 where there is none."""
    window = np.ones(2 * reach + 1)
    count = np.convolve(known, window)[reach : reach + len(known)]
    columns = [np.convolve(np.where(known, column, 0.0), window)[reach : reach + len(known)] for column in values.T]
    return np.asarray(np.stack(columns, axis=1) / np.maximum(count, 1.0)[:, None])
