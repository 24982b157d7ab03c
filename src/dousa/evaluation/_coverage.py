"""Two-way coverage: does the performance stay on the reference's path, and does it reach all of it?

On the path and all of it reached, at another time: a shift. On the path, but the extreme never reached: incomplete.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dousa.evaluation._evidence import Evidence, at_lag
from dousa.evaluation._line_kernels import follow_lag
from dousa.motion._types import FloatArray

__all__ = ["compute_unreached", "follow_path"]

_CHANGE = 0.3  # price of one column of lag: nearly free, since any time of the reference may be met
_OUTSIDE = 1e3


def follow_path(evidence: Evidence, start: int, end: int) -> tuple[NDArray[np.intp], FloatArray]:
    """Where on the reference's path between the same two moments the performance is.

    Returns
    -------
    course : (n,) columns of lag.
    cost : (n,) sum over the segments of the capped ratio left on the way.
    """
    columns = np.arange(evidence.ratio.shape[1])
    there = np.arange(start, end)[:, None] + columns - evidence.center
    cost = np.where((there >= start) & (there < end), evidence.ratio[start:end].sum(axis=2), _OUTSIDE)
    course = follow_lag(cost, _CHANGE).astype(np.intp)
    return course, at_lag(evidence.ratio[start:end], course).sum(axis=1)


def compute_unreached(evidence: Evidence, start: int, end: int, first: int, last: int) -> FloatArray:
    """How far each moment of the reference is from all that the performance does.

    Parameters
    ----------
    evidence : of the performance.
    start, end : moments of the reference, on the performance's clock, half-open.
    first, last : frames of the performance that are looked at, half-open.

    Returns
    -------
    (n, 9) squared distance over squared tolerance to the nearest point of the performance's path, which runs
    straight between its frames; averaged over three moments.
    """
    deviations, center = evidence.deviations, evidence.center
    inverse = 1.0 / evidence.tolerance**2
    steps = ((deviations.performance[1:] - deviations.performance[:-1]) ** 2).sum(axis=2) * inverse
    unreached = np.zeros((end - start, 9))
    for row, moment in enumerate(range(start, end)):
        frames = np.arange(max(first, moment - center), min(last, moment + center + 1))
        far = deviations.squared[frames, center + moment - frames] * inverse
        if len(frames) < 2:
            unreached[row] = far[0] if len(frames) else 0.0
            continue
        step = steps[frames[:-1]]
        here, there, whole = far[:-1].sum(axis=1), far[1:].sum(axis=1), step.sum(axis=1)
        share = np.clip((here - there + whole) / np.maximum(2.0 * whole, 1e-9), 0.0, 1.0)[:, None]
        between = far[:-1] * (1.0 - share) + far[1:] * share - share * (1.0 - share) * step
        unreached[row] = np.maximum(between[between.sum(axis=1).argmin()], 0.0)
    padded = np.pad(unreached, ((1, 1), (0, 0)), mode="edge")
    averaged: FloatArray = (padded[:-2] + padded[1:-1] + padded[2:]) / 3.0
    return averaged
