"""Adding motions: unchanged files are skipped, the others are read in parallel and written in portions.

A portion is one transaction, so that an interrupted run keeps its writes and goes on from there. A trained forest
learns once, at the end.
"""

from __future__ import annotations

import os
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, cast

import sqlalchemy as sa

from dousa.errors import DousaError
from dousa.formats.annotations.label_file import to_annotation
from dousa.formats.motion_files import (
    Elected,
    FoundFile,
    FrameVotes,
    ReadOptions,
    Skipped,
    find_motion_files,
    is_unicode,
)
from dousa.formats.parts import KINDS, are_all, file_of, join_address
from dousa.formats.registry import find_reader
from dousa.library.annotations.matching import FoundLabels, TakeLength, check_fit, choose_labels, find_labels
from dousa.library.annotations.store import annotate_takes, read_annotations, rename_segments
from dousa.library.care.compact import begin_where_large
from dousa.library.history.recording import recording, recording_together, step
from dousa.library.label_rules import LabelRule, check_text, no_label
from dousa.library.learning.insert import Arrival, describe_arrival, insert_clips
from dousa.library.learning.lesson import learn_new
from dousa.library.results import AddReport, Duplicate
from dousa.library.store import schema
from dousa.library.store.checksums import LABELS, NUMBERS
from dousa.library.store.engine import Database, next_revision
from dousa.library.store.forests import ForestCache
from dousa.library.store.ingest import (
    ClipRecord,
    FileRecord,
    ReadTask,
    Several,
    SourceState,
    look_at,
    read_clip,
    read_clips,
)
from dousa.library.store.rows import fetch_in, update_rows
from dousa.library.store.selection import delete_clips, read_tags, save_tags, with_segments
from dousa.library.takes.windows import make_window_files, refresh_windows
from dousa.messages import Message

AddProgress = Callable[[int, int, str], None]
"""Called with (files done, files, path of the last one), then, for many takes, with (takes done, takes, message)."""

_NO_LABEL = {"category": Message("library_add.no_category"), "performer": Message("library_add.no_performer")}

Labels = dict[str, str | None]

Answer = ClipRecord | FileRecord | Skipped

_PART_NOTES = {"parts.person_asked", "parts.animation_asked", "parts.alone"}  # the name of the clip says it

_SKELETONS = {".asf", ".pmx"}  # read with motions

Tally = defaultdict[str, list[Any]]
"""The growing fields of the report; numbers are lists of their parts."""


def _make_report(tally: Tally, seconds: float) -> AddReport:
    values: dict[str, Any] = {field.name: tuple(tally[field.name]) for field in fields(AddReport)}
    values |= {name: sum(tally[name]) for name in ("n_learned", "n_segments", "bytes")}
    values["new_categories"] = tuple(sorted(set(tally["new_categories"])))
    return AddReport(**(values | {"seconds": seconds}))


@dataclass(frozen=True, slots=True, eq=False)
class _Sorted:
    """Sorted motions: their counts, the new ones, the clips they replace, and moved files."""

    tally: Tally
    fresh: list[ClipRecord]
    gone: list[int]
    moved: list[tuple[FileRecord, Any]]
    arrival: Arrival | None


