"""The index of the tree answers about all clips of a library, and its refresh, which reads only changed clips.

Changes are found by checksums: those of the rows are summed for each block of clip numbers, and compared one by one
where a sum differs. So any change of the library is found, also a copy that was put back.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
import sqlalchemy as sa

from dousa.arrays import BoolArray, FloatArray, IndexArray, IntArray
from dousa.library.search.kernels import bound_clips, compare_clips
from dousa.library.search.parts import ClipPart, SparseVotes, count_part, read_part
from dousa.library.search.text_store import find_meanings
from dousa.library.store import schema
from dousa.library.store.engine import next_clip_id
from dousa.library.store.features import lacks
from dousa.library.store.forests import PARTS_OF_A_VOTE, StoredForest, TreeAnswers
from dousa.library.store.rows import portions
from dousa.retrieval.forest.likeness import Likeness


@dataclass(frozen=True, slots=True, eq=False)
class IndexedRows:
    """The rows that an index was read from.

    ``sums`` : (B, 4) int64 for each block: rows of clips, sum of their checksums; and the same of their leaves.
    ``partial`` : by number, the joints that clips lack.
    """

    sums: IntArray
    partial: dict[int, str]


@dataclass(frozen=True, slots=True)
class Base:
    """The first file that a later one belongs to.

    ``checksum`` : of its header.
    ``categories`` : of the forest when it was written, in the order of its votes.
    """

    checksum: int
    categories: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class ReadClips:
    """Clips that were read, in parts.

    Parameters
    ----------
    parts, votes : the clips, and the votes for them; later parts may have none yet.
    alive : for each part (N,) which clips are unchanged; None for all.
    source : the rows that they were read from; None if the library is too small for a file.
    base : of the file of the first part, if that has the votes of its unchanged clips.
    """

    parts: tuple[ClipPart, ...]
    votes: tuple[SparseVotes, ...]
    alive: tuple[BoolArray | None, ...]
    source: IndexedRows | None = None
    base: Base | None = None

    def list_alive(self) -> list[BoolArray]:
        """Return for each part (N,) which clips are unchanged."""
        return [np.ones(len(p), np.bool_) if a is None else a for p, a in zip(self.parts, self.alive, strict=True)]


@dataclass(frozen=True, eq=False, kw_only=True)
class LeafIndex(ReadClips):
    """The tree answers about the clips of a library, in parts whose rows are numbered through.

    Parameters
    ----------
    revision, learned : of the library and of its forest when it was read.
    categories : names, in the order of the votes.
    likeness : finds clips of the same meaning; None if not learned.
    meanings : (C,) number of each category's meaning.
    partial : by number, absent joints of the clips that are left out because they lack joints of the forest.
    n_kept : number of first parts that were read from all rows or from files; the others hold later changes.
    """

    revision: int
    learned: tuple[int, int]
    categories: tuple[str, ...]
    likeness: Likeness | None
    meanings: IndexArray
    partial: dict[int, str] = field(default_factory=dict)
    n_kept: int = 1

    @cached_property
    def starts(self) -> IntArray:
        """The first row of each part, and the number of all rows."""
        return np.cumsum([0, *map(len, self.parts)])

    @cached_property
    def has_directions(self) -> bool:
        """Whether the directions of all clips are known."""
        return self.likeness is not None and all(part.directions is not None for part in self.parts)

    @cached_property
    def living(self) -> BoolArray:
        """(N,) whether the clip of each row is unchanged."""
        return np.concatenate([np.zeros(0, np.bool_), *self.list_alive()])

    @cached_property
    def n_clips(self) -> int:
        """The number of unchanged clips."""
        return int(self.living.sum())

    def list_ids(self) -> list[int]:
        """Return the numbers of the unchanged clips."""
        return [
            number for part, own in zip(self.parts, self.list_alive(), strict=True) for number in part.ids[own].tolist()
        ]

    def find(self, clip_id: int) -> int | None:
        """Return the row of a clip; None if it is not in the index."""
        for part, start in zip(self.parts, self.starts, strict=False):
            row = int(np.searchsorted(part.ids, clip_id))
            if row < len(part) and part.ids[row] == clip_id and self.living[start + row]:
                return int(start) + row
        return None

    def clip_id(self, row: int) -> int:
        """Return the number of a clip."""
        part, own = self._locate(row)
        return int(part.ids[own])

    def path(self, row: int) -> bytes:
        """Return the path of a clip in UTF-8."""
        part, own = self._locate(row)
        return part.path(own)

    def label(self, row: int) -> str:
        """Return the given category of a clip, else the predicted one."""
        part, own = self._locate(row)
        return part.label(own)

    def _locate(self, row: int) -> tuple[ClipPart, int]:
        number = int(np.searchsorted(self.starts, row, side="right")) - 1
        return self.parts[number], row - int(self.starts[number])

    def choose(self, category: str | None, among: Collection[int] | None) -> BoolArray:
        """Return (N,) which unchanged rows are of a category and among some clip numbers; None for any."""
        chosen = self.living
        if category is not None:
            chosen = chosen & np.concatenate([part.are_labelled(category) for part in self.parts])
        if among is not None:
            wanted = np.array(sorted(among), np.int64)
            chosen = chosen & np.concatenate([np.isin(part.ids, wanted, kind="sort") for part in self.parts])
        return chosen

    def answers_of(self, clip_id: int) -> TreeAnswers:
        """Return the tree answers about one clip."""
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

    def bound(self, query: TreeAnswers, weights: tuple[float, float]) -> tuple[FloatArray, FloatArray]:
        """Compute lower bounds of the distances of all rows from one motion, and the cosines of the votes for meanings.

        ``weights`` are those of the distance of the histograms and of the share of other leaves.
        """
        votes = query.votes[0].astype(np.int64)
        merged = np.bincount(self.meanings, query.votes[0], minlength=1) if len(self.meanings) else np.zeros(1)
        meant = merged[self.meanings].astype(np.int64)
        length = float(np.linalg.norm(merged))
        numbers = _total(votes), float((votes * votes).sum()), length, float(PARTS_OF_A_VOTE)
        bounds, cosines = np.empty(self.starts[-1]), np.empty(self.starts[-1])
        for _, own, place in self._each():

            def work(first: int, last: int, own: SparseVotes = own, place: slice = place) -> None:
                some = slice(place.start + first, place.start + last)
                bound_clips(
                    own.starts[first : last + 1], own.categories, own.votes, own.squares[first:last],
                    own.lengths[first:last], votes, meant, numbers, weights, query.leaves.shape[1], bounds[some],
                    cosines[some],
                )  # fmt: skip

            _share_out(place.stop - place.start, work)
        return bounds, cosines

    def compare(self, query: TreeAnswers, rows: IndexArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Compare some clips, of ascending rows (M,), with one motion.

        Returns
        -------
        Distances of the histograms (eq. 8), shares of the trees with other leaves, and cosines of the angles (0 if
        unknown), (M,) each.
        """
        votes = query.votes[0].astype(np.int64)
        total, square = _total(votes), float((votes * votes).sum())
        histograms, others, cosines = np.empty(len(rows)), np.empty(len(rows)), np.zeros(len(rows))
        uses = self.has_directions and query.directions is not None
        direction = query.directions[0] if uses and query.directions is not None else np.zeros(0, np.float32)
        edges = np.searchsorted(rows, self.starts)
        for (part, own, place), first, last in zip(self._each(), edges[:-1], edges[1:], strict=True):
            some = slice(int(first), int(last))
            directions = np.zeros((0, 0), np.float32) if part.directions is None or not uses else part.directions
            filled = rows[some] - place.start, histograms[some], others[some], cosines[some]
            clips = own.starts, own.categories, own.votes, own.squares, part.codes, directions
            asked = votes, part.encode(query.leaves[0]), direction, total, square

            def work(first: int, last: int, filled: Any = filled, clips: Any = clips, asked: Any = asked) -> None:
                chosen, *places = (column[first:last] for column in filled)
                compare_clips(chosen, *clips, *asked, *places)

            _share_out(some.stop - some.start, work)
        return histograms, others / query.leaves.shape[1], cosines


