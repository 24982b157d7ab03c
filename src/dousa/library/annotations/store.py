"""Labels of takes in the library: each segment is a clip that refers to a part of the take's positions.

A take with a table of labels has a row in ``take_annotations``: it is labelled from beginning to end, and the rest
shows nothing that has a name. Segments named by hand are stored like the others; if a take has only such segments, the
rest is undecided.
"""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import sqlalchemy as sa

from dousa.errors import LibraryError, OptionError
from dousa.library.annotations.matching import TakeLength, check_annotation, check_fit, check_times, fit
from dousa.library.history.recording import recording
from dousa.library.label_rules import check_text
from dousa.library.learning.insert import Arrival, describe_arrival, insert_clips
from dousa.library.learning.lesson import learn_new
from dousa.library.results import TakeAnnotation, TakeSegment
from dousa.library.store import schema
from dousa.library.store.checksums import ANNOTATIONS, LABELS, SEGMENTS
from dousa.library.store.engine import Database, next_revision
from dousa.library.store.features import StoredMotion, load_motions
from dousa.library.store.forests import ForestCache
from dousa.library.store.ingest import ClipRecord
from dousa.library.store.rows import delete_rows, fetch_in, fetch_rows, insert_rows, portions, update_rows
from dousa.library.store.selection import delete_clips, find_row
from dousa.library.takes.windows import refresh_windows
from dousa.messages import Message
from dousa.motion.annotation import Annotation, Stretch
from dousa.retrieval.features.posed_motion import AnnotatedTake

Spans = Mapping[int, Sequence[tuple[float, float]]]
"""By number of the take: (start, stop) s."""


def find_leaving(connection: sa.Connection, ids: Sequence[int]) -> Spans:
    """Return the (start, stop) s, by take, of those clips that are table segments of takes not removed themselves.

    Segments named by hand are not part of a table and are left out.
    """
    table, going = schema.segments.c, set(ids)
    query = sa.select(table.take_id, table.start_s, table.end_s)
    query = query.join(schema.take_annotations, schema.take_annotations.c.take_id == table.take_id)
    found: dict[int, list[tuple[float, float]]] = {}
    for row in fetch_in(connection, query.where(sa.not_(table.by_hand)), table.clip_id, ids):
        if row.take_id not in going:
            found.setdefault(int(row.take_id), []).append((row.start_s, row.end_s))
    return found


def leave_open(connection: sa.Connection, removed: Spans) -> None:
    """Mark places of `find_leaving` as undecided, after the removal in the same transaction.

    A take left without segments loses its table.
    """
    segments, tables = schema.segments.c, schema.take_annotations
    there = {row.take_id for row in fetch_in(connection, sa.select(segments.take_id), segments.take_id, list(removed))}
    delete_rows(connection, tables, sorted(removed.keys() - there))
    changes = {
        int(row.take_id): {"unclear": sorted([*map(list, row.unclear), *map(list, removed[row.take_id])])}
        for row in fetch_rows(connection, ANNOTATIONS, sorted(there))
    }
    update_rows(connection, ANNOTATIONS, changes)


_TIME = "#t="  # between the path of a take and the time of a segment


@dataclass(frozen=True, slots=True)
class AnnotationChanges:
    """Changes to the labels of takes.

    Parameters
    ----------
    takes, unchanged : paths of takes with new or changed labels, and with the same ones.
    n_segments, n_removed : new and removed segments.
    warnings : (path of the take, what was cut or left out).
    n_learned, new_categories : as in ``AddReport``.
    """

    takes: tuple[str, ...] = ()
    unchanged: tuple[str, ...] = ()
    n_segments: int = 0
    n_removed: int = 0
    warnings: tuple[tuple[str, Message], ...] = ()
    n_learned: int = 0
    new_categories: tuple[str, ...] = ()

    def __add__(self, other: AnnotationChanges) -> AnnotationChanges:
        return AnnotationChanges(*(getattr(self, name) + getattr(other, name) for name in self.__slots__))


_COLUMNS = ("id", "path", "performer", "content_hash", "read_options", "format", "n_frames", "frame_rate", "height",
            "joint_table", "duration", "absent")  # fmt: skip


