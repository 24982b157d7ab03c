"""Synthetic silhouettes of a body in motion, clean or with the errors of a real segmentation (`spoil`)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from statistics import NormalDist

import numpy as np
from numpy.typing import ArrayLike

from dousa.arrays import FloatArray, Mask
from dousa.errors import BodyModelError, OptionError, SilhouetteError
from dousa.estimation.body.body import BodyModel
from dousa.estimation.body.kinematics import point_names
from dousa.estimation.body.posing import fit_poses
from dousa.estimation.cameras.camera import Camera
from dousa.estimation.raster.rasteriser import draw_body
from dousa.extras import cv2
from dousa.motion import CANONICAL_JOINTS, Motion, Trajectories, canonicalise, compute_trajectories


@dataclass(frozen=True, slots=True)
class Spoiling:
    """The amounts of errors in the image, 0 for none.

    Parameters
    ----------
    ragged : px, root mean square shift of the edge, bump by bump.
    holes : share of the silhouette that is missing inside.
    speckle : share of the background that is marked wrongly, specks of a few pixels.
    shadow : length of the shadow on the floor, in heights of the silhouette.
    jitter : px, root mean square shift of the whole image, along rows and columns each.
    """

    ragged: float = 0.0
    holes: float = 0.0
    speckle: float = 0.0
    shadow: float = 0.0
    jitter: float = 0.0

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            most = 1.0 if field.name in ("holes", "speckle") else 100.0
            if not 0.0 <= value <= most:
                raise OptionError("rendering.amount", option=field.name, most=most, found=value)


def spoil(
    masks: Mask,
    rng: np.random.Generator,
    amounts: Spoiling = Spoiling(ragged=1.0, holes=0.02, speckle=0.002, shadow=0.4, jitter=0.5),
    *,
    grains: tuple[float, float, float] = (2.5, 4.0, 1.0),
    persistence: float = 0.6,
    shadow_depth: float = 0.12,
    shadow_loss: float = 0.25,
) -> Mask:
    """Add errors of a real segmentation to the clean silhouettes (T, H, W) of one view.

    Errors last a few frames; an empty mask gets speckle only.

    Parameters
    ----------
    masks : (T, H, W) bool.
    rng : source of the errors.
    amounts : of each error; by default those of a poor segmentation of 320 x 240 pixels.
    grains : px, sizes of the bumps of a ragged edge, of holes and of speckle.
    persistence : share of an error that the next frame keeps.
    shadow_depth : height of a shadow on the floor by its length: cameras look flat over the floor.
    shadow_loss : share of a shadow that segmentation notices and removes.

    Raises
    ------
    SilhouetteError : masks of another shape.
    """
    masks = np.asarray(masks, bool)
    if masks.ndim != 3:
        raise SilhouetteError("masks.shape", found=str(masks.shape))
    spoiled = np.empty_like(masks)
    size = masks.shape[1:]
    edge, inside, outside = (_Field(size, grain, rng, persistence) for grain in grains)
    to_the_side = float(rng.choice([-1.0, 1.0]))
    shift = np.zeros(2)
    for t, mask in enumerate(masks):
        shift = _follow(shift, rng.standard_normal(2), persistence)
        changed = mask
        if amounts.shadow:
            shadow = _cast_shadow(mask, amounts.shadow, to_the_side, shadow_depth)
            changed = changed | (shadow & (rng.random(size) > shadow_loss))
        if amounts.ragged:
            changed = _depths(changed) > amounts.ragged * edge.advance()
        if amounts.holes:
            changed = changed & (inside.advance() > _quantile(amounts.holes))
        if amounts.jitter:
            across, down = amounts.jitter * shift
            changed = _warp(changed, [[1.0, 0.0, across], [0.0, 1.0, down]])
        if amounts.speckle:
            changed = changed | (outside.advance() > _quantile(1.0 - amounts.speckle))
        spoiled[t] = changed
    return spoiled


def _follow(before: FloatArray, new: FloatArray, persistence: float) -> FloatArray:
    """Update an error of unit variance that persists in part."""
    return np.asarray(persistence * before + np.sqrt(1.0 - persistence**2) * new)


class _Field:
    """A smooth random image of unit variance that changes slowly."""

    def __init__(self, size: tuple[int, int], grain: float, rng: np.random.Generator, persistence: float) -> None:
        self._size, self._grain, self._rng, self._persistence = size, grain, rng, persistence
        self._values = self._draw()

    def _draw(self) -> FloatArray:
        kernel = cv2.getGaussianKernel(2 * int(np.ceil(4.0 * self._grain)) + 1, self._grain)
        noise = self._rng.standard_normal(self._size)
        smooth = cv2.sepFilter2D(noise, cv2.CV_64F, kernel, kernel, borderType=cv2.BORDER_REFLECT)
        return np.asarray(smooth / (kernel * kernel).sum())

    def advance(self) -> FloatArray:
        self._values = _follow(self._values, self._draw(), self._persistence)
        return self._values


def _quantile(share: float) -> float:
    """Return the quantile of a unit normal."""
    return NormalDist().inv_cdf(min(max(share, 1e-12), 1.0 - 1e-12))


def _depths(mask: Mask) -> FloatArray:
    """Compute the distance (px) to the edge, negative outside."""
    if mask.all() or not mask.any():
        return np.where(mask, np.inf, -np.inf)
    inner = cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, 3)
    outer = cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, 3)
    return np.asarray(np.where(mask, inner - 0.5, 0.5 - outer), np.float64)


def _cast_shadow(mask: Mask, length: float, side: float, depth: float) -> Mask:
    """Lay the silhouette flat on the floor from its lowest row, to one side."""
    rows = np.flatnonzero(mask.any(axis=1))
    if not len(rows):
        return np.zeros_like(mask)
    foot = float(rows[-1])
    # A point h above the feet falls length * h to the side and a little up the image.
    rise = length * depth
    return _warp(mask, [[1.0, -side * length, side * length * foot], [0.0, rise, foot * (1.0 - rise)]])


def _warp(mask: Mask, affine: Sequence[Sequence[float]]) -> Mask:
    """Move the image by an affine matrix (2, 3); the rest is background."""
    return np.asarray(cv2.warpAffine(mask.astype(np.float32), np.array(affine), mask.shape[::-1]) > 0.5)


def render(body: BodyModel, poses: ArrayLike, cameras: Sequence[Camera]) -> list[Mask]:
    """Render silhouettes of a body, (V,) masks (T, height, width) as of `draw_body`.

    Parameters
    ----------
    body : with A joint angles.
    poses : (T, 7 + A), see `BodyModel`.
    cameras : (V,) the views.

    Raises
    ------
    BodyModelError : poses of another shape.
    """
    rows = np.asarray(poses, np.float64)
    if rows.ndim != 2 or rows.shape[1] != 7 + body.n_angles:
        raise BodyModelError("pose.rows", expected=7 + body.n_angles, found=str(rows.shape))
    if not np.isfinite(rows).all():
        raise BodyModelError("pose.finite")
    return [draw_body(body, rows, camera) for camera in cameras]


def poses_from_motion(body: BodyModel, motion: Motion | Trajectories) -> FloatArray:
    """Return poses (T, 7 + A) of a body that follow a motion, by inverse kinematics from frame to frame.

    Parameters
    ----------
    body : any tree of parts; the nearer its bones to the motion's, the nearer the joints.
    motion : of T frames, with the body's names of joints and tips, or, for a person, mapped to the canonical ones.

    Raises
    ------
    BodyModelError : too few joints of the body are found in the motion.
    JointMappingError : the joints of a person's motion cannot be distinguished.
    """
    moving = compute_trajectories(motion) if isinstance(motion, Motion) else motion
    wanted = point_names(body)
    if set(wanted) <= set(moving.names) or not set(wanted) >= set(CANONICAL_JOINTS):
        names, positions = moving.names, moving.positions
    else:
        canonical = canonicalise(motion, whole=True)
        names, positions = CANONICAL_JOINTS, canonical.positions
    if not set(wanted) & set(names):
        raise BodyModelError("rendering.joints", wanted=wanted, found=names)
    return fit_poses(body, positions, names)[0]
