"""The list of clips with its facets, small figures, labels and removal, asked as a program would."""

import os
import shutil
import sqlite3
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from app.studio.test_studio_search import add_take
from dousa.app.player.figures import MINIATURE_BYTES, encode_miniature
from dousa.app.studio.content.clips import LENGTHS, Figures
from dousa.app.studio.jobs.board import FolderWatch
from dousa.formats.registry import write_motion
from dousa.library import Library
from dousa.motion.synthetic.performers import draw_performer, make_motion

N = 24


def ids_of(answer):
    return [item["id"] for item in answer.json()["items"]]


def open_library(studio):
    return studio.app.state.studio.library


# --- the list


def test_the_list_comes_in_parts_and_in_order(studio):
    whole = studio.get("/api/clips", params={"limit": 500}).json()
    assert whole["total"] == N
    assert [item["path"] for item in whole["items"]] == sorted(item["path"] for item in whole["items"])
    parts = [studio.get("/api/clips", params={"offset": start, "limit": 7}) for start in range(0, 28, 7)]
    assert [number for part in parts for number in ids_of(part)] == [item["id"] for item in whole["items"]]
    assert studio.get("/api/clips", params={"offset": 999}).json()["items"] == []


def test_items_say_what_the_library_says_and_a_name_without_the_folders_of_this_machine(studio):
    (item,) = studio.get("/api/clips", params={"limit": 1}).json()["items"]
    clip = open_library(studio).clips([item["id"]])[0]
    assert {name: item[name] for name in clip.to_json()} == clip.to_json()
    assert item["motion"] == f"clip:{clip.id}"
    assert item["name"] == "performer00_1.bvh"
    assert item["folder"] == "motions/kick_left"


@pytest.mark.parametrize(
    ("asked", "count"),
    [
        ({"category": "squat"}, 6),
        ({"category": ["squat", "walk"]}, 12),
        ({"category": ""}, 0),
        ({"performer": "performer03"}, 4),
        ({"category": "squat", "performer": "performer03"}, 1),
        ({"kind": "clip"}, N),
        ({"kind": "take"}, 0),
        ({"text": "SQUAT performer03"}, 1),
        ({"text": "ｓｑｕａｔ"}, 6),
        ({"text": "kick performer"}, 6),
        ({"text": "nothing of the kind"}, 0),
        ({"min_s": 0, "max_s": 10000}, N),
        ({"min_s": 10000}, 0),
        ({"max_s": 0}, 0),
        ({"batch": "0" * 16}, 0),
    ],
)
def test_filters(studio, asked, count):
    answer = studio.get("/api/clips", params=asked)
    assert answer.json()["total"] == len(answer.json()["items"]) == count
    assert studio.get("/api/clips/ids", params=asked).json()["ids"] == ids_of(answer)


def test_lengths_are_cut_where_the_facet_says(studio):
    counts = studio.get("/api/clips").json()["facets"]["length"]
    assert sum(counts.values()) == N
    for name, (low, high) in LENGTHS.items():
        limits = {"min_s": low} if high == np.inf else {"min_s": low, "max_s": high}
        assert studio.get("/api/clips", params=limits).json()["total"] == counts.get(name, 0)


def test_a_facet_counts_what_would_fit_if_it_were_open(studio):
    facets = studio.get("/api/clips", params={"category": "squat", "performer": "performer03"}).json()["facets"]
    assert facets["category"] == {"kick_left": 1, "squat": 1, "walk": 1, "wave_right": 1}
    assert facets["performer"] == {f"performer{number:02}": 1 for number in range(6)}
    assert facets["kind"] == {"clip": 1}


@pytest.mark.parametrize("sort", ["duration", "-duration", "category", "-id"])
def test_orders(studio, sort):
    items = studio.get("/api/clips", params={"sort": sort, "limit": 500}).json()["items"]
    keys = [item[sort.removeprefix("-")] for item in items]
    assert len(items) == N
    assert keys == sorted(keys, reverse=sort.startswith("-"))


@pytest.mark.parametrize(
    "query",
    ["limit=501", "limit=-1", "offset=-1", "kind=dance", "min_s=nan", "max_s=inf", "sort=path;drop", "batch=.."],
)
def test_questions_that_mean_nothing_are_refused(studio, query):
    answer = studio.get(f"/api/clips?{query}")
    assert answer.status_code == 422
    assert answer.json()["problem"]


