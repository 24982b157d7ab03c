"""Compiled steps of the running evaluation: the lines as frames come, and one pose beside the reference around it."""

from __future__ import annotations

import numpy as np
from numba import njit

from dousa.motion._types import FloatArray

__all__ = ["compare_pose", "extend_lines", "find_pose_yaw"]

_N_ROUNDS = 3
_N_YAW_ROUNDS = 6


@njit(cache=True, nogil=True)
def extend_lines(
    cost: FloatArray,
    best: FloatArray,
    outside_costs: FloatArray,
    jump: float,
    pause: float,
    outside: float,
    origin: np.ndarray,
    ended: np.ndarray,
) -> None:  # pragma: no cover - compiled
    """The forward step of `follow_lines` for frames that are new; before the first all of ``best`` is infinite.

    Parameters
    ----------
    cost : (n, U) of the new performance frames against the reference frames.
    best : (U,) price of the cheapest sequence of lines that ends at each reference frame; in place.
    outside_costs : (2,) price of being before the lines so far, and of being after them; in place.
    jump, pause, outside : prices, as in `follow_lines`.
    origin : (n, U) out, reference frame that each is reached from; -1 from before the lines.
    ended : (n,) out, reference frame after which the lines ended at this frame; -2 if they did before.
    """
    n_reference = len(best)
    now = np.empty(n_reference)
    for t in range(len(cost)):
        cheapest = 0
        for r in range(1, n_reference):
            if best[r] < best[cheapest]:
                cheapest = r
        outside_costs[1] += outside
        ended[t] = -2
        if best[cheapest] + outside < outside_costs[1]:
            outside_costs[1] = best[cheapest] + outside
            ended[t] = cheapest
        for r in range(n_reference):
            value = best[cheapest] + jump
            source = cheapest
            if r >= 1 and best[r - 1] <= value:
                value = best[r - 1]
                source = r - 1
            if best[r] + pause < value:
                value = best[r] + pause
                source = r
            if r >= 2 and best[r - 2] + pause < value:
                value = best[r - 2] + pause
                source = r - 2
            if outside_costs[0] < value:
                value = outside_costs[0]
                source = -1
            now[r] = value + cost[t, r]
            origin[t, r] = source
        for r in range(n_reference):
            best[r] = now[r]
        outside_costs[0] += outside


@njit(cache=True, nogil=True)
def compare_pose(
    ours: FloatArray,
    theirs: FloatArray,
    weights: FloatArray,
    theirs_seen: np.ndarray,
    scale: float,
    turns: FloatArray,
    past: FloatArray,
    squared: FloatArray,
) -> None:  # pragma: no cover - compiled
    """Squared chords of one pose at every lag, the yaw taken from this pose and those before it at equal lag.

    Parameters
    ----------
    ours : (9, 3) unit vectors.
    theirs : (K, 9, 3) of the reference around the same time.
    weights : (9,) of the segments, 0 where this pose is not seen.
    theirs_seen : (K, 9).
    scale : squared chord from which a segment loses its say.
    turns : (K, 2) sums over the past poses, the oldest taken off already; this pose is added.
    past : (K, 2) out, what this pose adds.
    squared : (K, 9) out, 0 where either is not seen.
    """
    along, across, fixed = np.empty(9), np.empty(9), np.empty(9)
    for k in range(len(theirs)):
        a, b = turns[k, 0], turns[k, 1]
        for s in range(9):
            x, y, z = ours[s, 0], ours[s, 1], ours[s, 2]
            p, q, r = theirs[k, s, 0], theirs[k, s, 1], theirs[k, s, 2]
            along[s] = z * r + x * p
            across[s] = x * r - z * p
            fixed[s] = 2.0 - 2.0 * y * q
            squared[k, s] = 0.0
        for _ in range(_N_ROUNDS):
            more_along, more_across = 0.0, 0.0
            for s in range(9):
                if weights[s] > 0.0 and theirs_seen[k, s]:
                    share = 1.0 / (1.0 + squared[k, s] / scale)
                    more_along += along[s] * weights[s] * share * share
                    more_across += across[s] * weights[s] * share * share
            a, b = turns[k, 0] + more_along, turns[k, 1] + more_across
            size = max(np.sqrt(a * a + b * b), 1e-12)
            a, b = a / size, b / size
            for s in range(9):
                squared[k, s] = max(fixed[s] - 2.0 * (along[s] * a + across[s] * b), 0.0)
        past[k, 0], past[k, 1] = more_along, more_across
        turns[k, 0] += more_along
        turns[k, 1] += more_across
        for s in range(9):
            if weights[s] == 0.0 or not theirs_seen[k, s]:
                squared[k, s] = 0.0


@njit(cache=True, nogil=True)
def find_pose_yaw(
    a: FloatArray, b: FloatArray, starts: FloatArray, wrong: float
) -> float:  # pragma: no cover - compiled
    """`estimate_robust_yaw` of one pose with equal weights: for single poses arrays cost more than the sums.

    Parameters
    ----------
    a, b : (9, 3) unit vectors; the angle turns b onto a.
    starts : (9, n) shares of the segments in each start.
    wrong : squared chord from which a segment loses its say.
    """
    along, across, fixed = np.empty(9), np.empty(9), np.empty(9)
    for s in range(9):
        along[s] = a[s, 2] * b[s, 2] + a[s, 0] * b[s, 0]
        across[s] = a[s, 0] * b[s, 2] - a[s, 2] * b[s, 0]
        lengths = 0.0
        for axis in range(3):
            lengths += a[s, axis] * a[s, axis] + b[s, axis] * b[s, axis]
        fixed[s] = lengths - 2.0 * a[s, 1] * b[s, 1]
    least, turn_along, turn_across = np.inf, 1.0, 0.0
    for k in range(starts.shape[1]):
        x, y = 0.0, 0.0
        for s in range(9):
            x += along[s] * starts[s, k]
            y += across[s] * starts[s, k]
        size = np.sqrt(x * x + y * y)
        x, y = (x / size, y / size) if size > 0.0 else (1.0, 0.0)
        cost = 0.0
        for s in range(9):
            far = max(fixed[s] - 2.0 * (along[s] * x + across[s] * y), 0.0)
            cost += far / (far + wrong)
        if cost < least:
            least, turn_along, turn_across = cost, x, y
    for _ in range(_N_YAW_ROUNDS):
        x, y = 0.0, 0.0
        for s in range(9):
            far = max(fixed[s] - 2.0 * (along[s] * turn_along + across[s] * turn_across), 0.0)
            share = wrong / (far + wrong)
            x += along[s] * share * share
            y += across[s] * share * share
        size = np.sqrt(x * x + y * y)
        turn_along, turn_across = (x / size, y / size) if size > 0.0 else (1.0, 0.0)
    return float(np.arctan2(turn_across, turn_along))
