"""The time between films, by the speed of a person's points and then by geometry.

Upright cameras see vertical movement equally from all sides, and speed equally from most. Both are correlated at every
lag: the vertical velocity of each point, the root of its speed (which tames jumps), and the mean speed. Only moments
that both films show count at a lag (Padfield, Masked object registration in the Fourier domain, 2012). A short overlap
agrees easily by chance, so lags are compared by Fisher's z of the correlation.

Then cameras, points and time offsets are fitted together (`bundle`): a moving point is off in every image by its
velocity times the error of the offset, which no camera can compensate. This resolves fractions of a frame; at wrong
times the residuals are half as large again.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dousa.arrays import FloatArray
from dousa.estimation.calibration.bundle import LIKENESS, Fit, Freedom, Limb, Rig, Sightings, adjust
from dousa.estimation.calibration.rig_search import find_rig, triangulate
from dousa.estimation.calibration.sightings import Track, choose_moments, read_sightings


@dataclass(frozen=True, slots=True, eq=False)
class Movement:
    """The movement of a person in one film, at steady intervals.

    Parameters
    ----------
    start : s of the film's own clock, of the first sample.
    step : s.
    values : (C, N) signals in heights of the person per second (or their roots); 0 where unknown.
    known : (C, N) 1 where known.
    families : (C,) kind of each signal: 0 vertical velocities, 1 speeds, 2 the mean speed.
    """

    start: float
    step: float
    values: FloatArray
    known: FloatArray
    families: FloatArray

    @property
    def speed(self) -> float:
        """Heights of the person per second: the 0.9 quantile over the points."""
        speeds = self.values[self.families == 1]
        there = speeds[self.known[self.families == 1] > 0]
        return float(np.quantile(there, 0.9) ** 2) if len(there) else 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Agreement:
    """The agreement of two films at every lag.

    Parameters
    ----------
    lags : (L,) s, rising; added to the second film's own time to get that of the first.
    scores : (L,) Fisher's z by its spread: a chance agreement is about 1; -inf where the films overlap too little.
    correlations : (L,) -1 to 1; 0 where the films overlap too little.
    """

    lags: FloatArray
    scores: FloatArray
    correlations: FloatArray

    def at(self, lag: float) -> float:
        """Return the greatest score within two steps of a lag, at least -1; 0 where the films overlap too little."""
        place = int(np.searchsorted(self.lags, lag))
        near = self.scores[max(0, place - 2) : place + 3]
        near = near[np.isfinite(near)]
        return max(-1.0, float(near.max())) if len(near) else 0.0

    def find(self, most: int, apart: float = 0.1) -> list[float]:
        """Return the best lags that are more than ``apart`` s apart, best first."""
        scores = self.scores
        inner = np.flatnonzero((scores[1:-1] >= scores[:-2]) & (scores[1:-1] >= scores[2:])) + 1
        ends = [0, len(scores) - 1]
        found: list[float] = []
        for place in sorted({*inner.tolist(), *ends}, key=lambda index: -scores[index]):
            lag = float(self.lags[place])
            if not np.isfinite(scores[place]) or scores[place] <= 0 or len(found) == most:
                break
            if all(abs(lag - other) > apart for other in found):
                found.append(lag)
        return found


def choose_step(
    tracks: Sequence[Track], shortest: float = 1.0 / 60.0, longest: float = 1.0 / 20.0, most_samples: int = 60_000
) -> float:
    """Choose a step from ``shortest`` to ``longest`` s, fine enough for films, with ``most_samples`` of long ones."""
    finest = min(track.interval for track in tracks)
    duration = max(float(track.times[-1] - track.times[0]) for track in tracks)
    return max(min(max(finest, shortest), longest), duration / most_samples)


def describe_movement(track: Track, step: float, window: float = 0.05, quick: float = 1.0) -> Movement:
    """Compute the movement of a person, sampled every ``step`` s.

    ``window`` (s) is wider than for places, as velocities are noisier. Vertical velocities beyond ``quick`` heights of
    the person per second are squashed: a jump is no evidence.
    """
    start = float(track.times[0])
    moments = np.arange(start, float(track.times[-1]) + 1e-9, step)
    _, velocities, weights = track.read(moments, window)
    velocities = velocities / max(track.height, 1.0)
    known = (weights > 0).T.astype(np.float64)
    vertical = (velocities[..., 1] / (1.0 + np.abs(velocities[..., 1]) / quick)).T
    speeds = np.sqrt(np.linalg.norm(velocities, axis=-1)).T
    count = known.sum(axis=0)
    enough = count >= max(4, known.shape[0] // 3)
    mean = np.where(enough, (speeds**2 * known).sum(axis=0) / np.maximum(count, 1.0), 0.0)
    values = np.concatenate((vertical * known, speeds * known, mean[None]))
    families = np.repeat([0, 1, 2], (len(known), len(known), 1))
    return Movement(start, step, values, np.concatenate((known, known, enough[None].astype(np.float64))), families)


def correlate(
    first: Movement,
    second: Movement,
    *,
    independent: float = 8.0,
    least_overlap: float = 0.5,
    least_spread: float = 1e-9,
) -> Agreement:
    """Compute the agreement of two films of the same step at every lag of the second.

    ``independent`` moments count in a second, as people hardly move faster than 4 Hz. Films that overlap by less than
    ``least_overlap`` s, or hardly move there (``least_spread``), do not agree.
    """
    n_first, n_second = first.values.shape[1], second.values.shape[1]
    size = 1 << (n_first + n_second - 1).bit_length()
    # Shift s pairs sample i + s of the first with sample i of the second.
    shifts = np.arange(-(n_second - 1), n_first)
    means = np.zeros(len(shifts))
    overlap = np.zeros(len(shifts))
    for family in range(3):
        covariance, spread, pairs = _sum_family(first, second, family, size)
        correlation = np.where(spread > least_spread, covariance / np.maximum(spread, least_spread), 0.0)
        means += np.clip(correlation, -1.0, 1.0)[shifts] / 3.0
        if family == 2:
            overlap = pairs[shifts] * first.step
    counts = overlap * independent
    enough = overlap >= least_overlap
    scores = np.arctanh(np.clip(means, -0.999, 0.999)) * np.sqrt(np.maximum(counts - 3.0, 0.0))
    lags = shifts * first.step + first.start - second.start
    return Agreement(lags, np.where(enough, scores, -np.inf), np.where(enough, means, 0.0))


def _sum_family(first: Movement, second: Movement, family: int, size: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Compute covariance, product of the spreads and number of pairs of one kind of signals by shift (size,)."""
    covariance, squares, pairs = np.zeros(size), np.zeros((2, size)), np.zeros(size)
    for row in np.flatnonzero(first.families == family):
        values = [movement.values[row] for movement in (first, second)]
        known = [movement.known[row] for movement in (first, second)]
        one, one_squared, one_known = (np.fft.rfft(x, size) for x in (values[0], values[0] ** 2, known[0]))
        two, two_squared, two_known = (np.conj(np.fft.rfft(x, size)) for x in (values[1], values[1] ** 2, known[1]))
        products = np.stack(
            (one_known * two_known, one * two_known, one_known * two, one * two,
             one_squared * two_known, one_known * two_squared)
        )  # fmt: skip
        count, sum_one, sum_two, product, square_one, square_two = np.fft.irfft(products, size)
        count = np.maximum(np.round(count), 0.0)
        number = np.maximum(count, 1.0)
        covariance += product - sum_one * sum_two / number
        squares[0] += np.maximum(square_one - sum_one**2 / number, 0.0)
        squares[1] += np.maximum(square_two - sum_two**2 / number, 0.0)
        pairs += count
    return covariance, np.sqrt(squares[0] * squares[1]), pairs


