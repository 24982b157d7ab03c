"""Positions and features in fragments: the same answers, the same care, and the same way back."""

import random
import shutil
from pathlib import Path

import numpy as np
import pytest
import sqlalchemy as sa

from dousa.errors import LibraryDamagedError, LibraryError
from dousa.library import Library
from dousa.library.care import compact as moving
from dousa.library.store import fragments as store
from dousa.library.store import schema
from dousa.library.store.fragments import ARRAYS, FolderFragments, Place
from library.database_server import WANTED, run_sql


@pytest.fixture
def place(tmp_path) -> str:
    """What ``compact`` is told: beside a file, and a folder for all on a server."""
    return str(tmp_path / "shared") if WANTED else ""


@pytest.fixture
def moved(library_file, place) -> Library:
    """A trained library whose arrays lie in fragments."""
    with Library.open(library_file) as library:
        library.compact(fragments=place)
        yield library


def list_fragments(library: Library) -> list[Path]:
    place = run_sql(Path(library.name), "SELECT place FROM array_store")[0][0]
    return sorted(Path(place or f"{library.name}.fragments").glob("*.blocks"))


def count_in_rows(library: Library) -> int:
    """Arrays that stand in their rows."""
    with library.database.reading() as connection:
        counts = (sa.select(sa.func.count()).where(sa.func.length(column) > 0) for column in ARRAYS)
        return sum(connection.execute(query).scalar_one() for query in counts)


def dump(library: Library) -> tuple:
    """Everything that a library says."""
    clips = library.clips()
    return (
        clips,
        [library.trajectories(clip.id).positions.tobytes() for clip in clips],
        library.search(clips[0].id, 20, mirror=True),
        library.search_text("wave"),
        library.categories(),
    )


def test_a_library_says_the_same_from_fragments(library_file, place):
    with Library.open(library_file) as library:
        before, rows = dump(library), count_in_rows(library)
        told = []
        report = library.compact(fragments=place, progress=lambda *step: told.append(step))
        assert rows == 30 and count_in_rows(library) == 0
        assert dump(library) == before
        assert report.n_fragments == 1 and report.moved > 15 * 5000
        assert told[-1][0] == told[-1][1]
        assert library.compact(fragments=place).moved == 0
        assert library.check().damage == ()
    with Library.open(library_file, read_only=True) as library:
        assert dump(library) == before


@pytest.mark.sqlite
def test_a_link_to_a_library_leads_to_its_fragments_too(moved, tmp_path):
    link = tmp_path / "elsewhere" / "link.dousa"
    link.parent.mkdir()
    link.symlink_to(moved.name)
    before = dump(moved)
    with Library.open(link) as library:
        assert dump(library) == before
        library.train(n_trees=5)
    assert [path.name for path in link.parent.iterdir()] == ["link.dousa"]
    assert moved.check().is_sound


def test_new_clips_and_trainings_go_there_too(moved, write_move, tmp_path):
    moved.add(write_move(tmp_path / "in" / "wave" / "new.bvh", "wave", 99).parent.parent)
    moved.train(n_trees=5)
    assert count_in_rows(moved) == 0
    take = write_move(tmp_path / "take.bvh", "bow", 90, n_frames=700)
    moved.add(take, kind="take")
    number = next(clip.id for clip in moved.clips() if clip.kind == "take")
    part = moved.annotations.name(number, 300 / 30, 520 / 30, "bow")
    whole = moved.trajectories(number).positions
    np.testing.assert_array_equal(moved.trajectories(part).positions, whole[300:520])
    assert moved.check().damage == ()


def test_removed_clips_come_back_until_they_are_forgotten(moved):
    before = dump(moved)
    moved.remove(category="bow")
    moved.undo()
    assert dump(moved) == before
    moved.redo()
    after, size = dump(moved), sum(path.stat().st_size for path in list_fragments(moved))
    report = moved.compact()
    assert report.before > report.after
    assert sum(path.stat().st_size for path in list_fragments(moved)) == pytest.approx(size * 2 / 3, rel=0.01)
    assert dump(moved) == after
    assert moved.check().damage == ()
    with pytest.raises(LibraryError):
        moved.undo()


def test_small_fragments_are_joined(moved, write_move, tmp_path, monkeypatch):
    monkeypatch.setitem(store.FolderFragments.__init__.__kwdefaults__, "full", 1)
    for seed in range(3):
        moved.add(write_move(tmp_path / "in" / "wave" / f"{seed}.bvh", "wave", 70 + seed).parent)
    assert len(list_fragments(moved)) > 3
    monkeypatch.undo()
    before = dump(moved)
    assert moved.compact().n_fragments == 1
    assert dump(moved) == before


def test_a_stopped_move_goes_on(library_file, place, monkeypatch):
    with Library.open(library_file) as library:
        before = dump(library)
        monkeypatch.setitem(moving._move_blocks.__kwdefaults__, "most", 20_000)

        def stop(done, total, what):
            if done > 30:
                raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            library.compact(fragments=place, progress=stop)
        left = count_in_rows(library)
        assert 0 < left < 30
        assert dump(library) == before and library.check().is_sound
        library.compact(fragments=place)
        assert count_in_rows(library) == 0 and dump(library) == before


def test_what_a_killed_program_wrote_is_left_out(moved):
    (fragment,) = list_fragments(moved)
    with open(fragment, "ab") as file:
        file.write(b"half a block")
    stray = fragment.with_name("999999-0123abcd.blocks")
    stray.write_bytes(b"x" * 100)
    other = fragment.with_name("notes.txt")
    other.write_text("not ours")
    before = dump(moved)
    assert moved.check().damage == ()
    moved.compact()
    assert not stray.exists() and other.exists()
    assert dump(moved) == before


