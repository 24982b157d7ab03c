"""Holding feet and hands in place: plans for the feet of a character, and limbs that bend to reach a place.

A standing foot moves in proportion to the source's: not at all, or rolling over heel or toe. The slower of the two
carries it, so that a longer foot rolls over its own toe. In the air the foot swings from one place to the next.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from dousa.arrays import BoolArray, FloatArray
from dousa.motion.retargeting.contacts import Stances, find_stances, ramp, smooth
from dousa.motion.retargeting.rig import Rig
from dousa.motion.rotations import between, conjugate, from_axis_angle, identity, multiply, rotate, to_axis_angle
from dousa.motion.runs import find_runs


def bend(
    root: FloatArray,
    middle: FloatArray,
    end: FloatArray,
    wanted: FloatArray,
    outward: FloatArray,
    reach: float = 0.9999,
    bias: float = 0.02,
) -> tuple[FloatArray, FloatArray]:
    """Compute turns (T, 4) in the world of the upper and lower bone that bring the end of a limb to a place.

    The plane of the limb turns as little as it can; lengths are kept, so that a place out of reach is approached.

    Parameters
    ----------
    root, middle, end : (T, 3) m, joints of the limb, such as hip, knee and ankle.
    wanted : (T, 3) m, place for the end.
    outward : (T, 3) of any length, direction of the middle joint if the limb is straight: knees to the front.
    reach : share of the length of the limb beyond which the knee would leap.
    bias : share of the upper bone by which a limb that is nearly straight bends outward.
    """
    upper, lower = np.linalg.norm(middle - root, axis=1), np.linalg.norm(end - middle, axis=1)
    line, goal = end - root, wanted - root
    furthest, nearest = reach * (upper + lower), 1.001 * np.abs(upper - lower) + 1e-6
    distance = np.clip(np.linalg.norm(goal, axis=1), nearest, np.maximum(furthest, nearest))
    ahead = goal / np.maximum(np.linalg.norm(goal, axis=1, keepdims=True), 1e-9)
    turned = rotate(between(line, goal), middle - root)
    # A straight limb has no plane of its own, and one that is nearly straight an unsteady one.
    side = outward / np.maximum(np.linalg.norm(outward, axis=1, keepdims=True), 1e-9)
    own = turned - (turned * ahead).sum(axis=1, keepdims=True) * ahead
    lacking = np.maximum(bias * upper - np.linalg.norm(own, axis=1), 0.0)
    turned = turned + lacking[:, None] * side
    across = turned - (turned * ahead).sum(axis=1, keepdims=True) * ahead
    length = np.linalg.norm(across, axis=1, keepdims=True)
    across = across / np.maximum(length, 1e-9)
    along = (upper**2 - lower**2 + distance**2) / (2 * distance)
    off = np.sqrt(np.maximum(upper**2 - along**2, 0.0))
    knee = along[:, None] * ahead + off[:, None] * across
    reached = distance[:, None] * ahead
    return between(middle - root, knee), between(end - middle, reached - knee)


def stand(
    hips: FloatArray,
    ankles: FloatArray,
    bones: FloatArray,
    moves: FloatArray,
    weights: FloatArray,
    frame_rate: float,
    price: float = 0.03,
    eased: float = 0.1,
    rounds: int = 3,
) -> tuple[FloatArray, FloatArray]:
    """Compute moves (T, 3) m of the body and (T, 2, 3) m of the ankles, so that the joints of the legs turn least.

    What lies across the line from hip to ankle costs little: the whole leg turns. What lies along it bends the knee,
    the more the straighter the leg is, so that there the body follows the foot. What the body cannot give to both legs
    is weighed against the angle and in part given up, as by damped least squares (Nakamura and Hanafusa 1986, Inverse
    kinematic solutions with singularity robustness).

    Parameters
    ----------
    hips, ankles : (T, 2, 3) m.
    bones : (T, 2, 2) m, lengths of thigh and shank.
    moves : (T, 2, 3) m, to the places of the ankles.
    weights : (T, 2) of the feet.
    frame_rate : Hz.
    price : m of place that are as bad as a radian of the knee; chosen on walks of six skeletons and HDM05's bd as the
        greatest at which feet slip no more than if they are held at any angle.
    eased : s, over which the body gives way to a leg that turns as a whole.
    rounds : of Gauss and Newton.
    """
    own, wanted = ankles - hips, ankles + moves - hips
    length, longest = np.linalg.norm(own, axis=-1), bones.sum(axis=-1)
    body = (weights[..., None] * moves).sum(axis=1) / weights.sum(axis=1)[:, None]
    stiff = (eased * frame_rate) ** 4 / float(np.square(longest).mean())
    for _ in range(rounds):
        goal = wanted - body[:, None]
        distance = np.linalg.norm(goal, axis=-1)
        line = goal / np.maximum(distance, 1e-9)[..., None]
        folded, slope = _fold(length, bones, distance, price)
        # The length at which the knee would stay as it is, seen from here.
        best = distance - (distance - folded) * (1 + np.square(slope / price))
        along = weights / (price**2 + np.square(slope))
        across = weights / np.square(longest)
        outer = line[..., :, None] * line[..., None, :]
        cost = across[..., None, None] * np.eye(3) + (along - across)[..., None, None] * outer
        turned = own - (own * line).sum(axis=-1, keepdims=True) * line
        gap = wanted - best[..., None] * line - turned
        body = _ease(cost.sum(axis=1), (cost @ gap[..., None])[..., 0].sum(axis=1), stiff)
    goal = wanted - body[:, None]
    distance = np.linalg.norm(goal, axis=-1)
    folded, _ = _fold(length, bones, distance, price)
    return body, body[:, None] + goal * (folded / np.maximum(distance, 1e-9))[..., None] - own


def _fold(
    length: FloatArray, bones: FloatArray, goal: FloatArray, price: float, halvings: int = 30
) -> tuple[FloatArray, FloatArray]:
    """Lengths (...) m of limbs that go from one length towards another, and m by which a radian of bend shortens them.

    The least of the squares of the bend's change and of what lacks in place over ``price``.
    """
    first, second = bones[..., 0], bones[..., 1]
    twice, squares = 2 * first * second, np.square(first) + np.square(second)
    was, full = (np.arccos(np.clip((np.square(one) - squares) / twice, -1.0, 1.0)) for one in (length, goal))
    low, high = was, full
    for _ in range(halvings):
        bent = 0.5 * (low + high)
        reached = np.sqrt(np.maximum(squares + twice * np.cos(bent), 1e-12))
        slope = 0.5 * twice * np.sin(bent) / reached
        beyond = (price**2 * (bent - was) - (reached - goal) * slope) * np.sign(full - was) > 0
        low, high = np.where(beyond, low, bent), np.where(beyond, bent, high)
    return reached, slope


def _ease(cost: FloatArray, pull: FloatArray, stiff: float) -> FloatArray:
    """The curve (T, 3) with least squares by costs (T, 3, 3) and pulls (T, 3), and least acceleration."""
    from scipy.linalg import solveh_banded

    n_frames = len(pull)
    bands = np.zeros((7, 3 * n_frames))
    for row in range(3):
        for column in range(row, 3):
            bands[6 - (column - row), column::3] = cost[:, row, column]
    second = (1.0, -2.0, 1.0)
    for here, there in ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2)):
        within = slice(3 * there, max(3 * (n_frames - 2 + there), 0))
        bands[6 - 3 * (there - here), within] += stiff * second[here] * second[there]
    solved: FloatArray = solveh_banded(bands, pull.reshape(-1), check_finite=False)
    return solved.reshape(n_frames, 3)


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
    grounded : (T,) 1 where it is held, 0 where it is in the air and goes with the body.
    """

    turns: FloatArray
    moves: FloatArray
    stands: BoolArray
    grounded: FloatArray


