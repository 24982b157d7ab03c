"""Accents of a movement: moments that a dancer can put on a beat.

========  ===================================================================================================
kind      when
========  ===================================================================================================
clap      the hands meet
step      a foot comes to rest near the floor
stop      a hand, or a foot in the air, comes to rest after a movement
turn      a hand or a foot changes its direction sharply
========  ===================================================================================================

That a dance marks the beat where the speed of a joint is lowest is common: Li et al., "AI choreographer: music
conditioned 3D dance generation with AIST++", ICCV 2021 (kinematic beats). A hold is low in speed all the while, so
here the accent is the arrival: the descent from the last peak of speed, continued to rest.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import FloatArray
from dousa.motion import CanonicalMotion
from dousa.motion.canonical.joints import JOINT_INDEX
from dousa.motion.resampling import smooth_gaussian

ACCENTS: tuple[str, ...] = ("clap", "step", "stop", "turn")
"""Kinds of accents, the most certain first: of several in one moment the first is reported."""

_HIGH, _LOW = 0.5, 0.1  # of the fall: between these the descent is a line
_SMOOTH_S = 0.025  # deviation of the Gaussian over positions, see docs/evaluation.md
_USUAL = 0.35  # of the limb's fast movements, see docs/evaluation.md
_APART_S = 0.1  # between accents of one limb, see docs/evaluation.md
_ASIDE_S = 0.08  # before and after a turn, where speed and direction are taken, see docs/evaluation.md
_MEET, _OPEN = 0.16, 0.08  # body heights between the hands at a clap, and by how much more they were apart before

_LIMBS = ("left_hand", "right_hand", "left_foot", "right_foot")


@dataclass(frozen=True, slots=True)
class Accent:
    """A moment that marks the music.

    Parameters
    ----------
    time_s : seconds from the first frame.
    kind : of `ACCENTS`.
    parts : who: of ``left_hand``, ``right_hand``, ``left_foot``, ``right_foot``, in this order.
    strength : 0 to 1: speed lost, as a share of the limb's fast movements.
    """

    time_s: float
    kind: str
    parts: tuple[str, ...]
    strength: float


def find_accents(motion: CanonicalMotion, *, slowest: float = 0.25) -> tuple[Accent, ...]:
    """Find the accents of a motion in order of time.

    Parameters
    ----------
    motion : of any frame rate from about 20 Hz; hands are taken relative to the pelvis, feet in the room.
    slowest : body heights per second: a slower movement marks nothing.

    Returns
    -------
    Accents; none where a joint that they rest on was not seen.
    """
    if motion.n_frames < 4:
        return ()
    points = _place_limbs(motion)
    limit = slowest * motion.height
    found: list[Accent] = []
    for name in _LIMBS:
        found += [one for one in _find_in_limb(points[name], name, motion, limit) if _is_seen(motion, one)]
    claps = [one for one in _find_claps(points, motion, limit) if _is_seen(motion, one)]
    return _unite([one for one in found if not _belongs_to(one, claps)] + claps)


def _place_limbs(motion: CanonicalMotion) -> dict[str, FloatArray]:
    """(T, 3) m of each hand (wrist, relative to the pelvis) and foot (middle of ankle and toe, in the room)."""
    joints = motion.positions
    pelvis = joints[:, JOINT_INDEX["pelvis"]]
    found: dict[str, FloatArray] = {}
    for side in ("left", "right"):
        found[f"{side}_hand"] = joints[:, JOINT_INDEX[f"{side}_wrist"]] - pelvis
        found[f"{side}_foot"] = 0.5 * (joints[:, JOINT_INDEX[f"{side}_ankle"]] + joints[:, JOINT_INDEX[f"{side}_toe"]])
    deviation = _SMOOTH_S * motion.frame_rate
    return {name: smooth_gaussian(points, deviation) for name, points in found.items()}


def _is_seen(motion: CanonicalMotion, accent: Accent, *, cut_s: float = 0.1, gap_s: float = 0.15) -> bool:
    # cut_s: at both ends a movement may be cut off by the recording; gap_s: around what was not seen
    if not cut_s <= accent.time_s <= (motion.n_frames - 1) / motion.frame_rate - cut_s:
        return False
    if motion.missing is None:
        return True
    middle, reach = round(accent.time_s * motion.frame_rate), round(gap_s * motion.frame_rate)
    names = {"hand": ("wrist",), "foot": ("ankle", "toe")}
    joints = [JOINT_INDEX[f"{side}_{name}"] for side, _, what in _split(accent.parts) for name in names[what]]
    return not motion.missing[max(middle - reach, 0) : middle + reach + 1][:, joints].any()


def _split(parts: Iterable[str]) -> list[tuple[str, str, str]]:
    return [part.partition("_") for part in parts]


def _find_in_limb(
    points: FloatArray,
    name: str,
    motion: CanonicalMotion,
    limit: float,
    *,
    hold_s: float = 0.12,
    near_floor: float = 0.04,
) -> list[Accent]:
    """Stops, steps and turns of one limb."""
    # hold_s: at rest for so long: a stop, else a turn in passing; near_floor: body heights above where this foot
    # stands
    rate = motion.frame_rate
    velocity = np.diff(points, axis=0) * rate  # half a frame after each frame
    speed = np.linalg.norm(velocity, axis=1)
    falls = _find_falls(speed, limit)
    usual = _get_usual([speed[peak] - speed[valley] for peak, valley, _ in falls])
    standing = float(np.percentile(points[:, 1], 10)) + near_floor * motion.height
    found = []
    for peak, valley, rise in falls:
        lost = speed[peak] - speed[valley]
        if lost < _USUAL * usual:
            continue
        arrival = _find_arrival(speed, peak, valley, rate)
        held = rise - arrival >= hold_s * rate
        is_turn = not held and _turns(velocity, valley, rate, limit)
        place = arrival if held else _find_lowest(speed, valley)
        kind = "turn" if is_turn else "stop"
        if name.endswith("foot") and points[min(round(place), len(points) - 1), 1] <= standing:
            kind = "step"
            if not held and speed[valley] > limit:
                continue  # a foot that only slows down on its way past the other one
        found.append(Accent((place + 0.5) / rate, kind, (name,), min(float(lost / usual), 1.0)))
    return found + _find_corners(velocity, speed, name, rate, limit, usual, found)


def _get_usual(sizes: Sequence[float]) -> float:
    return float(np.percentile(sizes, 90)) if sizes else float("inf")


def _find_falls(speed: FloatArray, limit: float, *, fall: float = 0.5) -> list[tuple[int, int, int]]:
    """Every fall of the speed from a peak over the limit by half and more.

    Returns
    -------
    Of each: the peak, the lowest frame after it, and the frame at which the speed rises again (or the last one).
    """
    # fall: of a peak that the speed must lose; and of what it lost that it must regain to end a rest
    change = np.diff(speed)
    inner = np.flatnonzero(np.sign(change[1:]) != np.sign(change[:-1])) + 1
    turning = [0, *inner.tolist(), len(speed) - 1]
    falls: list[tuple[int, int, int]] = []
    peak = valley = 0
    falling = False
    for frame in turning:
        value = speed[frame]
        if falling:
            if value < speed[valley]:
                valley = frame
            elif value - speed[valley] > fall * min(speed[peak] - speed[valley], 2.0 * limit):
                falls.append((peak, valley, _find_rise(speed, valley, frame)))
                peak, falling = frame, False
        elif value > speed[peak]:
            peak = frame
        elif speed[peak] >= limit and value < fall * speed[peak]:
            valley, falling = frame, True
        elif speed[peak] < limit:
            peak = frame
    if falling:
        falls.append((peak, valley, len(speed) - 1))
    return falls


def _find_rise(speed: FloatArray, valley: int, frame: int) -> int:
    """The last frame before ``frame`` that is nearer to the valley's speed than to that of the frame."""
    level = speed[valley] + 0.25 * (speed[frame] - speed[valley])
    return valley + int(np.flatnonzero(speed[valley : frame + 1] <= level)[-1])


