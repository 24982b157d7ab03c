"""Estimation over the interface: a look before, frames while it runs, what comes out, stopping, hostile input."""

import base64
import io
import json
import time
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from app.studio.conftest import ask_directly, wait_for
from app.studio.estimating_scenes import write_scene
from dousa.app.studio.content.footage import Footage, FootageWriter
from dousa.app.studio.core.answers import name_error, pack, say, say_packed
from dousa.app.studio.jobs.lanes import Context
from dousa.app.studio.work.estimation import rank_warnings
from dousa.app.studio.work.materials import sort_materials
from dousa.app.studio.work.preview import preview
from dousa.errors import MotionFileError
from dousa.messages import Message
from dousa.messages.tables import load_table

N_FRAMES = 12


@pytest.fixture(scope="module")
def seen(tmp_path_factory) -> Path:
    """An npz of silhouettes: a dozen frames in two views."""
    return write_scene(tmp_path_factory.mktemp("seen") / "seen.npz", N_FRAMES)


@pytest.fixture(scope="module")
def client(tmp_path_factory):
    """A studio for all tests of this module, on an empty library."""
    yield from ask_directly(tmp_path_factory.mktemp("estimating") / "moves.dousa")


def upload(client: Any, *files: tuple[str, bytes]) -> str:
    batch = ""
    for name, content in files:
        asked = f"/api/uploads?name={name}" + (f"&batch={batch}" if batch else "")
        answer = client.post(asked, content=content)
        assert answer.status_code == 201, answer.text
        batch = answer.json()["batch"]
    return batch


@pytest.fixture(scope="module")
def batch(client, seen) -> str:
    """The silhouettes, uploaded."""
    return upload(client, ("seen.npz", seen.read_bytes()))


@pytest.fixture(scope="module")
def done(client, batch) -> dict[str, Any]:
    """One estimation for all tests, finished."""
    answer = client.post("/api/jobs/estimate", json={"batch": batch, "smoothing": 8, "beam": 2})
    assert answer.status_code == 202, answer.text
    job = wait_for(client, answer.json()["id"])
    assert job["state"] == "done", job["problem"]
    return job


def look(client: Any, **request: Any) -> dict[str, Any]:
    answer = client.post("/api/estimations/preview", json=request)
    assert answer.status_code == 200, answer.text
    return answer.json()


def look_here(client: Any, **request: Any) -> dict[str, Any]:
    """The same without a process of its own, which takes a second to begin."""
    home = client.app.state.studio.settings.folder
    context = Context(home / "x.dousa", home, home / "files", lambda *_: None, lambda _: None)
    return say_packed(pack(preview(request, context)))


def npz(**arrays: Any) -> bytes:
    file = io.BytesIO()
    np.savez(file, **arrays)
    return file.getvalue()


