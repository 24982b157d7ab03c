"""From an arbitrary unit and axes to metres, with Y up and the floor at 0: by what people are like.

Metres: ankle to knee to hip to shoulder is 0.775 of a person's stature, and hardly depends on the posture or on where
networks put hips, which are between (Winter, Biomechanics and Motor Control of Human Movement: 0.779; on films of a man
of 1.72 m: 0.768). Up: the centre of mass is above the feet that carry it, most cameras stand upright (their
rows are level), and feet that rest are on one plane. The first camera looks from +Z.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dousa.arrays import FloatArray
from dousa.estimation.calibration.bundle import Rig

_CHAIN, _ARM = 0.775, 0.325  # shares of stature: ankle to knee to hip to shoulder, shoulder to elbow to wrist
_ROLL, _LEAN = np.radians(4.0), np.radians(3.0)  # how far cameras are tilted sideways, and people off their balance
_LIFTED = 0.08  # m, by which the foot that does not carry is above the other
# Shares of the body's mass between two points (Winter), arms and head by the trunk's ends.
_MASSES = {("hip", "shoulder"): 0.6, ("hip", "knee"): 0.2, ("knee", "ankle"): 0.093, ("shoulder", "elbow"): 0.06,
           ("elbow", "wrist"): 0.047}  # fmt: skip
_FOOT_SPREAD, _FEET = 0.03, 10.0  # m that feet are off the plane, and how many of them tell something of their own
_RESTING = 0.25  # m/s
_NEAR_FLOOR = 0.12  # m
_LOW = 0.15  # quantile of a foot's heights at which it rests
# Of the stature, above the floor.
_HEIGHTS = {"heel": 0.025, "foot_index": 0.005, "big_toe": 0.005, "ankle": 0.06}


def measure_stature(points: FloatArray, names: Sequence[str]) -> float | None:
    """The stature in the unit of points (T, K, 3) that are nan where unknown; None where no limb tells it."""
    chain = [
        _length(points, names, "ankle", "knee"),
        _length(points, names, "knee", "hip"),
        _middle_length(points, names, "hip", "shoulder"),
    ]
    if all(part is not None for part in chain):
        return sum(part for part in chain if part is not None) / _CHAIN
    arm = [_length(points, names, "shoulder", "elbow"), _length(points, names, "elbow", "wrist")]
    if all(part is not None for part in arm):
        return sum(part for part in arm if part is not None) / _ARM
    return None


def _length(points: FloatArray, names: Sequence[str], first: str, second: str) -> float | None:
    """The middle length of a limb over both sides."""
    sides = [(f"{side}_{first}", f"{side}_{second}") for side in ("left", "right")]
    there = [(names.index(a), names.index(b)) for a, b in sides if a in names and b in names]
    lengths = [np.linalg.norm(points[:, a] - points[:, b], axis=-1) for a, b in there]
    found = [float(np.nanmedian(some)) for some in lengths if np.isfinite(some).any()]
    return float(np.mean(found)) if found else None


def _middle_length(points: FloatArray, names: Sequence[str], first: str, second: str) -> float | None:
    ends = [find_middle(points, names, name) for name in (first, second)]
    lengths = np.linalg.norm(ends[0] - ends[1], axis=-1)
    return float(np.nanmedian(lengths)) if np.isfinite(lengths).any() else None


def find_middle(points: FloatArray, names: Sequence[str], name: str) -> FloatArray:
    """(T, 3) the middle between the left and the right point; nan where one is unknown."""
    pair = [f"{side}_{name}" for side in ("left", "right")]
    if not all(one in names for one in pair):
        return np.full((len(points), 3), np.nan)
    return np.asarray(points[:, [names.index(one) for one in pair]].mean(axis=1), np.float64)


def find_world(
    rig: Rig, points: FloatArray, names: Sequence[str], stature: float, moments: FloatArray
) -> tuple[Rig, FloatArray] | None:
    """The rig and the points in metres, Y up, the floor at 0, the person about the origin.

    Parameters
    ----------
    rig : in an arbitrary unit and axes.
    points : (T, K, 3) in them, nan where unknown.
    names : (K,) of the points.
    stature : m.
    moments : (T,) s.

    Returns
    -------
    Both, moved, turned and scaled; None where no limb tells the scale.
    """
    measured = measure_stature(points, names)
    if measured is None or not measured > 0:
        return None
    scale = stature / measured
    points = points * scale
    rig = replace(rig, translations=rig.translations * scale)
    up = _find_up(rig, points, names, moments)
    middle = find_middle(points, names, "hip")
    middle = points.reshape(-1, 3) if not np.isfinite(middle).any() else middle
    centre = np.nanmedian(middle, axis=0)
    front = rig.positions[0] - centre
    front -= up * (front @ up)
    if np.linalg.norm(front) < 1e-6:
        front = np.cross(up, (1.0, 0.0, 0.0))
    front /= np.linalg.norm(front)
    axes = np.stack((np.cross(up, front), up, front))  # from the old world to the new
    heights = _find_heights((points - centre) @ axes.T, names, stature)
    shift = -axes @ centre - np.array([0.0, heights, 0.0])
    turned = rig.rotations @ axes.T
    return replace(rig, rotations=turned, translations=rig.translations - turned @ shift), points @ axes.T + shift


def _find_up(rig: Rig, points: FloatArray, names: Sequence[str], moments: FloatArray) -> FloatArray:
    """The unit vector from the feet that carry people to their centres of mass, and square to rows and resting feet."""
    level, cameras = rig.rotations[:, 0], -rig.rotations[:, 1].mean(axis=0)
    along = find_middle(points, names, "shoulder") - find_middle(points, names, "ankle")
    along = along[np.isfinite(along).all(axis=-1)]
    up = along.sum(axis=0) if len(along) else cameras
    up = up / max(float(np.linalg.norm(up)), 1e-9)
    for _ in range(6):
        carried = _find_load(points, names, moments, up)
        lean = up if carried is None else carried
        form = (np.eye(3) - np.outer(lean, lean)) / _LEAN**2
        weights = 1.0 / (1.0 + (level @ up / _ROLL) ** 2)  # a tripod may be tilted
        form += np.einsum("v,vi,vj->ij", weights, level, level) / _ROLL**2
        feet = _find_resting(points, names, moments, up)
        if len(feet) >= _FEET:
            form += _FEET * np.cov(feet.T) / _FOOT_SPREAD**2
        up = _smallest(form, lean)
    return np.asarray(up, np.float64)


def _find_load(points: FloatArray, names: Sequence[str], moments: FloatArray, up: FloatArray) -> FloatArray | None:
    """The unit vector from the feet that carry the body to its centre of mass, over all moments; None if unknown.

    Who does not fall has the centre of mass above the feet that carry it, whatever the posture.
    """
    mass, total = np.zeros((len(points), 3)), 0.0
    for (first, second), share in _MASSES.items():
        mass += share * (find_middle(points, names, first) + find_middle(points, names, second)) / 2.0
        total += share
    feet = [_find_foot(points, names, side) for side in ("left", "right")]
    if len(points) < 3 or any(foot is None for foot in feet):
        return None
    both = np.stack([foot for foot in feet if foot is not None])
    speeds = np.linalg.norm(np.gradient(both, moments, axis=1), axis=-1)
    heights = both @ up
    carries = (speeds < 2 * _RESTING) & (heights < np.nanmin(heights, axis=0, initial=np.inf) + _LIFTED)
    count = carries.sum(axis=0)
    place = np.where(carries[..., None], both, 0.0).sum(axis=0) / np.maximum(count, 1)[:, None]
    way = (mass / total - place)[count > 0]
    way = way[np.isfinite(way).all(axis=-1)]
    if len(way) < 3:
        return None
    mean = np.median(way, axis=0)
    return np.asarray(mean / np.linalg.norm(mean))


def _find_foot(points: FloatArray, names: Sequence[str], side: str) -> FloatArray | None:
    """(T, 3) the middle of the foot's points."""
    there = [names.index(f"{side}_{kind}") for kind in _HEIGHTS if f"{side}_{kind}" in names]
    return np.asarray(points[:, there].mean(axis=1)) if there else None


