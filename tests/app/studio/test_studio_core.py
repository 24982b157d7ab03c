"""Who may come in, what is kept of uploads, how jobs go."""

import contextlib
import html
import json
import math
import os
import re
import time
import warnings
from importlib import resources

import numpy as np
import pytest
from starlette.testclient import TestClient

from dousa.app.studio import Settings, create_app
from dousa.app.studio.core.answers import Answer, to_answer
from dousa.errors import OptionError
from dousa.messages import Message

TOKEN = "the-token-of-the-tests"


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


@pytest.mark.plain_workers
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


@pytest.mark.parametrize(
    ("language", "said"),
    [
        ("en-GB,en;q=0.8", "is not in the library any more"),
        ("ja,en;q=0.5", "はもうライブラリーにありません"),
        ("fr", "not in"),
    ],
)
def test_problems_are_in_the_language_of_the_request(studio, language, said):
    answer = studio.get("/api/motions/info?motion=clip:999", headers={"accept-language": language})
    assert answer.status_code == 404 and said in answer.json()["problem"]
    assert answer.json()["code"] == "library_clips.no_clip" and answer.json()["values"]["number"] == 999


def test_a_job_speaks_the_language_of_whoever_asks(studio, wait_job):
    studio.app.state.studio.library.remove([clip.id for clip in studio.app.state.studio.library.clips()])
    job = wait_job(studio, studio.post("/api/jobs/train", json={}).json()["id"])
    assert job["state"] == "failed" and job["codes"]["problem"]["code"].startswith("library_training.")
    japanese = studio.get(f"/api/jobs/{job['id']}", headers={"accept-language": "ja"}).json()
    assert "カテゴリー" in japanese["problem"] and japanese["codes"] == job["codes"]


def test_what_was_not_added_is_said_in_the_language_of_whoever_asks(studio, bvh, wait_job):
    whole = bvh.read_text()
    damaged = whole[: whole.index("\n", whole.index("Frame Time"))].encode()  # no frame follows
    batch = studio.post("/api/uploads?name=kick/short.bvh", content=damaged).json()["batch"]
    job = wait_job(studio, studio.post("/api/jobs/add", json={"batch": batch}).json()["id"])
    for language, said in (("en", "is it truncated or edited?"), ("ja", "フレーム")):
        answer = studio.get(f"/api/jobs/{job['id']}", headers={"accept-language": language}).json()
        (skipped,) = answer["result"]["skipped"]
        assert skipped["path"] == "kick/short.bvh" and said in skipped["reason"]


def test_words_of_the_pages_are_pairs_that_name_the_same():
    for file in resources.files("dousa.app.studio").joinpath("words").iterdir():
        for name, (english, japanese) in json.loads(file.read_text(encoding="utf-8")).items():
            assert bool(english) == bool(japanese), f"{file.name}: {name}"
            assert sorted(re.findall(r"\{\w+\}", english)) == sorted(re.findall(r"\{\w+\}", japanese)), name
            for counted in re.findall(r"\{(\w+):[^{}|]+\|[^{}]+\}", english):  # {count:clip|clips}
                assert f"{{{counted}}}" in english, name


def test_pages_load_only_what_there_is(studio):
    for page in ("library", "search", "takes", "evaluate", "estimate", "api"):
        asked = set(re.findall(r'(?:src|href)="(/static/[^"]+)"', studio.get(f"/{page}").text))
        assert asked and [path for path in asked if studio.get(path).status_code != 200] == []


# --- codes and the token


def test_a_code_opens_once_and_is_not_the_token(studio):
    code = studio.post("/code").json()["code"]
    del studio.headers["authorization"]
    answer = studio.get(f"/library?code={code}&lang=ja", follow_redirects=False)
    assert (answer.status_code, answer.headers["location"]) == (303, "/library?lang=ja")
    assert studio.get("/library").status_code == 200
    assert studio.get(f"/library?code={code}", follow_redirects=False).status_code == 303  # who is in goes on
    studio.cookies.clear()
    again = studio.get(f"/library?code={code}", follow_redirects=False)
    assert again.status_code == 401 and "set-cookie" not in again.headers
    assert 'name="token"' in again.text


def test_codes_are_for_those_who_have_the_token(studio):
    del studio.headers["authorization"]
    assert studio.post("/code").status_code == 401
    assert studio.get("/library?code=", follow_redirects=False).status_code == 401


def test_the_field_leads_to_the_page_that_was_asked_for(studio):
    del studio.headers["authorization"]
    page = studio.get("/takes?motion=take%3A3&token=guess")
    assert page.status_code == 401
    action = html.unescape(re.search(r'action="([^"]+)"', page.text)[1])
    rest = dict(re.findall(r'type="hidden" name="([^"]+)" value="([^"]*)"', page.text))
    answer = studio.get(action, params={**rest, "token": f" {TOKEN} "}, follow_redirects=False)
    assert (answer.status_code, answer.headers["location"]) == (303, "/takes?motion=take%3A3")
    assert studio.get("/library").status_code == 200


