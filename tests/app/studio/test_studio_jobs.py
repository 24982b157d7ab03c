"""Jobs: queued in lanes, stopped, taken up again, kept over a restart; and processes that end badly."""

import json
import os
import signal
import subprocess
import sys
import threading
import time

import pytest

from dousa.app.studio.core.answers import RefusedError
from dousa.app.studio.core.workspace import Workspace
from dousa.app.studio.jobs import lanes
from dousa.app.studio.jobs.board import Job, JobBoard, JobStopped, Lane
from dousa.app.studio.jobs.lanes import start_worker
from dousa.errors import OptionError
from dousa.messages import Message
from patience import PATIENCE

pytestmark = pytest.mark.plain_workers


class Work:
    """Work that goes on until it is let go or stopped."""

    def __init__(self) -> None:
        self.go = threading.Event()
        self.ran: list[str] = []

    def run(self, job, board, stop):
        self.ran.append(job.title)
        board.change(job, done=1, total=2, what=Message("text.verbatim", text="half"))
        while not self.go.wait(0.005):
            if stop.is_set():
                raise JobStopped
        return {"title": job.title}


@pytest.fixture
def work():
    return Work()


@pytest.fixture
def board(tmp_path, work):
    def fail(job, board, stop):
        raise OptionError("text.verbatim", text="one clear sentence")

    def crash(job, board, stop):
        raise ZeroDivisionError("a fault")

    kinds = {
        "slow": Lane("one", work.run, resumable=True),
        "other": Lane("two", work.run),
        "bad": Lane("three", fail),
        "crash": Lane("three", crash),
    }
    made = JobBoard(Workspace(tmp_path / "home"), kinds)
    yield made
    work.go.set()
    made.close()


def until(condition, seconds=PATIENCE):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.005)


def test_a_lane_does_one_thing_at_a_time_and_lanes_do_not_wait_for_each_other(board, work):
    first, second, other = (board.submit(kind, {}, kind + str(k)) for k, kind in enumerate(("slow", "slow", "other")))
    until(lambda: first.state == other.state == "running")
    assert second.state == "queued"
    work.go.set()
    until(lambda: second.state == "done")
    assert second.result == {"title": "slow1"}
    assert work.ran.index("slow0") < work.ran.index("slow1")


def test_stopping_and_taking_up(board, work):
    job = board.submit("slow", {}, "slow")
    until(lambda: job.state == "running")
    board.stop(job.id)
    until(lambda: job.state == "stopped")
    board.resume(job.id)
    work.go.set()
    until(lambda: job.state == "done")
    with pytest.raises(RefusedError, match="cannot be resumed"):
        board.resume(job.id)


def test_what_cannot_be_taken_up_says_so(board):
    job = board.submit("other", {}, "other")
    until(lambda: job.state == "running")
    board.stop(job.id)
    until(lambda: job.state == "stopped")
    with pytest.raises(RefusedError, match="start a new one"):
        board.resume(job.id)


def test_problems_are_sentences_and_faults_do_not_end_the_lane(board):
    bad, crash, again = (board.submit(kind, {}, kind) for kind in ("bad", "crash", "bad"))
    until(lambda: again.state == "failed")
    assert str(bad.problem) == "one clear sentence"
    assert "ZeroDivisionError" in str(crash.problem)
    assert "a fault" in (board.folder(crash) / "log.txt").read_text()


def test_jobs_are_there_after_a_restart(board, work, tmp_path):
    running, waiting = board.submit("slow", {"a": 1}, "first"), board.submit("slow", {}, "second")
    until(lambda: running.state == "running")
    later = JobBoard(Workspace(tmp_path / "home"), {"slow": Lane("one", work.run, resumable=True)})
    assert {job.id: job.state for job in later.all()} == {running.id: "stopped", waiting.id: "stopped"}
    assert later.get(running.id).request == {"a": 1}
    work.go.set()
    later.resume(running.id)
    until(lambda: later.get(running.id).state == "done")
    later.close()


@pytest.mark.parametrize(
    "content", [b"", b"{", b"[]", b"null", b'{"id": "x"}', b'{"id": 3, "kind": "slow", "title": ""}']
)
def test_damaged_records_are_left_out(board, tmp_path, work, content):
    folder = tmp_path / "home" / "jobs" / ("ab" * 8)
    folder.mkdir()
    (folder / "job.json").write_bytes(content)
    later = JobBoard(Workspace(tmp_path / "home"), {"slow": Lane("one", work.run)})
    assert later.all() == []


def test_not_more_jobs_than_anybody_can_mean(board):
    with pytest.raises(RefusedError, match="jobs are waiting"):
        for _ in range(60):
            board.submit("slow", {}, "slow")


def test_removing(board, work):
    job = board.submit("slow", {}, "slow")
    with pytest.raises(RefusedError, match="stop it first"):
        board.remove(job.id)
    work.go.set()
    until(lambda: job.state == "done")
    board.remove(job.id)
    assert board.all() == []
    assert not board.folder(job).exists()
    with pytest.raises(RefusedError, match="no job"):
        board.get(job.id)


def test_what_others_were_made_from_is_kept_as_long_as_they_are(board, work):
    work.go.set()
    masks = board.submit("slow", {}, "masks")
    until(lambda: masks.state == "done")
    corrected = board.submit("slow", {"masks": masks.id}, "corrected")
    until(lambda: corrected.state == "done")
    with pytest.raises(RefusedError, match=r"made from this one \(corrected\); forget it first"):
        board.remove(masks.id)
    board.remove(corrected.id)
    board.remove(masks.id)


