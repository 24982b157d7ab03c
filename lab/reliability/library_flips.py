"""Single bits of a library flipped, one at a time: is each found, and does nothing answer otherwise in silence?

    python -m lab.reliability.library_flips [--flips N] [--seed N]

In turns one bit of a value of some row (every column of every table has the same chance), of any byte of the library's
file, and of any byte of its fragments. Then everything that a library can be asked is asked: clips, joints, searches,
texts, takes, the journal, the state, and an undo of its removal; and ``check`` is asked as well. Prints for each kind
how many flips were *found* (by ``check``), *refused* (an error that says what is damaged, by opening or asking),
*without effect* (answers are the same, and undo brings back the same), and *silent*: another answer, and no error. The
exit code is 1 if there is a silent one, or anything but an error of dousa.
"""

from __future__ import annotations

import argparse
import random
import sqlite3
import struct
import sys
import tempfile
from collections import Counter
from contextlib import closing, suppress
from pathlib import Path
from typing import Any

from dousa.errors import DousaError
from dousa.formats.registry import write_motion
from dousa.library import Library
from dousa.motion.synthetic.performers import draw_performer, make_motion
from lab.reliability.library_kill import KINDS, copy_library, dump, make_base, write_files

OUTCOMES = ("found", "refused", "without effect", "silent")


def ask_everything(path: Path) -> dict[str, Any]:
    """What a library answers, and what an undo of its removal brings back."""
    answers = dump(path)
    with Library.open(path) as library:
        clips = library.clips()
        takes = [clip.id for clip in clips if clip.kind == "take"]
        answers["details"] = [repr(clip) for clip in clips]
        answers["text"] = library.search_text("both hands overhead").to_json()
        answers["searches"] = [repr(library.search(clip.id, 5)) for clip in clips[:3]]
        answers["journal"] = [entry.to_json() for entry in library.journal()]
        answers["tags"] = library.tags()
        answers["saved"] = [search.to_json() for search in library.searches.all()]
        answers["annotations"] = repr(library.annotations.read())
        answers["labels"] = [library.label(take, n_jobs=1).to_json() for take in takes]
        answers["state"] = repr(library.stats())
        removal = next((entry.number for entry in library.journal() if entry.kind == "remove"), None)
        if removal is not None:
            library.undo(removal, n_jobs=1)
    answers["undone"] = dump(path)
    return answers


