"""The journal of changes, and the removed clips kept for undo.

Kept are rows that cannot be computed again, and small ones: labels and numbers, positions, the place in a take, tables
of labels, tags, words, poses, and leaves, which hold while the forest is the same. Features are computed again when
needed, windows of takes at once.
"""

from __future__ import annotations

import base64
import getpass
import os
import socket
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import sqlalchemy as sa
from sqlalchemy import exc

from dousa.library.results import Answer
from dousa.library.store import schema
from dousa.library.store.checksums import JOURNAL, POSITIONS, REMOVED, damaged
from dousa.library.store.features import lacks, load_features
from dousa.library.store.forests import ask_trees, load_forest, save_answers
from dousa.library.store.rows import delete_rows, fetch_in, fetch_rows, insert_rows, portions
from dousa.messages import Message


@dataclass(frozen=True, slots=True)
class JournalEntry(Answer):
    """A change of a library.

    Parameters
    ----------
    number : of the change; later ones have higher numbers.
    made_at : ISO 8601, UTC.
    kind : ``"add"``, ``"move"`` (files that were added again from where they are now), ``"remove"``, ``"relabel"``,
        ``"tag"``, ``"label"`` (tables of labels of takes) or ``"name"`` (a part of a take, by hand).
    n_clips : number of clips and takes.
    what : description.
    is_undone : whether it was undone and can be redone.
    kept_bytes : of removed clips that are kept for it.
    made_by : user and machine, as ``name_writer``.
    """

    number: int
    made_at: str
    kind: str
    n_clips: int
    what: Message
    is_undone: bool
    kept_bytes: int
    made_by: str


WRITER = "by"
"""The value of a change that names its writer."""


def name_writer() -> str:
    """Return the user and the machine, such as ``ann@desk``."""
    try:
        user = getpass.getuser()
    except (KeyError, OSError, ImportError):  # a user without a name, as in a container
        user = str(os.getuid()) if hasattr(os, "getuid") else ""
    return f"{user}@{socket.gethostname()}"


def _read_values(row: Any) -> dict[str, Any]:
    """Return the values of the message about a change, and its writer; none of a damaged row."""
    values = row._mapping[schema.journal.c.told]
    return values if isinstance(values, dict) else {}


def read_row(connection: sa.Connection, number: int) -> Any:
    """Read a change, None if there is none of this number; LibraryDamagedError if its checksum is wrong."""
    return next(fetch_rows(connection, JOURNAL, [number]), None)


def find_next(connection: sa.Connection, *, undone: bool) -> tuple[int | None, int | None]:
    """Return the number of the next change of this writer to undo or redo, and that of anybody."""
    table = schema.journal.c
    query = sa.select(*JOURNAL.columns)
    if undone:
        query = query.where(table.undone.is_not(None)).order_by(table.undone.desc(), table.number)
    else:
        query = query.where(table.undone.is_(None)).order_by(table.number.desc())
    rows = [(int(row.number), _read_values(row).get(WRITER)) for row in connection.execute(query)]
    own = (number for number, by in rows if by in (None, name_writer()))
    return next(own, None), next((number for number, _ in rows), None)


def list_entries(connection: sa.Connection, numbers: Sequence[int] | None = None) -> list[JournalEntry]:
    """Return the recorded changes, the last first; all, or those of these numbers."""
    kept = schema.removed_clips.c
    sizes = {
        row[0]: row[1]
        for row in connection.execute(sa.select(kept.change, sa.func.sum(kept.size)).group_by(kept.change))
    }
    entries = []
    for row in fetch_rows(connection, JOURNAL, numbers, order=schema.journal.c.number.desc()):
        what = describe(row.kind, row.n_clips, _read_values(row))
        size = int(sizes.get(row.number, 0))
        writer, undone = _read_values(row).get(WRITER, ""), row.undone is not None
        entries.append(JournalEntry(row.number, row.made_at, row.kind, row.n_clips, what, undone, size, writer))
    return entries


