"""A whole assessment, its report, and the running one that takes a frame at a time.

    python -m lab.benchmarks.assess [--minutes M] [--rate HZ] [--file DANCE]

The reference is the synthetic dance (or a file), danced to and fro until it is long enough; the performance is that
with twelve errors, by a simulated performer. Prints ours, the goal, and the ratio of both (above 1: better):

- the first call with nothing compiled before, in a process of its own: what a person waits once;
- the whole assessment when all is compiled, and the peak of memory in a process of its own;
- the report on disk;
- frames a second of the running assessment at 30 and 120 Hz, on one core, and its longest wait for one frame.

Goals: 5 minutes at 120 frames a second in 5 s; the report in 10 s; 1,000 frames a second.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from dousa.evaluation import IncrementalAssessor, assess
from dousa.motion import CanonicalMotion, canonicalise
from dousa.motion.synthetic.dance import make_dance
from dousa.motion.synthetic.performers import Performer
from lab.benchmarks.timing import timed
from lab.injection.injection import inject_many, simulate_performer

KINDS = ("shift", "incomplete", "partial", "global")


def read_dance(name: str | None) -> CanonicalMotion:
    if name is None:
        return canonicalise(make_dance(Performer(), 0, 30.0).motion)
    from dousa.formats.registry import read_motion

    return canonicalise(read_motion(name))


def lengthen(dance: CanonicalMotion, seconds: float, rate: float) -> CanonicalMotion:
    """To and fro, at another rate."""
    last = dance.n_frames - 1
    place = np.arange(round(seconds * rate)) / rate * dance.frame_rate % (2 * last)
    place = np.where(place > last, 2 * last - place, place)
    low = np.minimum(place.astype(np.intp), last - 1)
    share = (place - low)[:, None, None]
    positions = dance.positions[low] * (1 - share) + dance.positions[low + 1] * share
    return replace(dance, positions=positions, frame_rate=rate, missing=None)


def make_pair(
    name: str | None, seconds: float, rate: float, n_errors: int = 12
) -> tuple[CanonicalMotion, CanonicalMotion]:
    reference = lengthen(read_dance(name), seconds, rate)
    rng = np.random.default_rng(1)
    wrong = inject_many(reference, (KINDS * n_errors)[:n_errors], rng)
    return reference, simulate_performer(reference if wrong is None else wrong.motion, rng)


def say(what: str, ours: float, goal: float, unit: str, *, more_is_better: bool = False) -> None:
    ratio = ours / goal if more_is_better else goal / ours
    print(f"{what}: {ours:,.2f} {unit}; goal: {goal:,.0f} {unit}; ratio: {ratio:.1f}")


def read_status(key: str) -> float:
    """A line of what Linux says of this process, MB."""
    with open("/proc/self/status") as status:
        return next(float(line.split()[1]) / 1024 for line in status if line.startswith(key))


def measure_memory(name: str | None, seconds: float, rate: float) -> None:
    pair = make_pair(name, seconds, rate)
    assess(*make_pair(name, 10.0, 30.0, 1))
    try:
        with open("/proc/self/clear_refs", "w") as reset:
            reset.write("5")
        before = read_status("VmRSS")
        assess(*pair)
        print(f"peak of memory: {read_status('VmHWM') - before:.0f} MB beyond the {before:.0f} MB held before")
    except OSError:
        print("peak of memory: not measured, as this system does not tell it")


def measure_first(name: str | None) -> None:
    reference, performance = make_pair(name, 30.0, 30.0, 4)
    first, _ = timed(lambda: assess(reference, performance))
    warm, _ = timed(lambda: assess(reference, performance))
    print(f"first call with nothing compiled: {first:.1f} s (the next: {warm:.2f} s)")

    def play() -> None:
        assessor = IncrementalAssessor(reference, 30.0)
        for joints in performance.positions[:150]:
            assessor.push(joints)

    print(f"first running assessment after that: {timed(play)[0]:.1f} s (the next: {timed(play)[0]:.2f} s)")


def run_apart(flag: str, options: argparse.Namespace) -> None:
    """This file again, in a process of its own, with nothing compiled where that is what is measured."""
    words = [
        sys.executable,
        "-m",
        "lab.benchmarks.assess",
        flag,
        "--minutes",
        str(options.minutes),
        "--rate",
        str(options.rate),
    ]
    words += ["--file", options.file] if options.file else []
    with tempfile.TemporaryDirectory() as folder:
        cache = {"NUMBA_CACHE_DIR": folder} if flag == "--first" else {}
        subprocess.run(words, check=True, env=os.environ | cache)


def measure_whole(options: argparse.Namespace) -> None:
    seconds = 60.0 * options.minutes
    reference, performance = make_pair(options.file, seconds, options.rate)
    assess(*make_pair(options.file, 20.0, 30.0, 2))
    spent = time.process_time()
    ours, assessment = timed(lambda: assess(reference, performance), 3)
    spent = (time.process_time() - spent) / 3
    n_frames, goal = performance.n_frames, 5.0
    say(f"whole assessment of {n_frames:,} frames ({len(assessment.events)} errors)", ours, goal, "s")
    print(f"  processor time: {spent:.2f} s")
    from dousa.app.report.page import write_report

    with tempfile.TemporaryDirectory() as folder:
        ours, page = timed(lambda: write_report(assessment, Path(folder)))
        say(f"report ({Path(page).stat().st_size / 1e6:.1f} MB)", ours, 10.0, "s")


def measure_running(options: argparse.Namespace, rate: float, seconds: float = 90.0) -> None:
    reference, performance = make_pair(options.file, seconds, rate, 9)
    start = time.perf_counter()
    assessor = IncrementalAssessor(reference, rate)
    ready = time.perf_counter() - start
    waits = []
    spent = time.process_time()
    for joints in performance.positions:
        start = time.perf_counter()
        assessor.push(joints)
        waits.append(time.perf_counter() - start)
    spent = time.process_time() - spent
    found = len(assessor.settled)
    say(f"running at {rate:g} Hz", len(waits) / sum(waits), 1000.0, "frames a second", more_is_better=True)
    typical, longest = 1000.0 * float(np.median(waits)), 1000.0 * max(waits)
    print(
        f"  ready after {ready:.2f} s; a frame takes {typical:.2f} ms, the longest wait is {longest:.0f} ms; "
        f"{found} errors settled; {len(waits) / spent:,.0f} frames a second of processor time"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=5.0)
    parser.add_argument("--rate", type=float, default=120.0)
    parser.add_argument("--file")
    parser.add_argument("--first", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("--memory", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.first:
        measure_first(options.file)
        return
    if options.memory:
        measure_memory(options.file, 60.0 * options.minutes, options.rate)
        return
    run_apart("--first", options)
    sys.stdout.flush()
    measure_whole(options)
    sys.stdout.flush()
    run_apart("--memory", options)
    for rate in (30.0, 120.0):
        measure_running(options, rate)


if __name__ == "__main__":
    main()
