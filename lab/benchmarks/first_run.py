"""What the first use of twelve commands takes, of it the compiler, and what the second use takes.

    python -m lab.benchmarks.first_run [--only NAME] [--train] [--warm] [--each]

The commands are convert, add, train, search, classify, find, label, export (to glb), evaluate, evaluate --repetitions,
and estimate of silhouettes and of keypoints, in this order, as a new user may go through them: each in a process of its
own, with one cache of compiled functions, which is empty at first (with --warm ``dousa warm`` has filled it). ``info``
reads as ``convert`` does and compiles nothing more. Then once more. Printed are the seconds of each on the clock and of
processors, and what numba compiled (its event ``numba:compile``): functions, and processor seconds.

With --train: the first training of nine clips, with nothing compiled but what ``dousa add`` needed; the second, and
the second while two programs keep two cores busy. With --each: what was compiled, the dearest first.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack, chdir
from dataclasses import replace
from pathlib import Path

import numpy as np

from dousa import write_motion
from dousa.estimation import (
    MEDIAPIPE_NAMES,
    PersonTrack,
    ViewKeypoints,
    make_human,
    make_ring,
    poses_from_motion,
    write_cameras,
    write_keypoints,
)
from dousa.estimation.body.kinematics import compute_points, point_names
from dousa.motion import Motion
from dousa.motion.synthetic.performers import draw_performer, make_motion
from lab.benchmarks.timing import Row, Spent, run, spend, take_turns

KINDS = ("walk", "throw", "squat")
N_FRAMES, RATE = 12, 30.0
DOUSA = (sys.executable, "-c", "from dousa.app.cli.main import main; main()")
COMMANDS = {
    "convert": "convert motions/walk/0.bvh walk.trc",
    "add": "add library.dousa motions",
    "train": "train library.dousa",
    "search": "search library.dousa stranger/walk.bvh",
    "classify": "classify library.dousa stranger",
    "find": "find library.dousa stranger/walk.bvh take.bvh",
    "label": "label library.dousa take.bvh",
    "export": "export library.dousa --to glb -o exported",
    "evaluate": "evaluate motions/walk/0.bvh --performance stranger/walk.bvh",
    "evaluate --repetitions": "evaluate motions/squat/0.bvh --performance squats.bvh --repetitions",
    "estimate silhouettes": f"estimate masks.npz --frames 0:{N_FRAMES} -o silhouettes.bvh",
    "estimate keypoints": "estimate view1.npz view2.npz --cameras cameras.toml --cues keypoints --offsets none "
    "-o keypoints.bvh",
}
PARTS = ("rotations", "translations")
BUSY = (sys.executable, "-c", "while True: pass")


def join(motions: list[Motion]) -> Motion:
    """One recording of several, one after the other."""
    rotations, translations = (np.concatenate([getattr(one, name) for one in motions]) for name in PARTS)
    return replace(motions[0], rotations=rotations, translations=translations)


def make_files() -> None:
    """Three motions each by three people and by a stranger, a take, squats, silhouettes, and keypoints of two views."""
    people = [draw_performer(number) for number in range(4)]
    made = {kind: [make_motion(kind, one, frame_rate=RATE) for one in people] for kind in KINDS}
    Path("stranger").mkdir()
    for kind, (*known, strange) in made.items():
        Path("motions", kind).mkdir(parents=True)
        for number, motion in enumerate(known):
            write_motion(motion, f"motions/{kind}/{number}.bvh")
        write_motion(strange, f"stranger/{kind}.bvh")
    write_motion(join([motions[-1] for motions in made.values()] * 3), "take.bvh")
    write_motion(join([made["squat"][1]] * 6), "squats.bvh")
    render = [*DOUSA, "render", "motions/walk/0.bvh", "--ring", "4", "-o", "masks.npz"]
    subprocess.run(render, check=True, capture_output=True)
    body, cameras = make_human(1.75), make_ring(2, size=(640, 480), focal=500.0)
    poses = poses_from_motion(body, made["throw"][0])[:N_FRAMES]
    names = [name for name in MEDIAPIPE_NAMES if name in point_names(body)]
    places = compute_points(body, poses)[:, [point_names(body).index(name) for name in names]]
    for camera in cameras:
        points = camera.project(places)
        track = PersonTrack(points, np.full(points.shape[:2], 0.9))
        view = ViewKeypoints(tuple(names), (track,), np.arange(len(points)) / RATE, (640, 480))
        write_keypoints(f"{camera.name}.npz", view)
    write_cameras("cameras.toml", cameras)


class Cache:
    """A cache of compiled functions, and the log of what was compiled into it."""

    def __init__(self, name: str) -> None:
        self.folder, self.log = Path(name).absolute(), Path(f"{name}.log").absolute()
        self.log.touch()

    def call(self, words: str) -> Spent:
        """What a command takes with this cache; ends the program if it fails."""
        paths = [str(Path(__file__).with_name("compile_log")), *sys.path[1:]]
        told = {"NUMBA_CACHE_DIR": str(self.folder), "COMPILE_LOG": str(self.log), "PYTHONPATH": os.pathsep.join(paths)}
        spent, done = spend(
            lambda: subprocess.run(
                [*DOUSA, *words.split()], env={**os.environ, **told}, capture_output=True, text=True, check=False
            )
        )
        if done.returncode:
            sys.exit(f"dousa {words}: {done.stderr or done.stdout}")
        return spent

    def compiled(self) -> list[tuple[str, float]]:
        """Functions and the processor seconds of each compilation."""
        lines = (line.split("\t") for line in self.log.read_text().splitlines())
        return [(f"{module}.{name}", float(seconds)) for seconds, module, name in lines]


def measure_commands(chosen: list[str], each: bool, warm: bool, brief: bool) -> Iterator[Row]:
    """All in turn, twice."""
    cache, spent, compiled = Cache("cache"), [], []
    if warm:
        yield Row("dousa warm", cache.call("warm"), note=tell_compiled(cache.compiled()))
    for when in ("first", "second"):
        if when == "second":
            Path("library.dousa").unlink(missing_ok=True)
        for name in chosen:
            before = len(cache.compiled())
            spent.append((when, cache.call(COMMANDS[name])))
            compiled += (now := cache.compiled()[before:])
            if not brief:
                yield Row(f"{when} {name}", spent[-1][1], note=tell_compiled(now))
    for when in ("first", "second"):
        walls, cpus = zip(*(one for then, one in spent if then == when), strict=True)
        note = tell_compiled(compiled) if when == "first" else ""
        yield Row(f"{when} use of {len(chosen)} commands", Spent(sum(walls), sum(cpus)), note=note)
    if each:
        sums: Counter[str] = Counter()
        for name, seconds in compiled:
            sums[name] += seconds  # type: ignore[assignment]
        for name, seconds in sums.most_common():
            print(f"{seconds:7.2f} s  {name}")


def tell_compiled(found: list[tuple[str, float]]) -> str:
    """How much was compiled."""
    return f"of it {sum(seconds for _, seconds in found):.1f} s of CPU for {len(found)} compilations"


def measure_training(repeats: int) -> Iterator[Row]:
    """Nine clips: the first training, the second on the machine as it is, and with two busy cores."""
    cache = Cache("cache of the training")
    cache.call(COMMANDS["add"])
    before = len(cache.compiled())
    yield Row("first train", cache.call(COMMANDS["train"]), note=tell_compiled(cache.compiled()[before:]))
    for where in ("", ", two busy cores"):
        with ExitStack() as stack:
            for _ in range(2 if where else 0):
                stack.callback(stack.enter_context(subprocess.Popen(BUSY)).kill)
            found = take_turns({"ours": lambda: cache.call(COMMANDS["train"])}, repeats, warm=False)
        yield Row(f"second train{where}", found["ours"])


def benchmark(options: argparse.Namespace) -> Iterator[Row]:
    with tempfile.TemporaryDirectory() as folder, chdir(folder):
        make_files()
        if options.train:
            yield from measure_training(options.repeats)
            return
        chosen = [name for name in COMMANDS if not options.only or name.startswith(tuple(options.only))]
        yield from measure_commands(chosen, options.each, options.warm, options.brief)


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--only", action="append", default=[], metavar="NAME", help=", ".join(COMMANDS))
    parser.add_argument("--train", action="store_true", help="the training alone, quiet and busy")
    parser.add_argument("--warm", action="store_true", help="after dousa warm")
    parser.add_argument("--brief", action="store_true", help="the sums alone")
    parser.add_argument("--each", action="store_true", help="name every function that was compiled")


if __name__ == "__main__":
    run(__doc__, benchmark, add_options)
