"""Pelvis and trunk of a person by what was measured: their joints are landmarks, their solids stay where they were."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dousa.estimation.body import BodyModel

__all__ = ["Torso", "apply_torso", "body_torso", "measure_torso"]

FloatArray = NDArray[np.float64]

_NEEDED = ("pelvis", "spine", "neck", "left_hip", "right_hip", "left_shoulder", "right_shoulder")
_STRAIGHT = 90.0  # percentile of a distance that bending shortens
_LEAST, _GREATEST = 0.4, 1.8  # of the body's own: beyond, a point is wrong
_NARROW, _WIDE = (
    0.8,
    1.25,
)  # the flesh follows the joints no farther: some recordings' shoulders sit at the neck
_LEAST_BENT = 25.0  # percentile of how far the hips are ahead, which bending forward adds to
_AHEAD = (
    0.15  # of the trunk's height: as far as hips or shoulders can be before or behind the line to the neck
)
_SPINE_RANGE = (0.25, 0.75)  # of the way from hips to neck, where a trunk can bend at all


@dataclass(frozen=True, slots=True)
class Torso:
    """Sizes in metres; NaN where not told.

    Parameters
    ----------
    hip_breadth, shoulder_breadth : between the joints of both sides.
    root, spine, neck, shoulders : heights over the middle of the hips, of a straight person.
    hips_ahead, shoulders_ahead : of the hips before the line from the root to the neck, and of the shoulders.
    """

    hip_breadth: float
    shoulder_breadth: float
    root: float
    spine: float
    neck: float
    shoulders: float
    hips_ahead: float
    shoulders_ahead: float


def body_torso(body: BodyModel) -> Torso | None:
    """The sizes of a body whose joints have the names of a person's; None for others."""
    if not set(_NEEDED) <= set(body.joints):
        return None
    place = {name: body.offsets[body.joints.index(name)] for name in _NEEDED}
    root = -0.5 * (place["left_hip"][1] + place["right_hip"][1])
    spine = root + place["spine"][1]
    return Torso(
        hip_breadth=float(place["left_hip"][0] - place["right_hip"][0]),
        shoulder_breadth=float(place["left_shoulder"][0] - place["right_shoulder"][0]),
        root=float(root),
        spine=float(spine),
        neck=float(spine + place["neck"][1]),
        shoulders=float(spine + 0.5 * (place["left_shoulder"][1] + place["right_shoulder"][1])),
        hips_ahead=float(0.5 * (place["left_hip"][2] + place["right_hip"][2])),
        shoulders_ahead=float(0.5 * (place["left_shoulder"][2] + place["right_shoulder"][2])),
    )


def measure_torso(tracks: Mapping[str, FloatArray]) -> Torso:
    """The sizes of whom joint places (T, 3) were recorded of."""
    points = dict(tracks)
    unseen = np.full((1, 3), np.nan)
    for middle in ("hip", "shoulder"):
        points[middle] = 0.5 * (points.get(f"left_{middle}", unseen) + points.get(f"right_{middle}", unseen))

    def distance(one: str, other: str, percentile: float = 50.0) -> float:
        lengths = np.linalg.norm(points.get(one, unseen) - points.get(other, unseen), axis=1)
        lengths = lengths[np.isfinite(lengths)]
        return float(np.percentile(lengths, percentile)) if len(lengths) else np.nan

    ahead = _ahead(points, points["hip"], _LEAST_BENT)
    root = distance("pelvis", "hip")
    if np.isfinite(ahead):  # the hips' way from the root is down and ahead
        root = float(np.sqrt(max(root**2 - ahead**2, 0.0)))
    spine = root + distance("pelvis", "spine")
    neck = spine + distance("spine", "neck")
    if np.isnan(neck):
        above = root + distance("pelvis", "neck", _STRAIGHT)
        neck = distance("hip", "neck", _STRAIGHT) if np.isnan(above) else above
    drop = _fall(points.get("neck", unseen), points["shoulder"], points["hip"])
    straight = distance("hip", "shoulder", _STRAIGHT) if np.isnan(neck) else neck - drop
    return Torso(
        distance("left_hip", "right_hip"),
        distance("left_shoulder", "right_shoulder"),
        root,
        spine,
        neck,
        straight,
        ahead,
        _ahead(points, points["shoulder"], 50.0),
    )


