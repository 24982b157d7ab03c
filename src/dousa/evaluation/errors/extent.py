"""How much smaller a motion is than the reference's: shrinking towards a point, in windows and in stretches.

An arm that is merely short leaves the eigenspace, so that the distance inside it does not show an incomplete motion.
The gain does: performance = gain * reference + constant, fitted over the segments of a limb.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import FloatArray
from dousa.evaluation.errors.deviation import Deviations
from dousa.evaluation.posture.posture import LIMBS, SEGMENTS

GROUPS: dict[str, NDArray[np.intp]] = {"body": np.arange(len(SEGMENTS))} | {
    limb: np.array(indices) for limb, indices in LIMBS.items()
}
"""What shrinks as one: the body, or a limb."""

_WINDOWS_S = (0.7, 1.2, 2.0)
_EVIDENCE = 8.0  # by how much shrinking explains a window better than a constant difference
_SHORT = np.radians(10.0)  # range that is missing
_SMALLER = 0.84  # gain
_UNEXPLAINED = 0.45  # share that is left
_N_ROUNDS = 4


@dataclass(frozen=True, slots=True, eq=False)
class GainFit:
    """A motion as a smaller copy of another.

    Parameters
    ----------
    gain : 1 for the same size.
    unexplained : share of the difference, up to a constant, that shrinking leaves.
    off_center : distance of the point it shrinks to from the middle of the reference's motion, in multiples of the
        motion's reach.
    chord : whether vectors shrink, or angles seen from ``pole``.
    pole : (S, 3) mean directions.
    reference_mean, performance_mean : (S, 3).
    """

    gain: float
    unexplained: float
    off_center: float
    chord: bool
    pole: FloatArray
    reference_mean: FloatArray
    performance_mean: FloatArray

    def predict(self, reference: FloatArray) -> FloatArray:
        """(T, S, 3) unit vectors: the reference made smaller."""
        seen = reference if self.chord else _to_tangent(self.pole, reference)
        moved = self.performance_mean + self.gain * (seen - self.reference_mean)
        if not self.chord:
            angle = np.linalg.norm(moved, axis=-1, keepdims=True)
            moved = np.cos(angle) * self.pole + np.sin(angle) * moved / np.maximum(angle, 1e-9)
        length = np.linalg.norm(moved, axis=-1, keepdims=True)
        smaller: FloatArray = moved / np.maximum(length, 1e-9)
        return smaller

    def compute_rest(self, performance: FloatArray, reference: FloatArray, tolerance: FloatArray) -> FloatArray:
        """(T, S) squared deviation from the prediction over squared tolerance."""
        theirs = reference if self.chord else _to_tangent(self.pole, reference)
        ours = performance if self.chord else _to_tangent(self.pole, performance)
        rest = ours - self.performance_mean - self.gain * (theirs - self.reference_mean)
        squared: FloatArray = (rest**2).sum(axis=2) / tolerance**2
        return squared


def fit_gain(performance: FloatArray, reference: FloatArray, tolerance: FloatArray) -> GainFit:
    """The gain of a stretch, frames that do not fit losing weight.

    Parameters
    ----------
    performance, reference : (T, S, 3) unit vectors at the same time, turned alike.
    tolerance : (S,) rad.

    Returns
    -------
    The best of four fits: vectors shrink (as an average of two postures does), or angles do (as joints do), seen from
    the mean direction, from the direction at the beginning, or from that of a hanging limb.
    """
    middle = reference.mean(axis=0)
    middle = middle / np.maximum(np.linalg.norm(middle, axis=1, keepdims=True), 1e-9)
    hanging = np.broadcast_to(np.array([0.0, -1.0, 0.0]), middle.shape)
    fits = [_fit(performance, reference, tolerance, middle, True)]
    fits += [_fit(performance, reference, tolerance, pole, False) for pole in (middle, reference[0], hanging)]
    return min(fits, key=lambda pair: pair[0])[1]


def _fit(
    performance: FloatArray, reference: FloatArray, tolerance: FloatArray, pole: FloatArray, chord: bool
) -> tuple[float, GainFit]:
    theirs = reference if chord else _to_tangent(pole, reference)
    ours = performance if chord else _to_tangent(pole, performance)
    trust = np.ones(len(theirs))
    for _ in range(_N_ROUNDS):
        shares = (trust / trust.sum())[:, None, None]
        x0, y0 = (theirs * shares).sum(axis=0), (ours * shares).sum(axis=0)
        x, y = theirs - x0, ours - y0
        weight = trust[:, None] / tolerance**2
        power = ((x * x).sum(axis=2) * weight).sum()
        gain = float(((x * y).sum(axis=2) * weight).sum() / max(power, 1e-9))
        rest = ((y - gain * x) ** 2).sum(axis=2) / tolerance**2
        trust = 1.0 / (1.0 + 2.0 * rest.mean(axis=1)) ** 2
    plain = ((y - x) ** 2).sum(axis=2) / tolerance**2
    unexplained = float((rest * trust[:, None]).sum() / max((plain * trust[:, None]).sum(), 1e-9))
    target = (y0 - gain * x0) / max(1.0 - gain, 0.05)
    reach = (x * x).sum(axis=2).max(axis=0).sum()
    off_center = float(np.sqrt(((target - x0) ** 2).sum() / max(reach, 1e-9)))
    cost = float(np.minimum(rest, 9.0).sum())
    return cost, GainFit(gain, unexplained, off_center, chord, pole, x0, y0)


def _to_tangent(pole: FloatArray, vectors: FloatArray) -> FloatArray:
    """Directions as angles from a pole: the logarithm of the sphere."""
    along = (vectors * pole).sum(axis=-1, keepdims=True)
    across = vectors - along * pole
    sine = np.linalg.norm(across, axis=-1, keepdims=True)
    tangent: FloatArray = across / np.maximum(sine, 1e-9) * np.arctan2(sine, along)
    return tangent


def find_shrunk(deviations: Deviations, tolerance: FloatArray, rate: float) -> list[tuple[int, int]]:
    """Windows over which a limb or the body moves less than the reference: half-open, the clearest first, apart.

    A window adds up what no single frame shows: a range that is smaller by a few degrees everywhere.
    """
    theirs, ours = deviations.reference, deviations.performance
    gaps = ~deviations.judged.all(axis=1)
    sums = [
        np.concatenate([np.zeros((1, *values.shape[1:])), np.cumsum(values, axis=0)])
        for values in (theirs, ours, (theirs**2).sum(2), (theirs * ours).sum(2), (ours**2).sum(2), gaps)
    ]
    found: list[tuple[float, int, int]] = []
    for seconds in _WINDOWS_S:
        width = round(seconds * rate)
        if not 2 <= width < len(ours):
            continue
        x, y, xx, xy, yy, unseen = (total[width:] - total[:-width] for total in sums)
        xx = xx - (x * x).sum(axis=2) / width
        xy = xy - (x * y).sum(axis=2) / width
        yy = yy - (y * y).sum(axis=2) / width
        clear = np.zeros(len(xx))
        for group in GROUPS.values():
            clear = np.maximum(clear, _weigh(xx[:, group], xy[:, group], yy[:, group], tolerance[group], width))
        clear[unseen > 0] = 0.0
        found += [(float(clear[start]), int(start), int(start) + width) for start in np.flatnonzero(clear)]
    taken = np.zeros(len(ours), np.bool_)
    kept = []
    for _, start, end in sorted(found, key=lambda window: (-window[0], window[1])):
        if not taken[start:end].any():
            taken[start:end] = True
            kept.append((start, end))
    return kept


def _weigh(xx: FloatArray, xy: FloatArray, yy: FloatArray, tolerance: FloatArray, width: int) -> FloatArray:
    """(N,) how clearly a gain below one explains windows of (N, S) sums of squares about their means; 0 if not."""
    inverse = 1.0 / tolerance**2
    power, product, other = xx @ inverse, xy @ inverse, yy @ inverse
    gain = product / np.maximum(power, 1e-9)
    same_size = other - 2.0 * product + power
    smaller = other - product * gain
    # The range of a swing is 2 sqrt(2) times its root mean square.
    missing = (1.0 - gain) * 2.0 * np.sqrt(2.0 * np.maximum(xx.max(axis=1), 0.0) / width)
    shrunk = (
        (same_size - smaller > _EVIDENCE)
        & (missing > _SHORT)
        & (gain > 0.0)
        & (gain < _SMALLER)
        & (smaller < _UNEXPLAINED * same_size)
    )
    # A longer window must be worth its length.
    return np.where(shrunk, same_size - 2.0 * smaller, 0.0).clip(min=0.0)


_MOST_FRAMES = 90
_MODEL_SHARE = 0.25


def measure_ranges(segments: FloatArray) -> FloatArray:
    """(S,) rad, the largest angle between any two directions of each segment of (T, S, 3)."""
    thinned = segments[:: max(1, -(-len(segments) // _MOST_FRAMES))].transpose(1, 0, 2)
    cosines = (thinned @ thinned.transpose(0, 2, 1)).reshape(len(thinned), -1).min(axis=1)
    ranges: FloatArray = np.arccos(np.clip(cosines, -1.0, 1.0))
    return ranges


def measure_missing_range(
    reference: FloatArray, performance: FloatArray, model: FloatArray, segments: NDArray[np.intp]
) -> tuple[float, float]:
    """How much range the most affected segment lacks.

    Parameters
    ----------
    reference, performance, model : (T, 9, 3) unit vectors of the same moments; the model is the performance as its
        explanation has it, without the performer's unsteadiness.
    segments : indices of those that may be affected.

    Returns
    -------
    missing : rad.
    share : of the reference's range.
    """
    whole = measure_ranges(reference[:, segments])
    # Seen and explained err to different sides: unsteadiness widens the one, a blunt model narrows the other.
    seen, explained = measure_ranges(performance[:, segments]), measure_ranges(model[:, segments])
    missing = whole - (1.0 - _MODEL_SHARE) * seen - _MODEL_SHARE * explained
    worst = int(np.argmax(missing))
    amount = float(max(missing[worst], 0.0))
    return amount, amount / max(float(whole[worst]), 1e-6)
