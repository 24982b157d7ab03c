"""Cameras: projection as OpenCV has it, its inverse, rings of cameras, and cameras for videos."""

import dataclasses
import pickle
from itertools import combinations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dousa.errors import CalibrationError, OptionError
from dousa.estimation.cameras.camera import (
    CAMERA_ROW,
    Camera,
    fit_cameras,
    make_ring,
    make_view,
    match_cameras,
    pack_cameras,
)
from dousa.motion.rotations import from_axis_angle, from_matrix, to_axis_angle, to_matrix


def rotation(*vector):
    return to_matrix(from_axis_angle(np.array(vector, float)))


def camera(**changes):
    usual = Camera(
        "cam",
        640,
        480,
        np.array([[600.0, 0.0, 310.5], [0.0, 590.0, 245.25], [0.0, 0.0, 1.0]]),
        rotation(0.3, -0.8, 0.1),
        np.array([0.2, -0.4, 3.5]),
        np.array([-0.05, 0.14, 0.001, -0.0007, 0.01]),
    )
    return dataclasses.replace(usual, **changes)


def small(limit):
    return st.floats(-limit, limit, allow_nan=False)


cameras = st.builds(
    lambda turn, move, focal, centre, bend: camera(
        rotation=rotation(*turn),
        translation=np.array(move),
        matrix=np.array([[focal[0], 0.0, centre[0]], [0.0, focal[1], centre[1]], [0.0, 0.0, 1.0]]),
        distortion=np.array(bend),
    ),
    st.tuples(*[small(3.0)] * 3),
    st.tuples(*[small(5.0)] * 3),
    st.tuples(*[st.floats(50, 2000)] * 2),
    st.tuples(*[st.floats(0, 1000)] * 2),
    st.tuples(small(0.05), small(0.02), small(0.002), small(0.002), small(0.01)),
)
# places before the camera, within a field of view of 90 degrees
seen = st.lists(st.tuples(small(1.0), small(1.0), st.floats(0.2, 20.0)), min_size=1, max_size=8)


def in_front(view, places):
    """Points of the world at (x / z, y / z, z) of the camera."""
    plane = np.array(places)
    local = plane * np.concatenate((plane[:, 2:], plane[:, 2:], np.ones_like(plane[:, :1])), axis=1)
    return (local - view.translation) @ view.rotation


@given(cameras, seen)
def test_projection_is_that_of_opencv(view, places):
    # The vector is not from cv2.Rodrigues, which takes turns of 1e-5 rad for none.
    points = in_front(view, places)
    vector = to_axis_angle(from_matrix(view.rotation))
    expected = cv2.projectPoints(points, vector, view.translation, view.matrix, view.distortion)[0][:, 0]
    np.testing.assert_allclose(view.project(points), expected, rtol=1e-9, atol=1e-9 * view.matrix[0, 0])


def test_projection_is_that_of_opencv_to_a_billionth_of_a_pixel():
    view = camera()
    points = np.random.default_rng(3).normal(size=(500, 3))
    vector = to_axis_angle(from_matrix(view.rotation))
    expected = cv2.projectPoints(points, vector, view.translation, view.matrix, view.distortion)[0][:, 0]
    assert np.abs(view.project(points) - expected).max() < 1e-9


@given(cameras, seen)
def test_the_ray_of_a_projected_point_goes_through_it(view, places):
    points = in_front(view, places)
    origins, directions = view.compute_rays(view.project(points))
    along = ((points - origins) * directions).sum(axis=1)
    assert (along > 0).all()
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1.0, atol=1e-12)
    np.testing.assert_allclose(origins + along[:, None] * directions, points, atol=1e-6)


@given(cameras, st.tuples(small(0.7), small(0.7)))
def test_undistort_is_the_inverse_of_distort(view, place):
    np.testing.assert_allclose(view.undistort(view.distort(place)), place, atol=1e-10)


def test_no_ray_where_the_lens_images_nothing():
    # a barrel with k1 = -1/2 images nothing beyond 0.5443
    view = camera(distortion=np.array([-0.5, 0.0, 0.0, 0.0, 0.0]), matrix=np.diag([100.0, 100.0, 1.0]))
    _, directions = view.compute_rays([[54.0, 0.0], [56.0, 0.0]])
    assert np.isfinite(directions[0]).all()
    assert np.isnan(directions[1]).all()


