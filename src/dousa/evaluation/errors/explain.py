"""Which error explains a stretch that differs: late, too small, one limb wrong, or another figure.

Every explanation says what the performance should look like if it were true; the one that leaves least unexplained,
its own price included, wins. Costs are squared deviations in multiples of what is tolerated, summed over frames of
1/30 s and segments.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import FloatArray
from dousa.evaluation.alignment.dynamic_programming import follow_lag, switch_on
from dousa.evaluation.errors.evidence import (
    CAP,
    GROUPS,
    LIMB_SEGMENTS,
    Evidence,
    GainFit,
    find_stretches,
    fit_gain,
    measure_missing_range,
    measure_ranges,
    refine_lag,
)
from dousa.motion.runs import find_runs


def follow_path(
    evidence: Evidence, start: int, end: int, *, change: float = 0.3, outside: float = 1e3
) -> tuple[NDArray[np.intp], FloatArray]:
    """Follow the performance on the reference's path between the same two moments.

    Returns
    -------
    course : (n,) columns of lag.
    cost : (n,) sum over the segments of the capped ratio left on the way.
    """
    # change: price of one column of lag: nearly free, since any time of the reference may be met
    columns = np.arange(len(evidence.lag_prices))
    there = np.arange(start, end)[:, None] + columns - evidence.center
    ratio = evidence.ratio.of(start, end)
    cost = np.where((there >= start) & (there < end), ratio.sum(axis=2), outside)
    course = follow_lag(cost, change).astype(np.intp)
    return course, evidence.ratio.at_lag(course, start).sum(axis=1)


def compute_unreached(evidence: Evidence, start: int, end: int, first: int, last: int) -> FloatArray:
    """Compute the distance of each moment of the reference from the nearest moment of the performance.

    Moments start to end of the reference (on the performance's clock) are compared with frames first to last of the
    performance, both half-open. Returns (n, 9) squared distance over squared tolerance to the nearest point of the
    performance's path, which runs straight between its frames; averaged over three moments.
    """
    deviations, center = evidence.deviations, evidence.center
    inverse = 1.0 / evidence.tolerance**2
    steps = ((deviations.performance[1:] - deviations.performance[:-1]) ** 2).sum(axis=2) * inverse
    unreached = np.zeros((end - start, 9))
    for row, moment in enumerate(range(start, end)):
        frames = np.arange(max(first, moment - center), min(last, moment + center + 1))
        far = deviations.squared[frames, center + moment - frames] * inverse
        if len(frames) < 2:
            unreached[row] = far[0] if len(frames) else 0.0
            continue
        step = steps[frames[:-1]]
        here, there, whole = far[:-1].sum(axis=1), far[1:].sum(axis=1), step.sum(axis=1)
        share = np.clip((here - there + whole) / np.maximum(2.0 * whole, 1e-9), 0.0, 1.0)[:, None]
        between = far[:-1] * (1.0 - share) + far[1:] * share - share * (1.0 - share) * step
        unreached[row] = np.maximum(between[between.sum(axis=1).argmin()], 0.0)
    padded = np.pad(unreached, ((1, 1), (0, 0)), mode="edge")
    averaged: FloatArray = (padded[:-2] + padded[1:-1] + padded[2:]) / 3.0
    return averaged


_PRICE = 10.0  # of an explanation with a number in it: a lag, a gain; chosen as lab/notes/evaluation.md says
_SURPRISE = 2.0  # of a segment that does something else, a frame; chosen as lab/notes/evaluation.md says
_DOUBT = 0.15  # what a frame must be explained better to belong to the error; chosen as lab/notes/evaluation.md says
_ON_PATH, _ON_PATH_SHARE, _OFF_PATH = 4.5, 0.55, 9.0
_OFF_CENTER, _UNEXPLAINED = 1.5, 0.6
_OFF_CENTER_CLEAR, _CLEAR = 3.0, 0.2  # what shrinks to its first pose, if shrinking explains nearly all
_STEADY_S, _STEADY_SHARE, _IN_STEP = 0.07, 0.7, 2.5  # of a leap in time
_LEAP_S, _LEAP_LASTS_S = 0.15, 0.5  # a smaller or shorter one may be a turn that came too early

# Of the stretch's length, and s: a moment from further away is another figure.
_LONGEST_LAG, _LONGEST_LAG_S = 0.5, 0.6
_GLOBAL_LIMBS, _GLOBAL_SEGMENTS = 3, 4  # or so many, spread over the body
_LARGER, _LEAST_EXCESS = 1.2, np.radians(10.0)
_BY_TIME = ("shift", "stops short")
_SHORTEST_S = 0.25  # s of an error, see "Limits" in docs/evaluation.md
BODY = np.arange(9)  # all segments, by definition


@dataclass(frozen=True, slots=True, eq=False)
class Finding:
    """An error in working frames."""

    kind: str  # class
    start: int
    end: int  # the frame after the last
    segments: tuple[int, ...]  # indices
    severity: float  # in multiples of what is tolerated
    worst: int  # frame
    lag_s: float | None = None  # positive is late
    shortfall: float | None = None  # rad; negative is larger than the reference
    shortfall_share: float | None = None
    cause: str | None = None  # of `dousa.evaluation.words.CAUSES`


@dataclass(frozen=True, slots=True, eq=False)
class _Hypothesis:
    """One explanation of the frames first to last."""

    name: str
    cost: float  # what it leaves, price included
    frames: FloatArray  # (n,) what it leaves in each frame
    course: NDArray[np.intp] | None = None  # (n,) lag columns of a shift or of the way along the path
    group: NDArray[np.intp] | None = None  # of a gain
    fit: GainFit | None = None  # of a gain


def explain_all(evidence: Evidence, first: int = 0, last: float = np.inf) -> list[Finding]:
    """Find all errors of a performance by the rules, in order of time; those of stretches that touch some frames."""
    stretches = [one for one in find_stretches(evidence) if one[0] < last and one[1] > first]
    return [found for start, end in stretches for found in explain(evidence, start, end)]


def explain(
    evidence: Evidence, start: int, end: int, *, pad_s: float = 0.25, surely_late: float = 1.15
) -> list[Finding]:
    """Find the errors of one stretch [start, end), in order."""
    # surely_late: multiple of the lag that is forgiven
    pad = round(pad_s * evidence.rate)
    first, last = max(start - pad, 0), min(end + pad, len(evidence.ordinary))
    if end - start < 2:
        return []
    hypotheses = [
        *_explain_by_time(evidence, start, end, first, last),
        *_explain_by_size(evidence, start, end, first, last),
        _explain_by_limbs(evidence, start, end, first, last),
    ]
    best = _choose(evidence, hypotheses, first, last)
    if best is None:
        return []
    finding = _REPORTS[best.name](evidence, best, start, end, first)
    lasting = finding.end - finding.start >= _SHORTEST_S * evidence.rate
    forgiven = finding.kind == "shift" and finding.severity <= surely_late
    found = [finding] if lasting and not forgiven else []
    if best.name == "shift":
        found += _explain_rest(evidence, finding, start, end, pad)
    return sorted(found, key=lambda one: one.start)


def _choose(evidence: Evidence, hypotheses: list[_Hypothesis], first: int, last: int) -> _Hypothesis | None:
    """The cheapest explanation that is better than none.

    A lag is forgiven or it is not: once it is too large it counts in full, so explanations by time are held against
    a performance in which no lag is forgiven, if nothing else is wrong.
    """
    best = min(hypotheses, key=lambda hypothesis: hypothesis.cost)
    scale = _per_frame(evidence)
    if best.name not in _BY_TIME and best.cost < evidence.ordinary[first:last].sum() * scale:
        return best
    by_time = [hypothesis for hypothesis in hypotheses if hypothesis.name in _BY_TIME]
    if not by_time:
        return None
    best = min(by_time, key=lambda hypothesis: hypothesis.cost)
    return best if best.cost < evidence.punctual[first:last].sum() * scale else None


def _per_frame(evidence: Evidence) -> float:
    return 30.0 / evidence.rate


def _explain_by_time(
    evidence: Evidence,
    start: int,
    end: int,
    first: int,
    last: int,
    *,
    unreached_turning: float = 2.0,
    off_path_segment: float = 4.0,
    unreached_ratio: float = 5.0,
) -> list[_Hypothesis]:
    """Late or early; or on the path of the reference, but not to its end."""
    # unreached_ratio: squared ratio from which an extreme was not reached
    # unreached_turning: and if the performance is late on the way there, and early on the way back
    scale = _per_frame(evidence)
    ordinary = evidence.ordinary[first:last]
    # Where a segment is off the path it is wrong: that the path's end is not reached says nothing then.
    wrong = evidence.ratio.at_lag(evidence.course[start:end], start) > off_path_segment
    unreached = float(np.where(wrong, 0.0, compute_unreached(evidence, start, end, first, last)).max())
    lag = refine_lag(evidence, evidence.course[start:end], start)
    turned_back = bool((lag > evidence.slack_s).any() and (lag < -evidence.slack_s).any())
    missed = unreached >= (unreached_turning if turned_back else unreached_ratio)
    if missed and not _keeps_its_lag(evidence, start, end):
        if _holds_a_limb(evidence, start, end):
            return []
        course, left = follow_path(evidence, first, last)
        if (left[start - first : end - first] < _ON_PATH).mean() < _ON_PATH_SHARE:
            return []
        cost = np.minimum(left, _OFF_PATH).sum() * scale + _PRICE + 0.5 * _PRICE
        return [_Hypothesis("stops short", cost, left, course)]
    found = []
    near, far = evidence.center - evidence.slack, evidence.center + evidence.slack
    whole = evidence.course[first:last]
    farthest = max(_LONGEST_LAG * (end - start), _LONGEST_LAG_S * evidence.rate)
    for course in (np.minimum(whole, far), np.maximum(whole, near)):
        if abs(np.median(course[start - first : end - first]) - evidence.center) > farthest:
            continue
        forgiven = np.abs(course - evidence.center) <= evidence.slack
        shifted = evidence.ratio.at_lag(course, first) * evidence.deviations.judged[first:last]
        left = np.where(forgiven[:, None], ordinary, shifted).sum(axis=1)
        cost = (left + evidence.lag_prices[course] / scale).sum() * scale + _PRICE
        found.append(_Hypothesis("shift", cost, left, course))
    return found


def _holds_a_limb(evidence: Evidence, start: int, end: int, *, held: float = 0.35) -> bool:
    """Whether all that is wrong is one limb, which does next to nothing of what the reference's does."""
    # held: of the reference's range, unsteadiness included
    out = evidence.ordinary[start:end].mean(axis=0) > 1.0
    limbs = [limb for limb in LIMB_SEGMENTS if out[limb].any()]
    if len(limbs) != 1:
        return False
    theirs = measure_ranges(evidence.deviations.reference[start:end, limbs[0]])
    ours = measure_ranges(evidence.deviations.performance[start:end, limbs[0]])
    return bool(ours.max() < held * theirs.max())


def _keeps_its_lag(evidence: Evidence, start: int, end: int) -> bool:
    """Whether a stretch is one steady lag: a leap in time skips an extreme, or comes too late for it, yet moves on."""
    course = evidence.course[start:end]
    typical = round(float(np.median(course)))
    steady = np.abs(course - typical) <= _STEADY_S * evidence.rate
    left = evidence.ratio.at_lag(course, start).sum(axis=1)
    leap = abs(typical - evidence.center) > max(evidence.slack, _LEAP_S * evidence.rate - 0.5)
    lasts = end - start >= _LEAP_LASTS_S * evidence.rate
    return bool(leap and lasts and (steady & (left < _IN_STEP)).mean() > _STEADY_SHARE)


def _explain_by_size(
    evidence: Evidence, start: int, end: int, first: int, last: int, *, gains: tuple[float, float] = (0.28, 0.86)
) -> list[_Hypothesis]:
    """A limb, or the body, moves less."""
    # gains: below, a limb does nothing of the motion; above, it does it all
    ours, theirs = evidence.deviations.performance, evidence.deviations.reference
    ordinary = evidence.ordinary[first:last]
    inside = slice(start - first, end - first)
    found = []
    for group in GROUPS.values():
        tolerance = evidence.tolerance[group]
        fit = fit_gain(ours[start:end, group], theirs[start:end, group], tolerance)
        off_center = _OFF_CENTER_CLEAR if fit.unexplained < _CLEAR else _OFF_CENTER
        plausible = gains[0] < fit.gain < gains[1] and fit.off_center < off_center
        if not plausible or fit.unexplained > _UNEXPLAINED:
            continue
        rest = fit.compute_rest(ours[first:last, group], theirs[first:last, group], tolerance)
        smaller = np.minimum(rest, CAP).sum(axis=1)
        others = np.delete(ordinary, group, axis=1).sum(axis=1)
        same = ordinary[:, group].sum(axis=1)
        # Where the error fades in or out a frame is nearer to the reference than to its smaller copy.
        within = same.copy()
        within[inside] = np.minimum(smaller, same + 1.0)[inside]
        cost = (within + others).sum() * _per_frame(evidence) + _PRICE
        found.append(_Hypothesis("size", cost, smaller + others, group=group, fit=fit))
    return found


def _explain_by_limbs(
    evidence: Evidence, start: int, end: int, first: int, last: int, *, price_wrong: float = 6.0
) -> _Hypothesis:
    """Some segments do something else: each for a price a frame."""
    # price_wrong: of another motion, which explains anything
    left = evidence.ordinary[first:last].copy()
    inside = left[start - first : end - first]
    wrong = inside.sum(axis=0) > _SURPRISE * len(inside)
    inside[:, wrong] = _SURPRISE
    frames = left.sum(axis=1)
    return _Hypothesis("limbs", frames.sum() * _per_frame(evidence) + price_wrong, frames)


def _report_shift(
    evidence: Evidence, best: _Hypothesis, start: int, end: int, first: int, *, plateau: float = 0.75
) -> Finding:
    # plateau: of the largest lag: the rest is fading in and out
    assert best.course is not None
    span = slice(first, first + len(best.frames))
    better = evidence.punctual[span].sum(axis=1) - best.frames - _DOUBT
    begin, stop = find_best_span(better)
    lag = refine_lag(evidence, best.course, first)[begin:stop]
    typical = float(np.median(lag[np.abs(lag) >= plateau * np.abs(lag).max()])) if len(lag) else 0.0
    worst = int(np.argmax(evidence.punctual[first + begin : first + stop].sum(axis=1))) if stop > begin else 0
    return Finding(
        "shift",
        first + begin,
        first + stop,
        tuple(range(9)),
        abs(typical) / evidence.slack_s,
        first + begin + worst,
        typical,
    )


def _report_stop(evidence: Evidence, best: _Hypothesis, start: int, end: int, first: int) -> Finding:
    assert best.course is not None
    theirs, ours = evidence.deviations.reference, evidence.deviations.performance
    # An error fades in and out: it begins before it is out of tolerance.
    start, end = max(start - 2 * _fade_frames(evidence), first), end + 2 * _fade_frames(evidence)
    end = min(end, first + len(best.frames))
    frames = np.arange(start, end) + best.course[start - first : end - first] - evidence.center
    model = theirs[np.clip(frames, 0, len(theirs) - 1)]
    missing, share = measure_missing_range(theirs[start:end], ours[start:end], model, BODY)
    changed = find_changed(evidence, start, end, BODY)
    severity, worst = measure_severity(evidence, start, end, changed)
    return Finding("incomplete", start, end, tuple(changed.tolist()), severity, worst, None, missing, share)


def find_changed(evidence: Evidence, start: int, end: int, segments: NDArray[np.intp]) -> NDArray[np.intp]:
    """Find the segments that are out of tolerance at some moment; all if none is."""
    out = evidence.punctual[start:end].max(axis=0)[segments] > 1.0
    return segments[out] if out.any() else segments


def _report_size(evidence: Evidence, best: _Hypothesis, start: int, end: int, first: int) -> Finding:
    assert best.fit is not None and best.group is not None
    group, fit = best.group, best.fit
    theirs, ours = evidence.deviations.reference, evidence.deviations.performance
    better = evidence.ordinary[first : first + len(best.frames)].sum(axis=1) - best.frames - _DOUBT
    begin, stop = find_best_span(better)
    if stop - begin >= _SHORTEST_S * evidence.rate:
        fade = _fade_frames(evidence)
        start, end = max(first + begin - fade, 0), min(first + stop + fade, len(ours))
        fit = fit_gain(ours[start:end, group], theirs[start:end, group], evidence.tolerance[group])
    return measure_shrinking(evidence, start, end, group, fit)


def measure_shrinking(evidence: Evidence, start: int, end: int, group: NDArray[np.intp], fit: GainFit) -> Finding:
    """Describe a stretch in which a group of segments does a smaller motion, with the gain of ``fit``."""
    theirs, ours = evidence.deviations.reference[start:end], evidence.deviations.performance[start:end]
    model = ours.copy()
    model[:, group] = fade_gain(theirs[:, group], ours[:, group], fit, evidence.tolerance[group])
    missing, share = measure_missing_range(theirs, ours, model, group)
    if len(group) == len(BODY):
        group = find_changed(evidence, start, end, group)
    severity, worst = measure_severity(evidence, start, end, group)
    return Finding("incomplete", start, end, tuple(group.tolist()), severity, worst, None, missing, share)


def _fade_frames(evidence: Evidence, *, fade_s: float = 0.033) -> int:
    return round(fade_s * evidence.rate)


def fade_gain(reference: FloatArray, performance: FloatArray, fit: GainFit, tolerance: FloatArray) -> FloatArray:
    """Fade the smaller motion in and out as the performance does."""
    change = fit.predict(reference) - reference
    weight = 1.0 / tolerance[:, None] ** 2
    along = ((performance - reference) * change * weight).sum(axis=(1, 2))
    power = (change * change * weight).sum(axis=(1, 2))
    kernel = np.ones(5)
    share = np.convolve(along, kernel, mode="same") / np.maximum(np.convolve(power, kernel, mode="same"), 1e-6)
    faded = reference + np.clip(share[: len(change)], 0.0, 1.1)[:, None, None] * change
    unit: FloatArray = faded / np.maximum(np.linalg.norm(faded, axis=2, keepdims=True), 1e-9)
    return unit


def _report_limbs(
    evidence: Evidence,
    best: _Hypothesis,
    start: int,
    end: int,
    first: int,
    *,
    wrong_share: float = 0.6,
    global_share: float = 5 / 9,
) -> Finding:
    # global_share: share of the segments with a weight above 0
    # wrong_share: of the surprise's price, in the mean: the segment belongs to the error
    inside = evidence.ordinary[start:end]
    wrong = np.flatnonzero(inside.mean(axis=0) > wrong_share * _SURPRISE)
    if not len(wrong):
        wrong = np.array([int(inside.mean(axis=0).argmax())])
    limbs = [limb for limb in LIMB_SEGMENTS if np.isin(limb, wrong).any()]
    weighing = np.flatnonzero(evidence.ratio.find_weighing())
    most = len(wrong) >= global_share * len(weighing) and len(limbs) >= 2
    whole = most or (len(limbs) >= _GLOBAL_LIMBS and len(wrong) >= _GLOBAL_SEGMENTS)
    kind = "global" if whole else "partial"
    if kind == "global":
        wrong = BODY
    severity, worst = measure_severity(evidence, start, end, wrong)
    further, share = (None, None) if kind == "global" else measure_excess(evidence, start, end, wrong)
    return Finding(kind, start, end, tuple(wrong.tolist()), severity, worst, None, further, share)


def measure_excess(
    evidence: Evidence, start: int, end: int, segments: NDArray[np.intp]
) -> tuple[float | None, float | None]:
    """Measure the negative missing range, rad and share, of limbs whose motion is larger; None for another motion."""
    ours = evidence.deviations.performance[start:end, segments]
    theirs = evidence.deviations.reference[start:end, segments]
    fit = fit_gain(ours, theirs, evidence.tolerance[segments])
    if fit.gain < _LARGER or fit.unexplained > _UNEXPLAINED:
        return None, None
    whole, reached = measure_ranges(theirs), measure_ranges(ours)
    most = int(np.argmax(reached - whole))
    missing = float(whole[most] - reached[most])
    return (missing, missing / float(whole[most])) if missing < -_LEAST_EXCESS else (None, None)


_REPORTS = {
    "shift": _report_shift,
    "stops short": _report_stop,
    "size": _report_size,
    "limbs": _report_limbs,
}


def _explain_rest(evidence: Evidence, shift: Finding, start: int, end: int, pad: int) -> list[Finding]:
    """What a shift leaves over: limbs that are wrong at its own time too, and what lies before and after it."""
    found: list[Finding] = []
    late = evidence.ratio.at_lag(evidence.course[shift.start : shift.end], shift.start)
    for limb in LIMB_SEGMENTS:
        if len(late) < 2:
            break
        score = (late[:, limb].max(axis=1) - 1.5) * _per_frame(evidence)
        for begin, stop in find_runs(switch_on(score, 2.0 * _PRICE)).tolist():
            if stop - begin >= 2.0 * _SHORTEST_S * evidence.rate:
                a, b = shift.start + begin, shift.start + stop
                severity = float(np.sqrt(late[begin:stop, limb].max(axis=1).mean()))
                worst = a + int(late[begin:stop, limb].max(axis=1).argmax())
                found.append(Finding("partial", a, b, tuple(limb.tolist()), severity, worst))
    for a, b in ((start, shift.start - pad // 2), (shift.end + pad // 2, end)):
        if b - a >= 2.0 * _SHORTEST_S * evidence.rate and b - a < end - start:
            found += explain(evidence, a, b)
    return found


def measure_severity(evidence: Evidence, start: int, end: int, segments: NDArray[np.intp]) -> tuple[float, int]:
    """Measure the largest lasting deviation in multiples of the tolerance, and find its worst frame."""
    far = evidence.deviations.squared[start:end, evidence.center][:, segments]
    ratio = np.sqrt(far / evidence.tolerance[segments] ** 2).max(axis=1)
    return float(np.percentile(ratio, 90)), start + int(ratio.argmax())


def find_best_span(gains: FloatArray) -> tuple[int, int]:
    """Find the half-open span with the largest sum."""
    best, total, start, span = -np.inf, 0.0, 0, (0, len(gains))
    for i, gain in enumerate(gains):
        if total <= 0.0:
            total, start = 0.0, i
        total += gain
        if total > best:
            best, span = total, (start, i + 1)
    return span
