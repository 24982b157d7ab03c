"""Does the grade agree with a physiotherapist? IntelliRehabDS: repetitions of exercises marked correct or incorrect.

    python -m lab.trials.irds_grade [--data DIR] [--references N]

Of every exercise the first five correct repetitions are the reference, all others are judged. Prints the area under
the ROC curve of correct against incorrect, for each exercise that has both and pooled, of the grade and of two plain
measures in the same run: the distance of dynamic time warping to the nearest reference, and the largest difference of
a segment's range of motion from the references' mean. Nothing of the grade is fitted to these data: it comes with the
package (lab/training/calibrate_grade.py, which reads other sets), so that no exercise needs to be left out.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dousa.evaluation import assess
from dousa.evaluation.alignment.correspondence import find_path
from dousa.evaluation.errors.evidence import measure_ranges
from dousa.evaluation.posture.posture import PostureSequence, compute_postures
from dousa.formats.motion_files import read_canonical

MEASURES = ("grade", "dtw", "range")


@dataclass(frozen=True, slots=True)
class Judged:
    """One repetition: its label, and how bad it is by each of `MEASURES`."""

    exercise: str
    correct: bool
    score: float
    badness: tuple[float, ...]


def measure_warping(references: Sequence[PostureSequence], performance: PostureSequence) -> float:
    """Mean angle between segments along the path of dynamic time warping, of the nearest reference; rad."""
    found = []
    for reference in references:
        path = find_path(reference.segments, performance.segments)
        cosine = (reference.segments[path[:, 0]] * performance.segments[path[:, 1]]).sum(axis=2)
        found.append(float(np.arccos(np.clip(cosine, -1.0, 1.0)).mean()))
    return min(found)


def measure_range(references: Sequence[PostureSequence], performance: PostureSequence) -> float:
    """Largest difference of a segment's range from the references' mean; rad."""
    usual = np.mean([measure_ranges(one.segments) for one in references], axis=0)
    return float(np.abs(measure_ranges(performance.segments) - usual).max())


def judge_exercise(folder: Path, n_references: int) -> list[Judged]:
    """All repetitions of an exercise that are no references."""
    correct, wrong = (sorted((folder / label).glob("*.trc")) for label in ("correct", "incorrect"))
    if len(correct) < n_references:
        return []
    takes = [read_canonical(path)[0] for path in correct[:n_references]]
    postures = [compute_postures(take) for take in takes]
    judged = []
    for path in (*correct[n_references:], *wrong):
        motion = read_canonical(path)[0]
        score = assess(takes, motion).score
        own = compute_postures(motion)
        bad = (-np.nan_to_num(score), measure_warping(postures, own), measure_range(postures, own))
        judged.append(Judged(folder.name, path in correct, score, tuple(float(one) for one in bad)))
    return judged


def find_area(judged: Sequence[Judged], measure: int) -> float:
    """Area under the ROC curve; nan without both kinds."""
    good = np.array([one.badness[measure] for one in judged if one.correct])
    bad = np.array([one.badness[measure] for one in judged if not one.correct])
    if not len(good) or not len(bad):
        return float("nan")
    return float((bad[:, None] > good).mean() + 0.5 * (bad[:, None] == good).mean())


def main() -> None:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path("../shared/data/irds"))
    parser.add_argument("--references", type=int, default=5)
    options = parser.parse_args()
    by_exercise: dict[str, list[Judged]] = defaultdict(list)
    for folder in sorted(options.data.iterdir()):
        if folder.is_dir():
            by_exercise[folder.name] = judge_exercise(folder, options.references)
    everything = [one for some in by_exercise.values() for one in some]
    print("exercise  correct  incorrect  median grades    AUROC: " + "  ".join(MEASURES))
    for name, some in [*by_exercise.items(), ("all", everything)]:
        scores = [[one.score for one in some if one.correct is label] for label in (True, False)]
        medians = " / ".join(f"{np.nanmedian(one):3.0f}" if one else "  -" for one in scores)
        areas = "  ".join(f"{find_area(some, k):5.2f}" for k in range(len(MEASURES)))
        print(f"{name:9s} {len(scores[0]):7d} {len(scores[1]):10d}  {medians:15s}         {areas}")


if __name__ == "__main__":
    main()
