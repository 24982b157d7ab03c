"""Whether finding in takes on disk finds what comparing every window finds.

    python -m lab.benchmarks.find_many FOLDER [--performer-from RULE] [--minutes M] [--takes PATH ...]

The clips of a folder are joined into takes, but those of its last two people (the last, of three or less), which are
looked for: a search that compares all windows, and the search by sketches with more and fewer windows compared. Printed
is the share of the first ten places that both have. With ``--takes`` the takes are recordings instead.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path
from unittest import mock

import numpy as np

from dousa.formats.motion_files import find_motion_files
from dousa.formats.registry import read_motion
from dousa.library.takes import scanning
from dousa.library.takes.portions import read_portion, write_portion
from dousa.motion import canonicalise, compute_trajectories
from dousa.retrieval.takes.find import Found, TakeQuery, TakeSearch, describe_query, find_in_takes
from dousa.retrieval.takes.windows import TakeWindows, choose_grid, describe_take
from lab.benchmarks.take_material import FEATURE_SET, make_takes, read_or_make_clips, train_forest

COMPARED = 64, 256, 1024, scanning.MOST_COMPARED
MOST_QUERIES = 60
IN_A_FILE = 16  # takes


def find_on_disk(query: TakeQuery, far: scanning.TakesOnDisk, n_takes: int) -> list[Found]:
    search = TakeSearch(query, 10)
    for number in range(n_takes):
        search.include(str(number))
    far.search([search], {number: number for number in range(n_takes)})
    return search.finish(far.cutter)


def write_files(folder: Path, takes: list[TakeWindows], n_leaves: int) -> scanning.TakesOnDisk:
    portions, places = [], {}
    for start in range(0, len(takes), IN_A_FILE):
        some = [(number, 0, takes[number]) for number in range(start, min(start + IN_A_FILE, len(takes)))]
        path = folder / f"{start:06}.windows"
        write_portion(path, [], some, n_leaves)
        portions.append(read_portion(path))
        places.update({number: (start // IN_A_FILE, number - start) for number, _, _ in some})
    return scanning.TakesOnDisk(portions, places)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, nargs="?")
    parser.add_argument("--performer-from", default=None)
    parser.add_argument("--minutes", type=float, default=100.0)
    parser.add_argument("--takes", type=Path, nargs="*", help="recordings, or folders of them")
    options = parser.parse_args()
    clips = read_or_make_clips(options.folder, options.performer_from)
    people = sorted({clip.performer for clip in clips})
    left_out = people[-2:] if len(people) > 3 else people[-1:]
    known = [clip for clip in clips if clip.performer not in left_out]
    forest = train_forest(known)
    grid = choose_grid([len(clip.positions) / clip.frame_rate for clip in known])
    if options.takes:
        files = find_motion_files(options.takes)[0]
        motions = [canonicalise(compute_trajectories(read_motion(file.path))) for file in files]
    else:
        motions = make_takes(known, options.minutes)
    takes = [describe_take(forest, FEATURE_SET, motion, grid) for motion in motions]
    asked = [clip for clip in clips if clip.performer in left_out]
    asked = asked[:: -(-len(asked) // MOST_QUERIES)]
    n_windows, minutes = sum(len(one.leaves) for one in takes), sum(one.duration for one in takes) / 60
    print(f"{len(asked)} clips of {len(left_out)} people, {len(takes)} takes, {minutes:.0f} min, {n_windows} windows")
    queries = [describe_query(forest, FEATURE_SET, clip) for clip in asked]
    exact = [find_in_takes(one, [(str(k), take) for k, take in enumerate(takes)], limit=10) for one in queries]
    with tempfile.TemporaryDirectory() as folder:
        far = write_files(Path(folder), takes, forest.trees_.n_leaves)
        for most in (*COMPARED, n_windows):
            kept = most * scanning.MOST_KEPT // scanning.MOST_COMPARED
            with mock.patch.object(scanning, "MOST_COMPARED", most), mock.patch.object(scanning, "MOST_KEPT", kept):
                found = [find_on_disk(query, far, len(takes)) for query in queries]
            shares = [
                np.mean([any(same(one, own) for own in there) for one in wanted])
                for wanted, there in zip(exact, found, strict=True)
                if wanted
            ]
            equal = sum(there == wanted for wanted, there in zip(exact, found, strict=True))
            print(f"{most} compared: recall@10 {np.mean(shares):.3f}, {equal} of {len(queries)} answers the same")


def same(one: Found, other: Found) -> bool:
    return (one.take, one.start, one.stop) == (other.take, other.start, other.stop)


if __name__ == "__main__":
    main()
