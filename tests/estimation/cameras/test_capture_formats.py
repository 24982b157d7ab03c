"""Calibrations of EasyMocap, OpenCap, Vicon, BioCV, Anipose and Caliscope, written by hand; OpenCV agrees."""

import pickle

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from oracles.calibration_files import write

from dousa.errors import CalibrationError
from dousa.estimation.cameras.camera_files import read_cameras
from dousa.motion.rotations import from_axis_angle, from_matrix, to_axis_angle, to_matrix

SIZE = (1280, 720)
Y_FROM = {"z": [[0, 1, 0], [0, 0, 1], [1, 0, 0]], "y": np.eye(3), "-y": np.diag([1, -1, -1])}  # to (x, y, z) of dousa


# From a world with z up to those of the programs.
TO_WORLD = {"z": np.eye(3), "y": np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])}
TO_WORLD["-y"] = TO_WORLD["y"] @ np.diag([1.0, -1, -1])


class Lens:
    """A camera in the world of its program: metres, and the axis that points up."""

    def __init__(self, turn=(0.1, 0.2, 0.0), place=(0.1, 0.0, 4.0), bend=(0.0,) * 5, up="z"):
        level = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # looks along y of a world with z up
        self.rotation = to_matrix(from_axis_angle(np.array(turn))) @ level @ TO_WORLD[up].T
        self.vector = to_axis_angle(from_matrix(self.rotation))
        self.translation, self.distortion = np.array(place), np.array(bend)
        self.matrix = np.array([[900.0, 0, 640.0], [0, 905.5, 360.0], [0, 0, 1]])

    def project(self, points):
        """OpenCV's formula."""
        local = points @ self.rotation.T + self.translation  # cv2.Rodrigues loses digits
        return cv2.projectPoints(local, np.zeros(3), np.zeros(3), self.matrix, self.distortion)[0][:, 0]


PAIR = (Lens(), Lens((0.1, 0.5, 0.0)))


def _rows(matrix):
    return "\n".join(" ".join(repr(float(value)) for value in row) for row in matrix)


def _storage(name, matrix):
    matrix = np.atleast_2d(matrix)
    rows, columns = matrix.shape
    head = f"{name}: !!opencv-matrix\n   rows: {rows}\n   cols: {columns}\n   dt: d\n"
    return f"{head}   data: {matrix.ravel().tolist()}\n"


def write_easymocap(folder, lenses, vector=False):
    names = "names:\n" + "".join(f'   - "{number}"\n' for number, _ in enumerate(lenses, 1))
    inner, outer = "%YAML:1.0\n---\n" + names, "%YAML:1.0\n---\n" + names
    for number, lens in enumerate(lenses, 1):
        inner += _storage(f"K_{number}", lens.matrix) + _storage(f"dist_{number}", lens.distortion)
        outer += _storage(f"R_{number}", lens.vector[:, None]) if vector else _storage(f"Rot_{number}", lens.rotation)
        outer += _storage(f"T_{number}", lens.translation[:, None])
    write(folder, inner, "intri.yml")
    write(folder, outer, "extri.yml")
    return folder


def write_opencap(folder, lenses):
    for number, lens in enumerate(lenses):
        place = folder / f"Cam{number}"
        place.mkdir(exist_ok=True)
        content = {"distortion": lens.distortion[None], "intrinsicMat": lens.matrix, "rotation": lens.rotation}
        content |= {"imageSize": np.array([[720.0], [1280.0]]), "translation": 1000 * lens.translation[:, None]}
        (place / "cameraIntrinsicsExtrinsics.pickle").write_bytes(pickle.dumps(content))
    return folder


def write_biocv(folder, lenses):
    for number, lens in enumerate(lenses):
        pose = np.vstack([np.column_stack([lens.rotation, 1000 * lens.translation]), (0, 0, 0, 1)])
        text = f"1280\n720\n{_rows(lens.matrix)}\n\n{_rows(pose)}\n\n{_rows([lens.distortion])}\n"
        write(folder, text, f"{number:02d}.mp4.calib")
    return folder


