"""An independent examination of retrieval: strangers, bad sensors, counts, confidences, likeness, words, first answers.

Written from the words of the specification and of the request alone; dousa is asked by its public commands. Beside it
stands the nearest clip by joint positions. What the exam is made of lies in lab/exams/search, unread by who
works on the retrieval. Every row takes some minutes of one processor; the same seed gives the same questions.

    python -m lab.exams.retrieval [--data DIR] [--rows N ...] [--seed N] [--json FILE]
"""

from __future__ import annotations

import argparse
import json
import math
import resource
import tempfile
from pathlib import Path

import dousa
from lab.exams.search import clip_rows, take_rows
from lab.exams.search.context import Context

SEED = 17
ROWS = {
    1: take_rows.strangers,
    2: take_rows.joined,
    3: clip_rows.clips,
    4: take_rows.foreign_take,
    5: take_rows.repetitions,
    6: clip_rows.confidence,
    7: clip_rows.words,
    8: clip_rows.likeness,
    9: clip_rows.first_answer,
}


def read_options():
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    default = Path(dousa.__file__).resolve().parents[2] / "../shared/data"
    parser.add_argument("--data", type=Path, default=default, help="the folder of recordings")
    parser.add_argument("--rows", type=int, nargs="+", choices=ROWS, default=list(ROWS))
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--json", type=Path, help="write the numbers here")
    return parser.parse_args()


def number(value):
    """A number of the table."""
    return "" if math.isnan(value) else f"{value:.3f}"


def main():
    """Sit the rows that are asked for, and print their tables."""
    options, content = read_options(), {}
    for row in options.rows:
        with tempfile.TemporaryDirectory() as folder:
            before = used()
            lines = ROWS[row](Context(options.data.resolve(), options.seed, Path(folder)))
        print(f"\n{ROWS[row].__doc__}\n{used() - before:.0f} s of processor time\n")
        width = max(len(line.what) for line in lines)
        print(f"{'':{width}}     dousa  baseline    target")
        for line in lines:
            numbers = f"{number(line.dousa):>10}{number(line.baseline):>10}{line.target:>10}"
            print(f"{line.what:{width}}{numbers}  {line.note}".rstrip(), flush=True)
        content[row] = [vars(line) for line in lines]
    if options.json:
        options.json.write_text(json.dumps(content, indent=1, default=float) + "\n", encoding="utf-8")


def used():
    """Processor seconds of this program and of those that it ran."""
    both = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(u.ru_utime + u.ru_stime for u in both)


if __name__ == "__main__":
    main()
