"""Calibration files of OpenCV; units, axes and sizes that a file does not tell; folders."""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np
import pytest
from oracles.calibration_files import (
    ROS,
    Z_FROM_Y,
    same_cameras,
    turned_view,
    write,
    write_opencv,
)

from dousa.errors import CalibrationError, OptionError
from dousa.estimation.cameras.camera import make_ring, make_view
from dousa.estimation.cameras.camera_files import read_cameras


@pytest.mark.parametrize("suffix", ["yml", "xml", "json", "yaml"])
@pytest.mark.parametrize("pose", ["RT", "rvec", "matrix", "board"])
def test_what_opencv_writes_is_read(tmp_path, suffix, pose):
    view = turned_view()
    path = tmp_path / f"cam01.{suffix}"
    write_opencv(path, view, pose)
    same_cameras(read_cameras(path, up="y"), [view], atol=1e-12 if pose in ("RT", "matrix") else 1e-9)
    path.rename(tmp_path / "cam01.dat")  # the suffix does not matter
    assert read_cameras(tmp_path / "cam01.dat", up="y")[0].size == view.size


def test_a_folder_of_cameras(tmp_path):
    ring = make_ring(11)
    for view in ring:
        write_opencv(tmp_path / f"{view.name}.yml", view)
    write(tmp_path, "read me", "notes.txt")
    write(tmp_path, '{"a": 1}', "other.json")
    write(tmp_path, "[project]\ntype = 2\n", "Config.toml")
    write(tmp_path, "broken {", ".hidden.yml")
    (tmp_path / "folder.yml").mkdir()
    same_cameras(read_cameras(tmp_path), ring, atol=1e-12)  # view2 before view10; up is found
    found = read_cameras(tmp_path, ["view10", "view3"])
    assert [view.name for view in found] == ["view10", "view3"]
    with pytest.raises(CalibrationError, match="no camera for the view 'side'"):
        read_cameras(tmp_path, ["side"])
    (tmp_path / "view2.yml").write_text("%YAML:1.0\n---\ncamera_matrix: [1, 2\n", encoding="utf-8")
    with pytest.raises(CalibrationError, match=r"view2\.yml:3: invalid YAML"):
        read_cameras(tmp_path)


def test_an_empty_folder_or_one_without_cameras(tmp_path):
    with pytest.raises(CalibrationError, match="a folder without any"):
        read_cameras(tmp_path)
    write(tmp_path, "read me", "notes.txt")
    with pytest.raises(CalibrationError, match="a folder without any"):
        read_cameras(tmp_path)


def test_yaml_of_other_programs(tmp_path):
    (view,) = read_cameras(write(tmp_path, ROS))
    assert (view.name, view.size) == ("left cam", (640, 480))
    np.testing.assert_allclose(view.matrix, [[500, 0, 320], [0, 510, 240], [0, 0, 1]])
    np.testing.assert_allclose(view.distortion, [0.1, 0.2, 0.01, 0.02, 0.3])
    np.testing.assert_allclose(view.translation, [0.5, 1.0, 4.0])
    np.testing.assert_allclose(view.rotation, np.diag([1.0, -1.0, -1.0]))  # the camera's up is +Y already


def test_several_cameras_in_one_file(tmp_path):
    ring = make_ring(3)
    sections, documents, listed = [], [], []
    for view in ring:
        keys = (
            f"K: {view.matrix.tolist()}",
            f"rvec: {cv2.Rodrigues(view.rotation)[0].ravel().tolist()}",
            f"tvec: {view.translation.tolist()}",
            f"resolution: [{view.width}, {view.height}]",
        )
        sections.append(f"{view.name}:\n" + "".join(f"    {key}\n" for key in keys))
        documents.append(f"---\ncamera_name: '{view.name}'\n" + "\n".join(keys) + "\n")
        listed.append(f"  - name: {view.name}\n" + "".join(f"    {key}\n" for key in keys))
    for text in ("".join(sections), "".join(documents), "cameras:\n" + "".join(listed)):
        same_cameras(read_cameras(write(tmp_path, text)), ring)


@pytest.mark.parametrize("axis", ["x", "y", "z", "-x", "-y", "-z"])
def test_the_up_axis_is_found_or_told(tmp_path, axis):
    """Whichever axis of the file is up, it is Y afterwards, and no world is mirrored."""
    number = "xyz".index(axis[-1])
    upright = np.eye(3)[number] * (-1.0 if axis.startswith("-") else 1.0)
    aside = np.eye(3)[(number + 1) % 3]
    turn = np.stack((aside, upright, np.cross(aside, upright)), axis=1)  # from Y up to the file's world
    ring = [view.in_world(turn) for view in make_ring(3)]
    for view in ring:
        write_opencv(tmp_path / f"{view.name}.yml", view)
    for found in (read_cameras(tmp_path), read_cameras(tmp_path, up=axis)):
        for view in found:
            assert view.position[1] == pytest.approx(1.4)
            assert view.rotation[1, 1] < -0.9
            assert np.linalg.det(view.rotation) == pytest.approx(1.0)


