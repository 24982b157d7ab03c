"""Calibration files of Qualisys, Pose2Sim and OpenCV; units, axes and sizes that a file does not give; folders."""

import dataclasses
import os
import tomllib

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from oracles.calibration_files import POSE2SIM, QUALISYS, ROS, Z_FROM_Y, same_cameras, turned_view, write, write_opencv

from dousa.errors import CalibrationError, MotionWriteError, OptionError
from dousa.estimation.cameras.camera import fit_cameras, make_ring, make_view
from dousa.estimation.cameras.camera_files import read_cameras, write_cameras
from dousa.formats.registry import read_motion

CALIBRATION = "pose2sim/calibration/Calib.qca.txt"


# Qualisys


def test_qualisys_numbers_by_hand(tmp_path):
    (view,) = read_cameras(write(tmp_path, QUALISYS))
    assert (view.name, view.size) == ("21", (1088, 1920))
    np.testing.assert_allclose(view.matrix, [[1680, 0, 534], [0, 1670, 900], [0, 0, 1]])
    np.testing.assert_allclose(view.distortion, [-0.04, 0.1, 0.001, 0.002, 0.01])
    # It stands 3 m before the origin, on the -Y side of the file's world, and looks along its +Y.
    np.testing.assert_allclose(view.position, [-3.0, 1.5, 0.1])
    np.testing.assert_allclose(view.rotation[2], [1.0, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(view.rotation[1], [0.0, -1.0, 0.0], atol=1e-12)
    # What lies in the direction of the file's +X is to the right.
    np.testing.assert_allclose(view.rotation[0], [0.0, 0.0, 1.0], atol=1e-12)


def test_qualisys_as_the_data_page_says(shared_data):
    """X_camera = diag(1, -1, -1) R (X - C / 1000) with X = (z, x, y) of the Y-up world, transcribed."""
    import xml.etree.ElementTree as ET

    path = shared_data(CALIBRATION)
    views = read_cameras(path)
    points = np.random.default_rng(0).normal(size=(30, 3))
    for view, element in zip(views, ET.parse(path).iter("camera"), strict=True):
        place, lens = element.find("transform"), element.find("intrinsic")
        turn = np.array([[float(place.get(f"r{i}{j}")) for j in (1, 2, 3)] for i in (1, 2, 3)])
        centre = np.array([float(place.get(axis)) for axis in "xyz"])
        local = (points @ Z_FROM_Y.T - centre / 1000) @ turn.T * (1, -1, -1)
        numbers = [float(lens.get(f"{what}{axis}")) / 64 for what in ("focalLength", "centerPoint") for axis in "UV"]
        matrix = np.array([[numbers[0], 0, numbers[2]], [0, numbers[1], numbers[3]], [0, 0, 1.0]])
        bend = [float(lens.get(f"radialDistortion{k}")) for k in (1, 2, 3)]
        slant = [float(lens.get(f"tangentalDistortion{k}")) for k in (1, 2)]
        bent = np.array([*bend[:2], *slant, bend[2]])
        expected = cv2.projectPoints(local, np.zeros(3), np.zeros(3), matrix, bent)[0][:, 0]
        seen = local[:, 2] > 0
        np.testing.assert_allclose(view.project(points)[seen], expected[seen], atol=1e-6, rtol=1e-9)
        assert view.size == (1088, 1920)
    assert [view.name for view in views] == ["cam01", "cam02", "cam03", "cam04"]


def test_the_recorded_man_stands_where_his_markers_are(shared_data):
    """The markers of the reference fall on pixels that the plate does not have, in all four views."""
    views = read_cameras(shared_data(CALIBRATION), ["cam01", "cam02", "cam03", "cam04"])
    motion = read_motion(shared_data("pose2sim/Balancing_for_IK.trc"))
    markers = {name: motion.positions[0, index] for index, name in enumerate(motion.names)}
    for view in views:
        image = view.project(motion.positions[0])
        assert ((image >= 0) & (image <= np.array(view.size) - 1)).all()
        neck, hip, toe = (view.project(markers[name])[1] for name in ("Neck", "RHip", "RBigToe"))
        assert neck < hip < toe
        plate = cv2.imread(str(shared_data(f"pose2sim/background/{view.name}.png")))
        video = cv2.VideoCapture(str(shared_data(f"pose2sim/videos/{view.name}.mp4")))
        frame = cv2.resize(video.read()[1], view.size)
        video.release()
        person = (cv2.absdiff(frame, plate).max(axis=2) > 40).astype(np.uint8)
        person = cv2.morphologyEx(person, cv2.MORPH_OPEN, np.ones((7, 7), np.uint8))
        away = cv2.distanceTransform(1 - person, cv2.DIST_L2, 5)
        columns, rows = np.round(image).astype(int).T
        assert away[rows, columns].max() < 50  # px; the man is some 900 px tall
        assert away[rows, columns].mean() < 6


def test_videos_of_another_width_are_fitted(shared_data):
    views = read_cameras(shared_data(CALIBRATION))
    fitted, notes = fit_cameras(views, [(1080, 1920), (1080, 1920), (1088, 1920), (1088, 1920)])
    assert notes == ()
    assert [view.width for view in fitted] == [1080, 1080, 1088, 1088]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('active="1"', 'active="0"', "active cameras"),
        ('x="100"', 'x="abc"', "camera '21': transform x: expected a finite number, got 'abc'"),
        ('x="100"', 'x="nan"', "finite number"),
        ('x="100"', "", "camera '21': expected transform x, got none"),
        ('r11="1"', 'r11="2"', "camera '21': expected a rotation"),
        ('r11="1"', 'r11="-1"', "camera '21': expected a rotation"),
        ('focalLengthU="107520"', 'focalLengthU="0"', "focal lengths above 0"),
        ('right="1097"', 'right="5"', "width in pixels above 0"),
        ('right="1097"', 'right="3000"', "beyond the sensor's last"),
        ('skew="0.0"', 'skew="0.5"', "skew: expected 0"),
        ("<intrinsic ", "<intrinsics ", r"expected an element <intrinsic>|incomplete XML"),
        ('type="regular"', 'type="fisheye"', "fisheye"),
        ("</calibration>", "", "line 15: incomplete XML"),
        ("<calibration type", '<!DOCTYPE x [<!ENTITY a "b">]><calibration type', "without a DOCTYPE"),
        ("encoding='ASCII'", "encoding='no-such'", "not XML|incomplete XML"),
        ("</cameras>", '<camera active="1" serial="21"/></cameras>', "<transform>"),
    ],
)
def test_damaged_qualisys_files(tmp_path, old, new, message):
    path = write(tmp_path, QUALISYS.replace(old, new))
    with pytest.raises(CalibrationError, match=message) as caught:
        read_cameras(path)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


