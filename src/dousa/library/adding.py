"""Adding files: what is known is left alone, the rest is read at the same time and written in portions.

A portion is one transaction, so a program that is stopped in the middle keeps what it wrote and goes on from
there when it is run again.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any

import numpy as np
import sqlalchemy as sa

from dousa.errors import DousaError
from dousa.library import schema
from dousa.library._arrays import pack
from dousa.library._engine import reading, writing
from dousa.library._forests import StoredForest, ask_trees, load_forest, save_answers
from dousa.library._revision import lock_for_writing, next_revision, take_clip_ids
from dousa.library.ingest import (
    ClipRecord,
    FoundFile,
    KnownContent,
    ReadOptions,
    ReadTask,
    find_motion_files,
    look_at,
    read_clip,
    read_clips,
)
from dousa.library.labels import LabelRule, no_label
from dousa.library.reports import AddReport, Duplicate, Skipped

__all__ = ["AddProgress", "Adding"]

AddProgress = Callable[[int, int, str], None]
"""Called with (files done, files, path of the last one)."""

_PORTION_CLIPS = 64
_PORTION_SECONDS = 1.0

Answer = ClipRecord | KnownContent | Skipped
Labels = dict[str, str | None]


@dataclass(slots=True)
class _Tally:
    """The report while it grows."""

    added: list[str] = field(default_factory=list)
    replaced: list[str] = field(default_factory=list)
    unchanged: list[str] = field(default_factory=list)
    moved: list[Duplicate] = field(default_factory=list)
    duplicates: list[Duplicate] = field(default_factory=list)
    skipped: list[Skipped] = field(default_factory=list)
    warnings: list[tuple[str, str]] = field(default_factory=list)
    other_labels: list[str] = field(default_factory=list)
    bytes: int = 0

    def extend(self, other: _Tally) -> None:
        for name in (
            "added",
            "replaced",
            "unchanged",
            "moved",
            "duplicates",
            "skipped",
            "warnings",
            "other_labels",
        ):
            getattr(self, name).extend(getattr(other, name))
        self.bytes += other.bytes


class Adding:
    """One run of ``Library.add``.

    Parameters
    ----------
    engine, where : the library and its name for messages.
    category_rule, performer_rule : labels of new clips.
    options : what is said about the files.
    known_forest : the forest of the library, if it is loaded.
    """

    def __init__(
        self,
        engine: sa.Engine,
        where: str,
        *,
        category_rule: LabelRule,
        performer_rule: LabelRule,
        options: ReadOptions,
        known_forest: StoredForest | None = None,
    ) -> None:
        self._engine = engine
        self._where = where
        self._rules = {"category": category_rule, "performer": performer_rule}
        self._options = options
        self._option_text = options.describe()
        self.forest = known_forest
        self._found: dict[str, FoundFile] = {}
        self._tally = _Tally()

    def run(self, paths: Sequence[Any], n_jobs: int | None, progress: AddProgress | None) -> AddReport:
        """Add all motion files of these files and folders."""
        start = time.perf_counter()
        files, missing = find_motion_files(paths)
        self._tally.skipped += missing
        self._found = {str(file.path): file for file in files}
        tasks = self._plan()
        report = progress or (lambda done, total, path: None)
        done = len(files) - len(tasks)
        report(done, len(files), "")
        portion: list[Answer] = []
        last = time.monotonic()
        answers = read_clips(tasks, n_jobs)
        try:
            for answer in answers:
                portion.append(answer)
                if len(portion) >= _PORTION_CLIPS or time.monotonic() - last >= _PORTION_SECONDS:
                    portion = self._store_portion(portion)
                    last = time.monotonic()
                done += 1
                report(done, len(files), answer.path)
        except KeyboardInterrupt:
            self._store_portion(portion)
            raise
        finally:
            answers.close()
        self._store_portion(portion)
        return self._report(time.perf_counter() - start)

    def _report(self, seconds: float) -> AddReport:
        tally = self._tally
        return AddReport(
            added=tuple(tally.added),
            replaced=tuple(tally.replaced),
            unchanged=tuple(tally.unchanged),
            moved=tuple(tally.moved),
            duplicates=tuple(tally.duplicates),
            skipped=tuple(tally.skipped),
            warnings=tuple(tally.warnings),
            other_labels=tuple(tally.other_labels),
            seconds=seconds,
            bytes=tally.bytes,
        )

    def _labels(self, path: str) -> Labels:
        file = self._found[path]
        return {name: rule(file.root, file.path) for name, rule in self._rules.items()}

    def _plan(self) -> list[ReadTask]:
        """The files that must be opened; those that did not change since they were stored are tallied."""
        table = schema.clips.c
        columns = (table.path, table.content_hash, table.fingerprint, table.size, table.read_options)
        query = sa.select(*columns, table.category, table.performer)
        with reading(self._engine, self._where) as connection:
            stored: dict[str, Any] = {row.path: row for row in connection.execute(query)}
        hashes: dict[int, list[str]] = {}
        for row in stored.values():
            hashes.setdefault(row.size, []).append(row.content_hash)
        tasks = []
        for path in self._found:
            try:
                state = look_at(path, self._options)
            except (DousaError, OSError):
                tasks.append(ReadTask(path, self._options))  # reading it says what is wrong
                continue
            row = stored.get(path)
            if row and (row.fingerprint, row.read_options) == (state.fingerprint, self._option_text):
                self._tally.unchanged.append(path)
                self._note_labels(self._tally, path, row)
            else:
                tasks.append(ReadTask(path, self._options, tuple(hashes.get(state.size, ()))))
        return tasks

    def _note_labels(self, tally: _Tally, path: str, row: Any) -> None:
        """Whether the rules would label a stored clip otherwise: it keeps its labels, but that is told."""
        labels = self._labels(path)
        if any(value is not None and value != getattr(row, name) for name, value in labels.items()):
            tally.other_labels.append(path)

    def _store_portion(self, portion: list[Answer]) -> list[Answer]:
        """Write a portion in one transaction; returns the empty next one."""
        self._tally.skipped += [answer for answer in portion if isinstance(answer, Skipped)]
        read = [answer for answer in portion if not isinstance(answer, Skipped)]
        if read:
            with writing(self._engine, self._where) as connection:
                lock_for_writing(connection)
                tally = self._store(connection, read)
            self._tally.extend(tally)
        return []

    def _store(self, connection: sa.Connection, read: list[ClipRecord | KnownContent]) -> _Tally:
        tally = _Tally()
        stored = _load_rows(connection, read)
        by_path = {row.path: row for row in stored}
        # Files that hold something else now. All are found before any is stored: two may have changed places.
        now = {answer.path: answer.content_hash for answer in read}
        gone = {row.path: row.id for row in stored if now.get(row.path, row.content_hash) != row.content_hash}
        owner = {row.content_hash: row.path for row in stored if row.path not in gone}
        fresh: list[tuple[ClipRecord, Labels]] = []
        for answer in read:
            tally.bytes += answer.state.size
            row, first = by_path.get(answer.path), owner.get(answer.content_hash)
            if first == answer.path and row is not None:
                self._move(connection, answer, first)
                tally.unchanged.append(first)
                self._note_labels(tally, first, row)
            elif first is None:
                self._take(tally, fresh, answer, row)
                owner[answer.content_hash] = answer.path
            elif row is None and first in by_path and not os.path.exists(first):
                self._move(connection, answer, first)
                tally.moved.append(Duplicate(answer.path, first))
                self._note_labels(tally, answer.path, by_path[first])
                owner[answer.content_hash] = answer.path
            else:
                tally.duplicates.append(Duplicate(answer.path, first))
        _delete(connection, list(gone.values()))
        self._insert(connection, fresh)
        if fresh or gone or tally.moved:
            next_revision(connection)
        return tally

    def _take(
        self,
        tally: _Tally,
        fresh: list[tuple[ClipRecord, Labels]],
        answer: ClipRecord | KnownContent,
        row: Any,
    ) -> None:
        """Note a clip for the insert; ``row`` is the clip that stands under its path, if any."""
        record: Answer = answer
        if isinstance(answer, KnownContent):
            # The clip of this content has just gone: read the file after all.
            record = read_clip(ReadTask(answer.path, self._options))
        if isinstance(record, ClipRecord):
            labels = self._choose_labels(record.path, row)
            fresh.append((record, labels))
            (tally.added if row is None else tally.replaced).append(record.path)
            tally.warnings += [(record.path, text) for text in (*record.warnings, *self._missing(labels))]
        elif isinstance(record, Skipped):
            tally.skipped.append(record)

    def _missing(self, labels: Labels) -> Iterator[str]:
        """What a rule that was given did not find."""
        for name, rule in self._rules.items():
            if labels[name] is None and rule is not no_label:
                yield f"no {name} found; see --{name}-from, or give one with: dousa relabel"

    def _choose_labels(self, path: str, row: Any) -> Labels:
        """Labels of a new clip; one whose file changed keeps those that it has."""
        labels = self._labels(path)
        if row is None:
            return labels
        return {
            name: value if getattr(row, name) is None else getattr(row, name)
            for name, value in labels.items()
        }

    def _move(self, connection: sa.Connection, answer: ClipRecord | KnownContent, old_path: str) -> None:
        new = {
            "path": answer.path,
            "fingerprint": answer.state.fingerprint,
            "read_options": self._option_text,
        }
        connection.execute(sa.update(schema.clips).where(schema.clips.c.path == old_path).values(**new))

    def _insert(self, connection: sa.Connection, fresh: list[tuple[ClipRecord, Labels]]) -> None:
        if not fresh:
            return
        ids = take_clip_ids(connection, len(fresh))
        records = [record for record, _ in fresh]
        rows = [self._clip_row(clip_id, *pair) for clip_id, pair in zip(ids, fresh, strict=True)]
        connection.execute(sa.insert(schema.clips), rows)
        positions = [{"clip_id": i, "positions": r.positions} for i, r in zip(ids, records, strict=True)]
        connection.execute(sa.insert(schema.clip_trajectories), positions)
        features = [
            {"clip_id": i, "pose_features": pack(r.features, "<f8")}
            for i, r in zip(ids, records, strict=True)
        ]
        connection.execute(sa.insert(schema.clip_features), features)
        self.forest = load_forest(connection, self._where, self.forest)
        if self.forest is not None:
            stacked = np.stack([record.features for record in records])
            save_answers(connection, ids, ask_trees(self.forest, stacked))

    def _clip_row(self, clip_id: int, record: ClipRecord, labels: Labels) -> dict[str, Any]:
        return {
            "id": clip_id,
            "path": record.path,
            "content_hash": record.content_hash,
            "fingerprint": record.state.fingerprint,
            "size": record.state.size,
            "read_options": self._option_text,
            "category": labels["category"],
            "performer": labels["performer"],
            "format": record.format,
            "n_frames": record.n_frames,
            "frame_rate": record.frame_rate,
            "duration": record.duration,
            "height": record.height,
            "joint_table": record.joint_table,
            "warnings": list(record.warnings),
            "added_at": datetime.now(UTC).isoformat(timespec="seconds"),
        }


def _load_rows(connection: sa.Connection, read: list[ClipRecord | KnownContent]) -> list[Any]:
    """Stored clips that share a path or a content with files that were read."""
    table = schema.clips.c
    query = sa.select(table.id, table.path, table.content_hash, table.category, table.performer)
    rows = {}
    for column, values in (
        (table.path, [r.path for r in read]),
        (table.content_hash, [r.content_hash for r in read]),
    ):
        rows.update({row.id: row for row in connection.execute(query.where(column.in_(values)))})
    return list(rows.values())


def _delete(connection: sa.Connection, ids: list[int]) -> None:
    if ids:
        connection.execute(sa.delete(schema.clips).where(schema.clips.c.id.in_(ids)))