def annotate_takes(
    database: Database,
    wanted: Mapping[int, Annotation],
    forests: ForestCache,
    *,
    at_once: int = 16,
) -> AnnotationChanges:
    """Replace the labels of takes by those of tables, and let the forest learn them.

    OptionError or MotionFileError for invalid labels, or labels that do not fit their take; nothing changes.

    Parameters
    ----------
    wanted : by number of the take; missing takes are left out. Blank labels remove all labels.
    at_once : takes in one transaction; more make other writers wait longer.
    """
    for labels in wanted.values():
        check_annotation(labels)
    ids = sorted(wanted)
    with database.reading() as connection:
        for row in _read_takes(connection, ids):
            check_fit(TakeLength.of(row), wanted[row.id])
    changes = AnnotationChanges()
    for numbers in portions(ids, at_once=at_once):
        some = {number: wanted[number] for number in numbers}
        changes += database.write_planned(partial(_plan_tables, some, forests), _exchange)[0]
    return _learn(database, forests, changes)


def _learn(database: Database, forests: ForestCache, changes: AnnotationChanges) -> AnnotationChanges:
    forests.last, learned = learn_new(database, forests.last)
    return changes + AnnotationChanges(n_learned=learned.n_clips, new_categories=learned.new_categories)


def _find_missing(row: Any, labels: Annotation, there: Iterable[TakeSegment]) -> list[Stretch]:
    """Return segments of a table that were removed since, unless a segment named by hand took their place."""
    there = list(there)
    n_there = Counter((one.start, one.end) for one in there)
    known = {(one.start, one.end, one.category) for one in there}
    by_hand = [one for one in there if one.by_hand]
    kept, _ = fit(TakeLength.of(row), labels.segments)
    # A relabelled segment is there: at equal times as many go as come.
    n_missing = Counter((one.start, one.stop) for one in kept) - n_there
    missing = []
    for one in kept:
        span = (one.start, one.stop)
        if n_missing[span] > 0 and (*span, one.category) not in known:
            n_missing[span] -= 1
            missing.append(one)
    return [one for one in missing if not any(_is_same_place(own, one) for own in by_hand)]


def name_segment(
    database: Database,
    take_id: int,
    segment: Stretch,
    forests: ForestCache,
    instead_of: str | None = None,
) -> int | None:
    """Name a part of a take by hand; a segment at about the same place (half, intersection over union) is replaced.

    With ``instead_of``, only a segment of that category is replaced. The forest learns it. Returns the number of the
    clip; None if the part has no motion.
    """

    def plan(connection: sa.Connection, known: _Exchange | None) -> _Exchange:
        rows = _read_takes(connection, [take_id])
        if not rows:
            return _Exchange()
        before = _read_segments(connection, [take_id]).get(take_id, [])
        if segment.start >= rows[0].duration or segment.stop <= 0.0:
            check_fit(TakeLength.of(rows[0]), Annotation((segment,)))
        kept, _ = fit(TakeLength.of(rows[0]), [segment])
        there = [one for one in before if kept and _is_same_place(one, kept[0])]
        gone = [one.clip_id for one in there if instead_of in (None, one.category)]
        places = [(rows[0], kept, gone)] if kept else []
        return _plan(connection, forests, places, _Exchange(by_hand=True), known)

    done, ids = database.write_planned(plan, _exchange)
    _learn(database, forests, done)
    return ids[0] if ids else None


def _is_same_place(one: TakeSegment, other: Stretch) -> bool:
    shared = min(one.end, other.stop) - max(one.start, other.start)
    return shared > 0 and 2 * shared >= max(one.end, other.stop) - min(one.start, other.start)


def _read_takes(connection: sa.Connection, ids: Sequence[int]) -> list[Any]:
    table = schema.clips.c
    query = sa.select(*(table[name] for name in _COLUMNS)).where(table.kind == schema.TAKE)
    return sorted(fetch_in(connection, query, table.id, ids), key=lambda row: int(row.id))


def _hash_labels(labels: Annotation) -> str:
    plain = [[(one.start, one.stop, one.category) for one in labels.segments], labels.unclear, labels.tier]
    return hashlib.sha256(json.dumps(plain).encode()).hexdigest()


@dataclass(frozen=True, slots=True, eq=False)
class _Exchange:
    """New segments that replace others, planned before they are written.

    Parameters
    ----------
    tables : takes and their tables of labels.
    gone : numbers of the segments to remove.
    arrival : what follows from the records; None if there are none.
    """

    tables: Sequence[tuple[Any, Annotation]] = ()
    records: Sequence[ClipRecord] = ()
    gone: Sequence[int] = ()
    arrival: Arrival | None = None
    changes: AnnotationChanges = AnnotationChanges()
    by_hand: bool = False


