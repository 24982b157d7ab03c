"""Holding feet and hands in place: bending two bones so that the end of a limb reaches a place."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from dousa.arrays import BoolArray, FloatArray
from dousa.motion.retargeting.contacts import Stances, find_stances, ramp, smooth
from dousa.motion.retargeting.rig import Rig
from dousa.motion.rotations import between, conjugate, from_axis_angle, identity, multiply, rotate, to_axis_angle
from dousa.motion.runs import find_runs

_REACH = 0.9999  # of the length of a limb: beyond, the knee would leap
_BENT = 0.999  # of the length of a leg: the pelvis goes down so far that knees keep a little bend
_BIAS = 0.02  # of the upper bone
_EASED, _SWINGING = 0.1, 0.1  # s; how much of a foot in the air counts
_SMOOTH = 0.08  # s, over which the pelvis gives way


def share_moves(moves: FloatArray, stands: BoolArray, frame_rate: float) -> FloatArray:
    """Compute the move (T, 3) m of the whole body from those of its feet, so that the legs bend little.

    A standing foot counts most.

    Parameters
    ----------
    moves : (T, 2, 3) m, of the feet.
    stands : (T, 2) which of them are held.
    frame_rate : Hz.
    """
    around = max(1, round(_EASED * frame_rate))
    weights = np.where(stands, 1.0, _SWINGING)
    shared = (weights[..., None] * moves).sum(axis=1) / weights.sum(axis=1)[:, None]
    return np.stack([smooth(shared[:, axis], around) for axis in range(3)], axis=1)


def bend(
    root: FloatArray, middle: FloatArray, end: FloatArray, wanted: FloatArray, outward: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Compute turns (T, 4) in the world of the upper and lower bone that bring the end of a limb to a place.

    The plane of the limb turns as little as it can; lengths are kept, so that a place out of reach is approached.

    Parameters
    ----------
    root, middle, end : (T, 3) m, joints of the limb, such as hip, knee and ankle.
    wanted : (T, 3) m, place for the end.
    outward : (T, 3) of any length, direction of the middle joint if the limb is straight: knees to the front.
    """
    upper, lower = np.linalg.norm(middle - root, axis=1), np.linalg.norm(end - middle, axis=1)
    line, goal = end - root, wanted - root
    furthest, nearest = _REACH * (upper + lower), 1.001 * np.abs(upper - lower) + 1e-6
    distance = np.clip(np.linalg.norm(goal, axis=1), nearest, np.maximum(furthest, nearest))
    ahead = goal / np.maximum(np.linalg.norm(goal, axis=1, keepdims=True), 1e-9)
    turned = rotate(between(line, goal), middle - root)
    # A straight limb has no plane of its own, and one that is nearly straight an unsteady one.
    side = outward / np.maximum(np.linalg.norm(outward, axis=1, keepdims=True), 1e-9)
    own = turned - (turned * ahead).sum(axis=1, keepdims=True) * ahead
    lacking = np.maximum(_BIAS * upper - np.linalg.norm(own, axis=1), 0.0)
    turned = turned + lacking[:, None] * side
    across = turned - (turned * ahead).sum(axis=1, keepdims=True) * ahead
    length = np.linalg.norm(across, axis=1, keepdims=True)
    across = across / np.maximum(length, 1e-9)
    along = (upper**2 - lower**2 + distance**2) / (2 * distance)
    off = np.sqrt(np.maximum(upper**2 - along**2, 0.0))
    knee = along[:, None] * ahead + off[:, None] * across
    reached = distance[:, None] * ahead
    return between(middle - root, knee), between(end - middle, reached - knee)


def lower_pelvis(hips: FloatArray, wanted: FloatArray, lengths: FloatArray, frame_rate: float) -> FloatArray:
    """Compute how far down (T,) m the pelvis must go so that all feet are within reach, smooth over time.

    Parameters
    ----------
    hips, wanted : (T, 2, 3) m, hip joints, and places for the ankles.
    lengths : (2,) m of the legs.
    """
    gap = hips - wanted
    beside = np.square(gap[..., 0]) + np.square(gap[..., 2])
    highest = np.sqrt(np.maximum(np.square(_BENT * lengths) - beside, 0.0))
    needed = np.maximum(gap[..., 1] - highest, 0.0).max(axis=1)
    return _widen(needed, max(1, round(_SMOOTH * frame_rate)))


def _widen(values: FloatArray, around: int) -> FloatArray:
    """A smooth curve (T,) nowhere below the values: the maximum around each, averaged over as far."""
    around = min(around, len(values))
    padded = np.pad(values, 2 * around, mode="edge")
    highest = np.lib.stride_tricks.sliding_window_view(padded, 2 * around + 1).max(axis=1)
    weights = np.hanning(2 * around + 3)[1:-1]
    return np.convolve(highest, weights / weights.sum(), mode="valid")


