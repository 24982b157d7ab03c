"""Joint maps: the three spellings, their errors, and their use."""

import json

import numpy as np
import pytest
from oracles.bodies import walking_body

from dousa.errors import JointMappingError, OptionError
from dousa.motion import Trajectories, canonicalise, read_joint_map
from dousa.motion.canonical.naming import REQUIRED_JOINTS


@pytest.mark.parametrize(
    "text",
    [
        'pelvis = ["a", "b"]\nleft_elbow = "elbow 03"  # comment\n',
        '[joints]\npelvis = ["a", "b"]\nleft_elbow = "elbow 03"\n',
        json.dumps({"pelvis": ["a", "b"], "left_elbow": "elbow 03"}),
        "# by hand\npelvis = a, b\n\nleft_elbow = elbow 03   # comment\n",
        "\ufeffpelvis = [a, b]\r\nleft_elbow = 'elbow 03'\r\n",
    ],
)
def test_spellings(tmp_path, text: str) -> None:
    path = tmp_path / "map.txt"
    path.write_bytes(text.encode())
    assert read_joint_map(path) == {"pelvis": ("a", "b"), "left_elbow": ("elbow 03",)}


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("", "expected lines"),
        ("left_elbow\n", r"map.txt:1: expected 'canonical joint = name"),
        ("elbow = a\n", "'elbow' is not a canonical joint; they are: pelvis"),
        ('{"pelvis": 3}', "expected a name or a list of names, got 3"),
        ('{"pelvis": }', r"map.txt:1: not valid JSON"),
        ("pelvis = []\n", "expected a name or a list of names"),
        ("left_knee = A\nleft_knee = B\n", r"map\.txt:2: 'left_knee' is given a second time"),
    ],
)
def test_errors(tmp_path, text: str, problem: str) -> None:
    path = tmp_path / "map.txt"
    path.write_text(text)
    with pytest.raises(OptionError, match=problem):
        read_joint_map(path)


def test_unreadable(tmp_path) -> None:
    with pytest.raises(OptionError, match="cannot be read"):
        read_joint_map(tmp_path / "none.toml")
    (tmp_path / "bytes").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(OptionError, match="UTF-8"):
        read_joint_map(tmp_path / "bytes")


def _unknown() -> tuple[Trajectories, dict[str, str]]:
    canonical = canonicalise(walking_body()).to_trajectories()
    names = tuple(f"M{i}" for i in range(len(canonical.names)))
    joint_map = {joint: name for joint, name in zip(canonical.names, names, strict=True) if joint in REQUIRED_JOINTS}
    return Trajectories(names, canonical.positions, 30.0), joint_map


def test_a_map_names_what_nothing_else_tells() -> None:
    moving, joint_map = _unknown()
    canonical = canonicalise(moving, joint_map)
    assert canonical.mapping.table == "joint map"
    assert canonical.mapping.sides == "agree"
    np.testing.assert_array_equal(canonical.positions[:, 5], moving.positions[:, 5])


def test_a_map_overrides_names_and_averages() -> None:
    body = walking_body()
    canonical = canonicalise(body, {"spine": ("Spine", "Chest")})
    np.testing.assert_allclose(canonical.positions[:, 1], body.select(["Spine", "Chest"]).mean(axis=1))
    assert canonical.mapping.sources["spine"] == ("Spine", "Chest")


def test_a_map_that_does_not_fit() -> None:
    moving, joint_map = _unknown()
    with pytest.raises(JointMappingError, match="'nothing' for left_elbow, but there is no such joint"):
        canonicalise(moving, {**joint_map, "left_elbow": "nothing"})
    del joint_map["left_knee"]
    assert canonicalise(moving, joint_map).absent == ("left_knee", "left_toe")
    with pytest.raises(JointMappingError, match="leaves out left_shoulder"):
        canonicalise(moving, {"left_hip": "M1"})
    with pytest.raises(OptionError, match="not a canonical joint"):
        canonicalise(moving, {"tail": "M1"})
