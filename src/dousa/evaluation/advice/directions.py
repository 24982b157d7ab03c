"""Corrections of limbs: direction (higher, further forward, more bent) and amount, in the dancer's body frame.

Each direction is a rotation of the limb by one angle over all moments looked at. The rotation that brings the limb
nearest to the reference's has a closed form, and so has the share of the difference that it removes. A direction is
reported only if this share is large.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import FloatArray
from dousa.evaluation.alignment.pairing import smooth_turn
from dousa.evaluation.posture.posture import LIMBS, SEGMENTS, PostureSequence, interpolate_segments
from dousa.evaluation.posture.yaw import WRONG_CHORD, ComplexArray, get_horizontal, rotate_yaw
from dousa.evaluation.words import say_correction
from dousa.messages import Message
from dousa.motion import JOINT_INDEX as J


@dataclass(frozen=True, slots=True, eq=False)
class PosePairs:
    """Poses of the same moments in the reference's body frame: x to its left, y up, z to its front."""

    ours: FloatArray  # (N, 9, 3) unit vectors of the performance, turned onto the reference
    theirs: FloatArray  # (N, 9, 3) of the reference
    judged: NDArray[np.bool_]  # (N, 9) whether both are seen, and the moment has a place in the reference
    times: FloatArray  # (N,) s of the performance
    reference_times: FloatArray  # (N,) s of the reference; nan where it has none
    frame_rate: float  # Hz

    @property
    def angles(self) -> FloatArray:
        """(N, 9) rad between both; 0 where not judged."""
        chord = np.linalg.norm(self.ours - self.theirs, axis=2)
        return np.where(self.judged, 2.0 * np.arcsin(np.minimum(0.5 * chord, 1.0)), 0.0)

    def cut(self, start_s: float, end_s: float) -> PosePairs:
        """Cut out the moments of a span of the performance, at least one."""
        last = len(self.times) - 1
        first = int(np.clip(np.searchsorted(self.times, start_s), 0, last))
        end = int(np.clip(np.searchsorted(self.times, end_s, "right"), first + 1, last + 1))
        return self._slice(slice(first, end))

    def find_worst(self, segments: list[int], *, sustained_s: float = 0.4) -> PosePairs:
        """Find the moments around the one where these segments are farthest off for some time (0.4 s)."""
        half = max(0, round(0.5 * sustained_s * self.frame_rate))
        off = (self.angles[:, segments] ** 2).sum(axis=1)
        total = np.cumsum(np.pad(off, (half + 1, half)))
        middle = int(np.argmax(total[2 * half + 1 :] - total[: len(off)]))
        return self._slice(slice(max(middle - half, 0), middle + half + 1))

    def _slice(self, span: slice) -> PosePairs:
        return PosePairs(
            self.ours[span],
            self.theirs[span],
            self.judged[span],
            self.times[span],
            self.reference_times[span],
            self.frame_rate,
        )


class PairedDancers:
    """A performance and its reference, of which the poses of any span can be had.

    Parameters
    ----------
    reference, performance : at one frame rate.
    same_time : (T,) s, reference time of each frame of the performance; nan where it has none.
    first_s : performance time of the first frame.
    """

    def __init__(
        self, reference: PostureSequence, performance: PostureSequence, same_time: FloatArray, first_s: float = 0.0
    ) -> None:
        self._reference, self._performance = reference, performance
        self._same_time, self._first_s = same_time, first_s

    def pair(self, start_s: float, end_s: float, *, margin_s: float = 0.5) -> PosePairs | None:
        """Pair the poses of a span of the performance; None if nothing of it is judged."""
        rate, count = self._performance.frame_rate, self._performance.n_frames
        if not (np.isfinite(start_s) and np.isfinite(end_s)) or count == 0:
            return None
        first = int(np.clip(np.floor((start_s - self._first_s - margin_s) * rate), 0, count - 1))
        last = int(np.clip(np.ceil((end_s - self._first_s + margin_s) * rate) + 1, first + 1, count))
        found = self._pair(slice(first, last)).cut(start_s, end_s)
        return found if found.judged.any() else None

    def _pair(self, span: slice, *, yaw_s: float = 0.5) -> PosePairs:
        # yaw_s: s that the yaw is averaged over
        rate, reference = self._performance.frame_rate, self._reference
        there = np.asarray(self._same_time[span], np.float64)
        inside = np.isfinite(there)
        frames = np.clip(np.where(inside, there, 0.0) * reference.frame_rate, 0.0, reference.n_frames - 1.0)
        seen = reference.seen[np.floor(frames).astype(np.intp)] & reference.seen[np.ceil(frames).astype(np.intp)]
        judged = self._performance.seen[span] & seen & inside[:, None]
        theirs, ours = interpolate_segments(reference.segments, frames), self._performance.segments[span]
        lines = _find_lines(reference.positions[np.rint(frames).astype(np.intp)])
        own = _find_lines(self._performance.positions[span])
        half = max(0, round(0.5 * yaw_s * rate))
        yaw = _estimate_yaw(ours, theirs, own, lines, judged, half)
        # A line from right to left points a quarter turn to the left of where the body faces.
        front = np.angle(smooth_turn(lines.sum(axis=1) * inside, half)) - 0.5 * np.pi
        times = self._first_s + np.arange(span.start, span.stop) / rate
        return PosePairs(rotate_yaw(ours, -yaw - front), rotate_yaw(theirs, -front), judged, times, there, rate)