def test_another_program_that_reads_an_earlier_state_goes_on(moved, library_file):
    moved.remove([1])
    with Library.open(library_file) as other:
        reading = other.iterate_trajectories([2, 3])
        next(reading)
        moved.database.engine.dispose()
        with Library.open(library_file, timeout=0.2) as writer:
            writer.compact()
        assert next(reading)[1].n_frames == 24
        reading.close()
    assert len(moved.compact().to_json()) == 7
    assert len(list_fragments(moved)) == 1


def test_a_flipped_bit_in_a_fragment_is_found_and_mended(moved, moves):
    before = dump(moved)
    chance = random.Random(3)
    for number in range(12):
        (fragment,) = list_fragments(moved)
        content = bytearray(fragment.read_bytes())
        bit = chance.randrange(8 * len(content))
        content[bit // 8] ^= 1 << bit % 8
        fragment.write_bytes(content)
        report = moved.check(repair=bool(number % 2))
        assert len(report.damage) == 1
        if not report.is_sound:
            assert moved.check(repair=True).is_sound
        assert dump(moved) == before
        moved.compact()


def test_a_missing_fragment_is_one_clear_error_and_mended_from_the_files(moved):
    before = dump(moved)
    (fragment,) = list_fragments(moved)
    kept = fragment.read_bytes()
    fragment.unlink()
    with pytest.raises(LibraryDamagedError, match=f"{fragment.name} is missing .* dousa check .* --repair") as caught:
        moved.trajectories(1)
    assert caught.value.code == "library_fragments.missing"
    report = moved.check()
    assert [one.what.code for one in report.damage].count("library_damage.fragment") == 1
    assert len(report.damage) == 31
    fragment.write_bytes(kept[:9000])
    with pytest.raises(LibraryDamagedError, match="cut short"):
        [moved.trajectories(clip.id) for clip in before[0]]
    fragment.unlink()
    report = moved.check(repair=True)
    assert report.is_sound
    moved.train(n_trees=20)  # features are computed again
    assert dump(moved)[:2] == before[:2]


@pytest.mark.sqlite  # the fragments of a server stay where they are
def test_a_library_is_copied_with_its_folder(moved, library_file, tmp_path):
    before = dump(moved)
    moved.close()
    target = tmp_path / "elsewhere" / "other.dousa"
    target.parent.mkdir()
    shutil.copy(library_file, target)
    with Library.open(target) as copy, pytest.raises(LibraryDamagedError, match=r"other\.dousa\.fragments"):
        copy.trajectories(1)
    shutil.copytree(f"{library_file}.fragments", f"{target}.fragments")
    with Library.open(target) as copy:
        assert dump(copy) == before


@pytest.mark.sqlite  # a server's fragments are where somebody says
def test_large_libraries_begin_by_themselves(library, write_move, tmp_path, monkeypatch):
    monkeypatch.setitem(moving.begin_where_large.__kwdefaults__, "begin_at", 10)
    report = library.add(write_move(tmp_path / "in" / "wave" / "a.bvh", "wave", 50).parent.parent)
    assert [note.code for _, note in report.warnings] == ["library_fragments.begun"]
    assert count_in_rows(library) == 32
    again = library.add(write_move(tmp_path / "in" / "wave" / "b.bvh", "wave", 51).parent.parent)
    assert again.warnings == () and count_in_rows(library) == 32
    assert library.check().damage == ()


@pytest.mark.sqlite  # about the place of fragments
def test_a_place_that_does_not_fit(library, tmp_path):
    with pytest.raises(LibraryError, match="beside it"):
        library.compact(fragments=str(tmp_path))


@pytest.mark.sqlite  # a file from somebody else
def test_a_file_cannot_name_other_files(moved, library_file, tmp_path):
    secret = tmp_path / "secret.blocks"
    secret.write_bytes(b"s" * 10**6)
    run_sql(library_file, "UPDATE clip_trajectories SET fragment = '../secret.blocks', first_byte = 0")
    run_sql(library_file, "UPDATE array_store SET place = ?", str(tmp_path))
    with Library.open(library_file) as library, pytest.raises(LibraryDamagedError):
        library.trajectories(1)
    assert FolderFragments(tmp_path, "x").read([Place("../secret.blocks", 0, 10)]) == [b""]


@pytest.mark.sqlite  # a salvage is of a file
def test_what_can_be_read_of_a_broken_file_keeps_its_fragments(moved, library_file):
    before = dump(moved)[:2]
    moved.close()
    page = run_sql(library_file, "SELECT rootpage FROM sqlite_master WHERE name = 'ix_clips_category'")[0][0]
    content = bytearray(library_file.read_bytes())
    content[(page - 1) * 4096 : (page - 1) * 4096 + 12] = b"\xff" * 12
    library_file.write_bytes(content)
    with Library.open(library_file) as library:
        library.check(repair=True)
        assert dump(library)[:2] == before
        with library.database.reading() as connection:
            assert connection.execute(sa.select(schema.array_store.c.id)).scalars().all() == [1]


def test_blocks_are_laid_out_and_read_in_any_order(tmp_path):
    chance = random.Random(1)
    folder = FolderFragments(tmp_path / "f", "library", full=300)
    assert folder.sizes() == {} and folder.read([Place("000001-00000000.blocks", 0, 5)]) == [b""]
    blocks, places = [], []
    for _ in range(20):
        some = [chance.randbytes(chance.randrange(60)) for _ in range(4)]
        places += folder.append(some)
        blocks += some
    assert len(folder.sizes()) > 3
    order = chance.sample(range(len(blocks)), len(blocks))
    assert folder.read([places[n] for n in order]) == [blocks[n] for n in order]
    for name in folder.sizes():
        folder.delete(name)
    assert not (tmp_path / "f").exists()
