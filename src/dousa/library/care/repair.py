"""Checking and repairing a library: values are computed again, or read again from files.

If the structure of the file is damaged, its readable rows are copied to a new file.
"""

from __future__ import annotations

import json
import os
import sqlite3
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, suppress
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any
from urllib.parse import quote

import sqlalchemy as sa

from dousa.errors import LibraryError
from dousa.formats.motion_files import Elected, ReadOptions, Skipped
from dousa.formats.parts import file_of
from dousa.library.care.damage import (
    REMOVED_POSITIONS,
    WINDOW_FILE,
    CheckReport,
    Damage,
    Fault,
    Findings,
    find_damage,
)
from dousa.library.search.text_store import keep_all_relations
from dousa.library.store import checksums, schema
from dousa.library.store.checksums import seal_positions
from dousa.library.store.engine import Database
from dousa.library.store.exchange import exchange, prepare
from dousa.library.store.features import lacks, load_features, pack_positions, save_descriptions
from dousa.library.store.forests import ask_trees, load_forest, save_answers
from dousa.library.store.fragments import begin_store, put_aside
from dousa.library.store.ingest import ClipRecord, ReadTask, read_clip
from dousa.library.store.opening import open_database
from dousa.library.store.rows import insert_rows, portions
from dousa.library.takes.windows import refresh_windows
from dousa.messages import Message, Progress

# Forests for parts of bodies, examples of leaves and the state are computed again; the undo journal is lost.
_LEFT_OUT = (
    schema.migrations, schema.library_state, schema.part_forests, schema.leaf_examples, *schema.JOURNAL_TABLES,
)  # fmt: skip


def salvage_library(database: Database) -> tuple[dict[int, str], str]:
    """Copy every readable row into a new file, which replaces the old one.

    Returns the names of lost clips, by number, if an index still has them; and the folder with the old one.
    """
    path = Path(os.path.realpath(database.where))  # a link to the library stays one
    with suppress(sqlite3.Error), database.alone() as connection:
        connection.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchall()
    database.engine.dispose()
    name = f"file:{quote(os.fsencode(path.as_posix()))}?mode=ro"
    with prepare(path) as folder:
        fresh = open_database(folder / "new" / path.name, create=True, read_only=False, timeout=5.0)
        try:
            with closing(sqlite3.connect(name, uri=True)) as source:
                saved, lost = _copy(source, fresh)
            with fresh.alone() as connection:
                connection.execute("PRAGMA journal_mode = DELETE").fetchone()  # one file, without a log
        finally:
            fresh.engine.dispose()
        kept = exchange(folder, path, "damaged", stays=(".fragments",))
    assert kept is not None
    return {number: lost[number] for number in sorted(lost.keys() - saved)}, kept


def _copy(source: sqlite3.Connection, fresh: Database) -> tuple[set[int], dict[int, str]]:
    """Copy the rows; return the numbers of the clips saved, and of all clips in an index."""
    known = _read_names(source)
    last = max([_read_next(source), *(number + 1 for number in known)])
    saved: set[int] = set()
    for table in schema.metadata.sorted_tables:
        if table in _LEFT_OUT:
            continue
        keys = range(1, 2) if table is schema.forests else range(1, last)
        for rows in _read_rows(source, table, keys):
            if table is schema.clips:
                saved |= {row["id"] for row in rows}
            owners = [name for name in ("clip_id", "take_id") if name in table.c]
            _insert(fresh, table, [row for row in rows if all(row[name] in saved for name in owners)])
    with fresh.writing() as connection:
        _write_state(connection, last)
    return saved, known


def _write_state(connection: sa.Connection, next_clip_id: int) -> None:
    learned = connection.execute(sa.select(sa.func.max(schema.forests.c.learned))).scalar() or 0
    state = {"id": 1, "revision": learned + 1, "next_clip_id": next_clip_id, "clips_revision": learned + 1}
    connection.execute(sa.delete(schema.library_state))
    insert_rows(connection, schema.library_state, [state])


def _insert(fresh: Database, table: sa.Table, rows: list[dict[str, Any]]) -> None:
    """Write raw values; rows that break a table constraint (two of one name) are left out."""
    names = [column.name for column in table.c]
    statement = f"INSERT OR IGNORE INTO {table.name} ({', '.join(names)}) VALUES ({', '.join('?' * len(names))})"
    with fresh.alone() as connection:
        connection.execute("BEGIN")
        connection.executemany(statement, [tuple(row[name] for name in names) for row in rows])
        connection.execute("COMMIT")