def write_vicon(folder, lenses, radial="0 0 0"):
    cameras = ""
    for number, lens in enumerate(lenses):
        w, x, y, z = from_matrix(lens.rotation).tolist()
        place = " ".join(map(str, (-1000 * lens.rotation.T @ lens.translation).tolist()))
        aspect = float(lens.matrix[0, 0] / lens.matrix[1, 1])
        cameras += (
            f'<Camera DEVICEID="212{number}" TYPE="VideoCamera" SENSOR_SIZE="1280 720" PIXEL_ASPECT_RATIO="{aspect}">'
            f'<KeyFrames><KeyFrame FOCAL_LENGTH="900" ORIENTATION="{x} {y} {z} {w}" POSITION="{place}" FRAME="0" '
            f'PRINCIPAL_POINT="640 360" VICON_RADIAL2="ViconRadial2 640 360 {radial}"/></KeyFrames></Camera>\n'
        )
    marker = '<Camera DEVICEID="7" TYPE="ViconMCamera" SENSOR_SIZE="9 9"><KeyFrames><KeyFrame/></KeyFrames></Camera>'
    return write(folder, f'<?xml version="1.0"?>\n<Cameras>{marker}{cameras}</Cameras>', "session.xcp")


def _toml(lens, vector, scale=1.0):
    turned = lens.vector.ravel().tolist() if vector else lens.rotation.tolist()
    return (
        f"size = [1280, 720]\nmatrix = {lens.matrix.tolist()}\ndistortions = {lens.distortion.tolist()}\n"
        f"rotation = {turned}\ntranslation = {(scale * lens.translation).tolist()}\n"
    )


def write_anipose(folder, lenses):
    text = "".join(
        f'[cam_{number}]\nname = "cam{number}"\n{_toml(lens, True, 1000.0)}\n' for number, lens in enumerate(lenses)
    )
    return write(folder, text + "[metadata]\nadjusted = true\nerror = 0.4\n", "calibration.toml")


def write_caliscope(folder, lenses):
    head = "[{}]\nport = {}\nrotation_count = 0\nerror = 0.2\nignore = {}\n"
    text = "".join(
        head.format(f"cam_{number}", number, "false") + _toml(lens, False) for number, lens in enumerate(lenses)
    )
    text += head.format("cam_9", 9, "true") + "size = [9, 9]\nmatrix = [[9, 0, 4], [0, 9, 4], [0, 0, 1]]\n"
    return write(folder, text + "[charuco]\ncolumns = 4\n", "config.toml")


def write_camera_array(folder, lenses):
    head = "[cameras.{}]\ncam_id = {}\nrotation_count = 1\nignore = false\n"
    text = "".join(head.format(number, number) + _toml(lens, number % 2) for number, lens in enumerate(lenses))
    return write(folder, text, "camera_array.toml")


PROGRAMS = {  # how its calibration is written, the axis that is up, the names of the cameras, whether lenses bend
    "easymocap": (write_easymocap, "z", ["1", "2"], True),
    "easymocap, vectors": (lambda folder, lenses: write_easymocap(folder, lenses, vector=True), "z", ["1", "2"], True),
    "easymocap, one file named": (
        lambda folder, lenses: write_easymocap(folder, lenses) / "extri.yml",
        "z",
        ["1", "2"],
        True,
    ),
    "opencap": (write_opencap, "-y", ["Cam0", "Cam1"], True),
    "biocv": (write_biocv, "z", ["00", "01"], True),
    "vicon": (write_vicon, "z", ["2120", "2121"], False),
    "anipose": (write_anipose, "-y", ["cam0", "cam1"], True),
    "caliscope": (write_caliscope, "z", ["cam_0", "cam_1"], True),
    "caliscope, camera array": (write_camera_array, "y", ["0", "1"], True),
}
ANGLE, SHIFT = st.floats(-0.4, 0.4), st.floats(-0.5, 0.5)
POSE = st.tuples(st.tuples(ANGLE, ANGLE, ANGLE), st.tuples(SHIFT, SHIFT, st.floats(2.0, 6.0)))


