"""kill -9 at random moments of the studio's jobs: nothing is lost, and nothing stays behind.

In every round a studio starts on one home, its jobs of earlier rounds are looked at, work is given to it (uploads that
are added, trainings, exports, labels, evaluations, estimations), and it is killed at a random moment with that work
under way. Looked at are:

    library     whole for SQLite; the clips that were there are there, their motions can be read
    jobs        every job that was accepted is still known; none claims to be under way that is not
    processes   those that worked for it end by themselves
    files       no half-written file is left once the next studio has started
    resume      what was stopped is resumed and comes to its end
    second      in every tenth round: a second studio on the same library refuses and names the first

    python -m lab.reliability.studio_kill 100
"""

from __future__ import annotations

import argparse
import http.client
import json
import random
import re
import shutil
import sqlite3
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

from lab.benchmarks.studio_process import start_studio
from lab.reliability.studio_load import Client

KINDS = ("add", "train", "export", "estimate", "label", "evaluate", "upload")
LONGEST = 6.0  # s of work before the end
PATIENCE = 30.0  # s for processes to end, for which they have 15 s
RESUMABLE = ("add", "train", "export", "estimate")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("n", type=int, nargs="?", default=100, help="kills")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--port", default="8920")
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        found = Rounds(Path(name), chosen.seed, chosen.port).run(chosen.n)
    for line in found.tell():
        print(line)
    sys.exit(1 if found.faults else 0)


