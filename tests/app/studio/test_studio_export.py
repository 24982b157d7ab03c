"""Clips out of the studio: as a ZIP file on the user's own character, and one at a time."""

from __future__ import annotations

import csv
import io
import zipfile

import pytest

from dousa.formats.registry import read_motion, write_motion
from dousa.motion import canonicalise
from dousa.motion.synthetic import draw_performer, make_motion


@pytest.fixture
def character(studio, tmp_path):
    """A character, uploaded: its name, and its height."""
    path = tmp_path / "hero.bvh"
    write_motion(make_motion("bow", draw_performer(31)), path)
    answer = studio.post("/api/uploads?name=hero.bvh", content=path.read_bytes())
    return answer.json()["files"][0]["motion"], canonicalise(read_motion(path)).height


def read_zip(content):
    archive = zipfile.ZipFile(io.BytesIO(content))
    assert archive.testzip() is None
    rows = list(csv.DictReader(io.StringIO(archive.read("manifest.csv").decode())))
    return archive, {row["file"]: row for row in rows}


@pytest.mark.plain_workers
def test_clips_on_a_character(studio, character, tmp_path, wait_job):
    motion, height = character
    said = studio.get("/api/export/character", params={"motion": motion}).json()
    assert (said["name"], said["suffix"]) == ("hero.bvh", ".bvh")
    assert said["height_m"] == pytest.approx(height, abs=1e-3)
    clips = [clip.id for clip in studio.app.state.studio.library.clips(category="kick_left")[:2]]
    asked = {"clips": [*clips, 9999], "to": "glb", "onto": motion, "keep_reach": True}
    answer = studio.post("/api/jobs/export", json=asked)
    assert answer.status_code == 202
    assert answer.json()["title"] == "3 clips as GLB, onto hero.bvh"
    assert studio.get("/api/exports/0123456789abcdef").status_code == 404
    job = wait_job(studio, answer.json()["id"])
    assert job["state"] == "done", job
    assert (job["result"]["n_files"], job["result"]["n_gone"], job["result"]["skipped"]) == (2, 1, [])
    got = studio.get(f"/api/exports/{job['id']}")
    assert got.headers["content-type"] == "application/zip"
    assert len(got.content) == job["result"]["bytes"]
    archive, rows = read_zip(got.content)
    assert {row["category"] for row in rows.values()} == {"kick_left"}
    assert {int(row["id"]) for row in rows.values()} == set(clips)
    for name in rows:
        archive.extract(name, tmp_path)
        assert canonicalise(read_motion(tmp_path / name)).height == pytest.approx(height, abs=2e-3)


def test_one_at_a_time(studio, character, tmp_path):
    motion, height = character
    clip = studio.app.state.studio.library.clips(category="squat")[0]
    for asked, suffix in (({"to": "glb", "onto": motion}, ".glb"), ({"to": "c3d"}, ".c3d"), ({}, ".bvh")):
        part = {"motion": f"clip:{clip.id}", "start_s": 0.2, "end_s": 1.0}
        got = studio.get("/api/motions/file", params={**part, **asked})
        assert got.status_code == 200, got.text
        assert f"_0.20s{suffix}" in got.headers["content-disposition"]
        (tmp_path / f"x{suffix}").write_bytes(got.content)
        made = read_motion(tmp_path / f"x{suffix}")
        assert made.n_frames == round(0.8 * clip.frame_rate) + 1
        expected = height if "onto" in asked else clip.height
        assert canonicalise(made).height == pytest.approx(expected, rel=0.03)  # without a rest pose: along the bones


def test_the_formats_are_those_that_are_written(studio):
    answer = studio.get("/api/export/formats").json()
    assert answer["formats"]["glb"] == ".glb"
    assert answer["original"] not in answer["formats"]


def test_mistakes_are_told_at_once(studio, character):
    motion, _ = character
    points = "PathFileType\t4\t(X/Y/Z)\tp.trc\n"
    upload = studio.post("/api/uploads?name=p.trc", content=points.encode()).json()["files"][0]["motion"]
    clip = studio.app.state.studio.library.clips()[0].id
    for asked, status in (
        ({"clips": [clip], "to": "docx"}, 422),
        ({"clips": [clip], "to": "original", "onto": motion}, 422),
        ({"clips": [clip], "to": "bvh", "keep_reach": True}, 422),
        ({"clips": []}, 422),
        ({"clips": [clip], "onto": "file:0123456789abcdef/x.bvh"}, 404),
        ({"clips": [clip], "onto": motion.replace("hero", "../../x")}, 422),
        ({"clips": [clip], "frame_rate": -1}, 422),
    ):
        answer = studio.post("/api/jobs/export", json=asked)
        assert answer.status_code == status, (asked, answer.text)
        assert answer.json()["problem"]
    assert studio.get("/api/export/character", params={"motion": upload}).status_code == 422
    assert studio.get("/api/motions/file", params={"motion": f"clip:{clip}", "to": "original"}).status_code == 422
    assert studio.get("/api/jobs").json()["jobs"] == []


def test_clips_that_are_gone(studio, wait_job):
    job = wait_job(studio, studio.post("/api/jobs/export", json={"clips": [9998, 9999]}).json()["id"])
    assert job["state"] == "failed"
    assert "9998" in job["problem"]
    assert studio.get(f"/api/exports/{job['id']}").status_code == 404
