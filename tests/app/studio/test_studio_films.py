"""Estimation from films over the interface: people, offsets, cameras, another person, what is missing, hostile input.

No models are needed: the films come with keypoints, as of `dousa keypoints` or another program.
"""

import base64
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from oracles import made_films

from app.studio.conftest import ask_directly, wait_for
from app.studio.film_scenes import LATE, N_FRAMES, RATE, write_film_scene
from app.studio.test_studio_estimate import look, look_here, upload
from app.test_keypoint_sources import to_rows, write_openpose
from app.test_projects import RATE as PROJECT_RATE
from app.test_projects import make_pose2sim
from dousa.app.studio.content.film_record import FilmPictures, choose_stride, name_pictures, write_pictures
from dousa.app.studio.work.films import choose_person, choose_who_places, leave_out, pair_films
from dousa.app.studio.work.materials import sort_materials
from dousa.errors import OptionError
from dousa.estimation import read_keypoints
from dousa.estimation.keypoints.keypoint_json import HALPE_26
from estimation.keypoints.test_keypoint_input import PIXELS

pytest.importorskip("av", reason="the reader of films is not installed: pip install 'dousa[film]'")

N_SHARED = N_FRAMES - LATE
CAMERAS, STATURE = {"cameras": "cameras.toml"}, {"body": {"stature_m": 1.75}}


@pytest.fixture(scope="module")
def scene(tmp_path_factory) -> Path:
    """Three films of two people with their keypoints, and the cameras."""
    folder = tmp_path_factory.mktemp("films")
    write_film_scene(folder)
    return folder


@pytest.fixture(scope="module")
def client(tmp_path_factory):
    """A studio for all tests of this module, on an empty library."""
    yield from ask_directly(tmp_path_factory.mktemp("studio-of-films") / "moves.dousa")


@pytest.fixture(scope="module")
def batch(client, scene) -> str:
    """All of it, uploaded."""
    return upload(client, *((path.name, path.read_bytes()) for path in sorted(scene.iterdir())))


def estimate(client: Any, **request: Any) -> dict[str, Any]:
    answer = client.post("/api/jobs/estimate", json={"overlay_video": False, **request})
    assert answer.status_code == 202, answer.text
    return wait_for(client, answer.json()["id"], 300)


@pytest.fixture(scope="module")
def done(client, batch) -> dict[str, Any]:
    """One estimation for all tests, finished."""
    job = estimate(client, batch=batch, **CAMERAS)
    assert job["state"] == "done", job["problem"]
    return job


@pytest.fixture(scope="module")
def film(client, done) -> dict[str, Any]:
    """What was found."""
    return client.get(f"/api/estimations/{done['id']}/film").json()


class TestBefore:
    def test_a_look_shows_the_films_and_asks_for_the_stature(self, client, batch):
        found = look(client, batch=batch, cameras=None, sources=["view1.mp4", "view1.npz", "view2.mp4", "view2.npz"])
        assert found["films"] and [view["name"] for view in found["views"]] == ["view1", "view2"]
        assert all(view["picture"].startswith("data:image/jpeg;base64,") for view in found["views"])

    def test_without_cameras_the_stature_is_needed_and_nothing_else(self, client, scene):
        films = [(path.name, path.read_bytes()) for path in sorted(scene.glob("view*"))]
        batch = upload(client, *films)
        found = look_here(client, batch=batch)
        assert found["missing"].startswith("type the stature") and len(found["views"]) == 3
        ready = look_here(client, batch=batch, **STATURE)
        assert ready["missing"] is None and ready["body"] == "body height 1.75 m, given"

    def test_a_calibration_is_matched(self, client, batch):
        found = look_here(client, batch=batch)
        assert found["missing"] is None and [view["camera"] for view in found["views"]] == ["view1", "view2", "view3"]

    def test_one_film_is_enough_and_its_limits_are_said(self, client, batch):
        found = look_here(client, batch=batch, sources=["view2.npz"], cameras=None)
        assert found["missing"] is None or found["missing"].startswith("expected")
        assert found["films"] and len(found["views"]) == 1

    def test_missing_models_are_one_sentence_with_the_command(self, client, scene, tmp_path, monkeypatch):
        monkeypatch.setenv("DOUSA_MODELS", str(tmp_path))
        pytest.importorskip("ai_edge_litert", reason="LiteRT is not installed: pip install 'dousa[film]'")
        batch = upload(client, *((f"view{k}.mp4", (scene / f"view{k}.mp4").read_bytes()) for k in (1, 2)))
        found = look_here(client, batch=batch, **STATURE)
        assert "dousa keypoints --install" in found["missing"] and "\n" not in found["missing"]
        assert len(found["views"]) == 2 and found["films"]

    def test_films_with_plates_are_silhouettes_as_before(self, client, scene):
        files = [(f"view{k}.mp4", (scene / f"view{k}.mp4").read_bytes()) for k in (1, 2)]
        found = look_here(client, batch=upload(client, *files), cues="silhouettes")
        assert not found["films"] and found["missing"].startswith("calibration file required")


