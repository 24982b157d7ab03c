"""The table of formats: choice by suffix, errors that name the file, formats of other packages by entry points."""

import importlib
import subprocess
import sys

import numpy as np
import pytest

from dousa.app.pipelines.estimation_body import load_given_body
from dousa.app.studio.core.uploads import motion_suffixes
from dousa.app.targets import check_table
from dousa.errors import (
    InvalidMotionError,
    JointMappingError,
    MotionFileError,
    MotionWriteError,
    OptionError,
    UnknownFormatError,
)
from dousa.formats import ReadOptions
from dousa.formats.registry import (
    FORMATS,
    SUFFIXES,
    WRITERS,
    list_suffixes,
    load_plugins,
    read_motion,
    write_motion,
)
from dousa.motion import Motion, Skeleton, Trajectories, compute_trajectories

POINTS = Trajectories(("a", "b"), np.random.default_rng(0).normal(size=(4, 2, 3)), 25.0)


def make_motion():
    skeleton = Skeleton(("hips", "knee"), [-1, 0], [[0, 1, 0], [0, -0.5, 0]])
    rotations = np.tile([1.0, 0, 0, 0], (3, 2, 1))
    return Motion(skeleton, rotations, np.tile(skeleton.offsets, (3, 1, 1)), 25.0)


def test_every_line_of_the_table_works():
    for line in FORMATS:
        module = importlib.import_module(line.module)
        for name in (line.reader, line.writer):
            assert name is None or callable(getattr(module, name))
        assert all(suffix == suffix.lower() and suffix.startswith(".") for suffix in line.suffixes)
        assert line.holds in ("motion", "trajectories", "both")


def test_the_table_is_the_one_promised():
    assert " ".join(SUFFIXES) == (
        ".bvh .amc .c3d .trc .npz .npy .pkl .pk .pickle .joblib .pt .csv .tsv .json .vmd .mot .mvnx .fbx .dae .usd"
        " .usda .usdc .usdz .glb .gltf .vrm .vrma"
    )
    assert " ".join(WRITERS) == ".bvh .c3d .trc .opencap.trc .amass.npz .npz .angles.csv .csv .vmd .mot .fbx .glb"


def test_the_help_of_the_commands_names_them():
    from dousa.app.cli import files

    assert files.READ_SUFFIXES.split() == list(SUFFIXES)
    assert files.WRITTEN_SUFFIXES.split() == list(WRITERS)


def test_looking_at_the_table_imports_no_reader():
    code = (
        "import sys, dousa.formats; "
        "print(sorted(m for m in sys.modules if m.startswith(('dousa.formats.', 'numba', 'ezc3d'))))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == str([f"dousa.formats.{name}" for name in ("motion_files", "parts", "registry")])


@pytest.mark.parametrize("suffix", [".trc", ".TRC", ".c3d", ".C3d", ".npz", ".NPZ"])
def test_the_suffix_chooses_in_any_case(tmp_path, suffix):
    write_motion(POINTS, tmp_path / f"x{suffix}")
    got = read_motion(tmp_path / f"x{suffix}", up=None if suffix.lower() == ".npz" else "y")
    np.testing.assert_allclose(got.positions, POINTS.positions, rtol=1e-6)


def test_unknown_suffixes_name_the_known_ones(tmp_path):
    for name in ("x.max", "x", "x.bvh.rar"):
        with pytest.raises(UnknownFormatError, match=r"\.bvh, \.amc, \.c3d, \.trc, .*\.npz"):
            read_motion(tmp_path / name)
        with pytest.raises(UnknownFormatError, match=r"written end in \.bvh, \.c3d, \.trc, .*\.npz"):
            write_motion(POINTS, tmp_path / name)
    with pytest.raises(UnknownFormatError, match="written"):
        write_motion(POINTS, tmp_path / "x.amc")
    with pytest.raises(UnknownFormatError, match=r"give the \.amc"):
        read_motion(tmp_path / "x.ASF")


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_missing_empty_and_folder(tmp_path, suffix):
    path = tmp_path / f"x{suffix}"
    with pytest.raises(MotionFileError, match="no such file"):
        read_motion(path)
    path.touch()
    with pytest.raises(MotionFileError, match="empty"):
        read_motion(path)
    path.unlink()
    path.mkdir()
    with pytest.raises(MotionFileError, match="folder"):
        read_motion(path)


def test_a_file_under_a_wrong_suffix(tmp_path):
    contents = {}
    for suffix in (".bvh", ".c3d", ".trc", ".npz"):
        write_motion(make_motion(), tmp_path / f"x{suffix}")
        contents[suffix] = (tmp_path / f"x{suffix}").read_bytes()
    for suffix in SUFFIXES:
        for other, content in contents.items():
            if other != suffix:
                (tmp_path / f"wrong{suffix}").write_bytes(content)
                with pytest.raises(MotionFileError, match="wrong"):
                    read_motion(tmp_path / f"wrong{suffix}")


def test_options(tmp_path):
    write_motion(POINTS, tmp_path / "x.trc")
    got = read_motion(tmp_path / "x.trc", unit="cm", up="-Z")
    assert (got.provenance.unit, got.provenance.up) == (0.01, "-z")
    assert read_motion(tmp_path / "x.trc", unit=0.5, up="y").provenance.unit == 0.5
    for options in ({"unit": "ells"}, {"unit": -1}, {"up": "w"}):
        with pytest.raises(OptionError):
            read_motion(tmp_path / "x.trc", **options)
    with pytest.raises(OptionError, match=r"\.amc and \.vmd files and SMPL poses only"):
        read_motion(tmp_path / "x.trc", skeleton="x.asf")


def test_a_motion_becomes_positions_where_the_format_wants_them(tmp_path):
    motion = make_motion()
    expected = compute_trajectories(motion)
    write_motion(motion, tmp_path / "x.trc")
    got = read_motion(tmp_path / "x.trc", up="y")
    assert got.names == ("hips", "knee")
    np.testing.assert_array_equal(got.positions, expected.positions)
    write_motion(motion, tmp_path / "x.npz")
    assert isinstance(read_motion(tmp_path / "x.npz"), Motion)


def test_positions_of_a_body_become_a_bvh(tmp_path, shared_data):
    points = read_motion(sorted(shared_data("utd_mhad/skeleton").glob("*/*.c3d"))[0])
    write_motion(points, tmp_path / "x.bvh")
    got = read_motion(tmp_path / "x.bvh")
    assert isinstance(got, Motion)
    assert (got.n_frames, got.frame_rate) == (points.n_frames, pytest.approx(30))


def test_positions_of_no_body_do_not(tmp_path):
    with pytest.raises(MotionWriteError, match="no body can be fitted"):
        write_motion(POINTS, tmp_path / "x.bvh")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "problem",
    [
        ValueError("bad"), IndexError("bad"), KeyError("bad"), ZeroDivisionError("bad"), MemoryError(),
        InvalidMotionError("bad"),
    ],
)  # fmt: skip
def test_whatever_a_reader_meets_the_file_is_named(tmp_path, monkeypatch, problem):
    def fail(*_, **__):
        raise problem

    monkeypatch.setattr("dousa.formats.tables.read_trc", fail)
    with pytest.raises(MotionFileError, match=r"damaged\.trc: ") as caught:
        read_motion(tmp_path / "damaged.trc")
    assert type(caught.value) is MotionFileError


