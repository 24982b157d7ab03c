"""Time and memory of the densest files: 50 MB of numbers of one digit, or of one byte, which take most memory for it.

``python -m lab.reliability.dense_files [--megabytes 50] [--files NAME ...]`` writes each and reads it in a new process.
What is refused says so in the place of its frames.
"""

from __future__ import annotations

import argparse
import io
import pickle
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from itertools import chain
from pathlib import Path

import numpy as np

from dousa.formats.registry import write_motion
from dousa.motion import Motion, compute_trajectories
from dousa.motion.synthetic import draw_performer, make_motion
from lab.places import SHARED_DATA

NAMES = [f"m{number}" for number in range(30)]

_READ = """
import re, sys, time
from dousa.errors import DousaError
from dousa.formats.registry import read_motion
try:
    frames = read_motion(sys.argv[1]).n_frames
except DousaError as error:
    frames = f"refused: {error.code}"
spent, peak = time.process_time(), int(re.search(r"VmHWM:\\s*(\\d+)", open("/proc/self/status").read())[1])  # kB
print(f"{frames} | {spent:.1f} | {peak / 1e6:.2f}")
"""


def write_rows(mark: str, titles: list[list[str]], size: int) -> bytes:
    """A table: rows of titles, then for every frame its number, its time and the digits of the markers."""
    head = "".join(mark.join(row) + "\n" for row in titles).encode()
    width = 3 * len(NAMES)
    digits = np.random.default_rng(0).integers(48, 58, size=(size // (2 * width + 12), width), dtype=np.uint8)
    cells = np.full((len(digits), 2 * width), ord(mark), np.uint8)
    cells[:, ::2], cells[:, -1] = digits, 10
    return head + b"".join(f"{n}{mark}{n / 100:.2f}{mark}".encode() + row.tobytes() for n, row in enumerate(cells))


def make_files(size: int) -> Iterator[tuple[str, bytes]]:
    """Name and content of each file of so many bytes."""
    wide = [name for name in NAMES for _ in range(3)]
    axes = ["X", "Y", "Z"] * len(NAMES)
    keys = [["NO_OF_FRAMES", "9"], ["FREQUENCY", "100"], ["MARKER_NAMES", *NAMES]]
    yield (
        "qualisys.tsv",
        write_rows("\t", [*keys, ["Frame", "Time", *map(" ".join, zip(wide, axes, strict=True))]], size),
    )
    spread = [cell for name in NAMES for cell in (name, "", "")]
    head = [["DataRate", "NumFrames", "NumMarkers", "Units"], ["100", "9", "30", "m"]]
    yield "markers.trc", write_rows("\t", [*head, ["Frame#", "Time", *spread], ["", "", *axes]], size)
    titles = ["frame", "time", *(f"{name}_{axis.lower()}" for name, axis in zip(wide, axes, strict=True))]
    yield "titles.csv", write_rows(",", [titles], size)
    fields = [["Format Version", "1.23", "Capture Frame Rate", "100", "Length Units", "Meters"], []]
    rows = [["", "Type", *["Marker"] * len(wide)], ["", "Name", *wide], ["", "", *["Position"] * len(wide)]]
    yield "motive.csv", write_rows(",", [*fields, *rows, ["Frame", "Time", *axes]], size)
    points = np.random.default_rng(0).integers(0, 10, size=(size // (17 * 8 + 24), 17, 3)).tolist()
    yield "lists.json", ("[" + ",".join(str(frame).replace(" ", "") for frame in points) + "]").encode()
    flat = (str([value for point in frame for value in point]).replace(" ", "") for frame in points)
    yield "objects.json", ('{"frames":[' + ",".join(f'{{"keypoints_3d":{row}}}' for row in flat) + "]}").encode()
    long = (f"{n},{place},1,{(n + place) % 10},2\n" for n in range(size // (17 * 14)) for place in range(17))
    yield "points.csv", ("frame,keypoint,x,y,z\n" + "".join(long)).encode()


def make_long(frames: int) -> Motion:
    """A walk over and over."""
    motion = make_motion("walk", draw_performer(0))
    rows = np.arange(frames) % motion.n_frames
    return motion.replace(rotations=motion.rotations[rows], translations=motion.translations[rows])


def write_digits(frame: str, size: int) -> bytes:
    """Frames of one text, of which each 7 is another digit in each."""
    shape = np.frombuffer(frame.encode(), np.uint8)
    frames = np.tile(shape, (size // len(shape), 1))
    digits = np.flatnonzero(shape == ord("7"))
    frames[:, digits] = np.random.default_rng(0).integers(48, 58, size=(len(frames), len(digits)), dtype=np.uint8)
    return frames.tobytes()


def make_rotations(size: int) -> Iterator[tuple[str, bytes]]:
    """Name and content of each file of rotations, or of one byte for each number."""
    walk = make_long(1)
    with tempfile.TemporaryDirectory() as folder:

        def write(suffix: str, motion: Motion) -> bytes:
            path = Path(folder, f"a{suffix}")
            points = suffix in (".c3d", ".trc")
            write_motion(compute_trajectories(motion) if points else motion, path)
            return path.read_bytes()

        def fill(suffix: str) -> bytes:
            one, two = (len(write(suffix, make_long(count))) for count in (1000, 2000))
            return write(suffix, make_long(1000 * size // (two - one)))

        head = write(".bvh", walk).partition(b"MOTION")[0] + b"MOTION\nFrames: 9\nFrame Time: 0.01\n"
        yield "body.bvh", head + write_digits(" ".join("7" * (head.count(b"rotation") + 3)) + "\n", size)
        turns = b"CHANNELS 3 Xrotation Yrotation Zrotation\n"
        root = b"HIERARCHY\nROOT a\n{\nOFFSET 0 0 0\n" + turns + b"End Site\n{\nOFFSET 0 1 0\n}\n}\n"
        yield "bone.bvh", root + b"MOTION\nFrames: 9\nFrame Time: 0.01\n" + write_digits("7 7 7\n", size)
        for suffix in (".c3d", ".glb", ".vmd", ".npz", ".amass.npz"):
            yield f"walk{suffix}", fill(suffix)
    take = SHARED_DATA / "cmu86/86_01.amc"
    if take.exists():
        head, _, rest = take.read_text().partition("\n1\n")
        frame = re.sub(r"(?<= )\S+", "7", rest.partition("\n2\n")[0])
        yield take.name, head.encode() + b"\n" + write_digits(f"7\n{frame}\n", size)
    segments, names = 23, " ".join("7" * 23 * 4)
    frame = f'<frame time="0" index="0" type="normal"><orientation>{names}</orientation></frame>\n'
    top = f'<mvnx><subject frameRate="60" segmentCount="{segments}"><frames>'
    yield "segments.mvnx", top.encode() + write_digits(frame, size) + b"</frames></subject></mvnx>"
    points = np.random.default_rng(0).integers(0, 10, size=(size // 51, 17, 3), dtype=np.int8)
    for name, save in (("bytes.npy", np.save), ("squeezed.npz", np.savez_compressed)):
        file = io.BytesIO()
        save(file, np.repeat(points, 1 if name == "bytes.npy" else 2, axis=0))
        yield name, file.getvalue()
    yield "lists.pkl", pickle.dumps({"keypoints3d": points[: size // (2 * 51 + 9 * 18)].tolist()})
    zeros = io.BytesIO()
    np.savez_compressed(zeros, joints=np.zeros((20 * size // 51, 17, 3), np.int8))
    yield "zeros.npz", zeros.getvalue()


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--megabytes", type=float, default=50)
    parser.add_argument("--files", nargs="+", metavar="NAME", help="some of them; all by default")
    options = parser.parse_args()
    print("| file | MB | frames | s of a processor | GB at most |\n" + "| --- " * 5 + "|")
    size = int(options.megabytes * 1e6)
    with tempfile.TemporaryDirectory() as folder:
        for name, content in chain(make_rotations(size), make_files(size)):
            if options.files and name not in options.files:
                continue
            path = Path(folder, name)
            path.write_bytes(content)
            if path.suffix == ".amc":
                path.with_name("86.asf").write_bytes((SHARED_DATA / "cmu86/86.asf").read_bytes())
            found = subprocess.run(
                [sys.executable, "-c", _READ, path], capture_output=True, text=True, check=True
            ).stdout
            print(f"| {name} | {len(content) / 1e6:.0f} | {found.strip()} |", flush=True)


if __name__ == "__main__":
    main()
