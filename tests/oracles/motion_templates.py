"""Slow, literal motion templates: plain loops over dictionaries and lists, as the paper tells it."""

import functools

import numpy as np

Path = list[tuple[int, int]]


def best_path(costs: np.ndarray) -> tuple[float, Path]:
    """Cheapest path by recursion; of equal costs the diagonal, then the step along the second index."""

    @functools.cache
    def total(i: int, j: int) -> float:
        if i < 0 or j < 0:
            return float("inf")
        if i == j == 0:
            return float(costs[0, 0])
        return float(costs[i, j]) + min(total(i - 1, j - 1), total(i, j - 1), total(i - 1, j))

    path = [(costs.shape[0] - 1, costs.shape[1] - 1)]
    while path[-1] != (0, 0):
        i, j = path[-1]
        choices = [(i - 1, j - 1), (i, j - 1), (i - 1, j)]
        path.append(min(choices, key=lambda cell: total(*cell)))  # min keeps the first of equals
    return total(costs.shape[0] - 1, costs.shape[1] - 1), path[::-1]


def merge(reference: np.ndarray, motions: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray, float]:
    """Weighted mean of the motions warped to the reference, the weights (mean over motions), the cost."""
    sums = np.zeros_like(reference)
    weights = np.zeros(len(reference))
    cost = 0.0
    for motion in motions:
        local = np.array([[np.abs(a - b).sum() for b in motion] for a in reference])
        path_cost, path = best_path(local)
        cost += path_cost
        for i, j in path:
            partners = sum(1 for _, other in path if other == j)
            sums[i] += motion[j] / partners
            weights[i] += 1.0 / partners
    return sums / weights[:, None], weights / len(motions), cost


def equalise(values: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Frames of equal weight: every new frame is the mean over its part of the weighted time line."""
    whole = weights.sum()
    count = max(round(whole), 1)
    frames = []
    for k in range(count):
        low, high = k * whole / count, (k + 1) * whole / count
        mean, start = np.zeros(values.shape[1]), 0.0
        for value, weight in zip(values, weights, strict=True):
            overlap = min(high, start + weight) - max(low, start)
            mean += max(overlap, 0.0) * value
            start += weight
        frames.append(mean / (high - low))
    return np.array(frames)


def template_distance(template: np.ndarray, motion: np.ndarray) -> float:
    """Cheapest warping, diagonal steps counted twice, over the two lengths; grey (-1) entries are skipped."""
    local = np.zeros((len(template), len(motion)))
    for i, row in enumerate(template):
        for j, frame in enumerate(motion):
            fixed = [k for k in range(len(row)) if row[k] >= 0]
            wrong = [k for k in fixed if row[k] != frame[k]]
            local[i, j] = len(wrong) / len(fixed) if fixed else 0.0

    @functools.cache
    def total(i: int, j: int) -> float:
        if i == j == 0:
            return 2.0 * local[0, 0]
        steps = []
        if i > 0 and j > 0:
            steps.append(total(i - 1, j - 1) + 2.0 * local[i, j])
        if i > 0:
            steps.append(total(i - 1, j) + local[i, j])
        if j > 0:
            steps.append(total(i, j - 1) + local[i, j])
        return min(steps)

    return total(len(template) - 1, len(motion) - 1) / (len(template) + len(motion))
