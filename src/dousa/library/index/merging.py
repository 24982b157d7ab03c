"""The parts of an index as one part, put together in portions: so a file of it is written with little in memory."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from dousa.arrays import BoolArray, IndexArray, IntArray
from dousa.library.index.kernels import copy_runs, recode
from dousa.library.index.parts import ClipPart, SparseVotes, choose_code, order_table

_AT_ONCE = 1 << 14  # clips

Portion = list[tuple[int, IndexArray, IndexArray]]
"""Of each part its number, rows of it, and the places where they come."""


class IndexedParts(Protocol):
    """What is put together: a ``LeafIndex``, or anything like it."""

    @property
    def parts(self) -> tuple[ClipPart, ...]:
        """The clips."""

    @property
    def votes(self) -> tuple[SparseVotes, ...]:
        """Their votes."""

    @property
    def alive(self) -> tuple[BoolArray | None, ...]:
        """For each part (N,) which of its clips are as they were; None for all."""


class MergedParts:
    """The clips of an index that are as they were, in the order of their numbers.

    Parameters
    ----------
    index : of at least one part.

    Raises
    ------
    ValueError : leaves that are in two trees, which only damaged rows without checksums have.
    """

    def __init__(self, index: IndexedParts) -> None:
        rows = [
            np.arange(len(part)) if own is None else np.flatnonzero(own)
            for part, own in zip(index.parts, index.alive, strict=True)
        ]
        used = [number for number, some in enumerate(rows) if len(some)] or [0]
        self._parts = tuple(index.parts[number] for number in used)
        self._votes = tuple(index.votes[number] for number in used)
        rows = [rows[number] for number in used]
        ids = np.concatenate([part.ids[some] for part, some in zip(self._parts, rows, strict=True)])
        order = np.argsort(ids, kind="stable")
        self._owners = np.repeat(np.arange(len(rows), dtype=np.int16), [len(some) for some in rows])[order]
        self._rows = np.concatenate(rows)[order]
        self.names = tuple(dict.fromkeys(name for part in self._parts for name in part.names))
        self._numbers = [np.array([*map(self.names.index, part.names), -1], np.int32) for part in self._parts]
        self._n_trees = self._parts[0].codes.shape[1]
        self._table, self._offsets, self._ranks = self._order_leaves()

    def __len__(self) -> int:
        return len(self._rows)

    def _order_leaves(self) -> tuple[NDArray[np.int32], IntArray, IntArray]:
        """The leaves of all parts by their trees, where those of each tree begin, and the rank of each leaf there."""
        owners = np.full(max(int(part.table.max(initial=-1)) for part in self._parts) + 1, -1, np.int32)
        for part in self._parts:
            if not part.is_by_trees:
                raise ValueError
            trees = np.repeat(np.arange(self._n_trees), np.diff(np.append(part.offsets, len(part.table))))
            if ((owners[part.table] >= 0) & (owners[part.table] != trees)).any():
                raise ValueError
            owners[part.table] = trees
        return order_table(owners, self._n_trees)

    def arrays(self) -> Iterator[tuple[str, Iterator[NDArray[Any]]]]:
        """Names and contents of the arrays of a ``ClipPart`` and, as ``votes.NAME``, of a ``SparseVotes``."""
        yield "ids", self._take([part.ids for part in self._parts])
        yield "sums", self._take([part.sums for part in self._parts])
        yield "given", self._renumber([part.given for part in self._parts])
        yield "predicted", self._renumber([part.predicted for part in self._parts])
        paths = [(_starts_of(part.path_ends), part.path_bytes) for part in self._parts]
        yield "path_ends", self._ends([starts for starts, _ in paths])
        yield "path_bytes", self._runs([starts for starts, _ in paths], [own for _, own in paths])
        yield "codes", self._codes()
        yield "table", iter([self._table])
        yield "offsets", iter([self._offsets])
        if all(part.directions is not None for part in self._parts):
            yield "directions", self._take([part.directions for part in self._parts])
        starts = [votes.starts for votes in self._votes]
        yield "votes.starts", self._ends(starts, np.zeros(1, np.int64))
        yield "votes.categories", self._runs(starts, [votes.categories for votes in self._votes])
        yield "votes.votes", self._runs(starts, [votes.votes for votes in self._votes])
        yield "votes.squares", self._take([votes.squares for votes in self._votes])
        yield "votes.lengths", self._take([votes.lengths for votes in self._votes])

    def _portions(self) -> Iterator[tuple[int, Portion]]:
        """How many clips, and where they are; at least one portion."""
        for first in range(0, max(len(self), 1), _AT_ONCE):
            owners, rows = self._owners[first : first + _AT_ONCE], self._rows[first : first + _AT_ONCE]
            own = ((number, np.flatnonzero(owners == number)) for number in range(len(self._parts)))
            yield len(rows), [(number, rows[places], places) for number, places in own if len(places)]

    def _take(self, arrays: list[Any]) -> Iterator[NDArray[Any]]:
        for count, portion in self._portions():
            out = np.empty((count, *arrays[0].shape[1:]), arrays[0].dtype)
            for number, rows, places in portion:
                out[places] = arrays[number][rows]
            yield out

    def _renumber(self, arrays: list[NDArray[np.int32]]) -> Iterator[NDArray[Any]]:
        for count, portion in self._portions():
            out = np.empty(count, np.int32)
            for number, rows, places in portion:
                out[places] = self._numbers[number][arrays[number][rows]]
            yield out

    def _codes(self) -> Iterator[NDArray[Any]]:
        kind = choose_code(self._ranks)
        ranks = [self._ranks[part.table] for part in self._parts]
        for count, portion in self._portions():
            out = np.empty((count, self._n_trees), kind)
            for number, rows, places in portion:
                part = self._parts[number]
                recode(part.codes, rows, part.offsets, ranks[number], places, out)
            yield out

    def _lengths(self, starts: list[IntArray]) -> Iterator[tuple[Portion, IntArray]]:
        for count, portion in self._portions():
            lengths = np.zeros(count, np.int64)
            for number, rows, places in portion:
                lengths[places] = starts[number][rows + 1] - starts[number][rows]
            yield portion, lengths

    def _ends(self, starts: list[IntArray], before: IntArray | None = None) -> Iterator[NDArray[Any]]:
        """Where the runs of the clips end, one after the other."""
        if before is not None:
            yield before
        end = 0
        for _, lengths in self._lengths(starts):
            ends = end + np.cumsum(lengths)
            end = int(ends[-1]) if len(ends) else end
            yield ends

    def _runs(self, starts: list[IntArray], values: list[NDArray[Any]]) -> Iterator[NDArray[Any]]:
        for portion, lengths in self._lengths(starts):
            ends = np.cumsum(lengths)
            out = np.empty(int(ends[-1]) if len(ends) else 0, values[0].dtype)
            for number, rows, places in portion:
                copy_runs(values[number], starts[number], rows, ends[places], out)
            yield out


def _starts_of(ends: IntArray) -> IntArray:
    return np.concatenate([np.zeros(1, np.int64), ends])