class TestBefore:
    @pytest.mark.plain_workers
    def test_a_look_shows_views_cameras_and_silhouettes(self, client, batch):
        found = look(client, batch=batch, frames="2:")
        assert found["missing"] is None
        assert found["files"] == [{"name": "seen.npz", "role": "source", "kind": "npz", "n_files": 1}]
        assert (found["n_frames"], found["frame_rate"], found["first_frame"]) == (N_FRAMES - 2, 30.0, 2)
        assert [view["camera"] for view in found["views"]] == ["view1", "view2"]
        assert all(view["picture"].startswith("data:image/jpeg;base64,") for view in found["views"])
        assert "from the file of the silhouettes" in found["body"]

    def test_without_cameras_the_silhouettes_show_and_one_sentence_says_what_is_missing(self, client, seen):
        with np.load(seen) as file:
            bare = npz(**{key: file[key] for key in ("mask_packed", "width", "height")})
        found = look_here(client, batch=upload(client, ("bare.npz", bare)))
        assert found["missing"].startswith("calibration file required") and len(found["views"]) == 2
        assert found["views"][0]["picture"] and found["views"][0]["camera"] is None

    def test_a_calibration_beside_masks_is_found_and_matched(self, client, seen):
        with np.load(seen) as file:
            masks = {key: file[key] for key in ("mask_packed", "width", "height")}
            cameras = {key: file[key] for key in file if key.startswith(("camera", "world", "view_"))}
            sides = {key: file[key] for key in ("width", "height")}
        files = (("masks.npz", npz(**masks)), ("calib.npz", npz(**cameras, **sides)))
        batch = upload(client, *files)
        found = look_here(client, batch=batch)
        assert {item["name"]: item["role"] for item in found["files"]} == {
            "masks.npz": "source",
            "calib.npz": "cameras",
        }
        assert found["missing"] is None
        without = look_here(client, batch=batch, sources=["masks.npz"])
        assert without["missing"].startswith("calibration file required")

    @pytest.mark.parametrize(
        ("content", "said"),
        [
            (npz(mask_packed=np.zeros((2, 4, 60, 10), np.uint8), width=80, height=60), "empty"),
            (npz(mask_packed=np.zeros((1, 1, 8, 8), np.uint8), width=900_000, height=8), "width"),
            (npz(nothing=np.zeros(3)), "mask"),
            (npz(mask_packed=np.zeros(3, np.uint8), width=8, height=8), "mask_packed"),
        ],
    )
    def test_what_is_no_silhouette_is_said_in_one_sentence(self, client, content, said):
        found = look_here(client, batch=upload(client, ("odd.npz", content)))
        assert found["missing"] and "Traceback" not in found["missing"] and "\n" not in found["missing"]
        assert said in found["missing"] or found["missing"].startswith("calibration file required")
        assert "/files/" not in found["missing"]

    def test_an_array_that_says_it_is_huge_is_not_unpacked(self, client):
        head = b"\x93NUMPY\x01\x00" + (118).to_bytes(2, "little")
        shape = b"{'descr': '|u1', 'fortran_order': False, 'shape': (1000, 100000, 6000, 8000), }"
        file = io.BytesIO()
        with zipfile.ZipFile(file, "w") as archive:
            archive.writestr("mask_packed.npy", head + shape.ljust(117) + b"\n")
        found = look(client, batch=upload(client, ("huge.npz", file.getvalue())))
        assert found["missing"] and found["views"] == []

    @pytest.mark.slow
    @pytest.mark.plain_workers
    def test_the_example_is_ready_to_be_estimated(self, client):
        answer = client.post("/api/estimations/example")
        assert answer.status_code == 201 and 1.4 < answer.json()["stature_m"] < 2.1
        found = look_here(client, batch=answer.json()["batch"])
        assert found["missing"] is None and len(found["views"]) == 4

    def test_nothing_to_estimate(self, client):
        batch = upload(client, ("calib.txt", b"nothing"))
        assert "silhouettes are missing" in look_here(client, batch=batch)["missing"]


