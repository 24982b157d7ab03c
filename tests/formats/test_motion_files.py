"""Which files of the given paths are motion files, and those that are packed by gzip or zip."""

import errno
import os
from pathlib import Path

import numpy as np
import pytest

from dousa.errors import MotionFileError, UnknownFormatError
from dousa.formats import find_motion_files
from dousa.formats.registry import read_motion
from formats import made_files as made
from formats.made_files import save
from formats.test_asf_amc import AMC, ASF
from formats.test_bvh import SMALL as BVH


def touch(root: Path, *names: str) -> None:
    for name in names:
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("x")


def names(root: Path, *given: Path) -> list[str]:
    files, _ = find_motion_files(given or [root])
    return [file.path.relative_to(root).as_posix() for file in files]


def test_hidden_files_and_folders_are_left_out(tmp_path):
    touch(tmp_path, ".a.bvh", ".git/b.bvh", "c.bvh")
    assert names(tmp_path) == ["c.bvh"]


def test_a_file_that_is_named_is_taken_whatever_it_is(tmp_path):
    touch(tmp_path, "notes.txt")
    assert names(tmp_path, tmp_path / "notes.txt") == ["notes.txt"]


def test_a_folder_that_cannot_be_looked_into_is_named(tmp_path, monkeypatch):
    touch(tmp_path, "open/a.bvh", "closed/b.bvh")
    look = os.scandir

    def refuse(folder):
        if os.path.basename(folder) == "closed":
            raise PermissionError(errno.EACCES, "Permission denied", os.fspath(folder))
        return look(folder)

    monkeypatch.setattr(os, "scandir", refuse)
    files, missing = find_motion_files([tmp_path])
    assert [file.path.name for file in files] == ["a.bvh"]
    assert [(item.path, str(item.reason)) for item in missing] == [
        (str(tmp_path / "closed"), "the folder cannot be read: permission denied")
    ]


def test_links_in_a_circle_end(tmp_path):
    touch(tmp_path, "a/1.bvh")
    os.symlink(tmp_path, tmp_path / "a" / "up")
    assert names(tmp_path) == ["a/1.bvh"]


def test_a_broken_link_does_not_stop_the_rest(tmp_path):
    touch(tmp_path, "a/1.bvh")
    os.symlink(tmp_path / "gone", tmp_path / "a" / "folder")
    os.symlink(tmp_path / "gone.bvh", tmp_path / "a" / "2.bvh")
    assert names(tmp_path) == ["a/1.bvh", "a/2.bvh"]


def test_a_file_is_found_once_under_the_first_path(tmp_path):
    touch(tmp_path, "a/b/1.bvh")
    files, _ = find_motion_files([tmp_path / "a", tmp_path / "a" / "b", tmp_path / "a" / "b" / "1.bvh"])
    assert [(file.root, file.path) for file in files] == [(tmp_path / "a", tmp_path / "a" / "b" / "1.bvh")]


def test_missing_paths_are_reported(tmp_path):
    files, missing = find_motion_files([tmp_path / "none", tmp_path / "none.bvh"])
    assert files == []
    assert [item.path for item in missing] == [str(tmp_path / "none"), str(tmp_path / "none.bvh")]
    assert "no such file" in str(missing[0].reason)


def test_packed_is_as_unpacked(tmp_path):
    plain = read_motion(save(tmp_path / "x.bvh", BVH.encode()))
    for name, data in (
        ("a.bvh.gz", made.pack_gzip(BVH.encode())),
        ("b.zip", made.pack_zip(x__bvh=BVH, readme__txt="hello")),
        ("c.BVH.ZIP", made.pack_zip(x__bvh=BVH)),
    ):
        motion = read_motion(save(tmp_path / name, data))
        np.testing.assert_array_equal(motion.rotations, plain.rotations)
        assert motion.provenance.path == str(tmp_path / name)


def test_an_archive_with_a_skeleton(tmp_path):
    motion = read_motion(save(tmp_path / "x.zip", made.pack_zip(a__asf=ASF, a__amc=AMC)))
    assert motion.skeleton.names[0] == "root"


def test_what_cannot_be_unpacked_is_said(tmp_path):
    for name, data, code in (
        ("a.bvh.gz", b"no gzip", "packed.damaged"),
        ("b.zip", b"no zip", "packed.damaged"),
        ("c.bvh.gz", made.pack_gzip(BVH.encode())[:-9], "packed.damaged"),
        ("d.zip", made.pack_zip(x__bvh=BVH, y__bvh=BVH), "packed.motions"),
        ("e.zip", made.pack_zip(x__txt=BVH), "packed.motions"),
        ("f.bvh.gz", made.pack_gzip(bytes(150_000_000)), "packed.large"),
        ("g.bvh.gz", made.pack_gzip(BVH[:200].encode()), "bvh.open_braces"),
    ):
        with pytest.raises(MotionFileError) as caught:
            read_motion(save(tmp_path / name, data))
        assert caught.value.path == str(tmp_path / name)
        assert caught.value.code == code or name[0] == "g"
    with pytest.raises(UnknownFormatError):
        read_motion(save(tmp_path / "x.txt.gz", made.pack_gzip(b"hello")))


def test_folders_give_motions_only(tmp_path):
    rng = np.random.default_rng(0)
    wanted = {
        "a.npy": made.make_npy(rng.normal(size=(4, 22, 3))),
        "b.csv": made.make_motive(),
        "c.tsv": made.make_qualisys(),
        "d.pkl": made.make_aist(),
        "e.bvh.gz": made.pack_gzip(BVH.encode()),
        "f.mvnx": made.make_mvnx(),
    }
    others = {
        "labels.csv": b"start,end,category\n",
        "table.tsv": b"a\tb\n",
        "model.pkl": b"\x80\x04}\x94.",
        "features.npy": made.make_npy(rng.normal(size=(4, 264))),
        "notes.txt.gz": made.pack_gzip(b"hello"),
        "forces.mot": b"name forces\nendheader\ntime\tground_force_vx\n",
        "states.sto": b"Coordinates\n",
    }
    for name, data in (wanted | others).items():
        save(tmp_path / name, data)
    found, missing = find_motion_files([tmp_path])
    assert [file.path.name for file in found] == sorted(wanted)
    assert not missing
    with pytest.raises(UnknownFormatError, match="joint angles of an OpenSim model"):
        read_motion(tmp_path / "states.sto")
