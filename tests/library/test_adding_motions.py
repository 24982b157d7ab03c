"""Motions of the memory in the library: the same as their files, learned at once, told apart by name and content."""

from dataclasses import replace

import numpy as np
import pytest

from dousa.errors import InvalidMotionError, JointMappingError, LibraryError, OptionError
from dousa.formats import read_canonical, read_motion
from dousa.library import Library
from dousa.motion import Trajectories, compute_trajectories

SQUAT = "squat/squat_p2.bvh"


def tables_of(library: Library, clip_id: int) -> list[object]:
    """All that is stored of a clip but the columns that say where it came from."""
    columns = "n_frames, frame_rate, duration, height, joint_table, warnings, category, performer, kind"
    with library.database.engine.connect() as connection:
        rows = [
            connection.exec_driver_sql(f"SELECT {chosen} FROM {table} WHERE {key} = {clip_id}").all()
            for chosen, table, key in (
                (columns, "clips", "id"),
                ("positions", "clip_trajectories", "clip_id"),
                ("feature_set, pose_features", "clip_features", "clip_id"),
                ("poses", "clip_poses", "clip_id"),
                ("predicted_category, leaves", "clip_leaves", "clip_id"),
            )
        ]
    return [tuple(row) for some in rows for row in some]


@pytest.mark.parametrize("form", ["motion", "trajectories", "canonical"])
def test_it_is_as_if_its_file_had_been_added(library_file, write_move, tmp_path, form):
    path = write_move(tmp_path / "in" / "squat" / "new.bvh", "squat", 77)
    twin = tmp_path / "twin.dousa"
    twin.write_bytes(library_file.read_bytes())
    motion = read_motion(path)
    given = {"motion": motion, "trajectories": compute_trajectories(motion), "canonical": read_canonical(path)[0]}[form]
    with Library.open(library_file) as by_file, Library.open(twin) as by_memory:
        first = by_file.add(path.parents[1], n_jobs=1)
        second = by_memory.add_motion(given, "new", "squat")
        assert second.added == ("new",)
        assert (second.n_learned, second.warnings) == (first.n_learned, first.warnings) == (1, ())
        (a,), (b,) = by_file.clips(list(first.added)), by_memory.clips("new")
        assert a.id == b.id
        assert tables_of(by_file, a.id) == tables_of(by_memory, b.id)
        np.testing.assert_array_equal(by_file.trajectories(a.id).positions, by_memory.trajectories(b.id).positions)
        for number in (1, a.id):
            hits = [library.search(number, 20).results for library in (by_file, by_memory)]
            # Between equals the path decides, and theirs differ.
            keys = [[(hit.distance, hit.rank_distance, hit.clip_id) for hit in some] for some in hits]
            assert sorted(keys[0], key=str) == sorted(keys[1], key=str)


def test_a_trained_library_learns_it_at_once(library, write_move, tmp_path):
    kick = read_motion(write_move(tmp_path / "a.bvh", "wave", 31))
    report = library.add_motion(kick, "take one, 1.0 s to 1.8 s", "kick")
    assert (report.added, report.n_learned, report.new_categories) == (("take one, 1.0 s to 1.8 s",), 1, ("kick",))
    assert library.search(kick, 1).verdict.guess == "kick"
    assert "kick" in library.categories()


def test_without_a_forest_or_a_category_it_is_kept(empty_library, library, moves):
    motion = read_motion(moves / SQUAT)
    assert empty_library.add_motion(motion, "a", "squat").n_learned == 0
    report = library.add_motion(motion, "a", performer="p9")
    assert (report.added, report.n_learned, report.warnings) == (("a",), 0, ())  # nobody asked for a category
    (clip,) = library.clips("a")
    assert (clip.category, clip.performer, clip.format, clip.kind) == (None, "p9", "memory", "clip")
    assert library.search(clip.id, 1).verdict.guess == "squat"