def test_the_sensor_is_the_image_where_no_view_is_told(tmp_path):
    text = QUALISYS.replace("<fov_video", "<fov_marker")
    (view,) = read_cameras(write(tmp_path, text))
    assert view.size == (1200, 2047)
    np.testing.assert_allclose(view.matrix[:2, 2], [544, 960])


# Pose2Sim


def test_pose2sim_numbers_by_hand(tmp_path):
    (view,) = read_cameras(write(tmp_path, POSE2SIM))
    assert (view.name, view.size) == ("left", (1088, 1920))
    np.testing.assert_allclose(view.distortion, [-0.04, 0.1, 0.001, 0.002, 0.0])
    points = np.random.default_rng(0).normal(size=(20, 3))
    turn, move = np.array([1.2, 0.5, -0.4]), np.array([0.1, 0.9, 2.9])
    expected = cv2.projectPoints(points @ Z_FROM_Y.T, turn, move, view.matrix, view.distortion)[0][:, 0]
    seen = view.compute_depths(points) > 0
    np.testing.assert_allclose(view.project(points)[seen], expected[seen], atol=1e-6)


names = st.text(st.characters(exclude_categories=("Cs",)), min_size=1, max_size=12)


@settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.lists(st.tuples(*[st.floats(-3.1, 3.1)] * 3), min_size=1, max_size=3),
    st.lists(names, min_size=3, max_size=3, unique=True),
    st.sampled_from(["pinhole", "orthographic"]),
    st.floats(-0.3, 0.3),
)
def test_what_is_written_is_read(tmp_path, vectors, labels, kind, bend):
    path = tmp_path / "cameras.toml"
    written = [
        dataclasses.replace(turned_view(name, vector), kind=kind, distortion=[0.1, 0.2, 1e-3, -1e-5, bend])
        for name, vector in zip(labels, vectors, strict=False)
    ]
    write_cameras(path, written)
    same_cameras(read_cameras(path), written)


