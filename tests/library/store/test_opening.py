"""Opening libraries: good, missing, damaged, locked, of another version, read-only, on a full disk."""

import importlib
import os
import shutil
import sqlite3
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import pytest
import sqlalchemy as sa
from sqlalchemy import event

from dousa.errors import LibraryDamagedError, LibraryError, LibraryLockedError, LibraryVersionError, OptionError
from dousa.library import Library
from dousa.library.store import engine as _engine
from dousa.motion.synthetic import draw_performer, make_motion
from fuzzing import count_tries
from library.database_server import address, connect_plainly, run_sql


def change(path: Path, *statements: str) -> None:
    for statement in statements:
        run_sql(path, statement)


@pytest.mark.sqlite
def test_create_makes_a_library_and_opens_it_again(tmp_path):
    path = tmp_path / "any name"
    with Library.open(path, create=True) as library:
        assert library.stats().n_clips == 0
    with Library.open(path, create=True) as library, Library.open(str(path)) as again:
        assert library.stats() == again.stats()
    assert os.listdir(tmp_path) == ["any name"]  # no log is left behind
    with closing(sqlite3.connect(path)) as connection:
        assert connection.execute("PRAGMA journal_mode").fetchone() == ("wal",)


@pytest.mark.sqlite
def test_a_program_that_opens_it_twice_keeps_its_log(tmp_path):
    """To open a file and close it gives up a program's locks on it; another one would then take its log away."""
    path = tmp_path / "moves.dousa"
    visit = f"from dousa.library import Library\nwith Library.open({os.fspath(path)!r}) as library: library.clips()"
    with Library.open(path, create=True) as library:
        assert library.clips() == []
        with Library.open(path) as again:
            assert again.clips() == []
        log = os.stat(f"{path}-wal").st_ino
        subprocess.run([sys.executable, "-c", visit], check=True)
        assert os.stat(f"{path}-wal").st_ino == log
        library.add_motion(make_motion("walk", draw_performer(0)), "walk", "walk")
        with Library.open(path) as again:
            assert [clip.path for clip in again.clips()] == ["walk"]
    with closing(sqlite3.connect(path)) as connection:
        assert connection.execute("PRAGMA integrity_check").fetchone() == ("ok",)


@pytest.mark.sqlite
@pytest.mark.parametrize(
    "content",
    [b"x", b"abc", b"x" * 511, b"x" * 5000, b"garbage " * 1000, bytes(700), b"SQLite format 3\0" + b"x" * 600,
     b"SQLite format 3\0" + b"\xff" * 5000],
)  # fmt: skip
def test_what_is_no_database_is_left_as_it_was(tmp_path, content):
    path = tmp_path / "notes.dousa"
    path.write_bytes(content)
    for create in (True, False):
        with pytest.raises(LibraryDamagedError, match=r"not a dousa library|damaged"):
            Library.open(path, create=create)
    assert path.read_bytes() == content
    assert os.listdir(tmp_path) == ["notes.dousa"]


@pytest.mark.sqlite
def test_ctrl_c_within_a_query_gives_the_lock_back(library_file):
    """What is finished is written while the interrupt is still on its way."""

    def interrupt(*asked):
        event.remove(library.database.engine, "after_cursor_execute", interrupt)
        raise KeyboardInterrupt

    with Library.open(library_file, timeout=0.1) as library:
        try:
            with library.database.writing() as connection:
                event.listen(library.database.engine, "after_cursor_execute", interrupt)
                connection.execute(sa.text("SELECT * FROM clips"))
        except KeyboardInterrupt:
            library.tag([1], add=["afterwards"])
        assert library.tags() == {"afterwards": 1}


def test_a_missing_library_says_how_to_make_one(tmp_path):
    with pytest.raises(LibraryError, match=r"no library at .*m\.dousa; make one with: dousa add m\.dousa PATH"):
        Library.open(tmp_path / "m.dousa")
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("create", [True, False])
def test_a_missing_folder_and_a_folder(tmp_path, create):
    with pytest.raises(LibraryError, match="folder .* does not exist" if create else "no library at"):
        Library.open(tmp_path / "none" / "m.dousa", create=create)
    with pytest.raises(LibraryError, match="this is a folder"):
        Library.open(tmp_path, create=create)


def test_create_and_read_only_contradict(tmp_path):
    with pytest.raises(OptionError):
        Library.open(tmp_path / "m.dousa", create=True, read_only=True)


