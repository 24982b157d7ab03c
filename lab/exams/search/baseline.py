"""The plainest that answers: the nearest clip by joint positions, resampled, centred at the pelvis, facing one way."""

from __future__ import annotations

import numpy as np

from lab.exams.search.marks import overlap
from lab.exams.search.takes import heading, turn

FRAMES = 16


def fill(positions):
    """Gaps of each joint filled along straight lines."""
    flat = positions.reshape(len(positions), -1).copy()
    for column in flat.T:
        seen = np.isfinite(column)
        column[~seen] = np.interp(np.flatnonzero(~seen), np.flatnonzero(seen), column[seen]) if seen.any() else 0.0
    return flat.reshape(positions.shape)


def describe(positions):
    """(960,) numbers of a clip without gaps: 16 frames of 20 joints, in sizes of the body."""
    frames = positions[np.linspace(0, len(positions) - 1, FRAMES).round().astype(int)]
    frames = turn(frames, -heading(frames[0]), frames[0, 0]) - frames[0, 0]
    return (frames / np.linalg.norm(frames - frames[:, :1], axis=2).max()).ravel()


class Nearest:
    """Learned from (Points, category, person) of clips; their own names count, nothing is fitted but two tables."""

    def __init__(self, clips):
        self.x = np.array([describe(fill(p.positions)) for p, _, _ in clips])
        self.names = np.array([c for _, c, _ in clips])
        people = np.array([p for _, _, p in clips])
        self.lengths = np.quantile([p.seconds for p, _, _ in clips], (0.25, 0.5, 0.75))
        apart = self.distances(self.x)
        foreign = people[:, None] != people[None]
        if not foreign.any():
            foreign = ~np.eye(len(people), dtype=bool)
        nearest = np.where(foreign, apart, np.inf).argmin(1)
        rows = np.arange(len(nearest))
        self.firsts = self.tabulate(apart[rows, nearest], self.names[nearest] == self.names)
        self.pairs = self.tabulate(apart[foreign], (self.names[:, None] == self.names[None])[foreign])
        self.usual = np.quantile(apart[rows, nearest], 0.9)

    def distances(self, x):
        """(n, clips) between descriptions and the clips."""
        square = (x**2).sum(1)[:, None] + (self.x**2).sum(1) - 2 * x @ self.x.T
        return np.sqrt(np.maximum(square, 0))

    @staticmethod
    def tabulate(distances, right):
        """(distances, shares of right ones among the 50 around each), sorted."""
        order = np.argsort(distances, kind="stable")
        share = np.convolve(np.pad(right[order].astype(float), 25, mode="edge"), np.ones(50) / 50, "valid")
        return distances[order], np.minimum.accumulate(share[: len(order)])

    def classify(self, points):
        """(category, share of right answers at this distance, whether it is known, nearness)."""
        d = self.distances(describe(fill(points.positions))[None])[0]
        return (
            str(self.names[d.argmin()]),
            float(np.interp(d.min(), *self.firsts)),
            bool(d.min() <= self.usual),
            -d.min(),
        )

    def search(self, points):
        """(categories of all clips, the nearest first, and how many of them are as likely as not alike)."""
        d = self.distances(describe(fill(points.positions))[None])[0]
        order = d.argsort()
        return [str(n) for n in self.names[order]], int((np.interp(d[order], *self.pairs) >= 0.5).sum())

    def windows(self, points, lengths):
        """[(start, end), ...] in s of a take and (n, clips) distances, a window every fifth of a second."""
        whole, places = fill(points.positions), []
        for seconds in lengths:
            n = max(round(seconds * points.rate), 2)
            places += [(i, i + n) for i in range(0, max(len(whole) - n, 1), max(round(points.rate / 5), 1))]
        x = np.array([describe(whole[a:b]) for a, b in places])
        return np.array(places) / points.rate, self.distances(x)

    def label(self, points, never_unknown=False):
        """[(start, end, category, share of right answers)] of a take: the nearest windows that do not overlap."""
        places, d = self.windows(points, self.lengths)
        told = []
        for i in d.min(1).argsort():
            if (d[i].min() <= self.usual or never_unknown) and all(overlap(places[i], t) < 0.1 for t in told):
                told.append((*places[i], str(self.names[d[i].argmin()]), float(np.interp(d[i].min(), *self.firsts))))
        return sorted(told)

    def find(self, query, takes):
        """(number of the take, start, end, probability) of the place nearest to a query, at three tempos."""
        x, best = describe(fill(query.positions)), None
        for i, take in enumerate(takes):
            places, _ = self.windows(take, query.seconds * np.array((0.7, 1.0, 1.4)))
            whole = fill(take.positions)
            rows = np.array([describe(whole[round(a * take.rate) : round(b * take.rate)]) for a, b in places])
            d = np.linalg.norm(rows - x, axis=1)
            if best is None or d.min() < best[0]:
                best = (d.min(), i, *places[d.argmin()])
        return (*best[1:], float(np.interp(best[0], *self.pairs)))