class Adding:
    """One run of ``Library.add`` or ``Library.add_motion``.

    Parameters
    ----------
    kind : ``CLIP`` or ``TAKE``, of new motions.
    rules : of category and performer: labels of new clips.
    options : how to read the files.
    forests : of the library; learns from what is added.
    labels_from, tier : the labels of takes, see ``dousa.library.annotations.matching``; None for none.
    """

    def __init__(
        self,
        database: Database,
        kind: str,
        rules: Mapping[str, LabelRule],
        options: ReadOptions,
        forests: ForestCache,
        labels_from: str | None = None,
        tier: str | None = None,
    ) -> None:
        self._database = database
        self._kind = kind
        self._rules = rules
        # A part goes into the name of its clip, as it does where all parts are added.
        self._part = {kind: name for kind in KINDS if (name := getattr(options, kind)) is not None}
        self._options = replace(options, person=None, animation=None)
        self._forests = forests
        self._labels_from = labels_from
        self._tier = tier
        self._found: dict[str, FoundFile] = {}
        self._of_file: dict[str, list[str]] = {}  # clips that the library has of a file that is read again
        self._sizes: dict[str, int] = {}  # of the files that were read
        self._known_labels: dict[str, Labels] = {}
        self._labels_stay = True
        self._tally: Tally = defaultdict(list)

    def run(self, paths: Sequence[Any], n_jobs: int | None, progress: AddProgress | None) -> AddReport:
        """Add all motion files of these files and folders."""
        start = time.perf_counter()
        others: Counter[str] = Counter()
        files, missing = find_motion_files(paths, others)
        self._tally["skipped"] += missing
        self._tally["passed_over"] += others.most_common()
        self._found = {self._name(str(file.path)): file for file in files}
        self._leave_out(self._find_skeletons())
        report = progress or (lambda done, total, path: None)
        report(0, len(files), "")  # a rule for labels may take long
        for path in self._found:
            self._labels(path)
        # All tables before anything is written, so that an error in one leaves nothing half done.
        labels = {} if self._labels_from is None else find_labels(files, self._labels_from, self._tier)
        labels = {self._name(path): own for path, own in labels.items()}
        tasks = self._plan(labels)
        self._check_known(labels)
        with recording_together(self._database.engine) as whole:  # one change for all portions
            before = whole.number  # of a block around it
            try:
                self._read(tasks, labels, n_jobs, report)
                if self._labels_from is not None:
                    self._annotate(labels)
            except DousaError:
                if labels and whole.number != before:  # many takes, written while others were read
                    step(self._database, whole.number, redo=False)
                    whole.number = None
                raise
        return self._finish(start, n_jobs, progress)

    def _read(
        self,
        tasks: Sequence[ReadTask],
        labels: dict[str, FoundLabels],
        n_jobs: int | None,
        report: AddProgress,
        *,
        most_doubtful: int = 500,
        at_most_s: float = 1.0,
    ) -> None:
        """Read files and store them in portions; a table that does not fit its take is an error.

        Parameters
        ----------
        most_doubtful : doubtful files held in memory until the others of their skeleton are read; on those beyond, the
            files before them decide.
        at_most_s : s between two portions, which is what an interrupted program loses; less makes more transactions.
        """
        done = len(self._found) - len(tasks)
        if done:
            report(done, len(self._found), "")
        portion: list[Answer] = []
        doubtful: list[ClipRecord] = []
        votes = FrameVotes()
        last = time.monotonic()
        answers = self._read_parts(tasks, labels, n_jobs)
        try:
            for answer in answers:
                self._check_table(answer, labels)
                claim = answer.claim if isinstance(answer, ClipRecord) else None
                if claim is not None:
                    votes.count(claim)
                if claim is None or not claim.doubtful:
                    portion.append(_believe(answer))
                elif len(doubtful) < most_doubtful:
                    doubtful.append(cast("ClipRecord", answer))
                else:
                    portion.append(self._settle(cast("ClipRecord", answer), votes))
                # Takes with tables wait while there is room, so that nothing is written if one does not fit.
                if _is_full(portion) or (not labels and time.monotonic() - last >= at_most_s):
                    portion = self._store_portion(portion)
                    last = time.monotonic()
                done += 1
                report(done, len(self._found), answer.path)
        except KeyboardInterrupt:
            self._store_portion(portion)
            raise
        finally:
            answers.close()
        portion += [self._settle(record, votes) for record in doubtful]
        self._store_portion(portion, [path for paths in self._of_file.values() for path in paths])

    def _read_parts(
        self, tasks: Sequence[ReadTask], labels: dict[str, FoundLabels], n_jobs: int | None
    ) -> Generator[Answer, None, None]:
        """Read files, and those of several people or animations once more for each of them.

        Clips of a file that are none of its parts any more stay in ``_of_file``; of one that cannot be read, all are
        left alone.
        """
        while tasks:
            several: list[Several] = []
            with closing(read_clips(tasks, n_jobs)) as answers:
                for task, answer in zip(tasks, answers, strict=True):
                    if isinstance(answer, Several):
                        several.append(answer)
                        continue
                    own = self._of_file.get(file_of(answer.path), [])
                    if isinstance(answer, Skipped):
                        own.clear()
                    elif answer.path in own:
                        own.remove(answer.path)
                    if not isinstance(answer, Skipped) and answer.path != task.path:  # a part by its number
                        self._rename(task.path, [answer.path], labels)
                    yield answer
            for one in several:
                self._rename(one.path, one.addresses, labels)
            tasks = [self._task(address, parts=True) for one in several for address in one.addresses]

    def _rename(self, path: str, addresses: Sequence[str], labels: dict[str, FoundLabels]) -> None:
        """Put addresses of parts in the place of a path."""
        self._found |= dict.fromkeys(addresses, self._found.pop(path))
        if path in labels:
            labels |= dict.fromkeys(addresses, labels.pop(path))

    def _check_known(self, labels: Mapping[str, FoundLabels]) -> None:
        """Check that tables fit takes in the library, before anything is written."""
        paths = [path for path in self._tally["unchanged"] if path in labels]
        for row in self._read_takes(paths):
            self._check_fit(TakeLength.of(row), labels)

    def _check_table(self, answer: Answer, labels: Mapping[str, FoundLabels]) -> None:
        if isinstance(answer, ClipRecord) and answer.row["kind"] == schema.TAKE and answer.path in labels:
            row = answer.row
            length = TakeLength(answer.path, row["duration"], row["frame_rate"], row["n_frames"])
            self._check_fit(length, labels)

    def _check_fit(self, take: TakeLength, labels: Mapping[str, FoundLabels]) -> None:
        own = labels[take.path]
        check_fit(take, to_annotation(own.file, own.tiers, self._tier, take.frame_rate)[0])

    def _read_takes(self, paths: Sequence[str]) -> list[Any]:
        table = schema.clips.c
        query = sa.select(table.id, table.path, table.frame_rate, table.duration, table.n_frames)
        with self._database.reading() as connection:
            rows = fetch_in(connection, query.where(table.kind == schema.TAKE), table.path, list(paths))
            return sorted(rows, key=lambda row: str(row.path))

    def _annotate(self, labels: Mapping[str, FoundLabels]) -> None:
        """Label the takes among the files; those with the same labels are not touched."""
        copies: dict[str, list[FoundLabels]] = {}
        for one in self._tally["duplicates"]:
            if one.path in labels:
                copies.setdefault(one.same_as, []).append(labels[one.path])
        rows = self._read_takes(list(dict.fromkeys([*self._found, *copies])))
        with self._database.reading() as connection:
            stored = {one.take_id: one for one in read_annotations(connection, [row.id for row in rows])}
        wanted = {}
        notes: dict[int, list[Message]] = {}
        for row in rows:
            chosen = choose_labels(row, labels.get(row.path), copies.get(row.path, ()), stored[row.id], self._tier)
            self._tally["warnings"] += [(row.path, note) for note in chosen.always]
            if chosen.labels is not None:
                wanted[row.id], notes[row.id] = chosen.labels, list(chosen.notes)
        self._tally["warnings"] += self._find_clips(labels, {row.path for row in rows})
        changes = annotate_takes(self._database, wanted, self._forests)
        changed = set(changes.takes)
        # Do not repeat notes on unchanged labels.
        new = [(row.path, note) for row in rows if row.path in changed for note in notes[row.id]]
        of_several = {note: path for path, note in reversed(new) if note.code == "annotations.one_name"}
        self._tally["warnings"] += [(path, note) for path, note in new if of_several.get(note, path) == path]
        self._tally["warnings"] += changes.warnings
        blank = {row.path for row in rows if row.id in wanted and wanted[row.id].is_blank}
        self._tally["labelled"] += [path for path in changes.takes if path not in blank]
        self._tally["n_segments"].append(changes.n_segments)
        self._tally["n_learned"].append(changes.n_learned)
        self._tally["new_categories"] += changes.new_categories
        # Tables that were read are none of the files that no reader accepts.
        self._leave_out({os.path.abspath(own.file.path) for own in labels.values()})

    def _find_clips(self, labels: Mapping[str, FoundLabels], takes: set[str]) -> Iterator[tuple[str, Message]]:
        """Return files with tables that are in the library as clips, so that the labels have no take."""
        first = {one.path: one.same_as for one in self._tally["duplicates"]}
        skipped = {one.path for one in self._tally["skipped"]}
        for path, own in labels.items():
            clip = first.get(path, path)
            if clip not in takes and path not in skipped:
                yield path, Message("annotations.of_clip", table=own.file.path, clip=clip)

    def _find_skeletons(self) -> set[str]:
        found: set[str] = set()
        if not {suffix for suffix, _ in self._tally["passed_over"]} & _SKELETONS:
            return found
        for path in self._found:
            with suppress(DousaError, OSError):
                found.update(map(os.path.abspath, look_at(path, self._options).files[1:]))
        return found

    def _leave_out(self, paths: set[str]) -> None:
        """Remove used files from those that no reader accepts, if they are in the folders."""
        roots = {file.root for file in self._found.values() if file.root != file.path}
        used = Counter(os.path.splitext(path)[1].lower() for path in paths if not roots.isdisjoint(Path(path).parents))
        left = [(suffix, count - used[suffix]) for suffix, count in self._tally["passed_over"]]
        self._tally["passed_over"] = [(suffix, count) for suffix, count in left if count > 0]

    def _settle(self, record: ClipRecord, votes: FrameVotes) -> Answer:
        """Read a file of doubtful up axis or unit as the others of its skeleton."""
        given = self._options
        voted = Elected() if record.claim is None else votes.elect(record.claim)
        if given.up is not None or given.unit is not None:
            voted = replace(
                voted, up=None, unit=None, notes=tuple(n for n in voted.notes if not n.code.startswith("units."))
            )
        if not voted.decides or (record.refusal is not None and not voted.is_person):
            return _believe(record)
        return _whole(read_clip(replace(self._task(record.path, record.row["kind"]), voted=voted)))

    def run_one(self, record: ClipRecord, n_jobs: int | None) -> AddReport:
        """Add a motion in memory, or replace one of its name; its labels are given."""
        start = time.perf_counter()
        self._labels_stay = False
        self._found = {record.path: FoundFile(Path(record.path), Path(record.path))}
        self._store_portion([record])
        return self._finish(start, n_jobs)

    def _finish(self, start: float, n_jobs: int | None, progress: AddProgress | None = None) -> AddReport:
        # Even if nothing is new: an earlier run may have been interrupted before this.
        self._forests.last, learned = learn_new(self._database, self._forests.last)
        self._tally["n_learned"].append(learned.n_clips)
        self._tally["new_categories"] += learned.new_categories
        if self._forests.last is not None:
            refresh_windows(self._database, self._forests.last, n_jobs)
            report = progress or (lambda done, total, path: None)
            make_window_files(
                self._database, self._forests.last, n_jobs, lambda done, total, what: report(done, total, str(what))
            )
        if begun := begin_where_large(self._database):
            self._tally["warnings"].append((self._database.where, Message("library_fragments.begun", most=begun)))
        return _make_report(self._tally, time.perf_counter() - start)

    def _name(self, path: str) -> str:
        """Return the address of the part that was asked for, of a file that can have it."""
        line = find_reader(path) if "animation" in self._part else None
        if line is not None and "animation" not in line.options:
            return join_address(path, {kind: name for kind, name in self._part.items() if kind != "animation"})
        return join_address(path, self._part)

    def _plan(self, labels: dict[str, FoundLabels]) -> list[ReadTask]:
        """Return the files to open; unchanged files are tallied."""
        table = schema.clips.c
        columns = (table.path, table.content_hash, table.fingerprint, table.size, table.read_options)
        query = sa.select(*columns, table.category, table.performer, table.kind)
        states = {path: self._look_at(path) for path in self._found}
        names = [path for path in states if is_unicode(path)]
        with self._database.reading() as connection:
            stored: dict[str, Any] = {row.path: row for row in fetch_in(connection, query, table.path, names)}
            parts = _read_parts_of_files(connection)
            self._forests.renew(connection)
            unread, options = [], self._options.describe()
            for path, state in states.items():
                rows = [stored[path]] if path in stored else parts.get(path, [])
                same = state and all((r.fingerprint, r.read_options) == (state.fingerprint, options) for r in rows)
                whole = path in stored or are_all({row.path: map(Message.from_json, row.warnings) for row in rows})
                if rows and same and whole:
                    self._rename(path, [row.path for row in rows], labels)
                    for row in rows:
                        self._tally["unchanged"].append(row.path)
                        self._note_labels(self._tally, row.path, row)
                    continue
                if not self._part:
                    self._of_file[path] = [row.path for row in rows]
                unread.append((path, next(iter(rows), None), -1 if state is None else state.size))
            hashes = _find_hashes(connection, {size for _, _, size in unread})
        return [
            self._task(path, row.kind if row and size >= 0 else self._kind, tuple(hashes.get(size, ())), parts=True)
            for path, row, size in unread
        ]

    def _look_at(self, path: str) -> SourceState | None:
        """Return the state of a file; None if only reading it gives the error."""
        try:
            return look_at(path, self._options)
        except (DousaError, OSError):
            return None

    def _task(
        self, path: str, kind: str | None = None, known: tuple[str, ...] = (), *, parts: bool = False
    ) -> ReadTask:
        """Return the task for a file; with a forest, the features of a clip are computed too."""
        chosen = kind or self._kind
        forest = self._forests.last
        feature_set = forest.feature_set if forest and chosen == schema.CLIP else ""
        return ReadTask(path, self._options, known, chosen, feature_set, parts=parts, may_be_voted=True)

    def _labels(self, path: str) -> Labels:
        """Return the labels of a file by the rules, each applied once."""
        if path not in self._known_labels:
            file = self._found[path]
            labels = {name: rule(file.root, file.path) for name, rule in self._rules.items()}
            for label in labels.values():
                check_text(label or "")
            self._known_labels[path] = labels
        return self._known_labels[path]

    def _note_labels(self, tally: Tally, path: str, row: Any) -> None:
        """Report a stored clip whose kind or labels would now differ; it stays."""
        if row.kind != self._kind:
            tally["other_kind"].append(path)
        labels = self._labels(path)
        if any(value is not None and value != getattr(row, name) for name, value in labels.items()):
            tally["other_labels"].append(path)

    def _store_portion(self, portion: list[Answer], stale: Sequence[str] = ()) -> list[Answer]:
        """Write a portion in one transaction and remove stale clips by path; return the empty next portion."""
        self._tally["skipped"] += [answer for answer in portion if isinstance(answer, Skipped)]
        read = [answer for answer in portion if not isinstance(answer, Skipped)]
        self._sizes |= {file_of(record.path): record.row["size"] for record in read}
        self._tally["bytes"] = [*self._sizes.values()]
        if read or stale:
            # Votes are slow: compute them before other programs have to wait.
            sorted_out = self._database.write_planned(lambda c, known: self._sort(c, read, known, stale), self._store)
            for name, items in sorted_out.tally.items():
                self._tally[name] += items
        return []

    def _sort(
        self, connection: sa.Connection, read: list[FileRecord], known: _Sorted | None, stale: Sequence[str] = ()
    ) -> _Sorted:
        """Sort motions into new, changed and present ones, without writing."""
        tally: Tally = defaultdict(list)
        stored = _load_rows(connection, read)
        by_path = {row.path: row for row in stored}
        # Changed files, all found before any is stored: two may have swapped names.
        now = {record.path: record.row["content_hash"] for record in read}
        gone = {row.path: row.id for row in stored if now.get(row.path, row.content_hash) != row.content_hash}
        clips = schema.clips.c
        gone |= {row.path: row.id for row in fetch_in(connection, sa.select(clips.id, clips.path), clips.path, stale)}
        owner = {row.content_hash: row.path for row in stored if row.path not in gone}
        fresh: list[ClipRecord] = []
        moved: list[tuple[FileRecord, Any]] = []
        for record in read:
            row, first = by_path.get(record.path), owner.get(record.row["content_hash"])
            if first == record.path and row is not None:
                moved.append((record, row))
                tally["unchanged"].append(first)
                self._note_labels(tally, first, row)
            elif first is None:
                self._take(tally, fresh, record, row)
                owner[record.row["content_hash"]] = record.path
            elif row is None and first in by_path and _is_gone(by_path[first]):
                moved.append((record, by_path[first]))
                tally["moved"].append(Duplicate(record.path, first))
                self._note_labels(tally, record.path, by_path[first])
                owner[record.row["content_hash"]] = record.path
            else:
                tally["duplicates"].append(Duplicate(record.path, first))
        arrival = None
        if fresh:
            # Loaded again: another program may have trained the library while files were read.
            arrival = describe_arrival(self._forests.renew(connection), fresh, known.arrival if known else None)
        return _Sorted(tally, fresh, list(gone.values()), moved, arrival)

    def _store(self, connection: sa.Connection, found: _Sorted) -> _Sorted:
        if not (found.fresh or found.gone or found.tally["moved"]):
            _move(connection, found.moved)
            return found
        kind = "add" if found.fresh or found.gone else "move"
        renamed = with_segments(connection, [row.id for record, row in found.moved if record.path != row.path])
        with recording(connection, next_revision(connection), kind, marked=renamed, gone=found.gone):
            _move(connection, found.moved)
            tags = _read_own_tags(connection, found.gone)
            delete_clips(connection, found.gone)
            if found.arrival is not None:
                insert_clips(connection, found.fresh, found.arrival)
            _give_tags(connection, tags)
        return found

    def _take(self, tally: Tally, fresh: list[ClipRecord], known: FileRecord, row: Any) -> None:
        """Add a clip to the insert; ``row`` is the clip under its path, if any."""
        record: Answer = known
        if not isinstance(known, ClipRecord):
            # The clip of this content was just removed: read the file after all.
            record = _believe(_whole(read_clip(self._task(known.path, row.kind if row is not None else None))))
        if isinstance(record, ClipRecord):
            labels = self._choose_labels(record.path, row)
            kind = record.row["kind"] if row is None else row.kind
            fresh.append(replace(record, row={**record.row, **labels, "kind": kind}))
            (tally["added"] if row is None else tally["replaced"]).append(record.path)
            missing = [name for name, rule in self._rules.items() if labels[name] is None and rule is not no_label]
            notes = map(Message.from_json, record.row["warnings"])
            doubts = [*(note for note in notes if note.code not in _PART_NOTES), *map(_NO_LABEL.__getitem__, missing)]
            doubts += [Message("library_add.one_frame")] if record.row["n_frames"] == 1 else []
            tally["warnings"] += [(record.path, text) for text in doubts]
        elif isinstance(record, Skipped):
            tally["skipped"].append(record)

    def _choose_labels(self, path: str, row: Any) -> Labels:
        """Return labels of a new clip; a clip whose file changed keeps its own."""
        labels = self._labels(path)
        if row is None:
            return labels
        stored = {name: getattr(row, name) for name in labels}
        first, second = (stored, labels) if self._labels_stay else (labels, stored)
        return {name: second[name] if value is None else value for name, value in first.items()}


