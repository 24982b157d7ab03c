"""Joints are found by the shape of the tree when the names say nothing."""

import dataclasses

import numpy as np
import pytest
from oracles.bodies import walking_body

from dousa.errors import JointMappingError
from dousa.formats.registry import read_motion
from dousa.motion import CANONICAL_JOINTS, Trajectories, canonicalise, compute_trajectories
from dousa.motion.canonical.tree_shape import shape_sources


def _nameless(moving: Trajectories) -> Trajectories:
    return moving.replace(names=tuple(f"j{i}" for i in range(len(moving.names))))


@pytest.mark.parametrize("path", ["hdm05", "bandai"])
def test_renamed_recordings_map_alike(path: str, shared_data) -> None:
    files = sorted(p for p in shared_data(path).rglob("*") if p.suffix.lower() in (".amc", ".bvh"))
    for file in files[:: max(1, len(files) // 12)]:
        moving = compute_trajectories(read_motion(file))
        by_name, by_shape = canonicalise(moving), canonicalise(_nameless(moving))
        assert by_shape.mapping.table == "tree shape"
        apart = np.linalg.norm(by_shape.positions - by_name.positions, axis=-1).max(axis=0)
        doubtful = ("neck", "wrist", "hand") if path == "hdm05" else ()  # two necks, a forearm of two bones
        limits = [0.12 if joint.endswith(doubtful) else 1e-6 for joint in CANONICAL_JOINTS]
        assert (apart <= limits).all(), (file, dict(zip(CANONICAL_JOINTS, apart, strict=True)))
        assert any(warning.code.startswith("canonical.by_shape") for warning in by_shape.warnings)


def test_made_figure() -> None:
    body = walking_body()
    sources = shape_sources(body.parents, body.positions)
    assert sources is not None
    found = {joint: body.names[i] for joint, (i,) in sources.items()}
    assert found["left_knee"] == "LeftLeg"
    assert found["right_wrist"] == "RightHand"
    assert found["pelvis"] == "Hips"
    assert found["head"] == "Head_end"


def test_scale_yaw_and_missing_frames_change_nothing() -> None:
    body = walking_body()
    turn = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
    positions = 37.0 * body.positions @ turn.T
    positions[3, 5] = np.nan
    assert shape_sources(body.parents, positions) == shape_sources(body.parents, body.positions)


def test_no_body() -> None:
    chain = np.arange(30) - 1
    positions = np.zeros((4, 30, 3))
    positions[..., 1] = np.arange(30)
    assert shape_sources(chain, positions) is None
    assert shape_sources(chain, np.zeros((4, 30, 3))) is None
    assert shape_sources(np.array([-1]), np.zeros((1, 1, 3))) is None


def test_a_one_armed_figure_is_a_part_of_a_body() -> None:
    body = walking_body()
    kept = [i for i, n in enumerate(body.names) if not n.startswith("LeftShoulder") and "LeftArm" not in n]
    kept = [i for i in kept if not body.names[i].startswith(("LeftFore", "LeftHand"))]
    parents = np.array([-1 if body.parents[i] < 0 else kept.index(body.parents[i]) for i in kept])
    assert body.rest_positions is not None
    cut = dataclasses.replace(
        body,
        names=tuple(body.names[i] for i in kept),
        positions=body.positions[:, kept],
        parents=parents,
        rest_positions=body.rest_positions[kept],
    )
    assert canonicalise(cut).absent == ("left_shoulder", "left_elbow", "left_wrist", "left_hand")
    with pytest.raises(JointMappingError, match="no known family"):
        canonicalise(_nameless(cut))
