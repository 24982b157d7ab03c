"""What a library costs as it grows: making it, training, searching, and adding 64 clips to it when it is trained.

    python -m lab.benchmarks.scale [N ...] [--categories N] [--folder FOLDER] [--drawn K] [--replicate M]
        [--hours H] [--scanned H]
    python -m lab.benchmarks.scale --library PATH

The clips are made as by ``search.py``, 60 frames each. Prints for each size the clips written per second in
every tenth of it, or every 100,000; then, each in a process of its own, the seconds on the clock and of processors, and
the largest memory, of training, of the first search and warm ones, of adding 64 files of people and motions that
the library does not know, and of the search after that, and then of 64 more. A clip takes 14 kB before the training and
31 kB after it. With ``--library`` all but the making and training is done with a library that is there, and stays
changed.

With ``--drawn`` every tree grows from so many clips, as those of more than 100,000 do: a tenth of them shows in small
what becomes of a million.

With ``--replicate`` rows are added to each library, when all that is done, until it has so many clips, and searches are
timed in that: they cost what the rows cost, so a million clips need not be trained. ``first search of all`` reads every
row and makes the file of the index; ``first search`` is that of the next program; then 64 clips get another category.

With ``--hours`` a take of ten minutes is added to the first library, and takes made of it until there are so many
hours, 9 MB each. A motion and its mirror image are looked for in them: by a program that compares everything, by one
that makes the files of windows, and by the next; and it is told how many of the first ten places of the first are those
of the others, for ten motions. Memory is that of the program, the rest of which takes 0.2 GB. With ``--scanned`` the
files of windows are copied until there are so many hours, and looked through by themselves.
"""

from __future__ import annotations

import argparse
import multiprocessing
import pickle
import resource
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from unittest import mock

import numpy as np

from dousa.formats.registry import read_motion, write_motion
from dousa.library import Library
from dousa.library.results import Place
from dousa.library.store.features import find_feature_set
from dousa.library.store.forests import load_forest
from dousa.library.takes import windows as keeper
from dousa.messages import Message
from dousa.motion import canonicalise, compute_trajectories
from dousa.motion.canonical.canonicalise import mirror_canonical
from dousa.motion.synthetic.performers import CATEGORIES, draw_performer, make_motion
from dousa.retrieval.forest import trees
from dousa.retrieval.takes.find import TakeSearch, describe_query
from lab.benchmarks.replicas import copy_windows, replicate, replicate_take
from lab.benchmarks.search import make_library

N_ADDED = 64
N_WARM = 20


