"""The path between two long motions.

    python -m lab.benchmarks.correspondence [--frames N] [--full N] [--files REFERENCE PERFORMANCE]

A dance is made (figures of a few seconds, some repeated) and danced again with a tempo that wanders by seconds and
with noise.

- The whole matrix is searched by our kernel and by librosa, over the same costs: the same algorithm; the path of both
  is the same. dtaidistance searches it on 27 numbers a frame (squared Euclidean: it knows no yaw).
- What dousa does, coarse to fine, is compared with the full search by our own kernel.
- At --frames (five minutes at 120 frames/s) the full search would take a matrix of 5 GB: ours alone.

With --files, two takes are compared at their own rate, coarse to fine and by the full search.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from dousa.evaluation import compute_correlation_matrix, compute_postures, find_path
from dousa.evaluation.alignment import correspondence as module
from lab.benchmarks.timing import Row, measure_memory, run, take_turns


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


def tell_difference(path: np.ndarray, other: np.ndarray) -> str:
    difference = np.abs(mean_columns(path) - mean_columns(other))
    return f"paths differ by {np.median(difference):.2f} frames (median), at most {difference.max():.1f}"


def compare_paths(a: np.ndarray, b: np.ndarray, repeats: int) -> Iterator[Row]:
    """Coarse to fine against the full search by the same kernel."""
    found = take_turns({"ours": lambda: find_path(a, b), "full": lambda: search_all(a, b)}, repeats)
    note = tell_difference(find_path(a, b), search_all(a, b))
    work = f"path, {len(a):,} x {len(b):,} frames, coarse to fine"
    yield Row(work, found["ours"], "the full search by the same kernel", found["full"], note=note)


def compare_full(a: np.ndarray, b: np.ndarray, repeats: int) -> Iterator[Row]:
    """The same algorithm by others."""
    try:
        import librosa
        from dtaidistance import dtw, dtw_ndim
    except ImportError:
        print("librosa or dtaidistance is not installed; run: pip install 'dousa[bench]'", file=sys.stderr)
        return

    def by_librosa() -> np.ndarray:
        return np.asarray(librosa.sequence.dtw(C=1.0 - compute_correlation_matrix(a, b).astype(float))[1])[::-1]

    first, second = (np.ascontiguousarray(one.reshape(len(one), 27)) for one in (a, b))
    peers = {
        "librosa, same costs": by_librosa,
        "dtaidistance, no yaw": lambda: dtw.best_path(dtw_ndim.warping_paths_fast(first, second)[1]),
    }
    found = take_turns({"ours": lambda: search_all(a, b), **peers}, repeats)
    for name, peer in peers.items():
        note = tell_difference(search_all(a, b), np.array(peer()))
        yield Row(f"path, {len(a):,} frames, full search", found["ours"], name, found[name], note=note)


def benchmark(options: argparse.Namespace) -> Iterator[Row]:
    if options.files:
        from dousa.formats.registry import read_motion
        from dousa.motion import canonicalise

        motions = [canonicalise(read_motion(name)) for name in options.files]
        yield from compare_paths(
            *(compute_postures(motion, motions[1].frame_rate).segments for motion in motions), options.repeats
        )
        return
    long = make_dance(options.frames)
    again = dance_again(long)
    find_path(long[:300], again[:300])  # compiles
    memory = measure_memory(lambda: find_path(long, again))  # first: what was needed once is kept for the next time
    a = make_dance(options.full)
    b = dance_again(a)
    yield from compare_full(a, b, options.repeats)
    yield from compare_paths(a, b, options.repeats)
    found = take_turns({"": lambda: find_path(long, again)}, options.repeats)
    yield Row(f"path, {len(long):,} frames", found[""], note=memory)


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--frames", type=int, default=36_000)
    parser.add_argument("--full", type=int, default=4_000, help="of the full search: 12,000 take 21 GB in librosa")
    parser.add_argument("--files", nargs=2, type=Path, metavar=("REFERENCE", "PERFORMANCE"))


if __name__ == "__main__":
    run(__doc__, benchmark, add_options)
