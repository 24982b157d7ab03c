"""Rotations between two bodies: the yaw by complex correlation, and the constant offset of each segment.

Source of the yaw: Yamane and Shakunaga, eq. 3 to 7. The horizontal part of a vector is the complex number
``h = z + j x`` (Y is up here, Z in the paper), so that multiplying by ``exp(j theta)`` turns it by theta about +Y,
right-handed.

Neutral posture, proportions, the tilt of a sensor and the definition of a front turn each segment by the same angle at
every moment. This offset is estimated over the whole performance, so that errors in less than half of the time do not
bend it, and removed before deviations are measured, as far as bodies differ.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dousa.arrays import FloatArray, IndexArray, iterate_blocks
from dousa.errors import OptionError
from dousa.evaluation.posture.posture import LIMBS, SEGMENTS, PostureSequence, Working, check_segments, check_weights
from dousa.motion import rotations

ComplexArray = NDArray[np.complex128]
WRONG_CHORD = 0.35
"""Chord between unit vectors (20 degrees) from which a segment loses its say in a common yaw."""

# By definition all segments, and all but one limb: one wrong limb leaves one of these columns untouched.
_WITHOUT_LIMB = np.ones((len(SEGMENTS), 1 + len(LIMBS)))

for _column, _limb in enumerate(LIMBS.values(), start=1):
    _WITHOUT_LIMB[_limb, _column] = 0.0


def get_horizontal(segments: FloatArray) -> ComplexArray:
    """(..., 9) horizontal parts of (..., 9, 3) vectors as complex numbers: eq. 3 with Y up."""
    return segments[..., 2] + 1j * segments[..., 0]


def compute_complex_correlation(
    a: ArrayLike, b: ArrayLike, normalisation: str = "pose", weights: ArrayLike | None = None
) -> ComplexArray:
    """Compute the complex correlation of the horizontal parts of two postures.

    Parameters
    ----------
    a, b : (..., 9, 3) unit vectors, Y up; leading axes broadcast.
    normalisation : ``"pose"`` divides the sum once, by the norms of the whole poses; ``"segment"`` divides each
        term by its own lengths, as eq. 5 is printed.
    weights : (9,) or (..., 9) of the segments, 0 or above; None for equal ones.

    Returns
    -------
    (...) complex; the modulus is the similarity in the plane, 0 to 1, the argument the angle about +Y that
    turns b onto a. 0 where a posture has no horizontal part.

    Raises
    ------
    InvalidMotionError : wrong shapes or missing values.
    OptionError : an unknown normalisation, or wrong weights.

    Source: Yamane and Shakunaga, eq. 5 and 6. Dividing each term makes a pure phase of every segment, so that
    nearly vertical segments vote with their noise; hence ``"pose"`` is the default. The printed sum of phases is
    divided by the sum of weights, so that both readings end at 1.
    """
    first, second = get_horizontal(check_segments(a, "a")), get_horizontal(check_segments(b, "b"))
    shares = check_weights(weights)
    products = first * second.conj()
    if normalisation == "segment":
        size = np.abs(products)
        phases = np.divide(products, size, out=np.zeros_like(products), where=size > 0)
        return np.asarray((phases * shares).sum(axis=-1) / shares.sum(axis=-1))
    if normalisation != "pose":
        raise OptionError("postures.normalisation", normalisation=normalisation)
    total = np.asarray((products * shares).sum(axis=-1))
    power = (np.abs(first) ** 2 * shares).sum(axis=-1) * (np.abs(second) ** 2 * shares).sum(axis=-1)
    return np.asarray(np.divide(total, np.sqrt(power), out=np.zeros_like(total), where=power > 0))


def estimate_yaw(
    a: ArrayLike, b: ArrayLike, normalisation: str = "pose", weights: ArrayLike | None = None
) -> FloatArray:
    """Estimate the angle about the vertical that turns one posture onto another.

    Parameters
    ----------
    a, b, normalisation, weights : as in `compute_complex_correlation`.

    Returns
    -------
    (...) rad, -pi to pi, about +Y, right-handed: ``rotate_yaw(b, angle)`` faces like a. 0 where it cannot be known.

    Raises
    ------
    InvalidMotionError, OptionError : as in `compute_complex_correlation`.

    Source: Yamane and Shakunaga, eq. 7.
    """
    return np.angle(compute_complex_correlation(a, b, normalisation, weights))


def estimate_robust_yaw(
    a: ArrayLike, b: ArrayLike, weights: ArrayLike | None = None, n_rounds: int = 6
) -> tuple[FloatArray, FloatArray]:
    """Estimate the same angle robustly against one wrong limb.

    Six starts (all segments, and all but one limb) compete; the one that leaves most segments in place is
    refined: segments far off lose weight, the angle is estimated again, and so on.

    Parameters
    ----------
    a, b : (..., 9, 3) unit vectors, Y up; leading axes broadcast.
    weights : (9,) or (..., 9) of the segments, 0 or above; None for equal ones.
    n_rounds : of re-weighting, 0 or more.

    Returns
    -------
    theta : (...) rad, -pi to pi, turns b onto a.
    trust : (..., 9) the given weights times 0 (far off) to 1 (in place).

    Raises
    ------
    InvalidMotionError, OptionError : as in `compute_complex_correlation`; a negative number of rounds.

    Not in the paper. Weights are those of Geman and McClure's estimator, scale 20 degrees.
    """
    if n_rounds < 0:
        raise OptionError("postures.n_rounds", n_rounds=n_rounds)
    first, second = check_segments(a, "a"), check_segments(b, "b")
    shares = check_weights(weights)
    products = get_horizontal(first) * get_horizontal(second).conj()
    # Squared chord of each segment after turning by theta: fixed - 2 Re(product exp(-j theta)).
    fixed = (first * first).sum(axis=-1) + (second * second).sum(axis=-1)
    fixed -= 2.0 * first[..., 1] * second[..., 1]
    turns = _unit((products * shares) @ _WITHOUT_LIMB)
    costs = np.stack(
        [(_far(products, fixed, turns[..., k]) * shares).sum(axis=-1) for k in range(turns.shape[-1])],
        axis=-1,
    )
    best = costs.argmin(axis=-1)
    turn = np.take_along_axis(turns, best[..., None], axis=-1)[..., 0]
    for _ in range(n_rounds):
        trust = shares * (1.0 - _far(products, fixed, turn)) ** 2
        turn = _unit((products * trust).sum(axis=-1))
    trust = shares * (1.0 - _far(products, fixed, turn)) ** 2
    return np.angle(turn), trust


def _unit(values: ComplexArray) -> ComplexArray:
    """Values of modulus 1; 1 where there is no direction."""
    size = np.abs(values)
    return np.divide(values, size, out=np.ones_like(values), where=size > 0)


def _far(products: ComplexArray, fixed: FloatArray, turn: ComplexArray) -> FloatArray:
    """How far off each segment is after a turn: 0 in place to 1 anywhere."""
    across = turn[..., None]
    squared = fixed - 2.0 * (products.real * across.real + products.imag * across.imag)
    squared = np.maximum(squared, 0.0)
    far: FloatArray = squared / (squared + WRONG_CHORD**2)
    return far


def rotate_yaw(segments: ArrayLike, theta: ArrayLike) -> FloatArray:
    """Turn postures (..., 9, 3) about the vertical by theta (...) rad about +Y, right-handed; shapes broadcast.

    Raises InvalidMotionError for wrong shapes or missing values.
    """
    vectors = check_segments(segments, "segments")
    angle = np.asarray(theta, np.float64)[..., None]
    cosine, sine = np.cos(angle), np.sin(angle)
    x, y, z = vectors[..., 0], vectors[..., 1], vectors[..., 2]
    turned_x = x * cosine + z * sine
    return np.stack([turned_x, np.broadcast_to(y, turned_x.shape), z * cosine - x * sine], axis=-1)


BETWEEN_DEG = np.array([3.5, 9.0, 9.5, 9.0, 9.5, 6.0, 5.5, 6.0, 5.5])
"""(9,) deg, root mean square of the offsets between people who do the same thing, beyond those between takes of one
person. Chosen by hand, left as right: within 2.5 deg of the medians that lab/training/body_offsets.py prints for
HDM05 (bd, bk) and UTD-MHAD (s1, s3, s5), between which they lie; five people do not say it more exactly."""

WITHIN_DEG = np.array([2.5, 4.5, 5.0, 4.5, 5.0, 2.5, 3.0, 2.5, 3.0])
"""(9,) deg, the same between two takes of one person that last `WITHIN_S`: what a short clip leaves open. Chosen by
hand, within 1 deg of the root mean squares that lab/training/body_offsets.py prints for both sets."""

WITHIN_S = 2.5  # see docs/evaluation.md


_N_YAWS, _N_ROUNDS = 2, 5
_MOST_MOMENTS = 1500  # that an offset is estimated from, see docs/evaluation.md


@dataclass(frozen=True, slots=True, eq=False)
class Offset:
    """How another body stands, against the reference, throughout."""

    # (9, 3) rad, rotation vectors in the performer's own frame (x to the own back, y up, z to the left) that turn
    # the reference's segments onto the performer's
    measured: FloatArray
    taken: FloatArray  # (9, 3) the part of them that is laid to the body, and taken out
    seconds: FloatArray  # (9,) s, of the performance, that the estimate rests on
    # (9,) parts that one of the two does not show, or does in another position throughout (sitting): not judged
    missing: NDArray[np.bool_]

    @property
    def degrees(self) -> FloatArray:
        """(9,) size of what is taken out."""
        return np.asarray(np.degrees(np.linalg.norm(self.taken, axis=1)))


def make_no_offset() -> Offset:
    """Make the offset of the same body."""
    return Offset(np.zeros((9, 3)), np.zeros((9, 3)), np.zeros(9), np.zeros(9, np.bool_))


def estimate_offset(
    reference: Working, performance: Working, pairs: IndexArray, between: FloatArray | None = None
) -> Offset:
    """Estimate the offset of another body from moments that correspond.

    Parameters
    ----------
    reference, performance : at the same working rate.
    pairs : (K, 2) frames of reference and performance that correspond.
    between : (9,) rad, root mean square of what bodies differ by; None for `BETWEEN_DEG`.
    """
    if not len(pairs):
        return make_no_offset()
    theirs, ours = pairs[:: max(1, len(pairs) // _MOST_MOMENTS)].T
    span = float(ours[-1] - ours[0] + 1)
    rate = performance.frame_rate * len(ours) / span  # of the moments that are looked at
    judged = reference.seen[theirs] & performance.seen[ours]
    heading = np.nan_to_num(performance.heading[ours])
    a, b = reference.segments[theirs], performance.segments[ours]
    measured, seconds = measure_offset(a, b, judged, heading, rate)
    missing = find_missing(reference, performance)
    shown = ~missing & (seconds > 0.0)
    tilt = find_tilt(measured, shown)
    # A short clip hardly tells a body from a take.
    noise = np.radians(WITHIN_DEG) ** 2 * WITHIN_S / np.maximum(seconds, 1e-6)
    spread = np.radians(BETWEEN_DEG) if between is None else between
    sure = spread**2 / (spread**2 + noise)
    taken = tilt * sure.min(initial=1.0, where=shown) + _limit(measured - tilt, spread) * sure[:, None]
    taken[~shown] = 0.0
    return Offset(measured, taken, seconds, missing)


def find_tilt(measured: FloatArray, shown: NDArray[np.bool_], *, tilt_deg: float = 5.0) -> FloatArray:
    """(1, 3) rad, the tilt that all segments (9,) which are shown have in common: of a sensor, not of a body."""
    # tilt_deg: of a sensor against the vertical, at most
    common = np.median(measured[shown], axis=0) * (1.0, 0.0, 1.0) if shown.any() else np.zeros(3)
    return _limit(common[None], np.radians([tilt_deg]))


def _limit(vectors: FloatArray, spread: FloatArray, *, limit: float = 1.6, soft: float = 4.0) -> FloatArray:
    """(n, 3) vectors as far as bodies with this (n,) root mean square make them: small ones whole."""
    # limit: of the root mean square: one body in twelve differs more; soft: how suddenly the limit sets in
    size = np.linalg.norm(vectors, axis=1) / (limit * spread)
    return np.asarray(vectors / (1.0 + size**soft)[:, None] ** (1.0 / soft))


def learn_between(measured: Sequence[Offset], *, prior_takes: float = 4.0) -> FloatArray:
    """(9,) rad, root mean square of what bodies differ by, from the offsets of further takes of the reference.

    Takes of several people show more than those of one; what is known of people counts as some takes more.
    """
    # prior_takes: what is known of people counts as so many takes of the reference
    known = np.radians(BETWEEN_DEG) ** 2
    squares = [
        np.maximum((one.measured**2).sum(axis=1) - np.radians(WITHIN_DEG) ** 2, 0.0) * ~one.missing for one in measured
    ]
    total = prior_takes * known + np.sum(squares, axis=0)
    return np.asarray(np.sqrt(total / (prior_takes + len(squares))))


def find_missing(
    reference: Working,
    performance: Working,
    *,
    seen: float = 0.1,
    still: float = np.radians(0.1),
    moves: float = np.radians(15.0),
    higher: float = 0.5,
) -> NDArray[np.bool_]:
    """(9,) what cannot be judged: not seen, not tracked in one of the two, or sitting against standing."""
    # seen: of the time: less says nothing of a part
    # still: no person holds a limb so still: a joint that is not tracked
    # higher: vertical part of both thighs, mostly: who sits does not stand badly
    both = (reference, performance)
    missing: NDArray[np.bool_] = np.min([one.seen.mean(axis=0) for one in both], axis=0) < seen
    reach = np.array([_measure_reach(one, 99.0) for one in both])
    missing |= (reach.min(axis=0) < still) & (reach.max(axis=0) > moves)
    legs, thighs = [*LIMBS["left_leg"], *LIMBS["right_leg"]], [LIMBS["left_leg"][0], LIMBS["right_leg"][0]]
    if missing[thighs].any():
        return missing
    height = np.array([[np.median(one.segments[one.seen[:, k], k, 1]) for k in thighs] for one in both])
    rests = np.array([_measure_reach(one, 80.0)[thighs].max() for one in both]) < moves
    # Of the two that one sits whose thighs are higher; who squats moves.
    sitting = int(height.mean(axis=1).argmax())
    if (height[sitting] - height[1 - sitting] > higher).all() and rests[sitting]:
        missing[legs] = True
    return missing


def _measure_reach(motion: Working, percent: float) -> FloatArray:
    """(9,) rad, how far each segment gets from where it mostly is, so much of the time."""
    step = max(1, motion.n_frames // _MOST_MOMENTS)
    segments, seen = motion.segments[::step], motion.seen[::step]
    if not seen.all():
        segments = np.where(seen[..., None], segments, np.nan)
        segments[:, ~seen.any(axis=0)] = 0.0  # of what is never seen
    middle = _find_median(segments)
    middle /= np.maximum(np.linalg.norm(middle, axis=1, keepdims=True), 1e-9)
    far = np.sqrt(((segments - middle) ** 2).sum(axis=2))
    reach = np.percentile(far, percent, axis=0) if seen.all() else np.nanpercentile(far, percent, axis=0)
    return np.asarray(reach * seen.any(axis=0))


def _find_median(values: FloatArray) -> FloatArray:
    """Medians along the first axis of what is known."""
    return np.asarray((np.nanmedian if np.isnan(values.sum()) else np.median)(values, axis=0))


def take_out(performance: Working, offset: Offset) -> Working:
    """Remove the offset from a performance; missing segments are marked as not seen.

    The first line of a grade and of every deviation: what is left are differences that come and go.
    """
    heading = np.nan_to_num(performance.heading)
    segments = _take_out(performance.segments, heading, offset)
    return replace(performance, segments=segments, seen=performance.seen & ~offset.missing)


def take_out_of_postures(performance: PostureSequence, working: Working, offset: Offset) -> PostureSequence:
    """Remove the offset at the full rate; positions stay. ``working`` is the same performance, thinned."""
    middle = (np.arange(working.n_frames) + 0.5) * working.stride - 0.5
    heading = np.interp(np.arange(performance.n_frames), middle, np.nan_to_num(working.heading))
    segments = _take_out(performance.segments, heading, offset)
    segments.flags.writeable = False
    return replace(performance, segments=segments, seen=performance.seen & ~offset.missing)


def take_out_of_pose(pose: FloatArray, heading: float, turns: FloatArray) -> FloatArray:
    """Remove the offset from one pose (9, 3) with a heading in rad; ``turns`` (9, 3, 3) of `find_turns`."""
    cosine, sine = math.cos(heading), math.sin(heading)
    yaw = np.array([[cosine, 0.0, sine], [0.0, 1.0, 0.0], [-sine, 0.0, cosine]])
    return np.asarray((turns @ (pose @ yaw)[..., None])[..., 0] @ yaw.T)


def find_turns(offset: Offset) -> FloatArray:
    """(9, 3, 3) rotations that take the offset out, in the performer's own frame."""
    return np.asarray(rotations.to_matrix(rotations.from_axis_angle(-offset.taken)))


