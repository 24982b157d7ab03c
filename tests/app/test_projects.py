"""Folders of Pose2Sim, FreeMoCap, OpenCap and EasyMocap: what is in them, and what is estimated of them."""

import json
import pickle

import numpy as np
import pytest
from oracles.made_films import Performance, make_cameras
from oracles.made_films import film as make_film

from app.test_keypoint_sources import to_rows, write_openpose
from dousa.app.pipelines.film_sources import name_films, pair_sources
from dousa.app.pipelines.projects import find_project
from dousa.estimation import MEDIAPIPE_NAMES, write_cameras
from dousa.estimation.keypoints.keypoint_json import HALPE_26
from dousa.formats.registry import read_motion

RATE = 50.0


def put(folder, *names):
    for name in names:
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"")


def make_pose2sim(folder, cameras):
    put(folder, "videos/cam1.mp4", "videos/cam2.mp4", "pose-3d/walk_0-99.trc", "kinematics/walk.mot")
    put(folder, ".git/videos/x.mp4", "pose/cam1_json/.keep", "calibration/intrinsics/cam1.mp4")
    write_cameras(folder / "calibration" / "Calib_qualisys.toml", cameras)
    (folder / "Config.toml").write_text(f"[project]\nframe_rate = {RATE:g}\nparticipant_height = 1.68\n")


POINTS_2D = "mediapipe2dData_numCams_numFrames_numTrackedPoints_pixelXY.npy"


def make_array(cameras):
    """(V, T, 553, 3) as FreeMoCap saves it: x, y and MediaPipe's z in pixels, NaN where not seen."""
    performance = Performance(("punch", "turn_around"))
    views = [make_film(performance, camera, 0.0, 1.0, RATE) for camera in cameras]
    rows = np.stack([to_rows(view, MEDIAPIPE_NAMES) for view in views])
    rows[rows[..., 2] == 0] = np.nan
    rows[..., 2] *= -80
    return np.concatenate((rows, np.full((*rows.shape[:2], 520, 3), np.nan)), axis=2)


def make_freemocap(folder, cameras):
    put(folder, "synchronized_videos/a.mp4", "synchronized_videos/b.mp4", "output_data/mediapipe_body_3d_xyz.csv")
    put(
        folder,
        "annotated_videos/a.mp4",
        "output_data/raw_data/mediapipe3dData_numFrames_numTrackedPoints_spatialXYZ.npy",
    )
    np.save(folder / "output_data/raw_data" / POINTS_2D, make_array(cameras))
    write_cameras(folder / "session_camera_calibration.toml", cameras)


def make_opencap(folder, cameras):
    for number, camera in enumerate(cameras):
        place = folder / "Videos" / f"Cam{number}"
        for take in ("neutral", "squat"):
            put(place / "InputMedia" / take, f"{take}_sync.mp4", f"{take}.mov")
        content = {"intrinsicMat": camera.matrix, "distortion": np.zeros((1, 5)), "rotation": camera.rotation}
        content |= {"imageSize": np.array(camera.size)[::-1, None], "translation": 1000 * camera.translation[:, None]}
        (place / "cameraIntrinsicsExtrinsics.pickle").write_bytes(pickle.dumps(content))
    put(folder, "MarkerData/squat.trc", "OpenSimData/Kinematics/squat.mot")
    (folder / "sessionMetadata.yaml").write_text("gender_mf: f\nheight_m: 1.71\nmass_kg: 60.2\n")


def make_plain(folder, cameras):
    put(folder, "cam1.mp4", "cam2.mp4", "notes.txt")
    write_cameras(folder / "calib.toml", cameras)


FOLDERS = {
    "Pose2Sim": (make_pose2sim, [(2, 0, 2)], RATE, 1.68),
    "FreeMoCap": (make_freemocap, [(2, 1, 1)], None, None),
    "OpenCap": (make_opencap, [(2, 0, 0), (2, 0, 2)], None, 1.71),
    "": (make_plain, [(2, 0, 0)], None, None),
}


@pytest.mark.parametrize("program", FOLDERS)
def test_what_is_in_a_folder(dousa, tmp_path, program):
    make, counts, rate, stature = FOLDERS[program]
    make(tmp_path, make_cameras(2))
    code, out, error = dousa("info", tmp_path, "--json")
    assert (code, error) == (0, "")
    (answer,) = json.loads(out)
    found = [tuple(len(take[kind]) for kind in ("films", "keypoints", "results")) for take in answer["takes"]]
    assert (answer["program"] or "", found) == (program, counts)
    assert (answer["rate"], answer["stature_m"]) == (rate, stature)
    assert answer["cameras"] == (["Cam0", "Cam1"] if program == "OpenCap" else ["film1", "film2"])
    code, out, _ = dousa("info", tmp_path)
    assert code == 0 and out.count("go on with: dousa estimate") == len(counts)


def test_folders_that_are_no_project(tmp_path):
    put(tmp_path, "films/a.mp4", "masks/0001.png", "walk.bvh")
    assert find_project(tmp_path) is None and find_project(tmp_path / "films") is None


def test_films_of_one_name_are_called_by_the_folder_that_differs(tmp_path):
    make_opencap(tmp_path, make_cameras(2))
    (_, squat) = find_project(tmp_path).takes
    assert name_films(squat.films) == ("Cam0_squat_sync", "Cam1_squat_sync")
    for places in ("a/view.1 a/view.2 b/view.1", "a/x/cam a/y/cam b/x/cam", "left.mp4 left.avi"):
        assert len(set(name_films([tmp_path / place for place in places.split()]))) == len(places.split())


