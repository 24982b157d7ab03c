"""Drawing a body into an image: which pixels its parts cover.

A pixel belongs to a part if its centre lies in the hull of the discs that the part's spheres project to (a sphere of
radius r at depth z becomes the disc of radius r sqrt(fx fy) / z about its projected centre). Tracker, renderer and the
slow oracle of the tests share this convention.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

if TYPE_CHECKING:
    from dousa.estimation.body import BodyModel
    from dousa.estimation.camera import Camera

__all__ = ["draw_body", "draw_parts", "outline_scratch", "pack_bits", "unpack_bits"]

Mask = NDArray[np.bool_]
Bits = NDArray[np.uint64]


def pack_bits(masks: NDArray[np.bool_]) -> Bits:
    """Masks (..., H, W) as rows of bits (..., H, ceil(W / 64)): column i is bit i % 64 of word i // 64."""
    width = masks.shape[-1]
    n_words = -(-width // 64)
    if width != n_words * 64:
        padded = np.zeros((*masks.shape[:-1], n_words * 64), np.bool_)
        padded[..., :width] = masks
        masks = padded
    packed = np.packbits(masks, axis=-1, bitorder="little")
    return packed.view("<u8").astype(np.uint64, copy=False)


def unpack_bits(bits: Bits, width: int) -> Mask:
    """The inverse of `pack_bits`: (..., H, words) to (..., H, width)."""
    flat = np.ascontiguousarray(bits.astype("<u8", copy=False)).view(np.uint8)
    return np.unpackbits(flat, axis=-1, count=width, bitorder="little").view(np.bool_)


def outline_scratch(body: BodyModel, height: int) -> tuple[NDArray, NDArray, NDArray, NDArray]:
    """Scratch arrays with which the kernels outline any part of a body in an image of this height or less."""
    most = int(np.diff(body.sphere_starts).max())
    return (
        np.empty((most, 3)),
        np.empty((most, most, 2)),
        np.empty(height, np.int64),
        np.empty(height, np.int64),
    )


def draw_body(body: BodyModel, poses: ArrayLike, camera: Camera) -> Mask:
    """Silhouettes of a body, as this camera would see it before a plain wall.

    Parameters
    ----------
    body : with A joint angles.
    poses : (T, 7 + A).
    camera : the view.

    Returns
    -------
    (T, height, width), true on the body; parts behind the camera are not drawn.
    """
    return _draw(body, poses, camera, np.zeros(body.n_parts, np.intp), 1)[:, 0]


def draw_parts(body: BodyModel, poses: ArrayLike, camera: Camera) -> Mask:
    """Masks (T, P, height, width) of each part on its own, as if the others were of glass."""
    return _draw(body, poses, camera, np.arange(body.n_parts, dtype=np.intp), body.n_parts)


def _draw(body: BodyModel, poses: ArrayLike, camera: Camera, layers: NDArray[np.intp], n_layers: int) -> Mask:
    from dousa.estimation._raster_kernels import draw_layers
    from dousa.estimation.kinematics import place_parts

    rotations, positions = place_parts(body, np.atleast_2d(np.asarray(poses, np.float64)))
    n_words = -(-camera.width // 64)
    bits = np.zeros((len(positions), n_layers, camera.height, n_words), np.uint64)
    solids = (body.spheres, body.sphere_starts)
    work = outline_scratch(body, camera.height)
    draw_layers(rotations, positions, solids, camera.to_row(), camera.width, layers, work, bits)
    return unpack_bits(bits, camera.width)
