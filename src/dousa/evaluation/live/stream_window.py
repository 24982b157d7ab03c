"""The line of a performance that is still going on, and its last seconds, looked at as the whole is.

The line is searched as `align` does it, carried on frame by frame; along it are deviations, errors and lapses.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import FloatArray
from dousa.evaluation.alignment.dynamic_programming import Steps, extend_lines, join_steps, trace_lines
from dousa.evaluation.alignment.lines import (
    COARSE_RATE,
    JUMP_S,
    OUTSIDE,
    PAUSE,
    Alignment,
    Lapse,
    Run,
    extrapolate,
    find_lapses,
    find_pauses,
    find_runs,
    pair_similarity,
    smooth_course,
    to_cost,
)
from dousa.evaluation.errors.descriptors import choose_stride, join_descriptors
from dousa.evaluation.errors.evidence import (
    YAW_WINDOW_S,
    Deviations,
    Evidence,
    Tolerance,
    compute_deviations,
    gather_evidence,
    merge_takes,
)
from dousa.evaluation.errors.explain import Finding
from dousa.evaluation.errors.findings import measure_suspects
from dousa.evaluation.errors.judge import decode, load_judge
from dousa.evaluation.grade.references import ReferenceTakes, choose_tolerance, describe
from dousa.evaluation.posture.posture import Working

_KEPT_S = 30.0  # for which the past may still change, see docs/evaluation.md


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

    def settle(self, middle: int, reach: int, *, prefer_zero: bool, zero_gain: float = 0.01) -> float:
        """Find the shift with the least mean cost, to a fraction of a frame."""
        # zero_gain: as in `align`: recordings of equal length begin together without evidence against it
        near = np.abs(self.shifts - middle) <= reach
        shifts, costs = self.shifts[near], self.costs[near] / max(self.counted - self.start, 1)
        best = int(np.argmin(costs))
        zero = np.flatnonzero(self.shifts == 0)
        if prefer_zero and len(zero):
            at_zero = self.costs[zero[0]] / max(self.counted - self.start, 1)
            if at_zero <= costs[best] + zero_gain:
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
        self._steps: Steps | None = None  # of the last frames
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
        from dousa.evaluation.alignment.correspondence import compute_correlation_matrix

        rows = np.arange(len(self._course) * self._step, len(segments), self._step)
        if not len(rows):
            return
        cost = to_cost(compute_correlation_matrix(segments[rows], self._coarse, weights=self._weights))
        prices = JUMP_S * self._rate, PAUSE[self._tempo], OUTSIDE
        steps = extend_lines(cost, self._best, self._outside, *prices)
        kept = round(_KEPT_S * self._rate)
        self._steps = steps if self._steps is None else join_steps((self._steps, steps), kept)
        self._course = np.concatenate([self._course, np.full(len(rows), -1, np.int32)])

    def _trace_back(self) -> NDArray[np.int32]:
        """Cheapest course so far; what is older than the kept part stays as it was."""
        if self._steps is not None:
            course = trace_lines(self._best, self._outside, self._steps)
            self._course[len(self._course) - len(course) :] = course
        return self._course.copy()

    def _choose_runs(
        self, course: NDArray[np.int32], count: int, *, clear: float = 5.0, other_s: float = 1.0, latest_s: float = 15.0
    ) -> list[Run]:
        """The lines of the course; while no line is clear the one from the beginning, if it is as good."""
        # clear: coarse frames of complete mismatch by which a line must beat every other to be known
        # other_s: s; nearer lines are the same line; latest_s: s after which the best line is accepted
        place = int(self._best.argmin())
        if not self.known:
            others = np.abs(np.arange(len(self._best)) - place) > other_s * self._rate
            margin = (self._best[others].min() if others.any() else np.inf) - self._best[place]
            late = len(course) >= latest_s * self._rate
            self.known = bool(margin >= clear and len(course) >= 2.0 * self._rate) or late
        if not self.known:
            zero = min(len(course), len(self._best)) - 1
            around = self._best[max(zero - 3, 0) : zero + 4]
            if around.min() <= self._best[place] + clear:
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
        equal = len(segments) <= 1.02 * self._reference.n_frames + 1
        return known.settle(middle, reach, prefer_zero=equal and end - start > 0.6 * len(segments))

    def _follow_tempo(self, run: Run, frames: FloatArray, *, trend_s: float = 40.0) -> FloatArray:
        begin = max(run.start, run.end - round(trend_s * self._rate))
        on = np.flatnonzero(self._shown[begin : run.end] >= 0)
        offset = float(self._shown[begin + on[0]] - begin - on[0]) if len(on) else run.offset
        trend = smooth_course(self._shown, Run(begin, run.end, offset), self._rate)
        return extrapolate(frames, np.arange(begin, run.end, dtype=np.float64) * self._step, trend * self._step)


_SHORT_S, _LONG_S = 12.0, 30.0
_CONTEXT_S = 2.5  # before a stretch that is still open, see docs/evaluation.md
_MOVED = 0.25  # frames by which a line must have moved for its deviations to be measured again
_HISTORY_S, _NEAR_S = 180.0, 0.6
_ORDER = ("stop", "skip", "repeat")


@dataclass(frozen=True, slots=True, eq=False)
class _Weighed:
    """Log probabilities of moments ``first`` and on; up to ``end`` (both of the whole) they had all that matters."""

    first: int
    end: int
    limbs: FloatArray
    body: FloatArray


class Window:
    """What is known of the last seconds.

    Parameters
    ----------
    references : takes.
    line : of the performance.
    weights : (9,) of the segments, mean 1.
    """

    def __init__(self, references: ReferenceTakes, line: LineFollower, weights: FloatArray) -> None:
        self._references, self._line, self._weights = references, line, weights
        self._rate = references.working[0].frame_rate
        self._context = 4 * max(1, round(0.5 * YAW_WINDOW_S * self._rate))
        self._first = 0
        self._frames = np.empty(0)
        self._parts: Deviations | None = None
        self._open: int | None = None  # first frame of a stretch that has not ended
        self._settled_to = 0
        self._reported: list[Finding] = []
        self._weighed: _Weighed | None = None
        self._hop = round(0.5 * self._rate)
        self._history: list[tuple[FloatArray, FloatArray, FloatArray]] = []
        self._counted, self._measured = 0, 0
        self.tolerance = Tolerance(np.full(9, np.radians(21.6)))  # until a second was seen: the least steady one's
        self.lapses: list[Lapse] = []

    @property
    def first(self) -> int:
        """First working frame that is kept."""
        return self._first

    @property
    def frames(self) -> FloatArray:
        """Reference frames of the working frames that are kept."""
        return self._frames

    def update(self, performance: Working) -> float:
        """Take the whole performance so far; how far the line of the past has moved, in frames."""
        first = self._choose_first(performance.n_frames)
        frames = self._line.locate(first, performance.n_frames)
        kept = self._frames[first - self._first :]
        moved = np.abs(kept - frames[: len(kept)])
        old = max(len(kept) - self._context, 0)
        if (moved > _MOVED).any():
            old = min(old, int(np.argmax(moved > _MOVED)))
        start = first + old
        begin = max(start - self._context, 0)
        used = np.concatenate([kept[:old], frames[old:]])
        before = self._line.locate(begin, first) if begin < first else used[:0]
        known = np.concatenate([before, used[max(begin - first, 0) :]])
        new = self._measure(_cut(performance, begin, performance.n_frames), known)
        new = _rows(new, slice(start - begin, None))
        if self._parts is not None and old:
            past = _rows(self._parts, slice(first - self._first, first - self._first + old))
            new = _join(past, new)
        self._parts, self._frames, self._first = new, used, first
        self._learn()
        return float(moved.max()) if len(moved) else 0.0

    def settle(self, performance: Working, until: int, *, join_s: float = 0.35) -> list[Finding]:
        """Find new errors that end before the working frame ``until``, in frames of the whole."""
        # join_s: s; nearer errors may become one
        assert self._parts is not None
        self._find_lapses(performance, until)
        tolerance = self.tolerance
        evidence = gather_evidence(self._parts, tolerance.angle, tolerance.lag_s, self._weights)
        found = [_move(one, self._first) for one in self._judge(evidence, until)]
        self._open, settled = None, list[Finding]()
        for group in _group(found, join_s * self._rate):
            if max(one.end for one in group) <= until:
                settled += group
                continue
            # What touches an error that goes on may become part of it, or of a lapse that is not known yet.
            self._open = group[0].start
            if until - self._open >= (_LONG_S - _CONTEXT_S) * self._rate:
                # An error that lasts so long is reported in pieces.
                settled += [replace(one, end=min(one.end, until)) for one in group if one.start < until]
                self._open = until
        fresh = [one for one in (self._cut_off(one) for one in settled) if one is not None]
        self._reported = [one for one in self._reported if one.end >= self._first] + fresh
        self._settled_to = until
        return sorted(fresh, key=lambda one: one.start)

    def _judge(self, evidence: Evidence, until: int) -> list[Finding]:
        """As `find_errors`, of the kept frames; what was judged with all that matters around it is not judged again."""
        judge, stride = load_judge(), choose_stride(self._rate)
        descriptors = join_descriptors(describe(self._references, self._frames, evidence))
        begin, kept = self._first // stride, self._weighed
        # A hop ago the look-ahead was as long as it is now: before that nothing is new.
        old = min(max(kept.end - self._hop // stride - begin, 0), len(descriptors.frames)) if kept else 0
        new = judge.weigh(descriptors, old)
        past = [one[begin - kept.first :][:old] for one in (kept.limbs, kept.body)] if kept and old else []
        limbs, body = (np.concatenate(both) for both in zip(past, new, strict=True)) if past else new
        self._weighed = _Weighed(begin, begin + max(0, (until - self._first) // stride), limbs, body)
        suspects = decode(limbs, body, self._rate / stride, judge.decoding)
        return measure_suspects(evidence, suspects, descriptors.frames)

    def _cut_off(self, finding: Finding, *, least_left_s: float = 0.5, late_news_s: float = 1.0) -> Finding | None:
        """What of an error was not reported yet; None if it was, or too little is left."""
        # late_news_s: s; an error that ended longer ago is not reported
        start = finding.start
        for earlier in self._reported:
            same = earlier.kind == finding.kind and set(earlier.segments) & set(finding.segments)
            if same and earlier.start < finding.end and start < earlier.end:
                start = earlier.end
        if start > finding.start and finding.end - start < least_left_s * self._rate:
            return None
        recent = finding.end > self._settled_to - late_news_s * self._rate
        return replace(finding, start=start, worst=max(finding.worst, start)) if recent else None

    def _choose_first(self, count: int) -> int:
        first = count - round(_SHORT_S * self._rate)
        if self._open is not None:
            first = min(first, self._open - round(_CONTEXT_S * self._rate))
        if not self._line.known:
            first = 0
        first = max(first, count - round(_LONG_S * self._rate), 0)
        # What was dropped is gone; moments are every so many frames of the whole.
        stride = choose_stride(self._rate)
        return max(first, self._first) // stride * stride

    def _measure(self, part: Working, frames: FloatArray) -> Deviations:
        """As `compare` does, along a line that is known."""
        takes = [compute_deviations(take, part, frames, self._weights) for take in self._references.working]
        return merge_takes(takes)

    def _learn(self, *, growth: float = 1.1, few_s: float = 1.0) -> None:
        """The tolerance, from what has been seen so far, whenever a tenth more has been."""
        assert self._parts is not None
        last = self._first + len(self._frames) - self._context
        reach = min(round(_NEAR_S * self._rate), self._parts.center)
        columns = slice(self._parts.center - reach, self._parts.center + reach + 1)
        if last > self._counted and self._line.known:
            rows = slice(max(self._counted, self._first) - self._first, last - self._first)
            self._history.append(
                (self._parts.squared[rows, columns].copy(), self._parts.reference[rows], self._parts.spread[rows])
            )
            self._counted = last
            while sum(len(part[0]) for part in self._history[1:]) > _HISTORY_S * self._rate:
                self._measured -= len(self._history.pop(0)[0])
        seen = sum(len(part[0]) for part in self._history)
        if seen < max(few_s * self._rate, growth * self._measured):
            return
        self._measured = seen
        parts = [np.concatenate(values) for values in zip(*self._history, strict=True)]
        sample = replace(self._parts, squared=parts[0], reference=parts[1], spread=parts[2], center=reach)
        self.tolerance = choose_tolerance(sample)

    def _find_lapses(self, performance: Working, until: int) -> None:
        inner = [run.start for run in self._line.runs[1:] if self._first < run.start <= until]
        fresh = [start for start in inner if not any(_near(start / self._rate, one) for one in self.lapses)]
        if not fresh:
            return
        runs = (Run(0, 1, 0.0), *(Run(start - self._first, start, 0.0) for start in fresh))
        part = _cut(performance, self._first, performance.n_frames)
        begin = self._first / self._rate
        alignment = Alignment(self._frames, runs, 0.0, 1.0)
        found = find_lapses(alignment, self._references.working[0], part)
        self.lapses += [_place(lapse, begin) for lapse in found if lapse.kind in _ORDER]


def _near(start_s: float, lapse: Lapse) -> bool:
    return lapse.start_s - 1.0 <= start_s <= lapse.end_s + 1.0


def _place(lapse: Lapse, begin_s: float) -> Lapse:
    """A lapse of a part that begins at a moment; what is danced again may not be over yet."""
    start_s, end_s = begin_s + lapse.start_s, begin_s + lapse.end_s
    if lapse.kind == "repeat":
        end_s = start_s + lapse.reference_end_s - lapse.reference_start_s
    return replace(lapse, start_s=start_s, end_s=end_s)


def _cut(working: Working, start: int, end: int) -> Working:
    part = slice(start, end)
    return replace(working, segments=working.segments[part], seen=working.seen[part], heading=working.heading[part])


# Arrays of deviations with a row a frame.
_BY_FRAME = ("squared", "yaw", "judged", "performance", "reference", "spread")


def _rows(deviations: Deviations, part: slice) -> Deviations:
    return replace(deviations, **{name: getattr(deviations, name)[part] for name in _BY_FRAME})


def _join(past: Deviations, new: Deviations) -> Deviations:
    parts: dict[str, Any] = {name: np.concatenate([getattr(past, name), getattr(new, name)]) for name in _BY_FRAME}
    return replace(new, **parts)


def _group(findings: Sequence[Finding], gap: float) -> list[list[Finding]]:
    """Errors near each other belong together."""
    groups: list[list[Finding]] = []
    for finding in sorted(findings, key=lambda one: one.start):
        if groups and finding.start - max(one.end for one in groups[-1]) <= gap:
            groups[-1].append(finding)
        else:
            groups.append([finding])
    return groups


def _move(finding: Finding, by: int) -> Finding:
    return replace(finding, start=finding.start + by, end=finding.end + by, worst=finding.worst + by)
