"""The time between films by geometry: when points that move are in one place for all cameras at once.

Cameras, points and time offsets are fitted together (`bundle`): a point that moves is off in every picture by its
velocity times the error of the offset, which no camera can make good. That tells fractions of a frame, and wrong times
from right ones, since those leave residuals that are half as large again.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dousa.arrays import FloatArray
from dousa.estimation.calibration.bundle import CAMERA_UNKNOWNS, Fit, Freedom, Limb, Rig, Sightings, adjust
from dousa.estimation.calibration.rig_search import find_rig
from dousa.estimation.calibration.sightings import Track, choose_moments, read_sightings
from dousa.estimation.calibration.two_views import triangulate

_MOST_MOMENTS = 120
_STEPS = 25
_SETTLED = 0.0005  # s
_LEAST_MOMENTS = 12
_LIKENESS = 5.0
"""Errors of networks last for some frames and are shared by neighbouring points: measured on real films, offsets are
off by five times what independent errors would give."""


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
    most: int = _MOST_MOMENTS,
    rounds: int = 5,
) -> TimedRig | None:
    """Improve time offsets by the geometry.

    Parameters
    ----------
    tracks : (V,) one person in V films.
    offsets : (V,) s, first guess, good to some 0.3 s.
    limbs : what keeps its length.
    focals : (V,) px; a guess, unless the cameras are calibrated.
    start : cameras to begin with: calibrated, or found already.
    calibrated : the focal lengths are known. The cameras' poses are fitted in any case: what a network takes for a hip
        is seen a little differently from each side, and fixed cameras would make that a matter of time.
    most : moments to look at.
    rounds : at most; in each the points are read anew at the offsets of the last.

    Returns
    -------
    The offsets; None where the films hardly overlap or no cameras fit them.
    """
    freedom = Freedom(focals=not calibrated, offsets=True, focal_spread=0.2)
    fit: Fit | None = None
    seen: Sightings | None = None
    for round_ in range(rounds):
        moments = choose_moments(tracks, offsets, most)
        if len(moments) < _LEAST_MOMENTS:
            return None
        seen = read_sightings(tracks, offsets, moments)
        last = start if fit is None else fit.rig
        starts = [] if last is None else [replace(last, offsets=offsets)]
        if start is None and round_ <= 1:  # what was found at a wrong time need not be near what is right
            found = find_rig(seen, focals, limbs)
            starts += [] if found is None else [found.rig]
        fits = [adjust(seen, start, triangulate(seen, start), limbs, freedom, _STEPS) for start in starts]
        if not fits:
            return None
        fit = min(fits, key=lambda one: one.cost)
        moved = float(np.abs(fit.rig.offsets - offsets).max())
        offsets = fit.rig.offsets
        if round_ > 0 and moved < _SETTLED:
            break
    assert fit is not None and seen is not None
    counted = float((seen.weights * seen.seen_twice).sum())
    if counted < _LEAST_MOMENTS:
        return None
    misfit = fit.cost / counted
    variances = np.diag(fit.covariance).reshape(-1, CAMERA_UNKNOWNS)[:, -1]
    spreads = _LIKENESS * np.sqrt(np.maximum(variances * 2.0 * misfit, 0.0))
    return TimedRig(offsets, spreads, misfit, fit.rig)
