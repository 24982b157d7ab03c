"""NPZ: nothing is lost, and nothing hostile gets through."""

import json
import zipfile

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dousa.errors import MotionFileError, MotionWriteError
from dousa.formats.arrays.npz import read_npz, write_npz
from dousa.motion import Motion, Provenance, Skeleton, Trajectories
from dousa.motion.rotations import normalise

PROVENANCE = Provenance("walk ü.bvh", "bvh", 0.0254 / 0.45, "inferred", "-z", "given")


def make_motion(seed=0, n_frames=3, n_joints=4, provenance=PROVENANCE):
    rng = np.random.default_rng(seed)
    parents = [int(rng.integers(-1, joint)) if joint else -1 for joint in range(n_joints)]
    skeleton = Skeleton(
        tuple(f"joint {'ü' * joint}" for joint in range(n_joints)),
        parents,
        rng.normal(size=(n_joints, 3)),
        rng.random(n_joints) < 0.3,
    )
    rotations = normalise(rng.normal(size=(n_frames, n_joints, 4)))
    rotations[0, 0] = np.nan
    return Motion(skeleton, rotations, rng.normal(size=(n_frames, n_joints, 3)), 1 / 0.0083333, provenance)


def make_trajectories(**changes):
    positions = np.random.default_rng(1).normal(size=(4, 2, 3))
    positions[1, 1] = np.nan
    return Trajectories(("a", "b"), positions, 29.97, **changes)


def saved_arrays(path, moving):
    write_npz(moving, path)
    with np.load(path, allow_pickle=False) as archive:
        return dict(archive)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 1000), n_frames=st.integers(1, 6), n_joints=st.integers(1, 8))
def test_a_motion_comes_back_whole(tmp_path_factory, seed, n_frames, n_joints):
    motion = make_motion(seed, n_frames, n_joints)
    path = tmp_path_factory.mktemp("npz") / "x.npz"
    write_npz(motion, path)
    got = read_npz(path)
    assert isinstance(got, Motion)
    assert got.skeleton.names == motion.skeleton.names
    for name in ("parents", "offsets", "end_sites"):
        np.testing.assert_array_equal(getattr(got.skeleton, name), getattr(motion.skeleton, name))
    np.testing.assert_array_equal(got.rotations, motion.rotations)
    np.testing.assert_array_equal(got.translations, motion.translations)
    assert got.frame_rate == motion.frame_rate
    assert got.provenance == PROVENANCE


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"parents": [-1, 0]},
        {"rest_positions": np.ones((2, 3))},
        {"parents": [-1, -1], "rest_positions": np.zeros((2, 3)), "provenance": PROVENANCE},
    ],
)
def test_trajectories_come_back_whole(tmp_path, changes):
    moving = make_trajectories(**changes)
    write_npz(moving, tmp_path / "x.npz")
    got = read_npz(tmp_path / "x.npz")
    assert isinstance(got, Trajectories)
    assert (got.names, got.frame_rate, got.provenance) == (moving.names, moving.frame_rate, moving.provenance)
    np.testing.assert_array_equal(got.positions, moving.positions)
    for name in ("parents", "rest_positions"):
        one, other = getattr(got, name), getattr(moving, name)
        assert (one is None) == (other is None)
        assert one is None or np.array_equal(one, other)


@given(name=st.text(st.characters(exclude_characters="\0", exclude_categories=[]), max_size=30))
def test_any_name_but_the_zero_byte(tmp_path_factory, name):
    path = tmp_path_factory.mktemp("npz") / "x.npz"
    write_npz(Trajectories((name, ""), np.zeros((1, 2, 3)), 1.0), path)
    assert read_npz(path).names == (name, "")


def test_a_zero_byte_in_a_name(tmp_path):
    with pytest.raises(MotionWriteError, match="zero byte"):
        write_npz(Trajectories(("a\0",), np.zeros((1, 1, 3)), 1.0), tmp_path / "x.npz")


def test_unit_and_axis_are_fixed(tmp_path):
    write_npz(make_trajectories(), tmp_path / "x.npz")
    assert read_npz(tmp_path / "x.npz", unit="m", up="+Y").n_frames == 4
    for options in ({"unit": "mm"}, {"up": "z"}):
        with pytest.raises(MotionFileError, match="leave out"):
            read_npz(tmp_path / "x.npz", **options)


