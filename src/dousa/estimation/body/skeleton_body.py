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
_STRAIGHT = 90.0  # percentile of a distance that bending shortens
_LEAST_SIZE, _GREATEST_SIZE = 0.4, 1.8  # of the body's own: beyond, a point is wrong

# The flesh follows the joints no farther: some recordings' shoulders sit at the neck.
_NARROW, _WIDE = 0.8, 1.25
_LEAST_BENT = 25.0  # percentile of how far the hips are ahead, which bending forward adds to
_AHEAD = 0.15  # of the trunk's height: how far hips or shoulders can be from the line to the neck
_SPINE_RANGE = (0.25, 0.75)  # of the way from hips to neck, where a trunk can bend at all


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


def measure_torso(tracks: Mapping[str, FloatArray]) -> Torso:
    """Measure the torso of the recorded joint places (T, 3)."""
    points = dict(tracks)
    unseen = np.full((1, 3), np.nan)
    for middle in ("hip", "shoulder"):
        points[middle] = 0.5 * (points.get(f"left_{middle}", unseen) + points.get(f"right_{middle}", unseen))

    def distance(one: str, other: str, percentile: float = 50.0) -> float:
        lengths = np.linalg.norm(points.get(one, unseen) - points.get(other, unseen), axis=1)
        return _typical(lengths, percentile)

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


def _typical(values: FloatArray, percentile: float | None = None) -> float:
    """Return a percentile, by default the median, of the known values; NaN without any."""
    known = values[np.isfinite(values)]
    if not len(known):
        return np.nan
    return float(np.median(known) if percentile is None else np.percentile(known, percentile))


def _ahead(points: Mapping[str, FloatArray], middle: FloatArray, percentile: float) -> float:
    """Compute how far a middle lies before the line from the root to the neck."""
    unseen = np.full((1, 3), np.nan)
    root, neck = points.get("pelvis", unseen), points.get("neck", unseen)
    left = points.get("left_shoulder", unseen) - points.get("right_shoulder", unseen)
    front = np.cross(left, neck - root)
    front = front / (np.linalg.norm(front, axis=1, keepdims=True) + 1e-12)
    return _typical(((middle - root) * front).sum(axis=1), percentile)


def _fall(neck: FloatArray, shoulders: FloatArray, hips: FloatArray) -> float:
    """Compute how far the shoulders' middle lies below the neck, along the direction to the hips."""
    down = hips - neck
    falls = ((shoulders - neck) * down).sum(axis=1) / (np.linalg.norm(down, axis=1) + 1e-12)
    return _typical(falls)


def apply_torso(body: BodyModel, measured: Torso) -> BodyModel:
    """Move hips, spine, neck and shoulders to their measured places, with the solids about them."""
    own = body_torso(body)
    if own is None:
        return body
    height = _plausible_size(measured.neck, own.neck, own.neck * measured.shoulders / own.shoulders)
    stretch = height / own.neck
    # A landmark's place is no size: the root may well be the hips' middle.
    root = measured.root if measured.root <= 0.5 * height else own.root * stretch
    spine = measured.spine if np.isfinite(measured.spine) else own.spine * stretch
    spine = float(np.clip(spine, _SPINE_RANGE[0] * height, _SPINE_RANGE[1] * height))
    shoulders = _plausible_size(measured.shoulders, own.shoulders * stretch)
    hips = _plausible_size(measured.hip_breadth, own.hip_breadth) / own.hip_breadth
    breadth = _plausible_size(measured.shoulder_breadth, own.shoulder_breadth) / own.shoulder_breadth
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


def _plausible_size(value: float, usual: float, otherwise: float | None = None) -> float:
    """Return the first plausible size, else the usual one."""
    for tried in (value, otherwise):
        if tried is not None and _LEAST_SIZE * usual <= tried <= _GREATEST_SIZE * usual:
            return float(tried)
    return usual