def test_the_same_again_changes_nothing(library, moves):
    motion = read_motion(moves / SQUAT)
    library.add_motion(motion, "a", "squat")
    revision = library.revision
    again = library.add_motion(motion, "a", "squat")
    assert (again.added, again.unchanged, again.other_labels) == ((), ("a",), ())
    assert library.add_motion(motion, "a", "bow").other_labels == ("a",)  # it stays what it is; relabel changes it
    assert library.add_motion(motion, "a", kind="take").other_kind == ("a",)
    other = library.add_motion(motion, "b", "squat")
    assert (other.added, [(one.path, one.same_as) for one in other.duplicates]) == ((), [("b", "a")])
    assert (library.revision, len(library.clips())) == (revision, 16)


def test_another_motion_of_the_name_takes_its_place(library, moves):
    library.add_motion(read_motion(moves / SQUAT), "a", "squat", performer="p2")
    (before,) = library.clips("a")
    report = library.add_motion(read_motion(moves / "bow/bow_p1.bvh"), "a", "bow")
    assert (report.added, report.replaced, report.n_learned) == ((), ("a",), 1)
    (after,) = library.clips("a")
    assert (after.category, after.performer) == ("bow", "p2")
    assert after.id != before.id and len(library.clips()) == 16


def test_it_is_chosen_relabelled_and_removed_by_its_name(library, moves):
    library.add_motion(read_motion(moves / SQUAT), "some name", "squat")
    assert library.relabel("some name", category="sit") == ["some name"]
    assert library.remove(["some name"]) == ["some name"]
    with pytest.raises(LibraryError, match="no clip of 'some name'"):
        library.clips("some name")


def test_a_take_of_the_memory_is_looked_into(library, write_move, tmp_path):
    path = write_move(tmp_path / "take.bvh", "squat", n_frames=400)
    library.add_motion(read_motion(path), "evening", kind="take")
    (place,) = library.find(1, k=1).results
    assert place.take == "evening"
    with Library.open(library.name) as again:
        assert again.find(1, k=1).results == (place,)  # its windows are stored
        assert again.find(1, [path], k=1).results[0].score == place.score


def test_it_is_no_file_that_was_moved(library, moves, tmp_path):
    """The content of a motion of the memory and of a file are never one, and a name is not looked for on the disk."""
    motion = read_motion(moves / SQUAT)
    library.add_motion(motion, "a", "squat")
    assert library.add_motion(motion, "b").moved == ()
    assert library.add(moves, n_jobs=1).unchanged == tuple(sorted(map(str, moves.glob("*/*.bvh"))))
    assert {clip.path for clip in library.clips()} >= {"a", str(moves / SQUAT)}


@pytest.mark.parametrize("name", ["", "  ", "bad\udcff"])
def test_a_name_is_needed(library, moves, name):
    with pytest.raises(OptionError) as caught:
        library.add_motion(read_motion(moves / SQUAT), name)
    assert caught.value.code == "library_add.no_name"


def test_what_cannot_be_is_refused(library, moves):
    motion = read_canonical(moves / SQUAT)[0]
    for code, options in (
        ("library_add.unknown_kind", {"kind": "film"}),
        ("library_add.take_has_no_category", {"kind": "take", "category": "squat"}),
        ("library_clips.empty_label", {"category": " "}),
        ("library_clips.empty_label", {"performer": ""}),
    ):
        with pytest.raises(OptionError) as caught:
            library.add_motion(motion, "a", **options)
        assert caught.value.code == code
    with pytest.raises(InvalidMotionError) as invalid:
        library.add_motion(replace(motion, positions=motion.positions * 1e12), "a")
    assert invalid.value.code == "motion_files.beyond_measure"
    with pytest.raises(InvalidMotionError, match="1 Hz or more"):
        library.add_motion(replace(motion, frame_rate=1e-6), "a")
    with pytest.raises(JointMappingError):
        library.add_motion(Trajectories(("x", "y"), np.zeros((3, 2, 3)), 30.0), "a")
    assert len(library.clips()) == 15
