"""Benchmarks of two checkouts in turns (A B A B A B) in one run: is the later version as fast as the earlier?

    python -m lab.benchmarks.in_turns --before OLD_CHECKOUT [--after ROOT] [--rounds 3] [--only NAME]
    python -m lab.benchmarks.in_turns --before OLD_CHECKOUT --command 'estimate --threads 1'

Each checkout runs its own benchmarks with its own src/ (the same environment), one after the other, so that a machine
that is busy is so for both. Every figure with a unit that a benchmark prints is followed, and the time of the whole
command. Printed are for each the medians of before and after, their ratio (of rates the inverse: above 1 is always
slower), the spread of each over the rounds (largest to smallest, in percent of the median), and whether it is slower or
faster: that is, all rounds of one version beat all of the other. With three rounds chance alone makes one figure in ten
look so; figures of peers, which did not change, show how many.
"""

from __future__ import annotations

import argparse
import os
import re
import shlex
import statistics
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from lab.places import ROOT

COMMANDS = {
    "reading": "reading DATA --repeats 1",
    "library_add": "library_add DATA/bandai/run --repeats 1",
    "forest": "forest --clips 300 --classes 10 --repeats 2",
    "search": "search --clips 300 --categories 10",
    "ranking": "ranking DATA/utd_mhad/skeleton --queries 2",
    "find": "find --minutes 5",
    "label": "label --minutes 2",
    "silhouette_candidates": "silhouette_candidates --candidates 500 --limbs left_forearm",
    "correlation_matrix": "correlation_matrix --frames 3000",
    "correspondence": "correspondence --frames 6000 --full 500",
    "assess": "assess --minutes 0.5 --rate 30",
}
WHOLE = "the whole command, s"
_FIGURE = re.compile(r"(?<![\w.])(\d[\d,]*(?:\.\d+)?) ?((?:million |thousand )?\w+/s|MB|ns|us|µs|ms|s)(?![\w/])")
_NUMBER = re.compile(r"\d[\d,]*(?:\.\d+)?(?:e[+-]?\d+)?")


@dataclass
class Figure:
    """One figure of a benchmark in all rounds."""

    rate: bool = False
    values: tuple[list[float], list[float]] = field(default_factory=lambda: ([], []))


def run(checkout: Path, words: Sequence[str]) -> tuple[str, float]:
    """What a benchmark of a checkout prints, and its seconds; ends the program if it fails."""
    begin = time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-m", f"lab.benchmarks.{words[0]}", *words[1:]],
        cwd=checkout,
        env={**os.environ, "PYTHONPATH": f"{checkout / 'src'}{os.pathsep}{checkout}", "COLUMNS": "200"},
        text=True,
        capture_output=True,
        check=False,
    )
    if done.returncode != 0:
        sys.exit(f"{checkout}: {shlex.join(words)} failed\n{done.stdout}\n{done.stderr}")
    return done.stdout, time.perf_counter() - begin


def read_figures(text: str) -> dict[str, tuple[float, bool]]:
    """Figures with a unit by what stands before them on the line, and whether they are rates."""
    figures: dict[str, tuple[float, bool]] = {}
    heading = ""
    for line in text.splitlines():
        if line.startswith("--"):
            heading = _NUMBER.sub("#", re.split(r"[,;]", line.strip("- "))[0]) + ": "
        for number, found in enumerate(_FIGURE.finditer(line)):
            label = re.sub(r"\s+", " ", _NUMBER.sub("#", line[: found.start()]).strip(" :,;(-"))
            name = f"{heading}{label[-60:] or number}, {found[2]}"
            while name in figures:
                name += "'"
            figures[name] = float(found[1].replace(",", "")), found[2].endswith("/s")
    return figures


def measure(words: Sequence[str], checkouts: Sequence[Path], rounds: int) -> dict[str, Figure]:
    """All rounds of one benchmark."""
    figures: dict[str, Figure] = {}
    for _ in range(rounds):
        for version, checkout in enumerate(checkouts):
            text, seconds = run(checkout, words)
            for name, (value, rate) in {**read_figures(text), WHOLE: (seconds, False)}.items():
                figure = figures.setdefault(name, Figure(rate))
                figure.values[version].append(value)
    return figures


def describe(name: str, figure: Figure) -> str:
    """One line of the table."""
    before, after = figure.values
    if not before or not after:
        return f"  {name[:70]:70} only {'before' if before else 'after'}"
    medians = statistics.median(before), statistics.median(after)
    spreads = [
        100 * (max(values) - min(values)) / median if median else 0.0
        for values, median in zip(figure.values, medians, strict=True)
    ]
    ratio = medians[0] / medians[1] if figure.rate and medians[1] else medians[1] / (medians[0] or 1e-12)
    if medians[0] == medians[1]:
        ratio = 1.0
    apart = max(before) < min(after) or max(after) < min(before)
    verdict = ("slower" if ratio > 1 else "faster") if apart and len(before) > 1 else ""
    numbers = f"{medians[0]:12.4g} {medians[1]:12.4g} {ratio:7.2f} {spreads[0]:6.0f} % {spreads[1]:6.0f} %"
    return f"  {name[:70]:70} {numbers}  {verdict}".rstrip()


def choose_commands(only: Sequence[str], more: Sequence[str], data: Path) -> dict[str, list[str]]:
    """Words of the commands by name."""
    chosen = {
        name: text
        for name, text in COMMANDS.items()
        if (not only and not more) or any(name.startswith(word) for word in only)
    }
    chosen |= {text: text for text in more}
    if not chosen:
        sys.exit(f"--only: expected one of {', '.join(COMMANDS)}")
    return {name: [word.replace("DATA", str(data)) for word in shlex.split(text)] for name, text in chosen.items()}


def main() -> None:
    """Measure, and print a table for each command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--before", type=Path, help="checkout of the earlier version")
    parser.add_argument("--after", type=Path, default=ROOT, help="by default the one of this script")
    parser.add_argument("--data", type=Path, default=Path("../shared/data"))
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--only", action="append", default=[], metavar="NAME", help=", ".join(COMMANDS))
    parser.add_argument("--command", action="append", default=[], metavar="'NAME OPTIONS'")
    options = parser.parse_args()
    if options.before is None:
        print("nothing to compare with: name the checkout of an earlier version with --before")
        return
    checkouts = [options.before.resolve(), options.after.resolve()]
    print(f"{'':72} {'before':>12} {'after':>12} {'ratio':>7} {'spread':>8} {'spread':>8}")
    commands = choose_commands(options.only, options.command, options.data.resolve())
    for name, words in commands.items():
        print(f"{name}: {shlex.join(words)}")
        for figure, values in measure(words, checkouts, options.rounds).items():
            print(describe(figure, values), flush=True)


if __name__ == "__main__":
    main()
