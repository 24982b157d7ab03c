"""Rings of cameras, and cameras for videos."""

from __future__ import annotations

import dataclasses
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dousa.errors import CalibrationError, OptionError
from dousa.estimation.cameras.camera import fit_cameras, make_ring, make_view, match_cameras

place = st.tuples(*[st.floats(-10, 10)] * 3)


@settings(deadline=None)
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
    ends = [
        (0.2, 2.15, 0.0),
        (-0.2, 2.15, 0.0),
        (0.85, 1.4, 0.0),
        (-0.85, 1.4, 0.0),
        (0.3, 0, 0.5),
        (-0.3, 0, -0.5),
    ]
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
