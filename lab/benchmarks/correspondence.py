"""The path between two long motions, and straight lines.

    python -m lab.benchmarks.correspondence [--frames N] [--full N] [--files REFERENCE PERFORMANCE]

A dance is made (figures of a few seconds, some repeated) and danced again with a tempo that wanders by seconds and
with noise. Prints

- ours at 36,000 frames (five minutes at 120 frames/s): time, and memory beyond the inputs in a process of its own;
- at 4,000 frames: how far our path is from the full search over the same costs, beside the peers: librosa on the
  finished cost matrix, dtaidistance on 27 numbers a frame (squared Euclidean: it knows no yaw);
- lines: ours beside stumpy's matrix profile, which finds the one most similar window of each window.

With --files, the takes are compared at their own rate, by ours and by the full search.
Goal: 36,000 frames in 1 s and 500 MB; median difference to the full search of at most 1 frame.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import warnings

import numpy as np

from dousa.evaluation import compute_correlation_matrix, compute_postures, find_lines, find_path
from dousa.evaluation.alignment import correspondence as module
from lab.benchmarks.timing import timed


def unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def smooth_noise(rng: np.random.Generator, n_frames: int, every: int) -> np.ndarray:
    """(T, 9, 3), straight between values drawn every so many frames."""
    knots = rng.normal(size=(n_frames // every + 2, 9, 3))
    place = np.arange(n_frames) / every
    low = place.astype(np.intp)
    share = (place - low)[:, None, None]
    return knots[low] * (1 - share) + knots[low + 1] * share


def make_dance(n_frames: int, rate: float = 120.0) -> np.ndarray:
    """Sixteen figures of 5 s in an order drawn at random, with holds of a second between."""
    rng = np.random.default_rng(0)
    rest = np.tile([0.0, -1.0, 0.0], (9, 1))
    rest[0] = 0.0, 1.0, 0.0
    length, hold = int(5 * rate), int(rate)
    fade = np.minimum(1.0, np.minimum(np.arange(length), np.arange(length)[::-1]) / (0.4 * rate))
    figures = [fade[:, None, None] * smooth_noise(rng, length, int(0.5 * rate)) for _ in range(16)]
    parts, total = [], 0
    while total < n_frames:
        parts += [figures[rng.integers(16)], np.zeros((hold, 9, 3))]
        total += length + hold
    return unit(rest + 0.7 * np.concatenate(parts)[:n_frames])


def dance_again(dance: np.ndarray, rate: float = 120.0) -> np.ndarray:
    """The same with a wandering tempo and another body."""
    rng = np.random.default_rng(1)
    n = len(dance)
    knots = np.cumsum(rng.normal(size=n // 600 + 2)) * 0.15 * rate
    knots -= np.linspace(knots[0], knots[-1], len(knots))
    place = np.arange(n) + np.interp(np.arange(n), np.arange(len(knots)) * 600, knots)
    place = np.maximum.accumulate(np.clip(place, 0, n - 1))
    low = np.minimum(place.astype(np.intp), n - 2)
    share = (place - low)[:, None, None]
    moved = dance[low] * (1 - share) + dance[low + 1] * share
    return unit(moved + 0.08 * smooth_noise(rng, n, 30) + 0.02 * rng.normal(size=dance.shape))


def search_all(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The path over the whole matrix, by our kernel."""
    return module._warp(a, b, np.full(9, 1 / 9), None, 1e30, 4.0)


def mean_columns(path: np.ndarray) -> np.ndarray:
    return np.bincount(path[:, 0], path[:, 1]) / np.bincount(path[:, 0])


def say_difference(name: str, path: np.ndarray, other: np.ndarray) -> None:
    difference = np.abs(mean_columns(path) - mean_columns(other))
    print(f"{name}: median {np.median(difference):.2f}, largest {difference.max():.1f} frames")


def read_status(key: str) -> float:
    """A line of what Linux says of this process, MB."""
    with open("/proc/self/status") as status:
        return next(float(line.split()[1]) / 1024 for line in status if line.startswith(key))


def measure_memory(n_frames: int) -> None:
    """Peak beyond what is held before the search; run in a process of its own."""
    a = make_dance(n_frames)
    b = dance_again(a)
    find_path(a[:20], b[:20])
    try:
        with open("/proc/self/clear_refs", "w") as reset:
            reset.write("5")
        before = read_status("VmRSS")
        find_path(a, b)
        print(f"ours, peak of memory beyond the inputs: {read_status('VmHWM') - before:.0f} MB")
    except OSError:
        print("ours, memory: not measured, as this system does not tell the peak")


