"""Files that lie, work that does not end, disks that are full, libraries that go away."""

import errno
import io
import json
import os
import shutil
import struct
import time
import zipfile
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from app.studio.conftest import TOKEN, list_below, send
from dousa.app.studio import Settings
from dousa.app.studio.core import uploads
from dousa.app.studio.core.answers import status_of
from dousa.app.studio.jobs import lanes
from dousa.app.studio.work.worker import JOBS
from dousa.errors import DousaError, LibraryError, MotionWriteError
from dousa.formats import read_motion
from dousa.motion import CANONICAL_JOINTS
from patience import PATIENCE

GOOD = b"HIERARCHY\nROOT Hips\n"


def take(rate: float, n_frames: int = 50) -> bytes:
    """A motion of dousa's own kind."""
    buffer = io.BytesIO()
    np.savez(
        buffer,
        format=np.array("dousa motion"),
        version=np.array(1),
        kind=np.array("trajectories"),
        names=np.array(CANONICAL_JOINTS),
        frame_rate=np.array(rate),
        positions=np.random.default_rng(0).random((n_frames, 20, 3)),
    )
    return buffer.getvalue()


# --- files


@pytest.fixture
def reads_itself(studio, monkeypatch):
    """A studio that reads uploads in its own process, where tests can change how."""
    monkeypatch.setattr(studio.app.state.studio.reader, "run", lambda function, *args, seconds=0.0: function(*args))
    return studio


def test_an_archive_whose_list_is_endless_is_refused(reads_itself, monkeypatch, tmp_path):
    monkeypatch.setattr(uploads, "_MOST_AT_ONCE", 2_000)
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as packed:
        for number in range(100):
            packed.writestr(f"{number}.bvh", GOOD)
    before = list_below(tmp_path)
    assert reads_itself.post("/api/uploads?name=a.zip", content=buffer.getvalue()).status_code == 413
    assert list_below(tmp_path) == before


@pytest.mark.parametrize("suffix", ["mp4", "avi", "mov", "mkv", "webm", "jpg", "bmp", "tif"])
@pytest.mark.parametrize("content", [b"#EXTM3U\n#EXTINF:1,\nfile:///etc/passwd\n", b"ffconcat version 1.0\nfile x\n"])
def test_lists_of_addresses_are_no_films(studio, suffix, content):
    assert studio.post(f"/api/uploads?name=v.{suffix}", content=content).status_code == 415


@pytest.mark.parametrize("rate", [1e-6, 1e-300])
def test_a_motion_of_years_is_refused_before_it_fills_the_memory(studio, rate):
    motion = send(studio, "slow.npz", take(rate))["files"][0]["motion"]
    for path in ("info", "player", "miniature", "file"):
        answer = studio.get(f"/api/motions/{path}", params={"motion": motion})
        assert answer.status_code == 422, answer.text
    pair = {"motion": "clip:1", "other": motion}
    assert studio.get("/api/motions/pair", params=pair).status_code == 422


def test_a_motion_of_many_hours_is_refused(studio):
    motion = send(studio, "long.npz", take(1.0, 11_000))["files"][0]["motion"]
    answer = studio.get("/api/motions/player", params={"motion": motion})
    assert answer.status_code == 422
    assert "hours" in answer.json()["problem"]


def test_evaluations_that_would_take_for_ever_are_refused(studio, wait_job):
    motion = send(studio, "long.npz", take(5.0, 2_990))["files"][0]["motion"]
    wanted = {"references": [{"motion": motion}] * 4, "performance": {"motion": motion}}
    job = wait_job(studio, studio.post("/api/jobs/evaluate", json=wanted).json()["id"])
    assert job["state"] == "failed"
    assert "fewer takes" in job["problem"]


def test_skeletons_are_not_taken_from_outside(studio, tmp_path):
    """An AMC looks for its ASF in the folders above, but not in those above the studio's files."""
    (tmp_path / "private.asf").write_text(":version 1.10\n:name private\n")
    motion = send(studio, "walk.amc", b"#!OML:ASF x\n:FULLY-SPECIFIED\n:DEGREES\n1\nroot 0 0 0 0 0 0\n")["files"][0]
    answer = studio.get("/api/motions/info", params={"motion": motion["motion"]})
    assert answer.status_code == 422
    assert "private" not in answer.text
    assert "no .asf skeleton" in answer.json()["problem"]


