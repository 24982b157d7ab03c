"""One cause, one finding: what a lag or an exchange of sides explains is not said again as short, bent or different.

A cause says where the parts of the body would be if it were true; it takes the place of every finding of whose
deviation it leaves less than a third. That is the principle of the shortest description: a cause costs as much as a
finding, so one that stands for several is the simpler account, and what it leaves over of one must be small.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import FloatArray
from dousa.evaluation.alignment.dynamic_programming import switch_on
from dousa.evaluation.errors.deviations import YAW_SCALE, YAW_WINDOW_S, measure_deviations
from dousa.evaluation.errors.evidence import CAP, Evidence, measure_ranges
from dousa.evaluation.errors.findings import Finding, describe_shift, follow_limb, measure_severity, measure_suspects
from dousa.evaluation.errors.judge import Suspect
from dousa.evaluation.posture.posture import LIMBS, MIRRORED_SEGMENTS
from dousa.motion.runs import find_runs

# s, rad: a smaller error is not worth saying, see docs/evaluation.md
_USEFUL_LAG_S, _USEFUL_ANGLE = 0.08, np.radians(10.0)

_EDGE_BETWEEN, _MOSTLY = 0.5, 0.8  # of the lag between two shifts that are one; of the moments there
_LEFT_OVER = 1.0 / 3.0  # of the deviation, that a cause may leave; measured in lab/trials/causes.py
_FLIP = np.array([1.0, 1.0, -1.0])  # mirror image by definition: z, the body's own left in `Deviations`, negated
_PAIRS = tuple((np.array(LIMBS[f"left_{limb}"]), np.array(LIMBS[f"right_{limb}"])) for limb in ("arm", "leg"))


def tell_errors(
    evidence: Evidence, suspects: Sequence[Suspect], frames: NDArray[np.intp], time_spread: FloatArray
) -> list[Finding]:
    """Measure what the judge found, with one finding for each cause, and leave out what is not worth saying.

    Parameters
    ----------
    evidence, suspects, frames : see `measure_suspects`.
    time_spread : (T,) s, how much the timing of the takes of the reference differs there; 0 of one take.
    """
    found = explain_together(evidence, measure_suspects(evidence, suspects, frames))
    return [one for one in found if _is_useful(evidence, one, time_spread) and not _is_posture(evidence, one)]


def _is_posture(evidence: Evidence, one: Finding, *, edge_s: float = 0.35, idle: float = 0.5) -> bool:
    """Whether limbs that the reference hardly moves are held otherwise from the beginning to the end.

    How somebody holds an idle arm is no error, as it is none in the grade.
    """
    # edge_s: as near as findings that follow each other at once; idle: of the range of what moves most
    deviations, edge = evidence.deviations, edge_s * evidence.rate
    if one.kind not in ("incomplete", "partial") or one.start > edge or one.end < len(evidence.ordinary) - edge:
        return False
    ranges, segments = measure_ranges(deviations.reference), list(one.segments)
    away = (deviations.performance - deviations.reference)[one.start : one.end, segments]
    left = ((away - away.mean(axis=0)) ** 2).sum(axis=2)
    return bool(ranges[segments].max() < idle * ranges.max() and _is_explained((away**2).sum(axis=2), left))


def _is_useful(evidence: Evidence, one: Finding, time_spread: FloatArray, *, by_spread: float = 2.0) -> bool:
    """Whether an error is as large as is worth saying, and beyond all takes of the reference in one direction."""
    # by_spread: multiple of the takes' mean difference in time, as `choose_tolerance` has it for angles
    span = slice(one.start, one.end)
    if one.lag_s is not None and abs(one.lag_s) < _USEFUL_LAG_S + by_spread * float(np.median(time_spread[span])):
        return False
    if one.kind == "incomplete" and (one.shortfall or 0.0) < _USEFUL_ANGLE:
        return False
    # Of a range that is missing half is at either end.
    least = _USEFUL_ANGLE if one.kind in ("partial", "global") else 0.5 * _USEFUL_ANGLE
    beyond = evidence.deviations.beyond - evidence.deviations.apart
    return bool(np.percentile(beyond[span, list(one.segments)].max(axis=1), 90.0) >= least)


def explain_together(evidence: Evidence, findings: Iterable[Finding]) -> list[Finding]:
    """Put one cause in the place of all findings that it explains; in order of time."""
    found = _join_lags(evidence, list(findings))
    sides = _Sides(evidence)
    found = sides.exchange(found)
    found = [sides.name_side(one) for one in _drop_late(evidence, found)]
    return sorted(found, key=lambda one: (one.start, one.end))


def _is_explained(before: FloatArray, left: FloatArray) -> bool:
    """Whether a cause leaves little of the deviations (n, S) of a finding."""
    return bool(np.minimum(left, before).sum() < _LEFT_OVER * before.sum())


def _join_lags(evidence: Evidence, findings: list[Finding]) -> list[Finding]:
    """Of the same limbs one lag for neighbouring findings, if all of them are late by it or early."""
    kept = [one for one in findings if one.kind == "global"]
    by_limbs: dict[tuple[int, ...], list[Finding]] = {}
    for one in findings:
        if one.kind != "global":
            by_limbs.setdefault(_find_limbs(one), []).append(one)
    for segments, some in by_limbs.items():
        for group in _find_neighbours(evidence, some, np.array(segments)):
            kept += _explain_by_lag(evidence, group, np.array(segments))
    return kept


def _find_limbs(finding: Finding) -> tuple[int, ...]:
    """All segments of the limb that a finding is about; of more than a limb its own."""
    return next((limb for limb in LIMBS.values() if set(finding.segments) <= set(limb)), finding.segments)


def _find_neighbours(
    evidence: Evidence, findings: Sequence[Finding], segments: NDArray[np.intp], *, near_s: float = 0.35
) -> list[list[Finding]]:
    """Groups of findings that follow each other at once, or between which a lag goes on."""
    groups: list[list[Finding]] = []
    for one in sorted(findings, key=lambda finding: finding.start):
        end = max((other.end for other in groups[-1]), default=0) if groups else 0
        lag = next((other.lag_s for other in reversed(groups[-1]) if other.lag_s is not None), 0.0) if groups else 0.0
        opposite = lag * (one.lag_s or 0.0) < 0.0
        near = bool(groups) and one.start - end <= near_s * evidence.rate
        if groups and not opposite and (near or _goes_on(evidence, end, one, lag, segments)):
            groups[-1].append(one)
        else:
            groups.append([one])
    return groups


def _goes_on(evidence: Evidence, end: int, one: Finding, lag: float, segments: NDArray[np.intp]) -> bool:
    """Whether a lag lasts from the frame ``end`` to a finding with a lag: half of it, nearly all the time."""
    if not lag or one.lag_s is None:
        return False
    between = follow_limb(evidence, end, one.start, segments) * np.sign(lag)
    return bool((between >= _EDGE_BETWEEN * min(abs(lag), abs(one.lag_s))).mean() >= _MOSTLY)


def _explain_by_lag(evidence: Evidence, group: list[Finding], segments: NDArray[np.intp]) -> list[Finding]:
    """The group as one shift and what that leaves, if there is a shift among it."""
    if not any(one.kind == "shift" for one in group):
        return group
    start, end = min(one.start for one in group), max(one.end for one in group)
    late = follow_limb(evidence, start, end, segments)
    left = _measure_late(evidence, start, late, segments)
    before = evidence.punctual[start:end, segments]
    explained = [
        one
        for one in group
        if one.kind == "shift"
        or _is_explained(before[one.start - start : one.end - start], left[one.start - start : one.end - start])
    ]
    rest = [one for one in group if not any(one is other for other in explained)]
    span = min(one.start for one in explained), max(one.end for one in explained)
    return [describe_shift(evidence, *span, segments), *rest]


def _measure_late(evidence: Evidence, start: int, late: FloatArray, segments: NDArray[np.intp]) -> FloatArray:
    """(n, S) deviations that are left at a lag (n,) in s."""
    columns = np.rint(evidence.center - late * evidence.rate).astype(np.intp)
    columns = np.clip(columns, 0, len(evidence.lag_prices) - 1)
    return evidence.ratio.at_lag(columns, start)[:, segments]


def _drop_late(evidence: Evidence, findings: list[Finding]) -> list[Finding]:
    """Leave out what is no error at the lag of a shift that is reported anyway."""
    shifts = [one for one in findings if one.kind == "shift"]
    courses = [follow_limb(evidence, one.start, one.end, np.array(one.segments)) for one in shifts]
    late = list(zip(shifts, courses, strict=True))
    return [one for one in findings if not any(_is_late(evidence, one, *each) for each in late)]


def _is_late(evidence: Evidence, one: Finding, shift: Finding, course: FloatArray) -> bool:
    first, last = max(one.start, shift.start), min(one.end, shift.end)
    if one.kind == "shift" or not set(one.segments) <= set(shift.segments) or 2 * (last - first) < one.end - one.start:
        return False
    segments = np.array(one.segments)
    left = _measure_late(evidence, first, course[first - shift.start : last - shift.start], segments)
    return _is_explained(evidence.punctual[first:last, segments], left)


class _Sides:
    """What a performance would be, did limbs what those of the other side should."""

    def __init__(self, evidence: Evidence) -> None:
        self._evidence = evidence
        self._known: dict[tuple[int, ...], FloatArray] = {}

    def measure(self, segments: Sequence[int]) -> FloatArray:
        """(T, 9) deviations that are left if the reference did with these segments what it does with the others.

        Without them nothing may show the heading of who stands upright: it is estimated once more.
        """
        key = tuple(segments)
        if key not in self._known:
            self._known[key] = self._measure(list(key))
        return self._known[key]

    def _measure(self, segments: list[int]) -> FloatArray:
        evidence, deviations = self._evidence, self._evidence.deviations
        theirs = deviations.reference.copy()
        theirs[:, segments] = deviations.reference[:, [MIRRORED_SEGMENTS[k] for k in segments]] * _FLIP
        ends = ((evidence.slack, evidence.slack), (0, 0), (0, 0))
        theirs, seen = np.pad(theirs, ends, mode="edge"), np.pad(deviations.judged, ends[:2], mode="edge")
        half = max(1, round(0.5 * YAW_WINDOW_S * evidence.rate))
        weights = evidence.ratio.weights
        far, _ = measure_deviations(
            deviations.performance, theirs, deviations.judged, seen, weights, half, YAW_SCALE**2
        )
        # At the nearest of the moments by which one may be late.
        ratio = np.minimum(far / evidence.tolerance**2, CAP) * weights
        best = ratio.sum(axis=2).argmin(axis=1)
        return np.asarray(ratio[np.arange(len(best)), best] * deviations.judged)

    def exchange(self, findings: list[Finding]) -> list[Finding]:
        """One finding for limbs that were exchanged, in the place of all that this explains."""
        for pair in _PAIRS:
            segments = np.concatenate(pair)
            if not any(one.kind != "shift" and set(one.segments) & set(segments.tolist()) for one in findings):
                continue
            left = self.measure(segments.tolist())
            for start, end in self._find_spans(left):
                explained = [one for one in findings if self._explains(one, start, end, segments, left)]
                if not explained:
                    continue
                findings = [one for one in findings if not any(one is other for other in explained)]
                severity, worst = measure_severity(self._evidence, start, end, segments)
                cause = self._name_exchange(pair, start, end)
                findings.append(Finding("partial", start, end, tuple(segments.tolist()), severity, worst, cause=cause))
        return _join_exchanged(findings)

    def _find_spans(
        self, left: FloatArray, *, price: float = 10.0, shortest_s: float = 0.5
    ) -> Iterator[tuple[int, int]]:
        """Half-open spans that an exchange explains."""
        # price: of a cause, in frames of 1/30 s of a segment at its tolerance
        before, rate = self._evidence.ordinary, self._evidence.rate
        gain = (before - left).sum(axis=1) * (30.0 / rate)
        for start, end in find_runs(switch_on(gain - 1e-6, price)).tolist():
            if end - start >= shortest_s * rate and _is_explained(before[start:end], left[start:end]):
                yield start, end

    def _explains(self, one: Finding, start: int, end: int, segments: NDArray[np.intp], left: FloatArray) -> bool:
        span = slice(max(one.start, start), min(one.end, end))
        if 2 * (span.stop - span.start) < one.end - one.start or not set(one.segments) & set(segments.tolist()):
            return False
        return _is_explained(self._evidence.ordinary[span], left[span])

    def _name_exchange(
        self, pair: tuple[NDArray[np.intp], NDArray[np.intp]], start: int, end: int, *, idle: float = 1.0 / 3.0
    ) -> str:
        # idle: of the range of the other limb
        theirs = self._evidence.deviations.reference[start:end]
        left, right = (float(measure_ranges(theirs[:, limb]).max()) for limb in pair)
        if left < idle * right:
            return "left_for_right"
        return "right_for_left" if right < idle * left else "exchanged"

    def name_side(self, one: Finding) -> Finding:
        """A wrong limb that does what that of the other side should is said to."""
        if one.kind != "partial" or one.cause or 0 in one.segments or len(one.segments) > 2:
            return one
        span = slice(one.start, one.end)
        left = self.measure(_find_limbs(one))
        copied = _is_explained(self._evidence.ordinary[span], left[span])
        return replace(one, cause="copied") if copied else one


def _join_exchanged(findings: list[Finding]) -> list[Finding]:
    """Arms and legs exchanged at the same time are the whole body."""
    arms, legs = ([one for one in findings if one.segments == (*left, *right) and one.cause] for left, right in _PAIRS)
    for arm, leg in product(arms, legs):
        shared = min(arm.end, leg.end) - max(arm.start, leg.start)
        if 2 * shared > max(arm.end - arm.start, leg.end - leg.start):
            worse = max(arm, leg, key=lambda one: one.severity)
            start, end = min(arm.start, leg.start), max(arm.end, leg.end)
            both = replace(worse, kind="global", start=start, end=end, segments=tuple(range(9)), cause="exchanged")
            findings = [*(one for one in findings if one is not arm and one is not leg), both]
    return findings