def _take_out(segments: FloatArray, heading: FloatArray, offset: Offset) -> FloatArray:
    if not offset.taken.any():
        return segments.copy()
    # In the performer's own frame, in one go: turn back by the heading, the offset, and the heading again.
    turns, bare = find_turns(offset), np.empty_like(segments)
    for some in iterate_blocks(len(segments)):
        own = rotate_yaw(segments[some], -heading[some])
        bare[some] = rotate_yaw(np.einsum("sij,tsj->tsi", turns, own), heading[some])
    return bare


def measure_offset(
    reference: FloatArray,
    performance: FloatArray,
    judged: NDArray[np.bool_],
    heading: FloatArray,
    rate: float,
    *,
    yaw_window_s: float = 0.6,
) -> tuple[FloatArray, FloatArray]:
    """Measure the angle by which each segment is off at every moment.

    Reference and performance are (N, 9, 3) unit vectors of the same moments at a rate in Hz, judged (N, 9) where both
    are seen, heading (N,) rad of the performer. Returns the vectors (9, 3) rad of `Offset.measured`, and the seconds
    (9,) that they rest on: moments that are elsewhere do not count.

    Not in the paper. The start is a median, refined by re-weighting (Geman and McClure, scale 3 to 10 degrees); the
    common heading, over yaw_window_s, and the offsets are estimated in turns.
    """
    vectors, trust = np.zeros((9, 3)), judged.astype(np.float64)
    half = max(1, round(0.5 * yaw_window_s * rate))
    body = rotate_yaw(performance, -heading)
    for number in range(_N_YAWS):
        bare = turn_segments(body, -vectors)
        theirs = rotate_yaw(reference, _find_yaw(reference, bare, heading, trust, half))
        if number == 0:
            vectors = _take_median(theirs, body, judged)
        for _ in range(_N_ROUNDS):
            vectors, trust = _refine(theirs, body, judged, vectors)
    return vectors, trust.sum(axis=0) / rate


