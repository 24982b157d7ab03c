"""By how much people differ throughout: what ``evaluation/posture/yaw.py`` takes for another body.

    python -m lab.training.body_offsets [--data DIR] [--pairs N]

Takes of the same motion are paired, two of one person or one of each of two people; prints by segment, in degrees, the
size of the constant offset that is estimated beside the line, after the tilt that all segments have in common: of one
person, for takes of ``WITHIN_S``, and of two people beyond what takes of one differ by. Of each the root of the median
and of the mean square (some short clips slip, and weigh much in the mean), for HDM05 (bd, bk) and UTD-MHAD (s1, s3,
s5) and their mean; the last rows are what the package has. Nothing is read of the people that are kept back.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dousa.arrays import FloatArray
from dousa.evaluation.grade.references import MOST_MISMATCH, compare
from dousa.evaluation.posture.posture import SEGMENTS, Working, compute_postures, thin_postures
from dousa.evaluation.posture.yaw import BETWEEN_DEG, WITHIN_DEG, WITHIN_S, find_tilt
from lab.training.judge_recordings import read_recordings

RATE = 30.0
SETS = ("HDM05", "UTD-MHAD")
AVERAGES: dict[str, Callable[..., FloatArray]] = {"median": np.nanmedian, "mean": np.nanmean}


@dataclass(frozen=True, slots=True, eq=False)
class Pair:
    """Two takes of one motion: (9,) deg squared of each segment, nan where it is not judged, and (9,) s."""

    same_person: bool
    squared: FloatArray
    seconds: FloatArray


def measure_pair(reference: Working, performance: Working, same_person: bool) -> Pair | None:
    """The offset of one take against another; None where they have nothing in common."""
    found = compare((reference,), performance, "same", np.ones(9))
    if found.alignment.mismatch > MOST_MISMATCH:
        return None
    offset = found.offset
    tilt = find_tilt(offset.measured, ~offset.missing & (offset.seconds > 0.0))
    squared = (np.degrees(offset.measured - tilt) ** 2).sum(axis=1)
    return Pair(same_person, np.where(offset.missing, np.nan, squared), offset.seconds)


def measure_set(data: Path, name: str, n_pairs: int) -> list[Pair]:
    """Pairs of takes of each motion by each two people of a set, either way round."""
    takes: dict[str, dict[str, list[Working]]] = defaultdict(lambda: defaultdict(list))
    for one in read_recordings(data):
        if one.set_name == name:
            takes[one.motion_name][one.person].append(thin_postures(compute_postures(one.motion, RATE)))
    rng = np.random.default_rng(0)
    pairs = []
    for people in takes.values():
        for a, theirs in people.items():
            for b, ours in people.items():
                chosen = [(i, j) for i in range(len(theirs)) for j in range(len(ours)) if a != b or i != j]
                for k in rng.permutation(len(chosen))[:n_pairs]:
                    i, j = chosen[k]
                    pairs.append(measure_pair(theirs[i], ours[j], a == b))
    return [pair for pair in pairs if pair is not None]


def summarise(pairs: Sequence[Pair], average: Callable[..., FloatArray]) -> tuple[FloatArray, FloatArray]:
    """(9,) deg within one person, for takes of ``WITHIN_S``, and (9,) deg between people beyond that."""
    same, other = ([pair for pair in pairs if pair.same_person is kind] for kind in (True, False))
    within = average([pair.squared * pair.seconds / WITHIN_S for pair in same], axis=0)
    beyond = average([pair.squared for pair in other], axis=0) - average([pair.squared for pair in same], axis=0)
    return np.sqrt(within), np.sqrt(np.maximum(beyond, 0.0))


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path("../shared/data"))
    parser.add_argument("--pairs", type=int, default=6, help="of takes, for each motion and each two people")
    options = parser.parse_args()
    sets = {name: measure_set(options.data, name, options.pairs) for name in SETS}
    width = max(map(len, SEGMENTS))
    print(f"{'':32}", *(f"{name:>{width}}" for name in SEGMENTS))
    for row, kind in enumerate(("one person", "two people")):
        for word, average in AVERAGES.items():
            measured = {name: summarise(pairs, average)[row] for name, pairs in sets.items()}
            measured["both"] = np.mean(list(measured.values()), axis=0)
            for name, values in measured.items():
                print_row(f"{kind}, {word}, {name}", values, width)
    print_row("one person, in the package", WITHIN_DEG, width)
    print_row("two people, in the package", BETWEEN_DEG, width)
    for name, pairs in sets.items():
        count = sum(pair.same_person for pair in pairs)
        print(f"{name}: {count} pairs of one person's takes, {len(pairs) - count} of two people's")


def print_row(title: str, values: FloatArray, width: int) -> None:
    """One line of the table."""
    print(f"{title:32}", *(f"{value:{width}.1f}" for value in values))


if __name__ == "__main__":
    main()
