"""Damage of a library: its file structure, checksums of rows, impossible numbers and contradictions."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import sqlalchemy as sa

from dousa.errors import DousaError, LibraryDamagedError, LibraryError
from dousa.library.care.compact import measure_used
from dousa.library.results import Answer
from dousa.library.store import checksums, schema
from dousa.library.store.checksums import SEALS, STATE, Seal, seal_positions
from dousa.library.store.engine import Database
from dousa.library.store.features import load_motions
from dousa.library.store.forests import load_forest
from dousa.library.store.fragments import find_store, look_at_blocks, read_feature_rows
from dousa.library.store.rows import fetch_in
from dousa.library.takes.portions import check_portion
from dousa.library.takes.windows import find_files
from dousa.messages import Count, Message


@dataclass(frozen=True, slots=True)
class Damage(Answer):
    """A damaged part of a library.

    Parameters
    ----------
    what : names the part.
    clip_id, path : of the clip or take; None for the library as a whole.
    remedy : what was done, can be done, or must be done by hand.
    repaired : whether it is whole again.
    """

    what: Message
    clip_id: int | None
    path: str | None
    remedy: Message
    repaired: bool


@dataclass(frozen=True, slots=True)
class CheckReport(Answer):
    """The result of ``Library.check``.

    Parameters
    ----------
    n_clips : clips and takes.
    n_rows : rows compared with their checksums.
    damage : what is, or was, damaged.
    seconds : time it took.
    """

    library: str
    n_clips: int
    n_rows: int
    damage: tuple[Damage, ...]
    seconds: float

    @property
    def is_sound(self) -> bool:
        """Whether all damage is repaired."""
        return all(one.repaired for one in self.damage)

    def to_messages(self) -> Iterator[Message]:
        """Return a line for each damaged part, then a summary."""
        for one in self.damage:
            where = {"what": one.what, "remedy": one.remedy}
            if one.clip_id is None:
                yield Message("library_check.part", **where)
            else:
                yield Message("library_check.of_clip", path=one.path, number=one.clip_id, **where)
        counts = {"clips": self.n_clips, "rows": self.n_rows, "seconds": self.seconds}
        left = sum(not one.repaired for one in self.damage)
        yield (
            Message("library_check.damaged", left=left, **counts) if left else Message("library_check.sound", **counts)
        )

    def to_json(self) -> dict[str, Any]:
        """Return plain values, with messages in the current language."""
        first = {"library": self.library, "sound": self.is_sound}
        return {**first, **Answer.to_json(self), "seconds": round(self.seconds, 3)}


_POSITIONS = (schema.clip_trajectories, schema.removed_positions)
REMOVED_POSITIONS = Message("library_damage.removed_positions")
"""Names positions of a removed clip."""

_WINDOWS = Message("library_damage.windows")
WINDOW_FILE = "library_damage.window_file"
"""Code of a damaged window file; the key is its path."""

_LABELLER = Message("library_damage.labeller")


@dataclass(frozen=True, slots=True)
class Fault:
    """A damaged part: its name, key (None for the whole library), and seal if it is a row with its own checksum."""

    what: Message
    key: Any = None
    seal: Seal | None = None


@dataclass(slots=True)
class Findings:
    """Results of checking a whole library.

    Parameters
    ----------
    faults : the damaged parts, each once.
    n_rows, n_clips : rows checked; clips and takes.
    """

    faults: dict[Fault, None] = field(default_factory=dict)
    n_rows: int = 0
    n_clips: int = 0

    def add(self, fault: Fault) -> None:
        """Add a fault, if it is new."""
        self.faults[fault] = None


def find_damage(database: Database, tell: Count | None = None, *, forests: bool = True, at_once: int = 64) -> Findings:
    """Check everything in a library, ``at_once`` rows in a transaction; more need more memory.

    ``forests`` : whether forests that are as they were written can be used by this dousa.
    """
    findings = Findings()
    report = tell or (lambda done, total: None)
    with _noting(findings), database.reading() as connection:
        for reason in _check_structure(connection):
            findings.add(Fault(Message("library_damage.structure", reason=reason)))
    tables = [*dict.fromkeys(seal.checksum.table for seal in SEALS), *_POSITIONS]
    keys: dict[str, list[Any]] = {}
    for table in tables:
        with _noting(findings), database.reading() as connection:
            keys[table.name] = list(connection.execute(sa.select(schema.key_of(table))).scalars())
    total, done = sum(map(len, keys.values())), 0
    for table in tables:
        own = keys.get(table.name, [])
        for start in range(0, len(own), at_once):
            report(done, total)
            some = own[start : start + at_once]
            with _noting(findings), database.reading() as connection:
                _check_rows(connection, table, some, findings)
            done += len(some)
    findings.n_rows, findings.n_clips = total, len(keys.get(schema.clips.name, []))
    with _noting(findings), database.reading() as connection:
        _check_fragments(connection, findings)
    with _noting(findings), database.reading() as connection:
        _check_state(connection, findings)
        if forests:
            _check_forest(connection, database.where, findings)
    with _noting(findings), database.reading() as connection:
        for file in find_files(connection, database.where):
            if not check_portion(file):
                findings.add(Fault(Message(WINDOW_FILE, file=file.name), str(file)))
    report(total, total)
    return findings


@contextmanager
def _noting(findings: Findings) -> Iterator[None]:
    """Record a failure to read as a fault of the structure."""
    try:
        yield
    except LibraryDamagedError as error:
        findings.add(Fault(Message("library_damage.structure", reason=error)))


def _check_structure(connection: sa.Connection, *, most: int = 20) -> Iterator[str]:
    """Check the columns of all tables and, in SQLite, the integrity of the file; yield the faults, ``most`` a kind."""
    inspector = sa.inspect(connection)
    for table in schema.metadata.sorted_tables:
        there = {column["name"] for column in inspector.get_columns(table.name)}
        lacking = sorted(column.name for column in table.c if column.name not in there)
        if lacking:
            yield f"{table.name}: {', '.join(lacking)}"
    if connection.dialect.name != "sqlite":
        return
    for said in connection.exec_driver_sql(f"PRAGMA integrity_check({most})").scalars():
        if said != "ok":
            yield from (line for line in str(said).splitlines() if line and not line.startswith("***"))
    for row in connection.exec_driver_sql("PRAGMA foreign_key_check").all()[:most]:
        yield f"{row[0]} {row[1]}"


def _check_rows(connection: sa.Connection, table: sa.Table, keys: Sequence[Any], findings: Findings) -> None:
    if table in _POSITIONS:
        check = _check_positions if table is schema.clip_trajectories else _check_removed_positions
        for number in keys:
            check(connection, number, findings)
        return
    for seal in SEALS:
        if seal.checksum.table is not table:
            continue
        rows: list[Any] = (
            read_feature_rows(connection, keys, look_at_blocks)
            if seal is checksums.FEATURES
            else list(fetch_in(connection, sa.select(*seal.columns), seal.covered[0], keys))
        )
        for row in rows:
            if not seal.is_whole(row):
                findings.add(Fault(seal.what, row[0], seal))
        for number in set(keys) - {row[0] for row in rows}:  # in an index but not in the table
            findings.add(Fault(seal.what, number, seal))


def _check_positions(connection: sa.Connection, number: int, findings: Findings) -> None:
    table = schema.clip_trajectories
    row = connection.execute(sa.select(table).where(table.c.clip_id == number)).first()
    n_frames = connection.execute(sa.select(schema.clips.c.n_frames).where(schema.clips.c.id == number)).scalar()
    data = b"" if row is None else look_at_blocks(connection, [row], "positions")[0]
    if row is None or n_frames is None or not are_positions(number, data, row.block_checksums, n_frames):
        findings.add(Fault(checksums.POSITIONS, number))
        return
    known = {(fault.seal, fault.key) for fault in findings.faults}
    if not known & {(seal, number) for seal in (checksums.LABELS, checksums.NUMBERS)}:
        try:
            next(load_motions(connection, [number]))
        except LibraryDamagedError:
            findings.add(Fault(checksums.POSITIONS, number))


def _check_removed_positions(connection: sa.Connection, number: int, findings: Findings) -> None:
    table = schema.removed_positions
    row = connection.execute(sa.select(table).where(table.c.number == number)).first()
    data = b"" if row is None else look_at_blocks(connection, [row], "positions")[0]
    n_frames = len(data) // schema.FRAME_BYTES
    if row is None or not n_frames or not are_positions(number, data, row.block_checksums, n_frames):
        findings.add(Fault(REMOVED_POSITIONS, number))


def _check_fragments(connection: sa.Connection, findings: Findings) -> None:
    used = measure_used(connection)
    store = find_store(connection) if used else None
    if used and store is None:
        findings.add(Fault(checksums.STORE.what, 1, checksums.STORE))
    elif store is not None:
        there = store.sizes()
        for name in sorted(used.keys() - there.keys()):
            findings.add(Fault(Message("library_damage.fragment", fragment=name, where=store.where)))


def are_positions(number: int, data: bytes, sums: bytes | None, n_frames: int) -> bool:
    """Return whether positions have the right length and checksums."""
    return len(data) == n_frames * schema.FRAME_BYTES and seal_positions(number, data) == sums


def _check_state(connection: sa.Connection, findings: Findings) -> None:
    clips, segments, stored = schema.clips.c, schema.segments.c, schema.clip_trajectories.c
    state = connection.execute(sa.select(*STATE.columns)).one_or_none()
    highest = connection.execute(sa.select(sa.func.max(clips.id))).scalar() or 0
    learned = connection.execute(sa.select(sa.func.max(schema.forests.c.learned))).scalar() or 0
    if state is None or not (highest < state.next_clip_id and learned <= state.revision):
        findings.add(Fault(STATE.what, 1, STATE))
    query = sa.select(clips.id).join(schema.segments, segments.clip_id == clips.id, isouter=True)
    query = query.join(schema.clip_trajectories, stored.clip_id == clips.id, isouter=True)
    for number in connection.execute(query.where(segments.clip_id.is_(None), stored.clip_id.is_(None))).scalars():
        findings.add(Fault(checksums.POSITIONS, number))


def _check_forest(connection: sa.Connection, where: str, findings: Findings) -> None:
    """Check that the forest, its leaves, the windows of takes and the labeller can be used."""
    from dousa.retrieval import MotionForest
    from dousa.retrieval.forest.calibration import Calibration
    from dousa.retrieval.takes.label import TakeLabeller
    from dousa.retrieval.takes.windows import TakeWindows

    table, windows = schema.forests.c, schema.take_windows.c
    try:
        load_forest(connection, where)
    except LibraryError:
        findings.add(Fault(checksums.FOREST.what, 1, checksums.FOREST))
    asked = connection.execute(sa.select(schema.clip_leaves.c.clip_id).limit(1)).first()
    if asked is not None and connection.execute(sa.select(table.id)).first() is None:
        findings.add(Fault(checksums.FOREST.what, 1, checksums.FOREST))  # the forest is missing
    labeller = connection.execute(sa.select(table.labeller)).scalar()
    if labeller is not None and not _is_readable(TakeLabeller.from_bytes, labeller):
        findings.add(Fault(_LABELLER, 1))
    for number in connection.execute(sa.select(windows.clip_id)).scalars().all():
        data = connection.execute(sa.select(windows.data).where(windows.clip_id == number)).scalar()
        if data is None or not _is_readable(TakeWindows.from_bytes, data):
            findings.add(Fault(_WINDOWS, number))
    for row in connection.execute(sa.select(schema.part_forests)).all():
        readers = (MotionForest.from_bytes, row.forest), (Calibration.from_bytes, row.calibration)
        both = (*readers, (TakeLabeller.from_bytes, row.labeller))
        if not all(data is None or _is_readable(read, data) for read, data in both):
            findings.add(Fault(checksums.PART_FORESTS.what, row.feature_set, checksums.PART_FORESTS))


def _is_readable(read: Callable[[bytes], Any], data: bytes) -> bool:
    try:
        read(data)
    except DousaError:
        return False
    return True