def test_a_world_with_z_up_is_turned_as_pose2sim_does(tmp_path):
    view = make_view((1.0, 2.0, 3.0), (0.0, 1.0, 0.0))
    write_opencv(tmp_path / "a.yml", view.in_world(Z_FROM_Y))
    (found,) = read_cameras(tmp_path / "a.yml", up="z")
    np.testing.assert_allclose(found.position, [1.0, 2.0, 3.0])


def test_up_that_cannot_be_told(tmp_path):
    write_opencv(tmp_path / "a.yml", make_view((0.0, 3.0, 3.0), (0.0, 0.0, 0.0)))
    with pytest.raises(CalibrationError, match="no axis is clearly up"):
        read_cameras(tmp_path / "a.yml")
    assert read_cameras(tmp_path / "a.yml", up="y")
    with pytest.raises(OptionError, match="up axis"):
        read_cameras(tmp_path / "a.yml", up="w")


def test_units_are_told(tmp_path):
    far = dataclasses.replace(make_view((0.0, 1.0, 3.0), (0, 1, 0)), translation=[0.0, 1000.0, 3000.0])
    write_opencv(tmp_path / "a.yml", far)
    with pytest.raises(CalibrationError, match="3162 m from the origin"):
        read_cameras(tmp_path / "a.yml")
    for unit in ("mm", 0.001, "0.001"):
        np.testing.assert_allclose(read_cameras(tmp_path / "a.yml", unit=unit)[0].translation, [0, 1, 3])
    np.testing.assert_allclose(read_cameras(tmp_path / "a.yml", unit="m")[0].translation, [0, 1000, 3000])
    with pytest.raises(OptionError, match="unit 'mile'"):
        read_cameras(tmp_path / "a.yml", unit="mile")


def test_sizes_are_told_where_the_file_has_none(tmp_path):
    ring = make_ring(2)
    for view in ring:
        write_opencv(tmp_path / f"{view.name}.yml", view, size=False)
    with pytest.raises(CalibrationError, match="camera 'view1': the file does not give the size"):
        read_cameras(tmp_path)
    found = read_cameras(tmp_path, ["view2", "view1"], sizes=[(640, 480), (320, 240)])
    assert [view.size for view in found] == [(640, 480), (320, 240)]
    with pytest.raises(CalibrationError, match="a size for each of 2 cameras, got 1"):
        read_cameras(tmp_path, sizes=[(640, 480)])


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("T: [0.5, 1.0, 4.0]", "", "expected the pose of the camera, got none; add R and T"),
        ("T: [0.5, 1.0, 4.0]", "T: [0.5, 1.0]", "camera 'left cam': translation: expected 3 numbers, got 2"),
        ("T: [0.5, 1.0, 4.0]", "T: [0.5, .nan, 4.0]", "finite number"),
        ("T: [0.5, 1.0, 4.0]", "T: [0.5, 1.0, 4.0", ":17: invalid YAML"),
        ("T: [0.5, 1.0, 4.0]", "T: [0.5, {1.0, 4.0]}", ":17: invalid YAML"),
        ("- [1, 0, 0]", "- [1, 0]", "rotation: expected 3 x 3 numbers, got 8"),
        ("- [1, 0, 0]", "- [1, 0, 1]", "expected a rotation"),
        ("rows: 3", "rows: 4", "camera_matrix: expected 4 x 3 numbers, got 9"),
        ("rows: 3", "rows: -1", "expected a small matrix"),
        ("rows: 3", "rows: 1e9", "expected a small matrix"),
        ("plumb_bob", "equidistant", "fisheye"),
        ("image_width: 640", "image_width: many", "image_size: expected a finite number"),
        ("image_width: 640", "image_width 640", ":3: invalid YAML"),
        ("image_width: 640", "image_height: 640", ":4: the key 'image_height' stands here twice"),
        ("image_width: 640", "\timage_width: 640", ":3: invalid YAML"),
        ("  cols: 3", "    cols: 3", ":7: invalid YAML"),
        ("500, 0, 320", "0, 0, 320", "focal lengths above 0"),
        ("500, 0, 320", "500, 0, ", ":8: invalid YAML"),
        ("data: [500", "numbers: [500", "expected numbers, got the keys"),
    ],
)
def test_damaged_yaml(tmp_path, old, new, message):
    assert old in ROS
    path = write(tmp_path, ROS.replace(old, new, 1))
    with pytest.raises(CalibrationError, match=message) as caught:
        read_cameras(path)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


def test_poses_of_the_board_are_no_place(tmp_path):
    write_opencv(tmp_path / "a.yml", turned_view(), "boards")
    with pytest.raises(CalibrationError, match="a pose for each view of the board"):
        read_cameras(tmp_path / "a.yml")
