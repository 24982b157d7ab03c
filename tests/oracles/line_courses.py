"""Slow literal readings of the three compiled loops: every course is priced step by step, and all courses are tried."""

from collections.abc import Iterator, Sequence
from itertools import pairwise, product

import numpy as np

OUTSIDE = -1


def price_of_lag(cost: np.ndarray, slope: float, course: Sequence[int]) -> float:
    """Sum of the costs on a course of columns, and of its changes."""
    total = sum(float(cost[t, column]) for t, column in enumerate(course))
    return total + slope * sum(abs(int(b) - int(a)) for a, b in pairwise(course))


def cheapest_lag(cost: np.ndarray, slope: float) -> float:
    """Price of the cheapest of all courses."""
    n_frames, n_lags = cost.shape
    return min(price_of_lag(cost, slope, course) for course in product(range(n_lags), repeat=n_frames))


def worth_of_switching(score: np.ndarray, price: float, states: Sequence[bool]) -> float:
    """Sum of the scores while on, less the price of every change; off before the first frame and after the last."""
    around = [False, *(bool(state) for state in states), False]
    changes = sum(a != b for a, b in pairwise(around))
    return sum(float(s) for s, on in zip(score, states, strict=True) if on) - price * changes


def best_switching(score: np.ndarray, price: float) -> float:
    """Worth of the best of all on/off sequences."""
    return max(worth_of_switching(score, price, states) for states in product((False, True), repeat=len(score)))


def price_of_lines(cost: np.ndarray, jump: float, pause: float, outside: float, path: Sequence[int]) -> float:
    """Price of a sequence of lines; infinite if it leaves them and comes back."""
    total, left, before = 0.0, False, None
    for t, column in enumerate(path):
        if column == OUTSIDE:
            left = left or before is not None
            total += outside
            continue
        if left:
            return float("inf")
        if before is not None:
            step = column - before
            # A line goes on by one; a pause may also go through the price of leaving a line.
            total += 0.0 if step == 1 else min(pause, jump) if step in (0, 2) else jump
        total += float(cost[t, column])
        before = column
    return total


def all_paths(n_frames: int, n_reference: int) -> Iterator[tuple[int, ...]]:
    """Every assignment of reference frames, or none, to the frames."""
    return product(range(OUTSIDE, n_reference), repeat=n_frames)


def cheapest_lines(cost: np.ndarray, jump: float, pause: float, outside: float) -> float:
    """Price of the cheapest of all sequences of lines."""
    return min(price_of_lines(cost, jump, pause, outside, path) for path in all_paths(*cost.shape))
