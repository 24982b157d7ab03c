"""What the trees say of all clips of a library, at one of its revisions."""

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import BoolArray, FloatArray, IndexArray, IntArray
from dousa.library.forests import TreeAnswers
from dousa.library.index.kernels import bound_clips, compare_clips
from dousa.library.index.parts import ClipPart, SparseVotes
from dousa.library.text.meanings import find_meanings
from dousa.retrieval.forest.likeness import Likeness


@dataclass(frozen=True, slots=True, eq=False)
class IndexedRows:
    """What an index was read from.

    Parameters
    ----------
    sums : (B, 6) int64 for each block: rows of clips, how many have a checksum, the sum of these; and of their leaves.
    partial : by number, the joints that clips lack, of all that lack some.
    """

    sums: IntArray
    partial: dict[int, str]

    @property
    def is_sealed(self) -> bool:
        """Whether all rows have checksums; those of an older dousa may have none."""
        return bool((self.sums[:, 0] == self.sums[:, 1]).all() and (self.sums[:, 3] == self.sums[:, 4]).all())


@dataclass(frozen=True, slots=True, eq=False)
class IndexQuery:
    """What is known of a motion that is searched for.

    Parameters
    ----------
    votes, leaves : (C,) and (n_trees,) of its ``TreeAnswers``.
    poses : its pose sequence.
    direction : (K,) of ``Likeness.place``; None where it is not known.
    """

    votes: NDArray[np.int32]
    leaves: NDArray[np.int32]
    poses: NDArray[np.float32]
    direction: NDArray[np.float32] | None


@dataclass(frozen=True, slots=True, eq=False)
class Compared:
    """How far M clips are from a query.

    Parameters
    ----------
    histograms : (M,) eq. 8 between shares.
    leaves : (M,) share of the trees with other leaves.
    cosines : (M,) of the angle to the query; 0 where that is not known.
    """

    histograms: FloatArray
    leaves: FloatArray
    cosines: FloatArray


