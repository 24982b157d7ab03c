"""What the first run of a command waits for the compiler, and the second does not.

    python -m lab.benchmarks.first_run [--only NAME] [--rounds N]

Each command runs in a process of its own with an empty cache of compiled functions, then again with the one it has
left. Printed are seconds, and processor seconds in brackets, which a busy machine disturbs less: of the first run, the
second, and what the first took longer. Commands: silhouettes and keypoints to a motion, a library filled, trained and
searched, a performance compared with a reference. The files are made here; neither films nor models are needed, as
finding keypoints compiles nothing. Goal: less than 10 s for `dousa estimate`.
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import time
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
from dousa.motion.synthetic.performers import draw_performer, make_motion

KINDS = ("walk", "throw", "squat")
N_FRAMES, RATE = 12, 30.0


def make_files() -> None:
    """Motions of three categories, silhouettes of one, and its keypoints in two views."""
    for kind in KINDS:
        os.makedirs(f"motions/{kind}")
        for number in range(3):
            motion = make_motion(kind, draw_performer(number), frame_rate=RATE)
            write_motion(motion, f"motions/{kind}/{number}.bvh")
    render = [*DOUSA, "render", "motions/walk/0.bvh", "--ring", "4", "-o", "masks.npz"]
    subprocess.run(render, check=True, capture_output=True)
    body, cameras = make_human(1.75), make_ring(2, size=(640, 480), focal=500.0)
    poses = poses_from_motion(body, make_motion("throw", draw_performer(0), frame_rate=RATE))[:N_FRAMES]
    names = [name for name in MEDIAPIPE_NAMES if name in point_names(body)]
    places = compute_points(body, poses)[:, [point_names(body).index(name) for name in names]]
    for camera in cameras:
        points = camera.project(places)
        track = PersonTrack(points, np.full(points.shape[:2], 0.9))
        view = ViewKeypoints(tuple(names), (track,), np.arange(len(points)) / RATE, (640, 480))
        write_keypoints(f"{camera.name}.npz", view)
    write_cameras("cameras.toml", cameras)


DOUSA = (sys.executable, "-c", "from dousa.app.cli.main import main; main()")
COMMANDS = {
    "estimate silhouettes": f"estimate masks.npz --frames 0:{N_FRAMES} -o silhouettes.bvh",
    "estimate keypoints": "estimate view1.npz view2.npz --cameras cameras.toml --cues keypoints --offsets none "
    "-o keypoints.bvh",
    "add": "add library.dousa motions",
    "train": "train library.dousa",
    "search": "search library.dousa motions/walk/0.bvh",
    "evaluate": "evaluate motions/walk/0.bvh --performance motions/walk/1.bvh",
}
NEEDS = {"train": ["add"], "search": ["add", "train"]}  # what leaves the library that a command works on


def run(words: str, cache: str) -> tuple[float, float]:
    """Seconds and processor seconds of a command with this cache of compiled functions."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    start = time.perf_counter()
    done = subprocess.run(
        [*DOUSA, *words.split()],
        env={**os.environ, "NUMBA_CACHE_DIR": cache},
        capture_output=True,
        text=True,
        check=False,
    )
    seconds, now = time.perf_counter() - start, resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode:
        sys.exit(f"dousa {words}: {done.stderr or done.stdout}")
    return seconds, now.ru_utime + now.ru_stime - used.ru_utime - used.ru_stime


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", action="append", default=[], metavar="NAME", help=", ".join(COMMANDS))
    parser.add_argument("--rounds", type=int, default=1, help="of which the least of each time is printed")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        make_files()
        chosen = [name for name in COMMANDS if not options.only or any(word in name for word in options.only)]
        for name, words in COMMANDS.items():
            if name not in chosen:
                if any(name in NEEDS.get(other, []) for other in chosen):
                    run(words, str(Path(folder, "cache")))
                continue
            times = []
            for number in range(options.rounds):
                cache = str(Path(folder, f"cache {name} {number}"))
                times.append((*run(words, cache), *run(words, cache)))
            first, spent, second, later = (min(column) for column in zip(*times, strict=True))
            print(
                f"{name}: first {first:.1f} s ({spent:.1f} s), then {second:.1f} s ({later:.1f} s); "
                f"compiling {first - second:.1f} s ({spent - later:.1f} s)",
                flush=True,
            )


if __name__ == "__main__":
    main()