def find_values(path: Path) -> list[tuple[str, str, int, int]]:
    """Every value of every table: table, column, row number of SQLite, and its length in bytes."""
    values = []
    with closing(sqlite3.connect(path)) as connection:
        tables = [name for (name,) in connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")]
        for table in tables:
            for _, column, *_ in connection.execute(f"PRAGMA table_info({table})").fetchall():
                asked = f"SELECT rowid, length(CAST({column} AS BLOB)) FROM {table} WHERE {column} IS NOT NULL"
                values += [(table, column, row, size) for row, size in connection.execute(asked) if size]
    return values


def flip_bit(data: bytes, bit: int) -> bytes:
    """The same bytes but for one bit."""
    changed = bytearray(data)
    changed[bit // 8] ^= 1 << bit % 8
    return bytes(changed)


def flip_value(path: Path, values: list[tuple[str, str, int, int]], chance: random.Random) -> str:
    """Flip a bit of a value as SQLite keeps it; the name of the value."""
    by_column: dict[tuple[str, str], list[tuple[int, int]]] = {}
    for table, column, row, size in values:
        by_column.setdefault((table, column), []).append((row, size))
    table, column = chance.choice(list(by_column))
    row, size = chance.choice(by_column[table, column])
    with closing(sqlite3.connect(path)) as connection:
        connection.execute("PRAGMA foreign_keys = OFF")
        (kind, value) = connection.execute(
            f"SELECT typeof({column}), {column} FROM {table} WHERE rowid = ?", (row,)
        ).fetchone()
        while True:
            changed: Any
            if kind == "integer":
                changed = value ^ (1 << chance.randrange(max(8, value.bit_length())))
            elif kind == "real":
                changed = struct.unpack("<d", flip_bit(struct.pack("<d", value), chance.randrange(64)))[0]
            else:
                data = value if kind == "blob" else value.encode()
                changed = flip_bit(data, chance.randrange(8 * len(data)))
                if kind == "text":
                    try:
                        changed = changed.decode()
                    except UnicodeDecodeError:
                        continue
            try:
                connection.execute(f"UPDATE {table} SET {column} = ? WHERE rowid = ?", (changed, row))
            except sqlite3.IntegrityError:  # the number of another row
                continue
            break
        connection.commit()
    return f"{table}.{column} of row {row}"


def flip_file(path: Path, chance: random.Random) -> str:
    """Flip a bit anywhere in a file; the name of the place."""
    bit = chance.randrange(8 * path.stat().st_size)
    data = path.read_bytes()
    path.write_bytes(flip_bit(data, bit))
    return f"{path.name}, byte {bit // 8}"


def judge(path: Path, sound: dict[str, Any]) -> tuple[str, str]:
    """What became of a flip, and what there is to say of it."""
    found, refused = "", ""
    try:
        with Library.open(path) as library:
            report = library.check()
            if not report.is_sound:
                found = str(report.damage[0].what)
    except DousaError as error:
        refused = str(error)
    try:
        answers = ask_everything(path)
        differing = [name for name, value in sound.items() if answers[name] != value]
    except DousaError as error:
        refused, differing = refused or str(error), []
    if differing and not found:
        return "silent", f"differs in {', '.join(differing)}"
    if found:
        return "found", f"{found}; meanwhile {', '.join(differing)} differed" if differing else found
    return ("refused", refused) if refused else ("without effect", "")


def main() -> int:
    """Flip, and print what became of it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--flips", type=int, default=500)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--all", action="store_true", help="print what became of each")
    options = parser.parse_args()
    chance = random.Random(options.seed)
    outcomes: dict[str, Counter[str]] = {"a value": Counter(), "the file": Counter(), "a fragment": Counter()}
    told = Counter[str]()
    failed = 0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_files(folder / "base", range(4))
        write_motion(make_motion(KINDS[1], draw_performer(50), seed=50), folder / "take.bvh")
        bases = [make_base(folder, in_fragments=kind) for kind in (False, True)]
        path = folder / "flipped" / "flipped.dousa"
        sound, values = [], []
        for base in bases:
            copy_library(base, path)
            sound.append(ask_everything(path))
            values.append(find_values(base))
        with suppress(KeyboardInterrupt):  # then what was found until now is printed
            for number in range(options.flips):
                kind = ("a value", "a value", "the file", "a fragment")[number % 4]
                base = int(kind == "a fragment" or number // 4 % 2)
                copy_library(bases[base], path)
                if kind == "a value":
                    place = flip_value(path, values[base], chance)
                elif kind == "the file":
                    place = flip_file(path, chance)
                else:
                    parts = sorted(one for one in Path(f"{path}.fragments").rglob("*") if one.is_file())
                    place = flip_file(chance.choice(parts), chance)
                try:
                    outcome, words = judge(path, sound[base])
                except Exception as error:  # what no person should see
                    outcome, words = "silent", f"{type(error).__name__}: {error}"
                outcomes[kind][outcome] += 1
                told["differed meanwhile"] += "meanwhile" in words
                if options.all or outcome == "silent":
                    print(f"{place}: {outcome}: {words}", flush=True)
                failed += outcome == "silent"
                if (number + 1) % 50 == 0:
                    print(f"{number + 1} flips", flush=True)
    print(f"{'a bit of':12}" + "".join(f"{outcome:>16}" for outcome in OUTCOMES))
    for kind, counts in outcomes.items():
        print(f"{kind:12}" + "".join(f"{counts[outcome]:16}" for outcome in OUTCOMES))
    print(f"{sum(map(Counter.total, outcomes.values()))} flips: {failed} silent; {told['differed meanwhile']} of those")
    print("that check finds answered otherwise as long as it was not asked")
    return bool(failed)


if __name__ == "__main__":
    sys.exit(main())