def big_endian(array):
    return array.astype(array.dtype.newbyteorder(">"))


def test_other_byte_orders_and_float32_are_read(tmp_path):
    arrays = saved_arrays(tmp_path / "x.npz", make_motion())
    arrays |= {name: big_endian(arrays[name]) for name in ("rotations", "translations", "parents")}
    arrays |= {"offsets": np.asfortranarray(arrays["offsets"].astype(np.float32))}
    np.savez(tmp_path / "y.npz", **arrays)
    got = read_npz(tmp_path / "y.npz")
    np.testing.assert_array_equal(got.rotations, make_motion().rotations)
    np.testing.assert_allclose(got.skeleton.offsets, make_motion().skeleton.offsets, rtol=1e-6)


CHANGES = [
    ({"parents": np.array([1, 0, 1, 2])}, "parent before its child"),
    ({"parents": np.array([-1, 0, 9, 2])}, "parent before its child"),
    ({"parents": np.array([-1, -7, 1, 2])}, "parent"),
    ({"parents": np.array([-1.0, 0, 1, 2])}, "'parents': expected"),
    ({"parents": np.array([-1, 0])}, "parents: expected shape"),
    ({"rotations": np.zeros((3, 4, 4))}, "unit quaternions"),
    ({"rotations": np.zeros((3, 4, 3))}, "rotations: expected shape"),
    ({"rotations": np.zeros((0, 4, 4))}, "at least one frame"),
    ({"rotations": np.zeros((3, 16))}, "'rotations': expected 3 axes, got 2"),
    ({"translations": np.full((3, 4, 3), np.inf)}, "finite"),
    ({"translations": np.zeros((2, 4, 3))}, "translations: expected shape"),
    ({"translations": np.zeros((3, 4, 3), complex)}, "translations"),
    ({"offsets": np.full((4, 3), np.nan)}, "finite offsets"),
    ({"offsets": np.array([["a"] * 3] * 4)}, "'offsets': expected"),
    ({"end_sites": np.zeros(4)}, "'end_sites': expected"),
    ({"names": np.array(["only one"])}, "expected shape"),
    ({"names": np.array([], "U1")}, "at least one joint"),
    ({"names": np.array([b"a", b"b", b"c", b"d"])}, "names"),
    ({"frame_rate": np.array(0.0)}, "frame rate"),
    ({"frame_rate": np.array(np.nan)}, "frame rate"),
    ({"frame_rate": np.array([1.0, 2.0])}, "'frame_rate': expected 0 axes, got 1"),
    ({"kind": np.array("movie")}, "'movie'"),
    ({"format": np.array("other")}, "not a motion file"),
    ({"version": np.array(2)}, "update dousa"),
    ({"version": np.array(2**63, np.uint64)}, "update dousa"),
    ({"provenance": np.array("{")}, "not JSON"),
    ({"provenance": np.array("[" * 100_000)}, "not JSON"),
    ({"provenance": np.array("[]")}, "expected the texts"),
    ({"provenance": np.array(json.dumps({"unit": 1.0}))}, "expected the texts"),
]


@pytest.mark.parametrize(("changes", "message"), CHANGES)
def test_arrays_that_make_no_motion(tmp_path, changes, message):
    arrays = saved_arrays(tmp_path / "x.npz", make_motion()) | changes
    np.savez(tmp_path / "bad.npz", **arrays)
    with pytest.raises(MotionFileError, match=message) as caught:
        read_npz(tmp_path / "bad.npz")
    assert "bad.npz" in str(caught.value)


@pytest.mark.parametrize("unit", [0.0, -1.0, "1", None, float("nan"), float("inf"), True])
def test_units_that_are_none(tmp_path, unit):
    arrays = saved_arrays(tmp_path / "x.npz", make_motion())
    fields = json.loads(str(arrays["provenance"])) | {"unit": unit}
    np.savez(tmp_path / "bad.npz", **(arrays | {"provenance": np.array(json.dumps(fields))}))
    with pytest.raises(MotionFileError, match="metres per unit"):
        read_npz(tmp_path / "bad.npz")


