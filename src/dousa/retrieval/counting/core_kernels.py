"""Compiled: where in a part of a recording something is repeated after the body has gone there, and before it returns.

Who waves raises an arm first, and lowers it afterwards, by far more than the hand waves: to all that is counted of the
whole that is one movement. What is done there is counted by itself. Nothing here allocates: without reference counts it
compiles in half the time.
"""

from __future__ import annotations

import numpy as np

from dousa.retrieval.counting.tally_kernels import compiled, read_quantile, sort_into
from dousa.retrieval.features.noise_kernels import find_middle

_NEAR = 0.8  # share of the usual distance from the pose at an end below which the body is back there
_REACHED = 0.1  # of what is not near, so much still belongs to the ways there and back
_END = 3  # frames whose mean is the pose at an end


@compiled
def _measure_away(poses, at_end, away):
    """How far poses (K, n) are from the mean of the first frames, or of the last, into ``away`` (n,)."""
    n = poses.shape[1]
    away[:] = 0.0
    for k in range(len(poses)):
        curve, pose = poses[k], 0.0
        for t in range(_END):
            pose += curve[n - 1 - t] / _END if at_end else curve[t] / _END
        for t in range(n):
            away[t] += (curve[t] - pose) ** 2
    for t in range(n):
        away[t] = np.sqrt(away[t])


@compiled
def _find_block(away, first, last, shortest, lines):
    """The frames that are away from an end, if they are one stretch: where they range, and from where to where; else 0.

    ``away`` (n,); the usual distance is that of the frames from ``first`` to before ``last``; ``lines`` (2, n) is
    working memory.
    """
    n, ordered = len(away), lines[0]
    for t in range(first, last):
        ordered[t - first] = away[t]
    least = _NEAR * find_middle(ordered[: last - first])
    begin, end = n, 0
    for t in range(n):
        if away[t] >= least:
            begin, end = min(begin, t), t + 1
    for t in range(begin, end):
        if away[t] < least:
            return 0, 0
    if end - begin < shortest:
        return 0, 0
    sort_into(away[begin:end], ordered[: end - begin], lines[1])
    reached = read_quantile(ordered[: end - begin], _REACHED)
    while away[begin] < reached:
        begin += 1
    while away[end - 1] < reached:
        end -= 1
    return begin, end


@compiled
def find_core(poses, speeds, moving, shortest, lines):
    """The frames of poses (K, n) between a way there and a way back, or one of them; 0, 0 where there is none.

    ``speeds`` (n,) of all poses, ``moving`` that from which the body moves; of less than ``shortest`` frames nothing is
    said; ``lines`` (3, n) is working memory.
    """
    n, away = len(speeds), lines[2]
    first, last, start, stop, found = n, 0, 0, n, False
    for t in range(n):
        if speeds[t] > moving:
            first, last = min(first, t), t + 1
    if last - first < shortest:
        return 0, 0
    for at_end in (False, True):
        _measure_away(poses, at_end, away)
        begin, end = _find_block(away, first, last, shortest, lines)
        if end > begin:
            start, stop, found = max(start, begin), min(stop, end), True
    return (start, stop) if found and stop - start >= shortest else (0, 0)
