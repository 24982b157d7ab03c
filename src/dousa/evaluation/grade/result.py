"""Results of an assessment: events in seconds, figures, gaps and warnings, and their JSON."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np

from dousa.arrays import FloatArray, IndexArray
from dousa.evaluation.alignment.lines import Lapse, align
from dousa.evaluation.errors.evidence import measure_ranges
from dousa.evaluation.errors.faults import Fault
from dousa.evaluation.errors.findings import Finding
from dousa.evaluation.figures.curves import Curves
from dousa.evaluation.figures.eigenspace import Eigenspace
from dousa.evaluation.figures.furi import Furi
from dousa.evaluation.grade.references import Comparison, ReferenceTakes
from dousa.evaluation.posture.posture import LIMBS, SEGMENTS, PostureSequence, Working, mirror_postures, thin_postures
from dousa.evaluation.posture.yaw import Offset, rotate_yaw
from dousa.evaluation.words import date, describe_event, describe_heading, format_time, group_segments
from dousa.files.json_values import round_number, to_json_value
from dousa.messages import Message
from dousa.motion.runs import find_runs
from dousa.notebooks import Tabular, short_repr

# Digits after the point: a millisecond, a tenth of a degree; finer than anything that was measured.
_SECONDS, _DEGREES, _SHARES = 3, 1, 4


# What is written of a furi, an error and a lapse.
_FURI = "start_s end_s n_dims contribution label reference_start_s reference_end_s score"
_EVENT = (
    "kind start_s end_s segments lag_ms shortfall_deg shortfall_percent severity says deviation_deg facing_deg "
    "worst_s reference_s furi cause fault"
)
_LAPSE = "kind start_s end_s reference_start_s reference_end_s says"


@dataclass(frozen=True, slots=True)
class ErrorEvent:
    """One error of the performance.

    Parameters
    ----------
    kind : ``"global"``, ``"partial"``, ``"incomplete"`` or ``"shift"``.
    start_s, end_s : in the performance's own seconds.
    segments : names of the segments that are wrong; all nine for an error of the whole body.
    lag_ms : how late (positive) or early (negative), of a shift.
    shortfall_deg, shortfall_percent : how much of the range of motion is missing, of an incomplete motion; negative
        for a limb (a partial error) that goes further than the reference.
    severity : size in multiples of what is tolerated, 1 or above.
    worst_s : moment of the largest deviation, performance seconds.
    reference_s : moment of the reference that belongs to it.
    furi : number of the furi, from 0; None outside all.
    deviation_deg : largest lasting angle of a wrong segment from the reference's at the same time.
    facing_deg : median heading against the reference's while it lasts; positive is turned to the own left.
    cause : what is known besides, of `dousa.evaluation.words.CAUSES`; None for nothing.
    fault : the joint, its degrees and the phase, of a single movement, such as an exercise, that is not done well.
    """

    kind: str
    start_s: float
    end_s: float
    segments: tuple[str, ...]
    lag_ms: float | None
    shortfall_deg: float | None
    shortfall_percent: float | None
    severity: float
    worst_s: float
    reference_s: float
    furi: int | None
    deviation_deg: float | None = None
    facing_deg: float | None = None
    cause: str | None = None
    fault: Fault | None = None

    @property
    def message(self) -> Message:
        """What is wrong: ``"whole body: 180 ms late"``."""
        if self.fault is not None:
            return self.fault.message
        return describe_event(
            self.kind,
            self.segments,
            lag_ms=self.lag_ms,
            shortfall_deg=self.shortfall_deg,
            shortfall_percent=self.shortfall_percent,
            deviation_deg=self.deviation_deg,
            cause=self.cause,
        )

    @property
    def says_in_furi(self) -> Message:
        """What is wrong, and in which furi."""
        if self.furi is None:
            return self.message
        return Message("error_event.in_furi", what=self.message, number=self.furi + 1)

    @property
    def says(self) -> Message:
        """When, what is wrong, and in which furi: ``"0:31.0, whole body: 180 ms late (furi 3)"``."""
        return date(self.says_in_furi, self.start_s)


@dataclass(frozen=True, slots=True, eq=False)
class FuriAssessment:
    """One furi (figure) of the dance and how it went.

    Parameters
    ----------
    start_s, end_s : in the performance's seconds; nan if the performance does not reach it.
    reference_start_s, reference_end_s : in the reference's seconds.
    label : equal furi have the same label and share one eigenspace.
    eigenspace : of the reference.
    gain : (9,) range of each segment as a share of the reference's; nan where the reference hardly moves.
    lag_s : median lag, s; nan if not reached.
    score : 0 to 100.
    """

    start_s: float
    end_s: float
    reference_start_s: float
    reference_end_s: float
    label: str
    eigenspace: Eigenspace
    gain: FloatArray
    lag_s: float
    score: float

    @property
    def n_dims(self) -> int:
        """Dimensions of the eigenspace."""
        return self.eigenspace.n_dims

    @property
    def contribution(self) -> float:
        """Share of the variance that they hold."""
        return self.eigenspace.contribution


@short_repr
@dataclass(frozen=True, slots=True, eq=False)
class Assessment(Tabular):
    """How a performance differs from its reference: curves over the performance's frames, and events.

    All arrays have one row a frame of the performance; nan where there is nothing to compare (outside the
    reference, gaps).

    Parameters
    ----------
    frame_rate : Hz, of the performance; the reference is resampled to it.
    reference, performance : postures at that rate. The performance is mirrored already, if it was asked for.
    same_time : (T,) s, reference time that belongs to each frame if the tempo is kept (straight line).
    matched_time : (T,) s, reference time that each frame resembles (curve).
    lag : (T,) s, how late the performance is against the straight line; positive is late.
    facing : (T,) rad, heading of the performance against the reference's, its median taken off.
    d_space : (T,) d#, distance from the furi's eigenspace (eq. 10, 11).
    d_within : (T,) d*, distance inside it at the same time (eq. 12-14).
    d_path : (T,) distance to the reference trajectory, any time of the furi: wrong, though in the space.
    d_space_limit, d_within_limit : (T,) what the takes, or a steady performer, keep below. Drawn for orientation:
        the events come from deviations and lags.
    residual : (T, 9) rad, angle between each segment and the reference's at the same time.
    residual_limit : (9,) rad.
    path : (K, 2) frames of performance and reference that correspond, for the picture of the matrix.
    furi : figures in order of the reference.
    events : errors in order of time.
    lapses : in order of time, see `Lapse`.
    score : 0 to 100; nan if it is not the same dance.
    score_formula : how the score came about, with its numbers.
    calibrated : whether the grade rests on three takes of the reference or more.
    n_references : takes of the reference that were used; those left out are not counted.
    tempo : performance seconds per reference second.
    gaps : (start_s, end_s, segment name) of spans that were not seen and not judged.
    warnings : what a person should know before believing the grade.
    side : ``"mirrored"`` if the performance was mirrored first: left and right are the reference's, then.
    coverage : share of the reference's motion that was danced, 0 to 1.
    score_interval : (low, high); four of five takes of one quality are graded in it. nan where the score is.
    weights : (9,) what the segments count in the grade.
    offset_deg : (9,) what was taken off as another body, see `dousa.evaluation.posture.yaw`.
    not_judged : names of the segments that could not be compared: one of both bodies lacks them, or holds them in
        another position throughout.
    """

    _rows: ClassVar[str] = "events"
    _columns: ClassVar[str] = " ".join(name for name in _EVENT.split() if name not in ("segments", "fault"))

    frame_rate: float
    reference: PostureSequence
    performance: PostureSequence
    same_time: FloatArray
    matched_time: FloatArray
    lag: FloatArray
    facing: FloatArray
    d_space: FloatArray
    d_within: FloatArray
    d_path: FloatArray
    d_space_limit: FloatArray
    d_within_limit: FloatArray
    residual: FloatArray
    residual_limit: FloatArray
    path: IndexArray
    furi: tuple[FuriAssessment, ...]
    events: tuple[ErrorEvent, ...]
    lapses: tuple[Lapse, ...]
    score: float
    score_formula: Message
    calibrated: bool
    n_references: int
    tempo: float
    gaps: tuple[tuple[float, float, str], ...] = ()
    warnings: tuple[Message, ...] = ()
    side: str = "same"
    coverage: float = 1.0
    score_interval: tuple[float, float] = (math.nan, math.nan)
    weights: FloatArray = field(default_factory=lambda: np.ones(len(SEGMENTS)))
    offset_deg: FloatArray = field(default_factory=lambda: np.zeros(len(SEGMENTS)))
    not_judged: tuple[str, ...] = ()

    @property
    def is_other_dance(self) -> bool:
        """Whether it is hardly the same dance: there is no grade, and no praise either."""
        return any(warning.code == "assessment.unlike" for warning in self.warnings)

    @property
    def times(self) -> FloatArray:
        """(T,) s, of the frames of the performance."""
        return np.arange(self.performance.n_frames) / self.frame_rate

    def to_json(self, language: str | None = None) -> dict[str, Any]:
        """The answer of ``dousa evaluate --json``, see `describe_assessment`."""
        return describe_assessment(self, language)


def describe_assessment(assessment: Assessment, language: str | None = None) -> dict[str, Any]:
    """The answer of ``dousa evaluate --json``.

    Parameters
    ----------
    assessment : what `assess` returns.
    language : of the sentences, of `dousa.messages.LANGUAGES`; None for the one in use.

    Returns
    -------
    A dictionary for ``json.dumps``, without nan: what has no value (the times of a furi that the performance
    never reaches, the lag of an error that is no shift) is None. Times are seconds of the performance unless
    the key begins with ``reference``; lags are positive where the performance is late.
    """
    return {
        "score": round_number(assessment.score, 1),
        "calibrated": bool(assessment.calibrated),
        "furi": [_describe_furi(furi) for furi in assessment.furi],
        "events": [_describe(event, _EVENT, language) for event in assessment.events],
        "lag_ms": _summarise(
            1000 * assessment.lag, 1, median=np.median, mean_abs=lambda lag: np.abs(lag).mean(), max=np.max, min=np.min
        ),
        "frame_rate": round_number(assessment.frame_rate, 6),
        "n_references": int(assessment.n_references),
        "score_formula": assessment.score_formula.render(language),
        "side": assessment.side,
        "tempo": round_number(assessment.tempo, _SHARES),
        "facing_deg": _summarise(np.degrees(np.abs(assessment.facing)), _DEGREES, median=np.median, max=np.max),
        "lapses": [_describe(lapse, _LAPSE, language) for lapse in assessment.lapses],
        "gaps": [
            {"start_s": round_number(start, _SECONDS), "end_s": round_number(end, _SECONDS), "segment": segment}
            for start, end, segment in assessment.gaps
        ],
        "coverage": round_number(assessment.coverage, 3),
        "not_judged": list(assessment.not_judged),
        "score_interval": [round_number(value, 1) for value in assessment.score_interval],
        "segment_weights": _by_segment(assessment.weights, 2),
        "posture_offsets": _by_segment(assessment.offset_deg, _DEGREES),
        "warnings": [message.render(language) for message in assessment.warnings],
        "warning_codes": [message.code for message in assessment.warnings],
    }


# Decimals of numbers in JSON, by definition.
_DIGITS = {
    "contribution": _SHARES,
    "severity": 2,
    **dict.fromkeys(("shortfall_deg", "deviation_deg", "facing_deg"), _DEGREES),
    **dict.fromkeys(("score", "lag_ms", "shortfall_percent"), 1),
}


def _describe(what: object, names: str, language: str | None = None) -> dict[str, Any]:
    return {name: _write(name, getattr(what, name), language) for name in names.split()}


def _write(name: str, value: Any, language: str | None) -> Any:
    if isinstance(value, Message):
        return value.render(language)
    if isinstance(value, Fault):
        return value.to_json(language)
    digits = _SECONDS if name.endswith("_s") else _DIGITS.get(name)
    return to_json_value(value) if digits is None else round_number(value, digits)


def _by_segment(values: FloatArray, digits: int) -> dict[str, float | None]:
    return {name: round_number(value, digits) for name, value in zip(SEGMENTS, values, strict=True)}


def _describe_furi(furi: FuriAssessment) -> dict[str, Any]:
    gain = _by_segment(furi.gain, 3)
    return {**_describe(furi, _FURI), "lag_ms": round_number(1000 * furi.lag_s, 1), "gain": gain}


def _summarise(
    values: FloatArray, digits: int, **measures: Callable[[FloatArray], float | FloatArray]
) -> dict[str, float | None]:
    """Some measures of what is known of the values; None where nothing is."""
    known = values[np.isfinite(values)]
    return {name: round_number(float(take(known)), digits) if len(known) else None for name, take in measures.items()}


_TEMPO_OFF, _TEMPO_BETTER = 0.04, 0.8
_TURNED, _TURNED_S = np.radians(40.0), 1.0


def describe_findings(
    findings: Sequence[Finding],
    lapses: Sequence[Lapse],
    *,
    working: Working,
    same_time: FloatArray,
    residual: FloatArray,
    facing: FloatArray,
    furi_index: IndexArray,
    join_s: float = 0.35,
) -> tuple[ErrorEvent, ...]:
    """Describe findings as events, without those that a lapse explains.

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
    for finding in _join(findings, join_s * rate):
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
        sure = finding.lag_s is not None and finding.cause is None
        lag_ms = 1000.0 * finding.lag_s if sure and finding.lag_s is not None else None
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
                cause=finding.cause,
            )
        )
    return tuple(events)


