"""The relations of motions, stored when motions are added or first needed, and the meanings of category names."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import sqlalchemy as sa

from dousa.errors import LibraryDamagedError
from dousa.library.store import schema
from dousa.library.store.checksums import RELATIONS
from dousa.library.store.engine import Database, choose_jobs
from dousa.library.store.features import StoredMotion, load_motions
from dousa.library.store.rows import delete_rows, fetch_in, fetch_rows, insert_rows, portions
from dousa.retrieval.words.relations import RELATIONS_VERSION, Relation, find_relations
from dousa.retrieval.words.vocabulary import load_vocabulary, read_words
from dousa.workers.threads import map_pieces

_KINDS = ("action", "side", "direction")


def find_meanings(categories: Iterable[str]) -> dict[str, str]:
    """Return the meaning of each category, the same for names with the same actions, sides and directions.

    "squat1Reps", "squat" and "しゃがむ" mean the same, as do "walk/active" and "walk/tired", but not "wave-left-hand"
    and "wave-right-hand". A name without an action is its own meaning.
    """
    vocabulary = load_vocabulary()
    kinds = {name: concept.kind for name, concept in vocabulary.concepts.items()}
    meanings = {}
    for category in categories:
        named = {word.meanings[0] for word in read_words(vocabulary, category, name=True) if word.meanings}
        kept = sorted(name for name in named if kinds[name] in _KINDS)
        is_action = any(kinds[name] == "action" for name in kept)
        meanings[category] = f"({' '.join(kept)})" if is_action else category
    return meanings


_COUNT_CLIPS = sa.select(sa.func.count()).select_from(schema.clips)


def load_relations(connection: sa.Connection, ids: Sequence[int] | None = None) -> dict[int, tuple[Relation, ...]]:
    """Load the relations of all or some motions, by number, or compute them; LibraryDamagedError if damaged."""
    rows = fetch_rows(connection, RELATIONS, ids, schema.clip_relations.c.version == RELATIONS_VERSION)
    found = {row.clip_id: _from_json(row.relations) for row in rows}
    return found | _compute(connection, _list_missing(connection, ids))


def keep_relations(connection: sa.Connection) -> None:
    """Compute and write the relations of all clips and takes that have none."""
    table = schema.clip_relations
    kept = sa.select(sa.func.count()).select_from(table).where(table.c.version == RELATIONS_VERSION)
    # Counted first, as a join reads all stored relations.
    if connection.execute(kept).scalar_one() < connection.execute(_COUNT_CLIPS).scalar_one():
        _write(connection, _list_missing(connection))


def describe_relations(motion: StoredMotion) -> list[list[Any]]:
    """Compute the relations of a motion in their stored form."""
    return _to_json(find_relations(motion))


def save_relations(connection: sa.Connection, described: Mapping[int, list[list[Any]]]) -> None:
    """Write the relations, by number, of clips and takes that have none."""
    rows = [
        {"clip_id": number, "version": RELATIONS_VERSION, "relations": relations}
        for number, relations in described.items()
    ]
    insert_rows(connection, schema.clip_relations, rows)


def keep_all_relations(database: Database) -> None:
    """Write the missing relations, and those of another version, each portion in its own transaction."""
    with database.reading() as connection:
        missing = _list_missing(connection)
    for some in portions(missing):
        with database.writing() as connection:
            _write(connection, _list_missing(connection, some))


def keep_relations_of(database: Database, motions: Mapping[int, StoredMotion], n_jobs: int | None = 1) -> None:
    """Compute, ``n_jobs`` at a time, and write the missing relations of some clips and takes."""
    with database.reading() as connection:
        missing = _list_missing(connection, list(motions))
    found = map_pieces(describe_relations, [motions[number] for number in missing], choose_jobs(n_jobs))
    described = dict(zip(missing, found, strict=True))
    if described:
        with database.writing() as connection:
            still = _list_missing(connection, missing)
            _replace(connection, {number: described[number] for number in still})


def _list_missing(connection: sa.Connection, ids: Sequence[int] | None = None) -> list[int]:
    """Return the ascending numbers of the existing motions without relations, among some or all."""
    clips, table = schema.clips.c, schema.clip_relations.c
    kept = sa.and_(table.clip_id == clips.id, table.version == RELATIONS_VERSION)
    query = sa.select(clips.id).join(schema.clip_relations, kept, isouter=True).where(table.clip_id.is_(None))
    rows = connection.execute(query).all() if ids is None else fetch_in(connection, query, clips.id, ids)
    return sorted(row.id for row in rows)


def _compute(connection: sa.Connection, ids: Iterable[int]) -> dict[int, tuple[Relation, ...]]:
    numbers = list(ids)
    return dict(zip(numbers, map(find_relations, load_motions(connection, numbers)), strict=True))


def _write(connection: sa.Connection, ids: list[int]) -> None:
    for some in portions(ids):
        found = _compute(connection, some)
        _replace(connection, {number: _to_json(relations) for number, relations in found.items()})


def _replace(connection: sa.Connection, described: Mapping[int, list[list[Any]]]) -> None:
    delete_rows(connection, schema.clip_relations, list(described))
    save_relations(connection, described)


def _to_json(relations: Iterable[Relation]) -> list[list[Any]]:
    return [[one.name, one.part, one.share, one.start, one.end] for one in relations]


def _from_json(stored: Any) -> tuple[Relation, ...]:
    try:
        return tuple(Relation(str(n), str(p), float(share), float(s), float(e)) for n, p, share, s, e in stored)
    except (TypeError, ValueError) as error:
        raise LibraryDamagedError("library_text.relations_damaged", reason=error) from error
