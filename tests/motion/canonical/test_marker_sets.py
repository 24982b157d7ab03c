"""Published marker sets on bodies whose joints are known: which joints they give, and where, in any spelling."""

import functools

import numpy as np
import pytest
from oracles.bodies import walking_body
from oracles.marker_bodies import MARKER_SETS as SETS
from oracles.marker_bodies import MarkerSet, wear

from dousa.formats.registry import read_motion
from dousa.motion import CANONICAL_JOINTS, JOINT_INDEX, Trajectories, canonicalise
from dousa.motion.canonical.geometry import move_inside
from dousa.motion.canonical.naming import REQUIRED_JOINTS, match_names

MOST_MM = {"hip": 30, "knee": 20, "ankle": 20, "shoulder": 45, "elbow": 45, "wrist": 45}
"""Median distance from the joint centres: hips by regression; shoulders and wrists of one marker are known least."""

SPELLINGS = {
    "subject": lambda name: f"Subject 01:{name}",
    "prefix": lambda name: f"S01_{name}",
    "two words before": lambda name: f"251112_KUO_{name}",
    "Japanese before": lambda name: f"被験者1_{name}",
    "behind": lambda name: f"{name}_1",
    "lower": str.lower,
    "upper": str.upper,
    "spaces": lambda name: f" {name.replace('_', '  ')}  ",
    "wide letters": lambda name: name.translate({code: code + 0xFEE0 for code in range(33, 127)}),
}


def _points() -> np.ndarray:
    return canonicalise(walking_body()).positions.copy()


def _off(found: np.ndarray, points: np.ndarray, joint: str) -> float:
    """Median distance, mm."""
    index = JOINT_INDEX[joint]
    return float(1000 * np.median(np.linalg.norm(found[:, index] - points[:, index], axis=1)))


def _check(markers: MarkerSet, points: np.ndarray, rate: float, allowed: dict[str, float]) -> None:
    found = canonicalise(wear(markers, points, rate))
    assert {joint for joint in found.absent if joint in REQUIRED_JOINTS} == markers.absent
    assert found.mapping.sides != "disagree"
    for joint in REQUIRED_JOINTS:
        if joint not in markers.absent:
            assert _off(found.positions, points, joint) < allowed[joint.partition("_")[2]], joint


@pytest.mark.parametrize("title", SETS)
def test_joints_are_where_the_body_has_them(title: str) -> None:
    allowed = MOST_MM | ({"hip": 60} if "DIFF" in title else {})  # the trochanters alone tell little of the hips
    _check(SETS[title], _points(), 30.0, allowed)


@pytest.mark.parametrize(
    "title", ["Plug-in Gait, full body", "CMU 41", "IOR trunk, Leardini 2011", "Motive Baseline 37"]
)
@pytest.mark.parametrize("take", ["grabHighR/*_001_*", "squat1Reps/*_002_*", "lieDownFloor/*_001_*"])
def test_joints_of_recorded_people(title: str, take: str, shared_data) -> None:
    files = sorted(shared_data("hdm05").glob(f"{take}.amc"))
    body = canonicalise(read_motion(files[0]))
    _check(SETS[title], body.positions[:300].copy(), body.frame_rate, MOST_MM)


match_plainly = functools.cache(match_names)


@pytest.mark.parametrize("spelling", SPELLINGS)
def test_spelling_does_not_matter(spelling: str) -> None:
    for markers in SETS.values():
        plain = match_plainly(tuple(markers.names))
        spelled = match_names(tuple(map(SPELLINGS[spelling], markers.names)))
        assert plain is not None and spelled is not None
        assert spelled.missing == plain.missing, markers.title
        joints = [joint for joint in CANONICAL_JOINTS if joint in plain.sources]
        assert [spelled.sources.get(joint) for joint in joints] == [plain.sources[joint] for joint in joints]


def test_what_is_estimated_and_what_is_there_is_said() -> None:
    found = canonicalise(wear(SETS["Plug-in Gait, lower body"], _points(), 30.0))
    said = {note.code: note.values for note in found.warnings}
    assert {"left_leg", "right_leg"} == set(said["canonical.part"]["there"])
    assert {"left_wrist", "head"} <= set(said["canonical.part"]["absent"])
    assert set(said["canonical.skin_markers"]["joints"]) == {
        f"{side}_{joint}" for side in ("left", "right") for joint in ("hip", "knee", "ankle")
    }
    inside = canonicalise(wear(SETS["Visual3D six degrees of freedom"], _points(), 30.0))
    said = {note.code: note.values for note in inside.warnings}
    assert set(said["canonical.skin_markers"]["joints"]) == {"left_hip", "right_hip"}


@pytest.mark.parametrize("mirror", [1.0, -1.0])
def test_a_marker_beside_the_knee_is_moved_inside_whatever_the_unit_and_handedness(mirror: float) -> None:
    points = _points()
    skin = frozenset({"left_knee", "right_knee", "left_elbow", "right_elbow"})
    worn = wear(SETS["Plug-in Gait, full body"], points, 30.0)
    moved = points.copy()
    for joint, marker in (("knee", "KNE"), ("elbow", "ELB")):
        for side, letter in (("left", "L"), ("right", "R")):
            moved[:, JOINT_INDEX[f"{side}_{joint}"]] = worn.positions[:, worn.names.index(letter + marker)]
    before = moved.copy()
    moved *= (1000.0, 1000.0, 1000.0 * mirror)
    move_inside(moved, skin)
    moved /= (1000.0, 1000.0, 1000.0 * mirror)
    for joint in sorted(skin):
        assert _off(moved, points, joint) < 0.4 * _off(before, points, joint)
    others = [index for joint, index in JOINT_INDEX.items() if joint not in skin]
    np.testing.assert_allclose(moved[:, others], before[:, others], atol=1e-9)


@pytest.mark.parametrize(("first", "second"), [("Anna:", "Ben:"), ("S1_", "S2_")])
def test_of_several_people_the_first_is_taken_and_said(first: str, second: str) -> None:
    worn = wear(SETS["Plug-in Gait, full body"], _points(), 30.0)
    keep = [index for index, name in enumerate(worn.names) if name != "RFIN"]  # which only the second wears
    names = tuple(first + worn.names[index] for index in keep) + tuple(second + name for name in worn.names)
    both = np.concatenate([worn.positions[:, keep], worn.positions + np.array([2.0, 0, 0])], axis=1)
    found = canonicalise(Trajectories(names, both, 30.0))
    (note,) = [one for one in found.warnings if one.code == "canonical.several"]
    assert note.values == {"first": first[:-1], "others": (second[:-1],)}
    assert all(name.startswith(first) for sources in found.mapping.sources.values() for name in sources)
    assert _off(found.positions, _points(), "right_hand") < 200
    assert canonicalise(worn).mapping.sources["right_hand"] == ("RFIN",)


def test_nothing_is_moved_where_nothing_tells_the_size() -> None:
    points = np.full((3, 20, 3), np.nan)
    move_inside(points, frozenset({"left_knee"}))
    assert np.isnan(points).all()
