"""The lines of a performance that is still going on: the same search as `align`, carried on frame by frame."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from dousa.evaluation._alignment import (
    COARSE_RATE,
    JUMP_S,
    OUTSIDE,
    PAUSE,
    Run,
    extrapolate,
    find_pauses,
    find_runs,
    pair_similarity,
    smooth_course,
    to_cost,
)
from dousa.evaluation._working import Working
from dousa.motion._types import FloatArray

__all__ = ["LineFollower"]

_KEPT_S = 30.0  # for which the past may still be seen otherwise
_CLEAR = 5.0  # coarse frames of complete mismatch by which a line must beat every other to be known
_OTHER_S = 1.0  # lines nearer than this are not another
_LATEST_S = 15.0  # after which the best line is believed
_TREND_S = 40.0
_ZERO_GAIN = 0.01  # as in `align`: recordings cut alike begin together unless something speaks against it


@dataclass(slots=True)
class _Diagonals:
    """Costs of the shifts around one line, summed as frames come."""

    start: int
    counted: int
    shifts: NDArray[np.intp]
    costs: FloatArray

    def add(self, end: int, reference: Working, segments: FloatArray, weights: FloatArray) -> None:
        """Count the frames up to ``end``."""
        if end <= self.counted:
            return
        there = np.arange(self.counted, end)[:, None] + self.shifts
        inside = (there >= 0) & (there < reference.n_frames)
        poses = reference.segments[np.clip(there, 0, reference.n_frames - 1)]
        cost = to_cost(pair_similarity(segments[self.counted : end, None], poses, weights))
        self.costs += np.where(inside, cost, OUTSIDE).sum(axis=0)
        self.counted = end

    def settle(self, middle: int, reach: int, *, prefer_zero: bool) -> float:
        """The shift with the least mean cost, to a fraction of a frame."""
        near = np.abs(self.shifts - middle) <= reach
        shifts, costs = self.shifts[near], self.costs[near] / max(self.counted - self.start, 1)
        best = int(np.argmin(costs))
        zero = np.flatnonzero(self.shifts == 0)
        if prefer_zero and len(zero):
            at_zero = self.costs[zero[0]] / max(self.counted - self.start, 1)
            if at_zero <= costs[best] + _ZERO_GAIN:
                return 0.0
        shift = float(shifts[best])
        if 0 < best < len(costs) - 1:
            left, here, right = costs[best - 1 : best + 2]
            bend = left - 2.0 * here + right
            shift += float(0.5 * (left - right) / bend) if bend > 1e-12 else 0.0
        return shift


class LineFollower:
    """Which moment of the reference belongs to each moment so far.

    Parameters
    ----------
    reference : at the working rate.
    tempo : ``"same"`` or ``"free"``.
    weights : (9,) of the segments.
    offset : reference frame at performance frame 0, if it is known; then nothing is searched.
    """

    def __init__(self, reference: Working, tempo: str, weights: FloatArray, offset: float | None) -> None:
        self._reference, self._tempo, self._weights, self._offset = reference, tempo, weights, offset
        self._step = max(1, round(reference.frame_rate / COARSE_RATE))
        self._rate = reference.frame_rate / self._step
        coarse = reference.segments[:: self._step]
        self._best = np.full(len(coarse), np.inf)
        self._coarse = coarse
        self._outside = np.zeros(2)
        self._origins: list[np.ndarray] = []
        self._ended: list[int] = []
        self._course = np.empty(0, np.int32)
        self._diagonals: list[_Diagonals] = []
        self._runs: list[Run] = [Run(0, 0, 0.0 if offset is None else offset)]
        self.known = offset is not None

    @property
    def runs(self) -> tuple[Run, ...]:
        """Lines so far in working frames, the last one going on."""
        return tuple(self._runs)

    def update(self, segments: FloatArray) -> None:
        """Take all poses (T, 9, 3) so far, at the working rate."""
        count = len(segments)
        if self._offset is not None:
            self._runs = [Run(0, count, self._offset)]
            return
        self._extend(segments)
        course = self._trace_back()
        if self._tempo == "free":
            course = np.where(find_pauses(course, self._rate), -1, course)
        runs = self._choose_runs(course, count)
        starts = [0, *(run.start * self._step for run in runs[1:])]
        self._runs = []
        for run, (start, end) in zip(runs, pairwise([*starts, count]), strict=True):
            offset = run.offset * self._step
            if self._tempo == "same":
                offset = self._refine(run, start, end, segments)
            self._runs.append(Run(start, end, offset))
        self._course_runs = runs
        self._shown = course

    def locate(self, first: int, last: int) -> FloatArray:
        """Reference frames (fractional) of the working frames first to last, which may lie ahead."""
        frames = np.arange(first, last, dtype=np.float64)
        there = frames + self._runs[-1].offset
        for number, run in enumerate(self._runs):
            end = last if number == len(self._runs) - 1 else run.end
            here = (frames >= run.start) & (frames < end)
            if not here.any():
                continue
            there[here] = frames[here] + run.offset
            if self._tempo == "free" and self._offset is None and run.end > run.start:
                there[here] = self._follow_tempo(self._course_runs[number], frames[here])
        return there

    def _extend(self, segments: FloatArray) -> None:
        from dousa.evaluation._line_kernels import extend_lines
        from dousa.evaluation.correlation import compute_correlation_matrix

        rows = np.arange(len(self._course) * self._step, len(segments), self._step)
        if not len(rows):
            return
        cost = to_cost(compute_correlation_matrix(segments[rows], self._coarse, weights=self._weights))
        origin = np.empty((len(rows), len(self._coarse)), np.int32)
        ended = np.empty(len(rows), np.int32)
        extend_lines(
            cost,
            self._best,
            self._outside,
            JUMP_S * self._rate,
            PAUSE[self._tempo],
            OUTSIDE,
            origin,
            ended,
        )
        self._origins.extend(origin)
        self._ended.extend(ended.tolist())
        self._course = np.concatenate([self._course, np.full(len(rows), -1, np.int32)])
        spare = len(self._origins) - round(_KEPT_S * self._rate)
        if spare > 0:
            del self._origins[:spare], self._ended[:spare]

    def _trace_back(self) -> NDArray[np.int32]:
        """Cheapest course so far; what is older than the kept part stays as it was."""
        first = len(self._course) - len(self._origins)
        row, place = len(self._origins) - 1, int(self._best.argmin())
        path = np.full(len(self._origins), -1, np.int32)
        if self._outside[1] < self._best[place]:
            while row >= 0 and self._ended[row] == -2:
                row -= 1
            place = self._ended[row] if row >= 0 else -1
            row -= 1
        while row >= 0 and place >= 0:
            path[row] = place
            place = int(self._origins[row][place])
            row -= 1
        self._course[first:] = path
        return self._course.copy()

    def _choose_runs(self, course: NDArray[np.int32], count: int) -> list[Run]:
        """The lines of the course; while no line is clear the one from the beginning, if it is as good."""
        place = int(self._best.argmin())
        if not self.known:
            others = np.abs(np.arange(len(self._best)) - place) > _OTHER_S * self._rate
            margin = (self._best[others].min() if others.any() else np.inf) - self._best[place]
            late = len(course) >= _LATEST_S * self._rate
            self.known = bool(margin >= _CLEAR and len(course) >= 2.0 * self._rate) or late
        if not self.known:
            zero = min(len(course), len(self._best)) - 1
            around = self._best[max(zero - 3, 0) : zero + 4]
            if around.min() <= self._best[place] + _CLEAR:
                return [Run(0, len(course), 0.0)]
        return find_runs(course, self._rate)

    def _refine(self, run: Run, start: int, end: int, segments: FloatArray) -> float:
        """Offset at the working rate, from all frames of the run."""
        middle, reach = round(run.offset * self._step), self._step + 1
        for known in self._diagonals:
            apart = abs(known.start - run.start * self._step)
            covered = known.shifts[0] <= middle - reach and middle + reach <= known.shifts[-1]
            if covered and apart <= self._reference.frame_rate:
                break
        else:
            begin = max(run.start * self._step, end - round(_KEPT_S * self._reference.frame_rate))
            shifts = np.arange(middle - 2 * reach, middle + 2 * reach + 1)
            known = _Diagonals(begin, begin, shifts, np.zeros(len(shifts)))
            self._diagonals.append(known)
        known.add(end, self._reference, segments, self._weights)
        alike = len(segments) <= 1.02 * self._reference.n_frames + 1
        return known.settle(middle, reach, prefer_zero=alike and end - start > 0.6 * len(segments))

    def _follow_tempo(self, run: Run, frames: FloatArray) -> FloatArray:
        begin = max(run.start, run.end - round(_TREND_S * self._rate))
        on = np.flatnonzero(self._shown[begin : run.end] >= 0)
        offset = float(self._shown[begin + on[0]] - begin - on[0]) if len(on) else run.offset
        trend = smooth_course(self._shown, Run(begin, run.end, offset), self._rate)
        return extrapolate(
            frames, np.arange(begin, run.end, dtype=np.float64) * self._step, trend * self._step
        )
