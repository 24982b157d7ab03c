"""How far one movement is from another, part by part: what moves otherwise than in the reference.

A part is a line of the body: the nine segments, the lines through hips and shoulders, and the neck. A constant posture
of a part is taken off, so that build, sitting and an idle arm held elsewhere are no error; a quiet part that moves is
one, however large the movement of the others is: therapists call that compensation. Each part counts by the logarithm
of its distance above what its sensor trembles by.

Measured by ``python -m lab.trials.exercise_measures``, which has the plainer candidates and the constants beside.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import FloatArray, IndexArray
from dousa.evaluation.alignment.correspondence import find_path
from dousa.evaluation.posture.posture import SEGMENTS, PostureSequence, mirror_postures, thin_postures
from dousa.motion.canonical.joints import JOINT_INDEX as J
from dousa.motion.runs import find_runs

_ACROSS = (
    ("right_hip", "left_hip", [5, 7]),
    ("right_shoulder", "left_shoulder", [1, 3]),
    ("neck", "head", [0]),
)  # by definition; and the segments with which they are seen
N_PARTS = 9 + len(_ACROSS)
"""By definition the segments in their order, then hips, shoulders and neck, which are parts of the trunk."""

# Measured by lab/trials/exercise_measures.py, where 8 to 30 Hz, 2 to 6 degrees and 1 to 4 times do as well.
RATE = 12.0  # Hz, at which movements are compared: measured there
STILL_DEG = 3.5  # a part that stands still differs by this from itself: measured there
TREMBLES = 2.0  # how much more a sensor drifts than it trembles from frame to frame: measured there
BODIES_DEG = 8.5  # posture by which people differ, in the median of the parts: lab/training/body_offsets.py
_AROUND_S = 0.5  # before and after a moment, in which a performer moves along or not: measured on lab/exams/exercises
_OF_RANGE = 0.3  # ten degrees matter less in a large movement than in a quiet part: measured there
_DISAGREE = 4.0  # what the references differ by counts so many times: measured there


@dataclass(frozen=True, slots=True, eq=False)
class Movement:
    """A motion at `RATE`, in the frame of the performer's own heading."""

    segments: FloatArray  # (U, 9, 3) unit vectors
    lines: FloatArray  # (U, 12, 3) unit vectors in the performer's own frame; nan where not seen
    rows: IndexArray  # (U,) frames at the working rate
    noise: FloatArray  # (12,) rad, what the sensor trembles by; nan for what is never seen


def describe_movement(postures: PostureSequence, *, heading_s: float = 0.3) -> Movement:
    """Describe a motion for `compare_movements`."""
    working = thin_postures(postures, heading_s=heading_s)
    lines = np.full((working.n_frames, N_PARTS, 3), np.nan)
    lines[:, :9] = np.where(working.seen[:, :, None], working.segments, np.nan)
    points: FloatArray = postures.positions[: working.n_frames * working.stride : working.stride]
    for number, (start, end, ends) in enumerate(_ACROSS, start=9):
        across = points[:, J[end]] - points[:, J[start]]
        across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-9)
        lines[:, number] = np.where(working.seen[:, ends].all(axis=1, keepdims=True), across, np.nan)
    turned = (lines[..., 2] + 1j * lines[..., 0]) * np.exp(-1j * np.nan_to_num(working.heading))[:, None]
    lines[..., 2], lines[..., 0] = turned.real, turned.imag
    step = max(1, round(working.frame_rate / RATE))
    rows = np.arange(0, working.n_frames, step)
    noise = np.sqrt(_average((np.diff(lines, 2, axis=0) ** 2).sum(axis=2)))
    return Movement(working.segments[rows], lines[rows], rows, noise)


def _average(values: FloatArray) -> FloatArray:
    """Mean over time of what is known; nan where nothing is."""
    known = np.isfinite(values)
    count = known.sum(axis=0)
    return np.asarray(np.where(known, values, 0.0).sum(axis=0) / np.where(count > 0, count, np.nan))


