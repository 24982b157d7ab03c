"""The newest pose of a performance that is still going on: how late it is, and what is off, at once."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import FloatArray
from dousa.evaluation.errors.deviations import MAX_LAG_S, YAW_SCALE, YAW_WINDOW_S
from dousa.evaluation.errors.evidence import CAP, LAG_CHANGE, LAG_PRICE, Tolerance
from dousa.evaluation.figures.curves import turn_reference
from dousa.evaluation.figures.eigenspace import Eigenspace
from dousa.evaluation.figures.furi import Furi
from dousa.evaluation.posture.posture import PostureSequence, Working
from dousa.kernels import kernel, part


class LagWatcher:
    """How late each pose is, at once: as of the whole, of which only the past is known.

    Parameters
    ----------
    references : takes at the working rate, on one clock.
    weights : (9,) of the segments, mean 1.
    """

    def __init__(self, references: Sequence[Working], weights: FloatArray) -> None:
        first = references[0]
        self._rate, self._weights, self._n_frames = first.frame_rate, weights, first.n_frames
        self.center = max(2, round(MAX_LAG_S * self._rate))
        reach = ((0, 0), (self.center, self.center), (0, 0))
        self._takes = np.pad([one.segments for one in references], (*reach, (0, 0)), mode="edge")
        self._seen = np.pad([one.seen for one in references], reach, mode="edge")
        # Of a window in the middle of time only the past is known.
        self._length = max(1, round(0.5 * YAW_WINDOW_S * self._rate))
        scale = 30.0 / self._rate
        self._prices = np.array([YAW_SCALE**2, LAG_CHANGE * scale, LAG_PRICE * scale])
        self._n_lags = 2 * self.center + 1
        self.forget()

    def forget(self, *, smooth: int = 5) -> None:
        """Forget all lags, after the line has moved."""
        # smooth: poses whose costs give the lag to a fraction of a frame
        n_takes, n_lags = len(self._takes), self._n_lags
        self._past, self._turns = np.zeros((self._length, n_takes, n_lags, 2)), np.zeros((n_takes, n_lags, 2))
        self._slot, self._best, self._costs = 0, np.zeros(n_lags), np.zeros((smooth, n_lags))
        self._least = np.zeros((n_lags, 9))
        self.lag_s = self.yaw = np.nan
        self.residual, self.forgiven = np.full((2, 9), np.nan)

    def look(self, pose: FloatArray, seen: NDArray[np.bool_], there: float, tolerance: Tolerance) -> None:
        """Take a pose (9, 3) that belongs to the reference frame ``there``; afterwards the fields are about it.

        ``lag_s`` s, positive is late; ``yaw`` rad that turns the reference onto the pose; ``residual`` (9,) rad, angle
        to it, nan where either is not seen; ``forgiven`` (9,) squared chord to it, small lags forgiven.
        """
        if not -0.5 <= there <= self._n_frames - 0.5:
            self.forget()
            return
        near, center = min(max(round(there), 0), self._n_frames - 1), self.center
        part, slot = slice(near, near + self._n_lags), self._slot % self._length
        self._costs[:-1] = self._costs[1:]
        compare_pose(
            pose,
            self._takes[:, part],
            self._seen[:, part],
            self._weights * seen,
            self._prices,
            tolerance.angle**2,
            self._turns,
            self._past[slot],
            self._least,
            self._best,
            self._costs[-1],
        )
        self._slot += 1
        self.yaw = math.atan2(self._turns[0, center, 1], self._turns[0, center, 0])
        slack = min(max(1, round(tolerance.lag_s * self._rate)), center)
        column = int(self._best.argmin())
        nearest = center - slack + int(self._best[center - slack : center + slack + 1].argmin())
        column = nearest if abs(column - center) <= slack else column
        shift = 0.0
        if 0 < column < self._n_lags - 1:
            left, here, right = self._costs[:, column - 1 : column + 2].sum(axis=0).tolist()
            bend = left - 2.0 * here + right
            shift = min(max(0.5 * (left - right) / bend, -1.0), 1.0) if bend > 1e-6 else 0.0
        self.lag_s = -(column - center + shift + near - there) / self._rate
        self.forgiven = self._least[nearest].copy()
        place = center + min(max(there, 0.0), self._n_frames - 1.0)
        low = int(place)
        theirs = self._takes[0, low] * (low + 1.0 - place) + self._takes[0, low + 1] * (place - low)
        theirs /= np.maximum(np.sqrt((theirs * theirs).sum(axis=1, keepdims=True)), 1e-9)
        chord = np.sqrt(((pose - turn_pose(theirs, self.yaw)) ** 2).sum(axis=1))
        judged = seen & self._seen[0, low] & (self._seen[0, low + 1] | (low == place))
        self.residual = np.where(judged, 2.0 * np.arcsin(np.minimum(0.5 * chord, 1.0)), np.nan)


class FigureMeter:
    """d# and d* of single poses.

    Parameters
    ----------
    reference : first take at the full rate.
    furi : its figures.
    spaces : by label.
    """

    def __init__(self, reference: PostureSequence, furi: Sequence[Furi], spaces: Mapping[str, Eigenspace]) -> None:
        self.index = np.full(reference.n_frames, -1, np.intp)
        self._figures: list[tuple[int, Eigenspace, FloatArray, FloatArray]] = []
        for number, one in enumerate(furi):
            self.index[one.start : one.end] = number
            space = spaces[one.label]
            # The turns of the reference are known in advance, so of every frame also those after it.
            turned = turn_reference(reference, one, space)
            here = turned.find(one)
            theirs = (turned.segments[here] - space.mean).reshape(-1, space.axes.shape[0]) @ space.axes
            self._figures.append((one.start, space, turned.turn[here], theirs))

    def measure(self, pose: FloatArray, there: float, yaw: float) -> tuple[float, float]:
        """Distance from the space and within it of a pose (9, 3) at a reference frame; nan outside all figures.

        ``yaw`` rad turns the reference onto the pose.
        """
        number = self.index[min(max(round(there), 0), len(self.index) - 1)]
        if number < 0:
            return np.nan, np.nan
        start, space, turns, theirs = self._figures[number]
        place = min(max(there - start, 0.0), len(turns) - 1.0)
        low = min(int(place), max(len(turns) - 2, 0))
        high, share = min(low + 1, len(turns) - 1), place - low
        turn = turns[low] + share * (turns[high] - turns[low])
        inside = (turn_pose(pose, turn - yaw) - space.mean).reshape(-1)
        ours = inside @ space.axes
        outside, within = inside - space.axes @ ours, ours - theirs[low] - share * (theirs[high] - theirs[low])
        return math.sqrt(outside @ outside), math.sqrt(within @ within)


def turn_pose(pose: FloatArray, yaw: float) -> FloatArray:
    """Turn a pose (9, 3) about the vertical: `rotate_yaw` of one."""
    cosine, sine = math.cos(yaw), math.sin(yaw)
    return np.asarray(pose @ np.array([[cosine, 0.0, -sine], [0.0, 1.0, 0.0], [sine, 0.0, cosine]]))


@part
def _carry_on(
    least: FloatArray,
    weights: FloatArray,
    prices: FloatArray,
    tolerated: FloatArray,
    best: FloatArray,
    costs: FloatArray,
) -> None:
    """Carry the cheapest course of lag on by one pose, see `compare_pose`."""
    n_lags = len(best)
    for k in range(1, n_lags):  # the cheapest way to each lag: from below, and from above
        best[k] = min(best[k], best[k - 1] + prices[1])
    for k in range(n_lags - 2, -1, -1):
        best[k] = min(best[k], best[k + 1] + prices[1])
    cheapest = np.inf
    for k in range(n_lags):
        costs[k] = 0.0
        best[k] += prices[2] * abs(k - n_lags // 2)
        for s in range(9):
            costs[k] += least[k, s]
            best[k] += min(least[k, s] / tolerated[s], CAP) * weights[s]
        cheapest = min(cheapest, best[k])
    for k in range(n_lags):
        best[k] -= cheapest


@kernel(allocates=True)
def compare_pose(
    ours: FloatArray,
    theirs: FloatArray,
    theirs_seen: np.ndarray,
    weights: FloatArray,
    prices: FloatArray,
    tolerated: FloatArray,
    turns: FloatArray,
    past: FloatArray,
    least: FloatArray,
    best: FloatArray,
    costs: FloatArray,
) -> None:
    """Do `LagWatcher.look`: squared chords of one pose at every lag, with the yaw of this pose and those before at
    equal lag.

    ``ours`` (9, 3) meets ``theirs`` (N, K, 9, 3) of the takes; ``turns`` (N, K, 2) are sums over the past poses, of
    which ``past`` (N, K, 2) is the oldest's part, then this one's. Into ``least`` (K, 9) goes the squared chord from
    the nearest one, into ``costs`` (K,) its sums, ``best`` (K,) is carried on. Prices are a squared chord from which a
    segment loses its say, a column of lag more or less, and a column of lag; weights (9,) are 0 where not seen.
    """
    along, across, fixed, squared = np.empty(9), np.empty(9), np.empty(9), np.empty(9)
    n_takes, n_lags = theirs.shape[:2]
    for n in range(n_takes):
        for k in range(n_lags):
            here, counts = theirs[n, k], theirs_seen[n, k]
            turns[n, k, 0] -= past[n, k, 0]
            turns[n, k, 1] -= past[n, k, 1]
            for s in range(9):
                along[s] = ours[s, 2] * here[s, 2] + ours[s, 0] * here[s, 0]
                across[s] = ours[s, 0] * here[s, 2] - ours[s, 2] * here[s, 0]
                fixed[s] = 2.0 - 2.0 * ours[s, 1] * here[s, 1]
                squared[s] = 0.0
            for _ in range(3):  # each time what is off loses more of its say
                more_along, more_across = 0.0, 0.0
                for s in range(9):
                    if weights[s] > 0.0 and counts[s]:
                        share = 1.0 / (1.0 + squared[s] / prices[0])
                        more_along += along[s] * weights[s] * share * share
                        more_across += across[s] * weights[s] * share * share
                a, b = turns[n, k, 0] + more_along, turns[n, k, 1] + more_across
                size = max(math.sqrt(a * a + b * b), 1e-12)
                a, b = a / size, b / size
                for s in range(9):
                    squared[s] = max(fixed[s] - 2.0 * (along[s] * a + across[s] * b), 0.0)
            past[n, k, 0], past[n, k, 1] = more_along, more_across
            turns[n, k, 0] += more_along
            turns[n, k, 1] += more_across
            for s in range(9):
                far = squared[s] if weights[s] > 0.0 and counts[s] else 0.0
                if n == 0 or (far > 0.0 and (far < least[k, s] or least[k, s] == 0.0)):
                    least[k, s] = far
    _carry_on(least, weights, prices, tolerated, best, costs)
