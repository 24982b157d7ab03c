"""Which points between two clips stand beside the clips of a small category, whatever the order in which these came."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import BoolArray, IntArray

MOST_FILLED = 256
"""Clips from which on a category has no points: it meets leaves enough of its own."""

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
    """Pairs that fill small categories up to the usual number of clips, or to ``MOST_FILLED`` if that is less.

    Parameters
    ----------
    own : (N,) categories of all clips.
    keys : (N,) that stand for their contents.
    later : (N,) which came after the training: of each pair at least one did.
    usual : number of clips of a category.
    """
    nothing = np.zeros(0, np.int64)
    chosen = [Pairs(nothing, nothing, np.zeros(0, np.uint64))]
    sizes = np.bincount(own) if len(own) else nothing
    for category in np.unique(own[later]):
        missing = min(usual, MOST_FILLED) - int(sizes[category])
        if missing > 0:
            inside = np.flatnonzero(own == category)
            theirs = keys[inside]  # only of these: of a large library they are read
            order = np.argsort(theirs, kind="stable")
            pairs = _list_pairs(inside[order], later[inside[order]], theirs[order])
            chosen.append(pairs.take(np.argsort(pairs.keys, kind="stable")[:missing]))
    return Pairs(*(np.concatenate([getattr(one, name) for one in chosen]) for name in Pairs.__slots__))


def _list_pairs(inside: IntArray, later: BoolArray, keys: NDArray[np.uint64]) -> Pairs:
    """Pairs of the clips of one small category, in the order of their keys (n,), of which one came later."""
    first, second = np.triu_indices(len(inside), 1)
    some = later[first] | later[second]
    one, other = first[some], second[some]
    return Pairs(inside[one], inside[other], mix(keys[one], keys[other]))