class TestAfter:
    def test_the_result_says_how_far_to_trust_it(self, done):
        result = done["result"]
        assert result["iou"]["mean"] > 0.7 and result["n_frames"] == N_FRAMES
        assert result["files"] == ["motion.bvh", "joints.trc", "angles.csv", "overlay.mp4"]
        assert result["motion"] == "motion.bvh"

    def test_every_frame_is_there_smoothed(self, client, done):
        answer = client.get(f"/api/estimations/{done['id']}/frames?joints=true").json()
        assert answer["finished"] == answer["total"] == N_FRAMES
        assert answer["frames"] == list(range(N_FRAMES)) and answer["stage"] == [2] * N_FRAMES
        overlap = np.array(answer["overlap"])
        assert overlap.shape == (N_FRAMES, 2) and overlap.mean() == pytest.approx(
            done["result"]["iou"]["mean"], abs=0.01
        )
        joints = np.frombuffer(base64.b64decode(answer["joints"]), "<f4").reshape(-1, 20, 3)
        motion = client.app.state.studio.motions.get(_ref(done)).motion
        np.testing.assert_allclose(joints, motion.positions, atol=0.03)
        later = client.get(f"/api/estimations/{done['id']}/frames?from={answer['next']}").json()
        assert later["frames"] == [] and later["next"] == answer["next"]

    def test_the_figure_is_that_of_the_player(self, client, done):
        data = client.get(f"/api/estimations/{done['id']}/player?language=ja").json()
        assert data["performance"]["n_frames"] == N_FRAMES and data["language"] == "ja"

    def test_overlays_are_drawn_when_asked_for(self, client, done):
        first, again = (client.get(f"/api/estimations/{done['id']}/overlay/1/5") for _ in range(2))
        assert first.headers["content-type"] == "image/jpeg" and first.content[:2] == b"\xff\xd8"
        assert first.content == again.content
        assert first.content != client.get(f"/api/estimations/{done['id']}/overlay/0/5").content

    @pytest.mark.parametrize("path", ["overlay/2/0", "overlay/0/99", "overlay/0/10000000"])
    def test_overlays_that_are_not(self, client, done, path):
        answer = client.get(f"/api/estimations/{done['id']}/{path}")
        assert answer.status_code == 404 and "problem" in answer.json()

    def test_files_can_be_fetched_and_no_others(self, client, done):
        start = f"/api/estimations/{done['id']}/files"
        assert client.get(f"{start}/motion.bvh").content.startswith(b"HIERARCHY")
        assert client.get(f"{start}/joints.trc").content.startswith(b"PathFileType")
        assert client.get(f"{start}/angles.csv").text.startswith("time_s,")
        assert b"ftyp" in client.get(f"{start}/overlay.mp4").content[:16]
        for name in ("job.json", "log.txt", "poses.bin", "..%2Fjob.json", "%2e%2e"):
            assert client.get(f"{start}/{name}").status_code == 404

    def test_its_pose_can_be_the_start_of_another(self, client, batch, done):
        start = {"motion": f"job:{done['id']}", "frame": 2}
        assert look_here(client, batch=batch, start=start)["start"] == "motion.bvh, frame 2"
        late = look_here(client, batch=batch, start={**start, "frame": 99})
        assert "no frame 99" in late["missing"] and "/jobs/" not in late["missing"]

    def test_it_goes_into_the_library(self, client, done):
        job = client.post(f"/api/estimations/{done['id']}/add", json={"name": "mine", "category": "jump"}).json()
        job = wait_for(client, job["id"])
        assert job["result"]["added"] == ["jump/mine.bvh"]
        assert client.get("/api/info").json()["library"]["categories"] == {"jump": 1}
        bad = client.post(f"/api/estimations/{done['id']}/add", json={"name": "../../evil"})
        assert bad.status_code == 422


def _ref(job: dict[str, Any]) -> Any:
    from dousa.app.studio.content.motions import MotionRef

    return MotionRef(motion=f"job:{job['id']}")


class TestStopped:
    @pytest.mark.slow
    @pytest.mark.plain_workers
    def test_stopped_work_goes_on_where_it_was(self, client, tmp_path):
        content = write_scene(tmp_path / "long.npz", 90).read_bytes()
        batch = upload(client, ("long.npz", content))
        job = client.post("/api/jobs/estimate", json={"batch": batch, "overlay_video": False, "beam": 2}).json()["id"]
        seen = 0
        while seen < 34:
            found = client.get(f"/api/estimations/{job}/frames").json()
            seen = found["finished"]
            assert client.get(f"/api/jobs/{job}").json()["state"] in ("queued", "running")
            time.sleep(0.02)
        assert found["total"] == 90 and 0 in found["stage"]
        client.post(f"/api/jobs/{job}/stop")
        assert wait_for(client, job)["state"] == "stopped"
        assert client.get(f"/api/estimations/{job}/overlay/0/20").status_code == 200
        assert client.get(f"/api/estimations/{job}/files/motion.bvh").status_code == 404
        client.post(f"/api/jobs/{job}/resume")
        done = wait_for(client, job)
        assert done["state"] == "done", done["problem"]
        assert any(note.startswith("resuming at frame ") for note in done["notes"])
        assert done["result"]["files"] == ["motion.bvh", "joints.trc", "angles.csv"]
        assert client.get(f"/api/estimations/{job}/frames").json()["stage"] == [2] * 90


