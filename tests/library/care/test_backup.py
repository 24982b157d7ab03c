"""Copies of libraries: made while others write, compared before they count, put back; and logs of other files."""

import shutil
import subprocess
import sys
from contextlib import closing

import pytest

from dousa.errors import LibraryDamagedError, LibraryError, LibraryLockedError
from dousa.library import Library
from library.database_server import WANTED, address

_CRASH = """
import os, sys
from dousa.library import Library
library = Library.open(sys.argv[1])
library.relabel([1, 2], category="lost")
library.tag([3], add=["crash"])
os.kill(os.getpid(), 9)
"""
_LIMIT = """
import resource, sys
from pathlib import Path
from dousa.library import Library
resource.setrlimit(resource.RLIMIT_FSIZE, (8192, 8192))
Library.open(sys.argv[1]).backup(Path(sys.argv[1]).with_name("copy.dousa"))
"""


def say(library):
    """What a library says, without dates."""
    clips = [(clip.id, clip.path, clip.category, clip.tags, clip.predicted_category) for clip in library.clips()]
    joints = {number: motion.positions.tobytes() for number, motion in library.iterate_trajectories([1, 2])}
    return clips, joints, [hit.path for hit in library.search(1, 5).results], [one.number for one in library.journal()]


@pytest.mark.parametrize("in_fragments", [False, True])
def test_a_backup_is_a_library_and_comes_back(library, library_file, tmp_path, in_fragments):
    if in_fragments:
        library.compact(fragments=str(tmp_path / "elsewhere") if WANTED else "")
    library.remove([4])  # kept for an undo
    before = say(library)
    report = library.backup(tmp_path / "copy.dousa")
    assert report.n_clips == len(library.clips()) and report.replaced is None
    assert (tmp_path / "copy.dousa.fragments").exists() == in_fragments
    with closing(Library.open(tmp_path / "copy.dousa", read_only=True)) as copy:
        assert say(copy) == before
    library.relabel([1], category="changed")
    if WANTED:
        target = address(tmp_path / "new.dousa", create=True)
    else:
        with pytest.raises(LibraryLockedError, match="open"):
            Library.restore(tmp_path / "copy.dousa", library_file)
        library.close()
        target = library_file
    report = Library.restore(tmp_path / "copy.dousa", target)
    with closing(Library.open(target)) as again:
        assert say(again) == before
        again.undo()
        assert len(again.clips()) == len(before[0]) + 1
    if not WANTED:
        assert report.replaced == f"{library_file}.replaced"
        with closing(Library.open(f"{report.replaced}/{library_file.name}")) as old:
            assert old.clips([1])[0].category == "changed"
    assert not list(tmp_path.rglob("*.part"))


@pytest.mark.sqlite
def test_others_write_while_a_backup_is_made(library, library_file, tmp_path):
    def write(done, total, what):
        with Library.open(library_file) as other:
            other.tag([1], add=[f"t{done}-{total}"])

    library.backup(tmp_path / "copy.dousa", progress=write)
    with Library.open(tmp_path / "copy.dousa") as copy:
        assert copy.check().is_sound
    assert library.tags()


@pytest.mark.sqlite
def test_the_log_of_another_file_is_refused(library, library_file, tmp_path):
    """A copy is put over a library whose program was killed: its log would go over the copy."""
    library.close()
    shutil.copy(library_file, tmp_path / "night.dousa")
    with Library.open(library_file) as opened:
        opened.tag([1], add=["day"])
    subprocess.run([sys.executable, "-c", _CRASH, library_file], check=False)
    log = library_file.with_name(f"{library_file.name}-wal")
    kept = log.read_bytes()
    with Library.open(library_file) as opened:  # its own log is taken in
        assert opened.tags() == {"crash": 1, "day": 1}
    shutil.copy(tmp_path / "night.dousa", library_file)
    log.write_bytes(kept)
    for visit in (Library.open, lambda path: Library.open(path, read_only=True)):
        with pytest.raises(LibraryDamagedError) as caught:
            visit(library_file)
        assert caught.value.code == "library_file.other_log"
    Library.restore(tmp_path / "night.dousa", library_file)
    assert not log.exists()
    with Library.open(library_file) as opened:
        assert opened.tags() == {} and opened.check().is_sound


def test_a_forest_of_another_version_is_copied(library, tmp_path, monkeypatch):
    monkeypatch.setattr("dousa.retrieval.forest.forest_file._VERSION", 99)
    assert not library.check().is_sound
    assert library.backup(tmp_path / "copy.dousa").n_clips == len(library.clips())


@pytest.mark.sqlite
def test_what_cannot_be_copied_is_said(library, library_file, tmp_path):
    taken = tmp_path / "taken.dousa"
    taken.write_bytes(b"mine")
    with pytest.raises(LibraryError, match="a file of that name"):
        library.backup(taken)
    assert taken.read_bytes() == b"mine"
    with pytest.raises(LibraryError, match="the library itself"):
        Library.restore(library_file, library_file)
    with pytest.raises(LibraryError, match="no library at"):
        Library.restore(tmp_path / "none.dousa", library_file)
    limited = subprocess.run([sys.executable, "-c", _LIMIT, library_file], check=False, capture_output=True, text=True)
    assert f"{tmp_path / 'copy.dousa'}: the disk" in limited.stderr and not list(tmp_path.rglob("*.part"))
    with library.database.alone() as connection:
        connection.execute("UPDATE clips SET category = 'x' WHERE id = 1")
    with pytest.raises(LibraryDamagedError, match="labels"):
        library.backup(tmp_path / "copy.dousa")
    assert not (tmp_path / "copy.dousa").exists() and not list(tmp_path.rglob("*.part"))


