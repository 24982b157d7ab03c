"""Searching 10,000 clips, warm in Python and as a cold command; and training, of any number of clips.

    python -m lab.benchmarks.search [--clips N] [--categories N]
    python -m lab.benchmarks.search --train N [N ...]

With ``--train`` each library is trained in a process of its own, which prints what each step takes (on the clock, and
of all processors) and the largest memory; what takes are labelled with is a step of its own. A clip takes 14 kB before
the training and 44 kB after it.

The clips are made: one synthetic motion of each of a number of categories, whose joints are moved at random 10,000
times. Prints ours (with the check whether the library changed), the peer (scikit-learn's
NearestNeighbors on the same histograms, which knows no files, labels or changes), and the ratio.
Goal: 0.1 s warm, 1.5 s cold.
"""

from __future__ import annotations

import argparse
import multiprocessing
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import sqlalchemy as sa

from dousa.formats.registry import write_motion
from dousa.library import Library
from dousa.library.search.leaf_index import read_index
from dousa.library.search.part_search import make_dense
from dousa.library.store import schema
from dousa.library.store.checksums import seal_rows
from dousa.library.store.engine import next_revision, take_clip_ids
from dousa.library.store.forests import load_forest
from dousa.library.store.schema import pack
from dousa.messages import Message
from dousa.motion import canonicalise, compute_trajectories
from dousa.motion.synthetic.performers import CATEGORIES, draw_performer, make_motion
from lab.benchmarks.timing import best_of

N_FRAMES = 60
MOVED = 0.03  # m, standard deviation of each of three waves in the way of every joint


def make_library(path: Path, n_clips: int, n_categories: int, tell: Callable[[int], None] | None = None) -> None:
    """A library of clips that differ at random from one prototype per category; ``tell`` is called with those done."""
    rng = np.random.default_rng(0)
    prototypes = []
    for number in range(n_categories):
        motion = make_motion(CATEGORIES[number % len(CATEGORIES)], draw_performer(number))
        positions = canonicalise(compute_trajectories(motion)).positions
        prototypes.append(positions[np.linspace(0, len(positions) - 1, N_FRAMES).astype(int)])
    now = datetime.now(UTC).isoformat(timespec="seconds")
    with Library.open(path, create=True) as library:
        for start in range(0, n_clips, 2000):
            numbers = range(start, min(start + 2000, n_clips))
            with library.database.writing() as connection:
                next_revision(connection)
                insert_clips(connection, numbers, prototypes, rng, now)
            if tell is not None:
                tell(numbers.stop)


def insert_clips(
    connection: sa.Connection, numbers: range, prototypes: list[np.ndarray], rng: np.random.Generator, now: str
) -> None:
    waves = np.sin(np.pi * np.outer(np.linspace(0, 1, N_FRAMES), np.arange(1, 4)))
    rows, positions = [], []
    for number, clip_id in zip(numbers, take_clip_ids(connection, len(numbers)), strict=True):
        category = number % len(prototypes)
        moved = np.einsum("tw,wjk->tjk", waves, rng.normal(0.0, MOVED, (3, 20, 3)))
        rows.append(
            {"id": clip_id, "path": f"/synthetic/{category:02}/{number:07}.bvh", "content_hash": f"{number:064}"}
            | {"fingerprint": "", "size": 0, "read_options": "", "category": f"kind {category:02}"}
            | {"performer": None, "format": "bvh", "n_frames": N_FRAMES, "frame_rate": 30.0, "duration": 2.0}
            | {"height": 1.7, "joint_table": "synthetic", "warnings": [], "added_at": now, "kind": "clip", "absent": ""}
        )
        positions.append({"clip_id": clip_id, "positions": pack(prototypes[category] + moved, "<f4")})
    connection.execute(sa.insert(schema.clips), seal_rows(schema.clips, rows))
    connection.execute(sa.insert(schema.clip_trajectories), positions)