_LEAST, _GREATEST = 0.6, 1.6  # of the scale of the whole body: a bone beyond is a wrong point
_SIDES_AGREE = 0.10  # left and right that differ by less are one length, seen twice
_MOST_FRAMES = 200
_OVER_JOINTS = 1.085  # stature over the height of the joints: three people of HDM05, within 1 %


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
        if owners[row] >= 0 and lengths[row] > 0 and _is_limb(body, row):
            ratios[row] = _distance(tracks, names[owners[row]], name) / lengths[row]
    torso = measure_torso(tracks)
    overall = _overall(body, ratios, torso)
    ratios = _even_sides(names, _believable(body, ratios / overall))
    grown = apply_torso(_grow(body, overall), torso)
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


def _believable(body: BodyModel, ratios: FloatArray) -> FloatArray:
    """Drop implausible ratios of joints; ratios of tips are clipped."""
    joints = np.arange(len(ratios)) < body.n_parts
    wrong = joints & ~((ratios >= _LEAST) & (ratios <= _GREATEST))
    return np.where(wrong, np.nan, np.clip(ratios, _LEAST, _GREATEST))


def _even_sides(names: tuple[str, ...], ratios: FloatArray) -> FloatArray:
    """Average left and right where they agree, or where one of them is unknown."""
    even = ratios.copy()
    for row, name in enumerate(names):
        if not name.startswith("left_") or (other := "right_" + name[5:]) not in names:
            continue
        pair = [row, names.index(other)]
        known = ratios[pair][np.isfinite(ratios[pair])]
        if len(known) and np.ptp(known) <= _SIDES_AGREE * known.mean():
            even[pair] = known.mean()
    return even


def _grow(body: BodyModel, scale: float) -> BodyModel:
    return replace(
        body,
        offsets=scale * body.offsets,
        tip_offsets=scale * body.tip_offsets,
        spheres=scale * body.spheres,
        stature=scale * body.stature,
    )


def _tracks(body: BodyModel, positions: ArrayLike | Mapping[str, ArrayLike]) -> dict[str, FloatArray]:
    """Return name -> (T, 3) of the body's joints and tips, with a limited number of frames."""
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
            tracks[name] = track[:: max(1, len(track) // _MOST_FRAMES)]
    return tracks


def _distance(tracks: Mapping[str, FloatArray], one: str, other: str) -> float:
    if one not in tracks or other not in tracks:
        return np.nan
    return _typical(np.linalg.norm(tracks[one] - tracks[other], axis=1))


def _is_limb(body: BodyModel, row: int) -> bool:
    """Return whether a point determines the length of its parent part: a tip, or a joint without siblings."""
    if row >= body.n_parts:
        return True
    return row > 0 and int((body.parents == body.parents[row]).sum()) == 1


def body_from_motion(motion: Motion | Trajectories | CanonicalMotion, sex: str = "average") -> BodyModel:
    """Return the body of a recorded person: bones from the skeleton, girths from the tables, see `make_human`.

    Missing joints keep the tables' proportions.

    Parameters
    ----------
    motion : any motion whose joints can be identified (BVH, ASF/AMC, C3D, TRC ...), in m, or its canonical joints.
    sex : as in `make_human`; changes girths only.

    Raises
    ------
    JointMappingError : the joints cannot be distinguished.
    BodyModelError : an implausible size, perhaps by a wrong unit.
    """
    canonical = require_whole(motion if isinstance(motion, CanonicalMotion) else canonicalise(motion))
    frames = slice(None, None, max(1, canonical.n_frames // _MOST_FRAMES))
    positions = canonical.positions[frames].copy()
    if canonical.missing is not None:
        positions[canonical.missing[frames]] = np.nan
    made_up = [index for index, name in enumerate(CANONICAL_JOINTS) if name in canonical.mapping.derived]
    positions[:, made_up] = np.nan
    return fit_body(make_human(_OVER_JOINTS * canonical.height, sex), positions)
