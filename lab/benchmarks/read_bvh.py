"""Reading BVH: dousa (file to Motion, metres, reference frame inferred) against upc-pymotion and bvhio.

    python -m lab.benchmarks.read_bvh [DATA_FOLDER]     # default ../shared/data; needs pip install 'dousa[bench]'

All read the same 200 files of DATA_FOLDER/bandai in one process, one core, after a warm-up; best of three
rounds, processor time. Values are compared with Python's float() on ten of the files.
"""

from __future__ import annotations

import importlib
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from dousa.formats.bvh.reading import read_bvh

N_FILES = 200


def find_files(folder: Path) -> list[Path]:
    """200 files spread over all kinds of motion."""
    files = sorted((folder / "bandai").rglob("*.bvh"))
    if not files:
        sys.exit(f"no BVH files in {folder / 'bandai'}; name the folder that holds bandai/")
    chosen = np.linspace(0, len(files) - 1, min(N_FILES, len(files))).astype(int)
    return [files[number] for number in chosen]


def seconds_for(readers: list[Callable[[str], object]], files: list[Path], rounds: int) -> list[float]:
    """Shortest processor time of each reader for all files; they take turns, so that other load hits all."""
    best = [float("inf")] * len(readers)
    for _ in range(rounds):
        for number, read in enumerate(readers):
            start = time.process_time()
            for path in files:
                read(str(path))
            best[number] = min(best[number], time.process_time() - start)
    return best


def check_values(files: list[Path]) -> None:
    """Stop if a value differs from Python's float() in a single bit."""
    for path in files:
        rows = path.read_text().split("Frame Time:")[1].splitlines()[1:]
        wanted = np.array([[float(word) for word in row.split()] for row in rows if row.strip()])
        provenance = read_bvh(path).provenance
        if provenance is None or provenance.values is None or provenance.values.tobytes() != wanted.tobytes():
            sys.exit(f"{path}: values differ from float()")


def find_peers() -> dict[str, Callable[[str], object]]:
    """Readers of the packages that are installed; says which are missing."""
    found: dict[str, Callable[[str], object]] = {}
    try:
        pymotion = importlib.import_module("pymotion.io.bvh")
        found["upc-pymotion"] = lambda path: pymotion.BVH().load(path)
    except ImportError:
        print("upc-pymotion is not installed; run: pip install 'dousa[bench]'")
    try:
        found["bvhio"] = importlib.import_module("bvhio").readAsBvh
    except ImportError:
        print("bvhio is not installed; run: pip install 'dousa[bench]'")
    return found


def main() -> None:
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else "../shared/data")
    files = find_files(folder)
    megabytes = sum(path.stat().st_size for path in files) / 1e6
    start = time.perf_counter()
    read_bvh(files[0])
    print(f"{len(files)} files, {megabytes:.1f} MB; first file of this process {time.perf_counter() - start:.2f} s")
    check_values(files[:: max(1, len(files) // 10)])
    print("values equal to float() to the last bit")
    peers = find_peers()
    ours, *theirs = seconds_for([read_bvh, *peers.values()], files, 3)
    print(f"{'dousa':<14}{megabytes / ours:8.1f} MB/s")
    for name, seconds in zip(peers, theirs, strict=True):
        print(f"{name:<14}{megabytes / seconds:8.1f} MB/s   dousa is {seconds / ours:.1f} times as fast")


if __name__ == "__main__":
    main()
