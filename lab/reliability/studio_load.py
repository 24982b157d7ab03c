"""An hour of mixed use: does the studio's memory grow?

The studio runs in a process of its own on a copy of a library; programs ask it all the time for everything that its
pages ask for: lists, thumbnails, searches of clips and of uploaded files, pairs, labels, evaluations that are adjusted,
files that are uploaded, added and removed again, now and then an estimation or a training. Its resident memory is read
every 10 s; the claim is about what comes after the first ten minutes, when everything that is kept has been kept: it
stays within 5 %.

    python -m lab.reliability.studio_load --minutes 60
    python -m lab.reliability.studio_load --minutes 60 --rest 0.6
"""

from __future__ import annotations

import argparse
import http.client
import json
import os
import random
import re
import shutil
import signal
import subprocess
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from lab.benchmarks.studio_process import start_studio

N_CLIENTS = 3
REST = 0.02  # s between the requests of one client: a machine that is used, not one that is stormed
SETTLED = 600.0  # s after which memory is to be flat


class Client:
    """One program that asks, over one connection."""

    def __init__(self, port: int, token: str) -> None:
        self.port, self.token = port, token
        self.connection = http.client.HTTPConnection("127.0.0.1", port, timeout=600)

    def ask(self, method: str, path: str, body: Any = None) -> tuple[int, bytes]:
        headers = {"authorization": f"Bearer {self.token}"}
        if isinstance(body, dict):
            body, headers["content-type"] = json.dumps(body).encode(), "application/json"
        try:
            self.connection.request(method, path, body, headers)
            answer = self.connection.getresponse()
            return answer.status, answer.read()
        except (OSError, http.client.HTTPException):
            self.connection.close()
            raise


def use(client: Client, ids: list[int], takes: list[int], motion: bytes, chance: random.Random) -> tuple[str, int]:
    """One thing that somebody does; its name and the status of the answer."""
    one, other = chance.choice(ids), chance.choice(ids)
    some = chance.sample(ids, min(24, len(ids)))
    search = {"query": {"motion": f"clip:{one}"}, "k": 12, "explain": chance.random() < 0.3}
    deeds: dict[str, tuple[float, Any]] = {
        "search": (30, lambda: client.ask("POST", "/api/search", search)),
        "list": (15, lambda: client.ask("GET", f"/api/clips?offset={chance.randrange(200)}&limit=60")),
        "thumbnails": (15, lambda: client.ask("POST", "/api/clips/thumbnails", {"clips": some})),
        "player": (10, lambda: client.ask("GET", f"/api/motions/player?motion=clip:{one}")),
        "pair": (10, lambda: client.ask("GET", f"/api/motions/pair?motion=clip:{one}&other=clip:{other}")),
        "bvh": (2, lambda: client.ask("GET", f"/api/motions/file?motion=clip:{one}")),
        "page": (
            5,
            lambda: client.ask("GET", f"/{chance.choice(['library', 'search', 'takes', 'evaluate'])}"),
        ),
        "add": (0.3, lambda: add_and_remove(client, motion, chance)),
        "train": (0.03, lambda: follow(client, client.ask("POST", "/api/jobs/train", {"n_trees": 20}))),
        "upload": (3, lambda: upload_and_search(client, motion, chance)),
        "evaluate": (1, lambda: evaluate(client, one, other)),
        "label": (1, lambda: label(client, takes, chance)),
        "estimate": (0.03, lambda: estimate(client)),
        "jobs": (10, lambda: client.ask("GET", "/api/jobs")),
    }
    name = chance.choices(list(deeds), [weight for weight, _ in deeds.values()])[0]
    return name, deeds[name][1]()[0]


def upload_and_search(client: Client, motion: bytes, chance: random.Random) -> tuple[int, bytes]:
    """A file comes, is asked for, and goes again."""
    status, answer = client.ask("POST", f"/api/uploads?name=query{chance.randrange(10**6)}.bvh", motion)
    if status != 201:
        return status, answer
    came = json.loads(answer)
    said = client.ask("POST", "/api/search", {"query": {"motion": came["files"][0]["motion"]}, "k": 5})
    client.ask("DELETE", f"/api/uploads/{came['batch']}")
    return said


