"""Weighs the evidence for the up axis of a file.

Every axis, up or down, gets a score in natural logarithms of odds, the sum of

- posture: people stand and sit far more often than they lie or hang (the direction from feet to head over the file);
- floor: something of the body is nearly always on the floor, and floors are near zero;
- the rest pose, which stands along the up axis of the program that made the skeleton;
- the usual axis of the format, or the declared one;
- gravity: a body in the air falls with 9.81 m/s^2 against the up axis.

The weights were set by hand on files of 20 producers with the axis known from pictures; from the lead of `clear` on, no
file of them was wrong. Below it the answer is a guess, and the next best axis is named.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from dousa.arrays import BoolArray, FloatArray
from dousa.motion.canonical.geometry import body_points
from dousa.motion.canonical.joints import JOINT_INDEX as J
from dousa.motion.canonical.recipes import Recipe

AXES = ("y", "z", "x", "-y", "-z", "-x")
# The unit vector of each axis.
_VECTORS = {name: np.eye(3)["xyz".index(name[-1])] * (-1.0 if name.startswith("-") else 1.0) for name in AXES}

_MATRIX = np.stack(list(_VECTORS.values()))
# Columns of the first three axes, by the same definition.
_COLUMNS = ["xyz".index(axis) for axis in AXES[:3]]

_CLEAR = 1.5  # lead in natural logarithms of odds; measured: from it on no file of the 20 producers was wrong


@dataclass(frozen=True, slots=True)
class Upright:
    """The up axis of a file.

    Parameters
    ----------
    axis : ``"y"``, ``"-z"`` ...
    second : the next best.
    lead : by how much the axis leads, in natural logarithms of odds.
    """

    axis: str
    second: str
    lead: float

    @property
    def clear(self) -> bool:
        """Whether the lead is large enough for more than a guess."""
        return self.lead >= _CLEAR


def _list_ends() -> Iterator[tuple[tuple[str, ...], tuple[str, ...], float]]:
    """Ends of a standing body, the surest first, and the weight of their direction: arms hang, but not always."""
    sides = ("left", "right")
    for top in (("head",), ("neck",), ("left_shoulder", "right_shoulder"), ("pelvis",)):
        for foot in (("left_ankle", "right_ankle"), ("left_knee", "right_knee"), ("pelvis",)):
            if top != foot:
                yield top, foot, 1.0
    yield from (((top,), (f"{side}_ankle",), 1.0) for top in ("head", "neck", "pelvis") for side in sides)
    yield from (((f"{side}_hip",), (f"{side}_ankle",), 1.0) for side in sides)
    yield ("neck",), ("spine",), 0.8
    yield ("head",), ("left_shoulder", "right_shoulder"), 0.6
    yield ("head",), ("neck",), 0.6
    yield from (((f"{side}_shoulder",), (f"{side}_elbow",), 0.4) for side in sides)


def body_direction(points: FloatArray) -> tuple[FloatArray, float]:
    """Compute unit vectors (T, 3) from the lowest to the highest part of the body, and their weight.

    No rows where none is seen. The weight is 1 for a trunk or legs, less for a head or an arm.
    """
    body = points[:, J["head"]] - 0.5 * (points[:, J["left_ankle"]] + points[:, J["right_ankle"]])
    length = np.sqrt(np.einsum("tk,tk->t", body, body))
    if (length > 0).all():
        whole: FloatArray = body / length[:, None]
        return whole, 1.0
    for top, foot, trust in _list_ends():
        ends = (points[:, [J[joint] for joint in joints]].mean(axis=1) for joints in (top, foot))
        body = np.subtract(*ends)
        body = body[~np.isnan(body).any(axis=1)]
        length = np.sqrt(np.einsum("tk,tk->t", body, body))
        if len(body) and (length > 0).all():
            directions: FloatArray = body / length[:, None]
            return directions, trust
    return np.zeros((0, 3)), 0.0


def stands_along(
    points: FloatArray,
    axis: str,
    rest: FloatArray | None,
    *,
    standing: float = 0.8,
    nearly_all: float = 0.9,
    mostly: float = 0.6,
    rest_agrees: float = 0.5,
) -> bool:
    """Return whether the body stands along an axis so clearly that no other evidence is needed.

    Parameters
    ----------
    points : (T, 20, 3) some frames.
    axis : ``"y"``, ``"-z"`` ...
    rest : (3,) from `rest_direction`; a skeleton that stands along the axis needs to do so in fewer frames.
    standing : least cosine between the body and the axis, in the share ``nearly_all`` of the frames.
    mostly : least mean cosine, where the rest pose stands along y.
    rest_agrees : least cosine between the rest pose and the axis.
    """
    upright = None if rest is None else float(rest @ _VECTORS[axis])
    if upright is not None and upright < rest_agrees:
        return False
    body, trust = body_direction(points)
    cosines = body @ _VECTORS[axis]
    if trust < 1:
        return False
    if rest is not None and points_along(rest, axis) and axis == "y" and cosines.mean() > mostly:
        return True
    return bool(np.mean(cosines > standing) >= nearly_all)


def points_along(direction: FloatArray, axis: str, cosine: float = 0.8) -> bool:
    """Return whether a direction (3,) is nearly that of an axis."""
    return bool(direction @ _VECTORS[axis] > cosine)


def rest_direction(recipe: Recipe, rest_positions: FloatArray | None) -> FloatArray | None:
    """Return the direction (3,) in which the rest pose (K, 3) of a skeleton stands; None if it does not."""
    return None if rest_positions is None else _rest_direction(recipe, rest_positions.tobytes())


@lru_cache(maxsize=256)
def _rest_direction(recipe: Recipe, rest_bytes: bytes) -> FloatArray | None:
    rest = body_points(recipe, np.frombuffer(rest_bytes).reshape(1, -1, 3))
    trunk = rest[0, J["neck"]] - rest[0, J["pelvis"]]
    legs = rest[0, [J["left_ankle"], J["right_ankle"]]] - rest[0, [J["left_hip"], J["right_hip"]]]
    legs = legs.sum(axis=0)
    size = np.sqrt((trunk @ trunk) * (legs @ legs))
    if not size > 0 or trunk @ legs > -0.7 * size:
        return None
    found, _ = body_direction(rest)
    return found[0] if len(found) else None


def weigh_axes(
    points: FloatArray,
    height: float,
    rest: FloatArray | None,
    *,
    habit: str | None,
    declared: str | None,
    fall: FloatArray | None = None,
    lying: float = 0.4,
    standing: float = 0.8,
    aligned: float = 0.97,
    tumbling: float = 0.5,
    weak: float = 0.5,
) -> Upright:
    """Weigh the evidence for every axis, with the weights set on the files of 20 producers.

    Parameters
    ----------
    points : (T, 20, 3) canonical points over the whole file, any unit, NaN where absent.
    height : of the body in that unit.
    rest : (3,) from `rest_direction`.
    habit : up axis of the format; None if it has none.
    declared : up axis that the file declares.
    fall : (3,) direction of free fall, from `find_fall`.
    lying, standing : cosine between the body and an axis up to which it lies, and from which on it stands.
    aligned : largest component of the mean direction of a body that stands: a lying one points anywhere.
    tumbling : length of the mean direction below which a body goes over its head and back.
    weak : weight of a direction, such as of an arm, that gives no more than a guess.
    """
    body, trust = body_direction(points)
    scores = np.array([_prior(axis, habit, declared, bare=rest is None) for axis in AXES])
    mean = body.mean(axis=0) if len(body) else np.zeros(3)
    postures = _MATRIX @ mean
    if len(body):
        across = np.abs(postures) < lying
        # Mean cosine between the body and the axis, and the logarithm of how often files are like that.
        cosines, odds = [-1.0, -0.3, 0.0, 0.3, 0.6, 0.8, 1.0], [-8.0, -6.0, -3.5, -2.5, -1.0, -0.1, 0.0]
        scores += trust * np.interp(postures, cosines, odds)
        scores += _score_place(points[..., _COLUMNS] / height, across, _find_centred(points, height)[_COLUMNS])
        if np.abs(mean).max() > aligned:
            scores[across] -= 1.5
    if rest is not None:
        # Rest poses along x are a habit of drawing bones.
        scores += [points_along(rest, axis) * (2.9 if axis[-1] != "x" else 0.3) for axis in AXES]
    if fall is not None:
        scores -= 3.0 * (_MATRIX @ fall)
    first, next_best = np.argsort(-scores, kind="stable")[:2].tolist()
    best, second, lead = AXES[first], AXES[next_best], float(scores[first] - scores[next_best])
    tumbles = len(body) > 0 and float(np.linalg.norm(mean)) < tumbling
    if tumbles and fall is None:  # over its head and back: the up axis is one that it turns away from and back to
        spread = body.var(axis=0)
        order = ("z", "y") if spread[2] > spread[1] else ("y", "z")
        return Upright(*order, 0.0)
    if trust < weak:
        return Upright(best, second, 0.0)
    if habit is not None and best != habit and scores[first] - scores[AXES.index(habit)] < _CLEAR:
        return Upright(habit, best, 0.0)  # nothing clear speaks against the habit
    if fall is None and postures[first] < lying and postures.max() > standing:
        # A body that lies all the time may stand along an unusual axis.
        return Upright(best, AXES[int(postures.argmax())], 0.0)
    return Upright(best, second, lead)


def _prior(axis: str, habit: str | None, declared: str | None, *, bare: bool) -> float:
    score = 0.7 if axis == (habit or "z") else 0.0
    if axis not in ("y", "z"):  # points without a skeleton may be in the axes of a camera, y down
        score += -1.5 if axis == "-y" and bare else -3.0
    if declared is not None and axis == declared:
        score += 4.0
    return score


def _find_centred(points: FloatArray, height: float, near: float = 0.02) -> BoolArray:
    """Columns of x, y, z along which the pelvis was put to zero, by ``near`` heights; none if it was along all."""
    pelvis = points[:, J["pelvis"]]
    pelvis = pelvis[~np.isnan(pelvis).any(axis=1)]
    centred: BoolArray = np.abs(pelvis).max(axis=0, initial=0.0) < near * height
    return centred if len(pelvis) else np.zeros(3, bool)


_LEGS = [J[f"{side}_{joint}"] for joint in ("knee", "ankle", "toe") for side in ("left", "right")]
_TOPS = [J["neck"], J["left_shoulder"], J["right_shoulder"]]


def _score_place(
    points: FloatArray, lying: BoolArray, centred: BoolArray, low: float = 0.45, high: float = 0.95
) -> FloatArray:
    """Score (6,) every axis by where the body is along it: feet on a floor, else shoulders of people who sit or stand.

    Parameters
    ----------
    points : (T, 20, 3) in heights of the body, in the order of the first three axes.
    lying : (6,) whether the body is across the axis.
    centred : (3,) whether the pelvis was put to zero along it.
    low, high : height above zero of the shoulders of people, whose knees are not seen.
    """
    # One joint after the other in the memory: the lowest of all is found several times as fast.
    places = np.ascontiguousarray(points.transpose(1, 2, 0))
    ends = np.minimum.reduce(places), np.maximum.reduce(places)
    if not np.isnan(ends[0].sum()):  # nearly every file shows all joints in all frames
        return _score_floors(*ends, lying, centred)
    seen: BoolArray = np.any(~np.isnan(places), axis=(1, 2))
    scores = np.zeros(len(AXES))
    ends = np.fmin.reduce(places), np.fmax.reduce(places)
    shown = ~np.isnan(ends[0].sum(axis=0))
    if seen[_LEGS].any() and shown.any():
        scores += _score_floors(ends[0][:, shown], ends[1][:, shown], lying, centred)
    if not seen[_LEGS[:4]].any() and seen[_TOPS].any():
        tops = np.nanmedian(places[_TOPS], axis=(0, 2))
        tops = np.concatenate((tops, -tops))
        scores[(low < tops) & (tops < high)] += 1.2
    return scores


def _percentile(ordered: FloatArray, percent: float) -> FloatArray:
    """The percentile of sorted rows (N, T), as NumPy's, which takes several times as long for some hundreds."""
    place = percent / 100 * (ordered.shape[1] - 1)
    below = int(place)
    above = min(below + 1, ordered.shape[1] - 1)
    percentile: FloatArray = ordered[:, below] + (place - below) * (ordered[:, above] - ordered[:, below])
    return percentile


