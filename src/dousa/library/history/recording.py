"""Recording changes, and undo and redo: both swap the state before a change with the state after it.

A step is all or nothing, and refused if the clips are not as the change left them.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any

import sqlalchemy as sa

from dousa.errors import LibraryError
from dousa.library.history.journal import (
    WRITER,
    JournalEntry,
    bring_back,
    find_next,
    forget_undone,
    keep_within_bounds,
    list_entries,
    list_kept,
    name_writer,
    pack_ids,
    put_away,
    read_row,
    unpack_ids,
)
from dousa.library.store import schema
from dousa.library.store.checksums import JOURNAL, LABELS
from dousa.library.store.engine import Database, next_revision, note_changed_clips
from dousa.library.store.rows import delete_rows, fetch_in, fetch_rows, insert_rows, update_rows
from dousa.library.store.selection import delete_clips, save_tags, with_segments

Marks = dict[int, dict[str, Any]]
"""By number: path, category, performer and tags of clips."""


@dataclass(slots=True)
class Whole:
    """A change in progress, of one transaction or several; ``number`` is None as long as nothing changed.

    ``kind`` and message values as in `recording`; by default those of its first part.
    """

    engine: sa.Engine
    kind: str | None = None
    values: dict[str, Any] = field(default_factory=dict)
    number: int | None = None


_WHOLE: ContextVar[Whole | None] = ContextVar("whole", default=None)


@contextmanager
def recording_together(
    engine: sa.Engine, kind: str | None = None, values: dict[str, Any] | None = None
) -> Iterator[Whole]:
    """Record this thread's changes of a library inside the block as one, or as part of that of a block around it."""
    whole = _WHOLE.get()
    if whole is not None and whole.engine is engine:
        yield whole
        return
    whole = Whole(engine, kind, values or {})
    token = _WHOLE.set(whole)
    try:
        yield whole
    finally:
        _WHOLE.reset(token)


@dataclass(slots=True)
class Changes:
    """A recorded change: labels (column, before, after, numbers), gone and new numbers, tables before and after."""

    labels: list[tuple[str, Any, Any, list[int]]] = field(default_factory=list)
    gone: list[int] = field(default_factory=list)
    new: list[int] = field(default_factory=list)
    annotations: list[tuple[int, Any, Any]] = field(default_factory=list)

    @classmethod
    def from_json(cls, values: dict[str, Any]) -> Changes:
        """Read the result of ``to_json``."""
        return cls(
            [(name, before, after, unpack_ids(spans)) for name, before, after, spans in values["labels"]],
            unpack_ids(values["gone"]),
            unpack_ids(values["new"]),
            [(take, before, after) for take, before, after in values["annotations"]],
        )

    def to_json(self) -> dict[str, Any]:
        """Return plain values."""
        return {
            "labels": [[name, before, after, pack_ids(ids)] for name, before, after, ids in self.labels],
            "gone": pack_ids(self.gone),
            "new": pack_ids(self.new),
            "annotations": [list(one) for one in self.annotations],
        }

    @property
    def clips(self) -> set[int]:
        """Return the numbers of all clips and takes in the change."""
        labelled = {number for *_, ids in self.labels for number in ids}
        return labelled | {*self.gone, *self.new} | {take for take, _, _ in self.annotations}


