"""Killing programs that write to a library, at random moments: is it whole, and does the same command end the work?

    python -m lab.reliability.library_kill [--kills N] [--seed N] [--only COMMAND]

A small trained library, its arrays in rows or in fragments, is copied; a process adds clips to it, trains, relabels,
tags, removes, undoes, names a part of a take, compacts, moves arrays to fragments or repairs, and is killed (SIGKILL)
at a random moment of the time that it takes. Then every checksum and the structure of the file are compared, the same
is done again without being killed, and the library must say the same as if nobody had been killed: names, labels, tags,
joints, the answers of a search. Prints kills by command, and what failed; the exit code is 1 if something did.
Processes are forked from one in which all is compiled, so that what is killed is the writing and not the beginning of a
program.
"""

from __future__ import annotations

import argparse
import os
import random
import shutil
import signal
import sqlite3
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from contextlib import closing, suppress
from pathlib import Path
from typing import Any

from dousa.errors import LibraryError
from dousa.formats.registry import write_motion
from dousa.library import Library
from dousa.library import add as adding
from dousa.motion.synthetic.performers import CATEGORIES, draw_performer, make_motion

Work = Callable[[Library], Any]
KINDS = CATEGORIES[:3]


def write_files(folder: Path, performers: range) -> None:
    """One short motion of each kind and performer."""
    for number in performers:
        for kind in KINDS:
            path = folder / kind / f"{kind}_p{number}.bvh"
            path.parent.mkdir(parents=True, exist_ok=True)
            write_motion(make_motion(kind, draw_performer(number), seed=number), path)


def list_commands(folder: Path) -> dict[str, Work]:
    """What is done to a library, by name; each may be done again after it was stopped."""
    more, repaired = folder / "more", folder / "base" / KINDS[0] / f"{KINDS[0]}_p0.bvh"
    return {
        "add": lambda library: library.add(more, performer_from=r"name:_(p\d+)", n_jobs=1),
        "train": lambda library: library.train(n_trees=5, random_state=3, n_jobs=1),
        "relabel": lambda library: library.relabel(where_category=KINDS[0], performer="somebody"),
        "tag": lambda library: library.tag([2, 3, 4], add=["fight", "draft"]),
        "remove": lambda library: _unless_done(lambda: library.remove(category=KINDS[1])),
        "remove for good": lambda library: _unless_done(lambda: library.remove(category=KINDS[1], for_good=True)),
        "undo": lambda library: _unless_done(lambda: library.undo(_find_removal(library), n_jobs=1)),
        "name": lambda library: _name_part(library, folder / "take.bvh"),
        "replace": lambda library: library.add_motion(library.trajectories(5), str(repaired), n_jobs=1),
        "compact": lambda library: library.compact(),
        "fragments": lambda library: library.compact(fragments=""),
        "check": lambda library: library.check(repair=True),
    }


def _unless_done(work: Callable[[], Any]) -> None:
    with suppress(LibraryError):  # it was done before the kill: nothing is left that it could be done to
        work()


def _find_removal(library: Library) -> int:
    return next(entry.number for entry in library.journal() if entry.kind == "remove")


def _name_part(library: Library, file: Path) -> None:
    clips = library.clips()
    if all(clip.start_s is None for clip in clips):  # a second time would be another segment, and another lesson
        library.annotations.name(next(clip.id for clip in clips if clip.kind == "take"), 0.2, 0.9, KINDS[2])
    library.add(file, kind="take", n_jobs=1)  # the next add, of anything, learns from a part named before the kill


def make_base(folder: Path, *, in_fragments: bool) -> Path:
    """A trained library with a take, a tag, and a removal that can be undone."""
    path = folder / f"base{int(in_fragments)}.dousa"
    with Library.open(path, create=True) as library:
        library.add(folder / "base", performer_from=r"name:_(p\d+)", n_jobs=1)
        library.add(folder / "take.bvh", kind="take", n_jobs=1)
        library.train(n_trees=5, n_jobs=1)
        library.tag([1], add=["favourite"])
        if in_fragments:
            library.compact(fragments="")
        library.remove([6])
    return path


def copy_library(source: Path, target: Path) -> None:
    """A library file and its fragments."""
    for path in target.parent.glob(f"{target.name}*"):
        shutil.rmtree(path) if path.is_dir() else path.unlink()
    shutil.copy(source, target)
    if Path(f"{source}.fragments").exists():
        shutil.copytree(f"{source}.fragments", f"{target}.fragments")