def _plan_tables(
    wanted: Mapping[int, Annotation],
    forests: ForestCache,
    connection: sa.Connection,
    known: _Exchange | None,
) -> _Exchange:
    rows = _read_takes(connection, list(wanted))
    table, ids = schema.take_annotations.c, [row.id for row in rows]
    stored = fetch_in(connection, sa.select(table.take_id, table.labels_hash), table.take_id, ids)
    hashes = {row.take_id: row.labels_hash for row in stored}
    before = _read_segments(connection, [row.id for row in rows])
    changes, tables, places = AnnotationChanges(), [], []
    for row in rows:
        labels, there = wanted[row.id], before.get(row.id, [])
        if labels.is_blank and not there and row.id not in hashes:
            changes += AnnotationChanges(unchanged=(row.path,))
        elif labels.is_blank or hashes.get(row.id) != _hash_labels(labels):
            place, own = _compare(row, labels, there)
            tables.append((row, labels))
            places.append(place)
            changes += own
        elif missing := _find_missing(row, labels, there):
            tables.append((row, labels))  # removed segments would be undecided
            places.append((row, missing, []))
        else:
            changes += AnnotationChanges(unchanged=(row.path,))
    changes += AnnotationChanges(takes=tuple(row.path for row, _, _ in places))
    return _plan(connection, forests, places, _Exchange(tables, changes=changes), known)


def _compare(
    row: Any, labels: Annotation, there: Iterable[TakeSegment]
) -> tuple[tuple[Any, list[Stretch], list[int]], AnnotationChanges]:
    """Return the segments that a new table adds to a take, and the numbers of those to remove."""
    there = list(there)
    kept, notes = fit(TakeLength.of(row), labels.segments)
    known = {(one.start, one.end, one.category): one for one in there}
    stays = {(one.start, one.stop, one.category) for one in kept} & known.keys()
    gone = [one for one in there if (place := (one.start, one.end, one.category)) not in stays or known[place] != one]
    by_hand = sum(one.by_hand for one in gone)
    if len(gone) > by_hand:
        notes.append(Message("annotations.removed", n=len(gone) - by_hand))
    if by_hand:
        notes.append(Message("annotations.by_hand_gone", n=by_hand))
    changes = AnnotationChanges(warnings=tuple((row.path, note) for note in notes))
    new = [one for one in kept if (one.start, one.stop, one.category) not in stays]
    return (row, new, [one.clip_id for one in gone]), changes


def _plan(
    connection: sa.Connection,
    forests: ForestCache,
    places: Sequence[tuple[Any, Sequence[Stretch], Sequence[int]]],
    exchange: _Exchange,
    known: _Exchange | None,
) -> _Exchange:
    """Build the records of new segments, and their consequences."""
    gone = [clip_id for _, _, ids in places for clip_id in ids]
    records: list[ClipRecord] = []
    for row, new, _ in places:
        if new:
            (motion,) = load_motions(connection, [row.id])  # one at a time: takes are long
            taken = _read_paths(connection, row.id) - _read_paths(connection, row.id, gone)
            for one in new:
                number, path = 1, name_path(row.path, one.start, one.stop)
                while path in taken:
                    number += 1
                    path = name_path(row.path, one.start, one.stop, number)
                taken.add(path)
                records.append(_make_record(row, motion, one, path, number, exchange.by_hand))
    arrival = None
    if records:
        # Loaded again: another program may have trained the library.
        arrival = describe_arrival(forests.renew(connection), records, known.arrival if known else None)
    changes = exchange.changes + AnnotationChanges(n_segments=len(records), n_removed=len(gone))
    return replace(exchange, records=records, gone=gone, arrival=arrival, changes=changes)


def _exchange(connection: sa.Connection, planned: _Exchange) -> tuple[AnnotationChanges, list[int]]:
    """Replace segments; return the changes, and the numbers of the new ones."""
    if not (planned.tables or planned.records or planned.gone):
        return planned.changes, []
    revision = next_revision(connection)
    takes = {row.id for row, _ in planned.tables}
    named = next((str(one.row["category"]) for one in planned.records if planned.by_hand), None)
    kind, values = ("label", {}) if named is None else ("name", {"category": named})
    with recording(connection, revision, kind, gone=planned.gone, takes=takes, values=values):
        ids = _write_exchange(connection, planned)
    return planned.changes, ids


