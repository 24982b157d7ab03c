"""Finding a motion in 100 minutes of takes at 30 frames a second.

    python -m lab.benchmarks.find [FOLDER] [--performer-from RULE] [--minutes M] [--takes PATH ...]

Clips of the folder (or synthetic ones) are joined into takes and described once; then clips are looked for, warm. The
peer is stumpy's MASS: the distance profiles of the same small poses, one for each of their 27 numbers, summed; it
compares at the query's own tempo only and knows no trees.

With --on-disk nothing is timed: does the search by sketches, in takes on disk, find what comparing every window finds?
The takes are made without the last two people (the last, of three or less), whose clips are looked for; the note is the
share of the first ten places that both have, with more and fewer windows compared. With --takes these are recordings.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from unittest import mock

import numpy as np

from dousa.formats.motion_files import find_motion_files
from dousa.formats.registry import read_motion
from dousa.library.takes import scanning
from dousa.library.takes.portions import read_portion, write_portion
from dousa.motion import canonicalise, compute_trajectories
from dousa.retrieval import LabelledClip
from dousa.retrieval.takes.find import Found, TakeQuery, TakeSearch, describe_query, find_in_takes
from dousa.retrieval.takes.windows import TakeWindows, choose_grid, describe_take
from lab.benchmarks.take_material import FEATURE_SET, make_takes, read_or_make_clips, train_forest
from lab.benchmarks.timing import Row, run, spend, take_turns

COMPARED = 64, 256, 1024, scanning.MOST_COMPARED
MOST_QUERIES = 60
IN_A_FILE = 16  # takes


def find_by_stumpy(poses: np.ndarray, series: Sequence[np.ndarray]) -> list[float]:
    """The least summed distance of each take."""
    import stumpy

    best = []
    for one in series:
        total = np.zeros(len(one) - len(poses) + 1)
        for k in range(one.shape[1]):
            total += stumpy.mass(poses[:, k], one[:, k], normalize=False) ** 2
        best.append(float(total.min()))
    return best


def measure(clips: list[LabelledClip], minutes: float, repeats: int) -> Iterator[Row]:
    """The clip of middle length, and a short and a long one."""
    forest = train_forest(clips)
    durations = [len(clip.positions) / clip.frame_rate for clip in clips]
    grid, made = choose_grid(durations), make_takes(clips, minutes)
    describe_take(forest, FEATURE_SET, made[0], grid)
    spent, described = spend(lambda: [describe_take(forest, FEATURE_SET, take, grid, n_jobs=2) for take in made])
    takes = [(str(k), one) for k, one in enumerate(described)]
    frames = sum(one.n_frames for one in described)
    yield Row(f"describe {frames / 1800:.0f} minutes of takes once", spent, amount=frames, unit="frames/s")
    order = np.argsort(durations)
    for place in (0.1, 0.9, 0.5):
        query = describe_query(forest, FEATURE_SET, clips[order[int(place * len(order))]])
        work = f"find {len(query.poses) / 30:.1f} s in {frames / 1800:.0f} minutes of takes, warm, tempo 0.5 to 2"
        calls = {"ours": lambda query=query: find_in_takes(query, takes)}
        series = [one.poses.astype(np.float64) for one in described]
        try:
            import stumpy  # noqa: F401

            calls["theirs"] = lambda query=query, all_of=series: find_by_stumpy(query.poses.astype(np.float64), all_of)
        except ImportError:
            print("stumpy is not installed; run: pip install 'dousa[bench]'", file=sys.stderr)
        found = take_turns(calls, repeats)
        yield Row(work, found["ours"], "stumpy.mass, one tempo" if "theirs" in found else "", found.get("theirs"))


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


def compare_on_disk(clips: list[LabelledClip], minutes: float, recordings: list[Path] | None) -> Iterator[Row]:
    """Shares of the first ten places."""
    people = sorted({clip.performer for clip in clips})
    left_out = people[-2:] if len(people) > 3 else people[-1:]
    known = [clip for clip in clips if clip.performer not in left_out]
    forest, grid = train_forest(known), choose_grid([len(clip.positions) / clip.frame_rate for clip in known])
    if recordings:
        files = find_motion_files(recordings)[0]
        motions = [canonicalise(compute_trajectories(read_motion(file.path))) for file in files]
    else:
        motions = make_takes(known, minutes)
    takes = [describe_take(forest, FEATURE_SET, motion, grid) for motion in motions]
    asked = [clip for clip in clips if clip.performer in left_out]
    queries = [describe_query(forest, FEATURE_SET, clip) for clip in asked[:: -(-len(asked) // MOST_QUERIES)]]
    n_windows = sum(len(one.leaves) for one in takes)
    named = [(str(k), take) for k, take in enumerate(takes)]
    spent, exact = spend(lambda: [find_in_takes(one, named, limit=10) for one in queries])
    yield Row(f"{len(queries)} queries, all {n_windows:,} windows compared", spent)
    with tempfile.TemporaryDirectory() as folder:
        far = write_files(Path(folder), takes, forest.trees_.n_leaves)
        for most in (*COMPARED, n_windows):
            kept = most * scanning.MOST_KEPT // scanning.MOST_COMPARED
            with mock.patch.object(scanning, "MOST_COMPARED", most), mock.patch.object(scanning, "MOST_KEPT", kept):
                spent, found = spend(lambda: [find_on_disk(query, far, len(takes)) for query in queries])
            pairs = list(zip(exact, found, strict=True))
            shares = [
                np.mean([any(same(one, own) for own in there) for one in wanted]) for wanted, there in pairs if wanted
            ]
            equal = sum(there == wanted for wanted, there in pairs)
            yield Row(f"{most:,} compared", spent, note=f"recall@10 {np.mean(shares):.3f}, {equal} answers the same")


def same(one: Found, other: Found) -> bool:
    return (one.take, one.start, one.stop) == (other.take, other.start, other.stop)


def benchmark(options: argparse.Namespace) -> Iterator[Row]:
    clips = read_or_make_clips(options.folder, options.performer_from)
    if options.on_disk or options.takes:
        yield from compare_on_disk(clips, options.minutes, options.takes)
    else:
        yield from measure(clips, options.minutes, options.repeats)


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("folder", type=Path, nargs="?")
    parser.add_argument("--performer-from", default=None)
    parser.add_argument("--minutes", type=float, default=100.0)
    parser.add_argument("--on-disk", action="store_true", help="compare what is found in takes on disk")
    parser.add_argument("--takes", type=Path, nargs="*", help="recordings, or folders of them, on disk")


if __name__ == "__main__":
    run(__doc__, benchmark, add_options)
