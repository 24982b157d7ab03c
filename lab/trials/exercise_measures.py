"""Which plain measure agrees with therapists? Repetitions of UI-PRMD beside references by other people.

    python -m lab.trials.exercise_measures [--data DIR] [--sensors NAME ...] [--references N ...] [--draws N]

Prints for each measure the area under the ROC curve of correct against incorrect repetitions, of all people together,
as the mean of the ten movements and the worst one, and for own references. People 1 to 5; a repetition is never beside
references by its own person, but for the column "own". Nothing is fitted. Lateral movements are held against the
mirror image too, as two people do some with the left.

Joints are centred, turned to face one way, of unit height. ``rms``: evenly in time; ``DTW``: along the path of dynamic
time warping. ``displacement``: from the own first pose; ``centred``: from the own mean pose. ``d#`` and ``d*`` are the
paper's, of an eigenspace of each reference, along the path. References are pooled by the least, the mean or the median.
The last rows are what the grade is made of (`dousa.evaluation.grade.movement.PARTS`), their sum, and the grade itself,
for which none is 0. ``cannot tell``: by how much the share of repetitions that are judged rightly (correct ones graded
75 or more) rises if the three in ten nearest to that limit are left out.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dousa.arrays import FloatArray
from dousa.evaluation import compute_joint_angles, compute_postures
from dousa.evaluation.alignment.correspondence import find_path
from dousa.evaluation.figures.eigenspace import Eigenspace, fit_eigenspace
from dousa.evaluation.grade.movement import (
    PARTS,
    Difference,
    Movement,
    compare_movements,
    describe_movement,
    find_agreement,
    find_coverage,
    find_extent,
    find_parts,
)
from dousa.evaluation.grade.score import compute_grade, load_model
from dousa.motion import CanonicalMotion, mirror_canonical
from lab.exams.exercises.baselines import measure_warping, normalise_joints
from lab.exams.exercises.material import MOVEMENTS, SENSORS, draw_others, draw_own, find_area, read_uiprmd

EQUAL = np.ones(9)


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """What the measures need of one motion."""

    joints: FloatArray
    ranges: FloatArray
    movement: Movement
    space: Eigenspace


@dataclass(frozen=True, slots=True, eq=False)
class Pair:
    """A repetition against one reference: the plain distances, and the difference of the movements."""

    plain: dict[str, float]
    difference: Difference


def see(motion: CanonicalMotion) -> Seen:
    """Prepare a motion."""
    angles = compute_joint_angles(motion).values()
    ranges = np.array([np.ptp(one[np.isfinite(one)]) if np.isfinite(one).any() else 0.0 for one in angles])
    movement = describe_movement(compute_postures(motion))
    return Seen(normalise_joints(motion), ranges, movement, fit_eigenspace(movement.segments))


def compare(one: Seen, reference: Seen) -> Pair:
    """All plain distances of two motions."""
    a, b = one.joints, reference.joints
    plain = {"joints rms": float(np.sqrt(np.nanmean((a - b) ** 2))), "joints DTW": measure_warping(a, b)}
    plain["displacement rms"] = float(np.sqrt(np.nanmean((a - a[:3].mean(0) - b + b[:3].mean(0)) ** 2)))
    plain["displacement DTW"] = measure_warping(a - a[:3].mean(axis=0), b - b[:3].mean(axis=0))
    plain["centred DTW"] = measure_warping(a - a.mean(axis=0), b - b.mean(axis=0))
    plain["ranges"] = float(np.abs(one.ranges - reference.ranges).mean())
    space, ours, theirs = reference.space, one.movement.segments, reference.movement.segments
    path = find_path(ours, theirs)
    ours, theirs = space.align(ours)[path[:, 0]], space.align(theirs)[path[:, 1]]
    plain["d#"] = float(np.linalg.norm(space.residual(ours), axis=1).mean())
    plain["d*"] = float(np.linalg.norm(space.project(ours) - space.project(theirs), axis=1).mean())
    return Pair(plain, compare_movements(reference.movement, one.movement))


Measure = Callable[[Sequence[Pair], FloatArray], float]


def make_measures() -> dict[str, Measure]:
    """Name -> distance of a repetition from its references (pairs, agreement of the references)."""

    def pool(name: str, find: Callable) -> Measure:
        return lambda pairs, _: float(find([one.plain[name] for one in pairs]))

    names = ("joints rms", "joints DTW", "displacement rms", "displacement DTW", "centred DTW", "ranges", "d#", "d*")
    measures = {f"{name}, {how.__name__}": pool(name, how) for name in names for how in (min, np.mean, np.median)}

    def find(pairs: Sequence[Pair], agreement: FloatArray) -> tuple[FloatArray, float]:
        differences = [one.difference for one in pairs]
        return find_parts(differences, agreement, EQUAL), find_extent(differences, EQUAL)

    def find_one(number: int) -> Measure:
        return lambda pairs, agreement: float(find(pairs, agreement)[0][number])

    def find_sum(pairs: Sequence[Pair], agreement: FloatArray) -> float:
        return load_model().find_distance(*find(pairs, agreement))

    def find_grade(pairs: Sequence[Pair], agreement: FloatArray) -> float:
        coverage = find_coverage([one.difference for one in pairs], EQUAL)
        return -float(np.nan_to_num(compute_grade(*find(pairs, agreement), coverage, len(pairs)).score))

    measures |= {name: find_one(number) for number, name in enumerate(PARTS)}
    return measures | {"all parts": find_sum, "grade": find_grade}


def find_lift(good: Sequence[float], bad: Sequence[float], *, limit: float = 75.0, left_out: float = 0.3) -> float:
    """How much more is judged rightly by a limit of the grade if those nearest to it are left out."""
    values, correct = np.array([*good, *bad]), np.repeat([True, False], [len(good), len(bad)])
    if len(values) < 2:
        return float("nan")
    right = (values >= limit) == correct
    sure = np.argsort(np.abs(values - limit))[round(left_out * len(values)) :]
    return float(right[sure].mean() - right.mean())


def examine(options: argparse.Namespace, sensor: str, count: int, own: bool) -> dict[str, list[float]]:
    """Measure -> AUROC of each movement, the mean of the draws."""
    measures = make_measures()
    areas: dict[str, list[float]] = {name: [] for name in measures}
    lifts: list[float] = []
    for movement in MOVEMENTS:
        repetitions = read_uiprmd(options.data, sensor, movement, 1)
        seen = {id(one): see(one.motion) for one in repetitions}
        turned = {id(one): see(mirror_canonical(one.motion)) for one in repetitions if movement in ("m02", "m03")}
        found: dict[str, list[float]] = {name: [] for name in measures}
        for draw in range(options.draws):
            values = {name: ([], []) for name in measures}
            for number, one in enumerate(repetitions):
                if own:
                    references = draw_own(repetitions, one.person, movement, count, draw)
                else:
                    references = draw_others(repetitions, one.person, count, draw)
                if number % options.every or any(one is other for other in references):
                    continue
                pairs = [compare(seen[id(one)], seen[id(other)]) for other in references]
                for place, other in enumerate(references if turned else ()):
                    mirrored = compare(turned[id(one)], seen[id(other)])
                    if mirrored.plain["centred DTW"] < pairs[place].plain["centred DTW"]:
                        pairs[place] = mirrored
                apart = [
                    compare_movements(seen[id(a)].movement, seen[id(b)].movement)
                    for a in references for b in references if a is not b
                ]  # fmt: skip
                agreement = find_agreement(apart)
                for name, measure in measures.items():
                    values[name][not one.correct].append(-measure(pairs, agreement))
            for name in measures:
                found[name].append(find_area(*values[name]))
            lifts.append(find_lift(*values["grade"]))
        for name in measures:
            areas[name].append(float(np.mean(found[name])))
    return areas | {"cannot tell": lifts}


def main() -> None:
    """Read the command line, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path("../shared/data"))
    parser.add_argument("--sensors", nargs="+", choices=SENSORS, default=list(SENSORS))
    parser.add_argument("--references", nargs="+", type=int, default=[1, 3, 5])
    parser.add_argument("--draws", type=int, default=2)
    parser.add_argument("--every", type=int, default=2, help="every so many repetitions are judged")
    options = parser.parse_args()
    columns = {}
    for sensor in options.sensors:
        for count, own in [*((count, False) for count in options.references), (3, True)]:
            columns[f"{sensor} {'own ' if own else ''}{count}"] = examine(options, sensor, count, own)
    print(f"{'':36}" + "".join(f"{name:>14}" for name in columns))
    for name in (*make_measures(), "cannot tell"):
        cells = (f"{np.mean(one[name]):.3f} / {np.min(one[name]):.2f}" for one in columns.values())
        print(f"{name:36}" + "".join(f"{cell:>14}" for cell in cells))
    for title, one in columns.items():
        best = one["grade"]
        print(f"{title}: " + ", ".join(f"{m} {area:.2f}" for m, area in zip(MOVEMENTS, best, strict=True)))


if __name__ == "__main__":
    main()
