"""Nothing in the tables or questions is for SQLite only."""

from pathlib import Path

import pytest
from sqlalchemy import event
from sqlalchemy.dialects import postgresql
from sqlalchemy.schema import CreateIndex, CreateTable

from dousa import library as library_room
from dousa.library import Library
from dousa.library.store import schema

ROOM = Path(library_room.__file__).parent


def test_the_tables_can_be_made_in_postgresql():
    dialect = postgresql.dialect()
    for table in schema.metadata.sorted_tables:
        text = str(CreateTable(table).compile(dialect=dialect))
        assert "SERIAL" not in text  # numbers are ours
        for index in table.indexes:
            assert str(CreateIndex(index).compile(dialect=dialect))


@pytest.mark.sqlite
def test_every_question_can_be_asked_in_postgresql(tmp_path, moves, write_move):
    asked = []
    with Library.open(tmp_path / "m.dousa", create=True) as library:
        event.listen(library.database.engine, "before_execute", lambda c, element, *rest: asked.append(element))
        library.add(moves)
        library.train(n_trees=3)
        library.add(write_move(tmp_path / "a.bvh", seed=50))
        write_move(tmp_path / "a.bvh", seed=51)
        library.add(tmp_path / "a.bvh")
        library.add(write_move(tmp_path / "take.bvh", n_frames=90), kind="take")
        library.add(write_move(tmp_path / "new" / "kick" / "b.bvh", seed=52).parents[1])
        library.find(1)
        library.label(tmp_path / "take.bvh")
        library.search_text("bow")
        library.search(moves / "bow" / "bow_p0.bvh", mirror=True, explain=True)
        library.classify(moves / "bow")
        library.clips(category="bow", performer=None)
        library.trajectories(1)
        library.relabel([1, 2], category="x", performer=None)
        library.remove(category="wave")
        library.stats()
    assert len(asked) > 30
    compiled = {str(element.compile(dialect=postgresql.dialect())) for element in asked}
    for written in ("INSERT INTO clip_leaves", "INSERT INTO take_windows", "UPDATE forests"):
        assert any(written in text for text in compiled)
    assert not any("PRAGMA" in text for text in compiled)


@pytest.mark.parametrize(
    "module",
    sorted(
        {".".join(path.relative_to(ROOM).with_suffix("").parts) for path in ROOM.rglob("*.py")}
        - {
            "store.engine",
            "store.log_marks",
            "care.backup",
            "care.compact",
            "care.damage",
            "care.repair",
            "search.side_file",
        }
    ),
)
def test_only_the_engine_speaks_sqlite(module):
    import importlib
    import inspect

    source = inspect.getsource(importlib.import_module(f"dousa.library.{module}"))
    assert "exec_driver_sql" not in source and "sqlite3" not in source and "sa.text(" not in source
