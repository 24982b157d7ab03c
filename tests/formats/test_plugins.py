"""Formats of other packages, by entry points of the group dousa.formats."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from dousa.app.pipelines.estimation_body import load_given_body
from dousa.app.studio.core.uploads import motion_suffixes
from dousa.app.targets import check_table
from dousa.errors import JointMappingError, OptionError, UnknownFormatError
from dousa.formats import ReadOptions
from dousa.formats.registry import find_reader, list_suffixes, load_plugins, read_motion, write_motion
from dousa.motion import Trajectories

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
POINTS = Trajectories(("a",), np.arange(12.0).reshape(4, 1, 3), 25.0)


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


def test_a_package_adds_a_format(install, tmp_path):
    install("walk = walk_format:WALK", "broken = walk_format:NOTHING")
    write_motion(POINTS, tmp_path / "take.walk")
    assert find_reader(tmp_path / "take.walk").name == "walk"
    np.testing.assert_array_equal(read_motion(tmp_path / "take.walk").positions, POINTS.positions)


@pytest.mark.parametrize(
    "entry", ["lost = walk_format:LOST", "lost = no_such_module:LOST", "lost = walk_format:CHARACTERS"]
)
def test_a_bad_plugin_fails_only_for_its_files(install, tmp_path, entry):
    install(entry)
    write_motion(POINTS, tmp_path / "take.trc")
    assert read_motion(tmp_path / "take.trc").n_frames == 4
    with pytest.raises(UnknownFormatError, match="plug-in 'lost' cannot be used"):
        read_motion(tmp_path / "take.lost")


def test_the_suffixes_of_plugins_are_known_everywhere(install, tmp_path):
    install("walk = walk_format:WALK", "broken = walk_format:NOTHING")
    path = tmp_path / "take.walk"
    write_motion(POINTS, path)
    assert ".walk" in list_suffixes() and ".walk" in motion_suffixes()
    with pytest.raises(OptionError, match="motion"):
        check_table("--output", path, (), overwrite=True)
    with pytest.raises(JointMappingError):  # it was read as a motion, and not as the TOML of a body
        load_given_body(path, ReadOptions())
    with pytest.raises(UnknownFormatError, match=r"\.bvh, .*\.walk; the plug-in 'broken' cannot be used"):
        read_motion(tmp_path / "take.max")
