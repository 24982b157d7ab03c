"""A library is looked after from the studio: its checksums compared, what is damaged repaired, room given back."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path

import pytest

from dousa.library import Library


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
    from dousa.library.upkeep import repair

    looks, find = [], repair.find_damage
    monkeypatch.setattr(repair, "find_damage", lambda *words: looks.append(1) or find(*words))
    context = SimpleNamespace(
        open_library=lambda: Library.open(library_copy), progress=lambda *words: None, tell=lambda message: None
    )
    assert check({"repair": True}, context)["sound"] and len(looks) == 1


def test_files_of_jobs_are_read_once(tmp_path, monkeypatch):
    from dousa.app.studio.content.disk_space import MentionedBatches

    batches = [f"{k:016x}" for k in range(3)]
    for name in batches:
        (tmp_path / "files" / name).mkdir(parents=True)
    job = tmp_path / "jobs" / "one" / "job.json"
    job.parent.mkdir(parents=True)
    job.write_text(f'{{"motion": "file:{batches[1]}/a.bvh", "value": 0.1234567890123456789}}')
    mentioned, reads, read = MentionedBatches(tmp_path), [], Path.read_bytes
    monkeypatch.setattr(Path, "read_bytes", lambda path: reads.append(path) or read(path))
    assert mentioned.list() == mentioned.list() == {batches[1]} and len(reads) == 1
    job.write_text(f'{{"motion": "file:{batches[2]}/a.bvh", "other": "{batches[0]}"}}')
    assert mentioned.list() == {batches[0], batches[2]} and len(reads) == 2
    job.unlink()
    assert mentioned.list() == set()


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


@pytest.mark.parametrize("language", ["en", "ja"])
def test_the_tray_says_what_was_found_and_repairs(show, running, library_copy, language):
    damage(library_copy, "UPDATE clip_poses SET poses = zeroblob(length(poses)) WHERE clip_id = 2")
    page = show("/library", language=language)
    page.find("#jobs-button").click()
    page.wait("return document.querySelector('#space-check')")
    assert not page.run("return document.querySelector('#space-fragments')")  # it is small
    page.run("document.querySelector('#space-check').click()")
    job = "document.querySelector('.job[data-state=done]')"
    page.wait(f"return {job}")
    said = {"en": ("poses: ", "1 thing is damaged"), "ja": ("姿勢", "1か所が壊れています")}[language]
    assert all(part in page.run(f"return {job}.textContent") for part in said)
    page.run(f"{job}.querySelector('.actions button').click()")
    page.wait("return document.querySelectorAll('.job[data-state=done]').length === 2")
    sound = {"en": "the library is sound", "ja": "異常はありません"}[language]
    assert sound in page.run(f"return {job}.textContent")
    assert page.messages() == []
