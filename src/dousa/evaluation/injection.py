"""Errors of known class, time and size put into a motion, and a simulated person who performs it.

What is injected follows the four errors of Yamane and Shakunaga, section 2.3: time shift, incomplete motion,
partial and global motion error. A trial compares the clean motion with ``simulate_performer(inject(...).motion,
...)``: the same dance with the error, by another body that faces elsewhere and is not quite steady.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dousa.errors import OptionError
from dousa.evaluation._injection_body import (
    LIMB_BONES,
    TRUNK_BONES,
    Body,
    Take,
    prepare_take,
    put_together,
    sample_body,
    smooth_noise,
    turn,
)
from dousa.evaluation._injection_edits import VARIANTS, Sources, Window, make_edit
from dousa.evaluation._injection_truth import Error, Limits, find_truth, measure_range
from dousa.motion._types import FloatArray
from dousa.motion.canonical import CanonicalMotion
from dousa.motion.joints import CANONICAL_JOINTS

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

KINDS: tuple[str, ...] = ("shift", "incomplete", "partial", "global")
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
    _check(kind, variant)
    return _inject_all(
        motion,
        [(kind, variant)],
        np.random.default_rng(rng),
        donors=donors,
        gap_s=0.0,
        duration_s=duration_s,
        size=size,
        limits=limits or Limits(),
    )


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
        _check(kind, None)
    rng = np.random.default_rng(rng)
    order: list[tuple[str, str | None]] = [(kinds[k], None) for k in rng.permutation(len(kinds))]
    return _inject_all(
        motion, order, rng, donors=donors, gap_s=gap_s, duration_s=None, size=size, limits=limits or Limits()
    )


def _check(kind: str, variant: str | None) -> None:
    if kind not in VARIANTS:
        raise OptionError(f"kind: expected {', '.join(KINDS)}, got '{kind}'")
    if variant is not None and variant not in VARIANTS[kind]:
        raise OptionError(f"variant: expected {' or '.join(VARIANTS[kind])}, got '{variant}'")


def _inject_all(
    motion: CanonicalMotion,
    wanted: Sequence[tuple[str, str | None]],
    rng: np.random.Generator,
    *,
    donors: Sequence[CanonicalMotion],
    gap_s: float,
    duration_s: float | None,
    size: float | None,
    limits: Limits,
) -> Injection | None:
    # Two poses have a pace, one has none; nothing can be wrong in less than a second.
    if motion.duration < 2.0 * _SHORTEST_S:
        return None
    take = prepare_take(motion)
    sources = Sources(take, donors)
    places = _Places(take, gap_s, limits.most_share)
    positions = np.array(motion.positions, dtype=np.float64)
    errors = []
    for kind, variant in wanted:
        found = _find_place(
            kind, variant, sources, places, rng, duration_s=duration_s, size=size, limits=limits
        )
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


def _find_place(
    kind: str,
    variant: str | None,
    sources: Sources,
    places: _Places,
    rng: np.random.Generator,
    *,
    duration_s: float | None,
    size: float | None,
    limits: Limits,
) -> tuple[Error, Window, Body] | None:
    """Draw windows until one shows the error."""
    variants = VARIANTS[kind] if variant is None else (variant,)
    for number in rng.permutation(len(variants)):
        for _ in range(_N_TRIES):
            window = places.draw(rng, duration_s)
            if window is None:
                continue
            edit = make_edit(kind, variants[number], sources, window, rng, size)
            if edit is None:
                continue
            error = find_truth(kind, variants[number], sources.take, window, edit, limits)
            if error is not None:
                return error, window, edit.body
    return None


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