class TestRefused:
    @pytest.mark.parametrize(
        "request_",
        [
            {"batch": "../etc"},
            {"batch": "0" * 16},
            {"sources": ["../../../etc/passwd"]},
            {"sources": ["/etc/passwd"]},
            {"cameras": "../x.toml"},
            {"body": "../x.toml"},
            {"body": {"stature_m": 172}},
            {"frames": "a:b"},
            {"rate": 0},
            {"beam": 1000},
            {"start": {"motion": "file:../../x"}},
            {"unknown": 1},
        ],
    )
    def test_requests_that_cannot_be_carried_out(self, client, batch, request_):
        for path in ("/api/jobs/estimate", "/api/estimations/preview"):
            answer = client.post(path, json={"batch": batch, **request_})
            assert 400 <= answer.status_code < 500 and answer.json()["problem"]

    def test_names_that_are_not_in_the_batch_end_the_job_with_a_sentence(self, client, batch):
        job = client.post("/api/jobs/estimate", json={"batch": batch, "sources": ["other.npz"]}).json()
        job = wait_for(client, job["id"])
        assert job["state"] == "failed" and "no file or folder 'other.npz'" in job["problem"]

    def test_jobs_of_another_kind_have_no_frames(self, client):
        job = client.post("/api/jobs/train", json={}).json()["id"]
        assert client.get(f"/api/estimations/{job}/frames").status_code == 404
        assert client.get("/api/estimations/0123456789abcdef/frames").status_code == 404
        wait_for(client, job)


class TestMaterials:
    def roles(self, tmp_path: Path, files: dict[str, bytes]) -> dict[str, str]:
        for name, content in files.items():
            path = tmp_path / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
        return {item.name: item.role for item in sort_materials(tmp_path, files)}

    def test_films_with_plates(self, tmp_path):
        files = dict.fromkeys(("b/cam10.mp4", "b/cam2.mp4", "plates/cam2.png", "calib.qca.txt", "first.trc"), b"x")
        found = self.roles(tmp_path, files)
        assert list(found) == ["b/cam2.mp4", "b/cam10.mp4", "calib.qca.txt", "plates/cam2.png", "first.trc"]
        assert list(found.values()) == ["source", "source", "cameras", "background", "start"]

    def test_folders_of_masks(self, tmp_path):
        files = {f"{view}/{frame}.png": b"x" for view in ("left", "right") for frame in range(3)}
        found = self.roles(tmp_path, {**files, "c.toml": b"[cam]", "me.toml": b"stature = 1.7\n"})
        assert found == {"left": "source", "right": "source", "c.toml": "cameras", "me.toml": "body"}

    def test_pictures_without_a_folder_are_one_view(self, tmp_path):
        assert self.roles(tmp_path, {"1.png": b"x", "2.png": b"x"}) == {".": "source"}

    def test_of_two_calibrations_one_is_used(self, tmp_path):
        assert self.roles(tmp_path, {"a.toml": b"[cam]", "b.xml": b"<a/>"}) == {"a.toml": "cameras", "b.xml": "unused"}


def test_messages_name_neither_folders_nor_options(tmp_path):
    path = tmp_path / "files" / ("a" * 16) / "seen.npz"
    told = name_error(
        MotionFileError(path, "amc.several_skeletons", skeletons=("a.asf",), folder=path.parent), tmp_path
    )
    assert told.values["path"] == "seen.npz"
    assert str(tmp_path) not in say(told) and "--" not in say(told)


def test_half_a_record_at_the_end_is_waited_for(client, done, tmp_path):
    folder = client.app.state.studio.jobs.folder(client.app.state.studio.jobs.get(done["id"]))
    for name in ("scene.npz", "poses.bin", "seen.idx", "seen.bin"):
        (tmp_path / name).write_bytes((folder / name).read_bytes())
    whole = (tmp_path / "poses.bin").read_bytes()
    (tmp_path / "poses.bin").write_bytes(whole[:-7])
    footage = Footage(tmp_path)
    footage.refresh()
    before = footage.frames_since(0)
    (tmp_path / "poses.bin").write_bytes(whole)
    footage.refresh()
    assert footage.frames_since(before["next"])["frames"] == [N_FRAMES - 1]
    (tmp_path / "scene.npz").unlink()
    footage.refresh()
    assert footage.frames_since(0)["frames"] == [] and footage.total == 0


