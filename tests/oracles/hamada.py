"""Equations 1-8 and steps 1-8 of Hamada, Kuriyama, Mukai, word for word in plain Python, without any speed.

Written from the paper, not from the fast code. Only two conventions are shared, since the paper leaves them
open: the order in which random numbers are used, and that the first of equal gains is kept.
"""

import itertools
import math
from collections import Counter

SAME_GAIN = 1e-9


def height(upright):
    """Eq. 1: joints {name: (x, y, z)} of an upright posture."""
    ys = [y for _, y, _ in upright.values()]
    return max(ys) - min(ys)


def normalise(joints, h):
    """Eq. 2."""
    return {name: tuple(value / h for value in xyz) for name, xyz in joints.items()}


def mean_by_sum(series, t0, t1):
    """Eq. 3: the integral of a series that holds each of its values for one frame."""
    return sum(series[t] for t in range(t0, t1)) / (t1 - t0)


def integral(series):
    """Eq. 4."""
    g = [0.0]
    for value in series:
        g.append(g[-1] + value)
    return g


def mean_by_integral(g, t0, t1):
    """Eq. 5."""
    return (g[t1] - g[t0]) / (t1 - t0)


def entropy(categories):
    """Eq. 6, in bits."""
    count = Counter(categories)
    total = len(categories)
    return -sum(n / total * math.log2(n / total) for n in count.values())


def gain(whole, parts):
    """Eq. 7."""
    return entropy(whole) - sum(len(part) / len(whole) * entropy(part) for part in parts if part)


def distance(one, other):
    """Eq. 8."""
    return math.sqrt(sum((a - b) ** 2 for a, b in zip(one, other, strict=True)))


def parameters(n_features, n_frames):
    """The set R: every feature with every interval, long intervals before short ones and early before late."""
    return [
        (i, t0, t0 + length)
        for length in range(n_frames, 0, -1)
        for t0 in range(n_frames - length + 1)
        for i in range(n_features)
    ]


def splitmix64(state):
    """Steele, Lea, Flood 2014: the next state and the number it gives."""
    mask = 2**64 - 1
    state = (state + 0x9E3779B97F4A7C15) & mask
    z = state
    z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) & mask
    z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & mask
    return state, z ^ (z >> 31)


def draw_parameters(R, count, seed, node):
    """Step 1, as often as step 4 says: ``count`` members of R in random order, then the rest."""
    if count >= len(R):
        return list(R)
    state = seed ^ ((node * 0xD1342543DE82EF95) & (2**64 - 1))
    rest = list(range(len(R)))
    for place in range(len(R)):
        state, number = splitmix64(state)
        other = place + ((number >> 32) * (len(R) - place) >> 32)
        rest[place], rest[other] = rest[other], rest[place]
    return [R[place] for place in rest]


def best_threshold(means, categories):
    """Step 3: (gain, s) over all s half way between two different means; None if there is no such s."""
    best = None
    different = sorted(set(means))
    for low, high in itertools.pairwise(different):
        s = (low + high) / 2
        below = [c for m, c in zip(means, categories, strict=True) if m <= s]
        above = [c for m, c in zip(means, categories, strict=True) if m > s]
        value = gain(categories, [below, above])
        if best is None or value > best[0] + SAME_GAIN:
            best = value, s
    return best


class Tree:
    """Steps 1-8 for one tree over features[clip][frame][feature]."""

    def __init__(self, features, categories, n_trials, max_entropy=0.0, seed=0):
        self.features, self.categories = features, categories
        self.R = parameters(len(features[0][0]), len(features[0]))
        self.n_trials, self.max_entropy, self.seed = n_trials, max_entropy, seed
        self.n_nodes = 1
        self.root = self.build(list(range(len(features))), 0)

    def mean(self, clip, r):
        i, t0, t1 = r
        return mean_by_sum([pose[i] for pose in clip], t0, t1)

    def build(self, D, node):
        labels = [self.categories[d] for d in D]
        found = None
        if entropy(labels) > self.max_entropy:  # step 6, 8
            found = self.find(D, labels, node)
        if found is None:
            return {"histogram": Counter(labels)}
        value, r, s = found
        below = [d for d in D if self.mean(self.features[d], r) <= s]  # step 5
        above = [d for d in D if self.mean(self.features[d], r) > s]
        first = self.n_nodes
        self.n_nodes += 2
        return {  # step 7
            "r": r, "s": s, "gain": value, "below": self.build(below, first), "above": self.build(above, first + 1),
        }  # fmt: skip

    def find(self, D, labels, node):
        best = None
        for number, r in enumerate(draw_parameters(self.R, self.n_trials, self.seed, node)):  # steps 1, 2, 4
            if number >= self.n_trials and best is not None:
                break
            threshold = best_threshold([self.mean(self.features[d], r) for d in D], labels)
            if threshold is not None and (best is None or threshold[0] > best[0] + SAME_GAIN):
                best = threshold[0], r, threshold[1]
        return best

    def leaf(self, clip):
        """Section 3.4: the histogram of the leaf that a clip reaches."""
        node = self.root
        while "histogram" not in node:
            node = node["above"] if self.mean(clip, node["r"]) > node["s"] else node["below"]
        return node["histogram"]