def _share_out(count: int, work: Callable[[int, int], None], *, fewest: int = 50_000, most_threads: int = 4) -> None:
    """Call ``work(first, last)`` for all clips, in several threads of at least ``fewest`` clips each."""
    n_threads = min(count // fewest, os.cpu_count() or 1, most_threads)
    if n_threads < 2:
        work(0, count)
        return
    edges = np.linspace(0, count, n_threads + 1).astype(int).tolist()
    with ThreadPoolExecutor(n_threads) as pool:
        list(pool.map(work, edges[:-1], edges[1:]))


def _total(votes: IntArray) -> float:
    return max(float(votes.sum()), 1e-300)


def number_meanings(categories: Sequence[str]) -> IndexArray:
    """Return (C,) number of each category's meaning."""
    named = find_meanings(categories)
    numbers: IndexArray = np.unique([named[name] for name in categories], return_inverse=True)[1]
    return numbers


BLOCK = 16_384
"""Clip numbers of a block, over which checksums are summed, by definition of the index files."""


def add_checksums(connection: sa.Connection) -> IntArray:
    """Compute the ``sums`` of ``IndexedRows`` as they are now."""
    clips, leaves = schema.clips.c, schema.clip_leaves.c
    queries = []
    for key, checksum in ((clips.id, clips.label_checksum), (leaves.clip_id, leaves.checksum)):
        own = sa.select(sa.func.count(), sa.func.coalesce(sa.func.sum(checksum), 0))
        queries.append(own.where(key.between(sa.bindparam("first"), sa.bindparam("last"))))
    found = []
    for first in range(0, next_clip_id(connection), BLOCK):
        ends = {"first": first, "last": first + BLOCK - 1}
        found.append([int(value) for query in queries for value in connection.execute(query, ends).one()])
    return np.array(found, np.int64).reshape(-1, 4)


def read_lacking(connection: sa.Connection, blocks: Iterable[int] | None = None) -> dict[int, str]:
    """Read the absent joints, by clip number, of the clips in all or some blocks that lack any."""
    clips = schema.clips.c
    query = sa.select(clips.id, clips.absent).where(clips.kind == schema.CLIP, clips.absent != "")
    if blocks is None:
        return {row.id: row.absent for row in connection.execute(query)}
    found = {}
    for block in blocks:
        own = query.where(clips.id.between(block * BLOCK, (block + 1) * BLOCK - 1))
        found.update({row.id: row.absent for row in connection.execute(own)})
    return found


def renew_lacking(connection: sa.Connection, known: ReadClips, changed: Sequence[int]) -> dict[int, str]:
    """Return the ``partial`` of ``IndexedRows`` as it is now, where some blocks have changed."""
    before = {} if known.source is None else known.source.partial
    blocks = set(changed)
    kept = {number: absent for number, absent in before.items() if number // BLOCK not in blocks}
    return kept | read_lacking(connection, changed)


def change_sums(sums: IntArray, ids: IntArray, differences: IntArray) -> IntArray:
    """Return the ``sums`` of ``IndexedRows`` after the checksums of leaves of clips changed by differences (M,)."""
    changed = sums.copy()
    np.add.at(changed[:, 3], ids // BLOCK, differences)
    return changed


def read_index(connection: sa.Connection, revision: int, stored: StoredForest) -> LeafIndex:
    """Read the tree answers about all clips; LibraryDamagedError as in ``read_part``."""
    clips = schema.clips.c
    rows = IndexedRows(add_checksums(connection), read_lacking(connection))
    starts = range(0, len(rows.sums) * BLOCK, BLOCK)
    part = read_part(connection, stored, (clips.id.between(start, start + BLOCK - 1) for start in starts))
    return make_index(revision, stored, rows, (part,))


def make_index(
    revision: int,
    stored: StoredForest,
    rows: IndexedRows,
    parts: tuple[ClipPart, ...],
    votes: tuple[SparseVotes, ...] | None = None,
) -> LeafIndex:
    """Make the index of clips that are all unchanged, and count the votes if they are not given."""
    meanings = number_meanings(stored.categories)
    return LeafIndex(
        parts,
        tuple(count_part(stored, part, meanings) for part in parts) if votes is None else votes,
        (None,) * len(parts),
        rows,
        revision=revision,
        learned=(stored.revision, stored.learned),
        categories=stored.categories,
        likeness=stored.likeness,
        meanings=meanings,
        partial={number: absent for number, absent in rows.partial.items() if lacks(stored.feature_set, absent)},
    )


def refresh_index(
    connection: sa.Connection,
    revision: int,
    stored: StoredForest,
    known: LeafIndex,
    *,
    most_parts: int = 6,
    most_changed: float = 0.1,
) -> LeafIndex | None:
    """Update an earlier index of the same trees; None if so much has changed that all must be read.

    ``most_parts`` : more are joined to one; each is looked through by every search.
    ``most_changed`` : share of the clips beyond which reading the whole library is faster.
    """
    rows = known.source
    if rows is None or known.learned[0] != stored.revision:
        return None
    sums, changed, fresh, alive = compare_rows(connection, known, rows)
    if len(known.parts) > most_parts:  # the small ones become one
        alive, again = _fold(known, alive)
        fresh = np.union1d(fresh, again)
    n_changed = len(fresh) + sum(int(a.sum()) for a in alive[known.n_kept :])
    if n_changed > max(most_changed * len(known.parts[0]), 1000):
        return None
    lacking = renew_lacking(connection, known, changed)
    parts, votes = list(known.parts), list(known.votes)
    if (stored.revision, stored.learned) != known.learned:
        votes = [count_part(stored, part, number_meanings(stored.categories)) for part in parts]
    if len(fresh):
        some = read_part(connection, stored, (schema.clips.c.id.in_(ids) for ids in portions(fresh.tolist())))
        parts.append(some)
        votes.append(count_part(stored, some, number_meanings(stored.categories)))
        alive.append(np.ones(len(some), np.bool_))
    kept = [place for place, own in enumerate(alive) if place == 0 or own.any()]
    whole = make_index(revision, stored, IndexedRows(sums, lacking), tuple(parts[:1]), tuple(votes[:1]))
    return replace(
        whole,
        parts=tuple(parts[place] for place in kept),
        votes=tuple(votes[place] for place in kept),
        alive=tuple(None if alive[place].all() else alive[place] for place in kept),
        n_kept=sum(place < known.n_kept for place in kept),
    )


def compare_rows(
    connection: sa.Connection, known: ReadClips, rows: IndexedRows
) -> tuple[IntArray, list[int], IntArray, list[BoolArray]]:
    """Find the changes since clips were read from these rows.

    Returns
    -------
    sums : of ``IndexedRows``, as they are now.
    changed : blocks with changes.
    fresh : numbers of changed and added clips.
    alive : which clips of each part are unchanged.
    """
    sums = add_checksums(connection)
    both, most = sorted((len(sums), len(rows.sums)))
    changed = [block for block in range(most) if block >= both or (sums[block] != rows.sums[block]).any()]
    return sums, changed, *_compare_blocks(connection, known, changed)


def _compare_blocks(
    connection: sa.Connection, known: ReadClips, blocks: Sequence[int]
) -> tuple[IntArray, list[BoolArray]]:
    """Return the numbers of changed and added clips in some blocks, and which clips of each part are unchanged."""
    clips, leaves = schema.clips.c, schema.clip_leaves.c
    query = sa.select(clips.id, sa.func.coalesce(clips.label_checksum, -1), sa.func.coalesce(leaves.checksum, -1))
    query = query.join(schema.clip_leaves, leaves.clip_id == clips.id).order_by(clips.id)
    alive = [own.copy() for own in known.list_alive()]
    fresh = [np.zeros(0, np.int64)]
    for block in blocks:
        first, last = block * BLOCK, (block + 1) * BLOCK - 1
        rows: list[Any] = list(connection.execute(query.where(clips.id.between(first, last))))
        now = np.array([tuple(row) for row in rows], np.int64).reshape(-1, 3)
        same = np.zeros(len(now), np.bool_)
        for part, own in zip(known.parts, alive, strict=True):
            start, stop = np.searchsorted(part.ids, [first, last + 1])
            places = np.searchsorted(now[:, 0], part.ids[start:stop])
            inside = np.minimum(places, max(len(now) - 1, 0))
            equal = np.zeros(stop - start, np.bool_)
            if len(now):
                equal = (now[inside, 0] == part.ids[start:stop]) & (now[inside, 1:] == part.sums[start:stop]).all(
                    axis=1
                )
            own[start:stop] &= equal
            same[inside[own[start:stop]]] = True
        fresh.append(now[~same, 0])
    return np.concatenate(fresh), alive


def _fold(known: LeafIndex, alive: list[BoolArray]) -> tuple[list[BoolArray], IntArray]:
    """Mark all clips of the small parts as changed, and return their numbers."""
    n_kept = known.n_kept
    again = [part.ids[own] for part, own in zip(known.parts[n_kept:], alive[n_kept:], strict=True)]
    return [*alive[:n_kept], *(np.zeros_like(own) for own in alive[n_kept:])], np.concatenate(again)