def add_and_remove(client: Client, motion: bytes, chance: random.Random) -> tuple[int, bytes]:
    """A file that the library does not have yet is added, and its clip is removed."""
    other = re.sub(rb"Frame Time: *\S+", b"Frame Time: %.6f" % chance.uniform(0.02, 0.03), motion)
    status, answer = client.ask("POST", f"/api/uploads?name=added/{chance.randrange(10**9)}.bvh", other)
    if status != 201:
        return status, answer
    batch = json.loads(answer)["batch"]
    said = follow(client, client.ask("POST", "/api/jobs/add", {"batch": batch}))
    clips = json.loads(client.ask("GET", f"/api/clips?batch={batch}")[1])["items"]
    if said[0] != 200 or not clips:
        return (599, b"nothing was added") if said[0] == 200 else said
    return client.ask("POST", "/api/clips/remove", {"clips": [clip["id"] for clip in clips]})


def evaluate(client: Client, one: int, other: int) -> tuple[int, bytes]:
    wanted = {"references": [{"motion": f"clip:{other}"}], "performance": {"motion": f"clip:{one}"}}
    look = [
        ("GET", "/api/evaluations/{id}/report", None),
        ("POST", "/api/evaluations/{id}/adjust", {"weights": {"left_leg": 0.5}, "furi": None}),
    ]
    return follow(client, client.ask("POST", "/api/jobs/evaluate", wanted), look)


def estimate(client: Client) -> tuple[int, bytes]:
    """The example of the page, some frames of it."""
    status, answer = client.ask("POST", "/api/estimations/example", {})
    if status != 201:
        return status, answer
    wanted = {"batch": json.loads(answer)["batch"], "frames": "0:8"}
    look = [
        (method, f"/api/estimations/{{id}}/{what}", None) for method, what in (("GET", "player"), ("GET", "frames"))
    ]
    return follow(client, client.ask("POST", "/api/jobs/estimate", wanted), look)


def label(client: Client, takes: list[int], chance: random.Random) -> tuple[int, bytes]:
    if not takes:
        return 200, b""
    wanted = {"take": {"motion": f"clip:{chance.choice(takes)}"}}
    return follow(client, client.ask("POST", "/api/jobs/label", wanted))


def follow(client: Client, said: tuple[int, bytes], look: Sequence[tuple[str, str, Any]] = ()) -> tuple[int, bytes]:
    """Wait for a job, look at what came of it, and forget it."""
    if said[0] != 202:
        return said
    job = json.loads(said[1])
    while job["state"] in ("queued", "running", "stopping"):
        time.sleep(0.05)
        job = json.loads(client.ask("GET", f"/api/jobs/{job['id']}")[1])
    for method, path, body in look:
        status, answer = client.ask(method, path.format(id=job["id"]), body)
        if status >= 400:
            print(path, status, answer[:300], flush=True)
            return status, answer
    client.ask("DELETE", f"/api/jobs/{job['id']}")
    return (200 if job["state"] == "done" else 599), json.dumps(job).encode()


def resident(pid: int) -> float:
    """MB of a process."""
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


def make_library(folder: Path) -> tuple[Path, bytes]:
    """The demo's library with a take, trained; and a motion file to upload."""
    from dousa.app.demo import write_dance, write_library
    from dousa.library import Library

    files = write_library(folder / "motions", n_performers=10)
    reference, pupil, _ = write_dance(folder)
    path = folder / "load.dousa"
    with Library.open(path, create=True) as library:
        library.add([folder / "motions"])
        library.add([reference, pupil], kind="take")
        library.train(n_trees=50)
    return path, files[7].read_bytes()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--library", type=Path, help="a trained library to copy; made by default")
    parser.add_argument("--motion", type=Path, help="a BVH to upload, with --library")
    parser.add_argument("--rest", type=float, default=REST, help="s between the requests of each of the three programs")
    parser.add_argument("--port", default="8900")
    parser.add_argument("--curve", type=Path, help="write the memory over time as CSV")
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        if chosen.library is None:
            library, motion = make_library(folder)
        else:
            library = Path(shutil.copy(chosen.library, folder / "load.dousa"))
            motion = chosen.motion.read_bytes()
        run(library, motion, chosen)