@contextmanager
def recording(
    connection: sa.Connection,
    revision: int,
    kind: str,
    *,
    marked: Sequence[int] = (),
    gone: Sequence[int] = (),
    takes: Iterable[int] = (),
    values: dict[str, Any] | None = None,
) -> Iterator[None]:
    """Record the changes inside the block, after ``next_revision`` in the same transaction.

    Within `recording_together` they extend that change; a new one is begun if it no longer exists.

    Parameters
    ----------
    revision : of the library in this transaction.
    kind, values : see ``JournalEntry``; values of the change's message.
    marked : clips whose labels or tags may change.
    gone : clips to be removed; they are kept, with the segments of takes among them.
    takes : whose tables of labels may change.
    """
    whole = _WHOLE.get()
    if whole is None or whole.engine is not connection.engine:
        whole = Whole(connection.engine)
    kind, values = (kind, values) if whole.kind is None else (whole.kind, whole.values)
    known = None if whole.number is None else read_row(connection, whole.number)
    if known is not None and known.undone is not None:
        known = None
    number = revision if known is None else int(known.number)
    forget_undone(connection)
    if known is None:
        _begin(connection, number, kind, values or {})
    leaving = with_segments(connection, gone) if gone else []
    put_away(connection, leaving, number)
    marks, tables = read_marks(connection, marked), read_tables(connection, takes)
    first = _next_number(connection)
    yield
    made = Changes(gone=leaving, new=list(range(first, _next_number(connection))))
    made.labels = _compare(marks, read_marks(connection, marked))
    now = read_tables(connection, tables)
    made.annotations = [(take, before, now[take]) for take, before in tables.items() if before != now[take]]
    if made.clips:
        _finish(connection, number, kind, made, known)
        whole.number = number
    elif known is None:
        delete_rows(connection, schema.journal, [number])


def _begin(connection: sa.Connection, number: int, kind: str, values: dict[str, Any]) -> None:
    row = {
        "number": number,
        "made_at": datetime.now(UTC).isoformat(timespec="seconds"),
        "kind": kind,
        "n_clips": 0,
        schema.journal.c.told.name: {**values, WRITER: name_writer()},
        "changes": Changes().to_json(),
        "undone": None,
    }
    insert_rows(connection, schema.journal, [row])


def _finish(connection: sa.Connection, number: int, kind: str, made: Changes, known: Any) -> None:
    # Replacing files count once; removed segments count without the takes whose tables change.
    changes, n_clips = made.to_json(), len(made.new) or len(made.gone) or len(made.clips)
    if known is not None:
        changes = {name: join_spans(known.changes[name], changes[name]) for name in changes}
        n_clips += known.n_clips
    if known is not None and (known.kind, kind) != ("move", "add"):  # of files that moved, later ones may be new
        kind = known.kind
    update_rows(connection, JOURNAL, {number: {"kind": kind, "n_clips": n_clips, "changes": changes}})
    keep_within_bounds(connection, number)


def join_spans(before: list[Any], more: list[Any]) -> list[Any]:
    """Join two lists of number spans; the last and first become one if they are adjacent."""
    if before and more and len(before[-1]) == 2 and len(more[0]) == 2 and before[-1][1] + 1 == more[0][0]:
        return [*before[:-1], [before[-1][0], more[0][1]], *more[1:]]
    return before + more


def _next_number(connection: sa.Connection) -> int:
    return int(connection.execute(sa.select(schema.library_state.c.next_clip_id)).scalar_one())


def read_marks(connection: sa.Connection, ids: Sequence[int]) -> Marks:
    """Read the path, category, performer and tags of clips."""
    clips, tags = schema.clips.c, schema.clip_tags.c
    query = sa.select(clips.id, clips.path, clips.category, clips.performer, tags.tags)
    query = query.join(schema.clip_tags, tags.clip_id == clips.id, isouter=True)
    rows = fetch_in(connection, query, clips.id, ids)
    names = ("path", "category", "performer")
    return {row.id: {**{name: getattr(row, name) for name in names}, "tags": row.tags or []} for row in rows}


def _compare(before: Marks, after: Marks) -> list[tuple[str, Any, Any, list[int]]]:
    """Return what changed, grouped by equal change."""
    groups: dict[str, tuple[str, Any, Any, list[int]]] = {}
    for number, old in before.items():
        new = after.get(number)
        for name, value in old.items():
            if new is not None and new[name] != value:
                key = json.dumps([name, value, new[name]])
                groups.setdefault(key, (name, value, new[name], []))[3].append(number)
    return list(groups.values())


def read_tables(connection: sa.Connection, takes: Iterable[int]) -> dict[int, dict[str, Any] | None]:
    """Read the rows of ``take_annotations`` of takes; None for takes without one."""
    table = schema.take_annotations
    names = [column.name for column in table.c if column.name != "checksum"]
    found: dict[int, dict[str, Any] | None] = dict.fromkeys(takes)
    for row in fetch_in(connection, sa.select(*(table.c[name] for name in names)), table.c.take_id, list(found)):
        found[row.take_id] = {name: row._mapping[name] for name in names}
    return found