@pytest.mark.parametrize("place", ["//evil.example/x", "/\\evil.example/x", "/%09//evil.example/x"])
def test_the_field_leads_to_no_other_machine(studio, place):
    del studio.headers["authorization"]
    for token in ("guess", TOKEN):
        answer = studio.get(f"http://127.0.0.1:8765{place}", params={"token": token}, follow_redirects=False)
        found = re.search(r'action="([^"]+)"', answer.text)
        assert re.match(r"/[^/\\]", found[1] if found else answer.headers["location"])


def test_browsers_are_sent_to_the_name_of_this_studio_alone(library_copy):
    from starlette.testclient import TestClient

    from dousa.app.studio import Settings, create_app

    app = create_app(Settings(library_copy, token=TOKEN), uses_alias=True)
    with TestClient(app, "http://127.0.0.1:8765") as client:
        code = client.app.state.codes.issue()
        first = client.get(f"/library?code={code}", follow_redirects=False)
        place = first.headers["location"]
        assert re.fullmatch(r"http://dousa-[0-9a-f]{16}\.localhost:8765/library\?code=\S+", place)
        assert code not in place and "set-cookie" not in first.headers
        second = client.get(place, follow_redirects=False)
        assert second.headers["location"] == "/library" and TOKEN in second.headers["set-cookie"]
    host = (library_copy.with_suffix(".studio") / "host").read_text()
    assert f"http://{host}:8765" in place


def test_what_the_studio_makes_is_for_its_user_alone(tmp_path):
    from dousa.app.studio import Settings
    from dousa.app.studio.content.studio import Studio

    studio = Studio(Settings(tmp_path / "new.dousa", token="x"), lambda _: {})
    studio.held.announce("http://127.0.0.1:1", "x", tmp_path / "new.dousa")
    home = tmp_path / "new.studio"
    assert home.stat().st_mode & 0o777 == 0o700
    for path in (tmp_path / "new.dousa", home / "studio.json", home / "studio.lock"):
        assert path.stat().st_mode & 0o777 == 0o600, path
    studio.close()


@pytest.mark.parametrize("name", ["con.bvh", "kick/Aux.bvh", "LPT1.bvh", "walk\u202ehvb.exe.bvh", "a\u2066b.bvh"])
def test_names_that_mislead_or_cannot_be_stored_everywhere_are_refused(studio, bvh, name):
    answer = studio.post("/api/uploads", params={"name": name}, content=bvh.read_bytes())
    assert answer.status_code == 422
    assert answer.json()["code"] in ("studio_files.device", "studio_files.bad_character")


def test_searches_beyond_the_gate_are_sent_away(studio):
    with contextlib.ExitStack() as stack:
        gate = studio.app.state.studio.searching
        while gate._known.acquire(blocking=False):
            stack.callback(gate._known.release)
        for path, asked in (("", {"query": {"motion": "clip:1"}}), ("/text", {"text": "kick"})):
            assert studio.post(f"/api/search{path}", json=asked).status_code == 429
        assert studio.post("/api/classify", json={"motions": [{"motion": "clip:1"}]}).status_code == 429
    assert studio.post("/api/search", json={"query": {"motion": "clip:1"}}).status_code == 200


@pytest.mark.parametrize(
    ("path", "asked", "field", "said"),
    [
        ("/api/clips/relabel", {"clips": [1], "category": " "}, "category", "one line of text"),
        ("/api/jobs/add", {"batch": "x"}, "batch", "16 digits"),
        ("/api/search", {"query": {"motion": "squat"}}, "query.motion", "clip:NUMBER"),
        ("/api/jobs/export", {"clips": [1], "onto": "hero"}, "onto", "file:BATCH/NAME"),
        ("/api/jobs/estimate", {"batch": "0" * 16, "frames": "all"}, "frames", "FIRST:LAST"),
        ("/api/clips/remove", {"clips": "all"}, "clips", "expected a list"),
        ("/api/search", {"query": 3}, "query", "expected an object"),
    ],
)
def test_a_field_that_is_wrong_is_explained_without_expressions(studio, path, asked, field, said):
    for language in ("en", "ja"):
        answer = studio.post(path, json=asked, headers={"accept-language": language})
        assert answer.status_code == 422
        problem = answer.json()["problem"]
        assert problem.startswith(f"{field}: ")
        assert not re.search(r"[\^$\[\]{}\\]|should|pattern|valid", problem), problem
        assert said in problem or language == "ja"


# --- the disk


def test_space_is_shown_and_given_back(studio, bvh, wait_job):
    used = studio.post("/api/uploads?name=hop/a.bvh", content=bvh.read_bytes() + b"\n").json()["batch"]
    wait_job(studio, studio.post("/api/jobs/add", json={"batch": used}).json()["id"])
    fresh, old = (studio.post(f"/api/uploads?name={n}.bvh", content=bvh.read_bytes()).json()["batch"] for n in "bc")
    export = wait_job(studio, studio.post("/api/jobs/export", json={"clips": [1]}).json()["id"])
    home = studio.app.state.studio.workspace.root
    for batch in (used, old):
        os.utime(home / "files" / batch, (1, 1))
    space = studio.get("/api/space").json()
    assert space["can_be_freed_bytes"] > len(bvh.read_bytes())
    assert space["uploads_bytes"] > 3 * len(bvh.read_bytes()) and space["disk_free_bytes"] > 0
    freed = studio.post("/api/space/free").json()
    assert freed["freed_bytes"] == space["can_be_freed_bytes"] and freed["can_be_freed_bytes"] == 0
    assert {used, fresh} <= {path.name for path in (home / "files").iterdir()}
    assert not (home / "files" / old).exists()
    assert studio.get(f"/api/jobs/{export['id']}").status_code == 404


