"""Clips of a library as files: labels, formats, characters, and runs that are interrupted."""

import csv
import zipfile

import numpy as np
import pytest

from dousa import formats
from dousa.errors import LibraryError, MotionWriteError, OptionError
from dousa.files.disk import atomic_write
from dousa.formats.motion_files import ReadOptions
from dousa.formats.registry import WRITERS, read_motion, write_motion
from dousa.library import Library
from dousa.library import export as destination
from dousa.library.export import MANIFEST, ExportFormat, list_formats
from dousa.motion import Trajectories, canonicalise
from dousa.motion.annotation import Annotation, Stretch
from dousa.motion.synthetic import draw_performer, make_motion


@pytest.fixture
def recordings(tmp_path):
    for category in ("walk", "bow"):
        for number in range(2):
            path = tmp_path / "recordings" / category / f"take{number}.bvh"
            path.parent.mkdir(parents=True, exist_ok=True)
            write_motion(make_motion(category, draw_performer(number), seed=number), path)
    return tmp_path / "recordings"


@pytest.fixture
def library(tmp_path, recordings):
    with Library.open(tmp_path / "moves.dousa", create=True) as opened:
        opened.add([recordings], n_jobs=1)
        yield opened


def rows(folder):
    with open(folder / MANIFEST, encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_originals_are_the_same_bytes(tmp_path, library, recordings):
    report = library.export(tmp_path / "out")
    assert sorted(report.written) == ["bow/take0.bvh", "bow/take1.bvh", "walk/take0.bvh", "walk/take1.bvh"]
    for name in report.written:
        assert (tmp_path / "out" / name).read_bytes() == (recordings / name).read_bytes()
    table = rows(tmp_path / "out")
    assert [(row["file"], row["category"]) for row in table] == [(n, n.split("/")[0]) for n in sorted(report.written)]
    assert all(row["from"] == "file" for row in table)


@pytest.mark.parametrize(
    ("to", "suffix"), [("glb", ".glb"), ("c3d", ".c3d"), ("bvh", ".bvh"), ("csv", ".csv"), ("amass", ".amass.npz")]
)
def test_formats(tmp_path, library, to, suffix):
    report = library.export(tmp_path / "out", category="walk", to=to)
    assert sorted(report.written) == [f"walk/take{n}{suffix}" for n in range(2)]
    motion = read_motion(tmp_path / "out" / report.written[0])
    expected = make_motion("walk", draw_performer(0), seed=0)
    assert motion.n_frames == expected.n_frames
    if to != "amass":
        np.testing.assert_allclose(canonicalise(motion).positions, canonicalise(expected).positions, atol=1e-3)


def test_what_is_there_is_kept_and_what_changed_is_made_again(tmp_path, library):
    first = library.export(tmp_path / "out", to="glb")
    times = {name: (tmp_path / "out" / name).stat().st_mtime_ns for name in first.written}
    (tmp_path / "out" / "walk" / "take1.glb").unlink()
    (tmp_path / "out" / "notes.txt").write_text("mine")
    second = library.export(tmp_path / "out", to="glb")
    assert second.written == ("walk/take1.glb",)
    assert len(second.kept) == 3
    for name in second.kept:
        assert (tmp_path / "out" / name).stat().st_mtime_ns == times[name]
    assert (tmp_path / "out" / "notes.txt").read_text() == "mine"
    # Onto a character it is another motion.
    character = tmp_path / "character.bvh"
    write_motion(make_motion("bow", draw_performer(9)), character)
    third = library.export(tmp_path / "out", to="glb", onto=character)
    assert len(third.written) == 4
    heights = [canonicalise(read_motion(tmp_path / "out" / name)).height for name in third.written]
    np.testing.assert_allclose(heights, canonicalise(read_motion(character)).height, atol=1e-3)


@pytest.mark.parametrize("name", ["out", "all.zip"])
def test_an_interrupted_export_goes_on(tmp_path, library, name):
    path = tmp_path / name

    def stop(done, total, name):
        if done == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        library.export(path, to="bvh", progress=stop)
    assert not path.exists() if name == "all.zip" else len(rows(path)) == 3
    seen = []
    report = library.export(path, to="bvh", progress=lambda *what: seen.append(what[:2]))
    assert (len(report.kept), len(report.written)) == (3, 1)
    assert seen == [(n, 4) for n in range(5)]
    assert len(names_in(path) if name == "all.zip" else list(path.rglob("*.*"))) == 5
    assert not [left for left in tmp_path.rglob("*") if left.suffix == ".part" or left.name.startswith(".all.zip")]


def test_a_full_disk_ends_the_export_and_the_same_goes_on(tmp_path, library, monkeypatch):
    whole, lists = formats.write_motion, []

    def write(motion, path):
        if len(list((tmp_path / "out").rglob("*.bvh"))) == 3:
            raise MotionWriteError(path, "disk.full")
        whole(motion, path)

    def write_list(path):
        lists.append(path)
        if len(lists) > 1:  # the first names all files
            raise MotionWriteError(path, "disk.full")
        return atomic_write(path)

    with monkeypatch.context() as patch:
        patch.setattr(formats, "write_motion", write)
        patch.setattr(destination, "atomic_write", write_list)
        with pytest.raises(MotionWriteError, match=r"the disk is full.*3 of 4 clips are written") as caught:
            library.export(tmp_path / "out", to="bvh")
    assert (caught.value.code, caught.value.path) == ("export.no_room", str(tmp_path / "out"))
    assert len(destination.read_manifest(tmp_path / "out" / MANIFEST)) == 4
    report = library.export(tmp_path / "out", to="bvh")
    assert (len(report.kept), len(report.written), report.skipped) == (3, 1, ())


def test_a_source_that_is_gone(tmp_path, library, recordings):
    (recordings / "walk" / "take0.bvh").unlink()
    report = library.export(tmp_path / "a", category="walk")
    assert len(report.written) == 1
    assert report.skipped[0].reason.code == "disk.missing"
    report = library.export(tmp_path / "b", category="walk", to="c3d")
    assert {row["from"] for row in rows(tmp_path / "b")} == {"file", "stored joints"}
    motion = canonicalise(read_motion(tmp_path / "b" / "walk" / "take0.c3d"))
    expected = canonicalise(make_motion("walk", draw_performer(0), seed=0))
    np.testing.assert_allclose(motion.positions, expected.positions, atol=1e-3)


@pytest.mark.parametrize("name", ["out", "out.zip"])
def test_sources_that_are_all_gone_are_named_and_leave_no_list(tmp_path, library, recordings, name):
    for path in (recordings / "walk").iterdir():
        path.unlink()
    report = library.export(tmp_path / name, category="walk")
    assert {skipped.reason.code for skipped in report.skipped} == {"disk.missing"} and not report.written
    assert not list(tmp_path.glob("out/**/*.*")) and not list(tmp_path.glob("*.zip")), "nor a list of files to come"


def test_what_cannot_be_is_said(tmp_path, library):
    with pytest.raises(OptionError, match="original"):
        library.export(tmp_path / "out", to="original", onto="x.bvh")
    with pytest.raises(OptionError, match="glb"):
        library.export(tmp_path / "out", to="mvnx")
    with pytest.raises(LibraryError):
        library.export(tmp_path / "out", category="flight")
    with pytest.raises(OptionError, match="--onto"):
        library.export(tmp_path / "out", to="glb", keep_reach=True)
    with pytest.raises(OptionError, match="rate"):
        library.export(tmp_path / "out", to="glb", frame_rate=-1)
    (tmp_path / "file").write_text("")
    with pytest.raises(OptionError, match="folder"):
        library.export(tmp_path / "file")
    assert not (tmp_path / "out").exists()


def names_in(path):
    with zipfile.ZipFile(path) as archive:
        assert archive.testzip() is None
        return sorted(archive.namelist())


def test_a_zip_file(tmp_path, library):
    path = tmp_path / "new" / "walks.zip"
    report = library.export(path, category="walk", to="glb")
    assert names_in(path) == [MANIFEST, "walk/take0.glb", "walk/take1.glb"]
    assert [item.name for item in path.parent.iterdir()] == ["walks.zip"]
    # Once more, with others: what is in it stays.
    report = library.export(path, to="glb")
    assert sorted(report.kept) == ["walk/take0.glb", "walk/take1.glb"]
    assert sorted(report.written) == ["bow/take0.glb", "bow/take1.glb"]
    assert len(names_in(path)) == 5
    other = tmp_path / "other.zip"
    for content in (b"mine", None):
        if content is None:
            with zipfile.ZipFile(other, "w") as archive:
                archive.writestr("letter.txt", "mine")
        else:
            other.write_bytes(content)
        before = other.read_bytes()
        with pytest.raises(OptionError, match="another name"):
            library.export(other)
        assert other.read_bytes() == before


def test_a_zip_does_not_write_elsewhere(tmp_path, library):
    """Names that lead out of the folder are left out."""
    path = tmp_path / "sub" / "bad.zip"
    path.parent.mkdir()
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr(MANIFEST, "")
        archive.writestr("../../escaped.txt", "x")
    library.export(path, category="walk", to="glb")
    assert not list(tmp_path.rglob("escaped.txt"))
    assert len(names_in(path)) == 3


def test_what_is_said_of_the_files_counts(tmp_path, library):
    """Unit, rate and character of the files that are written; what was said when they were added holds otherwise."""
    doubled = library.export(tmp_path / "a", category="walk", to="npz", options=ReadOptions(unit=0.02))
    plain = library.export(tmp_path / "b", category="walk", to="npz", frame_rate=30.0)
    first, second = (
        read_motion(tmp_path / folder / report.written[0]) for folder, report in (("a", doubled), ("b", plain))
    )
    assert canonicalise(first).height == pytest.approx(2 * canonicalise(second).height)
    assert second.frame_rate == 30.0
    assert library.export(tmp_path / "b", category="walk", to="npz").kept == ()  # at another rate they are others


def test_a_part_of_a_take(tmp_path):
    """Segments are cut out of the file, with all of its joints; there is no original of them."""
    take = tmp_path / "take.bvh"
    write_motion(make_motion("walk", draw_performer(3)), take)
    with Library.open(tmp_path / "takes.dousa", create=True) as library:
        library.add(take, kind="take", n_jobs=1)
        library.annotations.write(library.clips()[0].id, Annotation((Stretch(0.2, 0.9, "step"),)), n_jobs=1)
        report = library.export(tmp_path / "out", category="step", to="npz")
        assert report.written == ("step/take_0.20s.npz",)
        part, whole = read_motion(tmp_path / "out" / report.written[0]), read_motion(take)
        first = round(0.2 * whole.frame_rate)
        np.testing.assert_array_equal(part.rotations, whole.rotations[first : round(0.9 * whole.frame_rate)])
        assert rows(tmp_path / "out")[0]["end_s"] == "0.9"
        assert library.export(tmp_path / "same", category="step").skipped[0].reason.code == "export.part_of_take"
        take.unlink()
        assert library.export(tmp_path / "joints", category="step", to="c3d").written


def test_the_joint_map_reaches_the_character(tmp_path):
    """Points with names of nobody's go onto a character when a map says which is which."""
    walk = canonicalise(make_motion("walk", draw_performer(2))).to_trajectories()
    odd = {name: f"P{number}" for number, name in enumerate(walk.names)}
    write_motion(Trajectories(tuple(odd.values()), walk.positions, walk.frame_rate), tmp_path / "odd.c3d")
    write_motion(make_motion("bow", draw_performer(9)), tmp_path / "character.bvh")
    with Library.open(tmp_path / "odd.dousa", create=True) as library:
        library.add([tmp_path / "odd.c3d"], options=ReadOptions(joint_map=odd), n_jobs=1)
        report = library.export(tmp_path / "out", to="bvh", onto=tmp_path / "character.bvh")
        assert not report.skipped
        bad = library.export(
            tmp_path / "bad", to="bvh", onto=tmp_path / "character.bvh", options=ReadOptions(joint_map={"neck": "P3"})
        )
        assert bad.skipped
    made = canonicalise(read_motion(tmp_path / "out" / report.written[0]))
    assert made.height == pytest.approx(canonicalise(make_motion("bow", draw_performer(9))).height, abs=1e-3)


def test_every_format_that_is_written_can_be_named():
    assert list_formats()["glb"] == ".glb"
    assert list_formats()["amass"] == ".amass.npz"
    assert set(list_formats().values()) == set(WRITERS)
    for name in list_formats():
        assert ExportFormat(name).to == name


def test_files_that_no_export_has_written_stay(tmp_path, library, recordings):
    before = {path: path.read_bytes() for path in recordings.rglob("*.bvh")}
    first = library.export(recordings, to="bvh", frame_rate=10.0)
    assert {path: path.read_bytes() for path in before} == before and len(first.written) == 4
    again = library.export(recordings, to="bvh", frame_rate=10.0)
    assert sorted(again.kept) == sorted(first.written) and len(list(recordings.rglob("*.bvh"))) == 8


def test_a_list_of_somebody_else_is_refused(tmp_path, library):
    own = tmp_path / "out" / MANIFEST
    own.parent.mkdir()
    own.write_text("title,composer\nSakura,-\n")
    with pytest.raises(OptionError, match=r"manifest\.csv was not written by an export"):
        library.export(tmp_path / "out")
    assert own.read_text() == "title,composer\nSakura,-\n" and len(list(own.parent.iterdir())) == 1
