"""An exam of the judge of exercises, written from the words of its task before anything of the evaluation was read.

Rows: does the grade agree with therapists (UI-PRMD, people left out, 1, 3 or 5 references by others, or 3 own ones;
IntelliRehabDS), is the part at fault named, one late arm, arms exchanged, false events on clean second takes, people
who do not move, and a growing error. The plainest measures judge the same rows. Counting on real films is in
lab/trials/count_series.py.

    python -m lab.exams.exercises [--data DIR] [--only ROW ...] [--system NAME] [--quick | --full] [--json FILE]

By default every third repetition is asked about, in two draws of references: about 20 minutes of one processor, most of
them the grades of UI-PRMD. ``--quick`` takes two: every fifth repetition, one draw, three references, and fewer takes;
``--full`` asks about every repetition (an hour).
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import dousa
from lab.exams.exercises.answers import Asker
from lab.exams.exercises.dances import sit_exchanged, sit_false, sit_late, sit_severity, sit_still
from lab.exams.exercises.material import SENSORS
from lab.exams.exercises.therapists import Judges, sit_irds, sit_uiprmd

DANCES = {
    "late": sit_late,
    "exchanged": sit_exchanged,
    "false": sit_false,
    "still": sit_still,
    "severity": sit_severity,
}
THERAPISTS = {"uiprmd": sit_uiprmd, "irds": sit_irds}


def read_options() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    default = Path(dousa.__file__).resolve().parents[2] / "../shared/data"
    parser.add_argument("--data", type=Path, default=default, help="the folder of recordings")
    parser.add_argument("--only", nargs="+", choices=(*THERAPISTS, *DANCES), default=[*THERAPISTS, *DANCES])
    parser.add_argument("--system", choices=("dousa", "baseline"), help="judge exercises by one of both only")
    parser.add_argument("--sensors", nargs="+", choices=SENSORS, default=list(SENSORS))
    size = parser.add_mutually_exclusive_group()
    size.add_argument("--quick", action="store_true")
    size.add_argument("--full", action="store_true")
    parser.add_argument("--json", type=Path, help="write the numbers here")
    options = parser.parse_args()
    options.stride = 5 if options.quick else 1 if options.full else 3
    options.draws = 1 if options.quick else 2
    return options


def main() -> None:
    """Sit the examination and print the rows."""
    options = read_options()
    asker, rows = Asker(), {}
    for name in options.only:
        start = time.process_time()
        if name in THERAPISTS:
            found = THERAPISTS[name](Judges(asker, options.system), options)
        else:
            found = DANCES[name](asker, options)
        print_rows(found)
        print(f"({name}: {time.process_time() - start:.0f} s of processor time)\n", flush=True)
        rows |= found
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


def print_rows(rows: dict[str, dict[str, float]]) -> None:
    """Systems beside each other."""
    systems = list(dict.fromkeys(system for row in rows.values() for system in row))
    width = max(map(len, rows), default=0)
    print(f"{'':{width}}  " + "  ".join(f"{name:>16}" for name in systems))
    for name, row in rows.items():
        cells = (f"{row[system]:16.3f}" if system in row else f"{'-':>16}" for system in systems)
        print(f"{name:{width}}  " + "  ".join(cells))


if __name__ == "__main__":
    main()
