"""Lines: the moment of the reference for each moment of the performance if the tempo is kept, and lapses between them.

Straight lines in the correlation matrix (step 4 of the method): one line for a performance from end to end, several
if a figure is left out or repeated, or the performer stops. What is left after the lines is lag.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import FloatArray
from dousa.evaluation.alignment.dynamic_programming import Steps, extend_lines, join_steps, trace_lines
from dousa.evaluation.posture.posture import Working
from dousa.evaluation.words import date, describe_lapse
from dousa.messages import Message

COARSE_RATE = 10.0  # Hz, see docs/evaluation.md
_SMALL = 1.0 - np.cos(np.radians(8.0))  # dissimilarity of the same pose taken twice, see docs/evaluation.md
JUMP_S = 2.5  # s of complete mismatch that are worth a new line, see docs/evaluation.md
PAUSE = {"same": 1e9, "free": 0.35}  # of a frame's full cost, see docs/evaluation.md
OUTSIDE = 0.75  # cost of a frame outside the reference, see docs/evaluation.md
_SAME_LINE_S = 1.0  # s; lines nearer than this are one line and a lag, see docs/evaluation.md
_SHORT_S, _SHORT_RATIO, _SHORT_SHARE = 8.0, 2.0, 0.65


@dataclass(frozen=True, slots=True)
class Run:
    """A stretch of the performance on one line."""

    start: int  # performance frame at the working rate
    end: int  # the frame after the last
    offset: float  # reference frame minus performance frame at ``start``


@dataclass(frozen=True, slots=True, eq=False)
class Alignment:
    """The lines."""

    # (T,) reference frame (fractional, working rate) of each performance frame; goes on beyond both ends of the
    # reference
    frames: FloatArray
    runs: tuple[Run, ...]  # lines in order
    mismatch: float  # mean cost along the lines, 0 (equal) to 1 (nothing in common)
    tempo: float  # performance seconds per reference second


def align(reference: Working, performance: Working, tempo: str, weights: FloatArray) -> Alignment:
    """Find the lines.

    Parameters
    ----------
    reference, performance : at the same working rate.
    tempo : ``"same"`` (lines of slope one) or ``"free"`` (a curve, averaged over seconds).
    weights : (9,) of the segments.
    """
    step = max(1, round(performance.frame_rate / COARSE_RATE))
    rate = performance.frame_rate / step
    # Performance frame of each row; its fractions matter only where the tempo is another.
    clock = np.arange(0, performance.n_frames, step, dtype=np.float64)
    coarse = reference.segments[::step]

    def follow() -> NDArray[np.int32]:
        search = Course(coarse, rate, tempo, weights)
        search.extend(performance.segments[_find_rows(clock, performance)])
        return search.trace()

    course = follow()
    if tempo == "free":
        # A pose that is held tells no tempo: it is crossed at the tempo of the rest.
        slope = _measure_slope(course)
        clock = np.arange(0.0, performance.n_frames, step / slope)
        course = follow()
        course = np.where(find_pauses(course, rate), -1, course)
    runs = find_runs(course, rate)
    starts = [int(np.ceil(clock[run.start])) for run in runs]
    edges = [0, *starts[1:], performance.n_frames]
    frames = np.empty(performance.n_frames)
    for run, (first, last) in zip(runs, pairwise(edges), strict=True):
        here = np.arange(first, last, dtype=np.float64)
        if tempo == "free":
            line = smooth_course(course, run, rate)
            frames[first:last] = extrapolate(here, clock[run.start : run.end], line * step)
        else:
            frames[first:last] = here + _refine(run, step, reference, performance, weights)
    if tempo == "same" and _hangs_by_an_end(frames, reference.n_frames, performance.frame_rate):
        starts, edges = [0], [0, performance.n_frames]
        frames = _keep_whole(reference, performance, weights)
    ends = edges[1:]
    final = tuple(Run(start, end, float(frames[start] - start)) for start, end in zip(starts, ends, strict=True))
    on_clock = np.interp(clock, np.arange(performance.n_frames), frames) / step
    mismatch = _measure_mismatch(on_clock, performance.segments[_find_rows(clock, performance)], coarse, weights)
    return Alignment(frames, final, mismatch, _measure_tempo(frames, final))


def _find_rows(clock: FloatArray, performance: Working) -> NDArray[np.intp]:
    return np.minimum(np.rint(clock).astype(np.intp), performance.n_frames - 1)


def _hangs_by_an_end(frames: FloatArray, n_reference: int, rate: float) -> bool:
    """Whether two short motions of about one length touch each other with little more than their ends.

    Takes of one short exercise have no common timing: leaving most of both out may look cheaper than being late.
    """
    count = len(frames)
    inside = int(((frames >= -0.5) & (frames <= n_reference - 0.5)).sum())
    short = max(count, n_reference) <= _SHORT_S * rate
    similar = max(count, n_reference) <= _SHORT_RATIO * min(count, n_reference)
    return short and similar and inside < _SHORT_SHARE * min(count, n_reference)


def _keep_whole(reference: Working, performance: Working, weights: FloatArray) -> FloatArray:
    """(T,) reference frames at the offset that dynamic time warping from end to end mostly has."""
    from dousa.evaluation.alignment.correspondence import find_path

    path = find_path(reference.segments, performance.segments, weights=weights)
    return np.arange(performance.n_frames, dtype=np.float64) + float(np.median(path[:, 0] - path[:, 1]))


class Course:
    """The cheapest sequence of lines through a reference, carried on as poses come.

    Parameters
    ----------
    reference : (U, 9, 3) poses, at about `COARSE_RATE`.
    rate : Hz, of those and of the performance's poses.
    tempo, weights : as for `align`.
    kept : poses of the performance for which the course may still change; 0: all.
    """

    def __init__(self, reference: FloatArray, rate: float, tempo: str, weights: FloatArray, kept: int = 0) -> None:
        self._reference, self._weights, self._kept = reference, weights, kept
        self._prices = JUMP_S * rate, PAUSE[tempo], OUTSIDE
        self.best = np.full(len(reference), np.inf)  # (U,) price of the cheapest sequence that ends at each pose
        self._outside = np.zeros(2)
        self._steps: list[Steps] = []

    def extend(self, segments: FloatArray, *, at_once: int = 500_000) -> None:
        """Take the next poses (n, 9, 3)."""
        from dousa.evaluation.alignment.correspondence import Correlation

        # at_once: pairs of poses whose costs are held at a time
        size = max(1, at_once // len(self._reference))
        pairs = Correlation.of(segments, self._reference, self._weights)
        for first in range(0, len(segments), size):
            cost = to_cost(pairs.compare(first, first + size))
            self._steps.append(extend_lines(cost, self.best, self._outside, *self._prices))
        if self._kept and self._steps:
            self._steps = [join_steps(self._steps, self._kept)]

    def trace(self) -> NDArray[np.int32]:
        """Reference pose (n,) of each pose so far, or of those that are kept; -1 without a line."""
        if not self._steps:
            return np.empty(0, np.int32)
        return trace_lines(self.best, self._outside, join_steps(self._steps))


class LineFollower:
    """The lines of a performance that is still going on.

    Parameters
    ----------
    reference : at the working rate.
    tempo, weights : as for `align`.
    kept_s : s of the past that may still change.
    """

    def __init__(self, reference: Working, tempo: str, weights: FloatArray, *, kept_s: float = 30.0) -> None:
        self._reference, self._tempo, self._weights = reference, tempo, weights
        self._step = max(1, round(reference.frame_rate / COARSE_RATE))
        self._rate, self._kept_s = reference.frame_rate / self._step, kept_s
        kept = round(kept_s * self._rate)
        self._search = Course(reference.segments[:: self._step], self._rate, tempo, weights, kept)
        self._course = np.empty(0, np.int32)
        self._coarse_runs: list[Run] = []
        self.runs = [Run(0, 0, 0.0)]  # lines so far in working frames, the last one going on
        self.known = False  # whether one line is clearly better than all others

    def update(self, performance: Working) -> None:
        """Take all poses so far, at the working rate."""
        count, step = performance.n_frames, self._step
        rows = np.arange(len(self._course) * step, count, step)
        self._search.extend(performance.segments[rows])
        traced = self._search.trace()
        # What is older than the kept part stays as it was.
        self._course = np.concatenate([self._course[: len(self._course) + len(rows) - len(traced)], traced])
        course = self._course
        if self._tempo == "free":
            course = np.where(find_pauses(course, self._rate), -1, course)
        self._coarse_runs = self._choose_runs(course)
        known = {(run.start, round(run.offset / step)): run for run in self.runs[:-1]}
        starts = [0, *(run.start * step for run in self._coarse_runs[1:])]
        self.runs = []
        for run, (start, end) in zip(self._coarse_runs, pairwise([*starts, count]), strict=True):
            before = known.get((start, round(run.offset)))
            if before is not None and before.end == end:
                self.runs.append(before)
                continue
            offset = run.offset * step
            if self._tempo == "same":
                late = Run(max(run.start, run.end - round(self._kept_s * self._rate)), run.end, run.offset)
                offset = _refine(late, step, self._reference, performance, self._weights, growing=True)
            self.runs.append(Run(start, end, offset))
        self._shown = course

    def locate(self, first: int, last: int) -> FloatArray:
        """Reference frames (fractional) of the working frames first to last, which may lie ahead."""
        frames = np.arange(first, last, dtype=np.float64)
        there = frames + self.runs[-1].offset
        for number, run in enumerate(self.runs):
            end = last if number == len(self.runs) - 1 else run.end
            here = (frames >= run.start) & (frames < end)
            if not here.any():
                continue
            there[here] = frames[here] + run.offset
            if self._tempo == "free" and run.end > run.start:
                there[here] = self._follow_tempo(self._coarse_runs[number], frames[here])
        return there

    def _choose_runs(
        self, course: NDArray[np.int32], *, clear: float = 5.0, other_s: float = 1.0, latest_s: float = 15.0
    ) -> list[Run]:
        """The lines of the course; while no line is clear the one from the beginning, if it is as good."""
        # clear: coarse frames of complete mismatch by which a line must beat every other to be known
        # other_s: s; nearer lines are the same line; latest_s: s after which the best line is accepted
        best, count = self._search.best, len(course)
        if not self.known:
            place = int(best.argmin())
            others = np.abs(np.arange(len(best)) - place) > other_s * self._rate
            margin = (best[others].min() if others.any() else np.inf) - best[place]
            self.known = bool(margin >= clear and count >= 2.0 * self._rate) or count >= latest_s * self._rate
            zero = min(count, len(best)) - 1
            if not self.known and best[max(zero - 3, 0) : zero + 4].min() <= best[place] + clear:
                return [Run(0, count, 0.0)]
        return find_runs(course, self._rate)

    def _follow_tempo(self, run: Run, frames: FloatArray, *, trend_s: float = 40.0) -> FloatArray:
        begin = max(run.start, run.end - round(trend_s * self._rate))
        on = np.flatnonzero(self._shown[begin : run.end] >= 0)
        offset = float(self._shown[begin + on[0]] - begin - on[0]) if len(on) else run.offset
        trend = smooth_course(self._shown, Run(begin, run.end, offset), self._rate)
        return extrapolate(frames, np.arange(begin, run.end, dtype=np.float64) * self._step, trend * self._step)


def _measure_slope(course: np.ndarray, *, fewest_for_tempo: int = 12) -> float:
    """Reference frames per performance frame: the median of all long pieces of the course."""
    # fewest_for_tempo: coarse frames
    on = np.flatnonzero(course >= 0)
    if len(on) < fewest_for_tempo:
        return 1.0
    far = len(on) // 4
    slopes = (course[on[far:]] - course[on[:-far]]) / (on[far:] - on[:-far])
    slopes = slopes[slopes > 0]
    return _limit_slope(float(np.median(slopes))) if len(slopes) else 1.0


def _limit_slope(slope: float, *, slowest: float = 0.4, fastest: float = 2.5) -> float:
    # reference per performance time; a tempo beyond these is a false line
    return min(max(slope, slowest), fastest)


def find_pauses(course: np.ndarray, rate: float, *, pause_s: float = 1.0) -> NDArray[np.bool_]:
    """Find rows in which the course rests in the reference for a second and more: the performer waits."""
    # pause_s: s of rest in the reference that make a stop; a shorter one is a slow passage
    length = max(2, round(pause_s * rate))
    paused = np.zeros(len(course), bool)
    if len(course) > length:
        resting = (course[length:] >= 0) & (course[:-length] >= 0)
        resting &= np.abs(course[length:] - course[:-length]) <= 1
        for row in np.flatnonzero(resting):
            paused[row + 1 : row + length] = True
    return paused


def extrapolate(x: FloatArray, known: FloatArray, values: FloatArray) -> FloatArray:
    """Interpolate linearly, and beyond both ends at the mean slope."""
    found = np.interp(x, known, values)
    slope = (values[-1] - values[0]) / (known[-1] - known[0]) if len(known) > 1 else 1.0
    found = np.where(x < known[0], values[0] + slope * (x - known[0]), found)
    return np.where(x > known[-1], values[-1] + slope * (x - known[-1]), found)


def to_cost(similarity: NDArray[np.floating], *, large: float = 25.0 * _SMALL) -> FloatArray:
    """0 for equal poses, 1 for poses with nothing in common; steep at first, so that the most frames decide."""
    # large: about 40 deg: a larger dissimilarity says no more than this
    cost: FloatArray = np.log1p(np.clip(1.0 - similarity, 0.0, large) / _SMALL) / np.log1p(large / _SMALL)
    return cost


def _measure_mismatch(frames: FloatArray, segments: FloatArray, reference: FloatArray, weights: FloatArray) -> float:
    """Mean cost where the lines run inside the reference; of everything if that is too little to tell."""
    n_frames, n_reference = len(frames), len(reference)
    inside = (frames >= -0.5) & (frames <= n_reference - 0.5)
    columns = np.clip(np.rint(frames).astype(np.intp), 0, n_reference - 1)
    along = np.where(inside, to_cost(pair_similarity(segments, reference[columns], weights)), OUTSIDE)
    enough = inside.sum() >= 0.5 * min(n_frames, n_reference)
    return float(along[inside].mean() if enough else along.mean())


def find_runs(course: np.ndarray, rate: float, *, shortest_run_s: float = 1.5) -> list[Run]:
    """Find the lines of a course; a departure that returns to the same line does not break it (it is an error)."""
    on = np.flatnonzero(course >= 0)
    if len(on) == 0:
        return [Run(0, len(course), 0.0)]
    steps = np.diff(course[on])
    # After a pause the next line begins.
    breaks = np.flatnonzero((steps < 0) | (steps > 2) | (np.diff(on) > 1)) + 1
    edges = [0, *breaks, len(on)]
    found = [Run(int(on[a]), int(on[b - 1]) + 1, float(course[on[a]] - on[a])) for a, b in pairwise(edges)]
    longest = max(found, key=lambda run: run.end - run.start)
    kept = [run for run in found if run is longest or run.end - run.start >= shortest_run_s * rate]
    merged: list[Run] = []
    for run in kept:
        same = [i for i, other in enumerate(merged) if _is_same_line(other, run, course, rate)]
        if same:
            first = merged[same[0]]
            longer = max(*merged[same[0] :], run, key=lambda r: r.end - r.start)
            offset = longer.offset if abs(longer.offset - first.offset) <= _SAME_LINE_S * rate else first.offset
            merged[same[0] :] = [Run(first.start, run.end, offset)]
        else:
            merged.append(run)
    starts = [run.start for run in merged]
    ends = [*starts[1:], merged[-1].end]
    return [Run(a, b, run.offset) for a, b, run in zip(starts, ends, merged, strict=True)]


def _is_same_line(
    earlier: Run, later: Run, course: np.ndarray, rate: float, *, same_long_line_s: float = 0.6, long_run_s: float = 4.0
) -> bool:
    # same_long_line_s: s; the same where both are long: who is late for good has stopped, not lagged
    shortest = min(earlier.end - earlier.start, later.end - later.start)
    near = same_long_line_s if shortest >= long_run_s * rate else _SAME_LINE_S
    return _leaves_off(earlier, course, later) <= near * rate


def _leaves_off(earlier: Run, course: np.ndarray, later: Run) -> float:
    """How far the later run lies from the end of the earlier one, frames."""
    end = earlier.end - 1
    while end > earlier.start and course[end] < 0:
        end -= 1
    return float(abs((course[end] - end) - later.offset))


def _refine(
    run: Run,
    step: int,
    reference: Working,
    performance: Working,
    weights: FloatArray,
    *,
    growing: bool = False,
    in_step: float = 1.4,
    refined_on: int = 900,
) -> float:
    """Offset at the working rate: the shift with the least mean cost, to a fraction of a frame."""
    # growing: the performance still goes on; refined_on: frames of the run, evenly spread: 30 s
    # in_step: motions of equal length begin together, unless another offset is so much better
    start, end = run.start * step, min(run.end * step, performance.n_frames)
    middle, count = round(run.offset * step), performance.n_frames
    over = count - reference.n_frames
    equal_length = (over if growing else abs(over)) <= 0.02 * count + 1
    frames = np.unique(np.linspace(start, end - 1, min(end - start, refined_on)).astype(np.intp))
    shifts = np.array([*range(middle - step - 1, middle + step + 2), 0])
    there = frames + shifts[:, None]
    inside = (there >= 0) & (there < reference.n_frames)
    theirs = reference.segments[np.clip(there, 0, reference.n_frames - 1)]
    cost = to_cost(pair_similarity(performance.segments[frames], theirs, weights))
    costs = np.where(inside.any(axis=1), np.where(inside, cost, OUTSIDE).mean(axis=1), np.inf)
    costs, zero = costs[:-1], costs[-1]
    best = int(np.argmin(costs))
    if equal_length and end - start > 0.6 * count and zero <= in_step * costs[best] + 0.02:
        return 0.0
    shift = float(shifts[best])
    if 0 < best < len(costs) - 1 and np.isfinite(costs[best - 1 : best + 2]).all():
        left, here, right = costs[best - 1 : best + 2]
        bend = left - 2 * here + right
        shift += 0.5 * (left - right) / bend if bend > 1e-12 else 0.0
    return shift


def pair_similarity(a: FloatArray, b: FloatArray, weights: FloatArray) -> FloatArray:
    """Compute S pose by pose; weights (..., 9), of all poses or of each (0 for segments that are not seen)."""
    across = (a[..., 2] + 1j * a[..., 0]) * (b[..., 2] - 1j * b[..., 0])
    upright = a[..., 1] * b[..., 1]
    total = np.abs((across * weights).sum(axis=-1)) + (upright * weights).sum(axis=-1)
    return np.asarray(total / np.maximum(weights.sum(axis=-1), 1e-9))


def smooth_course(course: np.ndarray, run: Run, rate: float, *, smooth_s: float = 6.0) -> FloatArray:
    """Smooth the reference frames of a run over seconds about a robust straight line."""
    # smooth_s: s over which a free tempo is averaged
    frames = np.arange(run.start, run.end, dtype=np.float64)
    on = course[run.start : run.end] >= 0
    x, y = frames[on], course[run.start : run.end][on].astype(np.float64)
    if len(x) == 0:
        return frames + run.offset
    weights = np.ones(len(x))
    slope, middle = 1.0, float(np.median(y - x))
    for _ in range(10):
        if len(x) < 3 or np.ptp(x) == 0:
            break
        slope, middle = np.polyfit(x, y, 1, w=np.sqrt(weights))
        slope = _limit_slope(float(slope))
        off = np.abs(y - slope * x - middle)
        weights = 1.0 / np.maximum(off, 0.1 * rate)
    line = slope * frames + middle
    half = round(0.5 * smooth_s * rate)
    if len(x) > 4 * half:
        rest = np.interp(frames, x, y - slope * x - middle)
        padded = np.pad(rest, half, mode="edge")
        windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * half + 1)
        median = np.pad(np.median(windows, axis=1), half, mode="edge")
        line = line + np.convolve(median, np.ones(2 * half + 1) / (2 * half + 1), mode="valid")
    return line


def _measure_tempo(frames: FloatArray, runs: tuple[Run, ...]) -> float:
    """Performance seconds per reference second, over all runs."""
    spent = sum(run.end - 1 - run.start for run in runs)
    covered = sum(frames[run.end - 1] - frames[run.start] for run in runs)
    return float(spent / covered) if covered > 0 and spent > 0 else 1.0


NO_LIKENESS = 0.74  # mismatch from which a performance has nothing in common, see docs/evaluation.md


@dataclass(frozen=True, slots=True)
class Lapse:
    """A stretch where the performance is not at the reference's place: no error of form, but of order.

    Parameters
    ----------
    kind : ``"stop"`` (stands still, goes on later), ``"skip"`` (leaves reference time out), ``"repeat"`` (does
        reference time again), ``"late start"`` or ``"early end"`` (of the performance's part of the reference),
        ``"lead-in"`` or ``"lead-out"`` (motion before or after, that is not in the reference).
    start_s, end_s : performance seconds.
    reference_start_s, reference_end_s : reference seconds that are left out, done again or not reached.
    """

    kind: str
    start_s: float
    end_s: float
    reference_start_s: float
    reference_end_s: float

    @property
    def message(self) -> Message:
        """What happens: ``"stands still for 1.2 s, then goes on"``."""
        spans = (self.start_s, self.end_s, self.reference_start_s, self.reference_end_s)
        return describe_lapse(self.kind, *spans)

    @property
    def says(self) -> Message:
        """When, and what happens: ``"0:31.0, stands still for 1.2 s, then goes on"``."""
        return date(self.message, self.start_s)


def find_lapses(
    alignment: Alignment, reference: Working, performance: Working, *, shortest_end_s: float = 0.7
) -> tuple[Lapse, ...]:
    """Find the places where the performance changes its place in the reference, in order of time.

    Motions are at the working rate, and so are the frames of the lines. Motions with nothing in common have no lapses.
    At the ends a lapse lasts ``shortest_end_s``: recordings are cut half a second earlier or later by chance.
    """
    if alignment.mismatch > NO_LIKENESS or performance.n_frames == 0:
        return ()
    speed = _measure_speed(performance)
    usual = _measure_speed(reference)
    found = [*_look_before(alignment, performance, shortest_end_s)]
    for run in alignment.runs[1:]:
        found += _look_between(alignment, run.start, speed, usual, performance)
    found += _look_after(alignment, reference, performance, shortest_end_s)
    return tuple(found)


def _look_before(alignment: Alignment, performance: Working, shortest_s: float) -> list[Lapse]:
    first = float(alignment.frames[0])
    if first > shortest_s * performance.frame_rate:
        return [Lapse("late start", 0.0, 0.0, 0.0, first / performance.frame_rate)]
    # The reference begins where the line comes to its frame 0.
    begins = int(np.searchsorted(alignment.frames, 0.0))
    if begins > shortest_s * performance.frame_rate:
        return [Lapse("lead-in", 0.0, begins / performance.frame_rate, 0.0, 0.0)]
    return []


def _look_after(alignment: Alignment, reference: Working, performance: Working, shortest_s: float) -> list[Lapse]:
    rate = performance.frame_rate
    end, last = performance.n_frames / rate, reference.n_frames / rate
    left = reference.n_frames - 1.0 - float(alignment.frames[-1])
    if left > shortest_s * rate:
        return [Lapse("early end", end, end, last - left / rate, last)]
    beyond = int((alignment.frames[::-1] > reference.n_frames - 1.0).cumprod().sum())
    if beyond > shortest_s * rate:
        return [Lapse("lead-out", end - beyond / rate, end, last, last)]
    return []


def _look_between(
    alignment: Alignment,
    start: int,
    speed: FloatArray,
    usual: FloatArray,
    performance: Working,
    *,
    shortest_s: float = 0.3,
) -> list[Lapse]:
    """What happens between two lines; the second begins at frame ``start``."""
    # shortest_s: a smaller step between two lines is a matter of lag
    if start < 1:
        return []
    rate = performance.frame_rate
    reached, again = float(alignment.frames[start - 1]) + 1.0, float(alignment.frames[start])
    if again - reached >= shortest_s * rate:
        return [Lapse("skip", start / rate, start / rate, reached / rate, again / rate)]
    lost = reached - again
    if lost < shortest_s * rate:
        return []
    still = _find_still(start, lost, speed, usual, (again, reached), rate)
    if still is not None:
        first, last = still
        # On the line before, the reference goes on; the performer does not.
        moment = float(alignment.frames[start - 1]) - (start - 1 - first)
        if first >= start:
            moment = again + (first - start)
        moment = float(np.clip(moment, 0.0, len(usual) - 1.0)) / rate
        return [Lapse("stop", first / rate, last / rate, moment, moment)]
    end = min(start + lost, performance.n_frames)
    return [Lapse("repeat", start / rate, end / rate, again / rate, reached / rate)]


def _find_still(
    start: int,
    lost: float,
    speed: FloatArray,
    usual: FloatArray,
    span: tuple[float, float],
    rate: float,
    *,
    slowest: float = 0.25,
    still_share: float = 0.7,
    slow: float = 0.35,
) -> tuple[int, int] | None:
    """The stretch around a break, as long as the time lost, in which the performer stands still, if there is one."""
    # slowest: rad/s, as fast as a standing person and a tracker waver; still_share: of the lost time
    # slow: of the reference's speed: below, a performer stands still
    length = max(1, round(lost))
    # The break between the lines lies somewhere in the stop.
    low, high = max(0, start - length), min(len(speed), start + length)
    if high - low < length:
        return None
    around = usual[max(0, int(span[0])) : max(int(span[1]), int(span[0]) + 1)]
    limit = max(slow * float(np.median(around if len(around) else usual)), slowest)
    still = (speed[low:high] < limit).astype(np.float64)
    shares = np.convolve(still, np.ones(length) / length, mode="valid")
    best = shares.max()
    if best < still_share:
        return None
    # Equal shares lie side by side: the middle one.
    places: NDArray[np.intp] = np.flatnonzero(shares >= best - 1e-9)
    first = low + int(places[len(places) // 2])
    return first, first + length


def _measure_speed(motion: Working, *, speed_window_s: float = 0.3) -> FloatArray:
    """(T,) rad/s, mean over the segments, averaged over a moment."""
    if motion.n_frames < 2:
        return np.zeros(motion.n_frames)
    half = max(1, round(0.5 * speed_window_s * motion.frame_rate))
    padded = np.pad(motion.segments, ((half, half), (0, 0), (0, 0)), mode="edge")
    chord = np.linalg.norm(padded[2 * half :] - padded[: -2 * half], axis=2).mean(axis=1)
    # At the ends the window is shorter than it looks.
    count = np.arange(motion.n_frames)
    width = np.minimum(count + half, motion.n_frames - 1) - np.maximum(count - half, 0)
    return np.asarray(chord * motion.frame_rate / width)
