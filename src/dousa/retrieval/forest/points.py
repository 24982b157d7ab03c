"""Which points between two clips stand beside the clips of a small category, whatever the order in which these came."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import BoolArray, IntArray

MOST_POINTS = 256
"""Points of one category."""

_MOST_LISTED = 100_000  # pairs of a category; of more, neighbours in the order of their keys are taken
_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_MIX_1 = np.uint64(0xBF58476D1CE4E5B9)
_MIX_2 = np.uint64(0x94D049BB133111EB)


class Keys(Protocol):
    """Numbers that stand for the contents of clips: an array, or what reads them when they are asked for."""

    def __getitem__(self, places: IntArray, /) -> NDArray[np.uint64]: ...


def mix(one: NDArray[np.uint64], other: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """A 64-bit number for each pair of numbers, as good as drawn: two rounds of splitmix64."""
    z = one
    for more in (np.uint64(0), other):
        z = (z ^ more) + _GOLDEN
        z = (z ^ (z >> np.uint64(30))) * _MIX_1
        z = (z ^ (z >> np.uint64(27))) * _MIX_2
        z = z ^ (z >> np.uint64(31))
    return z


@dataclass(frozen=True, slots=True, eq=False)
class Pairs:
    """Pairs of clips: the places (P,) of both, and a key (P,) for each pair that follows from those of its clips."""

    first: IntArray
    second: IntArray
    keys: NDArray[np.uint64]

    def take(self, places: IntArray) -> Pairs:
        """Some of them."""
        return Pairs(self.first[places], self.second[places], self.keys[places])

    def without(self, others: Pairs) -> IntArray:
        """Places of those that are not among others."""
        last = max((int(part.max()) for part in (self.second, others.second, self.first) if len(part)), default=0) + 1
        return np.flatnonzero(~np.isin(self.first * last + self.second, others.first * last + others.second))


def choose_pairs(own: NDArray[np.int32], keys: Keys, later: BoolArray, usual: int) -> Pairs:
    """Pairs that fill small categories up to the usual number of clips.

    Parameters
    ----------
    own : (N,) categories of all clips.
    keys : (N,) that stand for their contents.
    later : (N,) which came after the training: of each pair at least one did.
    usual : number of clips from which on a category has no points.
    """
    nothing = np.zeros(0, np.int64)
    chosen = [Pairs(nothing, nothing, np.zeros(0, np.uint64))]
    sizes = np.bincount(own) if len(own) else nothing
    for category in np.unique(own[later]):
        missing = min(usual - int(sizes[category]), MOST_POINTS)
        if missing > 0:
            inside = np.flatnonzero(own == category)
            theirs = keys[inside]  # only of these: of a large library they are read
            order = np.argsort(theirs, kind="stable")
            pairs = _list_pairs(inside[order], later[inside[order]], theirs[order], missing)
            chosen.append(pairs.take(np.argsort(pairs.keys, kind="stable")[:missing]))
    return Pairs(*(np.concatenate([getattr(one, name) for one in chosen]) for name in Pairs.__slots__))


def _list_pairs(inside: IntArray, later: BoolArray, keys: NDArray[np.uint64], missing: int) -> Pairs:
    """Pairs of the clips of one category, in the order of their keys (n,); at least as many as are missing."""
    n = len(inside)
    if n * (n - 1) // 2 <= _MOST_LISTED:
        first, second = np.triu_indices(n, 1)
    else:
        steps = min(missing // int(later.sum()) + 1, (n - 1) // 2)
        places = np.arange(n)
        first = np.tile(places, steps)
        second = np.concatenate([(places + step) % n for step in range(1, steps + 1)])
        first, second = np.minimum(first, second), np.maximum(first, second)
    some = later[first] | later[second]
    one, other = first[some], second[some]
    return Pairs(inside[one], inside[other], mix(keys[one], keys[other]))
