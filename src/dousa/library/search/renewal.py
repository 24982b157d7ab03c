"""Load the index of a library, and keep its file up to date.

An outdated file is no error, as checksums show the changes, but costs time. So it is written by a training, by
learning from added clips, and by a search that had to read much of the library.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import sqlalchemy as sa
from numpy.typing import NDArray

from dousa.arrays import BoolArray, IndexArray, IntArray
from dousa.library.search.leaf_index import (
    BLOCK,
    IndexedRows,
    LeafIndex,
    ReadClips,
    change_sums,
    compare_rows,
    number_meanings,
    read_index,
    refresh_index,
    renew_lacking,
)
from dousa.library.search.parts import ClipPart, SparseVotes, count_part, guess_categories, pick_clips, read_part
from dousa.library.search.side_file import find_place, read_side_file, read_side_rows, renumber_votes, write_side_file
from dousa.library.store import schema
from dousa.library.store.engine import Database, next_clip_id, read_revision
from dousa.library.store.forests import StoredForest
from dousa.library.store.rows import portions
from dousa.library.store.schema import pack
from dousa.retrieval.forest.growth import find_changed
from dousa.retrieval.forest.tree_kernels import find_marked

FEWEST_CLIPS = BLOCK
"""Clips from which on a library has an index file, those of a block: fewer are read as fast from their rows."""

# Clips in the later file per clip of the first: of a million, 64 files change the votes of 15 % (lab/notes/scaling.md).
_MOST_AGAIN = 0.25


def load_index(
    connection: sa.Connection, where: str, stored: StoredForest, known: LeafIndex | None, *, may_write: bool
) -> LeafIndex:
    """Load the index of a library as it is now.

    LibraryDamagedError for a wrong checksum, or leaves that do not fit the forest.

    Parameters
    ----------
    where : name of the library.
    known : the index as it was loaded before, or None.
    may_write : whether a file may be written for a large library.
    """
    revision = read_revision(connection)
    if known is not None and (known.revision, known.learned) == (revision, (stored.revision, stored.learned)):
        return known
    index = None if known is None else refresh_index(connection, revision, stored, known)
    if index is not None:
        return index
    place = find_place(connection, where)
    kept = read_side_file(place, stored)
    if kept is not None:
        before, has_votes = kept
        index = refresh_index(connection, revision, stored, before)
        if index is not None and has_votes and not _is_far_behind(before, index):
            return index
    if index is None:
        index = read_index(connection, revision, stored)
    if may_write and index.n_clips >= FEWEST_CLIPS:
        write_side_file(place, stored, index)
    return index


def _is_far_behind(known: LeafIndex, index: LeafIndex) -> bool:
    """Whether more than half of the blocks have changed, so that writing the file is faster than comparing rows."""
    assert known.source is not None and index.source is not None
    before, now = known.source.sums, index.source.sums
    both = min(len(before), len(now))
    return int((before[:both] != now[:both]).any(axis=1).sum()) + len(now) - both > len(now) / 2


def make_side_file(database: Database, stored: StoredForest) -> None:
    """Write the file of a large library after a training, so that no search needs to."""
    with database.reading() as connection:
        count = connection.execute(sa.select(sa.func.count()).select_from(schema.clip_leaves)).scalar_one()
        if count >= FEWEST_CLIPS:
            load_index(connection, database.where, stored, None, may_write=True)


def read_standing(connection: sa.Connection, where: str, stored: StoredForest) -> ReadClips:
    """Read all clips that have leaves, from the file if there is one; LibraryDamagedError as in ``read_part``."""
    clips = schema.clips.c
    known = read_side_rows(find_place(connection, where), stored)
    if known is not None and known.source is not None:
        sums, changed, fresh, alive = compare_rows(connection, known, known.source)
        some = read_part(connection, stored, (clips.id.in_(ids) for ids in portions(fresh.tolist())))
        source = IndexedRows(sums, renew_lacking(connection, known, changed))
        return ReadClips((*known.parts, some), known.votes, (*alive, None), source, known.base)
    n_clips = connection.execute(sa.select(sa.func.count()).select_from(schema.clip_leaves)).scalar_one()
    if n_clips >= FEWEST_CLIPS:
        index = read_index(connection, read_revision(connection), stored)
        return ReadClips(index.parts, (), index.alive, index.source)
    blocks = range(0, next_clip_id(connection), FEWEST_CLIPS)
    part = read_part(connection, stored, (clips.id.between(first, first + FEWEST_CLIPS - 1) for first in blocks))
    return ReadClips((part,), (), (None,))


@dataclass(frozen=True, eq=False, kw_only=True)
class LearnedRows(ReadClips):
    """All clips after a forest has learned: ``changes`` are the changed values in ``clip_leaves``, by number.

    The last parts are the clips with other leaves or other votes; ``source`` is as before learning.
    """

    changes: dict[int, dict[str, Any]]

    def sealed(self, checksums: Mapping[int, int]) -> LearnedRows:
        """Return a copy with the checksums of the written rows, by number."""
        if self.source is None:
            return self
        ids = np.array(sorted(checksums), np.int64)
        new = np.array([checksums[number] for number in ids.tolist()], np.int64)
        parts, differences = [], np.zeros(len(ids), np.int64)
        for part, own in zip(self.parts, self.list_alive(), strict=True):
            rows, which = find_clips(part, own, ids)
            if not len(rows):
                parts.append(part)
                continue
            differences[which] = new[which] - part.sums[rows, 1]
            sums = part.sums.copy()
            sums[rows, 1] = new[which]
            parts.append(replace(part, sums=sums))
        source = replace(self.source, sums=change_sums(self.source.sums, ids, differences))
        return replace(self, parts=tuple(parts), source=source)


def find_clips(part: ClipPart, alive: BoolArray, ids: IntArray) -> tuple[IntArray, IntArray]:
    """Return the rows in a part of those clips of some numbers (M,) that are unchanged, and their places in ``ids``."""
    if not len(part):
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    rows = np.minimum(np.searchsorted(part.ids, ids), len(part) - 1)
    which = np.flatnonzero((part.ids[rows] == ids) & alive[rows])
    return rows[which], which


def teach_rows(
    before: StoredForest, stored: StoredForest, rows: ReadClips, ids: IntArray, leaves: NDArray[np.int32]
) -> LearnedRows:
    """Update all clips after a forest has learned.

    ``before``, ``stored`` : the forest before and after.
    ``ids``, ``leaves`` : (M,) and (M, n_trees) of the clips that have moved to other leaves.
    """
    n_leaves = stored.forest.trees_.n_leaves
    votes_differ = find_changed(before.forest, stored.forest)
    parts: list[tuple[ClipPart, BoolArray, SparseVotes | None, bool]] = []  # last: moved to other leaves
    others: list[tuple[ClipPart, bool]] = []
    for place, (part, own) in enumerate(zip(rows.parts, rows.list_alive(), strict=True)):
        places, which = find_clips(part, own, ids)
        left = own.copy()
        left[places] = False
        if len(places):
            others.append((pick_clips(part, places, leaves[which], n_leaves), True))
        known = rows.votes[place] if place < len(rows.votes) else None
        again = np.zeros(0, np.int64)
        if known is not None:
            again = _find_again(part, left, votes_differ)
            if len(again) > _MOST_AGAIN * len(part):
                known, again = None, again[:0]
        if known is not None:
            known = renumber_votes(known, before.categories, stored.categories)
        if len(again):
            left[again] = False
            others.append((pick_clips(part, again, part.leaves(again), n_leaves), False))
        parts.append((part, left, known, False))
    parts += [(part, np.ones(len(part), np.bool_), None, moved) for part, moved in others]
    base = rows.base if parts and parts[0][2] is not None else None
    changes: dict[int, dict[str, Any]] = {}
    taught = [_count_again(stored, *one, changes) for one in parts]
    return LearnedRows(
        tuple(part for part, _ in taught),
        tuple(votes for _, votes in taught),
        tuple(alive for _, alive, _, _ in parts),
        rows.source,
        base,
        changes=changes,
    )


def _count_again(
    stored: StoredForest,
    part: ClipPart,
    alive: BoolArray,
    votes: SparseVotes | None,
    moved: bool,
    changes: dict[int, dict[str, Any]],
) -> tuple[ClipPart, SparseVotes]:
    """Return clips and their votes after learning, and add the changed values of their rows to ``changes``."""
    if votes is not None:
        return part, votes
    votes = count_part(stored, part, number_meanings(stored.categories))
    guessed = guess_categories(part, votes, stored.categories)
    for row in np.flatnonzero(alive & ((guessed.predicted != part.predicted) | moved)).tolist():
        values: dict[str, Any] = {"predicted_category": guessed.names[guessed.predicted[row]]}
        if moved:
            values["leaves"] = pack(part.leaves(slice(row, row + 1))[0], "<i4")
        changes[int(part.ids[row])] = values
    return guessed, votes


def _find_again(part: ClipPart, alive: BoolArray, changed: BoolArray) -> IndexArray:
    """Return the rows of clips in changed leaves (L,)."""
    hits = np.empty(len(part), np.bool_)
    find_marked(part.codes, part.offsets, np.where(alive, 0, -1), changed[part.table], hits)
    return np.flatnonzero(hits)


def keep_learned(database: Database, stored: StoredForest, learned: LearnedRows) -> None:
    """Write the index file of a large library after a forest has learned."""
    if learned.source is None or sum(int(own.sum()) for own in learned.list_alive()) < FEWEST_CLIPS:
        return
    with database.reading() as connection:
        place = find_place(connection, database.where)
    n_later = sum(int(own.sum()) for own in learned.list_alive()[1:])
    few = n_later <= _MOST_AGAIN * len(learned.parts[0])
    write_side_file(place, stored, learned, learned.base if few else None)