def test_points_behind_the_camera_have_no_image():
    view = camera(rotation=np.eye(3), translation=np.zeros(3))
    image = view.project([[0.1, 0.2, 2.0], [0.1, 0.2, -2.0], [0.1, 0.2, 0.0], [np.nan, 0.0, 1.0]])
    assert np.isfinite(image[0]).all()
    assert np.isnan(image[1:3]).all()
    assert np.isnan(image[3, 0])
    np.testing.assert_allclose(view.compute_depths([[0.1, 0.2, 2.0], [0.1, 0.2, -2.0]]), [2.0, -2.0])


def test_shapes_are_kept():
    view = camera()
    assert view.project(np.zeros((4, 5, 3))).shape == (4, 5, 2)
    assert view.project(np.zeros(3)).shape == (2,)
    assert view.compute_depths(np.zeros((4, 5, 3))).shape == (4, 5)
    assert [array.shape for array in view.compute_rays(np.zeros((4, 5, 2)))] == [(4, 5, 3)] * 2
    assert view.project(np.zeros((0, 3))).shape == (0, 2)


def test_an_orthographic_camera_sees_no_depth():
    view = camera(kind="orthographic", matrix=np.array([[100.0, 0.0, 320.0], [0.0, 50.0, 240.0], [0, 0, 1]]))
    points = np.random.default_rng(1).normal(size=(20, 3)) * 10
    image = view.project(points)
    np.testing.assert_allclose(view.project(points + 7.0 * view.rotation[2]), image, atol=1e-9)
    local = points @ view.rotation.T + view.translation
    np.testing.assert_allclose(image, local[:, :2] * [100.0, 50.0] + [320.0, 240.0])
    origins, directions = view.compute_rays(image)
    along = ((points - origins) * directions).sum(axis=1)
    np.testing.assert_allclose(origins + along[:, None] * directions, points, atol=1e-9)
    np.testing.assert_allclose(view.compute_depths(origins), 0.0, atol=1e-12)


def test_skew_moves_columns_with_rows():
    view = camera(matrix=np.array([[600.0, 30.0, 310.0], [0.0, 590.0, 245.0], [0.0, 0.0, 1.0]]))
    points = np.random.default_rng(2).normal(size=(20, 3))
    plain = dataclasses.replace(view, matrix=view.matrix * [[1, 0, 1], [1, 1, 1], [1, 1, 1]])
    difference = view.project(points) - plain.project(points)
    np.testing.assert_allclose(difference[:, 0], 30.0 * (plain.project(points)[:, 1] - 245.0) / 590.0, atol=1e-9)
    origins, directions = view.compute_rays(view.project(points))
    along = ((points - origins) * directions).sum(axis=1)
    np.testing.assert_allclose(origins + along[:, None] * directions, points, atol=1e-9)


@given(cameras, seen, st.integers(1, 4000), st.integers(1, 4000))
def test_scaling_follows_the_pixel_centres(view, places, width, height):
    points = in_front(view, places)
    factors = np.array([width / view.width, height / view.height])
    expected = (view.project(points) + 0.5) * factors - 0.5
    resized = view.resized(width, height)
    assert resized.size == (width, height)
    np.testing.assert_allclose(resized.project(points), expected, rtol=1e-9, atol=1e-6)
    back = resized.resized(*view.size)
    np.testing.assert_allclose(back.matrix, view.matrix, rtol=1e-9, atol=1e-6)


def test_the_corner_of_the_image_stays_the_corner():
    view = camera().scaled(0.5)
    corner = np.array([-0.5, -0.5, 1.0])
    np.testing.assert_allclose(np.linalg.solve(view.matrix, corner), np.linalg.solve(camera().matrix, corner))
    assert view.size == (320, 240)
    assert camera().scaled(2.0, 0.5).size == (1280, 240)
    with pytest.raises(CalibrationError, match="scales above 0"):
        view.scaled(0.0)
    with pytest.raises(CalibrationError, match="in pixels above 0"):
        view.scaled(1e-4)