def _write_exchange(connection: sa.Connection, planned: _Exchange) -> list[int]:
    """Write the exchange and return the numbers of the new segments."""
    delete_clips(connection, planned.gone)
    table = schema.take_annotations
    delete_rows(connection, table, [row.id for row, _ in planned.tables])
    rows = [
        {
            "take_id": row.id,
            "source": labels.source,
            "tier": labels.tier,
            "labels_hash": _hash_labels(labels),
            "unclear": [list(span) for span in labels.unclear],
        }
        for row, labels in planned.tables
        if not labels.is_blank
    ]
    insert_rows(connection, table, rows)
    if planned.arrival is None:
        return []
    insert_clips(connection, planned.records, planned.arrival)
    paths = [record.path for record in planned.records]
    clips = schema.clips.c
    numbers = {row.path: row.id for row in fetch_in(connection, sa.select(clips.id, clips.path), clips.path, paths)}
    return [numbers[path] for path in paths]


def name_path(take: str, start: float, stop: float, number: int = 1) -> str:
    """Return the name of a segment: the take's path with the time as a W3C media fragment.

    Segments at the same time get a number, from 2.
    """
    return f"{take}{_TIME}{start:.3f},{stop:.3f}" + (f"&id={number}" if number > 1 else "")


def _read_paths(connection: sa.Connection, take_id: int, among: Sequence[int] | None = None) -> set[str]:
    clips, table = schema.clips.c, schema.segments.c
    query = sa.select(clips.path).join(schema.segments, clips.id == table.clip_id).where(table.take_id == take_id)
    if among is not None:
        return {row.path for row in fetch_in(connection, query, clips.id, among)}
    return set(connection.execute(query).scalars())


def rename_segments(connection: sa.Connection, take: str) -> None:
    """Rename the segments of a take after its new path."""
    clips, table = schema.clips.c, schema.segments.c
    owner = sa.select(clips.id).where(clips.path == take)
    query = sa.select(clips.id, clips.path).join(schema.segments, clips.id == table.clip_id)
    rows = connection.execute(query.where(table.take_id.in_(owner))).all()
    paths = {row.id: take + _TIME + row.path.rpartition(_TIME)[2] for row in rows}
    update_rows(connection, LABELS, {number: {"path": path} for number, path in paths.items()})


def _make_record(row: Any, motion: StoredMotion, segment: Stretch, path: str, number: int, by_hand: bool) -> ClipRecord:
    first, stop = TakeLength.of(row).find_frames(segment)
    part = StoredMotion(motion.positions[first:stop], motion.frame_rate, motion.height)
    named = f"{row.content_hash} {row.id} {segment.start} {segment.stop} {segment.category}"
    named += f" {number}" if number > 1 else ""  # one of the same name may have been renamed since
    values = {
        "path": path,
        "content_hash": hashlib.sha256(named.encode()).hexdigest(),
        "fingerprint": "",
        "size": 0,
        "category": segment.category,
        "kind": schema.CLIP,
        "n_frames": stop - first,
        "duration": (stop - first) / row.frame_rate,
        "warnings": [],
    }
    same = ("read_options", "performer", "format", "frame_rate", "height", "joint_table", "absent")
    place = {"take_id": row.id, "first_frame": first, "start_s": segment.start, "end_s": segment.stop}
    return ClipRecord(
        {**values, **{name: getattr(row, name) for name in same}}, part, None, place={**place, "by_hand": by_hand}
    )


def _read_segments(connection: sa.Connection, take_ids: Sequence[int]) -> dict[int, list[TakeSegment]]:
    """Read segments by number of their take, in the order of time."""
    clips, table = schema.clips.c, schema.segments.c
    query = sa.select(*SEGMENTS.columns, clips.category)
    query = query.join(schema.clips, clips.id == table.clip_id)
    found: dict[int, list[TakeSegment]] = {}
    for row in fetch_in(connection, query, table.take_id, take_ids):
        SEGMENTS.check(connection, row)
        one = TakeSegment(row.clip_id, row.start_s, row.end_s, row.category, bool(row.by_hand))
        found.setdefault(row.take_id, []).append(one)
    for some in found.values():
        some.sort(key=lambda one: (one.start, one.end, one.clip_id))
    return found


def read_annotations(connection: sa.Connection, take_ids: Sequence[int] | None = None) -> list[TakeAnnotation]:
    """Read the labels of takes, in the order of their numbers; by default of all takes with labels."""
    if take_ids is None:
        some = sa.union(sa.select(schema.take_annotations.c.take_id), sa.select(schema.segments.c.take_id))
        take_ids = sorted(connection.execute(some).scalars())
    rows = _read_takes(connection, take_ids)
    segments = _read_segments(connection, take_ids)
    known = {row.take_id: row for row in fetch_rows(connection, ANNOTATIONS, take_ids)}
    answers = []
    for row in rows:
        own = known.get(row.id)
        unclear = tuple((float(a), float(b)) for a, b in own.unclear) if own else ()
        parts_of = tuple(segments.get(row.id, ()))
        where = (own.source, own.tier) if own else ("", "")
        answers.append(TakeAnnotation(row.id, row.path, row.duration, own is not None, parts_of, unclear, *where))
    return answers