class TestMaterials:
    @pytest.mark.parametrize("inside", ["", "trial/"])
    def test_a_project_is_opened(self, client, tmp_path, inside):
        """Keypoints, calibration, rate and stature are used, also as the page names them; what was made is not."""
        cameras = made_films.make_cameras(2)
        make_pose2sim(tmp_path, cameras)
        (tmp_path / "pose-3d" / "walk_0-99.trc").write_text("PathFileType 4 (X/Y/Z) walk.trc")
        (tmp_path / "calibration" / "cam.pickle").write_bytes(b"\x80\x04}.")
        for camera in cameras:
            view = made_films.film(made_films.Performance(("punch",)), camera, 0.0, 0.2, PROJECT_RATE)
            write_openpose(tmp_path / "pose" / camera.name, to_rows(view, HALPE_26))
        files = [path for path in sorted(tmp_path.rglob("*")) if path.is_file() and path.stat().st_size]
        named = [(f"{inside}{path.relative_to(tmp_path).as_posix()}", path.read_bytes()) for path in files]
        batch = upload(client, *named)
        found = look_here(client, batch=batch)
        roles = {item["name"]: item["role"] for item in found["files"] if item["role"] != "unused"}
        sources = [f"{inside}pose/{camera.name}_json" for camera in cameras]
        calibration = f"{inside}calibration/Calib_qualisys.toml"
        assert roles == dict.fromkeys(sources, "source") | {calibration: "cameras"}
        for answer in (found, look_here(client, batch=batch, sources=sources, cameras=calibration)):
            assert (answer["missing"], answer["frame_rate"], len(answer["views"])) == (None, PROJECT_RATE, 2)
            assert "168" in answer["body"] or "1.68" in answer["body"]

    def test_keypoints_are_views(self, scene):
        names = [path.name for path in scene.iterdir() if path.is_file()]
        roles = {item.name: (item.role, item.kind) for item in sort_materials(scene, names)}
        assert roles["view1.npz"] == ("source", "keypoints") and roles["cameras.toml"] == ("cameras", "table")

    def test_points_of_a_picture_in_a_trc_are_a_view_and_not_a_start(self, tmp_path):
        (tmp_path / "v_px.trc").write_text(PIXELS)
        assert [(item.role, item.kind) for item in sort_materials(tmp_path, ["v_px.trc"])] == [("source", "keypoints")]

    def test_json_of_many_frames_is_one_view_and_of_few_one_each(self, tmp_path):
        content = json.dumps({"people": [{"pose_keypoints_2d": [1.0, 2.0, 0.9] * 25}]})
        names = [f"left/f{frame:03d}.json" for frame in range(12)] + ["a.json", "b.json"]
        for name in [*names, "calib.json"]:
            (tmp_path / name).parent.mkdir(exist_ok=True)
            (tmp_path / name).write_text(content if name != "calib.json" else '{"cameras": []}')
        found = sort_materials(tmp_path, [*names, "calib.json"])
        assert {(item.name, item.role, item.n_files) for item in found} == {
            ("left", "source", 12),
            ("a.json", "source", 1),
            ("b.json", "source", 1),
            ("calib.json", "cameras", 1),
        }

    def test_a_film_and_its_keypoints_are_one_view(self, scene):
        files = [scene / "view1.mp4", scene / "view1.npz", scene / "view2.mp4", scene / "view3.npz"]
        pairs = [(one.name, one.source.name, one.film and one.film.name) for one in pair_films(files).views]
        assert pairs == [
            ("view1", "view1.npz", "view1.mp4"),
            ("view2", "view2.mp4", "view2.mp4"),
            ("view3", "view3.npz", None),
        ]
        with pytest.raises(OptionError) as error:
            pair_films([scene / f"{k}.mp4" for k in range(9)])
        assert error.value.code == "studio_films.many"


