"""Films with nothing prepared: several read at a time, doubts about people and cameras, and a motion of each person."""

import json
import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from app.made_landmarks import NAMES, OWN
from dousa.app.pipelines import film_scene
from dousa.app.pipelines.film_sources import shows_masks
from dousa.errors import KeypointError
from dousa.estimation import (
    PersonTrack,
    ViewKeypoints,
    make_human,
    make_ring,
    poses_from_motion,
    write_cameras,
    write_keypoints,
)
from dousa.estimation.keypoints.keypoints import MEDIAPIPE_NAMES
from dousa.estimation.multiview.landmarks import place_landmarks
from dousa.estimation.multiview.pose_residuals import place_points
from dousa.formats.registry import read_motion
from dousa.motion.synthetic.performers import draw_performer, make_motion
from patience import PATIENCE


def make_view(film):
    return ViewKeypoints(MEDIAPIPE_NAMES, (), np.arange(3) / 30, (64, 48), str(film))


@pytest.fixture
def finders(monkeypatch):
    """What is called for a film, by its name; every other film is found at once."""
    known = {}

    def find(film, model, *, threads=None, progress):
        known.get(Path(film).stem, lambda note: note(3, 3, "done"))(progress)
        return make_view(film)

    monkeypatch.setattr("dousa.estimation.find_keypoints", find)
    monkeypatch.setattr(film_scene.os, "cpu_count", lambda: 2)
    return known


def open_all(names, progress=lambda done, total, what: None):
    return film_scene.open_keypoints([Path(f"{name}.mp4") for name in names], "full", progress)


@pytest.mark.parametrize("content", [b"", b"sound" * 99])
def test_what_is_no_film_is_no_film_of_masks(tmp_path, content):
    (tmp_path / "a.mp4").write_bytes(content)
    assert not shows_masks(tmp_path / "a.mp4")


def test_two_films_are_looked_at_at_the_same_time_and_come_in_their_order(finders):
    both = threading.Barrier(2, timeout=PATIENCE)
    finders["a"] = finders["b"] = lambda note: both.wait()
    assert [view.source for view in open_all("abc")] == ["a", "b", "c"]


def test_progress_is_of_all_films_and_told_by_the_thread_that_asked(finders):
    told, go_on = [], threading.Event()

    def work(note):
        note(2, 5, "looking")
        assert go_on.wait(60)

    def progress(done, total, what):
        told.append((done, total, what, threading.current_thread()))
        if done == 4:
            go_on.set()

    finders["a"] = finders["b"] = work
    open_all("ab", progress)
    assert told[-1] == (4, 10, "looking", threading.main_thread())


@pytest.mark.parametrize("bad", ["a", "b"])
def test_a_film_that_fails_stops_the_others(finders, bad):
    def fail(note):
        raise KeypointError("film.no_frame")

    def work(note):
        for _ in range(10**9):
            note(1, 5, "looking")

    finders.update({"a": work, "b": work}, **{bad: fail})
    with pytest.raises(KeypointError) as caught:
        open_all("ab")
    assert caught.value.code == "film.no_frame"


def test_an_interruption_stops_all(finders):
    ended = []

    def work(note):
        try:
            for _ in range(10**9):
                note(1, 5, "looking")
        finally:
            ended.append(True)

    def interrupt(done, total, what):
        raise KeyboardInterrupt

    finders["a"] = finders["b"] = work
    with pytest.raises(KeyboardInterrupt):
        open_all("ab", interrupt)
    assert len(ended) == 2


SIZE, RATE = (640, 480), 30.0
BODY, CAMERAS = make_human(1.75), make_ring(3, size=SIZE, focal=500.0)


@pytest.fixture(scope="module")
def poses():
    """Of a throw, and of somebody else who does something else a metre away."""
    one = poses_from_motion(BODY, make_motion("throw", draw_performer(3), frame_rate=RATE))[20:60]
    other = one[::-1].copy()
    other[:, 0] += 1.0
    return one, other


def look(camera, rows):
    """Points (T, K, 2) that a network would find."""
    places = place_points(BODY, rows, place_landmarks(BODY, OWN))
    return camera.project(places) + np.random.default_rng(0).normal(0, 1.0, (*places.shape[:2], 2))