def make(path: Path, n_clips: int, n_categories: int) -> None:
    """Make a library, and print how fast its tenths are written."""
    last, rates, step = [0, time.perf_counter()], [], max(min(n_clips // 10, 100_000), 1)

    def tell(done: int) -> None:
        if done - last[0] >= step or done == n_clips:
            now = time.perf_counter()
            rates.append((done - last[0]) / (now - last[1]))
            last[:] = done, now

    make_library(path, n_clips, n_categories, tell)
    size, told = path.stat().st_size / 1e6, ", ".join(f"{rate:.0f}" for rate in rates)
    print(f"{n_clips} clips made, {size:.0f} MB: {told} a second", flush=True)


def write_files(folder: Path, n_categories: int, first: int) -> None:
    """Motions of people that the library does not know, in a folder for each category."""
    for number in range(N_ADDED):
        category = number % n_categories
        path = folder / f"kind {category:02}" / f"{first + number}.bvh"
        path.parent.mkdir(parents=True, exist_ok=True)
        write_motion(make_motion(CATEGORIES[category % len(CATEGORIES)], draw_performer(first + number)), path)


def measure(what: str, work: Callable[[], object]) -> None:
    """Do something, and print what it took."""
    wall, processors = time.perf_counter(), time.process_time()
    work()
    wall, processors = time.perf_counter() - wall, time.process_time() - processors
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    print(f"{what}: {wall:.3f} s ({processors:.3f} of processors), at most {peak:.2f} GB", flush=True)


def search(path: Path, what: str = "first search") -> None:
    """Time the first search and some warm ones, with all modules and kernels loaded."""
    with tempfile.TemporaryDirectory() as folder:
        small = Path(folder, "small.dousa")
        make_library(small, 60, 3)
        with Library.open(small) as library:
            library.train(n_trees=5)
            library.search(1)
    with Library.open(path) as library:
        measure(what, lambda: library.search(1))
        library.search(2)
        measure(f"{N_WARM} warm searches", lambda: [library.search(3 + number) for number in range(N_WARM)])
        people = [draw_performer(500 + number) for number in range(N_WARM)]
        strangers = [make_motion(CATEGORIES[k % len(CATEGORIES)], person, seed=k) for k, person in enumerate(people)]
        measure(f"{N_WARM} warm searches of people unknown", lambda: [library.search(one) for one in strangers])


def change(path: Path) -> None:
    """Time the search that follows a change of some clips, in a program that searched before."""
    with Library.open(path) as library:
        library.search(1)
        library.relabel(range(1, N_ADDED + 1), category="another")
        measure(f"search after {N_ADDED} clips were relabelled", lambda: library.search(100))


def train(path: Path) -> None:
    """Train a library in this process, and print what it took."""
    steps: dict[str, list[float]] = {}
    began = [time.perf_counter(), time.process_time()]
    last, name = list(began), "start"

    def tell(done: int, total: int, what: Message) -> None:
        nonlocal name
        now = [time.perf_counter(), time.process_time()]
        taken = steps.setdefault(name, [0.0, 0.0])
        for clock in range(2):
            taken[clock] += now[clock] - last[clock]
        last[:], name = now, what.code.rpartition(".")[2].removesuffix("_done")

    with Library.open(path) as library:
        report = library.train(progress=tell)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    wall, cpu = time.perf_counter() - began[0], time.process_time() - began[1]
    told = ", ".join(f"{step} {taken[0]:.1f} s ({taken[1]:.1f})" for step, taken in steps.items() if taken[0] > 0.05)
    own = steps.get("labeller", [0.0, 0.0])
    print(
        f"trained: {report.n_clips} clips, {wall - own[0]:.1f} s ({cpu - own[1]:.1f} of processors) without the "
        f"labeller, {wall:.1f} s with it, at most {peak:.2f} GB, {path.stat().st_size / 1e6:.0f} MB of file; {told}",
        flush=True,
    )


def train_from(path: Path, n_drawn: int | None) -> None:
    """Train a library; each tree from so many clips, where that is said."""
    with mock.patch.object(trees, "MOST_GROWN", trees.MOST_GROWN if n_drawn is None else n_drawn):
        train(path)


def add(path: Path, files: Path) -> None:
    """Time adding some files to a trained library."""
    with Library.open(path) as library:
        measure(f"add {N_ADDED} clips", lambda: library.add(files, n_jobs=1))


def find(path: Path, queries: list[Path], n_takes: int) -> None:
    """Time looking for a motion in takes, and count the places that are those of a search that compares everything."""
    there = f"in {n_takes} takes of ten minutes"
    with Library.open(path) as library, mock.patch.dict(keeper.WindowKeeper.open.__kwdefaults__, in_memory=1 << 60):
        for what in ("first", "second"):
            measure(f"{what} find {there}, all compared", lambda: library.find(queries[0], mirror=True))
        exact = [library.find(query, mirror=True).results for query in queries]
    path.with_suffix(".exact").write_bytes(pickle.dumps(exact))


def find_again(path: Path, queries: list[Path], n_takes: int) -> None:
    """Time looking for a motion in takes whose windows lie in files, which the first program makes."""
    there = f"in {n_takes} takes of ten minutes"
    exact: list[tuple[Place, ...]] = pickle.loads(path.with_suffix(".exact").read_bytes())
    with Library.open(path) as library:
        for what in ("first", "second", "third"):
            measure(f"{what} find {there}", lambda: library.find(queries[0], mirror=True))
        shares = []
        for query, expected in zip(queries, exact, strict=True):
            found = {(one.clip_id, one.start, one.end) for one in library.find(query, mirror=True).results}
            if expected:
                shares.append(np.mean([(one.clip_id, one.start, one.end) in found for one in expected]))
        print(f"of the first ten places {np.mean(shares):.3f} are found, {np.min(shares):.1f} at least", flush=True)


def scan(path: Path, query: Path, hours: float) -> None:
    """Time looking through files of windows alone."""
    far, count = copy_windows(path, hours)
    with Library.open(path) as library, library.database.reading() as connection:
        stored = load_forest(connection, library.name)
    assert stored is not None
    motion = canonicalise(compute_trajectories(read_motion(query)))
    asked = [
        describe_query(stored.forest, find_feature_set(stored.feature_set), one)
        for one in (motion, mirror_canonical(motion))
    ]

    def search() -> None:
        searches = [TakeSearch(one) for one in asked]
        for number in range(count):
            for one in searches:
                one.include(str(number))
        far.search(searches, {number: number for number in range(count)})
        for one in searches:
            one.finish(far.cutter)

    for what in ("first", "second", "third"):
        measure(f"{what} look through the files of {hours:.0f} hours", search)


def add_take(path: Path, file: Path) -> None:
    """Add a take of ten minutes."""
    people = [draw_performer(700 + number) for number in range(200)]
    motions = [make_motion(CATEGORIES[k % len(CATEGORIES)], person, seed=k) for k, person in enumerate(people)]
    rotations = np.concatenate([motion.rotations for motion in motions])
    translations = np.concatenate([motion.translations for motion in motions])
    count = round(600 * motions[0].frame_rate)
    some = np.arange(count) % len(rotations)
    write_motion(replace(motions[0], rotations=rotations[some], translations=translations[some]), file)
    with Library.open(path) as library:
        library.add(file, kind="take")


def use(path: Path, files: list[Path]) -> None:
    """Measure searches in a trained library, and adding to it."""
    run_alone(search, path)
    for some in files:
        run_alone(add, path, some)
        run_alone(search, path, "first search after that")


def run_alone(function: Callable[..., None], *arguments: object) -> None:
    """Call a function in a process of its own, so that its memory can be told."""
    process = multiprocessing.get_context("spawn").Process(target=function, args=arguments)
    process.start()
    process.join()
    if process.exitcode:
        raise SystemExit(f"{function.__name__} ended with {process.exitcode}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sizes", type=int, nargs="*", default=[10_000], metavar="N")
    parser.add_argument("--categories", type=int, default=70)
    parser.add_argument("--folder", type=Path, help="where the libraries are made; by default a temporary one")
    parser.add_argument("--drawn", type=int, metavar="K", help="clips that each tree grows from")
    parser.add_argument("--replicate", type=int, metavar="M", help="then search in so many clips, made of its rows")
    parser.add_argument("--hours", type=float, metavar="H", help="look for a motion in so many hours of takes")
    parser.add_argument("--scanned", type=float, metavar="H", help="look through files of so many hours by themselves")
    parser.add_argument("--library", type=Path, metavar="PATH", help="a trained library that is measured, and changed")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=options.folder) as folder:
        files = [Path(folder, name) for name in ("new", "more")]
        for number, one in enumerate(files, 1):
            write_files(one, options.categories, 1000 * number)
        if options.library:
            use(options.library, files)
            return
        for size in options.sizes:
            path = Path(folder, f"{size}.dousa")
            make(path, size, options.categories)
            run_alone(train_from, path, options.drawn)
            use(path, files)
            if options.hours and size == options.sizes[0]:
                add_take(path, Path(folder, "take.bvh"))
                queries = sorted(files[0].rglob("*.bvh"))[:10]
                n_takes = replicate_take(path, options.hours)
                for function in (find, find_again, find_again):
                    run_alone(function, path, queries, n_takes)
                if options.scanned:
                    run_alone(scan, path, queries[0], options.scanned)
            if options.replicate:
                replicate(path, options.replicate)
                print(f"{options.replicate} clips, made of these rows", flush=True)
                for what in ("first search of all", "first search"):
                    run_alone(search, path, what)
                run_alone(change, path)
            path.unlink()


if __name__ == "__main__":
    main()