@pytest.mark.sqlite
@pytest.mark.parametrize("statements", [["CREATE TABLE t (x)"], ["PRAGMA application_id = 7"]])
def test_a_database_of_another_program_is_not_touched(tmp_path, statements):
    path = tmp_path / "m.dousa"
    change(path, *statements)
    before = path.read_bytes()
    with pytest.raises(LibraryDamagedError, match="not a dousa library, but an SQLite database"):
        Library.open(path, create=True)
    assert path.read_bytes() == before


@pytest.mark.sqlite
def test_an_empty_file_is_not_yet_a_library(tmp_path):
    path = tmp_path / "m.dousa"
    path.touch()
    with pytest.raises(LibraryError, match="empty, not yet a library"):
        Library.open(path)
    with Library.open(path, create=True) as library:
        assert library.clips() == []


def use(library: Library, moves: Path) -> None:
    """Everything that reads."""
    for clip in library.clips():
        library.trajectories(clip.id)
    library.search(moves / "bow" / "bow_p0.bvh")
    library.classify(moves / "bow" / "bow_p0.bvh")
    library.stats()
    library.train(n_trees=3)


@pytest.mark.sqlite
@pytest.mark.parametrize("share", [0.01, 0.3, 0.6, 0.9, 0.99])
def test_a_file_that_was_cut_short(library_file, moves, share):
    data = library_file.read_bytes()
    library_file.write_bytes(data[: int(len(data) * share)])
    with pytest.raises(LibraryDamagedError), Library.open(library_file) as library:
        use(library, moves)


@pytest.mark.sqlite
@pytest.mark.fuzz
@pytest.mark.slow
def test_flipped_bytes_give_library_errors_or_nothing(library_file, moves):
    data = library_file.read_bytes()
    step = len(data) // count_tries(40)
    for start in range(100, len(data), step):
        library_file.write_bytes(
            data[:start] + bytes(255 - byte for byte in data[start : start + 64]) + data[start + 64 :]
        )
        try:
            with Library.open(library_file) as library:
                use(library, moves)
        except LibraryError:
            continue


@pytest.mark.parametrize(
    ("statement", "ask"),
    [
        ("UPDATE clip_trajectories SET positions = x'00'", lambda library, moves: library.trajectories(1)),
        ("UPDATE clip_features SET pose_features = zeroblob(12)", lambda library, moves: library.train()),
        ("UPDATE clip_leaves SET leaves = zeroblob(12)", lambda library, moves: library.search(1)),
        (f"UPDATE clip_leaves SET leaves = x'{'ff' * 80}'", lambda library, moves: library.search(1)),
        (f"UPDATE clip_leaves SET leaves = x'{'ffffff00' * 20}'", lambda library, moves: library.search(1)),
        (f"UPDATE clip_features SET pose_features = x'{'ff' * 4480}'", lambda library, moves: library.train()),
        ("UPDATE forests SET parameters = '{}'", lambda library, moves: library.search(1)),
        ("UPDATE forests SET data = zeroblob(5000)", lambda library, moves: library.classify(moves)),
        pytest.param(
            "UPDATE forests SET categories = '[\"a\"'",
            lambda library, moves: library.search(1),
            marks=pytest.mark.sqlite,  # a server takes no broken JSON
        ),
        ('UPDATE forests SET categories = \'["a","b","c"]\'', lambda library, moves: library.classify(moves)),
        pytest.param(
            "UPDATE clips SET warnings = '['", lambda library, moves: library.clips(), marks=pytest.mark.sqlite
        ),
        ("DROP TABLE clips", lambda library, moves: library.clips()),
        ("DELETE FROM library_state", lambda library, moves: library.stats()),
        ("DELETE FROM dousa_migrations", lambda library, moves: library.stats()),
    ],
)
def test_damaged_content(library_file, moves, statement, ask):
    change(library_file, statement)
    with pytest.raises(LibraryDamagedError), Library.open(library_file) as library:
        ask(library, moves)