def _score_floors(
    lowest: FloatArray,
    highest: FloatArray,
    lying: BoolArray,
    centred: BoolArray,
    *,
    steady: float = 0.05,
    unsteady: float = 0.15,
    far: float = 0.7,
    below: float = -0.035,
    thin: float = 0.4,
) -> FloatArray:
    """Score (6,) a body that stands, or lies flat, on a floor along each axis; all in heights of the body.

    Parameters
    ----------
    lowest, highest : (3, T) places of its ends.
    lying : (6,) whether the body is across the axis.
    centred : (3,) whether the pelvis was put to zero along it; then its level does not count, and the axis is unlikely
        to be up unless the pelvis is pinned to a place, along more than one: people stand on floors.
    steady, unsteady : scatter of the lowest points over time.
    far : distance of a floor from zero that speaks against it.
    below : a lying body below this is on no floor.
    thin : extent of a body that lies flat.
    """
    ordered = np.sort(np.concatenate((lowest, -highest)), axis=1)
    level, scatter = _percentile(ordered, 2), ordered.std(axis=1)
    on_floor = np.array([2.2, 1.5, 0.5, 0.0])[np.searchsorted([0.04, 0.1, 0.2], np.abs(level))]
    if lying.any():
        flat = _percentile(np.sort(highest - lowest, axis=1), 90) < thin
        on_floor[lying & (on_floor > 0) & np.tile(flat, 2)] += 2.0
        on_floor[lying & (level < below)] = 0.0  # a body on a floor is above it
    on_floor[np.abs(level) > far] = -3.0
    if centred.any():
        on_floor[np.tile(centred, 2)] = 0.0 if centred.sum() > 1 else -1.5
    scores: FloatArray = np.where(scatter <= steady, 1.0, np.where(scatter > unsteady, -1.5, 0.0)) + on_floor
    return scores


