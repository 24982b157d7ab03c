"""Two motions beside each other, plainly: the cheapest path and what is left along it."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import uniform_filter1d

from lab.exams.dance.bodies import END, START, angle, sample, unit


def to_30(body_motion):
    """(T, 9, 3) segments at 30 Hz."""
    points = body_motion.positions
    step = body_motion.frame_rate / 30
    points = sample(np.asarray(points), np.arange(0, len(points) - 1 + 1e-6, step))
    return unit(points[:, END] - points[:, START])


def dtw(cost):
    """The cheapest path, by anti-diagonals: for each column the mean row."""
    n, m = cost.shape
    total = np.full((n + 1, m + 1), np.inf)
    total[0, 0] = 0
    for d in range(n + m - 1):
        i = np.arange(max(0, d - m + 1), min(n, d + 1))
        j = d - i
        total[i + 1, j + 1] = cost[i, j] + np.minimum(np.minimum(total[i, j + 1], total[i + 1, j]), total[i, j])
    rows, i, j = [[] for _ in range(m)], n, m
    while i and j:
        rows[j - 1].append(i - 1)
        i, j = min(((i - 1, j - 1), (i - 1, j), (i, j - 1)), key=lambda p: total[p])
    return np.array([np.mean(r) if r else 0.0 for r in rows])


def follow(x, y):
    """The frames of the reference x that y is at, by the mean cosine of the segments after the best turn."""
    plane = (x[..., 0] + 1j * x[..., 2]) @ (y[..., 0] + 1j * y[..., 2]).conj().T
    return dtw(1 - (np.abs(plane) + x[..., 1] @ y[..., 1].T) / 9)


def residuals(x, y, at):
    """Degrees (T, 9) between the reference x at these frames and y, after the best turn of every second."""
    r = unit(sample(x, at))
    turn = ((r[..., 0] + 1j * r[..., 2]).conj() * (y[..., 0] + 1j * y[..., 2])).sum(1)
    turn = uniform_filter1d(turn.real, 31) + 1j * uniform_filter1d(turn.imag, 31)
    flat = (r[..., 0] + 1j * r[..., 2]) * (turn / (np.abs(turn) + 1e-9))[:, None]
    return angle(np.stack([flat.real, r[..., 1], flat.imag], axis=2), y)
