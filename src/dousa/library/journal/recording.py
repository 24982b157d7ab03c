"""Writing a change down while it is made: what its clips were before, and what they are afterwards.

``changes`` of a row of the journal, as JSON:

- ``labels`` is a list of [column, before, after, numbers], of ``category``, ``performer`` and ``tags``;
- ``gone`` and ``new`` are the numbers of the clips that are no longer there, and that were not there before;
- ``annotations`` is a list of [take, row of ``take_annotations`` before, and after], null for none.

Numbers are written as ``pack_ids`` does. Which columns a person can change is in ``read_marks``.
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

from dousa.library import schema
from dousa.library.journal.entries import forget_undone, keep_within_bounds, pack_ids, read_row, unpack_ids
from dousa.library.journal.kept import put_away
from dousa.library.seals.checksums import JOURNAL, seal_rows, update_rows
from dousa.library.selection import fetch_in, with_segments

Marks = dict[int, dict[str, Any]]
"""By number: category, performer and tags of clips."""


@dataclass(slots=True)
class Recorded:
    """A change that is being written down.

    Parameters
    ----------
    number : of the change; None where nothing changed.
    """

    number: int | None = None


@dataclass(slots=True)
class _Together(Recorded):
    """Several steps that are one change.

    Parameters
    ----------
    engine : of the library.
    kind, told : of the change; those of the first step where there are none.
    """

    engine: sa.Engine | None = None
    kind: str | None = None
    told: dict[str, Any] = field(default_factory=dict)


_TOGETHER: ContextVar[_Together | None] = ContextVar("together", default=None)


@contextmanager
def recording_together(engine: sa.Engine, kind: str | None, told: dict[str, Any]) -> Iterator[Recorded]:
    """What this thread records of a library inside the block is one change, even in several transactions.

    Parameters
    ----------
    engine : of the library.
    kind, told : as in `recording`, of the whole.
    """
    together = _Together(engine=engine, kind=kind, told=told)
    token = _TOGETHER.set(together)
    try:
        yield together
    finally:
        _TOGETHER.reset(token)


@dataclass(slots=True)
class Changes:
    """What a change did, as it is kept.

    Parameters
    ----------
    labels : (column, before, after, numbers).
    gone, new : numbers.
    annotations : (take, before, after).
    """

    labels: list[tuple[str, Any, Any, list[int]]] = field(default_factory=list)
    gone: list[int] = field(default_factory=list)
    new: list[int] = field(default_factory=list)
    annotations: list[tuple[int, Any, Any]] = field(default_factory=list)

    @classmethod
    def from_json(cls, values: dict[str, Any]) -> Changes:
        """From what ``to_json`` wrote."""
        return cls(
            [(name, before, after, unpack_ids(spans)) for name, before, after, spans in values["labels"]],
            unpack_ids(values["gone"]),
            unpack_ids(values["new"]),
            [(take, before, after) for take, before, after in values["annotations"]],
        )

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return {
            "labels": [[name, before, after, pack_ids(ids)] for name, before, after, ids in self.labels],
            "gone": pack_ids(self.gone),
            "new": pack_ids(self.new),
            "annotations": [list(one) for one in self.annotations],
        }

    @property
    def clips(self) -> set[int]:
        """Numbers of all clips and takes that it concerns."""
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
    told: dict[str, Any] | None = None,
    into: int | None = None,
) -> Iterator[Recorded]:
    """Write down what is changed inside the block, after ``next_revision`` in the same transaction.

    Parameters
    ----------
    revision : of the library in this transaction.
    kind : see ``JournalEntry``.
    marked : clips whose labels or tags may change.
    gone : clips that are going to be removed; they are put away, with the segments of the takes among them.
    takes : whose tables of labels may change.
    told : values of the message that tells it.
    into : number of a change that goes on; another one is begun where it is not there any more.
    """
    together = _TOGETHER.get()
    if together is not None and together.engine is not connection.engine:
        together = None
    if together is not None:
        into = together.number if into is None else into
        kind, told = (kind, told) if together.kind is None else (together.kind, together.told)
    known = None if into is None else read_row(connection, into)
    if known is not None and known.undone is not None:
        known = None
    number = revision if known is None else int(known.number)
    forget_undone(connection)
    if known is None:
        _begin(connection, number, kind, told or {})
    leaving = with_segments(connection, gone) if gone else []
    put_away(connection, leaving, number)
    marks, tables = read_marks(connection, marked), read_tables(connection, takes)
    first = _next_number(connection)
    recorded = Recorded()
    yield recorded
    made = Changes(gone=leaving, new=list(range(first, _next_number(connection))))
    made.labels = _compare(marks, read_marks(connection, marked))
    now = read_tables(connection, tables)
    made.annotations = [(take, before, now[take]) for take, before in tables.items() if before != now[take]]
    if made.clips:
        _finish(connection, number, made, known)
        recorded.number = number
    elif known is None:
        connection.execute(sa.delete(schema.journal).where(schema.journal.c.number == number))
    else:
        recorded.number = number
    if together is not None and recorded.number is not None:
        together.number = recorded.number


def _begin(connection: sa.Connection, number: int, kind: str, told: dict[str, Any]) -> None:
    row = {
        "number": number,
        "made_at": datetime.now(UTC).isoformat(timespec="seconds"),
        "kind": kind,
        "n_clips": 0,
        "told": told,
        "changes": Changes().to_json(),
        "undone": None,
    }
    connection.execute(sa.insert(schema.journal), seal_rows(schema.journal, [row]))


def _finish(connection: sa.Connection, number: int, made: Changes, known: Any) -> None:
    # Of files that replace others, each once; of segments that go, without the takes whose tables change with them.
    changes, n_clips = made.to_json(), len(made.new) or len(made.gone) or len(made.clips)
    if known is not None:
        changes = {name: join_spans(known.changes[name], changes[name]) for name in changes}
        n_clips += known.n_clips
    update_rows(connection, JOURNAL, {number: {"n_clips": n_clips, "changes": changes}})
    keep_within_bounds(connection, number)


def join_spans(before: list[Any], more: list[Any]) -> list[Any]:
    """Two lists, whose spans of numbers become one where the second goes on where the first ends."""
    if before and more and len(before[-1]) == 2 and len(more[0]) == 2 and before[-1][1] + 1 == more[0][0]:
        return [*before[:-1], [before[-1][0], more[0][1]], *more[1:]]
    return before + more


def _next_number(connection: sa.Connection) -> int:
    return int(connection.execute(sa.select(schema.library_state.c.next_clip_id)).scalar_one())


def read_marks(connection: sa.Connection, ids: Sequence[int]) -> Marks:
    """What people say of clips: their category, performer and tags."""
    clips, tags = schema.clips.c, schema.clip_tags.c
    query = sa.select(clips.id, clips.category, clips.performer, tags.tags)
    query = query.join(schema.clip_tags, tags.clip_id == clips.id, isouter=True)
    rows = fetch_in(connection, query, clips.id, ids)
    return {r.id: {"category": r.category, "performer": r.performer, "tags": r.tags or []} for r in rows}


def _compare(before: Marks, after: Marks) -> list[tuple[str, Any, Any, list[int]]]:
    """What changed, clips with the same change together."""
    groups: dict[str, tuple[str, Any, Any, list[int]]] = {}
    for number, old in before.items():
        new = after.get(number)
        for name, value in old.items():
            if new is not None and new[name] != value:
                key = json.dumps([name, value, new[name]])
                groups.setdefault(key, (name, value, new[name], []))[3].append(number)
    return list(groups.values())


def read_tables(connection: sa.Connection, takes: Iterable[int]) -> dict[int, dict[str, Any] | None]:
    """The rows of ``take_annotations`` of takes, None of those that have none."""
    table = schema.take_annotations
    names = [column.name for column in table.c if column.name != "checksum"]
    found: dict[int, dict[str, Any] | None] = dict.fromkeys(takes)
    for row in fetch_in(connection, sa.select(*(table.c[name] for name in names)), table.c.take_id, list(found)):
        found[row.take_id] = {name: row._mapping[name] for name in names}
    return found