@lru_cache(maxsize=16)
def _fit_parabola(n: int, frame_rate: float) -> FloatArray:
    """Weights (n,) of places one after the other that give the acceleration, by least squares."""
    times = (np.arange(n) - (n - 1) / 2) / frame_rate
    weights: FloatArray = np.linalg.pinv(np.stack([np.ones(n), times, 0.5 * times**2], axis=1))[2]
    return weights


def find_fall(
    points: FloatArray,
    frame_rate: float,
    unit: float,
    *,
    window: float = 0.12,
    tolerance: float = 0.12,
    least: float = 0.12,
    gravity: float = 9.81,
) -> FloatArray | None:
    """Find the direction (3,) of free fall; None if it does not last, or directions disagree.

    The middle of all joints stands for the centre of mass: a parabola is fitted to every window of its path, and those
    count whose acceleration is nearly that of gravity.

    Parameters
    ----------
    points : (T, 20, 3) of consecutive frames.
    frame_rate : Hz.
    unit : metres per unit.
    window, least : s, of a parabola and of the whole fall.
    tolerance : share of ``gravity``, m/s^2.
    """
    there = ~np.isnan(points.sum(axis=(0, 2)))
    n = max(5, round(window * frame_rate))
    if not there.any() or frame_rate < 25 or len(points) < 2 * n:
        return None
    path = (points if there.all() else points[:, there]).mean(axis=1) * unit
    weights = _fit_parabola(n, frame_rate)
    acceleration = np.stack([np.correlate(column, weights, "valid") for column in path.T], axis=1)
    size = np.sqrt(np.einsum("tk,tk->t", acceleration, acceleration))
    falling = np.abs(size / gravity - 1) < tolerance
    if np.count_nonzero(falling) < least * frame_rate:
        return None
    # A run of windows in the air, not one moment of a landing.
    together = np.convolve(falling, np.ones(n), "same") >= 0.6 * n
    chosen = falling & together
    if chosen.sum() < least * frame_rate:
        return None
    mean = (acceleration[chosen] / size[chosen, None]).mean(axis=0)
    return mean if np.linalg.norm(mean) > 0.95 else None


def guess_from_cloud(positions: FloatArray) -> str:
    """Return y or z, whichever a cloud of points (T, K, 3) without names is more extended along."""
    seen = positions[~np.isnan(positions).any(axis=(1, 2))]
    if not len(seen):
        return "y"
    extent = np.median(np.ptp(seen, axis=1), axis=0)
    return "z" if extent[2] > extent[1] else "y"
