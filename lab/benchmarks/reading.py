"""Reading BVH, AMC and C3D: file to Motion or Trajectories (metres), one core.

    python -m lab.benchmarks.reading [DATA_FOLDER]     # default ../shared/data

200 files of DATA_FOLDER/bandai and takes of hdm05 and cmu86. Peers: NumPy's own splitting of a file's numbers
(``loadtxt``), which gives neither skeleton nor rotations; upc-pymotion and bvhio, on every tenth file; of AMC the
loop that everybody writes, which stops at the values; of small C3D ezc3d, which does not look for unit, axes and body.
Ours are compared with Python's ``float()`` to the last bit.
"""

from __future__ import annotations

import argparse
import importlib
import sys
from collections.abc import Callable, Iterator, Sequence
from io import BytesIO
from pathlib import Path

import numpy as np

from dousa.files.disk import read_bytes
from dousa.formats.asf_amc.reading import parse_frames, parse_header, read_amc
from dousa.formats.asf_amc.skeleton import AsfSkeleton, read_asf
from dousa.formats.bvh.reading import read_bvh
from dousa.formats.c3d import read_c3d
from dousa.formats.numbers import scannable
from lab.benchmarks.timing import Row, run, take_turns
from lab.places import SHARED_DATA

N_FILES = 200


def split_bvh(path: Path) -> np.ndarray:
    """All numbers of the motion, by what NumPy has for it: ``fromstring`` and ``array(text.split())`` are slower."""
    return np.loadtxt(BytesIO(path.read_bytes().partition(b"Frame Time:")[2].partition(b"\n")[2]))


def read_amc_plainly(path: Path) -> list[dict[str, list[float]]]:
    """Per frame the values of every bone, as everybody writes it."""
    frames: list[dict[str, list[float]]] = []
    with open(path, encoding="latin-1") as file:
        for words in map(str.split, file):
            if len(words) == 1 and words[0].isdigit():
                frames.append({})
            elif frames and words and words[0][0] not in "#:":
                frames[-1][words[0]] = [float(word) for word in words[1:]]
    return frames


def check_bvh(path: Path) -> None:
    """Stop if a value differs from Python's float() in a single bit."""
    rows = path.read_text().split("Frame Time:")[1].splitlines()[1:]
    wanted = np.array([[float(word) for word in row.split()] for row in rows if row.strip()])
    provenance = read_bvh(path).provenance
    if provenance is None or provenance.values is None or provenance.values.tobytes() != wanted.tobytes():
        sys.exit(f"{path}: values differ from float()")


def find_skeleton(path: Path, folder: Path) -> AsfSkeleton:
    """The .asf of one of our takes."""
    return read_asf(folder / "cmu86/86.asf" if "cmu86" in path.parts else folder / "hdm05" / f"{path.name[:6]}.asf")


def check_amc(path: Path, folder: Path) -> None:
    """Stop if a channel value differs in a single bit."""
    asf, data = find_skeleton(path, folder), scannable(read_bytes(path))
    ours, _ = parse_frames(str(path), data, parse_header(str(path), data).first_frame_at, asf)
    names = ["root", *(bone.name for bone in asf.bones if bone.dof)]
    wanted = np.array([[value for name in names for value in frame[name]] for frame in read_amc_plainly(path)])
    if ours.tobytes() != wanted.tobytes():
        sys.exit(f"{path}: values differ from float()")


def compare(
    work: str, files: Sequence[Path], ours: Callable[[Path], object], peers: dict[str, Callable[[Path], object]], n: int
) -> Iterator[Row]:
    """A row for each peer."""
    size = sum(path.stat().st_size for path in files) / 1e6
    calls = {"ours": ours, **peers}
    found = take_turns({name: lambda read=read: [read(path) for path in files] for name, read in calls.items()}, n)
    for name in peers:
        yield Row(f"{work}, {len(files)} files", found["ours"], name, found[name], size, "MB/s")


def find_packages() -> dict[str, Callable[[Path], object]]:
    """Readers of BVH in packages that are installed."""
    found: dict[str, Callable[[Path], object]] = {}
    for name, module in (("upc-pymotion", "pymotion.io.bvh"), ("bvhio", "bvhio")):
        try:
            package = importlib.import_module(module)
        except ImportError:
            print(f"{name} is not installed; run: pip install 'dousa[bench]'", file=sys.stderr)
            continue
        if name == "bvhio":
            found[name] = lambda path, package=package: package.readAsBvh(str(path))
        else:
            found[name] = lambda path, package=package: package.BVH().load(str(path))
    return found


def benchmark(options: argparse.Namespace) -> Iterator[Row]:
    bvh = sorted((options.folder / "bandai").rglob("*.bvh"))
    amc = sorted(path for path in options.folder.glob("*/**/*") if path.suffix.lower() == ".amc")
    if bvh:
        bvh = [bvh[k] for k in np.linspace(0, len(bvh) - 1, min(N_FILES, len(bvh))).astype(int)]
        for path in bvh[::20]:
            check_bvh(path)
        numpy = {"NumPy (loadtxt), numbers only": split_bvh}
        yield from compare("BVH to Motion", bvh, read_bvh, numpy, options.repeats)
        yield from compare("BVH to Motion", bvh[::10], read_bvh, find_packages(), options.repeats)
    if amc:
        for path in amc[:: max(1, len(amc) // 20)]:
            check_amc(path, options.folder)
        some, plain = amc[:: max(1, len(amc) // 40)], {"a plain Python loop, numbers only": read_amc_plainly}
        yield from compare("AMC to Motion", some, read_amc, plain, options.repeats)
    c3d = sorted((options.folder / "utd_mhad/skeleton").rglob("*.c3d"))[:N_FILES]
    if c3d:
        ezc3d = importlib.import_module("ezc3d")
        peer = {"ezc3d": lambda path: ezc3d.c3d(str(path))}
        yield from compare("C3D to Trajectories", c3d, read_c3d, peer, options.repeats)


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("folder", nargs="?", type=Path, default=SHARED_DATA)


if __name__ == "__main__":
    run(__doc__, benchmark, add_options)