def test_a_run_from_the_beginning_leaves_nothing_of_the_one_before(tmp_path):
    from dousa.app.pipelines.estimation_views import Scene

    for name in ("scene.npz", "poses.bin", "seen.idx", "seen.bin"):
        (tmp_path / name).write_bytes(b"old")
    writer = FootageWriter(tmp_path)
    writer.begin(Scene(("a",), (), 30.0, 3, 0))
    writer.see(0, [np.ones((4, 4), bool)], [None])
    writer.close()
    assert not (tmp_path / "scene.npz").exists() and not (tmp_path / "poses.bin").exists()
    assert (tmp_path / "seen.bin").read_bytes().startswith(b"\x89PNG")


BAD = Message("doubts.bad_overlap", overlap=0.52)
DOUBT = Message("doubts.one_view")
NOTE = Message("film_estimate.calibrated", views=2)


@pytest.mark.parametrize(
    ("warnings", "lost", "trust", "order"),
    [
        ([NOTE, DOUBT, BAD], 0.0, "bad", [BAD, DOUBT, NOTE]),
        ([NOTE, DOUBT], 0.1, "unsure", [DOUBT, NOTE]),
        ([NOTE], 0.0, "good", [NOTE]),
        ([], 0.0, "good", []),
        ([], 0.6, "bad", []),
        ([Message("film.of_view", view="a", note=BAD), NOTE], 0.0, "bad", None),
    ],
)
def test_the_gravest_comes_first_and_counts(warnings, lost, trust, order):
    found, ranked, weights = rank_warnings(warnings, lost)
    assert found == trust
    assert order is None or ranked == order
    assert len(weights) == len(warnings)
    assert weights == sorted(weights, key=["bad", "unsure", "good"].index)


def test_every_code_that_is_weighed_exists():
    from dousa.app.studio.work import estimation as trust

    assert (trust._WRONG | trust._DOUBTFUL) - set(load_table("en")) == set()


@pytest.mark.parametrize(
    ("trust", "language", "heading"),
    [("bad", "en", "Do not trust this motion"), ("unsure", "ja", "動きが推定できました（要確認）")],
)
def test_a_wrong_result_is_not_headed_as_if_it_were_right(show, running, trust, language, heading, tmp_path):
    job = running.app.state.studio.jobs
    folder = running.app.state.studio.workspace.root / "jobs" / "0123456789abcdef"
    folder.mkdir()
    warnings = [BAD, DOUBT, NOTE] if trust == "bad" else [DOUBT, NOTE]
    result = {
        "trust": trust, "warning_weights": ["bad", "unsure", "good"][-len(warnings):],
        "warnings": [{"$message": one.to_json()} for one in warnings], "iou": {"mean": 0.52}, "lost_frames": [],
        "n_frames": 10, "frame_rate": 30.0, "stature_m": 1.7, "frames_per_second": 2.0, "files": [],
    }  # fmt: skip
    stored = {
        "id": folder.name, "kind": "estimate", "title": "kick", "request": {}, "state": "done", "what": None,
        "notes": [], "problem": None, "result": result, "version": 1, "finished_s": 1.0,
    }  # fmt: skip
    (folder / "job.json").write_text(json.dumps(stored))
    job._load()
    page = show(f"/estimate?job={folder.name}", language=language)
    page.wait("return !document.querySelector('#outcome').hidden")
    assert page.run("return document.querySelector('#outcome-title').textContent") == heading
    assert page.run("return document.querySelector('#watch-state').className") == f"badge {trust}"
    first = page.run("return document.querySelector('.says li').className")
    assert first == trust
    # The warnings stand above the figures.
    assert page.run(
        "return document.querySelector('.says').compareDocumentPosition(document.querySelector('.outcome-facts')) & 4"
    )