CODE = """
import numpy as np
from dousa.formats import Format
from dousa.motion import Trajectories

WALK = Format("walk", (".walk",), "walk_format", "read_walk", "write_walk", "trajectories")
LOST = (Format("lost", (".lost",), "walk_format", "read_lost", None, "trajectories"),)
CHARACTERS = Format("characters", (".x"), "walk_format", "read_walk", None, "trajectories")

def read_walk(path, *, unit=None, up=None):
    return Trajectories(("a",), np.loadtxt(path).reshape(-1, 1, 3), 25.0)

def write_walk(motion, path):
    np.savetxt(path, motion.positions[:, 0])
"""
PATH = Trajectories(("a",), np.arange(12.0).reshape(4, 1, 3), 25.0)


@pytest.fixture
def install(tmp_path, monkeypatch):
    def install(*entries):
        metadata = tmp_path / "walk_format-1.0.dist-info"
        metadata.mkdir()
        (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: walk-format\nVersion: 1.0\n")
        (metadata / "entry_points.txt").write_text("[dousa.formats]\n" + "\n".join(entries) + "\n")
        (tmp_path / "walk_format.py").write_text(CODE)
        monkeypatch.syspath_prepend(tmp_path)
        load_plugins.cache_clear()

    yield install
    sys.modules.pop("walk_format", None)
    load_plugins.cache_clear()


@pytest.mark.parametrize(
    "entry", ["lost = walk_format:LOST", "lost = no_such_module:LOST", "lost = walk_format:CHARACTERS"]
)
def test_a_bad_plugin_fails_only_for_its_files(install, tmp_path, entry):
    install(entry)
    write_motion(PATH, tmp_path / "take.trc")
    assert read_motion(tmp_path / "take.trc").n_frames == 4
    with pytest.raises(UnknownFormatError, match="plug-in 'lost' cannot be used"):
        read_motion(tmp_path / "take.lost")


def test_the_suffixes_of_plugins_are_known_everywhere(install, tmp_path):
    install("walk = walk_format:WALK", "broken = walk_format:NOTHING")
    path = tmp_path / "take.walk"
    write_motion(POINTS, path)
    assert ".walk" in list_suffixes() and ".walk" in motion_suffixes()
    with pytest.raises(OptionError, match="motion"):
        check_table("--output", path, ())
    with pytest.raises(JointMappingError):  # it was read as a motion, and not as the TOML of a body
        load_given_body(path, ReadOptions())
    with pytest.raises(UnknownFormatError, match=r"\.bvh, .*\.walk; the plug-in 'broken' cannot be used"):
        read_motion(tmp_path / "take.max")
