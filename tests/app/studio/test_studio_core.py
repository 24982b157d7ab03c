"""Who may come in, what is kept of uploads, how jobs go."""

from __future__ import annotations

import pytest


def test_the_library_is_described(studio):
    answer = studio.get("/api/info")
    assert answer.status_code == 200
    assert answer.json()["library"]["n_clips"] == 24


@pytest.mark.parametrize("path", ["/api/info", "/library", "/static/x/studio.css", "/api/openapi.json"])
def test_nothing_without_the_token(studio, path):
    del studio.headers["authorization"]
    answer = studio.get(path)
    assert answer.status_code == 401
    assert "24" not in answer.text


def test_the_token_of_the_address_becomes_a_cookie(studio):
    del studio.headers["authorization"]
    answer = studio.get("/library?token=the-token-of-the-tests&lang=ja", follow_redirects=False)
    assert answer.status_code == 303
    assert answer.headers["location"] == "/library?lang=ja"
    assert "HttpOnly" in answer.headers["set-cookie"]
    assert studio.get("/library").status_code == 200


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({"host": "evil.example:8765"}, 421),
        ({"host": "127.0.0.1:9999"}, 421),
        ({"origin": "http://evil.example"}, 403),
        ({"origin": "null"}, 403),
        ({"sec-fetch-site": "cross-site"}, 403),
        ({"sec-fetch-site": "same-site"}, 403),
        ({"origin": "http://127.0.0.1:8765", "sec-fetch-site": "same-origin"}, 200),
    ],
)
def test_other_pages_and_names_are_refused(studio, headers, status):
    assert studio.get("/api/info", headers=headers).status_code == status


def test_an_uploaded_motion_is_added_and_the_answer_says_so(studio, bvh, wait_job):
    batch = studio.post("/api/uploads?name=hop/new.bvh", content=bvh.read_bytes() + b"\n").json()["batch"]
    job = studio.post("/api/jobs/add", json={"batch": batch}).json()
    job = wait_job(studio, job["id"])
    assert job["state"] == "done", job
    assert job["result"]["added"] == ["hop/new.bvh"]
    assert studio.get("/api/info").json()["library"]["categories"]["hop"] == 1


def test_a_job_can_be_stopped_before_its_turn(studio, wait_job):
    first = studio.post("/api/jobs/train", json={}).json()
    second = studio.post("/api/jobs/train", json={}).json()
    assert studio.post(f"/api/jobs/{second['id']}/stop").json()["state"] == "stopped"
    assert studio.post(f"/api/jobs/{first['id']}/stop").json()["state"] in ("stopping", "stopped")
    assert wait_job(studio, first["id"])["state"] == "stopped"
