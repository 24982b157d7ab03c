"""How far one movement is from another, part by part: what moves otherwise than in the reference.

A part is a line of the body: the nine segments, the lines through hips and shoulders, and the neck. A constant posture
of a part is taken off, so that build, sitting and an idle arm held elsewhere are no error; a quiet part that moves is
one, however large the movement of the others is: therapists call that compensation. Each part counts by the logarithm
of its distance above what its sensor trembles by.

Measured by ``python -m lab.trials.exercise_measures``, which has the plainer candidates and the constants beside.
"""

from __future__ import annotations

import math
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
_AROUND_S = 0.5  # before and after a moment, to move along or not: measured on UI-PRMD, docs/evaluation.md
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
    there: IndexArray  # (K,) moments of the reference
    ours: FloatArray  # (K, 12, 3) the performer's lines less what they differ by throughout; nan where not danced
    theirs: FloatArray  # (K, 12, 3) the reference's
    posture: FloatArray  # (12,) rad, what they differ by throughout
    noise: FloatArray  # (12,) rad, of both sensors and of standing still: a difference of this size is one
    spread: FloatArray  # (12,) rad, how far the reference moves
    late: FloatArray  # (U,) s, how much later than at an even tempo each moment of the reference comes
    tempo: float  # seconds of the performance for one of the reference
    asked: FloatArray  # (U, 12) rad, how far the reference moves around each of its moments, beyond noise
    danced: NDArray[np.bool_]  # (U,) moments of the reference at which the performer moved along
    moved: FloatArray  # (2, 12) rad, how much the reference moves in all, and while the performer's part is seen


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
    course = _follow(path, len(there))
    follows = np.rint(course).astype(np.intp)
    steps = np.stack([_measure_steps(reference.lines, there), _measure_steps(performance.lines, follows)]) - noise
    asked, done = np.where(np.isfinite(steps).all(axis=0), np.maximum(steps, 0.0), 0.0)
    moved, danced = (one.sum(axis=1) >= hardly * asked.sum(axis=1) for one in (done, np.minimum(done, asked)))
    half = round(_AROUND_S * RATE)
    for start, end in find_runs(~moved).tolist():
        lapsed = end - start >= lapse_s * RATE  # everybody pauses
        moved[max(start - half, 0) if lapsed else start : end + half if lapsed else end] = not lapsed
    ours, theirs = performance.lines[path[:, 0]], reference.lines[path[:, 1]]
    known = (moved | ~moved.any())[path[:, 1], None, None] & np.isfinite(ours + theirs)
    ours, theirs = (np.where(known, one, np.nan) for one in (ours, theirs))
    mean = _average(ours - theirs)
    late, tempo = _measure_lateness(course, asked.sum(axis=1))
    alone = np.nan_to_num(_measure_steps(reference.lines, there) - np.radians(STILL_DEG) - TREMBLES * reference.noise)
    alone = np.maximum(alone, 0.0)
    return Difference(
        performance.rows[path[:, 0]],
        path[:, 1],
        ours - mean,
        theirs,
        np.sqrt((mean**2).sum(axis=1)),
        noise,
        _measure_spread(reference.lines),
        late,
        tempo,
        asked,
        danced,
        np.stack([alone, alone * _find_seen(performance, half, len(alone))]).sum(axis=1),
    )


def _find_seen(performance: Movement, half: int, count: int) -> NDArray[np.bool_]:
    """(count, 12) whether each part is seen at so many moments at an even tempo, a flicker of ``2 half`` included.

    What is not seen does not tell which moments belong together, and draws them to where it is.
    """
    seen = np.isfinite(performance.lines[..., 0]) & np.isfinite(performance.noise)
    times = np.arange(len(seen))
    before, after = (seen[np.clip(times + step, 0, len(seen) - 1)] for step in (-half, half))
    even = np.rint(np.linspace(0, len(seen) - 1, count)).astype(np.intp)
    return np.asarray((seen | (before & after))[even])


def _measure_lateness(course: FloatArray, motion: FloatArray) -> tuple[FloatArray, float]:
    """(U,) s later than at the tempo that fits best where there is motion, and that tempo."""
    line = np.column_stack([np.arange(len(course)), np.ones(len(course))])
    shares = np.sqrt(motion + 1e-3 * max(float(motion.mean()), 1e-6))  # rad: a held pose tells no time
    slope = np.linalg.lstsq(line * shares[:, None], course * shares, rcond=None)[0]
    return (course - line @ slope) / RATE, max(float(slope[0]), 0.05)


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


def find_seen(differences: Sequence[Difference], weights: FloatArray) -> float:
    """Find the share of the reference's movement that is seen of the performer, 0 to 1: part by part, at its time.

    Parameters as in `find_coverage`.
    """
    shares = spread_over_parts(weights)
    moved = [one.moved @ shares for one in differences]
    return max((float(seen / total) if total > 0.0 else 1.0 for total, seen in moved), default=0.0)


def spread_over_parts(weights: FloatArray) -> FloatArray:
    """(12,) weights of the parts from (9,) of the segments."""
    return np.concatenate([weights, np.repeat(weights[:1], N_PARTS - 9)])


