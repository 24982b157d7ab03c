"""Eigenspaces: eq. 8 to 14 against their literal transcription, invariants, and people who hardly move."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles import yamane_eigenspace as oracle

from dousa.errors import InvalidMotionError, OptionError
from dousa.evaluation import (
    compute_distance_from_space,
    compute_distance_to_path,
    compute_distance_within,
    compute_postures,
    fit_eigenspace,
    rotate_yaw,
)
from dousa.formats.registry import read_motion
from dousa.motion import canonicalise
from dousa.motion.synthetic.performers import draw_performer, make_motion

seeds = st.integers(0, 2**32 - 1)
kinds = st.sampled_from(["robust", "plain"])

REAL = ("bandai_dance/dataset-1_dance-short_normal_001.bvh", "hdm05/squat1Reps/HDM_bd_squat1Reps_001_120.amc")


def unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def wander(seed: int, n: int = 40) -> np.ndarray:
    """A furi: postures that vary about one, in a few directions, while the person turns."""
    rng = np.random.default_rng(seed)
    start = unit(rng.normal(size=(9, 3)))
    modes = rng.normal(size=(4, 9, 3)) * 0.3
    course = np.sin(rng.uniform(0.5, 3.0, 4) * np.linspace(0, 6, n)[:, None] + rng.uniform(0, 6, 4))
    poses = unit(start + np.tensordot(course, modes, axes=1))
    return rotate_yaw(poses, rng.uniform(-3, 3) + np.linspace(0, rng.uniform(-4, 4), n))


def flat(poses: np.ndarray) -> list[list[float]]:
    return poses.reshape(len(poses), 27).tolist()


@settings(max_examples=4, deadline=None)
@given(seeds, kinds, st.sampled_from([0.5, 0.9, 0.99, 1.0]))
def test_equations_8_to_14_are_those_of_the_paper(seed, yaw, contribution):
    poses = wander(seed, 20)
    space = fit_eigenspace(poses, contribution, yaw=yaw)
    check_against_oracle(space, space.align(poses), space.align(wander(seed + 1, 5)), contribution)


@pytest.mark.parametrize("name", REAL)
def test_equations_8_to_14_on_real_motion(shared_data: Callable[[str], Path], name):
    postures = compute_postures(canonicalise(read_motion(shared_data(name)))).segments[300:420:3]
    if len(postures) < 10:
        postures = compute_postures(canonicalise(read_motion(shared_data(name)))).segments[::4]
    space = fit_eigenspace(postures)
    other = space.align(postures[::7] * [-1, 1, 1])
    check_against_oracle(space, space.align(postures), other, 0.99)
    assert 1 <= space.n_dims <= 20


def check_against_oracle(space, aligned, others, contribution):
    mean, rows = oracle.mean(flat(aligned)), flat(aligned)
    assert np.allclose(space.mean.ravel(), mean, atol=2e-4)  # the direction of the mean itself
    values, vectors = oracle.eigen(oracle.covariance(rows))
    n_dims = space.n_dims
    assert n_dims == oracle.choose_dimensions(values, contribution - 1e-9)
    assert np.allclose(space.variances, values[:n_dims], atol=1e-5)
    assert space.contribution == pytest.approx(sum(values[:n_dims]) / sum(values), abs=1e-5)
    # The same space: its own eigenvectors are free where variances are equal, the projector is not.
    phi, middle = space.axes.T.tolist(), space.mean.ravel().tolist()
    gap = values[n_dims - 1] - values[n_dims] if n_dims < 27 else 1.0
    if gap > 1e-2 * values[0]:
        wanted = np.array(vectors[:n_dims]).T
        assert np.allclose(space.axes @ space.axes.T, wanted @ wanted.T, atol=2e-2)
    for x, y in zip(flat(aligned[: len(others)]), flat(others), strict=True):
        star = oracle.project(y, middle, phi)
        pose = np.array(y).reshape(1, 9, 3)
        before = np.array(x).reshape(1, 9, 3)
        assert np.allclose(space.project(pose)[0], star)
        assert np.allclose(space.residual(pose)[0], oracle.residual(y, middle, phi))
        assert compute_distance_from_space(space, pose)[0] == pytest.approx(oracle.distance_from_space(y, middle, phi))
        assert compute_distance_from_space(space, pose)[0] == pytest.approx(
            oracle.distance_from_space_by_residual(y, middle, phi)
        )
        within = compute_distance_within(space, before, pose)[0]
        assert within == pytest.approx(oracle.distance_within(x, y, middle, phi), abs=1e-12)
        assert within == pytest.approx(oracle.distance_within_by_difference(x, y, phi), abs=1e-12)
        assert compute_distance_to_path(space, aligned, pose)[0] == pytest.approx(
            oracle.distance_to_path(y, rows), abs=1e-7
        )


@settings(max_examples=40, deadline=None)
@given(seeds, kinds)
def test_mean_is_the_mean_of_the_aligned_postures(seed, yaw):
    poses = wander(seed)
    space = fit_eigenspace(poses, yaw=yaw)
    assert np.allclose(space.align(poses).mean(axis=0), space.mean, atol=2e-3)


@settings(max_examples=40, deadline=None)
@given(seeds)
def test_projection_and_residual_make_up_the_posture(seed):
    space = fit_eigenspace(wander(seed))
    others = space.align(wander(seed + 1))
    rebuilt = space.mean.ravel() + space.project(others) @ space.axes.T + space.residual(others)
    assert np.allclose(rebuilt, others.reshape(-1, 27))
    assert np.allclose(space.residual(others) @ space.axes, 0, atol=1e-12)
    away = np.linalg.norm((others - space.mean).reshape(-1, 27), axis=1)
    d_space = compute_distance_from_space(space, others)
    assert np.allclose(d_space**2 + (space.project(others) ** 2).sum(axis=1), away**2)


@settings(max_examples=30, deadline=None)
@given(seeds, kinds, st.floats(-3, 3), st.floats(-3, 3))
def test_distances_do_not_depend_on_where_people_face(seed, yaw, one, other):
    poses, performance = wander(seed), wander(seed + 1)
    first = fit_eigenspace(poses, yaw=yaw)
    second = fit_eigenspace(rotate_yaw(poses, np.array([one])), yaw=yaw)
    assert first.n_dims == second.n_dims
    a, b = first.align(performance), second.align(rotate_yaw(performance, np.array([other])))
    assert np.allclose(compute_distance_from_space(first, a), compute_distance_from_space(second, b), atol=1e-4)
    assert np.allclose(
        compute_distance_within(first, first.align(poses), a),
        compute_distance_within(second, second.align(poses), b),
        atol=1e-4,
    )


def test_axes_are_orthonormal_and_their_signs_fixed():
    space = fit_eigenspace(wander(4), 0.999)
    assert np.allclose(space.axes.T @ space.axes, np.eye(space.n_dims))
    assert (np.diff(space.variances) <= 0).all()
    assert (space.axes.max(axis=0) == np.abs(space.axes).max(axis=0)).all()
    again = fit_eigenspace(wander(4), 0.999)
    assert (again.axes == space.axes).all()
    with pytest.raises(ValueError, match="read-only"):
        space.axes[0, 0] = 1.0


def test_a_wrong_limb_does_not_turn_the_rest():
    poses = compute_postures(canonicalise(make_motion("bow", draw_performer(2)))).segments
    wrong = poses.copy()
    wrong[:, 3:5] = unit(np.array([0.3, 0.1, -1.0]))  # the right arm is stretched out to the back
    right = [0, 1, 2, 5, 6, 7, 8]
    bent = {}
    for yaw in ("robust", "plain"):
        space = fit_eigenspace(poses, yaw=yaw)
        bent[yaw] = np.linalg.norm((space.align(wrong) - space.align(poses))[:, right], axis=2).mean()
    assert bent["robust"] < np.radians(3) and bent["robust"] < 0.3 * bent["plain"]


def test_several_takes_are_pooled():
    takes = [compute_postures(canonicalise(make_motion("squat", draw_performer(3), k))).segments for k in range(3)]
    one, pooled = fit_eigenspace(takes[0]), fit_eigenspace(np.concatenate(takes))
    third = [compute_distance_from_space(s, s.align(takes[2])).mean() for s in (one, pooled)]
    assert pooled.n_frames == sum(map(len, takes)) and third[1] < third[0]


@pytest.mark.parametrize("n_frames", [1, 2, 50])
def test_one_who_stands_still_has_a_space_without_axes(n_frames):
    pose = wander(1, 1)
    poses = rotate_yaw(np.repeat(pose, n_frames, axis=0), np.linspace(0, 5, n_frames))
    space = fit_eigenspace(poses)
    assert (space.n_dims, space.contribution, space.axes.shape) == (0, 1.0, (27, 0))
    other = space.align(wander(2, 3))
    assert space.project(other).shape == (3, 0)
    assert np.allclose(compute_distance_within(space, other, other[::-1]), 0)
    assert (compute_distance_from_space(space, other) > 0.1).all()
    assert np.allclose(compute_distance_from_space(space, space.align(poses)), 0, atol=1e-6)


def test_two_frames_make_one_axis():
    assert fit_eigenspace(wander(3, 20)[[0, 10]]).n_dims == 1


def test_long_stretches_are_compared_in_pieces():
    poses, performance = wander(5, 30), wander(6, 50)
    space = fit_eigenspace(poses)
    arguments = space, space.align(poses), space.align(performance)
    whole = compute_distance_to_path(*arguments)
    assert np.allclose(compute_distance_to_path(*arguments, at_once=100), whole)


@pytest.mark.parametrize(
    ("arguments", "error", "says"),
    [
        ({"segments": np.zeros((0, 9, 3))}, InvalidMotionError, r"expected shape \(frames, 9, 3\)"),
        ({"segments": np.zeros((9, 3))}, InvalidMotionError, r"got \(9, 3\)"),
        ({"segments": np.full((4, 9, 3), np.nan)}, InvalidMotionError, "finite"),
        ({"contribution": 0.0}, OptionError, "contribution: expected a share above 0"),
        ({"contribution": np.nan}, OptionError, "got nan"),
        ({"contribution": 1.1}, OptionError, "got 1.1"),
        ({"yaw": "none"}, OptionError, "'robust' or 'plain', got 'none'"),
    ],
)
def test_what_cannot_be_is_refused(arguments, error, says):
    with pytest.raises(error, match=says):
        fit_eigenspace(**{"segments": wander(1), **arguments})


def test_a_path_needs_a_posture():
    space = fit_eigenspace(wander(1))
    with pytest.raises(InvalidMotionError, match="at least one posture"):
        compute_distance_to_path(space, np.zeros((0, 9, 3)), wander(1))