def describe(kind: str, n: int, values: dict[str, Any]) -> Message:
    """Describe a change of n clips in words.

    ``values`` has ``category`` and ``performer`` of a relabelling, changed ``tags`` as ``["+a", "-b"]``, or the
    ``category`` of a named part.
    """
    if kind == "relabel":
        return _describe_labels(n, values)
    if kind == "tag":
        return Message("journal.tagged", n=n, tags=tuple(values.get("tags", ())))
    if kind == "name":
        return Message("journal.named", category=values.get("category", "?"))
    simple: dict[str, Callable[[int], Message]] = {
        "add": lambda n: Message("journal.added", n=n),
        "move": lambda n: Message("journal.moved", n=n),
        "remove": lambda n: Message("journal.removed", n=n),
        "label": lambda n: Message("journal.labelled", n=n),
    }
    return simple[kind](n) if kind in simple else Message("journal.other", n=n)


def _describe_labels(n: int, values: dict[str, Any]) -> Message:
    if "category" in values and "performer" in values:
        return Message("journal.both_labels", n=n)
    if "performer" in values:
        performer = values["performer"]
        return Message("journal.no_performer" if performer is None else "journal.performer", n=n, performer=performer)
    category = values.get("category")
    return Message("journal.no_category" if category is None else "journal.category", n=n, category=category)


def measure_kept(connection: sa.Connection) -> int:
    """Return the bytes of the removed clips that are kept."""
    return int(connection.execute(sa.select(sa.func.sum(schema.removed_clips.c.size))).scalar() or 0)


def forget_undone(connection: sa.Connection) -> None:
    """Delete undone changes, which can then not be redone."""
    connection.execute(sa.delete(schema.journal).where(schema.journal.c.undone.is_not(None)))


def forget_kept(connection: sa.Connection) -> int:
    """Delete all kept clips, and the changes that cannot be undone without them; return the bytes."""
    size = measure_kept(connection)
    forget_undone(connection)
    last = connection.execute(sa.select(sa.func.max(schema.removed_clips.c.change))).scalar()
    if last is not None:
        connection.execute(sa.delete(schema.journal).where(schema.journal.c.number <= last))
    return size


def keep_within_bounds(connection: sa.Connection, newest: int, *, most: int = 1000, most_bytes: int = 1 << 30) -> None:
    """Delete the oldest changes if there are over ``most``, or if they keep more bytes of removed clips.

    The newest one is never deleted.
    """
    table, kept = schema.journal.c, schema.removed_clips.c
    numbers = list(connection.execute(sa.select(table.number).order_by(table.number.desc())).scalars())
    bound = numbers[most] if len(numbers) > most else 0
    query = sa.select(kept.change, sa.func.sum(kept.size)).group_by(kept.change).order_by(kept.change.desc())
    total = 0
    for number, size in connection.execute(query):
        total += int(size)
        if total > most_bytes and number != newest:
            bound = max(bound, number)
            break
    if bound:
        connection.execute(sa.delete(schema.journal).where(table.number <= bound))


def pack_ids(ids: Iterable[int]) -> list[list[int]]:
    """Pack numbers as [[first, last], ...]."""
    spans: list[list[int]] = []
    for number in sorted(set(ids)):
        if spans and spans[-1][1] == number - 1:
            spans[-1][1] = number
        else:
            spans.append([number, number])
    return spans


def unpack_ids(spans: Iterable[Sequence[int]]) -> list[int]:
    """Return the numbers of ``pack_ids``, ascending."""
    return [number for first, last in spans for number in range(first, last + 1)]


# Order of restoring: a segment after its clip.
_TABLES = (
    schema.clips, schema.segments, schema.take_annotations, schema.clip_tags, schema.clip_relations, schema.clip_poses,
    schema.clip_leaves,
)  # fmt: skip
_COPIED = ("positions", "block_checksums", *schema.PLACE)  # blocks in fragments stay in place
_BYTES = "base64"
_STAMP = "forest"


def put_away(connection: sa.Connection, ids: Sequence[int], change: int) -> None:
    """Keep clips and takes, with their segments among these numbers, before they are removed.

    Clips with unreadable rows are not kept, and cannot be restored.
    """
    for some in portions(ids):
        try:
            kept = _read_rows(connection, some)
        except (exc.SQLAlchemyError, ValueError):
            kept = {}
            for number in some:
                try:
                    kept |= _read_rows(connection, [number])
                except (exc.SQLAlchemyError, ValueError):
                    continue
        _write(connection, kept, change)


def _read_rows(connection: sa.Connection, ids: Sequence[int]) -> dict[int, dict[str, Any]]:
    kept: dict[int, dict[str, Any]] = {}
    for table in _TABLES:
        key = schema.key_of(table)
        for row in connection.execute(sa.select(table).where(key.in_(ids))):
            values = {name: _to_json(value) for name, value in row._mapping.items()}
            kept.setdefault(row._mapping[key.name], {})[table.name] = values
    stamp = _read_stamp(connection)
    return {number: {**rows, _STAMP: stamp} for number, rows in kept.items() if schema.clips.name in rows}


