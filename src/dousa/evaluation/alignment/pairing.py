"""A performance and its reference on one clock: poses of the same moments, the yaw between them, the rest.

Nothing here knows of figures or weights.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import FloatArray, iterate_blocks
from dousa.evaluation.posture.posture import PostureSequence, interpolate_segments
from dousa.evaluation.posture.yaw import WRONG_CHORD, estimate_robust_yaw, get_horizontal, rotate_yaw

TurnedTake = tuple[FloatArray, NDArray[np.bool_]]
"""A further take turned onto the first (U, 9, 3), and (U,) where both are seen."""


@dataclass(frozen=True, slots=True, eq=False)
class Pairing:
    """Both motions at the same moments."""

    frames: FloatArray  # (T,) fractional frames of the reference; 0 where it has none
    inside: NDArray[np.bool_]  # (T,) whether it has one
    residual: FloatArray  # (T, 9) rad, angle between the segments, nan where not judged
    yaw: FloatArray  # (T,) rad that turns the reference onto the performance, nan where nothing is judged
    whole: NDArray[np.bool_]  # (T,) where all segments are judged
    late_frames: FloatArray  # (T,) fractional frames of the reference that are resembled
    late_yaw: FloatArray  # (T,) rad that turns those onto the performance
    takes: tuple[TurnedTake, ...]  # further takes, turned onto the first


def pair_motions(
    reference: PostureSequence,
    takes: Sequence[TurnedTake],
    performance: PostureSequence,
    same_time: FloatArray,
    matched_time: FloatArray,
) -> Pairing:
    """Compare the poses of the same moments.

    Parameters
    ----------
    reference : first take.
    takes : the further ones, from `turn_takes`.
    performance : at the same frame rate.
    same_time, matched_time : (T,) s, as in `dousa.evaluation.figures.curves.compute_curves`.
    """
    frames = _find_frames(same_time, reference)
    inside = (frames >= -0.5) & (frames <= reference.n_frames - 0.5)
    frames = np.where(inside, np.clip(frames, 0.0, reference.n_frames - 1.0), 0.0)
    judged = performance.seen & _look_up_seen(reference, frames) & inside[:, None]
    there = interpolate_segments(reference.segments, frames)
    residual, yaw = compare_poses(there, performance.segments, judged, performance.frame_rate)
    del there  # poses of the whole are held once at a time
    late = find_resembled(reference, performance, matched_time, frames, yaw)
    whole: NDArray[np.bool_] = np.all(judged, axis=1)
    return Pairing(frames, inside, residual, yaw, whole, *late, tuple(takes))


def turn_takes(first: PostureSequence, takes: Sequence[PostureSequence]) -> tuple[TurnedTake, ...]:
    """Turn further takes, on the clock of the first, onto it."""
    return tuple(_turn_take(first, take) for take in takes)


def compare_poses(
    reference: FloatArray,
    performance: FloatArray,
    judged: NDArray[np.bool_],
    frame_rate: float,
    *,
    yaw_window_s: float = 0.5,
    yaw_rounds: int = 3,
) -> tuple[FloatArray, FloatArray]:
    """Compute the angles between segments after a common yaw that changes slowly.

    Reference and performance are (T, 9, 3) poses of the same moments, judged (T, 9) where both are seen. The yaw is
    estimated yaw_rounds times over yaw_window_s. Returns the residual (T, 9) rad, nan where not judged, and the yaw
    (T,) rad that turns the reference onto the performance, nan where nothing is judged.
    """
    some: NDArray[np.bool_] = np.any(judged, axis=1)
    residual = np.full(judged.shape, np.nan)
    yaw = np.full(len(judged), np.nan)
    if not some.any():
        return residual, yaw
    half = max(0, round(0.5 * yaw_window_s * frame_rate))
    turn, weighed = np.empty(0, np.complex128), np.empty(len(judged), np.complex128)
    for number in range(yaw_rounds + 1):
        for here in iterate_blocks(len(judged)):
            ours, theirs, known = performance[here], reference[here], judged[here]
            products = get_horizontal(ours) * get_horizontal(theirs).conj()
            if number == 0:
                # Where nothing is seen the weights are 0, so that the yaw is that of the neighbours.
                shares = np.where(some[here, None], known, 1.0)
                trust = estimate_robust_yaw(ours, theirs, shares, n_rounds=0)[1] * known
            else:
                fixed = 2.0 - 2.0 * ours[..., 1] * theirs[..., 1]
                squared = np.maximum(fixed - 2.0 * (products * turn[here].conj()[:, None]).real, 0.0)
                trust = known / (1.0 + squared / WRONG_CHORD**2) ** 2
            weighed[here] = (products * trust).sum(axis=1)
        turn = smooth_turn(weighed, half)
    angle = np.angle(turn)
    for here in iterate_blocks(len(judged)):
        chord = np.linalg.norm(performance[here] - rotate_yaw(reference[here], angle[here]), axis=2)
        residual[here] = np.where(judged[here], 2.0 * np.arcsin(np.minimum(0.5 * chord, 1.0)), np.nan)
    yaw[some] = angle[some]
    return residual, yaw


def smooth_turn(values: NDArray[np.complex128], half: int) -> NDArray[np.complex128]:
    """Sum correlations over a window and scale them to modulus 1."""
    total = np.cumsum(np.pad(values, (half + 1, half)))
    summed = total[2 * half + 1 :] - total[: len(values)]
    size = np.abs(summed)
    return np.divide(summed, size, out=np.ones_like(summed), where=size > 1e-9)


def _find_frames(times: FloatArray, reference: PostureSequence, *, rounding: float = 1e-6) -> FloatArray:
    """Fractional frames; those that are whole but for rounding are whole."""
    # rounding: frames
    frames = np.asarray(times, np.float64) * reference.frame_rate
    near = np.rint(frames)
    return np.where(np.abs(frames - near) < rounding, near, frames)


def _look_up_seen(reference: PostureSequence, frames: FloatArray) -> NDArray[np.bool_]:
    """(T, 9) whether both frames that each lies between are seen."""
    low, high = np.floor(frames).astype(np.intp), np.ceil(frames).astype(np.intp)
    return reference.seen[low] & reference.seen[high]


def find_resembled(
    reference: PostureSequence,
    performance: PostureSequence,
    matched_time: FloatArray,
    frames: FloatArray,
    yaw: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """(T,) reference frames that are resembled, and (T,) rad that turn them onto the performance.

    Where nothing is resembled, those of the same time.
    """
    matched = _find_frames(matched_time, reference)
    matched = np.clip(np.where(np.isfinite(matched), matched, frames), 0.0, reference.n_frames - 1.0)
    there = interpolate_segments(reference.segments, matched)
    judged = performance.seen & _look_up_seen(reference, matched)
    found = compare_poses(there, performance.segments, judged, performance.frame_rate)[1]
    known = np.isfinite(found)
    return np.where(known, matched, frames), np.where(known, found, yaw)


def _turn_take(first: PostureSequence, take: PostureSequence) -> tuple[FloatArray, NDArray[np.bool_]]:
    """A further take turned onto the first (T, 9, 3), and (T,) where both are seen."""
    judged = first.seen & take.seen
    yaw = compare_poses(first.segments, take.segments, judged, first.frame_rate)[1]
    return rotate_yaw(take.segments, -np.nan_to_num(yaw)), np.all(judged, axis=1)
