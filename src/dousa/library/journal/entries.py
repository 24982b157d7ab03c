"""The changes that are written down: reading them, naming them, and how many are kept."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import sqlalchemy as sa

from dousa.library import schema
from dousa.library.seals.checksums import JOURNAL
from dousa.messages import Message

MOST_CHANGES = 1000
"""That are written down; the oldest are forgotten."""

MOST_KEPT_BYTES = 1 << 30
"""Of removed clips: the oldest changes are forgotten with theirs. Those of the last change are kept in any case."""


@dataclass(frozen=True, slots=True)
class JournalEntry:
    """A change of a library.

    Parameters
    ----------
    number : of the change; later ones have higher numbers.
    made_at : when, ISO 8601, UTC.
    kind : ``"add"``, ``"remove"``, ``"relabel"``, ``"tag"``, ``"label"`` (tables of labels of takes) or ``"name"`` (a
        part of a take, by hand).
    n_clips : clips and takes that it concerns.
    what : tells it.
    is_undone : whether it was undone, and can be done again.
    kept_bytes : of removed clips that are kept for it.
    """

    number: int
    made_at: str
    kind: str
    n_clips: int
    what: Message
    is_undone: bool
    kept_bytes: int

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return {
            "number": self.number,
            "made_at": self.made_at,
            "kind": self.kind,
            "n_clips": self.n_clips,
            "what": str(self.what),
            "is_undone": self.is_undone,
            "kept_bytes": self.kept_bytes,
        }


def read_row(connection: sa.Connection, number: int) -> Any:
    """A row of the table, None if there is no such change; LibraryDamagedError where it is not as it was written."""
    row = connection.execute(sa.select(*JOURNAL.columns).where(schema.journal.c.number == number)).one_or_none()
    if row is not None:
        JOURNAL.check(connection, row)
    return row


def find_next(connection: sa.Connection, *, undone: bool) -> int | None:
    """Number of the change that is undone next, or done again next."""
    table = schema.journal.c
    if undone:
        query = sa.select(table.number).where(table.undone.is_not(None)).order_by(table.undone.desc(), table.number)
    else:
        query = sa.select(table.number).where(table.undone.is_(None)).order_by(table.number.desc())
    number = connection.execute(query.limit(1)).scalar()
    return None if number is None else int(number)


def list_entries(connection: sa.Connection, numbers: Sequence[int] | None = None) -> list[JournalEntry]:
    """The changes that are written down, the last first; all, or those of these numbers."""
    table, kept = schema.journal.c, schema.removed_clips.c
    query = sa.select(*JOURNAL.columns).order_by(table.number.desc())
    if numbers is not None:
        query = query.where(table.number.in_(numbers))
    sizes = {
        row[0]: row[1]
        for row in connection.execute(sa.select(kept.change, sa.func.sum(kept.size)).group_by(kept.change))
    }
    entries = []
    for row in connection.execute(query).all():
        JOURNAL.check(connection, row)
        what = describe(row.kind, row.n_clips, row.told)
        size = int(sizes.get(row.number, 0))
        entries.append(JournalEntry(row.number, row.made_at, row.kind, row.n_clips, what, row.undone is not None, size))
    return entries


def describe(kind: str, n: int, told: dict[str, Any]) -> Message:
    """A change in words.

    Parameters
    ----------
    kind, n : of the change, and clips that it concerns.
    told : ``category`` and ``performer`` of a relabelling, ``tags`` that were given and taken, as ``["+a", "-b"]``, or
        the ``category`` of a part that was named.
    """
    if kind == "relabel":
        return _describe_labels(n, told)
    if kind == "tag":
        return Message("journal.tagged", n=n, tags=tuple(told.get("tags", ())))
    if kind == "name":
        return Message("journal.named", category=told.get("category", "?"))
    simple: dict[str, Callable[[int], Message]] = {
        "add": lambda n: Message("journal.added", n=n),
        "remove": lambda n: Message("journal.removed", n=n),
        "label": lambda n: Message("journal.labelled", n=n),
    }
    return simple[kind](n) if kind in simple else Message("journal.other", n=n)


def _describe_labels(n: int, told: dict[str, Any]) -> Message:
    category, performer = told.get("category"), told.get("performer")
    if "category" in told and "performer" in told:
        return Message("journal.both_labels", n=n)
    if "performer" in told:
        if performer is None:
            return Message("journal.no_performer", n=n)
        return Message("journal.performer", n=n, performer=performer)
    if category is None:
        return Message("journal.no_category", n=n)
    return Message("journal.category", n=n, category=category)


def measure_kept(connection: sa.Connection) -> int:
    """Bytes of the removed clips that are kept."""
    return int(connection.execute(sa.select(sa.func.sum(schema.removed_clips.c.size))).scalar() or 0)


def forget_undone(connection: sa.Connection) -> None:
    """What was undone cannot be done again any more."""
    connection.execute(sa.delete(schema.journal).where(schema.journal.c.undone.is_not(None)))


def forget_kept(connection: sa.Connection) -> int:
    """Forget all removed clips, and the changes that cannot be undone without them; returns the bytes of these."""
    size = measure_kept(connection)
    forget_undone(connection)
    last = connection.execute(sa.select(sa.func.max(schema.removed_clips.c.change))).scalar()
    if last is not None:
        connection.execute(sa.delete(schema.journal).where(schema.journal.c.number <= last))
    return size


def keep_within_bounds(connection: sa.Connection, newest: int) -> None:
    """Forget the oldest changes where there are too many, or where they keep too much."""
    table, kept = schema.journal.c, schema.removed_clips.c
    numbers = list(connection.execute(sa.select(table.number).order_by(table.number.desc())).scalars())
    bound = numbers[MOST_CHANGES] if len(numbers) > MOST_CHANGES else 0
    query = sa.select(kept.change, sa.func.sum(kept.size)).group_by(kept.change).order_by(kept.change.desc())
    total = 0
    for number, size in connection.execute(query):
        total += int(size)
        if total > MOST_KEPT_BYTES and number != newest:
            bound = max(bound, number)
            break
    if bound:
        connection.execute(sa.delete(schema.journal).where(table.number <= bound))


def pack_ids(ids: Iterable[int]) -> list[list[int]]:
    """Numbers as [[first, last], ...]: those of clips that were added together follow each other."""
    spans: list[list[int]] = []
    for number in sorted(set(ids)):
        if spans and spans[-1][1] == number - 1:
            spans[-1][1] = number
        else:
            spans.append([number, number])
    return spans


def unpack_ids(spans: Iterable[Sequence[int]]) -> list[int]:
    """The numbers that ``pack_ids`` wrote, ascending."""
    return [number for first, last in spans for number in range(first, last + 1)]
