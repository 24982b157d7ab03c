"""The clock of the benchmarks."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TypeVar

__all__ = ["best_of", "timed"]

_Result = TypeVar("_Result")


def timed(call: Callable[[], _Result], repeats: int = 1) -> tuple[float, _Result]:
    """Shortest time of a call, s, and its result."""
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        result = call()
        times.append(time.perf_counter() - start)
    return min(times), result


def best_of(call: Callable[[], object], repeats: int) -> float:
    """Shortest time of a call, s; each result is dropped before the next is made."""
    return min(timed(call)[0] for _ in range(repeats))
