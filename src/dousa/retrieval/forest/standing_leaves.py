"""The leaves of very many clips in compact form, pairs of clips for small categories, and examples of leaves.

Leaves are stored as codes, numbered among the occupied leaves of their tree: a million clips in 100 trees are 200 MB,
which may be in a file.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import BoolArray, IndexArray, IntArray
from dousa.retrieval.forest import tree_kernels as kernels
from dousa.retrieval.forest.growing_kernels import GOLDEN, MIX_1, MIX_2


@dataclass(frozen=True, slots=True, eq=False)
class LeafCodes:
    """The leaves of some clips.

    Parameters
    ----------
    codes : (n, n_trees) whole numbers.
    table, offsets : (K,) leaves, and (n_trees,) start of each tree's; the leaf is table[offset + code].
    places : (n,) int64, the clip of each row among all; -1 for one that does not count.
    """

    codes: NDArray[Any]
    table: NDArray[np.int32]
    offsets: IntArray
    places: IntArray


class StandingLeaves:
    """The leaves of N clips, each in one of the parts."""

    def __init__(self, parts: Sequence[LeafCodes], count: int) -> None:
        self.parts = tuple(parts)
        self._count = count
        starts = np.cumsum([0, *(len(part.places) for part in self.parts)])
        self._rows = np.full(count, -1)
        for part, start in zip(self.parts, starts, strict=False):
            there = part.places >= 0
            self._rows[part.places[there]] = start + np.flatnonzero(there)
        self._starts = starts

    @classmethod
    def of(cls, leaves: NDArray[np.integer[Any]] | StandingLeaves, n_leaves: int) -> StandingLeaves:
        """Wrap plain leaves (N, n_trees) below ``n_leaves``."""
        if isinstance(leaves, StandingLeaves):
            return leaves
        table, offsets = np.arange(n_leaves, dtype=np.int32), np.zeros(leaves.shape[1], np.int64)
        part = LeafCodes(np.ascontiguousarray(leaves), table, offsets, np.arange(len(leaves)))
        return cls((part,), len(leaves))

    def __len__(self) -> int:
        return self._count

    @property
    def n_trees(self) -> int:
        return int(self.parts[0].codes.shape[1])

    def only(self, chosen: BoolArray) -> StandingLeaves:
        """Keep the clips ``chosen`` (N,), renumbered from 0."""
        return self._renumber(np.where(chosen, np.cumsum(chosen) - 1, -1), int(chosen.sum()))

    def among(self, chosen: BoolArray) -> StandingLeaves:
        """Keep the clips ``chosen`` (N,), with their numbers; the others do not count."""
        return self._renumber(np.where(chosen, np.arange(self._count), -1), self._count)

    def _renumber(self, numbers: IntArray, count: int) -> StandingLeaves:
        parts = [replace(part, places=np.where(part.places < 0, -1, numbers[part.places])) for part in self.parts]
        return StandingLeaves(parts, count)

    def take(self, clips: IndexArray, at_once: int = 1 << 14) -> NDArray[np.int32]:
        """Return (n, n_trees) leaves of some clips, read ``at_once``."""
        taken = np.empty((len(clips), self.n_trees), np.int32)
        rows = self._rows[clips]
        for part, start in zip(self.parts, self._starts, strict=False):
            own = np.flatnonzero((rows >= start) & (rows < start + len(part.places)))
            for first in range(0, len(own), at_once):
                some = own[first : first + at_once]
                taken[some] = part.table[part.offsets + part.codes[rows[some] - start]]
        return taken

    def find(self, marked: BoolArray) -> IndexArray:
        """Return the clips in any of the leaves ``marked`` (L,), ascending."""
        found = [np.zeros(0, np.int64)]
        for part in self.parts:
            hits = np.empty(len(part.places), np.bool_)
            kernels.find_marked(part.codes, part.offsets, part.places, marked[part.table], hits)
            found.append(part.places[hits])
        return np.sort(np.concatenate(found))

    def count(self, ranks: IntArray, categories: NDArray[np.int32], n_classes: int) -> IntArray:
        """Count (K, C) the clips of each category (N,) in leaves of ``ranks`` (L,) from 0, which may repeat; -1 for
        none.
        """
        counts = np.zeros((int(ranks.max(initial=-1)) + 1, n_classes), np.int64)
        for part in self.parts:
            kernels.count_standing(part.codes, part.offsets, part.places, ranks[part.table], categories, counts)
        return counts

    def list(self, marked: BoolArray) -> tuple[IndexArray, IndexArray]:
        """List (clip, leaf) pairs of all leaves ``marked`` (L,), as two arrays (M,), by ascending clip."""
        clips, leaves = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
        for part in self.parts:
            wanted = marked[part.table]
            count = kernels.list_marked(part.codes, part.offsets, part.places, wanted, np.empty((2, 0), np.int64))
            room = np.empty((2, count), np.int64)
            kernels.list_marked(part.codes, part.offsets, part.places, wanted, room)
            clips.append(room[0])
            leaves.append(part.table[room[1]].astype(np.int64))
        all_clips = np.concatenate(clips)
        order = np.argsort(all_clips, kind="stable")
        return all_clips[order], np.concatenate(leaves)[order]


MOST_FILLED = 256
"""Clips from which a category needs no points (docs/retrieval.md)."""


class Keys(Protocol):
    """Keys of the contents of clips: an array, or a reader."""

    def __getitem__(self, places: IntArray, /) -> NDArray[np.uint64]: ...


def mix(one: NDArray[np.uint64], other: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Return a pseudo-random 64-bit number for each pair of numbers: two rounds of splitmix64."""
    z = one
    for more in (np.uint64(0), other):
        z = (z ^ more) + GOLDEN
        z = (z ^ (z >> np.uint64(30))) * MIX_1
        z = (z ^ (z >> np.uint64(27))) * MIX_2
        z = z ^ (z >> np.uint64(31))
    return z


