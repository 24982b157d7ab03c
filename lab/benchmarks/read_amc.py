"""Reading AMC: dousa (file to Motion: quaternions, metres) against a plain Python reader (file to numbers only).

    python -m lab.benchmarks.read_amc [DATA_FOLDER]     # default ../shared/data

Both read all takes of DATA_FOLDER/hdm05 and DATA_FOLDER/cmu86 in one process, one core, after one warm-up; best of four
rounds, processor time. The plain reader does less work: it stops at the channel values, which are compared to the
last bit.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from dousa.files.disk import read_bytes
from dousa.formats.asf_amc.reading import parse_frames, parse_header, read_amc
from dousa.formats.asf_amc.skeleton import AsfSkeleton, read_asf
from dousa.formats.numbers import scannable


def read_plainly(path: Path) -> list[dict[str, list[float]]]:
    """The peer: per frame the values of every bone, as everybody writes it."""
    frames: list[dict[str, list[float]]] = []
    frame: dict[str, list[float]] = {}
    with open(path, encoding="latin-1") as file:
        for line in file:
            words = line.split()
            if not words or words[0][0] in "#:":
                continue
            if len(words) == 1 and words[0].isdigit():
                frame = {}
                frames.append(frame)
            else:
                frame[words[0]] = [float(word) for word in words[1:]]
    return frames


def find_skeleton(path: Path, folder: Path) -> AsfSkeleton:
    """The .asf of one of our takes."""
    return read_asf(folder / "cmu86/86.asf" if "cmu86" in path.parts else folder / "hdm05" / f"{path.name[:6]}.asf")


def check_values(files: list[Path], folder: Path) -> None:
    """Stop if a channel value differs in a single bit."""
    for path in files:
        asf, data = find_skeleton(path, folder), scannable(read_bytes(path))
        ours = parse_frames(str(path), data, parse_header(str(path), data).first_frame_at, asf)
        names = ["root", *(bone.name for bone in asf.bones if bone.dof)]
        wanted = np.array([[value for name in names for value in frame[name]] for frame in read_plainly(path)])
        if ours.tobytes() != wanted.tobytes():
            sys.exit(f"{path}: values differ from float()")


def seconds_for(readers: list[Callable[[Path], object]], files: list[Path], rounds: int) -> list[float]:
    """Shortest processor time of each reader for all files; they take turns, so that other load hits both."""
    best = [float("inf")] * len(readers)
    for _ in range(rounds):
        for number, read in enumerate(readers):
            start = time.process_time()
            for path in files:
                read(path)
            best[number] = min(best[number], time.process_time() - start)
    return best


def main() -> None:
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else "../shared/data")
    files = sorted(path for path in folder.glob("*/**/*") if path.suffix.lower() == ".amc")
    if not files:
        sys.exit(f"no AMC files in {folder}; name the folder that holds hdm05/ and cmu86/")
    megabytes = sum(path.stat().st_size for path in files) / 1e6
    start = time.perf_counter()
    read_amc(files[0])
    print(f"{len(files)} files, {megabytes:.1f} MB; first file of this process {time.perf_counter() - start:.2f} s")
    check_values(files[:: max(1, len(files) // 20)], folder)
    print("values equal to float() to the last bit")
    ours, theirs = seconds_for([read_amc, read_plainly], files, 4)
    print(f"{'dousa':<14}{megabytes / ours:8.1f} MB/s")
    print(f"{'plain Python':<14}{megabytes / theirs:8.1f} MB/s   dousa is {theirs / ours:.1f} times as fast")


if __name__ == "__main__":
    main()