def _find_lines(positions: FloatArray) -> ComplexArray:
    """(N, 2) horizontal parts of the lines through both hips and through both shoulders, of length 1, to the left."""
    across = [positions[:, J[f"left_{name}"]] - positions[:, J[f"right_{name}"]] for name in ("hip", "shoulder")]
    found: ComplexArray = np.stack([one[:, 2] + 1j * one[:, 0] for one in across], axis=1)
    size = np.abs(found)
    return np.divide(found, size, out=np.zeros_like(found), where=np.isfinite(size) & (size > 1e-6))


def _estimate_yaw(
    ours: FloatArray,
    theirs: FloatArray,
    own_lines: ComplexArray,
    lines: ComplexArray,
    judged: NDArray[np.bool_],
    half: int,
    *,
    rounds: int = 4,
) -> FloatArray:
    """(N,) rad that turns the reference onto the performance.

    If a person stands upright with the arms out, the segments alone do not show which of both arms is wrong;
    hips and shoulders do. So the estimate begins with these, and segments that are far off lose weight.
    """
    straight = (own_lines * lines.conj()).sum(axis=1)
    products = get_horizontal(ours) * get_horizontal(theirs).conj()
    fixed = 2.0 - 2.0 * ours[..., 1] * theirs[..., 1]
    turn = smooth_turn(straight, half)
    for _ in range(rounds):
        squared = np.maximum(fixed - 2.0 * (products * turn.conj()[:, None]).real, 0.0)
        trust = judged / (1.0 + squared / WRONG_CHORD**2) ** 2
        turn = smooth_turn((products * trust).sum(axis=1) + straight, half)
    return np.angle(turn)


_ALIKE_DEG, _ALIKE_SHARE = 10.0, 0.35  # amounts of left and right that are said as one
_UP, _FRONT, _LEFT = np.eye(3)[1], np.eye(3)[2], np.eye(3)[0]

OPPOSITES: dict[str, str] = {
    "up": "down",
    "forward": "back",
    "outward": "inward",
    "bend": "straighten",
    "lean_forward": "lean_back",
    "lean_left": "lean_right",
}
"""Directions and what a negative amount of them is; besides them there is ``upright``."""


@dataclass(frozen=True, slots=True)
class Correction:
    """One thing to do differently.

    Parameters
    ----------
    segments : what is to be moved.
    direction : ``up``, ``down``, ``forward``, ``back``, ``outward``, ``inward`` (of a limb), ``bend``, ``straighten``
        (of elbow or knee), ``lean_forward``, ``lean_back``, ``lean_left``, ``lean_right``, ``upright`` (of the trunk).
    amount_deg : how far, above 0.
    gain : what it takes away of the squared distance to the reference, summed over segments, mean over moments.
    """

    segments: tuple[str, ...]
    direction: str
    amount_deg: float
    gain: float

    @property
    def message(self) -> Message:
        """The correction, without its moment: ``raise the left arm 25 deg higher``."""
        return say_correction(self.direction, self.segments, self.amount_deg)


@dataclass(frozen=True, slots=True)
class _Fit:
    direction: str
    members: tuple[int, ...]
    angle: float
    share: float
    gain: float


def find_corrections(
    pairs: PosePairs, segments: Iterable[str], *, least_together: float = 0.4, minor: float = 0.4, most: int = 2
) -> tuple[Correction, ...]:
    """Find the corrections at some moments, the largest first; none where no direction dominates.

    Pairs are the moments, such as those around the worst one; segments are the wrong ones of `SEGMENTS`. The
    corrections must together remove least_together of the difference of all wrong limbs; those below minor times the
    largest are left out, and most of them remain at most. The same correction of a left and a right limb is one of
    both. Not in the paper.
    """
    wrong = {SEGMENTS.index(name) for name in segments}
    known = np.all(pairs.judged[:, sorted(wrong)], axis=1) if wrong else np.zeros(len(pairs.times), np.bool_)
    if not known.any():
        return ()
    ours, theirs = pairs.ours[known], pairs.theirs[known]
    found: list[_Fit] = []
    total = 0.0
    for name, limb in LIMBS.items():
        members = tuple(index for index in limb if index in wrong)
        if not members:
            continue
        total += _measure_gap(ours, theirs, members)
        whole = bool(pairs.judged[known][:, list(limb)].all())
        fit = _fit_trunk(ours, theirs) if name == "trunk" else _fit_limb(ours, theirs, limb, members, name, whole)
        if fit is not None:
            found.append(fit)
    found = [fit for fit in found if fit.gain >= minor * max(one.gain for one in found)]
    if sum(fit.gain for fit in found) < least_together * total:
        return ()
    made = [
        Correction(tuple(SEGMENTS[k] for k in one.members), one.direction, float(np.degrees(one.angle)), one.gain)
        for one in found
    ]
    return tuple(sorted(_join_sides(made), key=lambda one: -one.gain)[:most])