@dataclass(frozen=True, slots=True, eq=False)
class Pairs:
    """Pairs of clips: the places (P,) of both, and a key (P,) of each pair, derived from those of its clips."""

    first: IntArray
    second: IntArray
    keys: NDArray[np.uint64]

    def take(self, places: IntArray) -> Pairs:
        """Return the pairs at some places."""
        return Pairs(self.first[places], self.second[places], self.keys[places])

    def without(self, others: Pairs) -> IntArray:
        """Return the places of the pairs that are not among others."""
        last = max((int(part.max()) for part in (self.second, others.second, self.first) if len(part)), default=0) + 1
        return np.flatnonzero(~np.isin(self.first * last + self.second, others.first * last + others.second))


def choose_pairs(own: NDArray[np.int32], keys: Keys, later: BoolArray, usual: int) -> Pairs:
    """Choose pairs that fill small categories up to the usual number of clips, at most ``MOST_FILLED``.

    Parameters
    ----------
    own : (N,) categories of all clips.
    keys : (N,) of their contents.
    later : (N,) which came after the training: at least one of each pair did.
    usual : number of clips of a category.
    """
    nothing = np.zeros(0, np.int64)
    chosen = [Pairs(nothing, nothing, np.zeros(0, np.uint64))]
    sizes = np.bincount(own) if len(own) else nothing
    for category in np.unique(own[later]):
        missing = min(usual, MOST_FILLED) - int(sizes[category])
        if missing > 0:
            inside = np.flatnonzero(own == category)
            theirs = keys[inside]  # only of these, as keys may be read from a file
            order = np.argsort(theirs, kind="stable")
            pairs = _list_pairs(inside[order], later[inside[order]], theirs[order])
            chosen.append(pairs.take(np.argsort(pairs.keys, kind="stable")[:missing]))
    return Pairs(*(np.concatenate([getattr(one, name) for one in chosen]) for name in Pairs.__slots__))


def _list_pairs(inside: IntArray, later: BoolArray, keys: NDArray[np.uint64]) -> Pairs:
    """List pairs of clips of one small category, ordered by their keys (n,), of which at least one came later."""
    first, second = np.triu_indices(len(inside), 1)
    some = later[first] | later[second]
    one, other = first[some], second[some]
    return Pairs(inside[one], inside[other], mix(keys[one], keys[other]))


MOST_EXAMPLES = 8
"""Examples of a leaf (docs/scaling.md)."""


def choose_examples(
    portions: Iterable[tuple[IntArray, NDArray[np.int32], NDArray[np.int32]]],
    n_leaves: int,
    most: int = MOST_EXAMPLES,
) -> NDArray[np.int32]:
    """Choose examples (L, E) of each leaf by number, -1 where it has fewer clips.

    Parameters
    ----------
    portions : of clips in the order of their contents: numbers (n,), categories (n,), leaves (n, n_trees).
    n_leaves : L.
    most : E.
    """
    kept = np.full((n_leaves, most), -1, np.int32)
    categories = np.full((n_leaves, most), -1, np.int32)
    for numbers, own, leaves in portions:
        kernels.keep_examples(numbers.astype(np.int32), own, np.ascontiguousarray(leaves), kept, categories)
    return kept