def run(library: Path, motion: bytes, chosen: argparse.Namespace) -> None:
    process, port, token = start_studio(library, "--port", chosen.port)
    try:
        measure(process, Client(port, token), motion, chosen)
    finally:
        process.send_signal(signal.SIGINT)
        process.wait(timeout=300)


def measure(process: subprocess.Popen[str], first: Client, motion: bytes, chosen: argparse.Namespace) -> None:
    seconds, curve = chosen.minutes * 60, chosen.curve
    items = json.loads(first.ask("GET", "/api/clips?limit=500")[1])["items"]
    ids = [item["id"] for item in items if item["kind"] == "clip"]
    takes = [item["id"] for item in items if item["kind"] == "take"]
    statuses: Counter[tuple[str, int]] = Counter()
    stop, begun = threading.Event(), time.monotonic()

    def work(seed: int) -> None:
        chance, client = random.Random(seed), Client(first.port, first.token)
        while not stop.wait(chosen.rest):
            try:
                statuses[use(client, ids, takes, motion, chance)] += 1
            except (OSError, http.client.HTTPException):  # the next request makes a new connection
                statuses["lost", 0] += 1

    threads = [threading.Thread(target=work, args=(seed,), daemon=True) for seed in range(N_CLIENTS)]
    for thread in threads:
        thread.start()
    samples: list[tuple[float, float]] = []
    while (now := time.monotonic() - begun) < seconds:
        samples.append((now, resident(process.pid)))
        if len(samples) % 30 == 0:
            print(
                f"{now / 60:6.1f} min  {samples[-1][1]:7.1f} MB  {sum(statuses.values())} requests",
                flush=True,
            )
        time.sleep(min(10.0, seconds / 20))
    stop.set()
    for thread in threads:
        thread.join(timeout=60)
    tell(samples, statuses, seconds)
    if curve is not None:
        curve.write_text("seconds,megabytes\n" + "".join(f"{a:.1f},{b:.2f}\n" for a, b in samples))


def tell(samples: list[tuple[float, float]], statuses: Counter[tuple[str, int]], seconds: float) -> None:
    import numpy as np

    at, size = np.array(samples).T
    total = sum(statuses.values())
    print(f"requests: {total} ({total / seconds:.0f} a second)")
    for (name, status), count in sorted(statuses.items()):
        print(f"  {name:<11} {status}  {count}")
    later = at >= min(SETTLED, seconds / 2)
    slope = np.polyfit(at[later] / 3600, size[later], 1)[0] if later.sum() > 2 else float("nan")
    first, last = np.median(size[later][:18]), np.median(size[later][-18:])  # of three minutes each
    print(f"memory: {size[0]:.0f} MB at the start, at most {size.max():.0f}")
    print(f"  from minute {at[later][0] / 60:.0f} on {first:.0f} MB, at the end {last:.0f} "
          f"({(last / first - 1) * 100:+.1f} %), {slope:+.1f} MB an hour")  # fmt: skip
    step = 300.0 if seconds >= 1200.0 else seconds / 4
    print("  curve, from minute on: median, most in MB")
    for start in np.arange(0.0, seconds, step):
        part = size[(at >= start) & (at < start + step)]
        if len(part):
            print(f"  {start / 60:5.1f}  {np.median(part):4.0f} {part.max():4.0f}")
    bad = sum(count for (_, status), count in statuses.items() if status >= 400 or status == 0)
    print(f"refused or failed: {bad}")


if __name__ == "__main__":
    main()