def _smallest(form: FloatArray, about: FloatArray) -> FloatArray:
    vector = np.linalg.eigh(form)[1][:, 0]
    return np.asarray(vector if vector @ about > 0 else -vector)


def _find_resting(points: FloatArray, names: Sequence[str], moments: FloatArray, up: FloatArray) -> FloatArray:
    """(N, 3) feet that rest near the floor, each less the middle height of its kind."""
    kept = []
    for kind in _HEIGHTS:
        for side in ("left", "right"):
            if f"{side}_{kind}" not in names:
                continue
            track = points[:, names.index(f"{side}_{kind}")]
            speeds = np.linalg.norm(np.gradient(track, moments, axis=0), axis=-1) if len(track) > 2 else np.zeros(0)
            heights = track @ up
            if len(speeds) < 3 or not np.isfinite(heights).any():
                continue
            floor = np.nanquantile(heights, _LOW)
            rest = track[(np.nan_to_num(speeds, nan=np.inf) < _RESTING) & (np.abs(heights - floor) < _NEAR_FLOOR)]
            if len(rest) >= 3:
                kept.append(rest - up * np.median(rest @ up))
    return np.concatenate(kept) if kept else np.zeros((0, 3))


def _find_heights(points: FloatArray, names: Sequence[str], stature: float) -> float:
    """The height of the floor among points whose Y is up."""
    found = []
    for kind, share in _HEIGHTS.items():
        both = [names.index(f"{side}_{kind}") for side in ("left", "right") if f"{side}_{kind}" in names]
        heights = points[:, both, 1]
        if np.isfinite(heights).any():
            found.append(float(np.nanquantile(heights, _LOW / 2)) - share * stature)
    return float(np.median(found)) if found else float(np.nanmin(points[..., 1]))
