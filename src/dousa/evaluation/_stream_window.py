"""The last seconds of a performance that is still going on, looked at as the whole is: deviations, errors, lapses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dousa.evaluation._alignment import Alignment, Run
from dousa.evaluation._deviation import YAW_WINDOW_S, Deviations, choose_nearest, compute_deviations
from dousa.evaluation._evidence import find_stretches, gather_evidence
from dousa.evaluation._explain import Finding, explain
from dousa.evaluation._lapses import find_lapses
from dousa.evaluation._references import ReferenceTakes
from dousa.evaluation._stream_line import LineFollower
from dousa.evaluation._types import Lapse
from dousa.evaluation._working import Working
from dousa.evaluation.thresholds import Tolerance, measure_unsteadiness
from dousa.evaluation.words import describe_lapse
from dousa.motion._types import FloatArray

__all__ = ["Window"]

_SHORT_S, _LONG_S = 12.0, 30.0
_CONTEXT_S = 2.5  # before a stretch that is still open
_JOIN_S = 0.35  # errors nearer than this may become one
_LEAST_LEFT_S = 0.5
_MOVED = 0.25  # frames by which a line must have moved for its deviations to be measured again
_HISTORY_S, _NEAR_S = 180.0, 0.6
_GROWTH = 1.1
_FEW_S = 1.0
_ORDER = ("stop", "skip", "repeat")


class Window:
    """What is known of the last seconds.

    Parameters
    ----------
    references : takes.
    line : of the performance.
    weights : (9,) of the segments, mean 1.
    language : of the lapses.
    """

    def __init__(
        self, references: ReferenceTakes, line: LineFollower, weights: FloatArray, language: str
    ) -> None:
        self._references, self._line, self._weights = references, line, weights
        self._language = language
        self._rate = references.working[0].frame_rate
        self._context = 4 * max(1, round(0.5 * YAW_WINDOW_S * self._rate))
        self._first = 0
        self._frames = np.empty(0)
        self._parts: Deviations | None = None
        self._open: int | None = None  # first frame of a stretch that has not ended
        self._settled_to = 0
        self._history: list[tuple[FloatArray, FloatArray]] = []
        self._counted, self._measured = 0, 0
        self.tolerance = references.tolerance or _START
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

    def settle(self, performance: Working, until: int) -> list[Finding]:
        """Errors that end before the working frame ``until`` and were not told yet, in frames of the whole."""
        assert self._parts is not None
        self._find_lapses(performance, until)
        tolerance = self.tolerance
        evidence = gather_evidence(self._parts, tolerance.angle, tolerance.lag_s, self._weights)
        found: list[Finding] = []
        self._open = None
        for group in _group(find_stretches(evidence), _JOIN_S * self._rate):
            stretches = [(start + self._first, end + self._first) for start, end in group]
            end = stretches[-1][1]
            if end > until:
                self._open = max(stretches[0][0], self._settled_to)
                if until - self._open < (_LONG_S - _CONTEXT_S) * self._rate:
                    continue
                # Nobody waits for ever: what has been wrong for so long is told in pieces.
                stretches = [(start, min(stop, until)) for start, stop in stretches if start < until]
                end, self._open = until, until
            for start, stop in stretches:
                begin = max(start, self._settled_to)
                if start < begin and stop - begin < _LEAST_LEFT_S * self._rate:
                    continue
                found += explain(evidence, begin - self._first, stop - self._first) if stop > begin else []
            self._settled_to = max(self._settled_to, end)
        return [_move(finding, self._first) for finding in found]

    def _choose_first(self, count: int) -> int:
        first = count - round(_SHORT_S * self._rate)
        if self._open is not None:
            first = min(first, self._open - round(_CONTEXT_S * self._rate))
        if not self._line.known:
            first = 0
        first = max(first, count - round(_LONG_S * self._rate), 0)
        # What was dropped is gone.
        return max(first, self._first)

    def _measure(self, part: Working, frames: FloatArray) -> Deviations:
        """As `compare` does, along a line that is known."""
        first, *others = self._references.working
        deviations = compute_deviations(first, part, frames, self._weights)
        for reference in others:
            other = compute_deviations(reference, part, frames, self._weights)
            deviations = choose_nearest(deviations, other)
        return deviations

    def _learn(self) -> None:
        """The tolerance, from what has been seen so far, whenever a tenth more has been."""
        assert self._parts is not None
        last = self._first + len(self._frames) - self._context
        reach = min(round(_NEAR_S * self._rate), self._parts.center)
        columns = slice(self._parts.center - reach, self._parts.center + reach + 1)
        if last > self._counted and self._line.known:
            rows = slice(max(self._counted, self._first) - self._first, last - self._first)
            self._history.append((self._parts.squared[rows, columns].copy(), self._parts.reference[rows]))
            self._counted = last
            while sum(len(part[0]) for part in self._history[1:]) > _HISTORY_S * self._rate:
                self._measured -= len(self._history.pop(0)[0])
        seen = sum(len(part[0]) for part in self._history)
        if seen < max(_FEW_S * self._rate, _GROWTH * self._measured):
            return
        self._measured = seen
        parts = [np.concatenate(values) for values in zip(*self._history, strict=True)]
        sample = replace(self._parts, squared=parts[0], reference=parts[1], center=reach)
        own, learned = measure_unsteadiness(sample), self._references.tolerance
        if learned is not None:
            own = Tolerance(np.maximum(own.angle, learned.angle), learned.lag_s)
        self.tolerance = own

    def _find_lapses(self, performance: Working, until: int) -> None:
        inner = [run.start for run in self._line.runs[1:] if self._first < run.start <= until]
        fresh = [start for start in inner if not any(_near(start / self._rate, one) for one in self.lapses)]
        if not fresh:
            return
        runs = (Run(0, 1, 0.0), *(Run(start - self._first, start, 0.0) for start in fresh))
        part = _cut(performance, self._first, performance.n_frames)
        begin = self._first / self._rate
        for lapse in find_lapses(
            Alignment(self._frames, runs, 0.0, 1.0), self._references.working[0], part, self._language
        ):
            if lapse.kind not in _ORDER:
                continue
            spans = _place(lapse, begin)
            self.lapses.append(Lapse(lapse.kind, *spans, describe_lapse(lapse.kind, *spans, self._language)))


_START = Tolerance(np.full(9, np.radians(21.6)))
"""Until a second has been seen: that of the least steady performer."""


def _near(start_s: float, lapse: Lapse) -> bool:
    return lapse.start_s - 1.0 <= start_s <= lapse.end_s + 1.0


def _place(lapse: Lapse, begin_s: float) -> tuple[float, float, float, float]:
    """Spans of a lapse in a part that begins at a moment; what is danced again may not be over yet."""
    start_s, end_s = begin_s + lapse.start_s, begin_s + lapse.end_s
    if lapse.kind == "repeat":
        end_s = start_s + lapse.reference_end_s - lapse.reference_start_s
    return start_s, end_s, lapse.reference_start_s, lapse.reference_end_s


def _cut(working: Working, start: int, end: int) -> Working:
    part = slice(start, end)
    return replace(
        working, segments=working.segments[part], seen=working.seen[part], heading=working.heading[part]
    )


def _rows(deviations: Deviations, part: slice) -> Deviations:
    return replace(
        deviations,
        squared=deviations.squared[part],
        yaw=deviations.yaw[part],
        judged=deviations.judged[part],
        performance=deviations.performance[part],
        reference=deviations.reference[part],
    )


def _join(past: Deviations, new: Deviations) -> Deviations:
    return replace(
        new,
        squared=np.concatenate([past.squared, new.squared]),
        yaw=np.concatenate([past.yaw, new.yaw]),
        judged=np.concatenate([past.judged, new.judged]),
        performance=np.concatenate([past.performance, new.performance]),
        reference=np.concatenate([past.reference, new.reference]),
    )


def _group(stretches: Sequence[tuple[int, int]], gap: float) -> list[list[tuple[int, int]]]:
    """Stretches near each other belong together."""
    groups: list[list[tuple[int, int]]] = []
    for stretch in stretches:
        if groups and stretch[0] - groups[-1][-1][1] <= gap:
            groups[-1].append(stretch)
        else:
            groups.append([stretch])
    return groups


def _move(finding: Finding, by: int) -> Finding:
    return replace(finding, start=finding.start + by, end=finding.end + by, worst=finding.worst + by)