def name_joints(assessment: Assessment, faults: Sequence[Fault]) -> Assessment:
    """Name the joint of each error of a single movement, and the gravest fault of a limb of which nothing is said.

    Parameters
    ----------
    assessment : of the movement.
    faults : of `find_faults`, the gravest first, in its time; those that are clear count.
    """
    clear = [fault for fault in faults if fault.is_clear]
    named = [
        replace(event, fault=next((one for one in clear if _is_about(event, one)), None)) for event in assessment.events
    ]
    if clear and not any(_is_about(event, clear[0]) for event in named):
        named.append(_describe_fault(clear[0], assessment.same_time, assessment.frame_rate))
    return replace(assessment, events=tuple(sorted(named, key=lambda event: (event.start_s, event.end_s))))


def _is_about(event: ErrorEvent, fault: Fault) -> bool:
    limb = next(limb for limb in LIMBS.values() if SEGMENTS.index(fault.segment) in limb)
    at_once = fault.start_s < event.end_s and event.start_s < fault.end_s
    return event.kind != "shift" and at_once and any(SEGMENTS[index] in event.segments for index in limb)


def _describe_fault(fault: Fault, same_time: FloatArray, rate: float) -> ErrorEvent:
    """The event that a fault is by itself."""
    away = abs(fault.expected - fault.degrees)
    return ErrorEvent(
        kind="incomplete" if fault.kind == "short" else "partial",
        start_s=fault.start_s,
        end_s=fault.end_s,
        segments=(fault.segment,),
        lag_ms=None,
        shortfall_deg=away if fault.kind == "short" else -away,
        shortfall_percent=None,
        severity=max(fault.severity, 1.0),
        worst_s=fault.time_s,
        reference_s=float(same_time[min(round(fault.time_s * rate), len(same_time) - 1)]),
        furi=0,
        deviation_deg=away,
        cause="compensation" if fault.kind == "compensation" else None,
        fault=fault,
    )


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
        joined[-1] = replace(worse, start=last.start, end=max(last.end, finding.end))
    return joined


