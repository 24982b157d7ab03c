"""Searches a second through the studio's interface, against the same through the command line.

    python -m lab.benchmarks.studio_api [--clips N] [--seconds S] [--connections N] [--library FILE] [--quick]

A studio runs in another process; this one asks it over some connections at once, always for another clip, and checks
that what comes back is the clip itself. The peer is ``dousa search --json``, one process a question. Everything shares
the cores of this machine. Goal: 100 requests a second on 2 cores with 10,000 clips.
"""

from __future__ import annotations

import argparse
import http.client
import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from dousa.library import Library
from lab.benchmarks.search import make_library
from lab.benchmarks.studio_process import start_studio

GOAL = 100.0  # requests a second
DOUSA = (sys.executable, "-c", "from dousa.app.cli.main import main; main()")


@contextmanager
def running_studio(library: Path, home: Path) -> Iterator[tuple[int, str]]:
    """Port and token of a studio in another process."""
    process, port, token = start_studio(library, "--port", "9400", folder=home)
    try:
        yield port, token
    finally:
        process.send_signal(signal.SIGINT)
        process.wait(timeout=30)


class Asker(threading.Thread):
    """Asks one question after another until the end; keeps how long each took, s."""

    def __init__(self, port: int, token: str, ids: list[int], end: float) -> None:
        super().__init__()
        self.port, self.token, self.ids, self.end = port, token, ids, end
        self.took: list[float] = []
        self.problem = ""

    def run(self) -> None:
        """Ask."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=60)
        headers = {"Authorization": f"Bearer {self.token}", "Content-Type": "application/json"}
        place = 0
        while time.perf_counter() < self.end and not self.problem:
            clip = f"clip:{self.ids[place % len(self.ids)]}"
            place += 1
            began = time.perf_counter()
            connection.request("POST", "/api/search", json.dumps({"query": {"motion": clip}}), headers)
            answer = connection.getresponse()
            content = answer.read()
            self.took.append(time.perf_counter() - began)
            if answer.status != 200 or json.loads(content)["results"][0]["motion"] != clip:
                self.problem = content[:300].decode()
        connection.close()


def ask_for(port: int, token: str, ids: list[int], seconds: float, connections: int) -> np.ndarray:
    """Times of all answers within some seconds, s."""
    end = time.perf_counter() + seconds
    askers = [Asker(port, token, ids[number::connections], end) for number in range(connections)]
    for asker in askers:
        asker.start()
    for asker in askers:
        asker.join()
    problems = [asker.problem for asker in askers if asker.problem]
    if problems:
        raise SystemExit(f"a wrong answer: {problems[0]}")
    return np.concatenate([asker.took for asker in askers])


def ask_by_command(library: Path, ids: list[int]) -> float:
    """Questions a second, one process each."""
    began = time.perf_counter()
    for number in ids:
        command = [*DOUSA, "search", str(library), str(number), "--json"]
        answer = subprocess.run(command, check=True, capture_output=True, text=True)
        assert json.loads(answer.stdout)["results"][0]["clip_id"] == number
    return len(ids) / (time.perf_counter() - began)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--clips", type=int, default=10_000)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--connections", type=int, default=4)
    parser.add_argument("--library", type=Path, help="a trained library that is there already")
    parser.add_argument("--quick", action="store_true", help="500 clips, 3 seconds")
    options = parser.parse_args()
    clips, seconds = (500, 3.0) if options.quick else (options.clips, options.seconds)
    with tempfile.TemporaryDirectory() as folder:
        home = Path(folder)
        library = options.library
        if library is None:
            library = home / "moves.dousa"
            make_library(library, clips, 22)
        library = library.absolute()
        with Library.open(library) as opened:
            ids = [clip.id for clip in opened.clips() if clip.kind == "clip"]
        np.random.default_rng(0).shuffle(ids)
        with running_studio(library, home) as (port, token):
            ask_for(port, token, ids, 2.0, options.connections)  # warm
            took = ask_for(port, token, ids, seconds, options.connections)
        rate = len(took) / seconds
        peer = ask_by_command(library, ids[: 3 if options.quick else 5])
    print(
        f"ours: {rate:.0f} searches/s through the studio, {len(ids)} clips, {options.connections} connections, "
        f"{os.cpu_count()} cores; median {1e3 * np.median(took):.1f} ms, "
        f"99 % within {1e3 * np.quantile(took, 0.99):.0f} ms"
    )
    print(f"peer: {peer:.2f} searches/s through the command line")
    print(f"ratio: {rate / peer:.0f}; goal {GOAL:.0f}/s: {'reached' if rate >= GOAL else 'missed'}")


if __name__ == "__main__":
    main()
