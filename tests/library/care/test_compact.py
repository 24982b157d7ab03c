"""A library gives back the room of clips that were removed."""

import shutil
import sqlite3
from collections import namedtuple
from contextlib import closing

import pytest

from dousa.errors import LibraryError
from dousa.library import Library
from dousa.library.care import compact

pytestmark = pytest.mark.sqlite  # a server sees to its room itself


def test_the_file_shrinks_and_says_the_same(library, library_file):
    library.remove(category="wave")
    library.remove(category="bow")
    before = library.clips(), library.search(library.clips()[0].id, 15), library.revision
    size = library_file.stat().st_size
    report = library.compact()
    assert (report.before, report.after) == (size, library_file.stat().st_size)
    assert report.after < 0.95 * report.before  # the forest stays as large as it was, which is most of so few clips
    assert (library.clips(), library.search(before[0][0].id, 15), library.revision) == before
    assert library.check().is_sound


def test_another_program_goes_on_reading(library, library_file):
    with Library.open(library_file) as other:
        other.search(1)
        library.remove(category="wave")
        library.compact()
        assert len(other.clips()) == 10
        assert other.search(1, 100).results


def test_too_little_room_is_said_before_the_work(library, library_file, monkeypatch):
    usage = namedtuple("usage", "total used free")
    monkeypatch.setattr(shutil, "disk_usage", lambda folder: usage(10**6, 10**6, 1000))
    before = library_file.read_bytes()
    with pytest.raises(LibraryError, match="free disk space"):
        library.compact()
    assert library_file.read_bytes() == before


def test_what_cannot_be_written_is_neither_compacted_nor_trained(library_file):
    steps = []
    with Library.open(library_file, read_only=True) as library:
        for change in (library.compact, lambda: library.train(progress=lambda *step: steps.append(step))):
            with pytest.raises(LibraryError, match="read-only"):
                change()
    assert len(steps) <= 1


def test_stopped_in_the_middle_nothing_has_changed(library, library_file, monkeypatch):
    library.remove(category="wave")
    before = library.clips()
    monkeypatch.setitem(compact._vacuum.__kwdefaults__, "steps", 1)
    monkeypatch.setattr("dousa.library.care.compact._go_on", lambda: 1)
    with pytest.raises(KeyboardInterrupt):
        library.compact()
    assert library.clips() == before
    with closing(sqlite3.connect(library_file)) as connection:
        assert connection.execute("PRAGMA integrity_check").fetchone() == ("ok",)