def test_uploads_of_forgotten_jobs_have_an_end_after_thirty_days(studio, bvh, wait_job):
    """Only those that no job, no clip and no undo lives from; how old they are is told."""
    home = studio.app.state.studio.workspace.root / "files"
    motions, batches = [], {}
    for name in ("forgotten", "asked", "young", "clip"):
        answer = studio.post(
            f"/api/uploads?name=hop/{name}.bvh", content=bvh.read_bytes() + b"\n" * len(motions)
        ).json()
        motions.append(answer["files"][0]["motion"])
        batches[name] = answer["batch"]
    for motion in motions[:3]:
        wanted = {"references": [{"motion": "clip:1"}], "performance": {"motion": motion}}
        job = wait_job(studio, studio.post("/api/jobs/evaluate", json=wanted).json()["id"])
        if motion != motions[1]:
            assert studio.delete(f"/api/jobs/{job['id']}").status_code == 200
    wait_job(studio, studio.post("/api/jobs/add", json={"batch": batches["clip"]}).json()["id"])
    (home / batches["clip"] / ".kept").write_text("")
    old = time.time() - 40 * 86_400
    for name in ("forgotten", "asked", "clip"):
        for path in (home / batches[name] / ".kept", home / batches[name]):
            os.utime(path, (old, old))
    space = studio.get("/api/space").json()
    assert space["old_bytes"] >= len(bvh.read_bytes()) and space["oldest_days"] == 40
    assert studio.post("/api/space/free").json()["old_bytes"] == space["old_bytes"]
    assert studio.post("/api/space/free?older_days=41").json()["freed_bytes"] == 0
    assert studio.post("/api/space/free?older_days=30").json()["freed_bytes"] == space["old_bytes"]
    assert {path.name for path in home.iterdir() if path.is_dir()} == set(batches.values()) - {batches["forgotten"]}
    assert studio.get("/api/space").json()["oldest_days"] == 0
    assert studio.post("/api/space/free?older_days=0").status_code == 422


@pytest.mark.parametrize(("language", "words"), [("en", "No such page"), ("ja", "このページはありません")])
def test_an_unknown_address_is_a_page_with_a_way_home_and_json_for_programs(studio, language, words):
    page = studio.get("/no/such<b>", params={"lang": language})
    assert page.status_code == 404 and page.headers["content-type"].startswith("text/html")
    assert words in page.text and 'href="/library"' in page.text and "<b>" not in page.text.split("<main", 1)[1]
    told = studio.get("/api/no-such-thing")
    assert told.status_code == 404 and told.json()["code"] == "studio.no_address"
    assert studio.get("/static/x/no.js").json()["code"] == "studio.no_static"
    assert studio.post("/no-such-page").json()["code"] == "studio.no_address"


def test_the_first_request_makes_no_address(studio, monkeypatch):
    """Filters of warnings belong to the whole process: what threads of jobs do to them must not reach a request."""
    monkeypatch.setattr(warnings, "simplefilter", lambda *_, **__: None)
    assert studio.get("/api/jobs/0123456789abcdef").status_code == 404


def test_a_fault_of_ours_is_answered_in_words_and_shown_in_the_terminal(library_copy, monkeypatch):
    app = create_app(Settings(library_copy, token=TOKEN))
    monkeypatch.setattr(app.state.studio.jobs, "all", lambda: 1 / 0)
    request = {"url": "/api/jobs", "headers": {"authorization": f"Bearer {TOKEN}"}}
    with TestClient(app, "http://127.0.0.1:8765", raise_server_exceptions=False) as client:
        answer = client.get(**request)
    assert answer.status_code == 500 and answer.json()["code"] == "studio.fault"
    assert "ZeroDivisionError" in answer.json()["problem"]
    with TestClient(app, "http://127.0.0.1:8765") as client, pytest.raises(ZeroDivisionError):  # the server prints it
        client.get(**request)


def test_the_interface_describes_itself_in_its_own_names(studio):
    """Its models are made of the options of the command line."""
    schemas = studio.app.openapi()["components"]["schemas"]
    texts = [one.get("description", "") for schema in schemas.values() for one in schema.get("properties", {}).values()]
    assert any(texts) and not [text for text in texts if "--" in text and "as dousa " not in text]


def test_an_infinite_result_is_an_error_and_a_problem_may_name_one():
    assert Answer({"known": [1.5, math.nan]}).body == b'{"known":[1.5,null]}'
    with pytest.raises(OptionError, match="infinite"):
        Answer({"known": [np.inf]})
    problem = to_answer(Message("resampling.rate", rate=math.inf))
    assert b"inf" in Answer(problem).body
