"""Adding a folder of BVH files to a library, end to end: read, kinematics, features, store.

    python -m lab.benchmarks.library_add [FOLDER] [--files N]

The peer is the same library with upc-pymotion as its reader (BVH.load, get_data and fk_quat), on the same files, as it
is slow on few.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from unittest import mock

import numpy as np

from dousa.formats import ReadOptions
from dousa.library import Library
from dousa.library.store import ingest
from dousa.motion import Trajectories
from lab.benchmarks.timing import Row, run, take_turns
from lab.places import SHARED_DATA


def add(files: list[Path], jobs: int | None = None) -> None:
    with tempfile.TemporaryDirectory() as folder, Library.open(Path(folder, "m.dousa"), create=True) as library:
        report = library.add(files, n_jobs=jobs)
    if len(report.added) != len(files):
        raise SystemExit(f"{len(report.skipped)} of {len(files)} files could not be added")


def read_with_pymotion(path: str, options: ReadOptions) -> Trajectories:
    """What ``ingest.read_with`` does, with upc-pymotion: the positions of the joints, in metres."""
    from pymotion.io.bvh import BVH
    from pymotion.ops.skeleton_np import fk_quat

    file = BVH()
    file.load(path)
    rotations, positions, parents, _, _, _ = file.get_data()
    # The position channels of these files stand for the offsets.
    world, _ = fk_quat(rotations, positions[:, 0], positions, parents)
    return Trajectories(tuple(file.data["names"]), world * 0.01, 1 / file.data["frame_time"])


def add_with_pymotion(files: list[Path]) -> None:
    with mock.patch.object(ingest, "read_with", read_with_pymotion):
        add(files, 1)


def benchmark(options: argparse.Namespace) -> Iterator[Row]:
    files = sorted(options.folder.rglob("*.bvh"))
    if not files:
        raise SystemExit(f"no BVH files in {options.folder}")
    size = sum(path.stat().st_size for path in files) / 1e6
    whole = take_turns({"ours": lambda: add(files, options.jobs)}, options.repeats)["ours"]
    yield Row(f"add {len(files)} BVH files, {size:.0f} MB, all cores", whole, amount=size, unit="MB/s")
    try:
        import pymotion  # noqa: F401
    except ImportError:
        print("upc-pymotion is not installed; run: pip install 'dousa[bench]'", file=sys.stderr)
        return
    some = [files[k] for k in np.linspace(0, len(files) - 1, min(options.files, len(files))).astype(int)]
    size = sum(path.stat().st_size for path in some) / 1e6
    found = take_turns({"ours": lambda: add(some, 1), "theirs": lambda: add_with_pymotion(some)}, options.repeats)
    peer = "the same with upc-pymotion as the reader"
    yield Row(f"add {len(some)} BVH files, one core", found["ours"], peer, found["theirs"], size, "MB/s")


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("folder", nargs="?", type=Path, default=SHARED_DATA / "bandai")
    parser.add_argument("--jobs", type=int, default=None)
    parser.add_argument("--files", type=int, default=20, help="of the comparison")


if __name__ == "__main__":
    run(__doc__, benchmark, add_options)