def _read_names(source: sqlite3.Connection) -> dict[int, str]:
    names: dict[int, str] = {}
    with suppress(sqlite3.Error):
        for path, number in source.execute("SELECT path, id FROM clips INDEXED BY sqlite_autoindex_clips_1"):
            names[number] = str(path)
    return names


def _read_next(source: sqlite3.Connection) -> int:
    with suppress(sqlite3.Error):
        rows = source.execute("SELECT max(next_clip_id) FROM library_state").fetchall()
        if rows and isinstance(rows[0][0], int) and schema.is_id(rows[0][0]):
            return int(rows[0][0])
    return 1


def _read_rows(source: sqlite3.Connection, table: sa.Table, keys: range) -> Iterator[list[dict[str, Any]]]:
    names = [column.name for column in table.c]
    key = schema.key_of(table).name
    statement = f"SELECT {', '.join(names)} FROM {table.name} WHERE {key} = ?"
    rows: list[dict[str, Any]] = []
    for number in keys:
        with suppress(sqlite3.Error, UnicodeDecodeError):
            rows += [dict(zip(names, row, strict=True)) for row in source.execute(statement, (number,)).fetchmany(1)]
        if len(rows) >= 64:
            yield rows
            rows = []
    yield rows


_COMPUTED = {
    "library_damage.features": schema.clip_features,
    "library_damage.poses": schema.clip_poses,
    "library_damage.leaves": schema.clip_leaves,
    "library_damage.relations": schema.clip_relations,
    "library_damage.windows": schema.take_windows,
    "library_damage.part_forest": schema.part_forests,
    "library_damage.examples": schema.leaf_examples,
}
"""Parts that follow from positions and forest, and are computed again."""

_FORGOTTEN = ("library_damage.tags", "library_damage.search", "library_damage.journal", "library_damage.removed",
              REMOVED_POSITIONS.code)  # fmt: skip
_FORESEEN = {
    "library_damage.structure": Message("library_check.would_salvage"),
    "library_damage.forest": Message("library_check.retrain"),
    "library_damage.fragment": Message("library_check.would_replace"),
    **dict.fromkeys(_FORGOTTEN, Message("library_check.would_forget")),
}


def check_library(database: Database, repair: bool, progress: Progress | None, salvage: bool = True) -> CheckReport:
    """Check everything, and repair what can be; as ``Library.check``."""
    start = time.perf_counter()
    report = progress or (lambda done, total, what: None)

    def look() -> Findings:
        return find_damage(database, lambda done, total: report(done, total, Message("library_check.checking")))

    findings = look()
    repair = repair and (salvage or not _find_broken(findings))
    damage = _salvage(database, findings) if repair else []
    if damage:
        findings = look()
    outcomes = {fault: _foresee(database, fault) for fault in findings.faults}
    left = set(findings.faults)
    if repair and findings.faults:
        report(0, 1, Message("library_check.repairing"))
        for fault in findings.faults:
            outcomes[fault] = _repair(database, fault) or outcomes[fault]
        _compute_again(database)
        left = set(look().faults)
    with database.reading() as connection:
        names: dict[int, str] = {}
        for fault in findings.faults:
            if (number := _clip_of(fault)) is not None:
                names[number] = _name(connection, number)
    for fault in findings.faults:
        number = _clip_of(fault)
        path = None if number is None else names[number]
        damage.append(Damage(fault.what, number, path, outcomes[fault], repair and fault not in left))
    seconds = time.perf_counter() - start
    return CheckReport(database.where, findings.n_clips, findings.n_rows, tuple(damage), seconds)


def _find_broken(findings: Findings) -> list[Fault]:
    return [fault for fault in findings.faults if fault.what.code == "library_damage.structure"]


def _salvage(database: Database, findings: Findings) -> list[Damage]:
    """Salvage a file whose structure is damaged; empty if it is not."""
    broken = _find_broken(findings)
    if not broken or database.engine.dialect.name != "sqlite":
        return []
    database.check_writable()
    lost, kept = salvage_library(database)
    how = Message("library_check.salvaged", name=os.path.basename(kept))
    damage = [Damage(fault.what, None, None, how, repaired=True) for fault in broken]
    gone, again = Message("library_damage.clip"), Message("library_check.lost_clip")
    return damage + [Damage(gone, number, path, again, repaired=False) for number, path in lost.items()]