def compare_paths(n_frames: int) -> None:
    a = make_dance(n_frames)
    b = dance_again(a)
    print(f"-- paths at {n_frames} frames")
    ours, path = timed(lambda: find_path(a, b), 3)
    seconds, full = timed(lambda: search_all(a, b), 3)
    print(f"ours: {ours:.3f} s; full search by our kernel: {seconds:.3f} s")
    say_difference("ours to the full search", path, full)
    try:
        import librosa
        from dtaidistance import dtw, dtw_ndim
    except ImportError:
        print("peers: librosa or dtaidistance is not installed; run: pip install 'dousa[bench]'")
        return
    librosa.sequence.dtw(C=np.ones((3, 3)))
    seconds, (_, peer) = timed(lambda: librosa.sequence.dtw(C=1.0 - compute_correlation_matrix(a, b).astype(float)))
    print(f"peer, librosa (full, same costs): {seconds:.3f} s; ratio peer / ours: {seconds / ours:.1f}")
    say_difference("ours to librosa", path, peer[::-1])
    first, second = (np.ascontiguousarray(s.reshape(n_frames, 27)) for s in (a, b))
    seconds, peer = timed(lambda: dtw.best_path(dtw_ndim.warping_paths_fast(first, second)[1]))
    print(f"peer, dtaidistance (full, no yaw): {seconds:.3f} s; ratio peer / ours: {seconds / ours:.1f}")
    say_difference("ours to dtaidistance", path, np.array(peer))


def compare_lines(n_frames: int) -> None:
    a = make_dance(n_frames)
    b = dance_again(a)
    print(f"-- lines at {n_frames} frames")
    find_lines(a[:300], b[:300], 120.0)
    ours, lines = timed(lambda: find_lines(a, b, 120.0), 3)
    print(f"ours: {ours:.3f} s; {len(lines)} lines")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            import stumpy
    except ImportError:
        print("peer: stumpy is not installed; run: pip install 'dousa[bench]'")
        return
    channels = np.ascontiguousarray(a[::12].reshape(-1, 27).T)
    stumpy.mstump(channels[:2, :60].copy(), m=20)
    seconds, _ = timed(lambda: stumpy.mstump(channels, m=20))
    print(f"peer, stumpy.mstump at 10 Hz (the motion with itself): {seconds:.3f} s; ratio: {seconds / ours:.1f}")


def compare_files(files: list[str]) -> None:
    from dousa.formats.registry import read_motion
    from dousa.motion import canonicalise

    motions = [canonicalise(read_motion(name)) for name in files]
    a, b = (compute_postures(motion, motions[1].frame_rate).segments for motion in motions)
    print(f"-- {len(a)} and {len(b)} frames of {files[0]} and {files[1]}")
    ours, path = timed(lambda: find_path(a, b), 3)
    seconds, full = timed(lambda: search_all(a, b))
    print(f"ours: {ours:.3f} s; full search: {seconds:.3f} s")
    say_difference("ours to the full search", path, full)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=36_000)
    parser.add_argument("--full", type=int, default=4_000)
    parser.add_argument("--files", nargs=2, metavar=("REFERENCE", "PERFORMANCE"))
    parser.add_argument("--memory", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.memory:
        measure_memory(options.frames)
        return
    if options.files:
        compare_files(options.files)
        return
    a = make_dance(options.frames)
    b = dance_again(a)
    seconds, _ = timed(lambda: find_path(a[:20], b[:20]))
    print(f"ours, first call (compiles, or loads what was compiled): {seconds:.2f} s")
    seconds, path = timed(lambda: find_path(a, b), 3)
    print(f"ours at {options.frames} frames: {seconds:.3f} s, {len(path)} steps")
    sys.stdout.flush()
    words = [sys.executable, "-m", "lab.benchmarks.correspondence", "--memory", "--frames", str(options.frames)]
    subprocess.run(words, check=True, env=os.environ)
    compare_paths(options.full)
    compare_paths(3 * options.full)
    compare_lines(options.frames)


if __name__ == "__main__":
    main()