class Rounds:
    """A library, its studio, and what became of the two.

    Parameters
    ----------
    folder : to work in.
    seed : of the moments.
    port : of the studios.
    """

    def __init__(self, folder: Path, seed: int, port: str) -> None:
        from dousa.app.demo import write_library, write_performance
        from dousa.library import Library

        self.folder, self.port, self.chance = folder, port, random.Random(seed)
        self.motions = write_library(folder / "motions", n_performers=4)
        write_performance(folder / "truth.bvh", folder / "seen.npz")
        self.seen = (folder / "seen.npz").read_bytes()
        self.library = folder / "killed.dousa"
        with Library.open(self.library, create=True) as library:
            library.add([folder / "motions"])
            library.train(n_trees=20)
        self.home = folder / "killed.studio"
        self.jobs: dict[str, str] = {}  # accepted -> kind
        self.clips: set[int] = set()
        self.killed = 0.0  # when the last one was
        self.ending: list[int] = []  # processes of a studio that was killed
        self.counts: Counter[str] = Counter()
        self.faults: list[str] = []

    def run(self, n: int) -> Rounds:
        """Kill so many times, then resume what is left until it is done."""
        for number in range(n):
            self.kill_once(number)
            if (number + 1) % 10 == 0:
                print(f"{number + 1:4d} kills, {len(self.jobs)} jobs, {len(self.faults)} faults", flush=True)
        self.finish()
        return self

    def fail(self, what: str) -> None:
        self.faults.append(what)
        print(f"FAULT: {what}", flush=True)

    # --- one round

    def kill_once(self, number: int) -> None:
        process, port, token = start_studio(self.library, "--port", self.port)
        client = Client(port, token)
        try:
            self.wait_for_end(number)
            self.look(client, number)
            if number % 10 == 0:
                self.try_second(port, number)
            kind = self.give_work(client)
            time.sleep(self.chance.uniform(0.0, LONGEST))
            self.ending = find_children(process.pid)
            busy = [job for job in ask(client, "GET", "/api/jobs?limit=500")["jobs"] if job["state"] == "running"]
            self.counts["killed with a job running"] += bool(busy)
            self.counts[f"given: {kind}"] += 1
        finally:
            process.kill()
            process.wait()
            self.killed = time.time()
        if self.chance.random() < 0.5:  # else the next studio starts at once
            self.wait_for_end(number)
        self.check_library(number)

    def look(self, client: Client, number: int) -> None:
        """What the studio says after the end of the one before."""
        jobs = {job["id"]: job for job in ask(client, "GET", "/api/jobs?limit=500")["jobs"]}
        for job_id in self.jobs:
            if job_id not in jobs:
                self.fail(f"round {number}: job {self.jobs[job_id]} {job_id} is lost")
        for job in jobs.values():
            if job["state"] in ("running", "stopping", "queued"):
                self.fail(f"round {number}: {job['kind']} {job['id']} claims to be {job['state']}")
        if left := [path for path in self.home.rglob("*.part") if path.stat().st_mtime < self.killed]:
            self.fail(f"round {number}: half-written {[path.name for path in left][:3]}")
        if bare := [path.name for path in (self.home / "jobs").iterdir() if not (path / "job.json").exists()]:
            self.counts["folders of jobs that were never accepted"] += len(bare)
        stopped = [job for job in jobs.values() if job["state"] == "stopped" and job["resumable"]]
        if stopped and self.chance.random() < 0.5:
            client.ask("POST", f"/api/jobs/{self.chance.choice(stopped)['id']}/resume")
            self.counts["resumed at once"] += 1

    def give_work(self, client: Client) -> str:
        kind = self.chance.choice(KINDS)
        ids = [item["id"] for item in ask(client, "GET", "/api/clips?limit=200")["items"]]
        self.clips |= set(ids)
        one, other = self.chance.sample(ids, 2)
        works: dict[str, Callable[[], Any]] = {
            "add": lambda: {"batch": self.upload(client, self.chance.randrange(1, 12))},
            "train": lambda: {"n_trees": self.chance.choice((10, 100))},
            "export": lambda: {"clips": ids, "to": self.chance.choice(("bvh", "glb"))},
            "estimate": lambda: {
                "batch": self.upload_seen(client),
                "frames": "0:30",
            },
            "label": lambda: {"take": {"motion": f"clip:{one}"}},
            "evaluate": lambda: {"references": [{"motion": f"clip:{one}"}], "performance": {"motion": f"clip:{other}"}},
        }
        if kind == "upload":  # one under way, of which only a part came
            self.begin_upload(client)
            return kind
        job = ask(client, "POST", f"/api/jobs/{kind}", works[kind]())
        self.jobs[job["id"]] = kind
        return kind

    def upload(self, client: Client, count: int) -> str:
        batch = ""
        for path in self.chance.sample(self.motions, count):
            content = re.sub(
                rb"Frame Time: *\S+", b"Frame Time: %.6f" % self.chance.uniform(0.02, 0.03), path.read_bytes()
            )
            more = f"&batch={batch}" if batch else ""
            name = f"new/{self.chance.randrange(10**9)}.bvh"
            status, answer = client.ask("POST", f"/api/uploads?name={name}{more}", content)
            assert status == 201, answer
            batch = json.loads(answer)["batch"]
        return batch

    def upload_seen(self, client: Client) -> str:
        answer = client.ask("POST", "/api/uploads?name=seen.npz", self.seen)
        return str(json.loads(answer[1])["batch"])

    def begin_upload(self, client: Client) -> None:
        connection = client.connection
        connection.putrequest("POST", "/api/uploads?name=half/way.bvh")
        connection.putheader("authorization", f"Bearer {client.token}")
        connection.putheader("content-length", "500000")
        connection.endheaders()
        connection.send(self.motions[0].read_bytes()[:50_000])
        self.half = client.connection  # stays open
        client.connection = type(connection)("127.0.0.1", client.port, timeout=120)

    def try_second(self, port: int, number: int) -> None:
        command = [sys.executable, "-m", "dousa.app.cli.main", "studio", str(self.library), "--no-browser"]
        done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
        if f":{port}/" not in done.stderr:
            self.fail(f"round {number}: a second studio said {done.stderr[-200:]!r}")
        self.counts["second studios refused"] += 1

    # --- after a kill

    def wait_for_end(self, number: int) -> None:
        end = time.monotonic() + PATIENCE
        while alive := [pid for pid in self.ending if is_alive(pid)]:
            if time.monotonic() > end:
                self.fail(f"round {number}: processes {alive} are still there")
                return
            time.sleep(0.05)
        self.counts["processes that ended with their studio"] += len(self.ending)
        self.ending = []

    def check_library(self, number: int) -> None:
        with sqlite3.connect(self.library) as connection:
            if connection.execute("PRAGMA integrity_check").fetchone() != ("ok",):
                self.fail(f"round {number}: the library is damaged")
            if connection.execute("PRAGMA foreign_key_check").fetchall():
                self.fail(f"round {number}: rows of the library point nowhere")
        from dousa.library import Library

        with Library.open(self.library) as library:
            there = {clip.id: clip for clip in library.clips()}
            if lost := self.clips - set(there):
                self.fail(f"round {number}: clips {sorted(lost)[:5]} are lost")
            for clip in self.chance.sample(sorted(there.values(), key=lambda one: one.id), 5):
                assert library.trajectories(clip.id).n_frames == clip.n_frames

    def finish(self) -> None:
        """What was stopped is resumed, each to its end."""
        process, port, token = start_studio(self.library, "--port", self.port)
        client = Client(port, token)
        try:
            self.look(client, -1)
            self.wait_for_end(-1)
            for job in ask(client, "GET", "/api/jobs?limit=500")["jobs"]:
                if job["state"] == "stopped" and job["resumable"]:
                    client.ask("POST", f"/api/jobs/{job['id']}/resume")
            while any(
                job["state"] in ("queued", "running") for job in ask(client, "GET", "/api/jobs?limit=500")["jobs"]
            ):
                time.sleep(0.3)
            for job in ask(client, "GET", "/api/jobs?limit=500")["jobs"]:
                self.counts[f"at the end {job['state']}: {job['kind']}"] += 1
                if job["kind"] in RESUMABLE and job["state"] != "done":
                    self.fail(f"at the end {job['kind']} is {job['state']}: {job['problem']}")
        finally:
            process.kill()
            process.wait()
        self.check_library(-1)
        shutil.rmtree(self.home)

    def tell(self) -> list[str]:
        lines = [f"{count:5d}  {what}" for what, count in sorted(self.counts.items())]
        return [*lines, f"{len(self.jobs):5d}  jobs accepted", f"{len(self.faults):5d}  faults", *self.faults]


def ask(client: Client, method: str, path: str, body: Any = None) -> Any:
    try:
        status, answer = client.ask(method, path, body)
    except http.client.RemoteDisconnected:  # a connection at rest for half a minute is closed
        status, answer = client.ask(method, path, body)
    assert status < 400, (path, status, answer[:300])
    return json.loads(answer)


def find_children(pid: int) -> list[int]:
    """Processes that a process has started and that live, and those of theirs."""
    found = []
    for task in Path(f"/proc/{pid}/task").iterdir():
        found += [int(child) for child in (task / "children").read_text().split()]
    return found + [other for child in found for other in (find_children(child) if is_alive(child) else [])]


def is_alive(pid: int) -> bool:
    """Whether a process runs; one that has ended and that nobody has looked for does not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


if __name__ == "__main__":
    main()
