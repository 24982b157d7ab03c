"""Rotations over plain arrays, batch dimensions leading.

Quaternions are (..., 4), w x y z, of unit length; matrices (..., 3, 3) act on column vectors; rotation
vectors (..., 3) are axis times angle; angles are radians. Euler angles are intrinsic, as in BVH: order
``"ZXY"`` means R = R_z(first) R_x(second) R_y(third). NaN in gives NaN out.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from dousa.arrays import FloatArray
from dousa.errors import InvalidMotionError

_SMALL_ANGLE = 1e-8  # rad; below it sin(x) / x is 1 to the last bit of double precision (IEEE 754)


def identity(shape: tuple[int, ...] = ()) -> FloatArray:
    """Return quaternions (*shape, 4) of no rotation."""
    quaternions = np.zeros((*shape, 4))
    quaternions[..., 0] = 1.0
    return quaternions


def normalise(quaternions: ArrayLike) -> FloatArray:
    """Scale quaternions (..., 4) to unit length; a zero quaternion becomes NaN."""
    q = np.asarray(quaternions, np.float64)
    length = np.linalg.norm(q, axis=-1, keepdims=True)
    return q / np.where(length > 0, length, np.nan)


def multiply(first: ArrayLike, second: ArrayLike) -> FloatArray:
    """Compute the Hamilton product (..., 4): first ``second``, then ``first``."""
    a, b = np.asarray(first, np.float64), np.asarray(second, np.float64)
    aw, ax, ay, az = (a[..., k] for k in range(4))
    bw, bx, by, bz = (b[..., k] for k in range(4))
    product = np.empty((*np.broadcast_shapes(a.shape[:-1], b.shape[:-1]), 4))
    product[..., 0] = aw * bw - ax * bx - ay * by - az * bz
    product[..., 1] = aw * bx + ax * bw + ay * bz - az * by
    product[..., 2] = aw * by - ax * bz + ay * bw + az * bx
    product[..., 3] = aw * bz + ax * by - ay * bx + az * bw
    return product


def conjugate(quaternions: ArrayLike) -> FloatArray:
    """Invert unit quaternions (..., 4)."""
    conjugated: FloatArray = np.asarray(quaternions, np.float64) * np.array([1.0, -1.0, -1.0, -1.0])
    return conjugated


def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Compute cross products (..., 3), several times faster than numpy on small arrays."""
    result = np.empty(np.broadcast(a, b).shape)
    result[..., 0] = a[..., 1] * b[..., 2] - a[..., 2] * b[..., 1]
    result[..., 1] = a[..., 2] * b[..., 0] - a[..., 0] * b[..., 2]
    result[..., 2] = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return result


def rotate(quaternions: ArrayLike, vectors: ArrayLike) -> FloatArray:
    """Turn vectors (..., 3) by unit quaternions (..., 4)."""
    q, v = np.asarray(quaternions, np.float64), np.asarray(vectors, np.float64)
    axis = q[..., 1:]
    twice = 2.0 * cross(axis, v)
    return v + q[..., :1] * twice + cross(axis, twice)


def from_axis_angle(vectors: ArrayLike) -> FloatArray:
    """Compute unit quaternions (..., 4) of rotation vectors (..., 3), axis times angle in rad."""
    v = np.asarray(vectors, np.float64)
    angle = np.linalg.norm(v, axis=-1, keepdims=True)
    half = 0.5 * angle
    small = angle < _SMALL_ANGLE
    # sin(a/2)/a -> 1/2 as the angle goes to zero
    scale = np.where(small, 0.5, np.sin(half) / np.where(small, 1.0, angle))
    return np.concatenate((np.cos(half), v * scale), axis=-1)