def train(path: Path) -> None:
    """Train a library in this process, and print what it took."""
    steps: dict[str, list[float]] = {}
    began = [time.perf_counter(), time.process_time()]
    last, name = list(began), "start"

    def tell(done: int, total: int, what: Message) -> None:
        nonlocal name
        now = [time.perf_counter(), time.process_time()]
        taken = steps.setdefault(name, [0.0, 0.0])
        for clock in range(2):
            taken[clock] += now[clock] - last[clock]
        last[:], name = now, what.code.rpartition(".")[2].removesuffix("_done")

    with Library.open(path) as library:
        report = library.train(progress=tell)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    wall, cpu = time.perf_counter() - began[0], time.process_time() - began[1]
    told = ", ".join(f"{step} {taken[0]:.1f} s ({taken[1]:.1f})" for step, taken in steps.items() if taken[0] > 0.05)
    own = steps.get("labeller", [0.0, 0.0])
    print(
        f"trained: {report.n_clips} clips, {wall - own[0]:.1f} s ({cpu - own[1]:.1f} of processors) without the "
        f"labeller, {wall:.1f} s with it, at most {peak:.2f} GB, {path.stat().st_size / 1e6:.0f} MB of file; {told}",
        flush=True,
    )


def time_training(sizes: list[int], n_categories: int) -> None:
    with tempfile.TemporaryDirectory() as folder:
        for size in sizes:
            path = Path(folder, f"{size}.dousa")
            make_library(path, size, n_categories)
            process = multiprocessing.get_context("spawn").Process(target=train, args=(path,))
            process.start()
            process.join()
            path.unlink()
            if process.exitcode:
                raise SystemExit(f"the training of {size} clips ended with {process.exitcode}")


def time_warm(path: Path, query: Path) -> tuple[float, np.ndarray]:
    with Library.open(path) as library:
        start = time.perf_counter()
        library.search(1)
        print(f"ours, first search of an open library: {1e3 * (time.perf_counter() - start):.1f} ms")
        library.search(query)
        warm = best_of(lambda: library.search(1), 20)
        read = best_of(lambda: library.search(query), 20)
        print(f"ours, warm, a stored clip: {1e3 * warm:.2f} ms")
        print(f"ours, warm, a file (read, features, forest, ranking): {1e3 * read:.2f} ms")
        with library.database.engine.begin() as connection:
            stored = load_forest(connection, str(path))
            assert stored is not None
            votes = make_dense(read_index(connection, 0, stored)).answers.shares()
    return warm, votes


def time_peer(votes: np.ndarray) -> float | None:
    try:
        from sklearn.neighbors import NearestNeighbors
    except ImportError:
        print("peer: scikit-learn is not installed; run: pip install 'dousa[bench]'")
        return None
    best = np.inf
    for algorithm in ("brute", "kd_tree"):
        peer = NearestNeighbors(n_neighbors=10, algorithm=algorithm).fit(votes)
        seconds = best_of(lambda peer=peer: peer.kneighbors(votes[:1]), 20)
        print(f"peer, warm, scikit-learn NearestNeighbors ({algorithm}): {1e3 * seconds:.2f} ms")
        best = min(best, seconds)
    return best


def time_cold(path: Path, query: str, count: int) -> float:
    command = shutil.which("dousa", path=str(Path(sys.executable).parent))
    if command is not None:
        words = [command, "search", str(path), query, "--json"]
    else:
        program = f"from dousa.library import Library; print(Library.open({str(path)!r}).search({query!r}).to_json())"
        words = [sys.executable, "-c", program]
    return best_of(lambda: subprocess.run(words, check=True, capture_output=True), count)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--clips", type=int, default=10_000)
    parser.add_argument("--categories", type=int, default=70)
    parser.add_argument("--train", type=int, nargs="+", default=[], metavar="N", help="train libraries of so many")
    parser.add_argument("--cold", type=int, default=5, metavar="N", help="the best of so many cold commands")
    options = parser.parse_args()
    if options.train:
        time_training(options.train, options.categories)
        return
    with tempfile.TemporaryDirectory() as folder:
        path, query = Path(folder, "m.dousa"), Path(folder, "query.bvh")
        make_library(path, options.clips, options.categories)
        with Library.open(path) as library:
            report = library.train()
        print(f"made: {report.n_clips} clips of {len(report.categories)} categories, trained in {report.seconds:.1f} s")
        write_motion(make_motion(CATEGORIES[3], draw_performer(999)), query)
        ours, votes = time_warm(path, query)
        peer = time_peer(votes)
        if peer is not None:
            print(f"ratio, warm, peer / ours: {peer / ours:.2f}")
        print(f"ours, cold command, a file: {time_cold(path, str(query), options.cold):.2f} s")


if __name__ == "__main__":
    main()
