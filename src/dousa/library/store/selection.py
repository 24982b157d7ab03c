"""Choosing clips by number, path, folder or label."""

from __future__ import annotations

import enum
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeVar

import sqlalchemy as sa

from dousa.errors import LibraryError, OptionError
from dousa.formats.motion_files import is_unicode
from dousa.library.label_rules import fits_category
from dousa.library.results import ClipInfo, LibraryStats
from dousa.library.store import schema
from dousa.library.store.checksums import LABELS, NUMBERS, TAGS
from dousa.library.store.engine import note_changed_clips, read_revision
from dousa.library.store.rows import delete_rows, fetch_in, fetch_rows, insert_rows, portions, update_rows
from dousa.messages import Message

Item = TypeVar("Item")

Selection = int | str | os.PathLike[str] | Iterable[int | str | os.PathLike[str]]
"""One clip or several: numbers, paths of files, or folders, which stand for all clips below them."""


class Unchanged(enum.Enum):
    """The type of ``UNCHANGED``."""

    UNCHANGED = enum.auto()


UNCHANGED = Unchanged.UNCHANGED
"""Leaves a label as it is, while None removes it."""


def select_ids(
    connection: sa.Connection,
    where: str,
    selection: Selection,
    category: str | None,
    performer: str | None,
    tag: str | None = None,
) -> list[int]:
    """Return the numbers of the chosen clips, ascending.

    OptionError if nothing is chosen at all; LibraryError for a number or path that fits no clip.

    ``selection`` : clips; if empty, all clips of the given labels.
    ``category`` : only clips of it, as `fits_category` reads it; ``performer``, ``tag`` : of this label, with this tag.
    """
    items = [selection] if isinstance(selection, int | str | os.PathLike) else list(selection)
    if not items and category is None and performer is None and tag is None:
        raise OptionError("library_clips.nothing_chosen")
    table = schema.clips.c
    query = sa.select(table.id)
    if category is not None:
        names = connection.execute(sa.select(table.category).distinct()).scalars()
        query = query.where(table.category.in_([category, *(name for name in names if fits_category(name, category))]))
    if performer is not None:
        query = query.where(table.performer == performer)
    tagged = None if tag is None else {number for number, tags in read_tags(connection).items() if tag in tags}

    def find(*narrower: sa.ColumnElement[bool]) -> set[int]:
        found = set(connection.execute(query.where(*narrower)).scalars())
        return found if tagged is None else found & tagged

    if not items:
        found = find()
        if not found:
            raise _none_of(connection, where, category, performer, tag)
        return sorted(found)
    numbers = [item for item in items if isinstance(item, int) and schema.is_id(item)]
    known = {number for some in portions(numbers) for number in find(table.id.in_(some))}
    chosen: set[int] = set()
    for item in items:
        if not isinstance(item, int):
            chosen |= _below(find, item, where)
        elif item in known:
            chosen.add(item)
        else:
            raise LibraryError("library_clips.no_clip", library=where, number=item)
    return sorted(chosen)


def _none_of(
    connection: sa.Connection, where: str, category: str | None, performer: str | None, tag: str | None, most: int = 5
) -> LibraryError:
    if tag is not None:
        return LibraryError("library_tags.none_of_tag", library=where, tag=tag)
    if performer is None:
        names = connection.execute(sa.select(schema.clips.c.category).distinct()).scalars()
        near = sorted(name for name in names if name is not None and str(category).casefold() in name.casefold())
        if near:
            return LibraryError("library_clips.part_of_category", library=where, category=category, near=near[:most])
        return LibraryError("library_clips.none_of_category", library=where, category=category)
    if category is None:
        return LibraryError("library_clips.none_of_performer", library=where, performer=performer)
    return LibraryError("library_clips.none_of_both", library=where, category=category, performer=performer)


def _below(find: Callable[..., set[int]], item: str | os.PathLike[str], where: str) -> set[int]:
    path, column = os.path.abspath(item), schema.clips.c.path
    below = path.rstrip(os.sep) + os.sep
    names = [path, os.fspath(item)]  # motions from memory have a name that is no path
    found: set[int] = set()
    if all(map(is_unicode, names)):  # else no database can store it
        found = find(column.in_(names) | (sa.func.substr(column, 1, len(below)) == below))
    if not found:
        raise LibraryError("library_clips.no_path", library=where, path=item)
    return found


def find_row(connection: sa.Connection, where: str, number: int) -> Any:
    """Read ``id``, ``path``, ``kind`` and ``absent`` of a clip or take; LibraryError if there is none."""
    table = schema.clips.c
    query = sa.select(table.id, table.path, table.kind, table.absent).where(table.id == number)
    row = connection.execute(query).one_or_none() if schema.is_id(number) else None
    if row is None:
        raise LibraryError("library_clips.no_clip_or_take", library=where, number=number)
    return row