def _measure_spread(lines: FloatArray) -> FloatArray:
    """(12,) rad, root mean square about the mean direction."""
    return np.asarray(np.sqrt(_average(((lines - _average(lines)) ** 2).sum(axis=2))))


@dataclass(frozen=True, slots=True, eq=False)
class Difference:
    """A movement against one reference, along the path of best correspondence."""

    rows: IndexArray  # (K,) frames of the performance at the working rate
    path: FloatArray  # (K, 12) rad, distance of each part with the mean difference taken off; nan where not danced
    posture: FloatArray  # (12,) rad, that mean difference
    scale: FloatArray  # (12,) rad, of both sensors, of standing still and of the reference's own movement
    ranges: FloatArray  # (12,) absolute logarithm of how many times as far each part moves
    asked: FloatArray  # (U, 12) rad, how far the reference moves around each of its moments, beyond noise
    danced: NDArray[np.bool_]  # (U,) moments of the reference at which the performer moved along


def compare_movements(
    reference: Movement, performance: Movement, *, hardly: float = 0.1, lapse_s: float = 1.0
) -> Difference:
    """Compare two movements, whatever their tempo.

    Parts whose sensor trembles say little of which moments belong together. Where the performer does not move at
    all while the reference does, something was left out, which only `find_coverage` counts.

    Parameters
    ----------
    reference, performance : of `describe_movement`.
    hardly : share of the reference's movement at a moment below which it was not danced.
    lapse_s : for which the performer must not move.
    """
    noise = np.radians(STILL_DEG) + TREMBLES * np.hypot(performance.noise, reference.noise)
    shares = np.nan_to_num(noise[:9] ** -2.0)
    path = find_path(performance.segments, reference.segments, shares if shares.any() else None)
    there = np.arange(len(reference.lines))
    follows = np.rint(_follow(path, len(there))).astype(np.intp)
    steps = np.stack([_measure_steps(reference.lines, there), _measure_steps(performance.lines, follows)])
    asked, done = np.where(np.isfinite(steps).all(axis=0), np.maximum(steps - noise, 0.0), 0.0)
    moved, danced = (one.sum(axis=1) >= hardly * asked.sum(axis=1) for one in (done, np.minimum(done, asked)))
    half = round(_AROUND_S * RATE)
    for start, end in find_runs(~moved).tolist():
        lapsed = end - start >= lapse_s * RATE  # everybody pauses
        moved[max(start - half, 0) if lapsed else start : end + half if lapsed else end] = not lapsed
    ours, theirs = performance.lines[path[:, 0]], reference.lines[path[:, 1]]
    apart = np.where((moved | ~moved.any())[path[:, 1], None, None], ours - theirs, np.nan)
    known = np.where(np.isnan(apart), np.nan, 1.0)
    spreads = [
        _measure_spread((lines * known)[np.unique(frames, return_index=True)[1]]) + noise
        for lines, frames in ((ours, path[:, 0]), (theirs, path[:, 1]))
    ]
    mean = _average(apart)
    distance = np.sqrt(((apart - mean) ** 2).sum(axis=2))
    posture = np.sqrt((mean**2).sum(axis=1))
    ranges = np.abs(np.log(spreads[0] / spreads[1]))
    scale = noise + _OF_RANGE * (spreads[1] - noise)
    return Difference(performance.rows[path[:, 0]], distance, posture, scale, ranges, asked, danced)


def _follow(path: IndexArray, count: int) -> FloatArray:
    """(U,) frame of the performance at each of the reference's."""
    times = np.bincount(path[:, 1], minlength=count)
    return np.asarray(np.bincount(path[:, 1], weights=path[:, 0], minlength=count) / np.maximum(times, 1))


def _measure_steps(lines: FloatArray, frames: IndexArray) -> FloatArray:
    """(U, 12) rad, how far each part goes from half a second before to half a second after."""
    half = round(_AROUND_S * RATE)
    each = np.arange(len(frames))
    before, after = frames[np.maximum(each - half, 0)], frames[np.minimum(each + half, len(frames) - 1)]
    return np.asarray(np.sqrt(((lines[after] - lines[before]) ** 2).sum(axis=2)))