@pytest.mark.parametrize("missing", ["format", "version", "kind", "names", "rotations", "parents", "end_sites"])
def test_missing_arrays(tmp_path, missing):
    arrays = saved_arrays(tmp_path / "x.npz", make_motion())
    del arrays[missing]
    np.savez(tmp_path / "bad.npz", **arrays)
    with pytest.raises(MotionFileError, match=missing):
        read_npz(tmp_path / "bad.npz")


def test_pickles_are_never_opened(tmp_path):
    arrays = saved_arrays(tmp_path / "x.npz", make_motion())
    arrays["names"] = np.array([print, "b", "c", "d"], dtype=object)
    np.savez(tmp_path / "bad.npz", allow_pickle=True, **arrays)
    with pytest.raises(MotionFileError, match="not a plain numpy array"):
        read_npz(tmp_path / "bad.npz")


def npy(header, content=b""):
    text = header.encode("latin-1") + b"\n"
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text + content


@pytest.mark.parametrize(
    "member",
    [
        b"",
        b"\x93NUMPY",
        b"not numpy at all",
        npy("{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000, 4, 4), }"),
        npy("{'descr': '<f8', 'fortran_order': False, 'shape': (-1,), }", bytes(8)),
        npy("{'descr': '<U0', 'fortran_order': False, 'shape': (1000000000000,), }"),
        npy("{'descr': '<i3', 'fortran_order': False, 'shape': (1,), }", bytes(3)),
        npy("{'descr': '<U999999999', 'fortran_order': False, 'shape': (), }"),
        npy("{'descr': '|O', 'fortran_order': False, 'shape': (1,), }", bytes(8)),
        npy("{'descr': [('a', '<f8')], 'fortran_order': False, 'shape': (1,), }", bytes(8)),
        npy("{'descr': '<f8', 'fortran_order': False, 'shape': (1, 1, 1, 1, 1), }", bytes(8)),
        npy("{'descr': '<f8', 'fortran_order': False, 'shape': (9" + "9" * 150 + ", 0), }"),
        npy("(" * 9000),
        npy("{'descr': '<U1', 'fortran_order': False, 'shape': (4,), }", b"\xff\xff\xff\xff" * 4),
    ],
)
def test_hostile_arrays(tmp_path, member):
    write_npz(make_motion(), tmp_path / "x.npz")
    with zipfile.ZipFile(tmp_path / "x.npz") as source, zipfile.ZipFile(tmp_path / "bad.npz", "w") as target:
        for name in source.namelist():
            target.writestr(name, member if name == "names.npy" else source.read(name))
    with pytest.raises(MotionFileError):
        read_npz(tmp_path / "bad.npz")


def test_compressed_archives_are_refused(tmp_path):
    """So that a thousand million zeros in a megabyte are never unpacked."""
    arrays = saved_arrays(tmp_path / "x.npz", make_motion())
    np.savez_compressed(tmp_path / "bad.npz", **arrays)
    with pytest.raises(MotionFileError, match="compressed"):
        read_npz(tmp_path / "bad.npz")


def test_other_archives(tmp_path):
    path = tmp_path / "x.npz"
    np.savez(path, mask=np.zeros((2, 2)))
    with pytest.raises(MotionFileError, match="not a motion file of dousa"):
        read_npz(path)
    np.savez(path, **{f"a{number}": np.zeros(1) for number in range(100)})
    with pytest.raises(MotionFileError, match="archive of 100 files"):
        read_npz(path)
    path.write_bytes(b"PK\x05\x06" + bytes(18))
    with pytest.raises(MotionFileError, match="not a motion file"):
        read_npz(path)
    np.save(tmp_path / "x.npy", np.zeros(3))
    (tmp_path / "x.npy").replace(path)
    with pytest.raises(MotionFileError, match=r"not an \.npz file"):
        read_npz(path)


def test_every_truncation_is_noticed(tmp_path):
    write_npz(make_trajectories(), tmp_path / "x.npz")
    data = (tmp_path / "x.npz").read_bytes()
    for length in range(1, len(data), 37):
        (tmp_path / "bad.npz").write_bytes(data[:length])
        with pytest.raises(MotionFileError):
            read_npz(tmp_path / "bad.npz")