def list_clips(connection: sa.Connection, ids: Sequence[int] | None = None) -> list[ClipInfo]:
    """Return clips and takes without their arrays, sorted by path; all, or those of these numbers."""
    if ids is None:
        infos, last = [], 0
        while page := read_page(connection, last):
            infos += page
            last = page[-1].id
    else:
        infos = [info for some in portions(ids) for info in _read_infos(connection, schema.clips.c.id.in_(some))]
    # Sorted here: databases differ in how they order text.
    return sorted(infos, key=lambda info: info.path)


def read_page(
    connection: sa.Connection,
    after: int,
    category: str | None = None,
    performer: str | None = None,
    *,
    most: int = 1000,
) -> list[ClipInfo]:
    """Read the next page, ``most`` clips and takes, in the order of their numbers; of these labels if given."""
    table = schema.clips.c
    wanted = [table.id > after]
    wanted += [
        column == value
        for column, value in ((table.category, category), (table.performer, performer))
        if value is not None
    ]
    return _read_infos(connection, *wanted, limit=most)


def _read_infos(connection: sa.Connection, *wanted: sa.ColumnElement[bool], limit: int | None = None) -> list[ClipInfo]:
    """Read clips and takes without their arrays, in the order of their numbers."""
    clips, leaves, parts = schema.clips, schema.clip_leaves, schema.segments
    own = tuple(dict.fromkeys((*LABELS.columns, *NUMBERS.columns)))
    more = (leaves.c.predicted_category, parts.c.take_id, parts.c.start_s, parts.c.end_s)
    query = sa.select(*own, *more)
    query = query.join(leaves, leaves.c.clip_id == clips.c.id, isouter=True)
    query = query.join(parts, parts.c.clip_id == clips.c.id, isouter=True)
    rows = connection.execute(query.where(*wanted).order_by(clips.c.id).limit(limit)).all()
    if not rows:
        return []
    columns = dict(zip((*own, *more), zip(*rows, strict=True), strict=True))
    for seal in (LABELS, NUMBERS):
        seal.check_all(connection, [columns[column] for column in seal.columns])
    tagged = read_tags(connection, columns[clips.c.id])
    values: dict[str, Iterable[Any]] = {column.name: found for column, found in columns.items()}
    values["warnings"] = [tuple(map(Message.from_json, own)) for own in columns[clips.c.warnings]]
    values["absent"] = [tuple(own.split()) for own in columns[clips.c.absent]]
    values["tags"] = [tagged.get(number, ()) for number in columns[clips.c.id]]
    return list(map(ClipInfo, *(values[name] for name in ClipInfo.__dataclass_fields__)))


@dataclass(frozen=True, slots=True, eq=False)
class KnownClips:
    """Clips and takes as read before, by number, with the checksums of their rows to find changes."""

    clips: Mapping[int, ClipInfo] = field(default_factory=dict)
    sums: Mapping[int, tuple[Any, ...]] = field(default_factory=dict)