@pytest.mark.parametrize(
    "text", ["'; DROP TABLE clips; --", "%", "\\", "((((", "\x00", "𝕊𝕢𝕦𝕒𝕥" * 40, "<script>", "../.."]
)
def test_hostile_texts_find_nothing_and_break_nothing(studio, text):
    assert studio.get("/api/clips", params={"text": text}).status_code in (200, 422)
    assert studio.get("/api/clips", params={"category": text, "performer": text}).json()["total"] == 0
    assert studio.get("/api/clips").json()["total"] == N


def test_what_another_program_writes_is_seen(studio, library_copy):
    before = studio.get("/api/clips").json()
    with Library.open(library_copy) as library:
        library.remove(category="walk")
    after = studio.get("/api/clips").json()
    assert after["total"] == N - 6
    assert after["revision"] > before["revision"]
    assert after["library"]["n_categories"] == 3


def test_a_change_of_few_clips_leaves_the_others_as_they_were_read(studio):
    listing = studio.app.state.studio.listing
    before = listing.now()
    chosen = before.clips[3].id
    studio.post("/api/clips/tag", json={"clips": [chosen], "add": ["calm"]})
    studio.post("/api/clips/relabel", json={"clips": [chosen], "category": "stroll"})
    after = listing.now()
    others = [(one, other) for one, other in zip(before.clips, after.clips, strict=True) if one.id != chosen]
    assert len(others) == N - 1 and all(one is other for one, other in others)
    for text, count in (("calm", 1), ("stroll", 1), ("squat", 6)):
        assert studio.get("/api/clips", params={"text": text}).json()["total"] == count


def test_the_empty_library(studio):
    studio.post("/api/clips/remove", json={"clips": studio.get("/api/clips/ids").json()["ids"]})
    answer = studio.get("/api/clips").json()
    assert answer["total"] == 0
    assert answer["facets"] == {"category": {}, "performer": {}, "kind": {}, "tag": {}, "length": {}}
    assert answer["library"]["n_clips"] == 0
    assert studio.get("/api/clips", params={"category": "x", "text": "y"}).json()["total"] == 0


def test_an_address_with_the_token_keeps_every_category_it_asks_for(studio):
    address = "/library?category=a&token=the-token-of-the-tests&category=b+c"
    answer = studio.get(address, follow_redirects=False)
    assert answer.headers["location"] == "/library?category=a&category=b+c"


def test_one_clip(studio):
    assert studio.get("/api/clips/3").json()["id"] == 3
    for number in (0, -1, 999, 10**30):
        assert studio.get(f"/api/clips/{number}").status_code == 404


# --- figures


def test_figures_are_those_of_the_clips_in_the_order_asked_for(studio):
    answer = studio.post("/api/clips/thumbnails", json={"clips": [5, 999, 2, 5]})
    assert answer.headers["content-type"] == "application/octet-stream"
    parts = [answer.content[at : at + MINIATURE_BYTES] for at in range(0, len(answer.content), MINIATURE_BYTES)]
    five, two = (encode_miniature(open_library(studio).trajectories(number)) for number in (5, 2))
    assert parts == [five, bytes(MINIATURE_BYTES), two, five]


def test_figures_are_made_once(studio, monkeypatch):
    first = studio.post("/api/clips/thumbnails", json={"clips": [1, 2, 3]}).content
    monkeypatch.setattr("dousa.app.studio.content.clips.encode_miniature", None)
    assert studio.post("/api/clips/thumbnails", json={"clips": [1, 2, 3]}).content == first


def test_a_damaged_clip_does_not_take_the_others_with_it(studio, library_copy):
    with sqlite3.connect(library_copy) as library:
        library.execute("UPDATE clip_trajectories SET positions = x'00' WHERE clip_id = 2")
    library.close()
    content = studio.post("/api/clips/thumbnails", json={"clips": [1, 2, 3]}).content
    parts = [any(content[at : at + MINIATURE_BYTES]) for at in range(0, len(content), MINIATURE_BYTES)]
    assert parts == [True, False, True]