def _find_yaw(
    reference: FloatArray, performance: FloatArray, heading: FloatArray, trust: FloatArray, half: int
) -> FloatArray:
    """(N,) rad that turn the reference into the performer's frame, where ``performance`` is; changes slowly."""
    products = get_horizontal(performance) * get_horizontal(reference).conj() * trust
    turn = products.sum(axis=1) * np.exp(1j * heading)
    total = np.cumsum(np.pad(turn, (half + 1, half)))
    return np.asarray(np.angle(total[2 * half + 1 :] - total[: len(turn)]) - heading)


def _take_median(reference: FloatArray, performance: FloatArray, judged: NDArray[np.bool_]) -> FloatArray:
    """(9, 3) median over the moments of the shortest turn of each segment."""
    across = rotations.cross(reference, performance)
    sine = np.linalg.norm(across, axis=2)
    angle = np.arctan2(sine, (reference * performance).sum(axis=2))
    turns = across * (angle / np.maximum(sine, 1e-9))[..., None]
    if not judged.all():
        turns[~judged] = np.nan
        turns[:, ~judged.any(axis=0)] = 0.0
    return _find_median(turns)


def _refine(
    reference: FloatArray,
    performance: FloatArray,
    judged: NDArray[np.bool_],
    vectors: FloatArray,
    *,
    steady: float = 4.0,
    ridge: float = 0.03,
    scales_deg: tuple[float, float] = (3.0, 10.0),
) -> tuple[FloatArray, FloatArray]:
    """One round of re-weighted least squares; and (N, 9) what each moment counts."""
    # scales_deg: deviation from which a moment loses its say, at least and at most
    # steady: of the median squared deviation; ridge: of the moments: about its own axis a segment that hardly moves
    # has no offset
    turned = turn_segments(reference, vectors)
    error = performance - turned
    squared = (error**2).sum(axis=2)
    # Of a steady performer less is needed to be elsewhere.
    usual = _find_median(squared if judged.all() else np.where(judged | ~judged.any(axis=0), squared, np.nan))
    trust = judged / (1.0 + squared / np.clip(steady * usual, *np.radians(scales_deg) ** 2)) ** 2
    count = trust.sum(axis=0)
    # A small turn v moves a direction d by v x d: normal equations of sum |error - v x d|^2.
    by_segment = turned.transpose(1, 0, 2)
    spread = (by_segment * trust.T[..., None]).transpose(0, 2, 1) @ by_segment
    left = (count * (1.0 + ridge) + 1e-9)[:, None, None] * np.eye(3) - spread
    right = (rotations.cross(turned, error) * trust[..., None]).sum(axis=0) - (ridge * count)[:, None] * vectors
    return vectors + np.linalg.solve(left, right[..., None])[..., 0], trust


def turn_segments(segments: FloatArray, vectors: FloatArray) -> FloatArray:
    """Turn segments (N, 9, 3), each by its rotation vector (9, 3) rad."""
    turns = rotations.to_matrix(rotations.from_axis_angle(vectors))
    return np.asarray((segments.transpose(1, 0, 2) @ turns.transpose(0, 2, 1)).transpose(1, 0, 2))
