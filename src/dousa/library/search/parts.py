"""Clips as a search reads them: a few flat arrays, which can lie in a file."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import sqlalchemy as sa
from numpy.typing import NDArray

from dousa.arrays import BoolArray, FloatArray, IndexArray, IntArray
from dousa.errors import LibraryDamagedError
from dousa.library.search.kernels import copy_runs, count_sparsely, encode_leaves, find_most, find_owners
from dousa.library.store import schema
from dousa.library.store.checksums import LABELS, LEAVES
from dousa.library.store.forests import PARTS_OF_A_VOTE, StoredForest, check_leaves
from dousa.library.store.schema import stack

_MISSING = np.iinfo(np.uint16).max  # the code of leaves without clips


@dataclass(frozen=True, slots=True, eq=False)
class ClipPart:
    """N clips of a library, sorted by number, with the answers of the trees.

    Parameters
    ----------
    ids : (N,) int64.
    sums : (N, 2) int64, checksums of labels and leaves.
    given, predicted : (N,) int32, places in ``names`` of the given category, -1 for none, and of the predicted one.
    names : categories.
    path_ends, path_bytes : (N,) ends of the paths in (B,) uint8.
    codes : (N, n_trees) uint16 or int32, number of each leaf within its tree.
    table, offsets : (L,) int32 leaves, and (n_trees,) start of each tree in it.
    directions : (N, K) float32 of ``Likeness.place``; None if unknown.
    """

    ids: IntArray
    sums: IntArray
    given: NDArray[np.int32]
    predicted: NDArray[np.int32]
    names: tuple[str, ...]
    path_ends: IntArray
    path_bytes: NDArray[np.uint8]
    codes: NDArray[Any]
    table: NDArray[np.int32]
    offsets: IntArray
    directions: NDArray[np.float32] | None

    def __len__(self) -> int:
        return len(self.ids)

    def path(self, row: int) -> bytes:
        """Return the path of a clip in UTF-8, which sorts as the text does."""
        start = self.path_ends[row - 1] if row else 0
        return self.path_bytes[start : self.path_ends[row]].tobytes()

    def label(self, row: int) -> str:
        """Return the given category of a clip, else the predicted one."""
        return self.names[int(self.predicted[row] if self.given[row] < 0 else self.given[row])]

    def are_labelled(self, category: str) -> BoolArray:
        """Return (N,) whether clips are of a category, as in ``label``."""
        if category not in self.names:
            return np.zeros(len(self), np.bool_)
        number = self.names.index(category)
        chosen: BoolArray = np.where(self.given < 0, self.predicted, self.given) == number
        return chosen

    def leaves(self, rows: IndexArray | slice) -> NDArray[np.int32]:
        """Return (M, n_trees) leaves of clips."""
        leaves: NDArray[np.int32] = self.table[self.offsets + self.codes[rows]]
        return leaves

    def encode(self, leaves: NDArray[np.int32]) -> NDArray[Any]:
        """Return (n_trees,) codes of leaves, with an unused code for leaves without clips."""
        ends = np.append(self.offsets[1:], len(self.table))
        missing = _MISSING if self.codes.dtype == np.uint16 else -1
        codes = np.full(len(leaves), missing, self.codes.dtype)
        for tree, (leaf, start, end) in enumerate(zip(leaves, self.offsets, ends, strict=True)):
            place = int(np.searchsorted(self.table[start:end], leaf))
            if start + place < end and self.table[start + place] == leaf:
                codes[tree] = place
        return codes


@dataclass(frozen=True, slots=True, eq=False)
class SparseVotes:
    """Nonzero votes for N clips, in 64ths of a tree.

    Parameters
    ----------
    starts : (N + 1,) start of the entries of each clip.
    categories, votes : (E,) uint16 and int32.
    squares : (N,) int64, sums of the squared votes.
    lengths : (N,) Euclidean lengths of the votes for meanings.
    """

    starts: IntArray
    categories: NDArray[np.uint16]
    votes: NDArray[np.int32]
    squares: IntArray
    lengths: FloatArray

    def dense(self, row: int, n_categories: int) -> NDArray[np.int32]:
        """Return (1, C) votes of one clip."""
        votes = np.zeros((1, n_categories), np.int32)
        own = slice(self.starts[row], self.starts[row + 1])
        votes[0, self.categories[own]] = self.votes[own]
        return votes


def read_part(connection: sa.Connection, stored: StoredForest, portions: Iterable[sa.ColumnElement[bool]]) -> ClipPart:
    """Read clips that have leaves, in portions of ascending numbers.

    LibraryDamagedError for a wrong checksum, or leaves that do not fit the forest.
    """
    clips, table = schema.clips.c, schema.clip_leaves.c
    query = sa.select(*LABELS.columns, *LEAVES.columns).join(schema.clip_leaves, table.clip_id == clips.id)
    gathered = _Gathered(stored)
    for portion in portions:
        rows = connection.execute(query.where(portion).order_by(clips.id)).all()
        if rows:
            columns = list(zip(*rows, strict=True))
            LABELS.check_all(connection, columns[: len(LABELS.columns)])
            LEAVES.check_all(connection, columns[len(LABELS.columns) :])
            gathered.take(columns)
    return gathered.finish()


class _Gathered:
    """Clips that are being read."""

    def __init__(self, stored: StoredForest) -> None:
        self._n_leaves = stored.forest.trees_.n_leaves
        self._n_trees = len(stored.forest.trees_.roots)
        self._width = None if stored.likeness is None else stored.likeness.space.axes.shape[1]
        self._stored = stored
        self._names: dict[str, int] = {}
        self._arrays: list[tuple[NDArray[Any], ...]] = []
        self._paths: list[bytes] = []
        self._leaves: list[NDArray[np.int32]] = []
        self._directions: list[NDArray[np.float32]] = []

    def take(self, columns: Sequence[Sequence[Any]]) -> None:
        ids, paths, given, _, _, _, own, _, predicted, leaves, directions, theirs = columns
        some = stack(leaves, "<i4", (self._n_trees,), "leaves")
        check_leaves(self._stored, some)
        self._leaves.append(some)
        self._paths += [path.encode() for path in paths]
        numbers = ids, self._number(given), self._number(predicted)
        self._arrays.append((*(np.array(column, np.int64) for column in numbers), np.array((own, theirs), np.int64).T))
        if None in directions:
            self._width = None
        if self._width is not None:
            self._directions.append(stack(directions, "<f4", (self._width,), "directions"))

    def _number(self, labels: Sequence[str | None]) -> list[int]:
        known = self._names
        return [-1 if name is None else known.setdefault(name, len(known)) for name in labels]

    def finish(self) -> ClipPart:
        empty = (np.zeros(0, np.int64),) * 3 + (np.zeros((0, 2), np.int64),)
        ids, given, predicted, sums = (np.concatenate(parts) for parts in zip(empty, *self._arrays, strict=True))
        leaves = np.concatenate([np.zeros((0, self._n_trees), np.int32), *self._leaves])
        self._leaves.clear()
        directions = None
        if self._width is not None:
            directions = np.concatenate([np.zeros((0, self._width), np.float32), *self._directions])
        part = make_part(ids, given, tuple(self._names), self._paths, leaves, self._n_leaves)
        return replace(part, sums=sums, predicted=predicted.astype(np.int32), directions=directions)


def make_part(
    ids: IntArray,
    given: IntArray,
    names: tuple[str, ...],
    paths: Sequence[bytes],
    leaves: NDArray[np.int32],
    n_leaves: int,
) -> ClipPart:
    """Make a part of clips, sorted by number, and their leaves (N, n_trees) of a forest with ``n_leaves``.

    Checksums, predicted categories and directions are unknown.
    """
    codes, table, offsets = encode_rows(leaves, n_leaves)
    return ClipPart(
        ids=ids,
        sums=np.zeros((len(ids), 2), np.int64),
        given=given.astype(np.int32),
        predicted=np.zeros(len(ids), np.int32),
        names=names,
        path_ends=np.cumsum([len(path) for path in paths], dtype=np.int64),
        path_bytes=np.frombuffer(b"".join(paths), np.uint8),
        codes=codes,
        table=table,
        offsets=offsets,
        directions=None,
    )


def encode_rows(leaves: NDArray[np.int32], n_leaves: int) -> tuple[NDArray[Any], NDArray[np.int32], IntArray]:
    """Return the codes of leaves (N, n_trees), table and offsets; LibraryDamagedError for one in two trees."""
    n_trees = leaves.shape[1]
    owners = np.full(n_leaves, -1, np.int32)
    if not find_owners(leaves, owners):
        raise LibraryDamagedError("library_forest.no_such_leaf")
    table, offsets, ranks = order_table(owners, n_trees)
    codes = np.empty(leaves.shape, choose_code(ranks))
    encode_leaves(leaves, ranks, codes)
    return codes, table, offsets


def pick_clips(part: ClipPart, rows: IndexArray, leaves: NDArray[np.int32], n_leaves: int) -> ClipPart:
    """Return some clips (M,) of a part, moved to other leaves (M, n_trees) of a forest with ``n_leaves``."""
    starts = np.concatenate([np.zeros(1, np.int64), part.path_ends])
    ends = np.cumsum(starts[rows + 1] - starts[rows])
    paths = np.empty(int(ends[-1]) if len(ends) else 0, np.uint8)
    copy_runs(part.path_bytes, starts, rows, ends, paths)
    codes, table, offsets = encode_rows(leaves, n_leaves)
    return replace(
        part,
        ids=part.ids[rows],
        sums=part.sums[rows],
        given=part.given[rows],
        predicted=part.predicted[rows],
        path_ends=ends,
        path_bytes=paths,
        codes=codes,
        table=table,
        offsets=offsets,
        directions=None if part.directions is None else part.directions[rows],
    )


def order_table(owners: NDArray[np.int32], n_trees: int) -> tuple[NDArray[np.int32], IntArray, IntArray]:
    """Return the leaves sorted by tree, the start of each tree, and the rank of each leaf in its tree.

    ``owners`` (L,) is the tree of each leaf, -1 to leave it out.
    """
    table = np.flatnonzero(owners >= 0)
    table = table[np.argsort(owners[table], kind="stable")]
    offsets = np.searchsorted(owners[table], np.arange(n_trees))
    ranks = np.zeros(len(owners), np.int64)
    ranks[table] = np.arange(len(table)) - offsets[owners[table]]
    return table.astype(np.int32), offsets, ranks


def choose_code(ranks: IntArray) -> type[np.uint16 | np.int32]:
    """Choose the type of the codes by the largest rank."""
    return np.uint16 if int(ranks.max(initial=0)) < _MISSING else np.int32


def count_part(
    stored: StoredForest, part: ClipPart, meanings: IndexArray, *, at_once: int = 1024, room: int = 2**22
) -> SparseVotes:
    """Count the votes of the trees for clips.

    Parameters
    ----------
    meanings : (C,) number of each category's meaning.
    at_once : clips counted in one tree before the next, so that its leaves stay in the processor's cache.
    room : votes in memory before they are copied to where they stay.
    """
    starts, classes, weights = stored.forest.vote_entries
    begins, stops = starts[part.table], starts[part.table + 1]
    shares = np.empty((at_once, len(meanings)))
    merged = np.zeros(int(meanings.max(initial=-1)) + 1, np.int64)
    portion = max(room // max(len(meanings), 1), 1)
    ends = np.zeros(len(part) + 1, np.int64)
    squares, lengths = np.zeros(len(part), np.int64), np.zeros(len(part))
    found = [(np.zeros(0, np.uint16), np.zeros(0, np.int32))]
    for first in range(0, len(part), portion):
        own = np.zeros(min(portion, len(part) - first), np.int64)
        space = np.empty(len(own) * len(meanings), np.uint16), np.empty(len(own) * len(meanings), np.int32)
        written = count_sparsely(
            part.codes, part.offsets, begins, stops, classes, weights, PARTS_OF_A_VOTE, meanings, merged, first,
            shares, own, *space, squares, lengths,
        )  # fmt: skip
        found.append((space[0][:written].copy(), space[1][:written].copy()))
        ends[first + 1 : first + 1 + len(own)] = ends[first] + own
    categories, votes = (np.concatenate(parts) for parts in zip(*found, strict=True))
    return SparseVotes(ends, categories, votes, squares, lengths)


def guess_categories(part: ClipPart, votes: SparseVotes, categories: Sequence[str]) -> ClipPart:
    """Return clips with the category that has most votes, of ``categories`` in the order of the votes."""
    most = np.zeros(len(part), np.int64)
    find_most(votes.starts, votes.categories, votes.votes, most)
    names = tuple(dict.fromkeys((*part.names, *categories)))
    return replace(part, names=names, predicted=np.array([names.index(name) for name in categories], np.int32)[most])
