"""The takes of the reference: one clock for all, and what differs between them is tolerated."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from dousa.arrays import FloatArray, IndexArray
from dousa.evaluation.alignment.dynamic_programming import follow_lag
from dousa.evaluation.alignment.lines import OUTSIDE, Alignment, align, pair_similarity, to_cost
from dousa.evaluation.errors.causes import tell_errors
from dousa.evaluation.errors.descriptors import Descriptors, choose_stride, describe_moments
from dousa.evaluation.errors.deviations import Deviations, compute_deviations, merge_takes
from dousa.evaluation.errors.evidence import Evidence, Tolerance, measure_unsteadiness
from dousa.evaluation.errors.findings import Finding
from dousa.evaluation.errors.judge import load_judge
from dousa.evaluation.grade.movement import (
    PARTS,
    Difference,
    Movement,
    compare_movements,
    describe_movement,
    find_agreement,
    find_parts,
)
from dousa.evaluation.posture.posture import PostureSequence, Working, interpolate_segments, thin_postures
from dousa.evaluation.posture.yaw import Offset, estimate_offset, find_missing, learn_between, take_out

MOST_MISMATCH, MOST_STRAYED = 0.85, 0.6
"""Along the lines (0 to 1), and share of all movement: motions that differ more have nothing in common."""


@dataclass(frozen=True, slots=True, eq=False)
class ReferenceTakes:
    """Takes of the reference on the clock of the first."""

    postures: PostureSequence  # of the first take, at the performance's rate
    # of the first take and of each further one that is like it, at the working rate, warped onto the first
    working: tuple[Working, ...]
    warped: tuple[PostureSequence, ...]  # the further ones at the full rate, warped onto the first
    # (U,) frame of the first take at the working rate that belongs to each frame of ``working``: the takes are put on
    # the clock that most of them keep, not on the first one's own
    clock: FloatArray
    time_spread: FloatArray  # (U,) s, how much the takes' timing differs there
    between: FloatArray  # (9,) rad, root mean square of what bodies differ by
    movements: tuple[Movement, ...]  # of all takes, those left out too
    agreement: FloatArray  # (12,) rad, how much their postures differ, see `find_agreement`
    tempo: str  # ``"same"`` or ``"free"``
    left_out: tuple[int, ...] = ()  # numbers, from 1, of takes that are not like the first


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """How a performance compares with the reference."""

    alignment: Alignment  # lines
    deviations: Deviations  # from the nearest take
    offset: Offset  # of the performer's body against the first take's, taken out of all of them
    movement: tuple[Difference, ...] = ()  # from each take of the reference: what the grade is made of


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
    # Takes without common timing are takes all the same: what counts is whether they make the same movement.
    movements = tuple(describe_movement(take) for take in takes)
    apart = [compare_movements(*pair) for pair in combinations(movements, 2)]  # the first pairs are with the first take
    agreement = find_agreement(apart)
    strayed = [find_parts([one], agreement, weights)[PARTS.index("strayed")] for one in apart[: len(unwarped)]]
    like = [
        i
        for i, (one, share) in enumerate(zip(alone, strayed, strict=True))
        if one.alignment.mismatch <= MOST_MISMATCH and share <= MOST_STRAYED
    ]
    paths = [_follow_take(first, takes[i + 1], weights) for i in like]
    warped = tuple(_warp(first, takes[i + 1], path) for i, path in zip(like, paths, strict=True))
    working, common, time_spread = _keep_common_clock((*clock, *(thin_postures(take) for take in warped)), first, paths)
    left_out = tuple(i + 2 for i in range(len(unwarped)) if i not in like)
    between = learn_between([alone[i].offset for i in like])
    return ReferenceTakes(first, working, warped, common, time_spread, between, movements, agreement, tempo, left_out)


def _follow_take(first: PostureSequence, take: PostureSequence, weights: FloatArray) -> FloatArray:
    """(U,) frame of a take at each frame of the first, by the curve of best correspondence."""
    from dousa.evaluation.alignment.correspondence import find_path

    path = find_path(first.segments, take.segments, weights=weights)
    count = np.bincount(path[:, 0], minlength=first.n_frames)
    return np.bincount(path[:, 0], weights=path[:, 1], minlength=first.n_frames) / np.maximum(count, 1)


def _warp(first: PostureSequence, take: PostureSequence, frames: FloatArray) -> PostureSequence:
    """A take on the clock of the first; ``frames`` (U,) are its own."""
    nearest = np.rint(frames).astype(np.intp)
    return PostureSequence(
        interpolate_segments(take.segments, frames),
        take.seen[nearest],
        take.positions[nearest],
        first.frame_rate,
        take.name,
    )


def _keep_common_clock(
    working: tuple[Working, ...],
    first: PostureSequence,
    paths: Sequence[FloatArray],
    *,
    most_apart_s: float = 0.4,
    clock_s: float = 0.4,
) -> tuple[tuple[Working, ...], FloatArray, FloatArray]:
    """Takes, warped onto the first, on the clock that most of them keep; see `ReferenceTakes`.

    A held pose tells no time: there the clock is carried on from the movement around it.
    """
    # most_apart_s: of takes at one moment: more is a slip of the curve; clock_s: over which the common clock is
    # averaged
    clock = working[0]
    count, rate = clock.n_frames, clock.frame_rate
    own = np.arange(float(count))
    if not paths:
        return working, own, np.zeros(count)
    frames = np.arange(count) * clock.stride + 0.5 * (clock.stride - 1)
    late = np.array([np.interp(frames, np.arange(first.n_frames), path) - frames for path in paths]) / first.frame_rate
    late -= np.median(late, axis=1, keepdims=True)
    speed = np.linalg.norm(np.gradient(clock.segments, axis=0), axis=2).sum(axis=1) if count > 1 else np.zeros(count)
    kernel = np.hanning(2 * max(1, round(clock_s * rate)) + 1)
    kernel /= kernel.sum()
    weight = speed + 0.05 * max(float(speed.mean()), 1e-6)
    late = np.clip(late, -most_apart_s, most_apart_s)
    smooth = np.array([_average(one * weight, kernel) / _average(weight, kernel) for one in late])
    all_takes = np.concatenate([np.zeros((1, count)), smooth])
    common = np.median(all_takes, axis=0)
    spread = np.abs(all_takes - common).mean(axis=0)
    on_clock = np.maximum.accumulate(own + common * rate + 1e-6 * own)
    back = np.interp(own, on_clock, own)
    near = np.clip(np.rint(back).astype(np.intp), 0, count - 1)
    moved = tuple(
        replace(
            take,
            segments=interpolate_segments(take.segments, back),
            seen=take.seen[near],
            heading=np.interp(back, own, take.heading),
        )
        for take in working
    )
    return moved, back, np.interp(back, own, spread)


def _average(values: FloatArray, kernel: FloatArray) -> FloatArray:
    half = len(kernel) // 2
    return np.convolve(np.pad(values, half, mode="edge"), kernel, mode="valid")


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
    missing = find_missing(references[0], performance)
    if missing.any() and (weights * ~missing).any():
        weights = weights * ~missing
        performance = replace(performance, seen=performance.seen & ~missing)
    alignment = align(references[0], performance, tempo, weights)
    pairs = _pair_poses(references[0], performance, alignment.frames, weights)
    bodies = [estimate_offset(reference, performance, pairs, between) for reference in references]
    takes = (
        compute_deviations(reference, take_out(performance, body), alignment.frames, weights)
        for reference, body in zip(references, bodies, strict=True)
    )
    return Comparison(alignment, merge_takes(takes), bodies[0])


_TURN, _LATE = 0.05, 0.005  # prices of 0.1 s more or less, and of being late at all, in frames with nothing in common


def _pair_poses(
    reference: Working,
    performance: Working,
    frames: FloatArray,
    weights: FloatArray,
    *,
    paired_rate: float = 10.0,
    paired_s: float = 1.2,
    at_once: int = 512,
) -> IndexArray:
    """(K, 2) frames of both that resemble each other best near the line ``frames`` (T,), at any lag."""
    # paired_rate: Hz: a body does not change faster; at_once: rows: their memory
    step = max(1, round(performance.frame_rate / paired_rate))
    rows = np.arange(0, performance.n_frames, step)
    reach = max(1, round(paired_s * performance.frame_rate / step))
    lags = np.arange(-reach, reach + 1)
    there = np.rint(frames[rows]).astype(np.intp)[:, None] + lags * step
    inside = (there >= 0) & (there < reference.n_frames)
    near = np.clip(there, 0, reference.n_frames - 1)
    cost = np.empty(near.shape)
    for first in range(0, len(rows), at_once):
        part = slice(first, first + at_once)
        ours, theirs = rows[part, None], near[part]
        shares = weights * (performance.seen[ours] & reference.seen[theirs])
        likeness = pair_similarity(performance.segments[ours], reference.segments[theirs], shares)
        cost[part] = np.where(inside[part], to_cost(likeness), OUTSIDE)
    course = follow_lag(cost + _LATE * np.abs(lags), _TURN)
    pairs = np.column_stack([there[np.arange(len(rows)), course], rows])
    known: IndexArray = pairs[inside[np.arange(len(rows)), course]]
    return known


def choose_tolerance(deviations: Deviations, *, wider_by_spread: float = 2.0) -> Tolerance:
    """Choose the tolerance from the performer's steadiness and the spread of the takes."""
    own = measure_unsteadiness(deviations)
    if not deviations.spread.any():
        return own
    return Tolerance(np.maximum(own.angle, wider_by_spread * np.median(deviations.spread, axis=0)), own.lag_s)


def describe(
    references: ReferenceTakes,
    frames: FloatArray,
    evidence: Evidence,
    wanted: slice = slice(None),
    before: FloatArray | None = None,
) -> Iterator[Descriptors]:
    """Describe a performance along reference frames (T,) for the judge, some moments at a time.

    ``wanted`` are the moments to describe, ``before`` is what was usual earlier, see `describe_moments`.
    """
    time_spread = spread_in_time(references, frames)
    return describe_moments(evidence, time_spread, len(references.working), wanted=wanted, before=before)


def spread_in_time(references: ReferenceTakes, frames: FloatArray) -> FloatArray:
    """(T,) s, how much the timing of the takes differs at reference frames (T,)."""
    return np.interp(frames, np.arange(len(references.time_spread)), references.time_spread)


def find_errors(references: ReferenceTakes, frames: FloatArray, evidence: Evidence) -> list[Finding]:
    """Find all errors of a performance along reference frames (T,), in order of time."""
    stride = choose_stride(evidence.rate)
    suspects = load_judge().find(describe(references, frames, evidence), evidence.rate / stride)
    return tell_errors(evidence, suspects, np.arange(0, len(frames), stride), spread_in_time(references, frames))