def test_a_key_of_thousands_of_parts_is_refused(tmp_path):
    from dousa.errors import BodyModelError, CalibrationError
    from dousa.estimation.body.body_file import read_body
    from dousa.estimation.cameras.camera_files import read_cameras

    path = tmp_path / "deep.toml"
    path.write_text("stature = 1.7\n" + "a." * 50_000 + "b = 1\n")
    with pytest.raises(BodyModelError, match="too deep"):
        read_body(path)
    with pytest.raises(CalibrationError):
        read_cameras(path)


def test_tables_of_this_machine_are_not_read(studio, wait_job, tmp_path):
    (tmp_path / "secret.csv").write_text("file,category\na.bvh,secret\n")
    batch = send(studio, "a.bvh", GOOD)["batch"]
    for rule in ("csv:/etc/passwd", f"csv:{tmp_path}/secret.csv", "csv:../../../secret.csv", "csv:~/x.csv"):
        job = studio.post("/api/jobs/add", json={"batch": batch, "category_from": rule}).json()
        assert wait_job(studio, job["id"])["state"] == "failed"


def wait_until_begun(studio, job, seconds=PATIENCE):
    late = time.monotonic() + seconds
    while studio.get(f"/api/jobs/{job}").json()["total"] == 0:
        assert time.monotonic() < late, "the job does not say that it has begun"
        time.sleep(0.05)


@pytest.mark.skipif(os.name != "posix", reason="stops processes by signals")
def test_an_expression_without_end_can_be_stopped(studio, bvh, wait_job):
    batch = send(studio, "a" * 40 + "!.bvh", bvh.read_bytes() + b"\n")["batch"]
    job = studio.post("/api/jobs/add", json={"batch": batch, "category_from": "name:(a+)+$"}).json()
    wait_until_begun(studio, job["id"])
    studio.post(f"/api/jobs/{job['id']}/stop")
    assert wait_job(studio, job["id"])["state"] == "stopped"


@pytest.mark.skipif(os.name != "posix", reason="stops processes by signals")
def test_work_that_does_not_hear_ctrl_c_is_ended(studio, wait_job, monkeypatch):
    import sys

    step = {"progress": [0, 1, {"code": "text.verbatim", "values": {"text": "deaf"}}]}
    deaf = (
        "import signal, time; signal.signal(signal.SIGINT, signal.SIG_IGN); "
        f"print({lanes.READY.strip()!r}, {json.dumps(step)!r}, sep=chr(10), flush=True); time.sleep(600)"
    )
    real = lanes.subprocess.Popen
    monkeypatch.setitem(lanes._await_end.__kwdefaults__, "patience_s", 0.3)
    monkeypatch.setattr(
        lanes.subprocess, "Popen", lambda words, **options: real([sys.executable, "-c", deaf], **options)
    )
    job = studio.post("/api/jobs/train", json={}).json()
    wait_until_begun(studio, job["id"])
    studio.post(f"/api/jobs/{job['id']}/stop")
    assert wait_job(studio, job["id"], 30)["state"] == "stopped"


def test_names_of_a_relative_library_are_told_without_folders(library_copy, bvh, wait_job, monkeypatch):
    from pathlib import Path

    from starlette.testclient import TestClient

    from dousa.app.studio import create_app

    monkeypatch.chdir(library_copy.parent)
    app = create_app(Settings(Path(library_copy.name), token=TOKEN))
    with TestClient(app, "http://127.0.0.1:8765", headers={"authorization": f"Bearer {TOKEN}"}) as client:
        batch = send(client, "kick/bad.bvh", GOOD + b"nonsense")["batch"]
        job = wait_job(client, client.post("/api/jobs/add", json={"batch": batch}).json()["id"])
        assert job["result"]["skipped"][0]["path"] == "kick/bad.bvh"


# --- the disk and the library


@pytest.mark.parametrize("place", [".upload", ".member"])
def test_a_full_disk_is_one_sentence_and_nothing_stays(reads_itself, place, monkeypatch, tmp_path):
    def refuse(content):
        raise OSError(errno.ENOSPC, "No space left on device")

    def open_on_full_disk(path, mode):
        full = nullcontext(SimpleNamespace(write=refuse))
        return full if Path(path).name.startswith(place) and "x" in mode else open(path, mode)

    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as packed:
        packed.writestr("a.bvh", GOOD)
    before = list_below(tmp_path)
    monkeypatch.setattr(uploads, "open", open_on_full_disk, raising=False)
    answer = reads_itself.post("/api/uploads?name=a.zip", content=buffer.getvalue())
    assert answer.status_code == 507
    assert "disk is full" in answer.json()["problem"]
    assert list_below(tmp_path) == before


