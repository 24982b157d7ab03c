"""Adding files: what is known is left alone, the rest is read at the same time and written in portions.

A portion is one transaction, so a program that is stopped in the middle keeps what it wrote and goes on from
there when it is run again.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, fields
from typing import Any

import sqlalchemy as sa

from dousa.errors import DousaError
from dousa.library import schema
from dousa.library._contents import delete_clips
from dousa.library._engine import reading, writing
from dousa.library._forests import StoredForest, load_forest
from dousa.library._inserting import Fresh, Labels, insert_clips
from dousa.library._revision import lock_for_writing, next_revision
from dousa.library._take_windows import DescribedTakes, describe_records, refresh_windows
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
_PORTION_BYTES = 1 << 26

Answer = ClipRecord | KnownContent | Skipped


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
    other_kind: list[str] = field(default_factory=list)
    new_categories: list[str] = field(default_factory=list)
    n_learned: int = 0
    bytes: int = 0

    def extend(self, other: _Tally) -> None:
        for item in fields(self):
            setattr(self, item.name, getattr(self, item.name) + getattr(other, item.name))


class Adding:
    """One run of ``Library.add``.

    Parameters
    ----------
    engine, where : the library and its name for messages.
    kind : ``CLIP`` or ``TAKE``, of files that are not there yet.
    category_rule, performer_rule : labels of new clips.
    options : what is said about the files.
    known_forest : the forest of the library, if it is loaded.
    """

    def __init__(
        self,
        engine: sa.Engine,
        where: str,
        *,
        kind: str,
        category_rule: LabelRule,
        performer_rule: LabelRule,
        options: ReadOptions,
        known_forest: StoredForest | None = None,
    ) -> None:
        self._engine = engine
        self._where = where
        self._kind = kind
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
                if _is_full(portion) or time.monotonic() - last >= _PORTION_SECONDS:
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
        if self._tally.n_learned and self.forest is not None:
            refresh_windows(self._engine, self._where, self.forest, n_jobs)
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
            other_kind=tuple(tally.other_kind),
            n_learned=tally.n_learned,
            new_categories=tuple(sorted(set(tally.new_categories))),
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
        query = sa.select(*columns, table.category, table.performer, table.kind)
        with reading(self._engine, self._where) as connection:
            stored: dict[str, Any] = {row.path: row for row in connection.execute(query)}
            self.forest = load_forest(connection, self._where, self.forest)
        hashes: dict[int, list[str]] = {}
        for row in stored.values():
            hashes.setdefault(row.size, []).append(row.content_hash)
        tasks = []
        for path in self._found:
            try:
                state = look_at(path, self._options)
            except (DousaError, OSError):
                tasks.append(self._task(path))  # reading it says what is wrong
                continue
            row = stored.get(path)
            if row and (row.fingerprint, row.read_options) == (state.fingerprint, self._option_text):
                self._tally.unchanged.append(path)
                self._note_labels(self._tally, path, row)
            else:
                known = tuple(hashes.get(state.size, ()))
                tasks.append(self._task(path, row.kind if row else self._kind, known))
        return tasks

    def _task(self, path: str, kind: str | None = None, known: tuple[str, ...] = ()) -> ReadTask:
        """A file to read; if there is a forest, the features of a clip are computed while it is read."""
        chosen = kind or self._kind
        feature_set = self.forest.feature_set if self.forest and chosen == schema.CLIP else ""
        return ReadTask(path, self._options, known, chosen, feature_set)

    def _note_labels(self, tally: _Tally, path: str, row: Any) -> None:
        """Whether a stored clip would be another kind or have other labels now: it stays, but that is told."""
        if row.kind != self._kind:
            tally.other_kind.append(path)
        labels = self._labels(path)
        if any(value is not None and value != getattr(row, name) for name, value in labels.items()):
            tally.other_labels.append(path)

    def _store_portion(self, portion: list[Answer]) -> list[Answer]:
        """Write a portion in one transaction; returns the empty next one."""
        self._tally.skipped += [answer for answer in portion if isinstance(answer, Skipped)]
        read = [answer for answer in portion if not isinstance(answer, Skipped)]
        if read:
            # Long recordings take a while to describe: not while other programs wait to write.
            takes = describe_records(self.forest, [r for r in read if isinstance(r, ClipRecord)])
            with writing(self._engine, self._where) as connection:
                lock_for_writing(connection)
                tally = self._store(connection, read, takes)
            self._tally.extend(tally)
        return []

    def _store(
        self, connection: sa.Connection, read: list[ClipRecord | KnownContent], takes: DescribedTakes
    ) -> _Tally:
        tally = _Tally()
        stored = _load_rows(connection, read)
        by_path = {row.path: row for row in stored}
        # Files that hold something else now. All are found before any is stored: two may have changed places.
        now = {answer.path: answer.content_hash for answer in read}
        gone = {row.path: row.id for row in stored if now.get(row.path, row.content_hash) != row.content_hash}
        owner = {row.content_hash: row.path for row in stored if row.path not in gone}
        fresh: list[Fresh] = []
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
        if fresh or gone or tally.moved:
            revision = next_revision(connection)
            delete_clips(connection, list(gone.values()))
            self._insert(connection, tally, fresh, takes, revision)
        return tally

    def _take(
        self,
        tally: _Tally,
        fresh: list[Fresh],
        answer: ClipRecord | KnownContent,
        row: Any,
    ) -> None:
        """Note a clip for the insert; ``row`` is the clip that stands under its path, if any."""
        record: Answer = answer
        if isinstance(answer, KnownContent):
            # The clip of this content has just gone: read the file after all.
            record = read_clip(self._task(answer.path, row.kind if row is not None else None))
        if isinstance(record, ClipRecord):
            labels = self._choose_labels(record.path, row)
            fresh.append(Fresh(record, labels, self._option_text))
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

    def _insert(
        self,
        connection: sa.Connection,
        tally: _Tally,
        fresh: list[Fresh],
        takes: DescribedTakes,
        revision: int,
    ) -> None:
        if fresh:
            # Loaded again: another program may have trained the library while files were read.
            forest = load_forest(connection, self._where, self.forest)
            self.forest, learned = insert_clips(connection, fresh, forest, takes, revision)
            tally.n_learned += learned.n_clips
            tally.new_categories += learned.new_categories


def _is_full(portion: Sequence[Answer]) -> bool:
    size = sum(len(answer.positions) for answer in portion if isinstance(answer, ClipRecord))
    return len(portion) >= _PORTION_CLIPS or size >= _PORTION_BYTES


def _load_rows(connection: sa.Connection, read: list[ClipRecord | KnownContent]) -> list[Any]:
    """Stored clips that share a path or a content with files that were read."""
    table = schema.clips.c
    query = sa.select(table.id, table.path, table.content_hash, table.category, table.performer, table.kind)
    rows = {}
    for column, values in (
        (table.path, [r.path for r in read]),
        (table.content_hash, [r.content_hash for r in read]),
    ):
        rows.update({row.id: row for row in connection.execute(query.where(column.in_(values)))})
    return list(rows.values())
