"""An independent examination of ``dousa.evaluation.assess``.

Errors of known class, time and size are put into real recordings and looked for blind, each performance beside a
clean twin. The constructions follow the words of the specification only. A plain baseline judges the same rows.
What the exam is made of lies in lab/exams/dance, unread by who works on the evaluation.

    python -m lab.exams.evaluation [--data DIR] [--json FILE] [--only NAME] [--group NAME ...] [--seed N]
"""

from __future__ import annotations

import argparse
import json
import math
import time
from collections import Counter
from pathlib import Path

import dousa
from dousa.errors import DousaError
from dousa.evaluation import assess
from lab.exams.dance.baseline import baseline, irds_plain
from lab.exams.dance.cases import GROUPS, make_cases
from lab.exams.dance.grades import grade_check, irds_check
from lab.exams.dance.marks import judge, summarise
from lab.exams.dance.material import Material
from lab.exams.dance.placing import KINDS

SEED = 20140


def ask_dousa(references, performance):
    """(events, grade) of the candidate; what it refuses has no events and no grade, nor has what it does not grade."""
    try:
        answer = assess(references, performance)
    except DousaError:
        return [], None
    return list(answer.events), None if math.isnan(answer.score) else answer.score


def read_options():
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    default = Path(dousa.__file__).resolve().parents[2] / "../shared/data"
    parser.add_argument("--data", type=Path, default=default, help="the folder of recordings")
    parser.add_argument("--json", type=Path, help="write the numbers here")
    parser.add_argument("--only", choices=("dousa", "baseline"))
    parser.add_argument("--group", nargs="+", choices=GROUPS, default=list(GROUPS))
    parser.add_argument("--seed", type=int, default=SEED)
    return parser.parse_args()


def main():
    """Sit the examination and print the tables."""
    options = read_options()
    began = time.perf_counter()
    material = Material(options.data.resolve())
    cases = make_cases(material, options.group, options.seed)
    papers = [c for c in cases if c.truths]
    count = Counter(t.kind for c in papers for t in c.truths)
    shown = sum(len(c.counts) for c in papers)
    print(f"{len(papers)} performances with {count.total()} errors ({shown} rows with their references), each with a")
    kinds = ", ".join(f"{k} {count[k]}" for k in KINDS)
    print(f"clean twin; errors: {kinds}; built in {time.perf_counter() - began:.0f} s")
    table, seconds = {}, {}  # of processor time: the machine may be shared
    for name, ask in (("dousa", ask_dousa), ("baseline", baseline)):
        if options.only not in (None, name):
            continue
        start = time.process_time()
        rows = summarise(*judge(cases, ask))
        if "grade" in options.group:
            rows |= grade_check(material, ask, options.seed)
        if "irds" in options.group:
            rows |= irds_check(options.data, ask if name == "dousa" else irds_plain)
        table[name], seconds[name] = rows, time.process_time() - start
    print_tables(table, seconds)
    if options.json:
        content = {
            "performances": len(papers),
            "errors": dict(count),
            "rows": shown,
            "seconds": seconds,
            "table": table,
        }
        options.json.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def print_tables(table, seconds):
    """All rows of both candidates beside each other."""
    keys = list(dict.fromkeys(k for rows in table.values() for k in rows))
    width = max((len(k) for k in keys), default=0)
    print(f"{'':{width}}  " + "  ".join(f"{n:>9}" for n in table))
    for k in keys:
        print(f"{k:{width}}  " + "  ".join(f"{rows.get(k, float('nan')):9.3f}" for rows in table.values()))
    for name, rows in table.items():
        worse = [k for k, v in rows.items() if k.startswith("never worse") and v < 0]
        print(f"{name}: {seconds[name]:.0f} s of processor time; sets on which more references are worse: {len(worse)}")


if __name__ == "__main__":
    main()