_EASE = 0.05  # m/s: of two points slower than this each carries half the foot
_STANDS, _FEWEST = 0.8, 5  # how firmly ankle and toe are held in frames that show a flat foot, and how many it takes
_LOWEST, _LOW = 5, 0.03  # percentile, m above it
_ALIKE, _RISING, _STEEPEST = 0.1, 0.2, 1.3  # rad: feet of a reference pose that show the flat foot
_MOST, _FLAT = 0.45, 0.3  # rad; share of a vector that lies across the foot
_PASSING = 0.04  # s, over which the one takes over from the other
_TURNS = (0.10, 0.30)  # rad: what turns this little is held, what turns this much is not
_FLOOR = (0.05, 0.15)  # m: a foot as near to the floor as the one stands on it, one beyond the other does not


@dataclass(frozen=True, slots=True, eq=False)
class Foot:
    """One foot, of the source or of the character.

    Parameters
    ----------
    ankle : (T, 3) m.
    toe : (T, 3) m; None if either body has none.
    heights : m, of ankle and toe over the floor when the foot is flat on it.
    """

    ankle: FloatArray
    toe: FloatArray | None
    heights: tuple[float, float]


@dataclass(frozen=True, slots=True, eq=False)
class FootPlan:
    """Turns and moves of a foot.

    Parameters
    ----------
    turns : (T, 4) of the foot in the world.
    moves : (T, 3) m, of the ankle.
    stands : (T,) whether it is held.
    """

    turns: FloatArray
    moves: FloatArray
    stands: BoolArray


def plan_foot(source: Foot, made: Foot, scale: float, floor: float, frame_rate: float, size: float) -> FootPlan:
    """Plan the turns and moves of a foot so that it stands as the source's.

    Parameters
    ----------
    source, made : the foot of the source, and that of the character, which points as the source's.
    scale : length of the character's legs over that of the source's.
    floor : m, its height.
    frame_rate : Hz.
    size : of the source, in bodies of 1.6 m over the joints.
    """
    ankle = find_stances(source.ankle, frame_rate, size)
    near, steps, weight = ankle.near, scale * ankle.steps - np.diff(made.ankle, axis=0), _weigh(ankle)
    turns = identity((len(source.ankle),))
    heights = _height_over(source.ankle, made.ankle, source.heights[0], made.heights[0], scale, floor)
    if source.toe is not None and made.toe is not None:
        toe = find_stances(source.toe, frame_rate, size)
        turns = _still_direction(source.toe - source.ankle, ankle.held * toe.held)
        point = made.ankle + rotate(turns, made.toe - made.ankle)
        share = _share(ankle, toe, frame_rate)[:, None]
        steps = share * (scale * toe.steps - np.diff(point, axis=0)) + (1 - share) * steps
        near, weight = near | toe.near, np.maximum(weight, _weigh(toe))
        toes = _height_over(source.toe, point, source.heights[1], made.heights[1], scale, floor)
        # A toe may be lifted from a foot that stands on its heel, and a heel from one on its toe.
        over = [points[:, 1] - low for points, low in zip((source.ankle, source.toe), source.heights, strict=True)]
        heights = np.where(over[1] <= over[0], toes, heights)
    moves = np.zeros_like(made.ankle)
    stretches = find_runs(near).tolist()
    for start, end in stretches:
        moves[start + 1 : end] = np.cumsum(steps[start : end - 1], axis=0)
        own = weight[start:end]
        moves[start:end] -= np.average(moves[start:end], axis=0, weights=own)
        moves[start:end, 1] += np.average(heights[start:end] - moves[start:end, 1], weights=own)
    _swing(moves, stretches)
    return FootPlan(turns, moves, near)