class TestAfter:
    def test_the_films_are_on_one_clock(self, film):
        assert film["stage"] == "fitted" and film["total"] == N_SHARED
        np.testing.assert_allclose(film["starts"], [0, 0, LATE / RATE], atol=0.01)

    def test_each_person_is_one_in_all_views(self, film):
        members = [sorted(map(tuple, person["members"])) for person in film["people"]]
        assert members == [[(0, 1), (1, 0), (2, 0)], [(0, 0), (1, 1), (2, 1)]]
        assert film["chosen"] == 0 and film["left_out"] == []

    def test_cameras_stand_where_they_do(self, film, scene):
        from dousa.estimation import read_cameras

        for said, camera in zip(film["cameras"], read_cameras(scene / "cameras.toml"), strict=True):
            np.testing.assert_allclose(said["position"], camera.position, atol=1e-3)
            pixels = camera.project(np.array(said["corners"]))
            right, low = camera.width - 1, camera.height - 1
            np.testing.assert_allclose(pixels, [(0, 0), (right, 0), (right, low), (0, low)], atol=0.5)

    def test_keypoints_come_at_the_shared_moments(self, client, done, film, scene):
        came = client.get(f"/api/estimations/{done['id']}/film/people/0?first=10&count=20").json()
        assert (came["people"], came["frames"], came["first"]) == (2, 20, 10)
        points = np.frombuffer(base64.b64decode(came["points"]), "<i2").reshape(2, 20, -1, 2)
        own = read_keypoints(scene / "view1.npz")
        rows = own.find(film["names"])
        truth = own.people[1].points[LATE + 10 : LATE + 30][:, rows]  # the first film has run for LATE frames
        pixels = points[1] / 16384 * own.size - 0.5
        seen = points[1, ..., 0] != -32768
        assert seen.mean() > 0.95 and np.abs(pixels[seen] - truth[seen]).max() < 0.1
        sure = np.frombuffer(base64.b64decode(came["sure"]), np.uint8)
        assert set(np.unique(sure[sure > 0])) <= {round(255 * 0.8), round(255 * 0.9), 230, 229, 204}

    def test_pictures_are_those_of_the_moment(self, client, done):
        import cv2

        address = f"/api/estimations/{done['id']}/film/picture"
        first = client.get(f"{address}/0/0")
        assert first.headers["content-type"] == "image/jpeg"
        image = cv2.imdecode(np.frombuffer(first.content, np.uint8), cv2.IMREAD_COLOR)
        assert image.shape == (240, 320, 3)
        assert first.content != client.get(f"{address}/0/30").content
        assert client.get(f"/api/estimations/{done['id']}/overlay/0/30").content[:2] == b"\xff\xd8"

    def test_the_motion_goes_on_as_any_other(self, client, done):
        assert done["result"]["files"] == ["motion.bvh", "joints.trc", "angles.csv", "cameras.toml"]
        start = f"/api/estimations/{done['id']}"
        assert client.get(f"{start}/files/motion.bvh").content.startswith(b"HIERARCHY")
        assert "matrix" in client.get(f"{start}/files/cameras.toml").text
        frames = client.get(f"{start}/frames?joints=true").json()
        assert frames["film"] > 0 and frames["finished"] == N_SHARED
        assert client.get(f"{start}/player").json()["performance"]["n_frames"] == N_SHARED
        info = client.get(f"/api/motions/info?motion=job:{done['id']}")
        assert info.status_code == 200, info.text

    @pytest.mark.parametrize("path", ["picture/9/0", "picture/0/9999", "people/3", "people/0?count=0"])
    def test_what_is_not_there_is_said(self, client, done, path):
        answer = client.get(f"/api/estimations/{done['id']}/film/{path}")
        assert answer.status_code in (404, 422) and answer.json()["problem"]