def to_axis_angle(quaternions: ArrayLike) -> FloatArray:
    """Compute rotation vectors (..., 3), angle in [0, pi], of unit quaternions (..., 4)."""
    q = np.asarray(quaternions, np.float64)
    q = np.where(q[..., :1] < 0, -q, q)
    sine = np.linalg.norm(q[..., 1:], axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(sine, q[..., :1])
    small = sine < _SMALL_ANGLE
    return q[..., 1:] * np.where(small, 2.0, angle / np.where(small, 1.0, sine))


def to_matrix(quaternions: ArrayLike) -> FloatArray:
    """Compute rotation matrices (..., 3, 3) of unit quaternions (..., 4)."""
    w, x, y, z = np.moveaxis(np.asarray(quaternions, np.float64), -1, 0)
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def from_matrix(matrices: ArrayLike) -> FloatArray:
    """Compute unit quaternions (..., 4), w >= 0, of rotation matrices (..., 3, 3).

    Takes the largest of the four squared components first, so that no angle loses digits (Shepperd 1978).
    """
    m = np.asarray(matrices, np.float64)
    d0, d1, d2 = m[..., 0, 0], m[..., 1, 1], m[..., 2, 2]
    wx, wy, wz = m[..., 2, 1] - m[..., 1, 2], m[..., 0, 2] - m[..., 2, 0], m[..., 1, 0] - m[..., 0, 1]
    xy, xz, yz = m[..., 1, 0] + m[..., 0, 1], m[..., 0, 2] + m[..., 2, 0], m[..., 2, 1] + m[..., 1, 2]
    # Row c holds 4 q_c q: whichever q_c is largest gives the best-conditioned row.
    rows = (
        (1 + d0 + d1 + d2, wx, wy, wz),
        (wx, 1 + d0 - d1 - d2, xy, xz),
        (wy, xy, 1 - d0 + d1 - d2, yz),
        (wz, xz, yz, 1 - d0 - d1 + d2),
    )
    stacked = np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
    squares = np.diagonal(stacked, axis1=-2, axis2=-1)
    best = np.argmax(np.nan_to_num(squares), axis=-1)[..., None, None]
    q = normalise(np.take_along_axis(stacked, best, axis=-2)[..., 0, :])
    return np.where(q[..., :1] < 0, -q, q)


def _axis_numbers(order: str) -> list[int]:
    letters = order.upper()
    if not 1 <= len(letters) <= 3 or len(set(letters)) != len(letters) or set(letters) - set("XYZ"):
        raise InvalidMotionError("rotations.order", order=order)
    return ["XYZ".index(letter) for letter in letters]


def from_euler(angles: ArrayLike, order: str) -> FloatArray:
    """Compute unit quaternions (..., 4) of intrinsic Euler angles.

    Parameters
    ----------
    angles : (..., k) rad, in the order of the letters.
    order : k different letters of XYZ, such as ``"ZXY"``; R = R_first R_second R_third.

    Raises
    ------
    InvalidMotionError : the order is not one to three different letters, or does not fit the angles.
    """
    axes = _axis_numbers(order)
    half = 0.5 * np.asarray(angles, np.float64)
    if half.shape[-1] != len(axes):
        raise InvalidMotionError("rotations.count", expected=len(axes), order=order, found=half.shape[-1])
    result = None
    for number, axis in enumerate(axes):
        turn = np.zeros((*half.shape[:-1], 4))
        turn[..., 0] = np.cos(half[..., number])
        turn[..., 1 + axis] = np.sin(half[..., number])
        result = turn if result is None else multiply(result, turn)
    assert result is not None
    return result


def to_euler(quaternions: ArrayLike, order: str) -> FloatArray:
    """Compute intrinsic Euler angles (..., k) rad of unit quaternions (..., 4).

    With three letters the rotation is reproduced exactly, also in gimbal lock, where the third angle is 0. With fewer
    letters the missing angles of the three-letter solution are dropped.

    Raises
    ------
    InvalidMotionError : the order is not one to three different letters of XYZ.
    """
    given = _axis_numbers(order)
    rest = [axis for axis in (0, 1, 2) if axis not in given]
    i, j, k = given + rest
    sign = 1.0 if (j - i) % 3 == 1 else -1.0
    m = to_matrix(quaternions)
    cosine = np.hypot(m[..., i, i], m[..., i, j])
    locked = cosine < 1e-7  # the first and third axes are parallel to double precision
    first = np.where(
        locked, np.arctan2(sign * m[..., k, j], m[..., j, j]), np.arctan2(-sign * m[..., j, k], m[..., k, k])
    )
    second = np.arctan2(sign * m[..., i, k], cosine)
    third = np.where(locked, 0.0 * cosine, np.arctan2(-sign * m[..., i, j], m[..., i, i]))
    return np.stack((first, second, third), axis=-1)[..., : len(given)]


def unwrap_euler(angles: ArrayLike) -> FloatArray:
    """Make Euler angles (T, ..., 3) of three different axes continuous along time.

    (a, b, c) and (a + pi, pi - b, c + pi) are the same rotation; each frame takes the one nearer to the frame before,
    whole turns included.
    """
    a = np.array(angles, np.float64)
    turn = 2 * np.pi
    for t in range(1, len(a)):
        before = np.where(np.isnan(a[t - 1]), a[t], a[t - 1])
        other = np.stack((a[t, ..., 0] + np.pi, np.pi - a[t, ..., 1], a[t, ..., 2] + np.pi), axis=-1)
        near = a[t] - turn * np.round((a[t] - before) / turn)
        far = other - turn * np.round((other - before) / turn)
        swap = np.abs(far - before).sum(-1) < np.abs(near - before).sum(-1) - 1e-9
        a[t] = np.where(swap[..., None], far, near)
    return a


def between(start: ArrayLike, end: ArrayLike) -> FloatArray:
    """Compute the shortest rotations (..., 4) that turn the directions (..., 3) ``start`` into ``end``.

    Opposite directions turn by pi about an axis across them; a zero vector gives no rotation.
    """
    u, v = np.broadcast_arrays(*(_directions(x) for x in (start, end)))
    scalar = 1.0 + (u * v).sum(-1)
    q = np.concatenate((scalar[..., None], cross(u, v)), axis=-1)
    helper = np.eye(3)[np.argmin(np.abs(np.nan_to_num(u)), axis=-1)]
    across = np.concatenate((np.zeros((*u.shape[:-1], 1)), cross(u, helper)), axis=-1)
    q = np.where((scalar < 1e-14)[..., None], across, q)  # opposite, so that the axis is undefined
    directed = (u != 0).any(-1) & (v != 0).any(-1)
    return normalise(np.where(directed[..., None], q, identity()))


def _directions(vectors: ArrayLike) -> FloatArray:
    """Unit vectors of vectors (..., 3) of any length; zero stays zero."""
    v = np.asarray(vectors, np.float64)
    largest = np.abs(v).max(-1, keepdims=True)
    scaled = v / np.where(largest > 0, largest, 1.0)
    length = np.linalg.norm(scaled, axis=-1, keepdims=True)
    return scaled / np.where(length > 0, length, 1.0)


def slerp(start: ArrayLike, end: ArrayLike, fraction: ArrayLike) -> FloatArray:
    """Interpolate unit quaternions (..., 4) on the shorter arc from ``start`` (fraction 0) to ``end`` (fraction 1).

    ``fraction`` : (...) position on the arc.
    """
    a, b = np.asarray(start, np.float64), np.asarray(end, np.float64)
    s = np.asarray(fraction, np.float64)[..., None]
    b = np.where((a * b).sum(-1, keepdims=True) < 0, -b, b)
    # The chord's half angle keeps its digits where the arc is short; arccos of the dot product would not.
    angle = 2.0 * np.arctan2(np.linalg.norm(b - a, axis=-1), np.linalg.norm(b + a, axis=-1))[..., None]
    small = angle < _SMALL_ANGLE
    sine = np.sin(np.where(small, 1.0, angle))
    weight_a = np.where(small, 1 - s, np.sin((1 - s) * angle) / sine)
    weight_b = np.where(small, s, np.sin(s * angle) / sine)
    return normalise(weight_a * a + weight_b * b)
