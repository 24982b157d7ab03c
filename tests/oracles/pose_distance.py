"""Slow, literal dynamic time warping of poses: recursion over a dictionary of cells."""

import math


def warp_distance(query, other, reach: float = math.inf) -> float:
    """Cheapest path in steps (1, 1), (1, 0), (0, 1), each paying where it arrives, over both lengths."""
    n, m = len(query), len(other)
    slope = (m - 1) / (n - 1) if n > 1 else 0.0
    width = max(reach, slope, 1.0) + 1e-9  # pairs on the very edge belong
    total = {}
    for i in range(n):
        for j in range(m):
            if n > 1 and abs(j - i * slope) > width:
                continue
            cost = math.dist(query[i], other[j])
            earlier = [total.get(cell, math.inf) for cell in ((i - 1, j - 1), (i - 1, j), (i, j - 1))]
            total[i, j] = cost + (0.0 if i == j == 0 else min(earlier))
    return total[n - 1, m - 1] / (n + m)
