"""Time and memory of the densest files: 50 MB of numbers of one digit, which take most memory for their size.

``python -m lab.reliability.dense_files [--megabytes 50]`` writes each and reads it in a new process.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

NAMES = [f"m{number}" for number in range(30)]

_READ = """
import resource, sys, time
from dousa.formats.registry import read_motion
frames = read_motion(sys.argv[1]).n_frames
spent, peak = time.process_time(), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
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


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--megabytes", type=float, default=50)
    options = parser.parse_args()
    print("| file | MB | frames | s of a processor | GB at most |\n" + "| --- " * 5 + "|")
    with tempfile.TemporaryDirectory() as folder:
        for name, content in make_files(int(options.megabytes * 1e6)):
            path = Path(folder, name)
            path.write_bytes(content)
            found = subprocess.run(
                [sys.executable, "-c", _READ, path], capture_output=True, text=True, check=True
            ).stdout
            print(f"| {name} | {len(content) / 1e6:.0f} | {found.strip()} |", flush=True)


if __name__ == "__main__":
    main()
