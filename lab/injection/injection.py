"""Errors of known class, time and size put into a motion, and a simulated person who performs it.

What is injected follows the four errors of Yamane and Shakunaga, section 2.3: time shift, incomplete motion,
partial and global motion error. A trial compares the clean motion with ``simulate_performer(inject(...).motion,
...)``: the same dance with the error, by another body that faces elsewhere and is not quite steady.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dousa.arrays import FloatArray, Mask
from dousa.evaluation.posture.posture import SEGMENTS
from dousa.experiments.runner import check_choice
from dousa.motion.canonical.canonicalise import CanonicalMotion
from dousa.motion.canonical.joints import CANONICAL_JOINTS
from dousa.motion.canonical.joints import JOINT_INDEX as J
from lab.injection.edits import (
    LIMB_BONES,
    TRUNK_BONES,
    VARIANTS,
    Body,
    Edit,
    Sources,
    Take,
    Window,
    make_edit,
    measure_angles,
    measure_segments,
    prepare_take,
    put_together,
    sample_body,
    smooth_noise,
    turn,
    turn_onto,
)

__all__ = [
    "KINDS",
    "VARIANTS",
    "Error",
    "Injection",
    "Limits",
    "inject",
    "inject_many",
    "measure_range",
    "simulate_performer",
]

_CORE = 0.9  # weight from which an error is wholly there
_MOST_FRAMES = 100  # of a window, for the range: more change it by less than a degree
_OTHER_TIMES_S = np.linspace(-1.0, 1.0, 21)
_WITHIN_S = 0.5  # a limb that is where it was within this time is early or late rather than wrong

# What joints allow, heading-free (left +X, front +Z): generous, against arms through the trunk and legs that
# no hip lets go there. The clean motion is never held to it.
_TRUNK_RADIUS = 0.07  # of the body height
_BEHIND_ARM, _ACROSS_ARM = -0.75, 0.7
_BEHIND_LEG, _ACROSS_LEG, _RAISED_LEG = -0.6, 0.45, 0.35


@dataclass(frozen=True, slots=True)
class Error:
    """One injected error: the truth that an assessment is held to.

    Parameters
    ----------
    kind : ``"global"``, ``"partial"``, ``"incomplete"`` or ``"shift"``.
    variant : what it looks like, of `VARIANTS`, or of a recipe of another generator.
    start_s, end_s : first and last moment at which it can be seen.
    segments : names of the segments that are wrong; all nine for a shift of the whole body and a global error.
    lag_ms : how late at the most (positive) or early (negative), of a shift.
    shortfall_deg, shortfall_percent : how much range the most affected segment lost, of an incomplete motion.
    """

    kind: str
    variant: str
    start_s: float
    end_s: float
    segments: tuple[str, ...]
    lag_ms: float | None = None
    shortfall_deg: float | None = None
    shortfall_percent: float | None = None

    @property
    def duration_s(self) -> float:
        """Seconds."""
        return self.end_s - self.start_s


@dataclass(frozen=True, slots=True)
class Limits:
    """What an error must be to count as one that a teacher would see; smaller ones are not injected.

    All angles are in degrees between the segments of the injected and the clean motion, before any performer
    noise, after the yaw between the two is taken out (shift, global, stops short).

    Parameters
    ----------
    seen_deg : a moment counts as seen if some segment is off by this; the truth runs from the first such moment
        to the last, where the error is at least a quarter there.
    seen_share : of the moments between them that must be seen.
    shortest_s : what must be left of the window.
    shift_rms, shift_peak : root mean square over all segments and moments; the most moved segment's 90th
        percentile.
    shortfall_deg, shortfall_percent : loss of range of the most affected segment.
    partial_mean, partial_low, partial_share : mean of the most wrong segment, and what it exceeds for this
        share of the time.
    partial_outside : median distance of the limb from all that it does within half a second: a limb in its
        own place at another time would be a shift.
    global_mean, global_segment, n_global : mean over segments; what this many segments exceed.
    global_elsewhen : mean distance to the clean motion shifted by up to 1 s, at the best shift.
    most_share : of the motion's length, the longest window.
    """

    seen_deg: float = 8.0
    seen_share: float = 0.6
    shortest_s: float = 0.4
    shift_rms: float = 6.0
    shift_peak: float = 15.0
    shortfall_deg: float = 15.0
    shortfall_percent: float = 20.0
    partial_mean: float = 25.0
    partial_low: float = 12.0
    partial_share: float = 0.7
    partial_outside: float = 15.0
    global_mean: float = 25.0
    global_segment: float = 15.0
    n_global: int = 5
    global_elsewhen: float = 20.0
    most_share: float = 0.45


def measure_range(directions: FloatArray) -> FloatArray:
    """The largest angle between any two directions over time, degrees.

    Parameters
    ----------
    directions : (T, K, 3) unit vectors.

    Returns
    -------
    (K,) degrees; at most 100 evenly spread frames are looked at.
    """
    few = directions[np.linspace(0, len(directions) - 1, min(len(directions), _MOST_FRAMES)).round().astype(int)]
    cosines = np.einsum("tkc,ukc->ktu", few, few)
    widest: FloatArray = np.degrees(np.arccos(np.clip(cosines.min(axis=(1, 2)), -1.0, 1.0)))
    return widest


@dataclass(frozen=True, slots=True, eq=False)
class _Compared:
    """Injected and clean segments over the seen part of a window."""

    kind: str
    take: Take
    first: int  # frame of the take
    wrong: FloatArray  # (n, 9, 3) world
    clean: FloatArray  # (n, 9, 3) world
    angles: FloatArray  # (n, 9) degrees
    core: Mask  # (n,) where the error is wholly there
    segments: tuple[int, ...]


def find_truth(kind: str, variant: str, take: Take, window: Window, edit: Edit, limits: Limits) -> Error | None:
    """The error that an edit makes; None if it cannot be seen, or cannot be done by a body."""
    positions = put_together(edit.body)
    wrong, clean = measure_segments(positions), take.segments[window.start : window.stop]
    turned = kind in ("shift", "global") or variant == "stops short"
    angles = measure_angles(turn_onto(wrong, clean) if turned else wrong, clean)
    seen = (angles[:, edit.segments].max(axis=1) >= limits.seen_deg) & (edit.weight >= 0.25)
    moments = np.flatnonzero(seen)
    if len(moments) < max(limits.shortest_s * take.frame_rate, 2.0):
        return None
    first, last = moments[0], moments[-1] + 1
    if seen[first:last].mean() < limits.seen_share:
        return None
    if kind == "partial":
        before = put_together(take.body.cut(window.start, window.stop))
        if not is_possible(before, positions, take.heading[window.start : window.stop]):
            return None
    part = slice(first, last)
    compared = _Compared(
        kind,
        take,
        window.start + int(first),
        wrong[part],
        clean[part],
        angles[part],
        edit.weight[part] >= _CORE,
        edit.segments,
    )
    changed = compared.angles.max(axis=0)[list(edit.segments)] >= limits.seen_deg
    whole = kind in ("shift", "global")
    error = Error(
        kind,
        variant,
        start_s=compared.first / take.frame_rate,
        end_s=(window.start + int(last)) / take.frame_rate,
        segments=SEGMENTS
        if whole
        else tuple(SEGMENTS[s] for s, off in zip(edit.segments, changed, strict=True) if off),
        lag_ms=None if edit.lag_s is None else 1000.0 * edit.lag_s,
    )
    return _JUDGES[kind](error, compared, limits)


def _judge_shift(error: Error, compared: _Compared, limits: Limits) -> Error | None:
    rms = np.sqrt((compared.angles**2).mean())
    peak = np.percentile(compared.angles, 90, axis=0).max()
    return error if rms >= limits.shift_rms and peak >= limits.shift_peak else None


def _judge_incomplete(error: Error, compared: _Compared, limits: Limits) -> Error | None:
    heading = compared.take.heading[compared.first : compared.first + len(compared.wrong)]
    full = measure_range(turn(compared.clean, -heading))
    loss = full - measure_range(turn(compared.wrong, -heading))
    most = max(compared.segments, key=lambda segment: loss[segment])
    percent = 100.0 * loss[most] / max(full[most], 1e-6)
    if loss[most] < limits.shortfall_deg or percent < limits.shortfall_percent:
        return None
    return replace(error, shortfall_deg=float(loss[most]), shortfall_percent=float(percent))


def _judge_partial(error: Error, compared: _Compared, limits: Limits) -> Error | None:
    if not compared.core.any():
        return None
    angles = compared.angles[:, compared.segments]
    most = int(angles.mean(axis=0).argmax())
    low = (angles.max(axis=1) >= limits.partial_low).mean()
    if angles[:, most].mean() < limits.partial_mean or low < limits.partial_share:
        return None
    reach = int(_WITHIN_S * compared.take.frame_rate)
    around = compared.take.segments[max(compared.first - reach, 0) : compared.first + len(angles) + reach]
    wrong = compared.wrong[compared.core][:, None, compared.segments]
    step = max(len(around) // 60, 1)
    nearest = measure_angles(wrong, around[None, ::step, compared.segments]).max(axis=2).min(axis=1)
    return error if np.median(nearest) >= limits.partial_outside else None


def _judge_global(error: Error, compared: _Compared, limits: Limits) -> Error | None:
    if not compared.core.any():
        return None
    means = compared.angles.mean(axis=0)
    if means.mean() < limits.global_mean or (means >= limits.global_segment).sum() < limits.n_global:
        return None
    frames = compared.first + np.flatnonzero(compared.core)
    wrong = compared.wrong[compared.core]
    for time in _OTHER_TIMES_S:
        there = np.clip(frames + round(time * compared.take.frame_rate), 0, compared.take.n_frames - 1)
        clean = compared.take.segments[there]
        if measure_angles(turn_onto(wrong, clean), clean).mean() < limits.global_elsewhen:
            return None
    return error


_JUDGES = {
    "shift": _judge_shift,
    "incomplete": _judge_incomplete,
    "partial": _judge_partial,
    "global": _judge_global,
}


def is_possible(clean: FloatArray, positions: FloatArray, heading: FloatArray) -> bool:
    """Whether joints could do this, as far as a rough look tells; never stricter than the clean motion.

    Parameters
    ----------
    clean, positions : (n, 20, 3) m, before and after.
    heading : (n,) rad, of the clean motion.
    """
    height = float(np.median(clean[..., 1].max(axis=1) - clean[..., 1].min(axis=1)))
    radius = _TRUNK_RADIUS * height
    for name in ("left_elbow", "right_elbow", "left_wrist", "right_wrist"):
        before, after = _from_trunk(clean, name).min(), _from_trunk(positions, name).min()
        if after < min(radius, before):
            return False
    after, before = (turn(points, -heading) for points in (positions, clean))
    return not any(_bends_too_far(after, before, side) for side in ("left", "right"))


def _from_trunk(positions: FloatArray, name: str) -> FloatArray:
    """(T,) distance of a joint from the line from pelvis to neck."""
    base, top = positions[:, J["pelvis"]], positions[:, J["neck"]]
    along = top - base
    point = positions[:, J[name]] - base
    share = (point * along).sum(axis=1) / np.maximum((along * along).sum(axis=1), 1e-9)
    distance: FloatArray = np.linalg.norm(point - np.clip(share, 0.0, 1.0)[:, None] * along, axis=1)
    return distance


def _bends_too_far(after: FloatArray, before: FloatArray, side: str) -> bool:
    outward = np.array([1.0 if side == "left" else -1.0, 0.0, 0.0])
    back, up = np.array([0.0, 0.0, -1.0]), np.array([0.0, 1.0, 0.0])
    checks = (
        ("shoulder", "elbow", back, -_BEHIND_ARM),
        ("shoulder", "elbow", -outward, _ACROSS_ARM),
        ("hip", "knee", back, -_BEHIND_LEG),
        ("hip", "knee", -outward, _ACROSS_LEG),
        ("hip", "knee", up, _RAISED_LEG),
    )
    for start, end, way, most in checks:
        far = []
        for positions in (before, after):
            bone = positions[:, J[f"{side}_{end}"]] - positions[:, J[f"{side}_{start}"]]
            far.append(((bone @ way) / np.maximum(np.linalg.norm(bone, axis=1), 1e-9)).max())
        if far[1] > max(most, far[0]) + 1e-6:
            return True
    return False


# Places

KINDS: tuple[str, ...] = tuple(VARIANTS)
"""The four classes, in the order of the tables."""

_N_TRIES = 40  # windows per variant before a motion is held to have no place for it
_DURATIONS_S = (0.7, 3.0)
_SHORTEST_S = 0.5
_SHORT_ACTION_S, _SHORT_ACTION_SHARE = 0.8, 0.65
_RAMPS_S = (0.15, 0.3)
_MARGIN_S, _MARGIN_SHARE = 0.3, 0.1

_UNSTEADY_S = (0.3, 0.6)  # correlation time of the limbs' unsteadiness
_WOBBLE_S = 1.0  # and of the timing's
_LIMB_SPREAD = 0.1
_STATURES = (0.9, 1.1)
_PLACE_M = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class Injection:
    """A motion with errors in it.

    Parameters
    ----------
    motion : as the given one, wrong where the errors are.
    errors : in order of time, one or more.
    """

    motion: CanonicalMotion
    errors: tuple[Error, ...]

    @property
    def error(self) -> Error:
        """The first, or only one."""
        return self.errors[0]


def inject(
    motion: CanonicalMotion,
    kind: str,
    rng: np.random.Generator | int,
    *,
    donors: Sequence[CanonicalMotion] = (),
    variant: str | None = None,
    duration_s: float | None = None,
    size: float | None = None,
    limits: Limits | None = None,
) -> Injection | None:
    """Put one error into a motion.

    Parameters
    ----------
    motion : clean.
    kind : of ``KINDS``.
    rng : generator or seed.
    donors : other motions that wrong limbs and wrong sections may be taken from.
    variant : of ``VARIANTS[kind]``; by default they are tried in random order.
    duration_s : length of the window in s, fades included; drawn from 0.7 to 3 if None.
    size : lag in ms (shift), missing share 0 to 1 (incomplete), degrees (limb rotated); drawn if None.
    limits : what must be visible; see `Limits`.

    Returns
    -------
    The wrong motion and the truth; None if no place was found where this error could be seen: of a person who
    stands still nothing is late. Nothing is injected in the first and last 0.3 s (10 % of a short motion).

    Raises
    ------
    OptionError : an unknown kind or variant.
    """
    check_choice("kind", kind, KINDS)
    if variant is not None:
        check_choice("variant", variant, VARIANTS[kind])
    injector = _Injector(np.random.default_rng(rng), donors, size, limits or Limits(), duration_s=duration_s)
    return injector.inject(motion, [(kind, variant)])


def inject_many(
    motion: CanonicalMotion,
    kinds: Sequence[str],
    rng: np.random.Generator | int,
    *,
    donors: Sequence[CanonicalMotion] = (),
    gap_s: float = 1.5,
    size: float | None = None,
    limits: Limits | None = None,
) -> Injection | None:
    """Put several errors into a long motion, apart from each other.

    Parameters
    ----------
    motion, rng, donors, size, limits : as for `inject`.
    kinds : one entry an error; they are placed in random order.
    gap_s : s, between the windows at least.

    Returns
    -------
    The wrong motion with as many of the errors as found a place; None if none did.

    Raises
    ------
    OptionError : an unknown kind.
    """
    for kind in kinds:
        check_choice("kind", kind, KINDS)
    rng = np.random.default_rng(rng)
    order: list[tuple[str, str | None]] = [(kinds[k], None) for k in rng.permutation(len(kinds))]
    return _Injector(rng, donors, size, limits or Limits(), gap_s=gap_s).inject(motion, order)


@dataclass(frozen=True, slots=True, eq=False)
class _Injector:
    """Finds places for errors; what is asked is as for `inject` and `inject_many`."""

    rng: np.random.Generator
    donors: Sequence[CanonicalMotion]
    size: float | None
    limits: Limits
    gap_s: float = 0.0
    duration_s: float | None = None

    def inject(self, motion: CanonicalMotion, wanted: Sequence[tuple[str, str | None]]) -> Injection | None:
        """Put errors of these kinds and variants into a motion, one after the other."""
        # Two poses have a pace, one has none; nothing can be wrong in less than a second.
        if motion.duration < 2.0 * _SHORTEST_S:
            return None
        sources = Sources(prepare_take(motion), self.donors)
        places = _Places(sources.take, self.gap_s, self.limits.most_share)
        positions = np.array(motion.positions, dtype=np.float64)
        errors = []
        for kind, variant in wanted:
            found = self._find_place(kind, variant, sources, places)
            if found is None:
                continue
            error, window, body = found
            places.taken.append(window)
            positions[window.start : window.stop] = put_together(body)
            errors.append(error)
        if not errors:
            return None
        positions.flags.writeable = False
        return Injection(replace(motion, positions=positions), tuple(sorted(errors, key=lambda e: e.start_s)))

    def _find_place(
        self, kind: str, variant: str | None, sources: Sources, places: _Places
    ) -> tuple[Error, Window, Body] | None:
        """Draw windows until one shows the error."""
        variants = VARIANTS[kind] if variant is None else (variant,)
        for number in self.rng.permutation(len(variants)):
            for _ in range(_N_TRIES):
                window = places.draw(self.rng, self.duration_s)
                if window is None:
                    continue
                edit = make_edit(kind, variants[number], sources, window, self.rng, self.size)
                if edit is None:
                    continue
                error = find_truth(kind, variants[number], sources.take, window, edit, self.limits)
                if error is not None:
                    return error, window, edit.body
        return None


class _Places:
    """Windows that are still free."""

    def __init__(self, take: Take, gap_s: float, most_share: float) -> None:
        self.rate, self.n_frames = take.frame_rate, take.n_frames
        self.duration_s = take.n_frames / take.frame_rate
        self.margin_s = min(_MARGIN_S, _MARGIN_SHARE * self.duration_s)
        self.gap, self.most_share = gap_s * take.frame_rate, most_share
        self.taken: list[Window] = []

    def draw(self, rng: np.random.Generator, duration_s: float | None) -> Window | None:
        """A window, or None where it would meet another one."""
        # One short action, such as a squat of 1.5 s, goes wrong as a whole.
        whole = min(_SHORT_ACTION_S, _SHORT_ACTION_SHARE * self.duration_s)
        longest = min(_DURATIONS_S[1], max(self.most_share * self.duration_s, whole))
        shortest = max(_SHORTEST_S, min(_DURATIONS_S[0], longest))
        if duration_s is None:
            if longest < _SHORTEST_S:
                return None
            duration_s = rng.uniform(shortest, max(longest, shortest))
        room = self.duration_s - 2.0 * self.margin_s - duration_s
        if room < 0.0:
            return None
        start = round((self.margin_s + rng.uniform(0.0, room)) * self.rate)
        stop = min(start + round(duration_s * self.rate), self.n_frames)
        ramp = min(rng.uniform(*_RAMPS_S), 0.3 * duration_s) * self.rate
        for other in self.taken:
            if start < other.stop + self.gap and other.start < stop + self.gap:
                return None
        return Window(start, stop, max(ramp, 1.0))


def simulate_performer(
    motion: CanonicalMotion,
    rng: np.random.Generator | int,
    *,
    noise_deg: float = 3.0,
    bias_deg: float = 2.0,
    timing_ms: float = 20.0,
    stature: float | None = None,
    yaw: float | None = None,
    place: tuple[float, float] | None = None,
) -> CanonicalMotion:
    """The same motion by another person: other limbs, facing elsewhere, never quite steady nor quite in time.

    Parameters
    ----------
    motion : what is performed.
    rng : generator or seed.
    noise_deg : root mean square angle in degrees by which every bone wavers slowly (within 0.3 to 0.6 s).
    bias_deg : the same, of a posture that stays wrong throughout.
    timing_ms : root mean square of the slow timing wobble (within 1 s).
    stature : factor of all lengths; drawn from 0.9 to 1.1 if None. Limbs differ by up to 10 % more, both sides
        alike.
    yaw : rad, heading added; any if None.
    place : (x, z) m, added; within 2 m if None.

    Returns
    -------
    A motion of the same length and frame rate.
    """
    rng = np.random.default_rng(rng)
    stature = float(rng.uniform(*_STATURES)) if stature is None else stature
    yaw = float(rng.uniform(-np.pi, np.pi)) if yaw is None else yaw
    x, z = rng.uniform(-_PLACE_M, _PLACE_M, 2) if place is None else place
    n, rate = motion.n_frames, motion.frame_rate
    wobble = smooth_noise(n, (), _WOBBLE_S * rate, rng) * timing_ms / 1000.0 * rate
    # However large the wobble, nobody dances backwards.
    frames = np.maximum.accumulate(np.arange(n) + wobble)
    take = prepare_take(motion)
    body = sample_body(take.body, frames)
    heading = np.interp(frames, np.arange(n), take.heading)
    directions = _waver(body.directions, heading, rate, rng, noise_deg=noise_deg, bias_deg=bias_deg)
    lowest = np.asarray(motion.positions)[..., 1].min()
    lengths = body.lengths * stature * _draw_limb_lengths(rng)
    positions = put_together(Body(body.root * stature, directions, lengths))
    # The other legs stand on the same floor.
    positions[..., 1] += lowest - np.percentile(positions[..., 1].min(axis=1), 1.0)
    positions = turn(positions, np.asarray(yaw)) + np.array([x, 0.0, z])
    positions.flags.writeable = False
    return replace(motion, positions=positions, height=motion.height * stature)


def _waver(
    directions: FloatArray,
    heading: FloatArray,
    rate: float,
    rng: np.random.Generator,
    *,
    noise_deg: float,
    bias_deg: float,
) -> FloatArray:
    """Add slow noise and a constant bias to every bone; the trunk moves as one."""
    n, n_bones = directions.shape[:2]
    # Of a rotation vector's three components two tilt the bone.
    spread = np.radians([noise_deg, bias_deg]) / np.sqrt(2.0)
    correlation = rng.uniform(*_UNSTEADY_S) * rate
    tilt = spread[0] * smooth_noise(n, (n_bones, 3), correlation, rng)
    bias = spread[1] * rng.standard_normal((n_bones, 3))
    tilt += turn(np.broadcast_to(bias, tilt.shape), heading)
    tilt[:, TRUNK_BONES] = tilt[:, TRUNK_BONES[:1]]
    wavering = directions + np.cross(tilt, directions)
    unit: FloatArray = wavering / np.linalg.norm(wavering, axis=-1, keepdims=True)
    return unit


def _draw_limb_lengths(rng: np.random.Generator) -> FloatArray:
    """(19,) factors, left as right."""
    factors = np.ones(len(CANONICAL_JOINTS) - 1)
    factors[list(TRUNK_BONES)] = rng.uniform(1.0 - _LIMB_SPREAD, 1.0 + _LIMB_SPREAD)
    for limb in ("arm", "leg"):
        for left, right in zip(LIMB_BONES[f"left_{limb}"], LIMB_BONES[f"right_{limb}"], strict=True):
            factors[[left, right]] = rng.uniform(1.0 - _LIMB_SPREAD, 1.0 + _LIMB_SPREAD)
    return factors