def test_few_figures_are_remembered(studio):
    few, library = Figures(most=2), open_library(studio)
    for numbers in ([1, 2], [3, 4], [5, 6]):
        assert any(few.get(library, numbers))
    assert [number for number, _ in few._made] == [1, 2, 3, 4, 5, 6][4:]


@pytest.mark.parametrize("clips", [[0], [-1], [2**31], [1.5], ["x"], [None], list(range(1, 502)), "1", {"1": 1}])
def test_bad_numbers_are_refused(studio, clips):
    assert studio.post("/api/clips/thumbnails", json={"clips": clips}).status_code == 422


def test_a_take_does_not_lack_a_category(studio, tmp_path):
    """It is counted among takes, and not among clips without a label."""
    add_take(open_library(studio), tmp_path)
    studio.post("/api/clips/relabel", json={"clips": [1], "category": None})
    facets = studio.get("/api/clips").json()["facets"]
    assert (facets["kind"], facets["category"][""]) == ({"clip": N, "take": 1}, 1)
    assert ids_of(studio.get("/api/clips", params={"category": ""})) == [1]
    assert studio.get("/api/clips", params={"kind": "take"}).json()["facets"]["category"] == {}


# --- labels and removal


def test_relabelling(studio):
    answer = studio.post("/api/clips/relabel", json={"clips": [1, 2, 999], "category": "  hop  "})
    change = open_library(studio).journal()[0].number
    assert answer.json() == {"changed": 2, "missing": 1, "change": change}
    items = studio.get("/api/clips", params={"category": "hop"}).json()["items"]
    assert sorted(item["id"] for item in items) == [1, 2]
    assert items[0]["performer"] is not None
    studio.post("/api/clips/relabel", json={"clips": [1], "category": None, "performer": "Anna"})
    clip = studio.get("/api/clips/1").json()
    assert (clip["category"], clip["performer"]) == (None, "Anna")
    assert studio.get("/api/clips", params={"category": ""}).json()["total"] == 1
    assert studio.get("/api/clips").json()["facets"]["category"][""] == 1


@pytest.mark.parametrize(
    "body",
    [
        {"clips": [1]},
        {"clips": [], "category": "x"},
        {"clips": [1], "category": ""},
        {"clips": [1], "category": "  "},
        {"clips": [1], "category": 5},
        {"clips": [1], "category": "a\nb"},
        {"clips": [1], "performer": "a\x00b"},
        {"clips": [1], "category": "x" * 201},
        {"clips": [1], "category": "x", "path": "/etc/passwd"},
        {"category": "x"},
    ],
)
def test_labels_that_cannot_be_are_refused(studio, body):
    revision = open_library(studio).revision
    assert studio.post("/api/clips/relabel", json=body).status_code == 422
    assert open_library(studio).revision == revision


def test_hostile_labels_are_kept_as_they_are(studio):
    label = "<img src=x onerror=alert(1)>'\"; --"
    studio.post("/api/clips/relabel", json={"clips": [1], "category": label})
    assert studio.get("/api/clips", params={"category": label}).json()["total"] == 1


def test_removal_is_the_same_twice(studio):
    answer = studio.post("/api/clips/remove", json={"clips": [1, 2]}).json()
    assert answer == {"removed": 2, "missing": 0, "change": open_library(studio).journal()[0].number}
    answer = studio.post("/api/clips/remove", json={"clips": [2, 3]}).json()
    assert (answer["removed"], answer["missing"]) == (1, 1)
    answer = studio.post("/api/clips/remove", json={"clips": [1]})
    assert answer.status_code == 404
    assert "clip 1" in answer.json()["problem"]
    assert studio.get("/api/clips").json()["total"] == N - 3


def test_many_clips_at_once(studio):
    ids = studio.get("/api/clips/ids").json()["ids"]
    assert studio.post("/api/clips/relabel", json={"clips": ids * 100, "performer": "all"}).json()["changed"] == N


# --- adding