def worker_of(studio):
    """The process that works for a studio of this test."""
    found = subprocess.run(
        ["pgrep", "-P", str(os.getpid()), "-f", "dousa.app.studio.work.worker"],
        capture_output=True,
        text=True,
        check=False,
    )
    return [int(line) for line in found.stdout.split()]


@pytest.mark.skipif(os.name != "posix", reason="looks for processes by pgrep")
def test_a_process_that_dies_is_told_and_the_work_can_be_taken_up(studio, wait_job):
    job = studio.post("/api/jobs/train", json={}).json()
    until(lambda: worker_of(studio))
    os.kill(worker_of(studio)[0], signal.SIGKILL)
    job = wait_job(studio, job["id"])
    assert job["state"] == "failed"
    assert "ended unexpectedly" in job["problem"]
    assert studio.post(f"/api/jobs/{job['id']}/resume").status_code == 200
    assert wait_job(studio, job["id"])["state"] == "done"


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        ("""for one in '5', '[1]', '{"progress": 3}', '{"problem": {}}', '{': print(one)\nexit(1)""", "(code 1)"),
        ("import sys; sys.stderr.write('the last word\\n'); exit(3)", "the last word"),
        ("""print('progress'); print('{"result": {"clips": 1}}'); import time; time.sleep(100)""", None),
    ],
)  # fmt: skip
def test_lines_that_are_no_messages_leave_no_job_hanging(studio, wait_job, monkeypatch, lines, said):
    """A worker that writes anything, ends at any moment, or does not end after its answer: the job has an end."""

    def start(settings, kind, request, folder, errors):
        program = f"import functools; print = functools.partial(print, flush=True); print('ready'); input()\n{lines}"
        command = [sys.executable, "-c", program]
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": errors}
        return subprocess.Popen(command, start_new_session=True, **pipes), b"{}\n"

    monkeypatch.setattr(lanes, "start_worker", start)
    monkeypatch.setitem(lanes._await_end.__kwdefaults__, "patience_s", 0.2)
    job = wait_job(studio, studio.post("/api/jobs/train", json={}).json()["id"])
    if said is None:
        assert (job["state"], job["result"]) == ("done", {"clips": 1})
    else:
        assert job["state"] == "failed"
        assert "\n" not in job["problem"] and said in job["problem"]


def test_a_fault_in_a_process_is_a_sentence_and_the_log_says_where(studio, wait_job, monkeypatch):
    request = {"no": "such option"}  # what no request of a page has
    job = studio.app.state.studio.jobs.submit("train", request, "a")
    job = wait_job(studio, job.id)
    assert job["state"] == "failed"
    assert "unexpected" in job["problem"] and "\n" not in job["problem"]


@pytest.mark.skipif(os.name != "posix", reason="looks for processes by pgrep")
def test_a_stopped_process_is_gone_and_the_library_is_as_it_was(studio, wait_job):
    before = studio.get("/api/info").json()["library"]
    job = studio.post("/api/jobs/train", json={"n_trees": 2000}).json()
    until(lambda: studio.get(f"/api/jobs/{job['id']}").json()["total"] > 0, 60)
    studio.post(f"/api/jobs/{job['id']}/stop")
    assert wait_job(studio, job["id"])["state"] == "stopped"
    assert worker_of(studio) == []
    assert studio.get("/api/info").json()["library"] == before


@pytest.fixture
def deaf():
    """Ctrl-C is ignored here, as in what a script starts in the background; processes inherit that."""
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.skipif(os.name != "posix", reason="other systems have no such signal")
def test_work_can_be_stopped_where_ctrl_c_is_ignored(deaf, studio, tmp_path):
    settings = studio.app.state.studio.settings
    process, task = start_worker(settings, "train", {"n_trees": 2000}, tmp_path, subprocess.DEVNULL)
    with process:
        process.stdin.write(task)
        process.stdin.flush()
        assert "ready" in json.loads(process.stdout.readline())
        assert "progress" in json.loads(process.stdout.readline())
        process.send_signal(signal.SIGINT)
        assert json.loads(process.stdout.readlines()[-1]) == {"stopped": True}


@pytest.mark.skipif(os.name != "posix", reason="other systems have no such signal")
def test_a_job_stopped_at_once_stops_where_ctrl_c_is_ignored(deaf, studio, wait_job):
    """The signal may come before the process is ready to hear it."""
    job = studio.post("/api/jobs/train", json={}).json()
    studio.post(f"/api/jobs/{job['id']}/stop")
    assert wait_job(studio, job["id"])["state"] == "stopped"


def test_training_fails_with_a_sentence(studio, wait_job):
    ids = [clip.id for clip in studio.app.state.studio.library.clips()]
    studio.app.state.studio.library.remove(ids)
    job = wait_job(studio, studio.post("/api/jobs/train", json={}).json()["id"])
    assert job["state"] == "failed"
    assert "categor" in job["problem"]


def test_who_reads_a_job_that_ends_sees_its_result_before_it_is_done(board, work):
    seen = []

    class Watched(Job):
        def __setattr__(self, name, value):
            super().__setattr__(name, value)
            seen.append(name)

    job = Watched("0" * 16, "short", "a", {})
    board.folder(job).mkdir(parents=True)
    seen.clear()
    board.change(job, state="done", result={}, finished_s=1.0)
    assert seen.index("state") == 2
