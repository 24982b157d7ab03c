"""Literal, slow transcription of eq. 1 to 7 of Yamane and Shakunaga, of S, and of dynamic time warping.

Axes are the paper's: X and Y horizontal, Z up. `to_paper` turns Y-up vectors there without mirroring.
"""

import cmath
import math
from collections.abc import Sequence

import numpy as np

Vector = Sequence[float]


def to_paper(vectors: np.ndarray) -> np.ndarray:
    """(..., 3) Y up -> (..., 3) Z up."""
    return np.stack([vectors[..., 2], vectors[..., 0], vectors[..., 1]], axis=-1)


def posture_vector(segments: Sequence[tuple[Vector, Vector]]) -> list[float]:
    """Eq. 1 and 2, each segment of length 1 as section 3.1 asks: X = [x_1 ... x_n], from (start, end) points."""
    posture: list[float] = []
    for start, end in segments:
        x = [end[axis] - start[axis] for axis in range(3)]
        length = math.sqrt(sum(value * value for value in x))
        posture += [value / length for value in x]
    return posture


def complex_segment(x: Vector) -> complex:
    """Eq. 3."""
    return complex(x[0], x[1])


def complex_correlation(a: Sequence[Vector], b: Sequence[Vector]) -> complex:
    """Eq. 5 as printed: each term is divided by its own lengths."""
    total = 0j
    for x, x_other in zip(a, b, strict=True):
        conjugate = complex(x_other[0], -x_other[1])  # eq. 4
        total += complex_segment(x) * conjugate / (abs(complex_segment(x)) * abs(complex_segment(x_other)))
    return total


def pose_correlation(a: Sequence[Vector], b: Sequence[Vector]) -> complex:
    """Eq. 5 with the norms of the whole poses."""
    total, norm_a, norm_b = 0j, 0.0, 0.0
    for x, x_other in zip(a, b, strict=True):
        total += complex_segment(x) * complex(x_other[0], -x_other[1])
        norm_a += abs(complex_segment(x)) ** 2
        norm_b += abs(complex_segment(x_other)) ** 2
    return total / math.sqrt(norm_a * norm_b)


def phase(correlation: complex) -> float:
    """Eq. 6 and 7."""
    return cmath.phase(correlation)


def turn(x: Vector, theta: float) -> list[float]:
    """A vector turned about Z."""
    return [x[0] * math.cos(theta) - x[1] * math.sin(theta), x[0] * math.sin(theta) + x[1] * math.cos(theta), x[2]]


def best_mean_cosine(a: Sequence[Vector], b: Sequence[Vector], n_angles: int = 3600) -> float:
    """What S is: the mean cosine between unit segments, at the best of many yaw angles."""
    best = -1.0
    for number in range(n_angles):
        theta = 2.0 * math.pi * number / n_angles
        cosines = [sum(p * q for p, q in zip(x, turn(y, theta), strict=True)) for x, y in zip(a, b, strict=True)]
        best = max(best, sum(cosines) / len(cosines))
    return best


def similarity(a: Sequence[Vector], b: Sequence[Vector], weights: Sequence[float]) -> float:
    """S in closed form."""
    horizontal, vertical = 0j, 0.0
    for x, x_other, weight in zip(a, b, weights, strict=True):
        horizontal += weight * complex_segment(x) * complex_segment(x_other).conjugate()
        vertical += weight * x[2] * x_other[2]
    return (abs(horizontal) + vertical) / sum(weights)


def warp(cost: np.ndarray, skip: float = math.inf) -> tuple[float, list[tuple[int, int]]]:
    """Plain dynamic time warping over a whole matrix: price and path.

    A path begins in row or column 0 and ends in the last row or column; frames left out there cost ``skip`` each.
    """
    rows, columns = cost.shape
    table = [[math.inf] * columns for _ in range(rows)]
    origin: list[list[tuple[int, int] | None]] = [[None] * columns for _ in range(rows)]
    for t in range(rows):
        for u in range(columns):
            best, source = math.inf, None
            for step in ((t - 1, u - 1), (t - 1, u), (t, u - 1)):
                if min(step) >= 0 and table[step[0]][step[1]] < best:
                    best, source = table[step[0]][step[1]], step
            if min(t, u) == 0 and (left_out := (t + u) * skip if t + u else 0.0) <= best:
                best, source = left_out, None
            table[t][u] = best + float(cost[t, u])
            origin[t][u] = source
    ends = [(rows - 1, u) for u in range(columns)] + [(t, columns - 1) for t in range(rows)]
    prices = {}
    for t, u in ends:
        left_out = rows - 1 - t + columns - 1 - u
        prices[t, u] = table[t][u] + (left_out * skip if left_out else 0.0)
    cell: tuple[int, int] | None = min(prices, key=prices.__getitem__)
    assert cell is not None
    price, path = prices[cell], []
    while cell is not None:
        path.append(cell)
        cell = origin[cell[0]][cell[1]]
    return price, path[::-1]