def plan_foot(
    source: Foot,
    made: Foot,
    scale: float,
    floor: float,
    frame_rate: float,
    size: float,
    *,
    step: tuple[float, float] = (0.03, 0.06),
) -> FootPlan:
    """Plan the turns and moves of a foot so that it stands as the source's.

    A foot that stands a little over or under the floor stands on it: recordings drift by centimetres, and the least
    steps of stairs are 10 cm high.

    Parameters
    ----------
    source, made : the foot of the source, and that of the character, which points as the source's.
    scale : length of the character's legs over that of the source's.
    floor : m, its height.
    frame_rate : Hz.
    size : of the source, in bodies of 1.6 m over the joints.
    step : m on such a body; a foot nearer to the floor than the first stands on it, beyond the second on a step.
    """
    ankle = find_stances(source.ankle, frame_rate, size)
    risen = source.ankle[:, 1] - source.heights[0] - floor
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
        over = source.toe[:, 1] - source.heights[1] - floor
        heights = np.where(over <= risen, toes, heights)
        risen = np.minimum(over, risen)
    moves = np.zeros_like(made.ankle)
    stretches = find_runs(near).tolist()
    for start, end in stretches:
        moves[start + 1 : end] = np.cumsum(steps[start : end - 1], axis=0)
        own = weight[start:end]
        moves[start:end] -= np.average(moves[start:end], axis=0, weights=own)
        off = np.average(risen[start:end, None], axis=0, weights=own)
        off = off * (1 - ramp(np.abs(off) / size, *step))
        moves[start:end, 1] += np.average(heights[start:end] - scale * off - moves[start:end, 1], weights=own)
    return FootPlan(turns, moves, near, _swing(moves, source.ankle / size, stretches, frame_rate))