def test_a_full_disk_of_the_library_is_told_as_such():
    assert status_of(LibraryError("library_file.disk_full", library="a.dousa")) == 507
    assert status_of(MotionWriteError("a.bvh", "disk.full")) == 507


def test_a_library_that_is_taken_away_is_not_written_to(studio, library_copy, bvh, wait_job):
    moved = library_copy.with_name("moved")
    library_copy.rename(moved)
    wanted = {"clips": [1], "category": "lost"}
    for answer in (studio.get("/api/info"), studio.get("/api/clips"), studio.post("/api/clips/relabel", json=wanted)):
        assert answer.status_code == 404
        assert "gone" in answer.json()["problem"]
    batch = send(studio, "x/a.bvh", bvh.read_bytes() + b"\n")["batch"]
    job = studio.post("/api/jobs/add", json={"batch": batch}).json()
    assert wait_job(studio, job["id"])["state"] == "failed"
    assert not library_copy.exists()  # no empty one in its place
    moved.rename(library_copy)
    assert studio.post("/api/clips/relabel", json=wanted).json()["changed"] == 1


def test_a_library_that_is_replaced_is_the_one_that_is_shown(studio, library_copy, trained_library):
    assert studio.post("/api/clips/remove", json={"clips": [1, 2]}).json()["removed"] == 2
    assert studio.get("/api/clips").json()["total"] == 22
    other = shutil.copy(trained_library, library_copy.with_name("other"))
    os.replace(other, library_copy)
    for name in ("-wal", "-shm"):
        library_copy.with_name(library_copy.name + name).unlink(missing_ok=True)
    assert studio.get("/api/clips").json()["total"] == 24


def test_a_motion_whose_file_is_gone_is_told(studio):
    motions = studio.app.state.studio.motions
    from dousa.app.studio.content.motions import MotionRef

    with pytest.raises(DousaError, match="not there any more"):
        motions._from_file(library_gone := studio.app.state.studio.workspace.root / "x.bvh", MotionRef(motion="clip:1"))
    assert not library_gone.exists()


@pytest.mark.parametrize(
    ("work", "code"),
    [
        ((np.ones, 10**9), "studio_jobs.no_memory"),
        ((time.sleep, PATIENCE), "studio_jobs.took_long"),
        ((os._exit, 1), "studio_jobs.no_answer"),
        ((read_motion, "nowhere.bvh"), "disk.missing"),
    ],
)
def test_what_a_file_does_to_its_reader_does_not_reach_the_studio(studio, work, code):
    reader = studio.app.state.studio.reader
    with pytest.raises(DousaError) as caught:
        reader.run(*work, seconds=1.0 if code.endswith("long") else PATIENCE)
    assert caught.value.code == code
    assert reader.run(len, "goes on") == 7


def test_every_kind_of_work_is_there():
    assert all(callable(lanes.load_work(name)) for name, _, _ in JOBS.values())


def test_markup_in_names_stays_text(studio, wait_job):
    """The parts of a report are set into the page as they are: names and labels in them must be escaped."""
    label = '</script><img src=x onerror="alert(1)">'
    wanted = {"references": [{"motion": "clip:1"}], "performance": {"motion": "clip:2"}}
    wanted["furi"] = [{"start_s": 0, "end_s": 0.5, "label": label}]
    studio.post("/api/clips/relabel", json={"clips": [1, 2], "category": "<img src=x onerror=alert(2)>"})
    job = wait_job(studio, studio.post("/api/jobs/evaluate", json=wanted).json()["id"])
    assert job["state"] == "done", job["problem"]
    report = studio.get(f"/api/evaluations/{job['id']}/report").json()
    markup = json.dumps(report["parts"]) + json.dumps(report["frame"])
    assert "<img src=x" not in markup
    page = studio.get(f"/api/evaluations/{job['id']}/report.html").text
    assert "<img src=x" not in page
    assert "</script><img" not in page


def test_c3d_that_points_at_itself_ends(studio):
    head = struct.pack("<BBHHHHHfHHf", 2, 0x50, 20, 0, 1, 50, 0, -0.001, 3, 0, 100.0).ljust(512, b"\0")
    loop = bytes([1, 0x50, 255, 84, 5, 255]) + b"POINT" + struct.pack("<h", -7)
    motion = send(studio, "loop.c3d", head + loop.ljust(512, b"\0"))["files"][0]["motion"]
    assert studio.get("/api/motions/info", params={"motion": motion}).status_code == 422
