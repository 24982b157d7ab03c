"""Damage is found by checksums, told where it is met, and put right where that can be."""

import json
import random
import shutil
import sqlite3
from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest

from dousa.errors import LibraryDamagedError, LibraryError
from dousa.library import Library
from dousa.library.store.checksums import SEALS
from dousa.motion import canonicalise
from dousa.motion.synthetic import draw_performer, make_motion
from library.database_server import run_sql


def change(path, statement, *values):
    run_sql(path, statement, *values)


def flip(data, bit):
    return data[: bit // 8] + bytes([data[bit // 8] ^ (1 << bit % 8)]) + data[bit // 8 + 1 :]


def flip_column(path, table, column, row, bit=5, key="clip_id"):
    """Flip one bit of a value, as a failing disk does."""
    ((data,),) = run_sql(path, f"SELECT {column} FROM {table} WHERE {key} = {row}")
    if isinstance(data, bytes):
        value = flip(data, bit)
    else:  # a server gives JSON as what it says
        value = flip((data if isinstance(data, str) else json.dumps(data)).encode(), bit).decode()
    change(path, f"UPDATE {table} SET {column} = ? WHERE {key} = {row}", value)


ASK = {
    ("clip_trajectories", "positions"): lambda library: library.trajectories(2),
    ("clip_features", "pose_features"): lambda library: library.train(n_trees=2),
    ("clip_poses", "poses"): lambda library: library.search(1),
    ("clip_leaves", "leaves"): lambda library: library.search(1),
    ("clip_relations", "relations"): lambda library: library.search_text("wave"),
}


@pytest.mark.parametrize(("table", "column"), ASK)
def test_a_flipped_bit_is_an_error_and_no_other_answer(library_file, moves, table, column):
    with Library.open(library_file) as library:
        name = library.clips(2)[0].path
    bit = 8 * 150 + 1 if column == "positions" else 17 if column != "relations" else 8 * 3
    flip_column(library_file, table, column, 2, bit)
    with Library.open(library_file) as library:
        with pytest.raises(LibraryDamagedError, match=r"dousa check .* --repair") as caught:
            ASK[table, column](library)
        assert name in str(caught.value)
        report = library.check()
        assert not report.is_sound
        assert {one.path for one in report.damage} == {name}


def test_a_sound_library_is_sound(library):
    report = library.check()
    assert (report.damage, report.is_sound, report.n_clips) == ((), True, 15)
    assert report.n_rows > 15 * 6


@pytest.mark.parametrize("column", ["path", "category", "performer"])
def test_a_label_that_changed_is_told(library_file, moves, column):
    with Library.open(library_file) as library:
        number = library.clips()[3].id
    flip_column(library_file, "clips", column, number, bit=0, key="id")
    with Library.open(library_file) as library:
        for ask in (library.clips, lambda: library.search(1), lambda: library.search_text("wave"), library.train):
            with pytest.raises(LibraryDamagedError, match="labels"):
                ask()
        (damage,) = library.check(repair=True).damage
        assert (damage.clip_id, damage.repaired, damage.remedy.code) == (number, False, "library_check.lost")
        library.remove([number], for_good=True)  # as the remedy says
        assert library.check().is_sound


def test_what_follows_from_other_things_is_computed_again(library_file, moves):
    with Library.open(library_file) as library:
        before = library.search(1, 15), library.search_text("wave")
    for row, table, column in (
        (1, "clip_features", "pose_features"),
        (2, "clip_poses", "poses"),
        (3, "clip_leaves", "leaves"),
        (4, "clip_relations", "relations"),
    ):
        flip_column(library_file, table, column, row, 8 * 3)
    with Library.open(library_file) as library:
        assert len(library.check().damage) == 4
        report = library.check(repair=True)
        assert report.is_sound
        assert len(report.damage) == 4
        assert (library.search(1, 15), library.search_text("wave")) == before


def test_positions_are_read_again_from_the_file(library_file):
    with Library.open(library_file) as library:
        before = library.trajectories(2).positions
    change(library_file, "UPDATE clip_trajectories SET positions = zeroblob(length(positions)) WHERE clip_id = 2")
    with Library.open(library_file) as library:
        assert library.check().is_sound is False
        report = library.check(repair=True)
        assert report.is_sound
        assert report.damage[0].remedy.code == "library_check.read_again"
        np.testing.assert_array_equal(library.trajectories(2).positions, before)


def test_without_the_file_positions_are_lost(tmp_path, moves):
    folder, path = tmp_path / "moves", tmp_path / "own.dousa"
    shutil.copytree(moves, folder)
    with Library.open(path, create=True) as library:
        library.add(folder, n_jobs=1)
    for file in folder.glob("*/*.bvh"):
        file.unlink()
    flip_column(path, "clip_trajectories", "positions", 2, 8 * 1000 + 3)
    with Library.open(path) as library:
        report = library.check(repair=True)
        said = {one.clip_id: (one.repaired, one.remedy.code) for one in report.damage}
        assert said == {2: (False, "library_check.file_gone")}
        with pytest.raises(LibraryDamagedError):
            library.trajectories(2)
        gone = library.remove(2, for_good=True)  # as the remedy says: an undo could not bring it back
        assert gone == [report.damage[0].path]
        assert library.check().is_sound


def test_positions_that_an_undo_brings_back_are_looked_at_too(library_file):
    with Library.open(library_file) as library:
        before = library.trajectories(2).positions
        library.remove([2])
        library.remove([3])
    flip_column(library_file, "removed_positions", "positions", 3, 8 * 1000 + 3, key="number")
    with Library.open(library_file) as library:
        assert {one.what.code for one in library.check().damage} == {"library_damage.removed_positions"}
        report = library.check(repair=True)
        assert report.is_sound
        assert [one.remedy.code for one in report.damage] == ["library_check.forgotten"]
        later, first = library.journal()[:2]
        with pytest.raises(LibraryError, match="not kept any more"):
            library.undo(later.number)
        library.undo(first.number)
        np.testing.assert_array_equal(library.trajectories(2).positions, before)
        assert library.check().damage == ()


@pytest.mark.sqlite
def test_positions_whose_number_changed_are_missed_by_whoever_asks(library_file):
    with Library.open(library_file) as library:
        library.remove([2])
    with closing(sqlite3.connect(library_file)) as connection, connection:  # foreign keys are not looked at
        connection.execute("UPDATE removed_positions SET number = 34")
        connection.execute("UPDATE clip_trajectories SET clip_id = 39 WHERE clip_id = 7")
    with Library.open(library_file) as library:
        with pytest.raises(LibraryDamagedError, match="number 2"):
            library.undo()
        with pytest.raises(LibraryDamagedError, match="number 7"):
            list(library.iterate_trajectories([1, 7, 500]))
        assert [number for number, _ in library.iterate_trajectories([1, 500])] == [1]


def test_a_file_that_changed_is_not_taken_for_the_clip(tmp_path, moves, write_move):
    file = write_move(tmp_path / "in" / "wave" / "a.bvh", "wave", 1)
    path = tmp_path / "own.dousa"
    with Library.open(path, create=True) as library:
        library.add(tmp_path / "in")
    write_move(file, "wave", 2)
    change(path, "UPDATE clip_trajectories SET positions = zeroblob(length(positions))")
    with Library.open(path) as library:
        (damage,) = library.check(repair=True).damage
        assert (damage.repaired, damage.remedy.code) == (False, "library_check.file_changed")


def test_a_damaged_forest_asks_for_a_training(library_file):
    flip_column(library_file, "forests", "data", 1, 8 * 3000, key="id")
    with Library.open(library_file) as library:
        (damage,) = library.check(repair=True).damage
        assert (damage.repaired, damage.remedy.code, damage.clip_id) == (False, "library_check.retrain", None)
        library.train(n_trees=5)
        assert library.check().is_sound


def test_segments_are_checked_by_the_blocks_they_lie_in(tmp_path):
    path = tmp_path / "takes.dousa"
    short = canonicalise(make_motion("walk", draw_performer(1), seed=1))
    motion = replace(short, positions=np.tile(short.positions, (-(-1400 // short.n_frames), 1, 1)))
    with Library.open(path, create=True) as library:
        library.add_motion(motion, "take", kind="take")
        rate = library.trajectories(1).frame_rate
        first = library.annotations.name(1, 20 / rate, 120 / rate, "walk")
        later = library.annotations.name(1, 900 / rate, 1200 / rate, "walk")
        before = library.trajectories(later).positions
        whole = library.trajectories(1)
        np.testing.assert_array_equal(before, whole.positions[900:1200])
    flip_column(path, "clip_trajectories", "positions", 1, 8 * 240 * 40)
    with Library.open(path) as library:
        np.testing.assert_array_equal(library.trajectories(later).positions, before)
        for number in (1, first):
            with pytest.raises(LibraryDamagedError, match="positions of take"):
                library.trajectories(number)
        (damage,) = library.check(repair=True).damage
        assert (damage.clip_id, damage.repaired, damage.remedy.code) == (1, False, "library_check.no_file")


def test_counts_that_cannot_be_are_counted_again(library_file, write_move, tmp_path):
    change(library_file, "UPDATE library_state SET next_clip_id = 3")
    write_move(tmp_path / "in" / "wave" / "a.bvh", "wave", 77)
    with Library.open(library_file) as library:
        with pytest.raises(LibraryDamagedError, match="state"):
            library.add(tmp_path / "in")
        assert library.check(repair=True).is_sound
        library.add(tmp_path / "in")
        assert len(library.clips()) == 16


def dump(path):
    """Everything that a library says."""
    with Library.open(path) as library:
        return (
            library.clips(),
            library.stats(),
            [library.trajectories(clip.id).positions.tobytes() for clip in library.clips()],
            library.search(1, 15, mirror=True),
            library.search_text("wave"),
        )


def find_silent_flips(path, scratch, n_flips, seed):
    """Bits whose flipping a check does not find although the answers differ; and how many flips it found."""
    content, before = path.read_bytes(), dump(path)
    chance = random.Random(seed)
    silent, found = [], 0
    for _ in range(n_flips):
        bit = chance.randrange(8 * len(content))
        scratch.write_bytes(flip(content, bit))
        for rest in (scratch.with_name(scratch.name + end) for end in ("-wal", "-shm")):
            rest.unlink(missing_ok=True)
        try:
            with Library.open(scratch) as library:
                sound = library.check().is_sound
        except LibraryError:
            sound = False
        found += not sound
        if sound and dump(scratch) != before:
            silent.append(bit)
    return silent, found


@pytest.mark.sqlite
def test_flips_anywhere_in_the_file_are_found_or_change_nothing(library_file, tmp_path):
    silent, found = find_silent_flips(library_file, tmp_path / "flipped.dousa", 25, 1)
    assert silent == []
    assert found > 5


def find_root(path, table):
    """Number of the page where a table or an index begins, and the bytes of a page."""
    with closing(sqlite3.connect(path)) as connection:
        size = connection.execute("PRAGMA page_size").fetchone()[0]
        query = "SELECT rootpage FROM sqlite_master WHERE name = ?"
        return connection.execute(query, (table,)).fetchone()[0], size


@pytest.mark.sqlite
@pytest.mark.parametrize(
    "table",
    [
        *(pytest.param(one, marks=pytest.mark.slow) for one in ("clip_features", "clips", "ix_clips_category")),
        "clip_trajectories",
        "forests",
    ],
)
def test_what_can_be_read_of_a_broken_file_is_saved(library_file, tmp_path, table):
    with Library.open(library_file) as library:
        before = library.clips()
        library.compact()  # so that all is in the file itself
    page, size = find_root(library_file, table)
    content = bytearray(library_file.read_bytes())
    content[(page - 1) * size : (page - 1) * size + 12] = b"\xff" * 12
    library_file.write_bytes(content)
    with Library.open(library_file) as library:
        assert library.check().is_sound is False
        report = library.check(repair=True)
        assert (tmp_path / "moves.dousa.damaged/moves.dousa").read_bytes()[100:] == content[100:]  # but for its header
        left = {one.what.code for one in report.damage if not one.repaired}
        assert left <= {"library_damage.forest", "library_damage.clip", "library_damage.positions"}
        if table == "clips":
            assert [one.path for one in report.damage if one.what.code == "library_damage.clip"]
            return
        assert [clip.path for clip in library.clips()] == [clip.path for clip in before]
        library.train(n_trees=5)
        assert library.check().is_sound
        library.search(1)
        library.trajectories(1)


@pytest.mark.parametrize("seal", SEALS, ids=lambda seal: f"{seal.checksum.table.name}.{seal.checksum.name}")
def test_checksums_of_many_rows_are_those_of_each(seal):
    chance = random.Random(1)
    drawn = {
        bytes: lambda: chance.randbytes(chance.randrange(9)),
        float: chance.random,
        str: lambda: "あa"[: chance.randrange(3)],
    }
    make = {
        kind: drawn.get(kind, lambda: chance.randrange(2**31)) for kind in (bytes, float, str, int, bool, dict, object)
    }
    rows = [[make[column.type.python_type]() for column in seal.covered] for _ in range(20)]
    for row in rows[5:]:
        row[chance.randrange(len(row))] = None
    sums = [seal.compute(row) for row in rows]
    assert seal.compute_all(list(zip(*rows, strict=True))) == sums
    seal.check_all(None, [*zip(*rows, strict=True), sums])
    with pytest.raises(AttributeError):  # the error asks the connection which clip that is
        seal.check_all(None, [*zip(*rows, strict=True), [*sums[:-1], sums[-1] ^ 1]])