def _find_arrival(
    speed: FloatArray, peak: int, valley: int, rate: float, *, onwards: float = 1.6, blur: float = 1.28
) -> float:
    """The frame, not whole, at which a fall of the speed comes to rest.

    The speed of a movement of least jerk, 16 u^2 (1 - u)^2 of its peak at share u of its duration, is half at
    u = 0.771 and a tenth at u = 0.914: from the half to rest it is 1.6 times as long as from the half to the tenth.
    Smoothing leaves the half where it was, and adds its own width to that time (in squares).
    """
    # onwards: of the time between these: from the first of them to rest, see `_find_arrival`; blur: deviations from a
    # half to a tenth of a step under a Gaussian
    half, tenth = (_cross(speed, peak, valley, share) for share in (_HIGH, _LOW))
    deviation = float(np.hypot(_SMOOTH_S * rate, 1.0 / np.sqrt(12.0)))
    fall = np.sqrt(max((tenth - half) ** 2 - (blur * deviation) ** 2, 0.0))
    return min(half + onwards * float(fall), max(_find_lowest(speed, valley), half))


def _cross(speed: FloatArray, peak: int, valley: int, share: float) -> float:
    """Where the speed first falls to so much above the valley, as a share of the fall."""
    level = speed[valley] + share * (speed[peak] - speed[valley])
    after = peak + int(np.argmax(speed[peak : valley + 1] <= level))
    if after == peak:
        return float(peak)
    before, here = speed[after - 1], speed[after]
    return float(after - 1 + (before - level) / (before - here))


