"""Stopping programs that write to a library, at random moments: is it whole, and does the same command end the work?

    python -m lab.reliability.library_kill [--kills N] [--seed N] [--only COMMAND]
    python -m lab.reliability.library_kill --power 100

A small trained library, its arrays in rows or in fragments, is copied; a process adds clips to it, trains, relabels,
tags, removes, undoes, names a part of a take, compacts, moves arrays to fragments, repairs, exports to a folder or a
ZIP file, backs up or restores, and gets SIGKILL or SIGTERM in turn, at a random moment of the time that it takes. Then
every checksum and the structure of the file are compared, the same is done again without being stopped, and the library
must say the same as if nobody had stopped it: names, labels, tags, joints, the answers of a search, exported files. No
half-written file may be left, after SIGTERM at once. Prints stops by command, and what failed; the exit code is 1 if
something did. Processes are forked from one in which all is compiled, so that what is stopped is the writing and not
the beginning of a program.

With ``--power`` the power is cut so many times: strace records what a program writes, waits for and renames, and its
disk is made as it may be at a random moment of that: what was waited for, and any part of what was not. The library
must be sound, and have every change that the program had been answered. It also prints what the waiting costs.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import re
import shutil
import signal
import sqlite3
import subprocess
import sys
import tempfile
import time
import traceback
import zipfile
from collections import Counter
from collections.abc import Callable
from contextlib import closing, suppress
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any

from dousa.app.stops import hear_stops
from dousa.errors import LibraryError, is_interrupt
from dousa.formats.registry import write_motion
from dousa.library import Library
from dousa.library import add as adding
from dousa.motion.synthetic.performers import CATEGORIES, draw_performer, make_motion

Work = Callable[[Path], Any]
KINDS = CATEGORIES[:3]


def write_files(folder: Path, performers: range) -> None:
    """One short motion of each kind and performer."""
    for number in performers:
        for kind in KINDS:
            path = folder / kind / f"{kind}_p{number}.bvh"
            path.parent.mkdir(parents=True, exist_ok=True)
            write_motion(make_motion(kind, draw_performer(number), seed=number), path)


def list_commands(folder: Path, backup: Path) -> dict[str, Work]:
    """What is done to a library, by name; each may be done again after it was stopped."""
    more, repaired = folder / "more", folder / "base" / KINDS[0] / f"{KINDS[0]}_p0.bvh"
    in_library: dict[str, Callable[[Library], Any]] = {
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
        "export": lambda library: library.export(Path(library.name).with_name("out"), to="bvh"),
        "export zip": lambda library: library.export(Path(library.name).with_name("out.zip"), to="bvh"),
        "backup": lambda library: _unless_done(lambda: library.backup(Path(library.name).with_name("copy.dousa"))),
    }
    commands = {name: partial(_in_library, work) for name, work in in_library.items()}
    return {**commands, "restore": partial(Library.restore, backup)}


def _in_library(work: Callable[[Library], Any], path: Path) -> None:
    with Library.open(path, timeout=30.0) as library:
        work(library)


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
    """A library file and its fragments, alone in a folder."""
    shutil.rmtree(target.parent, ignore_errors=True)
    target.parent.mkdir()
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
            "files": list_files(path.parent),
        }


def list_files(folder: Path) -> dict[str, Any]:
    """What was exported or copied into the folder of a library, without times."""
    found: dict[str, Any] = {
        path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("out/**/*") if path.is_file()
    }
    for path in folder.glob("out.zip"):
        with zipfile.ZipFile(path) as archive:
            found |= {name: archive.read(name) for name in archive.namelist()}
    for path in folder.glob("copy.dousa"):
        with Library.open(path, read_only=True) as copy:
            found["copy"] = [(clip.path, clip.category, clip.tags) for clip in copy.clips()], copy.check().is_sound
    return found


def find_left_overs(folder: Path) -> list[str]:
    """What a program that was stopped left half-written."""
    return [path.name for path in folder.rglob("*") if path.name.endswith((".part", ".parts"))]


def find_fault(path: Path) -> str | None:
    """What is damaged in a library."""
    with closing(sqlite3.connect(path)) as connection:
        said = connection.execute("PRAGMA integrity_check").fetchall()
        if said != [("ok",)] or connection.execute("PRAGMA foreign_key_check").fetchall():
            return f"structure: {said}"
    with Library.open(path) as library:
        damage = library.check().damage
        return None if not damage else f"damaged: {damage[0]}"


def work_in_process(path: Path, work: Work, wait: float | None, number: int = signal.SIGKILL) -> bool:
    """Do something in a process of its own, which gets a signal after some s; whether it was done before that."""
    child = os.fork()
    if child == 0:
        code = 1
        try:
            with hear_stops():
                work(path)
            code = 0
        except BaseException as error:
            code = 143 if is_interrupt(error) else 1
            if code == 1:
                traceback.print_exc()
        finally:
            os._exit(code)
    if wait is not None:
        time.sleep(wait)
        with suppress(ProcessLookupError):
            os.kill(child, number)
    _, status = os.waitpid(child, 0)
    if os.WIFEXITED(status) and os.WEXITSTATUS(status) not in (0, 143):
        raise RuntimeError(f"the work failed by itself: {os.WEXITSTATUS(status)}")
    return os.WIFEXITED(status) and not os.WEXITSTATUS(status)


def stop_once(
    base: Path, path: Path, work: Work, wait: float, wanted: dict[str, Any], number: int
) -> tuple[bool, str | None]:
    """One stop: whether the work was done already, and what is wrong afterwards."""
    copy_library(base, path)
    try:
        done = work_in_process(path, work, wait, number)
    except RuntimeError as error:
        return False, str(error)
    fault = find_fault(path) if path.exists() else None  # it is missing for a moment of a restoring
    if fault is None and number == signal.SIGTERM:
        left = [name for name in find_left_overs(path.parent) if not name.endswith(".zip.parts")]  # it goes on from
        fault = f"left {left}" if left else None
    if fault is not None:
        return done, fault
    work(path)
    fault = find_fault(path)
    if fault is None and (left := find_left_overs(path.parent)):
        fault = f"left {left}"
    if fault is not None:
        return done, f"afterwards {fault}"
    found = dump(path)
    differing = [name for name, value in wanted.items() if found[name] != value]
    if "learned" in differing:
        return done, f"learned {found['learned']} instead of {wanted['learned']}"
    return done, f"differs in {', '.join(differing)}" if differing else None


class Disk:
    """A folder as strace saw it change: what is on the disk for sure, and what may be.

    Parameters
    ----------
    folder : as it is before, all of it on the disk.
    """

    def __init__(self, folder: Path) -> None:
        self.names = {str(path): Node(path.read_bytes()) for path in folder.rglob("*") if path.is_file()}
        self.kept, self.pending = dict(self.names), []  # names that are on the disk, and changes of names that are not
        self.files: dict[int, tuple[str, Node | None]] = {}
        self.places: dict[int, int] = {}
        self.folder, self.answers = str(folder), []

    def run(self, call: str, words: list[str], result: int) -> None:
        """One system call that succeeded."""
        if call == "openat":
            self._open(read_text(words[1]), words[2], result)
        elif call == "close":
            self.files.pop(int(words[0]), None)
        elif call in ("rename", "unlink", "renameat", "renameat2", "unlinkat"):
            texts = [read_text(word) for word in words if word.startswith('"')]
            if texts[0].startswith(self.folder):
                node = self.names.pop(texts[0], None)
                if node is not None and len(texts) > 1:
                    self.names[texts[1]] = node
                self.pending.append(dict(self.names))
        elif words and words[0].isdigit():
            self._change(call, int(words[0]), words, result)

    def _open(self, path: str, flags: str, number: int) -> None:
        if not path.startswith(self.folder) or path.endswith("-shm"):
            return
        if path not in self.names and "O_CREAT" not in flags:  # a folder
            self.files[number] = path, None
            return
        if path not in self.names:
            self.names[path] = Node(b"")
            self.pending.append(dict(self.names))
        node = self.names[path]
        if "O_TRUNC" in flags:
            node.truncate(0)
        self.files[number] = path, node
        self.places[number] = -1 if "O_APPEND" in flags else 0

    def _change(self, call: str, number: int, words: list[str], result: int) -> None:
        if call == "write" and number == 1:
            self.answers.append(json.loads(read_text(words[1])))
        if number not in self.files:
            return
        node = self.files[number][1]
        if call in ("fsync", "fdatasync"):
            if node is None:
                self.kept, self.pending = dict(self.names), []
            else:
                node.sync()
        elif node is not None and call == "pwrite64":
            node.write(int(words[3]), read_bytes(words[1])[:result])
        elif node is not None and call == "write":
            place = len(node.data) if self.places[number] < 0 else self.places[number]
            node.write(place, read_bytes(words[1])[:result])
            self.places[number] = -1 if self.places[number] < 0 else place + result
        elif node is not None and call == "lseek" and self.places[number] >= 0:
            self.places[number] = result
        elif node is not None and call == "ftruncate":
            node.truncate(int(words[1]))

    def cut(self, folder: Path, chance: random.Random) -> None:
        """Write what may be on the disk after a power cut."""
        shutil.rmtree(folder, ignore_errors=True)
        share = chance.choice((0.0, 0.5, 1.0))
        reached = chance.randint(0, len(self.pending)) if share else 0
        for name, node in (self.pending[reached - 1] if reached else self.kept).items():
            path = folder / Path(name).relative_to(self.folder)
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(node.recall(share, chance))


class Node:
    """The content of a file: what is on the disk, and the writes that may not be."""

    def __init__(self, data: bytes) -> None:
        self.data, self.kept = bytearray(data), data
        self.pending: list[tuple[int, bytes | None]] = []

    def write(self, place: int, data: bytes) -> None:
        _apply(self.data, place, data)
        self.pending.append((place, data))

    def truncate(self, size: int) -> None:
        _apply(self.data, size, None)
        self.pending.append((size, None))

    def sync(self) -> None:
        self.kept, self.pending = bytes(self.data), []

    def recall(self, share: float, chance: random.Random) -> bytes:
        data = bytearray(self.kept)
        for place, content in self.pending:
            if chance.random() < share:
                _apply(data, place, content)
        return bytes(data)


def _apply(data: bytearray, place: int, content: bytes | None) -> None:
    if len(data) < place:
        data.extend(bytes(place - len(data)))
    if content is None:
        del data[place:]
    else:
        data[place : place + len(content)] = content


def read_bytes(word: str) -> bytes:
    """The bytes of a string of strace -xx."""
    return bytes.fromhex(word.strip('"').replace("\\x", ""))


def read_text(word: str) -> str:
    return os.fsdecode(read_bytes(word))


CALLS = "openat,close,write,pwrite64,lseek,ftruncate,fsync,fdatasync,rename,renameat,renameat2,unlink,unlinkat"


def change_and_answer(path: Path, more: Path) -> None:
    """Change a library in many ways, and answer with its state after each: a program that strace watches."""
    with Library.open(path) as library:
        changes: list[Callable[[], Any]] = [
            lambda: library.tag([1], add=["one"]),
            lambda: library.relabel([2, 3], category="other"),
            lambda: library.add(more, n_jobs=1),
            lambda: library.tag([4], add=["two"]),
            lambda: library.remove([5]),
            lambda: library.undo(n_jobs=1),
            lambda: library.compact(fragments=""),
            lambda: library.add_motion(library.trajectories(1), "again", n_jobs=1),
            lambda: library.train(n_trees=3, n_jobs=1),
            lambda: library.remove([8]),
            library.compact,
            *(partial(library.tag, [1 + number % 3], add=[f"more {number}"]) for number in range(20)),
        ]
        for change in changes:
            change()
            os.write(1, json.dumps(say(library)).encode())


def say(library: Library) -> list[Any]:
    """The number of the last change, and what the library says then."""
    return [library.revision, [[clip.id, clip.path, clip.category, list(clip.tags)] for clip in library.clips()]]


def cut_power(folder: Path, base: Path, n_cuts: int, chance: random.Random) -> list[str]:
    """Cut the power so many times; return what was wrong afterwards."""
    path, log, before = folder / "work" / "moves.dousa", folder / "calls.txt", folder / "before"
    copy_library(base, path)
    shutil.copytree(path.parent, before)
    code = "import sys; from lab.reliability.library_kill import *; change_and_answer(*map(Path, sys.argv[1:]))"
    watch = ["strace", "-f", "-xx", "-s", "1000000000", "-e", f"trace={CALLS}", "-o", str(log)]
    words = [*watch, sys.executable, "-c", code, str(path), str(folder / "more")]
    subprocess.run(words, check=True, stdout=subprocess.DEVNULL)
    with open(log, encoding="ascii") as file:
        found = [re.match(r"\d+ +(\w+)\((.*)\) += (\d+)", line) for line in file]
    calls = [(one[1], one[2].split(", "), int(one[3])) for one in found if one]
    shutil.rmtree(path.parent)
    before.rename(path.parent)
    disk, faults = Disk(path.parent), []
    first = next(
        number for number, call in enumerate(calls) if call[0] == "openat" and read_text(call[1][1]) == str(path)
    )
    moments = sorted(chance.randrange(first, len(calls)) for _ in range(n_cuts))
    for number, call in enumerate(calls):
        disk.run(*call)
        for _ in range(moments.count(number)):
            disk.cut(folder / "cut", chance)
            fault = find_loss(folder / "cut" / path.name, disk.answers)
            if fault is not None:
                faults.append(f"power cut after call {number} of {len(calls)}, {call[0]}: {fault}")
                print(faults[-1], flush=True)
    n_calls, n_answers = len(calls) - first, len(disk.answers)
    print(f"{n_cuts} power cuts among {n_calls} calls, {n_answers} changes answered: {len(faults)} faults")
    return faults


def time_changes(base: Path, path: Path, n_changes: int = 200) -> None:
    """Print what a small change takes that waits for the disk, and one that does not, in turns."""
    copy_library(base, path)
    taken: dict[str, list[float]] = {"FULL": [], "NORMAL": []}
    with Library.open(path) as library:
        for number in range(n_changes):
            level = ("FULL", "NORMAL")[number % 2]
            with library.database.alone() as connection:  # the one that all changes use
                connection.execute(f"PRAGMA synchronous = {level}")
            start = time.perf_counter()
            names = [f"tag {number % 2}"]
            library.tag([1], add=names) if number % 4 < 2 else library.tag([1], remove=names)
            taken[level].append(time.perf_counter() - start)
    for level, seconds in taken.items():
        print(f"synchronous = {level}: {1e3 * median(seconds):.1f} ms a change (median of {len(seconds)})")


def find_loss(path: Path, answers: list[list[Any]]) -> str | None:
    """What is damaged in a library, or which answered change it lacks."""
    try:
        fault = find_fault(path)
        with Library.open(path) as library:
            revision, said = say(library)
    except LibraryError as error:
        return str(error)
    if fault is not None or not answers:
        return fault
    if revision < answers[-1][0]:
        return f"change {answers[-1][0]} was answered, {revision} is there"
    return "says something else" if revision == answers[-1][0] and said != answers[-1][1] else None


def main() -> int:
    """Stop, and print what became of it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=1000, help="stops, half of them by SIGTERM")
    parser.add_argument("--power", type=int, default=0, metavar="N", help="cut the power N times instead")
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
        bases = [make_base(folder, in_fragments=kind) for kind in (False, True)]
        if options.power:
            time_changes(bases[0], folder / "work" / "moves.dousa")
            return bool(cut_power(folder, bases[0], options.power, chance))
        cases = []
        for base in bases:
            backup = bases[1 - bases.index(base)]
            commands = {n: w for n, w in list_commands(folder, backup).items() if options.only in (None, n)}
            for command, work in commands.items():
                path = folder / "whole" / "moves.dousa"
                copy_library(base, path)
                start = time.perf_counter()
                work_in_process(path, work, None)
                seconds = time.perf_counter() - start
                cases.append((base, command, work, seconds, dump(path)))
        with suppress(KeyboardInterrupt):  # then what was found until now is printed
            for number in range(options.kills):
                base, command, work, seconds, wanted = cases[number % len(cases)]
                wait = chance.uniform(0.0, 1.05 * seconds)
                signals = signal.SIGKILL, signal.SIGTERM
                sent = signals[number // len(cases) % 2]
                done, fault = stop_once(base, folder / "whole" / "moves.dousa", work, wait, wanted, sent)
                kills[command] += 1
                before_end[command] += not done
                if fault is not None:
                    faults.append(f"{command} of {base.name}, {sent.name} after {wait:.4f} s: {fault}")
                    print(faults[-1], flush=True)
                if (number + 1) % 50 == 0:
                    print(f"{number + 1} stops", flush=True)
    for command in commands:
        print(f"{command:16} {kills[command]:5} stops, {before_end[command]:5} before its end")
    print(f"{sum(kills.values())} stops, {sum(before_end.values())} before the end of the work: {len(faults)} faults")
    return bool(faults)


if __name__ == "__main__":
    sys.exit(main())
