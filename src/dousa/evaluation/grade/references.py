"""The takes of the reference: one clock for all, and what differs between them is tolerated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dousa.arrays import FloatArray, IndexArray
from dousa.evaluation.alignment.dynamic_programming import follow_lag
from dousa.evaluation.alignment.lines import OUTSIDE, Alignment, align, to_cost
from dousa.evaluation.errors.deviation import Deviations, choose_nearest, compute_deviations
from dousa.evaluation.errors.evidence import SLACK_S, Tolerance, gather_evidence, measure_unsteadiness
from dousa.evaluation.errors.explain import Finding, explain_all
from dousa.evaluation.grade.score import compute_deviation
from dousa.evaluation.posture.offset import Offset, estimate_offset, learn_between, take_out
from dousa.evaluation.posture.posture import PostureSequence, Working, interpolate_segments, thin_postures

_DOUBT = 1.2  # few takes show little of what may still be done: 2.2 times with two takes, 1.3 times with five
_N_ROUNDS = 14
MOST_MISMATCH, MOST_DEVIATION = 0.85, 36.0
"""Along the lines (0 to 1), and degrees: motions that differ more have nothing in common."""

_MOST_LAG_S = 1.0
_MOST_ANGLE = np.radians(40.0)  # takes that differ more than this are not takes of one thing


@dataclass(frozen=True, slots=True, eq=False)
class ReferenceTakes:
    """Takes of the reference on the clock of the first.

    Parameters
    ----------
    postures : of the first take, at the performance's rate.
    working : of the first take and of each further one that is like it, at the working rate, warped onto the first.
    warped : the further ones at the full rate, warped onto the first.
    tolerance : learned from the takes; None if there is one only.
    deviations : degrees, mean deviation of each of the further ones from the first.
    left_out : numbers, from 1, of takes that are not like the first.
    from_first : (U, 9) rad of each of the further ones, from the first take at the same time; nan where unseen.
    between : (9,) rad, root mean square of what bodies differ by; None where one take does not tell.
    """

    postures: PostureSequence
    working: tuple[Working, ...]
    warped: tuple[PostureSequence, ...]
    tolerance: Tolerance | None
    deviations: tuple[float, ...]
    left_out: tuple[int, ...] = ()
    from_first: tuple[FloatArray, ...] = ()
    between: FloatArray | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """How a performance compares with the reference.

    Parameters
    ----------
    alignment : lines.
    deviations : from the nearest take.
    from_first : (T, 9) rad, from the first take at the same time; nan where nothing is judged.
    offset : of the performer's body against the first take's, taken out of all of them.
    performance : at the working rate, after that.
    """

    alignment: Alignment
    deviations: Deviations
    from_first: FloatArray
    offset: Offset
    performance: Working


def prepare_references(takes: Sequence[PostureSequence], tempo: str, weights: FloatArray) -> ReferenceTakes:
    """Warp the takes that are like the first onto it, and learn what is tolerated from how they differ.

    Parameters
    ----------
    takes : at one frame rate, one or more.
    tempo : of the performance's comparison; the takes are held to the same.
    weights : (9,) of the segments, those above 0 of mean 1.
    """
    first = takes[0]
    clock = (thin_postures(first),)
    unwarped = [thin_postures(take) for take in takes[1:]]
    alone = [compare(clock, take, tempo, weights) for take in unwarped]
    apart = [compute_deviation(one.from_first, weights) for one in alone]
    like = [
        i
        for i, (one, angle) in enumerate(zip(alone, apart, strict=True))
        if one.alignment.mismatch <= MOST_MISMATCH and angle <= MOST_DEVIATION
    ]
    warped = tuple(_warp(first, takes[i + 1], weights) for i in like)
    working = (*clock, *(thin_postures(take) for take in warped))
    tolerance = _learn(working, [unwarped[i] for i in like], tempo, weights) if like else None
    deviations = tuple(apart[i] for i in like)
    left_out = tuple(i + 2 for i in range(len(unwarped)) if i not in like)
    from_first = tuple(alone[i].from_first for i in like)
    between = learn_between([alone[i].offset for i in like]) if like else None
    return ReferenceTakes(first, working, warped, tolerance, deviations, left_out, from_first, between)


def reweigh_references(references: ReferenceTakes, weights: FloatArray) -> ReferenceTakes:
    """The same takes, held to each other with other weights (9,); what is tolerated of a segment stays as it is."""
    apart = tuple(compute_deviation(one, weights) for one in references.from_first)
    return replace(references, deviations=apart)


def _warp(first: PostureSequence, take: PostureSequence, weights: FloatArray) -> PostureSequence:
    """A take on the clock of the first, by the curve of best correspondence."""
    from dousa.evaluation.alignment.correspondence import find_path

    path = find_path(first.segments, take.segments, weights=weights)
    count = np.bincount(path[:, 0], minlength=first.n_frames)
    mean = np.bincount(path[:, 0], weights=path[:, 1], minlength=first.n_frames) / np.maximum(count, 1)
    nearest = np.rint(mean).astype(np.intp)
    return PostureSequence(
        interpolate_segments(take.segments, mean),
        take.seen[nearest],
        take.positions[nearest],
        first.frame_rate,
        take.name,
    )


def compare(
    references: Sequence[Working],
    performance: Working,
    tempo: str,
    weights: FloatArray,
    between: FloatArray | None = None,
) -> Comparison:
    """Compare a performance with the takes, the first of which gives the clock.

    What one take does is right: each deviation is from the take nearest to it, after what another body does
    differently throughout is taken out; ``between`` (9,) rad is what bodies differ by.
    """
    alignment = align(references[0], performance, tempo, weights)
    pairs = _pair_poses(references[0], performance, alignment.frames, weights)
    offset = estimate_offset(references[0], performance, pairs, between)
    bare = take_out(performance, offset)
    deviations = compute_deviations(references[0], bare, alignment.frames, weights)
    chord = np.sqrt(deviations.squared[:, deviations.center])
    from_first = np.where(deviations.judged, 2.0 * np.arcsin(np.minimum(0.5 * chord, 1.0)), np.nan)
    for reference in references[1:]:
        its = take_out(performance, estimate_offset(reference, performance, pairs, between))
        other = compute_deviations(reference, its, alignment.frames, weights)
        deviations = choose_nearest(deviations, other)
    return Comparison(alignment, deviations, from_first, offset, bare)


_PAIRED_RATE = 10.0  # Hz: a body does not change faster
_PAIRED_S = 1.2
_TURN, _LATE = 0.05, 0.005  # prices of 0.1 s more or less, and of being late at all, in frames with nothing in common


def _pair_poses(reference: Working, performance: Working, frames: FloatArray, weights: FloatArray) -> IndexArray:
    """(K, 2) frames of both that resemble each other best near the line ``frames`` (T,), whoever is late."""
    step = max(1, round(performance.frame_rate / _PAIRED_RATE))
    rows = np.arange(0, performance.n_frames, step)
    reach = max(1, round(_PAIRED_S * performance.frame_rate / step))
    lags = np.arange(-reach, reach + 1)
    there = np.rint(frames[rows]).astype(np.intp)[:, None] + lags * step
    inside = (there >= 0) & (there < reference.n_frames)
    near = np.clip(there, 0, reference.n_frames - 1)
    shares = weights * (performance.seen[rows, None] & reference.seen[near])
    likeness = _compare_poses(performance.segments[rows, None], reference.segments[near], shares)
    cost = np.where(inside, to_cost(likeness), OUTSIDE)
    course = follow_lag(cost + _LATE * np.abs(lags), _TURN)
    pairs = np.column_stack([there[np.arange(len(rows)), course], rows])
    known: IndexArray = pairs[inside[np.arange(len(rows)), course]]
    return known


def _compare_poses(a: FloatArray, b: FloatArray, shares: FloatArray) -> FloatArray:
    """S of the spec, pose by pose, of what both show; shares (..., 9) of the segments."""
    across = (a[..., 2] + 1j * a[..., 0]) * (b[..., 2] - 1j * b[..., 0])
    total = np.abs((across * shares).sum(axis=-1)) + (a[..., 1] * b[..., 1] * shares).sum(axis=-1)
    return np.asarray(total / np.maximum(shares.sum(axis=-1), 1e-9))


def find_errors(comparison: Comparison, tolerance: Tolerance, weights: FloatArray) -> list[Finding]:
    """All errors of a performance, in order of time."""
    return explain_all(gather_evidence(comparison.deviations, tolerance.angle, tolerance.lag_s, weights))


def _learn(working: Sequence[Working], takes: Sequence[Working], tempo: str, weights: FloatArray) -> Tolerance:
    """The least tolerance with which no take has an error against the others, and a margin."""
    comparisons = []
    for number, take in enumerate(takes, start=1):
        others = [other for index, other in enumerate(working) if index != number]
        comparisons.append(compare(others, take, tempo, weights))
    steady = np.max([measure_unsteadiness(one.deviations).angle for one in comparisons], axis=0)
    tolerance = Tolerance(steady, SLACK_S)
    for comparison in comparisons:
        for _ in range(_N_ROUNDS):
            found = find_errors(comparison, tolerance, weights)
            if not found:
                break
            tolerance = widen(tolerance, found)
    margin = 1.0 + _DOUBT / len(takes)
    capped = np.minimum(tolerance.angle * margin, _MOST_ANGLE)
    return Tolerance(capped, min(tolerance.lag_s * margin, _MOST_LAG_S))


_WIDER = 1.2


def widen(tolerance: Tolerance, found: Sequence[Finding]) -> Tolerance:
    """A little more tolerance of what was found: time for shifts, angles of the segments for the rest."""
    angle, lag_s = tolerance.angle.copy(), tolerance.lag_s
    for finding in found:
        if finding.kind == "shift":
            lag_s = max(lag_s, tolerance.lag_s * _WIDER, abs(finding.lag_s or 0.0))
        else:
            segments = list(finding.segments)
            angle[segments] = tolerance.angle[segments] * _WIDER
    return Tolerance(angle, lag_s)
