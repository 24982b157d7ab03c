"""Drawing of a body into an image.

A pixel belongs to a part if its centre lies in the hull of the discs that the part's spheres project to (a sphere of
radius r at depth z becomes the disc of radius r sqrt(fx fy) / z about its projected centre).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import types
from numba.extending import intrinsic
from numpy.typing import ArrayLike, NDArray

from dousa.arrays import FloatArray, IntArray, Mask
from dousa.estimation.body.body import BodyModel
from dousa.estimation.body.kinematics import place_parts
from dousa.estimation.cameras.camera import Camera
from dousa.kernels import kernel, part

Bits = NDArray[np.uint64]


def pack_bits(masks: NDArray[np.bool_]) -> Bits:
    """Pack masks (..., H, W) into bits (..., H, ceil(W / 64)): column i is bit i % 64 of word i // 64."""
    width = masks.shape[-1]
    n_words = -(-width // 64)
    if width != n_words * 64:
        padded = np.zeros((*masks.shape[:-1], n_words * 64), np.bool_)
        padded[..., :width] = masks
        masks = padded
    packed = np.packbits(masks, axis=-1, bitorder="little")
    return packed.view("<u8").astype(np.uint64, copy=False)


def unpack_bits(bits: Bits, width: int) -> Mask:
    """Invert `pack_bits`: (..., H, words) to (..., H, width)."""
    flat = np.ascontiguousarray(bits.astype("<u8", copy=False)).view(np.uint8)
    return np.unpackbits(flat, axis=-1, count=width, bitorder="little").view(np.bool_)


def outline_scratch(body: BodyModel, height: int) -> tuple[FloatArray, FloatArray, IntArray, IntArray]:
    """Return scratch arrays of the kernels for any part of a body in an image of at most this height."""
    most = int(np.diff(body.sphere_starts).max())
    return (
        np.empty((most, 3)),
        np.empty((most, most, 2)),
        np.empty(height, np.int64),
        np.empty(height, np.int64),
    )


def draw_body(body: BodyModel, poses: ArrayLike, camera: Camera) -> Mask:
    """Draw silhouettes (T, height, width) of a body in poses (T, 7 + A); parts behind the camera are not drawn."""
    return _draw(body, poses, camera, np.zeros(body.n_parts, np.intp), 1)[:, 0]


def draw_parts(body: BodyModel, poses: ArrayLike, camera: Camera) -> Mask:
    """Draw masks (T, P, height, width) of each part on its own, regardless of the others."""
    return _draw(body, poses, camera, np.arange(body.n_parts, dtype=np.intp), body.n_parts)


def _draw(body: BodyModel, poses: ArrayLike, camera: Camera, layers: NDArray[np.intp], n_layers: int) -> Mask:
    placed = place_parts(body, np.atleast_2d(np.asarray(poses, np.float64)))
    size = (camera.width, camera.height)
    return unpack_bits(draw_placed(body, placed, camera.to_row(), size, layers, n_layers), camera.width)


def draw_placed(
    body: BodyModel, placed: tuple[FloatArray, FloatArray], camera: FloatArray, size: tuple[int, int],
    layers: NDArray[np.intp], n_layers: int,
) -> Bits:  # fmt: skip
    """Draw the parts of a body, placed as of `place_parts`, each into its layer (P,): bits (T, layers, height, words).

    ``camera`` is as in `CAMERA_ROW`, ``size`` its width and height.
    """
    width, height = size
    bits = np.zeros((len(placed[1]), n_layers, height, -(-width // 64)), np.uint64)
    solids = (body.spheres, body.sphere_starts)
    draw_layers(*placed, solids, camera, width, layers, outline_scratch(body, height), bits)
    return bits


def _popcount(_context, word):  # type: ignore[no-untyped-def]
    """Count the set bits of a 64-bit word by the processor's own instruction."""

    def generate(_context, builder, _signature, arguments):  # type: ignore[no-untyped-def]
        return builder.ctpop(arguments[0])

    return types.uint64(types.uint64), generate


popcount: Any = intrinsic(_popcount)


@part
def project_sphere(camera, x, y, z, radius):  # type: ignore[no-untyped-def]
    """Return column, row and radius (px) of a sphere; ``camera`` as in `CAMERA_ROW`.

    The radius is -1 where the centre is behind the camera, or less than 0.05 m before its plane.
    """
    cx = camera[6] * x + camera[7] * y + camera[8] * z + camera[15]
    cy = camera[9] * x + camera[10] * y + camera[11] * z + camera[16]
    cz = camera[12] * x + camera[13] * y + camera[14] * z + camera[17]
    scale = np.sqrt(camera[1] * camera[2])
    if camera[0] == 0.0:
        if cz < 0.05:
            return 0.0, 0.0, -1.0
        cx /= cz
        cy /= cz
        radius = radius / cz
        k1, k2, p1, p2, k3 = camera[18], camera[19], camera[20], camera[21], camera[22]
        if k1 != 0.0 or k2 != 0.0 or p1 != 0.0 or p2 != 0.0 or k3 != 0.0:
            square = cx * cx + cy * cy
            gain = 1.0 + square * (k1 + square * (k2 + square * k3))
            dx = cx * gain + 2.0 * p1 * cx * cy + p2 * (square + 2.0 * cx * cx)
            cy = cy * gain + p1 * (square + 2.0 * cy * cy) + 2.0 * p2 * cx * cy
            cx = dx
    return camera[1] * cx + camera[5] * cy + camera[3], camera[2] * cy + camera[4], scale * radius


@part
def outline_discs(discs, count, width, height, pairs, low, high):  # type: ignore[no-untyped-def]
    """Compute first and last column of the hull of discs in each row and return the half-open range of rows.

    ``discs`` (count, 3) column, row, radius; ``pairs`` (n, n, 2) with n >= count is scratch. Fills ``low`` and ``high``
    (height,) with whole columns clipped to the image, high < low where a row has none.
    """
    top, bottom = np.inf, -np.inf
    for i in range(count):
        if not abs(discs[i, 0]) + abs(discs[i, 1]) + discs[i, 2] < 1e12:  # beyond all numbers of pixels, or none
            return 0, 0
        above, below = discs[i, 1] - discs[i, 2], discs[i, 1] + discs[i, 2]
        top = above if above < top else top
        bottom = below if below > bottom else bottom
    if not (top <= height - 1.0 and bottom >= 0.0):
        return 0, 0
    first = int(np.ceil(top)) if top > 0.0 else 0
    last = int(np.floor(bottom)) if bottom < height - 1.0 else height - 1
    if last < first:
        return 0, 0
    _measure_pairs(discs, count, pairs)
    _trace_side(1.0, discs, count, pairs, top, first, last, width, high)
    _trace_side(-1.0, discs, count, pairs, top, first, last, width, low)
    return first, last + 1


@part
def _measure_pairs(discs, count, pairs):  # type: ignore[no-untyped-def]
    """Compute for each pair the length of its outer tangents and 1 / squared distance.

    ``pairs[i, i, 0]`` is -1 for a disc inside another, which adds nothing to the hull.
    """
    for i in range(count):
        pairs[i, i, 0] = 0.0
        for j in range(i):
            dx, dy, dr = discs[j, 0] - discs[i, 0], discs[j, 1] - discs[i, 1], discs[j, 2] - discs[i, 2]
            square = dx * dx + dy * dy
            rest = square - dr * dr
            if rest <= 0.0:
                smaller = j if dr < 0.0 else i
                pairs[smaller, smaller, 0] = -1.0
            root = np.sqrt(rest) if rest > 0.0 else 0.0
            inverse = 1.0 / square if square > 0.0 else 0.0
            pairs[i, j, 0], pairs[i, j, 1] = root, inverse
            pairs[j, i, 0], pairs[j, i, 1] = root, inverse


@part
def _find_start(side, discs, count, pairs, top):  # type: ignore[no-untyped-def]
    """Return the outermost of the highest discs that lie in no other, where the walk begins."""
    here, outmost = 0, -np.inf
    for i in range(count):  # what differs by less than 1e-9 px, of coordinates up to 1, is as high
        high = discs[i, 1] - discs[i, 2] <= top + 1e-9 * (abs(top) if abs(top) > 1.0 else 1.0)
        if high and pairs[i, i, 0] >= 0.0 and side * discs[i, 0] > outmost:
            here, outmost = i, side * discs[i, 0]
    return here


@part
def _trace_side(side, discs, count, pairs, top, first, last, width, columns):  # type: ignore[no-untyped-def]
    """Walk down one side of the hull (gift wrapping over discs) and store its column in every row.

    The next disc is the one whose outer tangent turns least, that is, whose normal points up most; a normal of which
    less than 1e-18 points sideways has no slope.
    """
    here = _find_start(side, discs, count, pairs, top)
    row, up_here = first, -1.0
    for _ in range(2 * count):
        x, y, r = side * discs[here, 0], discs[here, 1], discs[here, 2]
        best, best_up, best_out = -1, 1.0, 0.0
        for j in range(count):
            if j == here or pairs[j, j, 0] < 0.0:
                continue
            root = pairs[here, j, 0]
            dx, dy, dr = side * discs[j, 0] - x, discs[j, 1] - y, discs[j, 2] - r
            up = (-dr * dy - root * dx) * pairs[here, j, 1]
            out = (-dr * dx + root * dy) * pairs[here, j, 1]
            # Of small angles from the vertical the sine tells more than the cosine.
            less = out < best_out if up < -0.7 and best_up < -0.7 else up < best_up
            if out > 1e-18 and up_here - 1e-9 <= up and less:
                best, best_up, best_out = j, up, out
        leave = y + r * best_up if best >= 0 else np.inf
        end = last if leave >= last else int(np.floor(leave))
        for k in range(row, end + 1):
            off = k - y
            rest = r * r - off * off
            columns[k] = _to_column(side, x + (np.sqrt(rest) if rest > 0.0 else 0.0), width)
        row = end + 1 if end >= row else row
        if best < 0 or row > last:
            break
        slope = -best_up / best_out
        start = x + r * best_out - slope * leave
        arrive = discs[best, 1] + discs[best, 2] * best_up
        end = last if arrive >= last else int(np.floor(arrive))
        for k in range(row, end + 1):
            columns[k] = _to_column(side, start + slope * k, width)
        row = end + 1 if end >= row else row
        here, up_here = best, best_up
    for k in range(row, last + 1):  # rounding alone can leave rows over, at the very end
        columns[k] = -1 if side > 0.0 else width


@part
def _to_column(side, x, width):  # type: ignore[no-untyped-def]
    """Return the outermost whole column within a boundary at ``side * x``, clipped to the image."""
    if side > 0.0:
        x += 1.0
        return int(x if x < width else width) - 1 if x > 0.0 else -1
    x += width + 1.0
    return width + 1 - (int(x if x < width + 1.0 else width + 1.0) if x > 1.0 else 1)


_ONES = np.uint64(0xFFFFFFFFFFFFFFFF)  # all bits of a word, by definition


@part
def interval_mask(word, start, stop):  # type: ignore[no-untyped-def]
    """Return the bits of a word in the columns from start to stop, both inclusive."""
    mask = _ONES
    if word == start >> 6:
        mask &= _ONES << np.uint64(start & 63)
    if word == stop >> 6:
        mask &= _ONES >> np.uint64(63 - (stop & 63))
    return mask


@part
def draw_intervals(bits, low, high, first, last):  # type: ignore[no-untyped-def]
    """Set the bits (H, words) of the intervals of rows first to last (exclusive)."""
    for row in range(first, last):
        start, stop = low[row], high[row]
        if stop >= start:
            for word in range(start >> 6, (stop >> 6) + 1):
                bits[row, word] |= interval_mask(word, start, stop)


@part
def outline_part(part, camera, width, height, solids, rotations, positions, work):  # type: ignore[no-untyped-def]
    """Compute row intervals of one part, placed by ``rotations`` (P, 3, 3) and ``positions`` (P, 3).

    ``solids`` is (spheres, sphere_starts); ``work`` is (discs, pairs, low, high), of which the last two are filled.
    """
    spheres, starts = solids
    discs = work[0]
    count = np.int64(0)
    for s in range(starts[part], starts[part + 1]):
        a, b, c = spheres[s, 0], spheres[s, 1], spheres[s, 2]
        x = positions[part, 0] + rotations[part, 0, 0] * a + rotations[part, 0, 1] * b + rotations[part, 0, 2] * c
        y = positions[part, 1] + rotations[part, 1, 0] * a + rotations[part, 1, 1] * b + rotations[part, 1, 2] * c
        z = positions[part, 2] + rotations[part, 2, 0] * a + rotations[part, 2, 1] * b + rotations[part, 2, 2] * c
        u, v, r = project_sphere(camera, x, y, z, spheres[s, 3])
        if not r >= 0.0:
            return 0, 0
        discs[count, 0], discs[count, 1], discs[count, 2] = u, v, r
        count += 1
    return outline_discs(discs, count, width, height, work[1], work[2], work[3])


@kernel
def draw_layers(rotations, positions, solids, camera, width, layers, work, bits):  # type: ignore[no-untyped-def]
    """Draw every part of every frame into its layer of ``bits`` (T, layers, H, words)."""
    height = bits.shape[2]
    for t in range(len(positions)):
        for number in range(len(layers)):
            first, last = outline_part(number, camera, width, height, solids, rotations[t], positions[t], work)
            draw_intervals(bits[t, layers[number]], work[2], work[3], first, last)
