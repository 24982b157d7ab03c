"""gzip and zip of motion files, and folders whose files only look like motions by their suffix."""

from __future__ import annotations

import numpy as np
import pytest

from dousa.errors import MotionFileError, UnknownFormatError
from dousa.formats import find_motion_files
from dousa.formats.registry import read_motion
from formats import made_files as made
from formats.test_fuzz_readers import AMC, ASF, BVH


def save(path, data):
    path.write_bytes(data)
    return path


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
        "features.npy": made.make_npy(rng.normal(size=(4, 263))),
        "notes.txt.gz": made.pack_gzip(b"hello"),
        "angles.mot": b"Coordinates\n",
    }
    for name, data in (wanted | others).items():
        save(tmp_path / name, data)
    found, missing = find_motion_files([tmp_path])
    assert [file.path.name for file in found] == sorted(wanted)
    assert not missing
    with pytest.raises(UnknownFormatError, match="joint angles of an OpenSim model"):
        read_motion(tmp_path / "angles.mot")
