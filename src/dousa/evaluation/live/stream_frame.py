"""One frame of a performance that is still going on: its posture, and what can be said of it at once."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import FloatArray
from dousa.evaluation.errors.evidence import (
    CAP,
    LAG_CHANGE,
    LAG_PRICE,
    MAX_LAG_S,
    YAW_SCALE,
    YAW_WINDOW_S,
    Tolerance,
    take_nearest,
)
from dousa.evaluation.figures.curves import turn_reference
from dousa.evaluation.figures.eigenspace import Eigenspace
from dousa.evaluation.figures.furi import Furi
from dousa.evaluation.posture.posture import PostureSequence, Working, compute_segments
from dousa.kernels import kernel
from dousa.motion.canonical.joints import JOINT_INDEX as J


class PoseReader:
    """Postures of frames as they come; what is not seen stays as it was."""

    def __init__(self) -> None:
        self._last = np.tile([0.0, -1.0, 0.0], (9, 1))
        self._last[0, 1] = 1.0

    def read(self, joints: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Directions (9, 3) of (20, 3) joints, and (9,) which are seen."""
        segments = np.ascontiguousarray(compute_segments(joints))
        seen = ~np.isnan(segments[:, 0])
        if not seen.all():
            segments[~seen] = self._last[~seen]
        self._last = segments
        return segments, seen


_SIDES = np.array([[J[f"{side}_{joint}"] for joint in ("hip", "shoulder")] for side in ("left", "right")])


def find_front(joints: FloatArray) -> float:
    """rad about +Y that the body of (20, 3) joints faces; nan where hips or shoulders are not seen."""
    left, right = joints[_SIDES].sum(axis=1)
    return math.atan2(left[0] - right[0], left[2] - right[2])


class LagWatcher:
    """How late each pose is, at once, at the working rate.

    Parameters
    ----------
    references : takes at the working rate, on one clock.
    weights : (9,) of the segments, mean 1.
    """

    def __init__(self, references: tuple[Working, ...], weights: FloatArray) -> None:
        first = references[0]
        self._rate, self._weights = first.frame_rate, weights
        self.center = round(MAX_LAG_S * self._rate)
        self._n_frames = first.n_frames
        ends = ((self.center, self.center), (0, 0), (0, 0))
        self._takes = [np.pad(one.segments, ends, mode="edge") for one in references]
        self._seen = [np.pad(one.seen, ends[:2], mode="edge") for one in references]
        # Of a window in the middle of time only the past is known.
        self._length = max(1, round(0.5 * YAW_WINDOW_S * self._rate))
        self.forget()

    def forget(self, *, smooth: int = 5) -> None:
        """Forget all lags, after the line has moved."""
        # smooth: poses whose costs give the lag to a fraction of a frame
        n_lags = 2 * self.center + 1
        shape = (len(self._takes), self._length, n_lags, 2)
        self._past, self._turns = np.zeros(shape), np.zeros((len(self._takes), n_lags, 2))
        self._slot = 0
        self._best = np.zeros(n_lags)
        self._costs = np.zeros((smooth, n_lags))
        self.lag_s, self.yaw = np.nan, np.nan
        self.forgiven = np.full(9, np.nan)

    def look(self, pose: FloatArray, seen: NDArray[np.bool_], there: float, tolerance: Tolerance) -> None:
        """Take a pose (9, 3) that belongs to the reference frame ``there``; afterwards the fields are about it.

        ``lag_s`` s, positive is late; ``yaw`` rad that turns the reference onto the pose; ``forgiven`` (9,)
        squared angle to the reference, small lags forgiven.
        """

        if not -0.5 <= there <= self._n_frames - 0.5:
            self.forget()
            return
        near = min(max(round(there), 0), self._n_frames - 1)
        part = slice(near, near + 2 * self.center + 1)
        shares = self._weights * seen
        squared = np.empty((2 * self.center + 1, 9))
        least: FloatArray | None = None
        for number, take in enumerate(self._takes):
            turns, past = self._turns[number], self._past[number, self._slot]
            turns -= past
            compare_pose(pose, take[part], shares, self._seen[number][part], YAW_SCALE**2, turns, past, squared)
            least = squared.copy() if least is None else take_nearest(least, squared)
        assert least is not None
        self._slot = (self._slot + 1) % self._length
        self.yaw = float(np.arctan2(self._turns[0, self.center, 1], self._turns[0, self.center, 0]))
        self._choose(least, tolerance, near - there)

    def _choose(self, squared: FloatArray, tolerance: Tolerance, rounded: float) -> None:
        columns = np.arange(len(squared))
        scale = 30.0 / self._rate
        cost = np.minimum(squared / tolerance.angle**2, CAP) @ self._weights
        change = LAG_CHANGE * scale * columns
        # The cheapest way to each lag, a change by a column at its price: from below, and from above.
        rising = np.minimum.accumulate(self._best - change) + change
        falling = (np.minimum.accumulate((self._best + change)[::-1]))[::-1] - change
        self._best = np.minimum(rising, falling) + cost + LAG_PRICE * np.abs(columns - self.center) * scale
        self._best -= self._best.min()
        slack = min(max(1, round(tolerance.lag_s * self._rate)), self.center)
        near = slice(self.center - slack, self.center + slack + 1)
        column = int(self._best.argmin())
        nearest = self.center - slack + int(self._best[near].argmin())
        if abs(column - self.center) <= slack:
            column = nearest
        self.forgiven = squared[nearest]
        self._costs[:-1] = self._costs[1:]
        self._costs[-1] = squared.sum(axis=1)
        shift = 0.0
        if 0 < column < len(squared) - 1:
            left, here, right = self._costs[:, column - 1 : column + 2].sum(axis=0)
            bend = left - 2.0 * here + right
            shift = min(max(float(0.5 * (left - right) / bend), -1.0), 1.0) if bend > 1e-6 else 0.0
        self.lag_s = -(column - self.center + shift + rounded) / self._rate


