"""From findings in frames to events in seconds and words; gaps and warnings."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dousa.evaluation._alignment import align
from dousa.evaluation._curves import Curves
from dousa.evaluation._evidence import runs_of
from dousa.evaluation._explain import Finding
from dousa.evaluation._references import MOST_DEVIATION, MOST_MISMATCH, Comparison, ReferenceTakes
from dousa.evaluation._types import ErrorEvent, Lapse, PostureSequence
from dousa.evaluation._warning_words import describe_warning
from dousa.evaluation._working import Working, thin_postures
from dousa.evaluation.furi import Furi
from dousa.evaluation.posture import SEGMENTS, mirror_postures
from dousa.evaluation.scoring import compute_deviation
from dousa.evaluation.words import describe_event, describe_facing, format_time
from dousa.motion._types import FloatArray

__all__ = ["describe_findings", "describe_gaps", "describe_warnings"]

_JOIN_S = 0.35
_MOSTLY = (
    0.5  # share of the performance that has a place in the reference, below which the grade is about a part
)
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
    curves: Curves,
    language: str,
) -> tuple[ErrorEvent, ...]:
    """Events of findings, those that a lapse explains left out.

    Parameters
    ----------
    findings : in working frames.
    lapses : in seconds.
    working : the performance at the working rate.
    same_time : (T,) s, at the full rate.
    curves : at the full rate.
    language : of the sentences.
    """
    rate, stride = working.frame_rate, working.stride
    events = []
    for finding in _join(findings, _JOIN_S * rate):
        start, end = finding.start / rate, finding.end / rate
        if any(_overlap(start, end, lapse) > 0.5 * (end - start) for lapse in lapses):
            continue
        frame = min(finding.worst * stride + stride // 2, len(same_time) - 1)
        number = int(curves.furi_index[frame])
        furi = number if number >= 0 else None
        segments = tuple(SEGMENTS[index] for index in finding.segments)
        span = slice(finding.start * stride, max(finding.end, finding.start + 1) * stride)
        off = _lasting(np.degrees(curves.residual[span][:, list(finding.segments)]))
        facing = np.degrees(curves.facing[span])
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
                facing_deg=float(np.nanmedian(facing)) if np.isfinite(facing).any() else None,
                says=describe_event(
                    finding.kind,
                    start,
                    segments,
                    lag_ms=lag_ms,
                    shortfall_deg=short,
                    shortfall_percent=percent,
                    deviation_deg=off,
                    language=language,
                    furi=furi,
                ),
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
    """Spans of the performance that were not seen, by segment."""
    gaps = [
        (start / performance.frame_rate, end / performance.frame_rate, name)
        for index, name in enumerate(SEGMENTS)
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
    language: str,
) -> tuple[str, ...]:
    """What a person should know before believing the grade."""
    first, mismatch = references.working[0], comparison.alignment.mismatch
    keys: list[tuple[str, float]] = [("left out", float(number)) for number in references.left_out]
    deviation = compute_deviation(comparison.from_first, weights)
    unlike = mismatch > MOST_MISMATCH or deviation > MOST_DEVIATION
    if unlike:
        keys.append(("unlike", mismatch))
    if mismatch > _ALIKE:
        mirrored = align(first, thin_postures(mirror_postures(performance)), tempo, weights)
        if mirrored.mismatch < _MIRROR_BETTER * mismatch:
            keys.append(("unmirrored" if side == "mirrored" else "mirrored", 0.0))
    if tempo == "same" and mismatch > 0.5 * _ALIKE:
        free = align(first, working, "free", weights)
        if abs(free.tempo - 1.0) > _TEMPO_OFF and free.mismatch < _TEMPO_BETTER * mismatch:
            keys.append(("tempo", free.tempo))
    for postures, key in ((references.postures, "still reference"), (performance, "still performance")):
        # What was never seen is drawn as standing.
        if postures.seen.any() and _moves(postures) < _STILL:
            keys.append((key, 0.0))
    compared = float(np.isfinite(comparison.from_first).any(axis=1).mean())
    if compared < _MOSTLY:
        keys.append(("compared", 100.0 * compared))
    if not performance.seen.all():
        keys.append(("gaps", 100.0 * float(np.mean(~performance.seen))))
    if not references.postures.seen.all():
        keys.append(("reference gaps", 100.0 * float(np.mean(~references.postures.seen))))
    covered = np.zeros(references.postures.n_frames, np.bool_)
    for one in furi:
        covered[one.start : one.end] = True
    uncovered = int((~covered).sum())
    if uncovered > 0:
        keys.append(("uncovered", uncovered / performance.frame_rate))
    turned = [
        f"{format_time(start / performance.frame_rate)}: {describe_facing(angle, language)}"
        for start, end in runs_of(np.nan_to_num(np.abs(curves.facing)) > _TURNED)
        if not unlike and end - start >= _TURNED_S * performance.frame_rate
        for angle in (float(np.median(curves.facing[start:end])),)
    ]
    return (*(describe_warning(key, value, language) for key, value in keys), *turned)


def _moves(postures: PostureSequence) -> float:
    """Range in rad of the segment that moves most, of a few poses."""
    from dousa.evaluation._size import measure_ranges

    return float(measure_ranges(postures.segments).max())
