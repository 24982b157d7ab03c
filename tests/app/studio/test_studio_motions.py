"""Motions as figures and files."""

import base64
import csv
import io
import re
import zipfile

import numpy as np
import pytest

from dousa.formats.exchange.programs import find_program
from dousa.formats.registry import read_motion, write_motion
from dousa.motion import canonicalise
from dousa.motion.canonical.joints import JOINT_INDEX
from dousa.motion.synthetic import draw_performer, make_motion
from formats import made_people


def clip_of(studio, category, n=0):
    """Number of a clip of a category."""
    return studio.app.state.studio.library.clips(category=category)[n].id


@pytest.fixture
def kick(studio):
    return clip_of(studio, "kick_left")


POINTS = """PathFileType\t4\t(X/Y/Z)\tpoints.trc
DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames
30\t30\t2\t1\tm\t30\t1\t2
Frame#\tTime\tHead\t\t
\t\tX1\tY1\tZ1

1\t0.0\t0.0\t1.6\t0.0
2\t0.033\t0.0\t1.6\t0.0
"""


def test_a_clip_is_described(studio, kick):
    answer = studio.get(f"/api/motions/info?motion=clip:{kick}")
    assert answer.status_code == 200, answer.text
    found = answer.json()
    assert found["category"] == "kick_left"
    assert found["kind"] == "clip"
    assert found["duration_s"] == pytest.approx(found["n_frames"] / found["frame_rate"])


def test_a_part_is_as_long_as_asked(studio, kick):
    found = studio.get(f"/api/motions/info?motion=clip:{kick}&start_s=0.5&end_s=1").json()
    assert found["n_frames"] == round(0.5 * found["frame_rate"]) + 1


@pytest.mark.parametrize(
    ("query", "status"),
    [
        ("motion=clip:999999", 404),
        ("motion=clip:12345678901234", 404),
        ("motion=job:0123456789abcdef", 404),
        ("motion=file:0123456789abcdef/x.bvh", 404),
        ("motion=walk.bvh", 422),
        ("motion=file:0123456789abcdef/../../x.bvh", 422),
        ("motion=clip:1&start_s=5&end_s=1", 422),
        ("motion=clip:1&start_s=nan", 422),
        ("motion=clip:1&surprise=1", 422),
    ],
)
@pytest.mark.parametrize("what", ["info", "player", "miniature", "bvh"])
def test_what_is_not_there_is_refused(studio, what, query, status):
    answer = studio.get(f"/api/motions/{what}?{query}")
    assert answer.status_code in (status, 404), answer.text
    assert answer.json()["problem"]


def test_the_player_is_fed(studio, kick):
    data = studio.get(f"/api/motions/player?motion=clip:{kick}&language=ja").json()
    assert data["language"] == "ja"
    assert data["performance"]["n_frames"] > 10
    assert data["reference"] is None


def test_a_pair_is_in_step(studio, kick):
    other = clip_of(studio, "kick_left", 1)
    data = studio.get(f"/api/motions/pair?motion=clip:{kick}&other=clip:{other}").json()
    assert data["reference"]["n_frames"] > 10
    assert len(base64.b64decode(data["step"])) == 4 * data["performance"]["n_frames"]
    mirrored = studio.get(f"/api/motions/pair?motion=clip:{kick}&other=clip:{other}&mirror=true").json()
    assert mirrored["reference"] != data["reference"]


def test_a_miniature_has_its_size(studio, kick):
    from dousa.app.player.figures import MINIATURE_BYTES

    assert len(studio.get(f"/api/motions/miniature?motion=clip:{kick}").content) == MINIATURE_BYTES


def test_a_download_has_all_joints_of_its_file(studio, kick, tmp_path):
    source = studio.app.state.studio.library.clips([kick])[0].path
    answer = studio.get(f"/api/motions/file?motion=clip:{kick}&start_s=0.5&end_s=1")
    assert 'filename="' in answer.headers["content-disposition"]
    (tmp_path / "part.bvh").write_bytes(answer.content)
    part, whole = read_motion(tmp_path / "part.bvh"), read_motion(source)
    assert part.skeleton.names == whole.skeleton.names
    first = round(0.5 * whole.frame_rate)
    expected = canonicalise(whole).positions[first : first + part.n_frames]
    np.testing.assert_allclose(canonicalise(part).positions, expected, atol=1e-4)


def test_a_download_without_its_file_is_fitted(studio, kick, tmp_path):
    library = studio.app.state.studio.library
    source = library.clips([kick])[0].path
    from pathlib import Path

    kept = Path(source).read_bytes()
    try:
        Path(source).unlink()
        answer = studio.get(f"/api/motions/file?motion=clip:{kick}")
    finally:
        Path(source).write_bytes(kept)
    assert answer.status_code == 200, answer.text
    (tmp_path / "fitted.bvh").write_bytes(answer.content)
    fitted = canonicalise(read_motion(tmp_path / "fitted.bvh")).positions
    assert np.abs(fitted - library.trajectories(kick).positions).mean() < 0.02


