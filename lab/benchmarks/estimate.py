"""The whole tracker: four views of 320 x 240 pixels, default settings.

    python -m lab.benchmarks.estimate [--clip FILE.npz] [--threads N]

Takes a sequence of silhouettes of a real motion if there is one (``../shared/data``), else a walk that is made and
rendered here. Prints

- the first call on a new machine, which compiles (a process of its own with an empty cache), and the second;
- frames/s for one, two and four views, and on one thread;
- milliseconds a frame at one and at four times the length, and the peak of memory of each beyond what was held before;
- where the time of a pass over the body goes, part by part (processor time of one thread).

There is no peer that tracks a rigid-part model in silhouettes. Goal: 30 frames/s with four views on two cores; a cost
per frame and a peak of memory that do not grow with the length.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from dousa.estimation import (
    TrackerSettings,
    estimate,
    fit_pose,
    make_human,
    make_ring,
    render,
    standing_state,
)
from dousa.estimation.silhouettes.silhouettes import PackedSilhouettes, Silhouettes
from dousa.estimation.tracking.search_setup import SearchSetup
from lab.benchmarks.timing import timed
from lab.estimation.clips import choose_views, first_frame_body, read_clip
from lab.places import SHARED_DATA

RECORDED = SHARED_DATA / "silhouette_bench/cmu86_walk_clean.npz"


class Repeated(Silhouettes):
    """Some views of a sequence, to and fro until it is long enough; nothing is held that grows with the length."""

    def __init__(self, source: Silhouettes, views: tuple[int, ...], n_frames: int) -> None:
        self.source, self.views, self.n_frames = source, views, n_frames
        self.names = tuple(source.names[view] for view in views)
        self.sizes = tuple(source.sizes[view] for view in views)
        self.frame_rate = source.frame_rate

    def read(self, frame: int):  # type: ignore[no-untyped-def]
        there, last = divmod(frame, max(1, self.source.n_frames - 1)), self.source.n_frames - 1
        masks = self.source.read(last - there[1] if there[0] % 2 else there[1])
        return tuple(masks[view] for view in self.views)


class Material:
    """Silhouettes, cameras, body and first pose."""

    def __init__(self, clip: str | None) -> None:
        path = RECORDED if clip is None else Path(clip)
        if clip is not None or path.exists():
            found = read_clip(path)
            self.name, self.silhouettes, self.cameras = found.name, found.silhouettes, found.cameras
            self.body = first_frame_body(found, "start")
            self.start = fit_pose(self.body, found.joints_at(0))[0]
            return
        self.name, self.body, self.cameras = "a walk made here", make_human(1.75), make_ring(4)
        poses = self._walk(90)
        self.silhouettes = PackedSilhouettes(render(self.body, poses, self.cameras), 30.0)
        self.start = poses[0]

    def _walk(self, n_frames: int) -> np.ndarray:
        poses = np.tile(standing_state(self.body), (n_frames, 1))
        phase = 2 * np.pi * np.arange(n_frames) / 36
        poses[:, 0] += 0.01 * np.arange(n_frames)
        for angle, name in enumerate(self.body.angle_names):
            side = -1.0 if name.startswith("right") else 1.0
            for joint, amount in (("shoulder.1", -0.5), ("hip.1", 0.4), ("elbow.1", 0.3), ("knee.1", 0.3)):
                if name.endswith(joint):
                    poses[:, 7 + angle] += side * amount * np.sin(phase)
        limits = self.body.angle_limits
        poses[:, 7:] = np.clip(poses[:, 7:], limits[:, 0], limits[:, 1])
        return poses

    def track(self, n_views: int, n_frames: int, n_threads: int):  # type: ignore[no-untyped-def]
        views = choose_views(self.cameras, n_views)
        return estimate(
            Repeated(self.silhouettes, views, n_frames),
            [self.cameras[view] for view in views],
            self.body,
            self.start,
            n_threads=n_threads,
        )


def read_status(key: str) -> float:
    """A line of what Linux says of this process, MB."""
    with open("/proc/self/status") as status:
        return next(float(line.split()[1]) / 1024 for line in status if line.startswith(key))


def run_length(material: Material, n_frames: int, n_threads: int) -> None:
    """Cost per frame and peak of memory at one length; run in a process of its own."""
    material.track(4, 4, n_threads)
    try:
        with open("/proc/self/clear_refs", "w") as reset:
            reset.write("5")
        before = read_status("VmRSS")
    except OSError:
        before = float("nan")
    seconds, _ = timed(lambda: material.track(4, n_frames, n_threads))
    peak = read_status("VmHWM") - before if np.isfinite(before) else float("nan")
    print(f"{n_frames} frames: {1000 * seconds / n_frames:.1f} ms a frame, {peak:.1f} MB beyond what was held")


def run_first(material: Material, n_threads: int) -> None:
    first, _ = timed(lambda: material.track(4, 3, n_threads))
    second, _ = timed(lambda: material.track(4, 3, n_threads))
    print(f"3 frames: {first:.1f} s at first, {second:.2f} s then")


def run_apart(words: list[str], **environment: str) -> None:
    sys.stdout.flush()
    command = [sys.executable, "-m", "lab.benchmarks.estimate", *words]
    subprocess.run(command, check=True, env={**os.environ, **environment})


def tell_parts(material: Material) -> None:
    """Processor time of a first pass over the body, and of each part's share of it."""
    masks = material.silhouettes.read(0)
    area = float(np.mean([mask.sum() for mask in masks if mask is not None]))
    settings = TrackerSettings()
    setup = SearchSetup(material.body, material.cameras, settings, material.silhouettes.frame_rate, area)
    frame, scratch = setup.pack(masks), setup.make_scratch()

    def spend(order: np.ndarray) -> float:
        setup.order = order
        times = []
        for _ in range(15):
            pose, shift = material.start.copy(), np.zeros(setup.n_axes)
            start = time.thread_time()
            setup.sweep(pose, shift, 1.0, frame, scratch)
            times.append(time.thread_time() - start)
        return 1000 * min(times)

    n_first, n_later = setup.beam * len(settings.damping), setup.beam * (len(settings.passes) - 1)
    print(f"-- a first pass over the body, {spend(np.arange(material.body.n_parts)):.2f} ms of one thread;")
    print(f"   a frame takes up to {n_first} of them and {n_later} finer ones")
    shares = {name: spend(np.array([part])) for part, name in enumerate(material.body.names)}
    print("   " + ", ".join(f"{name} {ms:.2f}" for name, ms in shares.items()))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--clip", help="an npz file with the truth, see dousa.estimation.silhouettes.mask_npz")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--length", type=int, help=argparse.SUPPRESS)
    parser.add_argument("--first", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    material = Material(options.clip)
    if options.length or options.first:
        if options.first:
            run_first(material, options.threads)
        else:
            run_length(material, options.length, options.threads)
        return
    n_frames = material.silhouettes.n_frames
    print(f"{material.name}, {n_frames} frames, {options.threads} threads; {os.cpu_count()} cores")
    same = [] if options.clip is None else ["--clip", options.clip]
    same += ["--threads", str(options.threads)]
    print("-- the first call, compiling:")
    with tempfile.TemporaryDirectory() as empty:
        run_apart(["--first", *same], NUMBA_CACHE_DIR=empty)
    material.track(4, 3, options.threads)
    print("-- frames/s, tracking alone")
    for n_views in (1, 2, 4):
        found = material.track(n_views, n_frames, options.threads)
        overlap = np.nanmean(found.iou)
        print(f"{n_views} views: {found.frames_per_second:.1f} frames/s, mean overlap {overlap:.2f}")
    print(f"4 views, one thread: {material.track(4, n_frames, 1).frames_per_second:.1f} frames/s")
    print("-- four views, the length")
    for times in (1, 4):
        run_apart(["--length", str(times * n_frames), *same])
    tell_parts(material)


if __name__ == "__main__":
    main()