@pytest.mark.parametrize(
    ("number", "said"),
    [
        (99, r"dousa 9\.9\.9 \(tables 99\).*pip install --upgrade dousa"),
        (16, "preview of dousa .tables 16, now 17.*dousa add NEW"),
    ],
)
def test_a_library_of_another_version_is_refused(library_file, tmp_path, number, said):
    change(library_file, f"UPDATE dousa_migrations SET number = {number}, dousa_version = '9.9.9'")
    for visit in (
        lambda: Library.open(library_file),
        lambda: Library.open(library_file, read_only=True),
        lambda: Library.restore(address(library_file), tmp_path / "new.dousa"),
    ):
        with pytest.raises(LibraryVersionError, match=said):
            visit()
    assert not (tmp_path / "new.dousa").exists()


def test_a_forest_of_other_features_is_not_asked(library_file, moves, monkeypatch):
    from dousa.retrieval.features.feature_sets import FEATURE_SETS

    def classify_fails(message: str) -> None:
        with Library.open(library_file) as library, pytest.raises(LibraryVersionError, match=message):
            library.classify(moves)

    monkeypatch.setitem(FEATURE_SETS, "extended", FEATURE_SETS["paper"])
    classify_fails("other features than those of this dousa; run: dousa train")
    monkeypatch.delitem(FEATURE_SETS, "extended")
    classify_fails(r"'extended', this dousa knows paper.*--upgrade dousa")


@contextmanager
def locked(path: Path) -> Iterator[None]:
    known = address(path)
    if isinstance(known, str):
        with connect_plainly(known) as other:
            other.execute("SELECT revision FROM library_state FOR UPDATE")
            yield
            other.rollback()
        return
    with closing(sqlite3.connect(path, isolation_level=None)) as other:
        other.execute("BEGIN IMMEDIATE")
        yield


def test_a_locked_library_can_be_read_and_says_who_writes(library_file, moves, write_move, tmp_path):
    with Library.open(library_file, timeout=0.05) as library, locked(library_file):
        assert library.search(moves / "bow" / "bow_p0.bvh").results
        for write in (
            lambda: library.add(write_move(tmp_path / "a.bvh", seed=9)),
            lambda: library.train(n_trees=2),
            lambda: library.remove(1),
            lambda: library.relabel(1, category="x"),
        ):
            with pytest.raises(LibraryLockedError, match="another program is writing"):
                write()


def test_a_read_only_library_answers_and_refuses(library_file, moves, write_move, tmp_path):
    with Library.open(library_file, read_only=True) as library:
        assert library.search(moves / "bow" / "bow_p0.bvh").results
        assert library.clips()
        with pytest.raises(LibraryError, match="read-only"):
            library.add(write_move(tmp_path / "a.bvh", seed=9))
        with pytest.raises(LibraryError, match="read-only"):
            library.remove(1)
    assert [path.name for path in library_file.parent.glob(f"{library_file.name}*")] == [library_file.name]


@contextmanager
def as_nobody() -> Iterator[None]:
    """Root may write anywhere: for permissions to mean something, be another user for a while.

    That user may not read Python's modules where they are in root's home; Python must not remember them as missing.
    """
    if os.geteuid() != 0:
        yield
        return
    os.seteuid(65534)
    try:
        yield
    finally:
        os.seteuid(0)
        importlib.invalidate_caches()


@pytest.fixture
def frozen_library(library_file: Path) -> Iterator[Path]:
    """A library that nobody may write, in a folder that nobody may write; what reading it imports is imported."""
    folder = Path(tempfile.mkdtemp())
    path = Path(shutil.copy(library_file, folder / "m.dousa"))
    with Library.open(path, read_only=True) as library:
        library.search(1)
        with pytest.raises(LibraryError, match="read-only"):
            library.train(n_trees=2)
    path.chmod(0o444)
    folder.chmod(0o555)
    yield path
    folder.chmod(0o755)
    shutil.rmtree(folder)


@pytest.mark.sqlite
@pytest.mark.parametrize("read_only", [True, False])
@pytest.mark.parametrize("writable_folder", [True, False])
def test_a_library_without_permission_to_write(frozen_library, moves, read_only, writable_folder):
    if writable_folder:
        frozen_library.parent.chmod(0o777)
    with as_nobody(), Library.open(frozen_library, read_only=read_only) as library:
        assert len(library.search(1, 100).results) == 15
        assert len(library.clips()) == 15
        with pytest.raises(LibraryError, match="read-only"):
            library.remove(1)
        with pytest.raises(LibraryError, match="read-only"):
            library.train(n_trees=2)


