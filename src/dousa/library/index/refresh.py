"""The index of a library as it is now: from the one of before, reading only clips that have changed.

Nobody has to say what has changed: numbers of clips are divided into blocks, and the checksums of the rows of a block,
which lie in an index of the database, are added up. Where a sum is another one the checksums are compared one by one,
and clips whose own are others are read. So it makes no difference who changed the library, with what, or whether it was
put back from a copy.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any, Protocol

import numpy as np
import sqlalchemy as sa

from dousa.arrays import BoolArray, IntArray
from dousa.library import schema
from dousa.library.engine import next_clip_id
from dousa.library.features import lacks
from dousa.library.forests import StoredForest
from dousa.library.index.leaf_index import IndexedRows, LeafIndex, number_meanings
from dousa.library.index.parts import ClipPart, SparseVotes, count_part, read_part
from dousa.library.selection import portions


class KnownRows(Protocol):
    """Clips as they were read once: a ``LeafIndex``, or anything like it."""

    @property
    def parts(self) -> Sequence[ClipPart]:
        """The clips."""

    @property
    def alive(self) -> Sequence[BoolArray | None]:
        """For each part (N,) which of its clips are as they were; None for all."""

    @property
    def source(self) -> IndexedRows | None:
        """What they were read from."""


BLOCK = 16_384
"""Numbers of clips whose checksums are added up."""

_MOST_PARTS = 6
_MOST_CHANGED = 0.1  # of the clips: of more the whole library is read


def add_checksums(connection: sa.Connection) -> IntArray:
    """The ``sums`` of ``IndexedRows`` as they are now."""
    clips, leaves = schema.clips.c, schema.clip_leaves.c
    queries = []
    for key, checksum in ((clips.id, clips.label_checksum), (leaves.clip_id, leaves.checksum)):
        own = sa.select(sa.func.count(), sa.func.count(checksum), sa.func.coalesce(sa.func.sum(checksum), 0))
        queries.append(own.where(key.between(sa.bindparam("first"), sa.bindparam("last"))))
    found = []
    for first in range(0, next_clip_id(connection), BLOCK):
        ends = {"first": first, "last": first + BLOCK - 1}
        found.append([int(value) for query in queries for value in connection.execute(query, ends).one()])
    return np.array(found, np.int64).reshape(-1, 6)


def read_lacking(connection: sa.Connection, blocks: Iterable[int] | None = None) -> dict[int, str]:
    """By number, the joints that clips lack; of those that lack some, in all blocks or in some."""
    clips = schema.clips.c
    query = sa.select(clips.id, clips.absent).where(clips.kind == schema.CLIP, clips.absent != "")
    if blocks is None:
        return {row.id: row.absent for row in connection.execute(query)}
    found = {}
    for block in blocks:
        own = query.where(clips.id.between(block * BLOCK, (block + 1) * BLOCK - 1))
        found.update({row.id: row.absent for row in connection.execute(own)})
    return found


def renew_lacking(connection: sa.Connection, known: KnownRows, changed: Sequence[int]) -> dict[int, str]:
    """The ``partial`` of ``IndexedRows`` as it is now, where something has changed in some blocks."""
    before = {} if known.source is None else known.source.partial
    blocks = set(changed)
    kept = {number: absent for number, absent in before.items() if number // BLOCK not in blocks}
    return kept | read_lacking(connection, changed)


def change_sums(sums: IntArray, ids: IntArray, differences: IntArray) -> IntArray:
    """The ``sums`` of ``IndexedRows`` where the checksums of the leaves of clips are others, by differences (M,)."""
    changed = sums.copy()
    np.add.at(changed[:, 5], ids // BLOCK, differences)
    return changed


def read_index(connection: sa.Connection, revision: int, stored: StoredForest) -> LeafIndex:
    """Read what the trees say of all clips, at a revision of the library.

    Raises
    ------
    LibraryDamagedError : as of ``read_part``.
    """
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
    """The index of clips that are all as they were; their votes are counted where they are not known."""
    meanings = number_meanings(stored.categories)
    return LeafIndex(
        revision,
        (stored.revision, stored.learned),
        stored.categories,
        stored.likeness,
        meanings,
        parts,
        tuple(count_part(stored, part, meanings) for part in parts) if votes is None else votes,
        (None,) * len(parts),
        {number: absent for number, absent in rows.partial.items() if lacks(stored.feature_set, absent)},
        rows,
    )


def refresh_index(connection: sa.Connection, revision: int, stored: StoredForest, known: LeafIndex) -> LeafIndex | None:
    """The index at a later revision; None where so much has changed that all is read anew.

    Parameters
    ----------
    known : of a time before, with the same trees but for what they have learned since.
    """
    rows = known.source
    if rows is None or known.learned[0] != stored.revision:
        return None
    compared = compare_rows(connection, known)
    if compared is None:
        return None
    sums, changed, fresh, alive = compared
    if len(known.parts) > _MOST_PARTS:  # the small ones become one
        alive, again = _fold(known, alive)
        fresh = np.union1d(fresh, again)
    n_changed = len(fresh) + sum(int(a.sum()) for a in alive[known.n_kept :])
    if n_changed > max(_MOST_CHANGED * len(known.parts[0]), 1000):
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
    connection: sa.Connection, known: KnownRows
) -> tuple[IntArray, list[int], IntArray, list[BoolArray]] | None:
    """What has changed since clips were read; None where rows have no checksums that would tell.

    Returns
    -------
    sums : of ``IndexedRows``, as they are now.
    changed : blocks in which something has.
    fresh : numbers of the clips that have changed or come.
    alive : which clips of each part are as they were.
    """
    rows = known.source
    if rows is None or not rows.is_sealed:
        return None
    sums = add_checksums(connection)
    both, most = sorted((len(sums), len(rows.sums)))
    changed = [block for block in range(most) if block >= both or (sums[block] != rows.sums[block]).any()]
    if not IndexedRows(sums, {}).is_sealed:
        return None
    return sums, changed, *_compare_blocks(connection, known, changed)


def _compare_blocks(
    connection: sa.Connection, known: KnownRows, blocks: Sequence[int]
) -> tuple[IntArray, list[BoolArray]]:
    """Numbers of the clips in some blocks that have changed or come, and which clips of each part are as they were."""
    clips, leaves = schema.clips.c, schema.clip_leaves.c
    query = sa.select(clips.id, clips.label_checksum, leaves.checksum)
    query = query.join(schema.clip_leaves, leaves.clip_id == clips.id).order_by(clips.id)
    alive = [
        np.ones(len(p), np.bool_) if a is None else a.copy() for p, a in zip(known.parts, known.alive, strict=True)
    ]
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
    """All clips of the small parts as if they were gone, and their numbers."""
    n_kept = known.n_kept
    again = [part.ids[own] for part, own in zip(known.parts[n_kept:], alive[n_kept:], strict=True)]
    return [*alive[:n_kept], *(np.zeros_like(own) for own in alive[n_kept:])], np.concatenate(again)