def _find_lowest(speed: FloatArray, valley: int) -> float:
    """The bottom of a valley between frames: a parabola through the squares of the speeds of three frames."""
    if not 0 < valley < len(speed) - 1:
        return float(valley)
    before, here, after = (float(speed[valley + step]) ** 2 for step in (-1, 0, 1))
    curve = before - 2.0 * here + after
    return valley + (float(np.clip(0.5 * (before - after) / curve, -0.5, 0.5)) if curve > 0.0 else 0.0)


def _turns(
    velocity: FloatArray,
    frame: int,
    rate: float,
    limit: float,
    *,
    sharp: float = np.cos(np.radians(60.0)),
) -> bool:
    """Whether a limb leaves in another direction than it came from."""
    # sharp: cosine of the turn that is an accent
    aside = max(round(_ASIDE_S * rate), 1)
    before, after = velocity[max(frame - aside, 0)], velocity[min(frame + aside, len(velocity) - 1)]
    sizes = np.linalg.norm(before), np.linalg.norm(after)
    return bool(min(sizes) > 0.5 * limit and before @ after < sharp * sizes[0] * sizes[1])


def _find_corners(
    velocity: FloatArray,
    speed: FloatArray,
    name: str,
    rate: float,
    limit: float,
    usual: float,
    known: Sequence[Accent],
) -> list[Accent]:
    """Sharp turns in full speed, at peaks of the acceleration without a fall of the speed."""
    acceleration = np.linalg.norm(np.gradient(velocity, axis=0), axis=1) * rate
    if len(acceleration) < 3:
        return []
    inner = acceleration[1:-1]
    peaks = np.flatnonzero((inner >= acceleration[:-2]) & (inner > acceleration[2:])) + 1
    least = max(limit, _USUAL * usual) if np.isfinite(usual) else limit
    aside = max(round(_ASIDE_S * rate), 1)
    times = [one.time_s for one in known]
    found: list[Accent] = []
    for peak in sorted(peaks.tolist(), key=lambda frame: -acceleration[frame]):
        if min(speed[max(peak - aside, 0)], speed[min(peak + aside, len(speed) - 1)]) < least:
            continue
        time = (peak + 0.5) / rate
        if all(abs(time - other) > _APART_S for other in times) and _turns(velocity, peak, rate, limit):
            times.append(time)
            strength = min(float(speed[peak]) / usual, 1.0) if np.isfinite(usual) else 1.0
            found.append(Accent(time, "turn", (name,), strength))
    return found


def _find_claps(
    points: dict[str, FloatArray], motion: CanonicalMotion, limit: float, *, abrupt_s: float = 0.15
) -> list[Accent]:
    """Where the hands come together after they were apart."""
    # abrupt_s: within which hands that meet come to rest; hands that pass each other take longer
    rate = motion.frame_rate
    apart = np.linalg.norm(points["left_hand"] - points["right_hand"], axis=1)
    closing = np.maximum(-np.diff(apart) * rate, 0.0)
    found = []
    for peak, valley, _ in _find_falls(closing, limit):
        half = _cross(closing, peak, valley, _HIGH) + 0.5
        place = _find_arrival(closing, peak, valley, rate) + 0.5
        frame = min(round(place), len(apart) - 1)
        reach = max(round(0.5 * rate), 1)
        before = apart[max(frame - reach, 0) : frame + 1].max()
        meet = apart[frame] < _MEET * motion.height and before - apart[frame] > _OPEN * motion.height
        if meet and place - half <= abrupt_s * rate:
            found.append(Accent(place / rate, "clap", ("left_hand", "right_hand"), 1.0))
    return found


def _belongs_to(accent: Accent, claps: Sequence[Accent]) -> bool:
    """Whether an accent of a hand is that of a clap."""
    return "hand" in accent.parts[0] and any(abs(accent.time_s - clap.time_s) < _APART_S for clap in claps)


def _unite(accents: Sequence[Accent], *, together_s: float = 0.06) -> tuple[Accent, ...]:
    """Accents of several limbs in one moment are one, at the mean of their times, the strongest counting most."""
    # together_s: accents of several limbs within this are one
    groups: list[list[Accent]] = []
    for one in sorted(accents, key=lambda accent: accent.time_s):
        together = groups and one.time_s - groups[-1][0].time_s <= together_s
        if together and not {*one.parts} & {part for other in groups[-1] for part in other.parts}:
            groups[-1].append(one)
        else:
            groups.append([one])
    return tuple(_join(group) for group in groups)


def _join(group: Sequence[Accent]) -> Accent:
    weights: NDArray[np.float64] = np.array([max(one.strength, 1e-3) for one in group])
    time_s = float(np.average([one.time_s for one in group], weights=weights))
    parts = {part for one in group for part in one.parts}
    kind = min((one.kind for one in group), key=ACCENTS.index)
    return Accent(time_s, kind, tuple(name for name in _LIMBS if name in parts), float(weights.max()))