def _whole(answer: Answer | Several) -> Answer:
    assert not isinstance(answer, Several), "parts are listed before"
    return answer


def _believe(answer: Answer) -> Answer:
    """Skip a body of impossible proportions on which no others decided."""
    refusal = answer.refusal if isinstance(answer, ClipRecord) else None
    return answer if refusal is None else Skipped(answer.path, refusal)


def _move(connection: sa.Connection, moved: Sequence[tuple[FileRecord, Any]]) -> None:
    names = ("fingerprint", "read_options")
    update_rows(connection, NUMBERS, {row.id: {name: record.row[name] for name in names} for record, row in moved})
    renamed = [(record, row) for record, row in moved if record.path != row.path]
    update_rows(connection, LABELS, {row.id: {"path": record.path} for record, row in renamed})
    for record, _ in renamed:
        rename_segments(connection, record.path)


def _read_own_tags(connection: sa.Connection, ids: Sequence[int]) -> dict[str, tuple[str, ...]]:
    clips, tags = schema.clips.c, read_tags(connection, ids)
    rows = fetch_in(connection, sa.select(clips.id, clips.path), clips.id, list(tags))
    return {row.path: tags[row.id] for row in rows}


def _give_tags(connection: sa.Connection, tags: Mapping[str, Sequence[str]]) -> None:
    """Restore the tags of clips whose file changed."""
    clips = schema.clips.c
    rows = fetch_in(connection, sa.select(clips.id, clips.path), clips.path, list(tags))
    save_tags(connection, {row.id: tags[row.path] for row in rows})


