"""All benchmarks that need nothing but this environment, in one table: ``make bench`` writes docs/performance.md.

    python -m lab.benchmarks [--only NAME] [--write]

Each runs in a process of its own, on real recordings where ../shared/data has them, else on made ones. Every row is the
median of as many repeats of ours as of the peer's, in turns. With --write the table in docs/performance.md is replaced.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
import time
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

from lab.benchmarks.timing import Row, Spent
from lab.places import ROOT, SHARED_DATA

PAGE = ROOT / "docs" / "performance.md"
BEGIN, END = "<!-- make bench writes what follows -->\n", "<!-- make bench -->\n"
RUNS = {
    "Files": ("reading --repeats 3", "library_add --repeats 3"),
    "Retrieval": (
        *("forest BANDAI --clips 1000 --repeats 3", "search", "ranking --queries 3 --repeats 3"),
        *("find --repeats 3", "label --minutes 10 --repeats 3"),
    ),
    "Estimation": ("estimate --repeats 3", "silhouette_candidates --candidates 2000 --repeats 3"),
    "Evaluation": ("correlation_matrix", "correspondence --repeats 3", "assess --repeats 3"),
    "First use": ("first_run --brief", "first_run --train --repeats 3"),
}
"""By heading; the options keep the whole within 15 minutes of two cores."""


def run_one(words: str) -> Iterator[Row]:
    """The rows of one benchmark, as they come."""
    if "BANDAI" in words:
        words = words.replace("BANDAI", str(SHARED_DATA / "bandai") if (SHARED_DATA / "bandai").is_dir() else "")
    name, *rest = words.split()
    command = [sys.executable, "-m", f"lab.benchmarks.{name}", *rest, "--json"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        for line in process.stdout:
            found = json.loads(line)
            pair = {key: found[key] and Spent(*found[key]) for key in ("ours", "theirs")}
            yield Row(**{**found, **pair})
    if process.returncode:
        sys.exit(f"{words} failed")


def make_table(rows: list[Row]) -> str:
    """A table of Markdown."""
    lines = ["| work | dousa | peer | | ratio: clock, CPU |", "| --- | --- | --- | --- | --- |"]
    for row in rows:
        theirs = row.tell(row.theirs) if row.theirs else ""
        work = f"{row.work} ({row.note})" if row.note else row.work
        lines.append(f"| {work} | {row.tell(row.ours)} | {row.peer} | {theirs} | {row.ratios()} |")
    return "\n".join(lines) + "\n"


def write_page(page: Path, tables: dict[str, str], seconds: float) -> None:
    """Put the tables in the place of the earlier ones."""
    today = datetime.now(UTC).strftime("%Y-%m-%d")
    load = f"; load at its end {os.getloadavg()[0]:.1f}" if hasattr(os, "getloadavg") else ""
    machine = (
        f"{today}, {os.cpu_count()} cores, Python {platform.python_version()}, {seconds / 60:.0f} minutes{load}.\n"
    )
    text = page.read_text(encoding="utf-8")
    before, _, rest = text.partition(BEGIN)
    parts = [f"### {heading}\n\n{table}" for heading, table in tables.items()]
    page.write_text(before + BEGIN + "\n".join(["", machine, *parts, END]) + rest.partition(END)[2], encoding="utf-8")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", action="append", default=[], metavar="NAME", help="benchmarks that begin so")
    parser.add_argument("--write", action="store_true", help="into docs/performance.md")
    options = parser.parse_args()
    tables, began = {}, time.perf_counter()
    for heading, runs in RUNS.items():
        rows = []
        for words in runs:
            if not options.only or words.startswith(tuple(options.only)):
                start = time.perf_counter()
                for row in run_one(words):
                    print(row, flush=True)
                    rows.append(row)
                print(f"-- {words}: {time.perf_counter() - start:.0f} s", flush=True)
        if rows:
            tables[heading] = make_table(rows)
        if options.write and not options.only:
            write_page(PAGE, tables, time.perf_counter() - began)
    print(f"{(time.perf_counter() - began) / 60:.1f} minutes")


if __name__ == "__main__":
    main()
