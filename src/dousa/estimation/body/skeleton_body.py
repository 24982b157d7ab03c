"""A body with the bones of a recorded person: lengths from joint places, girths scaled along."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from dousa.arrays import FloatArray
from dousa.errors import BodyModelError
from dousa.estimation.body.body import BodyModel, reshape
from dousa.estimation.body.human import make_human
from dousa.estimation.body.kinematics import point_names
from dousa.motion import CanonicalMotion, Motion, Trajectories, canonicalise
from dousa.motion.canonical.canonicalise import require_whole
from dousa.motion.canonical.joints import CANONICAL_JOINTS

_NEEDED = ("pelvis", "spine", "neck", "left_hip", "right_hip", "left_shoulder", "right_shoulder")


@dataclass(frozen=True, slots=True)
class Torso:
    """Sizes in metres; NaN where unknown.

    Parameters
    ----------
    hip_breadth, shoulder_breadth : between the joints of both sides.
    root, spine, neck, shoulders : heights over the middle of the hips, of a straight person.
    hips_ahead, shoulders_ahead : of hips and shoulders before the line from the root to the neck.
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
    """Return the torso of a body with a person's joint names; None for others."""
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


def measure_torso(tracks: Mapping[str, FloatArray], straight: float = 90.0, least_bent: float = 25.0) -> Torso:
    """Measure the torso of the recorded joint places (T, 3).

    Bending shortens distances to the neck, of which the percentile ``straight`` counts, and brings the hips ahead of
    the line from root to neck, where ``least_bent`` does; of all else the median.
    """
    points = dict.fromkeys(_NEEDED, np.full((1, 3), np.nan)) | dict(tracks)
    for middle in ("hip", "shoulder"):
        points[middle] = 0.5 * (points[f"left_{middle}"] + points[f"right_{middle}"])

    def distance(one: str, other: str, percentile: float = 50.0) -> float:
        return _typical(np.linalg.norm(points[one] - points[other], axis=1), percentile)

    ahead = _ahead(points, points["hip"], least_bent)
    root = distance("pelvis", "hip")
    if np.isfinite(ahead):  # the hips' way from the root is down and ahead
        root = float(np.sqrt(max(root**2 - ahead**2, 0.0)))
    spine = root + distance("pelvis", "spine")
    neck = spine + distance("spine", "neck")
    if np.isnan(neck):
        above = root + distance("pelvis", "neck", straight)
        neck = distance("hip", "neck", straight) if np.isnan(above) else above
    down = points["hip"] - points["neck"]
    drops = ((points["shoulder"] - points["neck"]) * down).sum(axis=1) / (np.linalg.norm(down, axis=1) + 1e-12)
    shoulders = distance("hip", "shoulder", straight) if np.isnan(neck) else neck - _typical(drops)
    return Torso(
        distance("left_hip", "right_hip"),
        distance("left_shoulder", "right_shoulder"),
        root,
        spine,
        neck,
        shoulders,
        ahead,
        _ahead(points, points["shoulder"], 50.0),
    )


def _typical(values: FloatArray, percentile: float | None = None) -> float:
    """Return a percentile, by default the median, of the known values; NaN without any."""
    known = values[np.isfinite(values)]
    if not len(known):
        return np.nan
    return float(np.median(known) if percentile is None else np.percentile(known, percentile))


def _ahead(points: Mapping[str, FloatArray], middle: FloatArray, percentile: float) -> float:
    """Compute how far a middle lies before the line from the root to the neck."""
    up = points["neck"] - points["pelvis"]
    front = np.cross(points["left_shoulder"] - points["right_shoulder"], up)
    front = front / (np.linalg.norm(front, axis=1, keepdims=True) + 1e-12)
    return _typical(((middle - points["pelvis"]) * front).sum(axis=1), percentile)


