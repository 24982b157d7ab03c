"""Bodies that lack joints over HTTP: shown, searched, added and judged; no number is NaN and nothing fails."""

from __future__ import annotations

import base64
import json

import numpy as np
import pytest

from dousa.formats import write_motion
from dousa.formats.motion_files import read_canonical
from dousa.motion import CANONICAL_JOINTS

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
    refused = studio.get("/api/motions/bvh", params={"motion": uploaded})
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
    assert result["score"] > 85
    assert set(result["not_judged"]) == {"trunk"} | {
        f"{side}_{part}" for side in ("left", "right") for part in ("upper_arm", "forearm")
    }
    json.dumps(result, allow_nan=False)