@pytest.fixture
def run(dousa, tmp_path):
    """Estimate from points of each view; exit code, warnings and what is said of an error."""

    def estimate(points, cameras, *words):
        sources = []
        for camera, own in zip(CAMERAS, points, strict=False):
            people = () if own is None else (PersonTrack(own, np.full(own.shape[:2], 0.9)),)
            times = np.arange(len(points[0])) / RATE
            write_keypoints(tmp_path / f"{camera.name}.npz", ViewKeypoints(NAMES, people, times, SIZE))
            sources.append(tmp_path / f"{camera.name}.npz")
        write_cameras(tmp_path / "cameras.toml", cameras)
        given = ("--cameras", tmp_path / "cameras.toml", "--cues", "keypoints", "--offsets", "none", "--json")
        code, out, err = dousa("estimate", *sources, *given, *words, "-o", tmp_path / "x.bvh")
        assert (tmp_path / "x.bvh").exists() == (code == 0)
        return code, json.loads(out)["warnings"] if code == 0 else err

    return estimate


def test_right_films_and_cameras_raise_no_doubt(run, poses):
    code, said = run([look(camera, poses[0]) for camera in CAMERAS], CAMERAS)
    assert code == 0 and not [line for line in said if "check" in line or "left out" in line or "tall" in line]


def test_exchanged_cameras_are_doubted(run, poses):
    points = [look(camera, poses[0]) for camera in CAMERAS]
    code, said = run([points[1], points[0], points[2]], CAMERAS)
    assert code == 0 and any("check" in line and "calibration" in line for line in said)


def test_another_person_in_one_view_is_left_out_and_said(run, poses):
    code, said = run([look(CAMERAS[0], poses[1]), *(look(camera, poses[0]) for camera in CAMERAS[1:])], CAMERAS)
    assert code == 0 and any("view1" in line and "left out" in line for line in said)


def test_a_camera_that_moves_is_left_out_and_said(run, poses):
    points = [look(camera, poses[0]) for camera in CAMERAS]
    points[0] = points[0] + np.linspace(0, 1, len(poses[0]))[:, None, None] * np.array([250.0, 80.0])
    code, said = run(points, CAMERAS)
    assert code == 0 and any("view1" in line and "left out" in line for line in said)


def test_two_views_of_two_people_are_refused(run, poses):
    code, said = run([look(CAMERAS[0], poses[1]), look(CAMERAS[1], poses[0])], CAMERAS[:2])
    assert code == 2 and "view1 and view2" in said and "different people" in said


def test_two_cameras_at_one_place_are_refused(run, poses):
    twice = [CAMERAS[0], replace(CAMERAS[0], name=CAMERAS[1].name)]
    code, said = run([look(CAMERAS[0], poses[0])] * 2, twice)
    assert code == 2 and "do not agree" in said


def test_lenses_of_another_camera_make_an_odd_body(run, poses):
    longer = [replace(camera, matrix=camera.matrix * [[1.4, 1, 1], [1, 1.4, 1], [1, 1, 1]]) for camera in CAMERAS]
    code, said = run([look(camera, poses[0]) for camera in CAMERAS], longer)
    assert code == 0 and any("that tall" in line for line in said)


def test_a_view_without_anybody_does_no_harm(run, poses):
    code, said = run([look(CAMERAS[0], poses[0]), None, look(CAMERAS[2], poses[0])], CAMERAS)
    assert code == 0 and not any("left out" in line for line in said)


def test_one_frame_is_enough(run, poses):
    code, said = run([look(camera, poses[0][:1]) for camera in CAMERAS], CAMERAS)
    assert code == 0 and not any("left out" in line for line in said)


