"""What is done on the Library page is undone and done again; tags, stars, searches and selections that are kept."""

import os

import pytest

from dousa.library import Library

N = 24


def library_of(studio) -> Library:
    return studio.app.state.studio.library


def ids(studio, **asked):
    return studio.get("/api/clips/ids", params=asked).json()["ids"]


def test_changes_are_undone_and_done_again(studio):
    removal = studio.post("/api/clips/remove", json={"clips": [1, 2, 3]}).json()
    assert (removal["removed"], len(ids(studio))) == (3, N - 3)
    label = studio.post("/api/clips/relabel", json={"clips": [4, 5], "category": "hop"}).json()
    listed = studio.get("/api/journal").json()
    assert [one["number"] for one in listed["changes"][:2]] == [label["change"], removal["change"]]
    assert listed["changes"][0]["what"] == "2 clips: category 'hop'"
    assert listed["kept_bytes"] == listed["changes"][1]["kept_bytes"] > 0
    undone = studio.post("/api/journal/undo", json={"number": removal["change"]})
    assert (undone.status_code, undone.json()["what"]) == (200, "3 clips removed")
    assert len(ids(studio)) == N
    assert studio.post("/api/journal/undo", json={}).json()["kind"] == "relabel"
    again = studio.post("/api/journal/redo", json={}, headers={"accept-language": "ja"})
    assert again.json()["what"] == "2件のカテゴリーを「hop」に"
    assert ids(studio, category="hop") == [4, 5]


def test_an_undo_of_what_others_changed_since_is_refused(studio):
    mine = studio.post("/api/clips/relabel", json={"clips": [1, 2], "category": "hop"}).json()["change"]
    with Library.open(library_of(studio).name) as other:
        other.relabel([2], category="leap")
    answer = studio.post("/api/journal/undo", json={"number": mine})
    assert (answer.status_code, answer.json()["code"]) == (409, "journal.changed_later")
    assert "undo that one first" in answer.json()["problem"]
    assert studio.get("/api/clips/2").json()["category"] == "leap"
    for number, status in ((10**9, 404), (0, 422), ("x", 422)):
        assert studio.post("/api/journal/undo", json={"number": number}).status_code == status
    assert studio.post("/api/journal/redo", json={}).status_code == 409


def test_tags_are_a_facet_and_are_found_by_words(studio):
    done = studio.post("/api/clips/tag", json={"clips": [1, 2, 99], "add": ["draft", "favourite"]}).json()
    assert (done["changed"], done["missing"]) == (2, 1)
    assert studio.post("/api/clips/tag", json={"clips": [2], "remove": ["draft"]}).json()["changed"] == 1
    assert studio.get("/api/clips/1").json()["tags"] == ["draft", "favourite"]
    answer = studio.get("/api/clips", params={"tag": "favourite"}).json()
    assert (answer["total"], answer["facets"]["tag"]) == (2, {"": N - 2, "favourite": 2, "draft": 1})
    assert ids(studio, tag=["draft", ""], category="kick_left") == sorted(set(ids(studio, category="kick_left")) - {2})
    assert ids(studio, text="draft") == [1]
    nothing = studio.post("/api/clips/tag", json={"clips": [2], "remove": ["draft"]}).json()
    assert (nothing["changed"], nothing["change"]) == (0, None)
    for body in ({"clips": [1]}, {"clips": [1], "add": ["+x"]}, {"clips": [1], "add": ["a\nb"]}, {"add": ["x"]}):
        assert studio.post("/api/clips/tag", json=body).status_code == 422


def test_searches_and_selections_are_kept(studio):
    saved = studio.post("/api/searches", json={"name": "kicks", "asked": {"category": ["kick_left"], "text": ""}})
    assert saved.json() == {"name": "kicks", "asked": {"category": ["kick_left"]}}
    studio.post("/api/searches", json={"name": "these", "asked": {"clips": [3, 1, 700]}})
    rows = studio.get("/api/searches").json()["searches"]
    assert [(row["name"], row["n_clips"]) for row in rows] == [("kicks", None), ("these", 3)]
    assert ids(studio, saved="these") == [1, 3]
    assert ids(studio, saved="kicks") == ids(studio, category="kick_left")
    studio.post("/api/clips/remove", json={"clips": [3]})
    assert ids(studio, saved="these") == [1]
    assert studio.post("/api/searches/forget", params={"name": "these"}).status_code == 200
    assert studio.post("/api/searches/forget", params={"name": "these"}).status_code == 404
    assert studio.get("/api/clips", params={"saved": "these"}).status_code == 404
    for body in ({"name": "x", "asked": {}}, {"name": " ", "asked": {"text": "a"}}, {"name": "x"}):
        assert studio.post("/api/searches", json=body).status_code == 422


@pytest.mark.parametrize("kind", ["clip"])
def test_adding_is_undone_in_the_studio(studio, bvh, wait_job, kind):
    upload = studio.post("/api/uploads", params={"name": "new/a.bvh"}, content=bvh.read_bytes() + b"\n").json()
    job = studio.post("/api/jobs/add", json={"batch": upload["batch"], "kind": kind}).json()
    done = wait_job(studio, job["id"])
    result = done["result"]
    if result["added"]:
        assert len(ids(studio)) == N + 1
        assert studio.post("/api/journal/undo", json={"number": result["change"]}).json()["kind"] == "add"
    assert len(ids(studio)) == N


def test_removed_clips_are_forgotten_and_their_uploads_freed(studio, bvh, wait_job):
    content = bvh.read_bytes() + b"\n"
    batch = studio.post("/api/uploads", params={"name": "new/a.bvh"}, content=content).json()["batch"]
    job = studio.post("/api/jobs/add", json={"batch": batch}).json()["id"]
    (path,) = wait_job(studio, job)["result"]["added"] or [None]
    clip = next(one for one in library_of(studio).clips() if one.path.endswith(f"{batch}/{path}"))
    assert studio.delete(f"/api/jobs/{job}").status_code == 200
    folder = studio.app.state.studio.workspace.root / "files" / batch
    for place in (folder, *folder.glob(".*")):  # also what says that it is kept
        os.utime(place, (1, 1))
    assert studio.get("/api/space").json()["can_be_freed_bytes"] == 0  # a clip comes from it
    studio.post("/api/clips/remove", json={"clips": [clip.id]})
    space = studio.get("/api/space").json()
    assert space["removed_bytes"] > 0 and space["can_be_freed_bytes"] == 0  # it may come back
    studio.post("/api/journal/undo", json={})
    assert studio.get("/api/space").json()["removed_bytes"] == 0
    studio.post("/api/clips/remove", json={"clips": [clip.id]})
    job = studio.post("/api/jobs/compact", json={}).json()["id"]
    assert wait_job(studio, job)["result"]["forgotten"] > 0
    assert studio.delete(f"/api/jobs/{job}").status_code == 200
    forgotten = studio.get("/api/space").json()
    assert forgotten["removed_bytes"] == 0 and forgotten["can_be_freed_bytes"] >= len(content)
    assert studio.post("/api/journal/undo", json={}).status_code == 409
    studio.post("/api/space/free")
    assert not folder.exists()