def test_scaling_is_that_of_opencvs_area_mean():
    """A blob's centre moves with the image that OpenCV shrinks."""
    rows, columns = np.mgrid[:480, :640]
    image = np.exp(-((columns - 301.0) ** 2 + (rows - 205.0) ** 2) / 200.0)
    half = cv2.resize(image, (320, 240), interpolation=cv2.INTER_AREA)
    centre = (half * np.mgrid[:240, :320]).sum(axis=(1, 2))[::-1] / half.sum()
    matrix = np.array([[1.0, 0.0, 301.0], [0.0, 1.0, 205.0], [0.0, 0.0, 1.0]])
    np.testing.assert_allclose(camera(matrix=matrix).scaled(0.5).matrix[:2, 2], centre, atol=1e-6)


def test_the_kernel_projects_as_the_camera_does():
    from dousa.estimation.raster.rasteriser import project_sphere

    points = np.random.default_rng(5).normal(size=(50, 3))
    for view in (camera(), camera(kind="orthographic"), camera(distortion=None)):
        row = view.to_row()
        assert row.shape == (CAMERA_ROW,)
        found = np.array([project_sphere.py_func(row, *point, 0.1)[:2] for point in points])
        np.testing.assert_allclose(found, view.project(points), atol=1e-9)


def test_cameras_are_copied_with_changes_and_sent_to_workers():
    view = dataclasses.replace(camera(), name="other")
    again = pickle.loads(pickle.dumps(view))
    assert again.name == "other"
    np.testing.assert_array_equal(again.to_row(), view.to_row())
    assert pack_cameras([view, again]).shape == (2, CAMERA_ROW)
    with pytest.raises(ValueError, match="read-only"):
        view.matrix[0, 0] = 1.0


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"width": 0}, "width in pixels above 0"),
        ({"height": -3}, "height in pixels above 0"),
        ({"matrix": np.diag([0.0, 500.0, 1.0])}, "focal lengths above 0"),
        ({"matrix": np.eye(2)}, "shape"),
        ({"rotation": np.eye(3) * 1.01}, "stretches or mirrors"),
        ({"rotation": np.diag([1.0, 1.0, -1.0])}, "stretches or mirrors"),
        ({"translation": [0.0, np.nan, 0.0]}, "finite"),
        ({"distortion": [0.1]}, "shape"),
        ({"distortion": ["a"] * 5}, "numbers"),
        ({"kind": "fisheye"}, "pinhole or orthographic"),
    ],
)
def test_what_is_no_camera_is_refused(changes, message):
    with pytest.raises(CalibrationError, match=message):
        camera(**changes)


place = st.tuples(*[st.floats(-10, 10)] * 3)


@given(place, place)
def test_a_view_stands_upright_and_looks_at_its_target(position, target):
    position, target = np.array(position), np.array(target)
    if np.linalg.norm(position - target) < 1e-3:
        return
    view = make_view(position, target, size=(640, 480))
    np.testing.assert_allclose(view.project(target), [319.5, 239.5], atol=1e-6)
    np.testing.assert_allclose(view.position, position, atol=1e-9)
    assert abs(view.rotation[0, 1]) < 1e-9  # the horizon is level
    assert view.rotation[1, 1] <= 1e-9  # image rows grow downwards


def test_a_view_from_the_front_has_the_persons_left_on_the_right():
    view = make_view((0.0, 1.0, 3.0), (0.0, 1.0, 0.0))
    left, head = view.project([[0.5, 1.0, 0.0], [0.0, 1.7, 0.0]])
    assert left[0] > 159.5
    assert head[1] < 119.5


@pytest.mark.parametrize("height", [5.0, -5.0])
def test_a_view_straight_down_or_up(height):
    view = make_view((0.0, height, 0.0), (0.0, 0.0, 0.0))
    np.testing.assert_allclose(view.project([0.0, 0.0, 0.0]), [159.5, 119.5])
    assert view.project([1.0, 0.0, 0.0])[0] > 159.5


@pytest.mark.parametrize("target", [(1.0, 1.0, 1.0), (np.nan, 0.0, 0.0), (1.0, 2.0)])
def test_a_view_of_nothing_is_refused(target):
    with pytest.raises(CalibrationError, match="apart"):
        make_view((1.0, 1.0, 1.0), target)


