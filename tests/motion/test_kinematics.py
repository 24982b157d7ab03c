"""Forward kinematics against 4 x 4 matrices."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles.kinematics import world_positions

from dousa.motion import Motion, Skeleton, compute_trajectories, forward_kinematics, kinematics
from dousa.motion import rotations as r


@given(st.integers(0, 2**32 - 1), st.integers(1, 12), st.integers(1, 4))
@settings(deadline=None, max_examples=40)
def test_random_trees(seed, joints, frames):
    rng = np.random.default_rng(seed)
    parents = np.array([-1, *(rng.integers(-1, j) for j in range(1, joints))])
    q = r.normalise(rng.normal(size=(frames, joints, 4)))
    v = rng.normal(size=(frames, joints, 3))
    positions, world = forward_kinematics(parents, q, v)
    for t in range(frames):
        assert np.allclose(positions[t], world_positions(parents, r.to_matrix(q[t]), v[t]))
    roots = parents < 0
    assert np.allclose(world[:, roots], q[:, roots])


def test_a_few_frames_are_the_same_without_the_kernel(monkeypatch):
    rng = np.random.default_rng(3)
    parents = [-1, 0, 1, 0, -1]
    q, v = r.normalise(rng.normal(size=(7, 5, 4))), rng.normal(size=(7, 5, 3))
    found = []
    for worth in (True, False):
        monkeypatch.setattr(kinematics, "is_worth_compiling", lambda numbers, worth=worth: worth)
        found.append(forward_kinematics(parents, q, v))
    np.testing.assert_array_equal(found[0][0], found[1][0])
    np.testing.assert_array_equal(found[0][1], found[1][1])


def test_batch_dimensions_lead_and_broadcast():
    parents = [-1, 0]
    q = r.from_euler(np.linspace(0, 1, 24).reshape(2, 3, 2, 2), "ZX")
    v = np.array([[0.0, 1, 0], [1, 0, 0]])
    positions, world = forward_kinematics(parents, q, v)
    assert positions.shape == (2, 3, 2, 3) and world.shape == (2, 3, 2, 4)
    assert np.allclose(positions[1, 2], forward_kinematics(parents, q[1, 2], v)[0])


def test_missing_rotation_hides_what_hangs_below():
    skeleton = Skeleton(("a", "b", "c"), [-1, 0, 0], np.zeros((3, 3)))
    q = r.identity((2, 3))
    q[1, 0] = np.nan
    made = compute_trajectories(Motion(skeleton, q, np.ones((2, 3, 3)), 30))
    assert np.isfinite(made.positions[0]).all()
    assert np.isfinite(made.positions[1, 0]).all()
    assert np.isnan(made.positions[1, 1:]).all()


def test_names_tree_and_rest_pose_are_carried_over():
    skeleton = Skeleton(("a", "b", "c"), [-1, 0, 1], [[0, 1, 0], [0, 0, 2], [3, 0, 0]])
    made = compute_trajectories(Motion(skeleton, r.identity((1, 3)), np.zeros((1, 3, 3)), 30))
    assert made.names == ("a", "b", "c")
    assert np.array_equal(made.rest_positions, [[0, 1, 0], [0, 1, 2], [3, 1, 2]])
    assert np.array_equal(made.parents, [-1, 0, 1])