def level_foot(
    source: Foot, made: Foot, world: FloatArray, rig: Rig, side: str, frame_rate: float, size: float
) -> FloatArray:
    """Compute turns (T, 4) in the world that make a character's foot flat where the source's stands flat.

    Feet point from ankle to toe as the source's do, but the height of ankles over the sole differs between bodies. The
    flat foot is found in the motion of the source and in the reference pose of the character.

    Parameters
    ----------
    source, made : the foot of the source, and that of the character, which points as the source's.
    world : (T, 4) orientation of the character's ankle.
    rig : the character; if its feet differ in the reference pose, they stay.
    side : ``"left"`` or ``"right"``.
    frame_rate : Hz.
    size : of the source, in bodies of 1.6 m over the joints.
    """
    still = identity((len(world),))
    if source.toe is None or made.toe is None:
        return still
    ankle, toe = (find_stances(points, frame_rate, size) for points in (source.ankle, source.toe))
    lowest = np.percentile(source.ankle[:, 1], _LOWEST)
    stands = (ankle.held * toe.held > _STANDS) & (source.ankle[:, 1] < lowest + _LOW * size)  # not on tiptoe
    up = rotate(rig.body, np.array([0.0, 1.0, 0.0]))
    feet = [rig.direction(f"{one}_ankle", f"{one}_toe") for one in ("left", "right")]
    steep = [_measure_slope(foot, up) for foot in feet]
    if stands.sum() < _FEWEST or abs(steep[0] - steep[1]) > _ALIKE or not -_STEEPEST < max(steep) < _RISING:
        return still
    since = multiply(world, conjugate(rig.world[rig.joints[f"{side}_ankle"]]))
    # What is up in the frame of the foot while it stands should be what is up in the reference pose.
    wanted = rotate(conjugate(since[stands]), np.array([0.0, 1.0, 0.0])).mean(axis=0)
    ahead = feet[0 if side == "left" else 1]
    ahead = ahead / max(float(np.linalg.norm(ahead)), 1e-9)
    sides = [vector - vector.dot(ahead) * ahead for vector in (up, wanted)]
    if min(float(np.linalg.norm(vector)) for vector in sides) < _FLAT:
        return still
    roll = between(*sides)
    tilt = to_axis_angle(between(up, rotate(conjugate(roll), wanted)))
    tilt = tilt * min(1.0, _MOST / max(float(np.linalg.norm(tilt)), 1e-9))
    turns: FloatArray = multiply(multiply(since, multiply(roll, from_axis_angle(tilt))), conjugate(since))
    return turns


def _measure_slope(directions: FloatArray, up: FloatArray) -> FloatArray:
    """Angle (...) rad by which directions (..., 3) rise."""
    lengths = np.maximum(np.linalg.norm(directions, axis=-1), 1e-9)
    slope: FloatArray = np.arcsin(np.clip((directions * up).sum(axis=-1) / lengths, -1.0, 1.0))
    return slope


def _weigh(stances: Stances) -> FloatArray:
    """Weight (T,) of a frame for the direction of a standing foot."""
    weights: FloatArray = 1.0 / (1.0 + np.square(stances.speed / (2 * _EASE))) ** 2 * stances.near + 1e-9
    return weights


def _still_direction(directions: FloatArray, held: FloatArray) -> FloatArray:
    """Turns (T, 4) that keep a foot's direction (T, 3) where it hardly changes while ankle and toe are held."""
    unit = directions / np.maximum(np.linalg.norm(directions, axis=1, keepdims=True), 1e-9)
    wanted = unit.copy()
    for start, end in find_runs(held > 0).tolist():
        mean = np.average(unit[start:end], axis=0, weights=held[start:end] ** 2)
        mean /= max(float(np.linalg.norm(mean)), 1e-9)
        away = np.linalg.norm(unit[start:end] - mean, axis=1)
        share = held[start:end] * (1 - ramp(away, *_TURNS))
        wanted[start:end] += share[:, None] * (mean - unit[start:end])
    return between(unit, wanted)


def _share(ankle: Stances, toe: Stances, frame_rate: float) -> FloatArray:
    """Share (T - 1,) of the foot that the toe carries between frames: all of it where the ankle moves about it."""
    slow = _EASE**2
    share = (ankle.speed**2 + slow) / (ankle.speed**2 + toe.speed**2 + 2 * slow)
    share = smooth(share, max(1, round(_PASSING * frame_rate)))
    middle: FloatArray = 0.5 * (share[1:] + share[:-1])
    return middle


def _height_over(
    own: FloatArray, made: FloatArray, low: float, height: float, scale: float, floor: float
) -> FloatArray:
    """Lift (T,) m that puts a point over the floor as the source's is, or on it if that nearly is.

    Parameters
    ----------
    own, made : (T, 3) m, of the source and of the character.
    low, height : m over the floor, where they are in a standing foot.
    """
    over = own[:, 1] - floor - low
    over = over * ramp(np.abs(over), *_FLOOR)
    lifts: FloatArray = floor + height + scale * over - made[:, 1]
    return lifts


def _swing(moves: FloatArray, stretches: list[tuple[int, int]]) -> None:
    """Interpolate smoothly between places where a foot stands; hold the ends."""
    if not stretches:
        return
    first, last = stretches[0][0], stretches[-1][1]
    moves[:first] = moves[first]
    moves[last:] = moves[last - 1]
    for (_, end), (start, _) in pairwise(stretches):
        share = (np.arange(end, start) - end + 1)[:, None] / (start - end + 1)
        share = share * share * (3 - 2 * share)
        moves[end:start] = (1 - share) * moves[end - 1] + share * moves[start]
