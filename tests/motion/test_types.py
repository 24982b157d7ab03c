"""Skeleton, Motion and Trajectories check themselves once and are then read-only."""

import numpy as np
import pytest

from dousa.errors import InvalidMotionError
from dousa.motion import Motion, Provenance, Skeleton, Trajectories
from dousa.motion.rotations import identity


def skeleton() -> Skeleton:
    return Skeleton(("hips", "spine", "head"), np.array([-1, 0, 1]), np.array([[0.0, 1, 0], [0, 0.5, 0], [0, 0.3, 0]]))


def motion(**changes) -> Motion:
    fields = {
        "skeleton": skeleton(), "rotations": identity((4, 3)), "translations": np.zeros((4, 3, 3)), "frame_rate": 30.0,
    }  # fmt: skip
    return Motion(**{**fields, **changes})


def test_arrays_are_read_only_and_do_not_follow_the_callers():
    offsets = np.zeros((1, 3))
    made = Skeleton(("a",), [-1], offsets)
    offsets[0] = 9
    assert made.offsets[0, 0] == 0
    with pytest.raises(ValueError, match="read-only"):
        made.offsets[0] = 1
    with pytest.raises(AttributeError):
        made.names = ()


def test_views_of_a_callers_array_are_copied():
    buffer = np.zeros((2, 4, 3, 3))
    made = motion(translations=buffer[0])
    buffer[:] = 5
    assert (made.translations == 0).all()


@pytest.mark.parametrize(
    ("parents", "says"),
    [([-1, 2, 1], "parent before"), ([-1, 1, 0], "parent before"), ([-1, -2, 0], "parent before"), ([-1, 0], "shape")],
)
def test_trees_that_are_none(parents, says):
    with pytest.raises(InvalidMotionError, match=says):
        Skeleton(("a", "b", "c"), parents, np.zeros((3, 3)))


def test_no_joint_and_infinite_offset():
    with pytest.raises(InvalidMotionError, match="at least one joint"):
        Skeleton((), [], np.zeros((0, 3)))
    with pytest.raises(InvalidMotionError, match="'a'"):
        Skeleton(("a",), [-1], [[0, np.inf, 0]])


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"rotations": np.zeros((4, 3, 4))}, "unit quaternions"),
        ({"rotations": identity((4, 2))}, "shape"),
        ({"rotations": identity((0, 3)), "translations": np.zeros((0, 3, 3))}, "at least one frame"),
        ({"translations": np.full((4, 3, 3), np.inf)}, "finite"),
        ({"frame_rate": 0}, "frame rate"),
        ({"frame_rate": float("nan")}, "frame rate"),
    ],
)
def test_motions_that_are_none(changes, says):
    with pytest.raises(InvalidMotionError, match=says):
        motion(**changes)


def test_missing_rotations_are_allowed():
    rotations = identity((4, 3))
    rotations[2] = np.nan
    assert np.isnan(motion(rotations=rotations).rotations[2]).all()


def test_changed_motions_drop_the_files_numbers():
    made = motion(provenance=Provenance("a.bvh", "bvh", layout="kept", values=np.zeros((4, 9))))
    changed = made.replace(frame_rate=60.0)
    assert changed.provenance.values is None
    assert changed.provenance.layout == "kept"
    assert made.provenance.values is not None


def test_trajectories_check_themselves():
    points = Trajectories(("a", "b"), np.full((2, 2, 3), np.nan), 25)
    assert (points.n_frames, points.duration) == (2, 0.08)
    assert points.select(["b"]).shape == (2, 1, 3)
    with pytest.raises(InvalidMotionError, match="no point 'c'"):
        points.select(["c"])
    with pytest.raises(InvalidMotionError, match="infinite position of 'b' in frame 1"):
        Trajectories(("a", "b"), [[[0, 0, 0]] * 2, [[0, 0, 0], [0, np.inf, 0]]], 25)
    with pytest.raises(InvalidMotionError, match="at least one"):
        Trajectories((), np.zeros((2, 0, 3)), 25)


def test_joint_by_name():
    assert skeleton().index("head") == 2
    with pytest.raises(InvalidMotionError, match="hips, spine, head"):
        skeleton().index("tail")