class FigureMeter:
    """d# and d* of single poses.

    Parameters
    ----------
    reference : first take at the full rate.
    furi : its figures.
    spaces : by label.
    """

    def __init__(self, reference: PostureSequence, furi: tuple[Furi, ...], spaces: dict[str, Eigenspace]) -> None:
        self._furi, self._spaces = furi, spaces
        self.index = np.full(reference.n_frames, -1, np.intp)
        for number, one in enumerate(furi):
            self.index[one.start : one.end] = number
        self._reference = reference.segments
        # The turns of the reference are known in advance, so of every frame also those after it.
        self._turns = []
        for one in furi:
            turned = turn_reference(reference, one, spaces[one.label])
            self._turns.append(turned.turn[turned.find(one)])

    def measure(self, pose: FloatArray, there: float, yaw: float) -> tuple[float, float]:
        """Distance from the space and within it of a pose (9, 3) at a reference frame; nan outside all figures.

        ``yaw`` rad turns the reference onto the pose.
        """
        number = self.index[min(max(round(there), 0), len(self.index) - 1)]
        if number < 0:
            return np.nan, np.nan
        figure, turns = self._furi[number], self._turns[number]
        space = self._spaces[figure.label]
        turn = _mix(turns, there - figure.start)
        ours = (turn_pose(pose, turn - yaw) - space.mean).reshape(-1)
        theirs = (turn_pose(mix_poses(self._reference, there), turn) - space.mean).reshape(-1)
        inside = ours @ space.axes
        outside = ours - space.axes @ inside
        within = inside - theirs @ space.axes
        return math.sqrt(outside @ outside), math.sqrt(within @ within)


def mix_poses(segments: FloatArray, frame: float) -> FloatArray:
    """Interpolate the pose (9, 3) at a fractional frame of (T, 9, 3), ends held: `interpolate_segments` of one."""
    frame = min(max(frame, 0.0), len(segments) - 1.0)
    low = int(frame)
    share = frame - low
    if share == 0.0:
        pose: FloatArray = segments[low]
        return pose
    mixed = segments[low] * (1.0 - share) + segments[low + 1] * share
    unit: FloatArray = mixed / np.maximum(np.sqrt((mixed * mixed).sum(axis=1, keepdims=True)), 1e-9)
    return unit


def _mix(values: FloatArray, frame: float) -> float:
    """The value at a fractional frame, ends held."""
    frame = min(max(frame, 0.0), len(values) - 1.0)
    low = int(frame)
    high = min(low + 1, len(values) - 1)
    return float(values[low] + (frame - low) * (values[high] - values[low]))


def turn_pose(pose: FloatArray, yaw: float) -> FloatArray:
    """Turn a pose (9, 3) about the vertical: `rotate_yaw` of one."""
    cosine, sine = math.cos(yaw), math.sin(yaw)
    return np.asarray(pose @ np.array([[cosine, 0.0, -sine], [0.0, 1.0, 0.0], [sine, 0.0, cosine]]))


def compare_with_reference(
    reference: PostureSequence, pose: FloatArray, seen: NDArray[np.bool_], there: float, yaw: float
) -> tuple[FloatArray, bool]:
    """Angles (9,) rad to the reference at a frame, nan where not seen; and whether all are seen."""
    frame = min(max(there, 0.0), reference.n_frames - 1.0)
    low, high = math.floor(frame), math.ceil(frame)
    judged = seen & reference.seen[low] & reference.seen[high]
    difference = pose - turn_pose(mix_poses(reference.segments, frame), yaw)
    chord = np.sqrt((difference * difference).sum(axis=1))
    return np.where(judged, 2.0 * np.arcsin(np.minimum(0.5 * chord, 1.0)), np.nan), bool(judged.all())


@kernel(allocates=True)
def compare_pose(
    ours: FloatArray,
    theirs: FloatArray,
    weights: FloatArray,
    theirs_seen: np.ndarray,
    scale: float,
    turns: FloatArray,
    past: FloatArray,
    squared: FloatArray,
) -> None:
    """Measure squared chords of one pose at every lag, with the yaw of this pose and those before at equal lag.

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
        for _ in range(3):  # each time what is off loses more of its say
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
