"""Slow transcriptions of the loops over windows of long takes."""

from itertools import pairwise

import numpy as np


def parts_of(poses, n_parts=8):
    """Mean poses of the parts of a sequence, by cutting it where parts round to."""
    edges = [int(np.floor(k * len(poses) / n_parts + 0.5)) for k in range(n_parts + 1)]
    return np.array([poses[a:b].mean(axis=0) for a, b in pairwise(edges)])


def pose_distance(window, query):
    """Root mean square over the parts' mean poses and their changes."""
    apart = parts_of(window) - parts_of(query)
    return float(np.sqrt(np.mean(np.concatenate([apart, np.diff(apart, axis=0)]) ** 2)))


def near_sketches(sketches, marks, first, last, query, rests, leaves, added, weight, most):
    """Rows and costs of the sketches (values and, last, rest, and marks of leaves) that cost no more than ``most``."""
    found = []
    for row in range(first, last):
        *values, rest = sketches[:, row].tolist()
        square = sum((value - wanted) ** 2 for value, wanted in zip(values, query.tolist(), strict=True))
        square += float(rests[rest + 128])
        cost = weight * np.sqrt(square) + added[int((marks[row] == leaves).sum())]
        if cost <= most:
            found.append((row, float(cost)))
    return found