class TestAgain:
    @pytest.mark.slow
    def test_another_person_without_a_wrong_track(self, client, batch, done):
        """The other person, after somebody said that one of their tracks is nobody."""
        two = {"sources": ["view1.mp4", "view1.npz", "view2.npz"], **CAMERAS}
        job = estimate(client, batch=batch, **two, person=[[0, 0], [1, 1]], left_out=[[0, 1]])
        assert job["state"] == "done", job["problem"]
        film = client.get(f"/api/estimations/{job['id']}/film").json()
        chosen = film["people"][film["chosen"]]["members"]
        assert sorted(chosen) == [[0, 0], [1, 1]] and film["left_out"] == [[0, 1]]
        assert film["starts"] == [0, 0] and film["total"] == N_FRAMES  # synchronised by this person
        assert [0, 1] not in [member for person in film["people"] for member in person["members"]]
        assert len(film["views"][0]["people"]) == 2  # it is still shown, so that it can be used again
        places = [joints(client, one["id"])[:, 0].mean(axis=0) for one in (done, job)]
        assert np.linalg.norm(places[0] - places[1]) > 0.5

    def test_tracks_that_nobody_has(self, client, batch):
        job = estimate(client, batch=batch, **CAMERAS, offsets="none", person=[[0, 77]])
        assert job["state"] == "failed" and "choose a person again" in job["problem"]

    def test_everybody_left_out(self, client, batch):
        tracks = [[view, track] for view in range(3) for track in range(2)]
        job = estimate(client, batch=batch, **CAMERAS, offsets="none", left_out=tracks)
        assert job["state"] == "failed" and "\n" not in job["problem"]
        assert client.get(f"/api/estimations/{job['id']}/film").json()["stage"] in ("found", "placed")

    def test_numbers_stay_those_of_the_film(self, scene):
        found = [read_keypoints(scene / f"view{k}.npz") for k in (1, 2)]
        kept, numbers = leave_out(found, [(0, 0), (5, 5)])
        assert numbers == [[1], [0, 1]] and [len(view.people) for view in kept] == [1, 2]
        np.testing.assert_array_equal(kept[0].people[0].points, found[0].people[1].points)

    def test_who_is_chosen_in_all_films_places_the_cameras(self, scene):
        found = [read_keypoints(scene / f"view{k}.npz") for k in (1, 2, 3)]
        kept, numbers = leave_out(found, [(1, 0)])
        assert choose_who_places(kept, numbers, [(0, 0), (1, 1), (2, 1)]) == [0, 0, 1]
        assert choose_who_places(kept, numbers, [(0, 0), (2, 1)]) is None
        assert choose_who_places(kept, numbers, []) is None

    def test_who_has_most_of_the_tracks_is_chosen(self):
        from dousa.estimation.multiview.people import MatchedPerson

        people = [MatchedPerson((None, None), ((0,), (1,))), MatchedPerson((None, None), ((1,), (0,)))]
        numbers = [[0, 2], [0, 1]]
        assert choose_person(people, numbers, []) == 0
        assert choose_person(people, numbers, [(0, 2)]) == 1
        assert choose_person(people, numbers, [(0, 2), (1, 1), (0, 0)]) == 0


