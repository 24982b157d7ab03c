"""The live interface: pictures in, keypoints, labels and grades out; with recorded keypoints in the network's place."""

import numpy as np
import pytest

from app.studio.live_people import record_landmarks, replay
from dousa.app.studio.content import live
from dousa.errors import KeypointError
from dousa.estimation.keypoints.people import SIGHTING
from patience import PATIENCE

cv2 = pytest.importorskip("cv2", reason="OpenCV is not installed: pip install 'dousa[film]'")
RATE = 15.0


@pytest.fixture(scope="module")
def kick():
    return record_landmarks("kick_left", 3, RATE)


@pytest.fixture
def watched(studio, monkeypatch, kick):
    monkeypatch.setattr(live, "choose_model", lambda: "full")
    monkeypatch.setattr(live, "open_finder", replay(kick))
    return studio


@pytest.fixture(scope="module")
def picture():
    return cv2.imencode(".jpg", np.full((120, 160, 3), 90, np.uint8))[1].tobytes()


def show(studio, session, picture, seconds):
    return studio.post(f"/api/live/{session}/picture?seconds={seconds}", content=picture)


def begin(studio, **wanted):
    answer = studio.post("/api/live", json=wanted)
    assert answer.status_code == 201, answer.text
    return answer.json()["id"]


@pytest.mark.parametrize("category", ["walk", "jump"])
def test_landmarks_of_a_camera_become_the_joints_of_the_motion_at_its_place_in_the_picture(category):
    across = record_landmarks(category, 3, RATE)[..., [2, 1, 0]] * (1.0, 1.0, -1.0)  # turned: it walks across
    find = replay(across)()
    joints = np.stack([live.to_canonical(find(np.zeros((240, 320, 3), np.uint8)), (320, 240)) for _ in across])
    seen = across[:, [25, 26]]
    assert joints[:, [13, 17]] - joints[:, :1] == pytest.approx(seen - across[:, [23, 24]].mean(1)[:, None], abs=0.12)
    went, moved = (np.ptp(some.mean(axis=1), axis=0) for some in (across[:, [23, 24]], joints[:, [12, 16]]))
    assert moved[:2] == pytest.approx(went[:2], abs=0.02)
    assert went.max() > 0.3


def test_what_is_missing_is_said_with_what_to_run(studio, monkeypatch, tmp_path):
    monkeypatch.setenv("DOUSA_MODELS", str(tmp_path))
    said = studio.get("/api/live").json()
    assert "dousa keypoints --install" in said["problem"] or "pip install" in said["problem"]
    answer = studio.post("/api/live", json={})
    assert answer.status_code == 409
    assert answer.json()["problem"] == said["problem"]


def test_a_picture_gives_a_person_and_what_each_step_took(watched, picture):
    session = begin(watched)
    answer = show(watched, session, picture, 0.0).json()
    assert np.shape(answer["person"]["points"]) == (33, 2)
    assert np.array(answer["person"]["points"])[:, 1].max() <= 1.0
    assert answer["grade"] is None
    assert set(answer["ms"]) == {"keypoints", "judging"}


@pytest.mark.parametrize("category", ["kick_left", "squat", "walk", "wave_right"])
def test_who_does_what_the_library_knows_gets_its_label(watched, picture, monkeypatch, category):
    landmarks = record_landmarks(category, 3, RATE)
    monkeypatch.setattr(live, "open_finder", replay(landmarks))
    session = begin(watched)
    watched.app.state.studio.live.get(session)._learning.join(timeout=PATIENCE)
    labels = []
    for frame in range(4 * len(landmarks)):
        label = show(watched, session, picture, frame / RATE).json()["label"]
        assert label["state"] == "ready"
        labels += [label["category"], *(one["category"] for one in label["settled"])]
    assert category in labels
    assert {label for label in labels if label} == {category}


def test_who_repeats_the_reference_is_graded_better_than_who_does_something_else(
    watched, picture, kick, monkeypatch, tmp_path
):
    scores = {}
    for name, landmarks in (("kick_left", kick), ("squat", record_landmarks("squat", 3, RATE))):
        monkeypatch.setattr(live, "open_finder", replay(landmarks))
        monkeypatch.setitem(live.LiveSession.__init__.__kwdefaults__, "grade_every", 0.0)
        clip = watched.get("/api/clips?category=kick_left").json()["items"][0]["id"]
        session = begin(watched, references=[{"motion": f"clip:{clip}"}])
        for frame in range(60):
            grade = show(watched, session, picture, frame / RATE).json()["grade"]
        assert grade["seconds"] == pytest.approx(60 / RATE, abs=0.1)
        scores[name] = grade["score"]
    assert scores["kick_left"] is not None
    assert scores["kick_left"] > (scores["squat"] or 0.0)


