"""Searching: what the interface answers, and what the page shows of it."""

import base64
import json

import numpy as np
import pytest

from dousa.formats import write_motion
from dousa.formats.motion_files import read_canonical
from dousa.motion import CANONICAL_JOINTS


def clip_of(studio, category, n=0):
    """Name of a clip of a category."""
    return f"clip:{studio.app.state.studio.library.clips(category=category)[n].id}"


def add_take(library, folder):
    """A take of three clips of the library, one after the other, in a file of that folder; its number."""
    import numpy as np

    from dousa.app.demo import write_take
    from dousa.retrieval import LabelledClip

    parts = []
    for name in ("walk", "kick_left", "squat"):
        info = library.clips(category=name)[-1]
        parts.append(
            LabelledClip(
                name, name, "x", np.array(library.trajectories(info.id).positions), info.frame_rate, info.height
            )
        )
    take = write_take(parts, (), folder / "take.bvh")
    report = library.add(take.path, kind="take")
    return library.clips([take.path])[0].id if not report.added else library.clips(list(report.added))[0].id


# --- the interface


def test_a_clip_finds_its_like(studio):
    kick = clip_of(studio, "kick_left")
    answer = studio.post("/api/search", json={"query": {"motion": kick}, "k": 5}).json()
    assert answer["category"] == "kick_left"
    assert [hit["category"] for hit in answer["results"][:4]] == ["kick_left"] * 4
    assert answer["results"][0]["motion"] == kick
    assert "places" not in answer


@pytest.mark.parametrize("text", ["kicking with the left leg", "左足で蹴る"])
def test_words_find_clips(studio, text):
    answer = studio.post("/api/search/text", json={"text": text, "k": 3}).json()
    assert [hit["category"] for hit in answer["results"]] == ["kick_left"] * 3
    assert answer["results"][0]["motion"] == f"clip:{answer['results'][0]['clip_id']}"
    assert answer["n_found"] >= 4
    nothing = studio.post("/api/search/text", json={"text": "xqzzv"}).json()
    assert (nothing["n_found"], nothing["results"], nothing["unknown_words"]) == (0, [], ["xqzzv"])


def test_words_that_cannot_be_searched_for_are_told(studio):
    for wanted in ({"text": ""}, {"text": "x" * 501}, {"text": "kick", "k": 0}, {"text": "  "}):
        answer = studio.post("/api/search/text", json=wanted)
        assert answer.status_code in (400, 422) and answer.json()["problem"]


def test_an_uploaded_file_and_a_part_of_it_are_searched_for(studio, bvh):
    came = studio.post("/api/uploads?name=new.bvh", content=bvh.read_bytes()).json()
    motion = came["files"][0]["motion"]
    whole = studio.post("/api/search", json={"query": {"motion": motion}}).json()
    assert whole["results"][0]["path"] == str(bvh)
    part = studio.post("/api/search", json={"query": {"motion": motion, "start_s": 0.4, "end_s": 1.2}}).json()
    assert part["results"]
    assert part["results"][0]["distance"] > whole["results"][0]["distance"]


def test_reasons_come_when_asked_for(studio):
    asked = {"query": {"motion": clip_of(studio, "squat")}, "explain": True, "mirror": True, "k": 3}
    answer = studio.post("/api/search", json=asked).json()
    assert answer["explanation"]["reasons"]
    assert all("likeness" in hit for hit in answer["results"])
    assert "fits_better" in answer["mirrored"]


def test_places_inside_takes_are_found(studio, tmp_path):
    take = add_take(studio.app.state.studio.library, tmp_path)
    asked = {"query": {"motion": clip_of(studio, "kick_left", 1)}, "inside_takes": True}
    place = studio.post("/api/search", json=asked).json()["places"][0]
    assert place["motion"] == f"clip:{take}"
    assert 0 < place["start_s"] < place["end_s"]


def test_without_takes_there_are_no_places(studio):
    asked = {"query": {"motion": clip_of(studio, "kick_left")}, "inside_takes": True}
    assert studio.post("/api/search", json=asked).json()["places"] == []


def test_a_take_as_a_whole_is_no_query(studio, tmp_path):
    take = add_take(studio.app.state.studio.library, tmp_path)
    answer = studio.post("/api/search", json={"query": {"motion": f"clip:{take}"}})
    assert answer.status_code == 404
    assert "is a whole take" in answer.json()["problem"]


@pytest.mark.parametrize(
    "body",
    [
        {},
        {"query": {"motion": "walk.bvh"}},
        {"query": {"motion": "clip:1"}, "k": 0},
        {"query": {"motion": "clip:1"}, "k": 10**9},
        {"query": {"motion": "clip:1"}, "ranking": "best"},
        {"query": {"motion": "clip:1"}, "threshold": 2},
        {"query": {"motion": "clip:1"}, "surprise": 1},
        {"query": {"motion": "clip:1", "start_s": 100, "end_s": 101}},
    ],
)
def test_questions_that_make_no_sense_are_refused(studio, body):
    answer = studio.post("/api/search", json=body)
    assert answer.status_code == 422
    assert answer.json()["problem"]