LATE = 12  # frames by which one film begins later


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """Keypoints of three films of two people, the third film late, and the cameras; poses of the first person."""
    folder = tmp_path_factory.mktemp("scene")
    cameras = make_ring(3, size=(640, 480), focal=500.0)
    body = make_human(1.75)
    poses = poses_from_motion(body, make_motion("throw", draw_performer(3), frame_rate=RATE))[:80]
    other = poses[::-1].copy()
    other[:, 0] += 1.2
    rng = np.random.default_rng(0)
    for number, camera in enumerate(cameras):
        first = LATE if number == 2 else 0
        people = []
        for rows in (poses, other):
            places = place_points(body, rows, place_landmarks(body, OWN))[first:]
            points = camera.project(places) + rng.normal(0, 1.0, (*places.shape[:2], 2))
            people.append(PersonTrack(points, np.full(points.shape[:2], 0.9 if rows is poses else 0.8)))
        people = people if number else people[::-1]
        view = ViewKeypoints(NAMES, tuple(people), np.arange(len(points)) / RATE, camera.size)
        write_keypoints(folder / f"{camera.name}.npz", view)
    write_cameras(folder / "cameras.toml", cameras)
    return folder, [folder / f"{camera.name}.npz" for camera in cameras], body, poses


def hips_off(path, body, poses):
    motion = read_motion(path)
    rows = [motion.names.index(name) for name in ("left_knee", "right_wrist", "left_shoulder")]
    from dousa.estimation.body.kinematics import compute_points, point_names

    own = [point_names(body).index(motion.names[row]) for row in rows]
    truth = compute_points(body, poses)[:, own]
    n_frames = min(len(truth), motion.n_frames)
    return np.linalg.norm(motion.positions[:n_frames, rows] - truth[:n_frames], axis=2).mean()


def test_films_that_start_apart_are_synchronised_and_the_first_person_taken(succeed, scene, tmp_path):
    folder, sources, body, poses = scene
    words = ("--cameras", folder / "cameras.toml", "--cues", "keypoints", "--json")
    out, _ = succeed("estimate", *sources, *words, "-o", tmp_path / "one.bvh", "-o", tmp_path / "one.trc")
    answer = json.loads(out)
    assert answer["n_frames"] == 80 - LATE and not answer["lost_frames"]
    assert any("synchronised" in warning for warning in answer["warnings"])
    assert hips_off(tmp_path / "one.trc", body, poses[LATE:]) < 0.035


def test_backgrounds_are_not_used_in_silence(succeed, scene, tmp_path):
    folder, sources, *_ = scene
    words = ("--cameras", folder / "cameras.toml", "--offsets", "none", "--json", "--background", "x.png")
    out, _ = succeed("estimate", *sources[:2], *words, "-o", tmp_path / "one.bvh")
    assert any("backgrounds were not used" in warning for warning in json.loads(out)["warnings"])


def test_everybody_gets_a_motion(succeed, scene, tmp_path):
    folder, sources, body, poses = scene
    words = ("--cameras", folder / "cameras.toml", "--cues", "keypoints", "--json", "--offsets", "none", "--everybody")
    out, _ = succeed("estimate", *sources[:2], *words, "-o", tmp_path / "all.trc")
    assert len(json.loads(out)["people"]) == 2
    assert hips_off(tmp_path / "all.trc", body, poses) < 0.035
    assert (tmp_path / "all-2.trc").exists()


@pytest.mark.slow
def test_cameras_that_nobody_knows_are_placed_by_the_person(succeed, scene, tmp_path):
    _, sources, *_ = scene
    words = ("--cues", "keypoints", "--stature", "1.75", "--json")
    out, _ = succeed("estimate", *sources, *words, "-o", tmp_path / "free.trc")
    found = read_motion(tmp_path / "free.trc")
    for side in ("left", "right"):
        ways = (
            found.positions[:, found.names.index(f"{side}_knee")] - found.positions[:, found.names.index(f"{side}_hip")]
        )
        assert abs(np.linalg.norm(ways, axis=1).mean() - 0.236 * 1.75) < 0.06
    assert any("placed by the person" in warning for warning in json.loads(out)["warnings"])