def _is_gone(row: Any) -> bool:
    """Return whether the file of a clip is missing; motions in memory never had one."""
    return bool(row.fingerprint) and not os.path.exists(file_of(row.path))


def _read_parts_of_files(connection: sa.Connection) -> dict[str, list[Any]]:
    """Return the clips that are parts of a file, by file."""
    table = schema.clips.c
    columns = (table.path, table.content_hash, table.fingerprint, table.size, table.read_options, table.warnings)
    query = sa.select(*columns, table.category, table.performer, table.kind).order_by(table.id)
    query = query.where(table.fingerprint != "")  # not the segments of a take
    parts: dict[str, list[Any]] = {}
    for row in connection.execute(query.where(sa.or_(*(table.path.contains(f"#{kind}=") for kind in KINDS)))):
        parts.setdefault(file_of(row.path), []).append(row)
    return parts


def _is_full(portion: Sequence[Answer], *, n_clips: int = 256, n_bytes: int = 1 << 26) -> bool:
    """Return whether a portion has this many clips, or bytes of positions; larger ones need more memory."""
    n_frames = sum(answer.motion.n_frames for answer in portion if isinstance(answer, ClipRecord))
    return len(portion) >= n_clips or n_frames >= n_bytes // schema.FRAME_BYTES


def _find_hashes(connection: sa.Connection, sizes: set[int]) -> dict[int, list[str]]:
    """Return the content hashes of stored clips by size, for the sizes of some files."""
    table = schema.clips.c
    query = sa.select(table.size, table.content_hash)
    hashes: dict[int, list[str]] = {}
    for row in fetch_in(connection, query, table.size, sorted(sizes)):
        hashes.setdefault(row.size, []).append(row.content_hash)
    return hashes


def _load_rows(connection: sa.Connection, read: Sequence[FileRecord]) -> list[Any]:
    table = schema.clips.c
    columns = (table.id, table.path, table.content_hash, table.fingerprint, table.kind)
    query = sa.select(*columns, table.category, table.performer)
    rows = {}
    for column in (table.path, table.content_hash):
        values = [record.row[column.name] for record in read]
        rows.update({row.id: row for row in connection.execute(query.where(column.in_(values)))})
    return list(rows.values())
