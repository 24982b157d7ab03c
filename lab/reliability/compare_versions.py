"""Two versions of dousa side by side: are all forests, tracks, labels, estimates and grades the same, bit for bit?

    python -m lab.reliability.compare_versions --before CHECKOUT [--after CHECKOUT] [--data FOLDER] [--only NAME]

Each version runs in an interpreter of its own (the same environment, PYTHONPATH is its src/), on the same recordings,
and says what it answers: files read and written, features, forests, libraries, answers of the commands, estimates,
grades. Printed are for each probe a digest of all numbers of each version, whether they are the same, and seconds. The
exit code is 1 if any differ. `--only` runs the groups whose name it begins (reading, features, library, old_library,
estimation, evaluation, experiments) and can be given several times; old_library asks the library that the earlier
version wrote. All takes some five minutes on two cores.

Values are compared by name. A name that the later version lacks is LOST and counts as a difference, unless it is named
with `--renamed NAME`, because the changelog does; a name that is new is printed only. Sentences (three words and more)
may be reworded: they stand in lines of their own, which do not count.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from lab.places import ROOT

GROUPS = ("reading", "features", "library", "old_library", "estimation", "evaluation", "experiments")
PROBE = Path(__file__).with_name("version_probe.py")
SHOWN = 6  # differences of a probe


@dataclass
class Comparison:
    """What was found so far: probes, and those that differ."""

    renamed: Sequence[str] = ()
    n_probes: int = 0
    n_values: int = 0
    different: list[str] = field(default_factory=list)
    reworded: int = 0


def start(checkout: Path, group: str, data: Path, work: Path, old_library: Path) -> subprocess.Popen[bytes]:
    """One version at work on a group; it writes `answers.json` beside its folder."""
    folder = work / "files"
    folder.mkdir(parents=True)
    environment = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join((str(checkout / "src"), str(ROOT))),
        "COLUMNS": "200",
        "LC_ALL": "C.UTF-8",
    }
    environment["DOUSA_LANG"] = "en"
    words = [
        group,
        "--data",
        data,
        "--work",
        folder,
        "--out",
        work / "answers.json",
        "--old-library",
        old_library,
    ]
    with (work / "log.txt").open("w") as log:
        return subprocess.Popen(
            [sys.executable, str(PROBE), *map(str, words)],
            cwd=folder,
            env=environment,
            stdout=log,
            stderr=subprocess.STDOUT,
        )


def finish(process: subprocess.Popen[bytes], checkout: Path, work: Path) -> dict[str, Any]:
    """The probes of a version; ends the program if it failed or was not that version."""
    if process.wait() != 0:
        sys.exit(f"{checkout}: the probes failed\n{(work / 'log.txt').read_text()[-4000:]}")
    answer = json.loads((work / "answers.json").read_text(encoding="utf-8"))
    if Path(answer["source"]) != checkout / "src" / "dousa":
        sys.exit(f"{checkout}: expected its own package, got {answer['source']}")
    probes: dict[str, Any] = answer["probes"]
    return probes


def digest(values: dict[str, str], places: Sequence[str]) -> str:
    """Of the values at some places, short."""
    text = "\n".join(f"{place}={values[place]}" for place in sorted(places))
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def names_of(values: dict[str, str]) -> dict[str, set[str]]:
    """Places by name: numbers of rows are left out, so that a name is that of a key."""
    names: dict[str, set[str]] = {}
    for place in values:
        names.setdefault(re.sub(r"\.\[\d+\]", "[]", place), set()).add(place)
    return names


def compare(name: str, before: dict[str, Any], after: dict[str, Any], found: Comparison) -> None:
    """Print the lines of one probe."""
    old, new = before["leaves"], after["leaves"]
    old_names, new_names = names_of(old), names_of(new)
    shared = old_names.keys() & new_names.keys()
    old_places = [place for key in shared for place in old_names[key]]
    new_places = [place for key in shared for place in new_names[key]]
    digests = digest(old, old_places), digest(new, new_places)
    lost = [key for key in sorted(old_names.keys() - shared) if not _is_renamed(key, found.renamed)]
    same = digests[0] == digests[1]
    verdict = ("LOST" if lost else "same") if same else "DIFFERENT"
    if "failed" in before and "failed" in after:
        verdict = "FAILED"
    seconds = f"{before['seconds']:8.2f} {after['seconds']:8.2f}"
    print(f"{name:40} {digests[0]} {digests[1]} {verdict:10}{len(old_places):8} {seconds}", flush=True)
    found.n_probes += 1
    found.n_values += len(old_places)
    if verdict != "same":
        found.different.append(name)
    places = sorted({place for place in (*old_places, *new_places) if old.get(place) != new.get(place)})
    for place in places[:SHOWN]:
        print(f"    {place}: {str(old.get(place))[:90]} -> {str(new.get(place))[:90]}")
    if len(places) > SHOWN:
        print(f"    and {len(places) - SHOWN:,} more values")
    _print_names("names only before", lost)
    _print_names("names only after", sorted(new_names.keys() - shared))
    for version, probe in (("before", before), ("after", after)):
        if "failed" in probe:
            print(f"    the probe failed {version}: {probe['failed']}")
    _compare_words(before["words"], after["words"], found)


def _is_renamed(key: str, renamed: Sequence[str]) -> bool:
    return any(part in re.split(r"[.\[\]]+", key) for part in renamed)


def _print_names(title: str, names: Sequence[str]) -> None:
    if names:
        rest = f" and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
        print(f"    {title}: {', '.join(names[:SHOWN])}{rest}")


def _compare_words(before: dict[str, str], after: dict[str, str], found: Comparison) -> None:
    changed = [place for place in sorted(before.keys() | after.keys()) if before.get(place) != after.get(place)]
    if changed:
        found.reworded += len(changed)
        place = changed[0]
        print(f"    words: {len(changed)} of {len(before)} sentences differ, which is allowed; the first, {place}:")
        print(f"      - {before.get(place, '(none)')[:150]!r}")
        print(f"      + {after.get(place, '(none)')[:150]!r}")


def run_group(group: str, checkouts: Sequence[Path], data: Path, folder: Path, found: Comparison) -> None:
    """Both versions at once, so that both find the machine equally busy."""
    old_library = folder / "library" / "0" / "files" / "moves.dousa"
    works = [folder / group / str(number) for number in (0, 1)]
    processes = [
        start(checkout, group, data, work, old_library) for checkout, work in zip(checkouts, works, strict=True)
    ]
    try:
        before, after = (
            finish(process, checkout, work) for process, checkout, work in zip(processes, checkouts, works, strict=True)
        )
    finally:
        for process in processes:
            process.kill()
            process.wait()
    for name in [*before, *(name for name in after if name not in before)]:
        none = {"leaves": {}, "words": {}, "seconds": 0.0}
        compare(name, before.get(name, none), after.get(name, none), found)


def choose_groups(only: Sequence[str]) -> list[str]:
    """The groups that were asked for, in their order; the old library is one that the group `library` makes."""
    chosen = [group for group in GROUPS if not only or any(group.startswith(word) for word in only)]
    if not chosen:
        sys.exit(f"--only: expected one of {', '.join(GROUPS)}")
    if "old_library" in chosen and "library" not in chosen:
        chosen.insert(chosen.index("old_library"), "library")
    return chosen


def main() -> None:
    """Compare; exit code 1 if anything differs."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--before", type=Path, help="checkout of the earlier version")
    parser.add_argument("--after", type=Path, default=ROOT, help="by default the one of this script")
    parser.add_argument("--data", type=Path, default=Path("../shared/data"))
    parser.add_argument("--only", action="append", default=[], metavar="GROUP")
    parser.add_argument("--renamed", action="append", default=[], metavar="NAME")
    parser.add_argument("--keep", type=Path, help="an empty folder for all files, which are kept")
    options = parser.parse_args()
    if options.before is None:
        print("nothing to compare with: name the checkout of an earlier version with --before")
        return
    checkouts = [options.before.resolve(), options.after.resolve()]
    found, began = Comparison(options.renamed), time.perf_counter()
    print(f"{'probe':40} {'before':16} {'after':16} {'':10}{'values':>8} {'s before':>8} {'s after':>8}")
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.keep.resolve() if options.keep else Path(temporary)
        for group in choose_groups(options.only):
            run_group(group, checkouts, options.data.resolve(), folder, found)
    print(
        f"{found.n_probes} probes, {found.n_values:,} values in {time.perf_counter() - began:.0f} s: "
        + (f"DIFFERENT: {', '.join(found.different)}" if found.different else "all the same, bit for bit")
        + (f"; {found.reworded} sentences differ" if found.reworded else "")
    )
    sys.exit(1 if found.different else 0)


if __name__ == "__main__":
    main()
