"""Four programs that add to one trained library at once, while a fifth searches: does everything come through?

    python -m lab.reliability.many_writers [--clips N] [--writers N] [--files N] [--url URL]

Makes a library of N clips as ``lab/benchmarks/search.py`` does, in a temporary file or at the URL of an empty database,
trains it, and adds to it from as many processes as there are writers, each with motions of its own of people
whom the library does not know. Prints the seconds until each was done, how many searches were answered meanwhile and
the slowest of them, and what is there afterwards: clips, clips that the forest has learned, and the result of a check.
The exit code is 1 if anything failed or is missing.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from dousa.formats.registry import write_motion
from dousa.library import Library
from dousa.motion.synthetic.performers import CATEGORIES, draw_performer, make_motion
from lab.benchmarks.search import make_library

CATEGORIES_MADE = 70
WRITER = """
import sys
from dousa import Library
with Library.open(sys.argv[1], timeout=600) as library:
    library.add(sys.argv[2], n_jobs=1)
"""


def write_files(folder: Path, writer: int, n_files: int) -> None:
    """Motions of one writer, in a folder for each category."""
    for number in range(n_files):
        kind = number % len(CATEGORIES)
        path = folder / f"kind {kind:02}" / f"w{writer}_{number}.bvh"
        path.parent.mkdir(parents=True, exist_ok=True)
        write_motion(make_motion(CATEGORIES[kind], draw_performer(1000 + 100 * writer + number), seed=number), path)


def main() -> int:
    """Make, train, write and look."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--clips", type=int, default=20_000)
    parser.add_argument("--writers", type=int, default=4)
    parser.add_argument("--files", type=int, default=16, help="of each writer")
    parser.add_argument("--trees", type=int, default=100)
    parser.add_argument("--url", help="of an empty database; by default a file")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        library = options.url or str(folder / "moves.dousa")
        make_library(library, options.clips, min(CATEGORIES_MADE, options.clips // 10))
        start = time.perf_counter()
        with Library.open(library) as opened:
            opened.train(n_trees=options.trees)
        print(f"{options.clips} clips trained in {time.perf_counter() - start:.0f} s", flush=True)
        for writer in range(options.writers):
            write_files(folder / str(writer), writer, options.files)
        start = time.perf_counter()
        command = [sys.executable, "-c", WRITER, library]
        programs = [
            subprocess.Popen([*command, str(folder / str(n))], stdout=subprocess.DEVNULL)
            for n in range(options.writers)
        ]
        answers, done = [], {}
        with Library.open(library) as opened:
            while len(done) < len(programs):
                began = time.perf_counter()
                opened.search(1, 10)
                answers.append(time.perf_counter() - began)
                time.sleep(0.2)
                for number, program in enumerate(programs):
                    if program.poll() is not None and number not in done:
                        done[number] = time.perf_counter() - start
        print("writers done after " + ", ".join(f"{seconds:.1f}" for seconds in sorted(done.values())) + " s")
        print(f"{len(answers)} searches meanwhile, the slowest {max(answers):.2f} s")
        failed = [program.returncode for program in programs if program.returncode]
        with Library.open(library) as opened:
            n_clips, n_learned = len(opened.clips()), opened.stats().n_learned
            report = opened.check()
        wanted = options.writers * options.files
        print(f"{n_clips} clips of {options.clips + wanted}, {n_learned} learned of {wanted}; sound: {report.is_sound}")
        return int(bool(failed) or n_clips != options.clips + wanted or n_learned != wanted or not report.is_sound)


if __name__ == "__main__":
    sys.exit(main())