def _measure_gap(ours: FloatArray, theirs: FloatArray, members: Iterable[int]) -> float:
    """Half the squared chord, summed over the members, mean over the moments."""
    columns = list(members)
    return float((1.0 - (ours[:, columns] * theirs[:, columns]).sum(axis=2)).sum(axis=1).mean())


def _rotate(
    ours: FloatArray, theirs: FloatArray, turns: Iterable[tuple[int, FloatArray]], gap: float
) -> tuple[float, float]:
    """The angle about the given axes that brings segments nearest to the reference, and the share that it takes away.

    Rodrigues: v cos a + (k x v) sin a + k (k v)(1 - cos a); its product with the target is A cos a + B sin a + C.
    """
    along, across, fixed, before = 0.0, 0.0, 0.0, 0.0
    for index, axis in turns:
        v, t = ours[:, index], theirs[:, index]
        both = (axis * v).sum(axis=1) * (axis * t).sum(axis=1)
        dot = (v * t).sum(axis=1)
        along += float((dot - both).mean())
        across += float((np.cross(axis, v) * t).sum(axis=1).mean())
        fixed += float(both.mean())
        before += float(dot.mean())
    won = np.hypot(along, across) + fixed - before
    return float(np.arctan2(across, along)), won / max(gap, 1e-9)


def _fit_limb(
    ours: FloatArray, theirs: FloatArray, limb: tuple[int, ...], wrong: tuple[int, ...], name: str, whole: bool
) -> _Fit | None:
    """The best direction of an arm or leg, moved whole or only where it is wrong; the usual words are tried first."""
    choices = [limb, wrong] if whole and wrong != limb else [wrong]
    fits: list[_Fit] = []
    for members in choices:
        gap = _measure_gap(ours, theirs, limb if whole else members)
        if whole and members != limb[:1]:
            fits += _fit_joint(ours, theirs, limb, members, gap)
        for direction, axis in _list_axes(ours, theirs, members, 1.0 if name.startswith("left") else -1.0):
            angle, share = _rotate(ours, theirs, ((index, axis) for index in members), gap)
            if direction != "up" or _is_elevation(ours, theirs, members, angle):
                fits.append(_Fit(direction, members, angle, share, share * gap))
    return _choose(fits)


def _choose(fits: list[_Fit], *, least_share: float = 0.6, rather: float = 0.1, least_deg: float = 8.0) -> _Fit | None:
    """The one that takes most away, an earlier one if it is nearly as good; the opposite word if it is negative."""
    # least_deg: Degrees; a smaller correction is not said
    # least_share: of the difference that a direction must take away; rather: more of the difference must a direction
    # take away to be said instead of a more usual one
    most = max((fit.share for fit in fits), default=0.0)
    best = next((fit for fit in fits if fit.share >= max(least_share, most - rather)), None)
    if best is None or abs(np.degrees(best.angle)) < least_deg:
        return None
    direction = best.direction if best.angle > 0 else OPPOSITES.get(best.direction, best.direction)
    return _Fit(direction, best.members, abs(best.angle), best.share, best.gain)


def _fit_joint(
    ours: FloatArray, theirs: FloatArray, limb: tuple[int, ...], members: tuple[int, ...], gap: float
) -> Iterator[_Fit]:
    """Elbow or knee more bent: the lower segment moves, or the upper one, or both towards each other."""
    upper, lower = limb
    normal = _unit(np.cross(ours[:, upper], ours[:, lower]) + np.cross(theirs[:, upper], theirs[:, lower]))
    wanted = float(np.median(_measure_bend(theirs, limb) - _measure_bend(ours, limb)))
    ways: list[tuple[tuple[int, FloatArray], ...]] = [((lower, normal),)]
    if len(members) == 2:
        ways += [((upper, -normal), (lower, normal)), ((upper, -normal),)]
    for turns in ways:
        angle, share = _rotate(ours, theirs, turns, gap)
        if angle * wanted > 0 and abs(wanted) >= 0.5 * abs(angle):
            yield _Fit("bend", limb, wanted, share, share * gap)