def renew_clips(connection: sa.Connection, known: KnownClips) -> KnownClips:
    """Return the current clips and takes; only rows with changed checksums are read."""
    sums = _read_sums(connection)
    changed = [number for number, own in sums.items() if known.sums.get(number) != own]
    fresh = list_clips(connection, None if len(changed) > len(sums) // 2 else changed)
    clips = {**known.clips, **{clip.id: clip for clip in fresh}}
    return KnownClips({number: clips[number] for number in sums if number in clips}, sums)


def _read_sums(connection: sa.Connection) -> dict[int, tuple[Any, ...]]:
    """Return the checksums of the rows of each ``ClipInfo``, by number."""
    clips = schema.clips.c
    query = sa.select(clips.id, clips.label_checksum, clips.checksum)
    sums = {row[0]: tuple(row) for row in connection.execute(query)}
    for table in (schema.clip_leaves.c, schema.segments.c, schema.clip_tags.c):
        for number, own in connection.execute(sa.select(table.clip_id, table.checksum)):
            if number in sums:
                sums[number] = (*sums[number], table.checksum.table.name, own)
    return sums


def read_tags(connection: sa.Connection, ids: Sequence[int] | None = None) -> dict[int, tuple[str, ...]]:
    """Return the tags of clips and takes that have some, by number; of all, or of these."""
    return {row.clip_id: tuple(row.tags) for row in fetch_rows(connection, TAGS, ids)}


def save_tags(connection: sa.Connection, tags: Mapping[int, Iterable[str]]) -> None:
    """Replace the tags of clips and takes; after ``next_revision``."""
    delete_rows(connection, schema.clip_tags, list(tags))
    rows = [{"clip_id": number, "tags": sorted(set(own))} for number, own in tags.items()]
    insert_rows(connection, schema.clip_tags, [row for row in rows if row["tags"]])


def list_paths(connection: sa.Connection, ids: Sequence[int]) -> list[str]:
    """Return the sorted paths of clips and takes, including damaged ones."""
    return sorted(row.path for row in fetch_in(connection, sa.select(schema.clips.c.path), schema.clips.c.id, ids))


def count_by(connection: sa.Connection, label: str) -> dict[str, int]:
    """Return the number of clips of each category, or of clips and takes of each performer."""
    column = schema.clips.c[label]
    query = sa.select(column, sa.func.count()).where(column.is_not(None)).group_by(column)
    if label == "category":
        query = query.where(schema.clips.c.kind == schema.CLIP)
    return {row[0]: int(row[1]) for row in sorted(connection.execute(query).all(), key=lambda row: row[0])}


def summarise(connection: sa.Connection) -> LibraryStats:
    """Return the library in numbers."""
    clips, forests = schema.clips.c, schema.forests.c
    sums = (sa.func.count(), sa.func.sum(clips.n_frames), sa.func.sum(clips.duration), sa.func.count(clips.category))
    by_kind = {
        kind: connection.execute(sa.select(*sums).select_from(schema.clips).where(clips.kind == kind)).one()
        for kind in (schema.CLIP, schema.TAKE)
    }
    n_clips, n_frames, seconds, n_labelled = by_kind[schema.CLIP]
    n_takes, _, take_seconds, _ = by_kind[schema.TAKE]
    columns = (forests.trained_at, forests.n_clips, forests.n_learned, forests.parameters, forests.revision)
    forest = connection.execute(sa.select(*columns)).one_or_none()
    changed = connection.execute(sa.select(schema.library_state.c.clips_revision)).scalar_one_or_none()
    revision = read_revision(connection)
    return LibraryStats(
        n_clips=int(n_clips),
        n_frames=int(n_frames or 0),
        seconds=float(seconds or 0.0),
        n_takes=int(n_takes),
        take_seconds=float(take_seconds or 0.0),
        n_unlabelled=int(n_clips - n_labelled),
        categories=count_by(connection, "category"),
        performers=count_by(connection, "performer"),
        trained_at=forest.trained_at if forest else None,
        n_trained=int(forest.n_clips) if forest else 0,
        n_learned=int(forest.n_learned) if forest else 0,
        parameters=dict(forest.parameters) if forest else {},
        forest_is_current=bool(forest and forest.revision >= (changed or 0)),
        revision=revision,
    )


def delete_clips(connection: sa.Connection, ids: Sequence[int]) -> None:
    """Remove clips and takes with all their arrays and segments, after ``next_revision`` in the same transaction."""
    ids = with_segments(connection, ids)
    if _any_clip(connection, ids):
        note_changed_clips(connection)
    delete_rows(connection, schema.clips, ids)


def with_segments(connection: sa.Connection, ids: Sequence[int]) -> list[int]:
    """Return these numbers, and those of the segments of the takes among them."""
    table = schema.segments.c
    found = fetch_in(connection, sa.select(table.clip_id), table.take_id, ids)
    return sorted({*ids, *(row.clip_id for row in found)})


def _any_clip(connection: sa.Connection, ids: Sequence[int]) -> bool:
    table = schema.clips.c
    query = sa.select(sa.func.count()).select_from(schema.clips).where(table.kind == schema.CLIP)
    return any(connection.execute(query.where(table.id.in_(some))).scalar_one() for some in portions(ids))


def set_labels(
    connection: sa.Connection, ids: Sequence[int], category: str | Unchanged | None, performer: str | Unchanged | None
) -> None:
    """Change the category or performer of clips and takes, after ``next_revision`` in the same transaction."""
    if category is not UNCHANGED and _any_clip(connection, ids):
        note_changed_clips(connection)
    given: dict[str, Any] = {"category": category, "performer": performer}
    for name, value in given.items():
        if value is UNCHANGED:
            continue
        # A take and its segments have the same performer.
        chosen = ids if name == "category" else with_segments(connection, ids)
        update_rows(connection, LABELS, {clip_id: {name: value} for clip_id in chosen})


def read_doubts(connection: sa.Connection, clip_id: int) -> tuple[Message, ...]:
    """Return the warnings from reading the file of a clip or take."""
    table = schema.clips.c
    found = connection.execute(sa.select(table.warnings).where(table.id == clip_id)).scalar_one_or_none()
    return choose_doubts(map(Message.from_json, found or ()))


def choose_doubts(doubts: Iterable[Message]) -> tuple[Message, ...]:
    """Return the warnings that a result does not state itself, as it does for a body that lacks joints."""
    return tuple(doubt for doubt in doubts if doubt.code != "canonical.part")
