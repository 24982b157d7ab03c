"""Yaw: the rotation about the vertical between two postures, by complex correlation.

Source: Yamane and Shakunaga, eq. 3 to 7. The horizontal part of a vector is the complex number ``h = z + j x``
(Y is up here, Z in the paper), so that multiplying by ``exp(j theta)`` turns it by theta about +Y, right-handed.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dousa.arrays import FloatArray
from dousa.errors import OptionError
from dousa.evaluation.posture.posture import LIMBS, SEGMENTS, check_segments, check_weights

ComplexArray = NDArray[np.complex128]
WRONG_CHORD = 0.35
"""Chord between unit vectors (20 degrees) from which a segment loses its say in a common yaw."""

# Columns: all segments, and all but one limb. One wrong limb leaves one of them untouched.
_WITHOUT_LIMB = np.ones((len(SEGMENTS), 1 + len(LIMBS)))

for _column, _limb in enumerate(LIMBS.values(), start=1):
    _WITHOUT_LIMB[_limb, _column] = 0.0


def get_horizontal(segments: FloatArray) -> ComplexArray:
    """(..., 9) horizontal parts of (..., 9, 3) vectors as complex numbers: eq. 3 with Y up."""
    return segments[..., 2] + 1j * segments[..., 0]


def compute_complex_correlation(
    a: ArrayLike, b: ArrayLike, normalisation: str = "pose", weights: ArrayLike | None = None
) -> ComplexArray:
    """Complex correlation of the horizontal parts of two postures.

    Parameters
    ----------
    a, b : (..., 9, 3) unit vectors, Y up; leading axes broadcast.
    normalisation : ``"pose"`` divides the sum once, by the norms of the whole poses; ``"segment"`` divides each
        term by its own lengths, as eq. 5 is printed.
    weights : (9,) or (..., 9) of the segments, 0 or above; None for equal ones.

    Returns
    -------
    (...) complex; the modulus is the similarity in the plane, 0 to 1, the argument the angle about +Y that
    turns b onto a. 0 where a posture has no horizontal part.

    Raises
    ------
    InvalidMotionError : wrong shapes or missing values.
    OptionError : an unknown normalisation, or wrong weights.

    Source: Yamane and Shakunaga, eq. 5 and 6. Dividing each term makes a pure phase of every segment, so that
    nearly vertical segments vote with their noise; hence ``"pose"`` is the default. The printed sum of phases is
    divided by the sum of weights, so that both readings end at 1.
    """
    first, second = get_horizontal(check_segments(a, "a")), get_horizontal(check_segments(b, "b"))
    shares = check_weights(weights)
    products = first * second.conj()
    if normalisation == "segment":
        size = np.abs(products)
        phases = np.divide(products, size, out=np.zeros_like(products), where=size > 0)
        return np.asarray((phases * shares).sum(axis=-1) / shares.sum(axis=-1))
    if normalisation != "pose":
        raise OptionError("postures.normalisation", normalisation=normalisation)
    total = np.asarray((products * shares).sum(axis=-1))
    power = (np.abs(first) ** 2 * shares).sum(axis=-1) * (np.abs(second) ** 2 * shares).sum(axis=-1)
    return np.asarray(np.divide(total, np.sqrt(power), out=np.zeros_like(total), where=power > 0))


def estimate_yaw(
    a: ArrayLike, b: ArrayLike, normalisation: str = "pose", weights: ArrayLike | None = None
) -> FloatArray:
    """The angle about the vertical that turns one posture onto another.

    Parameters
    ----------
    a, b, normalisation, weights : as in `compute_complex_correlation`.

    Returns
    -------
    (...) rad, -pi to pi, about +Y, right-handed: ``rotate_yaw(b, angle)`` faces like a. 0 where it cannot be known.

    Raises
    ------
    InvalidMotionError, OptionError : as in `compute_complex_correlation`.

    Source: Yamane and Shakunaga, eq. 7.
    """
    return np.angle(compute_complex_correlation(a, b, normalisation, weights))


def estimate_robust_yaw(
    a: ArrayLike, b: ArrayLike, weights: ArrayLike | None = None, n_rounds: int = 6
) -> tuple[FloatArray, FloatArray]:
    """The same angle, which one wrong limb cannot bend.

    Six starts (all segments, and all but one limb) compete; the one that leaves most segments in place is
    refined: segments far off lose weight, the angle is estimated again, and so on.

    Parameters
    ----------
    a, b : (..., 9, 3) unit vectors, Y up; leading axes broadcast.
    weights : (9,) or (..., 9) of the segments, 0 or above; None for equal ones.
    n_rounds : of re-weighting, 0 or more.

    Returns
    -------
    theta : (...) rad, -pi to pi, turns b onto a.
    trust : (..., 9) the given weights times 0 (far off) to 1 (in place).

    Raises
    ------
    InvalidMotionError, OptionError : as in `compute_complex_correlation`; a negative number of rounds.

    Not in the paper. Weights are those of Geman and McClure's estimator, scale 20 degrees.
    """
    if n_rounds < 0:
        raise OptionError("postures.n_rounds", n_rounds=n_rounds)
    first, second = check_segments(a, "a"), check_segments(b, "b")
    shares = check_weights(weights)
    products = get_horizontal(first) * get_horizontal(second).conj()
    # Squared chord of each segment after turning by theta: fixed - 2 Re(product exp(-j theta)).
    fixed = (first * first).sum(axis=-1) + (second * second).sum(axis=-1)
    fixed -= 2.0 * first[..., 1] * second[..., 1]
    turns = _unit((products * shares) @ _WITHOUT_LIMB)
    costs = np.stack(
        [(_far(products, fixed, turns[..., k]) * shares).sum(axis=-1) for k in range(turns.shape[-1])],
        axis=-1,
    )
    best = costs.argmin(axis=-1)
    turn = np.take_along_axis(turns, best[..., None], axis=-1)[..., 0]
    for _ in range(n_rounds):
        trust = shares * (1.0 - _far(products, fixed, turn)) ** 2
        turn = _unit((products * trust).sum(axis=-1))
    trust = shares * (1.0 - _far(products, fixed, turn)) ** 2
    return np.angle(turn), trust


def _unit(values: ComplexArray) -> ComplexArray:
    """Values of modulus 1; 1 where there is no direction."""
    size = np.abs(values)
    return np.divide(values, size, out=np.ones_like(values), where=size > 0)


def _far(products: ComplexArray, fixed: FloatArray, turn: ComplexArray) -> FloatArray:
    """How far off each segment is after a turn: 0 in place to 1 anywhere."""
    across = turn[..., None]
    squared = fixed - 2.0 * (products.real * across.real + products.imag * across.imag)
    squared = np.maximum(squared, 0.0)
    far: FloatArray = squared / (squared + WRONG_CHORD**2)
    return far


def rotate_yaw(segments: ArrayLike, theta: ArrayLike) -> FloatArray:
    """Postures turned about the vertical.

    Parameters
    ----------
    segments : (..., 9, 3), Y up.
    theta : (...) rad about +Y, right-handed; broadcasts.

    Returns
    -------
    (..., 9, 3).

    Raises
    ------
    InvalidMotionError : wrong shapes or missing values.
    """
    vectors = check_segments(segments, "segments")
    angle = np.asarray(theta, np.float64)[..., None]
    cosine, sine = np.cos(angle), np.sin(angle)
    x, y, z = vectors[..., 0], vectors[..., 1], vectors[..., 2]
    turned_x = x * cosine + z * sine
    return np.stack([turned_x, np.broadcast_to(y, turned_x.shape), z * cosine - x * sine], axis=-1)