def _ahead(points: Mapping[str, FloatArray], middle: FloatArray, percentile: float) -> float:
    """How far a middle lies before the line from the root to the neck."""
    unseen = np.full((1, 3), np.nan)
    root, neck = points.get("pelvis", unseen), points.get("neck", unseen)
    left = points.get("left_shoulder", unseen) - points.get("right_shoulder", unseen)
    front = np.cross(left, neck - root)
    front = front / (np.linalg.norm(front, axis=1, keepdims=True) + 1e-12)
    distances = ((middle - root) * front).sum(axis=1)
    distances = distances[np.isfinite(distances)]
    return float(np.percentile(distances, percentile)) if len(distances) else np.nan


def _fall(neck: FloatArray, shoulders: FloatArray, hips: FloatArray) -> float:
    """How far the shoulders' middle lies below the neck, along the way to the hips."""
    down = hips - neck
    falls = ((shoulders - neck) * down).sum(axis=1) / (np.linalg.norm(down, axis=1) + 1e-12)
    falls = falls[np.isfinite(falls)]
    return float(np.median(falls)) if len(falls) else np.nan


def apply_torso(body: BodyModel, measured: Torso) -> BodyModel:
    """Move hips, spine, neck and shoulders to their measured places and keep the solids about them."""
    own = body_torso(body)
    if own is None:
        return body
    height = _told(measured.neck, own.neck, own.neck * measured.shoulders / own.shoulders)
    stretch = height / own.neck
    # A landmark's place is no size: the root may well be the hips' middle.
    root = measured.root if measured.root <= 0.5 * height else own.root * stretch
    spine = measured.spine if np.isfinite(measured.spine) else own.spine * stretch
    spine = float(np.clip(spine, _SPINE_RANGE[0] * height, _SPINE_RANGE[1] * height))
    shoulders = _told(measured.shoulders, own.shoulders * stretch)
    hips = _told(measured.hip_breadth, own.hip_breadth) / own.hip_breadth
    breadth = _told(measured.shoulder_breadth, own.shoulder_breadth) / own.shoulder_breadth
    offsets, spheres = body.offsets.copy(), body.spheres.copy()
    row = {name: body.joints.index(name) for name in _NEEDED}
    ahead = [
        float(np.clip(there, -_AHEAD * height, _AHEAD * height)) if np.isfinite(there) else here
        for there, here in (
            (measured.hips_ahead, own.hips_ahead),
            (measured.shoulders_ahead, own.shoulders_ahead),
        )
    ]
    moves = {"hip": (-root, hips, ahead[0]), "shoulder": (shoulders - spine, breadth, ahead[1])}
    for name, (place, scale, forward) in moves.items():
        for side in ("left", "right"):
            offsets[row[f"{side}_{name}"], 0] *= scale
            offsets[row[f"{side}_{name}"], 1:] = place, forward
    offsets[row["spine"], 1], offsets[row["neck"], 1] = spine - root, height - spine
    flesh = float(np.clip(breadth, _NARROW, _WIDE))
    for joint, before, after, scale in (("pelvis", own.root, root, 1.0), ("spine", own.spine, spine, flesh)):
        solid = slice(*body.sphere_starts[row[joint] : row[joint] + 2])
        spheres[solid, 1] = (spheres[solid, 1] + before) * stretch - after
        spheres[solid, 0] *= scale
    spheres[slice(*body.sphere_starts[:2]), 2] += ahead[0] - own.hips_ahead
    return replace(body, offsets=offsets, spheres=spheres)


def _told(value: float, usual: float, otherwise: float | None = None) -> float:
    """A measured size if it can be one, else what is known of it otherwise, else the body's own."""
    for tried in (value, otherwise):
        if tried is not None and _LEAST * usual <= tried <= _GREATEST * usual:
            return float(tried)
    return usual
