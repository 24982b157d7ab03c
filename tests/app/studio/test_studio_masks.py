"""Repairing silhouettes over the interface: of films with their pictures, undo and redo, what is refused."""

import json

import numpy as np
import pytest

from app.studio.conftest import ask_directly, wait_for
from app.studio.estimating_scenes import write_films, write_scene
from dousa.estimation import read_cameras, read_silhouettes

pytestmark = pytest.mark.plain_workers
N_FRAMES = 8
THING, AT = (slice(97, 109), slice(70, 125)), 5  # a shadow below the feet, in one frame
ERASE = {"view": 0, "frame": AT, "action": "remove", "points": [[70, 104], [125, 104]], "radius": 5}


@pytest.fixture(scope="module")
def client(tmp_path_factory):
    """A studio for all tests of this module, on an empty library."""
    yield from ask_directly(tmp_path_factory.mktemp("masks") / "moves.dousa")


@pytest.fixture(scope="module")
def batch(client, tmp_path_factory) -> str:
    """Two films, their empty rooms and a calibration, uploaded."""
    folder = tmp_path_factory.mktemp("films")
    name = ""
    for path in write_films(write_scene(folder / "seen.npz", N_FRAMES), folder, (*THING, AT)):
        asked = f"/api/uploads?name={path.name}" + (f"&batch={name}" if name else "")
        answer = client.post(asked, content=path.read_bytes())
        assert answer.status_code == 201, answer.text
        name = answer.json()["batch"]
    return name


@pytest.fixture(scope="module")
def prepared(client, batch) -> str:
    """The job with the silhouettes of these films."""
    answer = client.post("/api/jobs/masks", json={"batch": batch, "cues": "silhouettes"})
    assert answer.status_code == 202, answer.text
    job = wait_for(client, answer.json()["id"])
    assert job["state"] == "done", job["problem"]
    assert job["result"]["n_frames"] == N_FRAMES
    return job["id"]


@pytest.fixture
def masks(client, prepared):
    """``masks(method, path, json)`` of this job; what was repaired is undone afterwards."""

    def ask(path="", json=None):
        address = f"/api/masks/{prepared}{path}"
        return client.get(address) if json is None else client.post(address, json=json)

    yield ask
    while ask("/undo", {}).status_code == 200:
        pass


def decode(content: bytes, grey: bool = True) -> np.ndarray:
    from dousa.extras import cv2

    flag = cv2.IMREAD_GRAYSCALE if grey else cv2.IMREAD_COLOR
    return np.asarray(cv2.imdecode(np.frombuffer(content, np.uint8), flag))


def test_films_are_written_down_with_their_pictures_and_what_looks_doubtful(masks):
    state = masks().json()
    assert [(view["width"], view["height"], view["pictures"]) for view in state["views"]] == [(160, 120, True)] * 2
    assert state["n_frames"] == N_FRAMES and state["cameras"] and state["done"] == 0
    assert state["doubts"] == [[[AT, "size"]], []]
    mask = decode(masks(f"/mask/0/{AT}").content) > 127
    assert mask.shape == (120, 160) and mask[THING].mean() > 0.9
    picture = decode(masks(f"/picture/0/{AT}").content, grey=False)
    assert picture.shape == (120, 160, 3) and np.abs(picture[104, 115].astype(int) - (40, 60, 30)).max() < 25