def test_the_recorded_cameras_survive_the_round_trip(tmp_path, shared_data):
    views = read_cameras(shared_data(CALIBRATION))
    path = tmp_path / "Calib.toml"
    write_cameras(path, views)
    same_cameras(read_cameras(path), views)
    tree = tomllib.loads(path.read_text(encoding="utf-8"))
    assert list(tree["cam_01"]) == "name size matrix distortions rotation translation fisheye".split()
    assert "metadata" in tree
    # in Pose2Sim's own world, Z up, the cameras stand where Qualisys says
    turn = cv2.Rodrigues(np.array(tree["cam_01"]["rotation"]))[0]
    place = -turn.T @ np.array(tree["cam_01"]["translation"])
    np.testing.assert_allclose(1000 * place, [1460.23237092, -1909.15904825, 1896.50585241], atol=1e-6)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("fisheye = false", "fisheye = true", "camera 'cam_01': fisheye lenses are not supported"),
        (
            "rotation = [ 1.2, 0.5, -0.4]",
            "rotation = [1.2, 0.5]",
            "camera 'cam_01': rotation: expected 3 numbers, got 2",
        ),
        ("rotation = [ 1.2, 0.5, -0.4]", "", "camera 'cam_01': expected rotation, got none"),
        ("1670.0", "nan", "matrix: expected a finite number"),
        ("1670.0", "-1670.0", "focal lengths above 0"),
        ("1670.0", '"a"', "matrix: expected a finite number"),
        ("1670.0", "true", "matrix: expected a finite number"),
        ("1670.0", "9" * 400, "matrix: expected a finite number"),
        ("[ 0.0, 0.0, 1.0]]", "[ 0.0, 0.0, 2.0]]", "expected a matrix"),
        ("[ 0.0, 0.0, 1.0]]", "]", "matrix: expected 3 x 3 numbers, got 6"),
        ("size = [ 1088.0, 1920.0]", "size = [1088]", "size: expected 2 numbers"),
        ("size = [ 1088.0, 1920.0]", "", "size of the image"),
        ("-0.04, 0.1, 0.001, 0.002]", "-0.04]", "4 or 5 distortion"),
        ("0.001, 0.002]", "0.001, 0.002, 0, 0.5, 0, 0]", "4 or 5 distortion"),
        ("2.9]", "2.9", "invalid TOML"),
        ("2.9]", "2900]", "2900 m from the origin if the file is in metres; specify its unit"),
        (
            "[metadata]",
            POSE2SIM.split("[meta", maxsplit=1)[0].replace("cam_01", "cam_02") + "[metadata]",
            "two of 'left'",
        ),
    ],
)
def test_damaged_pose2sim_files(tmp_path, old, new, message):
    path = write(tmp_path, POSE2SIM.replace(old, new, 1))
    with pytest.raises(CalibrationError, match=message) as caught:
        read_cameras(path)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


def test_writing_what_cannot_be(tmp_path):
    ring = make_ring(2)
    with pytest.raises(CalibrationError, match="got none"):
        write_cameras(tmp_path / "a.toml", [])
    with pytest.raises(CalibrationError, match="two of 'view1'"):
        write_cameras(tmp_path / "a.toml", [ring[0], ring[0]])
    with pytest.raises(CalibrationError, match="as text"):
        write_cameras(tmp_path / "a.toml", [dataclasses.replace(ring[0], name="\ud800")])
    with pytest.raises(MotionWriteError, match="folder"):
        write_cameras(tmp_path / "none" / "a.toml", ring)
    assert os.listdir(tmp_path) == []


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
    ring = [dataclasses.replace(view, rotation=view.rotation @ turn.T) for view in make_ring(3)]
    for view in ring:
        write_opencv(tmp_path / f"{view.name}.yml", view)
    for found in (read_cameras(tmp_path), read_cameras(tmp_path, up=axis)):
        for view in found:
            assert view.position[1] == pytest.approx(1.4)
            assert view.rotation[1, 1] < -0.9
            assert np.linalg.det(view.rotation) == pytest.approx(1.0)


def test_a_world_with_z_up_is_turned_as_pose2sim_does(tmp_path):
    view = make_view((1.0, 2.0, 3.0), (0.0, 1.0, 0.0))
    write_opencv(tmp_path / "a.yml", dataclasses.replace(view, rotation=view.rotation @ Z_FROM_Y.T))
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
