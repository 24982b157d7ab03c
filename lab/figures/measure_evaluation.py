"""Measurements of docs/evaluation.md that no command of dousa makes.

    python -m lab.figures.measure_evaluation furi [--dances N]
    python -m lab.figures.measure_evaluation sweep PATH... [--which tuning|held-out|all] [--repeats N] [--jobs N]

``furi`` cuts synthetic dances, whose figures are known. ``sweep`` puts errors of rising size into motions and counts
how many are found.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from dousa.evaluation import compute_postures, find_furi
from dousa.formats import ReadOptions
from dousa.library import parse_label_rule
from dousa.motion import canonicalise
from dousa.motion.synthetic.dance import make_dance
from dousa.motion.synthetic.performers import draw_performer
from lab.errors.experiment import is_held_out, run_severity_sweep
from lab.errors.recordings import read_takes

NEAR_S = 0.5  # a cut found so near to a true one is that one


def measure_furi(n_dances: int) -> None:
    """Cuts and labels of `find_furi` against those of synthetic dances by as many performers."""
    cuts, pairs = np.zeros(3, int), np.zeros(3, int)
    for seed in range(n_dances):
        dance = make_dance(draw_performer(seed), seed)
        postures = compute_postures(canonicalise(dance.motion))
        found = find_furi(postures)
        true = [figure.start for figure in dance.figures] + [dance.figures[-1].end]
        said = [one.start for one in found[1:]]
        cuts += (len(true), len(said), count_near(true, said, NEAR_S * postures.frame_rate))
        # Two moments that belong to equal figures, in truth and as found; every half second is one.
        names = np.full(postures.n_frames, "", object)
        labels = np.full(postures.n_frames, "", object)
        for figure in dance.figures:
            names[figure.start : figure.end] = figure.name
        for one in found:
            labels[one.start : one.end] = one.label
        some = np.flatnonzero(names != "")[:: round(NEAR_S * postures.frame_rate)]
        apart = ~np.eye(len(some), dtype=bool)
        alike = (names[some][:, None] == names[some]) & apart
        held = (labels[some][:, None] == labels[some]) & apart
        pairs += (alike.sum(), held.sum(), (alike & held).sum())
    for what, (n_true, n_said, n_right) in (("cuts", cuts), ("pairs of moments of equal label", pairs)):
        print(f"{what}: {n_true} true, {n_said} found, {n_right} right: "
              f"precision {n_right / n_said:.2f}, recall {n_right / n_true:.2f}")  # fmt: skip


def count_near(true: list[int], said: list[int], reach: float) -> int:
    """How many true frames have a found one of their own within reach."""
    left, count = set(said), 0
    for frame in true:
        nearest = min(left, key=lambda other: abs(other - frame), default=None)
        if nearest is not None and abs(nearest - frame) <= reach:
            left.remove(nearest)
            count += 1
    return count


def measure_sweep(paths: list[Path], which: str, repeats: int, jobs: int) -> None:
    """Share of injected errors that are found, by class and size."""
    takes, skipped = read_takes(paths, parse_label_rule(None, "takes"), options=ReadOptions(), n_jobs=jobs)
    motions = [one for one, _ in takes if which == "all" or is_held_out(one.name) == (which == "held-out")]
    print(f"{len(motions)} motions, {which}; {len(skipped)} files could not be read")
    print("class        size  injected  found  noticed")
    for row in run_severity_sweep(motions, repeats=repeats, n_jobs=jobs):
        shares = (count / max(row.n_errors, 1) for count in (row.n_found, row.n_noticed))
        print(f"{row.kind:10s} {row.size:6g} {row.n_errors:9d}", *(f"{share:7.2f}" for share in shares))


def main() -> None:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    furi = commands.add_parser("furi")
    furi.add_argument("--dances", type=int, default=20)
    sweep = commands.add_parser("sweep")
    sweep.add_argument("paths", nargs="+", type=Path)
    sweep.add_argument("--which", choices=("tuning", "held-out", "all"), default="tuning")
    sweep.add_argument("--repeats", type=int, default=1)
    sweep.add_argument("--jobs", type=int, default=2)
    given = parser.parse_args()
    if given.command == "furi":
        measure_furi(given.dances)
    else:
        measure_sweep(given.paths, given.which, given.repeats, given.jobs)


if __name__ == "__main__":
    main()