def apply_torso(
    body: BodyModel,
    measured: Torso,
    *,
    farthest_ahead: float = 0.15,
    spine_range: tuple[float, float] = (0.25, 0.75),
    flesh_range: tuple[float, float] = (0.8, 1.25),
) -> BodyModel:
    """Move hips, spine, neck and shoulders to their measured places, with the solids about them.

    Limits: hips and shoulders lie at most ``farthest_ahead`` of the trunk's height before the line to the neck; the
    spine bends in ``spine_range`` of the way from hips to neck; the flesh follows the shoulders' breadth in
    ``flesh_range``, as some recordings' shoulders sit at the neck.
    """
    own = body_torso(body)
    if own is None:
        return body
    height = _plausible_size(measured.neck, own.neck, own.neck * measured.shoulders / own.shoulders)
    stretch = height / own.neck
    # A landmark's place is no size: the root may well be the hips' middle.
    root = measured.root if measured.root <= 0.5 * height else own.root * stretch
    spine = measured.spine if np.isfinite(measured.spine) else own.spine * stretch
    spine = float(np.clip(spine, spine_range[0] * height, spine_range[1] * height))
    shoulders = _plausible_size(measured.shoulders, own.shoulders * stretch)
    hips = _plausible_size(measured.hip_breadth, own.hip_breadth) / own.hip_breadth
    breadth = _plausible_size(measured.shoulder_breadth, own.shoulder_breadth) / own.shoulder_breadth
    offsets, spheres = body.offsets.copy(), body.spheres.copy()
    row = {name: body.joints.index(name) for name in _NEEDED}
    ahead = [
        float(np.clip(there, -farthest_ahead * height, farthest_ahead * height)) if np.isfinite(there) else here
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
    flesh = float(np.clip(breadth, *flesh_range))
    for joint, before, after, scale in (("pelvis", own.root, root, 1.0), ("spine", own.spine, spine, flesh)):
        solid = slice(*body.sphere_starts[row[joint] : row[joint] + 2])
        spheres[solid, 1] = (spheres[solid, 1] + before) * stretch - after
        spheres[solid, 0] *= scale
    spheres[slice(*body.sphere_starts[:2]), 2] += ahead[0] - own.hips_ahead
    return replace(body, offsets=offsets, spheres=spheres)


def _plausible_size(
    value: float, usual: float, otherwise: float | None = None, least: float = 0.4, most: float = 1.8
) -> float:
    """Return the first size of ``least`` to ``most`` times the usual one, else that: beyond, a point is wrong."""
    for tried in (value, otherwise):
        if tried is not None and least * usual <= tried <= most * usual:
            return float(tried)
    return usual


def fit_body(body: BodyModel, positions: ArrayLike | Mapping[str, ArrayLike]) -> BodyModel:
    """Return the body with the bones of the person of the recorded joint places.

    Limbs take the median distance of their joints over the frames; left and right are one where they agree within
    10 %. Hips and shoulders take breadth and height, root and tips their recorded places. Girths and stature follow the
    bones in the mean.

    Parameters
    ----------
    body : any tree of parts with named joints and tips.
    positions : (20, 3) or (T, 20, 3) m in the order of `CANONICAL_JOINTS`, or name -> (3,) or (T, 3); NaN where
        unknown. Missing bones keep the body's own proportion.

    Raises
    ------
    BodyModelError : no bone of the body has both its ends, or positions of another shape.
    """
    tracks = _tracks(body, positions)
    names = point_names(body)
    owners = np.concatenate((body.parents, body.tip_parts))
    lengths = np.linalg.norm(np.concatenate((body.offsets, body.tip_offsets)), axis=1)
    ratios = np.full(len(names), np.nan)
    for row, name in enumerate(names):
        # A tip, or a joint without siblings, determines the length of its parent part.
        if owners[row] < 0 or lengths[row] == 0 or (row < body.n_parts and (body.parents == owners[row]).sum() > 1):
            continue
        if name in tracks and names[owners[row]] in tracks:
            apart = np.linalg.norm(tracks[names[owners[row]]] - tracks[name], axis=1)
            ratios[row] = _typical(apart) / lengths[row]
    torso = measure_torso(tracks)
    overall = _overall(body, ratios, torso)
    ratios = _even_sides(names, _believable(body, ratios / overall))
    fields = ("offsets", "tip_offsets", "spheres", "stature")
    grown = apply_torso(replace(body, **{field: overall * getattr(body, field) for field in fields}), torso)
    points = np.concatenate((grown.offsets, grown.tip_offsets)) * np.where(np.isnan(ratios), 1.0, ratios)[:, None]
    # Tips are landmarks and stretch no solid: the head's may be the crown or a point between the ears.
    stretched = reshape(grown, points[: body.n_parts], grown.tip_offsets)
    return replace(stretched, tip_offsets=points[body.n_parts :])


def _overall(body: BodyModel, ratios: FloatArray, torso: Torso) -> float:
    """Compute the scale of the person by the mean of the bones that make up the height."""
    lengths = np.linalg.norm(body.offsets, axis=1)
    sizes = [(lengths[row], ratios[row]) for row in range(body.n_parts)]
    own = body_torso(body)
    if own is not None:
        upright = [sizes[row] for row, joint in enumerate(body.joints) if joint.endswith(("_knee", "_ankle"))]
        upright.append((own.neck, torso.neck / own.neck))
        sizes = upright if any(_is_measured(ratio) for _, ratio in upright) else sizes
    known = [(length, ratio) for length, ratio in sizes if _is_measured(ratio)]
    if not known:
        raise BodyModelError("pose.no_bone", points=point_names(body))
    weights, shares = np.array(known).T
    return float((weights * shares).sum() / weights.sum())


def _is_measured(ratio: float) -> bool:
    return bool(np.isfinite(ratio) and ratio > 0)


def _believable(body: BodyModel, ratios: FloatArray, least: float = 0.6, most: float = 1.6) -> FloatArray:
    """Drop ratios of joints beyond ``least`` to ``most``, where a point is wrong; ratios of tips are clipped."""
    wrong = (np.arange(len(ratios)) < body.n_parts) & ~((ratios >= least) & (ratios <= most))
    return np.where(wrong, np.nan, np.clip(ratios, least, most))


def _even_sides(names: tuple[str, ...], ratios: FloatArray, agree: float = 0.10) -> FloatArray:
    """Average left and right where they differ by at most the share ``agree``, or where one of them is unknown."""
    even = ratios.copy()
    for row, name in enumerate(names):
        if not name.startswith("left_") or (other := "right_" + name[5:]) not in names:
            continue
        pair = [row, names.index(other)]
        known = ratios[pair][np.isfinite(ratios[pair])]
        if len(known) and np.ptp(known) <= agree * known.mean():
            even[pair] = known.mean()
    return even


def _tracks(
    body: BodyModel, positions: ArrayLike | Mapping[str, ArrayLike], most_frames: int = 200
) -> dict[str, FloatArray]:
    """Return name -> (T, 3) of the body's joints and tips, with some ``most_frames`` frames."""
    if not isinstance(positions, Mapping):
        array = np.asarray(positions, np.float64)
        if array.ndim not in (2, 3) or array.shape[-2:] != (len(CANONICAL_JOINTS), 3):
            raise BodyModelError("pose.places_over_time", joints=len(CANONICAL_JOINTS), found=str(array.shape))
        positions = dict(zip(CANONICAL_JOINTS, np.moveaxis(array, -2, 0), strict=True))
    tracks = {}
    for name in set(point_names(body)) & set(positions):
        track = np.atleast_2d(np.asarray(positions[name], np.float64))
        if track.ndim != 2 or track.shape[1] != 3:
            raise BodyModelError("pose.track", joint=name, found=str(track.shape))
        if np.isfinite(track).all(axis=1).any():
            tracks[name] = track[:: max(1, len(track) // most_frames)]
    return tracks


def body_from_motion(
    motion: Motion | Trajectories | CanonicalMotion, sex: str = "average", *, over_joints: float = 1.085
) -> BodyModel:
    """Return the body of a recorded person: bones from the skeleton, girths from the tables, see `make_human`.

    Missing joints keep the tables' proportions.

    Parameters
    ----------
    motion : any motion whose joints can be identified (BVH, ASF/AMC, C3D, TRC ...), in m, or its canonical joints.
    sex : as in `make_human`; changes girths only.
    over_joints : stature over the height of the joints: of three people of HDM05, within 1 %.

    Raises
    ------
    JointMappingError : the joints cannot be distinguished.
    BodyModelError : an implausible size, perhaps by a wrong unit.
    """
    canonical = require_whole(motion if isinstance(motion, CanonicalMotion) else canonicalise(motion))
    positions = canonical.positions.copy()
    if canonical.missing is not None:
        positions[canonical.missing] = np.nan
    made_up = [index for index, name in enumerate(CANONICAL_JOINTS) if name in canonical.mapping.derived]
    positions[:, made_up] = np.nan
    return fit_body(make_human(over_joints * canonical.height, sex), positions)