def test_motions_are_classified_one_by_one(studio):
    asked = {"motions": [{"motion": clip_of(studio, "walk")}, {"motion": "clip:99999"}]}
    walk, missing = studio.post("/api/classify", json=asked).json()["answers"]
    assert walk["category"] == "walk"
    assert walk["histogram"]["walk"] > 0.5
    assert missing["category"] is None
    assert "99999" in missing["problem"]


def test_an_untrained_library_says_so(tmp_path):
    from starlette.testclient import TestClient

    from dousa.app.studio import Settings, create_app

    with TestClient(create_app(Settings(tmp_path / "new.dousa", token="t")), "http://127.0.0.1:8765") as client:
        client.headers["authorization"] = "Bearer t"
        for path, body in (
            ("search", {"query": {"motion": "clip:1"}}),
            ("classify", {"motions": [{"motion": "clip:1"}]}),
        ):
            answer = client.post(f"/api/{path}", json=body)
            assert answer.status_code == 409
            assert "train" in answer.json()["problem"]


ARMS = tuple(f"{side}_{joint}" for side in ("left", "right") for joint in ("shoulder", "elbow", "wrist", "hand"))
UPPER = ("spine", "neck", "head", *ARMS)


@pytest.fixture
def legs(bvh, tmp_path):
    """A TRC file of the legs of somebody who kicks."""
    points = read_canonical(bvh)[0].to_trajectories()
    kept = [row for row, name in enumerate(points.names) if name not in UPPER]
    names, positions = [points.names[row] for row in kept], points.positions[:, kept]
    path = tmp_path / "legs.trc"
    write_motion(points.replace(names=names, positions=positions, parents=None, rest_positions=None), path)
    return path


@pytest.fixture
def uploaded(studio, legs):
    answer = studio.post("/api/uploads", params={"name": legs.name}, content=legs.read_bytes()).json()
    return answer["files"][0]["motion"]


def read(answer):
    assert answer.status_code == 200, answer.text
    return json.loads(answer.text, parse_constant=lambda name: pytest.fail(f"{name} in the answer"))


def test_legs_are_shown_without_the_rest(studio, uploaded):
    info = read(studio.get("/api/motions/info", params={"motion": uploaded}))
    assert any("part of a body" in note for note in info["notes"])
    figure = read(studio.get("/api/motions/player", params={"motion": uploaded}))["performance"]
    assert {CANONICAL_JOINTS[joint] for joint in figure["absent"]} == set(UPPER)
    assert len(base64.b64decode(figure["positions"])) == 2 * np.prod(figure["shape"])
    miniature = studio.get("/api/motions/miniature", params={"motion": uploaded})
    assert miniature.status_code == 200
    stored = np.frombuffer(miniature.content[16:], np.int8).reshape(-1, 20, 3)
    gone = [CANONICAL_JOINTS.index(joint) for joint in UPPER]
    assert (stored[:, gone] == -128).all()
    assert (np.delete(stored, gone, axis=1) > -128).all()


def test_legs_are_searched_and_paired(studio, uploaded):
    found = read(studio.post("/api/search", json={"query": {"motion": uploaded}, "k": 4, "explain": True}))
    assert found["guess"] == "kick_left"
    assert "without the head and the arms" in found["notes"][0]
    assert found["results"][0]["category"] == "kick_left"
    hit = found["results"][0]["motion"]
    pair = read(studio.get("/api/motions/pair", params={"motion": uploaded, "other": hit}))
    assert pair["reference"]["absent"] == []
    refused = studio.get("/api/motions/file", params={"motion": uploaded})
    assert refused.status_code == 422
    assert "a part of a body" in refused.text


def test_a_clip_of_legs_is_kept(studio, legs):
    library = studio.app.state.studio.library
    assert library.add(legs, category_from=None).added
    (clip,) = library.clips([legs])
    name = f"clip:{clip.id}"
    assert read(studio.get("/api/motions/player", params={"motion": name}))["performance"]["absent"]
    assert name in [
        hit["motion"] for hit in read(studio.post("/api/search", json={"query": {"motion": name}}))["results"]
    ]


def test_legs_are_judged_against_a_whole_body(studio, uploaded, bvh, wait_job):
    whole = studio.post("/api/uploads", params={"name": bvh.name}, content=bvh.read_bytes()).json()["files"][0][
        "motion"
    ]
    request = {"references": [{"motion": whole}], "performance": {"motion": uploaded}}
    job = studio.post("/api/jobs/evaluate", json=request)
    assert job.status_code == 202, job.text
    done = wait_job(studio, job.json()["id"])
    assert done["state"] == "done", done["problem"]
    result = done["result"]
    assert result["score"] is None  # less than half of what moves in the reference is seen: it cannot tell
    assert set(result["not_judged"]) == {"trunk"} | {
        f"{side}_{part}" for side in ("left", "right") for part in ("upper_arm", "forearm")
    }
    json.dumps(result, allow_nan=False)
