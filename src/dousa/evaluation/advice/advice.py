"""One to three sentences for a learner, or one for every error: limb, direction, amount, moment and figure."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dousa.arrays import FloatArray
from dousa.errors import OptionError
from dousa.evaluation.advice.directions import Correction, PairedDancers, PosePairs, find_corrections
from dousa.evaluation.alignment.correspondence import compute_correlation_matrix
from dousa.evaluation.alignment.lines import Lapse
from dousa.evaluation.figures.furi import Furi
from dousa.evaluation.grade.result import Assessment, ErrorEvent, FuriAssessment
from dousa.evaluation.posture.posture import SEGMENTS, PostureSequence
from dousa.evaluation.words import format_moment, name_parts, say_side, say_size, say_timing, say_where
from dousa.files.json_values import round_number
from dousa.messages import Message
from dousa.motion.runs import find_runs


def find_other_figure(
    reference: PostureSequence,
    performance: FloatArray,
    frame_rate: float,
    expected_s: float,
    furi: Sequence[FuriAssessment],
    *,
    rate: float = 10.0,
    around_s: float = 1.0,
    shortest_s: float = 0.6,
    fade_s: float = 0.4,
    better: float = 0.4,
    most_unlike: float = 1.0 - float(np.cos(np.radians(25.0))),
) -> int | None:
    """Find the number of the figure, from 0, that a stretch resembles instead of the expected one.

    The performance is (N, 9, 3) unit vectors of the stretch, expected_s the time in the whole reference of its first
    frame. The search runs at rate Hz and leaves out around_s around the expected place; a stretch shorter than
    shortest_s is not searched for. At both ends one figure becomes the other for fade_s. The other figure must differ
    by less than better times the difference from the expected one. Returns None if nothing elsewhere is similar, or
    only the same figure again.
    """
    # most_unlike: 1 - cosine, mean over segments and moments: 25 degrees
    if len(performance) < shortest_s * frame_rate or not np.isfinite(expected_s):
        return None
    fade = int(min(fade_s, 0.2 * len(performance) / frame_rate) * frame_rate)
    performance, expected_s = performance[fade : len(performance) - fade], expected_s + fade / frame_rate
    count = max(round(len(performance) / frame_rate * rate), 2)
    places = np.linspace(0, len(performance) - 1, count).round().astype(np.intp)
    step = places[-1] / frame_rate / (count - 1)  # s
    total = int(reference.n_frames / reference.frame_rate / step)
    if total <= count:
        return None
    frames = np.rint(np.arange(total) * step * reference.frame_rate).astype(np.intp)
    theirs = reference.segments[np.minimum(frames, reference.n_frames - 1)]
    unlike = 1.0 - np.asarray(compute_correlation_matrix(performance[places], theirs), np.float64)
    starts = np.arange(total - count + 1)
    rows = np.arange(count)
    mean = np.array([unlike[rows, start + rows].mean() for start in starts])
    here = int(np.clip(round(expected_s / step), 0, len(mean) - 1))
    away = np.abs(starts * step - expected_s) > around_s
    if not away.any():
        return None
    best = int(starts[away][mean[away].argmin()])
    if mean[best] > most_unlike or mean[best] > better * mean[here]:
        return None
    spans = [
        (min(one.reference_end_s, start + count * step) - max(one.reference_start_s, start)) / (count * step)
        for start in (expected_s, best * step)
        for one in furi
    ]
    return _choose_figure(furi, spans[: len(furi)], spans[len(furi) :])


def _choose_figure(
    furi: Sequence[FuriAssessment], expected: Sequence[float], found: Sequence[float], *, much: float = 0.4
) -> int | None:
    """The figure that takes the largest share of what was found, unless it is one that was expected."""
    # much: of the stretch
    known = {one.label for one, share in zip(furi, expected, strict=True) if share > much}
    others = [k for k, one in enumerate(furi) if one.label not in known and found[k] > much]
    return max(others, key=lambda k: found[k], default=None)


DETAILS = ("brief", "full")
"""How much advice: one to three sentences, or one for every error."""

_MOST_SEVERITY, _MOST_S, _LAPSE_SEVERITY = 10.0, 4.0, 5.0
_TURNED, _TURNED_S = math.radians(40.0), 1.0
_UNSAID_LAPSES = ("lead-in", "lead-out")


@dataclass(frozen=True, slots=True)
class Advice:
    """One thing to tell a learner.

    Parameters
    ----------
    message : the sentence.
    about : kind of the error or lapse; ``"facing"``, ``"praise"`` or ``"dance"`` (all of it) for what is neither.
    event : place in ``assessment.events``; None for what is no event.
    lapse : place in ``assessment.lapses``; None for what is no lapse.
    times : s of the performance, all moments that it is about; the first one is the one of the picture.
    reference_s : s of the reference at that moment; nan where it has none.
    segments : what should be moved; empty for the whole body.
    direction : of the largest correction, see `Correction`; ``"late"`` or ``"early"``; None where no direction can be
        said.
    amount_deg : of that correction.
    lag_ms : how late (positive) or early (negative).
    furi : figures, from 0, of all moments.
    corrections : all that the sentence names.
    importance : severity x duration x share of the body.
    """

    message: Message
    about: str
    event: int | None = None
    lapse: int | None = None
    times: tuple[float, ...] = ()
    reference_s: float = math.nan
    segments: tuple[str, ...] = ()
    direction: str | None = None
    amount_deg: float | None = None
    lag_ms: float | None = None
    furi: tuple[int | None, ...] = ()
    corrections: tuple[Correction, ...] = ()
    importance: float = 0.0

    @property
    def time_s(self) -> float:
        """s of the performance, of the picture; nan for what has no moment."""
        return self.times[0] if self.times else math.nan


@dataclass(frozen=True, slots=True)
class _Found:
    """What is known of an event before it is said."""

    event: ErrorEvent
    number: int
    corrections: tuple[Correction, ...]
    moment_s: float
    reference_s: float
    other: int | None
    importance: float


def advise(assessment: Assessment, detail: str = "brief", *, most_brief: int = 3) -> tuple[Advice, ...]:
    """Choose the advice for the learner, the most important first.

    Parameters
    ----------
    assessment : of a performance.
    detail : ``"brief"``: the one to three most important things, a fault that returns said once; ``"full"``: one
        sentence for each error and lapse, the heading where it is far off, and what was good.

    Returns
    -------
    One at least: where nothing is wrong, that.

    Raises
    ------
    OptionError : another detail.
    """
    if detail not in DETAILS:
        raise OptionError("advice.detail", known=DETAILS, detail=detail)
    if assessment.is_other_dance:
        return (Advice(Message("advice.other_dance"), "dance"),)
    if assessment.score_formula.code in ("grade.hardly", "grade.unseen"):
        return (Advice(assessment.score_formula, "dance"),)
    tempo = _say_tempo(assessment)
    faulty = any(event.fault is not None for event in assessment.events)
    if tempo and detail == "brief" and not faulty:
        return tempo  # on another clock everything else is late, and then another figure; but for joints
    labels = [one.label for one in assessment.furi]
    dancers = PairedDancers(assessment.reference, assessment.performance, assessment.same_time)
    found = [
        _look_at(event, number, dancers.pair(event.start_s, event.end_s), _search_elsewhere(assessment))
        for number, event in enumerate(assessment.events)
    ]
    lapses = [
        _say_lapse(lapse, number, assessment.furi)
        for number, lapse in enumerate(assessment.lapses)
        if lapse.kind not in _UNSAID_LAPSES
    ]
    groups = _group_alike(found) if detail == "brief" else [[one] for one in found]
    said = sorted([*(_say(group, labels) for group in groups), *lapses], key=lambda one: -one.importance)
    if detail == "brief":
        return (*tempo, *said)[:most_brief] or (Advice(Message("advice.nothing"), "praise"),)
    good = praise(assessment)
    return (*tempo, *said, *_say_facing(assessment, labels), *((good,) if good else ()))


def advise_on_event(
    event: ErrorEvent,
    number: int,
    dancers: PairedDancers,
    furi: Sequence[Furi] | Sequence[FuriAssessment],
) -> Advice:
    """Give the advice on one error, as `advise` does in full, without the figure that a wrong one resembles.

    Parameters
    ----------
    event : in seconds of the performance.
    number : its place among the events.
    dancers : both, the span of the event at least.
    furi : figures of the reference.
    """
    found = _look_at(event, number, dancers.pair(event.start_s, event.end_s), lambda one: None)
    return _say([found], [one.label for one in furi])


def _search_elsewhere(assessment: Assessment) -> Callable[[ErrorEvent], int | None]:
    def search(event: ErrorEvent) -> int | None:
        rate = assessment.frame_rate
        first, last = max(round(event.start_s * rate), 0), round(event.end_s * rate)
        part = assessment.performance.segments[first:last]
        if not len(part):
            return None
        expected = float(assessment.same_time[min(first, len(assessment.same_time) - 1)])
        return find_other_figure(assessment.reference, part, rate, expected, assessment.furi)

    return search


def _look_at(
    event: ErrorEvent, number: int, pairs: PosePairs | None, search: Callable[[ErrorEvent], int | None]
) -> _Found:
    corrections: tuple[Correction, ...] = ()
    moment, reference = event.worst_s, event.reference_s
    if pairs is not None and event.kind in ("partial", "incomplete") and event.cause is None and event.fault is None:
        names = event.segments or SEGMENTS
        worst = pairs.find_worst([SEGMENTS.index(name) for name in names])
        corrections = find_corrections(worst, names)
        middle = len(worst.times) // 2
        if math.isfinite(worst.reference_times[middle]):
            moment, reference = float(worst.times[middle]), float(worst.reference_times[middle])
    other = search(event) if event.kind == "global" else None
    return _Found(event, number, corrections, moment, reference, other, _weigh(event))


def _weigh(event: ErrorEvent) -> float:
    severity = event.severity if math.isfinite(event.severity) else 1.0
    duration = event.end_s - event.start_s
    share = len(event.segments or SEGMENTS) / len(SEGMENTS)
    return min(severity, _MOST_SEVERITY) * _limit_duration(duration) * (0.5 + 0.5 * share)


def _limit_duration(seconds: float, *, least_s: float = 0.3) -> float:
    return min(max(seconds, least_s), _MOST_S) if math.isfinite(seconds) else least_s


def _group_alike(found: Sequence[_Found]) -> list[list[_Found]]:
    """Errors of which the same would be said, the most important of each first."""
    groups: dict[tuple[Any, ...], list[_Found]] = {}
    for one in sorted(found, key=lambda one: -one.importance):
        event = one.event
        key: tuple[Any, ...]
        if event.fault is not None:
            key = ("fault", event.fault.angle)
        elif event.cause is not None and event.kind != "shift":
            key = (event.cause, event.segments)
        elif one.corrections:
            key = ("correct", tuple((each.segments, each.direction) for each in one.corrections))
        elif event.kind == "shift":
            late = event.cause == "late" or (event.lag_ms is not None and event.lag_ms > 0)
            key = ("shift", event.segments, late)
        elif event.kind == "global":
            key = ("global", one.number)
        else:
            key = (event.kind, event.segments, (event.shortfall_deg or 0.0) < 0)
        groups.setdefault(key, []).append(one)
    return list(groups.values())


def _say(group: Sequence[_Found], labels: Sequence[str]) -> Advice:
    """One sentence on errors of which the same is said; the picture is that of the first."""
    first = group[0]
    event = first.event
    furi = tuple(one.event.furi for one in group)
    times = tuple(one.moment_s for one in group)
    where = say_where(times, furi, labels)
    about = Advice(
        message=where,
        about=event.kind,
        event=first.number,
        times=times,
        reference_s=first.reference_s,
        segments=event.segments if len(event.segments) < len(SEGMENTS) else (),
        furi=furi,
        importance=sum(one.importance for one in group),
    )
    if event.kind == "shift":
        return _add_timing(about, group, where)
    if first.corrections:
        return _add_corrections(about, group, where)
    if event.fault is not None:
        said = Message("advice.joint", where=where, fault=event.fault.message)
    elif event.cause == "compensation":
        said = Message("advice.still", who=name_parts(event.segments), where=where)
    elif event.cause is not None:
        said = say_side(event.segments, event.cause, where)
    elif event.kind == "global":
        said = _say_figure(event, first.other, where)
    else:
        said = _say_undirected(event, where)
    return replace(about, message=said)


def _add_timing(about: Advice, group: Sequence[_Found], where: Message) -> Advice:
    lags = [one.event.lag_ms for one in group if one.event.lag_ms is not None and math.isfinite(one.event.lag_ms)]
    lag = float(np.mean(lags)) if lags else None
    cause = group[0].event.cause
    direction = cause if lag is None else "late" if lag > 0 else "early"
    said = say_timing(group[0].event.segments, lag, where, cause)
    return replace(about, message=said, direction=direction, lag_ms=lag)


def _add_corrections(about: Advice, group: Sequence[_Found], where: Message) -> Advice:
    corrections = tuple(
        replace(each, amount_deg=float(np.mean([one.corrections[place].amount_deg for one in group])))
        for place, each in enumerate(group[0].corrections)
    )
    largest = corrections[0]
    return replace(
        about,
        message=Message("advice.correct", what=tuple(each.message for each in corrections), where=where),
        segments=largest.segments,
        direction=largest.direction,
        amount_deg=largest.amount_deg,
        corrections=corrections,
    )


def _say_undirected(event: ErrorEvent, where: Message) -> Message:
    """No direction dominates: more or less of the movement, or only that it is another one."""
    short = event.shortfall_deg
    if short is not None and math.isfinite(short) and (event.kind == "incomplete" or short < 0):
        return Message("advice.correct", what=(say_size(event.segments, short),), where=where)
    return Message("advice.different", who=name_parts(event.segments), where=where)


def _say_figure(event: ErrorEvent, other: int | None, where: Message) -> Message:
    if event.furi is None:
        return Message("advice.something_else", where=where)
    # The figure is that of the worst moment; the error may begin at the end of the figure before it.
    time = format_moment(event.worst_s if math.isfinite(event.worst_s) else event.start_s)
    if other is None:
        return Message("advice.other_figure", time=time, number=event.furi + 1)
    return Message("advice.figure_instead", time=time, number=event.furi + 1, other=other + 1)


def _say_lapse(lapse: Lapse, number: int, furi: Sequence[FuriAssessment]) -> Advice:
    own, missed = lapse.end_s - lapse.start_s, lapse.reference_end_s - lapse.reference_start_s
    lost = own if lapse.kind == "stop" else missed
    time = format_moment(lapse.start_s)
    said = {
        "stop": Message("advice.stop", time=time, seconds=lost),
        "skip": Message("advice.skip", time=time, seconds=lost),
        "repeat": Message("advice.repeat", time=time, seconds=lost),
        "late start": Message("advice.late_start", seconds=lost),
        "early end": Message("advice.early_end", seconds=lost),
    }
    place = next((k for k, one in enumerate(furi) if one.reference_end_s > lapse.reference_start_s), None)
    return Advice(
        said[lapse.kind],
        lapse.kind,
        lapse=number,
        times=(lapse.start_s,),
        reference_s=lapse.reference_start_s,
        furi=(place,),
        importance=_LAPSE_SEVERITY * _limit_duration(lost),
    )


def _say_tempo(assessment: Assessment) -> tuple[Advice, ...]:
    """That all of it was slower or faster; nothing where it was not."""
    tempo = next((float(one.values["tempo"]) for one in assessment.warnings if one.code == "assessment.tempo"), 1.0)
    percent = round(100.0 * abs(tempo - 1.0))
    if not percent:
        return ()
    return (Advice(Message("advice.slower" if tempo > 1.0 else "advice.faster", percent=percent), "tempo"),)


def _say_facing(assessment: Assessment, labels: Sequence[str]) -> tuple[Advice, ...]:
    """Where the dancer faces another way for a second and more; that is no error, and comes after those."""
    rate = assessment.frame_rate
    said = []
    for start, end in find_runs(np.nan_to_num(np.abs(assessment.facing)) > _TURNED).tolist():
        if end - start < _TURNED_S * rate:
            continue
        turned = float(np.median(assessment.facing[start:end]))
        middle = (start + end) // 2
        moment = middle / rate
        correction = Correction(("trunk",), "turn_right" if turned > 0 else "turn_left", math.degrees(abs(turned)), 0.0)
        number = next((k for k, one in enumerate(assessment.furi) if one.start_s <= moment < one.end_s), None)
        said.append(
            Advice(
                Message(
                    "advice.correct",
                    what=(correction.message,),
                    where=say_where((moment,), (number,), labels),
                ),
                "facing",
                times=(moment,),
                reference_s=float(assessment.same_time[middle]),
                segments=correction.segments,
                direction=correction.direction,
                amount_deg=correction.amount_deg,
                furi=(number,),
                corrections=(correction,),
            )
        )
    return tuple(said)


def praise(assessment: Assessment, *, most_praised: int = 3, praised_score: float = 70.0) -> Advice | None:
    """Praise figures without errors, those with most movement first; None without such figures or a grade.

    Parameters
    ----------
    assessment : of a performance.
    """
    if assessment.is_other_dance or math.isnan(assessment.score):
        return None
    spoilt = [(event.start_s, event.end_s) for event in assessment.events]
    spoilt += [(lapse.start_s, lapse.end_s) for lapse in assessment.lapses]
    right = [
        number
        for number, one in enumerate(assessment.furi)
        if math.isfinite(one.start_s)
        and one.score >= praised_score
        and not any(start < one.end_s and end > one.start_s for start, end in spoilt)
    ]
    if not assessment.events and not assessment.lapses:
        return Advice(Message("advice.nothing"), "praise")
    if not right:
        return None
    liveliest = sorted(right, key=lambda number: -_measure_movement(assessment, number))[:most_praised]
    chosen = sorted(liveliest)
    return Advice(
        Message("advice.praise", n=len(chosen), numbers=tuple(number + 1 for number in chosen)),
        "praise",
        times=(assessment.furi[chosen[0]].start_s,),
        reference_s=assessment.furi[chosen[0]].reference_start_s,
        furi=tuple(chosen),
    )


def _measure_movement(assessment: Assessment, number: int) -> float:
    """Mean way of the segments in a figure of the reference, rad/s."""
    one, reference = assessment.furi[number], assessment.reference
    first, last = (round(time * reference.frame_rate) for time in (one.reference_start_s, one.reference_end_s))
    steps = np.diff(reference.segments[first:last], axis=0)
    return float(np.linalg.norm(steps, axis=2).mean()) * reference.frame_rate if len(steps) else 0.0


def describe_advice(said: Sequence[Advice], language: str | None = None) -> list[dict[str, Any]]:
    """Describe advice as the value of ``advice`` of ``dousa evaluate --json``.

    Parameters
    ----------
    said : what `advise` returns.
    language : of the sentences; None for the one in use.
    """
    return [
        {
            "says": one.message.render(language),
            "about": one.about,
            "event": one.event,
            "lapse": one.lapse,
            "time_s": round_number(one.time_s, 3),
            "times_s": [round_number(time, 3) for time in one.times],
            "reference_s": round_number(one.reference_s, 3),
            "segments": list(one.segments),
            "direction": one.direction,
            "amount_deg": round_number(one.amount_deg, 1),
            "lag_ms": round_number(one.lag_ms, 1),
            "furi": list(one.furi),
        }
        for one in said
    ]