@pytest.mark.sqlite
def test_a_library_that_may_not_be_made_or_read(frozen_library):
    with as_nobody(), pytest.raises(LibraryError, match="cannot be opened; check the permissions"):
        Library.open(frozen_library.parent / "new.dousa", create=True)
    frozen_library.chmod(0)
    with as_nobody(), pytest.raises(LibraryError, match="cannot be opened; check the permissions"):
        Library.open(frozen_library)


@pytest.mark.sqlite
def test_a_full_disk_does_not_hinder_reading(library_file, moves, monkeypatch):
    """SQLite makes files beside the library even to read it; where it cannot, it does without."""
    connect = _engine._connect_as

    def refuse(path, options, timeout):
        if "immutable" in options:
            return connect(path, options, timeout)
        error = sqlite3.OperationalError("disk I/O error")
        error.sqlite_errorname = "SQLITE_IOERR_SHMSIZE"
        raise error

    monkeypatch.setattr(_engine, "_connect_as", refuse)
    with Library.open(library_file, read_only=True) as library:
        assert library.search(1).results
    with pytest.raises(LibraryError, match="is it full"):
        Library.open(library_file)


@pytest.mark.sqlite
def test_a_full_disk_keeps_what_was_there(library_file, write_move, tmp_path):
    new = [write_move(tmp_path / "in" / f"{seed}.bvh", "wave", 100 + seed, n_frames=200) for seed in range(8)]
    with Library.open(library_file) as library:
        pages = library_file.stat().st_size // 4096 + 4

        def limit(connection, record) -> None:
            connection.execute(f"PRAGMA max_page_count = {pages}")

        library.close()
        event.listen(library.database.engine, "connect", limit)
        with pytest.raises(LibraryError, match="the disk is full"):
            library.add(new)
        assert len(library.clips()) == 15
        event.remove(library.database.engine, "connect", limit)
        library.close()
        assert len(library.add(new).added) == 8


@pytest.mark.parametrize(
    ("url", "message"),
    [
        ("nonsense://host/base", "not the URL of a database"),
        ("postgresql+nodriver://host/base", "not the URL of a database"),
        ("sqlite://me:secret@host:port/base", r"me:\*\*\*@host.*not the URL of a database"),
    ],
)
def test_bad_urls(url, message):
    with pytest.raises(LibraryError, match=message):
        Library.open(url)


def test_a_password_is_not_told():
    assert _engine.name_of("postgresql://me:secret@host/base") == "postgresql://me:***@host/base"
    assert "secret" not in _engine.name_of("postgresql://me:secret@host:port/base")
    assert _engine.name_of(Path("a/b.dousa")) == "a/b.dousa"


@pytest.mark.sqlite
def test_an_sqlite_file_is_named_and_not_given_as_a_url(library_file):
    with pytest.raises(LibraryError, match="name an SQLite file without"):
        Library.open(f"sqlite:///{library_file}")


def test_a_url_whose_driver_is_missing(monkeypatch):
    monkeypatch.setitem(sys.modules, "psycopg", None)
    with pytest.raises(LibraryError, match=r"pip install 'dousa\[postgres\]'"):
        Library.open("postgresql+psycopg://localhost/none")


@pytest.mark.sqlite
@pytest.mark.parametrize("leftover", [True, False])
def test_a_library_that_may_be_written_again(library_file, leftover):
    """SQLite leaves a file behind that nobody may write either, where it was opened without the permission."""
    with Library.open(library_file) as library:
        library.search(1)  # loads what only root may read
    folder = Path(tempfile.mkdtemp())
    path = Path(shutil.copy(library_file, folder / "m.dousa"))
    folder.chmod(0o777)
    if os.geteuid() == 0:
        os.chown(path, 65534, 65534)
    try:
        with as_nobody():
            path.chmod(0o444)
            library = Library.open(path)
            library.search(1)
            if not leftover:
                library.close()
            path.chmod(0o644)
            with Library.open(path) as again:
                assert again.relabel(1, performer="z")
                assert again.clips(1)[0].performer == "z"
            library.close()
    finally:
        shutil.rmtree(folder)


@pytest.mark.sqlite
@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no named pipes here")
def test_a_pipe_is_no_library(tmp_path):
    os.mkfifo(tmp_path / "pipe.dousa")
    with pytest.raises(LibraryDamagedError, match=r"pipe\.dousa"):
        Library.open(tmp_path / "pipe.dousa")
