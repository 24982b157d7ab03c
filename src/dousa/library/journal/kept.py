"""Removed clips that are kept for an undo: put away before they are removed, and brought back as they were.

Kept are the rows that nobody can compute again, and those that are small: labels and numbers, positions, the place in a
take, tables of labels, tags, words, poses, and the leaves, which hold while the forest is the same. Features are
computed again when they are needed, windows of takes at once.
"""

from __future__ import annotations

import base64
from collections.abc import Sequence
from typing import Any

import sqlalchemy as sa
from sqlalchemy import exc

from dousa.library import schema
from dousa.library.features import lacks, load_features
from dousa.library.forests import ask_trees, load_forest, save_answers
from dousa.library.seals.checksums import POSITIONS, REMOVED, damaged, seal_rows
from dousa.library.selection import fetch_in, portions

# In this order they are brought back: a segment after the clip that it is.
_TABLES = (
    schema.clips, schema.segments, schema.take_annotations, schema.clip_tags, schema.clip_relations, schema.clip_poses,
    schema.clip_leaves,
)  # fmt: skip
_COPIED = ("positions", "block_checksums", *schema.PLACE)  # blocks in fragments stay where they are
_BYTES = "base64"
_STAMP = "forest"


def put_away(connection: sa.Connection, ids: Sequence[int], change: int) -> None:
    """Keep clips and takes, with their segments among these numbers, that are about to be removed.

    Damaged rows that cannot be read are not kept: such a clip cannot be brought back.
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
        key = next(iter(table.primary_key))
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
    connection.execute(sa.insert(schema.removed_clips), seal_rows(schema.removed_clips, rows))
    copied = sa.select(positions.c.clip_id, *(positions.c[name] for name in _COPIED))
    copied = copied.where(positions.c.clip_id.in_(list(kept)))
    connection.execute(sa.insert(table).from_select(["number", *_COPIED], copied))


def list_kept(connection: sa.Connection, ids: Sequence[int], change: int) -> dict[int, dict[str, Any]]:
    """What is kept of clips for a change, by number; LibraryDamagedError where it is not as it was written."""
    table = schema.removed_clips.c
    found = {}
    for row in fetch_in(connection, sa.select(*REMOVED.columns).where(table.change == change), table.number, ids):
        REMOVED.check(connection, row)
        found[row.number] = row.kept
    return found


def list_kept_paths(connection: sa.Connection) -> list[str]:
    """Paths of all removed clips that are kept."""
    path = schema.removed_clips.c.kept[schema.clips.name]["path"].as_string()
    return [str(found) for found in connection.execute(sa.select(path)).scalars()]


def bring_back(connection: sa.Connection, where: str, kept: dict[int, dict[str, Any]]) -> None:
    """Put removed clips back as they were, with what the present forest says of them.

    Parameters
    ----------
    where : name of the library, for messages.
    kept : as ``list_kept`` has it.

    Raises
    ------
    LibraryDamagedError : the positions of one are gone.
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
        connection.execute(sa.delete(schema.removed_clips).where(schema.removed_clips.c.number.in_(ids)))
    _ask_forest(connection, where, [number for number in kept if kept[number][_STAMP] != stamp])


def _ask_forest(connection: sa.Connection, where: str, ids: Sequence[int]) -> None:
    """The leaves of clips in a forest that has learned since they were removed; takes have none."""
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
