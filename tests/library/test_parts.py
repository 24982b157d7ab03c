"""Files of several people or animations in a library: a clip of each, consistent however often files are added."""

import os
import shutil

import numpy as np
import pytest

from dousa import Library
from dousa.formats import ReadOptions, read_motion
from dousa.formats.parts import file_of, split_address
from formats.made_people import ANNA, BEN, join, prefixed, write_armatures, write_bvh, write_json


def names(library):
    return sorted(os.path.basename(clip.path) for clip in library.clips())


@pytest.fixture
def library(tmp_path):
    with Library.open(tmp_path / "l.dousa", create=True) as opened:
        yield opened


def test_each_person_is_a_clip_and_stays_one(tmp_path, library):
    folder = tmp_path / "takes"
    folder.mkdir()
    write_bvh(folder / "two.bvh")
    report = library.add(folder)
    assert (
        sorted(map(os.path.basename, report.added)) == names(library) == ["two.bvh#person=Anna", "two.bvh#person=Ben"]
    )
    assert report.bytes == (folder / "two.bvh").stat().st_size
    assert not report.warnings or all("parts." not in note.code for _, note in report.warnings)
    for clip in library.clips():
        stored = library.trajectories(clip.id)
        person = {"Anna": ANNA, "Ben": BEN}[split_address(clip.path)[1]["person"]]
        assert stored.positions[:, 0, 0].mean() == pytest.approx(person.translations[:, 0, 0].mean(), abs=1e-3)
    again = library.add(folder)
    assert (len(again.unchanged), again.added, again.skipped) == (2, (), ())
    os.utime(folder / "two.bvh", (1, 1))  # read again, and the same
    again = library.add(folder)
    assert (len(again.unchanged), again.added, again.replaced) == (2, (), ())


def test_one_is_added_by_name_or_number_and_the_others_later(tmp_path, library):
    write_bvh(tmp_path / "two.bvh")
    library.add(tmp_path / "two.bvh", options=ReadOptions(person="2"))
    assert names(library) == ["two.bvh#person=Ben"]
    report = library.add(tmp_path / "two.bvh")
    assert (len(report.added), len(report.unchanged)) == (1, 1) and len(names(library)) == 2
    ben = next(clip.id for clip in library.clips() if clip.path.endswith("Ben"))
    library.remove([ben])
    assert len(library.add(tmp_path / "two.bvh").added) == 1 and len(names(library)) == 2


def test_a_file_that_changes_has_the_clips_that_are_in_it(tmp_path, library):
    from dousa.formats import write_motion

    path = tmp_path / "x.bvh"
    write_motion(ANNA, path)
    library.add(path)
    assert names(library) == ["x.bvh"]
    write_bvh(path)
    library.add(path)
    assert names(library) == ["x.bvh#person=Anna", "x.bvh#person=Ben"]
    write_motion(join([BEN, ANNA], [prefixed()[1], lambda joint: f"Carol:{joint}"]), path)
    library.add(path)
    assert names(library) == ["x.bvh#person=Ben", "x.bvh#person=Carol"]
    path.write_text("HIERARCHY")
    assert len(library.add(path).skipped) == 1 and len(names(library)) == 2
    write_motion(BEN, path)
    library.add(path)
    assert names(library) == ["x.bvh"]


def test_copies_are_found_and_moves_followed(tmp_path, library):
    write_bvh(tmp_path / "a.bvh")
    library.add(tmp_path / "a.bvh")
    shutil.copy(tmp_path / "a.bvh", tmp_path / "b.bvh")
    report = library.add(tmp_path / "b.bvh")
    assert sorted((os.path.basename(d.path), os.path.basename(d.same_as)) for d in report.duplicates) == [
        ("b.bvh#person=Anna", "a.bvh#person=Anna"),
        ("b.bvh#person=Ben", "a.bvh#person=Ben"),
    ]
    (tmp_path / "a.bvh").unlink()
    report = library.add(tmp_path / "b.bvh")
    assert len(report.moved) == 2 and names(library) == ["b.bvh#person=Anna", "b.bvh#person=Ben"]


def test_clips_are_searched_and_written_by_their_addresses(tmp_path, library):
    write_json(tmp_path / "x.json", (4, 7))
    library.add(tmp_path / "x.json", options=ReadOptions(frame_rate=50))
    assert names(library) == ["x.json#person=id%204", "x.json#person=id%207"]
    clip = library.clips()[0]
    again = read_motion(clip.path, frame_rate=50)
    assert again.frame_rate == clip.frame_rate == 50 and file_of(clip.path) == str(tmp_path / "x.json")
    report = library.export(tmp_path / "out", to="npz")
    assert sorted(report.written) == ["x_id 4.npz", "x_id 7.npz"]
    written = [read_motion(tmp_path / "out" / name) for name in sorted(report.written)]
    assert np.abs(written[0].positions - written[1].positions).max() > 1
    report = library.export(tmp_path / "files")
    assert (tmp_path / "files" / report.written[0]).read_bytes() == (tmp_path / "x.json").read_bytes()


def test_each_animation_is_a_clip(library, shared_data):
    path = shared_data("reported/glb_several_animations/moves.glb")
    report = library.add(path)
    assert len(report.added) == 3
    assert names(library) == [f"moves.glb#animation={name}" for name in ("Idle", "Kick", "Walk")]
    assert len({clip.n_frames for clip in library.clips()}) > 1


def test_labels_beside_a_take_are_those_of_all_its_people(tmp_path, library):
    write_bvh(tmp_path / "two.bvh")
    (tmp_path / "two.labels.csv").write_text("start_s,end_s,category\n0.1,0.3,walk\n")
    for changed in (2, 0):
        report = library.add(tmp_path, kind="take", labels_from="beside")
        assert (len(report.labelled), report.warnings) == (changed, ())
    assert [[part.category for part in take.segments] for take in library.annotations.read()] == [["walk"]] * 2
    assert sum("#t=" in clip.path for clip in library.clips()) == 2
    assert len(library.export(tmp_path / "out", to="bvh").written) == 4


def test_animations_of_several_people_are_clips_of_those_who_move(tmp_path, library):
    path = tmp_path / "x.glb"
    write_armatures(path)
    for added in (3, 0):
        assert len(library.add(path).added) == added
        assert names(library) == [
            "x.glb#animation=duet&person=Anna", "x.glb#animation=duet&person=Ben", "x.glb#animation=solo",
        ]  # fmt: skip
    solo = read_motion(path, animation="solo")
    assert "parts.still" in [note.code for note in solo.provenance.notes]
    assert library.add(path, options=ReadOptions(animation="solo")).added == ()
