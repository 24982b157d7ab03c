"""From findings in frames to events in seconds; gaps and warnings."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dousa.arrays import FloatArray, IndexArray
from dousa.evaluation.alignment.lines import align
from dousa.evaluation.errors.evidence import runs_of
from dousa.evaluation.errors.explain import Finding
from dousa.evaluation.errors.extent import measure_ranges
from dousa.evaluation.errors.lapses import Lapse
from dousa.evaluation.figures.curves import Curves
from dousa.evaluation.figures.furi import Furi
from dousa.evaluation.grade.references import Comparison, ReferenceTakes
from dousa.evaluation.grade.result import ErrorEvent
from dousa.evaluation.grade.score import is_unlike, share_weights
from dousa.evaluation.posture.posture import (
    SEGMENTS,
    PostureSequence,
    Working,
    mirror_postures,
    thin_postures,
)
from dousa.evaluation.words import describe_heading, format_time
from dousa.messages import Message

_JOIN_S = 0.35
_MOSTLY = 0.5  # share of the performance with a place in the reference: below, the grade is about a part
_ALIKE = 0.3  # mismatch along the lines
_MIRROR_BETTER = 0.6
_TEMPO_OFF, _TEMPO_BETTER = 0.04, 0.8
_TURNED, _TURNED_S = np.radians(40.0), 1.0
_STILL = np.radians(12.0)  # range of the segment that moves most


def describe_findings(
    findings: Sequence[Finding],
    lapses: Sequence[Lapse],
    *,
    working: Working,
    same_time: FloatArray,
    residual: FloatArray,
    facing: FloatArray,
    furi_index: IndexArray,
) -> tuple[ErrorEvent, ...]:
    """Events of findings, those that a lapse explains left out.

    Parameters
    ----------
    findings : in working frames.
    lapses : in seconds.
    working : the performance at the working rate.
    same_time : (T,) s, at the full rate.
    residual, facing, furi_index : (T, 9), (T,) rad and (T,) at the full rate, see `Curves`.
    """
    rate, stride = working.frame_rate, working.stride
    events = []
    for finding in _join(findings, _JOIN_S * rate):
        start, end = finding.start / rate, finding.end / rate
        if any(_overlap(start, end, lapse) > 0.5 * (end - start) for lapse in lapses):
            continue
        frame = min(finding.worst * stride + stride // 2, len(same_time) - 1)
        number = int(furi_index[frame])
        furi = number if number >= 0 else None
        segments = tuple(SEGMENTS[index] for index in finding.segments)
        span = slice(finding.start * stride, max(finding.end, finding.start + 1) * stride)
        off = _lasting(np.degrees(residual[span][:, list(finding.segments)]))
        turned = np.degrees(facing[span])
        lag_ms = None if finding.lag_s is None else 1000.0 * finding.lag_s
        short = None if finding.shortfall is None else float(np.degrees(finding.shortfall))
        percent = None if finding.shortfall_share is None else 100.0 * finding.shortfall_share
        events.append(
            ErrorEvent(
                kind=finding.kind,
                start_s=start,
                end_s=end,
                segments=segments,
                lag_ms=lag_ms,
                shortfall_deg=short,
                shortfall_percent=percent,
                severity=max(finding.severity, 1.0),
                worst_s=frame / (rate * stride),
                reference_s=float(same_time[frame]),
                furi=furi,
                deviation_deg=off,
                facing_deg=float(np.nanmedian(turned)) if np.isfinite(turned).any() else None,
            )
        )
    return tuple(events)


def _lasting(angles: FloatArray) -> float | None:
    """Largest lasting number of (n, S): nine tenths of the moments are below it; None if there is none."""
    seen = np.isfinite(angles)
    if not seen.any():
        return None
    return float(np.percentile(np.where(seen, angles, 0.0).max(axis=1), 90))


def _join(findings: Sequence[Finding], gap: float) -> list[Finding]:
    """Findings of one kind, of the same segments, one right after the other, are one."""
    joined: list[Finding] = []
    for finding in findings:
        last = joined[-1] if joined else None
        if last is None or not _belongs(last, finding, gap):
            joined.append(finding)
            continue
        worse = max(last, finding, key=lambda one: one.severity)
        joined[-1] = Finding(
            last.kind,
            last.start,
            max(last.end, finding.end),
            last.segments,
            worse.severity,
            worse.worst,
            worse.lag_s,
            worse.shortfall,
            worse.shortfall_share,
        )
    return joined


def _belongs(last: Finding, finding: Finding, gap: float) -> bool:
    alike = last.kind == finding.kind and last.segments == finding.segments
    if alike and last.lag_s is not None and finding.lag_s is not None:
        alike = last.lag_s * finding.lag_s > 0
    return alike and finding.start - last.end <= gap


def _overlap(start: float, end: float, lapse: Lapse) -> float:
    return min(end, lapse.end_s) - max(start, lapse.start_s)


def describe_gaps(performance: PostureSequence) -> tuple[tuple[float, float, str], ...]:
    """Spans of the performance that were not seen, by segment; those that never were seen have no gaps."""
    gaps = [
        (start / performance.frame_rate, end / performance.frame_rate, name)
        for index, name in enumerate(SEGMENTS)
        if performance.seen[:, index].any()
        for start, end in runs_of(~performance.seen[:, index])
    ]
    return tuple(sorted(gaps))


def describe_warnings(
    references: ReferenceTakes,
    furi: Sequence[Furi],
    performance: PostureSequence,
    working: Working,
    comparison: Comparison,
    curves: Curves,
    tempo: str,
    weights: FloatArray,
    side: str,
) -> tuple[Message, ...]:
    """What a person should know before believing the grade."""
    first, mismatch = references.working[0], comparison.alignment.mismatch
    found = [Message("assessment.sides")] if side == "mirrored" else []
    found += [Message("assessment.left_out", number=number) for number in references.left_out]
    unlike = is_unlike(comparison, share_weights(references, weights))
    if unlike:
        found.append(Message("assessment.unlike", mismatch=mismatch))
    if mismatch > _ALIKE:
        mirrored = align(first, thin_postures(mirror_postures(performance)), tempo, weights)
        if mirrored.mismatch < _MIRROR_BETTER * mismatch:
            found.append(Message("assessment.unmirrored" if side == "mirrored" else "assessment.mirrored"))
    if tempo == "same" and mismatch > 0.5 * _ALIKE:
        free = align(first, working, "free", weights)
        if abs(free.tempo - 1.0) > _TEMPO_OFF and free.mismatch < _TEMPO_BETTER * mismatch:
            found.append(Message("assessment.tempo", tempo=free.tempo))
    if _stands_still(references.postures):
        found.append(Message("assessment.still_reference"))
    if _stands_still(performance):
        found.append(Message("assessment.still_performance"))
    found += _describe_coverage(references, furi, performance, comparison)
    if not unlike:
        found += _describe_turns(curves, performance.frame_rate)
    return tuple(found)


def _describe_coverage(
    references: ReferenceTakes,
    furi: Sequence[Furi],
    performance: PostureSequence,
    comparison: Comparison,
) -> list[Message]:
    """What of both motions is not compared."""
    found: list[Message] = []
    compared = float(comparison.deviations.judged.any(axis=1).mean())
    if compared < _MOSTLY:
        found.append(Message("assessment.compared", percent=100.0 * compared))
    for code, postures in (("assessment.gaps", performance), ("assessment.reference_gaps", references.postures)):
        seen = postures.seen[:, postures.seen.any(axis=0)]
        if not seen.all():
            found.append(Message(code, percent=100.0 * float(np.mean(~seen))))
    covered = np.zeros(references.postures.n_frames, np.bool_)
    for one in furi:
        covered[one.start : one.end] = True
    if not covered.all():
        seconds = int((~covered).sum()) / performance.frame_rate
        found.append(Message("assessment.uncovered", seconds=seconds))
    return found


def _describe_turns(curves: Curves, rate: float) -> list[Message]:
    """Where the performer faces another way for a while."""
    return [
        Message(
            "assessment.turned",
            time=format_time(start / rate),
            facing=describe_heading(float(np.median(curves.facing[start:end]))),
        )
        for start, end in runs_of(np.nan_to_num(np.abs(curves.facing)) > _TURNED)
        if end - start >= _TURNED_S * rate
    ]


def _stands_still(postures: PostureSequence) -> bool:
    """Whether what is seen hardly moves; what was never seen is drawn as standing."""
    return bool(postures.seen.any() and measure_ranges(postures.segments).max() < _STILL)