def test_added_clips_can_be_listed_together_and_have_their_figures(studio, bvh, wait_job):
    content = bvh.read_bytes()
    batch = studio.post("/api/uploads?name=hop/new.bvh", content=content + b"\n").json()["batch"]
    studio.post(f"/api/uploads?name=plain.bvh&batch={batch}", content=content + b"\n\n")
    job = wait_job(studio, studio.post("/api/jobs/add", json={"batch": batch}).json()["id"])
    assert job["state"] == "done", job
    items = studio.get("/api/clips", params={"batch": batch}).json()["items"]
    assert [(item["folder"], item["name"], item["category"]) for item in items] == [
        ("hop", "new.bvh", "hop"),
        ("", "plain.bvh", None),
    ]


def test_a_table_of_labels_must_come_with_the_files(studio, bvh, wait_job, tmp_path):
    table = tmp_path / "labels.csv"
    table.write_text("file,category\nnew.bvh,secret\n")
    batch = studio.post("/api/uploads?name=new.bvh", content=bvh.read_bytes() + b"\n").json()["batch"]
    asked = {"batch": batch, "category_from": f"csv:{table}"}
    job = wait_job(studio, studio.post("/api/jobs/add", json=asked).json()["id"])
    assert job["state"] == "failed"
    assert "secret" not in str(job)
    studio.post(f"/api/uploads?name=labels.csv&batch={batch}", content=table.read_bytes())
    asked = {"batch": batch, "category_from": "csv:labels.csv"}
    job = wait_job(studio, studio.post("/api/jobs/add", json=asked).json()["id"])
    assert job["state"] == "done", job
    assert studio.get("/api/clips", params={"category": "secret"}).json()["total"] == 1


def damage(path, statement):
    with closing(sqlite3.connect(path)) as connection, connection:
        assert connection.execute(statement).rowcount


def run(studio, wait_job, kind, **request):
    return wait_job(studio, studio.post(f"/api/jobs/{kind}", json=request).json()["id"])


def test_damage_is_found_and_repaired(studio, wait_job, library_copy):
    whole = run(studio, wait_job, "check")
    assert whole["result"]["sound"] and whole["codes"]["notes"][-1]["code"] == "library_check.sound"
    damage(library_copy, "UPDATE clip_poses SET poses = zeroblob(length(poses)) WHERE clip_id IN (2, 5)")
    found = run(studio, wait_job, "check")
    assert [one["clip_id"] for one in found["result"]["damage"]] == [2, 5]
    codes = [note["code"] for note in found["codes"]["notes"]]
    assert codes == ["library_check.of_clip", "library_check.of_clip", "library_check.damaged"]
    mended = run(studio, wait_job, "check", repair=True)
    assert mended["result"]["sound"] and all(one["repaired"] for one in mended["result"]["damage"])
    with Library.open(library_copy) as library:
        assert library.check().damage == ()


@pytest.mark.plain_workers
def test_a_structure_is_not_repaired_under_an_open_studio(studio, wait_job, library_copy):
    damage(library_copy, "DELETE FROM clips WHERE id = 3")  # foreign keys are not looked at
    before = library_copy.stat().st_ino
    done = run(studio, wait_job, "check", repair=True)
    assert done["codes"]["notes"][0]["code"] == "studio_jobs.repair_closed"
    assert not done["result"]["sound"] and library_copy.stat().st_ino == before


def test_a_repair_looks_once_where_nothing_is_damaged(studio, wait_job, library_copy, monkeypatch):
    from types import SimpleNamespace

    from dousa.app.studio.work.library import check
    from dousa.library.care import repair

    looks, find = [], repair.find_damage
    monkeypatch.setattr(repair, "find_damage", lambda *words: looks.append(1) or find(*words))
    context = SimpleNamespace(
        open_library=lambda: Library.open(library_copy), progress=lambda *words: None, tell=lambda message: None
    )
    assert check({"repair": True}, context)["sound"] and len(looks) == 1


def test_a_backup_lies_beside_the_library(studio, wait_job, library_copy):
    done = run(studio, wait_job, "backup")
    (copy,) = library_copy.with_name(f"{library_copy.stem}.backups").iterdir()
    assert done["result"]["library"] == str(copy) and f"dousa restore {copy}" in done["notes"][-1]
    with Library.open(copy) as again, Library.open(library_copy) as library:
        assert again.clips() == library.clips()