def load_annotated_takes(connection: sa.Connection, take_ids: Sequence[int] | None = None) -> Iterator[AnnotatedTake]:
    """Yield takes with labels and their motion, one in memory at a time; by default all takes with labels."""
    found = read_annotations(connection, take_ids)
    rows = {row.id: row for row in _read_takes(connection, [one.take_id for one in found])}
    for one in found:
        (motion,) = load_motions(connection, [one.take_id])
        performer = rows[one.take_id].performer
        yield AnnotatedTake(one.path, performer, motion.positions, motion.frame_rate, motion.height, one.stretches)


class Annotations:
    """Labels of the takes of a library, ``Library.annotations``."""

    def __init__(
        self, database: Database, forests: ForestCache, one_change: Callable[[], AbstractContextManager[None]]
    ) -> None:
        self._database = database
        self._forests = forests
        self._one_change = one_change

    def read(self, takes: Iterable[int] | None = None) -> list[TakeAnnotation]:
        """Read the labels of takes by their numbers, by default of all with labels; missing takes are left out."""
        with self._database.reading() as connection:
            return read_annotations(connection, _known_ids(takes))

    def load(self, takes: Iterable[int] | None = None) -> Iterator[AnnotatedTake]:
        """Yield takes with their motion and their labels from beginning to end, one in memory at a time.

        Takes as in ``read``. LibraryDamagedError if the numbers of one are damaged.
        """
        with self._database.reading() as connection:
            yield from load_annotated_takes(connection, _known_ids(takes))

    def write(self, take: int, labels: Annotation, *, n_jobs: int | None = None) -> AnnotationChanges:
        """Replace the labels of a take from beginning to end.

        Its segments become clips; a trained forest learns them at once.

        Parameters
        ----------
        take : number.
        labels : cut at the end of the take, and left out beyond it; they may overlap. Empty labels state that the take
            shows nothing; blank ones (``is_blank``) remove all labels.
        n_jobs : takes described at a time, as in ``Library.add``.

        Raises
        ------
        OptionError : times that are no numbers, an end that is not after its beginning, an empty or too long category;
            labels without a source of which none lies in the take. Nothing changes.
        MotionFileError : labels of a table, none of which lies in the take.
        LibraryError : no take of this number, or the library cannot be written.
        """
        return self.write_all({take: labels}, n_jobs=n_jobs)

    def write_all(self, labels: Mapping[int, Annotation], *, n_jobs: int | None = None) -> AnnotationChanges:
        """Replace the labels of several takes, by number; takes with the same labels are not touched."""
        for take in labels:
            self._check_take(take)
        with self._one_change():
            changes = annotate_takes(self._database, labels, self._forests)
        self._refresh(n_jobs)
        return changes

    def name(
        self,
        take: int,
        start: float,
        end: float,
        category: str,
        *,
        instead_of: str | None = None,
        n_jobs: int | None = None,
    ) -> int | None:
        """Name a part of a take by hand, and replace the segment at about the same time.

        Parameters
        ----------
        take : number.
        start, end : s.
        category : of the part.
        instead_of : replace only a segment of this category, if several overlap.
        n_jobs : as in ``write``.

        Returns
        -------
        The number of the new clip; None for a part of less than two frames.

        Raises
        ------
        OptionError : an empty category; times that are no numbers, an end that is not after the beginning, a part
            outside the take.
        LibraryError : no take of this number, or the library cannot be written.
        """
        if not category.strip():
            raise OptionError("library_clips.empty_label")
        check_text(category)
        check_times(start, end, category)
        self._check_take(take)
        part = Stretch(start, end, category)
        with self._one_change():
            number = name_segment(self._database, take, part, self._forests, instead_of)
        self._refresh(n_jobs)
        return number

    def _check_take(self, number: int) -> None:
        with self._database.reading() as connection:
            row = find_row(connection, self._database.where, number)
        if row.kind != schema.TAKE:
            raise LibraryError("annotations.not_a_take", library=self._database.where, number=number, path=row.path)

    def _refresh(self, n_jobs: int | None) -> None:
        """Describe takes again if the leaves of the forest have learned."""
        if self._forests.last is not None:
            refresh_windows(self._database, self._forests.last, n_jobs)


def _known_ids(takes: Iterable[int] | None) -> list[int] | None:
    return None if takes is None else [number for number in takes if schema.is_id(number)]