@pytest.mark.sqlite
def test_what_a_killed_program_left_goes_with_the_next_copy(library, tmp_path):
    library.backup(tmp_path / "copy.dousa")
    for name in ("copy.dousa.part", "other.dousa.part"):
        (tmp_path / name / "new").mkdir(parents=True)
        (tmp_path / name / "lock").touch()
    with pytest.raises(LibraryError, match="a file of that name"):
        library.backup(tmp_path / "copy.dousa")
    assert not list(tmp_path.rglob("*.part"))


@pytest.mark.sqlite
def test_a_restore_deletes_nothing_that_came_since_one_was_killed(library, library_file, tmp_path):
    """The name was given to the copy, or to another library, and the old one was not yet in its folder."""
    library.backup(tmp_path / "copy.dousa")
    library.close()
    left = library_file.with_name(f"{library_file.name}.part") / "old"
    left.mkdir(parents=True)
    shutil.copy(library_file, left / library_file.name)
    with Library.open(library_file) as opened:
        opened.tag([1], add=["since"])
    link = tmp_path / "link.dousa"
    link.symlink_to(library_file)
    assert Library.restore(tmp_path / "copy.dousa", link).replaced == f"{library_file}.replaced1"
    assert link.is_symlink()
    for number, tags in (("", {}), ("1", {"since": 1})):
        with Library.open(f"{library_file}.replaced{number}/{library_file.name}") as kept:
            assert kept.tags() == tags


@pytest.mark.sqlite
def test_a_restore_keeps_what_belonged_to_a_library_that_is_not_there(library, library_file, tmp_path):
    """Somebody has moved the file, but not its fragments; and a journal of SQLite would go over the copy."""
    library.backup(tmp_path / "copy.dousa")
    for end in (".fragments", "-journal"):
        (tmp_path / f"other.dousa{end}").write_bytes(b"not mine")
    report = Library.restore(tmp_path / "copy.dousa", tmp_path / "other.dousa")
    assert {path.name for path in (tmp_path / "other.dousa.replaced").iterdir()} == {
        "other.dousa.fragments",
        "other.dousa-journal",
    }
    assert report.replaced == f"{tmp_path / 'other.dousa'}.replaced"


_ENDED = """
import os, sys
from pathlib import Path
from dousa.library import Library
left, rename = [int(sys.argv[1])], Path.rename
def count(self, target):
    if not left[0]:
        os._exit(9)
    left[0] -= 1
    return rename(self, target)
Path.rename = count
Library.restore(*sys.argv[3:]) if sys.argv[2] == "restore" else Library.open(sys.argv[3]).backup(sys.argv[4])
"""


@pytest.mark.sqlite
@pytest.mark.parametrize(("what", "n"), [*(("restore", n) for n in range(6)), *(("backup", n) for n in range(3))])
def test_a_program_that_ends_between_two_renames_leaves_one_whole_library(library, tmp_path, what, n):
    """Who opens the name next finds the old library or the new one, with its fragments, and no left-over."""
    library.compact(fragments="")
    library.tag([1], add=["new"])
    library.backup(tmp_path / "from.dousa")
    library.tag([1], add=["old"], remove=["new"])
    library.close()
    target = tmp_path / ("moves.dousa" if what == "restore" else "to.dousa")
    words = [what, tmp_path / "from.dousa", target]
    assert subprocess.run([sys.executable, "-c", _ENDED, str(n), *words], check=False).returncode == 9
    if what == "restore" or n:
        with Library.open(target) as found:
            assert found.check().is_sound
            assert found.tags() == ({"old": 1} if what == "restore" and n < 3 else {"new": 1})
    else:
        with pytest.raises(LibraryError, match="no library at"):
            Library.open(target)
    if what == "restore":
        Library.restore(tmp_path / "from.dousa", target)
    elif not n:
        with closing(Library.open(tmp_path / "from.dousa")) as source:
            source.backup(target)
    with Library.open(target) as found:
        assert found.tags() == {"new": 1} and found.check().is_sound
    assert not list(tmp_path.rglob("*.part"))
    kept = [Library.open(folder / "moves.dousa", read_only=True) for folder in tmp_path.glob("*.replaced*")]
    assert len(kept) <= 2 and ({"old": 1} in [one.tags() for one in kept]) == (what == "restore")
    for one in kept:
        one.close()


@pytest.mark.sqlite
def test_a_backup_that_fails_leaves_no_folder(library, tmp_path):
    with library.database.alone() as connection:
        connection.execute("UPDATE clips SET category = 'x' WHERE id = 1")
    with pytest.raises(LibraryDamagedError):
        library.backup(tmp_path / "a" / "b" / "copy.dousa")
    assert not (tmp_path / "a").exists()