def test_cameras_that_nobody_knows_need_a_stature(dousa, scene, tmp_path):
    code, _, err = dousa("estimate", *scene[1][:2], "--cues", "keypoints", "-o", tmp_path / "x.trc")
    assert code == 2 and "--stature" in err and not (tmp_path / "x.trc").exists()


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("--cues", "keypoints", "--person", "5"), "--person 5"),
        (("--cues", "silhouettes", "--person", "2"), "--cues keypoints"),
        (("--cues", "keypoints", "--offsets", "none.toml"), "none.toml"),
        (("--cues", "keypoints", "--background", "x.png"), "without --background"),
        (("--cues", "both"), "requires masks"),
        (("--cues", "keypoints", "--stature", "175"), "stature"),
    ],
)
def test_mistakes_are_one_line(dousa, scene, tmp_path, words, says):
    folder, sources, *_ = scene
    given = ("--offsets", "none") if "--offsets" not in words else ()
    out_file = tmp_path / "x.bvh"
    code, out, err = dousa(
        "estimate", *sources[:2], "--cameras", folder / "cameras.toml", *given, *words, "-o", out_file
    )
    lines = [line for line in err.splitlines() if not line.startswith("dousa: note:")]
    assert (code, out, len(lines)) == (2, "", 1), err
    assert says in lines[0]
    assert not out_file.exists()


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("--focal-length", "5"), "above 10"),
        (("--focal-length", "500", "--cameras", "cameras.toml"), "either --focal-length or --cameras"),
        (("--mirror-left-right",), "mirror the film itself"),
    ],
)
def test_mistakes_about_one_film(dousa, scene, tmp_path, words, says):
    folder, sources, *_ = scene
    given = [folder / word if word.endswith(".toml") else word for word in words]
    code, out, err = dousa("estimate", sources[0], "--cues", "keypoints", *given, "-o", tmp_path / "x.bvh")
    assert (code, out, err.count("\n")) == (2, "", 1), err
    assert says in err and not (tmp_path / "x.bvh").exists()


def test_frames_without_anybody_are_told_from_those_that_are_lost():
    from dousa.app.pipelines.estimate import describe_fit
    from dousa.estimation import fit_keypoints

    body, cameras = make_human(1.75), make_ring(2, size=(640, 480), focal=500.0)
    poses = poses_from_motion(body, make_motion("bow", draw_performer(1), frame_rate=RATE))[:40]
    tracks = []
    for camera in cameras:
        points = camera.project(place_points(body, poses, place_landmarks(body, OWN)))
        points[:15] = np.nan
        tracks.append(PersonTrack(points, np.where(np.isfinite(points[..., 0]), 0.9, 0.0)))
    said = describe_fit(fit_keypoints(cameras, tracks, NAMES, RATE), cameras, True)
    absent = next(message for message in said if message.code == "film_estimate.absent")
    assert absent.values["frames"] == 15 and absent.values["total"] == 40
    assert not any(message.code == "film_estimate.lost" for message in said)


def test_somebody_in_the_background_is_left_out_and_named():
    from dousa.app.pipelines.estimate import list_everybody
    from dousa.estimation.multiview.people import MatchedPerson

    seen = PersonTrack(np.zeros((10, 3, 2)), np.ones((10, 3)))
    half = np.zeros((10, 3, 2))
    half[4:] = np.nan
    briefly = PersonTrack(half, np.ones((10, 3)))
    tracks = ((seen, seen, seen), (seen, seen, None), (briefly, seen, None))
    people = [MatchedPerson(own, tuple(() if track is None else (0,) for track in own)) for own in tracks]
    chosen, aside = list_everybody(people)
    assert [number for number, _ in chosen] == [1, 2]
    assert [(message.code, message.values["number"]) for message in aside] == [("film_estimate.aside", 3)]


def test_a_film_that_states_its_lens(tmp_path):
    av = pytest.importorskip("av")
    from dousa.app.pipelines.film_scene import read_focal_length

    path = tmp_path / "phone.mov"
    with av.open(str(path), "w", options={"movflags": "use_metadata_tags"}) as film:
        film.metadata["com.apple.quicktime.camera.focal_length.35mm_equivalent"] = "26"
        stream = film.add_stream("mpeg4", rate=30)
        stream.width, stream.height = 64, 48
        frame = av.VideoFrame.from_ndarray(np.zeros((48, 64, 3), np.uint8), format="rgb24")
        film.mux([*stream.encode(frame), *stream.encode(None)])
    assert read_focal_length(path, (1920, 1080)) == pytest.approx(26 / 36 * 1920)
    assert read_focal_length(tmp_path / "nothing.mp4", (1920, 1080)) is None
    assert read_focal_length(tmp_path / "keypoints.npz", (1920, 1080)) is None