def _read_stamp(connection: sa.Connection) -> list[int]:
    forests = schema.forests.c
    return list(connection.execute(sa.select(forests.revision, forests.learned)).first() or (0, 0))


def _write(connection: sa.Connection, kept: dict[int, dict[str, Any]], change: int) -> None:
    if not kept:
        return
    positions, table = schema.clip_trajectories, schema.removed_positions
    size = sa.func.coalesce(positions.c.n_bytes, sa.func.length(positions.c.positions))
    query = sa.select(positions.c.clip_id, size)
    sizes = {row[0]: row[1] for row in connection.execute(query.where(positions.c.clip_id.in_(list(kept))))}
    rows = [
        {"number": number, "change": change, "size": int(sizes.get(number, 0)), "kept": own}
        for number, own in kept.items()
    ]
    insert_rows(connection, schema.removed_clips, rows)
    copied = sa.select(positions.c.clip_id, *(positions.c[name] for name in _COPIED))
    copied = copied.where(positions.c.clip_id.in_(list(kept)))
    connection.execute(sa.insert(table).from_select(["number", *_COPIED], copied))


def list_kept(connection: sa.Connection, ids: Sequence[int], change: int) -> dict[int, dict[str, Any]]:
    """Read the kept clips of a change, by number; LibraryDamagedError if a checksum is wrong."""
    rows = fetch_rows(connection, REMOVED, ids, schema.removed_clips.c.change == change)
    return {row.number: row.kept for row in rows}


def list_kept_paths(connection: sa.Connection) -> list[str]:
    """Return the paths of all kept clips."""
    path = schema.removed_clips.c.kept[schema.clips.name]["path"].as_string()
    return [str(found) for found in connection.execute(sa.select(path)).scalars()]


def bring_back(connection: sa.Connection, where: str, kept: dict[int, dict[str, Any]]) -> None:
    """Restore removed clips of ``list_kept``, with their leaves in the present forest.

    ``where`` is the library's name in messages. LibraryDamagedError if the positions of one are gone.
    """
    stamp = _read_stamp(connection)
    fresh = [number for number, own in kept.items() if own[_STAMP] == stamp]
    for table in _TABLES:
        some = fresh if table is schema.clip_leaves else list(kept)
        rows = [_from_json(kept[number][table.name]) for number in some if table.name in kept[number]]
        for few in portions(rows):
            connection.execute(sa.insert(table), list(few))
    positions, old = schema.clip_trajectories, schema.removed_positions.c
    own = {number for number, rows in kept.items() if schema.segments.name not in rows}
    lacking = own - {row.number for row in fetch_in(connection, sa.select(old.number), old.number, sorted(own))}
    if lacking:
        raise damaged(connection, POSITIONS, min(lacking))
    for ids in portions(list(kept)):
        query = sa.select(old.number, *(old[name] for name in _COPIED)).where(old.number.in_(ids))
        connection.execute(sa.insert(positions).from_select(["clip_id", *_COPIED], query))
        delete_rows(connection, schema.removed_clips, ids)
    _ask_forest(connection, where, [number for number in kept if kept[number][_STAMP] != stamp])


def _ask_forest(connection: sa.Connection, where: str, ids: Sequence[int]) -> None:
    """Return the leaves of clips in a forest that learned since they were removed; takes have none."""
    stored = load_forest(connection, where) if ids else None
    if stored is None:
        return
    clips = schema.clips.c
    query = sa.select(clips.id, clips.absent).where(clips.kind == schema.CLIP)
    rows = fetch_in(connection, query, clips.id, ids)
    whole = sorted(row.id for row in rows if not lacks(stored.feature_set, row.absent))
    for some in portions(whole):
        save_answers(connection, some, ask_trees(stored, load_features(connection, stored.feature_set, some).features))


def _to_json(value: Any) -> Any:
    return {_BYTES: base64.b64encode(value).decode()} if isinstance(value, bytes) else value


def _from_json(row: dict[str, Any]) -> dict[str, Any]:
    return {
        name: base64.b64decode(value[_BYTES]) if isinstance(value, dict) and _BYTES in value else value
        for name, value in row.items()
    }