def find_side(
    takes: Sequence[PostureSequence], performance: PostureSequence, *, clearly: float = 0.7, strayed: float = 0.3
) -> str:
    """Find whether a performance is the mirror image of its references, ``"mirrored"``, or not, ``"same"``.

    Parameters
    ----------
    takes, performance : at one frame rate.
    clearly : ratio of the distances below which it is.
    strayed : share of the movement that is another one as it stands, if it is: no error of a limb comes to that.
    """
    references = [describe_movement(take) for take in takes]

    def compare(postures: PostureSequence) -> FloatArray:
        ours = describe_movement(postures)
        apart = [compare_movements(one, ours) for one in references]
        return find_parts(apart, find_agreement(()), np.ones(len(SEGMENTS)))

    as_it_is = compare(performance)
    if not as_it_is[PARTS.index("strayed")] > strayed:
        return "same"
    return "mirrored" if compare(mirror_postures(performance))[0] < clearly * as_it_is[0] else "same"


def find_agreement(differences: Sequence[Difference]) -> FloatArray:
    """(12,) rad, how much posture differs between references, each compared with each; ``BODIES_DEG`` of one alone."""
    usual = np.full(N_PARTS, np.radians(BODIES_DEG))
    if not differences:
        return usual
    apart = _find_quantile(np.array([one.posture for one in differences]), 0.5)
    return np.where(np.isfinite(apart), apart, usual)


PARTS: tuple[str, ...] = ("path", "range", "posture", "lag", "strayed")
"""How far the parts of the body are off their way, deg, as if no sensor trembled; by what share their range is more or
less; how far they are held otherwise throughout, in multiples of what references differ by; how unevenly late, s; the
share of all movement that was another one."""

_AGREE = 0.25  # share of the references that decide: measured by lab/trials/exercise_measures.py


def find_parts(
    differences: Sequence[Difference],
    agreement: FloatArray,
    weights: FloatArray,
    frames: NDArray[np.bool_] | None = None,
    *,
    tempo: str = "same",
    trembling: float = 0.5,
    pace_s: float = 0.2,
) -> FloatArray:
    """(5,) values of `PARTS`, 0 or above; nan where nothing is compared.

    Each part of the body is held against every reference; what a quarter of them are nearer than counts, so that no
    odd one decides.

    Parameters
    ----------
    differences : from each reference.
    agreement : (12,) of `find_agreement`.
    weights : (9,) of the segments; hips, shoulders and neck have that of the trunk.
    frames : (T,) of the working frames, those to look at; posture is not measured then.
    tempo : ``"same"``: being slower or faster counts; ``"free"``.
    trembling : of its square, taken off what was another movement.
    pace_s : lag that a tempo e times as slow counts.
    """
    logs, late, strayed = [], [], []
    parts = spread_over_parts(weights)
    for one in differences:
        here = slice(None) if frames is None else frames[np.minimum(one.rows, len(frames) - 1)]
        rows, there, ours, theirs = one.rows[here], one.there[here], one.ours[here], one.theirs[here]
        apart = _average(((ours - theirs) ** 2).sum(axis=2))
        mine, its = (  # who waits for the other is counted once
            _measure_spread(lines[np.unique(moments, return_index=True)[1]])
            for lines, moments in ((ours, rows), (theirs, there))
        )
        posture = one.posture / (one.noise + _DISAGREE * agreement)
        range_ = np.abs(np.log((mine + one.noise) / (its + one.noise)))
        logs.append([np.log1p(np.sqrt(apart) / one.noise), range_, np.log1p(posture) * (frames is None)])
        lag, motion = one.late[there], one.asked.sum(axis=1)[there] + 1e-6
        pace = pace_s * abs(np.log(one.tempo)) * (tempo == "same")
        late.append(np.sqrt((lag**2 * motion).sum() / motion.sum()) + pace if len(lag) else np.nan)
        other = np.maximum(apart - trembling * one.noise**2, 0.0)
        strayed.append(np.nansum(other * parts) / max(np.nansum((mine**2 + its**2) * parts), 1e-9))
    nearest = _find_quantile(np.array(logs).reshape(-1, 3, N_PARTS), _AGREE)
    shares = np.where(np.isfinite(nearest[0]), parts, 0.0)
    if not shares.any():
        return np.full(len(PARTS), np.nan)
    path, extent, posture = np.expm1((np.nan_to_num(nearest) * shares).sum(axis=1) / shares.sum())
    rest = _find_quantile(np.array([late, strayed]).T, _AGREE)
    return np.array([STILL_DEG * path, extent, posture, *rest])


def find_extent(
    differences: Sequence[Difference], weights: FloatArray, *, usual: float = 0.5, least: float = 0.2
) -> float:
    """Find how much moves, of which much is off: 1 for usual movements.

    Two people who do the same lie the further apart the more parts of the body move, and the further. It is the
    geometric mean of the share of the parts that move (mean over root mean square) and of how far a performer would be
    who moved without any relation to the reference.

    Parameters
    ----------
    differences, weights : as in `find_parts`.
    usual : the product of both, of usual movements.
    least : of a reference that stands still.
    """
    found = []
    for one in differences:
        shares = np.where(np.isfinite(one.spread), spread_over_parts(weights), 0.0)
        shares = shares / max(float(shares.sum()), 1e-9)
        spread = np.nan_to_num(one.spread)
        share = float(spread @ shares) / max(float(np.sqrt(spread**2 @ shares)), 1e-9)
        unrelated = np.nan_to_num(np.log1p(np.sqrt(2.0) * one.spread / one.noise)) @ shares
        found.append(np.sqrt(share * unrelated / usual))
    return float(max(np.median(found), least))


def _find_quantile(values: FloatArray, share: float) -> FloatArray:
    """What such a share over the first axis are below, of what is known; nan where nothing is."""
    rows = values.reshape(len(values), math.prod(values.shape[1:]))
    found = np.full(rows.shape[1], np.nan)
    some = np.isfinite(rows).any(axis=0)
    found[some] = np.nanquantile(rows[:, some], share, axis=0)
    return found.reshape(values.shape[1:])
