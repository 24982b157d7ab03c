"""A body with the bones of a recorded person: lengths from joint places, girths scaled along."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dousa.errors import BodyModelError
from dousa.estimation._reshaping import reshape
from dousa.estimation._torso_fit import Torso, apply_torso, body_torso, measure_torso
from dousa.estimation.body import BodyModel
from dousa.estimation.kinematics import point_names
from dousa.motion.joints import CANONICAL_JOINTS

if TYPE_CHECKING:
    from dousa.motion import CanonicalMotion, Motion, Trajectories

__all__ = ["body_from_motion", "fit_body"]

FloatArray = NDArray[np.float64]

_LEAST, _GREATEST = 0.6, 1.6  # of what the whole body says: a bone beyond is a wrong point, not a person
_SIDES_AGREE = 0.10  # left and right that differ by less are one length, seen twice
_MOST_FRAMES = 200
_OVER_JOINTS = 1.085  # stature over the height of the joints: three people of HDM05, within 1 %


def fit_body(body: BodyModel, positions: ArrayLike | Mapping[str, ArrayLike]) -> BodyModel:
    """The same body with the bones of the person that joint places were recorded of.

    Limbs take the median distance of their joints over the frames; left and right are one where they agree within
    10 %. Hips and shoulders take breadth and height, root and tips the places that the recording has them at (what is
    called pelvis, head, hand or toe differs from one to the next). Girths and stature follow the bones in the mean.

    Parameters
    ----------
    body : any tree of parts whose joints and tips have names.
    positions : (20, 3) or (T, 20, 3) m in the order of `CANONICAL_JOINTS`, or name -> (3,) or (T, 3); NaN where
        unknown. What is missing keeps the body's own proportion.

    Returns
    -------
    The new body.

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
    points = (
        np.concatenate((grown.offsets, grown.tip_offsets)) * np.where(np.isnan(ratios), 1.0, ratios)[:, None]
    )
    # Tips are landmarks and stretch no solid: the head's may be the crown or a point between the ears.
    stretched = reshape(grown, points[: body.n_parts], grown.tip_offsets)
    return replace(stretched, tip_offsets=points[body.n_parts :])


def _overall(body: BodyModel, ratios: FloatArray, torso: Torso) -> float:
    """How much larger than the body the person is: the bones that make up the height, in the mean by length."""
    lengths = np.linalg.norm(body.offsets, axis=1)
    sizes = [(lengths[row], ratios[row]) for row in range(body.n_parts)]
    own = body_torso(body)
    if own is not None:
        upright = [sizes[row] for row, joint in enumerate(body.joints) if joint.endswith(("_knee", "_ankle"))]
        upright.append((own.neck, torso.neck / own.neck))
        sizes = upright if any(_told(ratio) for _, ratio in upright) else sizes
    told = [(length, ratio) for length, ratio in sizes if _told(ratio)]
    if not told:
        raise BodyModelError(
            f"positions: expected both ends of a bone of the body; its points are {', '.join(point_names(body))}"
        )
    weights, shares = np.array(told).T
    return float((weights * shares).sum() / weights.sum())


def _told(ratio: float) -> bool:
    return bool(np.isfinite(ratio) and ratio > 0)


def _believable(body: BodyModel, ratios: FloatArray) -> FloatArray:
    """Joints that no person has are wrong points; tips are landmarks and may lie anywhere near."""
    joints = np.arange(len(ratios)) < body.n_parts
    wrong = joints & ~((ratios >= _LEAST) & (ratios <= _GREATEST))
    return np.where(wrong, np.nan, np.clip(ratios, _LEAST, _GREATEST))


def _even_sides(names: tuple[str, ...], ratios: FloatArray) -> FloatArray:
    """Left and right made one where they agree, or where one of them is not told."""
    even = ratios.copy()
    for row, name in enumerate(names):
        if not name.startswith("left_") or (other := "right_" + name[5:]) not in names:
            continue
        pair = [row, names.index(other)]
        told = ratios[pair][np.isfinite(ratios[pair])]
        if len(told) and np.ptp(told) <= _SIDES_AGREE * told.mean():
            even[pair] = told.mean()
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
    """Name -> (T, 3) of the body's joints and tips, at most so many frames of them."""
    if not isinstance(positions, Mapping):
        array = np.asarray(positions, np.float64)
        if array.ndim not in (2, 3) or array.shape[-2:] != (len(CANONICAL_JOINTS), 3):
            raise BodyModelError(
                f"positions: expected shape (T, {len(CANONICAL_JOINTS)}, 3), got {array.shape}; "
                "name the joints in a dict if there are others"
            )
        positions = dict(zip(CANONICAL_JOINTS, np.moveaxis(array, -2, 0), strict=True))
    tracks = {}
    for name in set(point_names(body)) & set(positions):
        track = np.atleast_2d(np.asarray(positions[name], np.float64))
        if track.ndim != 2 or track.shape[1] != 3:
            raise BodyModelError(f"positions: {name}: expected shape (T, 3), got {track.shape}")
        if np.isfinite(track).all(axis=1).any():
            tracks[name] = track[:: max(1, len(track) // _MOST_FRAMES)]
    return tracks


def _distance(tracks: Mapping[str, FloatArray], one: str, other: str) -> float:
    if one not in tracks or other not in tracks:
        return np.nan
    distances = np.linalg.norm(tracks[one] - tracks[other], axis=1)
    distances = distances[np.isfinite(distances)]
    return float(np.median(distances)) if len(distances) else np.nan


def _is_limb(body: BodyModel, row: int) -> bool:
    """Whether a point alone, or a tip, tells how long the part is that it hangs on."""
    if row >= body.n_parts:
        return True
    return row > 0 and int((body.parents == body.parents[row]).sum()) == 1


def body_from_motion(motion: Motion | Trajectories | CanonicalMotion, sex: str = "average") -> BodyModel:
    """The body of a recorded person: bones from the skeleton, girths from the tables.

    Parameters
    ----------
    motion : any motion whose joints can be told (BVH, ASF/AMC, C3D, TRC ...), in m, or its canonical joints.
    sex : as in `make_human`; moves girths, since the bones are measured.

    Returns
    -------
    Fifteen parts, see `make_human`. Joints that the recording lacks keep the tables' proportions.

    Raises
    ------
    JointMappingError : the joints cannot be told apart.
    BodyModelError : the person is no size that people are; is the unit right?
    """
    from dousa.estimation.human import make_human
    from dousa.motion import canonicalise

    canonical = motion if hasattr(motion, "mapping") else canonicalise(motion)
    frames = slice(None, None, max(1, canonical.n_frames // _MOST_FRAMES))
    positions = canonical.positions[frames].copy()
    if canonical.missing is not None:
        positions[canonical.missing[frames]] = np.nan
    made_up = [index for index, name in enumerate(CANONICAL_JOINTS) if name in canonical.mapping.derived]
    positions[:, made_up] = np.nan
    return fit_body(make_human(_OVER_JOINTS * canonical.height, sex), positions)