def _clip_of(fault: Fault) -> int | None:
    of_clip = fault.key is not None and (fault.seal.is_of_clip if fault.seal else fault.what.code in _OF_CLIPS)
    return int(fault.key) if of_clip else None


_OF_CLIPS = ("library_damage.positions", "library_damage.windows")


def _name(connection: sa.Connection, number: int) -> str:
    path = schema.clips.c.path
    # As bytes, as it may no longer be valid text.
    if connection.dialect.name == "sqlite":
        raw: sa.ColumnElement[bytes] = sa.cast(path, sa.LargeBinary)
    else:
        raw = sa.func.convert_to(path, "UTF8", type_=sa.LargeBinary)
    try:
        name = connection.execute(sa.select(raw).where(schema.clips.c.id == number)).scalar()
    except (sa.exc.SQLAlchemyError, ValueError):
        return "?"
    return name.decode(errors="backslashreplace") if isinstance(name, bytes) else "?"


def _foresee(database: Database, fault: Fault) -> Message:
    code = fault.what.code
    if code in _FORESEEN:
        return _FORESEEN[code]
    if code in _COMPUTED or code in ("library_damage.labeller", "library_damage.state", WINDOW_FILE):
        return Message("library_check.would_compute")
    if code == "library_damage.positions":
        return _look_at_file(database, fault.key)[0]
    return Message("library_check.lost_labels" if code == "library_damage.annotation" else "library_check.lost")


def _repair(database: Database, fault: Fault) -> Message | None:
    """Repair one fault; return how, or None if it cannot be repaired."""
    code = fault.what.code
    try:
        if code in _COMPUTED:
            _throw_away(database, _COMPUTED[code], fault.key)
            return Message("library_check.computed")
        if code in _FORGOTTEN:
            seal = fault.seal or checksums.REMOVED
            _throw_away(database, seal.checksum.table, fault.key)
            return Message("library_check.forgotten")
        return _REPAIRED[code](database, fault) if code in _REPAIRED else None
    except LibraryError:
        return None


def _throw_away(database: Database, table: sa.Table, key: Any) -> None:
    with database.writing() as connection:
        if table is schema.clip_leaves:
            load_forest(connection, database.where)  # first make sure that leaves can be computed again
        connection.execute(sa.delete(table).where(schema.key_of(table) == key))
        if table is schema.clip_features:
            connection.execute(sa.delete(schema.clip_poses).where(schema.clip_poses.c.clip_id == key))


def _begin_store(database: Database, fault: Fault) -> Message | None:
    if database.engine.dialect.name != "sqlite":
        return None
    with database.writing() as connection:
        begin_store(connection, "")  # the only possible place
    return Message("library_check.computed")


def _delete_file(database: Database, fault: Fault) -> Message:
    with suppress(OSError):
        os.unlink(fault.key)
    return Message("library_check.deleted")


def _delete_labeller(database: Database, fault: Fault) -> Message:
    with database.writing() as connection:
        connection.execute(sa.update(schema.forests).values(labeller=None))
    return Message("library_check.deleted")


def _count_again(database: Database, fault: Fault) -> Message:
    """Recompute the counters of clips and writes; the forest no longer counts as current."""
    with database.writing() as connection:
        highest = connection.execute(sa.select(sa.func.max(schema.clips.c.id))).scalar() or 0
        _write_state(connection, highest + 1)
    return Message("library_check.computed")


def _look_at_file(database: Database, number: int) -> tuple[Message, ClipRecord | None]:
    """Return a message about the file of a clip, and its record if the content is unchanged."""
    clips = schema.clips.c
    columns = (clips.path, clips.content_hash, clips.read_options, clips.kind, clips.format)
    try:
        with database.reading() as connection:
            row = connection.execute(sa.select(*columns).where(clips.id == number)).one()
            table = schema.clip_trajectories.c
            sums = connection.execute(sa.select(table.block_checksums).where(table.clip_id == number)).scalar()
        options = ReadOptions(**(json.loads(row.read_options) if row.read_options else {}))
    except (LibraryError, ValueError, TypeError):
        return Message("library_check.lost"), None
    if row.format == "memory":
        return Message("library_check.no_file"), None
    if not os.path.exists(file_of(row.path)):
        return Message("library_check.file_gone"), None
    return _read_file(ReadTask(row.path, options, kind=row.kind), row.content_hash, number, sums)