@dataclass(frozen=True, slots=True, eq=False)
class TimedRig:
    """Time offsets, and the cameras with which they were found.

    Parameters
    ----------
    offsets : (V,) s, added to each film's own time; 0 for the first.
    spreads : (V,) s, standard deviations.
    misfit : cost of a sighting: 0.2 is usual for films of one person, 0.4 and more is another moment.
    rig : the cameras, in an arbitrary unit unless they were given.
    """

    offsets: FloatArray
    spreads: FloatArray
    misfit: float
    rig: Rig


def fit_times(
    tracks: Sequence[Track],
    offsets: FloatArray,
    limbs: Sequence[Limb],
    focals: FloatArray,
    start: Rig | None = None,
    calibrated: bool = False,
    most: int = 120,
    rounds: int = 5,
    *,
    least: int = 12,
    steps: int = 25,
    settled: float = 0.0005,
) -> TimedRig | None:
    """Improve time offsets by the geometry; None where the films hardly overlap or no cameras fit them.

    Parameters
    ----------
    tracks : (V,) one person in V films.
    offsets : (V,) s, first guess, good to some 0.3 s.
    limbs : of constant length.
    focals : (V,) px; a guess, unless the cameras are calibrated.
    start : cameras to begin with, calibrated or found.
    calibrated : the focal lengths are known. The cameras' poses are fitted in any case, because a network's hips differ
        a little between sides, which fixed cameras would turn into time.
    most, least : moments used, and needed.
    rounds : at most; each reads the points again at the last offsets.
    steps : of the adjustment in a round.
    settled : s; the round in which the offsets change by less is the last.
    """
    freedom = Freedom(focals=not calibrated, offsets=True, focal_spread=0.2)
    fit: Fit | None = None
    seen: Sightings | None = None
    for round_ in range(rounds):
        moments = choose_moments(tracks, offsets, most)
        if len(moments) < least:
            return None
        seen = read_sightings(tracks, offsets, moments)
        last = start if fit is None else fit.rig
        starts = [] if last is None else [replace(last, offsets=offsets)]
        if start is None and round_ <= 1:  # what was found at a wrong time need not be near what is right
            found = find_rig(seen, focals, limbs)
            starts += [] if found is None else [found.rig]
        fits = [adjust(seen, start, triangulate(seen, start), limbs, freedom, steps) for start in starts]
        if not fits:
            return None
        fit = min(fits, key=lambda one: one.cost)
        moved = float(np.abs(fit.rig.offsets - offsets).max())
        offsets = fit.rig.offsets
        if round_ > 0 and moved < settled:
            break
    assert fit is not None and seen is not None
    counted = float((seen.weights * seen.seen_twice).sum())
    if counted < least:
        return None
    misfit = fit.cost / counted
    spreads = LIKENESS * np.sqrt(fit.variances[:, -1] * 2.0 * misfit)
    return TimedRig(offsets, spreads, misfit, fit.rig)