@pytest.mark.plain_workers
def test_arrays_are_moved_to_fragments(studio, wait_job, library_copy):
    asked = {"query": {"motion": "clip:1"}}
    before = studio.post("/api/search", json=asked).json()["results"]
    assert not studio.get("/api/space").json()["has_fragments"]
    moved = run(studio, wait_job, "compact", fragments=True)
    assert moved["result"]["moved"] > 0 and len(moved["notes"]) >= 2
    assert studio.get("/api/space").json()["has_fragments"]
    assert studio.post("/api/search", json=asked).json()["results"] == before
    for kind, request in (("check", {"repair": "maybe"}), ("compact", {"fragments": "s3://x"})):
        assert studio.post(f"/api/jobs/{kind}", json=request).status_code == 422


def test_the_tray_says_what_was_found_and_repairs(show, running, library_copy):
    damage(library_copy, "UPDATE clip_poses SET poses = zeroblob(length(poses)) WHERE clip_id = 2")
    page = show("/library")
    page.find("#jobs-button").click()
    page.wait("return document.querySelector('#space-check')")
    assert not page.run("return document.querySelector('#space-fragments')")  # it is small
    page.run("document.querySelector('#space-check').click()")
    job = "document.querySelector('.job[data-state=done]')"
    page.wait(f"return {job}")
    assert all(part in page.run(f"return {job}.textContent") for part in ("poses: ", "1 thing is damaged"))
    page.run(f"{job}.querySelector('.actions button').click()")
    page.wait("return document.querySelectorAll('.job[data-state=done]').length === 2")
    assert "the library is sound" in page.run(f"return {job}.textContent")


@pytest.fixture(scope="module")
def squat(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("watched") / "one.bvh"
    write_motion(make_motion("squat", draw_performer(77), 3), path)
    return path


def test_what_is_new_is_taken_once_when_it_rests(tmp_path, squat):
    taken, busy = [], [False]
    watch = FolderWatch(tmp_path, taken.append, lambda: busy[0])
    assert not watch.look() and not watch.look(), "nothing is there"
    place = tmp_path / "squat" / "one.bvh"
    place.parent.mkdir()
    place.write_bytes(squat.read_bytes()[:1000])
    assert not watch.look(), "somebody may still be writing it"
    shutil.copy(squat, place)
    os.utime(place, (1, 1))
    assert not watch.look(), "it has changed since"
    busy[0] = True
    assert not watch.look(), "one after the other"
    busy[0] = False
    assert watch.look()
    assert taken == [[str(place)]]
    assert not watch.look()
    shutil.copy(squat, tmp_path / "two.bvh")
    (tmp_path / "notes.txt").write_text("no motion")
    assert not watch.look()
    assert watch.look()
    assert taken[1:] == [[str(tmp_path / "two.bvh")]], "what was taken before is left alone"
    place.unlink()
    assert not watch.look() and not watch.look(), "what has gone stays in the library"


@pytest.mark.plain_workers
def test_what_appears_goes_into_the_library_with_its_folder_as_category(studio, tmp_path, squat, wait_job):
    from dousa.app.studio.server import _watch

    before = studio.get("/api/info").json()["library"]["categories"]
    watch = _watch(tmp_path, studio.app.state.studio)
    (tmp_path / "jumping").mkdir()
    shutil.copy(squat, tmp_path / "jumping" / "one.bvh")
    assert not watch.look()
    assert watch.look()
    job = next(one for one in studio.get("/api/jobs").json()["jobs"] if one["kind"] == "watch")
    done = wait_job(studio, job["id"])
    assert done["state"] == "done", done

    after = studio.get("/api/info").json()["library"]["categories"]
    assert after == {**before, "jumping": 1}


def test_the_watch_begins_and_ends(tmp_path):
    watch = FolderWatch(tmp_path, lambda files: None, lambda: False)
    watch.start()
    watch.end()


def test_a_folder_that_is_not_there_is_said_before_anything_is_made(dousa, tmp_path):
    code, out, err = dousa("studio", tmp_path / "new.dousa", "--no-browser", "--watch", tmp_path / "none")
    assert (code, out) == (2, "")
    assert "none" in err and "no such folder" in err
    assert not (tmp_path / "new.dousa").exists()
