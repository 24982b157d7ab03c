"""Undoing and redoing in a library on a PostgreSQL server; skipped where there is none."""

from __future__ import annotations

import threading

import pytest

from dousa.errors import LibraryError
from dousa.library import Library

pytest.importorskip("psycopg", reason="the driver psycopg is not installed")


def rows(library):
    return [(clip.id, clip.path, clip.category, clip.performer, clip.tags) for clip in library.clips()]


def test_changes_come_back_with_the_same_answers(url, moves, write_move, tmp_path):
    with Library.open(url, create=True) as library:
        library.add(moves, n_jobs=1)
        library.train(n_trees=10, n_jobs=1)
        library.add(write_move(tmp_path / "in" / "take.bvh", "wave", 3, n_frames=120), kind="take", n_jobs=1)
        (take,) = [clip.id for clip in library.clips() if clip.kind == "take"]
        before, answers = rows(library), [hit.to_json() for hit in library.search(1, 20).results]
        library.annotations.name(take, 0.5, 2.0, "wave")
        library.tag([1, 2], add=["夜", "draft"])
        library.relabel([2, 3], category="nod", performer="p")
        library.remove([3, 4, take])
        assert [entry.kind for entry in library.journal()] == ["remove", "relabel", "tag", "name", "add", "add"]
        library.undo()
        assert library.find(1, k=1).results
        for _ in range(2):
            library.undo()
        with Library.open(url) as other:
            other.undo()
        assert rows(library) == before
        assert [hit.clip_id for hit in library.search(1, 20).results] == [hit["clip_id"] for hit in answers]
        for _ in range(4):
            library.redo()
        assert not {3, 4, take} & {clip.id for clip in library.clips()}
        assert library.check().is_sound
        assert library.compact().forgotten > 0
        assert library.journal() == []


def test_of_several_who_undo_one_change_one_does(url, moves):
    with Library.open(url, create=True) as library:
        library.add(moves, n_jobs=1)
        library.remove([1, 2, 3])
        number = library.journal()[0].number
    outcomes = []

    def undo():
        with Library.open(url, timeout=30.0) as own:
            try:
                outcomes.append(own.undo(number).kind)
            except LibraryError as error:
                outcomes.append(error.code)

    threads = [threading.Thread(target=undo) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(outcomes) == ["journal.undone_already"] * 3 + ["remove"]
    with Library.open(url) as library:
        assert library.check().is_sound


@pytest.mark.usefixtures("url")
def test_the_tables_of_an_older_dousa_get_a_journal(url, moves):
    import sqlalchemy as sa

    from dousa.library.store import schema

    with Library.open(url, create=True) as library:
        library.add(moves, n_jobs=1)
        with library.database.writing() as connection:
            for table in (*reversed(schema.JOURNAL_TABLES), schema.clip_tags, schema.saved_searches):
                table.drop(connection)
            connection.execute(sa.delete(schema.migrations).where(schema.migrations.c.number >= 11))
    with Library.open(url) as library:
        assert library.journal() == []
        library.remove([1])
        library.undo()
        assert len(library.clips()) == 15