def test_keypoints_are_of_the_film_with_the_longest_name_that_fits(tmp_path, monkeypatch):
    monkeypatch.setattr("dousa.app.pipelines.film_sources.holds_keypoints", lambda path: path.suffix == ".npz")
    monkeypatch.setattr("dousa.app.pipelines.film_sources.holds_masks", lambda path: False)
    views, _ = pair_sources([tmp_path / name for name in ("left.mp4", "left_b.mp4", "left_b.npz")])
    assert [(view.source.name, view.film.name) for view in views] == [
        ("left.mp4", "left.mp4"),
        ("left_b.npz", "left_b.mp4"),
    ]


def test_a_folder_of_keypoints_says_how_to_go_on(dousa, tmp_path):
    for number in range(2):
        person = {"pose_keypoints_2d": [100.0, 200.0, 0.9] * 25}
        (tmp_path / f"cam_{number:012d}_keypoints.json").write_text(json.dumps({"people": [person]}))
    code, out, error = dousa("info", tmp_path)
    assert (code, out, error.count("\n")) == (2, "", 1)
    assert all(word in error for word in ("dousa estimate", "--cameras", "--rate", "--size", str(tmp_path)))


def test_several_takes_are_named(dousa, tmp_path):
    make_opencap(tmp_path, make_cameras(2))
    code, out, error = dousa("estimate", tmp_path, "-o", tmp_path / "out.bvh")
    assert (code, out, error.count("\n")) == (2, "", 1) and "neutral, squat" in error


@pytest.mark.parametrize("given", [(), ("--rate", "25")])
def test_a_project_is_estimated_from_its_keypoints(dousa, tmp_path, given):
    performance, cameras = Performance(("punch", "turn_around")), make_cameras(2)
    make_pose2sim(tmp_path, cameras)
    for camera in cameras:
        view = make_film(performance, camera, 0.0, 1.0, RATE)
        write_openpose(tmp_path / "pose" / camera.name, to_rows(view, HALPE_26))
    code, out, error = dousa("estimate", tmp_path, *given, "--offsets", "none", "-o", tmp_path / "out.trc", "--json")
    assert code == 0, error
    assert all(word in error for word in ("Calib_qualisys.toml", "2 views", "1.68"))
    assert ("50 Hz" in error) == (not given)
    assert read_motion(tmp_path / "out.trc").frame_rate == pytest.approx(25 if given else RATE)
    assert not json.loads(out)["lost_frames"] and np.isfinite(read_motion(tmp_path / "out.trc").positions).all()


@pytest.mark.parametrize("columns", [2, pytest.param(3, marks=pytest.mark.slow)])
def test_the_points_of_freemocap(dousa, tmp_path, columns):
    make_freemocap(tmp_path, make_cameras(2))
    path = tmp_path / "output_data/raw_data" / POINTS_2D
    np.save(path, np.load(path)[..., :columns])
    out = tmp_path / "out.trc"
    code, _, error = dousa("estimate", tmp_path, "--rate", "50", "-o", out)
    assert code == 0 and "session_camera_calibration.toml" in error, error
    found = read_motion(out).positions
    args = ("--cameras", tmp_path / "session_camera_calibration.toml", "--rate", "50")
    code, _, error = dousa("estimate", path, *args, "-o", tmp_path / "again.trc")
    assert code == 0, error
    np.testing.assert_array_equal(read_motion(tmp_path / "again.trc").positions, found)
    code, out, error = dousa("sync", path, *args, "--json")
    assert code == 0 and [film["name"] for film in json.loads(out)["films"]] == ["film1", "film2"], error
    code, out, error = dousa("calibrate", path, *args, "--stature", "1.7", "-o", tmp_path / "made.toml")
    assert code == 0, error
    code, out, error = dousa("info", path)
    assert code == 2 and "dousa estimate" in error and error.count("\n") == 1, error


def test_times_and_cameras_of_a_project(dousa, tmp_path):
    performance, cameras = Performance(("punch", "turn_around")), make_cameras(2)
    make_pose2sim(tmp_path, cameras)
    for camera, late in zip(cameras, (0.0, 0.2), strict=True):
        view = make_film(performance, camera, late, 2.0, RATE)
        write_openpose(tmp_path / "pose" / camera.name, to_rows(view, HALPE_26))
    code, out, error = dousa("sync", tmp_path, "--json")
    assert code == 0 and "Calib_qualisys.toml" in error and "50 Hz" in error, error
    assert json.loads(out)["films"][1]["offset"] == pytest.approx(0.2, abs=0.03)
    code, out, error = dousa("calibrate", tmp_path, "-o", tmp_path / "made.toml", "--json")
    assert code == 0 and "1.68" in error and len(json.loads(out)["cameras"]) == 2, error


def test_the_shared_folder_of_pose2sim(shared_data):
    project = find_project(shared_data("pose2sim/LICENSE").parent)
    assert project.program == "Pose2Sim" and project.cameras == ("cam01", "cam02", "cam03", "cam04")
    assert [len(take.films) for take in project.takes] == [4] and len(project.takes[0].results) == 2


def test_a_folder_of_points_in_space_is_described_as_a_motion(dousa, shared_data):
    """The command looks for 2D keypoints in a folder first."""
    code, out, error = dousa("info", shared_data("reported") / "easymocap_keypoints3d" / "keypoints3d")
    assert (code, error) == (0, "") and "30 frames" in out