def dump(path: Path) -> dict[str, Any]:
    """What a library says, without numbers and dates."""
    with Library.open(path) as library:
        clips = library.clips()
        names = {clip.id: clip.path for clip in clips}
        stats = library.stats()
        hits = library.search(next(clip.id for clip in clips if clip.kind == "clip"), 50).results
        return {
            "clips": [
                (c.path, c.kind, c.category, c.performer, c.tags, c.predicted_category, c.start_s) for c in clips
            ],
            "joints": {
                names[number]: joints.positions.tobytes()
                for number, joints in library.iterate_trajectories(list(names))
            },
            "hits": [(hit.path, round(hit.distance, 9)) for hit in hits],
            "learned": (stats.n_trained, stats.n_learned, stats.forest_is_current, stats.categories),
            "takes": [(place.take, place.start) for place in library.find(clips[0].id, k=3).results]
            if any(clip.kind == "take" for clip in clips)
            else [],
        }


def find_fault(path: Path) -> str | None:
    """What is damaged in a library."""
    with closing(sqlite3.connect(path)) as connection:
        said = connection.execute("PRAGMA integrity_check").fetchall()
        if said != [("ok",)] or connection.execute("PRAGMA foreign_key_check").fetchall():
            return f"structure: {said}"
    with Library.open(path) as library:
        damage = library.check().damage
        return None if not damage else f"damaged: {damage[0]}"


def work_in_process(path: Path, work: Work, wait: float | None) -> bool:
    """Do something in a process of its own, which is killed after some s; whether it was done before that."""
    child = os.fork()
    if child == 0:
        code = 1
        try:
            with Library.open(path, timeout=30.0) as library:
                work(library)
            code = 0
        finally:
            os._exit(code)
    if wait is not None:
        time.sleep(wait)
        with suppress(ProcessLookupError):
            os.kill(child, signal.SIGKILL)
    _, status = os.waitpid(child, 0)
    if os.WIFEXITED(status) and os.WEXITSTATUS(status):
        raise RuntimeError(f"the work failed by itself: {os.WEXITSTATUS(status)}")
    return os.WIFEXITED(status)


def kill_once(base: Path, path: Path, work: Work, wait: float, wanted: dict[str, Any]) -> tuple[bool, str | None]:
    """One kill: whether the work was done already, and what is wrong afterwards."""
    copy_library(base, path)
    done = work_in_process(path, work, wait)
    fault = find_fault(path)
    if fault is not None:
        return done, fault
    with Library.open(path, timeout=30.0) as library:
        work(library)
    fault = find_fault(path)
    if fault is not None:
        return done, f"afterwards {fault}"
    found = dump(path)
    differing = [name for name, value in wanted.items() if found[name] != value]
    if "learned" in differing:
        return done, f"learned {found['learned']} instead of {wanted['learned']}"
    return done, f"differs in {', '.join(differing)}" if differing else None


def main() -> int:
    """Kill, and print what became of it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", help="one of the commands")
    options = parser.parse_args()
    adding._is_full.__kwdefaults__["n_clips"] = 3  # so that an add has several transactions
    chance, kills, before_end, faults = random.Random(options.seed), Counter(), Counter(), []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_files(folder / "base", range(4))
        write_files(folder / "more", range(4, 7))
        write_motion(make_motion(KINDS[1], draw_performer(50), seed=50), folder / "take.bvh")
        commands = {n: w for n, w in list_commands(folder).items() if options.only in (None, n)}
        bases = [make_base(folder, in_fragments=kind) for kind in (False, True)]
        cases = []
        for base in bases:
            for command, work in commands.items():
                path = folder / "whole.dousa"
                copy_library(base, path)
                start = time.perf_counter()
                work_in_process(path, work, None)
                seconds = time.perf_counter() - start
                cases.append((base, command, work, seconds, dump(path)))
        with suppress(KeyboardInterrupt):  # then what was found until now is printed
            for number in range(options.kills):
                base, command, work, seconds, wanted = cases[number % len(cases)]
                wait = chance.uniform(0.0, 1.05 * seconds)
                done, fault = kill_once(base, folder / "killed.dousa", work, wait, wanted)
                kills[command] += 1
                before_end[command] += not done
                if fault is not None:
                    faults.append(f"{command} of {base.name}, killed after {wait:.4f} s: {fault}")
                    print(faults[-1], flush=True)
                if (number + 1) % 50 == 0:
                    print(f"{number + 1} kills", flush=True)
    for command in commands:
        print(f"{command:16} {kills[command]:5} kills, {before_end[command]:5} before its end")
    print(f"{sum(kills.values())} kills, {sum(before_end.values())} before the end of the work: {len(faults)} faults")
    return bool(faults)


if __name__ == "__main__":
    sys.exit(main())