def level_foot(
    source: Foot,
    made: Foot,
    world: FloatArray,
    rig: Rig,
    side: str,
    frame_rate: float,
    size: float,
    *,
    firm: float = 0.8,
    fewest: int = 5,
    low: float = 0.03,
    most_unequal: float = 0.1,
    slopes: tuple[float, float] = (-1.3, 0.2),
    most_tilt: float = 0.45,
    least_across: float = 0.3,
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
    firm, low, fewest : frames show a flat foot if ankle and toe are held so firmly and the ankle is at most so many m
        above its fifth percentile; so many frames are needed.
    most_unequal, slopes : rad, between the feet of the reference pose, and by which they rise, to show a flat foot.
    most_tilt : rad.
    least_across : share of a vector that lies across the foot.
    """
    still = identity((len(world),))
    if source.toe is None or made.toe is None:
        return still
    ankle, toe = (find_stances(points, frame_rate, size) for points in (source.ankle, source.toe))
    lowest = np.percentile(source.ankle[:, 1], 5)
    stands = (ankle.held * toe.held > firm) & (source.ankle[:, 1] < lowest + low * size)  # not on tiptoe
    up = rotate(rig.body, np.array([0.0, 1.0, 0.0]))
    feet = [rig.direction(f"{one}_ankle", f"{one}_toe") for one in ("left", "right")]
    steep = [_measure_slope(foot, up) for foot in feet]
    if stands.sum() < fewest or abs(steep[0] - steep[1]) > most_unequal or not slopes[0] < max(steep) < slopes[1]:
        return still
    since = multiply(world, conjugate(rig.world[rig.joints[f"{side}_ankle"]]))
    # What is up in the frame of the foot while it stands should be what is up in the reference pose.
    wanted = rotate(conjugate(since[stands]), np.array([0.0, 1.0, 0.0])).mean(axis=0)
    ahead = feet[0 if side == "left" else 1]
    ahead = ahead / max(float(np.linalg.norm(ahead)), 1e-9)
    sides = [vector - vector.dot(ahead) * ahead for vector in (up, wanted)]
    if min(float(np.linalg.norm(vector)) for vector in sides) < least_across:
        return still
    roll = between(*sides)
    tilt = to_axis_angle(between(up, rotate(conjugate(roll), wanted)))
    tilt = tilt * min(1.0, most_tilt / max(float(np.linalg.norm(tilt)), 1e-9))
    turns: FloatArray = multiply(multiply(since, multiply(roll, from_axis_angle(tilt))), conjugate(since))
    return turns


def _measure_slope(directions: FloatArray, up: FloatArray) -> FloatArray:
    """Angle (...) rad by which directions (..., 3) rise."""
    lengths = np.maximum(np.linalg.norm(directions, axis=-1), 1e-9)
    slope: FloatArray = np.arcsin(np.clip((directions * up).sum(axis=-1) / lengths, -1.0, 1.0))
    return slope


def _weigh(stances: Stances, slow: float = 0.1) -> FloatArray:
    """Weight (T,) of a frame for the direction of a standing foot; much less where it is faster than ``slow`` m/s."""
    weights: FloatArray = 1.0 / (1.0 + np.square(stances.speed / slow)) ** 2 * stances.near + 1e-9
    return weights


def _still_direction(directions: FloatArray, held: FloatArray, turns: tuple[float, float] = (0.10, 0.30)) -> FloatArray:
    """Turns (T, 4) that keep a foot's direction (T, 3) where it hardly changes while ankle and toe are held.

    ``turns`` : rad; a foot that turns as little as the one is held, one that turns as much as the other is not.
    """
    unit = directions / np.maximum(np.linalg.norm(directions, axis=1, keepdims=True), 1e-9)
    wanted = unit.copy()
    for start, end in find_runs(held > 0).tolist():
        mean = np.average(unit[start:end], axis=0, weights=held[start:end] ** 2)
        mean /= max(float(np.linalg.norm(mean)), 1e-9)
        away = np.linalg.norm(unit[start:end] - mean, axis=1)
        share = held[start:end] * (1 - ramp(away, *turns))
        wanted[start:end] += share[:, None] * (mean - unit[start:end])
    return between(unit, wanted)


def _share(ankle: Stances, toe: Stances, frame_rate: float, ease: float = 0.05, passing: float = 0.04) -> FloatArray:
    """Share (T - 1,) of the foot that the toe carries between frames: all of it where the ankle moves about it.

    ``ease`` : m/s; of two slower points each carries half the foot. ``passing`` : s, over which one takes over.
    """
    slow = ease**2
    share = (ankle.speed**2 + slow) / (ankle.speed**2 + toe.speed**2 + 2 * slow)
    share = smooth(share, max(1, round(passing * frame_rate)))
    middle: FloatArray = 0.5 * (share[1:] + share[:-1])
    return middle


def _height_over(
    own: FloatArray, made: FloatArray, low: float, height: float, scale: float, floor: float
) -> FloatArray:
    """Lift (T,) m that puts a point over the floor as the source's is, in proportion.

    Parameters
    ----------
    own, made : (T, 3) m, of the source and of the character.
    low, height : m over the floor, where they are in a standing foot.
    """
    lifts: FloatArray = floor + height + scale * (own[:, 1] - floor - low) - made[:, 1]
    return lifts


def _swing(
    moves: FloatArray,
    points: FloatArray,
    stretches: list[tuple[int, int]],
    frame_rate: float,
    away: tuple[float, float] = (0.0, 0.1),
    ease: float = 0.08,
) -> FloatArray:
    """Interpolate moves between places where a foot stands; return how far it is grounded, (T,) 1 to 0.

    Parameters
    ----------
    moves : (T, 3) m; changed in place.
    points : (T, 3) of the source's ankle, in bodies of 1.6 m.
    stretches : where it stands.
    frame_rate : Hz.
    away : m from where it left the floor, or comes down; farther than the second it is in the air.
    ease : s, over which it is let go of or taken.
    """
    grounded = np.zeros(len(moves))
    if not stretches:
        return grounded
    first, last = stretches[0][0], stretches[-1][1]
    moves[:first] = moves[first]
    moves[last:] = moves[last - 1]
    for start, end in stretches:
        grounded[start:end] = 1.0
    for (_, end), (start, _) in pairwise([(0, 0), *stretches, (len(moves), len(moves))]):
        swing = slice(end, start)
        for place in [end - 1] * (end > 0) + [start] * (start < len(moves)):
            near = 1 - ramp(np.linalg.norm(points[swing] - points[place], axis=1), *away)
            grounded[swing] = np.maximum(grounded[swing], near)
    for (_, end), (start, _) in pairwise(stretches):
        share = (np.arange(end, start) - end + 1)[:, None] / (start - end + 1)
        share = share * share * (3 - 2 * share)
        moves[end:start] = (1 - share) * moves[end - 1] + share * moves[start]
    return smooth(grounded, max(1, round(ease * frame_rate)))