@pytest.mark.parametrize(
    "content", [b"", b"no picture", b"\xff\xd8\xff\xc0\x00\x11\x08\xff\xff\xff\xff\x03", b"\xff\xd8"]
)
def test_what_is_no_picture_is_refused(watched, content):
    answer = show(watched, begin(watched), content, 0.0)
    assert answer.status_code == 422
    assert "JPEG" in answer.json()["problem"]


def test_a_new_session_ends_the_one_before_and_a_stopped_one_is_over(watched, picture):
    first, second = begin(watched), begin(watched)
    assert show(watched, first, picture, 0.0).status_code == 404
    assert show(watched, second, picture, 0.0).status_code == 200
    assert watched.delete(f"/api/live/{second}").status_code == 200
    assert show(watched, second, picture, 1.0).status_code == 404


def test_without_a_model_that_is_installed_none_is_chosen(monkeypatch, tmp_path):
    pytest.importorskip("ai_edge_litert", reason="LiteRT is not installed: pip install 'dousa[film]'")
    monkeypatch.setenv("DOUSA_MODELS", str(tmp_path))
    with pytest.raises(KeypointError):
        live.choose_model()


def sighting(stretch, x, size):
    row = np.zeros(1, SIGHTING)
    row["stretch"], row["crop"] = stretch, (x, 100.0, size, 0.0)
    return row


def test_who_is_followed_stays_so_though_another_is_nearer_or_larger():
    left, right = sighting(0, 100.0, 80.0), sighting(1, 300.0, 120.0)
    first = live.choose_person(np.concatenate([left, right]), None)
    assert first["stretch"] == 1  # who looks largest
    passing = np.concatenate([sighting(2, 290.0, 200.0), sighting(1, 340.0, 110.0)])
    assert live.choose_person(passing, first)["stretch"] == 1
    found_again = np.concatenate([sighting(3, 310.0, 120.0), left])
    assert live.choose_person(found_again, first)["stretch"] == 3
    assert live.choose_person(left, first, {0}) is None  # who was seen beside that person is another


@pytest.mark.parametrize(("seconds", "models"), [(0.0, ["full"]), (0.2, ["full", "lite"])])
def test_a_model_that_does_not_keep_up_gives_way_to_the_quickest(monkeypatch, seconds, models):
    clock, opened = [0.0], []

    class Follower:
        def __init__(self, detector, landmarks, most):
            opened.append(landmarks)

        def see(self, frame, picture):
            clock[0] += seconds if len(opened) == 1 else 0.01
            return sighting(0, 100.0, 80.0)

    monkeypatch.setattr(live, "choose_model", lambda: "full")
    monkeypatch.setattr(live.time, "perf_counter", lambda: clock[0])
    monkeypatch.setattr("dousa.estimation.keypoints.people.PeopleFollower", Follower)
    monkeypatch.setattr("dousa.estimation.keypoints.pose_networks.PersonDetector", lambda threads: None)
    monkeypatch.setattr("dousa.estimation.keypoints.pose_networks.LandmarkNetwork", lambda model, threads: model)
    monkeypatch.setattr("dousa.estimation.keypoints.pose_models.check_pose_model", lambda model: "installed")
    find = live.open_finder()
    for _ in range(40):
        assert find(np.zeros((4, 4, 3), np.uint8)) is not None
    assert opened == models


def test_who_passes_in_front_is_not_followed_and_a_new_follower_counts_anew(monkeypatch):
    one, other = sighting(0, 100.0, 120.0), sighting(1, 300.0, 80.0)
    swapped = np.concatenate([sighting(0, 300.0, 80.0), sighting(1, 100.0, 120.0)])
    pictures = [np.concatenate([one, other]), other, np.concatenate([sighting(2, 110.0, 120.0), other]), swapped]

    class Follower:
        def __init__(self, *given):
            pass

        def see(self, frame, picture):
            return pictures.pop(0)

    monkeypatch.setattr(live, "choose_model", lambda: "full")
    monkeypatch.setattr("dousa.estimation.keypoints.people.PeopleFollower", Follower)
    monkeypatch.setattr("dousa.estimation.keypoints.pose_networks.PersonDetector", lambda threads: None)
    monkeypatch.setattr("dousa.estimation.keypoints.pose_networks.LandmarkNetwork", lambda model, threads: model)
    monkeypatch.setattr("dousa.estimation.keypoints.pose_models.check_pose_model", lambda model: "installed")
    find = live.PersonFinder(rate=1e9, looks=3)
    nothing, followed = np.zeros((4, 4, 3), np.uint8), []
    while pictures:
        followed.append(None if find(nothing) is None else float(find._last["crop"][0]))
    assert followed == [100.0, None, 110.0, 100.0]