def test_what_is_erased_is_no_doubt_any_more_undone_and_done_again(masks, client, prepared, tmp_path):
    state = masks("/repairs", ERASE).json()
    assert state["done"] == 1 and state["changed"] == {"view": 0, "frame": AT, "count": 1}
    assert state["doubts"] == [[], []] and state["repaired"] == [[AT], []]
    assert (decode(masks(f"/mask/0/{AT}").content) > 127)[THING].mean() < 0.2

    state = masks("/undo", {}).json()
    assert state["done"] == 0 and state["undone"] == 1 and state["doubts"][0] == [[AT, "size"]]
    assert masks("/redo", {}).json()["done"] == 1
    folder = client.app.state.studio.settings.folder / "jobs" / prepared
    assert len(json.loads((folder / "repairs.json").read_text())["done"]) == 1  # kept on the disk

    (tmp_path / "masks.npz").write_bytes(masks("/masks.npz").content)
    assert read_silhouettes(tmp_path / "masks.npz").read(AT)[0][THING].mean() < 0.2
    assert len(read_cameras(tmp_path / "masks.npz")) == 2
    masks("/undo", {})
    (tmp_path / "masks.npz").write_bytes(masks("/masks.npz").content)
    assert read_silhouettes(tmp_path / "masks.npz").read(AT)[0][THING].mean() > 0.9


def test_a_part_is_followed_through_the_film(masks):
    state = masks("/repairs", {"view": 1, "frame": 2, "action": "exclude_through", "points": [[80, 50]]}).json()
    assert state["changed"] == {"view": 1, "frame": 0, "count": N_FRAMES}
    assert not decode(masks("/mask/1/7").content).any()


@pytest.mark.slow
def test_an_estimation_of_repaired_silhouettes_shows_the_films_behind_them(masks, client, batch, prepared):
    masks("/repairs", ERASE)
    wanted = {"batch": batch, "cues": "silhouettes", "masks": prepared, "overlay_video": False, "beam": 2}
    answer = client.post("/api/jobs/estimate", json={**wanted, "body": {"stature_m": 1.7}})
    job = wait_for(client, answer.json()["id"], 240)
    assert job["state"] == "done", job["problem"]
    assert "masks.npz" in job["result"]["files"] and job["result"]["n_frames"] == N_FRAMES
    shown = decode(client.get(f"/api/estimations/{job['id']}/overlay/0/{AT}").content, grey=False)
    scale = shown.shape[1] / 160
    there = shown[round(104 * scale), round(115 * scale)].astype(int)
    assert there.mean() < 0.75 * shown[round(114 * scale), round(115 * scale)].mean()  # the shadow in the film, still


@pytest.mark.parametrize(
    ("path", "wanted", "status"),
    [
        ("/repairs", {"view": 0, "frame": 0, "action": "exclude", "points": [[150, 1]]}, 422),
        ("/repairs", {"view": 7, "frame": 0, "action": "add", "points": [[1, 1]]}, 422),
        ("/repairs", {"view": 0, "frame": 99, "action": "add", "points": [[1, 1]]}, 422),
        ("/repairs", {"view": 0, "frame": 0, "action": "add", "points": []}, 422),
        ("/repairs", {"view": 0, "frame": 0, "action": "add", "points": [[1]]}, 422),
        ("/repairs", {"view": 0, "frame": 0, "action": "burn", "points": [[1, 1]]}, 422),
        ("/repairs", {"view": 0, "frame": 0, "action": "add", "points": [[1, 1]], "radius": 0}, 422),
        ("/undo", {}, 409),
        ("/redo", {}, 409),
        ("/mask/0/99", None, 422),
        ("/mask/9/0", None, 422),
        ("/picture/0/99", None, 404),
    ],
)
def test_what_cannot_be_is_refused_in_one_sentence(masks, path, wanted, status):
    masks("/repairs", {"view": 0, "frame": 0, "action": "add", "points": [[1, 1]]})
    masks("/undo", {})
    if path == "/redo":
        masks("/redo", {})
    answer = masks(path, wanted)
    assert answer.status_code == status, answer.text
    assert answer.json()["problem"] and "Traceback" not in answer.text
    assert masks().json()["done"] == (1 if path == "/redo" else 0)


def test_no_silhouettes_of_other_jobs(client, batch):
    assert client.get("/api/masks/0123456789abcdef").status_code == 404
    wanted = {"batch": batch, "masks": "0123456789abcdef"}
    assert client.post("/api/jobs/estimate", json=wanted).status_code == 404
