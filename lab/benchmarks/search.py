"""Searching 10,000 clips, warm in Python and as a cold command.

    python -m lab.benchmarks.search [--clips N] [--categories N]

The clips are made: one synthetic motion of each of a number of categories, whose joints are moved at random 10,000
times. Ours includes the check whether the library changed; the peer, scikit-learn's NearestNeighbors on the same
histograms, knows no files, labels or changes, and breaks no ties.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import sqlalchemy as sa

from dousa.formats.registry import write_motion
from dousa.library import Library
from dousa.library.search.leaf_index import read_index
from dousa.library.store import schema
from dousa.library.store.checksums import seal_positions
from dousa.library.store.engine import next_revision, take_clip_ids
from dousa.library.store.forests import load_forest
from dousa.library.store.rows import seal_rows
from dousa.library.store.schema import pack
from dousa.motion import canonicalise, compute_trajectories
from dousa.motion.synthetic.performers import CATEGORIES, draw_performer, make_motion
from lab.benchmarks.timing import Row, run, take_turns

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
        data = pack(prototypes[category] + moved, "<f4")
        positions.append({"clip_id": clip_id, "positions": data, "block_checksums": seal_positions(clip_id, data)})
    connection.execute(sa.insert(schema.clips), seal_rows(schema.clips, rows))
    connection.execute(sa.insert(schema.clip_trajectories), positions)


def read_votes(path: Path) -> np.ndarray:
    """The histograms that are searched, for the peer."""
    with Library.open(path) as library, library.database.engine.begin() as connection:
        stored = load_forest(connection, str(path))
        assert stored is not None
        index = read_index(connection, 0, stored)
        return np.stack([index.answers_of(number).shares()[0] for number in index.list_ids()])


def make_peers(votes: np.ndarray) -> dict[str, Callable[[], object]]:
    try:
        from sklearn.neighbors import NearestNeighbors
    except ImportError:
        print("scikit-learn is not installed; run: pip install 'dousa[bench]'", file=sys.stderr)
        return {}
    fitted = {name: NearestNeighbors(n_neighbors=10, algorithm=name).fit(votes) for name in ("brute", "kd_tree")}
    return {
        f"NearestNeighbors ({name}), histograms alone": lambda peer=peer: peer.kneighbors(votes[:1])
        for name, peer in fitted.items()
    }


def benchmark(options: argparse.Namespace) -> Iterator[Row]:
    with tempfile.TemporaryDirectory() as folder:
        path, query = Path(folder, "m.dousa"), Path(folder, "query.bvh")
        make_library(path, options.clips, options.categories)
        with Library.open(path) as library:
            library.train()
        write_motion(make_motion(CATEGORIES[3], draw_performer(999)), query)
        peers = make_peers(read_votes(path))
        with Library.open(path) as library:
            calls = {"a stored clip": lambda: library.search(1), "a file": lambda: library.search(query)}
            found = take_turns({**calls, **peers}, 4 * options.repeats)
        work = f"search {options.clips:,} clips, warm"
        for name in peers:
            yield Row(f"{work}, a stored clip", found["a stored clip"], name, found[name])
        yield Row(f"{work}, a file (read, features, forest, ranking)", found["a file"])
        words = [sys.executable, "-m", "dousa", "search", str(path), str(query), "--json"]
        cold = take_turns({"": lambda: subprocess.run(words, check=True, capture_output=True)}, options.repeats)[""]
        yield Row(f"search {options.clips:,} clips, cold command, a file", cold)


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--clips", type=int, default=10_000)
    parser.add_argument("--categories", type=int, default=70)


if __name__ == "__main__":
    run(__doc__, benchmark, add_options)
