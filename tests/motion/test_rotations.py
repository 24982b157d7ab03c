"""Rotation kernels: against matrices, against scipy, and at zero, pi and gimbal lock."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from oracles.kinematics import euler_matrix
from scipy.spatial.transform import Rotation

from dousa.errors import InvalidMotionError
from dousa.motion import rotations as r

ORDERS = ["".join(p) for p in itertools.permutations("XYZ")]
RNG = np.random.default_rng(7)
QUATERNIONS = r.normalise(RNG.normal(size=(4, 50, 4)))

angles = st.floats(-7, 7)
vectors = arrays(np.float64, 3, elements=st.floats(-3, 3))


def same_rotation(a, b, tolerance=1e-9):
    return np.allclose(r.to_matrix(a), r.to_matrix(b), atol=tolerance)


@pytest.mark.parametrize("order", [*ORDERS, "X", "ZY", "YX"])
def test_from_euler_is_the_product_of_axis_matrices(order):
    values = RNG.uniform(-4, 4, (20, len(order)))
    expected = np.array([euler_matrix(v, order) for v in values])
    assert np.allclose(r.to_matrix(r.from_euler(values, order)), expected)


@pytest.mark.parametrize("order", ORDERS)
def test_to_euler_agrees_with_scipy(order):
    scipy_form = Rotation.from_quat(QUATERNIONS.reshape(-1, 4)[:, [1, 2, 3, 0]])
    assert np.allclose(r.to_euler(QUATERNIONS, order).reshape(-1, 3), scipy_form.as_euler(order))


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("middle", [np.pi / 2, -np.pi / 2, np.pi / 2 - 1e-9, np.pi / 2 - 1e-5, np.pi])
def test_gimbal_lock_keeps_the_rotation(order, middle):
    values = np.column_stack((RNG.uniform(-3, 3, 30), np.full(30, middle), RNG.uniform(-3, 3, 30)))
    q = r.from_euler(values, order)
    assert same_rotation(r.from_euler(r.to_euler(q, order), order), q, 1e-7)


@given(vectors)
def test_axis_angle_round_trip(v):
    back = r.to_axis_angle(r.from_axis_angle(v))
    assert same_rotation(r.from_axis_angle(back), r.from_axis_angle(v))
    assert np.linalg.norm(back) <= np.pi + 1e-12


def test_axis_angle_at_zero_and_pi():
    assert np.array_equal(r.from_axis_angle([0.0, 0, 0]), [1, 0, 0, 0])
    assert np.allclose(r.to_axis_angle(r.from_axis_angle([1e-12, 0, 0])), [1e-12, 0, 0], atol=1e-20)
    assert np.allclose(r.to_axis_angle(r.from_axis_angle([0, np.pi, 0])), [0, np.pi, 0])


def test_matrix_round_trip_at_pi_about_every_axis():
    axes = np.vstack((np.eye(3), -np.eye(3), r.normalise(RNG.normal(size=(20, 3)))))
    for turn in (0.0, 1e-9, np.pi, np.pi - 1e-9, 3.0):
        q = r.from_axis_angle(axes * turn)
        assert same_rotation(r.from_matrix(r.to_matrix(q)), q, 1e-8)


def test_multiply_rotate_conjugate_agree_with_matrices():
    a, b = QUATERNIONS[0], QUATERNIONS[1]
    assert np.allclose(r.to_matrix(r.multiply(a, b)), r.to_matrix(a) @ r.to_matrix(b))
    v = RNG.normal(size=(50, 3))
    assert np.allclose(r.rotate(a, v), (r.to_matrix(a) @ v[..., None])[..., 0])
    assert np.allclose(r.multiply(a, r.conjugate(a)), r.identity((50,)))


@given(vectors, vectors)
def test_between_turns_one_direction_into_the_other(u, v):
    q = r.between(u, v)
    assert np.isclose(np.linalg.norm(q), 1)
    if min(np.linalg.norm(u), np.linalg.norm(v)) > 1e-3:
        turned = r.rotate(q, u / np.linalg.norm(u))
        assert np.allclose(turned, v / np.linalg.norm(v), atol=1e-6)


@pytest.mark.parametrize("size", [1e-310, 1e-200, 1e-82, 1e150])
def test_between_does_not_care_for_length(size):
    q = r.between(np.array([size, 0, 0]), np.array([0, size, 0]))
    assert np.allclose(r.rotate(q, [1, 0, 0]), [0, 1, 0])


def test_between_opposite_and_zero():
    for u in np.vstack((np.eye(3), [[1, 2, 3]])):
        assert np.allclose(r.rotate(r.between(u, -u), u), -u)
    assert np.array_equal(r.between([0.0, 0, 0], [1.0, 0, 0]), [1, 0, 0, 0])


@given(st.floats(0, 1))
def test_slerp_turns_evenly(fraction):
    axis = np.array([0.3, -0.5, 0.8]) / np.linalg.norm([0.3, -0.5, 0.8])
    end = r.from_axis_angle(axis * 2.5)
    expected = r.from_axis_angle(axis * 2.5 * fraction)
    assert same_rotation(r.slerp(r.identity(), end, fraction), expected)
    assert same_rotation(r.slerp(r.identity(), -end, fraction), expected)  # the same rotation, written negated


def test_slerp_of_equal_and_nearly_equal():
    q = QUATERNIONS[0]
    assert np.allclose(r.slerp(q, q, 0.3), q)
    assert np.allclose(r.slerp(q, r.multiply(q, r.from_axis_angle([1e-12, 0, 0])), 0.5), q)


@pytest.mark.parametrize("order", ORDERS)
def test_unwrap_keeps_rotations_and_removes_jumps(order):
    t = np.linspace(0, 6, 200)
    smooth = np.column_stack((4 * np.sin(t), 2.2 * np.sin(0.7 * t), 3 * t))
    q = r.from_euler(smooth, order)
    unwrapped = r.unwrap_euler(r.to_euler(q, order))
    assert same_rotation(r.from_euler(unwrapped, order), q, 1e-7)
    assert np.abs(np.diff(unwrapped, axis=0)).max() < 0.5


def test_nan_stays_in_its_place():
    q = QUATERNIONS[0].copy()
    q[3] = np.nan
    for out in (r.to_matrix(q), r.from_matrix(r.to_matrix(q)), r.to_euler(q, "ZXY"), r.to_axis_angle(q)):
        assert np.isnan(out[3]).all() and np.isfinite(out[np.arange(50) != 3]).all()


@pytest.mark.parametrize("order", ["", "XX", "XYZX", "AB"])
def test_wrong_order_is_named(order):
    with pytest.raises(InvalidMotionError, match="order"):
        r.from_euler(np.zeros(3), order)


def test_wrong_number_of_angles_is_named():
    with pytest.raises(InvalidMotionError, match="expected 3"):
        r.from_euler(np.zeros(2), "XYZ")