def test_a_file_that_became_another_is_not_handed_out(studio, kick, tmp_path):
    """The library remembers a kick; what lies in its place now is no business of a download."""
    library = studio.app.state.studio.library
    from pathlib import Path

    source, other = (Path(library.clips(category=name)[0].path) for name in ("kick_left", "squat"))
    kept = source.read_bytes()
    try:
        source.write_bytes(other.read_bytes())
        answer = studio.get(f"/api/motions/file?motion=clip:{kick}")
    finally:
        source.write_bytes(kept)
    (tmp_path / "kick.bvh").write_bytes(answer.content)
    found = canonicalise(read_motion(tmp_path / "kick.bvh")).positions
    assert np.abs(found - library.trajectories(kick).positions).mean() < 0.02


@pytest.mark.parametrize("suffix", [".glb", ".csv", ".c3d"])
def test_a_motion_of_another_format_can_be_looked_at(studio, bvh, suffix, tmp_path):
    """Also that a table that is no motion is none."""
    write_motion(read_motion(bvh), tmp_path / f"kick{suffix}")
    content = (tmp_path / f"kick{suffix}").read_bytes()
    (file,) = studio.post("/api/uploads", params={"name": f"kick{suffix}"}, content=content).json()["files"]
    found = studio.get("/api/motions/info", params={"motion": file["motion"]})
    assert found.status_code == 200, found.text
    assert found.json()["n_frames"] == read_motion(bvh).n_frames
    (table,) = studio.post("/api/uploads", params={"name": "labels.csv"}, content=b"start_s,end_s\n0,1\n").json()[
        "files"
    ]
    assert table["motion"] is None


def test_a_download_onto_a_character_has_its_skeleton(studio, kick, bvh, tmp_path):
    """A character of half the size, whose bones have other names, kicks as the clip does."""
    text = bvh.read_text()
    for name in sorted(set(re.findall(r"(?:ROOT|JOINT) (\S+)", text))):
        text = re.sub(rf"(ROOT|JOINT) {name}\b", rf"\1 mixamorig:{name}", text)
    text = re.sub(
        r"OFFSET (\S+) (\S+) (\S+)", lambda m: "OFFSET " + " ".join(str(0.5 * float(v)) for v in m.groups()), text
    )
    file = studio.post("/api/uploads", params={"name": "small.bvh"}, content=text.encode()).json()["files"][0]
    answer = studio.get("/api/motions/file", params={"motion": f"clip:{kick}", "onto": file["motion"]})
    assert answer.status_code == 200, answer.text
    (tmp_path / "onto.bvh").write_bytes(answer.content)
    onto = read_motion(tmp_path / "onto.bvh")
    assert all(name.startswith("mixamorig:") for name in onto.skeleton.names)
    made, source = canonicalise(onto), studio.app.state.studio.library.trajectories(kick)
    assert made.n_frames == len(source.positions)
    directions = []
    for positions in (made.positions, source.positions):
        shin = positions[:, JOINT_INDEX["left_ankle"]] - positions[:, JOINT_INDEX["left_knee"]]
        directions.append(shin / np.linalg.norm(shin, axis=1, keepdims=True))
    assert np.degrees(np.arccos(np.clip((directions[0] * directions[1]).sum(axis=1), -1, 1))).mean() < 5


def test_a_character_without_rotations_is_refused(studio, kick):
    points = studio.post("/api/uploads", params={"name": "points.trc"}, content=POINTS.encode()).json()["files"][0]
    answer = studio.get("/api/motions/file", params={"motion": f"clip:{kick}", "onto": points["motion"]})
    assert answer.status_code == 422
    assert "points.trc has no skeleton to move" in answer.json()["problem"]


def test_names_in_any_script_can_be_downloaded(studio, bvh):
    content = bvh.read_bytes()
    file = studio.post("/api/uploads", params={"name": '蹴り "1".bvh'.replace('"', "'")}, content=content).json()
    answer = studio.get("/api/motions/file", params={"motion": file["files"][0]["motion"]})
    assert answer.status_code == 200, answer.text
    header = answer.headers["content-disposition"]
    assert "filename*=UTF-8''%E8%B9%B4" in header
    assert header.isascii()


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
    assert ("fbx" in answer["missing"]) == (find_program("blender") is None) and "glb" not in answer["missing"]


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


def test_people_of_one_file_are_clips_of_their_own(studio, wait_job, tmp_path):
    made_people.write_bvh(tmp_path / "two.bvh")
    answer = studio.post("/api/uploads", params={"name": "two.bvh"}, content=(tmp_path / "two.bvh").read_bytes())
    batch = answer.json()["batch"]
    motion = studio.get("/api/motions/info", params={"motion": answer.json()["files"][0]["motion"]})
    assert "Ben" in str(motion.json()["notes"]), motion.text
    job = wait_job(studio, studio.post("/api/jobs/add", json={"batch": batch}).json()["id"])
    assert job["state"] == "done", job
    found = [clip for clip in studio.app.state.studio.library.clips() if "two.bvh" in clip.path]
    assert sorted(clip.path.rpartition("#")[2] for clip in found) == ["person=Anna", "person=Ben"]
    for clip in found:
        for page in ("motions/info", "motions/file"):
            answer = studio.get(f"/api/{page}", params={"motion": f"clip:{clip.id}"})
            assert answer.status_code == 200, answer.text
