"""A library on a PostgreSQL server that these tests start; they are skipped where there is none."""

import shutil
import sqlite3
import subprocess
import sys
import threading
from contextlib import closing
from pathlib import Path

import pytest

from dousa import library
from dousa.errors import LibraryError, LibraryVersionError, OptionError
from dousa.library import Library
from library.database_server import connect_plainly

_CREATE = """
import sys
from dousa.library import Library

print("ready", flush=True)
sys.stdin.readline()
Library.open(sys.argv[1], create=True).close()
"""


def run_program(text, *words, **options):
    return subprocess.Popen([sys.executable, "-c", text, *map(str, words)], text=True, **options)


@pytest.mark.slow
@pytest.mark.parametrize("attempt", range(3))
def test_four_programs_make_one_library_at_once(url, attempt):
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    programs = [run_program(_CREATE, url, **pipes) for _ in range(4)]
    for program in programs:
        assert program.stdout.readline() == "ready\n"
    for program in programs:
        program.stdin.write("\n")
        program.stdin.flush()
    for program in programs:
        program.communicate()
    assert [program.returncode for program in programs] == [0, 0, 0, 0]
    with Library.open(url) as library:
        assert library.clips() == []


def test_the_same_answers_as_from_a_file(url, moves, tmp_path, write_move):
    answers = []
    for where in (url, tmp_path / "m.dousa"):
        with Library.open(where, create=True) as library:
            library.add(moves, n_jobs=1)
            library.train(n_trees=10, n_jobs=1)
            library.add(write_move(tmp_path / "in" / "take.bvh", "wave", 3, n_frames=120), kind="take", n_jobs=1)
            take = next(clip for clip in library.clips() if clip.kind == "take")
            part = library.annotations.name(take.id, 0.5, 2.0, "wave")
            found = library.find(1, k=3)
            library.relabel(2, category="nod")
            library.remove(3)
            answers.append(
                (
                    library.categories(),
                    [hit.to_json() for hit in library.search(1, 20, mirror=True).results],
                    [place.to_json() for place in found.results],
                    library.trajectories(part).positions.tobytes(),
                    [hit.path for hit in library.search_text("wave").results],
                    library.check().is_sound,
                )
            )
    assert answers[0] == answers[1]


def test_damage_is_told_and_repaired(url, moves):
    with Library.open(url, create=True) as library:
        library.add(moves, n_jobs=1)
        with connect_plainly(url) as connection:
            flipped = "set_bit(positions, 77, 1 - get_bit(positions, 77))"
            connection.execute(f"UPDATE clip_trajectories SET positions = {flipped}")
        assert len(library.check().damage) == 15
        assert library.check(repair=True).is_sound


def test_labels_that_a_server_cannot_keep(url, moves):
    with Library.open(url, create=True) as library:
        library.add(moves, n_jobs=1)
        for label in ("a\0b", "x" * 9000):
            with pytest.raises(OptionError):
                library.relabel(1, category=label)
        library.relabel(1, category="é" * 500)


pytest.importorskip("psycopg", reason="the driver psycopg is not installed")


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


@pytest.mark.parametrize("number", [16, 18])
def test_tables_of_another_version_are_refused_and_not_changed(url, library_file, tmp_path, number):
    """Of a database, where it is opened; of a file, which nothing is taken from."""
    other = f"UPDATE dousa_migrations SET number = {number}"
    shutil.copy(library_file, tmp_path / "other.dousa")
    with closing(sqlite3.connect(tmp_path / "other.dousa")) as connection, connection:
        connection.execute(other)
    for attempt in range(2):  # the second time, of a database with tables and without clips
        with pytest.raises(LibraryVersionError, match=rf"tables {number}\b"):
            Library.restore(tmp_path / "other.dousa", url)
        with connect_plainly(url) as connection:
            tables = connection.execute("SELECT 1 FROM pg_tables WHERE tablename = 'clips'").fetchall()
        assert len(tables) == attempt
        Library.open(url, create=True).close()
    Library.restore(library_file, url)
    with connect_plainly(url) as connection:
        connection.execute(other)
    for visit in (
        lambda: Library.open(url),
        lambda: Library.open(url, create=True),
        lambda: Library.restore(library_file, url),
        lambda: Library.restore(url, tmp_path / "again.dousa"),
    ):
        with pytest.raises(LibraryVersionError, match=rf"tables {number}\b"):
            visit()
    assert not (tmp_path / "again.dousa").exists() and not list(tmp_path.rglob("*.part"))


def test_few_modules_speak_sqlite():
    own = {"engine.py", "backup.py", "compact.py", "damage.py", "repair.py", "side_file.py"}
    texts = {path.name: path.read_text(encoding="utf-8") for path in Path(library.__file__).parent.rglob("*.py")}
    words = ("exec_driver_sql", "sqlite3", "sa.text(")
    assert {name for name, text in texts.items() if any(word in text for word in words)} <= own
