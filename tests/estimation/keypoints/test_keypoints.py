"""The types of keypoints check what they are made of, and go through a file unchanged."""

import numpy as np
import pytest

from dousa.errors import KeypointError
from dousa.estimation import MEDIAPIPE_NAMES, PersonMasks, PersonTrack, ViewKeypoints, read_keypoints, write_keypoints
from dousa.estimation.keypoints.keypoints import sort_people

NAMES = ("nose", "left_wrist", "right_wrist")


def make_person(n_frames=4, n_points=3, seed=0, masks=False):
    rng = np.random.default_rng(seed)
    points = rng.uniform(0, 100, (n_frames, n_points, 2))
    points[1, 0] = np.nan
    made = None
    if masks:
        crops = np.tile(np.array([[2.0, 0, 10], [0, 2.0, 20]]), (n_frames, 1, 1))
        crops[1] = np.nan
        made = PersonMasks(np.packbits(rng.random((n_frames, 16, 16)) > 0.5, axis=2), crops)
    return PersonTrack(points, rng.random((n_frames, n_points)), rng.normal(size=(n_frames, n_points, 3)), made)


def make_view(**changes):
    values = {"names": NAMES, "people": (make_person(),), "times": [0, 0.1, 0.2, 0.31], "size": (640, 480)}
    return ViewKeypoints(**{**values, **changes})


def test_what_is_not_seen_is_nan_in_both_and_has_no_visibility():
    points = np.zeros((1, 2, 2))
    points[0, 1, 0] = np.nan
    person = PersonTrack(points, np.ones((1, 2)))
    assert np.isnan(person.points[0, 1]).all()
    assert person.visibility.tolist() == [[1, 0]]
    assert not person.points.flags.writeable and not person.visibility.flags.writeable


def test_boxes_are_around_what_is_visible():
    person = PersonTrack(np.array([[[0, 5], [10, 20], [50, 60]]] * 2), np.array([[1, 1, 0.1], [0, 0, 0]]))
    boxes = person.boxes(0.5)
    assert boxes[0].tolist() == [0, 5, 10, 20]
    assert np.isnan(boxes[1]).all()


@pytest.mark.parametrize(
    ("changes", "code"),
    [
        ({"names": ()}, "keypoints.names"),
        ({"names": ("a", "a", "b")}, "keypoints.names"),
        ({"names": ("a", "b")}, "keypoints.shape"),
        ({"times": [0, 1, 1, 2]}, "keypoints.times"),
        ({"times": [0, 1, np.nan, 2]}, "keypoints.times"),
        ({"times": [0, 1, 2]}, "keypoints.shape"),
        ({"size": (640, 0)}, "keypoints.size"),
        ({"size": (640.5, 480)}, "keypoints.size"),
    ],
)
def test_what_cannot_be_is_refused(changes, code):
    with pytest.raises(KeypointError) as caught:
        make_view(**changes)
    assert caught.value.code == code


@pytest.mark.parametrize(
    ("points", "visibility", "code"),
    [
        (np.zeros((2, 3)), np.zeros((2, 3)), "keypoints.shape"),
        (np.zeros((2, 3, 2)), np.zeros((2, 4)), "keypoints.shape"),
        (np.zeros((2, 3, 2)), np.full((2, 3), 1.5), "keypoints.visibility"),
        (np.zeros((2, 3, 2)), np.full((2, 3), np.nan), "keypoints.visibility"),
    ],
)
def test_a_track_that_cannot_be_is_refused(points, visibility, code):
    with pytest.raises(KeypointError) as caught:
        PersonTrack(points, visibility)
    assert caught.value.code == code


def test_the_frame_rate_is_the_nominal_one():
    assert make_view().frame_rate == pytest.approx(10)
    assert make_view(people=(), times=[0.0]).frame_rate == 30


def test_points_are_found_by_name():
    view = make_view()
    assert view.find(["right_wrist", "nose"]) == [2, 0]
    with pytest.raises(KeypointError, match="left_toe"):
        view.find(["left_toe"])


def test_who_is_seen_most_comes_first():
    seldom, often = make_person(seed=1), make_person(seed=2)
    seldom = PersonTrack(seldom.points, 0.1 * seldom.visibility)
    assert sort_people([seldom, often]) == (often, seldom)


def test_a_file_keeps_everything(tmp_path):
    view = make_view(people=(make_person(seed=3, masks=True), make_person(seed=4, masks=True)), source="film.mp4")
    write_keypoints(tmp_path / "view.npz", view)
    back = read_keypoints(tmp_path / "view.npz")
    assert (back.names, back.size, back.source) == (view.names, view.size, view.source)
    np.testing.assert_array_equal(back.times, view.times)
    for one, other in zip(back.people, view.people, strict=True):
        np.testing.assert_allclose(one.points, other.points, atol=1e-4)
        np.testing.assert_allclose(one.visibility, other.visibility, atol=1e-6)
        np.testing.assert_allclose(one.world, other.world, atol=1e-6)
        np.testing.assert_array_equal(one.masks.packed, other.masks.packed)
        np.testing.assert_array_equal(one.masks.crops, other.masks.crops)


def test_nobody_is_an_answer_too(tmp_path):
    write_keypoints(tmp_path / "view.npz", make_view(people=()))
    assert read_keypoints(tmp_path / "view.npz").people == ()


@pytest.mark.parametrize("field", ["names", "points", "visibility", "times", "size"])
def test_a_damaged_file_is_one_clear_error(tmp_path, field):
    path = tmp_path / "view.npz"
    write_keypoints(path, make_view())
    with np.load(path) as file:
        arrays = {name: file[name] for name in file.files}
    for damaged in (None, arrays[field][:0], arrays[field][..., None]):
        rest = {name: values for name, values in arrays.items() if name != field}
        np.savez(path, **rest, **({} if damaged is None else {field: damaged}))
        with pytest.raises(KeypointError, match=r"view\.npz"):
            read_keypoints(path)


def test_no_file_and_no_archive(tmp_path):
    with pytest.raises(KeypointError, match="no such file"):
        read_keypoints(tmp_path / "none.npz")
    (tmp_path / "text.npz").write_text("hello", encoding="utf-8")
    with pytest.raises(KeypointError, match=r"text\.npz"):
        read_keypoints(tmp_path / "text.npz")


def test_names_are_mediapipes():
    assert len(MEDIAPIPE_NAMES) == len(set(MEDIAPIPE_NAMES)) == 33
    lefts = [name.replace("left", "") for name in MEDIAPIPE_NAMES if "left" in name]
    assert lefts == [name.replace("right", "") for name in MEDIAPIPE_NAMES if "right" in name]


def test_a_mask_is_drawn_where_its_crop_lies():
    square = np.zeros((1, 16, 16), bool)
    square[0, 4:12, 2:6] = True
    masks = PersonMasks(np.packbits(square, axis=2), np.array([[[1.0, 0, 30], [0, 1.0, 40]]]))
    drawn = masks.read(0, (64, 80))
    expected = np.zeros((80, 64), bool)
    expected[44:52, 32:36] = True
    np.testing.assert_array_equal(drawn, expected)
    half = masks.read(0, (32, 40), of=(64, 80))
    np.testing.assert_array_equal(half, expected.reshape(40, 2, 32, 2).mean(axis=(1, 3)) > 0.5)
