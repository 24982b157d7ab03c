"""What a teacher says of an error that was found: how late, how much too small, which segments, how far off."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import FloatArray
from dousa.evaluation.alignment.dynamic_programming import follow_lag
from dousa.evaluation.errors.evidence import LAG_CHANGE, Evidence, measure_missing_range, measure_ranges
from dousa.evaluation.errors.judge import Suspect

_EDGE, _LEAST_KEPT = 0.3, 0.5  # of the lag; of the span
_REACH_S, _MOST = 0.8, 0.5  # lags that are looked at; squared chord, further away says no more
# s for which the deviations of a performer are alike; rad by which any are uncertain; s, standard error up to which the
# number is said: see lab/notes/evaluation.md
_ALIKE_S, _BLUR, _SURE_S = 0.1, np.radians(3.0), 0.05
_LEAST_EXCESS = np.radians(10.0)  # as much as is worth saying, see docs/evaluation.md
# gain of a motion that is larger, and share that it may leave, see lab/notes/evaluation.md
_LARGER, _UNEXPLAINED = 1.2, 0.6
_BODY = np.arange(9)  # all segments, by definition


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


def measure_suspects(evidence: Evidence, suspects: Sequence[Suspect], frames: NDArray[np.intp]) -> list[Finding]:
    """Measure the errors found in moments, in order of time.

    Parameters
    ----------
    evidence : of the performance.
    suspects : found by the judge.
    frames : (N,) working frames of its moments.
    """
    if not len(frames):
        return []
    stride = int(frames[1] - frames[0]) if len(frames) > 1 else 1
    count = len(evidence.ordinary)
    found = []
    for suspect in suspects:
        start = max(int(frames[suspect.start]) - stride // 2, 0)
        end = min(int(frames[suspect.end - 1]) + (stride + 1) // 2, count)
        segments = np.array(suspect.segments)
        if end > start and evidence.deviations.judged[start:end, segments].any():
            found.append(_MEASURES[suspect.kind](evidence, start, end, segments))
    return sorted(found, key=lambda one: (one.start, one.end))


def describe_shift(evidence: Evidence, start: int, end: int, segments: NDArray[np.intp]) -> Finding:
    """Describe a stretch in which some segments are late or early."""
    course = follow_limb(evidence, start, end, segments)
    lag, error = estimate_lag(evidence, start, segments, course)
    unsure = None if error <= _SURE_S else "late" if lag > 0.0 else "early"
    # It begins and ends where it is seen to.
    late = np.flatnonzero(course * np.sign(lag) >= _EDGE * abs(lag))
    if len(late) and late[-1] - late[0] >= _LEAST_KEPT * (end - start):
        start, end = start + int(late[0]), start + int(late[-1]) + 1
    far = evidence.punctual[start:end, segments].sum(axis=1)
    worst = start + int(np.argmax(far))
    severity = max(abs(lag) / evidence.slack_s, 1.0)
    return Finding("shift", start, end, _name(segments), severity, worst, lag, cause=unsure)


def estimate_lag(
    evidence: Evidence, start: int, segments: NDArray[np.intp], course: FloatArray, *, lasting: float = 0.5
) -> tuple[float, float]:
    """Estimate the one lag of a stretch in s and its standard error; positive is late.

    How likely each lag is follows from the deviations that it leaves, as in a regression with noise of unknown size;
    where another lag is nearly as likely, or the limb hardly moves, the error is large.

    Parameters
    ----------
    evidence : of the performance.
    start : first frame.
    segments : indices.
    course : (n,) s, of `follow_limb` from that frame on.
    """
    # lasting: share of the course's large lags (their 90th percentile): the rest is fading in and out
    late = np.sign(course.sum()) * course
    frames = start + np.flatnonzero(late >= lasting * np.percentile(np.abs(course), 90.0))
    squared, reach = _take_near(evidence, frames if len(frames) else np.arange(start, start + len(course)), segments)
    total = squared.sum(axis=(0, 2), dtype=np.float64)
    size = squared.shape[0] * squared.shape[2]
    moments = max(squared.shape[0] / evidence.rate / _ALIKE_S, 1.0)
    odds = -moments * np.log(total + size * _BLUR**2)
    chances = np.exp(odds - odds.max())
    at = int(np.clip(total.argmin(), 1, len(total) - 2))
    before, here, after = total[at - 1 : at + 2]
    bend = before - 2.0 * here + after
    part = 0.5 * (before - after) / bend if bend > 1e-9 else 0.0
    lags = (reach - np.arange(len(total))) * evidence.deviations.step_s
    lag = float(lags[at] - np.clip(part, -1.0, 1.0) * evidence.deviations.step_s)
    return lag, float(np.sqrt(chances @ (lags - lag) ** 2 / chances.sum()))


def _take_near(
    evidence: Evidence, frames: slice | NDArray[np.intp], segments: NDArray[np.intp]
) -> tuple[NDArray[np.float32], int]:
    """(n, K, S) squared deviations of some frames and segments at the lags that are looked at, and how many to a side.

    What is not seen speaks for no lag.
    """
    deviations = evidence.deviations
    reach = min(round(_REACH_S * evidence.rate), deviations.center)
    near = slice(deviations.center - reach, deviations.center + reach + 1)
    seen = deviations.squared[frames, near][:, :, segments]
    return np.minimum(np.where(seen > 0.0, seen, seen[:, reach : reach + 1]), _MOST), reach


def follow_limb(
    evidence: Evidence, start: int, end: int, segments: NDArray[np.intp], *, smooth_s: float = 0.3
) -> FloatArray:
    """(end - start,) s, lag of some segments over time; positive is late.

    The course of the lag that leaves least, smoothed, to a fraction of a frame by a parabola.
    """
    deviations = evidence.deviations
    seen, reach = _take_near(evidence, slice(start, end), segments)
    near = slice(deviations.center - reach, deviations.center + reach + 1)
    squared = seen.mean(axis=2)
    half = min(max(1, round(0.5 * smooth_s * evidence.rate)), max((end - start) // 2, 1))
    total = np.cumsum(np.pad(squared, ((half + 1, half), (0, 0)), mode="edge"), axis=0)
    squared = (total[2 * half + 1 :] - total[: -2 * half - 1]) / (2 * half + 1)
    scale = float(np.mean(evidence.tolerance[segments] ** 2))
    prices = evidence.lag_prices[near] / 9.0
    course = follow_lag(squared / scale + prices, LAG_CHANGE / 9.0 * 30.0 / evidence.rate).astype(np.intp)
    rows = np.arange(len(course))
    inner = np.clip(course, 1, squared.shape[1] - 2)
    left, here, right = (squared[rows, inner + step] for step in (-1, 0, 1))
    bend = left - 2.0 * here + right
    part = np.where(bend > 1e-9, 0.5 * (left - right) / np.maximum(bend, 1e-9), 0.0)
    return np.asarray(-(inner - reach + np.clip(part, -1.0, 1.0)) * deviations.step_s)


def _measure_incomplete(evidence: Evidence, start: int, end: int, segments: NDArray[np.intp]) -> Finding:
    theirs, ours = evidence.deviations.reference[start:end], evidence.deviations.performance[start:end]
    missing, share = measure_missing_range(theirs, ours, segments)
    if len(segments) == len(_BODY):
        out = evidence.punctual[start:end].max(axis=0)[segments] > 1.0
        segments = segments[out] if out.any() else segments
    severity, worst = measure_severity(evidence, start, end, segments)
    return Finding("incomplete", start, end, _name(segments), severity, worst, None, missing, share)


def _measure_partial(
    evidence: Evidence, start: int, end: int, segments: NDArray[np.intp], *, partly_wrong: float = 1.0
) -> Finding:
    # partly_wrong: mean squared multiple of the tolerance from which a segment of a wrong limb is wrong itself
    far = evidence.ordinary[start:end].mean(axis=0)[segments]
    if (far > partly_wrong).any():
        segments = segments[far > min(partly_wrong, 0.5 * float(far.max()))]
    severity, worst = measure_severity(evidence, start, end, segments)
    excess, share = _measure_excess(evidence, start, end, segments)
    moved = _measure_compensation(evidence, start, end, segments)
    if moved is not None:
        return Finding("partial", start, end, _name(segments), severity, worst, None, moved, None, "compensation")
    return Finding("partial", start, end, _name(segments), severity, worst, None, excess, share)


def _measure_excess(
    evidence: Evidence, start: int, end: int, segments: NDArray[np.intp]
) -> tuple[float | None, float | None]:
    """Measure the negative missing range, rad and share, of limbs whose motion is larger; None for another motion."""
    ours = evidence.deviations.performance[start:end, segments]
    theirs = evidence.deviations.reference[start:end, segments]
    x, y = theirs - theirs.mean(axis=0), ours - ours.mean(axis=0)
    gain = float((x * y).sum() / max((x * x).sum(), 1e-9))
    if gain < _LARGER or ((y - gain * x) ** 2).sum() > _UNEXPLAINED * ((y - x) ** 2).sum():
        return None, None
    whole, reached = measure_ranges(theirs), measure_ranges(ours)
    most = int(np.argmax(reached - whole))
    missing = float(whole[most] - reached[most])
    return (missing, missing / float(whole[most])) if missing < -_LEAST_EXCESS else (None, None)


def _measure_compensation(
    evidence: Evidence, start: int, end: int, segments: NDArray[np.intp], *, still: float = 1.0 / 3.0
) -> float | None:
    """Measure the negative range, rad, by which what is still in the reference moves more; None if it is not still."""
    # still: of the range of the performance
    theirs = float(measure_ranges(evidence.deviations.reference[start:end, segments]).max())
    ours = float(measure_ranges(evidence.deviations.performance[start:end, segments]).max())
    return theirs - ours if theirs < still * ours and ours - theirs > _LEAST_EXCESS else None


def measure_severity(evidence: Evidence, start: int, end: int, segments: NDArray[np.intp]) -> tuple[float, int]:
    """Measure the largest lasting deviation in multiples of the tolerance, and find its worst frame."""
    far = evidence.deviations.squared[start:end, evidence.center][:, segments]
    ratio = np.sqrt(far / evidence.tolerance[segments] ** 2).max(axis=1)
    return float(np.percentile(ratio, 90)), start + int(ratio.argmax())


def _measure_global(evidence: Evidence, start: int, end: int, segments: NDArray[np.intp]) -> Finding:
    severity, worst = measure_severity(evidence, start, end, segments)
    return Finding("global", start, end, _name(_BODY), severity, worst)


def _name(segments: NDArray[np.intp]) -> tuple[int, ...]:
    return tuple(int(segment) for segment in segments)


_MEASURES = {
    "shift": describe_shift,
    "incomplete": _measure_incomplete,
    "partial": _measure_partial,
    "global": _measure_global,
}
