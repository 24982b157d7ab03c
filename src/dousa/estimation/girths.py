"""How thick a person is, from silhouettes of a known pose: clothes and flesh that no table knows."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dousa.errors import BodyModelError, SilhouetteError
from dousa.estimation._reshaping import widen
from dousa.estimation.body import BodyModel
from dousa.estimation.camera import Camera

__all__ = ["fit_girths"]

FloatArray = NDArray[np.float64]
Mask = NDArray[np.bool_]

_LEAST, _GREATEST = 0.6, 1.8  # of the body's own girth: naked child to winter coat
_APART = 1.25  # a part may be so much thicker or thinner than the whole
_STEPS = (0.16, 0.08, 0.04, 0.02)
_WORTH = 5e-4  # of the silhouette: a change that gains fewer pixels is not made


def fit_girths(
    body: BodyModel, poses: ArrayLike, masks: Sequence[Mask], cameras: Sequence[Camera]
) -> BodyModel:
    """Thicken or thin the parts of a body until its outline fits silhouettes whose pose is known.

    First the whole body, then part by part, left and right together. Lengths stay: `fit_body` has those.

    Parameters
    ----------
    body : any tree of parts.
    poses : (T, 7 + A) or (7 + A,), a frame or a few: one where the limbs are off the trunk tells most.
    masks : (V,) one (T, height, width) or (height, width) for each camera, true on the body.
    cameras : (V,).

    Returns
    -------
    The new body; the same where the silhouettes tell nothing.

    Raises
    ------
    SilhouetteError : masks that are not as many as the cameras or not of their size, or of no body at all.
    BodyModelError : poses of another body, or not as many as the masks.
    """
    rows = np.atleast_2d(np.asarray(poses, np.float64))
    if rows.shape[1] != 7 + body.n_angles:
        raise BodyModelError(f"poses: expected rows of {7 + body.n_angles} numbers, got shape {rows.shape}")
    views = _check_masks(masks, cameras, len(rows))
    area = sum(int(view.sum()) for view in views)
    if not area:
        raise SilhouetteError("girths: expected silhouettes of a body, got empty masks; choose other frames")

    def mismatch(shares: FloatArray) -> int:
        from dousa.estimation.rasteriser import draw_body

        tried = widen(body, shares)
        drawn = (draw_body(tried, rows, camera) for camera in cameras)
        return sum(int((mask ^ view).sum()) for mask, view in zip(drawn, views, strict=True))

    shares = np.ones(body.n_parts)
    shares = _search(mismatch, shares, [np.arange(body.n_parts)], (_LEAST, _GREATEST), _WORTH * area)
    middle = shares[0]
    bounds = max(_LEAST, middle / _APART), min(_GREATEST, middle * _APART)
    return widen(body, _search(mismatch, shares, _groups(body), bounds, _WORTH * area))


def _check_masks(masks: Sequence[Mask], cameras: Sequence[Camera], n_frames: int) -> list[Mask]:
    if len(masks) != len(cameras) or not len(cameras):
        raise SilhouetteError(f"girths: expected masks of {len(cameras)} cameras, got {len(masks)}")
    views = []
    for mask, camera in zip(masks, cameras, strict=True):
        view = np.asarray(mask, np.bool_)
        view = view[None] if view.ndim == 2 else view
        if view.shape != (n_frames, camera.height, camera.width):
            raise SilhouetteError(
                f"girths: view '{camera.name}': expected masks ({n_frames}, {camera.height}, {camera.width}), "
                f"got {view.shape}"
            )
        views.append(view)
    return views


def _groups(body: BodyModel) -> list[NDArray[np.intp]]:
    """Parts that share a girth: left and right."""
    plain = [name.removeprefix("left_").removeprefix("right_") for name in body.names]
    return [np.flatnonzero([name == one for name in plain]) for one in dict.fromkeys(plain)]


def _search(mismatch, shares, groups, bounds, worth):  # type: ignore[no-untyped-def]
    """Coordinate descent with shrinking steps over the shares (P,) of groups of parts."""
    best = mismatch(shares)
    for step in _STEPS:
        for group in groups:
            for way in (1.0 + step, 1.0 / (1.0 + step)):
                while True:
                    tried = shares.copy()
                    tried[group] = np.clip(tried[group] * way, *bounds)
                    found = mismatch(tried)
                    if found >= best - worth:
                        break
                    shares, best = tried, found
    return shares
