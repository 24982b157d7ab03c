"""The whole tracker: four views of 320 x 240 pixels, default settings.

    python -m lab.benchmarks.estimate [--clip FILE.npz] [--threads N]

Takes a sequence of silhouettes of a real motion if there is one (``../shared/data``), else a walk that is made and
rendered here. Frames/s for four views, on two threads and on one, for two views and one; and at four times the length:
cost per frame and memory should not grow. On standard error: where the time of a pass over the body goes (processor
time of one thread). There is no peer that tracks a rigid-part model in silhouettes.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator
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
from lab.benchmarks.timing import Row, measure_memory, run, take_turns
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


def tell_parts(material: Material) -> str:
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
    told = f"a first pass over the body: {spend(np.arange(material.body.n_parts)):.2f} ms of one thread; "
    told += f"a frame takes up to {n_first} of them and {n_later} finer ones; by parts: "
    return told + ", ".join(f"{name} {spend(np.array([part])):.2f}" for part, name in enumerate(material.body.names))


def benchmark(options: argparse.Namespace) -> Iterator[Row]:
    material, n_threads = Material(options.clip), options.threads
    n_frames = options.frames or material.silhouettes.n_frames
    material.track(4, 3, n_threads)  # compiles
    memory = [measure_memory(lambda n=n: material.track(4, n, n_threads)) for n in (n_frames, 4 * n_frames)]
    calls = {
        f"{n_views} views, {threads} threads": lambda n_views=n_views, threads=threads: material.track(
            n_views, n_frames, threads
        )
        for n_views, threads in ((4, n_threads), (4, 1), (2, n_threads), (1, n_threads))
    }
    longer = f"4 views, {n_threads} threads, four times the length"
    calls[longer] = lambda: material.track(4, 4 * n_frames, n_threads)
    for name, spent in take_turns(calls, options.repeats).items():
        notes = {longer: memory[1], f"4 views, {n_threads} threads": memory[0]}
        amount = 4 * n_frames if name == longer else n_frames
        yield Row(f"track, {name}", spent, amount=amount, unit="frames/s", note=notes.get(name, ""))
    print(tell_parts(material), file=sys.stderr)


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--clip", help="an npz file with the truth, see dousa.estimation.silhouettes.mask_npz")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--frames", type=int, help="instead of all of the clip")


if __name__ == "__main__":
    run(__doc__, benchmark, add_options)
