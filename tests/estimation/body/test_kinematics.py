"""Forward kinematics of a body against plain quaternions, and poses as a motion."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dousa.errors import BodyModelError
from dousa.estimation.body.body import BodyModel
from dousa.estimation.body.human import make_human
from dousa.estimation.body.kinematics import compute_points, place_parts, point_names, to_motion
from dousa.motion import compute_trajectories

# The oracle: Hamilton's quaternions as tuples, one part of one pose at a time.


def times(a, b):
    w, x, y, z = a
    p, q, r, s = b
    return (
        w * p - x * q - y * r - z * s,
        w * q + x * p + y * s - z * r,
        w * r - x * s + y * p + z * q,
        w * s + x * r - y * q + z * p,
    )


def turn_by(vector):
    angle = math.sqrt(sum(c * c for c in vector))
    if angle == 0.0:
        return (1.0, 0.0, 0.0, 0.0)
    return (math.cos(angle / 2), *(math.sin(angle / 2) * c / angle for c in vector))


def turned(q, vector):
    return times(times(q, (0.0, *vector)), (q[0], -q[1], -q[2], -q[3]))[1:]


def plain_points(body, pose):
    """World quaternions (P) and places of joints and tips (P + K), by the words of `BodyModel`."""
    quaternions, places = [], []
    angles = list(pose[7:])
    for part in range(body.n_parts):
        count, axes = int(body.n_axes[part]), body.axes[part]
        own, angles = angles[:count], angles[count:]
        if part == 0:
            quaternions.append(tuple(pose[3:7]))
            places.append(tuple(pose[:3]))
            continue
        local = tuple(body.rest[part])
        if count == 3:
            swing = [own[0] * axes[0][k] + own[1] * axes[1][k] for k in range(3)]
            turns = [swing, [own[2] * c for c in axes[2]]]
        else:
            turns = [[angle * c for c in axis] for angle, axis in zip(own, axes[:count], strict=True)]
        for turn in turns:
            local = times(local, turn_by(turn))
        parent = body.parents[part]
        places.append(
            tuple(a + b for a, b in zip(places[parent], turned(quaternions[parent], body.offsets[part]), strict=True))
        )
        quaternions.append(times(quaternions[parent], local))
    for part, offset in zip(body.tip_parts, body.tip_offsets, strict=True):
        places.append(tuple(a + b for a, b in zip(places[part], turned(quaternions[part], offset), strict=True)))
    return quaternions, np.array(places)


def unit(vector):
    return vector / np.linalg.norm(vector)


def random_tree(rng):
    """A body of any shape: parts of 0 to 3 axes on random parents, with rest rotations."""
    n_parts, n_tips = rng.integers(1, 7), rng.integers(0, 4)
    n_axes = np.concatenate(([0], rng.integers(0, 4, n_parts - 1)))
    axes = np.zeros((n_parts, 3, 3))
    for part, count in enumerate(n_axes):
        axes[part, :count] = np.linalg.qr(rng.normal(size=(3, 3)))[0][:count]
    offsets = rng.normal(size=(n_parts, 3))
    offsets[0] = 0
    return BodyModel(
        names=[f"part{k}" for k in range(n_parts)],
        joints=[f"joint{k}" for k in range(n_parts)],
        parents=[-1, *(rng.integers(0, k) for k in range(1, n_parts))],
        offsets=offsets,
        rest=np.array([unit(q) for q in rng.normal(size=(n_parts, 4))]),
        n_axes=n_axes,
        axes=axes,
        limits=np.tile([-3.0, 3.0], (n_parts, 3, 1)),
        spheres=np.tile([0, 0, 0, 0.1], (n_parts, 1)),
        sphere_starts=np.arange(n_parts + 1),
        tips=[f"tip{k}" for k in range(n_tips)],
        tip_parts=rng.integers(0, n_parts, n_tips),
        tip_offsets=rng.normal(size=(n_tips, 3)),
        stature=2.0,
    )


def random_poses(body, rng, count):
    poses = rng.uniform(-2, 2, (count, 7 + body.n_angles))
    poses[:, 3:7] = [unit(q) for q in rng.normal(size=(count, 4))]
    return poses


seeds = st.integers(0, 2**32 - 1)


@settings(max_examples=60, deadline=None)
@given(seeds)
def test_parts_and_points_of_any_tree_are_the_oracles(seed):
    rng = np.random.default_rng(seed)
    body = random_tree(rng)
    poses = random_poses(body, rng, 2)
    rotations, positions = place_parts(body, poses)
    points = compute_points(body, poses)
    for t, pose in enumerate(poses):
        quaternions, places = plain_points(body, pose)
        matrices = [np.stack([turned(q, axis) for axis in np.eye(3)], axis=1) for q in quaternions]
        np.testing.assert_allclose(rotations[t], matrices, atol=1e-12)
        np.testing.assert_allclose(positions[t], places[: body.n_parts], atol=1e-12)
        np.testing.assert_allclose(points[t], places, atol=1e-12)


@settings(max_examples=40, deadline=None)
@given(seeds, st.floats(1, 240))
def test_the_motion_puts_every_joint_where_the_body_has_it(seed, rate):
    rng = np.random.default_rng(seed)
    body = random_tree(rng)
    poses = random_poses(body, rng, 3)
    motion = to_motion(body, poses, rate)
    moving = compute_trajectories(motion)
    assert moving.names == point_names(body) and moving.frame_rate == rate
    np.testing.assert_allclose(moving.positions, compute_points(body, poses), atol=1e-9)


def test_batches_of_any_shape():
    body = make_human()
    poses = random_poses(body, np.random.default_rng(1), 6)
    flat = compute_points(body, poses)
    np.testing.assert_array_equal(compute_points(body, poses.reshape(2, 3, -1)), flat.reshape(2, 3, *flat.shape[1:]))
    np.testing.assert_array_equal(compute_points(body, poses[0]), flat[0])
    assert compute_points(body, poses[:0]).shape == (0, 20, 3)


@pytest.mark.parametrize("shape", [(), (3,), (2, 3), (2, 500)])
def test_poses_of_another_length_are_refused(shape):
    with pytest.raises(BodyModelError, match="poses: expected rows of"):
        compute_points(make_human(), np.zeros(shape))


def test_poses_are_not_changed():
    body = make_human()
    poses = random_poses(body, np.random.default_rng(1), 2)
    before = poses.copy()
    compute_points(body, poses)
    to_motion(body, poses, 30.0)
    np.testing.assert_array_equal(poses, before)
