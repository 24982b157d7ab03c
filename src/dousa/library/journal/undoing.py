"""Undoing a change, and doing it again: both put what was, or what became, in the place of the other.

Nothing is done by halves, and nothing is done where the clips are not as the change left them.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import sqlalchemy as sa

from dousa.errors import LibraryError
from dousa.library import schema
from dousa.library.engine import Database, next_revision, note_changed_clips
from dousa.library.journal.entries import JournalEntry, find_next, list_entries, read_row
from dousa.library.journal.kept import bring_back, list_kept, put_away
from dousa.library.journal.recording import Changes, read_marks, read_tables
from dousa.library.seals.checksums import JOURNAL, LABELS, seal_rows, update_rows
from dousa.library.selection import delete_clips, fetch_in, save_tags, with_segments


def step(database: Database, number: int | None, *, redo: bool) -> JournalEntry:
    """Undo a change, or do it again, in one transaction; as ``Library.undo`` and ``Library.redo``."""
    with database.writing() as connection:
        revision = next_revision(connection)
        wanted = find_next(connection, undone=redo) if number is None else number
        row = None if wanted is None else read_row(connection, wanted)
        if row is None or (row.undone is not None) != redo:
            raise _no_such(database.where, number, row, redo)
        changes = Changes.from_json(row.changes)
        _Step(connection, database.where, row.number, changes, redo).run()
        update_rows(connection, JOURNAL, {row.number: {"undone": None if redo else revision}})
        return list_entries(connection, [row.number])[0]


def _no_such(where: str, number: int | None, row: Any, redo: bool) -> LibraryError:
    if number is None:
        code = "journal.nothing_to_redo" if redo else "journal.nothing_to_undo"
        return LibraryError(code, library=where)
    if row is None:
        return LibraryError("journal.no_change", library=where, number=number)
    return LibraryError("journal.in_force" if redo else "journal.undone_already", library=where, number=number)


class _Step:
    """One step back or forth.

    Parameters
    ----------
    number, changes : of the change.
    redo : forth.
    """

    def __init__(self, connection: sa.Connection, where: str, number: int, changes: Changes, redo: bool) -> None:
        self.connection, self.where, self.number, self.changes = connection, where, number, changes
        self.redo = redo
        leaving, coming = (changes.gone, changes.new) if redo else (changes.new, changes.gone)
        self.leaving, self.coming = leaving, coming

    def run(self) -> None:
        """Check everything, then change everything."""
        self._check_later()
        self._check_labels()
        self._check_tables()
        self._check_leaving()
        kept = self._check_coming()
        if self.leaving or self.coming or any(name == "category" for name, *_ in self.changes.labels):
            note_changed_clips(self.connection)
        put_away(self.connection, self.leaving, self.number)
        delete_clips(self.connection, self.leaving)
        bring_back(self.connection, self.where, kept)
        self._set_labels()
        self._set_tables()

    def _check_later(self) -> None:
        """Later changes of the same clips come first."""
        if self.redo:
            return
        table = schema.journal.c
        query = sa.select(*JOURNAL.columns).where(table.number > self.number, table.undone.is_(None))
        own = self.changes.clips | set(with_segments(self.connection, self.leaving) if self.leaving else ())
        for row in self.connection.execute(query.order_by(table.number)).all():
            JOURNAL.check(self.connection, row)
            if own & Changes.from_json(row.changes).clips:
                entry = list_entries(self.connection, [row.number])[0]
                raise LibraryError(
                    "journal.changed_later", library=self.where, number=self.number, later=row.number, what=entry.what
                )

    def _check_labels(self) -> None:
        for name, before, after, ids in self.changes.labels:
            expected = before if self.redo else after
            there = read_marks(self.connection, ids)
            self._refuse(number for number in ids if there.get(number, {name: ...})[name] != expected)

    def _check_tables(self) -> None:
        there = read_tables(self.connection, [take for take, _, _ in self.changes.annotations])
        for take, before, after in self.changes.annotations:
            # Of a take that comes or goes with it, they come and go too.
            if take not in self.leaving and take not in self.coming:
                self._refuse([take] if there[take] != (before if self.redo else after) else [])

    def _check_leaving(self) -> None:
        clips = schema.clips.c
        there = set(self._fetch(clips.id, clips.id, self.leaving))
        self._refuse(number for number in self.leaving if number not in there)
        more = set(with_segments(self.connection, self.leaving) if self.leaving else ()) - set(self.leaving)
        self._refuse(more)  # segments that were named since

    def _check_coming(self) -> dict[int, dict[str, Any]]:
        """What is kept of the clips that come back; a name, content or take that is another's now is refused."""
        kept = list_kept(self.connection, self.coming, self.number)
        if len(kept) < len(self.coming):
            raise LibraryError(
                "journal.not_kept", library=self.where, number=self.number, n=len(self.coming) - len(kept)
            )
        rows = [own[schema.clips.name] for own in kept.values()]
        clips = schema.clips.c
        for column in (clips.path, clips.content_hash):
            taken = self._fetch(clips.id, column, [row[column.name] for row in rows])
            self._refuse(number for number in taken if number not in self.leaving)
        takes = {own[schema.segments.name]["take_id"] for own in kept.values() if schema.segments.name in own}
        there = set(self._fetch(clips.id, clips.id, sorted(takes - kept.keys())))
        self._refuse(takes - kept.keys() - there)
        return kept

    def _fetch(self, column: sa.Column[Any], key: sa.Column[Any], values: Sequence[Any]) -> Iterable[Any]:
        return [row[0] for row in fetch_in(self.connection, sa.select(column), key, values)]

    def _refuse(self, numbers: Iterable[int]) -> None:
        """LibraryError where clips are not as the change left them."""
        others = sorted(set(numbers))
        if others:
            paths = self._fetch(schema.clips.c.path, schema.clips.c.id, others[:1])
            first = next(iter(paths), f"#{others[0]}")
            raise LibraryError(
                "journal.changed_since", library=self.where, number=self.number, n=len(others), path=first
            )

    def _set_labels(self) -> None:
        for name, before, after, ids in self.changes.labels:
            value = after if self.redo else before
            if name == "tags":
                save_tags(self.connection, dict.fromkeys(ids, tuple(value)))
            else:
                update_rows(self.connection, LABELS, {number: {name: value} for number in ids})

    def _set_tables(self) -> None:
        table = schema.take_annotations
        own = [one for one in self.changes.annotations if one[0] not in self.leaving and one[0] not in self.coming]
        if not own:
            return
        connection = self.connection
        connection.execute(sa.delete(table).where(table.c.take_id.in_([take for take, _, _ in own])))
        wanted = [after if self.redo else before for _, before, after in own]
        rows = [row for row in wanted if row is not None]
        if rows:
            connection.execute(sa.insert(table), seal_rows(table, rows))