def _read_file(task: ReadTask, content: str, number: int, sums: bytes | None) -> tuple[Message, ClipRecord | None]:
    # Up axis, unit and markers may have been elected by other files of the folder: the checksum identifies them.
    for markers, up, unit in product((None, False, True), (None, "y", "z"), (None, 1.0, 0.01, 0.001)):
        record = read_clip(replace(task, voted=Elected(up, unit, markers, is_person=True)))
        if isinstance(record, Skipped):
            return Message("library_check.file_unusable", problem=record.reason), None
        if not isinstance(record, ClipRecord) or record.row["content_hash"] != content:
            break
        if sums is None or seal_positions(number, pack_positions(record.motion)) == sums:
            return Message("library_check.would_read"), record
        if record.claim is None or not record.claim.doubtful:
            break
    return Message("library_check.file_changed"), None


def _restore_positions(database: Database, fault: Fault) -> Message | None:
    """Read positions again from the file."""
    table, number = schema.clip_trajectories, fault.key
    _, record = _look_at_file(database, number)
    if record is None:
        return None
    data = pack_positions(record.motion)
    with database.writing() as connection:
        n_frames = connection.execute(sa.select(schema.clips.c.n_frames).where(schema.clips.c.id == number)).scalar()
        if n_frames is None or len(data) != n_frames * schema.FRAME_BYTES:
            return None
        values = {"clip_id": number, "positions": data, "block_checksums": seal_positions(number, data)}
        connection.execute(sa.delete(table).where(table.c.clip_id == number))
        connection.execute(sa.insert(table), put_aside(connection, [values], "positions"))
    return Message("library_check.read_again")


def _read_numbers(database: Database, fault: Fault) -> Message | None:
    """Read the numbers of a clip again from its file, if its positions are the same."""
    number = fault.key
    _, record = _look_at_file(database, number)
    if record is None:
        return None
    with database.writing() as connection:
        clips = schema.clips
        names = [column.name for column in checksums.NUMBERS.covered[1:] if column.name in record.row]
        values = {name: record.row[name] for name in names}
        added = connection.execute(sa.select(clips.c.added_at).where(clips.c.id == number)).scalar_one()
        whole = {**values, "id": number, "added_at": added}
        sealed = checksums.NUMBERS.compute([whole[column.name] for column in checksums.NUMBERS.covered])
        connection.execute(sa.update(clips).where(clips.c.id == number).values(**values, checksum=sealed))
    return Message("library_check.read_again")


_REPAIRED: dict[str, Callable[[Database, Fault], Message | None]] = {
    "library_damage.positions": _restore_positions,
    "library_damage.numbers": _read_numbers,
    "library_damage.state": _count_again,
    "library_damage.store": _begin_store,
    "library_damage.labeller": _delete_labeller,
    "library_damage.fragment": lambda database, fault: Message(
        "library_check.replaced"
    ),  # verified by the second check
    WINDOW_FILE: _delete_file,
}


def _compute_again(database: Database) -> None:
    with suppress(LibraryError):
        keep_all_relations(database)
        with database.reading() as connection:
            stored = load_forest(connection, database.where)
        if stored is None:
            return
        clips, poses, leaves = schema.clips.c, schema.clip_poses.c, schema.clip_leaves.c
        query = sa.select(clips.id).where(clips.kind == schema.CLIP)
        query = query.join(schema.clip_poses, poses.clip_id == clips.id, isouter=True)
        query = query.join(schema.clip_leaves, leaves.clip_id == clips.id, isouter=True)
        query = query.where(sa.or_(poses.clip_id.is_(None), leaves.clip_id.is_(None)))
        with database.reading() as connection:
            lacking = list(connection.execute(query).scalars())
        for some in portions(lacking):
            with database.writing() as connection:
                own = _lack_nothing(connection, stored.feature_set, some)
                known = load_features(connection, stored.feature_set, own)
                save_descriptions(connection, list(known.computed), list(known.computed.values()))
                there = set(connection.execute(sa.select(leaves.clip_id).where(leaves.clip_id.in_(own))).scalars())
                places = [place for place, number in enumerate(own) if number not in there]
                save_answers(connection, [own[p] for p in places], ask_trees(stored, known.features[places]))
        refresh_windows(database, stored, None)


def _lack_nothing(connection: sa.Connection, feature_set: str, ids: Sequence[int]) -> list[int]:
    query = sa.select(schema.clips.c.id, schema.clips.c.absent).where(schema.clips.c.id.in_(ids))
    return [row.id for row in connection.execute(query) if not lacks(feature_set, row.absent)]