def step(database: Database, number: int | None, *, redo: bool) -> JournalEntry:
    """Undo or redo a change in one transaction, as ``Library.undo`` and ``Library.redo``."""
    with database.writing() as connection:
        revision = next_revision(connection)
        own, last = find_next(connection, undone=redo)
        wanted = own if number is None else number
        if wanted is None and last is not None:
            entry = list_entries(connection, [last])[0]
            raise LibraryError(
                "journal.of_another", library=database.where, number=last, who=entry.made_by, what=entry.what
            )
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
    """One undo or redo of a change."""

    def __init__(self, connection: sa.Connection, where: str, number: int, changes: Changes, redo: bool) -> None:
        self.connection, self.where, self.number, self.changes = connection, where, number, changes
        self.redo = redo
        leaving, coming = (changes.gone, changes.new) if redo else (changes.new, changes.gone)
        self.leaving, self.coming = leaving, coming

    def run(self) -> None:
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
        """Refuse if later changes of the same clips must be undone first."""
        if self.redo:
            return
        table = schema.journal.c
        later = table.number > self.number, table.undone.is_(None)
        own = self.changes.clips | set(with_segments(self.connection, self.leaving) if self.leaving else ())
        for row in fetch_rows(self.connection, JOURNAL, None, *later, order=table.number):
            if own & Changes.from_json(row.changes).clips:
                entry = list_entries(self.connection, [row.number])[0]
                raise LibraryError(
                    "journal.changed_later", library=self.where, number=self.number, later=row.number, what=entry.what
                )

    def _check_labels(self) -> None:
        there = read_marks(self.connection, sorted({number for *_, ids in self.changes.labels for number in ids}))
        renamed: dict[int, Any] = {}
        for name, before, after, ids in self.changes.labels:
            expected, wanted = (before, after) if self.redo else (after, before)
            self._refuse(number for number in ids if there.get(number, {name: ...})[name] != expected)
            renamed |= dict.fromkeys(ids, wanted) if name == "path" else {}
        taken = self._fetch(schema.clips.c.id, schema.clips.c.path, list(renamed.values()))
        self._refuse(number for number in taken if number not in renamed and number not in self.leaving)

    def _check_tables(self) -> None:
        there = read_tables(self.connection, [take for take, _, _ in self.changes.annotations])
        for take, before, after in self.changes.annotations:
            # Segments come and go with their take.
            if take not in self.leaving and take not in self.coming:
                self._refuse([take] if there[take] != (before if self.redo else after) else [])

    def _check_leaving(self) -> None:
        clips = schema.clips.c
        there = set(self._fetch(clips.id, clips.id, self.leaving))
        self._refuse(number for number in self.leaving if number not in there)
        more = set(with_segments(self.connection, self.leaving) if self.leaving else ()) - set(self.leaving)
        self._refuse(more)  # segments named since

    def _check_coming(self) -> dict[int, dict[str, Any]]:
        """Return the kept data of the clips to restore; refuse if their name, content or take is in use."""
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
        """Raise LibraryError because the clips are not as the change left them."""
        others = sorted(set(numbers))
        if others:
            paths = self._fetch(schema.clips.c.path, schema.clips.c.id, others[:1])
            first = next(iter(paths), f"#{others[0]}")
            raise LibraryError(
                "journal.changed_since", library=self.where, number=self.number, n=len(others), path=first
            )

    def _set_labels(self) -> None:
        labels: dict[int, dict[str, Any]] = {}
        for name, before, after, ids in self.changes.labels:
            value = after if self.redo else before
            if name == "tags":
                save_tags(self.connection, dict.fromkeys(ids, tuple(value)))
            else:
                for number in ids:
                    labels.setdefault(number, {})[name] = value
        update_rows(self.connection, LABELS, labels)

    def _set_tables(self) -> None:
        table = schema.take_annotations
        own = [one for one in self.changes.annotations if one[0] not in self.leaving and one[0] not in self.coming]
        delete_rows(self.connection, table, [take for take, _, _ in own])
        wanted = [after if self.redo else before for _, before, after in own]
        insert_rows(self.connection, table, [row for row in wanted if row is not None])