def _belongs(last: Finding, finding: Finding, gap: float) -> bool:
    same = (last.kind, last.segments, last.cause) == (finding.kind, finding.segments, finding.cause)
    if same and last.lag_s is not None and finding.lag_s is not None:
        same = last.lag_s * finding.lag_s > 0
    return same and finding.start - last.end <= gap


def _overlap(start: float, end: float, lapse: Lapse) -> float:
    return min(end, lapse.end_s) - max(start, lapse.start_s)


def describe_gaps(performance: PostureSequence) -> tuple[tuple[float, float, str], ...]:
    """List the spans that were not seen, by segment; segments that were never seen have no gaps."""
    gaps = [
        (start / performance.frame_rate, end / performance.frame_rate, name)
        for index, name in enumerate(SEGMENTS)
        if performance.seen[:, index].any()
        for start, end in find_runs(~performance.seen[:, index]).tolist()
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
    *,
    unlike: bool,
    mirror_better: float = 0.6,
    most_unlike: float = 0.3,
) -> tuple[Message, ...]:
    """Describe the reservations about the grade."""
    # most_unlike: mismatch along the lines
    first, mismatch = references.working[0], comparison.alignment.mismatch
    found = [Message("assessment.sides")] if side == "mirrored" else []
    found += [Message("assessment.left_out", number=number) for number in references.left_out]
    if unlike:
        found.append(Message("assessment.unlike", mismatch=mismatch))
    if mismatch > most_unlike:
        mirrored = align(first, thin_postures(mirror_postures(performance)), tempo, weights)
        if mirrored.mismatch < mirror_better * mismatch:
            found.append(Message("assessment.unmirrored" if side == "mirrored" else "assessment.mirrored"))
    if tempo == "same" and mismatch > 0.5 * most_unlike:
        free = align(first, working, "free", weights)
        if abs(free.tempo - 1.0) > _TEMPO_OFF and free.mismatch < _TEMPO_BETTER * mismatch:
            found.append(Message("assessment.tempo", tempo=free.tempo))
    if _stands_still(references.postures):
        found.append(Message("assessment.still_reference"))
    if _stands_still(performance):
        found.append(Message("assessment.still_performance"))
    found += _describe_coverage(references, furi, performance, comparison, graded=not unlike)
    if not unlike:
        found += _describe_turns(curves, performance.frame_rate)
    return tuple(found)


