"""Finding a motion in 100 minutes of takes at 30 frames a second.

    python -m lab.benchmarks.find [FOLDER] [--performer-from RULE] [--minutes M]

Clips of the folder (or synthetic ones) are joined into takes and described once; then clips are looked for, warm. The
peer is stumpy's MASS: the distance profiles of the same small poses, one for each of their 27 numbers, summed; it
compares at the query's own tempo only and knows no trees. Goal: 0.2 s.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np

from dousa.retrieval.takes.find import describe_query, find_in_takes
from dousa.retrieval.takes.windows import TakeWindows, choose_grid, describe_take
from lab.benchmarks.take_material import FEATURE_SET, make_takes, read_or_make_clips, train_forest
from lab.benchmarks.timing import best_of


def time_peer(poses: np.ndarray, takes: list[tuple[str, TakeWindows]]) -> float | None:
    try:
        import stumpy
    except ImportError:
        print("peer: stumpy is not installed; run: pip install stumpy")
        return None
    query = poses.astype(np.float64)
    series = [windows.poses.astype(np.float64) for _, windows in takes]

    def search() -> list[float]:
        best = []
        for one in series:
            total = np.zeros(len(one) - len(query) + 1)
            for k in range(one.shape[1]):
                total += stumpy.mass(query[:, k], one[:, k], normalize=False) ** 2
            best.append(float(total.min()))
        return best

    search()
    return best_of(search, 3)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, nargs="?")
    parser.add_argument("--performer-from", default=None)
    parser.add_argument("--minutes", type=float, default=100.0)
    options = parser.parse_args()
    clips = read_or_make_clips(options.folder, options.performer_from)
    forest = train_forest(clips)
    durations = [len(clip.positions) / clip.frame_rate for clip in clips]
    grid = choose_grid(durations)
    start = time.perf_counter()
    takes = [
        (str(k), describe_take(forest, FEATURE_SET, take, grid, n_jobs=2))
        for k, take in enumerate(make_takes(clips, options.minutes))
    ]
    seconds = time.perf_counter() - start
    frames = sum(windows.n_frames for _, windows in takes)
    count = sum(len(windows.starts) for _, windows in takes)
    stored = sum(windows.leaves.nbytes + windows.poses.nbytes for _, windows in takes)
    print(f"{frames / 1800:.0f} minutes in {len(takes)} takes, {count} windows of {grid.lengths} frames")
    print(f"described once in {seconds:.1f} s ({frames / seconds:.0f} frames/s), {stored / 1e6:.0f} MB")
    order = np.argsort(durations)
    times = []
    for place in (0.1, 0.5, 0.9):
        clip = clips[order[int(place * len(order))]]
        query = describe_query(forest, FEATURE_SET, clip)
        find_in_takes(query, takes)
        times.append(best_of(lambda query=query: find_in_takes(query, takes), 5))
        print(f"ours, warm, a query of {len(query.poses) / 30:.1f} s: {1e3 * times[-1]:.0f} ms")
    clip = clips[order[len(order) // 2]]
    peer = time_peer(describe_query(forest, FEATURE_SET, clip).poses, takes)
    if peer is not None:
        print(f"peer, stumpy.mass over 27 numbers, one tempo: {1e3 * peer:.0f} ms")
        print(f"ratio, peer / ours: {peer / times[1]:.1f}")


if __name__ == "__main__":
    main()