@pytest.mark.parametrize("n_views", range(1, 9))
def test_a_ring_sees_a_whole_person_and_no_two_cameras_face_each_other(n_views):
    ring = make_ring(n_views)
    assert [view.name for view in ring] == [f"view{k + 1}" for k in range(n_views)]
    # hands raised, arms spread, a step
    ends = [(0.2, 2.15, 0.0), (-0.2, 2.15, 0.0), (0.85, 1.4, 0.0), (-0.85, 1.4, 0.0), (0.3, 0, 0.5), (-0.3, 0, -0.5)]
    for view in ring:
        image = view.project(ends)
        assert ((image >= 0) & (image <= [319, 239])).all()
        assert view.position[1] == pytest.approx(1.4)
    for one, other in combinations(ring, 2):
        away = [(view.position - (0.0, 1.4, 0.0)) / 3.5 for view in (one, other)]
        assert away[0] @ away[1] > -0.999
    assert ring[0].position == pytest.approx([0.0, 1.4, 3.5])


def test_a_ring_of_no_views_is_refused():
    with pytest.raises(OptionError, match="1 to 100"):
        make_ring(0)


def test_cameras_are_stretched_to_the_size_of_the_video():
    ring = make_ring(2, size=(1088, 1920))
    fitted, notes = fit_cameras(ring, [(1080, 1920), (1088, 1920)])
    assert fitted[0].size == (1080, 1920)
    assert fitted[1] is ring[1]
    assert notes == ()
    point = np.array([0.3, 1.0, 0.1])
    assert fitted[0].project(point)[0] == pytest.approx((ring[0].project(point)[0] + 0.5) * 1080 / 1088 - 0.5)


@pytest.mark.parametrize(("size", "guess"), [((240, 320), "turned"), ((320, 200), "cropped")])
def test_an_image_of_another_shape_is_told(size, guess):
    _, notes = fit_cameras(make_ring(1), [size])
    assert len(notes) == 1
    assert guess in str(notes[0])
    assert "view1" in str(notes[0])


def test_sizes_and_cameras_are_counted():
    with pytest.raises(CalibrationError, match="2 cameras for 1 view"):
        fit_cameras(make_ring(2), [(320, 240)])


def named(*names):
    return [dataclasses.replace(view, name=name) for view, name in zip(make_ring(len(names)), names, strict=True)]


@pytest.mark.parametrize(
    ("has", "wants", "gets"),
    [
        (("a", "b", "c"), ("c", "a"), ("c", "a")),
        (("cam01", "cam02", "cam12"), ("Cam 2", "cam-1"), ("cam02", "cam01")),
        (("int_cam01_img", "int_cam02_img"), ("cam02", "cam01"), ("int_cam02_img", "int_cam01_img")),
        (("cam1", "cam12"), ("take3_cam12", "take3_cam1"), ("cam12", "cam1")),
        (("21", "22"), ("Miqus_22_x", "Miqus_21_x"), ("22", "21")),
    ],
)
def test_cameras_are_found_by_name(has, wants, gets):
    found, notes = match_cameras(named(*has), wants)
    assert tuple(view.name for view in found) == gets
    assert notes == ()


def test_cameras_of_other_names_are_taken_in_order_and_told():
    found, notes = match_cameras(named("a", "b"), ("left", "right"))
    assert [view.name for view in found] == ["a", "b"]
    assert [str(note) for note in notes] == ["no camera has the name of a view; assigned in order: left = a, right = b"]
    assert match_cameras(named("a"), ("left",))[1] == ()


@pytest.mark.parametrize(
    ("has", "wants", "message"),
    [
        (("a", "b"), ("a", "x"), "no camera for the view 'x'; the cameras are: a, b"),
        (("a", "b"), ("x",), "no camera for the view 'x'"),
        (
            ("cam1_left", "cam1_right"),
            ("cam1", "cam1_right"),
            r"several cameras for the view 'cam1' \(cam1_left, cam1_right\)",
        ),
        (("a", "b"), ("a", "a"), "two of the views a, a match the same camera"),
    ],
)
def test_views_without_their_own_camera_are_refused(has, wants, message):
    with pytest.raises(CalibrationError, match=message):
        match_cameras(named(*has), wants)