def _describe_coverage(
    references: ReferenceTakes,
    furi: Sequence[Furi],
    performance: PostureSequence,
    comparison: Comparison,
    *,
    graded: bool,
    mostly: float = 0.5,
) -> list[Message]:
    """What of both motions is not compared."""
    # mostly: share of the performance with a place in the reference: below, the grade is about a part
    found: list[Message] = []
    compared = float(comparison.deviations.judged.any(axis=1).mean())
    if graded and compared < mostly:
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
        for start, end in find_runs(np.nan_to_num(np.abs(curves.facing)) > _TURNED).tolist()
        if end - start >= _TURNED_S * rate
    ]


def _stands_still(postures: PostureSequence, *, still: float = np.radians(12.0)) -> bool:
    """Whether what is seen hardly moves; what was never seen is drawn as standing."""
    # still: rad, range of the segment that moves most
    return bool(postures.seen.any() and measure_ranges(postures.segments).max() < still)


_SIDES = {"left_arm": "right_arm", "left_leg": "right_leg"}


def describe_offset(offset: Offset, reference: Working, *, least_deg: float = 5.0) -> tuple[Message, ...]:
    """Describe the offset of another body: "both arms are 8 deg further from the body throughout".

    Parameters
    ----------
    offset : of the performer.
    reference : the first take.
    """
    body = rotate_yaw(reference.segments, -np.nan_to_num(reference.heading)).mean(axis=0)
    # From the frame of `Offset`, in which z is the way to the left and x to the back.
    moved = np.degrees(np.cross(offset.taken, body))[:, [2, 1, 0]] * (1.0, 1.0, -1.0)
    found = {}
    for limb, segments in LIMBS.items():
        way, degrees = _find_way(limb, moved[list(segments)].mean(axis=0))
        if degrees > least_deg:
            found[limb] = (way, degrees)
    said = []
    for limb, (way, degrees) in found.items():
        other = _SIDES.get(limb, "")
        pair = found.get(other, ("", 0.0))
        if limb in _SIDES.values():
            first = next(one for one, second in _SIDES.items() if second == limb)
            if _belong(found.get(first, ("", 0.0)), (way, degrees)):
                continue
        together = _belong((way, degrees), pair)
        segments = (*LIMBS[limb], *LIMBS[other]) if together else LIMBS[limb]
        who = group_segments(SEGMENTS[index] for index in segments)
        size = 0.5 * (degrees + pair[1]) if together else degrees
        said.append(Message("assessment.offset", who=who, degrees=size, way=Message(f"offset_ways.{way}")))
    if offset.missing.any():
        who = group_segments(SEGMENTS[index] for index in np.flatnonzero(offset.missing))
        said.append(Message("assessment.not_judged", who=who))
    return tuple(said)


def _find_way(limb: str, moved: FloatArray) -> tuple[str, float]:
    """The direction in which a limb is mostly moved, and how far, from (3,) deg to the left, up and front."""
    axis = int(np.abs(moved).argmax())
    forward = bool(moved[axis] > 0.0)
    if axis == 1:
        way = "up" if forward else "down"
    elif axis == 2:
        way = "forward" if forward else "back"
    elif limb == "trunk":
        way = "left" if forward else "right"
    else:
        way = "out" if forward == limb.startswith("left") else "in"
    return way, float(abs(moved[axis]))


def _belong(one: tuple[str, float], other: tuple[str, float], *, alike_deg: float = 6.0) -> bool:
    # alike_deg: left and right that differ by less are said as one
    return one[0] == other[0] != "" and abs(one[1] - other[1]) < alike_deg