def find_coverage(differences: Sequence[Difference], weights: FloatArray) -> float:
    """Find the share of the reference's movement that the performer moved along with, 0 to 1.

    Parameters
    ----------
    differences : from each reference; the one that it goes along with most counts.
    weights : (9,) of the segments; hips, shoulders and neck have that of the trunk.
    """
    asked = [one.asked @ spread_over_parts(weights) for one in differences]
    found = [
        float(some[one.danced].sum() / some.sum()) if some.any() else 1.0
        for some, one in zip(asked, differences, strict=True)
    ]
    return max(found, default=0.0)


def spread_over_parts(weights: FloatArray) -> FloatArray:
    """(12,) weights of the parts from (9,) of the segments."""
    return np.concatenate([weights, np.repeat(weights[:1], N_PARTS - 9)])


def find_side(takes: Sequence[PostureSequence], performance: PostureSequence, *, clearly: float = 0.7) -> str:
    """Find whether a performance is the mirror image of its references, ``"mirrored"``, or not, ``"same"``.

    Parameters
    ----------
    takes, performance : at one frame rate.
    clearly : ratio of the distances below which it is.
    """
    equal, nothing = np.ones(len(SEGMENTS)), find_agreement(())
    references = [describe_movement(take) for take in takes]
    path, turned = (
        find_distances([compare_movements(one, ours) for one in references], nothing, equal)[0]
        for ours in (describe_movement(performance), describe_movement(mirror_postures(performance)))
    )
    return "mirrored" if turned < clearly * path else "same"


def find_agreement(differences: Sequence[Difference]) -> FloatArray:
    """(12,) rad, how much posture differs between references, each compared with each; ``BODIES_DEG`` of one alone."""
    usual = np.full(N_PARTS, np.radians(BODIES_DEG))
    if not differences:
        return usual
    apart = _find_median(np.array([one.posture for one in differences]))
    return np.where(np.isfinite(apart), apart, usual)


def find_distances(
    differences: Sequence[Difference],
    agreement: FloatArray,
    weights: FloatArray,
    frames: NDArray[np.bool_] | None = None,
) -> FloatArray:
    """(3,) how far a movement is from its references, 0 or above; nan where nothing is compared.

    Each part of the body is held against every reference; the median of them counts, so that no single reference
    decides.

    Parameters
    ----------
    differences : from each reference.
    agreement : (12,) of `find_agreement`.
    weights : (9,) of the segments; hips, shoulders and neck have that of the trunk.
    frames : (T,) of the working frames, those to look at; range and posture are not measured then.

    Returns
    -------
    How far parts are off their way, deg, as if no sensor trembled; by what share the range is more or less; how far
    they are held otherwise, in multiples of what the references differ by. All are geometric means over the parts.
    """
    paths, ranges, postures = [], [], []
    for one in differences:
        here = slice(None) if frames is None else frames[np.minimum(one.rows, len(frames) - 1)]
        paths.append(np.log1p(np.sqrt(_average(one.path[here] ** 2)) / one.scale))
        ranges.append(one.ranges)
        postures.append(np.log1p(one.posture / (one.scale + _DISAGREE * agreement)))
    logs = [_find_median(np.array(some)) for some in (paths, ranges, postures)]
    shares = np.where(np.isfinite(logs[0]), spread_over_parts(weights), 0.0)
    if not shares.any():
        return np.full(3, np.nan)
    path, extent, posture = (float(np.expm1((np.nan_to_num(one) * shares).sum() / shares.sum())) for one in logs)
    return np.array([STILL_DEG * path, extent, posture] if frames is None else [STILL_DEG * path, 0.0, 0.0])


def _find_median(values: FloatArray) -> FloatArray:
    """Median over the first axis of what is known; nan where nothing is."""
    known = np.isfinite(values)
    found = np.full(values.shape[1:], np.nan)
    some = known.any(axis=0)
    found[some] = np.nanmedian(values[:, some], axis=0)
    return found
