"""What a page asks, copied as a command and as Python, answers what the studio answers."""

import contextlib
import io
import json
import shlex

import pytest

import dousa
from app.studio.conftest import wait_for
from app.studio.evaluation_cases import upload


@pytest.fixture
def answers_of(studio, dousa, tmp_path, monkeypatch):
    """The answers of the copied command, as JSON, and of the copied Python."""

    def ask(address, request=None):
        spelled = studio.post(address, json=request) if request is not None else studio.get(address)
        assert spelled.status_code == 200, spelled.text
        said = spelled.json()
        monkeypatch.chdir(tmp_path)
        command = None
        if said["command"] is not None:
            program, *words = shlex.split(said["command"])
            assert program == "dousa"
            code, out, err = dousa(*words, "--json")
            assert code == 0, err
            command = json.loads(out)
        names: dict = {}
        with contextlib.redirect_stdout(io.StringIO()):
            exec(said["python"], names)  # what the studio wrote, of its own library
        return command, names["result"], said

    return ask


def ids(answer):
    return [(hit["clip_id"], round(hit["distance"], 4)) for hit in answer["results"]]


@pytest.mark.parametrize(
    "request_of",
    [
        lambda motion: {"query": {"motion": "clip:3"}, "k": 5},
        lambda motion: {"query": {"motion": "clip:3"}, "k": 4, "ranking": "leaves", "mirror": True, "threshold": 0.9},
        lambda motion: {"query": {"motion": "clip:3"}, "k": 4, "mirror": False, "same_category": True},
        lambda motion: {"query": {"motion": motion}, "k": 5, "explain": True},
        lambda motion: {"query": {"motion": motion, "start_s": 0.2, "end_s": 1.4}, "k": 5},
    ],
)
def test_a_search(studio, answers_of, bvh, request_of):
    request = request_of(upload(studio, bvh)[0]["motion"])
    answer = studio.post("/api/search", json=request).json()
    command, python, _ = answers_of("/api/spelling/search", request)
    assert ids(command) == ids(answer) == ids(python.to_json())
    assert command["category"] == python.to_json()["category"] == answer["category"]


def test_words(studio, answers_of):
    request = {"text": "kick; 'with' $HOME", "k": 5, "category": "kick*"}
    answer = studio.post("/api/search/text", json=request).json()
    command, python, _ = answers_of("/api/spelling/search/text", request)
    found = [hit["clip_id"] for hit in answer["results"]]
    assert (
        found
        == [hit["clip_id"] for hit in command["results"]]
        == [hit["clip_id"] for hit in python.to_json()["results"]]
    )
    command, python, said = answers_of("/api/spelling/search/text", {**request, "kind": "clip"})
    assert command is None and "kind" in said["note"]
    assert [hit["clip_id"] for hit in python.to_json()["results"]] == found


def test_labels(studio, answers_of, bvh):
    take = upload(studio, bvh)[0]
    request = {"take": {"motion": take["motion"]}, "threshold": 0.2}
    job = wait_for(studio, studio.post("/api/jobs/label", json=request).json()["id"])
    command, python, _ = answers_of("/api/spelling/label", request)

    def named(answer):
        return [(one["start_s"], one["end_s"], one["category"]) for one in answer["segments"]]

    assert named(job["result"]) == named(command) == named(python.to_json())


def test_an_export(studio, answers_of, tmp_path):
    import zipfile

    request = {"clips": [1, 2, 3], "to": "bvh", "onto": "clip:4", "frame_rate": 20}
    job = wait_for(studio, studio.post("/api/jobs/export", json=request).json()["id"])
    content = studio.get(f"/api/exports/{job['id']}").content
    (tmp_path / "studio.zip").write_bytes(content)
    command, python, _ = answers_of("/api/spelling/export", request)
    names = [set(zipfile.ZipFile(tmp_path / name).namelist()) for name in ("studio.zip", "export.zip")]
    assert names[0] == names[1]
    # The Python finds what the command has written, and keeps it.
    assert len(command["written"]) == len(python.kept) + len(python.written) == 3


def test_an_evaluation_of_clips_is_of_what_the_library_holds(studio, answers_of, bvh, tmp_path):
    motion = dousa.read_motion(bvh)
    own = tmp_path / "own.bvh"
    dousa.write_motion(motion.replace(rotations=motion.rotations[3:], translations=motion.translations[3:]), own)
    studio.app.state.studio.library.add([own], category_from="none")
    clip = studio.get("/api/clips", params={"text": "own"}).json()["items"][0]["motion"]
    request = {"references": [{"motion": "clip:1"}], "performance": {"motion": clip}, "side": "same"}
    job = wait_for(studio, studio.post("/api/jobs/evaluate", json=request).json()["id"])
    own.write_bytes(next(bvh.parents[1].glob("walk/*.bvh")).read_bytes())  # edited meanwhile
    command, python, _ = answers_of(f"/api/spelling/evaluations/{job['id']}")
    assert command["score"] == pytest.approx(job["result"]["score"], abs=0.06)
    assert python.score == pytest.approx(job["result"]["score"], abs=0.06)


def test_an_evaluation_with_its_figures_and_weights(studio, answers_of, trained_library):
    files = sorted((trained_library.parent / "motions" / "kick_left").glob("*.bvh"))[:3]
    first, second, third = upload(studio, *files)
    request = {"references": [first, second], "performance": third, "side": "same", "tempo": "free"}
    job = wait_for(studio, studio.post("/api/jobs/evaluate", json=request).json()["id"])
    address = f"/api/spelling/evaluations/{job['id']}"
    command, python, _ = answers_of(address)
    assert command["score"] == pytest.approx(job["result"]["score"], abs=0.06)
    assert python.score == pytest.approx(job["result"]["score"], abs=0.06)
    adjustment = {"weights": {"arms": 0.0, "left_shank": 3.0}, "furi": [{"start_s": 0, "end_s": 0.5, "label": "a"}]}
    adjusted = studio.post(f"/api/evaluations/{job['id']}/adjust", json=adjustment).json()["assessment"]
    command, python, said = answers_of(address)
    assert "--weights" in said["command"] and "--furi" in said["command"]
    assert command["score"] == pytest.approx(adjusted["score"], abs=0.06)
    assert python.score == pytest.approx(adjusted["score"], abs=0.06)
    assert [one["label"] for one in command["furi"]] == ["a"]
