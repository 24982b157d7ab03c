"""Adding a folder of BVH files to a library, end to end: read, kinematics, features, store.

    python -m lab.benchmarks.library_add [FOLDER] [--jobs N] [--peer-files N]

Prints MB of BVH per second, ours and of the same library with upc-pymotion as its reader (BVH.load, get_data
and fk_quat; on fewer files, as it is slow), and the ratio. Goal: 60 MB/s or more on 2 cores.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np

from dousa.formats import ReadOptions
from dousa.library import AddReport, Library
from dousa.library.store import ingest
from dousa.motion import CanonicalMotion, Trajectories, canonicalise
from lab.places import SHARED_DATA

BANDAI = SHARED_DATA / "bandai"


def add(files: list[Path], jobs: int | None) -> AddReport:
    with (
        tempfile.TemporaryDirectory() as folder,
        Library.open(Path(folder, "m.dousa"), create=True) as library,
    ):
        return library.add(files, n_jobs=jobs)


def read_with_pymotion(path: str, options: ReadOptions) -> tuple[CanonicalMotion, str]:
    """What ``ingest.read_canonical`` does, with upc-pymotion: the positions of the joints, in metres."""
    from pymotion.io.bvh import BVH
    from pymotion.ops.skeleton_np import fk_quat

    file = BVH()
    file.load(path)
    rotations, positions, parents, _, _, _ = file.get_data()
    # The position channels of these files stand for the offsets.
    world, _ = fk_quat(rotations, positions[:, 0], positions, parents)
    trajectories = Trajectories(tuple(file.data["names"]), world * 0.01, 1 / file.data["frame_time"])
    return canonicalise(trajectories), "bvh"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", nargs="?", type=Path, default=BANDAI)
    parser.add_argument("--jobs", type=int, default=None)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--peer-files", type=int, default=40)
    options = parser.parse_args()
    files = sorted(options.folder.rglob("*.bvh"))
    if not files:
        raise SystemExit(f"no BVH files in {options.folder}")
    first = add(files[:2], 1)
    print(f"first two files, with loading or compiling the kernels: {first.seconds:.2f} s")
    reports = [add(files, options.jobs) for _ in range(options.repeats)]
    speeds = [report.bytes / 1e6 / report.seconds for report in reports]
    report = reports[int(np.argmax(speeds))]
    print(f"ours: {len(report.added)} files, {report.bytes / 1e6:.1f} MB, {len(report.skipped)} skipped")
    print(f"ours: {max(speeds):.1f} MB/s ({', '.join(f'{speed:.1f}' for speed in speeds)})")
    try:
        import pymotion  # noqa: F401
    except ImportError:
        print("peer: upc-pymotion is not installed; run: pip install 'dousa[bench]'")
        return
    ours, ingest.read_canonical = ingest.read_canonical, read_with_pymotion
    try:
        peer_report = add(files[:: max(1, len(files) // options.peer_files)], options.jobs)
    finally:
        ingest.read_canonical = ours
    peer = peer_report.bytes / 1e6 / peer_report.seconds
    print(f"peer: upc-pymotion as the reader, {len(peer_report.added)} files, {len(peer_report.skipped)} skipped")
    print(f"peer: {peer:.2f} MB/s")
    print(f"ratio: {max(speeds) / peer:.1f}")


if __name__ == "__main__":
    main()