@pytest.mark.parametrize("program", PROGRAMS)
@settings(max_examples=15, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(poses=st.tuples(POSE, POSE), bend=st.tuples(*[st.floats(-0.05, 0.05)] * 3))
def test_points_are_where_opencv_projects_them(tmp_path, program, poses, bend):
    writer, up, names, bends = PROGRAMS[program]
    bent = [bend[0], bend[1], bend[2] / 20, -bend[2] / 30, bend[0] / 9] if bends else [0.0] * 5
    lenses = [Lens(turn, place, bent, up) for turn, place in poses]
    cameras = read_cameras(writer(tmp_path, lenses))
    assert [camera.name for camera in cameras] == names
    points = np.random.default_rng(0).uniform(-0.6, 0.6, (40, 3))  # in the file's world
    ours = points @ np.array(Y_FROM[up]).T
    for camera, lens in zip(cameras, lenses, strict=True):
        assert camera.size == SIZE
        np.testing.assert_allclose(camera.project(ours), lens.project(points), atol=1e-6, rtol=0)


def test_a_lens_of_vicon_is_met_within_a_tenth_of_a_pixel(tmp_path):
    """Vicon leads from the picture to straight lines: its formula undoes what our lens does."""
    lens = Lens()
    (camera,) = read_cameras(write_vicon(tmp_path, [lens], radial="2e-7 -1e-13 4e-20"))
    points = np.random.default_rng(0).uniform(-1.2, 1.2, (200, 3))
    seen = camera.project(points @ np.array(Y_FROM["z"]).T)
    inside = ((seen >= 0) & (seen < SIZE)).all(axis=1)
    square = ((seen - (640, 360)) ** 2).sum(axis=1, keepdims=True)
    straight = (640, 360) + (seen - (640, 360)) * (1 + 2e-7 * square - 1e-13 * square**2 + 4e-20 * square**3)
    assert inside.sum() > 50 and np.abs(seen - straight)[inside].max() > 5
    np.testing.assert_allclose(straight[inside], lens.project(points)[inside], atol=0.1)


def test_the_reported_easymocap(shared_data):
    cameras = read_cameras(shared_data("reported/calibration_of_easymocap/calib"))
    assert [camera.name for camera in cameras] == ["1", "2"] and {camera.size for camera in cameras} == {(1920, 1080)}
    for camera in cameras:
        assert 4 < np.linalg.norm(camera.position[[0, 2]]) < 5 and camera.position[1] == pytest.approx(1.5, abs=0.01)


def test_films_tell_the_sizes_that_easymocap_lacks(tmp_path):
    (camera,) = read_cameras(write_easymocap(tmp_path, PAIR[:1]), sizes=[(1300, 700)])
    assert camera.size == (1300, 700) and camera.matrix[0, 2] == 640


@pytest.mark.parametrize(
    ("writer", "old", "new", "code"),
    [
        (write_easymocap, "T_2", "Z_2", "easymocap.entry"),
        (write_anipose, "translation", "moved", "camera_files.no_entry"),
        (write_vicon, "POSITION", "PLACE", "camera_files.no_entry"),
        (write_vicon, "ViconRadial2 640 360 0", "ViconRadial2 640 360 1e-3", "vicon.lens"),
        (write_vicon, "<KeyFrames>", "<Other/><Frames>", None),
        (write_biocv, "1280\n", "1280\n1 ", "camera_files.empty_folder"),
        (write_opencap, b"rotation", b"rotatiom", "camera_files.no_entry"),
        (write_opencap, b"numpy", b"nompy", "pickles.refused"),
    ],
)
def test_what_is_damaged_is_one_sentence(tmp_path, writer, old, new, code):
    path = writer(tmp_path, PAIR)
    for file in [path] if path.is_file() else [file for file in path.rglob("*") if file.is_file()]:
        was, becomes = (word.encode() if isinstance(word, str) else word for word in (old, new))
        file.write_bytes(file.read_bytes().replace(was, becomes))
    with pytest.raises(CalibrationError) as caught:
        read_cameras(path)
    assert code is None or caught.value.code == code
    assert str(tmp_path) in str(caught.value.located)


def test_lenses_alone_are_no_cameras(tmp_path):
    write_easymocap(tmp_path, PAIR)
    (tmp_path / "extri.yml").unlink()
    with pytest.raises(CalibrationError) as caught:
        read_cameras(tmp_path / "intri.yml")
    assert caught.value.code == "easymocap.entry"