def joints(client: Any, job: str) -> np.ndarray:
    answer = client.get(f"/api/estimations/{job}/frames?joints=true").json()
    return np.frombuffer(base64.b64decode(answer["joints"]), "<f4").reshape(-1, 20, 3)


class TestPictures:
    def test_an_interrupted_run_goes_on(self, scene, tmp_path):
        film = tmp_path / "a.mp4"
        film.write_bytes((scene / "view2.mp4").read_bytes())
        whole = tmp_path / "b.mp4"
        whole.write_bytes(film.read_bytes())

        def stop(done: int, _total: int, _what: Any) -> None:
            if done > 30:
                raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            write_pictures(film, 1, stop)
        with open(f"{name_pictures(film)}.bin", "ab") as file:
            file.write(b"half a pict")
        write_pictures(film, 1, lambda *_: None)
        write_pictures(whole, 1, lambda *_: None)
        for frame in (0, 29, 31, N_FRAMES - 1):
            assert FilmPictures(film).read(frame) == FilmPictures(whole).read(frame) != None  # noqa: E711
        assert Path(f"{name_pictures(film)}.bin").stat().st_size == Path(f"{name_pictures(whole)}.bin").stat().st_size

    def test_of_long_films_not_every_frame_is_kept(self, scene, tmp_path):
        assert choose_stride(1000) == 1 and choose_stride(100_000) > 2
        film = tmp_path / "a.mp4"
        film.write_bytes((scene / "view2.mp4").read_bytes())
        write_pictures(film, 4, lambda *_: None)
        pictures = FilmPictures(film)
        assert pictures.read(7) == pictures.read(4) != pictures.read(8)
        assert FilmPictures(tmp_path / "none.mp4").read(0) is None


class TestRefused:
    @pytest.mark.parametrize(
        "request_",
        [
            {"person": [[0]]},
            {"person": [[0, -1]]},
            {"left_out": [[0, 1, 2]]},
            {"cues": "magic"},
            {"model": "best"},
            {"offsets": "/etc/passwd"},
        ],
    )
    def test_requests_that_are_none(self, client, batch, request_):
        answer = client.post("/api/jobs/estimate", json={"batch": batch, **request_})
        assert answer.status_code == 422 and answer.json()["problem"]

    def test_damaged_keypoints(self, client, scene):
        content = (scene / "view1.npz").read_bytes()
        for damaged in (content[: len(content) // 2], content[:-400] + bytes(300)):
            batch = upload(client, ("view1.npz", damaged), ("view2.npz", (scene / "view2.npz").read_bytes()))
            found = look_here(client, batch=batch, **STATURE)
            assert found["missing"] and "\n" not in found["missing"] and "/files/" not in found["missing"]

    def test_a_damaged_film(self, client, scene):
        content = (scene / "view1.mp4").read_bytes()
        files = (("view1.mp4", content[:64] + bytes(2000)), ("view1.npz", (scene / "view1.npz").read_bytes()))
        found = look_here(client, batch=upload(client, *files), cues="keypoints")
        assert found["missing"] and "Traceback" not in found["missing"] and "\n" not in found["missing"]

    def test_an_estimation_from_silhouettes_has_no_films(self, client, batch):
        job = estimate(client, batch=batch, cues="silhouettes", sources=["view1.mp4"], frames="0:1")
        answer = client.get(f"/api/estimations/{job['id']}/film")
        assert answer.status_code == 404 and answer.json()["problem"]
        assert client.get(f"/api/estimations/{job['id']}/frames").json()["film"] == 0