@dataclass(frozen=True, eq=False)
class LeafIndex:
    """What the trees of a library say of its clips: parts one after the other, in rows that are numbered through.

    Parameters
    ----------
    revision, learned : of the library and of its forest when it was read.
    categories : names, in the order of the votes.
    likeness : tells which clips are alike; None where that was not learned.
    meanings : (C,) number of what each category means; categories of one meaning have the same.
    parts, votes : the clips, and their votes.
    alive : for each part (N,) which of its clips are as they were; None for all.
    partial : by number, the joints that clips lack which the forest asks about: they are not among the above.
    source : what it was read from; None where nobody asks.
    n_kept : of the parts, the first, that were read from all rows or from files; the others are of what changed since.
    """

    revision: int
    learned: tuple[int, int]
    categories: tuple[str, ...]
    likeness: Likeness | None
    meanings: IndexArray
    parts: tuple[ClipPart, ...]
    votes: tuple[SparseVotes, ...]
    alive: tuple[BoolArray | None, ...]
    partial: dict[int, str] = field(default_factory=dict)
    source: IndexedRows | None = None
    n_kept: int = 1

    @cached_property
    def starts(self) -> IntArray:
        """Row at which each part begins, and the number of all rows."""
        return np.cumsum([0, *map(len, self.parts)])

    @cached_property
    def has_directions(self) -> bool:
        """Whether the directions of all clips are known."""
        return self.likeness is not None and all(part.directions is not None for part in self.parts)

    @cached_property
    def living(self) -> BoolArray:
        """(N,) rows of clips that are as they were."""
        own = [np.ones(len(p), np.bool_) if a is None else a for p, a in zip(self.parts, self.alive, strict=True)]
        return np.concatenate(own) if own else np.zeros(0, np.bool_)

    @cached_property
    def n_clips(self) -> int:
        """How many."""
        return int(self.living.sum())

    def find(self, clip_id: int) -> int | None:
        """The row of a clip; None if it is not among them."""
        for part, start in zip(self.parts, self.starts, strict=False):
            row = int(np.searchsorted(part.ids, clip_id))
            if row < len(part) and part.ids[row] == clip_id and self.living[start + row]:
                return int(start) + row
        return None

    def clip_id(self, row: int) -> int:
        """The number of a clip."""
        part, own = self._locate(row)
        return int(part.ids[own])

    def path(self, row: int) -> bytes:
        """The path of a clip, in UTF-8."""
        part, own = self._locate(row)
        return part.path(own)

    def label(self, row: int) -> str:
        """The category of a clip; the forest's, where nobody gave it one."""
        part, own = self._locate(row)
        return part.label(own)

    def _locate(self, row: int) -> tuple[ClipPart, int]:
        number = int(np.searchsorted(self.starts, row, side="right")) - 1
        return self.parts[number], row - int(self.starts[number])

    def choose(self, category: str | None, among: Collection[int] | None) -> BoolArray:
        """(N,) the rows of a category, and of clips of some numbers; of all where that is None."""
        chosen = self.living
        if category is not None:
            chosen = chosen & np.concatenate([part.are_labelled(category) for part in self.parts])
        if among is not None:
            wanted = np.array(sorted(among), np.int64)
            chosen = chosen & np.concatenate([np.isin(part.ids, wanted, kind="sort") for part in self.parts])
        return chosen

    def answers_of(self, clip_id: int) -> TreeAnswers:
        """What the trees say of one clip."""
        row = self.find(clip_id)
        assert row is not None
        number = int(np.searchsorted(self.starts, row, side="right")) - 1
        part, own = self._locate(row)
        directions = part.directions[own : own + 1] if self.has_directions and part.directions is not None else None
        votes = self.votes[number].dense(own, len(self.categories))
        return TreeAnswers(votes, part.leaves(slice(own, own + 1)), self.categories, directions)

    def _each(self) -> Iterator[tuple[ClipPart, SparseVotes, slice]]:
        places = (slice(int(a), int(b)) for a, b in zip(self.starts[:-1], self.starts[1:], strict=True))
        return zip(self.parts, self.votes, places, strict=True)

    def bound(self, query: IndexQuery, weights: tuple[float, float]) -> tuple[FloatArray, FloatArray]:
        """For all rows the least that their distance can be, and the cosine of their votes for meanings.

        Parameters
        ----------
        weights : of the distance of the histograms and of the share of other leaves.
        """
        merged = np.bincount(self.meanings, query.votes, minlength=1) if len(self.meanings) else np.zeros(1)
        told = merged[self.meanings].astype(np.int64)
        votes = query.votes.astype(np.int64)
        length = float(np.linalg.norm(merged))
        numbers = _total(query), float((votes * votes).sum()), length, _PARTS
        bounds, cosines = np.empty(self.starts[-1]), np.empty(self.starts[-1])
        for _, own, place in self._each():

            def work(first: int, last: int, own: SparseVotes = own, place: slice = place) -> None:
                some = slice(place.start + first, place.start + last)
                bound_clips(
                    own.starts[first : last + 1], own.categories, own.votes, own.squares[first:last],
                    own.lengths[first:last], votes, told, numbers, weights, len(query.leaves), bounds[some],
                    cosines[some],
                )  # fmt: skip

            _share_out(place.stop - place.start, work)
        return bounds, cosines

    def compare(self, query: IndexQuery, rows: IndexArray) -> Compared:
        """How far some clips are from a query; rows ascend."""
        votes = query.votes.astype(np.int64)
        total, square = _total(query), float((votes * votes).sum())
        found = Compared(np.empty(len(rows)), np.empty(len(rows)), np.zeros(len(rows)))
        uses = self.has_directions and query.direction is not None
        direction = query.direction if uses and query.direction is not None else np.zeros(0, np.float32)
        edges = np.searchsorted(rows, self.starts)
        for (part, own, place), first, last in zip(self._each(), edges[:-1], edges[1:], strict=True):
            some = slice(int(first), int(last))
            directions = np.zeros((0, 0), np.float32) if part.directions is None or not uses else part.directions
            told = rows[some] - place.start, found.histograms[some], found.leaves[some], found.cosines[some]
            clips = own.starts, own.categories, own.votes, own.squares, part.codes, directions
            asked = votes, part.encode(query.leaves), direction, total, square

            def work(first: int, last: int, told: Any = told, clips: Any = clips, asked: Any = asked) -> None:
                chosen, *places = (column[first:last] for column in told)
                compare_clips(chosen, *clips, *asked, *places)

            _share_out(some.stop - some.start, work)
        found.leaves[:] /= len(query.leaves)
        return found


_PARTS = 64.0
_FEWEST = 50_000  # clips for a thread
_MOST_THREADS = 4


def _share_out(count: int, work: Callable[[int, int], None]) -> None:
    """Do some work on clips from a first to a last one, in several threads where they are many."""
    n_threads = min(count // _FEWEST, os.cpu_count() or 1, _MOST_THREADS)
    if n_threads < 2:
        work(0, count)
        return
    edges = np.linspace(0, count, n_threads + 1).astype(int).tolist()
    with ThreadPoolExecutor(n_threads) as pool:
        list(pool.map(work, edges[:-1], edges[1:]))


def _total(query: IndexQuery) -> float:
    return max(float(query.votes.sum()), 1e-300)


def number_meanings(categories: Sequence[str]) -> IndexArray:
    """(C,) number of what each category means."""
    named = find_meanings(categories)
    numbers: IndexArray = np.unique([named[name] for name in categories], return_inverse=True)[1]
    return numbers