def _measure_bend(poses: FloatArray, limb: tuple[int, ...]) -> FloatArray:
    """(N,) rad between upper and lower segment, 0 is straight."""
    cosine = (poses[:, limb[0]] * poses[:, limb[1]]).sum(axis=1)
    return np.asarray(np.arccos(np.clip(cosine, -1.0, 1.0)))


def _list_axes(
    ours: FloatArray,
    theirs: FloatArray,
    members: tuple[int, ...],
    side: float,
    *,
    hanging_deg: float = -60.0,
    least_across: float = 0.35,
    least_level: float = 0.1,
) -> Iterator[tuple[str, FloatArray]]:
    """Directions that a limb can go, the usual words first, with the axes (N, 3) that it turns about."""
    # least_level: horizontal part below which a limb hangs
    # least_across: sine between limb and axis of the body, below which it cannot go further that way
    # hanging_deg: elevation below which people say forward and outward rather than higher
    columns = list(members)
    limbs = ours[:, columns].sum(axis=1) + theirs[:, columns].sum(axis=1)
    mean = _unit(limbs)
    level = (limbs * [1.0, 0.0, 1.0]).mean(axis=0) / len(members)
    found: list[tuple[str, FloatArray]] = []
    if np.linalg.norm(level) >= least_level:
        axis = np.cross(level / np.linalg.norm(level), _UP)
        found.append(("up", np.tile(axis, (len(ours), 1))))
    apart = np.abs((theirs[:, columns] - ours[:, columns]).sum(axis=1).mean(axis=0))
    ways = [("forward", _FRONT), ("outward", side * _LEFT)]
    for direction, way in ways if apart[2] >= apart[0] else ways[::-1]:
        across = np.cross(mean, way)
        if np.median(np.linalg.norm(across, axis=1)) >= least_across:
            found.append((direction, _unit(across)))
    hanging = np.sin(np.radians(hanging_deg))
    if max(float(np.median(_unit(poses[:, columns].sum(axis=1))[:, 1])) for poses in (ours, theirs)) < hanging:
        found.sort(key=lambda one: one[0] == "up")
    yield from found


def _is_elevation(ours: FloatArray, theirs: FloatArray, members: tuple[int, ...], angle: float) -> bool:
    """Whether the limb rises by about this angle, and does not swing through the vertical instead."""
    columns = list(members)
    heights = [np.arcsin(np.clip(_unit(poses[:, columns].sum(axis=1))[:, 1], -1.0, 1.0)) for poses in (ours, theirs)]
    return abs(float(np.median(heights[1] - heights[0])) - angle) <= 0.35 * abs(angle)


def _fit_trunk(ours: FloatArray, theirs: FloatArray, *, upright_deg: float = 12.0) -> _Fit | None:
    # upright_deg: tilt of a trunk that is held upright
    gap = _measure_gap(ours, theirs, (0,))
    mean = _unit(ours[:, 0] + theirs[:, 0])
    fits = []
    tilt = np.degrees(np.arccos(np.clip([float(np.median(poses[:, 0, 1])) for poses in (ours, theirs)], -1.0, 1.0)))
    if tilt[1] < min(upright_deg, tilt[0]):
        angle, share = _rotate(ours, theirs, ((0, _unit(np.cross(ours[:, 0], _UP))),), gap)
        if angle > 0:
            fits.append(_Fit("upright", (0,), angle, share, share * gap))
    for direction, way in (("lean_forward", _FRONT), ("lean_left", _LEFT)):
        angle, share = _rotate(ours, theirs, ((0, _unit(np.cross(mean, way))),), gap)
        fits.append(_Fit(direction, (0,), angle, share, share * gap))
    return _choose(fits)


def _unit(vectors: FloatArray) -> FloatArray:
    """Unit vectors along the last axis; what has no length stays 0."""
    size = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.asarray(vectors / np.maximum(size, 1e-9))


def _join_sides(found: list[Correction]) -> list[Correction]:
    """The same correction of left and right is one of both."""
    joined: list[Correction] = []
    for one in found:
        twin = next((other for other in joined if _is_twin(other, one)), None)
        if twin is None:
            joined.append(one)
            continue
        segments = tuple(name for name in SEGMENTS if name in twin.segments + one.segments)
        mean = 0.5 * (twin.amount_deg + one.amount_deg)
        joined[joined.index(twin)] = Correction(segments, one.direction, mean, twin.gain + one.gain)
    return joined


def _is_twin(left: Correction, right: Correction) -> bool:
    if left.direction != right.direction or left.segments == ("trunk",):
        return False
    if tuple(name.replace("left", "right") for name in left.segments) != right.segments:
        return False
    apart, most = abs(left.amount_deg - right.amount_deg), max(left.amount_deg, right.amount_deg)
    return apart <= max(_ALIKE_DEG, _ALIKE_SHARE * most)
